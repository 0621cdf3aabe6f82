"""Spread of numbers over a Latin hypercube, and the inputs that cause it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypedDict

import numpy as np

from app.case import quantities
from app.case.points import short_keys
from app.results.run_table import SweepRow
from app.schema.units import NUMBER
from app.system import layout

# Fewest samples that define a spread.
FEWEST = 3
# Numbers that stay below this are rounding, in any unit of theirs.
NOTHING = 1e-9


class NumberSpread(TypedDict):
    """Spread of a number over samples.

    Attributes:
        mean: Mean of the samples.
        deviation: Standard deviation of the samples.
        p5: 5th percentile.
        p95: 95th percentile.
        correlation: Rank correlation with each input (`correlation`), by key [-].
    """

    mean: float
    deviation: float
    p5: float
    p95: float
    correlation: dict[str, float]


class PartSpread(TypedDict):
    """Spread of all numbers of a part: number of its samples, and spreads by full name."""

    samples: int
    numbers: dict[str, NumberSpread]


def of_parts(
    rows: Sequence[SweepRow], inputs: Mapping[str, Sequence[str]]
) -> dict[str, PartSpread]:
    """Spread of each number over the converged samples of each part of a sweep.

    Args:
        rows: Rows of ``sweep.json``.
        inputs: Keys of the uncertain inputs, by part.
    """
    spreads: dict[str, PartSpread] = {}
    for part, keys in inputs.items():
        samples = [r for r in rows if r["part"] == part and not r["exit_code"]]
        if len(samples) < FEWEST:
            continue
        values = {key: [r["overrides"][key] for r in samples] for key in keys}
        names = [n for n in samples[0]["numbers"] if all(n in r["numbers"] for r in samples)]
        spreads[part] = {
            "samples": len(samples),
            "numbers": {n: of_number([r["numbers"][n] for r in samples], values) for n in names},
        }
    return spreads


def of_number(numbers: Sequence[float], inputs: Mapping[str, Sequence[object]]) -> NumberSpread:
    """Spread of one number, from its value and its inputs by key in each sample."""
    low, high = np.percentile(numbers, (5, 95))
    correlations = {key: correlation(numbers, values) for key, values in inputs.items()}
    return {
        "mean": float(np.mean(numbers)),
        "deviation": float(np.std(numbers, ddof=1)),
        "p5": float(low),
        "p95": float(high),
        "correlation": {key: r for key, r in correlations.items() if r is not None},
    }


def correlation(numbers: Sequence[float], inputs: Sequence[object]) -> float | None:
    """Spearman's rank correlation; None where one of them does not vary.

    Inputs other than numbers of one unit have no order: Kelley's epsilon of the ranks, the root
    of the part of their variance that the inputs explain beyond chance.
    """
    from scipy.stats import rankdata, spearmanr  # half a second, which only samples need

    values = [m for m in (NUMBER.fullmatch(str(v)) for v in inputs) if m]
    ordered = len(values) == len(inputs) and len({m[2] for m in values}) == 1
    groups = len(set(map(str, inputs)))
    if len(set(numbers)) < 2 or groups < 2:
        return None
    if ordered:
        return float(spearmanr(numbers, [float(m[1]) for m in values]).statistic)
    if groups == len(inputs):
        return None
    ranks = rankdata(numbers)
    group = np.unique([str(v) for v in inputs], return_inverse=True)[1]
    within = ranks - (np.bincount(group, ranks) / np.bincount(group))[group]
    explained = 1.0 - np.var(within, ddof=groups) / np.var(ranks, ddof=1)
    return float(np.sqrt(max(explained, 0.0)))


def rows(of: PartSpread) -> list[list[str]]:
    """Rows of `HEAD` for a part, the most uncertain number first.

    Numbers that vary by no more than rounding are left out.
    """
    spread = {n: s for n, s in of["numbers"].items() if s["deviation"] > NOTHING}
    order = sorted(spread, key=lambda n: -spread[n]["deviation"] / (abs(spread[n]["mean"]) or 1))
    table_rows = []
    for name in order:
        s = spread[name]
        short = short_keys(list(s["correlation"]))
        causes = sorted(s["correlation"].items(), key=lambda item: -abs(item[1]))[:3]
        follows = ", ".join(f"{short[key]} {r:+.2f}" for key, r in causes)
        numbers = [f"{value:.4g}" for value in (s["mean"], s["p5"], s["p95"])]
        table_rows.append([name, quantities.find(name).unit, *numbers, follows])
    return table_rows


HEAD = ("number", "unit", "mean", "5 %", "95 %", "follows (rank correlation)")


def table(spreads: Mapping[str, PartSpread]) -> str:
    """Tables of all parts."""
    return "\n".join(
        f"{part or 'samples'}: {of['samples']} samples\n{layout.table(HEAD, rows(of))}"
        for part, of in spreads.items()
    )
