"""Auxiliary runs without run directories: for the errors of a run, and to choose its mesh.

For ``output.error`` the companions of a run (`results.error_estimate`) are solved by models that
share its meshes and matrices.

For ``output.accuracy`` the mesh and order are chosen. The errors of cheap runs of both orders are
estimated. On cells of size h the error of a number is taken as :math:`e(h_0) (h / h_0)^p`, with the
order p of its class (`case.error_classes`).
"""

from __future__ import annotations

import logging
import time as clock
from collections.abc import Callable, Sequence

from mpi4py import MPI

from app.case.case import Case
from app.case.error_classes import ByOrder
from app.case.quantities import label_and_unit
from app.case.summary import EstimatedErrors, Summary
from app.case.summary_numbers import main_numbers
from app.foundation.errors import ConvergenceError, StoppedError
from app.foundation.layout import duration, percent
from app.results import error_estimate
from app.results.error_estimate import Companion, is_zero, largest_of_units, reference_size
from app.simulation.model import Model
from app.soundness import cost, memory
from app.system.timing import Timing

log = logging.getLogger("mantle")

# Ratio of successive mesh sizes that are considered.
FINER = 1.1
# Largest memory use of a run over the estimate of its least memory.
MEMORY = 1.5
# Longest time of a run over the estimated time.
TIME = 2.0


def add_errors(
    summary: Summary, case: Case, companions: Sequence[Companion], model: Model
) -> EstimatedErrors:
    """Solve the companions of a run and add errors to the numbers of its summary; collective.

    A companion that cannot be solved is left out.

    Returns:
        Section ``error`` of the summary.

    Raises:
        StoppedError: A signal stopped a companion.
    """
    solved: list[tuple[Companion, Summary]] = []
    failed_companions: list[str] = []
    for companion in companions:
        start_time = clock.perf_counter()
        try:
            numbers, reason = model.numbers_or_reason(companion.case)
        except StoppedError as stop:
            raise StoppedError(f"{stop}, in its companions") from stop
        if numbers is None:
            log.warning("error estimate: the companion run on %s failed: %s", companion, reason)
            failed_companions.append(str(companion))
            continue
        solved.append((companion, numbers))
        seconds = clock.perf_counter() - start_time
        log.info("     error estimate: companion run on %s in %.1f s", companion, seconds)
    return {
        "companions": [str(companion) for companion, _ in solved],
        "share_within_error": error_estimate.SHARE_WITHIN_ERROR[case.mesh.order - 1],
        "sources": error_estimate.error_sources([companion for companion, _ in solved]),
        "failed": failed_companions,
        "unsettled": error_estimate.add_error_estimates(summary, case, solved),
    }


def numbers_with_errors(
    comm: MPI.Comm, options: dict[str, str], stop: Callable[[], str], case: Case
) -> Summary:
    """Solve a case and its companions; return its numbers with their errors; collective.

    Raises:
        ConvergenceError: The case or one of its companions cannot be solved.
    """
    model = Model(case, comm, options, Timing("choosing"), stop)
    numbers = model.numbers_of_companion(case)
    if add_errors(numbers, case, error_estimate.companions(case), model)["failed"]:
        raise ConvergenceError(
            "output.accuracy: errors of the cheap runs cannot be estimated; set mesh.size instead"
        )
    return numbers


