"""Spread of numbers over samples of uncertain inputs, and the inputs that cause it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any, NotRequired, TypedDict

import numpy as np

from app.case import quantities
from app.case.points import UncertainInputs, short_keys
from app.foundation import layout
from app.foundation.arrays import Floats
from app.results.run_table import SweepRow
from app.schema.units import number_and_unit

# Fewest samples that define a spread.
FEWEST_SAMPLES = 3
# Fewest base samples for Sobol' indices.
FEWEST_BASE = 8
# Samples of the bootstrap for the confidence intervals of Sobol' indices.
RESAMPLES = 999
# Condition number of a matrix of correlations above which some inputs determine others.
SINGULAR = 1e8
# Range or deviation of a number below which it is rounding, in its unit.
ROUNDING_RANGE = 1e-9


class NumberSpread(TypedDict):
    """Spread of a number over samples.

    Attributes:
        mean: Mean of the samples.
        deviation: Standard deviation of the samples.
        p5: 5th percentile.
        p95: 95th percentile.
        correlation: Rank correlation with each input (`correlation`), by key [-].
        partial: Partial rank correlation with each input (`partial_correlations`), by key [-].
    """

    mean: float
    deviation: float
    p5: float
    p95: float
    correlation: dict[str, float]
    partial: dict[str, float]


class SobolIndices(TypedDict):
    """Sobol' indices of an input, each with the ends of its 95 % confidence interval [-].

    Attributes:
        first: First-order index: fraction of the variance that the input causes alone.
        total: Total index: this fraction plus that of interactions with other inputs.
    """

    first: list[float]
    total: list[float]


class PartSpread(TypedDict):
    """Spread of all numbers of a part of a sweep.

    Attributes:
        samples: Number of independent samples.
        numbers: Spreads by full name.
        base_samples: Number of base samples of Sobol' indices.
        indices: Sobol' indices by full name of the number and key of the input.
    """

    samples: int
    numbers: dict[str, NumberSpread]
    base_samples: NotRequired[int]
    indices: NotRequired[dict[str, dict[str, SobolIndices]]]


def of_parts(
    rows: Sequence[SweepRow], parts: Mapping[str, UncertainInputs]
) -> dict[str, PartSpread]:
    """Return the spread of each number over the converged samples of each part of a sweep.

    Args:
        rows: Rows of ``sweep.json``.
        parts: The uncertain inputs, by part.
    """
    spreads: dict[str, PartSpread] = {}
    for part, samples in parts.items():
        of_part = [row for row in rows if row["part"] == part]
        independent = of_part
        if samples.sobol:
            base = _base_samples(of_part, samples)
            independent = list(chain.from_iterable(base_sample[:2] for base_sample in base))
        converged = [row for row in independent if not row["exit_code"]]
        if len(converged) < FEWEST_SAMPLES:
            continue
        inputs = {}
        for key in samples.inputs:
            inputs[key] = [row["overrides"][key] for row in converged]
        spreads_of_numbers = {}
        for name in _common_numbers(converged):
            values = [row["numbers"][name] for row in converged]
            spreads_of_numbers[name] = of_number(values, inputs)
        spreads[part] = {"samples": len(converged), "numbers": spreads_of_numbers}
        base_samples = _converged_base_samples(of_part, samples) if samples.sobol else []
        if len(base_samples) >= FEWEST_BASE:
            spreads[part]["base_samples"] = len(base_samples)
            spreads[part]["indices"] = sobol_indices(base_samples, samples.inputs)
    return spreads


def _common_numbers(rows: Sequence[SweepRow]) -> list[str]:
    """Return the names of the numbers that all rows have."""
    common = []
    for name in rows[0]["numbers"]:
        if all(name in row["numbers"] for row in rows):
            common.append(name)
    return common


def of_number(numbers: Sequence[float], inputs: Mapping[str, Sequence[object]]) -> NumberSpread:
    """Return the spread of a number.

    Args:
        numbers: Its value in each sample.
        inputs: Values of each input in the samples, by key.
    """
    lowest, highest = np.percentile(numbers, (5, 95))
    correlations = {key: correlation(numbers, values) for key, values in inputs.items()}
    return {
        "mean": float(np.mean(numbers)),
        "deviation": float(np.std(numbers, ddof=1)),
        "p5": float(lowest),
        "p95": float(highest),
        "correlation": {key: r for key, r in correlations.items() if r is not None},
        "partial": partial_correlations(numbers, inputs),
    }


def _base_samples(rows: Sequence[SweepRow], samples: UncertainInputs) -> list[Sequence[SweepRow]]:
    """Return the rows of each base sample for Sobol' indices.

    They are two samples A and B, and for each input the sample A with this input of B.
    """
    width = len(samples.inputs) + 2
    return [rows[start : start + width] for start in range(0, len(rows) - width + 1, width)]


def _converged_base_samples(
    rows: Sequence[SweepRow], samples: UncertainInputs
) -> list[Sequence[SweepRow]]:
    """Return the first base samples whose runs all converged; their number is a power of two."""
    converged = []
    for base_sample in _base_samples(rows, samples):
        if not any(row["exit_code"] for row in base_sample):
            converged.append(base_sample)
    if not converged:
        return []
    power_of_two = 2 ** (len(converged).bit_length() - 1)
    return converged[:power_of_two]


def sobol_indices(
    base_samples: Sequence[Sequence[SweepRow]], inputs: Sequence[str]
) -> dict[str, dict[str, SobolIndices]]:
    """Return Sobol' indices by number and input, computed by scipy.

    The number of base samples is a power of two. Numbers that vary by rounding only are left out.
    """
    from scipy.stats import sobol_indices as indices_of

    indices = {}
    for name in _common_numbers(list(chain.from_iterable(base_samples))):
        columns = []
        for base_sample in base_samples:
            columns.append([row["numbers"][name] for row in base_sample])
        values = np.array(columns).T
        if np.ptp(values) <= ROUNDING_RANGE:
            continue
        a, b, mixed = values[:1], values[1:2], values[2:, None]
        result = indices_of(func={"f_A": a, "f_B": b, "f_AB": mixed}, n=len(base_samples))
        bootstrap = result.bootstrap(n_resamples=RESAMPLES)
        indices[name] = {
            key: SobolIndices(
                first=_with_interval(result.first_order, bootstrap.first_order, k),
                total=_with_interval(result.total_order, bootstrap.total_order, k),
            )
            for k, key in enumerate(inputs)
        }
    return indices


def _with_interval(values: Floats, bootstrap: Any, k: int) -> list[float]:
    """Return the index of an input, and the ends of its interval."""
    interval = bootstrap.confidence_interval
    return [float(np.ravel(v)[k]) for v in (values, interval.low, interval.high)]


def partial_correlations(
    numbers: Sequence[float], inputs: Mapping[str, Sequence[object]]
) -> dict[str, float]:
    """Return the partial rank correlation of a number with each ordered input.

    It excludes the effect of the other inputs. With the inverse P of the matrix of rank
    correlations it is -P_iy / sqrt(P_ii P_yy) for input i and number y. Empty for a single input,
    for inputs that determine each other, and for too few samples.
    """
    from scipy.stats import rankdata

    numbers_of = {key: _numbers(values) for key, values in inputs.items()}
    ordered = {key: values for key, values in numbers_of.items() if values}
    columns = list(ordered.values())
    varying = all(len({*column}) > 1 for column in [*columns, numbers])
    if len(columns) < 2 or len(numbers) < len(columns) + 3 or not varying:
        return {}
    ranks = np.array([rankdata(column) for column in [*columns, numbers]])
    correlations = np.corrcoef(ranks)
    if np.linalg.cond(correlations) > SINGULAR:
        return {}
    inverse = np.linalg.inv(correlations)
    scale = np.sqrt(np.diag(inverse) * inverse[-1, -1])
    partial = -inverse[:, -1] / scale
    return {key: float(value) for key, value in zip(ordered, partial[:-1], strict=True)}


def _numbers(values: Sequence[object]) -> list[float]:
    """Return the values of an input without their unit; empty if they are not of one unit."""
    parts = [part for part in map(number_and_unit, values) if part is not None]
    is_ordered = len(parts) == len(values) and len({unit for _, unit in parts}) == 1
    return [number for number, _ in parts] if is_ordered else []


def correlation(numbers: Sequence[float], inputs: Sequence[object]) -> float | None:
    """Return the rank correlation of numbers with an input; None if one of both does not vary.

    It is Spearman's correlation if the inputs are numbers of one unit. Other inputs have no order.
    They have Kelley's epsilon of the ranks: the square root of the fraction of the variance of the
    ranks that the inputs explain beyond chance.
    """
    from scipy.stats import rankdata, spearmanr  # half a second, which only samples need

    level_count = len(set(map(str, inputs)))
    if len(set(numbers)) < 2 or level_count < 2:
        return None
    input_numbers = _numbers(inputs)
    if input_numbers:
        return float(spearmanr(numbers, input_numbers).statistic)
    if level_count == len(inputs):
        return None
    ranks = rankdata(numbers)
    group = np.unique([str(v) for v in inputs], return_inverse=True)[1]
    within_groups = ranks - (np.bincount(group, ranks) / np.bincount(group))[group]
    explained = 1.0 - np.var(within_groups, ddof=level_count) / np.var(ranks, ddof=1)
    return float(np.sqrt(max(explained, 0.0)))


def rows_of_spread(part_spread: PartSpread) -> list[list[str]]:
    """Return the rows of a part below `HEAD_OF_SPREAD`, the most uncertain number first.

    Numbers that vary by rounding only are left out.
    """
    varying_numbers = {
        n: s for n, s in part_spread["numbers"].items() if s["deviation"] > ROUNDING_RANGE
    }
    order = sorted(
        varying_numbers,
        key=lambda n: -varying_numbers[n]["deviation"] / (abs(varying_numbers[n]["mean"]) or 1),
    )
    table_rows = []
    for name in order:
        s = varying_numbers[name]
        short_names = short_keys(list(s["correlation"]))
        causes = sorted(s["correlation"].items(), key=lambda item: -abs(item[1]))[:3]
        follows = ", ".join(f"{short_names[key]} {r:+.2f}" for key, r in causes)
        partial_text = ", ".join(
            f"{short_names[k]} {s['partial'][k]:+.2f}" for k, _ in causes if k in s["partial"]
        )
        numbers = [f"{value:.4g}" for value in (s["mean"], s["p5"], s["p95"])]
        table_rows.append(
            [name, quantities.quantity_or_fail(name).unit, *numbers, follows, partial_text or "-"]
        )
    return table_rows


HEAD_OF_SPREAD = (
    "number",
    "unit",
    "mean",
    "5 %",
    "95 %",
    "follows (rank correlation)",
    "partial rank correlation",
)


def index_rows(part_spread: PartSpread) -> list[list[str]]:
    """Return the rows of a part below `INDEX_HEAD`; the largest total index is first."""
    table_rows = []
    for name, by_input in part_spread.get("indices", {}).items():
        short_names = short_keys(list(by_input))
        for key, index in sorted(by_input.items(), key=lambda item: -item[1]["total"][0]):
            index_texts = [
                f"{value:.2f} ({lowest:.2f} to {highest:.2f})"
                for value, lowest, highest in (index["first"], index["total"])
            ]
            table_rows.append([name, short_names[key], *index_texts])
    return table_rows


INDEX_HEAD = (
    "number",
    "input",
    "alone: first-order index (95 %)",
    "with interactions: total index (95 %)",
)


def tables_of_spread(spreads: Mapping[str, PartSpread]) -> str:
    """Format the tables of all parts."""
    tables = []
    for part, part_spread in spreads.items():
        heading = f"{part or 'samples'}: {part_spread['samples']} samples"
        tables.append(
            f"{heading}\n{layout.text_table(HEAD_OF_SPREAD, rows_of_spread(part_spread))}"
        )
        if part_spread.get("indices"):
            heading = (
                f"{part or 'samples'}: Sobol' indices of {part_spread['base_samples']} base samples"
            )
            tables.append(f"{heading}\n{layout.text_table(INDEX_HEAD, index_rows(part_spread))}")
    return "\n".join(tables)
