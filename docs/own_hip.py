r"""Write mantle's own femur, its canal and a stem as the files of docs/howto/your_hip.md.

    ./mantle shell -c 'python3 docs/own_hip.py out/hip'

In the page yours then take their place.
"""

from __future__ import annotations

import sys
from pathlib import Path

from tests.meshes import cad_stems
from tests.patient import bones


def write(folder: Path) -> None:
    """Write femur.stl, canal.stl and stem.step."""
    folder.mkdir(parents=True, exist_ok=True)
    bones.write(folder / "femur.stl", bones.own())
    bones.write(folder / "canal.stl", bones.own_canal())
    cad_stems.write("exeter", folder).rename(folder / "stem.step")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
