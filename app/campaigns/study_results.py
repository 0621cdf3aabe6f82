"""Results of a study: plain data, a table, ``study.csv`` and ``study.json``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from app.campaigns.runs import Result
from app.campaigns.work_precision import HIGHEST_ORDER, NOT_CONVERGING, ErrorPoint, ReferenceValue
from app.case.quantities import Quantity
from app.foundation import layout
from app.foundation.layout import duration, percent
from app.system.folders import csv_text, write_json, write_text

# Absolute exponent below which the error does not depend on the key.
FLAT_EXPONENT = 0.05


@dataclass(frozen=True)
class StudyRun:
    """A run of a line or of the reference, and its result.

    Attributes:
        line: Name of the line; empty for the reference.
        key: Key shown on the axis; empty if none varies.
        label: Value of that key, as written.
        x: Value of the key in `unit`, if it is a number.
        unit: Internal unit; empty if it has none.
        time: Run time without meshing, compiling and companion runs [s]; None if it failed.
    """

    line: str
    result: Result
    key: str
    label: str
    x: float | None
    unit: str
    time: float | None

    @property
    def highest_order(self) -> float:
        """Highest order of the errors in the key; for mesh size, twice that of the elements."""
        of_mesh = self.key == "mesh.size"
        return 2.0 * self.result.planned.case.mesh.order if of_mesh else HIGHEST_ORDER

    @property
    def status(self) -> str:
        """``done``, or ``failed`` with the exit code."""
        code = self.result.exit_code
        return f"failed (exit code {code})" if code else "done"


@dataclass(frozen=True)
class Measured:
    """One quantity over the runs of all lines.

    Attributes:
        compared: True if it is compared with a reference; otherwise only values are shown.
        points: Value and error in each run.
        exponents: The exponent p of error ~ key^p along each line.
        front: Pareto front of time and error: indices of points, fastest first.
    """

    name: str
    quantity: Quantity
    compared: bool
    reference: ReferenceValue | None
    points: Sequence[ErrorPoint]
    exponents: dict[str, float | None]
    front: list[int]

    @property
    def uncertainty(self) -> float:
        """Relative uncertainty of the reference; 0 without a reference or if its value is 0."""
        is_known = self.reference is not None and self.reference.value
        return self.reference.uncertainty / abs(is_known) if self.reference and is_known else 0.0

    @property
    def errors(self) -> list[float | None]:
        """Error of each point, at least the uncertainty of the reference; None if unknown."""
        return [p.bound for p in self.points]


@dataclass(frozen=True)
class Report:
    """All results of a study.

    Attributes:
        target: Relative error that is aimed at.
        runs: The runs of all lines.
        ladder: The runs of the reference.
        advice: Sentence on the cost of accuracy for each compared quantity; the key "" is for all.
    """

    target: float
    runs: Sequence[StudyRun]
    ladder: Sequence[StudyRun]
    quantities: Sequence[Measured]
    advice: Mapping[str, str]

    @property
    def covered(self) -> list[bool]:
        """For each number with a known error: True if the true value lies within its ±."""
        indices = [p.effectivity for m in self.quantities for p in m.points]
        return [index >= 1.0 for index in indices if index is not None]


def value_with_unit(value: float | None, q: Quantity) -> str:
    """Format a value with its unit; a dash for None."""
    return "-" if value is None else f"{q.factor * value:.4g} {q.shown}".removesuffix(" -")


def exponent_text(report: Report, m: Measured, line: str) -> str:
    """Return the exponent of a line as text.

    The text is empty if the error does not depend on the key, and `NOT_CONVERGING` if the elements
    cannot have this order.
    """
    p = m.exponents[line]
    if p is None or abs(p) < FLAT_EXPONENT:
        return ""
    first_run = next(r for r in report.runs if r.line == line)
    likely = first_run.key != "mesh.size" or 0.0 < round(p, 1) <= first_run.highest_order
    return f"{p:.1f}" if likely else NOT_CONVERGING


def reference_in_words(reference: ReferenceValue | None, q: Quantity) -> str:
    """Return the reference value with its uncertainty and observed order, in words."""
    if reference is None:
        return "no reference: its runs failed or lack this number"
    reference_text = f"reference {value_with_unit(reference.value, q)}"
    if reference.method == "given":
        return f"{reference_text}, given"
    if reference.method == "of one run":
        return f"{reference_text}, of one run: errors are those of the method"
    relative = percent(reference.uncertainty / abs(reference.value)) if reference.value else "?"
    order = "" if reference.order is None else f", observed order {reference.order:.1f}"
    return f"{reference_text} ± {relative} ({reference.method}{order})"


def table_of_study(report: Report) -> str:
    """Format the report for the terminal."""
    lines = []
    for m in report.quantities:
        estimates = m.compared and any(p.estimate is not None for p in m.points)
        lines += [
            "",
            f"{m.name}: {reference_in_words(m.reference, m.quantity)}" if m.compared else m.name,
        ]
        head = ["", "line", "at", "value", "error", "time", *["estimated", "index"] * estimates]
        rows = [_row(r, m, i)[: len(head)] for i, r in enumerate(report.runs)]
        lines.append(layout.text_table(head, rows))
        keys = {r.line: r.key for r in report.runs}
        orders = []
        for name in m.exponents:
            p = exponent_text(report, m, name)
            if p == NOT_CONVERGING:
                orders.append(f"{p} along {name}")
            elif p:
                orders.append(f"{keys[name]}^{p} along {name}")
        if orders:
            lines.append(f"  error goes with {', '.join(orders)}")
        if m.compared:
            lines.append(f"  {report.advice[m.name]}")
    lines += ["", "* no other run is both faster and closer"]
    coverage = report.covered
    if coverage:
        lines.append(f"the truth lies within ± for {sum(coverage)} of {len(coverage)} numbers")
    if "" in report.advice:
        lines.append(report.advice[""])
    return "\n".join(lines)


def _row(r: StudyRun, m: Measured, i: int) -> list[str]:
    start = ["*" if i in m.front else "", r.line, f"{r.key} {r.label}"]
    if r.result.exit_code:
        return [*start, r.status, "", "", "", ""]
    p, q, error = m.points[i], m.quantity, m.errors[i]
    # The error is below the uncertainty of the reference.
    below = "" if p.trusted or not error else "< "
    shown_error = "-" if error is None else f"{below}{percent(error)}"
    index = "" if p.effectivity is None else f"{p.effectivity:.2f}"
    numbers = [value_with_unit(p.value, q), shown_error, duration(r.time or 0)]
    return [*start, *numbers, value_with_unit(p.estimate, q), index]


def write(report: Report, about: Mapping[str, object], folder: Path) -> list[str]:
    """Write ``study.json``, which begins with ``about``, and ``study.csv``; return their names."""
    quantity_records = {}
    rows = []
    for m in report.quantities:
        quantity_records[m.name] = {
            "unit": m.quantity.unit,
            "advice": report.advice.get(m.name, ""),
            "compared": m.compared,
            "reference": None if m.reference is None else asdict(m.reference),
            "exponents": m.exponents,
            "points": [_point_record(r, m, i) for i, r in enumerate(report.runs)],
        }
        rows += [_flat(r, m, i) for i, r in enumerate(report.runs)]
    record = {
        **about,
        "target": report.target,
        "advice": report.advice.get("", ""),
        "quantities": quantity_records,
        "within": {"numbers": len(report.covered), "covered": sum(report.covered)},
        "runs": [_run_record(r) for r in report.runs],
        "reference_runs": [_run_record(r) for r in report.ladder],
    }
    write_json(folder / "study.json", record)
    write_text(folder / "study.csv", csv_text(rows))
    return ["study.json", "study.csv"]


def _point_record(r: StudyRun, m: Measured, i: int) -> dict[str, object]:
    p = m.points[i]
    judged = {"effectivity": p.effectivity, "trusted": p.trusted, "pareto": i in m.front}
    return {"line": r.line, "label": r.label, "x": r.x, "time": r.time} | asdict(p) | judged


def _run_record(r: StudyRun) -> dict[str, object]:
    return {
        "line": r.line,
        "overrides": r.result.planned.point.changes,
        "status": r.status,
        "message": r.result.message,
        "folder": str(r.result.folder),
        "time": r.time,
        "timing": r.result.summary.get("timing"),
        "solver": r.result.summary.get("solver"),
    }


def _flat(r: StudyRun, m: Measured, i: int) -> dict[str, object]:
    """Return a row of ``study.csv``: a quantity of a run in the unit of the row, and its cost."""
    p, timing = m.points[i], r.result.summary.get("timing", {})
    solver = r.result.summary.get("solver", {})
    counts = {"unknowns": "dofs", "steps": "steps", "newton iterations": "newton_iterations"}
    counts |= {"krylov iterations": "linear_iterations", "condition": "condition"}
    return {
        "line": r.line,
        "key": r.key,
        "at": r.label,
        "number [internal]": r.x,
        "status": r.status,
        "quantity": m.name,
        "unit": m.quantity.unit,
        "value": p.value,
        "reference": m.reference and m.reference.value,
        "reference uncertainty": m.reference and m.reference.uncertainty,
        "error [-]": p.error,
        "error exceeds uncertainty": int(p.trusted),
        "estimated error": p.estimate,
        "effectivity [-]": p.effectivity,
        "pareto": int(i in m.front),
        "time [s]": r.time,
        **{f"{key} [s]": timing.get(key) for key in ("mesh", "compile", "error", "total")},
        **{title: solver.get(key) for title, key in counts.items()},
        "ranks": r.result.planned.ranks,
    }
