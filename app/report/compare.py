"""A page that compares runs: input, numbers with errors, bodies under one camera."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from app.case import quantities
from app.errors import InputError, StoppedError
from app.report import page, run_report, sweep_figures, viewer
from app.report.page import Blocks, bullets, table
from app.report.sweep_results import Number, SweptCase
from app.results.closing_lines import UNUSABLE, reasons_not_to_use
from app.system.folders import write_text
from app.system.layout import plain

MOST = 8  # runs beside each other; a browser draws some sixteen views
NAMED = 4  # differences in the leading sentence
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
    if not 2 <= len(folders) <= MOST:
        problems.append(f"2 to {MOST} runs can stand beside each other, not {len(folders)}")
    if problems:
        raise InputError(problems)
    try:
        html = _page(folders)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        names = ", ".join(map(str, folders))
        raise InputError(f"{names}: results that cannot be read: {error!r}") from error
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, html)
    except OSError as error:
        raise StoppedError(f"cannot write {path}: {error.strerror}") from error
    return path


def _page(folders: Sequence[Path]) -> str:
    names = viewer.distinct(folders)
    cases = [run_report.opened(folder) for folder in folders]
    view = viewer.viewer(*folders)
    drawn = sum((folder / "fields.vtkhdf").exists() for folder in folders)
    all_differences = view.count('class="one"') - drawn >= len(folders) - 1
    note = "Differences of fields are drawn where meshes are the same; here they are not all."
    keys = [
        n for n in sweep_figures.headlines(cases) if sum(c.number(n) is not None for c in cases) > 1
    ]
    return page.page(
        "Comparison of runs",
        [
            ("differences", "Numbers", _numbers(names, cases, keys)),
            ("input", "Input that differs", _input(names, cases)),
        ],
        facts=" · ".join(names),
        lead=_lead(names, cases, keys),
        summary=[_status(name, case.summary) for name, case in zip(names, cases, strict=True)],
        view=view,
        note=note if view and not all_differences else "",
    )


def _status(name: str, summary: dict[str, Any]) -> str:
    wrong = reasons_not_to_use(summary)
    status = UNUSABLE if wrong else summary["status"]
    return "; ".join([f"{status}: {name}", *wrong, *summary.get("notes", [])])


def _lead(names: Sequence[str], cases: Sequence[SweptCase], keys: Sequence[str]) -> str:
    """Sentence on the main numbers that differ by more than their errors, largest first."""
    count, known = 0, 0
    beyond: list[tuple[float, str]] = []
    for key in keys:
        if (q := quantities.get(key)) and q.exact:
            continue
        a, *others = (case.number(key) for case in cases)
        for name, b in zip(names[1:], others, strict=True):
            if a is None or b is None:
                continue
            count += 1
            known += a.error is not None and b.error is not None
            if differs(a, b, key):
                words, unit = quantities.in_words(key)
                part = abs(b.value - a.value) / max(abs(a.value), abs(b.value))
                beyond.append((part, f"{words} ({a} {unit}, {name}: {b} {unit})"))
    if not count:
        return "These runs have no numbers in common."
    errors = "" if known == count else f"; the errors of {count - known} are not known"
    if not beyond:
        return f"No main number differs from that of {names[0]} by more than the errors{errors}."
    most = [text for _, text in sorted(beyond, reverse=True)[:NAMED]]
    return (
        f"{len(beyond)} of {count} main numbers differ from those of {names[0]} by more than their "
        f"errors, most of all {'; '.join(most)}{errors}."
    )


def differs(a: Number, b: Number, key: str) -> bool:
    """Whether two numbers differ by more than their errors, and by more than rounding."""
    q = quantities.get(key)
    rounding = 10.0**-q.digits if q else 0.0
    return abs(b.value - a.value) > max((a.error or 0.0) + (b.error or 0.0), rounding)


def _numbers(names: Sequence[str], cases: Sequence[SweptCase], keys: Sequence[str]) -> Blocks:
    """Main numbers with errors, and differences of the other runs from the first."""
    head = ["", *names, *(f"{name} less {names[0]}" for name in names[1:])]
    rows = []
    for key in keys:
        a, *others = (case.number(key) for case in cases)
        own = [sweep_figures.cell(case, key) for case in cases]
        rows.append([quantities.titled(key), *own, *(_difference(a, b, key) for b in others)])
    return table(head, rows)


def _difference(a: Number | None, b: Number | None, key: str) -> str:
    """Difference b - a, with the sum of the errors and relative to a."""
    if a is None or b is None:
        return "-"
    change = b.value - a.value
    error = None if a.error is None or b.error is None else a.error + b.error
    part = f" ({100 * change / abs(a.value):+.1f} %)" if a.value else ""
    if differs(a, b, key):
        return f"{Number(change, error)}{part}"
    if a.error is None and b.error is None:
        return "0"
    return f"{Number(change, error)}{part}, within the errors"


def _input(names: Sequence[str], cases: Sequence[SweptCase]) -> Blocks:
    data = [{k: v for k, v in case.data.items() if k not in NOT_COMPARED} for case in cases]
    flat = [dict(_flat(own)) for own in data]
    keys = dict.fromkeys(key for own in flat for key in own)
    rows = [[key, *(own.get(key, "-") for own in flat)] for key in keys]
    rows = [row for row in rows if len(set(row[1:])) > 1]
    return table(["key", *names], rows) or bullets(["nothing: these are runs of the same case"])


def _flat(values: dict[str, Any], path: str = "") -> Iterator[tuple[str, str]]:
    """Every value of a case by its key, as ``interfaces.stem_cement.clearance``."""
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{path}{key}.")
        else:
            yield f"{path}{key}", plain(value)
