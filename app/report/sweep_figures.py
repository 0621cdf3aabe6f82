"""Figures of any sweep: its numbers over each key that varies."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mantle.report.curves import ROUNDED, Figure, Line, Panel, draw, in_words, too_few
from mantle.report.paper.cases import PERCENTILES
from mantle.report.paper.compare import named
from mantle.report.sweep_results import SweptCase, magnitude
from mantle.schema import quantities
from mantle.system.style import COLOURS, MARKERS

MOST_PANELS = 12
MOST_SERIES = 8
MOST_LEVELS = 8


def headlines(cases: Sequence[SweptCase]) -> list[str]:
    """Names of the numbers to show of cases, those that matter most first."""
    found: dict[str, None] = {}
    for case in cases:
        for name in case.summary.get("interfaces", {}):
            found |= {f"{name}.{q}_{part}": None for q, part in PERCENTILES.items()}
    for case in cases:
        # What burns is the bone; cement may be as hot as it starts.
        regions = case.summary.get("thermal", {}).get("regions", {})
        order = sorted(regions, key=lambda name: name not in case.bones)
        found |= {f"{name}.temperature_max": None for name in order}
    for case in cases:
        found |= dict.fromkeys(case.numbers)
    return [name for name in found if any(c.number(name) is not None for c in cases)]


def label(name: str) -> tuple[str, str]:
    """A number's name for people, and its unit."""
    place, _, key = name.partition(".")
    if (q := quantities.get(name)) is None:
        return f"{named(place)} {key}".replace("_", " "), ""
    return f"{named(place)} {key.replace(q.key, q.label)}", quantities.printed(q.shown)


def title(key: str) -> str:
    """A swept key in words: ``interfaces.cement_bone.friction_coefficient``."""
    *path, last = key.replace("_", " ").split(".")
    if not path or path[0] in ("geometry", "stages", "solver", "output"):
        return last
    if path[0] == "interfaces":
        return f"{last}, {named(key.split('.')[1])}"
    return f"{' '.join(path[1:]) or path[0]} {last}"


def value(level: Any) -> str:
    """A level in words; of a section its kind."""
    if isinstance(level, dict):
        return str(level.get("kind") or ", ".join(map(str, level.values())))
    return str(level)


def axes_in_words(cases: Sequence[SweptCase]) -> list[str]:
    """What varies, with all levels, a sentence for each part."""
    parts: dict[str, dict[str, dict[str, None]]] = {}
    for c in cases:
        own = parts.setdefault(c.part, {})
        for key, level in c.overrides.items():
            own.setdefault(key, {})[value(level)] = None
    found = []
    for part, keys in parts.items():
        varied = [f"{title(k)} ({_levels(list(v))})" for k, v in keys.items() if len(v) > 1]
        if varied:
            found.append(f"{f'{part}: ' * bool(part)}{'; '.join(varied)}.")
    return found


def _levels(values: Sequence[str]) -> str:
    """Levels of an axis, or how many there are."""
    if len(values) <= MOST_LEVELS:
        return ", ".join(values)
    return f"{len(values)} levels from {values[0]} to {values[-1]}"


def multiples(cases: Sequence[SweptCase], folder: Path) -> list[Figure]:
    """Draw each headline number over each numeric key that varies.

    Args:
        cases: Those that have something in common.
        folder: Where the pictures go.
    """
    done = [c for c in cases if c.done]
    keys = dict.fromkeys(key for c in done for key in c.overrides)
    figures = []
    for key in keys:
        groups = _groups(done, key)
        if not groups:
            continue
        panels = []
        for name in headlines([c for _, own in groups for c in own.values()]):
            text, unit = label(name)
            lines = []
            for k, (common, own) in enumerate(groups[:MOST_SERIES]):
                values = {x: n for x, c in own.items() if (n := c.number(name))}
                lines.append(Line(common or "mantle", COLOURS[k], MARKERS[k], values, {}))
            if any(map(_varies, lines)):
                panels.append(Panel(text, unit or "value", lines))
        panels = panels[:MOST_PANELS]
        if too_few(panels):
            continue
        file = f"over_{''.join(c if c.isalnum() else '_' for c in key)}.png"
        words = title(key)
        draw(folder / file, panels, f"{words} ({unit_of(done, key)})".replace(" ()", ""), 3)
        left = len(groups) - MOST_SERIES
        more = f" {left} further curves are left out." if left > 0 else ""
        caption = f"Bars: estimated errors, where they are known.{more}"
        figures.append(Figure(file, f"Numbers over {words}", caption, in_words(panels)))
    return figures


def _varies(line: Line) -> bool:
    """Whether a curve is more than rounding."""
    values = [n.value for n in line.numbers.values()]
    return max(values, default=0.0) - min(values, default=0.0) > max(ROUNDED.values())


def unit_of(cases: Sequence[SweptCase], key: str) -> str:
    """The unit of a key's values, as written."""
    texts = [str(c.overrides[key]).split(maxsplit=1) for c in cases if key in c.overrides]
    units = {t[1] for t in texts if len(t) > 1}
    return units.pop() if len(units) == 1 else ""


def _groups(cases: Sequence[SweptCase], key: str) -> list[tuple[str, dict[float, SweptCase]]]:
    """Cases that differ in a numeric key alone, with what they have in common in words."""
    found: dict[str, dict[float, SweptCase]] = {}
    for c in cases:
        x = magnitude(c.overrides.get(key))
        if x is not None:
            rest = {k: v for k, v in c.overrides.items() if k != key}
            common = ", ".join(f"{title(k)} {value(v)}" for k, v in rest.items())
            found.setdefault(": ".join(filter(None, (c.part, common))), {})[x] = c
    return [(t, dict(sorted(own.items()))) for t, own in found.items() if len(own) > 1]
