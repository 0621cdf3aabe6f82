"""A page that compares runs: input, numbers with errors, bodies under one camera."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from app.case import quantities
from app.foundation.errors import InputError, StoppedError
from app.foundation.verdict import Severity, recorded
from app.report import lead, page, run_report, sweep_figures, viewer
from app.report.page import Block, LargeNumber, PageSection, bullets, table
from app.report.sweep_results import Json, Number, SweptCase
from app.results.verdicts import notes_of
from app.system.folders import write_text
from app.system.layout import noted, plain

# Runs of a page: a browser draws some sixteen views.
MOST = 8
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
    if not 2 <= len(folders) <= MOST:
        problems.append(f"2 to {MOST} runs can be compared, not {len(folders)}")
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
    note = "Differences of fields are drawn only for runs on the same mesh."
    keys = [
        n for n in sweep_figures.headlines(cases) if sum(c.number(n) is not None for c in cases) > 1
    ]
    changes = _changes(names, cases, keys)
    notes = noted((name, notes_of(case.summary)) for name, case in zip(names, cases, strict=True))
    status = [_status(name, case.summary) for name, case in zip(names, cases, strict=True)]
    return page.page(
        "Comparison of runs",
        [
            PageSection("differences", "Numbers", _numbers(names, cases, keys)),
            PageSection("input", "Input that differs", _input(names, cases)),
        ],
        bullets(status) + page.folded(f"{len(notes)} notes on the input", bullets(notes)),
        facts=" · ".join(names),
        lead=_lead(names[0], changes),
        large=_largest(changes),
        view=view,
        note=note if view and not all_differences else "",
    )


def _status(name: str, summary: Json) -> str:
    errors = [v.text for v in recorded(summary) if v.severity is Severity.ERROR]
    unknown = [] if summary.get("error", {}).get("companions") else ["errors not estimated"]
    return "; ".join([f"{summary['status']}: {name}", *unknown, *errors])


@dataclass(frozen=True)
class Change:
    """A number of a run against the first run.

    Attributes:
        key: The number, as ``<interface or region>.<key>``.
        names: Names of the first run and of the other one.
        numbers: The numbers of both.
    """

    key: str
    names: tuple[str, str]
    numbers: tuple[Number, Number]

    @property
    def known(self) -> bool:
        """True if the errors of both numbers are known."""
        return _error(*self.numbers) is not None

    @property
    def differs(self) -> bool:
        """True if the numbers differ by more than their errors, where these are known."""
        return differs(*self.numbers, self.key)

    @property
    def share(self) -> float:
        """Difference over the larger of both numbers."""
        a, b = (number.value for number in self.numbers)
        return abs(b - a) / (max(abs(a), abs(b)) or 1.0)


def _changes(names: Sequence[str], cases: Sequence[SweptCase], keys: Sequence[str]) -> list[Change]:
    """Return the main numbers of all other runs against the first."""
    changes = []
    for key in keys:
        q = quantities.get(key)
        if q and q.exact:
            continue
        a, *others = (case.number(key) for case in cases)
        for name, b in zip(names[1:], others, strict=True):
            if a is not None and b is not None:
                changes.append(Change(key, (names[0], name), (a, b)))
    return changes


def _lead(first: str, changes: Sequence[Change]) -> str:
    """Return the share of main numbers that differ, in sentences: with and without errors."""
    sentences = []
    known = [change for change in changes if change.known]
    if known:
        count = sum(change.differs for change in known)
        text = f"{count} of {len(known)} main numbers differ from those of {first} by more than "
        sentences.append(f"{text}their errors.")
    others = [change for change in changes if not change.known]
    if others:
        count = sum(change.differs for change in others)
        text = f"{count} of {len(others)} main numbers without errors differ from those of {first}."
        cure = "Run with --error to see whether the differences are significant."
        sentences += [text, cure] if count else [text]
    return " ".join(sentences) or "These runs have no numbers in common."


def _largest(changes: Sequence[Change]) -> list[LargeNumber]:
    """Return the largest differences: those beyond known errors first."""
    differing = [change for change in changes if change.differs]
    differing.sort(key=lambda change: (not change.known, -change.share))
    numbers = []
    for change in differing[: lead.MOST]:
        a, b = change.numbers
        words, unit = quantities.in_words(change.key)
        one, other = change.names
        shown = [_rounded(number, change.key) for number in (a, b)]
        error = _error(a, b)
        numbers.append(
            LargeNumber(
                f"{b.value - a.value:+.3g}".replace("-", "−"),
                unit,
                page.spelled_out(words),
                f"± {error:.2g} {unit}" if error is not None else "",
                f"{one}: {shown[0]} {unit}. {other}: {shown[1]} {unit}.",
            )
        )
    return numbers


def _rounded(number: Number, key: str) -> str:
    """Return a number as text; 0 where it is rounding."""
    q = quantities.get(key)
    return "0" if q and abs(number.value) < 0.01 * 10.0**-q.digits else str(number)


def _error(a: Number, b: Number) -> float | None:
    """Error of the difference of two numbers; None if an error is unknown."""
    return None if a.error is None or b.error is None else a.error + b.error


def differs(a: Number, b: Number, key: str) -> bool:
    """Return True if two numbers differ by more than rounding and than their known errors."""
    q = quantities.get(key)
    rounding = 10.0**-q.digits if q else 0.0
    return abs(b.value - a.value) > max(_error(a, b) or 0.0, rounding)


def _numbers(names: Sequence[str], cases: Sequence[SweptCase], keys: Sequence[str]) -> list[Block]:
    """Main numbers with errors, and differences of the other runs from the first."""
    head = ["", *names, *(f"{name} − {names[0]}" for name in names[1:])]
    rows = []
    for key in keys:
        a, *others = (case.number(key) for case in cases)
        values = [sweep_figures.cell(case, key) for case in cases]
        rows.append([quantities.titled(key), *values, *(_difference(a, b, key) for b in others)])
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


def _input(names: Sequence[str], cases: Sequence[SweptCase]) -> list[Block]:
    """Keys of the input with their values in each run, where these differ."""
    data = [{k: v for k, v in case.data.items() if k not in NOT_COMPARED} for case in cases]
    flat = [dict(_flat(values)) for values in data]
    keys = dict.fromkeys(key for values in flat for key in values)
    rows = [[key, *(values.get(key, "-") for values in flat)] for key in keys]
    rows = [row for row in rows if len(set(row[1:])) > 1]
    return table(["key", *names], rows) or bullets(["nothing: these are runs of the same case"])


def _flat(values: Json, path: str = "") -> Iterator[tuple[str, str]]:
    """Every value of a case by its key, as ``interfaces.stem_cement.clearance``."""
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{path}{key}.")
        else:
            yield f"{path}{key}", plain(value)
