"""Time steps of heat through a stage: equal, chosen by their error, or one to a steady state.

If heat depends on the mechanics, each solve contains both. Else the mechanics are solved after the
heat (`stepping.heated_mechanics`).
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable
from itertools import pairwise

from app.foundation.errors import ConvergenceError
from app.numerics.integrator import Controller
from app.scene.scene import Stage
from app.soundness.failure import attempts, place_in_stage
from app.stepping.advance import Control, FixedSteps, Step, advance
from app.stepping.heat_state import HeatState, HeatStep
from app.stepping.heated_mechanics import SolvedAfterHeat, SolvedWithHeat
from app.stepping.load_steps import Effort, LoadStep

# Shortest time step, as a fraction of its stage.
SHORTEST_STEP = 1e-10

Mechanics = SolvedAfterHeat | SolvedWithHeat
OnHeat = Callable[[LoadStep, HeatStep], None]


class HeatStepper:
    """Time stepping of heat with error control.

    Args:
        mechanics: Mechanics that are solved with or after the heat, if any.
        on_heat: Called after each committed step, once the mechanics have followed.
    """

    saved = ("under_way", "stage_start", "steps_done", "controller", "mechanics")

    def __init__(self, heating: HeatState, mechanics: Mechanics | None, on_heat: OnHeat) -> None:
        self.heating, self.mechanics, self._on_heat = heating, mechanics, on_heat
        self.under_way, self.stage_start, self.steps_done = False, 0.0, 0
        self.controller = Controller(heating.method)

    @property
    def total(self) -> Effort:
        """Counts of steps and iterations so far."""
        return self.heating.total

    def run_stage(self, k: int, stage: Stage, checkpoint_point: Callable[[], None]) -> None:
        """Run a stage that takes time, or solve for its steady state."""
        if not self.under_way:
            self.stage_start, self.steps_done = self.heating.seconds, 0
        if self.mechanics is not None:
            self.mechanics.begin(k, stage, not self.under_way)
        self.under_way = True
        self._k, self._stage = k, stage
        advance(self, self._control_of(stage), checkpoint_point)
        self.under_way = False

    def _control_of(self, stage: Stage) -> Control:
        """Control of the steps of a stage: one to a steady state, by their error, or equal."""
        if stage.steady:
            return FixedSteps([Step(0.0, 1.0, math.inf, ends_increment=True)], self.steps_done)
        first_step = 0.0
        if not self.steps_done:
            first_step = self.heating.start(stage.seconds / stage.increments)
        if stage.adaptive:
            return StepsByError(self.heating, self.controller, stage, self.stage_start, first_step)
        return FixedSteps(self._equal(stage), self.steps_done)

    def _equal(self, stage: Stage) -> list[Step]:
        """Equal steps of a stage, divided at events."""
        length = stage.seconds / stage.increments
        tiny = SHORTEST_STEP * stage.seconds
        steps: list[Step] = []
        for n in range(stage.increments):
            inside = [e - self.stage_start - n * length for e in self.heating.events]
            step_ends = [0.0, *(e for e in inside if tiny < e < length - tiny), length]
            for a, b in pairwise(step_ends):
                begin = (n + a / length) / stage.increments
                end = (n + b / length) / stage.increments
                steps.append(Step(begin, end, b - a, ends_increment=b == length))
        return steps

    # Steps

    def try_step(self, step: Step) -> float:
        """Solve a time step or for a steady state; return its error; collective."""
        if self._stage.steady:
            self._steady_step = self.heating.solve_steady()
            return math.inf if self._steady_step is None else 0.0
        self._solution = self.heating.attempt(step.length, fixed=not self._stage.adaptive)
        if self._solution is None:
            return math.inf
        return self.heating.norm(self._solution[0].error)

    def refuse(self, step: Step) -> None:
        """Count a step that was not accepted.

        Raises:
            ConvergenceError: The step may not be shorter.
        """
        stage = self._stage
        if stage.steady:
            raise ConvergenceError(
                f"no steady state in stage '{stage.name}': "
                "heat and the fields coupled to it did not converge\n"
                "  what to do: give the stage a duration instead of steady"
            )
        self.total.rejected += 1
        if not stage.adaptive or step.length < SHORTEST_STEP * stage.seconds:
            raise ConvergenceError(self._failure_text(step))

    def commit(self, step: Step, started: float) -> None:
        """Commit the step last tried, then let the mechanics follow; collective."""
        if self._stage.steady:
            accepted_step = self._steady_step
        elif self._solution is not None:
            accepted_step = self.heating.accept(*self._solution, step.length)
        assert accepted_step is not None
        time = self._k + (1.0 if step.end > 1 - SHORTEST_STEP else step.end)
        if self.mechanics is not None:
            self.mechanics.after_heat_step(time, step.ends_increment)
        outcome, wall_seconds = accepted_step.outcome, clock.perf_counter() - started
        load_step = LoadStep(
            self.total.steps, self._stage.name, time, outcome, wall_seconds, step.ends_increment
        )
        self._on_heat(load_step, accepted_step)
        self.steps_done += 1

    def _failure_text(self, step: Step) -> str:
        outcome, stage = self.heating.outcome, self._stage
        tail = ", ".join(f"{r:.1e}" for r in outcome.residuals[-6:]) or "none"
        advice = (
            "use a larger time.tolerance or smaller changes (a slower reaction, weaker coupling)"
            if stage.adaptive
            else "use more increments, or adaptive: true"
        )
        return (
            f"no convergence in {place_in_stage(stage.name, step.begin)}, "
            f"with a time step of {step.length:.3g} s\n"
            f"  last residuals (relative to heat or forces): {tail}\n"
            f"  tried: {attempts(outcome.tried)}\n"
            f"  what to do: {advice}"
        )


class StepsByError:
    """Time steps of a stage whose error stays below the tolerance; they end at events.

    Args:
        heating: The heat.
        controller: Controller of the lengths, which is saved.
        begin: Time at which the stage begins [s].
        first: First step to try [s]; 0 if the stage continues after a restart.
    """

    def __init__(
        self, heating: HeatState, controller: Controller, stage: Stage, begin: float, first: float
    ) -> None:
        self._heating, self._controller = heating, controller
        self._stage, self._begin = stage, begin
        self._tiny = SHORTEST_STEP * stage.seconds
        increment = stage.seconds / stage.increments
        self._ends = [begin + (n + 1) * increment for n in range(stage.increments)]
        inside = [e for e in heating.events if begin < e < self._ends[-1]]
        controller.events = sorted([*self._ends, *inside])
        if first:
            controller.begin(min(first, increment))

    @property
    def finished(self) -> bool:
        """Return True if the stage is done."""
        return not self._heating.seconds < self._ends[-1] - self._tiny

    def propose(self) -> Step:
        """Return the next step: its ends as fractions of the stage, its length in seconds."""
        seconds = self._heating.seconds
        length = self._controller.propose(seconds)
        end = seconds + length
        ends_increment = min(abs(end - e) for e in self._ends) < self._tiny
        begin_fraction = min((seconds - self._begin) / self._stage.seconds, 1.0)
        end_fraction = min((end - self._begin) / self._stage.seconds, 1.0)
        return Step(begin_fraction, end_fraction, length, ends_increment)

    def judge(self, step: Step, error: float) -> bool:
        """Accept a step within its tolerance."""
        if math.isinf(error):
            self._controller.failed(step.length)
            return False
        return self._controller.judge(step.length, error)
