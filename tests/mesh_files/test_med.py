"""Files ``.med``: several meshes, families."""

from __future__ import annotations

from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest

from meshes.data import region_volumes
from tests.mesh_files.spellings import (
    BOTTOM_SIDES,
    MED_CELLS,
    POINTS,
    TAGS,
    TWO,
    VOLUMES,
    bonded,
    med,
    messages_of,
    refused,
    whole,
)


def test_med_mesh_of_tetrahedra_is_chosen(tmp_path: Path) -> None:
    skin = (POINTS, BOTTOM_SIDES, [["s"], ["t"]])
    data = bonded(med(tmp_path / "a.med", Hull=skin, Solid=(POINTS, MED_CELLS, TWO)))
    whole(data)
    assert "meshes that are not read: Hull" in messages_of(data)


def test_med_families_may_be_left_out(tmp_path: Path) -> None:
    """Nodes and triangles without a group need no family."""
    data = meshio.Mesh(POINTS, [("tetra", MED_CELLS), ("triangle", BOTTOM_SIDES)])
    data.cell_data = {"cell_tags": [-TAGS, np.zeros(2, dtype=int)]}
    data.cell_tags, data.point_tags = {-3: ["bone"], -8: ["cement"]}, {1: ["foot"]}
    data.point_data["point_tags"] = np.zeros(len(POINTS), dtype=int)
    path = tmp_path / "a.med"
    data.write(path)
    with h5py.File(path, "r+") as file:
        (step,) = file["ENS_MAA/mesh"].values()
        del step["MAI/TR3/FAM"], step["NOE/FAM"]
    assert whole(bonded(path)) == {}


def test_med_meshes_are_picked(tmp_path: Path) -> None:
    """The file has two alternatives, or the parts of a model in separate meshes."""
    fine = (POINTS * 2, MED_CELLS, TWO)
    path = med(tmp_path / "a.med", Coarse=(POINTS, MED_CELLS, TWO), Fine=fine)
    message = refused(path)
    assert "has the meshes Coarse (12 tetrahedra), Fine (12 tetrahedra)" in message
    assert "set `geometry.meshes` to those of the model" in message
    data = bonded(path, meshes=["Coarse"])
    whole(data)
    assert "meshes that are not read: Fine" in messages_of(data)
    assert region_volumes(bonded(path, meshes=["Fine"]))["bone"] == pytest.approx(
        8 * VOLUMES["bone"]
    )
    assert "has no mesh Mesh_1; it has the meshes Coarse (12" in refused(path, meshes=["Mesh_1"])


def test_med_meshes_of_parts_are_joined(tmp_path: Path) -> None:
    parts = {}
    for name, rows in (("Bone", slice(0, 6)), ("Cement", slice(6, 12))):
        used, cells = np.unique(MED_CELLS[rows], return_inverse=True)
        parts[name] = (POINTS[used], cells.reshape(-1, 4), [["all"], ["all"]])
    path = med(tmp_path / "a.med", **parts)
    data = bonded(path, meshes=["Bone", "Cement"])
    whole(data, "Bone_all", "Cement_all")
    assert "4 nodes are merged" in messages_of(data)
    assert "several meshes have the mesh before their name: all" in messages_of(data)
