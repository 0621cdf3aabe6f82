"""Positions of a stem relative to the neck cut."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from app.case.geometries import Femur
from app.foundation.errors import GeometryError
from meshes import _make, femur_bone, femur_stem, quality
from meshes.data import interface_facets, region_volumes
from meshes.placement import shoulder_level
from tests.meshes import cad_stems
from tests.meshes.canals import CUT, IMPLANT, START
from tests.patient.bones import cut, moved, parametric_canal, parametric_femur, turned, write
from tests.patient.patients import made, options, patient


def test_placement_flexion_moves_the_tip_to_posterior() -> None:
    """The tip of a straight stem is behind the axis by its distance from the cut times the sine."""
    angle = math.radians(3.0)
    placement = CUT.put(IMPLANT, replace(START, flexion=angle), False)
    tip = placement.to_model([0.0, 0.0, IMPLANT.tip_z])
    below = placement.top - IMPLANT.tip_z
    assert tip == pytest.approx(
        placement.foot - below * np.array([0.0, math.sin(angle), math.cos(angle)])
    )
    assert placement.rotation.T @ placement.rotation == pytest.approx(np.eye(3), abs=1e-14)


@pytest.mark.parametrize("flexion", [0.0, 8.0])
@pytest.mark.parametrize("depth", [2.0, 6.0])
def test_placement_shoulder_is_between_its_section_and_the_cut(
    depth: float, flexion: float
) -> None:
    """The section through the lateral edge is parallel to the cut; above it is the shoulder.

    A shoulder less than 2.5 mm below the cut counts as at the cut.
    """
    start = replace(START, depth=depth, flexion=math.radians(flexion))
    placement = CUT.put(IMPLANT, start, False)
    half_width = IMPLANT.half_width
    lateral, anterior = np.array([-half_width, 0.0]), np.array([0.0, 5.0])
    normal = placement.rotation.T @ placement.normal  # of the cut, in the stem's axes

    def on_plane(place: np.ndarray, above: float) -> np.ndarray:
        """A point of the cut moved down along the axis by the depth, and up again."""
        height = placement.top - depth - place @ normal[:2] / normal[2]
        return placement.to_model([*place, height + above])

    points = np.array(
        [
            on_plane(lateral, 0.1),
            on_plane(lateral, -0.1),
            on_plane(anterior, 0.1),
            on_plane(anterior, -0.1),
            on_plane(-lateral + [5.0, 0.0], 0.1),  # medial of the shaft
        ]
    )
    on_shoulder = shoulder_level(IMPLANT, placement, points) <= 0.0
    expected = [True, False, True, False, False] if depth > 2.5 else [False] * 5
    assert on_shoulder.tolist() == expected


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Surfaces of the parametric femur."""
    path = tmp_path_factory.mktemp("bone")
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    for name, surface in (("bone", parametric_femur()), ("canal", parametric_canal())):
        write(path / f"{name}.stl", surface)
        write(path / f"{name}_moved.stl", moved(surface, turn, np.array([50.0, -20.0, 900.0])))
    return path


# The parametric stem below the cut, placed where its shoulder is out of the bone.
NECK = (135.919, 130.0, 4.9, 5.5, 56.133)


# The parametric femur, whose stem is moved by hand.
WIDE = {"canal_widening": "5 mm", "cement_thickness": "3 mm", "anteversion": "5 deg"}
MOVED = {"varus": "2 deg", "version": {"angle": "8 deg"}, "medial_offset": "1 mm"}
MOVED |= {"anterior_offset": "-1 mm"}


def femur(**changes: Any) -> Femur:
    return Femur.model_validate(WIDE | changes)


