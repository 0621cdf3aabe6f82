"""Refuses a mesh that this machine cannot hold, before the mesher tries to make it."""

from __future__ import annotations

import math
import os
import resource
from collections.abc import Mapping
from pathlib import Path

from app import preview
from app.case_file import CaseFile, Problem
from app.config import Case, MeshFile

# Bytes that a run takes at least: in all, per unknown (measured: 6 kB) and per cell.
BASE, PER_UNKNOWN, PER_CELL = 3e8, 4e3, 3e2
GIGABYTE = 1e9
ABSURD = 1e4  # mm; a geometry that needs larger cells is itself wrong


def needed(case: Case) -> float:
    """Memory that a run takes at least [byte], estimated; 0 where its mesh is not known yet."""
    cells = case.geometry.estimate_cells(case.mesh)
    return BASE + PER_UNKNOWN * preview.unknowns(case) + PER_CELL * cells if cells else 0.0


def available(environ: Mapping[str, str] = os.environ) -> float:
    """Memory of the machines that a run has [byte]: what is built in, or what it may use of it."""
    limits = [float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))]
    if (limit := resource.getrlimit(resource.RLIMIT_AS)[0]) != resource.RLIM_INFINITY:
        limits.append(float(limit))
    for name in ("memory.max", "memory/memory.limit_in_bytes"):
        try:
            limits.append(float((Path("/sys/fs/cgroup") / name).read_text()))
        except (OSError, ValueError):
            continue  # there is none: "max"
    number = environ.get("SLURM_NNODES", "1")
    ranks, here = (environ.get(f"OMPI_COMM_WORLD_{n}SIZE", "1") for n in ("", "LOCAL_"))
    machines = int(ranks) / int(here) if ranks.isdigit() and here.isdigit() else 1.0
    return min(limits) * max(machines, float(number) if number.isdigit() else 1.0, 1.0)


def check(file: CaseFile, case: Case) -> None:
    """Refuse what cannot be held.

    Args:
        file: Where the case comes from.
        case: The case.

    Raises:
        InputError: With the estimate, what there is, and a size that would work.
    """
    memory = available()
    if needed(case) <= memory:
        return
    cells, unknowns = case.geometry.estimate_cells(case.mesh), preview.unknowns(case)
    text = (
        f"makes about {cells:.2g} cells and {unknowns:.2g} unknowns, which take at least "
        f"{needed(case) / GIGABYTE:.2g} GB; there are {memory / GIGABYTE:.2g} GB"
    )
    if isinstance(case.geometry, MeshFile):
        file.raise_all([Problem(("geometry", "path"), text)])
    larger = _fitting(case, memory)
    hint = f"; {larger:g} mm would do" if larger <= min(case.geometry.coarsest_size, ABSURD) else ""
    file.raise_all([Problem(("mesh", "size"), f"{case.mesh.size:g} mm {text}{hint}")])


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
