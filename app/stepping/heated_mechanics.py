"""Mechanics with heat: solved after the heat, or in one system with it.

Heat acts on the mechanics by temperatures, degrees of cure and the free strain of cement.
"""

from __future__ import annotations

import math
import time as clock
from dataclasses import dataclass
from functools import cached_property

from mpi4py import MPI

import numpy as np
from dolfinx import fem

from app.foundation.arrays import Floats, Ints
from app.heat.curing import fraction_since_gelation, free_strain
from app.numerics.saved_state import node_keys
from app.scene.scene import Stage
from app.stepping.coupled_system import CoupledSystem
from app.stepping.heat_state import HeatState
from app.stepping.load_steps import LoadStepper

# Rounding error of a number of steps.
ROUNDING_OF_STEP_COUNTS = 1e-9


@dataclass(frozen=True)
class ThermalState:
    """Temperatures [K], degrees of cure and free strains, by body or region, ghosts included.

    Attributes:
        temperatures: At the nodes of each thermal body [K].
        degrees: At the nodes of each curing region.
        strains: Free strain since gelation at the nodes of each curing region [-].
    """

    temperatures: list[Floats]
    degrees: list[Floats]
    strains: list[Floats]


class HeatedMechanics:
    """Mechanics with heat as a load.

    Between two states of the heat the load changes linearly. A step is at most
    ``time.mechanical_step``: a change of temperature, or the adiabatic temperature rise by a change
    of cure.

    Attributes:
        strains: Free strain of each curing region so far.
        previous: Thermal state at the last solve of the mechanics.
    """

    saved: tuple[str, ...] = ("strains", "previous")
    _stage: Stage

    def __init__(self, load_stepper: LoadStepper, heating: HeatState) -> None:
        self._load_stepper, self._heating = load_stepper, heating
        operators = self._operators = heating.operators
        self._limit = heating.options.mechanical_step
        self._curing = operators.cure.nodes if operators.cure else []
        self._temperatures = [fem.Function(operators.forms.space) for _ in operators.bodies.names]
        # The applied strains are between those of two thermal states.
        self._degrees, self.strains, self._applied_strains = (
            [fem.Function(operators.forms.space) for _ in self._curing] for _ in range(3)
        )
        expansion = {x.region: x.expansion for x in operators.scene.expansions}
        self._strain_increments = [
            free_strain(operators.comm, cure, expansion.get(cure.region, 0.0), len(c.dof))
            for cure, c in zip(operators.scene.cures, self._curing, strict=True)
        ]
        self._last_update: ThermalState | None = None
        self.previous = self._update_state()
        self._apply(self.previous, self.previous, 1.0)

    @cached_property
    def row_keys(self) -> Ints:
        """Keys of nodes, ghosts included."""
        return node_keys(self._operators.forms.space)

    def restored(self) -> None:
        """Load the mechanics with the thermal state of their last solve; collective."""
        self._last_update = None
        self._update_state()
        self._apply(self.previous, self.previous, 1.0)
        problem = self._load_stepper.problem
        if problem.stress_history:
            problem.stress_history.begin_at(problem.displacements())

    def _update_state(self) -> ThermalState:
        """Take over the state of the heat and return it; collective.

        The free strain since the last update is added to `strains`.
        """
        degrees = list(self._heating.degrees().values())
        T = self._heating.temperatures()
        for b, f in enumerate(self._temperatures):
            f.x.array[: self._operators.forms.owned] = T[b]
            f.x.scatter_forward()
        for f, c, values in zip(self._degrees, self._curing, degrees, strict=True):
            f.x.array[c.dof] = values
            f.x.scatter_forward()
        last_update = self._last_update
        if last_update is not None:
            for k, c in enumerate(self._curing):
                self.strains[k].x.array[c.dof] += self._strain_increments[k](
                    a_old=last_update.degrees[k][c.dof],
                    T_old=last_update.temperatures[c.body][c.dof],
                    a=degrees[k],
                    T=self._temperatures[c.body].x.array[c.dof],
                )[0]
                self.strains[k].x.scatter_forward()
        self._last_update = ThermalState(
            *(
                [f.x.array.copy() for f in functions]
                for functions in (self._temperatures, self._degrees, self.strains)
            )
        )
        return self._last_update

    def _largest_change(self, current_state: ThermalState) -> float:
        """Largest change since the mechanics were last solved [K]; collective.

        A change of cure counts as its adiabatic temperature rise.
        """
        previous_state = self.previous
        pairs = zip(previous_state.temperatures, current_state.temperatures, strict=True)
        # A rank without cells has no values.
        sizes = [float(np.abs(a - b).max(initial=0.0)) for a, b in pairs]
        for c, a, b in zip(
            self._curing, previous_state.degrees, current_state.degrees, strict=True
        ):
            sizes.append(c.adiabatic_rise * float(np.abs(a - b).max(initial=0.0)))
        return float(self._operators.comm.allreduce(max(sizes), MPI.MAX))

    def _advance(self, current_state: ThermalState, start_time: float, end_time: float) -> None:
        """Solve from the thermal state of the last solve to another one, between two times."""
        previous_state = self.previous
        steps = max(
            math.ceil(self._largest_change(current_state) / self._limit - ROUNDING_OF_STEP_COUNTS),
            1,
        )
        self.previous = current_state

        def set_load(fraction: float) -> None:
            self._load_stepper.problem.set_time(start_time + fraction * (end_time - start_time))
            self._apply(previous_state, current_state, fraction)

        self._load_stepper.run_path(self._stage, 1.0 / steps, set_load, start_time, end_time)

    def _apply(self, a: ThermalState, b: ThermalState, s: float) -> None:
        """Load the mechanics with a state between a, at s = 0, and b, at s = 1.

        Temperature and cure are linear in s. Free strain is linear from gelation on.
        """
        problem, scene = self._load_stepper.problem, self._operators.scene
        for f, x, y in zip(
            [*self._temperatures, *self._degrees],
            [*a.temperatures, *a.degrees],
            [*b.temperatures, *b.degrees],
            strict=True,
        ):
            f.x.array[:] = (1 - s) * x + s * y
        for k, cure in enumerate(scene.cures):
            gelled_fraction = fraction_since_gelation(cure.gel, a.degrees[k], b.degrees[k], s)
            strain = (1 - gelled_fraction) * a.strains[k] + gelled_fraction * b.strains[k]
            self._applied_strains[k].x.array[:] = strain
        body = self._operators.bodies.body_of_region
        problem.set_temperature(
            {x.region: self._temperatures[body[x.region]] for x in scene.expansions}
        )
        if problem.stress_history:
            regions = [c.region for c in self._curing]
            degrees = dict(zip(regions, self._degrees, strict=True))
            problem.stress_history.set(
                degrees, dict(zip(regions, self._applied_strains, strict=True))
            )


