"""Report on this machine: versions, libraries, resources, and problems with them.

Nothing here may fail because something is missing: telling what is missing is the purpose.
"""

from __future__ import annotations

import os
import platform
import re
import shutil
import subprocess
from collections.abc import Callable, Iterable
from importlib import import_module
from pathlib import Path

from app.system import ranks
from app.system.folders import form_cache
from app.version import __version__

# What a run needs, as (shown name, module).
_MODULES = (
    ("dolfinx", "dolfinx"),
    ("petsc4py", "petsc4py"),
    ("ufl", "ufl"),
    ("basix", "basix"),
    ("ffcx", "ffcx"),
    ("gmsh", "gmsh"),
    ("h5py", "h5py"),
    ("mpi4py", "mpi4py"),
    ("numpy", "numpy"),
    ("scipy", "scipy"),
    ("pydantic", "pydantic"),
    ("ruamel.yaml", "ruamel.yaml"),
    ("pint", "pint"),
    ("matplotlib", "matplotlib"),
    ("jinja2", "jinja2"),
)
_DOLFINX = "0.9"
_SHARED_MEMORY = 256 * 2**20  # bytes; Docker gives 64 MiB, in which ranks cannot exchange
_MISSING = "missing"


def report() -> str:
    """Describe the environment: versions, MPI, compiler, BLAS, threads, memory, and warnings.

    Returns:
        A plain table, and below it one line per problem.
    """
    rows = [
        ("mantle", __version__),
        ("python", f"{platform.python_version()} on {platform.platform(terse=True)}"),
        *((name, _version(module)) for name, module in _MODULES),
        ("PETSc", _try(_petsc)),
        ("h5py with MPI", _try(_h5py_mpi)),
        ("MPI library", _try(_mpi)),
        ("mpirun", shutil.which("mpirun") or _MISSING),
        ("C compiler", _compiler()),
        ("BLAS", ", ".join(loaded_blas()) or "none loaded"),
        ("OMP_NUM_THREADS", os.environ.get("OMP_NUM_THREADS", "1")),
        ("cores", f"{len(os.sched_getaffinity(0))} usable of {os.cpu_count()}"),
        ("memory", _try(lambda: f"{_memory('MemAvailable')} free of {_memory('MemTotal')}")),
        ("/dev/shm", _try(lambda: _size(shutil.disk_usage("/dev/shm").total))),
        ("compiled forms", str(form_cache())),
        ("ranks here", str(ranks.world_size() or 1)),
    ]
    width = max(len(name) for name, _ in rows) + 2
    lines = [f"{name:<{width}}{value}" for name, value in rows]
    found = problems()
    lines.append("")
    lines += [f"warning: {problem}" for problem in found] or ["no problems found"]
    return "\n".join(lines)


def problems() -> list[str]:
    """List what would stop or slow down a run, each with its cure.

    Returns:
        One line per problem; empty when all is well.
    """
    found = []
    missing = [name for name, module in _MODULES if _version(module) == _MISSING]
    if missing:
        found.append(
            f"not installed: {', '.join(missing)}; `./mantle setup` or the packages in packages.txt"
        )
    dolfinx = _version("dolfinx")
    if dolfinx != _MISSING and not dolfinx.startswith(_DOLFINX + "."):
        found.append(f"dolfinx {dolfinx} is not supported; install {_DOLFINX}")
    if shutil.which("mpirun") is None:
        found.append("mpirun is missing: -n does not work; install openmpi-bin")
    if _compiler() == _MISSING:
        found.append("there is no C compiler: forms cannot be compiled; install g++")
    if os.environ.get("OMP_NUM_THREADS", "1") != "1":
        found.append("OMP_NUM_THREADS is not 1: ranks times threads must not exceed the cores")
    if "complex" in _try(_petsc):
        found.append("PETSc is built for complex numbers: install the real build")
    slow = [name for name in loaded_blas() if is_reference_blas(name)]
    if slow:
        found.append(
            f"{slow[0]} is the reference BLAS: direct solves take five times as long; "
            "install libopenblas0-pthread"
        )
    if _try(_h5py_mpi) == "no":
        found.append("h5py is built without MPI: install python3-h5py-mpi")
    shared = _try(lambda: str(shutil.disk_usage("/dev/shm").total))
    if not shared.isdigit():
        found.append("/dev/shm is missing: ranks on one node cannot exchange")
    elif int(shared) < _SHARED_MEMORY:
        found.append(f"/dev/shm has only {_size(int(shared))}: give a container --shm-size=2g")
    if not _is_writable(form_cache()):
        found.append(f"{form_cache()} is not writable: forms are compiled anew; set XDG_CACHE_HOME")
    return found


