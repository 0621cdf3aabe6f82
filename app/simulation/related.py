"""Cases related to one: on a coarser mesh, with the same stiffness, with the same matrices."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mantle.schema import config

# Unknowns from which a coarser mesh pays, and the largest part of them that may be jumps: where
# most of a mesh is interface, as in a thin cement mantle, most of the work is to find the states of
# points that the coarse mesh does not have.
LARGE, SHARE = 40_000, 0.25
# Mesh size of the coarser one over that of the run, and what it takes at least to be worth it.
COARSER, LEAST = 3.0, 2.5
# Tolerance of the coarse solve, relative to the forces: far below its discretization error.
TOLERANCE = 1e-4


def coarser(case: config.Case, unknowns: Mapping[str, int]) -> config.Case | None:
    """The case on a coarser mesh, if it is large and its geometry can be meshed so.

    Args:
        case: A case.
        unknowns: Of its mechanics, by block.
    """
    coarsening = min(COARSER, case.geometry.coarsest_size / case.mesh.size)
    size = sum(unknowns.values())
    if size < LARGE or unknowns["jump"] > SHARE * size or coarsening < LEAST:
        return None
    sizes = {"size": coarsening * case.mesh.size, "far_size": coarsening * case.mesh.far}
    solver = {"tolerance": max(TOLERANCE, case.solver.tolerance)}
    return case.model_copy(
        update={
            "mesh": case.mesh.model_copy(update=sizes),
            "solver": case.solver.model_copy(update=solver),
        }
    )


def stiffness(case: config.Case) -> tuple[Any, ...]:
    """All of a case that the stiffness of the bonded model and its solver depend on."""
    solver = case.solver.model_copy(update={"augmentation_factor": 1.0})
    stages = [stage.name for stage in case.stages]
    return case.geometry, case.mesh, case.regions, case.supports, solver, stages


def matrices(case: config.Case) -> tuple[Any, ...]:
    """All of a case that its matrices and its compiled forms depend on."""
    loads = [(name, load.place) for name, load in case.loads.items()]
    contacts = [name for name, law in case.interfaces.items() if law.can_part]
    return *stiffness(case), loads, contacts
