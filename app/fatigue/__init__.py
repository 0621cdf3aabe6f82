"""Strength and fatigue of cement: failure at its largest flaw, and the damage of a year.

`laws` has the keys and the formulas, `risk` evaluates them on the stresses of a run, `findings` has
the faults, notes and verdicts. Importing the package registers it; the core does not know it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from app.case.case import Case
from app.case.quantities import RISK, STRESS, NumberSection, Quantity, add_quantity, add_section
from app.fatigue import findings as findings  # registers its checks
from app.fatigue.laws import Fatigue, Weibull, fatigue_of, weibull_of
from app.laws.materials import Elastic
from app.results.records import Followed, add_record
from app.scene.path_fields import PathField, path_fields
from app.schema.section import add_key

if TYPE_CHECKING:
    from app.fatigue.risk import CementRisk

add_key(Case, "fatigue", Fatigue, "Damage by a spectrum of activities; by default none.")
add_key(
    Elastic,
    "weibull",
    Weibull,
    "Strength of specimens, for the probability that the region fails.",
)


def _risk(case: Case, mechanics: Followed) -> CementRisk | None:
    """The record of a run, or None if nothing in its case tires or has a strength."""
    if not (fatigue_of(case) or weibull_of(case)):
        return None
    from app.fatigue.risk import CementRisk  # starts MPI

    zones = mechanics.zones
    return CementRisk(case, mechanics.problem, zones.borders if zones else None)


def _laws(case: Case) -> Iterable[str]:
    """Names of the S-N laws, by which damage is published."""
    fatigue = fatigue_of(case)
    return fatigue.laws if fatigue else ()


@path_fields
def _damage(case: Case) -> Iterable[PathField]:
    """Damage in a year by each S-N law, along paths."""
    for name in _laws(case):
        yield PathField(f"damage_{name}", f"damage in a year, {name}", "1/year", by_cell=True)


add_record("risk", _risk)
add_quantity(
    Quantity("regions", "failure_risk", "-", digits=4, order=RISK, peak=True, headline=True),
    Quantity("regions", "failure_probability", "-", "%", order=RISK),
)
add_section(
    NumberSection(
        name="fatigue",
        title="Fatigue: damage in a year",
        columns={
            "damage in a year": "",
            "p99": "damage_p99",
            "largest": "damage_max",
            "stress p99": "stress_p99",
        },
        owners=_laws,
        leads=True,
    ),
    Quantity(
        "fatigue",
        "damage_p99",
        "1/year",
        digits=4,
        label="damage, p99",
        order=RISK,
        headline=True,
    ),
    Quantity("fatigue", "damage_max", "1/year", digits=4, label="damage, max", peak=True),
    Quantity("fatigue", "stress_p99", "MPa", label="equivalent stress, p99", order=STRESS),
)
