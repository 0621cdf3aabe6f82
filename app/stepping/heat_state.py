"""State of the heat, its time steps, and the heat that enters during a step.

`numerics.integrator` makes the time steps. A step has implicit stages (Runge-Kutta); each of them
is one solve of the system of heat.
If heat depends on contact, heat and mechanics are solved together (`stepping.coupled_system`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.heat.curing import error_as_temperature
from app.heat.implicit_step import ImplicitStep
from app.numerics import integrator
from app.numerics.integrator import METHODS, SAME_TIME, Method, State
from app.numerics.newton import NewtonResult, Solver
from app.numerics.remedies import solve
from app.scene.scene import Scene
from app.stepping.coupled_system import CoupledSystem
from app.stepping.load_steps import Effort

# First step of a stage of the case, as a fraction of an increment, if the rate is unknown.
FIRST_STEP = 1e-3


@dataclass(frozen=True)
class HeatStep:
    """A committed heat step.

    Attributes:
        seconds: Time at its end, since the start of the run [s].
        dt: Length [s]; 0 for a steady state.
        heats: Heat that enters the model during the step, by condition [N mm].
        flows: Heat per time that enters at its end, by condition [N mm/s].
        outcome: Outcome of its last implicit stage.
    """

    seconds: float
    dt: float
    heats: dict[str, float]
    flows: dict[str, float]
    outcome: NewtonResult


class HeatState:
    """Temperatures, jumps and degrees of cure in time.

    Attributes:
        system: The system of heat, for one implicit solve at a time.
        operators: Operators of heat.
        solver: Solver of heat, or of heat and mechanics.
        coupled: Heat and mechanics in one system, if heat depends on contact.
        outcome: Outcome of the last solve.
        state: Temperatures of owned nodes, jumps of owned points [K], owned degrees of cure.
        rate: Rate of change of the state at the end of the last step [K/s] and [1/s].
        seconds: Time since the start of the run [s].
        total: Counts of steps and iterations so far.
    """

    saved = ("seconds", "total", "state", "rate", "system", "solver")

    def __init__(
        self, scene: Scene, system: ImplicitStep, solver: Solver, coupled: CoupledSystem | None
    ) -> None:
        assert scene.time is not None
        self.options = scene.time
        self.system, self.operators, self.solver = system, system.operators, solver
        self.coupled = coupled
        self.outcome = NewtonResult(False, 0, 0, (), (), False)
        self.method = METHODS[self.options.method]
        self.seconds = 0.0
        self.total = Effort()
        self.state = self._state(system.initial())
        self.rate: State = [np.zeros_like(part) for part in self.state]
        self._flows_of_implicit_stages: list[dict[str, float]] = []
        self.set_solver_state(self.state)
        cure = self.operators.cure
        self._curing = cure.nodes if cure else []

    @property
    def row_keys(self) -> dict[str, list[Ints]]:
        """Keys of owned nodes and points, by block."""
        blocks = self.operators.block_keys()
        return {"state": blocks, "rate": blocks}

    def restored(self) -> None:
        """Set the solver to the restored temperatures."""
        self.set_solver_state(self.state)

    # Between lists of arrays and the vectors of the solver

    def vectors(self) -> list[PETSc.Vec]:
        """Temperatures and jumps in the solver."""
        named = self.solver.blocks_by_name()
        return [named[n] for n in ("temperature", "temperature_jump") if n in named]

    @property
    def _block_count(self) -> int:
        """Number of blocks of temperatures: the first parts of a state. Degrees of cure follow."""
        return len(self.vectors())

    def _state(self, x: Sequence[PETSc.Vec]) -> State:
        return [*(v.array.copy() for v in x), *(a.copy() for a in self.system.degrees(x))]

    def set_solver_state(self, state: State) -> None:
        """Set temperatures and jumps in the solver."""
        for v, values in zip(self.vectors(), state[: self._block_count], strict=True):
            v.array[:] = values

    # A time step

    def norm(self, error: State) -> float:
        """Largest error over its tolerance; collective.

        An error of the degree of cure counts as the temperature rise that it releases.
        """
        n = self._block_count
        errors = list(error[:n])
        errors_of_cure = error[n : len(self.state)]  # without friction work
        for degree, e, nodes in zip(self.state[n:], errors_of_cure, self._curing, strict=True):
            errors.append(error_as_temperature(degree, e, nodes.adiabatic_rise))
        local = max(float(np.abs(e).max(initial=0.0)) for e in errors)
        return float(self.operators.comm.allreduce(local, MPI.MAX)) / self.options.tolerance

    def _solve(self, start: State, h: float, seconds: float, guess: State) -> State | None:
        """Solve an implicit stage of a time step; None if it fails.

        If mechanics is coupled, the last entry of a state is the friction work.
        """
        blocks, parts, coupled = self._block_count, len(self.state), self.coupled
        if not self.system.begin(start[:blocks], start[blocks:parts], h, seconds):
            return None
        self.set_solver_state(guess)
        if coupled is not None:
            coupled.begin(seconds, h, start[parts])
            if not self.outcome.converged:
                coupled.restore(self.solver.blocks())
        self.outcome = solve(self.solver)
        self.total.count(self.outcome)
        if not self.outcome.converged:
            return None
        self._flows_of_implicit_stages.append(self.system.flows(self.vectors()))
        friction_work = [coupled.contact_heat.friction_work] if coupled is not None else []
        return [*self._state(self.vectors()), *friction_work]

    def _with_work(self, state: State) -> State:
        """Return a state, with zero friction work as last part if mechanics is coupled."""
        coupled = self.coupled
        work = [coupled.contact_heat.zero_work()] if coupled is not None else []
        return [*state, *work]

    def start(self, longest: float) -> float:
        """Set the rate of change at the start of a stage of the case; return its first step [s].

        If mechanics is coupled, the rate is not computed, because computing it needs a very short
        step, in which slips are below rounding.
        """
        first_step = FIRST_STEP * longest
        if self.coupled is None:
            shortest = 1e-6 * min(longest, 1.0)
            rate = integrator.start_rate(self.state, self.seconds, shortest, self._solve)
            self.rate = rate or self.rate
            first_step = integrator.first_step(self.rate, self.norm, longest)
        return self.options.first_step or first_step

    def attempt(
        self, dt: float, fixed: bool = False
    ) -> tuple[integrator.SolvedTimeStep, Method] | None:
        """Solve a time step; None if an implicit stage does not converge.

        If ``fixed`` is True, the step cannot be shortened. It is then repeated by backward Euler.

        A step is also repeated if a temperature lies outside the range of the data (maximum
        principle): first without the mesh edges that cause this (`heat.maximum_principle`), then by
        backward Euler.
        """
        state, rate = (self._with_work(part) for part in (self.state, self.rate))
        principle = self.operators.principle
        for name in dict.fromkeys((self.method.name, "backward_euler")):
            method = METHODS[name]
            while True:
                self._flows_of_implicit_stages = []
                solution = integrator.step(method, state, rate, dt, self.seconds, self._solve)
                T = self.operators.nodal(self.vectors())
                is_violated = solution is not None and principle.is_violated(T)
                if not is_violated or not principle.correct(T):
                    break
            if not is_violated and (solution is not None or not fixed):
                break
        return (solution, method) if solution is not None else None

    def accept(self, solution: integrator.SolvedTimeStep, method: Method, dt: float) -> HeatStep:
        """Commit a step."""
        heats = {
            name: dt * sum(method.a[-1] * [flows[name] for flows in self._flows_of_implicit_stages])
            for name in self._flows_of_implicit_stages[-1]
        }
        self.operators.principle.restore_edges(self.operators.nodal(self.vectors()))
        parts = slice(len(self.state))
        self.state, self.rate = solution.state[parts], solution.rate[parts]
        self.seconds += dt
        self.total.steps += 1
        return HeatStep(self.seconds, dt, heats, self._flows_of_implicit_stages[-1], self.outcome)

    def solve_steady(self) -> HeatStep | None:
        """Solve for the steady state; None if it does not converge."""
        self._flows_of_implicit_stages = []
        state = self._solve(self._with_work(self.state), np.inf, self.seconds, self.state)
        if state is None:
            return None
        state = state[: len(self.state)]
        self.state, self.rate = state, [np.zeros_like(part) for part in state]
        self.total.steps += 1
        return HeatStep(self.seconds, 0.0, {}, self._flows_of_implicit_stages[-1], self.outcome)

    # Queries

    @property
    def events(self) -> tuple[float, ...]:
        """Times that no step may cross [s]."""
        scene, cure = self.operators.scene, self.operators.cure
        times = [t for c in scene.heat for t, _ in c.time_course or ()]
        curing = cure.events if cure else ()
        return tuple(sorted({*times, *curing}))

    def begins_at_event(self, heat_step: HeatStep) -> bool:
        """Return True if a step begins at an event."""
        step_start = heat_step.seconds - heat_step.dt
        return bool(np.isclose(self.events, step_start, rtol=SAME_TIME, atol=0.0).any())

    def temperatures(self) -> Floats:
        """Temperatures of owned nodes of each body (b, n) [K]."""
        return self._nodal(self.state)

    def temperature_rates(self) -> Floats:
        """Rates of change of temperature at owned nodes of each body (b, n) [K/s]."""
        return self._nodal(self.rate)

    def degrees(self) -> dict[str, Floats]:
        """Degrees of cure of owned nodes of each curing region."""
        degrees = self.state[self._block_count :]
        return {c.region: degree for c, degree in zip(self._curing, degrees, strict=True)}

    def cure_rates(self) -> dict[str, Floats]:
        """Rates of cure of owned nodes of each curing region [1/s]."""
        rates = self.rate[self._block_count :]
        return {c.region: rate for c, rate in zip(self._curing, rates, strict=True)}

    def _nodal(self, state: State) -> Floats:
        """Temperatures of owned nodes of each body in a state (b, n) [K]."""
        x = self.system.vectors()
        for v, values in zip(x, state[: len(x)], strict=True):
            v.array[:] = values
        return self.operators.nodal(x)
