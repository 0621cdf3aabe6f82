"""Percentiles by area or volume."""

from __future__ import annotations

import numpy as np

from mantle.arrays import Floats

PERCENTILE = 0.99


def percentile(values: Floats, weights: Floats, fraction: float = PERCENTILE) -> float:
    """Smallest value that at least ``fraction`` of the weight does not exceed; 0 if empty."""
    if not len(values):
        return 0.0
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order])
    k = np.searchsorted(cumulative, fraction * cumulative[-1])
    return float(values[order[min(int(k), len(values) - 1)]])
