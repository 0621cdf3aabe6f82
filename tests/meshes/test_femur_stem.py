"""The stem of the parametric femur: sections, offset, clearance."""

from __future__ import annotations

import numpy as np
import pytest

from app.case.geometries import Femur, MeshOptions
from app.foundation.errors import GeometryError
from meshes import femur_stem
from meshes.layered_surfaces import LayeredSurfaces, _rounded_up

GEOMETRY = Femur()
TURN = np.linspace(-np.pi, np.pi, 361)


def outline(shape: femur_stem.StemShaft, z: float) -> np.ndarray:
    r = shape.radius(TURN, np.full_like(TURN, z))
    return np.column_stack([r * np.cos(TURN), r * np.sin(TURN)])


def test_femur_stem_sections_are_rounded_rectangles() -> None:
    shape = femur_stem.shaft_of(GEOMETRY.implant)
    a, b, r = shape.section(15.0)
    assert (a, b, r) == pytest.approx((8.5, 5.0, 3.0))
    assert shape.section(-118.0) == pytest.approx((3.0, 3.0, 2.1))
    x, y = np.abs(outline(shape, 15.0)).T
    over = np.hypot(np.maximum(x - (a - r), 0), np.maximum(y - (b - r), 0))
    assert over == pytest.approx(np.full(len(x), r), abs=1e-12)  # on the rounded outline
    assert x.max() == pytest.approx(a)
    assert y.max() == pytest.approx(b)


@pytest.mark.parametrize("thickness", [1.0, 4.0, 8.0])
def test_femur_stem_offset_has_the_given_distance(thickness: float) -> None:
    """Flats have the distance exactly (along the normal), corners within a thousandth."""
    shape = femur_stem.shaft_of(GEOMETRY.implant)
    far = shape.offset(thickness)
    a, _, _ = shape.section(0.0)
    slope = shape.slope[0]
    # A point of the offset flank, and its distance from the plane x = a + slope z.
    assert (far.section(0.0)[0] - a) / np.hypot(1, slope) == pytest.approx(thickness, rel=1e-12)
    near, grown = outline(shape, 0.0), outline(far, 0.0)
    gap = np.min(np.linalg.norm(grown[:, None] - near[None], axis=2), axis=1)
    assert gap == pytest.approx(np.full(len(gap), thickness), rel=0.01)


def test_femur_stem_overlap_is_never_reported_as_zero() -> None:
    assert [_rounded_up(x) for x in (0.001, 0.041, 0.1, 0.31)] == [0.01, 0.05, 0.1, 0.4]


@pytest.mark.parametrize(
    ("half_width", "words"),
    [
        (9.85, "leaves 0.9[0-9] mm for cement .least: 1 mm. .*; 0.0[1-9] mm more are needed"),
        (11.0, "leaves 0.3 mm for cement .least: 1 mm. .*; 0.7 mm more are needed"),
        (11.7255, r"cuts 0.0[4-6] mm into the cortex .*\(tip_z\); 1.1 mm more are needed"),
    ],
)
def test_femur_stem_without_room_is_refused_with_a_length(half_width: float, words: str) -> None:
    """At the last length the cells between stem and cortex would have no volume."""
    geometry = Femur.model_validate({"stem": {"half_width": f"{half_width} mm"}})
    with pytest.raises(GeometryError, match=words):
        LayeredSurfaces(geometry, MeshOptions.model_validate({"size": "6 mm"}))
