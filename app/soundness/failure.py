"""Why a solve failed, in terms of the model: which interface, where, which body is free."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.errors import Reason
from app.mechanics.contact import ContactInterfaces, TrialState
from app.mechanics.problem import Problem
from app.numerics.active_set import ActiveSet
from app.numerics.newton import NewtonResult, Solver
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
        short: One clause for the log.
        free: Sentences on free bodies.
        notes: Sentences on bodies that friction barely holds, on friction beyond which solutions
            need not be unique, on the largest residual and on oscillating points.
        doubtful: Whether friction is among the notes.
    """

    outcome: NewtonResult
    short: str
    free: Sequence[str]
    notes: Sequence[str]
    doubtful: bool

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
        if self.doubtful:
            advice += "; other friction, or a support"
        if self.free:
            advice = "hold the free body (a support, friction, an elastic foundation)"
        lines = [
            f"no convergence in stage '{stage}' at {100 * reach:.3g} % of it: {self.short}{code}",
            *self.free[1:],
            *self.notes,
            f"last residuals (relative to the forces): {tail}",
            f"tried: {attempts(self.outcome.tried, steps)}",
            f"what to change: {advice}",
        ]
        return "\n  ".join(lines)


def explain(problem: Problem, solver: Solver, outcome: NewtonResult) -> Explanation:
    """Explain the failure of the last solve; collective."""
    free: list[str] = []
    friction: list[str] = []
    places: list[str] = []
    u, q = solver.u_and_q(solver.failed_state)
    if q is not None:
        trial = problem.trial(u, q)
        contact = trial.contact
        free = loose_bodies.free_bodies(problem, trial)
        friction = [
            *([] if free else loose_bodies.sliding(problem, contact)),
            *uniqueness.beyond(problem),
        ]
        places = [_largest(problem, trial), *_oscillating(problem, contact, solver.active)]
    if free:
        short = free[0]
    elif outcome.linear_failed:
        short = "the linear solver failed"
    elif sum(outcome.changes[-5:]) > 0:
        again = f", the same every {outcome.period} iterations" if outcome.period else ""
        short = f"contact states keep changing ({outcome.changes[-1]} in the last iteration{again})"
    else:
        short = f"the residual stays at {outcome.residuals[-1]:.1e} times the forces"
    return Explanation(outcome, short, free, [*friction, *places], bool(friction))


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
            r.changes,
            f"changing: {' <-> '.join(map(_state, r.states))} "
            f"{_place(problem, contact, r.row)}, "
            f"in {r.changes} of the last {r.iterations} iterations",
        )
        for r in active.oscillating()[:SHOWN]
    ]
    every = sorted((r for part in problem.comm.allgather(local) for r in part), reverse=True)
    return [text for _, text in every[:SHOWN]]


def _largest(problem: Problem, trial: TrialState) -> str:
    """Interface, place and state of the largest residual of contact points; collective."""
    contact = trial.contact
    r = np.linalg.norm(contact.residual(trial.equilibrium, trial.jump, trial.law), axis=1)
    found = (-1.0, "")
    if len(r):
        k = int(np.argmax(r))
        state = _state(trial.law.status[k])
        found = (
            float(r[k]),
            f"largest residual: {r[k]:.2e} N {_place(problem, contact, k)}, {state}",
        )
    return max(problem.comm.allgather(found))[1]
