"""Meshes of any geometry: imports, equality in processes, order of nodes, refused contact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.foundation.errors import GeometryError
from meshes import cylinders
from meshes.data import MeshData, cell_volumes
from tests import support
from tests.meshes.simple import ROD, mesh
from tests.support import digest


def test_meshes_import_without_gmsh_and_dolfinx() -> None:
    heavy = {"gmsh", "dolfinx", "mpi4py"}
    support.python("-c", f"import sys; import meshes; assert not {heavy} & set(sys.modules)")


def test_meshes_are_equal_in_another_process(rod: MeshData) -> None:
    program = "from tests.meshes.test_meshes import *; print(digest(mesh(ROD, 2.0)))"
    assert support.python("-c", program).stdout.strip() == digest(rod)


def test_meshes_have_canonical_order_without_unused_nodes(rod: MeshData) -> None:
    assert np.array_equal(np.unique(rod.cells), np.arange(len(rod.points)))
    assert np.array_equal(np.lexsort(rod.points.round(9).T), np.arange(len(rod.points)))
    assert np.all(np.diff(rod.cell_tags) >= 0)
    assert np.all(cell_volumes(rod.points, rod.cells) > 0)


def test_meshes_stem_that_meets_bone_through_cement_is_refused(
    rod: MeshData, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Any geometry is refused if its stem meets bone through its cement, here near the top."""
    centres = rod.points[rod.cells[:, :4]].mean(axis=1)
    cement = rod.cell_tags == rod.regions["cement"]
    hole = cement & (centres[:, 2] > 15) & (centres[:, 0] > 0)
    tags = np.where(hole, rod.regions["bone"], rod.cell_tags).astype(np.int32)
    monkeypatch.setattr(cylinders, "build", lambda *_: replace(rod, cell_tags=tags))
    with pytest.raises(GeometryError, match=r"^stem meets bone where .* about \(\d") as caught:
        mesh(ROD, 2.0)
    assert "cement" not in str(caught.value)
