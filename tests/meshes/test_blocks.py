"""Meshes of stacked blocks: volumes, areas, names."""

from __future__ import annotations

import math

import numpy as np
import pytest

from app.case.geometries import Block, Blocks
from meshes.data import boundary_areas, cell_volumes, facet_areas, interface_facets, region_volumes
from tests.meshes.simple import STACK, mesh


@pytest.mark.parametrize("curved", [False, True])
def test_blocks_have_exact_volumes_areas_and_names(curved: bool) -> None:
    data = mesh(STACK, 2.0, curved=curved)
    assert data.cells.shape[1] == (10 if curved else 4)
    assert region_volumes(data) == pytest.approx({"low": 400.0, "mid": 320.0, "high": 240.0})
    areas = boundary_areas(data)
    assert set(areas) == set(STACK.boundary_names)
    assert areas["x_min"] == pytest.approx(96.0)
    assert areas["bottom"] == pytest.approx(80.0)
    assert areas["low_x_min"] == pytest.approx(8.0 * (5.0 - 5.0 * math.tan(STACK.tilt)))
    assert areas["mid_y_max"] == pytest.approx(40.0)
    for name in STACK.interface_sides:
        facets, inner, outer = interface_facets(data, name)
        area = facet_areas(data.points, facets).sum()
        assert area == pytest.approx(80.0 / math.cos(STACK.tilt)), name
        normal = np.cross(*(data.points[facets[:, k]] - data.points[facets[:, 0]] for k in (1, 2)))
        assert np.all(normal[:, 2] > 0)  # from the first side to the second
        assert set(data.cell_tags[inner]) == {data.regions[name.split("_")[0]]}
        assert set(data.cell_tags[outer]) == {data.regions[name.split("_")[1]]}


def test_blocks_of_one_have_no_interface_and_a_uniform_mesh() -> None:
    data = mesh(Blocks(blocks=(Block(name="only", size=["4 mm"] * 3),)), 1.0)
    assert dict(data.interfaces) == {}
    assert np.cbrt(8.5 * cell_volumes(data.points, data.cells)).max() < 2.0
