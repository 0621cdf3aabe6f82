"""The paper's published numbers beside mantle's.

The facts are those of Rakotomanana and Ramaniraka, in `paper_numbers.csv`; where they contradict
themselves or each other, the remark says so.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from app.report.paper.cases import (
    INTERFACES,
    QUANTITIES,
    STEMS,
    WORDS,
    Cases,
    contact,
    same,
)
from app.report.paper.heat import AT, bone_peak, cement_peak
from app.report.sweep_results import Number, SweepResults, SweptCase, magnitude

FACTS = Path(__file__).with_name("numbers.csv")
READINGS = {"initial": "100 °C at the start", "held": "100 °C held"}
# The paper's sliding may be that of points in contact, or all that the sides move.
READINGS_OF = {"slip": ("slip", "motion")}
# A slip at 2 mm so many times that of a thicker mantle is a jump; the paper's are 32 and 13.
JUMP = 5.0
BODY = 37.0  # degC


@dataclass(frozen=True)
class Fact:
    """A number that the paper reports.

    Attributes:
        id: Its number.
        model: ``stance``, ``heat`` or empty.
        stem: Material of the stem, ``both`` or empty.
        thickness: Of the mantle in mm: ``4``, ``2-3``, ``>7`` or empty.
        friction: At the cement-bone interface; None if it does not matter.
        place: Interface or region; may be empty.
        quantity: What.
        unit: ``um``, ``MPa``, ``degC``.
        value: The number.
        kind: peak, exceeded, not exceeded, extreme, input, penalty.
        remark: What is to be said of it.
    """

    id: str
    model: str
    stem: str
    thickness: str
    friction: float | None
    place: str
    quantity: str
    unit: str
    value: float
    kind: str
    remark: str

    def matches(self, thickness: float) -> bool:
        """Whether it is about a thickness [mm]."""
        if self.thickness.startswith(">"):
            return thickness > float(self.thickness[1:])
        return any(same(thickness, float(t)) for t in self.thickness.split("-") if t)


@cache
def facts() -> list[Fact]:
    """Numbers that the paper reports."""
    with FACTS.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return [
        Fact(
            **{k: row[k] for k in ("id", "model", "stem", "thickness", "place", "quantity")},
            **{k: row[k] for k in ("unit", "kind", "remark")},
            friction=magnitude(row["cement_bone_friction"]),
            value=float(row["value"]),
        )
        for row in rows
    ]


@dataclass(frozen=True)
class ComparedNumber:
    """A number of the paper beside mantle's.

    Attributes:
        fact: The paper's.
        case: Name of mantle's case; empty if it has none.
        stem: Its stem.
        thickness: Its thickness [mm].
        peak: Mantle's largest value, in the paper's unit.
        number: The percentile; of temperatures the largest value, if its error is known.
        remark: How mantle's number is meant, or why there is none.
        quantity: Mantle's, where it is another reading of the paper's word.
    """

    fact: Fact
    case: str
    stem: str
    thickness: float | None
    peak: float | None
    number: Number | None
    remark: str
    quantity: str = ""

    @property
    def ratios(self) -> tuple[float | None, float | None]:
        """Mantle's largest value and its percentile over the paper's; None where meaningless.

        Of temperatures: their rise above that of the body.
        """
        if self.fact.kind not in ("peak", "extreme"):
            return None, None
        zero = BODY if self.fact.unit == "degC" else 0.0
        values = (self.peak, self.number.value if self.number else None)
        peak, p99 = (None if v is None else (v - zero) / (self.fact.value - zero) for v in values)
        return peak, p99


def compare(cases: Cases, sweep: SweepResults) -> list[ComparedNumber]:
    """Every number of the paper beside mantle's, or with the reason why there is none."""
    rows: list[ComparedNumber] = []
    for fact in facts():
        match fact.model, fact.quantity:
            case "stance", _:
                rows += _stance_rows(fact, cases)
            case "heat", "temperature":
                rows += _heat_rows(fact, cases)
            case "heat", _:
                rows += _extreme_rows(fact, cases)
            case _:
                rows.append(_other(fact, sweep))
    return rows


def named(name: str) -> str:
    """A place or a quantity in words."""
    return WORDS.get(name, name.replace("_", " "))


