"""Refuses a mesh that this machine cannot hold, before the mesher tries to make it."""

from __future__ import annotations

import errno
import math
import os
import re
import resource
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from app.case.case import Case
from app.case.geometries import MeshFile
from app.errors import EnvironmentProblem
from app.schema.yaml_file import CaseFile, Fault
from app.soundness import cost

# Bytes that a run takes at least: in all, per unknown (measured: 6 kB) and per cell.
BASE, PER_UNKNOWN, PER_CELL = 3e8, 4e3, 3e2
# Addresses that libraries take without using them (measured: 0.5 GB); without them some of them
# wait for ever.
UNUSED = 6e8
# What the libraries say where there is no more memory: C++, the system, CHOLMOD, MUMPS by PETSc.
SAID = ("bad_alloc", "Cannot allocate memory", "Out of memory", "status -2", "INFOG(1)=-13")
OUT_OF_MEMORY = 55  # of PETSc
NEARLY = 0.9  # of what a process may have
GIGABYTE = 1e9
# The control groups of this process, and where what limits them stands.
OWN_GROUPS, GROUPS = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")
ABSURD = 1e4  # mm; a geometry that needs larger cells is itself wrong


def needed(case: Case) -> float:
    """Memory that a run takes at least [byte], estimated; 0 where its mesh is not known yet."""
    cells = case.geometry.estimate_cells(case.mesh)
    return BASE + PER_UNKNOWN * cost.unknowns(case) + PER_CELL * cells if cells else 0.0


def available(environ: Mapping[str, str] = os.environ) -> float:
    """Memory of the machines that a run has [byte]: what is built in, or what it may use of it."""
    limits = [float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))]
    if (limit := resource.getrlimit(resource.RLIMIT_AS)[0]) != resource.RLIM_INFINITY:
        limits.append(limit - UNUSED)
    for file in _group_limits():
        with suppress(OSError, ValueError):  # there is none, or "max"
            limits.append(float(file.read_text()))
    number = environ.get("SLURM_NNODES", "1")
    ranks, here = (environ.get(f"OMPI_COMM_WORLD_{n}SIZE", "1") for n in ("", "LOCAL_"))
    machines = int(ranks) / int(here) if ranks.isdigit() and here.isdigit() else 1.0
    return min(limits) * max(machines, float(number) if number.isdigit() else 1.0, 1.0)


def _group_limits() -> Iterator[Path]:
    """Where limits of the control groups of this process may stand, and of those above them.

    In a container the path may be that outside of it; its own group is the root there.
    """
    with suppress(OSError):
        for line in OWN_GROUPS.read_text().splitlines():
            _, controllers, path = line.split(":", 2)
            folder, name = GROUPS, "memory.max"
            if controllers:  # of version 1
                if "memory" not in controllers.split(","):
                    continue
                folder, name = GROUPS / "memory", "memory.limit_in_bytes"
            group = Path(path.strip("/"))
            yield from (folder / part / name for part in (group, *group.parents))


def explain(error: BaseException) -> EnvironmentProblem | None:
    """Error that explains a lack of memory; None for any other error."""
    chain: list[BaseException] = []
    link: BaseException | None = error
    while link is not None and link not in chain:  # what PETSc hands back may be its own cause
        chain.append(link)
        link = link.__cause__ or link.__context__
    found = next(filter(_for_want, chain), error if _short() else None)
    if found is None:
        return None
    lines = filter(None, map(str.strip, str(found).splitlines()))
    return EnvironmentProblem(
        f"there is not enough memory: {next(lines, type(found).__name__)}\n{_limits()}; a larger "
        "mesh.size, solver.linear: multigrid or ranks on more machines need less of it"
    )


def _for_want(error: BaseException) -> bool:
    """Whether an error says that there is no more memory."""
    return (
        isinstance(error, MemoryError)
        or getattr(error, "errno", None) == errno.ENOMEM
        or getattr(error, "ierr", None) == OUT_OF_MEMORY
        or any(word in str(error) for word in SAID)
    )


def _short() -> bool:
    """Whether this process has nearly had all that it may: libraries do not always say why."""
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return False
    status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
    (peak,) = re.findall(r"VmPeak:\s+(\d+) kB", status)
    return 1024 * int(peak) > NEARLY * limit


def _limits() -> str:
    """Limit of memory of this process, in words."""
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    memory = f"{available({}) / GIGABYTE:.1f} GB"
    if limit == resource.RLIM_INFINITY:
        return f"a process may use {memory}"
    return f"a process may use {limit / GIGABYTE:.1f} GB of addresses (ulimit -v)"


def check(file: CaseFile, case: Case) -> None:
    """Refuse what cannot be held.

    Args:
        file: Where the case comes from.
        case: The case.

    Raises:
        InputError: With the estimate, what there is, and a size that would work.
        EnvironmentProblem: No case can be held.
    """
    memory = available()
    if memory < BASE:
        raise EnvironmentProblem(
            f"there is too little memory for any case: {_limits()}; mantle alone takes "
            f"{BASE / GIGABYTE:.1f} GB, and {(BASE + UNUSED) / GIGABYTE:.1f} GB of addresses"
        )
    if needed(case) <= memory:
        return
    cells, unknowns = case.geometry.estimate_cells(case.mesh), cost.unknowns(case)
    text = (
        f"makes about {cells:.2g} cells and {unknowns:.2g} unknowns, which take at least "
        f"{needed(case) / GIGABYTE:.2g} GB; there are {memory / GIGABYTE:.2g} GB"
    )
    if isinstance(case.geometry, MeshFile):
        file.raise_all([Fault(("geometry", "path"), text)])
    larger = _fitting(case, memory)
    hint = f"; {larger:g} mm would do" if larger <= min(case.geometry.coarsest_size, ABSURD) else ""
    file.raise_all([Fault(("mesh", "size"), f"{case.mesh.size:g} mm {text}{hint}")])


def _fitting(case: Case, memory: float) -> float:
    """A size with which a case fits: of two digits, and at most a tenth too large [mm]."""
    digit = 10.0 ** (math.floor(math.log10(case.mesh.size)) - 1)
    size = digit * math.ceil(case.mesh.size / digit)
    while needed(_with_size(case, size)) > memory:
        digit = digit if size < 99.5 * digit else 10.0 * digit
        size = digit * (round(size / digit) + 1)
    return float(f"{size:.2g}")


def _with_size(case: Case, size: float) -> Case:
    """The same with another mesh, as fine in proportion far from the interfaces."""
    far = case.mesh.far_size and case.mesh.far_size * size / case.mesh.size
    mesh = case.mesh.model_copy(update={"size": size, "far_size": far})
    return case.model_copy(update={"mesh": mesh})
