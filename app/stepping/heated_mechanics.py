"""Mechanics beside heat: solved after it, or in one system with it."""

from __future__ import annotations

import time as clock

import numpy as np

from app.arrays import Ints
from app.scene.scene import Stage
from app.stepping.coupled_system import CoupledSystem
from app.stepping.heat_state import HeatState
from app.stepping.load_steps import LoadStepper


class SolvedAfterHeat:
    """Mechanics that heat does not depend on.

    They are solved at the ends of the increments of a stage and after each large change of
    temperature, along the straight line between two states of the heat.

    Args:
        limit: Change of temperature, or of cure as the temperature it releases, after which
            they are solved again [K].
    """

    saved = ("_before", "_time")

    def __init__(self, load_stepper: LoadStepper, heating: HeatState, limit: float) -> None:
        self._load_stepper, self._heating, self._limit = load_stepper, heating, limit
        self._time = 0.0
        self._before = heating.thermal_state()
        heating.loading.interpolate(load_stepper.problem, self._before, self._before, 1.0)

    @property
    def row_keys(self) -> Ints:
        """Keys of nodes, ghosts included."""
        return self._heating.loading.row_keys

    def restored(self) -> None:
        """Load the mechanics with the thermal state of their last solve; collective."""
        self._heating.loading.restore(self._load_stepper.problem, self._before)

    def begin(self, k: int, stage: Stage, anew: bool) -> None:
        """Begin a stage that takes time, or continue it after a restart."""
        self._stage = stage
        if anew:
            self._time, self._before = float(k), self._heating.thermal_state()

    def follow(self, time: float, whole: bool) -> None:
        """Solve after a heat step that ends at a time, and perhaps ends an increment."""
        loading, problem = self._heating.loading, self._load_stepper.problem
        before, now = self._before, self._heating.thermal_state()
        if not whole and loading.distance(before, now) < self._limit:
            return
        begin = self._time

        def set_load(s: float) -> None:
            problem.set_time(begin + s * (time - begin))
            loading.interpolate(problem, before, now, s)

        longest = loading.largest_step(before, now)
        self._load_stepper.run_path(self._stage, longest, set_load, begin, time)
        self._before, self._time = now, time


class SolvedWithHeat:
    """Mechanics that heat depends on: in one system with it."""

    saved = ("_start", "_committed")

    def __init__(
        self, load_stepper: LoadStepper, heating: HeatState, system: CoupledSystem
    ) -> None:
        self._load_stepper, self._heating, self._system = load_stepper, heating, system
        self._start = self._committed = heating.seconds
        self._before = heating.thermal_state()
        heating.loading.interpolate(load_stepper.problem, self._before, self._before, 1.0)

    def restored(self) -> None:
        """Load the mechanics with the thermal state of their last solve; collective."""
        self._before = self._heating.thermal_state()
        self._heating.loading.restore(self._load_stepper.problem, self._before)

    def begin(self, k: int, stage: Stage, anew: bool) -> None:
        """Begin a stage that takes time, or continue it after a restart."""
        self._stage = stage
        if anew:
            self._start = self._committed = self._heating.seconds
        self._system.begin_stage(k, stage, self._start)
        self._system.restore(self._heating.solver.blocks())

    def follow(self, time: float, whole: bool) -> None:
        """Commit the mechanics of a heat step that ends at a time, and perhaps an increment."""
        started = clock.perf_counter()
        heating, loading = self._heating, self._heating.loading
        self._system.commit(heating.solver.blocks())
        self._system.exchange.report((heating.seconds - self._committed) or np.inf)
        self._committed = heating.seconds
        if not heating.cures:
            self._load_stepper.commit(self._stage, time, heating.outcome, started, whole)
            return
        # Within the step stiffness and free strain were those before it: an error of first order.
        before, now = self._before, heating.thermal_state()
        self._before = now

        def set_load(s: float) -> None:
            loading.interpolate(self._load_stepper.problem, before, now, s)

        longest = loading.largest_step(before, now)
        self._load_stepper.run_path(self._stage, longest, set_load, time, time)