def loaded_blas() -> list[str]:
    """Tell which BLAS libraries numpy and PETSc have really loaded into this process.

    Returns:
        Paths of shared libraries, sorted; empty where neither numpy nor PETSc can be loaded.
    """
    for module in ("numpy.linalg", "petsc4py.PETSc"):
        _try(lambda module=module: str(import_module(module)))  # type: ignore[misc]
    try:
        maps = Path("/proc/self/maps").read_text().splitlines()
    except OSError:
        return []
    return blas_libraries(maps)


def blas_libraries(maps: Iterable[str]) -> list[str]:
    """Pick the BLAS libraries from the lines of ``/proc/<pid>/maps``.

    Args:
        maps: Lines whose sixth column, if any, is the mapped file.

    Returns:
        Paths, sorted, each once.
    """
    paths = {line.split(maxsplit=5)[5].strip() for line in maps if len(line.split(maxsplit=5)) == 6}
    pattern = re.compile(
        r"lib(blas|cblas|(scipy_)?openblas\w*|blis\w*|mkl_rt|atlas|flexiblas)([-.].*)?\.so"
    )
    return sorted(path for path in paths if pattern.match(path.rsplit("/", 1)[-1]))


def is_reference_blas(path: str) -> bool:
    """Tell the reference BLAS, which is slow, from the others.

    Debian's alternatives give every BLAS the name libblas.so.3; the folder says whose it is.

    Args:
        path: Path of a shared library.
    """
    return Path(path).name.startswith("libblas.so") and Path(path).parent.name in ("blas", "lib64")


def _try(tell: Callable[[], str]) -> str:
    """Call, and take any failure of a package to load for an answer."""
    try:
        return tell()
    except ImportError:
        return _MISSING
    except Exception as error:
        return f"unusable ({type(error).__name__}: {error})".splitlines()[0]


def _version(module: str) -> str:
    if module == "h5py":
        _try(lambda: str(import_module("mpi4py.MPI")))  # h5py built for MPI needs it loaded first
    return _try(lambda: str(getattr(import_module(module), "__version__", "unknown version")))


def _petsc() -> str:
    petsc = import_module("petsc4py.PETSc")
    numbers = ".".join(str(number) for number in petsc.Sys.getVersion())
    kind = petsc.ScalarType.__name__
    solvers = [name for name in ("mumps", "hypre") if petsc.Sys.hasExternalPackage(name)]
    return f"{numbers}, {kind}, with {' and '.join(solvers) or 'neither mumps nor hypre'}"


def _h5py_mpi() -> str:
    import_module("mpi4py.MPI")
    return "yes" if import_module("h5py").get_config().mpi else "no"


def _mpi() -> str:
    return str(import_module("mpi4py.MPI").Get_library_version()).split(",")[0].strip()


def _compiler() -> str:
    name = os.environ.get("CC", "").split(" ")[0] or "cc"
    path = shutil.which(name)
    if path is None:
        return _MISSING
    try:
        told = subprocess.run([path, "--version"], capture_output=True, text=True, timeout=10)
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"{path} ({error})"
    return f"{path} ({(told.stdout.splitlines() or ['?'])[0]})"


def _memory(field: str) -> str:
    """Read one field of /proc/meminfo."""
    for line in Path("/proc/meminfo").read_text().splitlines():
        if line.startswith(field + ":"):
            return _size(int(line.split()[1]) * 1024)
    raise ValueError(f"no {field} in /proc/meminfo")


def _size(count: int) -> str:
    return f"{count / 2**30:.1f} GiB" if count >= 2**30 else f"{count / 2**20:.0f} MiB"


def _is_writable(folder: Path) -> bool:
    """Tell whether a folder can be written to, or made."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return os.access(folder, os.W_OK)
