"""Refuse a mesh beyond the memory of this machine, before meshing."""

from __future__ import annotations

import errno
import math
import os
import resource
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from app.case.case import Case
from app.case.geometries import MeshFile
from app.foundation.errors import EnvironmentProblem
from app.foundation.layout import rounded_count
from app.schema.yaml_file import CaseFile, Fault
from app.soundness import cost
from app.system.timing import peak_memory

# Least memory of any run [byte].
BASE = 3e8
# Least memory per unknown [byte] (measured: 6 kB).
PER_UNKNOWN = 4e3
# Least memory per cell [byte].
PER_CELL = 3e2
# Address space that libraries reserve but do not use (measured: 0.5 GB) [byte]. Without it some of
# them hang.
UNUSED = 6e8
# Messages of libraries out of memory: C++, the system, CHOLMOD, MUMPS by PETSc.
MEMORY_ERRORS = (
    "bad_alloc",
    "Cannot allocate memory",
    "Out of memory",
    "status -2",
    "INFOG(1)=-13",
)
# PETSc's code of an error without memory.
OUT_OF_MEMORY = 55
# Fraction of the limit of a process from which on its memory counts as used up.
NEARLY = 0.9
# Bytes of a gigabyte.
GIGABYTE = 1e9
# The control groups of this process.
OWN_GROUPS = Path("/proc/self/cgroup")
# The root of the limits of control groups.
GROUPS = Path("/sys/fs/cgroup")
# Largest cells that are suggested [mm]: a geometry that needs larger ones is wrong.
ABSURD = 1e4


def needed(case: Case) -> float:
    """Estimated least memory of a run [byte]; 0 if its size is not known before meshing."""
    cells = case.geometry.estimate_cells(case.mesh)
    return BASE + PER_UNKNOWN * cost.estimated_unknowns(case) + PER_CELL * cells if cells else 0.0


def available_memory(environ: Mapping[str, str] = os.environ) -> float:
    """Memory available to a run on its machines [byte]: installed memory, or a lower limit."""
    limits = [float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))]
    limits.append(_addresses() - UNUSED)
    for file in _group_limits():
        with suppress(OSError, ValueError):  # no such file, or the text "max"
            limits.append(float(file.read_text()))
    variable_names = ("SLURM_NNODES", "OMPI_COMM_WORLD_SIZE", "OMPI_COMM_WORLD_LOCAL_SIZE")
    slurm_values = (environ.get(name, "") for name in variable_names)
    nodes, ranks, node_ranks = (
        float(count_text) if count_text.isdigit() else 1.0 for count_text in slurm_values
    )
    return min(limits) * max(nodes, ranks / node_ranks, 1.0)


def _addresses() -> float:
    """Limit of the address space of a process [byte]; infinite if there is none."""
    address_limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    return math.inf if address_limit == resource.RLIM_INFINITY else float(address_limit)


def _group_limits() -> Iterator[Path]:
    """Files that may limit the control groups of this process, and the groups above them.

    In a container the path may be the one on the host. The group of the container is then the root.
    """
    with suppress(OSError):
        for line in OWN_GROUPS.read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            group = Path(path.strip("/"))
            for part in (group, *group.parents):
                if not controllers:
                    yield GROUPS / part / "memory.max"
                elif "memory" in controllers.split(","):  # of version 1
                    yield GROUPS / "memory" / part / "memory.limit_in_bytes"


def error_without_memory(error: BaseException) -> EnvironmentProblem | None:
    """Return an error that explains a lack of memory; None for any other error."""
    chain: list[BaseException] = []
    link: BaseException | None = error
    while link is not None and link not in chain:  # an error of PETSc may name itself as its cause
        chain.append(link)
        link = link.__cause__ or link.__context__
    is_nearly_full = 1e6 * peak_memory("VmPeak") > NEARLY * _addresses()
    cause = next(filter(_lacks_memory, chain), error if is_nearly_full else None)
    if cause is None:
        return None
    lines = filter(None, map(str.strip, str(cause).splitlines()))
    return EnvironmentProblem(
        f"there is not enough memory: {next(lines, type(cause).__name__)}\n{_limits()}; use a "
        "larger mesh.size, solver.linear: multigrid, or ranks on more machines"
    )


