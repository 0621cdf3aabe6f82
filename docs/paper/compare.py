r"""Compare a sweep with the paper by Rakotomanana and Ramaniraka, for docs/paper.md.

    ./mantle sweep configs/sweeps/paper.yaml -o out/paper
    ./mantle shell -c 'python3 -m docs.paper.compare out/paper'

writes the paper's Figures 3 to 8, ``figure3.png`` and so on, and ``paper.md`` into the folder: a
verdict on each trend, and each published number beside mantle's. The numbers are in `numbers.csv`;
a remark says where they contradict themselves or each other. A sweep that is not finished is
compared as far as it is.
"""

from __future__ import annotations

import csv
import statistics
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from app.case.number_text import Number, printed
from app.case.summary_numbers import numbers_of
from app.plots.curves import Line, Panel, draw
from app.plots.figures import PNG
from app.report.sweep_figures import curve_of_numbers
from app.report.sweep_results import QUANTITIES, SweptCase, named, read
from docs.paper import cases as paper
from docs.paper.cases import READINGS, REFERENCE, STEMS, Cases, labels
from docs.paper.claims import CLAIMS, INTERFACES, judge

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
        """Return True if it is about a mantle of a thickness [mm]."""
        if self.thickness.startswith(">"):
            return thickness > float(self.thickness[1:])
        return thickness in {float(t) for t in self.thickness.split("-") if t}


@cache
def facts() -> list[Fact]:
    """Numbers that the paper reports; of both stems once for each."""
    with Path(__file__).with_name("numbers.csv").open(encoding="utf-8", newline="") as file:
        rows: list[dict[str, Any]] = list(csv.DictReader(file))
    all_facts = []
    for row in rows:
        numbers = {key: float(row[key] or 0.0) for key in ("friction", "value")}
        stems = STEMS if row["stem"] == "both" else [row["stem"]]
        all_facts += [Fact(**row | numbers | {"stem": stem}) for stem in stems]
    return all_facts


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
    matching = [(t, c) for family in families for t, c in family.items() if fact.matches(t)]
    for t, case in matching:
        if not case.done:
            status = "did not converge" if "not" in case.status else case.status
            yield ComparedNumber(fact, t, remark=f"the case {case.name} {status}")
        elif fact.model == "heat":
            yield _heat(fact, t, case)
        else:
            readings = READINGS_OF.get(fact.quantity, (fact.quantity,))
            yield from (_stance(fact, t, case, reading) for reading in readings)
    if not matching:
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
    labelled = labels(case)
    return f"{labelled['model']}, {READINGS[labelled['reading']]}, {paper.conductance(case)}"


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
        of_reading = [f for f in every if f[3]["reading"] == reading]
        if of_reading:
            value, region, case, labelled = largest(of_reading, key=lambda f: f[0])
            by_region = {
                r: largest(v for v, o, *_ in of_reading if o == r) for _, r, *_ in of_reading
            }
            each = ", ".join(f"{named(r)} {v:.3g}" for r, v in by_region.items())
            remark = f"{words}, in {named(region)}; by region: {each}"
            yield ComparedNumber(fact, labelled["thickness"], case.name, value, remark=remark)
    if not every:
        why = "no case of this sweep computes stress in the heated femur"
        yield ComparedNumber(fact, remark=why)


# Figures

# By number: parameter, quantities.
FIGURES: dict[int, tuple[str, tuple[str, ...]]] = {
    3: ("thickness", ("gap",)),
    4: ("thickness", ("shear",)),
    5: ("thickness", ("slip", "motion")),
    6: ("friction", ("gap", "slip", "motion")),
    7: ("friction", ("pressure", "shear")),
    8: ("thickness", ("temperature",)),
}
# Labels of the abscissa by parameter.
AXES = {
    "thickness": "thickness of the mantle (mm)",
    "friction": "friction coefficient of the cement-bone interface",
}


def figures(cases: Cases, folder: Path) -> list[Path]:
    """Draw the paper's figures that have a curve of two points, into a folder."""
    drawn = []
    for number, (over, quantities) in FIGURES.items():
        if quantities == ("temperature",):
            panels = [_temperatures(cases, place) for place in ("cement", "cement_bone")]
        else:
            panels = [_panel(cases, p, q, over) for q in quantities for p in INTERFACES]
        if any(len(line.x) > 1 for panel in panels for line in panel.lines if line.look != "stars"):
            drawn += draw(folder / f"figure{number}.png", panels, 2, suffixes=PNG)
    return drawn


def published(stem: str, place: str, quantity: str, over: str) -> list[tuple[float, float]]:
    """The paper's peaks for figures: thickness [mm], or friction of a mantle of 4 mm, and value."""
    values = {
        (t if over == "thickness" else f.friction, f.value)
        for f in facts()
        if (f.stem, f.place, f.quantity, f.kind) == (stem, place, quantity, "peak")
        and not f.thickness.startswith(">")
        for t in map(float, f.thickness.split("-"))
        if over == "thickness" or t == REFERENCE["thickness"]
    }
    return sorted(values)


