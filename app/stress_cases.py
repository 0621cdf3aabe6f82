"""The rows of ``mantle stress``: what is tried, and what must hold."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from app import stress_judges as judges
from app.stress_case import Trial, Wanted, trial
from app.stress_extremes import extremes
from app.stress_invariants import invariants
from app.verify_heat import heat_problems


def trials(full: bool = False) -> list[Trial]:
    """All cases.

    Args:
        full: Whether those too that take long or add little.
    """
    return [*extremes(full), *invariants(full), *_heat()]


def _heat() -> Iterator[Trial]:
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
