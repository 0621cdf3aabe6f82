"""Companions of a case: a cheaper one, and keys of equal stiffness or equal matrices."""

from __future__ import annotations

from typing import Any

from app.case.case import Case

# Unknowns from which a start from a cheaper model pays. Between 18 000 and 40 000 it takes as long
# as none where that converges (within 10 %), and half as long where it does not: 7 iterations, not
# 25.
LARGE = 20_000
# Mesh size of a coarser model over that of the run.
COARSER = 2.0
# Tolerance of the cheaper model, relative to the forces: far below its discretization error.
TOLERANCE = 1e-4


def cheaper(case: Case, unknowns: int) -> Case | None:
    """The case on a coarser mesh, else at first order; None unless its mechanics is large."""
    if unknowns < LARGE:
        return None
    mesh, solver = case.mesh, case.solver
    if COARSER * mesh.size <= case.geometry.coarsest_size:
        mesh = mesh.coarser(COARSER)
    elif mesh.order > 1:
        mesh = mesh.model_copy(update={"order": 1})
    else:
        return None
    tolerance = {"tolerance": max(TOLERANCE, solver.tolerance)}
    changes = {"mesh": mesh, "solver": solver.model_copy(update=tolerance)}
    return case.model_copy(update=changes)


def stiffness(case: Case) -> tuple[Any, ...]:
    """All data of a case that the stiffness of the bonded model and its solver depend on."""
    solver = case.solver.model_copy(update={"augmentation_factor": 1.0, "tolerance": 0.0})
    stages = [stage.name for stage in case.stages]
    return case.geometry, case.mesh, case.regions, case.supports, solver, stages


def matrices(case: Case) -> tuple[Any, ...]:
    """All data of a case that its matrices and compiled forms depend on."""
    loads = [(name, load.place) for name, load in case.loads.items()]
    contacts = [name for name, law in case.interfaces.items() if law.can_part]
    return *stiffness(case), loads, contacts
