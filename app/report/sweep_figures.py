"""Figures of a sweep: main numbers over each key that varies."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path

from app.case import quantities
from app.case.number_text import Number
from app.plots.curves import Line, Panel, draw, drawing
from app.report import page
from app.report.page import Block
from app.report.sweep_keys import (
    ACHIEVED,
    THICKNESS,
    key_in_words,
    level_text,
    levels_of,
    mantle_thickness,
    varied_keys,
)
from app.report.sweep_results import SweptCase, headlines, is_varying

# Largest number of panels in a picture.
MOST_PANELS = 12
# Largest number of curves in a panel.
MOST_SERIES = 8


def draw_over_keys(
    cases: Sequence[SweptCase], folder: Path | None
) -> tuple[list[Block], list[Path]]:
    """Draw each main number over each numeric key that varies; write files if a folder is given."""
    converged = [c for c in cases if c.done]
    blocks: list[Block] = []
    files: list[Path] = []
    drawn_keys = varied_keys(converged)
    if THICKNESS in drawn_keys and any(
        mantle_thickness(c).get("clipped_fraction") for c in converged
    ):
        drawn_keys = [ACHIEVED, *drawn_keys]
    for key in drawn_keys:
        groups_of_cases = _groups(converged, key)
        key_title, unit_of_x = key_in_words(key), levels_of(converged, key)[0]
        x = f"{key_title} ({unit_of_x})" if unit_of_x else key_title
        panels = []
        drawn_cases = list(
            chain.from_iterable(by_level.values() for _, by_level in groups_of_cases)
        )
        for name in headlines(drawn_cases):
            number_title, unit = quantities.label_and_unit(name)
            lines = []
            for k, (common, by_level) in enumerate(groups_of_cases[:MOST_SERIES]):
                numbers = {level: c.number(name) for level, c in by_level.items()}
                lines.append(curve_of_numbers(common, k, numbers))
            if any(is_varying(line.y) for line in lines):
                panels.append(Panel(page.spelled_out(number_title), unit or "value", lines, x))
        panels = panels[:MOST_PANELS]
        all_lines = chain.from_iterable(panel.lines for panel in panels)
        if all(len(line.x) < 2 for line in all_lines):
            continue
        if folder:
            file = f"over_{re.sub(r'[^a-zA-Z0-9]', '_', key)}.png"
            files += draw(folder / file, panels, 3)[:1]
        left_out = len(groups_of_cases) - MOST_SERIES
        rest_text = f" {left_out} further curves are left out." if left_out > 0 else ""
        caption = f"Bars: estimated errors, where they are known.{rest_text}"
        drawings = page.drawings([drawing(panel) for panel in panels], caption)
        blocks += page.titled(f"Numbers over {key_title}", drawings)
    return blocks, files


def curve_of_numbers(label: str, style: int, numbers: Mapping[float, Number | None]) -> Line:
    """Return a curve of the numbers that are known, with their errors."""
    known_numbers = {x: n for x, n in numbers.items() if n is not None}
    errors = [n.error or 0.0 for n in known_numbers.values()]
    return Line(
        label, style, list(known_numbers), [n.value for n in known_numbers.values()], errors
    )


def _groups(cases: Sequence[SweptCase], key: str) -> list[tuple[str, dict[float, SweptCase]]]:
    """Groups of cases that differ in a numeric key alone.

    Each group has a text on the keys that its cases have in common, and its cases by level.
    """
    groups: dict[str, dict[float, SweptCase]] = {}
    other_keys = set(varied_keys(cases)) - {key}
    if key == ACHIEVED:
        other_keys = {k for k in other_keys if not k.startswith("geometry.")}
    for c, x in zip(cases, levels_of(cases, key)[1], strict=True):
        if x is not None:
            other_changes = [
                f"{key_in_words(k)} {level_text(v)}"
                for k, v in c.overrides.items()
                if k in other_keys
            ]
            common = ": ".join(filter(None, (c.part, ", ".join(other_changes))))
            groups.setdefault(common, {})[x] = c
    return [
        (common_text, dict(sorted(cases_by_level.items())))
        for common_text, cases_by_level in groups.items()
        if len(cases_by_level) > 1
    ]
