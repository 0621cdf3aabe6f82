"""A page that compares runs: their input, their numbers with errors, and 3D views of all runs."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from app.case import quantities
from app.case.summary import Summary
from app.foundation.errors import InputError
from app.foundation.layout import leaves, noted, plain_text, several, two_digits
from app.foundation.verdict import Severity, recorded
from app.plots.curves import Panel, drawing
from app.report import (
    compared_numbers,
    difference_maps,
    lead,
    page,
    path_curves,
    run_report,
    sweep_figures,
    viewer,
)
from app.report.compared_numbers import ComparedNumber
from app.report.page import Block, LargeNumber, PageSection, bullets, table
from app.report.sweep_results import SweptCase, headlines
from app.results.verdicts import notes_of
from app.system.folders import reading, write_text, writing

# Largest number of runs of a page: a browser draws about sixteen views.
MOST_RUNS = 8
# Numbers of the first table.
LARGEST = 10
# Keys of a case that are not compared.
NOT_COMPARED = ("title", "output")


def write(folders: Sequence[Path], path: Path) -> Path:
    """Write a page that compares runs, two or more, with the first; return it.

    Raises:
        InputError: A folder has no results or unreadable ones, or the number of folders is wrong;
            all errors at once.
        StoppedError: The page cannot be written.
    """
    problems = [
        f"{folder}: has no summary.json; expected a directory written by mantle run"
        for folder in folders
        if not (folder / "summary.json").exists()
    ]
    resolved_folders = [folder.resolve() for folder in folders]
    problems += [
        f"{folder}: given twice; expected another run to compare it with"
        for k, folder in enumerate(folders)
        if resolved_folders[k] in resolved_folders[:k]
    ]
    if not 2 <= len(folders) <= MOST_RUNS:
        problems.append(f"2 to {MOST_RUNS} runs can be compared, not {len(folders)}")
    if problems:
        raise InputError(problems)
    with reading(", ".join(map(str, folders))):
        html = _page(folders)
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, html)
    return path


def _page(folders: Sequence[Path]) -> str:
    names = viewer.distinct(folders)
    cases = [run_report.opened(folder) for folder in folders]
    numbers = compared_numbers.compared_numbers(cases)
    if not numbers:
        raise InputError(f"{', '.join(map(str, folders))}: these runs have no numbers in common")
    view = viewer.viewer(dict(zip(names, folders, strict=True)))
    runs_with_fields = sum((folder / "fields.vtkhdf").exists() for folder in folders)
    all_differences = view.count('class="one"') - runs_with_fields >= len(folders) - 1
    note = "Differences of fields are drawn only for runs on the same mesh."
    notes = noted((name, notes_of(case.summary)) for name, case in zip(names, cases, strict=True))
    noted_text = several(len(notes), "note")
    status = [_status(name, case.summary) for name, case in zip(names, cases, strict=True)]
    return page.page(
        "Comparison of runs",
        [
            PageSection("differences", "Numbers", _numbers(names, cases, numbers)),
            PageSection("strains", "Strain of the cortex", _strains(names, cases)),
            PageSection("paths", "Along paths", path_curves.path_blocks_of_runs(names, cases)),
            PageSection("maps", "Maps of the differences", _maps(names, cases)),
            PageSection("input", "Input that differs", _input(names, cases)),
        ],
        bullets(status) + page.folded(f"{noted_text} on the input", bullets(notes)),
        facts=" · ".join(names),
        lead=_lead(names[0], numbers),
        large=_largest(names, numbers, headlines(cases)),
        view=view,
        note=note if view and not all_differences else "",
    )


def _status(name: str, summary: Summary) -> str:
    errors = [v.text for v in recorded(summary) if v.severity is Severity.ERROR]
    missing_errors = [] if summary.get("error", {}).get("companions") else ["errors not estimated"]
    return "; ".join([f"{summary['status']}: {name}", *missing_errors, *errors])


def _lead(first_run: str, numbers: Sequence[ComparedNumber]) -> str:
    """Return the share of numbers that differ, in sentences: with and without errors."""
    sentences = []
    numbers_with_error = [number for number in numbers if number.known and not number.exact]
    if numbers_with_error:
        count = sum(number.differs for number in numbers_with_error)
        sentence = (
            f"{count} of {len(numbers_with_error)} numbers differ from those of {first_run} by "
            "more than "
        )
        sentences.append(f"{sentence}their errors.")
    numbers_without_error = [number for number in numbers if not number.known]
    if numbers_without_error:
        count = sum(number.differs for number in numbers_without_error)
        sentences.append(
            f"{count} of {len(numbers_without_error)} numbers without errors differ from those of"
            f" {first_run}."
        )
    if numbers_without_error and not numbers_with_error:
        sentences.append("Run with --error to see whether the differences are significant.")
    return " ".join(sentences)


def _largest(
    names: Sequence[str], numbers: Sequence[ComparedNumber], main: Sequence[str]
) -> list[LargeNumber]:
    """Return the most significant differences of the main numbers."""
    large = []
    for number in numbers:
        if number.key not in main or number.exact or not number.differs:
            continue
        run, a, b = max(number.changes, key=lambda change: compared_numbers.share(*change[1:]))
        error = compared_numbers.error_of_difference(a, b)
        unit = number.unit
        first_run = next(k for k, value in enumerate(number.numbers) if value is not None)
        values = [f"{names[k]}: {number.text(k)} {unit}." for k in (first_run, run)]
        large.append(
            LargeNumber(
                f"{b.value - a.value:+.3g}".replace("-", "−"),
                unit,
                page.spelled_out(number.label),
                f"± {two_digits(error)} {unit}" if error is not None else "",
                " ".join(values),
            )
        )
    return large[: lead.MOST_LARGE_NUMBERS]


def _numbers(
    names: Sequence[str], cases: Sequence[SweptCase], numbers: Sequence[ComparedNumber]
) -> list[Block]:
    """Return the largest differences, all others folded, and what cannot be compared."""
    head = ["", *names, *(f"{name} − {names[0]}" for name in names[1:])]
    runs = range(len(names))
    rows = [
        [number.title, *map(number.text, runs), *map(number.difference, runs[1:])]
        for number in numbers
    ]
    remaining_rows = rows[LARGEST:]
    blocks = table(head, rows[:LARGEST])
    remaining_text = several(len(remaining_rows), "number")
    blocks += page.folded(
        f"{remaining_text} with smaller differences",
        table(head, remaining_rows),
    )
    unshared_numbers = compared_numbers.unshared(names, cases)
    return blocks + page.folded("Numbers that cannot be compared", bullets(unshared_numbers))


def _strains(names: Sequence[str], cases: Sequence[SweptCase]) -> list[Block]:
    """Draw the axial strain of the cortex over the distance below the lesser trochanter."""
    panels = []
    for side in ("lateral", "medial"):
        lines = []
        for k, (name, case) in enumerate(zip(names, cases, strict=True)):
            keys = {-z: f"femur.strain_{side}_{gauge}" for gauge, z in quantities.GAUGES.items()}
            line = sweep_figures.curve_of_numbers(
                name, k, {z: case.number(key) for z, key in keys.items()}
            )
            if line.x:
                lines.append(line)
        if len(lines) > 1:
            distance = "distance below the lesser trochanter (mm)"
            panels.append(drawing(Panel(f"{side.capitalize()} strain", "µm/m", lines, distance)))
    return page.drawings(panels, "Axial strain on the outer surface; bars are errors.")


def _maps(names: Sequence[str], cases: Sequence[SweptCase]) -> list[Block]:
    """Draw the differences of the interfaces from the first run, on the surface of the first."""
    titled = list(zip(names, cases, strict=True))
    with tempfile.TemporaryDirectory() as scratch:
        maps, reasons = difference_maps.draw(titled, Path(scratch))
        return page.figures(maps, Path(scratch)) + bullets(reasons)


def _input(names: Sequence[str], cases: Sequence[SweptCase]) -> list[Block]:
    """Keys of the input with their values in each run, where these differ."""
    inputs = []
    keys: dict[str, None] = {}
    for case in cases:
        sections = {key: section for key, section in case.data.items() if key not in NOT_COMPARED}
        values = {key: plain_text(value) for key, value in leaves(sections) if value != {}}
        inputs.append(values)
        keys |= dict.fromkeys(values)
    rows = []
    for key in keys:
        level_texts = [values.get(key, "-") for values in inputs]
        if len(set(level_texts)) > 1:
            rows.append([key, *level_texts])
    return table(["key", *names], rows) or bullets(["nothing: these are runs of the same case"])
