"""Extrapolation, orders, fronts, advice and effectivity, against values by hand."""

from __future__ import annotations

import pytest

from app.campaigns import work_precision as wp
from app.campaigns.work_precision import ErrorPoint, ReferenceValue


@pytest.mark.parametrize("order", [0.6, 1.0, 1.7, 2.0, 3.0, 3.9])
@pytest.mark.parametrize("sizes", [(4.0, 2.0, 1.0), (3.0, 2.0, 1.5), (2.5, 2.4, 1.0)])
def test_work_precision_extrapolates_a_power_law_exactly(
    order: float, sizes: tuple[float, ...]
) -> None:
    """The law f = 7 - 0.3 h^p is exact for any ratios of sizes. Earlier runs do not matter."""
    values = [7 - 0.3 * h**order for h in sizes]
    limit = wp.extrapolate([9.0, *sizes], [123.0, *values])
    assert limit.value == pytest.approx(7, abs=1e-9)
    assert limit.order == pytest.approx(order, abs=1e-6)
    assert limit.uncertainty == pytest.approx(0.3 * sizes[-1] ** order, rel=1e-6)


@pytest.mark.parametrize(
    ("values", "tolerance", "uncertainty", "method"),
    [
        ([1.0, 1.4, 1.1], 0.0, 0.4, "finest, no clear order"),  # not monotone
        ([1.0, 2.0, 2.95], 0.0, 1.0, "finest, no clear order"),  # log2(1/0.95) = 0.07
        ([1.0, 2.0, 2.2], 0.0, 1.0, "not yet converging"),  # log2(1/0.2) = 2.3: above 2
        ([1.0, 2.0, 2.0], 0.0, 1.0, "not yet converging"),
        ([1.0, 1.02, 1.021], 0.01, 0.02, "finest, no clear order"),  # of the solver's tolerance
        ([2.0, 2.0, 2.0], 0.0, 0.0, "finest, no clear order"),
        ([1.0, 1.5], 0.0, 0.5, "finest of two"),
    ],
)
def test_work_precision_finest_run_without_an_order(
    values: list[float], tolerance: float, uncertainty: float, method: str
) -> None:
    """The error is the larger of the last two differences."""
    limit = wp.extrapolate([4.0, 2.0, 1.0][: len(values)], values, 2.0, tolerance)
    assert (limit.value, limit.order, limit.method) == (values[-1], None, method)
    assert limit.uncertainty == pytest.approx(uncertainty, abs=1e-12)


def test_work_precision_missing_numbers() -> None:
    limit = wp.extrapolate([], [7.0, 7.5, 7.6])
    assert (limit.value, limit.order) == (7.6, None)
    assert limit.uncertainty == pytest.approx(0.1)


def point(error: float, estimate: float | None = None, algebraic: float = 0.0) -> ErrorPoint:
    """A point of the quantity 2 + 2 error, compared with 2 ± 0.002."""
    raw = ErrorPoint(2 + 2 * error, estimate, algebraic)
    return wp.compare(raw, ReferenceValue(2.0, 0.002, None, "given"))


def test_work_precision_error_and_reliability() -> None:
    good, close = point(0.05), point(-0.0005)
    assert good.error == pytest.approx(0.05) and good.deviation == pytest.approx(0.1)
    assert good.trusted and not close.trusted
    assert good.bound == pytest.approx(0.05) and close.bound == pytest.approx(0.001)
    failed, plain = ErrorPoint(None), ErrorPoint(1.0)
    assert wp.compare(failed, ReferenceValue(2.0, 0.002, None, "given")) == failed
    assert wp.compare(plain, ReferenceValue(0.0, 0.0, None, "given")) == plain
    assert wp.compare(plain, None) == plain
    assert failed.bound is plain.bound is None and not plain.trusted


def test_work_precision_exponent() -> None:
    """Least squares over the points above the noise give 0.1 h^2."""
    sizes = [1.0, 0.5, 0.25]
    line = [point(0.1 * h**2) for h in sizes]
    assert wp.exponent(sizes, line) == pytest.approx(2)
    below = point(0.0009)  # below the error of the reference
    assert wp.exponent([*sizes, 0.01], [*line, below]) == pytest.approx(2)
    noise = point(0.002, algebraic=0.001)  # not above what the solver leaves
    assert wp.exponent([*sizes, 100], [*line, noise]) == pytest.approx(2)
    assert wp.exponent(sizes[:1], line[:1]) is None
    assert wp.exponent([1.0, 1.0], line[:1] * 2) is None
    counts = [1.0, 2.0, 4.0]
    assert wp.exponent(counts, [point(0.1 / n) for n in counts]) == pytest.approx(-1)


def test_work_precision_pareto() -> None:
    costs = [1.0, 2.0, 3.0, 4.0, None, 5.0, 6.0, 2.0]
    errors = [0.5, 0.2, 0.3, 0.1, 0.01, None, 0.1, 0.25]
    assert wp.pareto(costs, errors) == [0, 1, 3]
    assert wp.pareto([], []) == []


def test_work_precision_best() -> None:
    costs, errors = [1.0, 2.0, 3.0, None, 4.0], [0.5, 0.02, 0.01, 0.001, None]
    assert wp.index_of_best(costs, errors, 0.02) == 1
    assert wp.index_of_best(costs, errors, 0.015) == 2
    assert wp.index_of_best(costs, errors, 0.005) == 2
    assert wp.index_of_best([None, 1.0], [0.1, None], 0.1) is None


def test_work_precision_effectivity() -> None:
    """Estimates are compared with a true error of 0.1."""
    points = [point(0.05, estimate=e) for e in (0.04, 0.051, 0.299, 0.31)]
    assert [p.effectivity for p in points] == pytest.approx([0.4, 0.51, 2.99, 3.1])
    # Not judged: no estimate; near the reference's error; near the algebraic error.
    rest = [
        point(0.05),
        point(0.0029, estimate=1.0),
        point(0.05, estimate=1.0, algebraic=0.006),
        point(0.0031, estimate=1.0),
        point(0.05, estimate=1.0, algebraic=0.004),
    ]
    assert [p.effectivity is None for p in rest] == [True, True, True, False, False]
