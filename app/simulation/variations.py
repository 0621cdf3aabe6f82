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
    places = np.array([_ranks([value_at(c, key) for c in cases]) for key in keys])
    weights = [LOAD if key.startswith("loads.") else 1.0 for key in keys]
    chain: list[int] = []
    last = len(varied)
    nearest = np.full(len(varied), np.inf)
    for _ in varied:
        # Only the last can have come nearer to those that are left.
        steps = (
            w * np.minimum(np.abs(p[:-1] - p[last]), OTHER)
            for w, p in zip(weights, places, strict=True)
        )
        nearest = np.minimum(nearest, sum(steps, np.zeros(len(varied))))
        nearest[chain] = np.inf
        last = int(nearest.argmin())
        chain.append(last)
    return chain


def _ranks(values: Sequence[Any]) -> list[float]:
    """Rank of each value among the distinct numbers; other values are far from all."""
    numbers = [_numbers(v) for v in values]
    texts = [str(v) for v in values]
    known = {n: i for i, n in enumerate(sorted({n for n in numbers if n}))}
    unlike = dict.fromkeys(t for t, n in zip(texts, numbers, strict=True) if not n)
    others = {t: OTHER * (1 + i) for i, t in enumerate(unlike)}
    return [float(known[n]) if n else others[t] for t, n in zip(texts, numbers, strict=True)]


def _numbers(value: Any) -> tuple[float, ...]:
    """Numbers of a value with units, or of a list of such; empty for anything else."""
    found: list[float] = []
    for item in value if isinstance(value, list | tuple) else [value]:
        try:
            found.append(float(str(item).partition(" ")[0]))
        except ValueError:
            return ()
    return tuple(found)


def value_at(case: Mapping[str, Any], key: str) -> Any:
    """Value of a key of a case, or None; the default of a history is all ones.

    ``*`` stands for its first entry, an interface for its kind: other differences have keys of
    their own.
    """
    data: Any = case
    for item in key_parts(key):
        if isinstance(data, list | tuple):
            data = data[int(item)] if item.isdigit() and int(item) < len(data) else None
        else:
            found = data if isinstance(data, Mapping) else {}
            data = next(iter(found.values()), None) if item == "*" else found.get(item)
    if isinstance(data, Mapping):
        return data.get("kind")
    return [1.0] * len(case["stages"]) if data is None and key.endswith("history") else data


def row(v: Varied | Point, summary: Mapping[str, Any], status: str, seconds: float) -> Row:
    """Row of the table of variations for one run: a variation or a point of a sweep.

    ``summary`` is empty if there is none; ``status`` is converged, not converged or stopped;
    ``seconds`` are wall time.
    """
    solver = summary.get("solver", {})
    return {
        "name": v.name,
        "overrides": v.changes,
        "status": status,
        "numbers": headlines(summary),
        "notes": summary.get("notes", []),
        "newton_iterations": solver.get("newton_iterations"),
        "linear_iterations": solver.get("linear_iterations"),
        "seconds": round(seconds, 3),
    }


def headlines(summary: Mapping[str, Any]) -> dict[str, float]:
    """Numbers by which runs are compared, named as in a study."""
    return {
        f"{name}.{key}": numbers[key]
        for section, name, numbers in quantities.numbers_of(summary)
        for key, q in quantities.TABLE[section].items()
        if q.headline and key in numbers
    }


def write(rows: Sequence[Row], folder: Path) -> None:
    """Write the table as ``variations.json`` and ``variations.csv``."""
    write_json(folder / "variations.json", list(rows))
    flat = [
        {
            "name": r["name"],
            **r["overrides"],
            "status": r["status"],
            **{f"{key} [{quantities.find(key).unit}]": n for key, n in r["numbers"].items()},
            "newton [-]": r["newton_iterations"],
            "krylov [-]": r["linear_iterations"],
            "wall [s]": r["seconds"],
        }
        for r in rows
    ]
    write_text(folder / "variations.csv", csv_text(flat))


def table(rows: Sequence[Row]) -> str:
    """Table as text: numbers that all runs have, a line per run."""
    lines = []
    for r in rows:
        newton, krylov = (r[f"{kind}_iterations"] for kind in ("newton", "linear"))
        said = most(r["numbers"]) if r["status"] == "converged" else r["status"]
        lines.append((r["name"], newton, krylov, f"{r['seconds']:.1f} s", said))
    return layout.table(("variation", "newton", "krylov", "wall", "most"), lines)


def most(numbers: Mapping[str, float]) -> str:
    """Largest slip of a run, or its highest temperature, as text."""
    for key, words in (("slip_p99", "slip on"), ("temperature_max", "in")):
        found = {k: n for k, n in numbers.items() if k.endswith(f".{key}")}
        if found:
            name = max(found, key=lambda k: found[k])
            q = quantities.find(name)
            return f"{q.factor * found[name]:.1f} {q.shown} {words} {name.partition('.')[0]}"
    return ""
