"""Figures of any sweep: its numbers over each key that varies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

from app.case import keys, quantities
from app.report import page
from app.report.curves import ROUNDED, Figure, Line, Panel, draw, in_words, too_few
from app.report.page import Blocks
from app.report.sweep_results import PERCENTILES, SweptCase, magnitude, named
from app.schema.unit_conversion import conversion
from app.schema.units import NUMBER
from app.system import layout
from app.system.style import COLOURS, MARKERS

MOST_PANELS = 12
MOST_NUMBERS = 11  # in the table of cases
MOST_SERIES = 8
MOST_LEVELS = 8


def headlines(cases: Sequence[SweptCase]) -> list[str]:
    """Names of the numbers to show of cases, most important first."""
    found: dict[str, None] = {}
    for case in cases:
        for name in case.summary.get("interfaces", {}):
            found |= {f"{name}.{q}_{part}": None for q, part in PERCENTILES.items()}
    for case in cases:
        # Bone is what burns; cement may start hot.
        regions = case.summary.get("thermal", {}).get("regions", {})
        order = sorted(regions, key=lambda name: name not in case.bones)
        found |= {f"{name}.temperature_max": None for name in order}
    for case in cases:
        found |= dict.fromkeys(case.numbers)
    return [name for name in found if any(c.number(name) is not None for c in cases)]


def label(name: str) -> tuple[str, str]:
    """A number's label for people, and its unit."""
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
    """A level in words; a section by its kind."""
    if isinstance(level, dict):
        return str(level.get("kind") or ", ".join(map(str, level.values())))
    return str(level)


def axes_in_words(cases: Sequence[SweptCase]) -> list[str]:
    """Varied keys with all their levels, a sentence for each part."""
    parts: dict[str, list[SweptCase]] = {}
    for c in cases:
        parts.setdefault(c.part, []).append(c)
    found = []
    for part, own in parts.items():
        varied = []
        for key in dict.fromkeys(key for c in own for key in c.overrides):
            unit, number = scale(own, key)
            written = [c.overrides[key] for c in own if key in c.overrides]
            known = [x for level in written if (x := number(level)) is not None]
            numeric = len(known) == len(written)
            levels = list(
                dict.fromkeys([f"{x:g}" for x in known] if numeric else map(value, written))
            )
            if len(levels) > 1:
                words = f"{title(key)} ({unit})" if numeric and unit else title(key)
                varied.append(f"{words}: {_levels(levels)}")
        if varied:
            found.append(f"{f'{part}: ' * bool(part)}{'; '.join(varied)}.")
    return found


def cases_table(
    cases: Sequence[SweptCase], names: Sequence[str], links: Mapping[str, str] | None = None
) -> Blocks:
    """Cases with their outcome, the first of their numbers, and links to pages."""
    names = names[:MOST_NUMBERS]
    labels = [f"{words} ({unit})" if unit else words for words, unit in map(label, names)]
    head = ["case", "status", "changes", *labels, "unknowns", "ranks", "time", "message"]
    rows = [
        [
            page.link(c.name, links.get(c.name, "")) if links else c.name,
            c.status if c.exit_code == 0 else f"{c.status}: exit code {c.exit_code}",
            [f"{key} = {layout.plain(level)}" for key, level in c.overrides.items()],
            *(cell(c, name) for name in names),
            f"{c.unknowns or '-'}",
            f"{c.ranks}",
            layout.duration(c.seconds),
            c.message or ("" if not c.done or c.summary else "its folder has no summary.json"),
        ]
        for c in cases
    ]
    said = [k for k in range(len(head)) if k < 3 or {row[k] for row in rows} - {"-", "", "1"}]
    return page.table([head[k] for k in said], [[row[k] for k in said] for row in rows])


def cell(case: SweptCase, name: str) -> str:
    """A number with its error; 0 where it is rounding."""
    q, n = quantities.get(name), case.number(name)
    if n is None or q is None:
        return "-" if n is None else str(n)
    return str(n) if abs(n.value) > 0.01 * 10.0**-q.digits else "0"


def _levels(values: Sequence[str]) -> str:
    if len(values) <= MOST_LEVELS:
        return ", ".join(values)
    return f"{len(values)} levels from {values[0]} to {values[-1]}"


def multiples(cases: Sequence[SweptCase], folder: Path) -> list[Figure]:
    """Draw each headline number over each numeric key that varies."""
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
        draw(folder / file, panels, f"{words} ({scale(done, key)[0]})".replace(" ()", ""), 3)
        left = len(groups) - MOST_SERIES
        more = f" {left} further curves are left out." if left > 0 else ""
        caption = f"Bars: estimated errors, where they are known.{more}"
        figures.append(Figure(file, f"Numbers over {words}", caption, in_words(panels)))
    return figures


def _varies(line: Line) -> bool:
    """Whether a curve varies by more than rounding."""
    values = [n.value for n in line.numbers.values()]
    return max(values, default=0.0) - min(values, default=0.0) > max(ROUNDED.values())


def scale(cases: Sequence[SweptCase], key: str) -> tuple[str, Callable[[Any], float | None]]:
    """Printed unit of a key's values, and conversion of a value to a number in it.

    The unit is that of the file; that of the schema where there are several, or none.
    """
    texts = [str(c.overrides[key]) for c in cases if key in c.overrides]
    written = {match[2] for t in texts if (match := NUMBER.fullmatch(t))}
    if len(written) == 1 and (unit := written.pop()):
        return quantities.printed(unit), magnitude
    kept = keys.unit(key)

    def converted(level: Any) -> float | None:
        match = NUMBER.fullmatch(level) if isinstance(level, str) else None
        if not match or not match[2]:
            return magnitude(level)
        with suppress(LookupError, ValueError):  # an expression, or a key that has no unit
            slope, offset = conversion(match[2], kept)
            return float(Fraction(match[1]) * slope + offset)
        return None

    return quantities.printed(kept), converted


def _groups(cases: Sequence[SweptCase], key: str) -> list[tuple[str, dict[float, SweptCase]]]:
    """Cases that differ in a numeric key alone, by what they have in common."""
    found: dict[str, dict[float, SweptCase]] = {}
    _, number = scale(cases, key)
    for c in cases:
        x = number(c.overrides.get(key))
        if x is not None:
            rest = {k: v for k, v in c.overrides.items() if k != key}
            common = ", ".join(f"{title(k)} {value(v)}" for k, v in rest.items())
            found.setdefault(": ".join(filter(None, (c.part, common))), {})[x] = c
    return [(t, dict(sorted(own.items()))) for t, own in found.items() if len(own) > 1]
