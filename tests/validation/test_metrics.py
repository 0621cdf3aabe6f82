"""Metrics of agreement, by their formulas."""

from __future__ import annotations

import math

import pytest

from app.validation import metrics
from tests.validation.predictions import measured, prediction


@pytest.mark.parametrize(
    ("value", "between", "uncertainty", "inside"),
    [
        (3.05, None, None, True),  # within the discretization of the band's end
        (3.2, None, None, False),
        (3.2, None, 0.1, True),  # two standard uncertainties reach the band
        (None, (3.0, 9.0), None, True),
        (None, (3.2, 9.0), None, False),
        (0.5, (0.1, 1.0), None, True),  # the range counts, not the value
    ],
)
def test_metrics_inside_means_that_bands_overlap(
    value: float | None, between: tuple[float, float] | None, uncertainty: float, inside: bool
) -> None:
    band = prediction([1.0, 2.0, 3.0])
    assert metrics.inside(band, measured(value, between, uncertainty)) == inside


def test_metrics_normalised_error_is_over_twice_the_root_of_squares() -> None:
    """Samples 1, 2, 3 have the mean 2 and the standard deviation 1."""
    band = prediction([1.0, 2.0, 3.0], discretization=0.5)
    error = metrics.normalised_error(band, measured(6.0, uncertainty=2.0))
    assert error == pytest.approx((2 - 6) / (2 * math.sqrt(1 + 0.25 + 4)))
    even = metrics.normalised_error(band, measured(between=(5.0, 7.0)))
    assert even == pytest.approx((2 - 6) / (2 * math.sqrt(1 + 0.25 + 4 / 12)))


def test_metrics_area_of_a_single_value_is_the_mean_distance() -> None:
    band = prediction([1.0, 2.0, 6.0, 7.0])
    assert metrics.area_metric(band, measured(3.0)) == pytest.approx((2 + 1 + 3 + 4) / 4)


def test_metrics_area_of_shifted_distributions_is_the_shift() -> None:
    """Uniform samples of 0 to 1 are compared with a uniform range of 5 to 6.

    Two samples are compared with a normal distribution. Both samples of the last case are the
    measured value. The difference of quantiles is c - u z on the lower half, so its mean is u times
    the mean of |z|, which is u sqrt(2 / pi).
    """
    count = 2000
    even = prediction([(k + 0.5) / count for k in range(count)])
    assert metrics.area_metric(even, measured(between=(5.0, 6.0))) == pytest.approx(5, rel=1e-3)
    same = metrics.area_metric(prediction([4.0, 4.0]), measured(4.0, uncertainty=0.5))
    assert same == pytest.approx(0.5 * math.sqrt(2 / math.pi), rel=1e-3)
