r"""Where a solve starts from when others like it have been done: variations of a case.

Every variation goes its own way from rest, for friction remembers; what it takes from others is
where each of its solves starts. Contact with friction is homogeneous of degree one: where loads and
gaps change by a common factor the scaled state is the answer itself. Where anything else changes
the states around it lead near it, by ordinary kriging: weights w of sum one that solve

.. math:: K w + m 1 = k, \qquad 1^T w = 1,

K the covariances of the known states and k theirs with the one looked for, of Matérn 3/2 in the
distance of forces, gaps and the logarithm of friction (of the smooth and the rough covariances,
lines and parabolas tried it came closest to equilibrium, or nearly, beyond the known states too).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from mantle.arrays import Floats
from mantle.mechanics.prediction import same, take_better
from mantle.mechanics.problem import Problem
from mantle.numerics.newton import Solver

# Runs whose states are kept; one that is a multiple of another is not.
KEPT = 6
# Correlation length over the largest distance of states.
LENGTH = 2.0
# Friction below which there is as good as none.
LITTLE = 1e-3


@dataclass(frozen=True)
class Neighbour:
    """A converged state and what it belongs to, on this rank.

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


class Neighbours:
    """States of other runs on the same unknowns as starts of this one."""

    def __init__(self, problem: Problem, solver: Solver) -> None:
        """Begin with nothing known."""
        self._problem, self._solver = problem, solver
        self._past: list[dict[float, Neighbour]] = []
        self._now: dict[float, Neighbour] = {}
        self._start: PETSc.Vec | None = None
        self._new = False
        self._last = 0.0

    def begin(self) -> None:
        """Another run begins."""
        if self._new:
            self._past = [*self._past, self._now][-KEPT:]
        self._now, self._new, self._last = {}, False, 0.0

    def predict(self, time: float) -> None:
        """Start from the nearest state of another run, or from what all of them lead to."""
        self._start = None
        here = self._state()
        sizes = [self._product(p, p) or 1.0 for p in (here.forces, here.gaps)] + [1.0]
        runs = [states for states in self._past if time in states]
        if not runs:
            return
        factors = [self._factor(states[time], here, sizes) for states in runs]
        known = [
            _scaled(states[time], factor) for states, factor in zip(runs, factors, strict=True)
        ]
        all_ = [*known, here]
        apart = np.array([[self._distance(a, b, sizes) for b in all_] for a in all_])
        nearest = int(np.argmin(apart[-1, :-1]))
        self._try(known[nearest].x)
        if apart[-1, nearest] == 0:
            return
        weights = kriging(apart[:-1, :-1], apart[-1, :-1])
        x = self._solver.vector()
        for weight, state in zip(weights, known, strict=True):
            x.axpy(weight, state.x)
        self._try(x)
        # The step before shows how far off they are.
        if self._last in self._now and all(self._last in states for states in runs):
            x.axpy(1.0, self._now[self._last].x)
            for weight, factor, states in zip(weights, factors, runs, strict=True):
                x.axpy(-weight * factor, states[self._last].x)
            self._try(x)

    def commit(self, time: float) -> None:
        """Remember the state."""
        state = self._state()
        self._now[time], self._last = state, time
        self._new = self._new or self._start is None or not same(self._start, state.x)

    def _try(self, x: PETSc.Vec) -> None:
        if take_better(self._solver, x):
            self._start = x.copy()

    def _state(self) -> Neighbour:
        """Current solution, with the loads, gaps and friction that it belongs to."""
        problem = self._problem
        gaps = [j.gap.ravel() for j in problem.jumps]
        contacts = problem.scene.contacts if problem.comm.rank == 0 else ()
        friction = [math.log(max(c.law.friction, LITTLE)) for c in contacts]
        return Neighbour(
            self._solver.x.copy(),
            problem.f.array.copy(),
            np.concatenate([np.zeros(0), *gaps]),
            np.array(friction),
        )

    def _factor(self, state: Neighbour, here: Neighbour, sizes: list[float]) -> float:
        """By what loads and gaps of a state come nearest to those here."""

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


def kriging(apart: Floats, away: Floats) -> Floats:
    """Weights (n,) of sum one of known states for one that is looked for.

    Args:
        apart: Distances between the known (n, n).
        away: Their distances from the one looked for (n,).
    """
    length = LENGTH * max(apart.max(), away.max())

    def covariance(distance: Floats) -> Floats:
        r = np.sqrt(3) * distance / length
        return np.asarray((1 + r) * np.exp(-r))

    n = len(away)
    matrix = np.ones((n + 1, n + 1))
    matrix[n, n] = 0
    matrix[:n, :n] = covariance(apart)
    right = np.append(covariance(away), 1.0)
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=1e-12)[0][:n])


def _scaled(state: Neighbour, factor: float) -> Neighbour:
    """The state of loads and gaps times a factor."""
    x = state.x.copy()
    x.scale(factor)
    return Neighbour(x, factor * state.forces, factor * state.gaps, state.friction)
