"""Heat on its way through time: the state, a time step of it, what it has released so far.

A time step is that of `app.integrator`; each of its stages is one solve of the system of heat, or
of heat and mechanics together where heat depends on contact (`app.coupling`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from app import integrator
from app.conduction import Conduction
from app.integrator import METHODS, Method, State
from app.motion import Summary
from app.solver import Outcome, Solver
from app.terms import Scene

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Accepted:
    """A heat step that is history.

    Attributes:
        seconds: Time at its end, since the start of the run [s].
        dt: Its length [s]; 0 for a steady state.
        heats: Heat that entered the model by condition, as the integration sums it [N mm].
        flows: Heat that enters at its end by condition [N mm/s].
        outcome: What the solver said at its last stage.
    """

    seconds: float
    dt: float
    heats: dict[str, float]
    flows: dict[str, float]
    outcome: Outcome


class Heating:
    """Temperatures, jumps and degrees of cure in time.

    Attributes:
        conduction: The operators.
        state: Temperatures of own nodes, jumps of own points [K], degrees of cure of own nodes.
        seconds: Time since the start of the run [s].
        total: What it took so far.
    """

    def __init__(
        self,
        scene: Scene,
        conduction: Conduction,
        solver: Solver,
        place: Callable[[float], None] = lambda seconds: None,
    ) -> None:
        """Begin at the initial temperatures; collective.

        Args:
            scene: The scene.
            conduction: Its heat.
            solver: Solver of its heat, or of heat and mechanics.
            place: Sets what else is in the solver's system to the time of a stage.
        """
        (self.options,) = scene.time
        self.conduction, self.solver, self._place = conduction, solver, place
        self.method = METHODS[self.options.method]
        self.seconds = 0.0
        self.total = Summary()
        self.state = self._state(conduction.initial())
        self._slope: State = [np.zeros_like(part) for part in self.state]
        self._stages: list[dict[str, float]] = []
        self._outcome: Outcome | None = None
        self.put(self.state)

    # Between lists of arrays and the vectors of the solver

    def vectors(self) -> list[PETSc.Vec]:
        """Temperatures and jumps as the solver has them."""
        named = self.solver.named()
        return [named[n] for n in ("temperature", "temperature_jump") if n in named]

    def _state(self, x: Sequence[PETSc.Vec]) -> State:
        return [*(v.array.copy() for v in x), *(a.copy() for a in self.conduction.degrees(x))]

    def put(self, state: State) -> None:
        """Put temperatures and jumps into the solver."""
        for v, values in zip(self.vectors(), state, strict=False):
            v.array[:] = values

    # A time step

    def norm(self, error: State) -> float:
        """Largest error over its tolerance, of cure as the temperature it releases; collective."""
        sizes = [1.0] * len(self.vectors()) + list(self.conduction.adiabatic_rises)
        local = max(
            (float(np.abs(e).max(initial=0.0)) * s for e, s in zip(error, sizes, strict=True)),
            default=0.0,
        )
        return float(self.conduction.comm.allreduce(local, MPI.MAX)) / self.options.tolerance

    def _solve(self, start: State, h: float, seconds: float, guess: State) -> State | None:
        """One stage."""
        n = len(self.vectors())
        if not self.conduction.begin(start[:n], start[n:], h, seconds):
            return None
        self.put(guess)
        self._place(seconds)
        outcome = self.solver.solve()
        self.total.count(outcome)
        self._outcome = outcome
        if not outcome.converged:
            return None
        self._stages.append(self.conduction.flows(self.vectors()))
        return self._state(self.vectors())

    def start(self, longest: float) -> float:
        """Find the rate of change at the start of a stage, and a first step for it [s]."""
        slope = integrator.start_slope(
            self.state, self.seconds, 1e-6 * min(longest, 1.0), self._solve
        )
        self._slope = slope or self._slope
        return self.options.first_step or integrator.first_step(self._slope, self.norm, longest)

    def attempt(self, dt: float) -> tuple[integrator.Step, Method] | None:
        """Solve a time step; None where a stage does not converge.

        A step that leaves the extremes of the data is done again: where the mesh makes it, with the
        edges that do (`app.monotone`), else by backward Euler.
        """
        for method in dict.fromkeys((self.method, METHODS["backward_euler"])):
            while True:
                self._stages = []
                found = integrator.step(
                    method, self.state, self._slope, dt, self.seconds, self._solve
                )
                if found is None or not self.conduction.outside(self.vectors()):
                    break
                if not self.conduction.correct(self.vectors()):
                    found = None
                    break
            if found is not None:
                return found, method
        return None

    def accept(self, found: integrator.Step, method: Method, dt: float) -> Accepted:
        """Make a step history."""
        heats = {
            name: dt
            * sum(b * flows[name] for b, flows in zip(method.a[-1], self._stages, strict=True))
            for name in self._stages[-1]
        }
        self.conduction.settle(self.vectors())
        self.state, self._slope = found.state, found.slope
        self.seconds += dt
        self.total.steps += 1
        assert self._outcome is not None
        return Accepted(self.seconds, dt, heats, self._stages[-1], self._outcome)

    def rest(self) -> Accepted | None:
        """Go to the steady state; None if it does not converge."""
        self._stages = []
        found = self._solve(self.state, np.inf, self.seconds, self.state)
        if found is None:
            return None
        self.state, self._slope = found, [np.zeros_like(part) for part in found]
        self.total.steps += 1
        assert self._outcome is not None
        return Accepted(self.seconds, 0.0, {}, self._stages[-1], self._outcome)
