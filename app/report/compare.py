"""A page that compares runs: input, numbers with errors, bodies under one camera."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from app.case import quantities
from app.foundation.errors import InputError, StoppedError
from app.foundation.verdict import Severity, recorded
from app.report import page, run_report, sweep_figures, viewer
from app.report.page import Blocks, bullets, table
from app.report.sweep_results import Number, SweptCase
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
    view = viewer.viewer(dict(zip(names, folders, strict=True)))
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
    shown = [v.text for v in recorded(summary) if v.severity in (Severity.ERROR, Severity.NOTE)]
    unknown = [] if summary.get("error", {}).get("companions") else ["errors not estimated"]
    return "; ".join([f"{summary['status']}: {name}", *unknown, *shown])


def _lead(names: Sequence[str], cases: Sequence[SweptCase], keys: Sequence[str]) -> str:
    """Sentences on the main numbers that differ, largest first: by more than errors, if known."""
    count = {True: 0, False: 0}  # by whether both errors are known
    found: dict[bool, list[tuple[float, str]]] = {True: [], False: []}
    for key in keys:
        q = quantities.get(key)
        if q and q.exact:
            continue
        a, *others = (case.number(key) for case in cases)
        for name, b in zip(names[1:], others, strict=True):
            if a is None or b is None:
                continue
            known = _error(a, b) is not None
            count[known] += 1
            if differs(a, b, key):
                words, unit = quantities.in_words(key)
                part = abs(b.value - a.value) / max(abs(a.value), abs(b.value))
                found[known].append((part, f"{words} ({a} {unit}, {name}: {b} {unit})"))
    said = []
    for known, differing in found.items():
        most = "; ".join(text for _, text in sorted(differing, reverse=True)[:NAMED])
        most = f", most of all {most}" if most else ""
        those = f"{len(differing) or 'none'} of {count[known]} main numbers"
        if count[known] and known:
            text = f"{those} differ from those of {names[0]} by more than their errors{most}."
            said.append(f"{text[0].upper()}{text[1:]}")
        elif count[known]:
            said.append(
                f"Of {count[known]} main numbers errors were not estimated (mantle run --error): "
                f"{len(differing) or 'none'} differ from those of {names[0]}, by more or by less "
                f"than their errors{most}."
            )
    return " ".join(said) or "These runs have no numbers in common."


def _error(a: Number, b: Number) -> float | None:
    """Error of the difference of two numbers; None if one of theirs is not known."""
    return None if a.error is None or b.error is None else a.error + b.error


def differs(a: Number, b: Number, key: str) -> bool:
    """Whether two numbers differ by more than their errors, where known, and than rounding."""
    q = quantities.get(key)
    rounding = 10.0**-q.digits if q else 0.0
    return abs(b.value - a.value) > max(_error(a, b) or 0.0, rounding)


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
    change, error = b.value - a.value, _error(a, b)
    part = f" ({100 * change / abs(a.value):+.1f} %)" if a.value else ""
    if error is None:
        return f"{Number(change)}{part}, errors unknown" if differs(a, b, key) else "0"
    text = f"{Number(change, error)}{part}"
    return text if differs(a, b, key) else f"{text}, within the errors"


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
