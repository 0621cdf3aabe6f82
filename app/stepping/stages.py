"""Through the stages of a scene: load steps where a stage takes no time, else time steps.

Heat walks in steps of its own. Mechanics that heat does not depend on follow it: they are solved at
the ends of the increments of a stage and whenever a temperature has moved far enough, along the
straight line between two states of the heat. Mechanics that it does depend on are part of every
one of its stages.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import ClassVar, Protocol

import numpy as np

from app.arrays import Floats, Ints
from app.errors import ConvergenceError
from app.numerics.integrator import Controller
from app.scene.scene import SceneStage
from app.soundness.failure import attempts
from app.stepping.coupled_system import CoupledSystem
from app.stepping.heat_steps import HeatState, HeatStep
from app.stepping.load_steps import LoadStep, LoadStepper, Mark, Summary, unmarked

# A time step below this part of its stage is given up.
SHORTEST = 1e-10

OnHeat = Callable[[LoadStep, HeatStep], None]


class MechanicsBesideHeat(Protocol):
    """The mechanics beside the heat."""

    def begin(self, k: int, stage: SceneStage, anew: bool) -> None:
        """Begin a stage that takes time, or go on within it after a restart."""

    def after(self, time: float, whole: bool) -> None:
        """A heat step is history that ends at a time, and perhaps ends an increment."""


def run_stages(
    stages: Sequence[SceneStage],
    motion: tuple[LoadStepper, ...],
    march: tuple[HeatStepper, ...],
    begin: Callable[[SceneStage], None] = lambda stage: None,
    mark: Callable[[int], None] = lambda k: None,
    first: int = 0,
) -> None:
    """Take a model through its stages.

    Args:
        stages: Parts of the loading.
        motion: Its mechanics, at rest at time 0, if it has any.
        march: Its heat, if it has any.
        begin: Called before each stage.
        mark: Called with the number of the stage wherever a run may be taken up again.
        first: The stage to begin with: where motion and march have been taken up.

    Raises:
        ConvergenceError: A step cannot be made smaller or may not be, or a body runs away.
    """
    for k, stage in enumerate(stages[first:], first):
        begin(stage)
        for m in motion:
            m.problem.set_stage(k, m.solver.u_and_q()[0])
        if stage.duration > 0 or stage.steady:
            for h in march:
                h.go(k, stage, partial(mark, k))
        else:
            for m in motion:
                m.load(k, stage, partial(mark, k))


@dataclass
class HeatStepper:
    """The heat of a scene on its way through time.

    Attributes:
        heating: Its state.
        companions: The mechanics beside it, if there are any.
        on_heat: Called after each step, once it is history and the mechanics have followed.
        on_trouble: Told in plain words what is tried when a step fails.
    """

    saved: ClassVar = ("_under_way", "_begin", "_steps", "_controller", "companions")

    heating: HeatState
    companions: tuple[MechanicsBesideHeat, ...]
    on_heat: OnHeat
    on_trouble: Callable[[str], None]

    def __post_init__(self) -> None:
        """Nothing is under way."""
        self._under_way = False
        self._begin = 0.0
        self._steps = 0
        self._controller = Controller(self.heating.method)
        self._mark: Mark = unmarked

    @property
    def total(self) -> Summary:
        """Counts of steps and iterations so far."""
        return self.heating.total

    def go(self, k: int, stage: SceneStage, mark: Mark = unmarked) -> None:
        """Through a stage that takes time, or to a steady state."""
        self._mark = mark
        if not self._under_way:
            self._begin, self._steps = self.heating.seconds, 0
        for c in self.companions:
            c.begin(k, stage, not self._under_way)
        self._under_way = True
        if stage.steady:
            self._rest(k, stage)
        elif stage.adaptive:
            self._adaptive(k, stage)
        else:
            self._fixed(k, stage)
        self._under_way = False

    def _rest(self, k: int, stage: SceneStage) -> None:
        if self._steps:
            return
        started = clock.perf_counter()
        accepted = self.heating.rest()
        if accepted is None:
            raise ConvergenceError(
                f"no steady state in stage '{stage.name}': "
                "heat and the fields coupled to it did not converge\n"
                "  what to change: give the stage a duration instead"
            )
        self.heating.examine(stage.name)
        self._finish_step(k, stage, 1.0, accepted, started, True)

    def _fixed(self, k: int, stage: SceneStage) -> None:
        """Equal steps, whatever their error."""
        if not self._steps:
            self.heating.start(stage.duration / stage.increments)
        for dt, part, at_end in self._equal(stage)[self._steps :]:
            started = clock.perf_counter()
            found = self.heating.attempt(dt, fixed=True)
            if found is None:
                done = (self.heating.seconds - self._begin) / stage.duration
                raise ConvergenceError(self._text(stage, done, dt))
            accepted = self.heating.accept(*found, dt)
            self._finish_step(k, stage, part, accepted, started, at_end)

    def _equal(self, stage: SceneStage) -> list[tuple[float, float, bool]]:
        """Steps as long as increments, divided at events.

        Returns:
            Length [s] of each, where it ends as a part of the stage, and whether an increment does.
        """
        whole = stage.duration / stage.increments
        tiny = SHORTEST * stage.duration
        found = []
        for n in range(stage.increments):
            inside = [e - self._begin - n * whole for e in self.heating.events]
            ends = [0.0, *(e for e in inside if tiny < e < whole - tiny), whole]
            found += [
                (b - a, (n + b / whole) / stage.increments, b == whole) for a, b in pairwise(ends)
            ]
        return found

    def _adaptive(self, k: int, stage: SceneStage) -> None:
        """Steps chosen by their error."""
        heating, begin = self.heating, self._begin
        whole = stage.duration / stage.increments
        ends = [begin + (n + 1) * whole for n in range(stage.increments)]
        events = [*ends, *(e for e in heating.events if begin < e < ends[-1])]
        controller = self._controller
        controller.events = sorted(events)
        if not self._steps:
            controller.begin(min(heating.start(whole), whole))
        tiny = SHORTEST * stage.duration
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
                    part = (heating.seconds - begin) / stage.duration
                    raise ConvergenceError(self._text(stage, part, dt))
            accepted = heating.accept(*found, dt)
            at_end = min(abs(heating.seconds - e) for e in ends) < tiny
            part = (heating.seconds - begin) / stage.duration
            self._finish_step(k, stage, min(part, 1.0), accepted, started, at_end)

    def _finish_step(
        self,
        k: int,
        stage: SceneStage,
        part: float,
        accepted: HeatStep,
        started: float,
        whole: bool,
    ) -> None:
        """Solve the mechanics that follow the heat, and report the step."""
        time = k + (1.0 if part > 1 - SHORTEST else part)
        for c in self.companions:
            c.after(time, whole)
        seconds = clock.perf_counter() - started
        step = LoadStep(self.total.steps, stage.name, time, accepted.outcome, 1.0, seconds, whole)
        self.on_heat(step, accepted)
        self._steps += 1
        self._mark()

    def _text(self, stage: SceneStage, part: float, dt: float) -> str:
        """Why a time step failed."""
        tail = ", ".join(f"{r:.1e}" for r in self.heating.outcome.residuals[-6:]) or "none"
        advice = (
            "a larger time.tolerance or smaller changes (a slower reaction, weaker coupling)"
            if stage.adaptive
            else "more increments, or adaptive: true"
        )
        return (
            f"no convergence in stage '{stage.name}' at {100 * part:.3g} % of it, "
            f"with a time step of {dt:.3g} s\n"
            f"  last residuals (relative to heat or forces): {tail}\n"
            f"  tried: {attempts(self.heating.outcome.tried)}\n"
            f"  what to change: {advice}"
        )


class SolvedAfterHeat:
    """Mechanics that heat does not depend on: solved after it."""

    saved = ("_before", "_time")

    def __init__(self, motion: LoadStepper, heating: HeatState, limit: float) -> None:
        """Let the mechanics follow.

        Args:
            motion: The mechanics.
            heating: The heat.
            limit: Change of temperature, or of cure as the temperature it releases, after which
                they are solved again [K].
        """
        self._motion, self._heating, self._limit = motion, heating, limit
        self._time = 0.0
        self._before = heating.warmth()
        heating.loading.interpolate(motion.problem, self._before, self._before, 1.0)

    @property
    def row_keys(self) -> Ints:
        """Keys of nodes, ghosts too."""
        return self._heating.loading.row_keys

    def restored(self) -> None:
        """Tell the mechanics what they were solved with; collective."""
        self._heating.loading.restore(self._motion.problem, self._before)

    def begin(self, k: int, stage: SceneStage, anew: bool) -> None:
        """Remember where the mechanics stand."""
        self._stage = stage
        if anew:
            self._time, self._before = float(k), self._heating.warmth()

    def after(self, time: float, whole: bool) -> None:
        """Follow if it is time to."""
        heating, problem = self._heating, self._motion.problem
        before, now = self._before, heating.warmth()
        if not whole and heating.loading.distance(before, now) < self._limit:
            return
        begin = self._time

        def place(s: float) -> None:
            problem.set_time(begin + s * (time - begin))
            heating.loading.interpolate(problem, before, now, s)

        longest = heating.loading.followed(before, now)
        self._motion.advance(self._stage, longest, place, begin, time)
        self._before, self._time = now, time


class SolvedWithHeat:
    """Mechanics that heat depends on: in one system with it."""

    saved = ("_start", "_committed")

    def __init__(self, motion: LoadStepper, heating: HeatState, system: CoupledSystem) -> None:
        """Put the mechanics beside the heat.

        Args:
            motion: The mechanics.
            heating: The heat, whose solver solves both.
            system: Solves both.
        """
        self._motion, self._heating, self._exchange = motion, heating, system.exchange
        heating.beside, heating.system = (self,), system
        self._start = self._committed = heating.seconds
        self._before = heating.warmth()
        heating.loading.interpolate(motion.problem, self._before, self._before, 1.0)

    def restored(self) -> None:
        """Tell the mechanics what they were solved with; collective."""
        self._before = self._heating.warmth()
        self._heating.loading.restore(self._motion.problem, self._before)

    def begin(self, k: int, stage: SceneStage, anew: bool) -> None:
        """Begin where the mechanics stand."""
        self._k, self._stage = k, stage
        if anew:
            self._start = self._committed = self._heating.seconds
        self._restore()

    def _restore(self) -> None:
        """Give the committed state of the mechanics to the common solver."""
        named = self._heating.solver.blocks_by_name()
        for name, vector in self._motion.solver.blocks_by_name().items():
            if named[name] is not vector:
                vector.copy(named[name])

    def none(self) -> Floats:
        """No work of friction."""
        return np.zeros_like(self._exchange.work)

    def given(self) -> Floats:
        """Work of friction per area since the step began."""
        return self._exchange.work

    def place(self, seconds: float, h: float, given: Floats) -> None:
        """Set the mechanics to the time of a stage, and friction to its length."""
        part = (
            min((seconds - self._start) / self._stage.duration, 1.0)
            if not self._stage.steady
            else 1.0
        )
        self._motion.problem.set_time(self._k + part)
        self._exchange.start(h, given)
        if not self._heating.outcome.converged:
            self._restore()

    def after(self, time: float, whole: bool) -> None:
        """The mechanics of an accepted step become history."""
        started = clock.perf_counter()
        named = self._heating.solver.blocks_by_name()
        for name, vector in self._motion.solver.blocks_by_name().items():
            if named[name] is not vector:
                named[name].copy(vector)
        self._exchange.report((self._heating.seconds - self._committed) or np.inf)
        self._committed = self._heating.seconds
        if not self._heating.sets:
            self._motion.commit(self._stage, time, self._heating.outcome, started, whole)
            return
        # Within the step stiffness and free strain were those before it: an error of first order.
        before, now = self._before, self._heating.warmth()
        self._before = now

        def place(s: float) -> None:
            self._heating.loading.interpolate(self._motion.problem, before, now, s)

        longest = self._heating.loading.followed(before, now)
        self._motion.advance(self._stage, longest, place, time, time)
