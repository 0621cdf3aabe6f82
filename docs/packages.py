"""Write environment.yml from packages.txt: ``python3 docs/packages.py``.

A line of packages.txt has Debian's name and, after ``#``, requirements: ``wheel`` those of an
environment by pip, ``conda`` those of conda-forge. A test compares what is committed with this.
"""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
HEAD = """\
# mantle by conda or mamba, on Linux, macOS and Windows (there in WSL):
# `conda env create -f environment.yml`, `conda activate mantle`, then ./mantle as usual.
# Written from packages.txt by docs/packages.py. Not tested by the project.
name: mantle
channels: [conda-forge]
dependencies:
"""


def requirements(kind: str) -> list[str]:
    """Requirements of a kind, ``wheel`` or ``conda``, in the order of packages.txt."""
    names = []
    for line in (ROOT / "packages.txt").read_text(encoding="utf-8").splitlines():
        debian, _, notes = line.partition("#")
        for note in notes.split(";") if debian.strip() else ():
            words = note.split()
            if words[:1] == [kind]:
                names += words[1:]
    return names


def environment() -> str:
    """Text of environment.yml."""
    conda = ["python>=3.11", *requirements("conda")]
    return HEAD + "".join(f'  - "{name}"\n' for name in conda)


if __name__ == "__main__":
    (ROOT / "environment.yml").write_text(environment(), encoding="utf-8")
