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

from app.report import paper
from app.report.curves import Figure, Line, Panel, draw, in_words, too_few
from app.report.paper import READINGS, STEMS, Cases, Family
from app.report.sweep_results import (
    INTERFACES,
    QUANTITIES,
    WORDS,
    Number,
    SweptCase,
    magnitude,
    named,
)
from app.system.style import COLOURS, MARKERS

# The paper's sliding may be slip in contact, or all relative motion of the sides.
READINGS_OF = {"slip": ("slip", "motion")}
BODY = 37.0  # degC


@dataclass(frozen=True)
class Fact:
    """A number that the paper reports.

    Attributes:
        model: ``stance`` or ``heat``.
        stem: Material of the stem, ``both`` or empty.
        thickness: Of the mantle in mm: ``4``, ``2-3``, ``>7`` or empty.
        cement_bone_friction: Friction coefficient there; None if it does not matter.
        place: Interface or region; may be empty.
        unit: ``um``, ``MPa``, ``degC``.
        kind: peak, exceeded, not exceeded, extreme.
    """

    id: str
    model: str
    stem: str
    thickness: str
    cement_bone_friction: float | None
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
    """Numbers that the paper reports."""
    with Path(__file__).with_name("paper_numbers.csv").open(encoding="utf-8", newline="") as file:
        rows: list[dict[str, Any]] = list(csv.DictReader(file))
    for row in rows:
        row["cement_bone_friction"] = magnitude(row["cement_bone_friction"])
        row["value"] = float(row["value"])
    return [Fact(**row) for row in rows]


@dataclass(frozen=True)
class ComparedNumber:
    """A number of the paper beside mantle's.

    Attributes:
        stem: The stem of mantle's case.
        thickness: Thickness of its mantle [mm].
        case: Its name; empty if there is none.
        peak: Mantle's largest value, in the paper's unit.
        number: The percentile; of temperatures the largest value, if its error is known.
        remark: Definition of mantle's number, or the reason for its absence.
        quantity: Mantle's quantity, where it is another reading of the paper's word.
    """

    fact: Fact
    stem: str
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
    rows: list[ComparedNumber] = []
    for fact in facts():
        match fact.model, fact.quantity:
            case "stance", _:
                rows += _stance_rows(fact, cases)
            case "heat", "temperature":
                rows += _heat_rows(fact, cases)
            case _:
                rows += _extreme_rows(fact, cases)
    return rows


def _stance_rows(fact: Fact, cases: Cases) -> Iterator[ComparedNumber]:
    friction = fact.cement_bone_friction or 0.0
    for stem in STEMS.values() if fact.stem == "both" else (fact.stem,):
        family = cases.thicknesses(stem, friction, done=False)
        found = {t: c for t, c in family.items() if fact.matches(t)}
        for t, case in found.items():
            if not case.done:
                yield ComparedNumber(fact, stem, t, remark=_why(case))
                continue
            for reading in READINGS_OF.get(fact.quantity, (fact.quantity,)):
                yield _stance_row(fact, stem, t, case, reading)
        if not found:
            why = f"no case of this sweep has a mantle of {fact.thickness} mm, a {stem} stem and "
            yield ComparedNumber(fact, stem, remark=f"{why}friction {friction:g}")


def _stance_row(
    fact: Fact, stem: str, thickness: float, case: SweptCase, quantity: str
) -> ComparedNumber:
    peak, settled = (
        paper.contact(fact.place, quantity, how)(case) for how in ("max", "percentile")
    )
    remark = ""
    if fact.kind in ("exceeded", "not exceeded"):
        over = case.number(f"{fact.place}.area_{quantity}_over_30um")
        area = case.number(f"{fact.place}.area")
        if over is not None and area is not None:
            part = over.value / area.value
            share = f"{100 * part:.2g} %" if part < 0.995 else "100 %"
            remark = f"mantle: more than 30 µm on {share} of the area"
    other = quantity if quantity != fact.quantity else ""
    value = None if peak is None else peak.value
    return ComparedNumber(fact, stem, thickness, case.name, value, settled, remark, other)


def _why(case: SweptCase) -> str:
    return f"the case {case.name} {'did not converge' if 'not' in case.status else case.status}"


def _heat_rows(fact: Fact, cases: Cases) -> list[ComparedNumber]:
    rows: list[ComparedNumber] = []
    for (model, reading), family in cases.heats(done=False).items():
        for t, case in family.items():
            if not fact.matches(t):
                continue
            if not case.done:
                rows.append(ComparedNumber(fact, fact.stem, t, remark=_why(case)))
                continue
            number = paper.cement_peak(case) if fact.place == "cement" else paper.bone_peak(case)
            label = f"{model}, {READINGS[reading]}, {paper.conductance(case)}"
            if fact.place == "cement" and reading == "initial":
                label += f", after {paper.AT:g} s"
            peak = None if number is None else number.value
            sure = number if number and number.error is not None else None
            rows.append(ComparedNumber(fact, fact.stem, t, case.name, peak, sure, label))
    why = f"no case with cement of 100 °C and {fact.thickness} mm"
    return rows or [ComparedNumber(fact, fact.stem, remark=why)]


