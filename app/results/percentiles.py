"""Percentiles by area or volume."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from app.foundation.arrays import Floats

PERCENTILE = 0.99


def percentile(values: Floats, weights: Floats) -> float:
    """Smallest value that at least `PERCENTILE` of the weight does not exceed; 0 if empty."""
    if not len(values):
        return 0.0
    order = np.argsort(values)
    cumulative = np.cumsum(weights[order])
    k = np.searchsorted(cumulative, PERCENTILE * cumulative[-1])
    return float(values[order[min(int(k), len(values) - 1)]])


class SurfaceField:
    """A field that is linear on each triangle of a surface.

    Args:
        corners: Values of the field at the corners of triangles (f, 3).
        area: Their areas (f,) [mm2].
        x: Positions of these corners (f, 3, 3) [mm].
    """

    def __init__(self, corners: Floats, area: Floats, x: Floats) -> None:
        self._corners, self._area, self._x, self.area = corners, area, x, float(area.sum())
        self._sorted = np.sort(corners, axis=1)

    def mean(self) -> float:
        """Mean by area; 0 without triangles."""
        integral = float(self._area @ self._corners.mean(axis=1))
        return integral / self.area if self.area > 0 else 0.0

    def maximum(self) -> tuple[float, list[float]]:
        """Largest value and its place (3,) [mm]; 0 and no place without triangles."""
        if not len(self._area):
            return 0.0, []
        k = int(np.argmax(self._corners))
        return float(self._corners.ravel()[k]), self._x.reshape(-1, 3)[k].tolist()

    def area_above(self, level: float) -> float:
        """Area where the field exceeds a level [mm2]."""
        low, middle, high = self._sorted.T
        spread = np.where(high > low, high - low, 1.0)
        top = (high - level) ** 2 / (spread * np.where(high > middle, high - middle, 1.0))
        bottom = (level - low) ** 2 / (spread * np.where(middle > low, middle - low, 1.0))
        share = np.where(level >= middle, top, 1.0 - bottom)
        share = np.where(level >= high, 0.0, np.where(level < low, 1.0, share))
        return float(self._area @ share)

    def percentile(self, fraction: float = PERCENTILE) -> float:
        """Smallest level not exceeded on this fraction of the area; 0 without triangles."""
        if not len(self._area):
            return 0.0
        ends = [float(self._corners.min()), float(self._corners.max())]
        above = (1.0 - fraction) * self.area
        excess = [self.area - above, -above]
        last_side = -1
        level = _between(ends, excess)
        while ends[0] < level < ends[1]:
            value = self.area_above(level) - above
            side = int(value <= 0)
            ends[side], excess[side] = level, value
            if side == last_side:  # otherwise the other end would move slowly
                excess[1 - side] /= 2
            last_side = side
            level = _between(ends, excess)
        return min(max(level, ends[0]), ends[1])


def _between(ends: Sequence[float], values: Sequence[float]) -> float:
    """Zero of the line through two points."""
    return ends[0] + (ends[1] - ends[0]) * values[0] / ((values[0] - values[1]) or 1.0)
