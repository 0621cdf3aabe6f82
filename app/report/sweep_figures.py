"""Figures of a sweep: main numbers over each key that varies."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from fractions import Fraction
from itertools import chain
from pathlib import Path
from urllib.parse import quote

from app.campaigns.uncertainty import correlation
from app.case import keys, quantities
from app.plots.curves import ROUNDED, Line, Panel, draw, drawing
from app.report import page
from app.report.page import Block, Cell, Link
from app.report.sweep_results import PERCENTILES, Number, SweptCase, by_part, magnitude, named
from app.schema.units import NUMBER, conversion
from app.system import layout

# Largest number of panels in a picture.
MOST_PANELS = 12
# Largest number of columns of results in the table of cases.
MOST_NUMBERS = 11
# Largest number of curves in a panel.
MOST_SERIES = 8
# Number of levels of a key above which only the first and the last are written.
MOST_LEVELS = 8
# Abscissa in place of keys of the geometry: mean thickness of the cement mantle they result in.
ACHIEVED = "geometry.achieved_mean_thickness"
# Key of the thickness of the mantle.
THICKNESS = "geometry.cement_thickness"
# Texts of cells without content.
EMPTY = {"-", "", "1"}
# Fewest cases for rank correlations.
FEWEST = 6


def headlines(cases: Sequence[SweptCase]) -> list[str]:
    """Full names of the numbers to show, most important first."""
    names: dict[str, None] = {}
    for case in cases:
        for section in quantities.ADDED.values():
            leading = [q.key for q in quantities.TABLE[section.name].values() if q.headline]
            if section.leads:
                numbers = quantities.numbers_of(case.summary)
                owners = [owner for name, owner, _ in numbers if name == section.name]
                names |= {f"{owner}.{key}": None for owner in owners for key in leading}
        for name in case.summary.get("interfaces", {}):
            names |= {f"{name}.{q}_{statistic}": None for q, statistic in PERCENTILES.items()}
    for case in cases:
        # Bone comes first: heat damages it, while cement may start hot.
        regions = case.summary.get("thermal", {}).get("regions", {})
        order = sorted(regions, key=lambda name: name not in case.bones)
        names |= {f"{name}.temperature_max": None for name in order}
    for case in cases:
        names |= dict.fromkeys(case.numbers)
    known_names = []
    for name in names:
        if not all(case.number(name) is None for case in cases):
            known_names.append(name)
    return known_names


def key_in_words(key: str) -> str:
    """Return a key in words: ``friction coefficient, cement-bone``.

    This is the key ``interfaces.cement_bone.friction_coefficient``.
    """
    without_index = re.sub(r"force\[([012])\]$", lambda m: f"force along {'xyz'[int(m[1])]}", key)
    *path, last_word = without_index.replace("_", " ").split(".")
    if not path or path[0] in ("geometry", "stages", "solver", "output"):
        return last_word
    if path[0] == "interfaces":
        return f"{last_word}, {named(key.split('.')[1])}"
    return f"{' '.join(path[1:]) or path[0]} {last_word}"


def value(level: object) -> str:
    """Return the value of a key as text; a section has its kind."""
    if isinstance(level, dict):
        return str(level.get("kind") or ", ".join(map(str, level.values())))
    return str(level)


def axes_in_words(cases: Sequence[SweptCase]) -> list[str]:
    """Varied keys with all their levels, a sentence for each part."""
    sentences = []
    for part, part_cases in by_part(cases).items():
        varied = []
        for key in dict.fromkeys(chain.from_iterable(c.overrides for c in part_cases)):
            unit, numbers = levels(part_cases, key)
            written_levels = [c.overrides[key] for c in part_cases if key in c.overrides]
            number_texts = [f"{x:g}" for x in numbers if x is not None]
            is_numeric = len(number_texts) == len(written_levels)
            level_texts = [
                *dict.fromkeys(number_texts if is_numeric else map(value, written_levels))
            ]
            level_count = len({*map(str, written_levels)})
            if not is_numeric and len(level_texts) < level_count:
                level_texts = [f"{level_count} of {', '.join(level_texts)}"]
            elif len(level_texts) > MOST_LEVELS:
                sorted_levels = sorted(level_texts, key=float) if is_numeric else level_texts
                level_texts = [
                    f"{len(level_texts)} levels from {sorted_levels[0]} to {sorted_levels[-1]}"
                ]
            elif len(level_texts) < 2:
                continue
            heading = f"{key_in_words(key)} ({unit})" if is_numeric and unit else key_in_words(key)
            varied.append(f"{heading}: {', '.join(level_texts)}")
        if varied:
            of_part = f"{part}: " if part else ""
            sentences.append(f"{of_part}{'; '.join(varied)}.")
    return sentences


def cases_table(cases: Sequence[SweptCase], names: Sequence[str], folder: Path) -> list[Block]:
    """Return cases with their outcome, their first numbers, and links to pages below a folder."""
    names, keys = names[:MOST_NUMBERS], varied_keys(cases)
    head = ["case", "status", "changes", *map(quantities.label_with_unit, names)]
    head += ["unknowns", "ranks", "time", "message"]
    rows: list[list[Cell]] = []
    for c in cases:
        status = c.status if c.exit_code == 0 else f"{c.status}: exit code {c.exit_code}"
        changed_levels = {key: level for key, level in c.overrides.items() if key in keys}
        message = c.message
        if not message and c.done and not c.summary:
            message = "its folder has no summary.json"
        rows.append(
            [
                Link(c.name, _link(c.folder / "report.html", folder)),
                status,
                [f"{key} = {layout.plain_text(level)}" for key, level in changed_levels.items()],
                *(cell(c, name) for name in names),
                f"{c.unknowns or '-'}",
                f"{c.ranks}",
                layout.duration(c.seconds),
                message,
            ]
        )
    # Columns after the third are left out if they are empty.
    filled_columns = []
    for k in range(len(head)):
        column_texts = {str(row[k]) for row in rows}
        if k < 3 or column_texts - EMPTY:
            filled_columns.append(k)
    return page.table(
        [head[k] for k in filled_columns], [[row[k] for k in filled_columns] for row in rows]
    )


def _link(path: Path, folder: Path) -> str:
    return quote(str(path.relative_to(folder))) if path.exists() else ""


def cell(case: SweptCase, name: str) -> str:
    """Return a number of a case with its error as text; 0 if it is rounding."""
    q, n = quantities.quantity_of(name), case.number(name)
    if n is None or q is None:
        return "-" if n is None else str(n)
    return str(n) if abs(n.value) > 0.01 * 10.0**-q.digits else "0"


def multiples(cases: Sequence[SweptCase], folder: Path | None) -> tuple[list[Block], list[Path]]:
    """Draw each main number over each numeric key that varies; write files if a folder is given."""
    converged = [c for c in cases if c.done]
    blocks: list[Block] = []
    files: list[Path] = []
    keys = varied_keys(converged)
    if THICKNESS in keys and any(_mantle(c).get("clipped_fraction") for c in converged):
        keys = [ACHIEVED, *keys]
    for key in keys:
        groups_of_cases = _groups(converged, key)
        key_title, unit_of_x = key_in_words(key), levels(converged, key)[0]
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
            if any(_varies(line.y) for line in lines):
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


def varied_keys(cases: Sequence[SweptCase]) -> list[str]:
    """Keys whose values differ within a part of a sweep; all changed keys of a single case."""
    keys = dict.fromkeys(chain.from_iterable(c.overrides for c in cases))
    if len(cases) == 1:
        return list(keys)
    differing: dict[str, None] = {}
    for part_cases in by_part(cases).values():
        for key in keys:
            if len({str(c.overrides.get(key)) for c in part_cases}) > 1:
                differing[key] = None
    return [key for key in keys if key in differing]


def _varies(values: Sequence[float]) -> bool:
    """Return True if numbers vary by more than rounding."""
    return max(values, default=0.0) - min(values, default=0.0) > max(ROUNDED.values())


def levels(cases: Sequence[SweptCase], key: str) -> tuple[str, list[float | None]]:
    """Return the printed unit of a key, and its value in this unit for each case.

    A value is None if it is not numeric. The unit is the one written in the sweep. If the sweep has
    several units or none, it is the unit of the schema.
    """
    if key == ACHIEVED:
        return "mm", [_mantle(c).get("mean") for c in cases]
    values = [c.overrides.get(key) for c in cases]
    numbers = [magnitude(v) for v in values]
    matches = [NUMBER.fullmatch(str(v)) if v is not None else None for v in values]
    written_units = {match[2] for match in matches if match}
    unit = written_units.pop() if len(written_units) == 1 else None
    if unit:
        return quantities.printed(unit), numbers
    schema_unit = keys.internal_unit(key)
    for k, match in enumerate(matches):
        if match and match[2]:
            numbers[k] = None
            with suppress(LookupError, ValueError):  # the key has no unit
                slope, offset = conversion(match[2], schema_unit)
                numbers[k] = float(Fraction(match[1]) * slope + offset)
    return quantities.printed(schema_unit), numbers


def _mantle(case: SweptCase) -> dict[str, float]:
    """Thickness of a case's mantle [mm]; empty if it has none."""
    thickness: dict[str, float] = (case.summary.get("mantle") or {}).get("thickness", {})
    return thickness


