"""Predictors: the start of a load step from the states before it.

Contact with friction is homogeneous of degree one: without gaps, loads that grow in proportion from
zero make the state grow with them, so that from the second step on the straight line through the
states before is the exact answer. Where the load turns, or points open or begin to slip, it is near
the answer at best: a predicted state is used only if its residual is below that of the last state.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

from petsc4py import PETSc

import numpy as np

from app.numerics.newton import Solver

# Earlier states that are kept.
KEPT = 3


class Predictor(Protocol):
    """Finds a start for a load step."""

    def predict(self, time: float) -> None:
        """Set the solver to a better start for the step to a time, if there is one; collective.

        The problem is at that time, the solver at the last committed state.
        """

    def commit(self, time: float) -> None:
        """Store the state of the solver as committed at a time."""


class Extrapolation:
    """Line through the last two states; all states at the start of a stage, where loads turn."""

    def __init__(self, solver: Solver) -> None:
        self._solver = solver
        self._trail: list[tuple[float, PETSc.Vec]] = []

    def begin(self, time: float) -> None:
        """Store the state at which the first path of loads begins."""
        if not self._trail:
            self._trail = [(time, self._solver.x.copy())]

    def predict(self, time: float) -> None:
        """Use the line or the state of least residual, if it is closer to equilibrium."""
        if len(self._trail) < 2:
            return
        stage_begins = math.ceil(time) - 1
        if self._trail[-2][0] >= stage_begins:
            x = self._line(time)
        else:
            *before, last = (state for _, state in self._trail)
            x = mixture(self._solver, last, before)
        take_better(self._solver, x)

    def _line(self, time: float) -> PETSc.Vec:
        (t0, x0), (t1, x1) = self._trail[-2:]
        s = (time - t1) / (t1 - t0)
        x = x1.copy()
        x.axpby(-s, 1.0 + s, x0)
        return x

    def commit(self, time: float) -> None:
        """Store the state; of two at one time, the later."""
        state = (time, self._solver.x.copy())
        self._trail = [*[p for p in self._trail if p[0] != time][-KEPT:], state]


def mixture(solver: Solver, x: PETSc.Vec, others: Sequence[PETSc.Vec]) -> PETSc.Vec:
    r"""State of least linearized residual in the span of a state and others; collective.

    With x the state and d_i the differences of the others from it, it is x + sum s_i d_i with the
    s_i of

    .. math:: |R(x) + \sum_i s_i (R(x + d_i) - R(x))| = \min.
    """
    x = x.copy()
    here = solver.residual(x)
    steps, changes = [], []
    for state in others:
        step = x.copy()
        step.axpy(-1.0, state)
        there = x.copy()
        there.axpy(1.0, step)
        change = solver.residual(there)
        change.axpy(-1.0, here)
        steps.append(step)
        changes.append(change)
    gram = np.array([[a.dot(b) for b in changes] for a in changes])
    shares, *_ = np.linalg.lstsq(gram, [-a.dot(here) for a in changes], rcond=1e-12)
    for share, step in zip(shares, steps, strict=True):
        x.axpy(share, step)
    return x


def take_better(solver: Solver, x: PETSc.Vec) -> bool:
    """Set the solver to x, supports imposed, if its residual is smaller; collective."""
    if not imbalance(solver, x) < imbalance(solver, solver.x.copy()):
        return False  # nor is a state that is no number
    x.copy(solver.x)
    return True


def imbalance(solver: Solver, x: PETSc.Vec) -> float:
    """Impose the supports on a state and return the norm of its residual [N]; collective."""
    return float(solver.residual(x).norm())


def same(a: PETSc.Vec, b: PETSc.Vec) -> bool:
    """Whether two states are equal; collective."""
    difference = a.copy()
    difference.axpy(-1.0, b)
    return bool(difference.norm() == 0.0)
