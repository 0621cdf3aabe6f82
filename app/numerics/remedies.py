"""A nonlinear solve, with remedies that are tried where Newton's method does not converge."""

from __future__ import annotations

import logging
import math
from collections.abc import Generator, Iterator
from contextlib import AbstractContextManager, closing

from petsc4py import PETSc

import numpy as np

from app.numerics.newton import REASONS, NewtonResult, Solver
from app.numerics.system import SolvedContact

log = logging.getLogger("mantle")

# Factors of the augmentation in the order of trial. Mostly it is too large, so small ones come
# first. True: Newton continues from the current state; False: from the start. None: the line search
# is switched instead.
AUGMENTATIONS = ((0.1, True), (0.01, True), None, (100.0, False), (0.1, False), (0.01, False), None)
# Factors of the default augmentation, tried last if the case sets another one.
DEFAULT_FACTORS = (1.0, 0.1, 0.01)
# Shares by which given pressures follow those of the state, in the order of trial. A smaller share
# serves pressures that do not settle; after a solve that fails no further share is tried. In
# `stress/stem.yaml`, where the critical friction coefficient is 1.4, a coefficient of 10 needs
# shares down to 0.25, and one of 1000 the smallest.
SHARES = (0.5, 0.25, 0.125, 0.0625, 0.03, 0.015)
# Given pressures have reached those of the state if they differ by less than this fraction [-].
SAME_PRESSURES = 1e-3
# Largest number of updates that do not halve this difference. Then the next share is tried.
MOST_UPDATES = 20
# A solution is refined with the default augmentation if its own is below this fraction of it [-].
SMALL_AUGMENTATION = 0.05


def solve(solver: Solver) -> NewtonResult:
    """Solve a system at its current time from the solver's current state; collective.

    If an error or a signal interrupts a remedy, line search, laws and augmentation are those of
    before. Contact blocks that a remedy has factorized stay so until a solve converges.
    """
    contact, augmentation = solver.system.contact, solver.augmentation
    try:
        return _solve_with_remedies(solver)
    except BaseException:
        solver.augmentation = augmentation
        if contact:
            contact.laws.scale_augmentation(augmentation)
        raise


def _solve_with_remedies(solver: Solver) -> NewtonResult:
    contact = solver.system.contact
    solver.system.impose(solver.blocks())
    solver.residuals, solver.changes = [], []
    if contact:
        contact.laws.scale_augmentation(solver.augmentation)
    runs: list[tuple[int, int]] = []
    start = solver.x.copy() if contact else solver.x
    if contact:
        with contact.remedies.freezing() as has_variables:
            if has_variables:
                runs.append(solver.run())
        if has_variables and not solver.converged:
            start.copy(solver.x)
    runs.append(solver.run())
    solver.x.copy(solver.first_state)
    tried: list[tuple[str, float]] = []
    with closing(remedies(solver, start)) as applied_remedies:
        for remedy in applied_remedies:
            if remedy:
                log.info("     %s: %s", failure_text(solver), remedy)
            runs.append(solver.run())
            if remedy:
                # A converged run that is not the last one solved a problem with switched contact.
                tried.append((remedy, math.inf if solver.converged else solver.residuals[-1]))
    augmentation = solver.augmentation
    if (
        contact
        and solver.converged
        and augmentation < SMALL_AUGMENTATION * contact.laws.factor_to_default_augmentation()
    ):
        augmentation, iterations = _refine(solver, contact)
        runs.append(iterations)
    if solver.converged and solver.system.remove_free_motions(solver.blocks()):
        runs.append(solver.run())
    if solver.converged:
        solver.linear.sweep_interfaces()
        measures = solver.measure(solver.x, solver.snes.getFunction()[0])
        solver.scales = [p.scale for p in measures]
    else:
        solver.x.copy(solver.failed_state)
        solver.augmentation = 1.0
        if contact:
            contact.laws.scale_augmentation(1.0)
    solver.linear.observe()
    newton, krylov = map(sum, zip(*runs, strict=True))
    return NewtonResult(
        converged=solver.converged,
        iterations=newton,
        linear_iterations=krylov,
        residuals=tuple(solver.residuals),
        changes=tuple(solver.changes),
        linear_failed=solver.snes.getConvergedReason() == REASONS.DIVERGED_LINEAR_SOLVE,
        augmentation=augmentation,
        tried=tuple(tried),
        period=solver.active.period(),
    )


def _refine(solver: Solver, contact: SolvedContact) -> tuple[float, tuple[int, int]]:
    """Solve again with the default augmentation.

    A residual f leaves errors f / r in gaps and slips, which are large where r is small. Only the
    laws get the default: the next solve begins again with `Solver.augmentation`, which stays.

    Returns:
        The augmentation of the solution; Newton and Krylov iterations.
    """
    coarse, iterations_before = solver.x.copy(), len(solver.residuals)
    default = contact.laws.factor_to_default_augmentation()
    contact.laws.scale_augmentation(default)
    log.info("     converged: refining with augmentation %.3g r, the default", default)
    iterations = solver.run()
    if solver.converged:
        return default, iterations
    coarse.copy(solver.x)
    contact.laws.scale_augmentation(solver.augmentation)
    del solver.residuals[iterations_before:], solver.changes[iterations_before:]
    solver.converged = True
    return solver.augmentation, iterations