def _stance_rows(fact: Fact, cases: Cases) -> list[ComparedNumber]:
    rows: list[ComparedNumber] = []
    for stem in STEMS.values() if fact.stem == "both" else (fact.stem,):
        family = cases.stances(stem, fact.friction, done=False)
        found = {t: c for t, c in family.items() if fact.matches(t)}
        rows += [
            _stance_row(fact, stem, t, c, reading)
            for t, c in found.items()
            if c.done
            for reading in READINGS_OF.get(fact.quantity, (fact.quantity,))
        ]
        rows += [_nothing(fact, stem, t, _why(c)) for t, c in found.items() if not c.done]
        if not found:
            why = f"no case of this sweep has a mantle of {fact.thickness} mm, a {stem} stem and "
            rows.append(_nothing(fact, stem, None, f"{why}friction {fact.friction:g}"))
    return rows


def _stance_row(
    fact: Fact, stem: str, thickness: float, case: SweptCase, quantity: str
) -> ComparedNumber:
    peak, settled = (contact(fact.place, quantity, how)(case) for how in ("max", "percentile"))
    remark = ""
    if fact.kind in ("exceeded", "not exceeded"):
        over = case.number(f"{fact.place}.area_{quantity}_over_30um")
        area = case.number(f"{fact.place}.area")
        if over is not None and area is not None:
            remark = f"mantle: more than 30 µm on {_share(over.value / area.value)} of the area"
    return ComparedNumber(
        fact,
        case.name,
        stem,
        thickness,
        None if peak is None else peak.value,
        settled,
        remark,
        quantity if quantity != fact.quantity else "",
    )


def _share(part: float) -> str:
    return f"{100 * part:.2g} %" if part < 0.995 else "100 %"


def _why(case: SweptCase) -> str:
    """Why a case has no result."""
    return f"the case {case.name} {'did not converge' if 'not' in case.status else case.status}"


def _nothing(fact: Fact, stem: str, thickness: float | None, why: str) -> ComparedNumber:
    return ComparedNumber(fact, "", stem, thickness, None, None, why)


def _heat_rows(fact: Fact, cases: Cases) -> list[ComparedNumber]:
    rows: list[ComparedNumber] = []
    for (model, reading), family in cases.heats(done=False).items():
        label = f"{model}, {READINGS[reading]}, {cases.conductance(model)}"
        for t, case in family.items():
            if not fact.matches(t):
                continue
            if not case.done:
                rows.append(_nothing(fact, fact.stem, t, _why(case)))
                continue
            number = cement_peak(case, reading) if fact.place == "cement" else bone_peak(case)
            after = f", after {AT:g} s" if fact.place == "cement" and reading == "initial" else ""
            peak = None if number is None else number.value
            sure = number if number is not None and number.error is not None else None
            rows.append(ComparedNumber(fact, case.name, fact.stem, t, peak, sure, label + after))
    return rows or [
        _nothing(fact, fact.stem, None, f"no case with cement of 100 °C and {fact.thickness} mm")
    ]


def _extreme_rows(fact: Fact, cases: Cases) -> list[ComparedNumber]:
    """Mean stress of the regions of the heated femur."""
    largest = max if fact.value > 0 else min
    family = cases.heats().get(("femur", "initial"), {})
    found: list[tuple[float, str, float, SweptCase]] = []
    for t, case in family.items():
        for region in case.summary.get("regions", {}):
            if (n := case.number(f"{region}.{fact.quantity}")) is not None:
                found.append((n.value, region, t, case))
    if not found:
        why = "no case of this sweep computes stress in the heated femur"
        return [_nothing(fact, fact.stem, None, why)]
    value, region, t, case = largest(found, key=lambda f: f[0])
    others: dict[str, float] = {}
    for v, r, _, _ in found:
        others[r] = largest(v, others.get(r, v))
    each = ", ".join(f"{named(r)} {v:.3g}" for r, v in others.items())
    return [
        ComparedNumber(
            fact, case.name, fact.stem, t, value, None, f"in {named(region)}; by region: {each}"
        )
    ]


def _other(fact: Fact, sweep: SweepResults) -> ComparedNumber:
    """Compare a fact that is not a result of the paper."""
    if fact.kind == "input":
        why = "not a result but a property of materials; mantle's unilateral contact has none"
        return _nothing(fact, "", None, why)
    found = [
        (n.value, c.name)
        for c in sweep.cases
        for i in INTERFACES
        if (n := c.number(f"{i}.penetration_max")) is not None
    ]
    if not found:
        return _nothing(fact, "", None, "no case of this sweep has contact")
    value, name = max(found)
    remark = "largest of all cases, to rounding zero"
    return ComparedNumber(fact, name, "", None, value, None, remark)


