"""Cyclic loads: permanent motions, inducible motions, and dissipation per cycle."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise

from app.case.quantities import TABLE
from app.case.summary import Numbers, StageCycles

# Numbers of an interface that are kept at peaks and valleys of the loads.
AREAS = ("area_inducible_over_40um", "area_inducible_over_150um")
OF_CYCLES = {"motion_p99", "micromotion_p99", "inducible_p99", "dissipation", *AREAS}
# Dissipation per cycle, relative to that up to the first peak, below which it vanishes.
VANISHING_DISSIPATION = 0.02
# Relative change from the first to the last cycle below which the dissipation counts as constant.
SAME = 0.1

# Numbers of the stem and of each interface at a peak or valley, by name.
Reversal = dict[str, dict[str, float]]


class Cycles:
    """Numbers at the peaks and valleys of the loads, by stage."""

    saved = ("reversals",)

    def __init__(self) -> None:
        # Dissipation at every peak and valley [N mm], and the numbers at the last three.
        self.reversals: dict[str, tuple[list[float], list[Reversal]]] = {}

    def add(self, stage: str, stem: Numbers, interfaces: Mapping[str, Numbers]) -> None:
        """Add the numbers at a peak or a valley of the loads of a stage; these alternate."""
        numbers_at_reversal: Reversal = {}
        if stem:
            numbers_at_reversal["stem"] = dict(stem)
        dissipation = 0.0
        for name, numbers in interfaces.items():
            numbers_at_reversal[name] = {
                key: numbers[key] for key in sorted(OF_CYCLES) if key in numbers
            }
            dissipation += numbers.get("dissipation", 0.0)
        dissipations, last_reversals = self.reversals.setdefault(stage, ([], []))
        dissipations.append(dissipation)
        last_reversals.append(numbers_at_reversal)
        del last_reversals[:-3]

    def summary(self) -> dict[str, StageCycles]:
        """Parts of the motions of each stage with at least two peaks (`parts_of_cycles`)."""
        return {
            stage: parts_of_cycles(dissipated, last_reversals)
            for stage, (dissipated, last_reversals) in self.reversals.items()
            if len(dissipated) > 2
        }


def parts_of_cycles(dissipations: list[float], last_reversals: list[Reversal]) -> StageCycles:
    """Permanent and inducible parts of motions, and dissipation from peak to peak.

    Args:
        dissipations: Dissipation at every peak and valley, which alternate [N mm].
        last_reversals: Numbers at the last three of them.

    Returns:
        ``permanent``: motions in the last valley, by place and key. ``inducible``: motion from this
        valley to the next peak; for interfaces, its 99th percentile. ``areas``: of press fits,
        areas in which it exceeds the bounds of ingrowth. ``dissipation`` [N mm] of each cycle
        after the first peak, and its ``trend``.
    """
    *_, valley, peak = last_reversals if len(dissipations) % 2 else last_reversals[:-1]
    permanent: Reversal = {}
    inducible: Reversal = {}
    areas: Reversal = {}
    for owner, numbers in valley.items():
        if owner == "stem":
            permanent[owner] = numbers
            inducible[owner] = {key: peak[owner][key] - value for key, value in numbers.items()}
        elif "motion_p99" in numbers:  # absent with finite sliding
            # The motion of a press fit is that since the insertion.
            key = "micromotion_p99" if "micromotion_p99" in numbers else "motion_p99"
            permanent[owner] = {key: numbers[key]}
            inducible[owner] = {key: peak[owner]["inducible_p99"]}
        areas_at_peak = {key: peak[owner][key] for key in AREAS if key in peak[owner]}
        if areas_at_peak:
            areas[owner] = areas_at_peak
    per_cycle = [b - a for a, b in pairwise(dissipations[::2])]
    parts: StageCycles = {
        "permanent": permanent,
        "inducible": inducible,
        "dissipation": per_cycle,
        "trend": trend(dissipations[0], per_cycle),
    }
    if areas:
        parts["areas"] = areas
    return parts


def trend(first_dissipation: float, per_cycle: list[float]) -> str:
    """Return the trend of dissipation per cycle: ``vanishes``, ``stays``, ``falls``, ``grows``.

    The last cycle is compared with the first peak (it vanishes) and with the first cycle.

    Args:
        first_dissipation: Dissipation up to the first peak [N mm].
        per_cycle: Dissipation of each cycle after it [N mm].
    """
    if abs(per_cycle[-1]) <= VANISHING_DISSIPATION * first_dissipation:
        return "vanishes"
    if abs(per_cycle[-1] - per_cycle[0]) <= SAME * per_cycle[0]:
        return "stays"
    return "grows" if per_cycle[-1] > per_cycle[0] else "falls"


def rows_of_cycles(numbers: StageCycles) -> Iterator[tuple[str, ...]]:
    """Yield the motions of a stage with cycles as texts: name, permanent and inducible part."""
    for owner, permanent in numbers.get("permanent", {}).items():
        for key in permanent:
            q = TABLE["stem" if owner == "stem" else "interfaces"][key]
            name = key if owner == "stem" else f"{key.replace('_', ' ')} of {owner}"
            yield f"{name} ({q.shown})", q.text(permanent), q.text(numbers["inducible"][owner])


def friction(numbers: StageCycles) -> Iterator[str]:
    """Sentence on the friction of a stage with cycles, if it has peaks and valleys."""
    if "trend" not in numbers:
        return
    per_cycle = numbers["dissipation"]
    first, last, count = per_cycle[0], per_cycle[-1], len(per_cycle) + 1
    if count == 2:
        yield f"dissipation in the second of 2 cycles: {first:.3g} N mm"
        return
    ratio = f" ({100 * last / first:.0f} %)" if first > 0.0 else ""
    yield (
        f"dissipation per cycle {numbers['trend']}: {first:.3g} N mm in the second,"
        f" {last:.3g} N mm in the last of {count} cycles{ratio}"
    )


def sentences(cycles: Mapping[str, StageCycles]) -> Iterator[str]:
    """Yield a line of the log for each stage."""
    for stage, numbers in cycles.items():
        motion_texts = ", ".join(
            f"{name} {permanent} / {inducible}"
            for name, permanent, inducible in rows_of_cycles(numbers)
        )
        lines = [*friction(numbers)]
        if motion_texts:
            lines.insert(0, f"permanent / inducible: {motion_texts}")
        if lines:
            yield f"{stage}: {'; '.join(lines)}"
