"""Percentiles of fields on surfaces."""

from __future__ import annotations

import numpy as np
import pytest

from app.results.percentiles import SurfaceField


def test_percentiles_are_levels_of_the_linear_field() -> None:
    """The field is f = x on the unit square, cut in two triangles.

    The area below a level equals the level.
    """
    x = np.array([[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)], [(0.0, 0.0), (1.0, 1.0), (0.0, 1.0)]])
    x = np.concatenate([x, np.zeros((2, 3, 1))], axis=2)
    field = SurfaceField(x[:, :, 0], np.array([0.5, 0.5]), x)
    for level in (0.01, 0.3, 0.5, 0.95, 0.99):
        assert field.percentile(level) == pytest.approx(level, abs=1e-12)
        assert field.area_above(level) == pytest.approx(1 - level, abs=1e-12)
    assert field.mean() == pytest.approx(0.5)
    assert field.maximum() == (1.0, [1.0, 0.0, 0.0])
    same = SurfaceField(np.full((3, 3), 2.0), np.ones(3), np.zeros((3, 3, 3)))
    assert same.percentile() == 2.0 and same.area_above(2.0) == 0 and same.area_above(1.0) == 3.0
