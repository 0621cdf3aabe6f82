"""Stems that are not along the shaft of the parametric femur, against moving them by hand."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from app.case.geometries import Femur
from app.errors import GeometryError
from meshes import _make, femur_bone, femur_stem
from meshes.data import interface_facets
from tests.meshes import cad_stems
from tests.meshes.test_patient import NECK, made, options

WIDE = {"canal_widening": "5 mm", "cement_thickness": "3 mm", "anteversion": "5 deg"}
PUT = {"varus": "2 deg", "version": {"angle": "8 deg"}, "medial_offset": "1 mm"}
PUT |= {"anterior_offset": "-1 mm"}


def femur(**changes: Any) -> Femur:
    return Femur.model_validate(WIDE | changes)


@pytest.mark.parametrize("kind", ["own", "file"])
def test_the_stem_is_moved_and_the_bone_is_not(kind: str, tmp_path: Path) -> None:
    """Nodes on the body turned by hand, and on the periosteum's own function."""
    file = {"stem": {"step": cad_stems.write("own", tmp_path, neck=NECK)}} if kind == "file" else {}
    geometry = femur(insertion=PUT, **file)
    data = _make(geometry, options(size="6 mm", around=None))
    normal, level = femur_bone.resection(geometry)
    medial, anterior = (Rotation.from_euler("z", 5 + a, degrees=True) for a in (0, 90))
    shift = medial.apply([1.0, 0.0, 0.0]) - anterior.apply([1.0, 0.0, 0.0])
    shift[2] = -normal[0] / normal[2]  # along the cut
    turn = Rotation.from_euler("yz", [2, 5 + 8], degrees=True)
    pivot = np.array([0.0, 0.0, level / normal[2]])
    x = data.points[np.unique(interface_facets(data, "stem_cement")[0])]
    x, y, z = (turn.inv().apply(x - pivot - shift) + pivot).T
    flank = (z > -116 + 1e-6) & (z < 28.99)  # the file ends at its shoulder
    x, y, z = x[flank], y[flank], z[flank]
    radius = femur_stem.body(femur()).radius(np.arctan2(y, x), z)
    assert len(z) > 200
    assert np.hypot(x, y) == pytest.approx(radius, abs=1e-5 if kind == "own" else 0.013)
    x, y, z = data.points[data.facets[np.isin(data.facet_tags, data.boundaries["bone_surface"])]].T
    periosteum = femur_bone.PERIOSTEUM.radius(np.arctan2(y, x), z)
    assert np.hypot(x, y) == pytest.approx(periosteum, abs=1e-5)
    head = turn.apply(np.array([43.0, 0.0, 54.0]) - pivot) + pivot + shift
    assert geometry.head_centre == pytest.approx(head, abs=1e-9 if kind == "own" else 0.02)
    assert data.notes["quality"]["sicn_min"] > 0.1


def test_depth_is_that_of_the_shoulder_below_the_cut() -> None:
    normal, level = femur_bone.resection(femur())
    on, deep = (femur(insertion={"depth": f"{d} mm"}).placement for d in (0, 3))
    edge = np.array([[-9.0789, 0.0, 29.0]])
    x, _, z = femur_bone.turned(on.to_model(edge), -math.radians(5))[0]
    assert normal @ [x, 0.0, z] == pytest.approx(level, abs=1e-4)
    assert on.to_model(edge) - deep.to_model(edge) == pytest.approx(np.array([[0, 0, 3.0]]))


def test_a_stem_that_leaves_the_canal_is_refused_with_the_place() -> None:
    with pytest.raises(GeometryError, match=r"cuts .* mm into the cortex .*laterally at .* insert"):
        made(femur(insertion={"varus": "6 deg"}))
