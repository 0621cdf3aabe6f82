"""A folder with files named like Python modules and settings, which a run must not execute."""

from __future__ import annotations

import shutil
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# Files of options that libraries read in the working folder: PETSc writes a log, compilers get a
# flag that they do not know, forms are complex, pictures start LaTeX.
OPTIONS = {
    ".petscrc": "-log_view :petsc.txt\n",
    "petscrc": "-log_view :petsc.txt\n",
    "dolfinx_jit_options.json": '{"cffi_extra_compile_args": ["--no-such-flag"]}',
    "ffcx_options.json": '{"scalar_type": "complex128"}',
    "matplotlibrc": "text.usetex: True\n",
}
# Named as mantle's, as libraries and as what Python starts with.
MODULES = """
app.py argparse.py configs/__init__.py forms.py gmsh.py logging.py mantle.py meshes/__init__.py
numpy.py sitecustomize.py snakemake.py socket.py
""".split()


def mislead(folder: Path) -> None:
    """Write such files into a folder, with a case, blocks.yaml, and a sweep of it on two ranks."""
    for name, text in OPTIONS.items():
        (folder / name).write_text(text)
    for name in MODULES:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text("raise SystemExit('this is not what was asked for')\n")
    shutil.copy(ROOT / "configs" / "blocks.yaml", folder)
    (folder / "sweep.yaml").write_text(
        "base: blocks.yaml\nset: {ranks: 2, output.fields: false}\ngrid: {mesh.order: [1]}\n"
    )
