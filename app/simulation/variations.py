"""Runs of a ``variations`` section: their order and their common table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from app.case import quantities
from app.case.case import Case, Varied
from app.case.points import Point
from app.schema.yaml_file import key_parts
from app.system import layout
from app.system.folders import csv_text, write_json, write_text

# Distance of two runs per step of a key: loads may merely scale, interfaces of other kinds share
# little.
LOAD, OTHER = 0.1, 100.0
Row = dict[str, Any]


def order(case: Case, varied: Sequence[Varied]) -> list[int]:
    """A chain through all variations, from the nearest to the case and each time to the nearest."""
    keys = [k for k in dict.fromkeys(k for v in varied for k in v.changes) if k != "title"]
    cases = [c.model_dump(mode="json") for c in (*(v.case for v in varied), case)]
    ranks = [_ranks([value_at(c, key) for c in cases]) for key in keys]
    places = np.array(ranks).reshape(len(keys), len(cases))
    weights = np.array([[LOAD if key.startswith("loads.") else 1.0] for key in keys])
    chain: list[int] = []
    last = len(varied)
    nearest = np.full(len(varied), np.inf)
    for _ in varied:
        # Only the last can have come nearer to those that are left.
        steps = np.minimum(np.abs(places[:, :-1] - places[:, [last]]), OTHER)
        nearest = np.minimum(nearest, sum(weights * steps, np.zeros(len(varied))))
        nearest[chain] = np.inf
        last = int(nearest.argmin())
        chain.append(last)
    return chain


def _ranks(values: Sequence[Any]) -> list[float]:
    """Rank of each value among the distinct numbers; other values are far from all."""
    found = [(_numbers(v), str(v)) for v in values]
    known = {n: float(i) for i, n in enumerate(sorted({n for n, _ in found if n}))}
    unlike = dict.fromkeys(text for n, text in found if not n)
    others = {text: OTHER * (1 + i) for i, text in enumerate(unlike)}
    return [known[n] if n else others[text] for n, text in found]


def _numbers(value: Any) -> tuple[float, ...]:
    """Numbers of a value with units, or of a list of such; empty for anything else."""
    items = value if isinstance(value, list | tuple) else [value]
    try:
        return tuple(float(str(item).partition(" ")[0]) for item in items)
    except ValueError:
        return ()


def value_at(case: Mapping[str, Any], key: str) -> Any:
    """Value of a key of a case, or None; the default of a history is all ones.

    ``*`` stands for its first entry, an interface for its kind: other differences have keys of
    their own.
    """
    data: Any = case
    for item in key_parts(key):
        if isinstance(data, list | tuple):
            data = {str(k): value for k, value in enumerate(data)}
        found = data if isinstance(data, Mapping) else {}
        data = next(iter(found.values()), None) if item == "*" else found.get(item)
    if isinstance(data, Mapping):
        return data.get("kind")
    return [1.0] * len(case["stages"]) if data is None and key.endswith("history") else data


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
