"""Uncertain inputs: spread, causes and sensitivity indices of sampled runs."""

from __future__ import annotations

import math
import statistics
from typing import Any

import pytest

from app.campaigns import uncertainty
from app.case.points import Sobol, UncertainInputs


def test_uncertainty_spread_and_cause_of_samples() -> None:
    """A number grows with one input and is independent of the other. Ranks are by hand."""
    a, b = [0.1, 0.2, 0.3, 0.4, 0.5], [2, 5, 1, 4, 3]
    rows = [
        {
            "part": "p",
            "exit_code": 0,
            "overrides": {"a": f"{x} mm", "b": y},
            "numbers": {"stem.varus": 10 * x**3, "stem.retroversion": 1.0},
        }
        for x, y in zip(a, b, strict=True)
    ]
    failed = {"part": "p", "exit_code": 4, "overrides": {"a": "9 mm", "b": 9}, "numbers": {}}
    spread = uncertainty.of_parts([*rows, failed], {"p": UncertainInputs(("a", "b"))})["p"]
    assert spread["samples"] == 5
    n = spread["numbers"]["stem.varus"]
    assert n["mean"] == pytest.approx(0.45)
    assert n["deviation"] == pytest.approx(statistics.stdev(10 * x**3 for x in a))
    # Spearman: 1 - 6 sum d^2 / (n (n^2 - 1)), d = 1, 3, -2, 0, -2.
    assert n["correlation"] == pytest.approx({"a": 1.0, "b": 1 - 6 * 18 / 120})
    assert spread["numbers"]["stem.retroversion"]["correlation"] == {}
    printed = uncertainty.tables_of_spread({"p": spread})
    assert "a +1.00, b +0.10" in printed and "retroversion" not in printed


def test_uncertainty_of_choices() -> None:
    """Of a variance of ranks of 17.5, 1.5 is within three pairs and 16 within two triples.

    Degrees of freedom are 3, 4 and 5.
    """
    pairs = [{"kind": name} for name in "aabbcc"]
    assert uncertainty.correlation([1, 2, 3, 4, 5, 60], pairs) == pytest.approx((6 / 7) ** 0.5)
    assert uncertainty.correlation([1, 3, 5, 2, 4, 6], [*"xxxyyy"]) == 0.0
    assert uncertainty.correlation([1, 2, 3], [*"abc"]) is None
    assert uncertainty.correlation([1, 2, 3, 4], ["1 m", "10 mm", "10 mm", "1 m"]) == 0.0


def ishigami(samples: int) -> tuple[list[dict[str, Any]], UncertainInputs]:
    """Rows of a sweep whose number is Ishigami's function, sin x + 7 sin^2 y + 0.1 z^4 sin x."""
    inputs = {key: {"low": -math.pi, "high": math.pi} for key in "xyz"}
    design = Sobol.model_validate({"samples": samples, "inputs": inputs})
    rows = []
    for changes in design.draw().values():
        x, y, z = (float(str(changes[key])) for key in "xyz")
        number = math.sin(x) + 7 * math.sin(y) ** 2 + 0.1 * z**4 * math.sin(x)
        numbers = {"stem.varus": number, "stem.retroversion": 2.0}
        rows.append({"part": "", "exit_code": 0, "overrides": changes, "numbers": numbers})
    return rows, UncertainInputs(("x", "y", "z"), sobol=True)


def test_uncertainty_sobol_indices_of_a_known_function() -> None:
    """Ishigami's function (1990) has the first indices 0.314, 0.442, 0.

    The total ones are 0.558, 0.442, 0.244.
    """
    rows, samples = ishigami(1024)
    assert len(rows) == 1024 * 5
    spread = uncertainty.of_parts(rows, {"": samples})[""]
    assert (spread["samples"], spread["base_samples"]) == (2048, 1024)
    expected = {"x": (0.3139, 0.5576), "y": (0.4424, 0.4424), "z": (0.0, 0.2437)}
    indices = spread["indices"]["stem.varus"]
    assert {*spread["indices"]} == {"stem.varus"}  # a number that does not vary has none
    for key, (first, total) in expected.items():
        assert indices[key]["first"][0] == pytest.approx(first, abs=0.03)
        assert indices[key]["total"][0] == pytest.approx(total, abs=0.03)
        for value, low, high in indices[key].values():
            assert low < value < high
    printed = uncertainty.tables_of_spread({"": spread})
    assert "Sobol' indices of 1024 base samples" in printed
    assert [row[1] for row in uncertainty.index_rows(spread)] == ["x", "y", "z"]


def test_uncertainty_sobol_indices_without_failed_runs() -> None:
    """A failed run removes its base sample. The largest power of two of the others is used."""
    rows, samples = ishigami(32)
    rows[7]["exit_code"] = 4
    spread = uncertainty.of_parts(rows, {"": samples})[""]
    assert spread["base_samples"] == 16
    for row in rows[: 5 * 25]:
        row["exit_code"] = 4
    assert "indices" not in uncertainty.of_parts(rows, {"": samples})[""]


def test_uncertainty_partial_rank_correlation() -> None:
    """Three ranked columns have (r_xy - r_xz r_yz) / sqrt((1 - r_xz^2) (1 - r_yz^2))."""
    y, x, z = [1, 2, 3, 5, 4, 6], [2, 1, 3, 4, 6, 5], [3, 1, 2, 6, 5, 4]
    xy, xz, yz = (
        1 - 6 * sum((a - b) ** 2 for a, b in zip(*p, strict=True)) / 210
        for p in ((x, y), (x, z), (y, z))
    )
    expected = (xy - xz * yz) / math.sqrt((1 - xz**2) * (1 - yz**2))
    correlations = uncertainty.partial_correlations(y, {"x": [f"{v} mm" for v in x], "z": z})
    assert correlations["x"] == pytest.approx(expected)
    assert uncertainty.partial_correlations(y, {"x": x}) == {}
    assert uncertainty.partial_correlations(y, {"x": x, "z": x}) == {}
    assert uncertainty.partial_correlations(y, {"x": x, "name": [*"aabbcc"]}) == {}
