"""Mesh and order for an accuracy that is asked for (``output.accuracy``).

Cheap runs of both orders have their errors estimated. On cells of size h the error of a number is
taken as :math:`e(h_0) (h / h_0)^p`, with the order p of its class (`case.quantities`).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from app.case.case import Case
from app.case.quantities import TABLE
from app.results.error_estimate import Orders, is_zero, largest_of_units
from app.soundness import cost, memory
from app.system.layout import duration, percent

log = logging.getLogger("mantle")

FINER = 1.1  # ratio of the mesh sizes that are considered
# A run's memory over the least that is certain, and its time over that estimated, at most.
MEMORY, TIME = 1.5, 2.0
# Part of the largest number of the same unit that a smaller one counts as.
NEGLIGIBLE = 0.1


def shares(summary: Mapping[str, Any]) -> list[tuple[float, str, Orders]]:
    """Relative error, name and orders of each number that counts: the headlines of interfaces."""
    found = [
        (f"{name}.{key}", q.unit, q.order, abs(numbers[key]), numbers[f"{key}_error"])
        for name, numbers in summary["interfaces"].items()
        for key, q in TABLE["interfaces"].items()
        if q.headline and q.order and numbers.get(f"{key}_error") is not None
    ]
    largest = largest_of_units(dict(summary))
    found = [row for row in found if not is_zero(row[3], row[4], largest[row[1]])]
    sizes = [max(value, NEGLIGIBLE * largest[unit]) for _, unit, _, value, _ in found]
    return [(e / size, n, p) for (n, _, p, _, e), size in zip(found, sizes, strict=True) if size]


def choose(case: Case, solve: Callable[[Case], Any], longest: float | None) -> tuple[Case, str]:
    """The case on the mesh that is accurate enough in the least time, and why; collective.

    ``solve`` returns the numbers of a case with their errors. Cheap runs begin at twice the mesh
    size, as far as that can be meshed. The run may take ``longest`` [s].
    """
    asked, choices = case.output.accuracy or 0.0, list[tuple[float, float, str, Case]]()
    start = max(case.mesh.size, min(2 * case.mesh.size, case.geometry.coarsest_size / 2))
    for order in (2, 1):
        size, choice = start, None
        while choice is None or choice[3].mesh.size < size:
            now, limit = _on(case, size, order), ""
            known = [(e, p[order - 1]) for e, _, p in shares(solve(now))]
            while (error := _largest(known, now.mesh.size / size)) > asked and not limit:
                finer = _on(now, float(f"{now.mesh.size / FINER:.2g}"), order)
                if MEMORY * memory.needed(finer) > (available := memory.available()):
                    limit = f"; {available / memory.GIGABYTE:.3g} GB of memory allow no finer"
                elif longest and TIME * cost.seconds(finer) > longest:
                    limit = f"; a walltime of {duration(longest)} allows no finer"
                else:
                    now = finer
            told = f"{percent(error)} expected, about {duration(cost.seconds(now))}{limit}"
            told = f"{percent(asked)} asked for: {now.mesh.size:g} mm at order {order} ({told})"
            log.info("accuracy: %s, by a run on %g mm", told, size)
            choice = (max(error, asked), cost.seconds(now), told, now)
            if choices and choice > choices[0]:
                break
            size *= 0.5  # errors are extrapolated over a factor of two
        choices.append(choice)
    *_, told, best = min(choices)
    return best, told


def _largest(known: Sequence[tuple[float, float]], finer: float) -> float:
    """Largest of errors with their orders, on cells whose size is multiplied."""
    return max((error * finer**p for error, p in known), default=0.0)


def _on(case: Case, size: float, order: int) -> Case:
    """The case with errors, on cells of another size and order."""
    changed = {"size": size, "order": order, "curved": case.mesh.curved if order > 1 else None}
    mesh = case.mesh.coarser(size / case.mesh.size).model_copy(update=changed)
    output = case.output.model_copy(update={"accuracy": None, "error": True})
    return case.model_copy(update={"mesh": mesh, "output": output})


def reached(chosen: str, summary: Mapping[str, Any]) -> str:
    """A sentence on what was asked for, chosen and reached."""
    found = shares(summary)
    if not found:
        return f"accuracy: {chosen}; what was reached is unknown"
    error, worst, _ = max(found)
    counted = ", ".join(dict.fromkeys(name.partition(".")[2] for _, name, _ in found))
    return f"accuracy: {chosen}; {percent(error)} reached, by {worst}, the least sure of {counted}"
