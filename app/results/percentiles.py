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
    return float(np.quantile(values, PERCENTILE, weights=weights, method="inverted_cdf"))


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
        lowest, middle, highest = self._sorted.T
        value_range = np.where(highest > lowest, highest - lowest, 1.0)
        upper_part = (highest - level) ** 2 / (
            value_range * np.where(highest > middle, highest - middle, 1.0)
        )
        lower_part = (level - lowest) ** 2 / (
            value_range * np.where(middle > lowest, middle - lowest, 1.0)
        )
        fraction = np.where(level >= middle, upper_part, 1.0 - lower_part)
        fraction = np.where(level >= highest, 0.0, np.where(level < lowest, 1.0, fraction))
        return float(self._area @ fraction)

    def percentile(self, fraction: float = PERCENTILE) -> float:
        """Smallest level not exceeded on this fraction of the area; 0 without triangles."""
        if not len(self._area):
            return 0.0
        bracket = [float(self._corners.min()), float(self._corners.max())]
        above = (1.0 - fraction) * self.area
        excess = [self.area - above, -above]
        last_side = -1
        level = _between(bracket, excess)
        while bracket[0] < level < bracket[1]:
            value = self.area_above(level) - above
            side = int(value <= 0)
            bracket[side], excess[side] = level, value
            if side == last_side:  # otherwise the other end would move slowly
                excess[1 - side] /= 2
            last_side = side
            level = _between(bracket, excess)
        return min(max(level, bracket[0]), bracket[1])


def _between(ends: Sequence[float], values: Sequence[float]) -> float:
    """Zero of the line through two points."""
    return ends[0] + (ends[1] - ends[0]) * values[0] / ((values[0] - values[1]) or 1.0)
