"""Report on this machine: versions, libraries, resources, and problems with them.

Nothing here may fail because something is missing: reporting it is the purpose.
"""

from __future__ import annotations

import os
import platform
import re
import shutil
import subprocess
from collections.abc import Callable, Iterable
from functools import partial
from importlib import import_module
from pathlib import Path

from app import __version__
from app.system import ranks
from app.system.folders import form_cache

# Modules that a run needs.
_MODULES = (
    *("dolfinx", "petsc4py", "ufl", "basix", "ffcx", "gmsh", "h5py", "mpi4py", "numpy", "scipy"),
    *("pydantic", "ruamel.yaml", "pint", "matplotlib", "jinja2"),
    *("nibabel", "pydicom", "skimage"),
)
# Releases of DOLFINx that the tests run on, the first and the last; between them all.
_OLDEST = (0, 9)
_NEWEST = (0, 11)
_SHARED_MEMORY = 256 * 2**20  # bytes; Docker gives 64 MiB, in which ranks cannot exchange
_MISSING = "missing"
# Packages of PETSc that factor matrices. Others, such as hypre, mantle does not use.
_SOLVERS = ("MUMPS", "CHOLMOD")


def report_on_machine() -> str:
    """A table of versions, MPI, compiler, BLAS, threads and memory, and a line for each problem."""
    rows = {
        "mantle": __version__,
        "python": f"{platform.python_version()} on {platform.platform(terse=True)}",
        **{module: _version(module) for module in _MODULES},
        "PETSc": _try(_petsc),
        "h5py with MPI": _try(_h5py_mpi),
        "MPI library": _try(_mpi),
        "mpirun": shutil.which("mpirun") or _MISSING,
        "C compiler": _compiler(),
        "BLAS": ", ".join(loaded_blas()) or "none loaded",
        "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "1"),
        "cores": f"{len(os.sched_getaffinity(0))} usable of {os.cpu_count()}",
        "memory": _try(lambda: f"{_memory('MemAvailable')} free of {_memory('MemTotal')}"),
        "/dev/shm": _try(lambda: _size(shutil.disk_usage("/dev/shm").total)),
        "compiled forms": str(form_cache()),
        "ranks here": str(ranks.world_size() or 1),
    }
    lines = [f"{name:<{max(map(len, rows)) + 2}}{value}" for name, value in rows.items()]
    warnings = [f"warning: {problem}" for problem in problems()] or ["no problems found"]
    return "\n".join([*lines, "", *warnings])


def problems() -> list[str]:
    """Problems that would stop or slow down a run, each with its cure."""
    missing = [module for module in _MODULES if _version(module) == _MISSING]
    dolfinx = _version("dolfinx")
    numbers = re.match(r"(\d+)\.(\d+)", dolfinx)
    release = (int(numbers[1]), int(numbers[2])) if numbers else ()
    petsc = _try(_petsc)
    lacking = petsc.partition(", without ")[2]
    slow = next(filter(is_reference_blas, loaded_blas()), "")
    shared_memory = _try(lambda: str(shutil.disk_usage("/dev/shm").total))
    room = int(shared_memory) if shared_memory.isdigit() else 0
    wrong_sums = "" if missing else _try(wrong_blas)
    checks = {
        f"not installed: {', '.join(missing)}; `./mantle setup` or the packages in packages.txt": (
            bool(missing)
        ),
        f"DOLFINx {dolfinx} is too old; install 0.9, 0.10 or 0.11": (
            bool(release) and release < _OLDEST
        ),
        f"DOLFINx {dolfinx} is newer than what mantle is tested with, 0.11; run `mantle verify`": (
            release > _NEWEST
        ),
        "PETSc has no MUMPS: matrices cannot be factored": "MUMPS" in lacking,
        "PETSc has no CHOLMOD: MUMPS factors instead, and a run takes about 1.3 times the CPU time "
        "(stance of 160,000 unknowns: 25 s instead of 19)": "CHOLMOD" in lacking,
        "mpirun is missing: -n does not work; install openmpi-bin": shutil.which("mpirun") is None,
        "there is no C compiler: forms cannot be compiled; install g++": _compiler() == _MISSING,
        "OMP_NUM_THREADS is not 1: ranks times threads must not exceed the cores": (
            os.environ.get("OMP_NUM_THREADS", "1") != "1"
        ),
        "PETSc is built for complex numbers: install the real build": "complex" in petsc,
        f"{slow} is the reference BLAS: direct solves take five times as long; install "
        "libopenblas0-pthread": bool(slow),
        "/dev/shm is missing: ranks on one node cannot exchange": not room,
        f"/dev/shm has only {_size(room)}: give a container --shm-size=2g": (
            0 < room < _SHARED_MEMORY
        ),
        wrong_sums: bool(wrong_sums),
        f"{form_cache()} is not writable: forms are compiled anew; set XDG_CACHE_HOME": (
            not _is_writable(form_cache())
        ),
    }
    return [message for message, applies in checks.items() if applies]


