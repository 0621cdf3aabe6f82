"""Meshes of concentric cylinders: names, volumes, normals, slices."""

from __future__ import annotations

import math

import numpy as np
import pytest

import meshes
from app.campaigns.work_precision import fitted_order
from app.case.geometries import Cylinders, MeshOptions
from meshes.data import boundary_areas, region_volumes
from meshes.pieces import pieces_of_mesh
from tests.meshes.simple import ROD, mesh


@pytest.mark.parametrize(("sector", "part"), [("full", 1.0), ("half", 0.5), ("quarter", 0.25)])
def test_cylinders_are_concentric_conforming_and_named(sector: str, part: float) -> None:
    geometry = ROD.model_copy(update={"sector": sector})
    data = mesh(geometry, 1.5)
    assert data.notes["quality"]["sicn_min"] >= 0.25
    areas = boundary_areas(data)
    assert set(areas) == set(geometry.boundary_names)
    assert areas["top"] == pytest.approx(sum(areas[f"{r}_top"] for r in data.regions))
    assert areas["bone_surface"] == pytest.approx(part * 2 * math.pi * 17 * 20, rel=0.02)
    for plane in ("symmetry_x", "symmetry_y"):
        if plane in areas:
            sides = 2 if sector == "half" else 1  # the plane y = 0 on either side of the axis
            assert areas[plane] == pytest.approx(sides * 17 * 20)
    rise = 10 * math.tan(ROD.taper)
    for name, tag in (("stem_bottom", 7.0 - rise), ("stem_top", 7.0 + rise)):
        assert areas[name] == pytest.approx(part * math.pi * tag**2, rel=0.02)


@pytest.mark.parametrize("curved", [False, True])
def test_cylinders_volume_converges(curved: bool) -> None:
    """Straight facets lose volume as h^2, quadratic ones as h^4."""
    sizes = [4.0, 2.0]
    straight = ROD.model_copy(update={"taper": 0.0, "length": 8.0})
    exact = math.pi * 49.0 * 8.0
    errors = [
        region_volumes(mesh(straight, h, far_size=f"{h} mm", curved=curved))["stem"] / exact - 1
        for h in sizes
    ]
    assert fitted_order(sizes, errors) > (3.0 if curved else 1.6)


@pytest.mark.parametrize("curved", [False, True])
def test_cylinders_normals_point_outwards(curved: bool) -> None:
    data = mesh(ROD, 3.0, curved=curved)
    normals = pieces_of_mesh(data, with_normals=["bone_surface"]).normals["bone_surface"]
    on = np.unique(data.facets[np.isin(data.facet_tags, data.boundaries["bone_surface"])])
    radial = data.points[on] * [1, 1, 0]
    radial /= np.linalg.norm(radial, axis=1)[:, None]
    assert (normals[on] * radial).sum(axis=1).min() > (1 - 1e-6 if curved else 0.99)


@pytest.mark.parametrize("sector", ["full", "half", "quarter"])
def test_cylinders_slices_one_cell_thick_mesh(sector: str) -> None:
    """Any thickness works: 4.2 mm of cement did, 4.199999999999999 mm left a sliver."""
    rng = np.random.default_rng(7)
    for number in range(5):
        size = float(rng.uniform(2.0, 4.0))
        thickness = 4.199999999999999 if number == 0 else float(rng.uniform(1.0, 8.0))
        rings = Cylinders(
            stem_radius=f"{rng.uniform(4.0, 9.0)!r} mm",
            cement_thickness=f"{thickness!r} mm",
            bone_thickness=f"{rng.uniform(3.0, 8.0)!r} mm",
            length=f"{size * rng.uniform(0.5, 1.5)!r} mm",
            sector=sector,
        )
        data = meshes.build(rings, MeshOptions(size=f"{size!r} mm", curved=number % 2 == 1))
        assert data.notes["quality"]["sicn_min"] > 0.1
        inner, outer = rings.stem_radius, rings.stem_radius + thickness
        exact = np.pi * (outer**2 - inner**2) * rings.length * rings.fraction
        # Straight chords of length h lose (h / R)^2 / 6 of a circle's area.
        lost = (size / inner) ** 2 / 6
        volume = data.notes["volumes_mm3"]["cement"]
        assert volume == pytest.approx(exact, rel=0.01 if data.curved else 0.01 + 4 * lost)