def csv_rows(rows: Iterable[ComparedNumber]) -> list[dict[str, Any]]:
    """The comparison as rows of a table, by their titles."""
    head = (
        "id,model,stem,thickness [mm],cement-bone friction,place,quantity,kind,unit,paper,"
        "mantle quantity,mantle max,mantle percentile,mantle error,max over paper,"
        "percentile over paper,case,remark"
    ).split(",")
    found = []
    for r in rows:
        f, n = r.fact, r.number
        thickness = f.thickness if r.thickness is None else r.thickness
        what = [f.id, f.model, r.stem or f.stem, thickness, f.friction, f.place, f.quantity, f.kind]
        own = [
            f.unit,
            f.value,
            r.quantity or f.quantity,
            r.peak,
            n and n.value,
            n and n.error,
            *r.ratios,
            r.case,
        ]
        remark = "; ".join(filter(None, (r.remark, f.remark)))
        found.append(dict(zip(head, [*what, *own, remark], strict=True)))
    return found


def strange(cases: Cases) -> list[str]:
    """Sentences on numbers of the paper that look wrong, with those of mantle."""
    found = [s for stem in STEMS.values() for s in _jump(stem, cases)]
    start = "The paper's +296 MPa (tension) and −97 MPa in the heated hip: "
    told = [t for reading, words in READINGS.items() if (t := _mean_stress(cases, reading, words))]
    if told:
        end = "a unilateral interface bears no tension at all."
        found.append(f"{start}mantle's mean stress lies {'; '.join(told)}; {end}")
    else:
        found.append(f"{start}this sweep has no stress of the heated femur to set beside them.")
    return found


def _mean_stress(cases: Cases, reading: str, words: str) -> str:
    """Between what the mean stress lies in all cases of a reading, and where."""
    hot = [k.case for k in cases.every if k.physics.model == "femur" and k.case.done]
    of = {k.case.name for k in cases.every if k.physics.reading == reading}
    ends = []
    for how, pick in (("min", min), ("max", max)):
        values = [
            (numbers[f"mean_stress_{how}"], region.replace("_", " "))
            for c in hot
            if c.name in of
            for region, numbers in c.summary.get("regions", {}).items()
            if f"mean_stress_{how}" in numbers
        ]
        if not values:
            return ""
        value, region = pick(values)
        ends.append(f"{value:.3g} MPa (in {region})")
    return f"with {words} between {ends[0]} and {ends[1]}"


def _jump(stem: str, cases: Cases) -> list[str]:
    """The slip of a thin mantle."""
    published = next(
        f.value
        for f in facts()
        if (f.stem, f.thickness, f.place, f.quantity) == (stem, "2", "cement_bone", "slip")
    )
    start = f"The paper's slip of {published:g} µm at the cement-bone interface ({stem}, 2 mm): "
    family = cases.stances(stem)
    name, (unit, _) = "cement_bone.slip_p99", QUANTITIES["slip"]
    thin = next((c for t, c in family.items() if same(t, 2.0)), None)
    other = next(((t, c) for t, c in family.items() if t > 2.5), None)
    a = thin and thin.number(name)
    b = other and other[1].number(name)
    if not (thin and other and a and b):
        return [f"{start}this sweep has no case of it and of a thicker mantle."]
    most = thin.number("cement_bone.slip_max")
    ratio = a.value / b.value if b.value else math.inf
    jump = "the jump is there" if ratio > JUMP else "there is no such jump"
    return [
        f"{start}mantle finds {a} {unit} (p99; max {most.value:.3g} {unit}) "
        f"against {b} {unit} at {other[0]:g} mm, {ratio:.2g} times as much: {jump}."
        if most
        else f"{start}mantle finds {a} {unit}."
    ]


def published(stem: str, place: str, quantity: str) -> list[tuple[float, float, float]]:
    """The paper's peaks for figures.

    Args:
        stem: Its material.
        place: Interface or region.
        quantity: What.

    Returns:
        Thickness [mm], cement-bone friction (0 if it does not matter) and value, in its unit.
    """
    found = []
    for f in facts():
        if (f.place, f.quantity, f.kind) != (place, quantity, "peak"):
            continue
        if f.stem in (stem, "both") and not f.thickness.startswith(">"):
            found += [(float(t), f.friction or 0.0, f.value) for t in f.thickness.split("-")]
    return sorted(set(found))
