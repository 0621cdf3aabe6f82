"""The femur against its definition."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

import meshes
from app.case import sweep
from app.case.geometries import Femur, IntactFemur, MeshOptions
from app.case.hips import MUSCLES
from meshes import femur_bone, femur_intact, femur_stem, quality
from meshes.data import (
    MeshData,
    boundary_areas,
    faces_of,
    facet_areas,
    region_volumes,
)

SIZE = 3.0


@cache
def femur(thickness: float, size: float = SIZE) -> MeshData:
    return meshes.build(Femur(cement_thickness=f"{thickness} mm"), MeshOptions(size=f"{size} mm"))


def volume(radius: Callable[..., Any], low: float, high: float) -> float:
    """Volume within a surface r(theta, z) between two levels [mm3]."""
    angles, levels = np.meshgrid(np.linspace(0, 2 * np.pi, 361)[:-1], np.linspace(low, high, 800))
    return float(np.pi * (radius(angles, levels) ** 2).mean() * (high - low))


THICKNESSES = [
    4.0,
    *(pytest.param(t, marks=pytest.mark.slow) for t in (1.0, 2.0, 3.0, 5.0, 7.0, 8.0)),
]


@pytest.mark.parametrize("thickness", THICKNESSES)
def test_geometry_regions_are_connected_and_touch(thickness: float) -> None:
    data = femur(thickness)
    regions = data.regions
    assert quality.quality_without_length(data.points, data.cells).min() > 0.08
    assert set(data.boundaries) == set(Femur().boundary_names)
    assert all(area > 0 for area in boundary_areas(data).values())
    # The stem touches bone nowhere, not even at a node.
    stem = np.unique(data.cells[data.cell_tags == regions["stem"]])
    bone = [regions["cortical_bone"], regions["cancellous_bone"]]
    assert len(np.intersect1d(stem, data.cells[np.isin(data.cell_tags, bone)])) == 0


def test_geometry_thickness_is_reported() -> None:
    """Mantles have the given thickness where there is room.

    More than half of the canal has no room.
    """
    notes = femur(4.0).notes
    thickness = notes["mantle"]["thickness"]
    assert thickness["nominal"] == 4.0
    # At its narrowest, at z = -50 or so, the canal leaves 1.5 mm (antero-posteriorly) to 2.
    assert 1.4 < thickness["min"] < thickness["p5"] < thickness["median"] < 4.0
    assert thickness["median"] - 0.1 < thickness["mean"] < 4.0 < thickness["p95"] < 4.0 + 0.15
    assert thickness["max"] < 4.0 + 0.8  # where a layer ends: a quarter of the mesh size
    assert 0.5 < thickness["clipped_fraction"] < 0.7
    assert notes["head_centre"] == [43.0, 0.0, 54.0]
    assert notes["mantle"]["volume"] == pytest.approx(region_volumes(femur(4.0))["cement"])
    json.dumps(notes)


@pytest.mark.parametrize("widening", [0.0, 5.0])
def test_geometry_thinnest_cortex_is_that_between_surfaces(widening: float) -> None:
    """Points on both surfaces are half a millimetre apart. Reaming leaves 2.5 mm, but radially."""
    geometry = Femur(canal_widening=f"{widening} mm")
    data = meshes.build(geometry, MeshOptions(size="6 mm"))
    theta, z = np.meshgrid(np.radians(np.arange(0, 360, 2)), np.arange(-118.0, 0.0, 0.5))
    outside, inside = (
        np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=-1).reshape(-1, 3)
        for r in (femur_bone.PERIOSTEUM.radius(theta, z), geometry.femur.endosteum(theta, z))
    )
    exact = cKDTree(outside).query(inside)[0].min()
    assert data.notes["mantle"]["cortex_min"] == pytest.approx(exact, abs=0.2)


@pytest.mark.parametrize("kind", [Femur, IntactFemur])
@pytest.mark.parametrize("cortex", [1.5, 2.0, 4.0])
def test_geometry_metaphyseal_cortex_has_the_given_thickness(
    kind: type[Any], cortex: float
) -> None:
    """The thickness is radial at vertices of the endosteum.

    Those in the shaft are on the table's surface.
    """
    data = meshes.build(kind(metaphyseal_cortex=f"{cortex} mm"), MeshOptions(size="8 mm"))
    assert quality.quality_without_length(data.points, data.cells).min() > 0.08
    cell, face, behind = data.facets_between_regions
    bone = data.cell_tags == data.regions["cortical_bone"]
    at = bone[cell] & ~bone[behind]
    x, y, z = data.points[np.unique(faces_of(data.cells, cell[at], face[at])[:, :3])].T
    surfaces = femur_bone.PERIOSTEUM, femur_bone.Tube(femur_bone.CANAL)
    outer, canal = (s.radius(np.arctan2(y, x), z) - np.hypot(x, y) for s in surfaces)
    assert np.abs(outer - cortex)[(z > -10) & (z < 8)].max() < 2e-5
    assert np.abs(canal)[z < -50].max() < 2e-5


def test_geometry_stems_of_the_thickness_sweep_share_a_cavity() -> None:
    """Cavities agree to the difference of 1 / cos of the taper: 2 mm times 0.0009."""
    _, planned = sweep.read(Path(__file__).parents[2] / "configs/sweeps/thickness.yaml")
    shared = [c.case.geometry for c in planned if c.point.part == "cavity"]
    assert len({g.cement_thickness for g in shared}) == 4
    assert len(shared) == 4
    for z in (-118.0, -50.0, 20.0):
        outlines = [
            femur_stem.shaft_of(g.implant).offset(g.cement_thickness).section(z) for g in shared
        ]
        assert np.ptp(outlines, axis=0) == pytest.approx(0.0, abs=0.003)


def test_geometry_plug_fills_the_canal_below_the_tip() -> None:
    """The volume is that of the canal over its length: 7 mm of stem and cement have room of 6.2."""
    geometry, plug = Femur(), femur(4.0).notes["mantle"]["plug_volume"]
    tip, height = geometry.implant.tip_z, geometry.implant.tip_rounding
    low, high = tip - geometry.plug_length, tip + height
    exact = volume(femur_bone.Tube(femur_bone.CANAL).radius, low, high)
    # The rounded end of the stem fills four fifths of its height.
    exact -= 0.8 * volume(femur_stem.shaft_of(geometry.implant).radius, tip, high)
    # Flat facets of 3 mm lose 4 % of a circle of 6 mm.
    assert plug == pytest.approx(exact, rel=0.05)


@cache
def intact(curved: bool = True) -> MeshData:
    return meshes.build(IntactFemur(), MeshOptions(size="6 mm", curved=curved))


def test_geometry_head_is_a_sphere_on_a_neck() -> None:
    geometry = IntactFemur()
    centre = np.array(geometry.head_centre)
    assert set(intact().boundaries) == set(geometry.boundary_names)
    # Corners are on it; curved cells that bend too far are straightened.
    for data, part in ((intact(False), 0.0), (intact(), 0.05)):
        facets = data.facets[np.isin(data.facet_tags, data.boundaries["head"])]
        distance = np.linalg.norm(data.points[np.unique(facets)] - centre, axis=1)
        radius = np.full(len(distance), geometry.head_radius)
        assert distance == pytest.approx(radius, rel=max(part, 1e-6))
    # All of the sphere but the cap in the neck.
    radius, neck = geometry.head_radius, femur_intact.NECK_RATIO[1] * geometry.head_radius
    cap = 2 * np.pi * radius * (radius - np.sqrt(radius**2 - neck**2))
    area = boundary_areas(data)["head"]
    assert area == pytest.approx(4 * np.pi * radius**2 - cap, rel=0.002)
    # Cortex in the head's shell, cancellous bone within.
    x = data.points[data.cells[:, :4]].mean(axis=1)
    deep = np.linalg.norm(x - centre, axis=1) < geometry.head_radius - 5.0
    assert set(data.cell_tags[deep]) == {data.regions["cancellous_bone"]}
    shell = (np.linalg.norm(x - centre, axis=1) > geometry.head_radius - 1.5) & (x[:, 2] > 60.0)
    assert set(data.cell_tags[shell]) == {data.regions["cortical_bone"]}


def test_geometry_patches_are_at_muscles_and_head() -> None:
    data = femur(4.0)
    for name, place in MUSCLES.items():
        facets = data.facets[np.isin(data.facet_tags, data.boundaries[name])]
        assert np.linalg.norm(data.points[facets].mean(axis=(0, 1)) - place) < SIZE, name
        assert set(data.boundaries[name]) <= set(data.boundaries["bone_surface"])
    disc = data.facets[np.isin(data.facet_tags, data.boundaries["stem_trunnion"])]
    weights = facet_areas(data.points, disc)
    centre = np.average(data.points[disc].mean(axis=1), axis=0, weights=weights)
    assert centre == pytest.approx([43.0, 0.0, 54.0], abs=0.3)
    assert weights.sum() == pytest.approx(36 * np.pi, rel=0.13)


@pytest.mark.slow
@pytest.mark.parametrize("thickness", [2.0, 7.0])
def test_geometry_fine_meshes_of_thin_and_thick_mantles(thickness: float) -> None:
    """Cells are cubes of the given size, except that each layer has at least one cell."""
    data, coarse = femur(thickness, 1.5), femur(thickness, 6.0)
    assert 0.5 * 64 < len(data.cells) / len(coarse.cells) < 64
    assert quality.quality_without_length(data.points, data.cells).min() > 0.08
