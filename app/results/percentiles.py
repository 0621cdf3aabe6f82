"""Percentiles by area or volume."""

from __future__ import annotations

import numpy as np

from app.arrays import Floats

PERCENTILE = 0.99
# Bisections of a level: to the last digits.
HALVINGS = 50


def percentile(values: Floats, weights: Floats, fraction: float = PERCENTILE) -> float:
    """Smallest value that at least ``fraction`` of the weight does not exceed; 0 if empty."""
    if not len(values):
        return 0.0
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order])
    k = np.searchsorted(cumulative, fraction * cumulative[-1])
    return float(values[order[min(int(k), len(values) - 1)]])


class SurfaceField:
    """A field that is linear on each triangle of a surface."""

    def __init__(self, corners: Floats, area: Floats) -> None:
        """Keep it.

        Args:
            corners: Its values at the corners of triangles (f, 3).
            area: Their areas (f,) [mm2].
        """
        self._corners, self._area = corners, area
        self._sorted = np.sort(corners, axis=1)

    def mean(self) -> float:
        """Mean by area; 0 without triangles."""
        whole = self._area.sum()
        return float(self._area @ self._corners.mean(axis=1) / whole) if whole > 0 else 0.0

    def area_above(self, level: float) -> float:
        """Area where it exceeds a level [mm2]."""
        low, middle, high = self._sorted.T
        spread = np.where(high > low, high - low, 1.0)
        top = (high - level) ** 2 / (spread * np.where(high > middle, high - middle, 1.0))
        bottom = (level - low) ** 2 / (spread * np.where(middle > low, middle - low, 1.0))
        share = np.where(level >= middle, top, 1.0 - bottom)
        share = np.where(level >= high, 0.0, np.where(level < low, 1.0, share))
        return float(self._area @ share)

    def percentile(self, fraction: float = PERCENTILE) -> float:
        """Smallest level that it does not exceed on this part of the area; 0 without triangles."""
        if not len(self._area):
            return 0.0
        low, high = float(self._corners.min()), float(self._corners.max())
        above = (1.0 - fraction) * float(self._area.sum())
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            if self.area_above(middle) > above:
                low = middle
            else:
                high = middle
        return high

    def gradient(self, fraction: float | None) -> Floats:
        """Derivatives of a percentile, or of the mean, by the values at the corners (f, 3).

        Args:
            fraction: As of `percentile`; None: of the mean.
        """
        if fraction is None:
            return np.broadcast_to(
                self._area[:, None] / (3 * self._area.sum()), self._corners.shape
            )
        # The level moves with what the field moves on its line, in the mean.
        level = self.percentile(fraction)
        low, middle, high = self._sorted.T
        crossed = (low < level) & (level < high)
        upper = level >= middle
        span = np.where(crossed, high - low, 1.0)
        other = np.where(upper, high - middle, middle - low)
        other = np.where(other > 0, other, 1.0)
        length = self._area * 2 * np.where(upper, high - level, level - low) / (span * other)
        length = np.where(crossed, length, 0.0)
        whole = length.sum()
        if not whole > 0:
            return np.zeros(self._corners.shape)
        # Barycentric coordinates of both ends of the line, in the order low, middle, high.
        t = (level - low) / span
        s = np.where(upper, level - middle, level - low) / other
        none = np.zeros(len(t))
        long = np.stack([1 - t, none, t], axis=1)
        top, bottom = np.stack([none, 1 - s, s], axis=1), np.stack([1 - s, s, none], axis=1)
        at = (long + np.where(upper[:, None], top, bottom)) / 2 * (length / whole)[:, None]
        result = np.zeros(at.shape)
        np.put_along_axis(result, np.argsort(self._corners, axis=1), at, axis=1)
        return result
