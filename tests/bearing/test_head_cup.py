"""A head in its cup: names, spheres, volumes, quality."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

import meshes
from app.bearing.head_cup import HeadCup
from app.case.geometries import MeshOptions
from app.foundation.arrays import Floats, Ints
from meshes.data import (
    MeshData,
    boundary_areas,
    interface_facets,
    nodes_of_boundary_facets,
    region_volumes,
)
from tests.support import digest

LINER = {"head_diameter": "28 mm", "radial_clearance": "0.1 mm", "liner_thickness": "8 mm"}
CUP = HeadCup(**LINER, shell_thickness="4 mm")
# Radii of head, bore of the liner, its outside, and the outside of the shell [mm].
R = 14.0
INNER = 14.1
OUTER = 22.1
SHELL = 26.1


def mesh(size: float, geometry: HeadCup = CUP, order: int = 2) -> MeshData:
    options = MeshOptions(size=f"{size} mm", order=order, curved=order == 2)
    return meshes.build(geometry, options)


@pytest.fixture(scope="module")
def cup() -> MeshData:
    return mesh(2.8)


def away(data: MeshData, nodes: Ints) -> Floats:
    return np.linalg.norm(data.points[np.unique(nodes)], axis=1)


@pytest.mark.parametrize(("size", "order"), [(4.0, 2), (2.0, 1), (2.0, 2)])
def test_head_cup_bodies_are_separate_and_on_spheres(size: float, order: int) -> None:
    data = mesh(size, order=order)
    assert set(data.boundaries) == set(CUP.boundary_names)
    assert data.notes["quality"]["sicn_min"] >= 0.1
    head, liner = (data.cells[data.cell_tags == data.regions[n]] for n in ("head", "liner"))
    assert not np.isin(head, liner).any()
    assert not len(interface_facets(data, "bearing")[0])
    sides = zip(CUP.sliding_boundaries["bearing"], (R, INNER), (head, liner), strict=True)
    for name, radius, body in sides:
        on = nodes_of_boundary_facets(data, name)
        assert np.abs(away(data, on) - radius).max() < 1e-9
        assert np.isin(on, body).all()
    joint = interface_facets(data, "liner_shell")[0]
    assert np.abs(away(data, joint[:, :3]) - OUTER).max() < 1e-9


def exact() -> dict[str, float]:
    """Volumes and areas of spheres, of a cone in a ball, and of plane rings (mm3, mm2)."""
    bore, depth, taper = 6.5, 16.0, math.radians(2.85)
    end = bore - depth * math.tan(taper)
    rise = math.sqrt(R**2 - bore**2)
    cap = math.pi / 3 * (R - rise) ** 2 * (2 * R + rise)
    cone = math.pi / 3 * depth * (bore**2 + bore * end + end**2)
    return {
        "head": 4 / 3 * math.pi * R**3 - cap - cone,
        "liner": 2 / 3 * math.pi * (OUTER**3 - INNER**3),
        "shell": 2 / 3 * math.pi * (SHELL**3 - OUTER**3),
        "head_surface": 2 * math.pi * R * (R + rise),
        "head_bore": math.pi * (bore + end) * depth / math.cos(taper) + math.pi * end**2,
        "liner_inner": 2 * math.pi * INNER**2,
        "liner_rim": math.pi * (OUTER**2 - INNER**2),
        "shell_rim": math.pi * (SHELL**2 - OUTER**2),
        "shell_outer": 2 * math.pi * SHELL**2,
    }


def test_head_cup_volumes_and_areas_converge(cup: MeshData) -> None:
    """Edges are curved on both sides of the bearing."""
    for data, error in ((cup, 5e-4), (mesh(1.4), 2.5e-4)):
        sizes = region_volumes(data) | boundary_areas(data)
        assert {name: sizes[name] for name in exact()} == pytest.approx(exact(), rel=error)


def test_head_cup_bearing_is_finer_on_the_cup(cup: MeshData) -> None:
    other = mesh(2.8, CUP.model_copy(update={"head_size": 0.8}))
    sides = ((cup, "liner_inner", 1.0), (cup, "head_surface", 1.15), (other, "head_surface", 0.8))
    for data, name, ratio in sides:  # edges of regular triangles of the mean area
        area = boundary_areas(data)[name] / len(nodes_of_boundary_facets(data, name))
        assert math.sqrt(4 * area / math.sqrt(3)) == pytest.approx(2.8 * ratio, rel=0.1)


def test_head_cup_inclination_and_version_rotate_the_mesh(cup: MeshData) -> None:
    upright = mesh(2.8, CUP.model_copy(update={"inclination": 0.0, "version": 0.0}))
    # Lateral, anterior and distal (Murray 1993, radiographic definitions).
    i, v = math.radians(45), math.radians(20)
    opening = [-math.sin(i) * math.cos(v), math.sin(v), -math.cos(i) * math.cos(v)]
    for data, axis in ((cup, opening), (upright, [0, 0, -1])):
        assert (
            np.abs(data.points[np.unique(nodes_of_boundary_facets(data, "liner_rim"))] @ axis).max()
            < 1e-12
        )
        assert (
            np.mean(data.points[np.unique(nodes_of_boundary_facets(data, "head_bore"))] @ axis)
            > 5.0
        )
        assert (
            np.mean(data.points[np.unique(nodes_of_boundary_facets(data, "liner_inner"))] @ axis)
            < -5.0
        )
    assert region_volumes(upright) == pytest.approx(region_volumes(cup), rel=1e-12)
    assert digest(mesh(2.8)) == digest(cup)  # the same keys, the same mesh


THIN = {"liner_thickness": "0.5 mm", "shell_thickness": "2 mm"}
CLOSED = {"cover_angle": "120 deg", "bore_taper": "0 deg"}


@pytest.mark.parametrize(
    "keys", [THIN, CLOSED, {"cover_angle": "30 deg"}, {"radial_clearance": "0 mm"}]
)
@pytest.mark.parametrize("part", [1.0, 0.7])
def test_head_cup_thin_open_and_closed_cups_mesh(keys: dict[str, Any], part: float) -> None:
    """Cells are of the largest allowed size, or 5 mm."""
    geometry = HeadCup(**LINER | keys)
    size = part * min(5.0, geometry.coarsest_size)
    data = mesh(size, geometry)
    assert set(data.regions) == set(geometry.region_names)
    options = MeshOptions(size=f"{size} mm")
    assert geometry.estimate_cells(options) == pytest.approx(len(data.cells), rel=0.7)
    area = 2 * math.pi * geometry.cup_radii[0] ** 2 * (1 - math.cos(geometry.cover_angle))
    assert boundary_areas(data)["liner_inner"] == pytest.approx(area, rel=0.1)


def test_head_cup_refuses_impossible_bodies() -> None:
    wrong = {"cover_angle": "20 deg", "bore_diameter": "27 mm", "bore_depth": "25 mm"}
    texts = (
        "30 to 120 deg",
        "leaves no material of the head",
        "to the head's surface",
        "before its end",
    )
    for item, text in zip({**wrong, "bore_taper": "30 deg"}.items(), texts, strict=True):
        with pytest.raises(ValidationError, match=text):
            HeadCup(**LINER | dict([item]))
