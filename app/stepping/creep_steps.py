"""Creep in a stage under constant loads, in steps of cycles or seconds with error control.

Creep is a free strain, so the stiffness stays elastic. A step iterates until the stress that creep
relaxes, its forces and the displacements agree. Each step is solved whole and in two halves. The
difference is the error of the step. The committed relaxation is twice that of the halves less that
of the whole step, which is of second order (Richardson).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

from mpi4py import MPI

import numpy as np

from app.foundation.arrays import Floats
from app.numerics.newton import NewtonResult
from app.numerics.remedies import solve
from app.scene.scene import Stage
from app.soundness.failure import explanation_of_failure
from app.stepping.advance import Growth, Step, advance
from app.stepping.load_steps import LoadStepper

# Largest number of solves of a step. Mostly three suffice. Anderson's acceleration saves 8 % of
# them (measured).
MAX_SOLVES = 40
# Strains have settled if they change by less than this fraction of the tolerance of a step.
SETTLED = 0.02
# Fraction by which the last step may exceed the chosen length.
LENGTHENING = 0.001
# Factors from the length of a step to that of the next, by the error.
GROWTH = Growth(safety=0.8, smallest=0.2, largest=10.0, after_failure=0.2)


class _FailedError(Exception):
    """A solve has not converged, or creep and displacements do not agree."""


@dataclass
class CreepStepper:
    """Steps of creep after the load steps of a stage.

    Attributes:
        load_stepper: Applies the loads of a stage, then commits steps of creep.
        done: Completed creep of the stage [cycles or s].
        length: Length of the next step, 0 before the first.
    """

    saved: ClassVar = ("done", "length")

    load_stepper: LoadStepper

    def __post_init__(self) -> None:
        """Set the state before the first stage."""
        self.done = self.length = 0.0
        self._problem, self._solver = self.load_stepper.problem, self.load_stepper.solver
        stress_history, creep = self._problem.stress_history, self._problem.creep
        assert stress_history is not None and creep is not None
        self._stress_history, self._creep = stress_history, creep
        self._results: list[NewtonResult] = []

    def run_stage(self, k: int, stage: Stage, checkpoint_point: Callable[[], None]) -> None:
        """Apply the loads, then take creep steps; they are equal if the stage is not adaptive.

        Raises:
            ConvergenceError: A step fails even if it is short.
        """
        if not self.length:
            self.load_stepper.run_stage(k, stage, checkpoint_point)
            # At constant stress the first step would be exact for any length.
            first_length = self._creep.first_step(self._stress(), 10 * stage.creep_tolerance)
            self.length = first_length if stage.adaptive else stage.creep / stage.increments
        steps = CreepSteps(self, k, stage)
        advance(steps, steps, checkpoint_point)
        self.done = self.length = 0.0

    def fraction(self, stage: Stage) -> float:
        """Completed fraction of the stage [-].

        Loads are applied up to the fraction `Stage.loaded`. Creep has the rest, on a logarithmic
        scale.
        """
        if self.done >= stage.creep:
            return 1.0
        crept = math.log1p(self.done) / math.log1p(stage.creep)
        return stage.loaded + (1 - stage.loaded) * crept

    def outcome(self) -> NewtonResult:
        """Outcome of the last solve, with the iterations of all solves of the step."""
        newton = sum(o.iterations for o in self._results)
        krylov = sum(o.linear_iterations for o in self._results)
        return replace(self._results[-1], iterations=newton, linear_iterations=krylov)

    def _stress(self) -> Floats:
        """Stress of the current displacements without creep in the step (n, 6) [MPa]."""
        return self._stress_history.trial(self._problem.displacements())

    def _largest_creep_strain(self, relaxed_stress: Floats) -> float:
        """Largest creep strain, from the stress that it relaxes (n, 6) [MPa]; collective."""
        largest = float(self._creep.equivalent_strain(relaxed_stress).max(initial=0.0))
        return float(self._problem.comm.allreduce(largest, MPI.MAX))

    def step(self, stage: Stage, h: float) -> float:
        """Solve a step without commit; return its error over the tolerance; collective.

        If the error is too large, the state is reset to the state before the step.

        Raises:
            _FailedError: The step was not solved. The state is reset, too.
        """
        self._results = []
        x = self._solver.x.copy()
        state = self._stress_history.state()
        contact = self._problem.contact
        contact_state = contact.state if contact else None
        scale = stage.creep_tolerance * self._creep.elastic_strain(self._stress())

        def return_to_start() -> None:
            self._stress_history.return_to(state)
            if contact and contact_state:
                contact.state, contact.gaps.committed_jump = contact_state, contact_state.jump

        solved = False
        try:
            whole_step = self._iterate(h, scale)
            x.copy(self._solver.x)
            self._problem.update_displacements(*self._solver.u_and_q())
            half_steps = np.zeros_like(whole_step)
            for _ in range(2):
                half_steps += self._iterate(h / 2, scale)
                u, q = self._solver.u_and_q()
                self._problem.commit(self._problem.trial(u, q) if q is not None else None)
            error = self._largest_creep_strain(half_steps - whole_step) / scale
            if error <= 1.0 or not stage.adaptive:
                return_to_start()
                self._solve(2 * half_steps - whole_step, h)
                solved = True
        finally:
            if not solved:
                return_to_start()
                x.copy(self._solver.x)
                self._problem.update_displacements(*self._solver.u_and_q())
        return error

    def _iterate(self, h: float, scale: float) -> Floats:
        """Solve a step from the committed state; return the stress that creep relaxes; collective.

        Raises:
            _FailedError: `_solve` failed, or strains have not settled, relative to a scale.
        """
        relaxed_stress = self._creep.stress_relaxation(self._stress(), h)
        for _ in range(MAX_SOLVES):
            self._solve(relaxed_stress, h)
            previous, relaxed_stress = (
                relaxed_stress,
                self._creep.stress_relaxation(self._stress(), h),
            )
            if self._largest_creep_strain(relaxed_stress - previous) <= SETTLED * scale:
                return relaxed_stress
        raise _FailedError

    def _solve(self, relaxed_stress: Floats, h: float) -> None:
        """Solve for a stress that creep relaxes in a step (n, 6) [MPa]; collective.

        Raises:
            _FailedError: Newton's method has not converged.
        """
        self._stress_history.relax(relaxed_stress, h)
        self._problem.update_stiffness()
        self._results.append(solve(self._solver))
        self.load_stepper.total.count(self._results[-1])
        if not self._results[-1].converged:
            raise _FailedError
        self._problem.update_displacements(*self._solver.u_and_q())


class CreepSteps:
    """Creep steps through a stage, and their control by the error."""

    def __init__(self, stepper: CreepStepper, k: int, stage: Stage) -> None:
        self._stepper, self._k, self._stage = stepper, k, stage
        self._failures = 0

    # Control

    @property
    def finished(self) -> bool:
        """Return True if the stage is done."""
        return self._stepper.done >= self._stage.creep

    def propose(self) -> Step:
        """Return the next step."""
        done, end = self._stepper.done, self._stage.creep
        remaining = end - done
        if self._stepper.length > (1 - LENGTHENING) * remaining:
            return Step(done, end, remaining, ends_increment=True)
        return Step(done, done + self._stepper.length, self._stepper.length, ends_increment=False)

    def judge(self, step: Step, error: float) -> bool:
        """Accept a step within its tolerance; of equal steps, every one that was solved."""
        if self._stage.adaptive:
            self._stepper.length = step.length * GROWTH.factor(error)
        is_accepted = error <= 1.0 if self._stage.adaptive else not math.isinf(error)
        if is_accepted:
            self._stepper.done = step.end
        return is_accepted

    # Steps

    def try_step(self, step: Step) -> float:
        """Solve a step; return its error over the tolerance; collective."""
        try:
            error = self._stepper.step(self._stage, step.length)
        except _FailedError:
            self._failures += 1
            return math.inf
        self._failures = 0
        return error

    def refuse(self, step: Step) -> None:
        """Count a step that was too long.

        Raises:
            ConvergenceError: Too many steps in a row were not solved.
        """
        stepper, stage = self._stepper, self._stage
        if self._failures > stage.max_cut_backs or (self._failures and not stage.adaptive):
            problem, solver = stepper.load_stepper.problem, stepper.load_stepper.solver
            explanation = explanation_of_failure(problem, solver, stepper.outcome())
            raise explanation.error(stage.name, stepper.fraction(stage), [])
        stepper.load_stepper.total.rejected += 1

    def commit(self, step: Step, started: float) -> None:
        """Commit the step last tried; collective."""
        stepper, stage = self._stepper, self._stage
        time = self._k + stepper.fraction(stage)
        stepper.load_stepper.problem.set_time(time)
        outcome = stepper.outcome()
        stepper.load_stepper.commit(stage, time, outcome, started, step.ends_increment)
