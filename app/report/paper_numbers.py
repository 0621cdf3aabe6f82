"""The paper's published numbers beside mantle's, and its figures 3 to 8 redrawn.

The numbers are in `paper_numbers.csv`; a remark says where they contradict themselves or each
other.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from app.case.quantities import numbers_of
from app.report import paper
from app.report.curves import Line, Panel, draw, in_words, too_few
from app.report.page import Figure
from app.report.paper import READINGS, REFERENCE, STEMS, Cases, labels
from app.report.sweep_results import INTERFACES, QUANTITIES, Number, SweptCase, named

# The paper's sliding may be slip in contact, or all relative motion of the sides.
READINGS_OF = {"slip": ("slip", "motion")}
BODY = 37.0  # degC


@dataclass(frozen=True)
class Fact:
    """A number that the paper reports.

    Attributes:
        model: ``stance`` or ``heat``.
        stem: Material of the stem.
        thickness: Of the mantle in mm: ``4``, ``2-3``, ``>7`` or empty.
        friction: Coefficient of the cement-bone interface; 0 if it does not matter.
        place: Interface or region; may be empty.
        unit: ``um``, ``MPa``, ``degC``.
        kind: peak, exceeded, not exceeded, extreme.
    """

    id: str
    model: str
    stem: str
    thickness: str
    friction: float
    place: str
    quantity: str
    unit: str
    value: float
    kind: str
    remark: str

    def matches(self, thickness: float) -> bool:
        """Whether it is about a mantle of a thickness [mm]."""
        if self.thickness.startswith(">"):
            return thickness > float(self.thickness[1:])
        return any(paper.same(thickness, float(t)) for t in self.thickness.split("-") if t)


@cache
def facts() -> list[Fact]:
    """Numbers that the paper reports; of both stems once for each."""
    with Path(__file__).with_name("paper_numbers.csv").open(encoding="utf-8", newline="") as file:
        rows: list[dict[str, Any]] = list(csv.DictReader(file))
    found = []
    for row in rows:
        numbers = {key: float(row[key] or 0.0) for key in ("friction", "value")}
        stems = STEMS if row["stem"] == "both" else [row["stem"]]
        found += [Fact(**row | numbers | {"stem": stem}) for stem in stems]
    return found


@dataclass(frozen=True)
class ComparedNumber:
    """A number of the paper beside mantle's.

    Attributes:
        thickness: Thickness of the mantle of mantle's case [mm].
        case: Its name; empty if there is none.
        peak: Mantle's largest value, in the paper's unit.
        number: The percentile; of temperatures the largest value, if its error is known.
        remark: Definition of mantle's number, or the reason for its absence.
        quantity: Mantle's quantity, where it is another reading of the paper's word.
    """

    fact: Fact
    thickness: float | None = None
    case: str = ""
    peak: float | None = None
    number: Number | None = None
    remark: str = ""
    quantity: str = ""

    @property
    def ratios(self) -> tuple[float | None, float | None]:
        """Mantle's peak and percentile over the paper's; None where meaningless.

        Of temperatures: their rise above body temperature.
        """
        if self.fact.kind not in ("peak", "extreme"):
            return None, None
        zero = BODY if self.fact.unit == "degC" else 0.0
        values = (self.peak, self.number.value if self.number else None)
        peak, p99 = (None if v is None else (v - zero) / (self.fact.value - zero) for v in values)
        return peak, p99


def compare(cases: Cases) -> list[ComparedNumber]:
    """Every number of the paper beside mantle's, or with the reason for its absence."""
    return [row for fact in facts() for row in _rows(fact, cases)]


def _rows(fact: Fact, cases: Cases) -> Iterator[ComparedNumber]:
    if fact.kind == "extreme":
        yield from _extremes(fact, cases)
        return
    if fact.model == "stance":
        families = [cases.over("thickness", False, stem=fact.stem, friction=fact.friction)]
        why = f"no case of this sweep has a mantle of {fact.thickness} mm, a {fact.stem} stem and "
        why += f"friction {fact.friction:g}"
    else:
        families = [*cases.heats(done=False).values()]
        why = f"no case with cement of 100 °C and {fact.thickness} mm"
    found = [(t, c) for family in families for t, c in family.items() if fact.matches(t)]
    for t, case in found:
        if not case.done:
            status = "did not converge" if "not" in case.status else case.status
            yield ComparedNumber(fact, t, remark=f"the case {case.name} {status}")
        elif fact.model == "heat":
            yield _heat(fact, t, case)
        else:
            readings = READINGS_OF.get(fact.quantity, (fact.quantity,))
            yield from (_stance(fact, t, case, reading) for reading in readings)
    if not found:
        yield ComparedNumber(fact, remark=why)


def _stance(fact: Fact, thickness: float, case: SweptCase, quantity: str) -> ComparedNumber:
    most, settled = (paper.contact(fact.place, quantity, h)(case) for h in ("max", "percentile"))
    remark = ""
    if fact.kind in ("exceeded", "not exceeded"):
        over = case.number(f"{fact.place}.area_{quantity}_over_30um")
        area = case.number(f"{fact.place}.area")
        if over is not None and area is not None:
            part = over.value / area.value
            share = f"{100 * part:.2g} %" if part < 0.995 else "100 %"
            remark = f"mantle: more than 30 µm on {share} of the area without rim and tip"
    elif place := paper.peak_zone(case, fact.place, quantity):
        remark = f"mantle: largest {place}"
    other = quantity if quantity != fact.quantity else ""
    peak = most.value if most else None
    return ComparedNumber(fact, thickness, case.name, peak, settled, remark, other)


