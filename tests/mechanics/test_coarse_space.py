"""The coarse space of contact: motions of bodies past each other, and boxes."""

from __future__ import annotations

import numpy as np
import pytest

from app.mechanics.coarse_space import Boxes, free_directions
from app.numerics.deflation import CoarseSpace
from tests.mechanics.coarse_spaces import ALL, sparse


def test_coarse_space_free_directions_have_no_resistance() -> None:
    """Points are open, stick, or slip along x on a face normal to z with friction 0.4."""
    slip = np.array([[0.0, 0.0, 0.4], [0.0, 0.9, 0.0], [0.0, 0.0, 1.0]])
    projectors = free_directions(np.array([np.zeros((3, 3)), np.eye(3), slip]))
    np.testing.assert_allclose(projectors[0], np.eye(3), atol=1e-14)
    np.testing.assert_allclose(projectors[1], 0.0, atol=1e-14)
    np.testing.assert_allclose(projectors[2], np.diag([1.0, 0.0, 0.0]), atol=1e-14)


def test_coarse_space_boxes_reproduce_linear_functions() -> None:
    """Hat functions sum to one, interpolate linear functions, and are constant outside boxes."""
    x = np.random.default_rng(2).uniform([0, 0, 0], [4, 3, 9], (5000, 3))
    boxes = Boxes(x)
    functions, values = boxes(x)
    assert values.min() >= 0 and functions.max() < boxes.size
    np.testing.assert_allclose(values.sum(axis=1), 1.0, atol=1e-14)
    # The matrix of all functions at the points reproduces the coordinates.
    matrix = np.zeros((len(x), boxes.size))
    np.put_along_axis(matrix, functions, values, axis=1)
    weights, *_ = np.linalg.lstsq(matrix, x, rcond=None)
    np.testing.assert_allclose(matrix @ weights, x, atol=1e-12)
    far, near = boxes(np.array([[100.0, 1, 1]])), boxes(np.array([[50.0, 1, 1]]))
    np.testing.assert_array_equal(far[0], near[0])
    np.testing.assert_allclose(far[1], near[1])


@pytest.mark.parametrize("spans", [(1.0, 1.0, 0.0), (5.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
def test_coarse_space_boxes_at_flat_interfaces_are_few(spans: tuple[float, ...]) -> None:
    x = np.random.default_rng(2).uniform(size=(1000, 3)) * spans
    assert Boxes(x).size <= 64  # fifteen boxes in a row
    np.testing.assert_allclose(Boxes(x)(x)[1].sum(axis=1), 1.0, atol=1e-14)


def test_coarse_space_follows_breaking_cohesive_interfaces() -> None:
    """The free directions of a bond may stay the same while its stiffness changes."""
    random = np.random.default_rng(1)
    motions = CoarseSpace(sparse(random.normal(size=(6, 3))), sparse(random.normal(size=(6, 3))))
    versions = []
    for stiffness in ([8.0, 8.0], [8.0, 6.0], [8.0, 0.0], [8.0, 0.0], [0.0, 0.0]):
        motions.update(ALL, np.array(stiffness))
        versions.append(motions.version)
    assert versions == [1, 1, 2, 2, 3]
