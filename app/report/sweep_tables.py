"""Tables and sentences of a sweep: its axes, its cases, and rank correlations with its keys."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from urllib.parse import quote

from app.campaigns.uncertainty import correlation
from app.case import quantities
from app.foundation import layout
from app.report import page
from app.report.page import Block, Cell, Link
from app.report.sweep_keys import key_in_words, level_text, levels_of, varied_keys
from app.report.sweep_results import SweptCase, by_part, headlines, is_varying

# Largest number of columns of results in the table of cases.
MOST_NUMBERS = 11
# Number of levels of a key above which only the first and the last are written.
MOST_LEVELS = 8
# Texts of cells without content.
EMPTY = {"-", ""}
# Fewest cases for rank correlations.
FEWEST_CASES = 6


def axes_in_words(cases: Sequence[SweptCase]) -> list[str]:
    """Return one sentence per part of the sweep, with its varied keys and their levels.

    A part is one of several sets of points in a sweep file (`by_part`).
    """
    sentences = []
    for part, part_cases in by_part(cases).items():
        key_texts = []
        for key in dict.fromkeys(chain.from_iterable(c.overrides for c in part_cases)):
            unit, numbers = levels_of(part_cases, key)
            written_levels = [c.overrides[key] for c in part_cases if key in c.overrides]
            number_texts = [f"{x:g}" for x in numbers if x is not None]
            is_numeric = len(number_texts) == len(written_levels)
            level_texts = [
                *dict.fromkeys(number_texts if is_numeric else map(level_text, written_levels))
            ]
            level_count = len({*map(str, written_levels)})
            if not is_numeric and len(level_texts) < level_count:
                level_texts = [f"{level_count} values of {', '.join(level_texts)}"]
            elif len(level_texts) > MOST_LEVELS:
                sorted_levels = sorted(level_texts, key=float) if is_numeric else level_texts
                level_texts = [
                    f"{len(level_texts)} levels from {sorted_levels[0]} to {sorted_levels[-1]}"
                ]
            elif len(level_texts) < 2:
                continue
            heading = f"{key_in_words(key)} ({unit})" if is_numeric and unit else key_in_words(key)
            key_texts.append(f"{heading}: {', '.join(level_texts)}")
        if key_texts:
            of_part = f"{part}: " if part else ""
            sentences.append(f"{of_part}{'; '.join(key_texts)}.")
    return sentences


def cases_table(cases: Sequence[SweptCase], names: Sequence[str], folder: Path) -> list[Block]:
    """Return a table of the cases: status, changed keys, numbers, and links to their pages.

    Args:
        cases: The cases.
        names: Names of numbers; the first `MOST_NUMBERS` are shown.
        folder: Folder of the page, to which links are relative.
    """
    names, shown_keys = names[:MOST_NUMBERS], varied_keys(cases)
    head = ["case", "status", "changes", *map(quantities.label_with_unit, names)]
    head += ["unknowns", "ranks", "time", "message"]
    rows: list[list[Cell]] = []
    is_parallel = any(c.ranks != 1 for c in cases)
    for c in cases:
        status = c.status if c.exit_code == 0 else f"{c.status}: exit code {c.exit_code}"
        changed_levels = {key: level for key, level in c.overrides.items() if key in shown_keys}
        message = c.message
        if not message and c.done and not c.summary:
            message = "its folder has no summary.json"
        rows.append(
            [
                Link(c.name, _link(c.folder / "report.html", folder)),
                status,
                [f"{key} = {layout.plain_text(level)}" for key, level in changed_levels.items()],
                *(number_text(c, name) for name in names),
                f"{c.unknowns or '-'}",
                f"{c.ranks}" if is_parallel else "",
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


def number_text(case: SweptCase, name: str) -> str:
    """Return a number of a case with its error as text; 0 if it is rounding."""
    q, n = quantities.quantity_of(name), case.number(name)
    if n is None:
        return "-"
    return n.text(10.0**-q.digits if q else 0.0)


def sensitivity(cases: Sequence[SweptCase]) -> tuple[list[str], list[tuple[str, list[str]]]]:
    """Return head and rows: rank correlation of each main number with each key.

    Parts with fewer than two varied keys are left out, because a curve shows more. Parts with fewer
    than `FEWEST_CASES` cases are left out too.
    """
    rows: list[tuple[str, list[str]]] = []
    for part, part_cases in by_part([c for c in cases if c.done]).items():
        inputs_of_key: dict[str, Sequence[object]] = {}
        for key in part_cases[0].overrides:
            inputs: Sequence[object] = levels_of(part_cases, key)[1]
            if None in inputs:
                inputs = [c.overrides.get(key) for c in part_cases]
            if len(set(map(str, inputs))) > 1:
                inputs_of_key[key] = inputs
        if len(inputs_of_key) < 2 or len(part_cases) < FEWEST_CASES:
            continue
        for name in headlines(part_cases)[:MOST_NUMBERS]:
            numbers = [c.number(name) for c in part_cases]
            y = [number.value for number in numbers if number is not None]
            q = quantities.quantity_of(name)
            if (q and q.exact) or not is_varying(y):
                continue
            correlations = {
                k: correlation(y, x) for k, x in inputs_of_key.items() if len(y) == len(part_cases)
            }
            known_ranks = [
                (r, key_in_words(key)) for key, r in correlations.items() if r is not None
            ]
            known_ranks.sort(key=lambda pair: -abs(pair[0]))
            if known_ranks:
                number_title = ": ".join(filter(None, (part, quantities.label_and_unit(name)[0])))
                rows.append((number_title, [f"{r:+.2f} {k}" for r, k in known_ranks]))
    return ["number", "rank correlation with"], rows
