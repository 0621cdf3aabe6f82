"""Why a solve failed, in terms of the model: which interface, where, which body is free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.errors import Reason
from app.mechanics.contact import ContactInterfaces, TrialState
from app.mechanics.problem import Problem
from app.numerics.newton import ActiveSet, NewtonResult, Solver
from app.soundness import loose_bodies, uniqueness
from app.system.layout import point_text

# States of a contact point, by status.
STATES = ("open", "stick", "slip")
# Changing points that a message lists.
SHOWN = 3


@dataclass(frozen=True)
class Explanation:
    """Why a solve failed.

    Attributes:
        free: Sentences on free bodies.
        friction: Sentences on bodies that friction barely holds, and on friction beyond which
            solutions need not be unique.
        places: Sentences on the largest residual and on oscillating points.
    """

    outcome: NewtonResult
    free: Sequence[str] = ()
    friction: Sequence[str] = ()
    places: Sequence[str] = ()

    @property
    def short(self) -> str:
        """One clause for the log."""
        outcome = self.outcome
        if self.free:
            return self.free[0]
        if outcome.linear_failed:
            return "the linear solver failed"
        if sum(outcome.changes[-5:]) > 0:
            again = f", the same every {outcome.period} iterations" if outcome.period else ""
            return (
                f"contact states keep changing ({outcome.changes[-1]} in the last iteration{again})"
            )
        return f"the residual stays at {outcome.residuals[-1]:.1e} times the forces"

    def text(self, stage: str, reach: float, steps: Sequence[float]) -> str:
        """The message for the user.

        Args:
            stage: Name of the stage.
            reach: Part of it at which the solve failed.
            steps: Halved steps tried before, as parts of the stage.
        """
        code = f" [{Reason.LOOSE_BODY}]" if self.free else ""
        tail = ", ".join(f"{r:.1e}" for r in self.outcome.residuals[-6:])
        advice = "more increments, a finer mesh at the interface, or a smaller load"
        if self.friction:
            advice += "; other friction, or a support"
        if self.free:
            advice = "hold the free body (a support, friction, an elastic foundation)"
        lines = [
            f"no convergence in stage '{stage}' at {100 * reach:.3g} % of it: {self.short}{code}",
            *self.free[1:],
            *self.friction,
            *self.places,
            f"last residuals (relative to the forces): {tail}",
            f"tried: {attempts(self.outcome.tried, steps)}",
            f"what to change: {advice}",
        ]
        return "\n  ".join(lines)


def explain(problem: Problem, solver: Solver, outcome: NewtonResult) -> Explanation:
    """Explain the failure of the last solve; collective."""
    u, q = solver.u_and_q(solver.failed_state)
    if q is None:
        return Explanation(outcome)
    trial = problem.trial(u, q)
    contact = trial.contact
    free = loose_bodies.free_bodies(problem, trial)
    friction = [] if free else loose_bodies.sliding(problem, contact)
    friction += uniqueness.look(problem)[1]
    places = [_largest(problem, trial), *_oscillating(problem, contact, solver.active)]
    return Explanation(outcome, free, friction, places)


def attempts(tried: Sequence[tuple[str, float]], steps: Sequence[float] = ()) -> str:
    """List the attempts of the solver, in words.

    Args:
        tried: Changes of the solver, and the residuals they reached.
        steps: Halved steps tried before, as parts of the stage.
    """
    words = [f"{what}: {residual:.1e}" for what, residual in tried]
    text = f"{'; '.join(words)} (with final residuals)" if words else "plain Newton only"
    halved = f"; steps of {', '.join(f'{s:.3g}' for s in steps)} of the stage" if steps else ""
    return text + halved


def _state(status: int) -> str:
    return STATES[status] if status < len(STATES) else f"state {status}"


def _place(problem: Problem, contact: ContactInterfaces, row: int) -> str:
    name = problem.scene.contacts[contact.own.interface[row]].name
    return f"on interface '{name}' at {point_text(contact.own.x[row])}"


def _oscillating(problem: Problem, contact: ContactInterfaces, active: ActiveSet) -> list[str]:
    """Contact points that changed state most in the last iterations; collective."""
    local = [
        (
            changes,
            f"changing: {' <-> '.join(map(_state, states))} {_place(problem, contact, row)}, "
            f"in {changes} of the last {iterations} iterations",
        )
        for row, changes, iterations, states in active.oscillating()[:SHOWN]
    ]
    every = sorted((r for part in problem.comm.allgather(local) for r in part), reverse=True)
    return [text for _, text in every[:SHOWN]]


def _largest(problem: Problem, trial: TrialState) -> str:
    """Interface, place and state of the largest residual of contact points; collective."""
    contact = trial.contact
    r = np.linalg.norm(contact.residual(trial.equilibrium, trial.jump, trial.law), axis=1)
    local = [
        (
            float(r[k]),
            f"largest residual: {r[k]:.2e} N {_place(problem, contact, k)}, "
            f"{_state(trial.law.status[k])}",
        )
        for k in ([int(np.argmax(r))] if len(r) else [])
    ]
    return max(found for part in problem.comm.allgather(local) for found in part)[1]