def _lacks_memory(error: BaseException) -> bool:
    return (
        isinstance(error, MemoryError)
        or getattr(error, "errno", None) == errno.ENOMEM
        or getattr(error, "ierr", None) == OUT_OF_MEMORY
        or any(text in str(error) for text in MEMORY_ERRORS)
    )


def _limits() -> str:
    address_limit = _addresses()
    if math.isinf(address_limit):
        return f"a process may use {available_memory({}) / GIGABYTE:.1f} GB"
    return f"a process may use {address_limit / GIGABYTE:.1f} GB of address space (ulimit -v)"


def check(file: CaseFile, case: Case) -> None:
    """Refuse a case that needs more memory than is available.

    Raises:
        InputError: The case does not fit; the error names a size that does, if any.
        EnvironmentProblem: No case fits.
    """
    memory = available_memory()
    if memory < BASE:
        raise EnvironmentProblem(
            f"not enough memory for any case: {_limits()}; mantle itself needs "
            f"{BASE / GIGABYTE:.1f} GB, and {(BASE + UNUSED) / GIGABYTE:.1f} GB of address space"
        )
    needed_memory = needed(case)
    if needed_memory <= memory:
        return
    cells, unknowns = case.geometry.estimate_cells(case.mesh), cost.estimated_unknowns(case)
    message = (
        f"makes about {rounded_count(cells)} cells and {rounded_count(unknowns)} unknowns, which"
        f" need at least {needed_memory / GIGABYTE:.5g} GB;"
        f" {memory / GIGABYTE:.1f} GB are available"
    )
    if isinstance(case.geometry, MeshFile):
        file.raise_all([Fault(("geometry", "path"), message)])
    key = _finest(case, memory)
    given_value, fitting_value = getattr(case.mesh, key), _fitting(case, key, memory)
    shown_value = f"{given_value} lines" if isinstance(given_value, int) else f"{given_value:g} mm"
    hint = f"; {fitting_value} fits into the memory" if fitting_value else ""
    file.raise_all([Fault(("mesh", key), f"{shown_value} {message}{hint}")])


def _finest(case: Case, memory: float) -> str:
    """Mesh key to blame for a case that is too large.

    It is a given key whose default would fit, else `size`.
    """
    for key in ("around", "along"):
        mesh = case.mesh.model_copy(update={key: None})
        is_given = getattr(case.mesh, key) is not None
        if is_given and needed(case.model_copy(update={"mesh": mesh})) <= memory:
            return key
    return "size"


def _fitting(case: Case, key: str, memory: float) -> str:
    """Value of a mesh key with which a case fits into a memory [byte]; empty if there is none."""
    factor, coarser = 1.0, case
    while needed(coarser) > memory:
        factor *= 1.02
        mesh = case.mesh.coarser(factor)
        if key != "size":  # `size` changes all lengths of the mesh in proportion
            mesh = case.mesh.model_copy(update={key: getattr(mesh, key)})
        coarser = case.model_copy(update={"mesh": mesh})
    if isinstance(getattr(case.mesh, key), int):
        return f"{getattr(coarser.mesh, key)} lines"
    # Rounded up to two digits.
    length = factor * getattr(case.mesh, key)
    digit = 10.0 ** (math.floor(math.log10(length)) - 1)
    larger = float(f"{digit * math.ceil(length / digit):.2g}")
    if larger > min(case.geometry.coarsest_size, ABSURD):
        return ""
    other_keys = [
        k for k in ("around", "along") if key == "size" and getattr(case.mesh, k) is not None
    ]
    if not other_keys:
        return f"{larger:g} mm"
    return f"{larger:g} mm, with {' and '.join(other_keys)} coarser by the same factor,"
