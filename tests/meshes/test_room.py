"""Room around a stem: its distance from the widest possible canal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import meshes
from app.case.geometries import Femur, MeshOptions
from app.foundation.errors import GeometryError
from meshes import room
from meshes.layered_surfaces import LEAST_CORTEX, LayeredSurfaces
from meshes.room import StemSurface
from tests.meshes.canals import CUT, IMPLANT, RADIUS, START, rod, tube


def test_room_of_a_round_canal_is_its_clearance() -> None:
    """Linear interpolation between nodes has an error of h^2 / (8 r) = 0.02 mm at r = 6 mm."""
    canal = room.canal_of(CUT, tube((1.0, -2.0), (0.0, 0.0)))
    rng = np.random.default_rng(2)
    r, theta, z = rng.uniform(5.0, 15.0, 500), rng.uniform(-np.pi, np.pi, 500), -100.0
    x = np.stack([1 + r * np.cos(theta), -2 + r * np.sin(theta), np.full(500, z)], axis=1)
    assert canal.room(x) == pytest.approx(RADIUS - r, abs=0.03)
    # Beyond the grid its distance is added.
    assert canal.room(np.array([[61.0, -2.0, z]])) == pytest.approx(RADIUS - 60.0, abs=0.05)


def test_room_is_the_thickness_of_the_meshed_cement() -> None:
    """The least room is the least thickness of the mesh's cement, to 0.1 mm."""
    geometry = Femur.model_validate(
        {
            "cement_thickness": "5 mm",
            "canal_widening": "2 mm",
            "insertion": {"varus": "0.5 deg", "flexion": "0.6 deg", "medial_offset": "-0.5 mm"},
        }
    )
    mesh = MeshOptions.model_validate({"size": "5 mm"}).model_copy(update={"curved": True})
    least = meshes.build(geometry, mesh).notes["mantle"]["thickness"]["min"]
    stem = StemSurface.of(geometry.implant, geometry.placement)
    fit = room.fit(room.widest_canal(geometry), stem, geometry.placement)
    assert fit.least == pytest.approx(least, abs=0.1)


def test_room_of_a_stem_above_the_cut_is_refused() -> None:
    canal = room.canal_of(CUT, tube((0.0, 0.0), (0.0, 0.0)))
    placement = CUT.put(IMPLANT, replace(START, depth=-400.0), False)
    with pytest.raises(GeometryError, match="above the neck cut"):
        room.fit(canal, rod(5.0), placement)


def test_room_without_cement_is_the_cortex_left_above_the_least() -> None:
    """Lines from stem to periosteum are oblique by a few degrees, so agreement is to 0.15 mm."""
    geometry = Femur.model_validate({"cement_thickness": "0 mm", "tip_void": "5 mm"})
    mesh = MeshOptions.model_validate({"size": "6 mm"}).model_copy(update={"curved": True})
    surfaces = LayeredSurfaces(geometry, mesh)
    phi, s = (
        v.ravel()
        for v in np.meshgrid(np.arange(72) / 72, np.linspace(surfaces.tip, surfaces.cut, 90))
    )
    left = surfaces.lines(phi, s).length.min()
    stem = StemSurface.of(geometry.implant, geometry.placement)
    fit = room.fit(room.widest_canal(geometry), stem, geometry.placement)
    assert fit.least == pytest.approx(left - LEAST_CORTEX, abs=0.15)
