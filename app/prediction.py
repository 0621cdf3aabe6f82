"""Where a load step starts from: the straight line through the states before it.

Contact with friction is homogeneous of degree one: without gaps, loads that grow in proportion from
zero make the state grow with them, so that from the second step on the line is the answer itself.
Where the load turns, or points open or begin to slip, it is only near it or not even that: a
predicted state is taken if it is closer to equilibrium than the state the step comes from.
"""

from __future__ import annotations

import math
from typing import Protocol

from mpi4py import MPI
from petsc4py import PETSc

from app.problem import Problem
from app.solver import Solver


class Predictor(Protocol):
    """Finds a start for a load step."""

    def predict(self, time: float) -> None:
        """Put a better start for the step to a time into the solver, or leave it; collective.

        The problem is at that time, and the solver has the state last committed.
        """

    def commit(self, time: float) -> None:
        """The state of the solver at a time is history."""


class Extrapolation:
    """The straight line through the last two states of a stage."""

    def __init__(self, problem: Problem, solver: Solver) -> None:
        """Begin with nothing known."""
        self._problem, self._solver = problem, solver
        self._trail: list[tuple[float, PETSc.Vec]] = []

    def begin(self, time: float) -> None:
        """A path of loads goes on, or begins where a stage does."""
        if not self._trail or int(self._trail[0][0]) != int(time):
            self._trail = [(time, self._solver.x.copy())]

    def predict(self, time: float) -> None:
        """Follow the line if that comes closer to equilibrium."""
        if len(self._trail) < 2:
            return
        (t0, x0), (t1, x1) = self._trail
        s = (time - t1) / (t1 - t0)
        x = x1.copy()
        x.axpby(-s, 1.0 + s, x0)
        take_better(self._problem, self._solver, x)

    def commit(self, time: float) -> None:
        """Remember the state; of two at one time the later."""
        state = (time, self._solver.x.copy())
        self._trail = [*[p for p in self._trail if p[0] != time][-1:], state]


def take_better(problem: Problem, solver: Solver, x: PETSc.Vec) -> bool:
    """Give the solver a state if it is closer to equilibrium than its own; collective.

    Args:
        problem: At the time of the step.
        solver: Its solver.
        x: The state; its supported components are set.
    """
    if imbalance(problem, solver, x) >= imbalance(problem, solver, solver.x.copy()):
        return False
    x.copy(solver.x)
    return True


def imbalance(problem: Problem, solver: Solver, x: PETSc.Vec) -> float:
    """Norm of the residual of a state [N], once it is what supports say; collective."""
    u, q = solver.parts(x)
    problem.impose(u)
    f = u.duplicate()
    if q is None:
        problem.residual_u(u, q, f)
        return float(f.norm())
    (j,) = problem.jumps
    held = j.held.ravel()
    q.array[held] = j.given.ravel()[held]
    problem.residual_u(u, q, f)
    trial = problem.trial(u, q)
    r = j.residual(trial.equilibrium, trial.jump, trial.law)
    return math.hypot(f.norm(), math.sqrt(problem.comm.allreduce(float((r**2).sum()), MPI.SUM)))
