"""The suites: lists of checks by the command that runs them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from app.verification.benchmarks import benchmarks
from app.verification.check import Check
from app.verification.extreme_cases import extremes
from app.verification.heat_problems import heat_problems
from app.verification.invariance_cases import invariants
from app.verification.problems import problems


def rows() -> list[Check]:
    """Checks of ``mantle stress``, with the stiff problems of ``mantle verify``."""
    stiff = [p for p in heat_problems() if p.group == "stiff"]
    heat = [replace(p, name=p.name.replace("stiff", "heat", 1), group="heat") for p in stiff]
    return [*extremes(), *invariants(), *heat]


SUITES: dict[str, Callable[[], list[Check]]] = {
    "verify": problems,
    "stress": rows,
    "bench": benchmarks,
}
