"""Table of the runs of a sweep, or of the variations of a case."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import TypedDict

from app.case import quantities, summary_numbers
from app.case.points import Point
from app.case.summary import Summary
from app.foundation import layout
from app.results.verdicts import notes_of
from app.system.folders import csv_text, write_json, write_text


class RunRow(TypedDict):
    """A run in the table.

    Attributes:
        name: Name of the run.
        overrides: Changed keys of the case, with their values.
        status: Such as converged, not converged or stopped.
        numbers: Main numbers by full name, in the units of ``summary.json``.
        errors: Their estimated errors, as far as they are known.
        notes: Notes on the case.
        unknowns: Number of unknowns; None without results.
        newton_iterations: Number of Newton iterations; None without results.
        linear_iterations: Number of Krylov iterations; None without results.
        seconds: Wall time [s].
        folder: Run directory, relative to the folder of the table.
    """

    name: str
    overrides: dict[str, object]
    status: str
    numbers: dict[str, float]
    errors: dict[str, float]
    notes: list[str]
    unknowns: int | None
    newton_iterations: int | None
    linear_iterations: int | None
    seconds: float
    folder: str


class SweepRow(RunRow):
    """A run in the table of a sweep.

    Attributes:
        part: Part of the sweep; empty if there is only one.
        ranks: Number of ranks.
        exit_code: Exit code of the run.
        message: Reason of a failure, with the last lines of the log.
    """

    part: str
    ranks: int
    exit_code: int
    message: str


# Quantities that the text table shows, the first that a run has, and words around the unit.
TEXT_QUANTITIES = {
    "micromotion_p99": "micromotion (p99) of",
    "slip_p99": "slip (p99) on",
    "temperature_max": "in",
}


def row(point: Point, summary: Summary, status: str, seconds: float) -> RunRow:
    """Return the row of a run.

    Args:
        point: Name of the run and its overrides.
        summary: Content of ``summary.json`` of the run; empty if there is none.
        status: Such as converged, not converged or stopped.
        seconds: Wall time.
    """
    solver = summary.get("solver", {})
    numbers = list(summary_numbers.main_numbers(summary))
    return {
        "name": point.name,
        "overrides": point.changes,
        "status": status,
        "numbers": {name: value for name, _, value, _ in numbers},
        "errors": {name: error for name, _, _, error in numbers if error is not None},
        "notes": notes_of(summary),
        "unknowns": solver.get("dofs"),
        "newton_iterations": solver.get("newton_iterations"),
        "linear_iterations": solver.get("linear_iterations"),
        "seconds": round(seconds, 3),
        "folder": point.name,
    }


def csv_of_runs(rows: Sequence[RunRow], keys: Sequence[str], first: str) -> str:
    """Format the table as CSV with columns for ``keys``; ``first`` is the title of the names."""
    return csv_text([_flat(r, keys, first) for r in rows])


def _flat(row: RunRow, keys: Sequence[str], first: str) -> dict[str, object]:
    numbers = {}
    for name, value in row["numbers"].items():
        unit = quantities.quantity_or_fail(name).unit
        numbers[f"{name} [{unit}]"] = value
        if name in row["errors"]:
            numbers[f"{name} error [{unit}]"] = row["errors"][name]
    return {
        first: row["name"],
        "status": row["status"],
        "notes": "; ".join(row["notes"]),
        **{key: row["overrides"].get(key, "") for key in keys},
        **numbers,
        "unknowns [-]": row["unknowns"],
        "newton [-]": row["newton_iterations"],
        "krylov [-]": row["linear_iterations"],
        "wall [s]": row["seconds"],
        "folder": row["folder"],
    }


def write_variations(rows: Sequence[RunRow], folder: Path) -> list[RunRow]:
    """Write ``variations.json`` and ``variations.csv``; return the rows."""
    keys = list(dict.fromkeys(chain.from_iterable(r["overrides"] for r in rows)))
    write_json(folder / "variations.json", rows)
    write_text(folder / "variations.csv", csv_of_runs(rows, keys, "name"))
    return [*rows]


def text_of_runs(rows: Sequence[RunRow]) -> str:
    """Format the table as text: one line per run with its most informative number."""
    lines = []
    for r in rows:
        counts = (r["unknowns"], r["newton_iterations"], r["linear_iterations"])
        result = most_informative(r["numbers"]) if r["status"] == "converged" else r["status"]
        lines.append((r["name"], *counts, layout.duration(r["seconds"]), result))
    return layout.text_table(
        ("case", "unknowns", "Newton", "Krylov", "time", "largest slip or temperature"), lines
    )


def most_informative(numbers: Mapping[str, float]) -> str:
    """Return the largest micromotion or slip of a run, or its highest temperature, as text."""
    for key, text in TEXT_QUANTITIES.items():
        values = {name: value for name, value in numbers.items() if name.endswith(f".{key}")}
        if values:
            name = max(values, key=lambda name: values[name])
            q = quantities.quantity_or_fail(name)
            return f"{q.factor * values[name]:.1f} {q.shown} {text} {name.partition('.')[0]}"
    return ""
