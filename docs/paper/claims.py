"""Trends that the paper reports, judged by mantle's numbers and their errors.

A statement is undecided where its numbers differ by less than the sum of their errors, which are of
one mesh and not independent. The paper's numbers are peaks; mantle's peaks at edges have no error,
so that percentiles decide and peaks are given beside them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

from app.case.number_text import Number
from app.foundation.layout import plain_text
from app.report.sweep_results import QUANTITIES, SweptCase, named
from docs.paper import cases as paper
from docs.paper.cases import Cases

AGREES = "agrees"
DIFFERS = "differs"
UNDECIDED = "undecided"
FLAT = 0.20  # relative spread up to which a number counts as constant
MUCH = 2.0  # factor that "drastically" is taken to mean at least
ROUNDING_OF_VALUES = 1e-6  # relative difference that is none
AT = {"stem": "{} stem", "thickness": "{} mm", "friction": "friction {}"}  # by parameter
MISSING = "no results of"


class Statement(NamedTuple):
    """One statement of a trend: its verdict, and the numbers that decide it."""

    verdict: str
    text: str


class Trend(NamedTuple):
    """A trend that the paper reports.

    Attributes:
        name: ``T-a`` .. ``T-h``; of ``T-g`` with the model and the reading of "100 degrees".
        parts: Statements it consists of, by percentiles.
        peaks: The verdict by peaks, which have no errors; empty where there are none.
        causes: Verdicts where something was varied that the paper does not tell, by its name.
    """

    name: str
    parts: Sequence[Statement]
    peaks: str = ""
    causes: Mapping[str, str] = {}

    @property
    def verdict(self) -> str:
        """Agrees if all parts do; differs if any does."""
        return _all(verdict for verdict, _ in self.parts)

    @property
    def tried(self) -> str:
        """Causes tried of a difference, each with its verdict; empty if there is none."""
        each = [f"{words} ({verdict})" for words, verdict in self.causes.items()]
        return ", ".join(each) if self.verdict == DIFFERS else ""


def _all(verdicts: Iterable[str]) -> str:
    distinct = {*verdicts} or {UNDECIDED}
    return next(v for v in (DIFFERS, UNDECIDED, AGREES) if v in distinct)


def exceeds(a: Number, b: Number, factor: float = 1.0) -> str:
    """Verdict on a > factor b."""
    difference = a.value - factor * b.value
    errors = (a.error or 0.0) + factor * (b.error or 0.0)
    if errors and abs(difference) <= errors:
        return UNDECIDED
    return AGREES if difference > ROUNDING_OF_VALUES * abs(b.value) else DIFFERS


def alike(a: Number, b: Number, tolerance: float) -> str:
    """Verdict on whether two numbers agree, up to a part of their mean."""
    allowed = tolerance * 0.5 * (abs(a.value) + abs(b.value))
    difference, errors = abs(a.value - b.value), (a.error or 0.0) + (b.error or 0.0)
    if difference + errors <= allowed or not allowed:
        return AGREES
    return DIFFERS if difference - errors > allowed else UNDECIDED


# Relations over a series of numbers: label, numbers by parameter, unit, name of the parameter.
Series = Mapping[Any, Number]
Relation = Callable[[str, Series, str, str], Statement]


def rises(label: str, values: Series, unit: str, over: str, up: bool = True) -> Statement:
    """Statement that a number is larger, or else smaller, at the largest value of the parameter."""
    if len(values) < 2:
        return _missing(f"{label} at two values or more")
    low, high = min(values), max(values)
    a, b = values[low], values[high]
    text = f"{label} should {'rise' if up else 'fall'}: {a} {unit} at {_at(over, low)}, "
    return Statement(exceeds(*((b, a) if up else (a, b))), f"{text}{b} at {_at(over, high)}")


def constant(
    label: str, values: Series, unit: str, over: str, tolerance: float, beyond: float = 0.0
) -> Statement:
    """Statement that numbers beyond a value of the parameter agree, up to a part of their mean."""
    values = {x: n for x, n in values.items() if not beyond or x > beyond}
    if len(values) < 2:
        return _missing(f"{label} at two values or more")
    low, high = (pick(values, key=lambda x: values[x].value) for pick in (min, max))
    text = f"{label}: {values[low]} to {values[high]} {unit} (at {_at(over, low)} and "
    text += f"{_at(over, high)}; allowed: {100 * tolerance:g} %)"
    return Statement(alike(values[low], values[high], tolerance), text)


def far_more_when_thin(label: str, values: Series, unit: str, over: str) -> Statement:
    """Statement that a number at 2 mm is `MUCH` larger than at 3 to 5 mm."""
    thicker = {t: n for t, n in values.items() if 3 <= t <= 5}
    if 2.0 not in values or not thicker:
        return _missing(f"{label} at 2 mm and thicker")
    most = max(thicker.values(), key=lambda n: n.value)
    text = f"{label}: {values[2.0]} {unit} at 2 mm, at most {most} from 3 to 5 mm (asked: {MUCH:g} "
    return Statement(exceeds(values[2.0], most, MUCH), f"{text}times)")


def above(label: str, pairs: Iterable[tuple[Number | None, Number | None]]) -> Statement:
    """Statement that the first number exceeds the second in every case that has both."""
    exceeding = [exceeds(a, b) for a, b in pairs if a and b]
    text = f"{label}: in {exceeding.count(AGREES)} of {len(exceeding)} cases"
    return Statement(_all(exceeding), text) if exceeding else _missing(label)


def _at(over: str, value: object) -> str:
    return AT[over].format(plain_text(value))


def _missing(what: str) -> Statement:
    return Statement(UNDECIDED, f"{MISSING} {what}")


CLAIMS = {
    "T-a": "At the cement-bone interface the stem's material does not matter",
    "T-b": "A mantle of 2 mm slips and opens far more than one of 3 to 5 mm",
    "T-c": "Stresses do not depend on the thickness beyond 3 mm",
    "T-d": "The rougher the cement-bone interface, the less it slips, the more it opens and the "
    "higher its pressure; shear stays",
    "T-e": "The rougher the cement-bone interface, the more the stem slips in the cement and the "
    "less it opens",
    "T-f": "Stem-cement stresses exceed cement-bone stresses; pressure exceeds shear",
    "T-g": "Cement and cement-bone interface get hotter the thicker the mantle; cement is hottest",
    "T-h": "Tension remains near the interfaces as the cement cools; where the interface is "
    "unilateral it can only be compression",
}
# The interfaces of the paper's cemented stem.
BONE = "cement_bone"
STEM = "stem_cement"
INTERFACES = (BONE, STEM)
falls, flat = partial(rises, up=False), partial(constant, tolerance=FLAT)
far, beyond = far_more_when_thin, partial(flat, beyond=3.0)
# T-a to T-e: a relation of a quantity of an interface over a parameter.
FAMILIES: tuple[tuple[str, str, Relation, str, str], ...] = (
    ("T-a", "stem", partial(constant, tolerance=0.02), BONE, "slip"),
    ("T-a", "stem", partial(constant, tolerance=0.05), BONE, "shear"),
    *(("T-b", "thickness", far, BONE, quantity) for quantity in ("slip", "gap")),
    *(("T-c", "thickness", beyond, on, of) for on in INTERFACES for of in ("pressure", "shear")),
    ("T-d", "friction", falls, BONE, "slip"),
    ("T-d", "friction", rises, BONE, "gap"),
    ("T-d", "friction", rises, BONE, "pressure"),
    ("T-d", "friction", flat, BONE, "shear"),
    ("T-e", "friction", rises, STEM, "slip"),
    ("T-e", "friction", falls, STEM, "gap"),
)
# T-f: the first exceeds the second.
ORDER = (
    ((STEM, "pressure"), (BONE, "pressure")),
    ((STEM, "shear"), (BONE, "shear")),
    ((BONE, "pressure"), (BONE, "shear")),
    ((STEM, "pressure"), (STEM, "shear")),
)


def judge(cases: Cases) -> list[Trend]:
    """All trends."""
    by_percentiles, by_maxima = (_contact(cases, how) for how in ("percentile", "max"))
    varied = {
        w: _contact(alternatives, "percentile")
        for w, alternatives in cases.causes.items()
        if alternatives.stances
    }
    contact = []
    for name, parts in by_percentiles.items():
        # What was tried with one stem leaves the statements on the other without results.
        known = {w: [p for p in of[name] if MISSING not in p.text] for w, of in varied.items()}
        causes = {words: _all(v for v, _ in of) for words, of in known.items()}
        contact.append(Trend(name, parts, _all(v for v, _ in by_maxima[name]), causes))
    readings = {
        words: _all(v for v, _ in _remaining([c for c in cases.hot if _reading(c) == reading]))
        for reading, words in paper.READINGS.items()
    }
    return [*contact, *_heat(cases), Trend("T-h", _remaining(cases.hot), causes=readings)]


def _contact(cases: Cases, how: str) -> dict[str, list[Statement]]:
    """T-a to T-f, by percentiles or by maxima."""
    statements: dict[str, list[Statement]] = {}
    for name, over, relation, place, quantity in FAMILIES:
        for stem in [""] if over == "stem" else paper.STEMS:
            label = f"{stem}, {_name(place, quantity)}".removeprefix(", ")
            numbers = paper.series(cases.over(over, stem=stem), paper.contact(place, quantity, how))
            statement = relation(label, numbers, QUANTITIES[quantity][0], over)
            statements.setdefault(name, []).append(statement)
    for more, less in ORDER:
        a, b = (paper.contact(*of, how) for of in (more, less))
        pairs = ((a(c), b(c)) for c in cases.stances)
        statements.setdefault("T-f", []).append(
            above(f"{_name(*more)} above {_name(*less)}", pairs)
        )
    return statements


def _name(place: str, quantity: str) -> str:
    return f"{named(place)} {named(quantity)}"


def _heat(cases: Cases) -> list[Trend]:
    """T-g, for each reading of "100 degrees", whose causes are the other readings."""
    trends = []
    for (model, reading), family in cases.heats().items():
        of = paper.cement_peak, paper.bone_peak, paper.bone_p99
        cement, bone, p99 = (paper.series(family, number) for number in of)
        hotter = rises("cement", cement, "°C", "thickness")
        by_peak = rises("bone at the interface", bone, "°C", "thickness")
        by_p99 = rises("bone at the interface, p99", p99, "°C", "thickness")
        pairs = ((cement.get(t), _hottest_beside(c)) for t, c in family.items())
        hottest = above("cement above all else after 10 s", pairs)
        # The percentile is known where fields were written.
        parts = [hotter, by_p99 if len(p99) > 1 else by_peak, hottest]
        peaks = _all(v for v, _ in (hotter, by_peak, hottest))
        trends.append(Trend(f"T-g ({model}, {reading})", parts, peaks))
    each = {t.name: t.verdict for t in trends}
    trends = [t._replace(causes={k: v for k, v in each.items() if k != t.name}) for t in trends]
    return trends or [Trend("T-g", [_missing("cement of 100 °C")])]


def _hottest_beside(case: SweptCase) -> Number | None:
    """Highest temperature outside the cement after ten seconds [degC]."""
    others = [r for r in case.summary.get("thermal", {}).get("regions", {}) if r != "cement"]
    known = [n for r in others if (n := paper.at_ten_seconds(case, r)) is not None]
    return max(known, key=lambda n: n.value) if known else None


def _reading(case: SweptCase) -> str:
    return str(paper.labels(case)["reading"])


def _remaining(cases: Sequence[SweptCase]) -> list[Statement]:
    """T-h: signs of normal tractions as the cement cools."""
    parts: list[Statement] = []
    signs = (("bonded", "normal_max", "tension"), ("unilateral", "pressure_max", "compression"))
    for kind, key, what in signs:
        known = {p: [n.value for c in cases if (n := c.number(f"{p}.{key}"))] for p in INTERFACES}
        for place, values in known.items():
            if values:
                text = (
                    f"{named(place)} {kind}: {what} of {min(values):.3g} to {max(values):.3g} MPa "
                )
                text += f"at most in {len(values)} cases"
                parts.append(Statement(AGREES if min(values) > 0 else DIFFERS, text))
        if not any(known.values()):
            parts.append(_missing(f"a case that cools with a {kind} interface and mechanics"))
    return parts
