"""The triangles nearest to points."""

from __future__ import annotations

import numpy as np
import pytest

from meshes.nearest_facets import distance_from_triangles


def test_nearest_facets_distance_from_large_triangles_beside_small_ones() -> None:
    """A flat side of two triangles, 150 mm long, ends at a strip of small ones."""
    corners = np.array([[0.0, 0.0, 0.0], [150.0, 0.0, 0.0], [150.0, 12.0, 0.0], [0.0, 12.0, 0.0]])
    side = corners[[[0, 1, 2], [0, 2, 3]]]
    x, y = np.meshgrid(150.0 + np.arange(12) / 2, np.arange(25) / 2, indexing="ij")
    strip = np.stack([x, y, np.zeros_like(x)], axis=-1)
    a, b, c, d = strip[:-1, :-1], strip[1:, :-1], strip[1:, 1:], strip[:-1, 1:]
    small = np.concatenate([np.stack(t, axis=2).reshape(-1, 3, 3) for t in ((a, b, c), (a, c, d))])
    surface = np.concatenate([side, small])
    points = np.random.default_rng(3).uniform([0, 0, 0.5], [155, 12, 5], (200, 3))
    assert distance_from_triangles(points, surface) == pytest.approx(points[:, 2], rel=1e-12)
