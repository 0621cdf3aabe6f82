"""Explanation of failed solves in terms of the model, and critical friction coefficients.

A single contact point may have several equilibria. Let A be the tangential block of its stiffness,
and w its coupling row, the change of the normal force by slip. The critical friction coefficient is
the least value of t·At / |w·t| over unit vectors t of the tangent plane (derived in
`docs/theory.md`). In two dimensions it is Klarbring's k_T / |w|.

Take t = (cos θ, sin θ) in axes along and across w, and τ = tan θ. With [[a, b], [b, c]], the
symmetric part of A, the function is (a + 2 b τ + c τ²) / (|w| sqrt(1 + τ²)). It is stationary where
c τ³ + (2 c - a) τ + 2 b = 0.

A. Klarbring, Examples of non-uniqueness and non-existence of solutions to quasistatic contact
problems with friction, Ingenieur-Archiv 60 (1990) 529-541. P. Hild, Non-unique slipping in the
Coulomb friction model in two-dimensional linear elasticity, Q. J. Mech. Appl. Math. 57 (2004).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from mpi4py import MPI

import numpy as np

from app.foundation.arrays import Floats
from app.foundation.errors import ConvergenceError
from app.foundation.verdict import Reason, Severity, Verdict
from app.mechanics.contact import ContactInterfaces, TrialState
from app.mechanics.problem import Problem
from app.numerics.newton import ActiveSet, NewtonResult, Solver
from app.soundness import loose_bodies
from app.system.layout import point_text


def critical_friction(stiffness: Floats, normals: Floats) -> Floats:
    """Friction coefficient from which on a point may have several equilibria or none.

    Args:
        stiffness: Stiffness against a jump of each point, positive definite (n, 3, 3).
        normals: Unit normals (n, 3).

    Returns:
        Critical coefficients (n,); infinite where slip does not change the normal force.
    """
    n = normals
    row = np.einsum("pi,pij->pj", n, stiffness)
    w = row - np.einsum("pi,pi->p", row, n)[:, None] * n
    size = np.linalg.norm(w, axis=1)
    bound = np.linalg.norm(row, axis=1)
    coupled = size > np.finfo(float).eps * bound
    critical = np.full(len(n), np.inf)
    K, n, w, size = stiffness[coupled], n[coupled], w[coupled], size[coupled]
    coupled_direction = w / size[:, None]
    transverse = np.cross(n, coupled_direction)
    a = np.einsum("pi,pij,pj->p", coupled_direction, K, coupled_direction)
    b = np.einsum("pi,pij,pj->p", coupled_direction, (K + K.transpose(0, 2, 1)) / 2, transverse)
    c = np.einsum("pi,pij,pj->p", transverse, K, transverse)
    companion = np.zeros((len(n), 3, 3))
    companion[:, 1, 0] = companion[:, 2, 1] = 1
    companion[:, 0, 2] = -2 * b / c
    companion[:, 1, 2] = -(2 * c - a) / c
    # The real part of a complex root is another direction, and its value is no smaller.
    τ = np.linalg.eigvals(companion).real
    value = (a[:, None] + 2 * b[:, None] * τ + c[:, None] * τ**2) / np.sqrt(1 + τ**2)
    critical[coupled] = value.min(axis=1) / size
    return critical


def critical_friction_of_points(contact: ContactInterfaces) -> Floats:
    """Least critical coefficient of the faces of each local point with all others fixed (n,).

    The estimate is local and on the safe side: it fixes the bodies around a point. The exact
    stiffness, of a point in bodies that deform, takes a solve for each point. With it the least
    coefficient is 20 to 85 % larger on coarsened shipped cases. Friction below the critical
    coefficient is necessary for uniqueness, not sufficient.
    """
    stiffness = contact.coupling.local_stiffness()
    # A point cannot move in directions that supports hold: they are stiff and uncoupled.
    free_projector = np.eye(3) - contact.local.projector
    stiffness = free_projector @ stiffness @ free_projector
    stiffness += np.trace(stiffness, axis1=1, axis2=2)[:, None, None] * contact.local.projector
    critical = np.full(len(contact.local), np.inf)
    for k in range(contact.local.normals.shape[1]):
        has_face = contact.local.faces > k
        critical[has_face] = np.minimum(
            critical[has_face],
            critical_friction(stiffness[has_face], contact.local.normals[has_face, k]),
        )
    return critical


def beyond_critical(problem: Problem) -> tuple[dict[str, float], list[Verdict]]:
    """Least critical coefficient of each frictional interface, and warnings; collective."""
    coefficients: dict[str, float] = {}
    warnings: list[Verdict] = []
    contact = problem.contact
    if contact is None:
        return coefficients, warnings
    critical = critical_friction_of_points(contact)
    for i, term in enumerate(problem.scene.contacts):
        at_interface = np.flatnonzero(contact.local.interface == i)
        k = at_interface[np.argmin(critical[at_interface])] if len(at_interface) else 0
        local_smallest = (
            (float(critical[k]), tuple(contact.local.x[k])) if len(at_interface) else (np.inf, ())
        )
        smallest, x = min(problem.comm.allgather(local_smallest))
        points_beyond = int((critical[at_interface] < term.law.largest_friction).sum())
        points_beyond = problem.comm.allreduce(points_beyond, MPI.SUM)
        if term.law.largest_friction == 0 or not np.isfinite(smallest):
            continue
        coefficients[term.name] = smallest
        if points_beyond:
            message = (
                f"friction coefficient {term.law.largest_friction:g} exceeds the critical value at"
                f" {points_beyond} "
                f"points (smallest {smallest:.3g}, at {point_text(x)}): solutions may not be "
                "unique there"
            )
            location = f"interface '{term.name}'"
            warning = Verdict(message, location, severity=Severity.WARNING, code=Reason.NOT_UNIQUE)
            warnings.append(warning)
    return coefficients, warnings


# Why a solve failed


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
AT_REST = (
    "check the supports and the direction of the loads, or refine the mesh at the interface; "
    "without gaps a smaller first load fails in the same way"
)
BREAKS = (
    "use `fracture_step` in the stage, or prescribe a displacement instead of the load; a cohesive "
    "interface breaks, and past the peak load only smaller loads are in equilibrium"
)
FAR = "use stiffer foundations, add a support, or reduce the load"


@dataclass(frozen=True)
class Explanation:
    """Verdicts on a solve that failed.

    Attributes:
        outcome: The failed solve.
        cause: Its cause, without the stage.
        others: Verdicts on friction, on the largest residual, and on points that change state.
        free: True if nothing holds a body: smaller steps fail too.
    """

    outcome: NewtonResult
    cause: Verdict
    others: Sequence[Verdict] = ()
    free: bool = False

    def error(
        self, stage: str, reached_fraction: float, steps: Sequence[float]
    ) -> ConvergenceError:
        """Return the error of the failed solve.

        Args:
            stage: Name of the stage.
            reached_fraction: Fraction of the stage at which the solve failed.
            steps: Lengths of the failed steps, as fractions of the stage.
        """
        place = f"no convergence in stage '{stage}' at {100 * reached_fraction:.3g} % of it"
        residuals = ", ".join(f"{r:.1e}" for r in self.outcome.residuals[-6:])
        return ConvergenceError(
            [
                replace(self.cause, where=place),
                *self.others,
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


def explain(
    problem: Problem, solver: Solver, outcome: NewtonResult, scales: bool = False
) -> Explanation:
    """Explain the failure of the last solve; collective.

    Args:
        problem: The problem.
        solver: Its solver, with the state that failed.
        outcome: The outcome of the solve.
        scales: True if the solve began at rest and fails alike under any part of the load.
    """
    u, q = solver.u_and_q(solver.failed_state)
    if q is None:
        remedy = AT_REST if scales else SMALLER
        return Explanation(outcome, Verdict(_residuals(outcome), remedy=remedy))
    trial, first_trial = problem.trial(u, q), problem.trial(*solver.u_and_q(solver.first_state))
    contact = trial.contact
    dissipates = contact.laws.law_dissipates
    energy = sum(
        float(t.forces.outputs["dissipated"][dissipates].sum()) for t in (trial, first_trial)
    )
    breaks = bool(contact.laws.internal_variables and problem.comm.allreduce(energy, MPI.SUM) > 0)
    loose_texts: list[str] = []
    # A body whose cohesive interface breaks in this step is not free.
    if not breaks:
        loose_texts = pulled_off = loose_bodies.pulled_off(problem, contact)
        if not scales and not contact.finite_sliding:
            loose_texts = loose_bodies.pushed_freely(problem, trial)
        # A body is not free if iterates lose contact that the loads would close.
        if not loose_texts and (pulled_off or not problem.load_size or contact.is_apart()):
            loose_texts = loose_bodies.free_bodies(problem, trial)
            loose_texts = loose_texts or loose_bodies.free_bodies(
                problem, first_trial
            )  # remedies may end in any state
    runaway_verdict = None
    has_run_away = solver.system.runs_away(solver.blocks(solver.failed_state))
    if not loose_texts and has_run_away and outcome.residuals[-1] < BALANCED:
        runaway_verdict = loose_bodies.runaway(problem, trial)
    friction = [] if loose_texts or runaway_verdict else loose_bodies.sliding(problem, contact)
    friction += beyond_critical(problem)[1]
    # The first hypothesis that holds is the cause.
    if loose_texts:
        cause = Verdict(loose_texts[0], remedy=loose_bodies.HOLD, code=Reason.LOOSE_BODY)
    elif runaway_verdict:
        cause = Verdict(runaway_verdict.what, remedy=FAR, code=Reason.LARGE_DISPLACEMENT)
    else:
        remedy = AT_REST if scales else SMALLER
        if breaks:
            remedy = BREAKS
        if friction:
            remedy += "; or change the friction, or add a support"
        cause = Verdict(_residuals(outcome), remedy=remedy)
    other_causes = [bare_verdict(text) for text in loose_texts[1:]]
    other_causes += friction
    other_causes += map(
        bare_verdict, [_largest(problem, trial), *_oscillating(problem, contact, solver.active)]
    )
    return Explanation(outcome, cause, other_causes, bool(loose_texts))


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

    The log reports each remedy when it is tried.
    """
    tried_text = "plain Newton only"
    if tried:
        best_remedy, residual = min(tried, key=lambda attempt: attempt[1])
        tried_text = (
            f"{len(tried)} remedies, of which the best ({best_remedy}) left a residual of "
            f"{residual:.1e}"
        )
    if steps:
        tried_text += f"; steps halved down to {min(steps):.3g} of the stage"
    return tried_text


def _state(status: int) -> str:
    return STATES[status] if status < len(STATES) else f"state {status}"


def _place(problem: Problem, contact: ContactInterfaces, row: int) -> str:
    name = problem.scene.contacts[contact.local.interface[row]].name
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