def choose(
    comm: MPI.Comm, case: Case, solve: Callable[[Case], Summary], longest: float | None
) -> tuple[Case, str]:
    """The case on the mesh that is accurate enough in the least time, and why; collective.

    Cheap runs begin at twice the mesh size, if so coarse a mesh is possible.

    Args:
        comm: All ranks.
        case: The case.
        solve: Returns the numbers of a case with their errors.
        longest: Longest time of the run [s], if there is a limit.
    """
    target = case.output.accuracy or 0.0
    # The same on all ranks: machines may differ.
    available = comm.allreduce(memory.available_memory(), MPI.MIN)
    start = max(case.mesh.size, min(2 * case.mesh.size, case.geometry.coarsest_size / 2))
    # Error, time, reason and case of each choice.
    choices: list[tuple[float, float, str, Case]] = []
    for order in (2, 1):
        size = start
        choice = None
        while choice is None or choice[3].mesh.size < size:
            cheap = _on_mesh(case, size, order)
            errors = [(e, p[order - 1]) for e, _, p in relative_errors(solve(cheap))]
            error, chosen_case, limit_text = _coarsest_within(
                target, cheap, errors, longest, available
            )
            reason = (
                f"{percent(error)} expected, about"
                f" {duration(cost.estimated_seconds(chosen_case))}{limit_text}"
            )
            mesh = f"{chosen_case.mesh.size:g} mm at order {order}"
            reason = f"chosen for a target of {percent(target)}: {mesh} ({reason})"
            log.info("accuracy: %s, by a run on %g mm", reason, size)
            choice = (max(error, target), cost.estimated_seconds(chosen_case), reason, chosen_case)
            if choices and choice > choices[0]:
                break
            size *= 0.5  # errors are extrapolated over a factor of two
        choices.append(choice)
    *_, reason, chosen_case = min(choices)
    return chosen_case, reason


def _coarsest_within(
    target: float,
    cheap: Case,
    errors: Sequence[tuple[float, float]],
    longest: float | None,
    available: float,
) -> tuple[float, Case, str]:
    """Refine a case until it meets a target, as far as memory and time allow.

    Args:
        target: Relative error that is asked for.
        cheap: The case on the mesh that was solved.
        errors: Errors of its numbers with their orders.
        longest: Longest time [s], if there is a limit.
        available: Memory of a rank [byte].

    Returns:
        The largest expected error, the case, and the limit that stopped refinement, in words.
    """
    coarsest = cheap
    while True:
        finer = coarsest.mesh.size / cheap.mesh.size
        error = max((e * finer**p for e, p in errors), default=0.0)
        if error <= target:
            return error, coarsest, ""
        next_best = _on_mesh(
            coarsest, float(f"{coarsest.mesh.size / FINER:.2g}"), coarsest.mesh.order
        )
        if MEMORY * memory.needed(next_best) > available:
            limit_text = f"; {available / memory.GIGABYTE:.3g} GB of memory allow no finer mesh"
            return error, coarsest, limit_text
        if longest and TIME * cost.estimated_seconds(next_best) > longest:
            return error, coarsest, f"; a walltime of {duration(longest)} allows no finer mesh"
        coarsest = next_best


def _on_mesh(case: Case, size: float, order: int) -> Case:
    """The case with errors, on cells of another size and order."""
    curved = case.mesh.curved if order > 1 else None
    changed_keys = {"size": size, "order": order, "curved": curved}
    mesh = case.mesh.coarser(size / case.mesh.size).model_copy(update=changed_keys)
    output = case.output.model_copy(update={"accuracy": None, "error": True})
    return case.model_copy(update={"mesh": mesh, "output": output})


def relative_errors(summary: Summary) -> list[tuple[float, str, ByOrder]]:
    """Relative error, name and orders of each headline number of the interfaces."""
    largest = largest_of_units(summary)
    errors: list[tuple[float, str, ByOrder]] = []
    for name, q, value, error in main_numbers(summary):
        if q.section != "interfaces" or not q.order or error is None:
            continue
        size = reference_size(value, q, largest)
        if size and not is_zero(value, error, largest[q.unit]):
            errors.append((error / size, name, q.order))
    return errors


def reached_text(chosen: str, summary: Summary) -> str:
    """A sentence on the accuracy that was asked for, the chosen mesh, and the accuracy reached."""
    errors = relative_errors(summary)
    if not errors:
        return f"accuracy: {chosen}; the reached accuracy is unknown"
    error, worst_name, _ = max(errors)
    name_text, _ = label_and_unit(worst_name)
    return f"accuracy: {chosen}; {percent(error)} reached (largest error: {name_text})"
