"""Trends that the paper reports, judged by mantle's numbers and their errors.

A statement is undecided where its numbers differ by less than the sum of their errors, which are of
one mesh and not independent. The paper's numbers are peaks; mantle's peaks at edges have no error,
so that percentiles decide and peaks are given beside them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from app.report import paper
from app.report.sweep_results import INTERFACES, QUANTITIES, Number, SweptCase, named
from app.system.layout import plain

VERDICTS = CONFIRMED, NOT_CONFIRMED, UNDECIDED = "confirmed", "not confirmed", "undecided"
FLAT = 0.20  # relative spread up to which a number counts as constant
MUCH = 2.0  # factor that "drastically" is taken to mean at least
ROUNDING = 1e-6  # relative difference that is none
AT = {"stem": "{} stem", "thickness": "{} mm", "friction": "friction {}"}  # by parameter
NAMED = 3  # cases named of those in which a statement does not hold


@dataclass(frozen=True)
class Statement:
    """One statement of a trend: its verdict, and the numbers that decide it."""

    verdict: str
    text: str


@dataclass(frozen=True)
class Trend:
    """A trend that the paper reports.

    Attributes:
        name: ``T-a`` .. ``T-h``; of ``T-g`` with the model and the reading of "100 degrees".
        claim: The paper's statement.
        parts: Statements it consists of, by percentiles.
        peaks: The verdict by peaks, which have no errors; empty where there are none.
    """

    name: str
    claim: str
    parts: Sequence[Statement]
    peaks: str = ""

    @property
    def verdict(self) -> str:
        """Confirmed if all parts are; not confirmed if any is not."""
        return _all(self.parts)


def _all(parts: Iterable[Statement]) -> str:
    found = {p.verdict for p in parts} or {UNDECIDED}
    return next(v for v in (NOT_CONFIRMED, UNDECIDED, CONFIRMED) if v in found)


def exceeds(a: Number, b: Number, factor: float = 1.0) -> str:
    """Verdict on a > factor b."""
    difference = a.value - factor * b.value
    errors = (a.error or 0.0) + factor * (b.error or 0.0)
    if errors and abs(difference) <= errors:
        return UNDECIDED
    return CONFIRMED if difference > ROUNDING * abs(b.value) else NOT_CONFIRMED


def alike(a: Number, b: Number, tolerance: float) -> str:
    """Verdict on whether two numbers agree, up to a part of their mean."""
    allowed = tolerance * 0.5 * (abs(a.value) + abs(b.value))
    difference, errors = abs(a.value - b.value), (a.error or 0.0) + (b.error or 0.0)
    if difference + errors <= allowed or not allowed:
        return CONFIRMED
    return NOT_CONFIRMED if difference - errors > allowed else UNDECIDED


# Relations over a series of numbers: label, numbers by parameter, unit, name of the parameter.
Series = Mapping[Any, Number]
Relation = Callable[[str, Series, str, str], Statement]


def rises(label: str, values: Series, unit: str, over: str, up: bool = True) -> Statement:
    """Whether a number is larger, or else smaller, at the largest value of the parameter."""
    if len(values) < 2:
        return _missing(f"{label} at two values or more")
    low, high = min(values), max(values)
    a, b = values[low], values[high]
    text = f"{label} should {'rise' if up else 'fall'}: {a} {unit} at {_at(over, low)}, "
    return Statement(exceeds(*((b, a) if up else (a, b))), f"{text}{b} at {_at(over, high)}")


def constant(
    label: str, values: Series, unit: str, over: str, tolerance: float, beyond: float = 0.0
) -> Statement:
    """Whether numbers beyond a value of the parameter agree, up to a part of their mean."""
    values = {x: n for x, n in values.items() if not beyond or x > beyond}
    if len(values) < 2:
        return _missing(f"{label} at two values or more")
    low, high = (pick(values, key=lambda x: values[x].value) for pick in (min, max))
    a, b = values[low], values[high]
    spread = 2 * abs(b.value - a.value) / (abs(a.value) + abs(b.value) or 1.0)
    text = (
        f"{label}: {a} to {b} {unit} (at {_at(over, low)} and {_at(over, high)}), "
        f"spread {100 * spread:.2g} % (allowed {100 * tolerance:g} %)"
    )
    return Statement(alike(a, b, tolerance), text)


def far_more_when_thin(label: str, values: Series, unit: str, over: str) -> Statement:
    """Whether a number at 2 mm is `MUCH` larger than at 3 to 5 mm."""
    thicker = {t: n for t, n in values.items() if 3 <= t <= 5}
    if 2.0 not in values or not thicker:
        return _missing(f"{label} at 2 mm and thicker")
    t = max(thicker, key=lambda t: thicker[t].value)
    text = (
        f"{label}: {values[2.0]} {unit} at 2 mm, at most {thicker[t]} from 3 to 5 mm (at {t:g} mm; "
        f"asked: {MUCH:g} times)"
    )
    return Statement(exceeds(values[2.0], thicker[t], MUCH), text)


def above(label: str, pairs: Iterable[tuple[str, Number | None, Number | None]]) -> Statement:
    """Whether the first number exceeds the second in every case that has both."""
    found = {name: exceeds(a, b) for name, a, b in pairs if a and b}
    if not found:
        return _missing(label)
    text = f"{label}: in {sum(v == CONFIRMED for v in found.values())} of {len(found)} cases"
    if others := [name for name, v in found.items() if v != CONFIRMED]:
        more = f" and {len(others) - NAMED} more" if len(others) > NAMED else ""
        text += f"; not in {', '.join(others[:NAMED])}{more}"
    return Statement(_all(Statement(v, "") for v in found.values()), text)


def _at(over: str, value: object) -> str:
    return AT[over].format(plain(value))


def _missing(what: str) -> Statement:
    return Statement(UNDECIDED, f"no results of {what}")


# Claims over families of cases: name, the paper's words, parameter, and relations of quantities.
falls = partial(rises, up=False)
flat, flat_if_thick = partial(constant, tolerance=FLAT), partial(constant, tolerance=FLAT, beyond=3)
Row = tuple[Relation, str, str]
BONE, STEM = "cement_bone", "stem_cement"
CLAIMS: tuple[tuple[str, str, str, list[Row]], ...] = (
    (
        "T-a",
        "At the cement-bone interface the stem's material does not matter",
        "stem",
        [
            (partial(constant, tolerance=0.02), BONE, "slip"),
            (partial(constant, tolerance=0.05), BONE, "shear"),
        ],
    ),
    (
        "T-b",
        "A mantle of 2 mm slips and opens far more than one of 3 to 5 mm",
        "thickness",
        [(far_more_when_thin, BONE, "slip"), (far_more_when_thin, BONE, "gap")],
    ),
    (
        "T-c",
        "Stresses do not depend on the thickness beyond 3 mm",
        "thickness",
        [(flat_if_thick, place, q) for place in INTERFACES for q in ("pressure", "shear")],
    ),
    (
        "T-d",
        "The rougher the cement-bone interface, the less it slips, the more it opens and the "
        "higher its pressure; shear stays",
        "friction",
        [
            (falls, BONE, "slip"),
            (rises, BONE, "gap"),
            (rises, BONE, "pressure"),
            (flat, BONE, "shear"),
        ],
    ),
    (
        "T-e",
        "The rougher the cement-bone interface, the more the stem slips in the cement and the "
        "less it opens",
        "friction",
        [(rises, STEM, "slip"), (falls, STEM, "gap")],
    ),
)
# T-f: the first exceeds the second.
ORDER = (
    ((STEM, "pressure"), (BONE, "pressure")),
    ((STEM, "shear"), (BONE, "shear")),
    ((BONE, "pressure"), (BONE, "shear")),
    ((STEM, "pressure"), (STEM, "shear")),
)


def judge(cases: paper.Cases) -> list[Trend]:
    """All trends."""
    order = "Stem-cement stresses exceed cement-bone stresses; pressure exceeds shear"
    tension = (
        "Tension remains near the interfaces as the cement cools; where the interface is "
        "unilateral it can only be compression"
    )
    return [
        *(_trend(name, claim, _families, cases, over, rows) for name, claim, over, rows in CLAIMS),
        _trend("T-f", order, _order, cases),
        *_heat(cases),
        Trend("T-h", tension, _residual(cases)),
    ]


def _trend(name: str, claim: str, parts: Callable[..., list[Statement]], *of: Any) -> Trend:
    return Trend(name, claim, parts("percentile", *of), _all(parts("max", *of)))


def _families(how: str, cases: paper.Cases, over: str, rows: Sequence[Row]) -> list[Statement]:
    found = []
    for relation, place, quantity in rows:
        for stem in [""] if over == "stem" else paper.STEMS:
            label = f"{stem}, {_name(place, quantity)}".removeprefix(", ")
            family = cases.over(over, stem=stem)
            values = paper.series(family, paper.contact(place, quantity, how))
            found.append(relation(label, values, QUANTITIES[quantity][0], over))
    return found


def _order(how: str, cases: paper.Cases) -> list[Statement]:
    found = []
    for more, less in ORDER:
        a, b = (paper.contact(*of, how) for of in (more, less))
        label = f"{_name(*more)} above {_name(*less)}"
        found.append(above(label, ((c.name, a(c), b(c)) for c in cases.stances)))
    return found


def _name(place: str, quantity: str) -> str:
    return f"{named(place)} {named(quantity)}"


def _heat(cases: paper.Cases) -> list[Trend]:
    """T-g, for each reading of "100 degrees"."""
    claim = "Cement and cement-bone interface get hotter the thicker the mantle; cement is hottest"
    trends = []
    for (model, reading), family in cases.heats().items():
        peaks, bone = (paper.series(family, of) for of in (paper.cement_peak, paper.bone_peak))
        cement = rises("cement", peaks, "°C", "thickness")
        by_peak = rises("bone at the interface", bone, "°C", "thickness")
        known = paper.series(family, paper.bone_p99)  # where fields were written
        p99 = rises("bone at the interface, p99", known, "°C", "thickness")
        pairs = ((c.name, peaks.get(t), _hottest_beside(c)) for t, c in family.items())
        hottest = above("cement above all else after 10 s", pairs)
        parts = [cement, p99 if len(known) > 1 else by_peak, hottest]
        by_peaks = _all([cement, by_peak, hottest])
        trends.append(Trend(f"T-g ({model}, {reading})", claim, parts, by_peaks))
    return trends or [Trend("T-g", claim, [_missing("cement of 100 °C")])]


def _hottest_beside(case: SweptCase) -> Number | None:
    """Highest temperature outside the cement after ten seconds [degC]."""
    others = [r for r in case.summary.get("thermal", {}).get("regions", {}) if r != "cement"]
    known = [n for r in others if (n := paper.at_ten_seconds(case, r)) is not None]
    return max(known, key=lambda n: n.value) if known else None


def _residual(cases: paper.Cases) -> list[Statement]:
    """T-h."""
    parts: list[Statement] = []
    for kind, key, what in (
        ("bonded", "normal_max", "tension"),
        ("unilateral", "pressure_max", "compression"),
    ):
        known = len(parts)
        for place in INTERFACES:
            found = [n.value for c in cases.hot if (n := c.number(f"{place}.{key}"))]
            if found:
                low, high = min(found), max(found)
                text = f"{named(place)} {kind}: {what} of {low:.3g} to {high:.3g} MPa at most in "
                verdict = CONFIRMED if low > 0 else NOT_CONFIRMED
                parts.append(Statement(verdict, f"{text}{len(found)} case{'s' * (len(found) > 1)}"))
        if len(parts) == known:
            parts.append(_missing(f"a case that cools with a {kind} interface and mechanics"))
    return parts
