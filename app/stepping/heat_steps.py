"""Time steps of heat through a stage: equal, chosen by their error, or one to a steady state.

Mechanics that heat does not depend on are solved after it; mechanics that it does depend on are
part of each of its solves (`stepping.heated_mechanics`).
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Iterator
from itertools import pairwise

from app.foundation.errors import ConvergenceError
from app.numerics.integrator import Controller
from app.scene.scene import Stage
from app.soundness.failure import attempts
from app.stepping.heat_state import HeatState, HeatStep
from app.stepping.heated_mechanics import SolvedAfterHeat, SolvedWithHeat
from app.stepping.load_steps import LoadStep, Summary

# Least time step, as a part of its stage.
SHORTEST = 1e-10

Mechanics = SolvedAfterHeat | SolvedWithHeat
OnHeat = Callable[[LoadStep, HeatStep], None]
# Committed steps, the part of the stage that is done then, and whether an increment ends.
Steps = Iterator[tuple[HeatStep, float, bool]]


class HeatStepper:
    """Time stepping of heat with error control.

    Args:
        mechanics: The mechanics beside it, if any.
        on_heat: Called after each committed step, once the mechanics have followed.
    """

    saved = ("_under_way", "_begin", "_steps", "_controller", "mechanics")

    def __init__(self, heating: HeatState, mechanics: Mechanics | None, on_heat: OnHeat) -> None:
        self.heating, self.mechanics, self._on_heat = heating, mechanics, on_heat
        self._under_way, self._begin, self._steps = False, 0.0, 0
        self._controller = Controller(heating.method)

    @property
    def total(self) -> Summary:
        """Counts of steps and iterations so far."""
        return self.heating.total

    def run_stage(self, k: int, stage: Stage, checkpoint_point: Callable[[], None]) -> None:
        """Run a stage that takes time, or find a steady state."""
        if not self._under_way:
            self._begin, self._steps = self.heating.seconds, 0
        if self.mechanics is not None:
            self.mechanics.begin(k, stage, not self._under_way)
        self._under_way = True
        if stage.steady:
            steps = self._steady(stage)
        elif stage.adaptive:
            steps = self._adaptive(stage)
        else:
            steps = self._fixed(stage)
        started = clock.perf_counter()
        for accepted, part, whole in steps:
            time = k + (1.0 if part > 1 - SHORTEST else part)
            if self.mechanics is not None:
                self.mechanics.follow(time, whole)
            outcome, seconds = accepted.outcome, clock.perf_counter() - started
            step = LoadStep(self.total.steps, stage.name, time, outcome, seconds, whole)
            self._on_heat(step, accepted)
            self._steps += 1
            checkpoint_point()
            started = clock.perf_counter()
        self._under_way = False

    def _steady(self, stage: Stage) -> Steps:
        """The steady state, unless it has been reached."""
        if self._steps:
            return
        accepted = self.heating.solve_steady()
        if accepted is None:
            raise ConvergenceError(
                f"no steady state in stage '{stage.name}': "
                "heat and the fields coupled to it did not converge\n"
                "  what to change: give the stage a duration instead"
            )
        yield accepted, 1.0, True

    def _fixed(self, stage: Stage) -> Steps:
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
            found = heating.attempt(dt, fixed=True)
            if found is None:
                raise ConvergenceError(self._failure_text(stage, dt))
            yield heating.accept(*found, dt), done / stage.increments, at_end

    def _adaptive(self, stage: Stage) -> Steps:
        heating, begin, controller = self.heating, self._begin, self._controller
        whole = stage.seconds / stage.increments
        ends = [begin + (n + 1) * whole for n in range(stage.increments)]
        controller.events = sorted([*ends, *(e for e in heating.events if begin < e < ends[-1])])
        if not self._steps:
            controller.begin(min(heating.start(whole), whole))
        tiny = SHORTEST * stage.seconds
        while heating.seconds < ends[-1] - tiny:
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
            yield accepted, self._done(stage), at_end

    def _done(self, stage: Stage) -> float:
        return min((self.heating.seconds - self._begin) / stage.seconds, 1.0)

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
