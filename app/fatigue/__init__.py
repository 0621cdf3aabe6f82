"""Strength and fatigue: cement at its largest flaw, damage of a year, bench tests of stems.

`laws` has the keys and the formulas. `risk` evaluates them on the stresses of a run, `potted_stem`
on those of a stem in resin. `findings` has the faults, notes and verdicts. Importing the package
registers it; the core does not know it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from app.case.case import Case
from app.case.error_classes import MOTION_ERRORS, RISK_ERRORS, STRESS_ERRORS
from app.case.quantities import NumberSection, Quantity, add_quantity, add_section
from app.fatigue import findings as findings  # registers its checks
from app.fatigue.laws import (
    Fatigue,
    StemTest,
    Weibull,
    fatigue_of,
    stem_test_of,
    weibull_of,
)
from app.laws.materials import Elastic
from app.results.records import RecordedModel, add_record
from app.scene.path_fields import PathField, path_fields
from app.schema.section import add_key

if TYPE_CHECKING:
    from app.fatigue.potted_stem import PottedStem
    from app.fatigue.risk import CementRisk

add_key(Case, "fatigue", Fatigue, "Damage by a spectrum of activities; by default none.")
add_key(Case, "stem_test", StemTest, "Bench test of a potted stem; by default none.")
add_key(
    Elastic,
    "weibull",
    Weibull,
    "Strength of specimens, for the probability that the region fails.",
)


def _risk(case: Case, mechanics: RecordedModel) -> CementRisk | None:
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


def _potted_stem(case: Case, followed: RecordedModel) -> PottedStem | None:
    """The record of a bench test, or None without one."""
    if stem_test_of(case) is None:
        return None
    from app.fatigue.potted_stem import PottedStem  # starts MPI

    return PottedStem(case, followed)


def _tested(case: Case) -> Iterable[str]:
    """Region of the stem that is tested."""
    test = stem_test_of(case)
    return [test.region] if test else ()


add_record("risk", _risk)
add_record("stem_test", _potted_stem)
add_quantity(
    Quantity(
        "regions",
        "failure_risk",
        "-",
        digits=4,
        label="Weibull's risk of rupture",
        error_class=RISK_ERRORS,
        peak=True,
        headline=True,
    ),
    Quantity(
        "regions",
        "failure_probability",
        "-",
        "%",
        label="probability of failure",
        error_class=RISK_ERRORS,
    ),
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
        error_class=RISK_ERRORS,
        headline=True,
    ),
    Quantity("fatigue", "damage_max", "1/year", digits=4, label="damage, max", peak=True),
    Quantity(
        "fatigue", "stress_p99", "MPa", label="equivalent stress, p99", error_class=STRESS_ERRORS
    ),
)
add_section(
    NumberSection(
        name="stem_test",
        title="Bench test of the stem",
        columns={
            "stem in resin": "",
            "stress at the resin": "level_stress",
            "tension above": "free_tension_p99",
            "deflection": "deflection",
        },
        owners=_tested,
        leads=True,
    ),
    Quantity(
        "stem_test",
        "level_stress",
        "MPa",
        digits=1,
        label="largest axial stress at the level of the resin",
        error_class=STRESS_ERRORS,
        headline=True,
    ),
    Quantity(
        "stem_test",
        "free_tension_p99",
        "MPa",
        digits=1,
        label="tension above the resin, p99",
        error_class=STRESS_ERRORS,
        headline=True,
    ),
    Quantity(
        "stem_test",
        "free_tension_max",
        "MPa",
        digits=1,
        label="tension above the resin, max",
        peak=True,
    ),
    Quantity(
        "stem_test",
        "deflection",
        "mm",
        digits=3,
        label="deflection of the head along the force",
        error_class=MOTION_ERRORS,
        headline=True,
    ),
    Quantity("stem_test", "life_median", "-", digits=0, label="cycles to failure, median"),
    Quantity("stem_test", "life_p05", "-", digits=0, label="cycles to failure, 5 % of the stems"),
    Quantity("stem_test", "failing", "-", "%", label="stems that fail within the test"),
)
