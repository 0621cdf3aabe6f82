"""Quality of cells: equal to that of gmsh, with the place of a poor cell."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial import ConvexHull

import meshes
from app.foundation.errors import GeometryError
from meshes import quality
from meshes.data import MeshData
from meshes.gmsh_session import session
from tests.meshes.simple import ROD, mesh, options


@pytest.mark.parametrize("curved", [False, True])
def test_quality_equals_that_of_gmsh(tmp_path: Path, curved: bool) -> None:
    data = mesh(ROD, 3.0, curved=curved)
    meshes.write_msh(data, tmp_path / "a.msh")
    with session("theirs") as gmsh:
        gmsh.open(str(tmp_path / "a.msh"))
        _, tags, _ = gmsh.model.mesh.getElements(3)
        theirs = gmsh.model.mesh.getElementQualities(np.concatenate(tags), "minSICN")
    ours = quality.sicn(data.points, data.cells)
    assert np.sort(ours) == pytest.approx(np.sort(theirs), abs=1e-10)


def test_quality_check_names_region_place_and_value(rod: MeshData) -> None:
    points = rod.points.copy()
    # Flatten one cell of the cement: its last vertex into the plane of the others.
    cell = rod.cells[np.flatnonzero(rod.cell_tags == rod.regions["cement"])[100]]
    points[cell[3]] = points[cell[:3]].mean(axis=0)
    with pytest.raises(GeometryError, match=r"cement at \(-?\d+\.\d\d, .*\) mm: -?0\.\d{4}"):
        quality.check(points, rod.cells, rod.cell_tags, rod.regions)
    quality.check(rod.points, rod.cells, rod.cell_tags, rod.regions)


def test_quality_relaxation_moves_only_free_nodes_of_poor_cells() -> None:
    """A node among the corners of a cube is moved far outside of the cube, and returns."""
    corners = np.array(list(product((0.0, 1.0), repeat=3)))
    faces = ConvexHull(corners).simplices
    outward = np.cross(
        corners[faces[:, 1]] - corners[faces[:, 0]], corners[faces[:, 2]] - corners[faces[:, 0]]
    )
    inward = (outward * (corners[faces].mean(axis=1) - 0.5)).sum(axis=1) > 0
    faces[inward] = faces[inward][:, [1, 0, 2]]
    cells = np.column_stack([faces, np.full(len(faces), 8)])
    assert quality.sicn(np.vstack([corners, [[0.5, 0.5, 0.5]]]), cells).min() > 0.5
    x = np.vstack([corners, [[1.7, 0.4, 0.6]]])
    assert quality.sicn(x, cells).min() < -0.1
    free = np.arange(9) == 8
    moved = quality.relaxed_nodes(x, cells, free, 6)
    assert quality.sicn(moved, cells).min() >= quality.POOR
    assert (moved[:8] == corners).all() and ((moved[8] > 0) & (moved[8] < 1)).all()
    assert (quality.relaxed_nodes(moved, cells, free, 6) == moved).all()
    assert (quality.relaxed_nodes(x, cells, np.zeros(9, dtype=bool), 6) == x).all()


@pytest.mark.parametrize(
    ("works", "remedy"),
    [
        (
            lambda rod, mesh: mesh.size < 4.7,
            "Set mesh.size: 4.5 mm; with it all elements are good.",
        ),
        (
            lambda rod, mesh: rod.cement_thickness > 5.0,
            "Set geometry.cement_thickness: 5.4 mm; with it all elements are good.",
        ),
        (
            lambda rod, mesh: False,
            "Change geometry: elements are also inverted or nearly flat with mesh.size from 4.5 to"
            " 6 mm and geometry.cement_thickness from 3.6 to 6.4 mm.",
        ),
    ],
)
def test_quality_poor_cells_are_refused_with_a_size_that_meshes(
    works: Callable[[Any, Any], bool], remedy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The size is near the given one, within the far size.

    If none meshes, the message lists all tried sizes.
    """

    def checked(mesher: Any, geometry: Any, mesh: Any) -> None:
        if not works(geometry, mesh):
            raise quality.PoorCellsError("1 of 9 elements are inverted")

    monkeypatch.setattr(meshes, "_checked", checked)
    assert meshes._remedy(None, ROD, options(5.0, far_size="6 mm")) == remedy
