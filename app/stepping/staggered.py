"""Heat and mechanics in turns, where heat depends on contact."""

from __future__ import annotations

from dataclasses import replace

from petsc4py import PETSc

from app.heat.conduction import Conduction
from app.mechanics.problem import Problem
from app.numerics.newton import NewtonResult, Solver
from app.stepping.contact_heat import ContactHeat

# Turns of heat and mechanics before giving up.
TURNS = 60


class Staggered:
    """Heat and mechanics in turns, until both hold: the same solution by another way.

    Each turn solves the heat with the contact of the turn before and the mechanics with that heat.
    It takes the place of a solver of both.

    Attributes:
        exchange: Contact as the heat sees it.
    """

    saved = ("_heat",)

    def __init__(
        self,
        exchange: ContactHeat,
        conduction: Conduction,
        problem: Problem,
        heat: Solver,
        motion: Solver,
    ) -> None:
        """Join two solvers."""
        self.exchange, self._conduction, self._problem = exchange, conduction, problem
        self._heat, self._motion = heat, motion

    def named(self) -> dict[str, PETSc.Vec]:
        """Blocks of the current state by name."""
        return self._heat.named() | self._motion.named()

    @property
    def block_sizes(self) -> dict[str, int]:
        """Unknowns by block."""
        return self._heat.block_sizes | self._motion.block_sizes

    def solve(self) -> NewtonResult:
        """Solve from the current state."""
        outcome = NewtonResult(False, 0, 0, (), (), False)
        for _ in range(TURNS):
            self._pass_contact_to_heat()
            outcome = _after(outcome, self._heat.solve())
            if not outcome.converged:
                break
            self.exchange.to_mechanics(self._heat.blocks())
            outcome = _after(outcome, self._motion.solve())
            if not outcome.converged:
                break
            self._pass_contact_to_heat()
            if self._holds():
                return outcome
        return replace(outcome, converged=False)

    def _pass_contact_to_heat(self) -> None:
        """Set pressures and friction heat from the current state of the mechanics."""
        u, q = self._motion.parts()
        assert q is not None
        self.exchange.to_heat(self._problem.trial(u, q))

    def _holds(self) -> bool:
        """Whether the heat still balances with the contact that follows from it; collective."""
        x, f = self._heat.blocks(), self._conduction.vectors()
        self._conduction.residual(x, f)
        return self._heat.meets(self._conduction.measure(x, f))


def _after(done: NewtonResult, last: NewtonResult) -> NewtonResult:
    """Two solves as one."""
    return replace(
        last,
        iterations=done.iterations + last.iterations,
        linear_iterations=done.linear_iterations + last.linear_iterations,
    )