def remedies(solver: Solver, start: PETSc.Vec) -> Generator[str]:
    """Apply one remedy after the other until Newton has converged; yield each in words.

    An empty text is a further run of the last remedy. It is neither logged nor recorded. Closing
    the generator undoes switches and the line search.

    1. Interfaces that have to close before a body is held are constrained, then released. A body
       with clearance, or one that touches along an edge only, thus comes into contact.
    2. All interfaces are opened, then closed where the bodies overlap. In plain Newton the border
       of an opening zone moves by one row of facets in each iteration.
    3. The contact block is factorized, as SOR may yield poor directions.
    4. Friction is limited by given pressures, which follow those of the state. Above the critical
       friction coefficient Newton's method changes the same few points back and forth.
    5. The augmentation is scaled. A large one makes contact points change state back and forth, so
       Newton continues from the current state with smaller ones. A larger one and two smaller ones
       begin at the start.
    6. The line search is switched on or off. At a kink of the contact law it may shorten steps to
       almost zero, although full steps converge.
    7. An augmentation set by the case, which may be wrong by powers of ten, is replaced by the
       default, then by smaller ones, and then the line search is switched again.
    """
    contact = solver.system.contact
    if contact:
        yield from _with_switched_interfaces(
            solver,
            start,
            contact.remedies.constraining(),
            "constraining open interfaces of bodies that nothing else holds",
            "releasing these interfaces",
        )
        yield from _with_switched_interfaces(
            solver,
            start,
            contact.remedies.opening(),
            "opening all interfaces",
            "closing interfaces where the open bodies overlap",
        )
    if not solver.converged and solver.linear.factor_interfaces():
        start.copy(solver.x)
        yield "factorizing the contact block"
    if contact is None:
        return
    if not solver.converged:
        yield from _with_tresca_friction(solver, start, contact)
    for remedy in AUGMENTATIONS:
        if solver.converged:
            return
        if remedy is None:
            yield from _with_other_search(solver)
            continue
        factor, continues = remedy
        if continues and cannot_continue(solver):
            continue
        if factor != solver.augmentation:
            contact.laws.scale_augmentation(factor)
            if not continues:
                start.copy(solver.x)
            solver.augmentation = factor
            yield f"augmentation {factor:g} r{_augmentation_text(contact)}"
    if solver.converged:
        return
    default = contact.laws.factor_to_default_augmentation()
    if default == 1.0:
        return
    start.copy(solver.x)
    for share in DEFAULT_FACTORS:
        if cannot_continue(solver):
            return
        solver.augmentation = share * default
        contact.laws.scale_augmentation(solver.augmentation)
        times = f"{share:g} times the default"
        yield f"augmentation {solver.augmentation:.3g} r, {times}{_augmentation_text(contact)}"
    yield from _with_other_search(solver)


def _with_switched_interfaces(
    solver: Solver,
    start: PETSc.Vec,
    switched: AbstractContextManager[bool],
    switched_remedy: str,
    usual_remedy: str,
) -> Iterator[str]:
    """Solve the changed problem from the start, undo the change, and solve the usual problem.

    Args:
        solver: The solver. If a body has run away, its state is the start again.
        start: The state from which to start.
        switched: Context in which interfaces are constrained or opened, if there are any.
        switched_remedy: Name of the remedy with switched interfaces.
        usual_remedy: Name of the remedy after that.
    """
    if solver.converged:
        return
    with switched as has_switched:
        if not has_switched:
            return
        start.copy(solver.x)
        yield switched_remedy
    if solver.system.runs_away(solver.blocks()):
        start.copy(solver.x)
    else:
        yield usual_remedy


def _with_tresca_friction(
    solver: Solver, start: PETSc.Vec, contact: SolvedContact
) -> Iterator[str]:
    """Solve from the start with friction under given pressures, then from there with Coulomb's.

    Where a solve under given pressures does not converge, the state is that before the remedy.
    """
    before = solver.x.copy()
    with contact.remedies.tresca_friction() as has_friction:
        if not has_friction:
            return
        start.copy(solver.x)
        yield "limiting friction by given pressures, which follow those of the state"
        yield from _following_pressures(solver, contact)
    if solver.converged:
        yield "limiting friction by the pressures of the state"
    else:
        before.copy(solver.x)


def _following_pressures(solver: Solver, contact: SolvedContact) -> Iterator[str]:
    """Let the given pressures follow those of the state until both are the same."""
    for share in SHARES:
        least, updates = math.inf, 0
        while updates < MOST_UPDATES and solver.converged:
            solver.residual(solver.x)  # sets the last trial forces
            difference = contact.remedies.relax_tresca_friction(share)
            if difference < SAME_PRESSURES:
                return
            yield ""
            updates += 1
            if difference < least / 2:
                least, updates = difference, 0


def _with_other_search(solver: Solver) -> Iterator[str]:
    """Continue with full steps instead of a line search, or with a search instead of full steps."""
    if not cannot_continue(solver):
        other_search = "basic" if solver.usual_search == "bt" else "bt"
        solver.use_search(other_search)
        try:
            yield "full Newton steps" if other_search == "basic" else "line search"
        finally:
            solver.use_search(solver.usual_search)


def cannot_continue(solver: Solver) -> bool:
    """Return True if there is nothing to continue: converged, not finite, or a body runs away."""
    if solver.converged or not np.isfinite(solver.x.norm()):
        return True
    return solver.system.runs_away(solver.blocks())


def failure_text(solver: Solver) -> str:
    """Last residual and iterations, in words."""
    if solver.converged:
        return "converged"
    changing = ""
    if solver.changes[-1]:
        changing = f"; {solver.changes[-1]} contact points still change state"
    period = solver.active.period()
    if period:
        changing += f", in a cycle of {period} iterations"
    return f"not converging (residual {solver.residuals[-1]:.1e}{changing})"


def _augmentation_text(contact: SolvedContact) -> str:
    values = contact.augmentation().values()
    return f" (up to {max(values):.3g} MPa/mm)" if values else ""
