"""The mesh of the rod of `tests.meshes.simple`."""

from __future__ import annotations

import pytest

from meshes.data import MeshData
from tests.meshes.simple import ROD, mesh


@pytest.fixture(scope="module")
def rod() -> MeshData:
    return mesh(ROD, 2.0)