def _extreme_rows(fact: Fact, cases: Cases) -> list[ComparedNumber]:
    """Mean stress of the regions of the heated femur, for each reading."""
    largest = max if fact.value > 0 else min
    rows = []
    for reading, words in READINGS.items():
        found = [
            (n.value, region, case)
            for case in cases.hot
            if case.done and case.part != "slice" and paper.reading_of(case) == reading
            for region in case.summary.get("regions", {})
            if (n := case.number(f"{region}.{fact.quantity}")) is not None
        ]
        if not found:
            continue
        value, region, case = largest(found, key=lambda f: f[0])
        by_region = {r: largest(v for v, own, _ in found if own == r) for _, r, _ in found}
        each = ", ".join(f"{named(r)} {v:.3g}" for r, v in by_region.items())
        remark = f"{words}, in {named(region)}; by region: {each}"
        rows.append(
            ComparedNumber(fact, fact.stem, paper.thickness(case), case.name, value, remark=remark)
        )
    why = "no case of this sweep computes stress in the heated femur"
    return rows or [ComparedNumber(fact, fact.stem, remark=why)]


# Figures


HOT = (
    "The paper's “100 degrees” read as the cement's initial temperature (cement: after 10 s, "
    "for at the start it is 100 °C; the paper names no time) and as held. Bone, filled: the "
    "99th percentile over the area, after 10 s or at the end of cement that is held; hollow: "
    "the largest value at any time, which sits where bone is thinnest. Stars: the paper."
)
NOTE = (
    "Filled, with bars: mantle's 99th percentile and its estimated error. Light, hollow: mantle's "
    "largest value, which depends on the mesh. Stars: the paper."
)
# Number, title, quantities, and whether over friction or thickness.
FIGURES: tuple[tuple[int, str, tuple[str, ...], bool], ...] = (
    (3, "Largest debonding over the thickness of the mantle", ("gap",), False),
    (4, "Largest interfacial shear stress over the thickness of the mantle", ("shear",), False),
    (5, "Largest sliding and motion over the thickness of the mantle", ("slip", "motion"), False),
    (
        6,
        "Debonding, sliding, motion over the cement-bone friction",
        ("gap", "slip", "motion"),
        True,
    ),
    (7, "Pressure and shear over the cement-bone friction", ("pressure", "shear"), True),
)
THICKNESS, FRICTION = (
    "thickness of the mantle (mm)",
    "friction coefficient of the cement-bone interface",
)


def figures(cases: Cases, folder: Path) -> tuple[list[Figure], list[str]]:
    """Draw the paper's figures that there are cases for.

    Returns:
        The figures, and reasons for those missing.
    """
    planned = []
    for number, title, quantities, friction in FIGURES:
        panels = [_panel(cases, p, q, friction) for q in quantities for p in INTERFACES]
        lacking = f"no stem at two {'frictions' if friction else 'thicknesses'}"
        planned.append((number, title, panels, FRICTION if friction else THICKNESS, NOTE, lacking))
    title, lacking = (
        "Highest temperatures over the thickness of the mantle",
        "no case of hot cement",
    )
    panels = [_temperatures(cases, "cement", "cement")]
    panels += [_temperatures(cases, "cement_bone", "bone at the cement-bone interface")]
    planned.append((8, title, panels, THICKNESS, HOT, f"{lacking} at two thicknesses"))
    drawn, missing = [], []
    for number, title, panels, x, note, lacking in planned:
        if too_few(panels):
            missing.append(f"figure {number}: {lacking}")
            continue
        name = f"figure{number}.png"
        draw(folder / name, panels, x, 2)
        drawn.append(Figure(name, f"Figure {number}. {title}", note, in_words(panels)))
    return drawn, missing


def published(
    stem: str, place: str, quantity: str, friction: bool = False
) -> list[tuple[float, float]]:
    """The paper's peaks for figures: thickness [mm], or friction of a mantle of 4 mm, and value."""
    found = set()
    for f in facts():
        if (f.place, f.quantity, f.kind) != (place, quantity, "peak"):
            continue
        if f.stem in (stem, "both") and not f.thickness.startswith(">"):
            for t in map(float, f.thickness.split("-")):
                if not friction:
                    found.add((t, f.value))
                elif t == paper.THICKNESS:
                    found.add((f.cement_bone_friction or 0.0, f.value))
    return sorted(found)


def _panel(cases: Cases, place: str, quantity: str, friction: bool) -> Panel:
    lines = []
    for k, stem in enumerate(STEMS.values()):
        family: Family = cases.frictions(stem) if friction else cases.thicknesses(stem)
        percentile, most = (
            paper.series(family, paper.contact(place, quantity, how))
            for how in ("percentile", "max")
        )
        stars = published(stem, place, "slip" if quantity == "motion" else quantity, friction)
        lines.append(Line(stem, COLOURS[k], MARKERS[k], percentile, most, stars, own_stars=True))
    return Panel(WORDS[place], f"{WORDS[quantity]} ({QUANTITIES[quantity][0]})", lines)


def _temperatures(cases: Cases, place: str, title: str) -> Panel:
    lines = []
    stars = published("CoCr", place, "temperature")
    for k, ((model, reading), family) in enumerate(cases.heats().items()):
        label = f"{model}, {READINGS[reading]}, {paper.conductance(next(iter(family.values())))}"
        cement = place == "cement"
        values = paper.series(family, paper.cement_peak if cement else paper.bone_p99)
        peaks = {} if cement else paper.series(family, paper.bone_peak)
        lines.append(Line(label, COLOURS[k], MARKERS[k], values, peaks, stars))
        stars = []
    return Panel(title, "temperature (°C)", lines)
