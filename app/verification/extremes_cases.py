"""The rows of ``mantle stress``: what is tried, and what must hold."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from mantle.verification import judges
from mantle.verification.extremes_case import ExtremeCase, Wanted, trial
from mantle.verification.heat_problems import heat_problems
from mantle.verification.rows_of_extremes import extremes
from mantle.verification.rows_of_invariants import invariants


def trials(full: bool = False) -> list[ExtremeCase]:
    """All cases.

    Args:
        full: Whether those too that take long or add little.
    """
    return [*extremes(full), *invariants(full), *_heat()]


def _heat() -> Iterator[ExtremeCase]:
    """The stiff problems of `mantle verify`: conductances, time steps, jumps of temperature."""
    for p in heat_problems():
        if p.name.startswith("stiff_"):
            (point,) = p.points
            yield trial(
                "heat",
                "",
                p.name.removeprefix("stiff_").replace("_", " "),
                {"overrides": list(point.overrides)},
                Wanted(f"verification/{p.case}", point.overrides),
                partial(judges.verified, point=point),
                p.tolerance,
            )
