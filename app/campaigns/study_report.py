"""Results of a study as a table, ``study.csv``, ``study.json`` and ``study.png``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from app.campaigns import study_parameters, study_picture
from app.campaigns.study_model import FLAT, Measured, Report, StudyRun, percent
from app.campaigns.work_precision import USEFUL, Effectivity, ReferenceValue
from app.case.quantities import Quantity
from app.case.study_file import Source
from app.errors import StoppedError
from app.system import layout
from app.system.folders import csv_text, remove, write_json, write_text
from app.system.layout import duration
from app.version import __version__


def shown(value: float | None, q: Quantity) -> str:
    """A value for people."""
    return "-" if value is None else f"{q.factor * value:.4g} {q.shown}".removesuffix(" -")


def error_text(m: Measured, i: int) -> str:
    """The error of a point: below that of the reference only this is known."""
    error = m.errors[i]
    if error is None:
        return "-"
    return percent(error) if m.points[i].trusted or not error else f"< {percent(error)}"


def describe(reference: ReferenceValue | None, q: Quantity) -> str:
    """The reference in words."""
    if reference is None:
        return "no reference: its runs failed or do not have it"
    text = f"reference {shown(reference.value, q)}"
    if reference.method == "given":
        return f"{text}, given"
    if reference.method == "of one run":
        return f"{text}, of one run: errors are those of the method"
    own = percent(reference.uncertainty / abs(reference.value)) if reference.value else "?"
    order = "" if reference.order is None else f", observed order {reference.order:.1f}"
    return f"{text} ± {own} ({reference.method}{order})"


def table(report: Report) -> str:
    """The report for the terminal."""
    lines = []
    for m in report.quantities:
        estimates = m.compared and any(p.estimate is not None for p in m.points)
        lines += ["", f"{m.name}: {describe(m.reference, m.quantity)}" if m.compared else m.name]
        head = ["", "line", "at", "value", "error", "time", *["estimated", "index"] * estimates]
        rows = [_row(r, m, i)[: len(head)] for i, r in enumerate(report.runs)]
        lines.append(layout.table(head, rows))
        keys = {r.line: r.key for r in report.runs}
        orders = [
            f"{keys[n]}^{p:.1f} along {n}"
            for n, p in m.exponents.items()
            if p is not None and abs(p) >= FLAT
        ]
        if orders:
            lines.append(f"  error goes with {', '.join(orders)}")
        if m.compared:
            lines.append(f"  {m.advice}")
    lines += ["", "* no other run is both faster and closer"]
    if report.effectivity.pairs:
        lines += _effectivity(report.effectivity)
    return "\n".join([*lines, *([report.advice] if report.advice else [])])


def _row(r: StudyRun, m: Measured, i: int) -> list[str]:
    """A point of a quantity."""
    start = ["*" if i in m.front else "", r.line, f"{r.key} {r.label}"]
    if r.result.exit_code:
        return [*start, r.status, "", "", "", ""]
    p, q = m.points[i], m.quantity
    index = "" if p.effectivity is None else f"{p.effectivity:.2f}"
    numbers = [shown(p.value, q), error_text(m, i), duration(p.time or 0)]
    return [*start, *numbers, shown(p.estimate, q), index]


def _effectivity(e: Effectivity) -> list[str]:
    """How good the estimated errors are, and where they are not."""
    low, high = USEFUL
    lines = [
        f"estimated over true error is within {low:g} to {high:g} for {e.useful} of {e.pairs} "
        f"numbers ({percent(e.useful / e.pairs)})"
    ]
    for name, p in e.others:
        lines.append(f"  {name} with {p.line} at {p.label}: {p.effectivity:.2f}")
    return lines


def write(report: Report, source: Source, cores: int, folder: Path) -> list[str]:
    """Write the files.

    Returns:
        Their names; a picture of nothing is not drawn.

    Raises:
        StoppedError: The folder cannot be written.
    """
    record = {
        "mantle": __version__,
        "study": source.file.name,
        "case": str(source.case),
        "overrides": source.overrides,
        "cores": cores,
        **_record(report),
    }
    try:
        # What is not drawn again would stay beside other numbers.
        remove(folder / name for name in ("study.png", "study_parameters.png"))
        write_json(folder / "study.json", record)
        write_text(folder / "study.csv", _csv(report))
        drawn = {
            "study.png": study_picture.picture(report, folder / "study.png"),
            "study_parameters.png": study_parameters.picture(
                report, folder / "study_parameters.png"
            ),
        }
    except OSError as error:
        raise StoppedError(f"cannot write the study in {folder}: {error.strerror}") from error
    return ["study.json", "study.csv", *(name for name, done in drawn.items() if done)]


def _record(report: Report) -> dict[str, Any]:
    """The report as plain data."""
    e = report.effectivity
    return {
        "target": report.target,
        "advice": report.advice,
        "quantities": {
            m.name: {
                "unit": m.quantity.unit,
                "advice": m.advice,
                "compared": m.compared,
                "reference": None if m.reference is None else asdict(m.reference),
                "exponents": m.exponents,
                "points": [
                    asdict(p)
                    | {"effectivity": p.effectivity, "trusted": p.trusted, "pareto": i in m.front}
                    for i, p in enumerate(m.points)
                ],
            }
            for m in report.quantities
        },
        "effectivity": {
            "pairs": e.pairs,
            "useful": e.useful,
            "others": [[n, p.line, p.label, p.effectivity] for n, p in e.others],
        },
        "runs": [_run_record(r) for r in report.runs],
        "reference_runs": [_run_record(r) for r in report.ladder],
    }


def _run_record(r: StudyRun) -> dict[str, Any]:
    return {
        "line": r.line,
        "overrides": r.changes,
        "status": r.status,
        "message": r.result.message,
        "folder": str(r.result.folder),
        "time": r.time,
        "timing": r.result.summary.get("timing"),
        "solver": r.result.summary.get("solver"),
    }


def _csv(report: Report) -> str:
    """A row for each run and quantity; values in the unit of their row."""
    return csv_text([_flat(r, m, i) for m in report.quantities for i, r in enumerate(report.runs)])


def _flat(r: StudyRun, m: Measured, i: int) -> dict[str, Any]:
    """A point of a quantity with what it cost."""
    p, ref, summary = m.points[i], m.reference, r.result.summary
    timing, solver = summary.get("timing", {}), summary.get("solver", {})
    return {
        "line": r.line,
        "key": r.key,
        "at": r.label,
        "number [internal]": r.x,
        "status": r.status,
        "quantity": m.name,
        "unit": m.quantity.unit,
        "value": p.value,
        "reference": ref and ref.value,
        "reference uncertainty": ref and ref.uncertainty,
        "error [-]": p.error,
        "error exceeds uncertainty": int(p.trusted),
        "estimated error": p.estimate,
        "effectivity [-]": p.effectivity,
        "pareto": int(i in m.front),
        "time [s]": r.time,
        **{f"{key} [s]": timing.get(key) for key in ("mesh", "compile", "error", "total")},
        "unknowns": solver.get("dofs"),
        "steps": solver.get("steps"),
        "newton iterations": solver.get("newton_iterations"),
        "krylov iterations": solver.get("linear_iterations"),
        "condition": solver.get("condition"),
        "ranks": r.result.job.ranks,
    }
