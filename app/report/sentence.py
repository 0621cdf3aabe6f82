"""The findings of a run in one sentence that a surgeon understands."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from app.case.quantities import NECROSIS, TABLE, in_print, in_words, printed
from app.report.sweep_results import SweptCase, magnitude

# What moves on what, by interface, and its surface.
PAIRS = {
    "stem_cement": ("the stem", "its cement", "the stem's surface"),
    "cement_bone": ("the cement", "the bone", "the cement's surface"),
}
# Slip and gaps below this are none [um].
NOTHING = 0.05
# Open part of the area from which on nothing touches.
APART = 0.995
# Words for a model of a part of the body.
SECTORS = {"half": " on the half that is modelled", "quarter": " on the quarter that is modelled"}

Numbers = Mapping[str, Any]


def sentence(summary: Numbers, case: SweptCase) -> str:
    """Summarise the numbers of summary.json in one sentence; the case supplies the loads.

    The verdicts below it say how exact the numbers are.
    """
    clauses = [*_contacts(summary)]
    stem = summary.get("stem", {})
    if abs(1e3 * stem.get("subsidence", 0.0)) > NOTHING:
        clauses.append(f"the stem sinks by {_with_error('stem', 'subsidence', stem)}")
    clauses += _heat(summary)
    # Rounded down: incomplete cure never reads as 100 %.
    clauses += [
        f"{name} has set to {math.floor(1e3 * q['degree_min']) / 10:g} % or more"
        for name, q in summary.get("cure", {}).items()
    ]
    # Loads are those at the end: a run that stopped before had others.
    ended = summary["status"] not in ("stopped", "not converged")
    load = _load(case) if ended and (summary["interfaces"] or summary.get("stem")) else ""
    clauses = clauses or [
        f"in 99 % of {name.replace('_', ' ')} the stress (von Mises) is below "
        f"{_with_error('regions', 'von_mises_p99', q)}"
        for name, q in summary.get("regions", {}).items()
    ]
    if load and clauses:
        clauses[0] = f"{load}, {clauses[0]}"
    text = "; ".join(clauses)
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def _load(case: SweptCase) -> str:
    forces: dict[str, list[float]] = {}
    every = case.data.get("loads", {})
    for name, load in every.items():
        if load.get("cycle_table"):
            continue  # it has no one size
        parts = [x for v in load.get("force") or () if (x := magnitude(v)) is not None]
        last = (load.get("history") or [1.0])[-1]
        if len(parts) == 3 and isinstance(last, int | float):
            forces[name] = [last * part for part in parts]
    if not forces:
        return ""
    largest = max(forces, key=lambda name: math.hypot(*forces[name]))
    which = ""
    if len(every) > 1:
        which = f" ({largest.replace('_', ' ')}"
        if len(forces) == len(every):
            sum_ = math.hypot(*map(sum, zip(*forces.values(), strict=True)))
            which += f"; the sum of all {len(every)} loads is {sum_:,.0f} N"
        which += ")"
    sector = SECTORS.get(case.data.get("geometry", {}).get("sector", ""), "")
    return f"under {math.hypot(*forces[largest]):,.0f} N{which}{sector}"


def _with_error(section: str, key: str, numbers: Numbers) -> str:
    q = TABLE[section][key]
    return f"{q.text(numbers)} {printed(q.shown)}"


def _contacts(summary: Numbers) -> Iterator[str]:
    """Sliding and opening of the interfaces."""
    for name, q in summary["interfaces"].items():
        if "dissipation_cycle" in q:
            yield from _friction(name.replace("_", " "), q)
        if "slip_p99" not in q:
            continue
        one = f"one side of {name.replace('_', ' ')}"
        first, second, surface = PAIRS.get(name, (one, "the other", one))
        if "rim" in q:
            surface += " without rim and tip"
        gap = _with_error("interfaces", "gap_p99", q)
        if q.get("open_fraction", 0.0) > APART:
            yield f"{first} touches {second} nowhere; 99 % of it is less than {gap} away"
            continue
        slides, left = "does not slide", "does not leave it"
        if 1e3 * q["slip_p99"] > NOTHING:
            slides = f"slides less than {_with_error('interfaces', 'slip_p99', q)}"
        area = q.get("area_gap_over_30um", 0.0)
        if area > 0.5:
            left = f"{area:,.0f} of {q['area']:,.0f} mm² are more than 30 µm away from it"
        elif 1e3 * q.get("gap_p99", 0.0) > NOTHING:
            left = f"99 % is less than {gap} away from it"
        on = "in" if second == "its cement" else "on"
        yield f"99 % of {surface} {slides} {on} {second}, and {left}"


def _friction(name: str, q: Numbers) -> Iterator[str]:
    """Friction and wear of an interface whose sides slide far."""
    spent = _with_error("interfaces", "dissipation_cycle", q)
    torque = _with_error("interfaces", "torque_max", q) if "torque_max" in q else ""
    resists = f"resists the motion with up to {torque} and " if torque else ""
    yield f"friction on {name} {resists}dissipates {spent} in a cycle"
    if "wear_volume" in q:
        worn, deep = (
            _with_error("interfaces", f"wear_{key}_million", q) for key in ("volume", "depth_p99")
        )
        yield f"a million cycles wear {worn} off, {deep} deep (p99)"


def _heat(summary: Numbers) -> Iterator[str]:
    """Peak temperature of the bone, how long it lasts, and how much bone dies."""
    regions = summary.get("thermal", {}).get("regions", {})
    bone = [q for q in regions.values() if "necrosis_47C_1min_volume" in q]  # heat can kill it
    if not regions:
        return
    if not bone:
        name, q = max(regions.items(), key=lambda item: item[1]["temperature_max"])
        hot = _with_error("thermal.regions", "temperature_max", q)
        yield f"{name.replace('_', ' ')} gets as hot as {hot}"
        return
    worst = max(bone, key=lambda q: q["temperature_max"])
    said = f"bone gets as hot as {_with_error('thermal.regions', 'temperature_max', worst)}"
    spans = {level: max(q[f"seconds_over_{level}"] for q in bone) for level in (47, 50, 56)}
    over = [f"{s:,.0f} s above {level} °C" for level, s in spans.items() if s > 0]
    yield said + (f", for up to {', '.join(over)}" if over else " and is never above 47 °C")
    rule = "47C_1min"
    dead = {r: sum(q.get(f"necrosis_{r}_volume") or 0.0 for q in bone) for r in NECROSIS}
    if max(dead.values()) < 0.5:
        yield "no bone dies"
        return
    others = [v for k, v in dead.items() if k != rule]
    yield (
        f"{dead[rule]:,.0f} mm³ of bone dies by the rule of {in_print(NECROSIS[rule])}, "
        f"{min(others):,.0f} to {max(others):,.0f} mm³ by others"
    )


def spread(cases: Sequence[SweptCase], names: Sequence[str], what: str) -> str:
    """Ranges of some numbers over several runs, which are called variations or cases."""
    found = []
    for name, ends in ranges(cases, names):
        words, unit = in_words(name)
        shown = ((v if abs(v) > NOTHING else 0.0, c.name.replace("_", " ")) for v, c in ends)
        least, most = (f"{v:.3g} {unit} ({case})" for v, case in shown)
        found.append(f"{words} from {least} to {most}")
    return f"Over all {what}: {'; '.join(found)}." if found else ""


def ranges(
    cases: Sequence[SweptCase], names: Sequence[str]
) -> Iterator[tuple[str, list[tuple[float, SweptCase]]]]:
    """Slip, gap and temperature that vary: name, the least and its case, the most and its case."""
    for name in names:
        values = [(n.value, k) for k, c in enumerate(cases) if (n := c.number(name))]
        if len(values) > 1 and name.endswith((".slip_p99", ".gap_p99", ".temperature_max")):
            ends = min(values), max(values)
            if ends[1][0] > NOTHING and ends[0] != ends[1]:
                yield name, [(value, cases[k]) for value, k in ends]
