"""Predictors: the start of a load step from earlier states, of this run or of other variations.

Contact with friction is homogeneous of degree one. Without gaps, a state thus grows in proportion
to loads that grow from zero. From the second step on, the straight line through the states before
is then exact. If loads and gaps of two variations differ by a common factor, the scaled state is
exact. Otherwise, where the load reverses, or points open or begin to slip, these states are
approximate. A predicted state is used only if its residual is below that of the last state.

Every variation is solved from rest, because friction depends on the load history. Other variations
only provide guesses.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from app.foundation.arrays import Floats
from app.mechanics.problem import Problem
from app.numerics.newton import Solver

# Number of states of the run that are kept before the last one.
KEPT_STATES = 3
# Number of other runs whose states are kept. A run with multiples of the states of another is not.
KEPT_RUNS = 6
# Number of states of a run that are kept: its first ones.
STATES_PER_RUN = 20
# Friction coefficient below which an interface counts as frictionless.
SMALLEST_FRICTION = 1e-3

# Unknowns of a converged state and its inputs, on this rank: nodal forces of loads, supports and
# free strains [N], initial gaps at the contact points [mm], and the logarithm of the friction
# coefficient of each interface (on rank 0 alone).
Inputs = tuple[Floats, Floats, Floats]
StateWithInputs = tuple[PETSc.Vec, Inputs]


class Predictor(Protocol):
    """Finds a start for a load step."""

    def predict(self, time: float) -> None:
        """Set the solver to a better start for the step to a time, if there is one; collective.

        The problem is at that time, the solver at the last committed state.
        """

    def commit(self, time: float) -> None:
        """Store the state of the solver as committed at a time."""


class Extrapolation:
    """Line through the last two states.

    Where loads reverse or a stage begins, the start is on the line through the states two and four
    steps before. They are one and two cycles before if a cycle has two steps. If this is no
    better, the start is the best state in the span of all. It is exact if the loads of two
    stages are proportional: one Newton iteration instead of eight.

    Without extrapolation sliding_block.yaml takes 306 Newton iterations instead of 79,
    debonding.yaml 105 instead of 79, head_cup.yaml 169 instead of 139.
    """

    def __init__(self, solver: Solver, last_reversal: Callable[[float], float]) -> None:
        self._solver, self._last_reversal = solver, last_reversal
        self._past_states: list[tuple[float, PETSc.Vec]] = []

    def begin(self, time: float) -> None:
        """Store the state at which the first path of loads begins."""
        if not self._past_states:
            self._past_states = [(time, self._solver.x.copy())]

    def predict(self, time: float) -> None:
        """Use the line or the state of least residual, if it is closer to equilibrium."""
        if len(self._past_states) < 2:
            return
        (t0, x0), (t1, x1) = self._past_states[-2:]
        if t0 >= self._last_reversal(time) - 1e-9:
            s = (time - t1) / (t1 - t0)
            x = x1.copy()
            x.axpby(-s, 1.0 + s, x0)
        elif len(self._past_states) > KEPT_STATES and use_if_better(
            self._solver, x0 * 2 - self._past_states[-4][1]
        ):
            return
        else:
            x = least_residual_mixture(
                self._solver, x1, [state for _, state in self._past_states[:-1]]
            )
        use_if_better(self._solver, x)

    def commit(self, time: float) -> None:
        """Store the state. It replaces a state of the same time."""
        state = (time, self._solver.x.copy())
        self._past_states = [*[p for p in self._past_states if p[0] != time][-KEPT_STATES:], state]


def least_residual_mixture(
    solver: Solver, x: PETSc.Vec, other_states: Sequence[PETSc.Vec]
) -> PETSc.Vec:
    r"""State of least linearized residual in the span of a state and others; collective.

    With the state x and the others x_i it is x + sum s_i d_i, where d_i = x - x_i, and the s_i are
    those of

    .. math:: |R(x) + \sum_i s_i (R(x + d_i) - R(x))| = \min.
    """
    x = x.copy()
    residual = solver.residual(x)
    steps = [x - state for state in other_states]
    residual_changes = [solver.residual(x + step) - residual for step in steps]
    gram = np.array([[a.dot(b) for b in residual_changes] for a in residual_changes])
    weights, *_ = np.linalg.lstsq(gram, [-a.dot(residual) for a in residual_changes], rcond=1e-12)
    for weight, step in zip(weights, steps, strict=True):
        x.axpy(weight, step)
    return x


def use_if_better(solver: Solver, x: PETSc.Vec) -> bool:
    """Set the solver to x, supports imposed, if its residual is smaller; collective."""
    if not imbalance(solver, x) < imbalance(solver, solver.x.copy()):
        return False  # a residual of NaN is not smaller
    x.copy(solver.x)
    return True


def imbalance(solver: Solver, x: PETSc.Vec) -> float:
    """Impose the supports on a state and return the norm of its residual [N]; collective."""
    return float(solver.residual(x).norm())


def are_equal(a: PETSc.Vec, b: PETSc.Vec) -> bool:
    """Return True if two states are equal; collective."""
    return bool((a - b).norm() == 0.0)


class WarmStart:
    """Initial guesses from states of other runs with the same unknowns.

    The start is the scaled state of another run whose loads, gaps and friction are nearest. Without
    it variations.yaml takes 70 Newton iterations instead of 39, and twice the time of solution.
    """

    def __init__(self, problem: Problem, solver: Solver) -> None:
        self._problem, self._solver = problem, solver
        self._earlier_runs: list[dict[float, StateWithInputs]] = []
        self._states_of_run: dict[float, StateWithInputs] = {}
        self._used_start: PETSc.Vec | None = None
        # Whether a state of this run is no multiple of others.
        self._is_new = False

    def begin(self) -> None:
        """Begin another run."""
        if self._is_new:
            self._earlier_runs = [*self._earlier_runs, self._states_of_run][-KEPT_RUNS:]
        self._states_of_run, self._is_new = {}, False

    def predict(self, time: float) -> None:
        """Start from the nearest state of another run, if better."""
        self._used_start = None
        inputs = self._state()[1]
        forces, gaps, _ = self._inner_products(inputs, inputs)
        square_norms = np.array([forces or 1.0, gaps or 1.0, 1.0])
        # Runs in other load steps have states at other times.
        candidates = [
            state
            for states in self._earlier_runs
            for state in ([states[time]] if time in states else states.values())
        ]
        scaled = [self._scaled(state, inputs, square_norms) for state in candidates]
        if not scaled:
            return
        nearest = min(scaled, key=lambda state: self._distance(state[1], inputs, square_norms))[0]
        if use_if_better(self._solver, nearest):
            self._used_start = nearest.copy()

    def commit(self, time: float) -> None:
        """Store the state."""
        if len(self._states_of_run) >= STATES_PER_RUN:  # a walk has thousands
            return
        state = self._states_of_run[time] = self._state()
        self._is_new = (
            self._is_new or self._used_start is None or not are_equal(self._used_start, state[0])
        )

    def _state(self) -> StateWithInputs:
        problem = self._problem
        interfaces = problem.scene.parting_interfaces if problem.comm.rank == 0 else ()
        friction = np.log([max(c.law.largest_friction, SMALLEST_FRICTION) for c in interfaces])
        gaps = problem.contact.gaps.initial_gap.ravel() if problem.contact else np.zeros(0)
        return self._solver.x.copy(), (problem.f.array.copy(), gaps, friction)

    def _scaled(
        self, state: StateWithInputs, target: Inputs, square_norms: Floats
    ) -> StateWithInputs:
        """State scaled so that its loads and gaps are nearest to the current ones."""
        x, inputs = state
        square, product = (
            float((self._inner_products(inputs, vector) / square_norms)[:2].sum())
            for vector in (inputs, target)
        )
        factor = product / square if square > 0 and product > 0 else 1.0
        forces, gaps, friction = inputs
        return x * factor, (factor * forces, factor * gaps, friction)

    def _distance(self, a: Inputs, b: Inputs, square_norms: Floats) -> float:
        differences = [p - q for p, q in zip(a, b, strict=True)]
        return float(np.sqrt((self._inner_products(differences, differences) / square_norms).sum()))

    def _inner_products(self, a: Sequence[Floats], b: Sequence[Floats]) -> Floats:
        """Products of the inputs of two states, one by one; collective."""
        local = np.array([float(p @ q) for p, q in zip(a, b, strict=True)])
        return np.asarray(self._problem.comm.allreduce(local, MPI.SUM))
