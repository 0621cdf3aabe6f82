"""Heat that enters and is stored in a model, for its balance."""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np

from app.heat.implicit_step import ImplicitStep
from app.heat.operators import HeatOperators
from app.laws.values import multiplier


def flows(step: ImplicitStep, x: Sequence[PETSc.Vec]) -> dict[str, float]:
    """Heat that enters the model per time in a state, by condition [N mm/s]; collective.

    Their sum is the rate at which heat is stored in the interval last begun, to the tolerance of
    the solver.
    """
    here, operators = step.at(x), step.operators
    found: dict[str, float] = {}
    for h in operators.loads.heating:
        found[h.name] = multiplier(h.course, step.seconds) * float(h.nodal.sum())
    for e in operators.loads.exchange:
        found[e.name] = float((e.per_kelvin * (e.outside - here.T)).sum())
    if cure := operators.cure:
        for n, heat in zip(cure.nodes, cure.released(here.T), strict=True):
            found[f"cure {n.region}"] = float(heat.sum())
    lacking = here.lacking.copy()
    if (j := operators.jumps) and here.flux:
        q = j.weight * here.flux[0]
        np.add.at(lacking, (j.bodies[:, 0], j.dof), q)
        np.add.at(lacking, (j.bodies[:, 1], j.dof), -q)
    for s, c in enumerate(operators.fixed.conditions):
        found[c.name] = float(lacking[operators.fixed.of_body == s].sum())
    sums = step.comm.allreduce(np.array(list(found.values())))
    every = dict(zip(found, map(float, sums), strict=True))
    return every | (operators.friction.flows if operators.friction else {})


def through(step: ImplicitStep, x: Sequence[PETSc.Vec]) -> dict[str, float]:
    """Heat per time from the first side to the second [N mm/s]; collective.

    By interface of finite conductance, without friction heat.
    """
    names = [c.name for c in step.operators.scene.thermal_contacts]
    sums, flux = np.zeros(len(names)), step.at(x).flux
    if (j := step.operators.jumps) and flux:
        sums += np.bincount(j.interface, j.weight * flux[0], minlength=len(names))
    return dict(zip(names, map(float, step.comm.allreduce(sums)), strict=True))


def stored(operators: HeatOperators, x: Sequence[PETSc.Vec]) -> float:
    """Stored heat above an arbitrary but fixed temperature [N mm]; collective."""
    local = (operators.capacity * (operators.nodal(x) - operators.reference)).sum()
    return float(operators.comm.allreduce(float(local)))