def _heat(fact: Fact, thickness: float, case: SweptCase) -> ComparedNumber:
    number = paper.cement_peak(case) if fact.place == "cement" else paper.bone_peak(case)
    label = _heat_label(case)
    if fact.place == "cement" and labels(case)["reading"] == "initial":
        label += f", after {paper.AT:g} s"
    sure = number if number and number.error is not None else None
    peak = number.value if number else None
    return ComparedNumber(fact, thickness, case.name, peak, sure, label)


def _heat_label(case: SweptCase) -> str:
    own = labels(case)
    return f"{own['model']}, {READINGS[own['reading']]}, {paper.conductance(case)}"


def _extremes(fact: Fact, cases: Cases) -> Iterator[ComparedNumber]:
    """Mean stress of the regions of the heated femur, for each reading."""
    largest = max if fact.value > 0 else min
    every = [
        (n.value, region, case, labels(case))
        for case in cases.hot
        if case.done and case.part != "slice"
        for section, region, _ in numbers_of(case.summary, parts=True)
        if section == "regions" and (n := case.number(f"{region}.{fact.quantity}")) is not None
    ]
    for reading, words in READINGS.items():
        found = [f for f in every if f[3]["reading"] == reading]
        if found:
            value, region, case, own = largest(found, key=lambda f: f[0])
            by_region = {r: largest(v for v, o, *_ in found if o == r) for _, r, *_ in found}
            each = ", ".join(f"{named(r)} {v:.3g}" for r, v in by_region.items())
            remark = f"{words}, in {named(region)}; by region: {each}"
            yield ComparedNumber(fact, own["thickness"], case.name, value, remark=remark)
    if not every:
        why = "no case of this sweep computes stress in the heated femur"
        yield ComparedNumber(fact, remark=why)


# Figures

# By number: title, parameter, quantities.
FIGURES: dict[int, tuple[str, str, tuple[str, ...]]] = {
    3: ("Largest debonding", "thickness", ("gap",)),
    4: ("Largest interfacial shear stress", "thickness", ("shear",)),
    5: ("Largest sliding and motion", "thickness", ("slip", "motion")),
    6: ("Debonding, sliding, motion", "friction", ("gap", "slip", "motion")),
    7: ("Pressure and shear", "friction", ("pressure", "shear")),
    8: ("Highest temperatures", "thickness", ("temperature",)),
}
# By parameter: in titles, on axes, and several of them.
OVER = {
    "thickness": ("the thickness of the mantle", "thickness of the mantle (mm)", "thicknesses"),
    "friction": (
        "the cement-bone friction",
        "friction coefficient of the cement-bone interface",
        "frictions",
    ),
}


def figures(cases: Cases, folder: Path) -> tuple[list[Figure], list[str]]:
    """Draw the paper's figures that there are cases for.

    Returns:
        The figures, and reasons for those missing.
    """
    drawn, missing = [], []
    for number, (title, over, quantities) in FIGURES.items():
        words, axis, several = OVER[over]
        hot = quantities == ("temperature",)
        if hot:
            panels = [_temperatures(cases, place) for place in ("cement", "cement_bone")]
        else:
            panels = [_panel(cases, p, q, over) for q in quantities for p in INTERFACES]
        if too_few(panels):
            of = "case of hot cement" if hot else "stem"
            missing.append(f"figure {number}: no {of} at two {several}")
            continue
        name = f"figure{number}.png"
        draw(folder / name, panels, axis, 2)
        title = f"Figure {number}. {title} over {words}"
        drawn.append(Figure(name, title, "", in_words(panels)))
    return drawn, missing


def published(stem: str, place: str, quantity: str, over: str) -> list[tuple[float, float]]:
    """The paper's peaks for figures: thickness [mm], or friction of a mantle of 4 mm, and value."""
    found = {
        (t if over == "thickness" else f.friction, f.value)
        for f in facts()
        if (f.stem, f.place, f.quantity, f.kind) == (stem, place, quantity, "peak")
        and not f.thickness.startswith(">")
        for t in map(float, f.thickness.split("-"))
        if over == "thickness" or t == REFERENCE["thickness"]
    }
    return sorted(found)


def _panel(cases: Cases, place: str, quantity: str, over: str) -> Panel:
    lines = []
    for k, stem in enumerate(STEMS):
        family = cases.over(over, stem=stem)
        values, most = (
            paper.series(family, paper.contact(place, quantity, how))
            for how in ("percentile", "max")
        )
        stars = published(stem, place, "slip" if quantity == "motion" else quantity, over)
        lines.append(Line(stem, k, values, most, stars, own_stars=True))
    return Panel(named(place), f"{named(quantity)} ({QUANTITIES[quantity][0]})", lines)


def _temperatures(cases: Cases, place: str) -> Panel:
    lines = []
    stars = published("CoCr", place, "temperature", "thickness")
    cement = place == "cement"
    for k, family in enumerate(cases.heats().values()):
        label = _heat_label(next(iter(family.values())))
        values = paper.series(family, paper.cement_peak if cement else paper.bone_p99)
        peaks = {} if cement else paper.series(family, paper.bone_peak)
        lines.append(Line(label, k, values, peaks, stars))
        stars = []
    title = "cement" if cement else "bone at the cement-bone interface"
    return Panel(title, "temperature (°C)", lines)
