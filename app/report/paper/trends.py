"""Trends that the paper reports, judged with mantle's numbers and their errors.

A statement is undecided where its numbers differ by less than their errors, which are added: they
are of one mesh and not independent. The paper's numbers are peaks; mantle's peaks at edges have no
error, so that 99th percentiles decide and peaks are given beside them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from app.report.paper.cases import (
    INTERFACES,
    QUANTITIES,
    STEMS,
    WORDS,
    Cases,
    contact,
    series,
)
from app.report.paper.heat import at_ten_seconds, bone_p99, bone_peak, cement_peak
from app.report.sweep_results import Number, SweptCase

VERDICTS = CONFIRMED, NOT_CONFIRMED, UNDECIDED = "confirmed", "not confirmed", "undecided"
SLIP_LIKE, SHEAR_LIKE = 0.02, 0.05  # how alike the paper's two stems are
FLAT = 0.20  # relative spread up to which a number counts as constant
MUCH = 2.0  # factor that "drastically" is taken to mean at least
ROUNDING = 1e-6  # relative difference that is none


@dataclass(frozen=True)
class Part:
    """One statement of a trend.

    Attributes:
        verdict: confirmed, not confirmed or undecided.
        text: The numbers that decide it.
    """

    verdict: str
    text: str


@dataclass(frozen=True)
class Trend:
    """A trend that the paper reports.

    Attributes:
        name: ``T-a`` .. ``T-h``; of ``T-g`` with the model and the reading of "100 degrees".
        claim: What the paper says.
        parts: The statements it consists of, by percentiles.
        peaks: The verdict by peaks, which have no errors; empty where there are none.
    """

    name: str
    claim: str
    parts: Sequence[Part]
    peaks: str

    @property
    def verdict(self) -> str:
        """Confirmed if all parts are; not confirmed if any is not."""
        return _all(p.verdict for p in self.parts)


def _all(verdicts: Iterable[str]) -> str:
    found = set(verdicts)
    return next(
        (v for v in (NOT_CONFIRMED, UNDECIDED) if v in found), CONFIRMED if found else UNDECIDED
    )


def exceeds(a: Number, b: Number, factor: float = 1.0) -> str:
    """Whether a > factor b."""
    difference = a.value - factor * b.value
    errors = (a.error or 0.0) + factor * (b.error or 0.0)
    if abs(difference) <= ROUNDING * abs(b.value):
        return UNDECIDED if errors > abs(difference) else NOT_CONFIRMED
    if abs(difference) <= errors:
        return UNDECIDED
    return CONFIRMED if difference > 0 else NOT_CONFIRMED


def alike(a: Number, b: Number, tolerance: float) -> str:
    """Whether two numbers differ by no more than a part of their mean."""
    mean = 0.5 * (abs(a.value) + abs(b.value))
    if mean == 0.0:
        return CONFIRMED
    difference = abs(a.value - b.value) / mean
    errors = ((a.error or 0.0) + (b.error or 0.0)) / mean
    if difference + errors <= tolerance:
        return CONFIRMED
    return NOT_CONFIRMED if difference - errors > tolerance else UNDECIDED


def judge(cases: Cases) -> list[Trend]:
    """All trends."""
    return [
        *(
            Trend(name, claim, of(cases, "percentile"), _all(p.verdict for p in of(cases, "max")))
            for name, claim, of in _MECHANICAL
        ),
        *_heat(cases),
        Trend(
            "T-h",
            "Tension remains near the interfaces as the cement cools; where the interface is "
            "unilateral it can only be compression",
            _residual(cases),
            "",
        ),
    ]


def _name(place: str, quantity: str) -> str:
    return f"{WORDS[place]} {WORDS[quantity]}"


def _unit(quantity: str) -> str:
    return QUANTITIES[quantity][0]


def _missing(what: str) -> Part:
    return Part(UNDECIDED, f"no results of {what}")


def _stems(cases: Cases, how: str) -> list[Part]:
    """T-a."""
    parts = []
    for quantity, tolerance in (("slip", SLIP_LIKE), ("shear", SHEAR_LIKE)):
        of = contact("cement_bone", quantity, how)
        found = [series(cases.stances(stem), of).get(4.0) for stem in STEMS.values()]
        a, b = found
        if a is None or b is None:
            parts.append(_missing(f"both stems at 4 mm ({WORDS[quantity]})"))
            continue
        apart = 2 * abs(a.value - b.value) / (abs(a.value) + abs(b.value) or 1.0)
        text = (
            f"{_name('cement_bone', quantity)}: titanium {a}, CoCr {b} {_unit(quantity)}, "
            f"{100 * apart:.2g} % apart (allowed {100 * tolerance:g} %)"
        )
        parts.append(Part(alike(a, b, tolerance), text))
    return parts


def _thin(cases: Cases, how: str) -> list[Part]:
    """T-b."""
    parts = []
    for stem in STEMS.values():
        for quantity in ("slip", "gap"):
            values = series(cases.stances(stem), contact("cement_bone", quantity, how))
            thicker = {t: n for t, n in values.items() if 3 <= t <= 5}
            if 2.0 not in values or not thicker:
                parts.append(_missing(f"{stem} at 2 mm and thicker ({WORDS[quantity]})"))
                continue
            t = max(thicker, key=lambda t: thicker[t].value)
            text = (
                f"{stem}, {_name('cement_bone', quantity)}: {values[2.0]} {_unit(quantity)} at "
                f"2 mm, at most {thicker[t]} from 3 to 5 mm (at {t:g} mm; asked: {MUCH:g} times)"
            )
            parts.append(Part(exceeds(values[2.0], thicker[t], MUCH), text))
    return parts


def _flat(cases: Cases, how: str) -> list[Part]:
    """T-c."""
    parts = []
    for stem in STEMS.values():
        for place in INTERFACES:
            for quantity in ("pressure", "shear"):
                values = series(cases.stances(stem), contact(place, quantity, how))
                thick = {t: n for t, n in values.items() if t > 3}
                label = f"{stem}, {_name(place, quantity)}"
                parts.append(_constant(label, thick, quantity, "mm"))
    return parts


def _constant(label: str, values: dict[float, Number], quantity: str, unit: str) -> Part:
    """Whether a number stays within `FLAT`."""
    if len(values) < 2:
        return _missing(f"{label} at two values or more")
    low = min(values, key=lambda x: values[x].value)
    high = max(values, key=lambda x: values[x].value)
    a, b = values[low], values[high]
    spread = 2 * abs(b.value - a.value) / (abs(a.value) + abs(b.value) or 1.0)
    unit = f" {unit}".rstrip()
    text = (
        f"{label}: {a} to {b} {_unit(quantity)} (at {low:g} and {high:g}{unit}), spread "
        f"{100 * spread:.2g} % (allowed {100 * FLAT:g} %)"
    )
    return Part(alike(a, b, FLAT), text)


def _friction(cases: Cases, how: str) -> list[Part]:
    """T-d."""
    parts = []
    for stem in STEMS.values():
        for quantity, rises in (("slip", False), ("gap", True), ("pressure", True)):
            values = series(cases.frictions(stem), contact("cement_bone", quantity, how))
            parts.append(
                _ends(f"{stem}, {_name('cement_bone', quantity)}", values, quantity, rises)
            )
        values = series(cases.frictions(stem), contact("cement_bone", "shear", how))
        parts.append(_constant(f"{stem}, {_name('cement_bone', 'shear')}", values, "shear", ""))
    return parts


def _ends(label: str, values: dict[float, Number], quantity: str, rises: bool) -> Part:
    """Whether a number rises, or falls, from the smallest to the largest friction."""
    if len(values) < 2:
        return _missing(f"{label} at two frictions or more")
    low, high = min(values), max(values)
    a, b = values[low], values[high]
    text = (
        f"{label} should {'rise' if rises else 'fall'}: {a} {_unit(quantity)} at friction {low:g}, "
        f"{b} at {high:g}"
    )
    return Part(exceeds(b, a) if rises else exceeds(a, b), text)


def _stem_friction(cases: Cases, how: str) -> list[Part]:
    """T-e."""
    return [
        _ends(
            f"{stem}, {_name('stem_cement', quantity)}",
            series(cases.frictions(stem), contact("stem_cement", quantity, how)),
            quantity,
            rises,
        )
        for stem in STEMS.values()
        for quantity, rises in (("slip", True), ("gap", False))
    ]


def _order(cases: Cases, how: str) -> list[Part]:
    """T-f."""
    stances = [k.case for k in cases.of("stance")]
    pairs = [
        *((("stem_cement", q), ("cement_bone", q)) for q in ("pressure", "shear")),
        *(((place, "pressure"), (place, "shear")) for place in INTERFACES),
    ]
    parts = []
    for more, less in pairs:
        found: dict[str, str] = {}
        for case in stances:
            a, b = contact(*more, how)(case), contact(*less, how)(case)
            if a is not None and b is not None:
                found[case.name] = exceeds(a, b)
        label = f"{_name(*more)} above {_name(*less)}"
        if not found:
            parts.append(_missing(label))
            continue
        text = f"{label}: in {sum(v == CONFIRMED for v in found.values())} of {len(found)} cases"
        others = [name for name, v in found.items() if v != CONFIRMED]
        if others:
            more_of = f" and {len(others) - 3} more" if len(others) > 3 else ""
            text += f"; not in {', '.join(others[:3])}{more_of}"
        parts.append(Part(_all(found.values()), text))
    return parts


def _heat(cases: Cases) -> list[Trend]:
    """T-g, for each reading of "100 degrees"."""
    claim = "Cement and cement-bone interface get hotter the thicker the mantle; cement is hottest"
    heats = cases.heats()
    if not heats:
        return [Trend("T-g", claim, [_missing("cement of 100 °C")], "")]
    trends = []
    for (model, reading), family in heats.items():

        def hottest(case: SweptCase, reading: str = reading) -> Number | None:
            return cement_peak(case, reading)

        def typical(case: SweptCase, reading: str = reading) -> Number | None:
            return bone_p99(case, reading)

        cement = _warmer("cement", series(family, hottest))
        first = _cement_first(family, reading)
        by_peak = _warmer("bone at the interface", series(family, bone_peak))
        peaks = _all(p.verdict for p in (cement, by_peak, first))
        known = series(family, typical)  # where fields were written
        bone = _warmer("bone at the interface, p99", known) if len(known) > 1 else by_peak
        trends.append(Trend(f"T-g ({model}, {reading})", claim, [cement, bone, first], peaks))
    return trends


def _warmer(label: str, values: dict[float, Number]) -> Part:
    """Whether a temperature rises with the thickness."""
    if len(values) < 2:
        return _missing(f"{label} at two thicknesses or more")
    low, high = min(values), max(values)
    text = f"{label}: {values[low]} °C at {low:g} mm, {values[high]} °C at {high:g} mm"
    return Part(exceeds(values[high], values[low]), text)


def _cement_first(family: dict[float, SweptCase], reading: str) -> Part:
    """Whether nothing is as hot as the cement."""
    found = {}
    for t, case in family.items():
        cement = cement_peak(case, reading)
        others = [r for r in case.summary.get("thermal", {}).get("regions", {}) if r != "cement"]
        ends = [at_ten_seconds(case, r) for r in others]
        rest = [n for n in ends if n is not None]
        if cement is not None and rest:
            found[t] = exceeds(cement, max(rest, key=lambda n: n.value))
    if not found:
        return _missing("stem and bone beside the cement")
    count = sum(v == CONFIRMED for v in found.values())
    return Part(
        _all(found.values()), f"cement hottest of all after 10 s: in {count} of {len(found)}"
    )


def _residual(cases: Cases) -> list[Part]:
    """T-h."""
    hot = [k.case for k in cases.every if k.physics.model != "stance" and k.case.done]
    parts = []
    for place in INTERFACES:
        tension = [n.value for c in hot if (n := c.number(f"{place}.normal_max"))]
        if tension:
            verdict = CONFIRMED if min(tension) > 0 else NOT_CONFIRMED
            parts.append(Part(verdict, f"{WORDS[place]} bonded: tension of {_range(tension)}"))
    if not parts:
        parts.append(Part(UNDECIDED, "no case cools with a bonded interface and mechanics"))
    known = len(parts)
    for place in INTERFACES:
        pressure = [n.value for c in hot if (n := c.number(f"{place}.pressure_max"))]
        if pressure:
            verdict = CONFIRMED if min(pressure) > 0 else NOT_CONFIRMED
            text = f"{WORDS[place]} unilateral: compression of {_range(pressure)}"
            parts.append(Part(verdict, f"{text} (its law excludes tension)"))
    if len(parts) == known:
        parts.append(Part(UNDECIDED, "no case cools with a unilateral interface and mechanics"))
    return parts


def _range(peaks: Sequence[float]) -> str:
    """Largest values of some cases [MPa]."""
    low, high = min(peaks), max(peaks)
    several = f" to {high:.3g}" if len(peaks) > 1 else ""
    cases = f"{len(peaks)} case{'s' if len(peaks) > 1 else ''}"
    return f"{low:.3g}{several} MPa at most in {cases}"


_MECHANICAL: tuple[tuple[str, str, Callable[[Cases, str], list[Part]]], ...] = (
    ("T-a", "At the cement-bone interface the stem's material does not matter", _stems),
    ("T-b", "A mantle of 2 mm slips and opens far more than one of 3 to 5 mm", _thin),
    ("T-c", "Stresses do not depend on the thickness beyond 3 mm", _flat),
    (
        "T-d",
        "The rougher the cement-bone interface, the less it slips, the more it opens and the "
        "higher its pressure; shear stays",
        _friction,
    ),
    (
        "T-e",
        "The rougher the cement-bone interface, the more the stem slips in the cement and the "
        "less it opens",
        _stem_friction,
    ),
    ("T-f", "Stem-cement stresses exceed cement-bone stresses; pressure exceeds shear", _order),
)
