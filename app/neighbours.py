"""Where a solve starts from when others like it have been done: variations of a case.

Every variation goes its own way from rest, for friction remembers; what it takes from others is
where each of its solves starts. Contact with friction is homogeneous of degree one: where loads and
gaps change by a common factor the scaled state is the answer itself. Where friction changes too,
the line through two others leads near it.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from app.prediction import take_better
from app.problem import Problem
from app.solver import Solver

Floats = NDArray[np.float64]

# Runs whose states are kept; one that is a multiple of another is not.
KEPT = 6
# How far beyond two states a third is looked for, in units of their distance.
FARTHEST = 3.0


@dataclass(frozen=True)
class State:
    """A converged state and what it belongs to, on this rank.

    Attributes:
        x: Unknowns.
        forces: Nodal forces of loads, supports and free strains [N].
        gaps: Initial gaps at the contact points [mm].
        friction: Friction coefficient of each interface, on rank 0 alone.
    """

    x: PETSc.Vec
    forces: Floats
    gaps: Floats
    friction: Floats

    def scaled(self, factor: float) -> State:
        """The state of loads and gaps times a factor."""
        x = self.x.copy()
        x.scale(factor)
        return State(x, factor * self.forces, factor * self.gaps, self.friction)


class Neighbours:
    """States of other runs on the same unknowns as starts of this one."""

    def __init__(self, problem: Problem, solver: Solver) -> None:
        """Begin with nothing known."""
        self._problem, self._solver = problem, solver
        self._past: list[dict[float, State]] = []
        self._now: dict[float, State] = {}
        self._start: PETSc.Vec | None = None
        self._new = False

    def begin(self) -> None:
        """Another run begins."""
        if self._new:
            self._past = [*self._past, self._now][-KEPT:]
        self._now, self._new = {}, False

    def predict(self, time: float) -> None:
        """Start from the nearest state of another run, or on the line through the nearest two."""
        self._start = None
        here = self._state()
        size = self._sizes(here)

        def product(a: State, b: State) -> float:
            return self._product(a.forces, b.forces, size[0]) + self._product(
                a.gaps, b.gaps, size[1]
            )

        def apart(a: State, b: State, c: State, d: State) -> float:
            """Product (b - a) . (d - c)."""
            pairs = zip(_parts(a), _parts(b), _parts(c), _parts(d), size, strict=True)
            return sum(self._product(q - p, s - r, unit) for p, q, r, s, unit in pairs)

        known = []
        for states in self._past:
            if (state := states.get(time)) is not None:
                own = product(state, state)
                factor = product(state, here) / own if own > 0 else 1.0
                near = state.scaled(factor) if factor > 0 else state
                known.append((apart(near, here, near, here), near))
        known.sort(key=lambda entry: entry[0])
        if not known:
            return
        distance, nearest = known[0]
        self._try(nearest.x)
        for _, other in known[1:2]:
            length = apart(nearest, other, nearest, other)
            s = apart(nearest, here, nearest, other) / length if length > 0 else 0.0
            if distance > 0 and 0 < abs(s) <= FARTHEST:
                line = nearest.x.copy()
                line.axpby(s, 1.0 - s, other.x)
                self._try(line)

    def commit(self, time: float) -> None:
        """Remember the state."""
        state = self._state()
        self._now[time] = state
        self._new = self._new or self._start is None or not _same(self._start, state.x)

    def _try(self, x: PETSc.Vec) -> None:
        if take_better(self._problem, self._solver, x):
            self._start = x.copy()

    def _state(self) -> State:
        """What the solver has, and what the problem is at."""
        problem = self._problem
        gaps = [j.gap.ravel() for j in problem.jumps]
        friction = [c.friction for c in problem.scene.contacts if problem.comm.rank == 0]
        return State(
            self._solver.x.copy(),
            problem.f.array.copy(),
            np.concatenate([np.zeros(0), *gaps]),
            np.array(friction),
        )

    def _sizes(self, state: State) -> tuple[float, float, float]:
        """Squares that make forces, gaps and friction comparable."""
        forces, gaps, friction = (self._product(p, p, 1.0) or 1.0 for p in _parts(state))
        return forces, gaps, friction

    def _product(self, a: Floats, b: Floats, unit: float) -> float:
        return float(self._problem.comm.allreduce(float(a @ b), MPI.SUM)) / unit


def _parts(state: State) -> tuple[Floats, Floats, Floats]:
    return state.forces, state.gaps, state.friction


def _same(a: PETSc.Vec, b: PETSc.Vec) -> bool:
    """Whether nothing has changed; collective."""
    difference = a.copy()
    difference.axpy(-1.0, b)
    return bool(difference.norm() == 0.0)
