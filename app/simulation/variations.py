"""The common table of the runs of a ``variations`` section, or of a sweep."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from app.case import quantities
from app.case.case import Varied
from app.case.points import Point
from app.system import layout
from app.system.folders import csv_text, write_json, write_text

Row = dict[str, Any]


def row(v: Varied | Point, summary: Mapping[str, Any], status: str, seconds: float) -> Row:
    """Row of the table of many runs: a variation or a point of a sweep.

    ``summary`` is empty if there is none; ``status`` is converged, not converged or stopped;
    ``seconds`` are wall time.
    """
    solver = summary.get("solver", {})
    # Numbers by which runs are compared, named as in a study.
    numbers = {
        f"{name}.{key}": found[key]
        for section, name, found in quantities.numbers_of(summary)
        for key, q in quantities.TABLE[section].items()
        if q.headline and key in found
    }
    errors = {name: quantities.read(summary, name, "_error") for name in numbers}
    return {
        "name": v.name,
        "overrides": v.changes,
        "status": status,
        "numbers": numbers,
        "errors": {name: error for name, error in errors.items() if error is not None},
        "notes": summary.get("notes", []),
        "unknowns": solver.get("dofs"),
        "newton_iterations": solver.get("newton_iterations"),
        "linear_iterations": solver.get("linear_iterations"),
        "seconds": round(seconds, 3),
        "folder": v.name,
    }


def csv(rows: Sequence[Row], keys: Sequence[str], first: str) -> str:
    """Table as CSV, with the overrides of some keys; ``first`` is the title of the names."""
    flat = []
    for r in rows:
        numbers = {}
        for name, value in r["numbers"].items():
            unit = quantities.find(name).unit
            numbers[f"{name} [{unit}]"] = value
            if name in r["errors"]:
                numbers[f"{name} error [{unit}]"] = r["errors"][name]
        flat.append(
            {
                first: r["name"],
                "status": r["status"],
                "notes": "; ".join(r["notes"]),
                **{key: r["overrides"].get(key, "") for key in keys},
                **numbers,
                "unknowns [-]": r["unknowns"],
                "newton [-]": r["newton_iterations"],
                "krylov [-]": r["linear_iterations"],
                "wall [s]": r["seconds"],
                "folder": r["folder"],
            }
        )
    return csv_text(flat)


def write(rows: Mapping[int, Row], folder: Path) -> list[Row]:
    """Write ``variations.json`` and ``variations.csv``; returns the rows in their order."""
    every = [rows[i] for i in sorted(rows)]
    keys = list(dict.fromkeys(key for r in every for key in r["overrides"]))
    write_json(folder / "variations.json", every)
    write_text(folder / "variations.csv", csv(every, keys, "name"))
    return every


def table(rows: Sequence[Row]) -> str:
    """Table as text: a line per run, with the number that tells most of it."""
    lines = []
    for r in rows:
        counts = [r[key] for key in ("unknowns", "newton_iterations", "linear_iterations")]
        said = most(r["numbers"]) if r["status"] == "converged" else r["status"]
        lines.append((r["name"], *counts, layout.duration(r["seconds"]), said))
    return layout.table(("case", "unknowns", "newton", "krylov", "wall", "most"), lines)


def most(numbers: Mapping[str, float]) -> str:
    """Largest slip of a run, or its highest temperature, as text."""
    for key, words in (("slip_p99", "slip, p99, on"), ("temperature_max", "in")):
        found = {k: n for k, n in numbers.items() if k.endswith(f".{key}")}
        if found:
            name = max(found, key=lambda k: found[k])
            q = quantities.find(name)
            return f"{q.factor * found[name]:.1f} {q.shown} {words} {name.partition('.')[0]}"
    return ""
