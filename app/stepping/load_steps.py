"""Load steps along a path, with cut-backs where a step does not converge.

A step is committed only when it has converged. If all remedies of the solver fail it is halved;
after an easy step it grows again, up to the increments of the stage.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import ClassVar

from petsc4py import PETSc

from app.foundation.errors import ConvergenceError
from app.foundation.verdict import Verdict
from app.mechanics.contact import TrialState
from app.mechanics.predictors import Extrapolation, Predictor, are_equal
from app.mechanics.problem import Problem
from app.numerics.newton import NewtonResult, Solver
from app.numerics.remedies import solve
from app.scene.scene import Stage
from app.soundness.cover import Cover
from app.soundness.failure import explanation_of_failure, is_proportional, place_in_stage
from app.soundness.floating_bodies_of_state import (
    error_of_body_held_by_facets,
    error_of_expelled_body,
    error_of_runaway,
)
from app.stepping.advance import Progress, Step, advance
from app.stepping.energy_control import (
    HALVINGS,
    EnergyControl,
    dissipated_energy,
    start_beyond_onset,
)

# Largest number of Newton iterations of an easy step, after which the next one is longer.
EASY_ITERATIONS = 8
# Length of the next step over that of an easy one.
STEP_GROWTH = 2.0
# Largest number of new pairings of surfaces with finite sliding in a step; mostly none or one.
MAX_PAIRINGS = 10


@dataclass(frozen=True)
class LoadStep:
    """A committed step of the mechanics or of the heat.

    Attributes:
        number: 1 for the first.
        stage: Name of its stage.
        time: Time at its end: stage k runs from k to k + 1.
        outcome: Outcome of the nonlinear solve.
        wall_seconds: Wall time, failed attempts included [s].
        ends_increment: True if it ends an increment of its stage, for which fields are written.
    """

    number: int
    stage: str
    time: float
    outcome: NewtonResult
    wall_seconds: float
    ends_increment: bool


@dataclass
class Effort:
    """Counts of a run so far.

    Attributes:
        steps: Committed steps.
        newton_iterations: Newton iterations, failed attempts included.
        linear_iterations: Iterations of the linear solver, failed attempts included.
        rejected: Attempts that were not committed.
        augmentation: `NewtonResult.augmentation` of the last step; in a sum, the smallest one.
    """

    steps: int = 0
    newton_iterations: int = 0
    linear_iterations: int = 0
    rejected: int = 0
    augmentation: float = 1.0

    def add(self, other: Effort) -> None:
        """Add the counts of another part."""
        self.steps += other.steps
        self.newton_iterations += other.newton_iterations
        self.linear_iterations += other.linear_iterations
        self.rejected += other.rejected
        self.augmentation = min(self.augmentation, other.augmentation)

    def count(self, outcome: NewtonResult) -> None:
        """Add the iterations of a solve."""
        self.newton_iterations += outcome.iterations
        self.linear_iterations += outcome.linear_iterations


OnStep = Callable[[LoadStep, TrialState | None], None]


@dataclass
class LoadProgress(Progress):
    """Progress along a path of loads.

    Attributes:
        energy: Fracture energy of the next step [N mm]; 0 if its loads are given.
        reached: Largest fraction of the path so far; `done` falls where loads fall.
        handed_over_at: Fraction of the path at which steps of given loads last took over because no
            step of given energy converged; None if they never did.
    """

    energy: float = 0.0
    reached: float = 0.0
    handed_over_at: float | None = None


@dataclass
class LoadStepper:
    """Load stepping: predict, solve, halve on failure, commit.

    Attributes:
        problem: The mechanical problem.
        solver: Solver of the problem.
        on_step: Called after each committed step.
        on_trouble: Called with a sentence on the remedy when a step fails.
        predictors: Predictors in addition to extrapolation.
        total: Counts of steps and iterations so far.
    """

    saved: ClassVar = ("progress", "total")

    problem: Problem
    solver: Solver
    on_step: OnStep
    on_trouble: Callable[[str], None]
    predictors: tuple[Predictor, ...] = ()
    total: Effort = field(default_factory=Effort)

    def __post_init__(self) -> None:
        """Put extrapolation before the other predictors."""
        self._extrapolation = Extrapolation(self.solver, self.problem.scene.last_reversal)
        self.predictors = (self._extrapolation, *self.predictors)
        self.progress, self._cover = LoadProgress(), Cover(self.problem)
        self.problem.keep()

    def restored(self) -> None:
        """Keep the restored state as the last committed one."""
        self.problem.keep()

    def solve(self) -> NewtonResult:
        """Solve until points with finite sliding are paired with the facets that they touch."""
        problem, (u, q) = self.problem, self.solver.u_and_q()
        if problem.sliding_bodies:
            problem.sliding_bodies.approach(problem.f, u, q)
        outcome = solve(self.solver)
        self.total.count(outcome)
        for _ in range(MAX_PAIRINGS):
            if not (outcome.converged and problem.update_pairs(*self.solver.u_and_q())):
                return outcome
            repeated = solve(self.solver)
            self.total.count(repeated)
            total_iterations = outcome.iterations + repeated.iterations
            outcome = replace(repeated, iterations=total_iterations)
        return replace(outcome, converged=False)

    def run_stage(self, k: int, stage: Stage, checkpoint_point: Callable[[], None]) -> None:
        """Take load steps through a stage without time, except its creep."""
        end = k + stage.loaded
        increment = 1.0 / (stage.increments * stage.load_segments)
        increment /= self.problem.scene.rotation_substeps(k, increment)
        if not self.progress.step:
            self.progress = LoadProgress(increment)

        def set_load(fraction: float) -> None:
            self.problem.set_time(k + fraction * stage.loaded)

        self.run_path(stage, increment, set_load, k, end, self.progress, checkpoint_point)
        self.progress = LoadProgress()

    def run_path(
        self,
        stage: Stage,
        increment: float,
        set_load: Callable[[float], None],
        begin: float,
        end: float,
        progress: LoadProgress | None = None,
        checkpoint_point: Callable[[], None] = lambda: None,
    ) -> None:
        """Follow a path of loads, temperatures and supports.

        Args:
            stage: The stage, which limits cut-backs.
            increment: Largest step, as a fraction of the path.
            set_load: Sets the problem to a fraction of the path, 0 to 1.
            begin: Time at the start of the path.
            end: Time at its end.
            progress: Progress so far; kept up to date.
            checkpoint_point: Called after each step.

        Raises:
            ConvergenceError: A failed step cannot or may not be cut, or a body runs away.
        """
        progress = progress or LoadProgress(increment)
        path = LoadPath(stage, increment, set_load, begin, end)
        self._extrapolation.begin(path.time(progress.done))
        load_steps = LoadSteps(self, path, progress)
        energy_steps = EnergySteps(self, path, progress, load_steps.start)
        while progress.done < 1.0:
            advance(load_steps, load_steps, checkpoint_point)
            if progress.energy:
                energy_steps.begin(load_steps.start, load_steps.energy_start)
                advance(energy_steps, energy_steps, checkpoint_point)

    def commit(
        self, stage: Stage, time: float, outcome: NewtonResult, started: float, ends_increment: bool
    ) -> None:
        """Commit the state of the solver and report the step; collective.

        Args:
            stage: Stage of the step.
            time: Time at its end.
            outcome: Outcome of its solve.
            started: Wall time at which it began [s].
            ends_increment: True if it ends an increment of the stage.

        Raises:
            ConvergenceError: A body runs away, is pushed out or tips.
        """
        problem = self.problem
        u, q = self.solver.u_and_q()
        trial = problem.trial(u, q) if q is not None else None
        location = place_in_stage(stage.name, (time - int(time)) or 1.0)
        if trial is not None:
            verdict = (
                error_of_body_held_by_facets(problem, trial)
                or error_of_runaway(problem, trial)
                or error_of_expelled_body(problem, trial)
                or self._cover.pressed_beyond_rim(trial)
            )
            if verdict:
                raise ConvergenceError(replace(verdict, where=location))
        problem.update_displacements(u, q)
        problem.commit(trial)
        problem.keep()
        for predictor in self.predictors:
            predictor.commit(time)
        self.total.steps += 1
        self.total.augmentation = outcome.augmentation
        wall_seconds = clock.perf_counter() - started
        step = LoadStep(self.total.steps, stage.name, time, outcome, wall_seconds, ends_increment)
        self.on_step(step, trial)
        tipped = self._cover.tipped()
        if tipped:
            raise ConvergenceError(replace(tipped, where=location))


@dataclass(frozen=True)
class LoadPath:
    """A path of loads; attributes as arguments of `LoadStepper.run_path`."""

    stage: Stage
    increment: float
    set_load: Callable[[float], None]
    begin: float
    end: float

    def time(self, fraction: float) -> float:
        """Return the time at a fraction of the path."""
        return self.begin + fraction * (self.end - self.begin)


class LoadSteps:
    """Steps of given loads, and their control: halved on failure, longer after an easy one.

    Attributes:
        start: State at the beginning of the step.
        energy_start: Fraction of the path at a state beyond the onset of damage, from which steps
            of given energy begin; None if there is no such state.
    """

    def __init__(self, stepper: LoadStepper, path: LoadPath, progress: LoadProgress) -> None:
        self._stepper, self._path, self.progress = stepper, path, progress
        self._problem, self._solver = stepper.problem, stepper.solver
        self.energy_start: float | None = None
        self.start = self._solver.x.copy()
        self._uses_predictors = True
        self._is_predicted = False
        self._halved_lengths: list[float] = []
        self._outcome: NewtonResult

    # Control

    @property
    def finished(self) -> bool:
        """Return True if the path is done, or steps of given energy take over."""
        return self.progress.done >= 1.0 or self.progress.energy > 0.0

    def propose(self) -> Step:
        """Return the next step."""
        return self.progress.next(self._path.increment)

    def judge(self, step: Step, error: float) -> bool:
        """Accept a solved step; lengthen the next one if it took few iterations."""
        if math.isinf(error):
            return False
        progress, increment = self.progress, self._path.increment
        progress.done = step.end
        if error <= EASY_ITERATIONS and progress.step < increment:
            progress.step = min(STEP_GROWTH * progress.step, increment)
            progress.cuts = max(progress.cuts - 1, 0)
        return True

    # Steps

    def try_step(self, step: Step) -> float:
        """Predict and solve a step; return the number of Newton iterations; collective."""
        problem, solver, stage = self._problem, self._solver, self._path.stage
        if not self._halved_lengths and self._uses_predictors:
            solver.x.copy(self.start)
        self._path.set_load(step.end)
        problem.update_stiffness()
        if problem.sliding_bodies:
            problem.sliding_bodies.set_committed(*solver.u_and_q())
        predictors = self._stepper.predictors if self._uses_predictors else ()
        for predictor in predictors:
            predictor.predict(self._path.time(step.end))
        self._is_predicted = bool(predictors) and not are_equal(self.start, solver.x)
        self._outcome = self._stepper.solve()
        if not self._outcome.converged:
            return math.inf
        largest_energy = stage.fracture_step
        if (
            largest_energy is not None
            and dissipated_energy(problem, *solver.u_and_q())[0] > largest_energy
        ):
            return math.inf
        return float(self._outcome.iterations)

    def refuse(self, step: Step) -> None:
        """Choose the next attempt: by energy if an interface breaks, without prediction, or halved.

        Raises:
            ConvergenceError: The step cannot or may not be halved.
        """
        problem, solver, progress = self._problem, self._solver, self.progress
        stage, set_load = self._path.stage, self._path.set_load
        self._stepper.total.rejected += 1
        self.start.copy(solver.x)
        if stage.fracture_step is not None and self._continues_by_energy(stage.fracture_step, step):
            return
        self._uses_predictors = False
        # From rest and without gaps, smaller steps fail in the same way.
        fails_alike = not self.start.norm() and is_proportional(solver, set_load, step.end)
        explanation = explanation_of_failure(problem, solver, self._outcome, fails_alike)
        if self._is_predicted:
            self._stepper.on_trouble(f"{explanation.cause.what}; repeating without extrapolation")
            return
        allowed_cuts = stage.max_cut_backs
        if explanation.has_floating_body:  # halving hardly helps: it is tried once
            allowed_cuts = min(1, allowed_cuts)
        if fails_alike or not stage.adaptive or progress.cuts >= allowed_cuts:
            time = self._path.time(step.end) - int(self._path.begin)
            raise explanation.error(stage.name, time, self._halved_lengths)
        progress.cuts += 1
        progress.step = step.length / 2
        self._halved_lengths.append(progress.step)
        remedy_text = f"step halved to {progress.step:.4g} of stage '{stage.name}'"
        self._stepper.on_trouble(f"{explanation.cause.what}; {remedy_text}")

    def _continues_by_energy(self, energy: float, step: Step) -> bool:
        """Return True if an interface breaks in a step: steps of given energy [N mm] take over."""
        problem, solver, set_load = self._problem, self._solver, self._path.set_load
        solver.augmentation = 1.0  # a smaller step may not need the larger augmentation
        ends = step.begin, step.end
        self.energy_start = start_beyond_onset(problem, solver, energy, ends, set_load)
        if self.energy_start is None:
            self.start.copy(solver.x)
            return False
        self.progress.energy = energy
        self._begin_next_step()
        return True

    def commit(self, step: Step, started: float) -> None:
        """Commit the step last tried; collective."""
        path = self._path
        self._begin_next_step()
        time = path.time(step.end)
        self._stepper.commit(path.stage, time, self._outcome, started, step.ends_increment)

    def _begin_next_step(self) -> None:
        self._uses_predictors = True
        self._halved_lengths = []


class EnergySteps:
    """Steps of given fracture energy, and their control: halved on failure, doubled after each one.

    Steps of given loads take over after an increment in one step, or if nothing more breaks.
    """

    def __init__(
        self, stepper: LoadStepper, path: LoadPath, progress: LoadProgress, start: PETSc.Vec
    ) -> None:
        self._stepper, self._path, self.progress = stepper, path, progress
        self._solver = stepper.solver
        self._largest_energy = path.stage.fracture_step or 0.0
        self._control: EnergyControl | None = None
        self.begin(start, None)

    def begin(self, start: PETSc.Vec, energy_start: float | None) -> None:
        """Begin at a committed state, or at a state of the solver beyond the onset of damage."""
        self._start, self._energy_start = start, energy_start

    # Control

    @property
    def finished(self) -> bool:
        """Return True if the path is done, or steps of given loads take over."""
        return self.progress.energy == 0.0 or self.progress.done >= 1.0

    def propose(self) -> Step:
        """Return the next step: its length is its energy [N mm], its end unknown."""
        progress = self.progress
        return Step(progress.done, progress.done, progress.energy, ends_increment=False)

    def judge(self, step: Step, error: float) -> bool:
        """Accept a step that was solved before the end of the path."""
        return not math.isinf(error) and self._reached < 1.0

    # Steps

    def try_step(self, step: Step) -> float:
        """Solve a step; collective."""
        progress = self.progress
        if self._control is None:
            arguments = self._stepper.problem, self._solver, self._path.set_load
            self._control = EnergyControl(*arguments)
        start = progress.done if self._energy_start is None else self._energy_start
        self._outcome, self._reached = self._control.solve(step.length, start)
        self._stepper.total.count(self._outcome)
        return 0.0 if self._outcome.converged else math.inf

    def refuse(self, step: Step) -> None:
        """Halve the energy, or continue with steps of given loads; collective.

        Raises:
            ConvergenceError: Steps of given loads have already failed at this fraction of the path.
        """
        progress, stage = self.progress, self._path.stage
        self._start.copy(self._solver.x)
        self._energy_start = None
        if self._outcome.converged:  # beyond the end of the path
            progress.energy, progress.step = 0.0, 1.0 - progress.done
            return
        self._stepper.total.rejected += 1
        progress.energy = step.length / 2
        if progress.energy > self._largest_energy / 2**HALVINGS:
            return
        if progress.handed_over_at != progress.done:
            progress.energy, progress.step = 0.0, self._path.increment
            progress.handed_over_at = progress.done
            return
        message = (
            f"no state dissipates {progress.energy:.3g} N mm more at the interfaces; the load has "
            f"reached {100 * max(progress.reached, progress.done):.3g} % of the stage"
        )
        location = place_in_stage(stage.name, progress.done)
        remedy = (
            "use a shorter `fracture_step` or a finer mesh; if the interface is broken, reduce the "
            "load"
        )
        raise ConvergenceError(Verdict(message, location, remedy))

    def commit(self, step: Step, started: float) -> None:
        """Commit the step last tried; collective."""
        progress, increment, reached = self.progress, self._path.increment, self._reached
        spans_increment = reached - progress.done >= increment
        ends_increment = math.floor(reached / increment) > math.floor(progress.done / increment)
        progress.done = reached
        progress.reached = max(progress.reached, reached)
        if spans_increment:
            progress.energy, progress.step = 0.0, increment
        else:
            progress.energy = min(2 * step.length, self._largest_energy)
        self.begin(self._solver.x.copy(), None)
        time = self._path.time(reached)
        self._stepper.commit(self._path.stage, time, self._outcome, started, ends_increment)
