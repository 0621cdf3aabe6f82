"""Agreement of a predicted number with a measured one: overlap, area metric, normalised error."""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import norm

from app.validation.records import MeasuredQuantity, Prediction

# Points of the quadrature over probabilities.
PROBABILITIES = 4000
# Standard uncertainties on either side of a value without a range.
EXPANDED = 2.0


def predicted_band(prediction: Prediction) -> tuple[float, float]:
    """Predicted band: 5th to 95th percentile of the samples, widened by the discretization."""
    lowest, highest = prediction.band
    return lowest - prediction.discretization, highest + prediction.discretization


def measured_range(measured: MeasuredQuantity) -> tuple[float, float]:
    """Measured range; without one the value and two standard uncertainties on either side."""
    if measured.range is not None:
        return measured.range
    half_width = EXPANDED * (measured.uncertainty or 0.0)
    return measured.middle - half_width, measured.middle + half_width


def inside(prediction: Prediction, measured: MeasuredQuantity) -> bool:
    """Return True if the predicted band and the measured range overlap."""
    lowest_predicted, highest_predicted = predicted_band(prediction)
    lowest_measured, highest_measured = measured_range(measured)
    return lowest_predicted <= highest_measured and lowest_measured <= highest_predicted


def standard_uncertainty(measured: MeasuredQuantity) -> float:
    """Standard uncertainty of a measured number; of a range that of an even distribution."""
    if measured.uncertainty is not None:
        return measured.uncertainty
    if measured.range is not None:
        lowest, highest = measured.range
        return (highest - lowest) / math.sqrt(12.0)
    return 0.0


def normalised_error(prediction: Prediction, measured: MeasuredQuantity) -> float:
    """Error over its expanded uncertainty: up to 1 in size, it is explained by uncertainty.

    E_n = (S - D) / (2 sqrt(s^2 + d^2 + u^2)) (ISO 13528; ASME V&V 20). S and s are the mean and
    standard deviation of the samples, and d is the discretization. D and u are the measured value
    and its standard uncertainty.
    """
    deviation = float(np.std(prediction.samples, ddof=1))
    measurement = standard_uncertainty(measured)
    error = float(np.mean(prediction.samples)) - measured.middle
    uncertainty = math.hypot(deviation, prediction.discretization, measurement)
    return error / (EXPANDED * uncertainty)


def area_metric(prediction: Prediction, measured: MeasuredQuantity) -> float:
    """Area between the distribution functions of predicted and measured values, in their unit.

    The integral of the difference of their quantiles over the probability (Ferson, Oberkampf and
    Ginzburg 2008, doi:10.1016/j.cma.2007.07.030). The measured distribution is normal with an
    uncertainty, even with a range, else a single value.
    """
    probability = (np.arange(PROBABILITIES) + 0.5) / PROBABILITIES
    samples = np.sort(prediction.samples)
    predicted_quantiles = samples[np.floor(probability * len(samples)).astype(int)]
    if measured.uncertainty is not None:
        measured_quantiles = norm.ppf(probability, measured.middle, measured.uncertainty)
    elif measured.range is not None:
        lowest, highest = measured.range
        measured_quantiles = lowest + (highest - lowest) * probability
    else:
        measured_quantiles = np.full(PROBABILITIES, measured.middle)
    return float(np.abs(predicted_quantiles - measured_quantiles).mean())
