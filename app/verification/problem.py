"""Verification problem: a case, one or more runs of it, and a measure of each.

Where the runs are a ladder of mesh sizes or time steps their order is fitted too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mantle import configs
from mantle.verification.measures import Measure, Sample

CASES = configs.FOLDER / "verification"


@dataclass(frozen=True)
class CheckRun:
    """One run of a problem.

    Attributes:
        overrides: Of its case, as after ``--set``.
        measure: How far off the run is.
        size: What goes to zero where the runs are a ladder, else 0.
    """

    overrides: tuple[str, ...]
    measure: Measure
    size: float = 0.0


@dataclass(frozen=True)
class Check:
    """A problem with a known answer.

    Attributes:
        name: Short name.
        quantity: What is compared, with its unit, and what its error is relative to.
        tolerance: Largest error of any run; of the last if they are a ladder.
        case: The case file, in `CASES`.
        points: Its runs; a ladder goes from coarse to fine.
        order: Order that theory gives; None where the runs are no ladder.
        direct: Measure of a problem that needs no run.
        rung: What a ladder makes smaller, with its unit.
    """

    name: str
    quantity: str
    tolerance: float
    case: str = ""
    points: tuple[CheckRun, ...] = ()
    order: float | None = None
    direct: Callable[[], Sample] | None = None
    rung: str = "mesh size (mm)"


def ladder(
    sizes: Sequence[float], overrides: Sequence[str], measure: Measure
) -> tuple[CheckRun, ...]:
    """Runs from coarse to fine; ``{}`` in an override stands for the size."""
    return tuple(CheckRun(tuple(o.format(h) for o in overrides), measure, h) for h in sizes)