class SolvedAfterHeat(HeatedMechanics):
    """Mechanics with heat that does not depend on contact.

    They are solved at the ends of the increments of a stage, and after each large change of
    temperature or cure.
    """

    saved = (*HeatedMechanics.saved, "time")

    time = 0.0

    def begin(self, k: int, stage: Stage, is_new: bool) -> None:
        """Begin a stage that takes time, or continue it after a restart."""
        self._stage = stage
        if is_new:
            self.time, self.previous = float(k), self._update_state()

    def after_heat_step(self, time: float, ends_increment: bool) -> None:
        """Solve at the end of an increment, or after a large change."""
        current_state = self._update_state()
        if ends_increment or self._largest_change(current_state) >= self._limit:
            self._advance(current_state, self.time, time)
            self.time = time


class SolvedWithHeat(HeatedMechanics):
    """Mechanics in one system with heat that depends on contact."""

    saved = (*HeatedMechanics.saved, "stage_start", "committed_at")

    def __init__(
        self, load_stepper: LoadStepper, heating: HeatState, system: CoupledSystem
    ) -> None:
        super().__init__(load_stepper, heating)
        self._system = system
        self.stage_start = self.committed_at = heating.seconds

    def begin(self, k: int, stage: Stage, is_new: bool) -> None:
        """Begin a stage that takes time, or continue it after a restart."""
        self._stage = stage
        if is_new:
            self.stage_start = self.committed_at = self._heating.seconds
        self._system.begin_stage(k, stage, self.stage_start)
        self._system.restore(self._heating.solver.blocks())

    def after_heat_step(self, time: float, ends_increment: bool) -> None:
        """Commit the mechanics of a heat step."""
        started = clock.perf_counter()
        heating, current_state = self._heating, self._update_state()
        self._system.commit(heating.solver.blocks())
        self._system.contact_heat.report((heating.seconds - self.committed_at) or np.inf)
        self.committed_at = heating.seconds
        if self._load_stepper.problem.stress_history:
            # The step used the stiffness and free strain of its start, an error of first order.
            self._advance(current_state, time, time)
        else:
            self.previous = current_state
            self._load_stepper.commit(self._stage, time, heating.outcome, started, ends_increment)