@pytest.mark.parametrize("kind", ["parametric", "file"])
def test_placement_moves_the_stem_but_not_the_bone(kind: str, tmp_path: Path) -> None:
    """Nodes are on the body rotated by hand, and on the function of the periosteum."""
    file = (
        {"stem": {"step": cad_stems.write("parametric", tmp_path, neck=NECK)}}
        if kind == "file"
        else {}
    )
    geometry = femur(insertion=MOVED, **file)
    data = _make(geometry, options(size="6 mm", around=36))
    normal, level = cut(geometry)
    medial, anterior = (Rotation.from_euler("z", 5 + a, degrees=True) for a in (0, 90))
    shift = medial.apply([1.0, 0.0, 0.0]) - anterior.apply([1.0, 0.0, 0.0])
    shift[2] = -normal[0] / normal[2]  # along the cut
    turn = Rotation.from_euler("yz", [2, 5 + 8], degrees=True)
    pivot = np.array([0.0, 0.0, level / normal[2]])
    x = data.points[np.unique(interface_facets(data, "stem_cement")[0])]
    x, y, z = (turn.inv().apply(x - pivot - shift) + pivot).T
    flank = (z > -116 + 1e-6) & (z < 28.99)  # the file ends at its shoulder
    x, y, z = x[flank], y[flank], z[flank]
    radius = femur_stem.shaft_of(femur().implant).radius(np.arctan2(y, x), z)
    assert len(z) > 200
    assert np.hypot(x, y) == pytest.approx(radius, abs=1e-5 if kind == "parametric" else 0.02)
    x, y, z = data.points[data.facets[np.isin(data.facet_tags, data.boundaries["bone_surface"])]].T
    periosteum = femur_bone.PERIOSTEUM.radius(np.arctan2(y, x), z)
    assert np.hypot(x, y) == pytest.approx(periosteum, abs=1e-5)
    head = turn.apply(np.array([43.0, 0.0, 54.0]) - pivot) + pivot + shift
    assert geometry.head_centre == pytest.approx(head, abs=1e-9 if kind == "parametric" else 0.02)
    assert quality.quality_without_length(data.points, data.cells).min() > 0.05


def test_placement_depth_is_that_of_the_shoulder() -> None:
    normal, level = cut(femur())
    on, deep = (femur(insertion={"depth": f"{d} mm"}).placement for d in (0, 3))
    edge = np.array([[-9.0789, 0.0, 29.0]])
    x, _, z = turned(on.to_model(edge), -math.radians(5))[0]
    assert normal @ [x, 0.0, z] == pytest.approx(level, abs=1e-4)
    assert on.to_model(edge) - deep.to_model(edge) == pytest.approx(np.array([[0, 0, 3.0]]))


@pytest.mark.parametrize("kind", ["femur", "patient", "file"])
def test_placement_shoulder_below_the_cut_has_cement_above(kind: str, folder: Path) -> None:
    """The metal is the same at any depth. Its top begins at the edge, and ends at the cut.

    The top of the file's stem, by hand, is flat and 11 mm long. That of the parametric one has 7.61
    mm in 21.24 mm to the neck, and is 7.9 mm long.
    """
    given: dict[str, Any] = {"cement_thickness": "3 mm"}
    if kind == "file":
        given["stem"] = {"step": cad_stems.write("exeter", folder)}
    volumes = []
    for depth in (0, 9):
        given["insertion"] = {"depth": f"{depth} mm"}
        geometry = femur(**given) if kind == "femur" else patient(folder, **given)
        data = _make(geometry, options(size="6 mm", around=14))
        volumes.append(region_volumes(data))
        assert quality.quality_without_length(data.points, data.cells).min() > 0.05
    metal, there = (v["stem"] for v in volumes)
    assert metal == pytest.approx(there, rel=2e-3)
    level, rise = (
        femur_stem.shoulder_plane_height(geometry.implant, 0.0),
        0.0 if kind == "file" else 7.61 / 21.24,
    )
    x = data.points[np.unique(interface_facets(data, "stem_cement")[0])]
    x, y, z = geometry.placement.to_stem(x).T
    along = x + 9.08
    top = (x < 2.5) & (z > level + (-0.01 if kind == "file" else 0.1))
    middle = top & (np.abs(y) < (6 if kind == "file" else 0.01))
    assert z[middle] == pytest.approx(level + rise * along[middle], abs=0.01)
    assert along[middle].max() == pytest.approx(9 / (0.781 + rise), abs=0.3)
    assert (z[top] < level + rise * along[top] + 0.01).all()


def test_placement_refuses_a_stem_outside_the_canal() -> None:
    with pytest.raises(GeometryError, match=r"cuts .* mm into the cortex .*laterally at .* insert"):
        made(femur(insertion={"varus": "6 deg"}))


def test_placement_refuses_a_cut_that_slopes_from_front_to_back_alone() -> None:
    """A level cut and a stem in flexion: the angle of the cut helps, or less flexion."""
    level = replace(CUT, normal=np.array([0.0, 0.0, 1.0]))
    with pytest.raises(GeometryError, match=r"by 0 degrees .* but by 3 degrees from front to back"):
        level.put(IMPLANT, replace(START, flexion=math.radians(3.0)), False)
    assert level.put(IMPLANT, START, False).slopes == (0.0, 0.0)
