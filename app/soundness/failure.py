"""Explanation of failed solves in terms of the model: causes, places and remedies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from mpi4py import MPI

import numpy as np

from app.foundation.errors import ConvergenceError
from app.foundation.layout import point_text
from app.foundation.verdict import Reason, Severity, Verdict
from app.mechanics.contact import ContactInterfaces, TrialState
from app.mechanics.problem import Problem
from app.numerics.newton import ActiveSet, NewtonResult, Solver
from app.soundness import floating_bodies_of_state
from app.soundness.critical_friction import critical_friction_of_interfaces

# States of a contact point, by status.
STATES = ("open", "stick", "slip")
# Largest number of changing points in a message.
SHOWN = 3
# Largest relative difference of residuals that count as proportional to the load.
SAME = 1e-9
# Residual over the forces below which a failed state with large jumps counts as in balance.
BALANCED = 2e-2
# Remedies: in general; for a failure from rest without gaps; for a cohesive interface that breaks;
# for displacements that are not small.
SMALLER = "use more increments, a finer mesh at the interface, or a smaller load"
FROM_REST = (
    "check the supports and the direction of the loads, or refine the mesh at the interface; "
    "without gaps a smaller first load fails in the same way"
)
BREAKS = (
    "use `fracture_step` in the stage, or prescribe a displacement instead of the load; a cohesive "
    "interface breaks, and past the peak load only smaller loads are in equilibrium"
)
FAR = "use stiffer foundations, add a support, or reduce the load"


def place_in_stage(stage: str, fraction: float) -> str:
    """Name of a stage and the reached fraction of it, in words."""
    return f"stage '{stage}' at {100 * fraction:.3g} % of it"


@dataclass(frozen=True)
class Explanation:
    """Verdicts on a solve that failed.

    Attributes:
        outcome: The failed solve.
        cause: Its cause, without the stage.
        circumstances: Verdicts on other floating bodies, on friction, on the largest residual, and
            on points that change state.
        has_floating_body: True if nothing holds a body: smaller steps fail too.
    """

    outcome: NewtonResult
    cause: Verdict
    circumstances: Sequence[Verdict] = ()
    has_floating_body: bool = False

    def error(
        self, stage: str, reached_fraction: float, steps: Sequence[float]
    ) -> ConvergenceError:
        """Return the error of the failed solve.

        Args:
            stage: Name of the stage.
            reached_fraction: Fraction of the stage at which the solve failed.
            steps: Lengths of the failed steps, as fractions of the stage.
        """
        place = f"no convergence in {place_in_stage(stage, reached_fraction)}"
        residuals = ", ".join(f"{r:.1e}" for r in self.outcome.residuals[-6:])
        return ConvergenceError(
            [
                replace(self.cause, where=place),
                *self.circumstances,
                bare_verdict(residuals, "last residuals (relative to the forces)"),
                bare_verdict(attempts(self.outcome.tried, steps), "tried"),
            ]
        )


def bare_verdict(what: str, where: str = "") -> Verdict:
    """Return a plain verdict: a circumstance of a failure."""
    return Verdict(what, where, severity=Severity.PLAIN)


def is_proportional(
    solver: Solver, set_load: Callable[[float], None], reached_fraction: float
) -> bool:
    """Return True if the residual is halved by half the load and half the state; collective."""
    full_residual, half_state = solver.residual(solver.failed_state), solver.failed_state.copy()
    half_state.scale(0.5)
    set_load(reached_fraction / 2)
    half_residual = solver.residual(half_state)
    set_load(reached_fraction)
    half_residual.axpy(-0.5, full_residual)
    return half_residual.norm() <= SAME * full_residual.norm()


def explanation_of_failure(
    problem: Problem, solver: Solver, outcome: NewtonResult, fails_at_any_load: bool = False
) -> Explanation:
    """Return an explanation of the failure of the last solve; collective.

    Args:
        problem: The problem.
        solver: Its solver, with the state that failed.
        outcome: The outcome of the solve.
        fails_at_any_load: True if the solve began at rest and fails alike under any part of the
            load.
    """
    u, q = solver.u_and_q(solver.failed_state)
    if q is None:
        remedy = FROM_REST if fails_at_any_load else SMALLER
        return Explanation(outcome, Verdict(_residuals(outcome), remedy=remedy))
    trial, first_trial = problem.trial(u, q), problem.trial(*solver.u_and_q(solver.first_state))
    contact = trial.contact
    dissipates = contact.laws.dissipates
    energy = sum(
        float(t.forces.outputs["dissipated"][dissipates].sum()) for t in (trial, first_trial)
    )
    breaks = bool(contact.laws.internal_variables and problem.comm.allreduce(energy, MPI.SUM) > 0)
    floating: list[str] = []
    # A body whose cohesive interface breaks in this step does not float.
    if not breaks:
        floating = _floating_in_failed_solve(problem, trial, first_trial, fails_at_any_load)
    runaway = None
    has_run_away = solver.system.runs_away(solver.blocks(solver.failed_state))
    if not floating and has_run_away and outcome.residuals[-1] < BALANCED:
        runaway = floating_bodies_of_state.error_of_runaway(problem, trial)
    friction: list[Verdict] = []
    if not floating and not runaway:
        friction = floating_bodies_of_state.warnings_of_sliding_bodies(problem, contact)
    for critical in critical_friction_of_interfaces(problem):
        friction += critical.warnings()
    # The first hypothesis that holds is the cause.
    if floating:
        cause = Verdict(
            floating[0], remedy=floating_bodies_of_state.HOLD_REMEDY, code=Reason.FLOATING_BODY
        )
    elif runaway:
        cause = Verdict(runaway.what, remedy=FAR, code=Reason.LARGE_DISPLACEMENT)
    else:
        remedy = FROM_REST if fails_at_any_load else SMALLER
        if breaks:
            remedy = BREAKS
        if friction:
            remedy += "; or change the friction, or add a support"
        cause = Verdict(_residuals(outcome), remedy=remedy)
    circumstances = [bare_verdict(text) for text in floating[1:]]
    circumstances += friction
    circumstances += map(
        bare_verdict, [_largest(problem, trial), *_oscillating(problem, contact, solver.active)]
    )
    return Explanation(outcome, cause, circumstances, bool(floating))


def _floating_in_failed_solve(
    problem: Problem, trial: TrialState, first_trial: TrialState, fails_at_any_load: bool
) -> list[str]:
    """Sentences on bodies that float in a failed solve; collective.

    Args:
        problem: The problem.
        trial: Its failed state.
        first_trial: The state at which plain Newton ended. Remedies may end in any state.
        fails_at_any_load: True if the solve fails alike under any part of the load.
    """
    contact = trial.contact
    pulled = floating_bodies_of_state.texts_of_pulled_bodies(problem, contact)
    if fails_at_any_load or contact.finite_sliding:
        floating = pulled
    else:
        # The search for pulled bodies knows neither gaps nor the state. So a body that it names
        # counts only if the state has a free motion, which is tested below.
        floating = floating_bodies_of_state.texts_of_pushed_bodies(problem, trial)
    # A body does not float if iterates lose contact that the loads would close.
    if not floating and (pulled or not problem.size_of_loads or contact.is_apart()):
        for state in (trial, first_trial):
            floating = floating or floating_bodies_of_state.texts_of_floating_bodies(problem, state)
    return floating


def _residuals(outcome: NewtonResult) -> str:
    """One clause on how the iteration ended."""
    if outcome.linear_failed:
        return "the linear solver failed"
    if sum(outcome.changes[-5:]) > 0:
        repeat_text = f", repeated every {outcome.period} iterations" if outcome.period else ""
        return (
            f"contact states keep changing ({outcome.changes[-1]} in the last "
            f"iteration{repeat_text})"
        )
    return f"the residual stays at {outcome.residuals[-1]:.1e} times the forces"


def attempts(tried: Sequence[tuple[str, float]], steps: Sequence[float] = ()) -> str:
    """Number of remedies with the best of them, and the smallest halved step, in words.

    The log reports each remedy when it is tried. A remedy that converged has solved a problem with
    switched contact, so it is not the best one.
    """
    tried_text = f"{len(tried)} remedies" if tried else "plain Newton only"
    unsolved = [attempt for attempt in tried if np.isfinite(attempt[1])]
    if unsolved:
        best_remedy, residual = min(unsolved, key=lambda attempt: attempt[1])
        tried_text += f", of which the best ({best_remedy}) left a residual of {residual:.1e}"
    if steps:
        tried_text += f"; steps halved down to {min(steps):.3g} of the stage"
    return tried_text


def _state(status: int) -> str:
    return STATES[status] if status < len(STATES) else f"state {status}"


def _place(problem: Problem, contact: ContactInterfaces, row: int) -> str:
    name = problem.scene.parting_interfaces[contact.local.interface[row]].name
    return f"on interface '{name}' at {point_text(contact.local.x[row])}"


def _oscillating(problem: Problem, contact: ContactInterfaces, active: ActiveSet) -> list[str]:
    """Contact points that changed state most in the last iterations; collective."""
    local = [
        (
            change_count,
            f"changing: {' <-> '.join(map(_state, states))} {_place(problem, contact, row)}, "
            + (
                f"in {change_count} of the last {iterations} iterations"
                if iterations > 1
                else "in the last iteration"
            ),
        )
        for row, change_count, iterations, states in active.oscillating()[:SHOWN]
    ]
    all_points = sorted((r for part in problem.comm.allgather(local) for r in part), reverse=True)
    return [text for _, text in all_points[:SHOWN]]


def _largest(problem: Problem, trial: TrialState) -> str:
    """Interface, place and state of the largest residual of contact points; collective."""
    contact = trial.contact
    r = np.linalg.norm(contact.residual(trial.equilibrium, trial.jump, trial.forces), axis=1)
    local = [
        (
            float(r[k]),
            f"largest residual: {r[k]:.2e} N {_place(problem, contact, k)}, "
            f"{_state(trial.forces.status[k])}",
        )
        for k in ([int(np.argmax(r))] if len(r) else [])
    ]
    return max(point for part in problem.comm.allgather(local) for point in part)[1]
