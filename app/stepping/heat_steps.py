"""Time steps of heat through a stage: equal, chosen by their error, or one to a steady state.

Mechanics that heat does not depend on are solved after it; mechanics that it does depend on are
part of each of its solves (`stepping.heated_mechanics`).
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

from app.errors import ConvergenceError
from app.numerics.integrator import Controller
from app.scene.scene import Stage
from app.soundness.failure import attempts
from app.stepping.heat_state import HeatState, HeatStep
from app.stepping.heated_mechanics import SolvedAfterHeat, SolvedWithHeat
from app.stepping.load_steps import LoadStep, Summary, no_checkpoint

# Least time step, as a part of its stage.
SHORTEST = 1e-10

OnHeat = Callable[[LoadStep, HeatStep], None]


@dataclass
class HeatStepper:
    """Time stepping of heat with error control.

    Attributes:
        heating: Its state.
        mechanics: The mechanics beside it, if any.
        on_heat: Called after each committed step, once the mechanics have followed.
        on_trouble: Called with a sentence on the remedy when a step fails.
    """

    saved: ClassVar = ("_under_way", "_begin", "_steps", "_controller", "mechanics")

    heating: HeatState
    mechanics: SolvedAfterHeat | SolvedWithHeat | None
    on_heat: OnHeat
    on_trouble: Callable[[str], None]

    def __post_init__(self) -> None:
        """Set the initial progress: no stage under way."""
        self._under_way = False
        self._begin = 0.0
        self._steps = 0
        self._controller = Controller(self.heating.method)
        self._checkpoint_point = no_checkpoint

    @property
    def total(self) -> Summary:
        """Counts of steps and iterations so far."""
        return self.heating.total

    def run_stage(
        self, k: int, stage: Stage, checkpoint_point: Callable[[], None] = no_checkpoint
    ) -> None:
        """Run a stage that takes time, or find a steady state."""
        self._checkpoint_point = checkpoint_point
        if not self._under_way:
            self._begin, self._steps = self.heating.seconds, 0
        if self.mechanics is not None:
            self.mechanics.begin(k, stage, not self._under_way)
        self._under_way = True
        if stage.steady:
            self._steady(k, stage)
        elif stage.adaptive:
            self._adaptive(k, stage)
        else:
            self._fixed(k, stage)
        self._under_way = False

    def _steady(self, k: int, stage: Stage) -> None:
        if self._steps:
            return
        started = clock.perf_counter()
        accepted = self.heating.solve_steady()
        if accepted is None:
            raise ConvergenceError(
                f"no steady state in stage '{stage.name}': "
                "heat and the fields coupled to it did not converge\n"
                "  what to change: give the stage a duration instead"
            )
        self.heating.warn_if_unstable(stage.name)
        self._finish_step(k, stage, 1.0, accepted, started, True)

    def _fixed(self, k: int, stage: Stage) -> None:
        """Equal steps, whatever their error, divided at events."""
        heating, whole = self.heating, stage.seconds / stage.increments
        if not self._steps:
            heating.start(whole)
        tiny, steps = SHORTEST * stage.seconds, []
        for n in range(stage.increments):
            inside = [e - self._begin - n * whole for e in heating.events]
            ends = [0.0, *(e for e in inside if tiny < e < whole - tiny), whole]
            steps += [(b - a, n + b / whole, b == whole) for a, b in pairwise(ends)]
        for dt, done, at_end in steps[self._steps :]:
            started = clock.perf_counter()
            found = heating.attempt(dt, fixed=True)
            if found is None:
                raise ConvergenceError(self._failure_text(stage, dt))
            accepted = heating.accept(*found, dt)
            self._finish_step(k, stage, done / stage.increments, accepted, started, at_end)

    def _adaptive(self, k: int, stage: Stage) -> None:
        heating, begin = self.heating, self._begin
        whole = stage.seconds / stage.increments
        ends = [begin + (n + 1) * whole for n in range(stage.increments)]
        events = [*ends, *(e for e in heating.events if begin < e < ends[-1])]
        controller = self._controller
        controller.events = sorted(events)
        if not self._steps:
            controller.begin(min(heating.start(whole), whole))
        tiny = SHORTEST * stage.seconds
        while heating.seconds < ends[-1] - tiny:
            started = clock.perf_counter()
            while True:
                dt = controller.propose(heating.seconds)
                found = heating.attempt(dt)
                if found is None:
                    controller.failed(dt)
                elif controller.judge(dt, heating.norm(found[0].error)):
                    break
                heating.total.rejected += 1
                if dt < tiny:
                    raise ConvergenceError(self._failure_text(stage, dt))
            accepted = heating.accept(*found, dt)
            at_end = min(abs(heating.seconds - e) for e in ends) < tiny
            self._finish_step(k, stage, self._done(stage), accepted, started, at_end)

    def _done(self, stage: Stage) -> float:
        return min((self.heating.seconds - self._begin) / stage.seconds, 1.0)

    def _finish_step(
        self,
        k: int,
        stage: Stage,
        part: float,
        accepted: HeatStep,
        started: float,
        whole: bool,
    ) -> None:
        time = k + (1.0 if part > 1 - SHORTEST else part)
        if self.mechanics is not None:
            self.mechanics.follow(time, whole)
        seconds = clock.perf_counter() - started
        step = LoadStep(self.total.steps, stage.name, time, accepted.outcome, 1.0, seconds, whole)
        self.on_heat(step, accepted)
        self._steps += 1
        self._checkpoint_point()

    def _failure_text(self, stage: Stage, dt: float) -> str:
        outcome = self.heating.outcome
        tail = ", ".join(f"{r:.1e}" for r in outcome.residuals[-6:]) or "none"
        advice = (
            "a larger time.tolerance or smaller changes (a slower reaction, weaker coupling)"
            if stage.adaptive
            else "more increments, or adaptive: true"
        )
        return (
            f"no convergence in stage '{stage.name}' at {100 * self._done(stage):.3g} % of it, "
            f"with a time step of {dt:.3g} s\n"
            f"  last residuals (relative to heat or forces): {tail}\n"
            f"  tried: {attempts(outcome.tried)}\n"
            f"  what to change: {advice}"
        )
