"""Heat that enters a model and heat that it stores, for its balance."""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np

from app.heat.conduction import Conduction
from app.laws.values import multiplier


def flows(conduction: Conduction, x: Sequence[PETSc.Vec]) -> dict[str, float]:
    """Heat that enters the model per time in a state, by condition [N mm/s]; collective.

    Of the interval last begun: the sum is the rate at which heat is stored in it, to the tolerance
    of the solver.
    """
    here = conduction.at(x)
    found: dict[str, float] = {}
    for h in conduction.loads.heating:
        total = sum(float(nodal.sum()) for nodal in h.nodal.values())
        found[h.name] = multiplier(h.course, conduction.seconds) * total
    for e in conduction.loads.exchange:
        found[e.name] = sum(
            float((nodal * (e.outside - here.T[b])).sum()) for b, nodal in e.per_kelvin.items()
        )
    for cure in conduction.cures:
        for n, heat in zip(cure.nodes, cure.released(here.T), strict=True):
            found[f"cure {n.region}"] = float(heat.sum())
    lacking = [r.copy() for r in here.lacking]
    for j, (flux, _, _) in zip(conduction.jumps, here.flux, strict=True):
        q = j.weight * flux
        for side, sign in ((0, 1.0), (1, -1.0)):
            for b, nodal in enumerate(lacking):
                at = j.bodies[:, side] == b
                np.add.at(nodal, j.dof[at], sign * q[at])
    for s, c in enumerate(conduction.fixed.conditions):
        found[c.name] = sum(
            float(lacking[b][condition == s].sum())
            for b, condition in conduction.fixed.of_body.items()
        )
    sums = conduction.comm.allreduce(np.array(list(found.values())))
    every = dict(zip(found, map(float, sums), strict=True))
    for friction in conduction.frictions:
        every |= friction.flows
    return every


def through(conduction: Conduction, x: Sequence[PETSc.Vec]) -> dict[str, float]:
    """Heat per time from the first side to the second [N mm/s]; collective.

    Of each interface of finite conductance, friction heat left out.
    """
    names = [c.name for c in conduction.scene.thermal_contacts]
    sums = np.zeros(len(names))
    here = conduction.at(x)
    for j, (flux, _, _) in zip(conduction.jumps, here.flux, strict=True):
        sums += np.bincount(j.interface, j.weight * flux, minlength=len(names))
    return dict(zip(names, map(float, conduction.comm.allreduce(sums)), strict=True))


def stored(conduction: Conduction, x: Sequence[PETSc.Vec]) -> float:
    """Heat stored, from an arbitrary but fixed temperature on [N mm]; collective."""
    local = sum(
        float((m * (t - conduction.reference)).sum())
        for m, t in zip(conduction.capacity, conduction.nodal(x), strict=True)
    )
    return float(conduction.comm.allreduce(local))
