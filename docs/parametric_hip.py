r"""Write the parametric femur, its canal and a stem as the files of docs/howto/your_hip.md.

    ./mantle shell -c 'python3 docs/parametric_hip.py out/hip'

On that page your files then take their place.
"""

from __future__ import annotations

import sys
from pathlib import Path

from tests.meshes import cad_stems
from tests.patient import bones


def write(folder: Path) -> None:
    """Write femur.stl, canal.stl and stem.step."""
    folder.mkdir(parents=True, exist_ok=True)
    bones.write(folder / "femur.stl", bones.parametric_femur())
    bones.write(folder / "canal.stl", bones.parametric_canal())
    cad_stems.write("exeter", folder).rename(folder / "stem.step")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
