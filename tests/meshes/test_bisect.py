"""Refinement by bisection: conforming, of the same shape and names, with bounded angles."""

from __future__ import annotations

import numpy as np
import pytest

import meshes
from app.arrays import Bools
from app.case.geometries import Cylinders, MeshOptions
from app.errors import GeometryError
from meshes import quality
from meshes.bisect import centres, divide, divided
from meshes.data import (
    MeshData,
    boundary_areas,
    canonical,
    cell_volumes,
    exterior_facets,
    facet_areas,
    interface_facets,
    region_volumes,
)

CONES = Cylinders(
    stem_radius="7 mm",
    cement_thickness="4 mm",
    bone_thickness="6 mm",
    length="20 mm",
    taper="1 deg",
)


def cones(curved: bool, size: str = "4 mm") -> MeshData:
    return meshes.build(CONES, MeshOptions(size=size, curved=curved))


def near(data: MeshData, share: float = 0.03) -> Bools:
    """The cells next to a point on the outer interface."""
    away = np.linalg.norm(centres(data) - np.array([11.0, 0.0, 10.0]), axis=1)
    return away <= np.quantile(away, share)


@pytest.mark.parametrize("curved", [False, True])
def test_volumes_areas_and_names_are_inherited(curved: bool) -> None:
    before = cones(curved)
    after = divide(before, near(before))
    assert len(after.cells) > 1.1 * len(before.cells)
    # Pieces of a curved cell are the cell: volumes are exact, areas to their quadrature.
    assert region_volumes(after) == pytest.approx(region_volumes(before), rel=1e-12)
    assert boundary_areas(after) == pytest.approx(boundary_areas(before), rel=1e-6)
    assert (cell_volumes(after.points, after.cells) > 0).all()
    for name in before.interfaces:
        old, new = (
            facet_areas(m.points, interface_facets(m, name)[0]).sum() for m in (before, after)
        )
        assert new == pytest.approx(old, rel=1e-6)


@pytest.mark.parametrize("curved", [False, True])
def test_the_mesh_is_conforming(curved: bool) -> None:
    """Every face is of two cells or outside, and what is outside is what was."""
    before = cones(curved)
    after = divide(before, near(before))
    areas = [facet_areas(m.points, exterior_facets(m.cells)[0]).sum() for m in (before, after)]
    assert areas[1] == pytest.approx(areas[0], rel=1e-6)
    nodes, _ = exterior_facets(after.cells)
    outside = {tuple(sorted(f)) for f in nodes[:, :3]}
    assert {tuple(sorted(f)) for f in after.facets[:, :3]} == outside
    # Cells that share an edge share the node in its middle: no two nodes are in one place.
    assert len(np.unique(np.round(after.points, 7), axis=0)) == len(after.points)


def test_all_edges_of_marked_cells_are_halved() -> None:
    before = cones(curved=False)
    marked = np.zeros(len(before.cells), dtype=bool)
    marked[len(marked) // 2] = True
    after = divide(before, marked)
    corners = before.points[before.cells[marked][0]]
    middles = [(corners[i] + corners[j]) / 2 for i in range(4) for j in range(i)]
    for middle in middles:
        assert np.linalg.norm(after.points - middle, axis=1).min() < 1e-12


def test_nothing_marked_changes_nothing() -> None:
    before = cones(curved=True)
    after = canonical(divide(before, np.zeros(len(before.cells), dtype=bool)))
    for name in ("points", "cells", "cell_tags", "facets", "facet_tags"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))


def test_angles_stay_bounded_however_often_cells_are_divided() -> None:
    """Bisection of longest edges makes few shapes: the worst is not worse with every pass."""
    data = cones(curved=False, size="6 mm")
    worst = [quality.sicn(data.points, data.cells).min()]
    for _ in range(7):
        away = np.linalg.norm(centres(data) - np.array([11.0, 0.0, 10.0]), axis=1)
        data = divide(data, away < np.sort(away)[12])
        worst.append(quality.sicn(data.points, data.cells).min())
    assert worst[-1] > worst[0] / 3
    assert worst[-1] > 0.8 * worst[4]


def test_cells_are_named_by_their_centres_pass_by_pass() -> None:
    data = cones(curved=True)
    first = centres(data)[near(data, 0.01)]
    once = divided(data, [first])
    second = centres(once)[near(once, 0.005)]
    both = divided(data, [first, second])
    again = divided(once, [np.round(second, 6)])  # as a file has them
    np.testing.assert_array_equal(both.points, again.points)
    np.testing.assert_array_equal(both.cells, again.cells)
    with pytest.raises(GeometryError, match="no cell has its centre at"):
        divided(data, [np.array([[0.0, 0.0, 1000.0]])])
