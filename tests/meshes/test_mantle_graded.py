"""A mantle whose thickness varies with height and side."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

import meshes
from app.case.geometries import Femur, MeshOptions
from app.case.shapes import range_of_thickness
from app.foundation.arrays import Floats
from meshes import femur_stem
from meshes.data import interface_facets
from meshes.gruen import Zones
from tests.meshes import cad_stems
from tests.patient.bones import parametric_femur, write
from tests.patient.patients import patient

BOTH = {"proximal": "3 mm", "distal": "1.5 mm", "medial": "3 mm", "lateral": "2 mm"}
SIDES = {"medial": "4 mm", "anterior": "2 mm", "posterior": "3 mm"}
MESH = MeshOptions.model_validate({"size": "6 mm", "order": 1, "around": 24, "through_cement": 1})


def both(theta: Floats, part: Floats) -> Floats:
    return (1.5 + 1.5 * part) * (1 + 0.2 * np.cos(theta))


def sides(theta: Floats, part: Floats) -> Floats:
    """Quarters of a turn from medial, and a half from anterior to posterior."""
    quarter = np.where(np.sin(theta) > 0, 3 + np.cos(2 * theta), 3.5 + 0.5 * np.cos(2 * theta))
    return np.where(np.cos(theta) > 0, quarter, 2.5 - 0.5 * np.sin(theta))


@pytest.mark.parametrize("kind", ["femur", "sides", "cad", "patient"])
def test_mantle_graded_nodes_have_the_local_thickness(kind: str, tmp_path: Path) -> None:
    """The distance is from dense points of the stem, far from cortex and neck."""
    given, asked = (SIDES, sides) if kind == "sides" else (BOTH, both)
    if kind == "patient":
        write(tmp_path / "bone.stl", parametric_femur())
        canal = {"ream": "by", "ream_by": "4 mm"}
        geometry: Any = patient(tmp_path, canal=canal, cement_thickness=given)
    else:
        file = {"stem": {"step": cad_stems.write("parametric", tmp_path)}} if kind == "cad" else {}
        keys = {"canal_widening": "4 mm", "cement_thickness": given, **file}
        geometry = Femur.model_validate(keys)
    data, zones = meshes.build(geometry, MESH), Zones(geometry)
    x = data.points[np.unique(interface_facets(data, "cement_bone")[0])]
    cortex = data.points[np.unique(data.cells[data.cell_tags == data.regions["cortical_bone"]])]
    x = zones._local(x[cKDTree(cortex).query(x)[0] > 2.0]) - [0, 0, zones.tip]
    x = x[(x[:, 2] > 5) & (x[:, 2] < 125)]
    theta, z = np.meshgrid(np.linspace(0, 2 * np.pi, 720), np.arange(0, 135, 0.2))
    r = femur_stem.shaft_of(Femur().implant).radius(theta, z + Femur().implant.tip_z)
    stem = np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=-1).reshape(-1, 3)
    cut = zones._level / zones._normal[2] - zones.tip
    wanted = asked(np.arctan2(x[:, 1], x[:, 0]), x[:, 2] / cut)
    assert len(x) > 200 and np.ptp(wanted) > 1.5
    assert cKDTree(stem).query(x)[0] == pytest.approx(wanted, abs=0.1 if kind == "cad" else 0.01)
    assert data.notes["mantle"]["thickness"]["clipped_fraction"] < 0.1
    assert len(data.cells) == pytest.approx(geometry.estimate_cells(MESH), rel=0.15)
    theta, part = np.meshgrid(2 * np.pi * (np.arange(999) + 0.5) / 999, np.linspace(0, 1, 201))
    least, mean, most = range_of_thickness(geometry.cement_thickness)
    t = asked(theta, part)
    assert (least, mean, most) == pytest.approx((t.min(), t.mean(), t.max()), abs=2e-4)
