"""Warm start from converged states of earlier variations.

Every variation is solved from rest, for friction has a memory; earlier variations only provide
initial guesses. Contact with friction is homogeneous of degree one: where loads and gaps change by
a common factor the scaled state is the exact answer. Otherwise the nearest scaled state is near it,
in the distance of forces, gaps and the logarithm of friction, and the span of the nearest states
holds a nearer one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from app.arrays import Floats
from app.mechanics.predictors import mixture, same, take_better
from app.mechanics.problem import Problem
from app.numerics.newton import Solver

# Runs whose states are kept, multiples of another one left out.
KEPT = 6
# Nearest states that are mixed.
MIXED = 5
# Friction coefficient below which an interface counts as frictionless.
LITTLE = 1e-3


@dataclass(frozen=True)
class Neighbour:
    """A converged state with its loads, gaps and friction, on this rank.

    Attributes:
        x: Unknowns.
        forces: Nodal forces of loads, supports and free strains [N].
        gaps: Initial gaps at the contact points [mm].
        friction: Logarithm of the friction coefficient of each interface, on rank 0 alone.
    """

    x: PETSc.Vec
    forces: Floats
    gaps: Floats
    friction: Floats


class WarmStart:
    """Initial guesses from states of other runs with the same unknowns."""

    def __init__(self, problem: Problem, solver: Solver) -> None:
        self._problem, self._solver = problem, solver
        self._past: list[dict[float, Neighbour]] = []
        self._now: dict[float, Neighbour] = {}
        self._start: PETSc.Vec | None = None
        self._new = False

    def begin(self) -> None:
        """Begin another run."""
        if self._new:
            self._past = [*self._past, self._now][-KEPT:]
        self._now, self._new = {}, False

    def predict(self, time: float) -> None:
        """Start from the nearest state of another run, or a combination of several, if better."""
        self._start = None
        here = self._state()
        sizes = [self._product(p, p) or 1.0 for p in (here.forces, here.gaps)] + [1.0]
        # Runs in other load steps have states at other times.
        known = [
            state
            for states in self._past
            for state in ([states[time]] if time in states else states.values())
        ]
        scaled = [_scaled(state, self._factor(state, here, sizes)) for state in known]
        if not scaled:
            return
        scaled.sort(key=lambda state: self._distance(state, here, sizes))
        nearest, *others = (state.x for state in scaled[:MIXED])
        for x in (nearest, mixture(self._solver, nearest, others) if others else nearest):
            if take_better(self._solver, x):
                self._start = x.copy()

    def commit(self, time: float) -> None:
        """Store the state."""
        state = self._state()
        self._now[time] = state
        self._new = self._new or self._start is None or not same(self._start, state.x)

    def _state(self) -> Neighbour:
        problem = self._problem
        contacts = problem.scene.contacts if problem.comm.rank == 0 else ()
        friction = [math.log(max(c.law.friction, LITTLE)) for c in contacts]
        return Neighbour(
            self._solver.x.copy(),
            problem.f.array.copy(),
            problem.contact.gap.ravel() if problem.contact else np.zeros(0),
            np.array(friction),
        )

    def _factor(self, state: Neighbour, here: Neighbour, sizes: list[float]) -> float:
        """Factor that brings loads and gaps of a state nearest to those here."""

        def product(other: Neighbour) -> float:
            forces = self._product(state.forces, other.forces) / sizes[0]
            return forces + self._product(state.gaps, other.gaps) / sizes[1]

        own, towards = product(state), product(here)
        return towards / own if own > 0 and towards > 0 else 1.0

    def _distance(self, a: Neighbour, b: Neighbour, sizes: list[float]) -> float:
        pairs = ((a.forces, b.forces), (a.gaps, b.gaps), (a.friction, b.friction))
        parts = [self._product(p - q, p - q) / s for (p, q), s in zip(pairs, sizes, strict=True)]
        return float(np.sqrt(sum(parts)))

    def _product(self, a: Floats, b: Floats) -> float:
        return float(self._problem.comm.allreduce(float(a @ b), MPI.SUM))


def _scaled(state: Neighbour, factor: float) -> Neighbour:
    x = state.x.copy()
    x.scale(factor)
    return Neighbour(x, factor * state.forces, factor * state.gaps, state.friction)
