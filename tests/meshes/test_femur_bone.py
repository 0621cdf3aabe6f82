"""The bone of the parametric femur: widths of the canal, muscles, interpolation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator
from scipy.spatial.distance import pdist

from app.case.geometries import Femur
from app.case.hips import MUSCLES
from meshes import femur_bone
from meshes.femur import PATCH_RADIUS

GEOMETRY = Femur()
TURN = np.linspace(-np.pi, np.pi, 361)


def test_femur_bone_canal_has_published_widths() -> None:
    canal, outer = femur_bone.Tube(femur_bone.CANAL), femur_bone.PERIOSTEUM
    for z, width in ((20, 43.7), (10, 35.0), (0, 28.7), (-10, 24.0), (-20, 20.6), (-80, 13.5)):
        ends = canal.radius(np.array([0.0, np.pi]), np.array([z, z], dtype=float))
        assert ends.sum() == pytest.approx(width, abs=0.05)
    theta, z = np.meshgrid(TURN, np.linspace(-200.0, canal.top, 300))
    cortex = outer.radius(theta, z) - canal.radius(theta, z)
    assert cortex.min() > 1.5


def test_femur_bone_muscles_insert_on_the_surface() -> None:
    x, y, z = np.array([MUSCLES[name] for name in MUSCLES]).T
    on_bone = femur_bone.PERIOSTEUM.radius(np.arctan2(y, x), z)
    np.testing.assert_allclose(np.hypot(x, y), on_bone, atol=1e-3)
    assert set(MUSCLES) < set(GEOMETRY.boundary_names)
    assert pdist(np.array([x, y, z]).T).min() > 2 * PATCH_RADIUS


def test_femur_bone_tables_are_interpolated_as_by_scipy() -> None:
    """Values agree at and between random rows, with flat parts, turns and steep ends."""
    rng = np.random.default_rng(1)
    for n in (3, 4, 7, 12, 40):
        x, y = np.sort(rng.random(n)), np.round(rng.normal(size=(n, 4)), n % 3)
        places = np.concatenate([x, rng.uniform(x[0], x[-1], 99 - n)]).reshape(11, 9)
        expected = PchipInterpolator(x, y)(places)
        np.testing.assert_allclose(femur_bone.monotone(x, y)(places), expected, atol=1e-12)
