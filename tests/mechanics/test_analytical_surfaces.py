"""Analytical surfaces: fitted to nodes at any place, with exact gaps and normals."""

from __future__ import annotations

import numpy as np
import pytest

from app.foundation.arrays import Floats
from app.mechanics.analytical_surfaces import fit_surface
from app.numerics.rigid_motions import rotation_vector

RNG = np.random.default_rng(54)
R0 = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
ROTATION = R0 * np.sign(np.linalg.det(R0))
PLACE = np.array([30.0, -20.0, 400.0])


def nodes(kind: str) -> tuple[Floats, Floats, Floats]:
    """Nodes on a part of a surface, rough outward normals of facets, exact normals."""
    a, b = RNG.uniform(0.0, 1.2, (2, 80))
    if kind == "plane":
        exact = np.tile([0.0, 0.0, 1.0], (80, 1))
        x = np.column_stack([a, b, 0 * a]) * 20
    elif kind == "sphere":
        exact = np.column_stack([np.sin(a) * np.cos(5 * b), np.sin(a) * np.sin(5 * b), np.cos(a)])
        x = 14 * exact
    else:
        exact = np.column_stack([np.cos(3 * a), np.sin(3 * a), 0 * a])
        x = 5 * exact + np.column_stack([0 * a, 0 * a, 20 * b])
    return x, exact + 0.03 * RNG.normal(size=exact.shape), exact


@pytest.mark.parametrize("kind", ["plane", "sphere", "cylinder"])
@pytest.mark.parametrize("side", [1.0, -1.0], ids=["inside", "outside"])
def test_analytical_surfaces_are_fitted_to_nodes(kind: str, side: float) -> None:
    """Gap and normal at points off the surface follow its formula, with the body on either side."""
    x, rough, exact = nodes(kind)
    surface = fit_surface(x @ ROTATION.T + PLACE, side * rough @ ROTATION.T)
    assert surface is not None and surface.kind == kind
    away = RNG.uniform(-1.0, 1.0, 80)
    gap, normal = surface.gap((x + away[:, None] * exact) @ ROTATION.T + PLACE)
    np.testing.assert_allclose(gap, side * away, atol=1e-11)
    np.testing.assert_allclose(normal, side * exact @ ROTATION.T, atol=1e-11)


def test_analytical_surfaces_refuse_other_shapes() -> None:
    """Nodes a thousandth of the radius off a sphere are not on it."""
    x, rough, exact = nodes("sphere")
    assert fit_surface(x + 0.014 * np.sin(9 * x[:, :1]) * exact, rough) is None


def test_analytical_surfaces_rotation_vector_returns_axis_and_angle() -> None:
    """Rodrigues' formula returns axis and angle, also for small angles and nearly half a turn."""
    axis = ROTATION[:, 0]
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    for angle in (0.0, 1e-9, 0.1, 2.0, 3.1):
        R = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
        np.testing.assert_allclose(rotation_vector(R), angle * axis, atol=1e-12)
