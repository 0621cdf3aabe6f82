"""Volumes and depths of level sets against formulas."""

from __future__ import annotations

import numpy as np
import pytest

from app.results.level_sets import positive_fraction
from meshes.nearest_facets import distance_from_triangles


def test_level_sets_part_of_a_tetrahedron() -> None:
    rng = np.random.default_rng(3)
    f = rng.uniform(-1, 1, (40, 4))
    points = rng.dirichlet(np.ones(4), 400_000)
    for row, share in zip(f, positive_fraction(f), strict=True):
        assert share == pytest.approx((points @ row >= 0).mean(), abs=4e-3)


@pytest.mark.parametrize(
    ("f", "share"),
    [
        *[((1, 1, 1, 1), 1), ((-1, -1, -1, -1), 0), ((1, -1, -1, -1), 1 / 8)],
        *[((1, 1, 1, -1), 7 / 8), ((1, 1, -1, -1), 1 / 2), ((0, -1, -1, -1), 0)],
        *[((0, 0, 0, -1), 0), ((0, 0, 1, 1), 1), ((0, 0, 0, 0), 1), ((1, 0, 0, -1), 1 / 2)],
    ],
)
def test_level_sets_special_cases(f: tuple[int, ...], share: float) -> None:
    for order in ((0, 1, 2, 3), (3, 1, 0, 2), (2, 3, 1, 0)):
        assert positive_fraction(np.array([f], dtype=float)[:, order]) == pytest.approx(share)


def test_level_sets_volumes_add_up() -> None:
    f = np.random.default_rng(5).normal(size=(1000, 4))
    assert positive_fraction(f) + positive_fraction(-f) == pytest.approx(1)


def test_level_sets_distance_from_a_triangle() -> None:
    triangle = np.array([[[0.0, 0, 0], [3, 0, 0], [0, 3, 0]]])
    points = np.array(
        [[1, 1, 2], [1, -1, 0], [-3, -4, 0], [3, 3, 0], [1, 1, -0.5], [5, 0, 0]], float
    )
    assert distance_from_triangles(points, triangle) == pytest.approx(
        [2, 1, 5, 1.5 * 2**0.5, 0.5, 2]
    )


def test_level_sets_distance_from_a_surface() -> None:
    n = 12
    grid = np.stack(np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0), indexing="ij"), axis=-1)
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    flat = np.concatenate([np.stack(t, axis=2).reshape(-1, 3, 2) for t in ((a, b, c), (a, c, d))])
    triangles = np.concatenate([flat, np.zeros((*flat.shape[:2], 1))], axis=2)
    points = np.random.default_rng(7).uniform(0, n, (200, 3))
    assert distance_from_triangles(points, triangles) == pytest.approx(points[:, 2])