def _groups(cases: Sequence[SweptCase], key: str) -> list[tuple[str, dict[float, SweptCase]]]:
    """Groups of cases that differ in a numeric key alone.

    Each group has a text on the keys that its cases have in common, and its cases by level.
    """
    groups: dict[str, dict[float, SweptCase]] = {}
    other_keys = set(varied_keys(cases)) - {key}
    if key == ACHIEVED:
        other_keys = {k for k in other_keys if not k.startswith("geometry.")}
    for c, x in zip(cases, levels(cases, key)[1], strict=True):
        if x is not None:
            other_changes = [
                f"{key_in_words(k)} {value(v)}" for k, v in c.overrides.items() if k in other_keys
            ]
            common = ": ".join(filter(None, (c.part, ", ".join(other_changes))))
            groups.setdefault(common, {})[x] = c
    return [
        (common_text, dict(sorted(cases_by_level.items())))
        for common_text, cases_by_level in groups.items()
        if len(cases_by_level) > 1
    ]


def sensitivity(cases: Sequence[SweptCase]) -> tuple[list[str], list[tuple[str, list[str]]]]:
    """Return head and rows: rank correlation of each main number with each key.

    Parts with fewer than two varied keys are left out, because a curve shows more.
    """
    rows: list[tuple[str, list[str]]] = []
    for part, part_cases in by_part([c for c in cases if c.done]).items():
        varied: dict[str, Sequence[object]] = {}
        for key in part_cases[0].overrides:
            inputs: Sequence[object] = levels(part_cases, key)[1]
            if None in inputs:
                inputs = [c.overrides.get(key) for c in part_cases]
            if len(set(map(str, inputs))) > 1:
                varied[key] = inputs
        if len(varied) < 2 or len(part_cases) < FEWEST:
            continue
        for name in headlines(part_cases)[:MOST_NUMBERS]:
            numbers = [c.number(name) for c in part_cases]
            y = [number.value for number in numbers if number is not None]
            q = quantities.quantity_of(name)
            if (q and q.exact) or not _varies(y):
                continue
            ranks = {k: correlation(y, x) for k, x in varied.items() if len(y) == len(part_cases)}
            known_ranks = [(r, key_in_words(key)) for key, r in ranks.items() if r is not None]
            known_ranks.sort(key=lambda pair: -abs(pair[0]))
            if known_ranks:
                number_title = ": ".join(filter(None, (part, quantities.label_and_unit(name)[0])))
                rows.append((number_title, [f"{r:+.2f} {k}" for r, k in known_ranks]))
    return ["number", "rank correlation with"], rows
