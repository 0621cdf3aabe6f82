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
from app.mechanics.predictors import Extrapolation, Predictor, same
from app.mechanics.problem import Problem
from app.numerics.newton import NewtonResult, Solver
from app.numerics.remedies import solve
from app.scene.scene import Stage
from app.soundness.cover import Cover
from app.soundness.failure import explain, proportional
from app.soundness.loose_bodies import held_by_facets, runaway
from app.stepping.energy_control import HALVINGS, by_energy, overshoot, spent

EASY_ITERATIONS = 8
GROWTH = 2.0
# Times that points which slide far are paired anew in a step; mostly none or one is enough.
PAIRINGS = 10


@dataclass(frozen=True)
class LoadStep:
    """A committed step of the mechanics or of the heat.

    Attributes:
        number: 1 for the first.
        stage: Name of its stage.
        time: Time at its end: stage k runs from k to k + 1.
        outcome: Outcome of the nonlinear solve.
        seconds: Wall time, failed attempts included.
        whole: Whether it ends an increment of its stage, for which fields are written.
    """

    number: int
    stage: str
    time: float
    outcome: NewtonResult
    seconds: float
    whole: bool


@dataclass
class Summary:
    """Counts of steps and iterations of a loading so far."""

    steps: int = 0
    newton_iterations: int = 0
    linear_iterations: int = 0
    rejected: int = 0
    augmentation: float = 1.0

    def add(self, other: Summary) -> None:
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
class Progress:
    """Progress along a path of loads.

    Attributes:
        step: Next step, as a part of the path; 0 if no path has been begun.
        done: Completed part of the path.
        energy: Fracture energy of the next step where the load follows it, 0 where it is given.
        most: Largest part of the path that has been reached.
        handed: Part of the path at which no step of given energy was found, last.
        cuts: Number of halvings of the step minus that of its increases since.
    """

    step: float = 0.0
    done: float = 0.0
    cuts: int = 0
    energy: float = 0.0
    most: float = 0.0
    handed: float = -1.0

    def goal(self, whole: float) -> float:
        """End of the current increment, which a shortened step does not exceed."""
        goal = (math.floor(self.done / whole + 1e-9) + 1) * whole
        return 1.0 if goal > 1.0 - 1e-9 else goal

    def reach(self, goal: float) -> float:
        """End of the next step: the goal if hardly anything would be left before it."""
        return goal if self.done + 1.001 * self.step > goal else self.done + self.step

    def may_halve(self, stage: Stage, free: bool) -> bool:
        """Whether to try half of a failed step; once only if a body is free, as it hardly helps."""
        most = min(1, stage.max_cut_backs) if free else stage.max_cut_backs
        return stage.adaptive and self.cuts < most

    def halve(self, reach: float) -> None:
        """Try half of a failed step."""
        self.cuts += 1
        self.step = (reach - self.done) / 2

    def advance(self, reach: float, whole: float, easy: bool) -> None:
        """Complete a step, and lengthen the next one if it was easy."""
        self.done = reach
        if easy and self.step < whole:
            self.step, self.cuts = min(GROWTH * self.step, whole), max(self.cuts - 1, 0)


