"""Loads that come again: what stays when they go, and what comes and goes with them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

# Motions of the stem that are split.
STEM = ("subsidence", "retroversion", "varus")
# Dissipation per cycle that has vanished, and change per cycle that is none, relative.
NOTHING, SAME = 0.02, 0.1

Numbers = dict[str, float]


class Cycles:
    """Numbers at the peaks and valleys of the loads, by stage."""

    saved = ("_turns",)

    def __init__(self) -> None:
        self._turns: dict[str, list[Numbers]] = {}

    def add(self, stage: str, summary: Mapping[str, Any]) -> None:
        """Keep the numbers where the loads of a stage turn: peaks and valleys in turns."""
        stem, interfaces = summary.get("stem", {}), summary["interfaces"]
        kept = {f"stem.{key}": stem[key] for key in STEM if key in stem}
        for name, numbers in interfaces.items():
            for key in ("motion_p99", "inducible_p99", "dissipation"):
                kept |= {f"{name}.{key}": numbers[key]} if key in numbers else {}
        self._turns.setdefault(stage, []).append(kept)

    def summary(self) -> dict[str, Any]:
        """For each stage with two peaks at least, what `split` finds."""
        return {name: split(turns) for name, turns in self._turns.items() if len(turns) > 2}


def split(turns: list[Numbers]) -> dict[str, Any]:
    """Permanent and inducible parts of motions, and dissipation from peak to peak.

    Returns:
        ``permanent``: motions in the last valley, by place and key. ``inducible``: what the load
        adds from there to the next peak; of interfaces the 99th percentile of the way between
        both. ``dissipation`` [N mm] of each cycle after the first peak, and its ``trend``.
    """
    peaks, valleys = turns[::2], turns[1::2]
    low, high = valleys[len(peaks) - 2], peaks[-1]
    permanent: dict[str, Numbers] = {}
    inducible: dict[str, Numbers] = {}
    for path, value in low.items():
        place, key = path.split(".")
        if key in STEM:
            inducible.setdefault(place, {})[key] = high[path] - value
            permanent.setdefault(place, {})[key] = value
        elif key == "motion_p99":
            inducible.setdefault(place, {})[key] = high[f"{place}.inducible_p99"]
            permanent.setdefault(place, {})[key] = value
    total = [sum(v for k, v in peak.items() if k.endswith(".dissipation")) for peak in peaks]
    lost = [b - a for a, b in pairwise(total)]
    return {
        "permanent": permanent,
        "inducible": inducible,
        "dissipation": lost,
        "trend": trend(total[0], lost),
    }


def trend(first: float, lost: list[float]) -> str:
    """Whether the dissipation per cycle ``vanishes``, ``stays``, ``falls`` or ``grows``.

    Args:
        first: Dissipation up to the first peak [N mm].
        lost: Dissipation of each cycle after it [N mm].
    """
    if abs(lost[-1]) <= NOTHING * first:
        return "vanishes"
    if len(lost) < 2 or abs(lost[-1] - lost[-2]) <= SAME * lost[-2]:
        return "stays"
    return "grows" if lost[-1] > lost[-2] else "falls"


def rows(found: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """Motions of a stage with cycles: what it is, its permanent and its inducible part."""
    for place, own in found["permanent"].items():
        for key, value in own.items():
            both = value, found["inducible"][place][key]
            if key in ("retroversion", "varus"):
                yield f"{key} (deg)", *(f"{v:.3f}" for v in both)
            else:
                name = f"motion p99 of {place}" if key == "motion_p99" else key
                yield f"{name} (um)", *(f"{1e3 * v:.1f}" for v in both)


def dissipation(found: Mapping[str, Any]) -> str:
    """A sentence on the friction of a stage with cycles."""
    lost = ", ".join(f"{d:.3g}" for d in found["dissipation"])
    return f"dissipation per cycle {found['trend']}: {lost} N mm"


def sentences(cycles: Mapping[str, Any]) -> Iterator[str]:
    """A line for the log for each stage."""
    for stage, found in cycles.items():
        parts = ", ".join(f"{name} {low} / {more}" for name, low, more in rows(found))
        yield f"{stage}: permanent / inducible: {parts}; {dissipation(found)}"