def _panel(cases: Cases, place: str, quantity: str, over: str) -> Panel:
    lines = []
    for k, stem in enumerate(STEMS):
        family = cases.over(over, stem=stem)
        of = (paper.contact(place, quantity, how) for how in ("percentile", "max"))
        values, most = (paper.series(family, number) for number in of)
        stars = published(stem, place, "slip" if quantity == "motion" else quantity, over)
        lines += _lines(stem, k, values, most, stars)
    y = f"{named(quantity)} ({QUANTITIES[quantity][0]})"
    return Panel(named(place), y, lines, AXES[over])


def _temperatures(cases: Cases, place: str) -> Panel:
    """Curves of each model and reading; the paper's values stand at the first."""
    lines = []
    stars = published("CoCr", place, "temperature", "thickness")
    cement = place == "cement"
    for k, family in enumerate(cases.heats().values()):
        label = _heat_label(next(iter(family.values())))
        values = paper.series(family, paper.cement_peak if cement else paper.bone_p99)
        peaks = {} if cement else paper.series(family, paper.bone_peak)
        lines += _lines(label, k, values, peaks, stars)
        stars = []
    title = "cement" if cement else "bone at the cement-bone interface"
    return Panel(title, "temperature (°C)", lines, AXES["thickness"])


def _lines(
    label: str,
    style: int,
    values: Mapping[float, Number],
    peaks: Mapping[float, Number],
    stars: Sequence[tuple[float, float]],
) -> list[Line]:
    """Percentiles with bars, light maxima, and the paper's values as stars."""
    lines = [curve_of_numbers(label, style, values)]
    if peaks:
        most = [n.value for n in peaks.values()]
        lines.append(Line("", style, list(peaks), most, look="pale"))
    if stars:
        x, y = zip(*stars, strict=True)
        lines.append(Line("paper", style, x, y, look="stars"))
    return lines


# The page


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def trends(cases: Cases) -> str:
    """The verdict on each trend."""
    head = ["", "the paper says", "verdict", "by maxima", "because", "causes tried of a difference"]
    rows = []
    for t in judge(cases):
        because = "; ".join(map(": ".join, t.parts))
        rows.append([t.name, CLAIMS[t.name[:3]], t.verdict, t.peaks, because, t.tried])
    return table(head, rows)


def number_by_number(rows: Sequence[ComparedNumber]) -> str:
    """Each number of the paper beside mantle's."""
    head = ["", "stem", "mm", "where", "what", "paper", "max", "percentile", "max / paper"]
    head += ["percentile / paper", "case, remarks"]
    lines = []
    for r in rows:
        f = r.fact
        sign = {"exceeded": "> ", "not exceeded": "< "}.get(f.kind, "")
        line = [f.id, f.stem, f.thickness if r.thickness is None else f"{r.thickness:g}"]
        line += [named(f.place), named(f.quantity) + f" (as {r.quantity})" * bool(r.quantity)]
        line += [f"{sign}{f.value:g} {printed(f.unit)}", "-" if r.peak is None else f"{r.peak:.3g}"]
        line += [str(r.number or "-"), *("-" if x is None else f"{x:.2g}" for x in r.ratios)]
        notes = (r.case, r.remark, f"paper: {f.remark}" if f.remark else "")
        lines.append([*line, "; ".join(filter(None, notes))])
    return table(head, lines)


def ratios(rows: Sequence[ComparedNumber]) -> str:
    """Ratios of mantle's numbers to the paper's, over all peaks of the stance."""
    of_stance = [r for r in rows if r.fact.kind == "peak" and r.fact.model == "stance"]
    pairs = [r.ratios for r in of_stance if not r.quantity]
    peaks = [p for p, _ in pairs if p is not None]
    settled = [q for _, q in pairs if q is not None]
    if not peaks or not settled:
        return ""
    near = sum(0.5 <= p <= 2.0 for p in peaks)
    return (
        f"Over {len(peaks)} peaks of single-limb stance, mantle's largest value is "
        f"{statistics.median(peaks):.2g} times the paper's in the median (from {min(peaks):.2g} to "
        f"{max(peaks):.2g}; {near} within a factor of 2), its percentile "
        f"{statistics.median(settled):.2g} times.\n"
    )


def main(folder: Path) -> None:
    """Write figures and page into the folder of a sweep."""
    cases = Cases(read(folder))
    rows = compare(cases)
    page = folder / "paper.md"
    text = "\n".join(filter(None, (trends(cases), ratios(rows), number_by_number(rows))))
    page.write_text(text, encoding="utf-8")
    for path in (*figures(cases, folder), page):
        sys.stdout.write(f"{path}\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