def wrong_blas() -> str:
    """Message that names wrong results of the BLAS, and the cure; empty if all are right."""
    from app.system import blas_check  # which needs numpy and PETSc: they may be missing

    wrong_results = blas_check.wrong_results()
    if not wrong_results:
        return ""
    return (
        f"the BLAS of this machine ({', '.join(loaded_blas()) or 'unknown'}) computes wrong "
        f"numbers: {', '.join(wrong_results)}; choose another (update-alternatives --config "
        "libblas.so.3-x86_64-linux-gnu), or other kernels of OpenBLAS, e.g. "
        "OPENBLAS_CORETYPE=Haswell"
    )


def loaded_blas() -> list[str]:
    """Paths of the BLAS libraries that numpy and PETSc have loaded into this process."""
    for module in ("numpy.linalg", "petsc4py.PETSc"):
        _try(lambda module=module: str(import_module(module)))  # type: ignore[misc]
    return blas_libraries(Path("/proc/self/maps").read_text().splitlines())


def blas_libraries(maps: Iterable[str]) -> list[str]:
    """Paths of the BLAS libraries in the lines of ``/proc/<pid>/maps``, sorted, each once."""
    paths = {line.split(maxsplit=5)[5].strip() for line in maps if len(line.split(maxsplit=5)) == 6}
    pattern = re.compile(
        r"lib(blas|cblas|(scipy_)?openblas\w*|blis\w*|mkl_rt|atlas|flexiblas)([-.].*)?\.so"
    )
    return sorted(path for path in paths if pattern.match(path.rsplit("/", 1)[-1]))


def is_reference_blas(path: str) -> bool:
    """Return True if a library is the reference BLAS, which is slow.

    Debian's alternatives give every BLAS the name libblas.so.3; the folder says whose it is.
    """
    return Path(path).name.startswith("libblas.so") and Path(path).parent.name in ("blas", "lib64")


def _try(call: Callable[[], str]) -> str:
    """Result of a call, or the reason why a package cannot be loaded."""
    try:
        return call()
    except ImportError:
        return _MISSING
    except Exception as error:
        return f"unusable ({type(error).__name__}: {error})".splitlines()[0]


def _version(module: str) -> str:
    _try(lambda: str(import_module("mpi4py.MPI")))  # h5py and the libraries of wheels need it first
    return _try(lambda: str(getattr(import_module(module), "__version__", "unknown version")))


def _petsc() -> str:
    petsc = import_module("petsc4py.PETSc")
    numbers = ".".join(str(number) for number in petsc.Sys.getVersion())
    kind = petsc.ScalarType.__name__
    is_built_in = {name: petsc.Sys.hasExternalPackage(name.lower()) for name in _SOLVERS}
    petsc_text = f"{numbers}, {kind}"
    for preposition, expected in (("with", True), ("without", False)):
        solver_names = [name for name in _SOLVERS if is_built_in[name] is expected]
        if solver_names:
            petsc_text += f", {preposition} {' and '.join(solver_names)}"
    return petsc_text


def _h5py_mpi() -> str:
    import_module("mpi4py.MPI")
    return "yes" if import_module("h5py").get_config().mpi else "no"


def _mpi() -> str:
    library = str(import_module("mpi4py.MPI").Get_library_version())
    return " ".join(library.splitlines()[0].split(",")[0].split())


def _compiler() -> str:
    name, *arguments = os.environ.get("CC", "").split() or ["cc"]
    path = shutil.which(name)
    if path is None:
        return _MISSING
    command = partial(
        subprocess.check_output, [path, *arguments, "--version"], text=True, timeout=10
    )
    return f"{path} ({_try(command).splitlines()[0]})"


def _memory(field: str) -> str:
    return _size(1024 * int(Path("/proc/meminfo").read_text().partition(f"{field}:")[2].split()[0]))


def _size(count: int) -> str:
    return f"{count / 2**30:.1f} GiB" if count >= 2**30 else f"{count / 2**20:.0f} MiB"


def _is_writable(folder: Path) -> bool:
    return os.access(next(p for p in (folder, *folder.parents) if p.exists()), os.W_OK)
