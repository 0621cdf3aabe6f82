"""Identity of a run beside its input: the sources of mantle and the versions of the stack.

It imports nothing of the stack: commands that start many runs work without MPI.
"""

from __future__ import annotations

import ctypes
import hashlib
import importlib.util
import re
import sys
from functools import lru_cache
from importlib import metadata
from pathlib import Path

from app import __version__

# Modules that no number of a run depends on: changing them leaves finished runs valid.
WITHOUT_INFLUENCE = re.compile(
    r"app/(__init__|cli|(campaigns|command_line|report|validation|verification)/.*|results/reading"
    r"|case/(fit|keys|new_case|study|sweep)|system/doctor)\.py"
)
MISSING = "missing"


@lru_cache(maxsize=1)
def versions() -> dict[str, str]:
    """Versions of mantle (with a hash of its sources), dolfinx, PETSc, gmsh, BLAS with its kernel.

    A package that is not installed is "missing".
    """
    petsc = _petsc()
    return {
        "mantle": program(),
        "dolfinx": _version("fenics-dolfinx", "dolfinx-solver-real"),
        "petsc": _version_of(petsc) if petsc else MISSING,
        "gmsh": _version("gmsh"),
        "blas": _blas(petsc) if petsc else MISSING,
    }


@lru_cache(maxsize=1)
def program() -> str:
    """The version and a hash of the sources, which change more often."""
    digest = hashlib.sha256()
    for name, path in sorted(sources().items()):
        if not WITHOUT_INFLUENCE.fullmatch(name):
            digest.update(f"{name}\0".encode() + path.read_bytes())
    return f"{__version__} {digest.hexdigest()}"


def sources() -> dict[str, Path]:
    """Source files of the program, by path relative to the folder that holds ``app``."""
    top_folder = Path(__file__).resolve().parents[2]
    files = (
        p for folder in ("app", "forms", "meshes") for p in (top_folder / folder).rglob("*.py")
    )
    return {p.relative_to(top_folder).as_posix(): p for p in files}


def _version(*packages: str) -> str:
    """Version of the first of some packages that is installed."""
    found_versions = (
        distribution.version
        for name in packages
        for distribution in metadata.distributions(name=name)
    )
    return next(found_versions, MISSING)


def _petsc() -> ctypes.CDLL | None:
    """Load PETSc and its dependencies without starting it; None if missing."""
    spec = importlib.util.find_spec("petsc4py")
    folders = (spec and spec.submodule_search_locations) or ()
    libraries = sorted(p for folder in folders for p in Path(folder).glob("lib/**/PETSc*.so"))
    mpi = sorted(Path(sys.prefix).glob("lib/libmpi.so.*"))
    if mpi:  # of wheels: their PETSc needs it
        ctypes.CDLL(str(mpi[0]), mode=ctypes.RTLD_GLOBAL)
    return ctypes.CDLL(str(libraries[0])) if libraries else None


def _version_of(petsc: ctypes.CDLL) -> str:
    """Version of the library, which may be newer than petsc4py."""
    numbers = (ctypes.c_int * 4)()
    petsc.PetscGetVersionNumber(*(ctypes.byref(numbers, 4 * k) for k in range(4)))
    return "{}.{}.{}".format(*numbers)


def _blas(petsc: ctypes.CDLL) -> str:
    """Version and kernel of OpenBLAS; the file of any other BLAS."""
    if hasattr(petsc, "openblas_get_config"):
        petsc.openblas_get_config.restype = ctypes.c_char_p
        return str(petsc.openblas_get_config().decode())
    address = ctypes.cast(petsc.dgemm_, ctypes.c_void_p).value or 0
    for line in Path("/proc/self/maps").read_text().splitlines():
        low_address, high_address = (int(end, 16) for end in line.split()[0].split("-"))
        if low_address <= address < high_address:
            return line.split(maxsplit=5)[5]
    return MISSING