@dataclass
class LoadStepper:
    """Load stepping: predict, solve, halve on failure, commit.

    Attributes:
        problem: The mechanical problem.
        solver: Its solver.
        on_step: Called after each committed step.
        on_trouble: Called with a sentence on the remedy when a step fails.
        predictors: Predictors besides extrapolation.
        total: Counts of steps and iterations so far.
    """

    saved: ClassVar = ("_progress", "total")

    problem: Problem
    solver: Solver
    on_step: OnStep
    on_trouble: Callable[[str], None]
    predictors: tuple[Predictor, ...] = ()
    total: Summary = field(default_factory=Summary)

    def __post_init__(self) -> None:
        """Put extrapolation before the other predictors."""
        self._line = Extrapolation(self.solver, self.problem.scene.last_turn)
        self.predictors = (self._line, *self.predictors)
        self._progress, self._cover = Progress(), Cover(self.problem)

    def _solve(self) -> NewtonResult:
        """Solve, until points that slide far are paired with the surface that they touch."""
        problem, (u, q) = self.problem, self.solver.u_and_q()
        if problem.contact:
            problem.contact.approach(problem.f, u, q)
        outcome = solve(self.solver)
        self.total.count(outcome)
        for _ in range(PAIRINGS):
            if not (outcome.converged and problem.pair(*self.solver.u_and_q())):
                return outcome
            again = solve(self.solver)
            self.total.count(again)
            both = outcome.iterations + again.iterations
            outcome = replace(again, iterations=both)
        return replace(outcome, converged=False)

    def run_stage(self, k: int, stage: Stage, checkpoint_point: Callable[[], None]) -> None:
        """Take load steps through a stage that takes no time, up to its creep."""
        whole, end = 1.0 / (stage.increments * stage.ways), k + stage.loaded
        whole /= self.problem.scene.turns(k, whole)
        if not self._progress.step:
            self._progress = Progress(whole)

        def set_load(s: float) -> None:
            self.problem.set_time(k + s * stage.loaded)

        self.run_path(stage, whole, set_load, k, end, self._progress, checkpoint_point)
        self._progress = Progress()

    def run_path(
        self,
        stage: Stage,
        whole: float,
        set_load: Callable[[float], None],
        begin: float,
        end: float,
        progress: Progress | None = None,
        checkpoint_point: Callable[[], None] = lambda: None,
    ) -> None:
        """Follow a path of loads, temperatures and supports.

        Args:
            stage: The stage, which limits cut-backs.
            whole: Largest step, as a part of the path.
            set_load: Sets the problem to a point of the path, 0 to 1.
            begin: Time at the start of the path.
            end: Time at its end.
            progress: Progress so far; kept up to date.
            checkpoint_point: Called after each step.

        Raises:
            ConvergenceError: A failed step cannot or may not be cut, or a body runs away.
        """
        problem, solver, progress = self.problem, self.solver, progress or Progress(whole)
        self._line.begin(begin)
        while progress.done < 1.0:
            started, goal = clock.perf_counter(), progress.goal(whole)
            start, predictors = solver.x.copy(), self.predictors
            halved: list[float] = []
            begun: float | None = None
            while not progress.energy:
                reach = progress.reach(goal)
                time = begin + reach * (end - begin)
                set_load(reach)
                problem.update_stiffness()
                if problem.sliding:
                    problem.sliding.carry(*solver.u_and_q())
                for p in predictors:
                    p.predict(time)
                predicted = predictors and not same(start, solver.x)
                outcome = self._solve()
                most = stage.fracture_step
                if outcome.converged and (most is None or spent(problem, solver)[0] <= most):
                    break
                self.total.rejected += 1
                start.copy(solver.x)
                if most is not None:
                    solver.augmentation = 1.0  # what that step needed is not for smaller ones
                    path = progress.done, reach
                    begun = overshoot(problem, solver, most, path, set_load)
                    if begun is not None:
                        progress.energy = most
                        continue
                    start.copy(solver.x)
                predictors = ()
                # From rest, without gaps, smaller steps fail alike.
                scales = not start.norm() and proportional(solver, set_load, reach)
                why = explain(problem, solver, outcome, scales)
                if predicted:
                    self.on_trouble(f"{why.cause.what}; repeating without extrapolation")
                    continue
                if scales or not progress.may_halve(stage, why.free):
                    raise why.error(stage.name, time - int(begin), halved)
                progress.halve(reach)
                halved.append(progress.step)
                how = f"step halved to {progress.step:.4g} of stage '{stage.name}'"
                self.on_trouble(f"{why.cause.what}; {how}")
            if progress.energy:
                self._by_energy(stage, whole, set_load, (begin, end), progress, (start, begun))
                checkpoint_point()
                continue
            self.commit(stage, time, outcome, started, reach == goal)
            progress.advance(reach, whole, outcome.iterations <= EASY_ITERATIONS)
            checkpoint_point()

    def _by_energy(
        self,
        stage: Stage,
        whole: float,
        set_load: Callable[[float], None],
        times: tuple[float, float],
        progress: Progress,
        first: tuple[PETSc.Vec, float | None],
    ) -> None:
        """Take a step of given fracture energy from a state, and the part of the path of a guess.

        It hands back to load steps where it is a long one, or where nothing more can break.
        """
        problem, solver, started = self.problem, self.solver, clock.perf_counter()
        (start, begun), energy, most = first, progress.energy, stage.fracture_step or 0.0
        while energy > most / 2**HALVINGS:
            at = progress.done if begun is None else begun
            outcome, reach = by_energy(problem, solver, energy, at, set_load)
            self.total.count(outcome)
            if outcome.converged:
                break
            start.copy(solver.x)
            self.total.rejected += 1
            energy, begun = energy / 2, None
        else:
            if progress.handed != progress.done:
                progress.energy, progress.step, progress.handed = 0.0, whole, progress.done
                return
            text = (
                f"no state was found in which interfaces have used up {energy:.3g} N mm more; the "
                f"load has reached {100 * max(progress.most, progress.done):.3g} % of the stage"
            )
            where = f"stage '{stage.name}' at {100 * progress.done:.3g} % of it"
            cure = "a shorter `fracture_step`, a finer mesh, or a smaller load, if what holds is "
            raise ConvergenceError(Verdict(text, where, f"{cure}broken"))
        longer = reach - progress.done >= whole
        if reach >= 1.0:
            start.copy(solver.x)
            progress.energy, progress.step = 0.0, 1.0 - progress.done
            return
        passed = math.floor(reach / whole) > math.floor(progress.done / whole)
        progress.done, progress.most = reach, max(progress.most, reach)
        progress.energy = 0.0 if longer else min(2 * energy, most)
        if longer:
            progress.step = whole
        self.commit(stage, times[0] + reach * (times[1] - times[0]), outcome, started, passed)

    def commit(
        self, stage: Stage, time: float, outcome: NewtonResult, started: float, whole: bool
    ) -> None:
        """Commit the state of the solver and report the step; collective.

        The step ends at ``time``, and an increment if ``whole``; it ``started`` at a wall time.

        Raises:
            ConvergenceError: A body runs away or tips.
        """
        problem = self.problem
        u, q = self.solver.u_and_q()
        trial = problem.trial(u, q) if q is not None else None
        part = 100 * (time - int(time)) or 100
        where = f"stage '{stage.name}' at {part:.3g} % of it"
        if trial is not None:
            found = (
                held_by_facets(problem, trial) or runaway(problem, trial) or self._cover.left(trial)
            )
            if found:
                raise ConvergenceError(replace(found, where=where))
        problem.update_displacements(u, q)
        problem.commit(trial)
        for p in self.predictors:
            p.commit(time)
        self.total.steps += 1
        self.total.augmentation = outcome.augmentation
        seconds = clock.perf_counter() - started
        step = LoadStep(self.total.steps, stage.name, time, outcome, seconds, whole)
        self.on_step(step, trial)
        tipped = self._cover.tipped()
        if tipped:
            raise ConvergenceError(replace(tipped, where=where))
