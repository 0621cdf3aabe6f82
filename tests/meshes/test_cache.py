"""Cache of meshes: equal meshes, damage, a folder for one user."""

from __future__ import annotations

import os
from pathlib import Path

import gmsh
import numpy as np
import pytest

import meshes
from app.case.geometries import Block, Blocks
from meshes import cache
from meshes.data import MeshData
from tests.meshes.simple import ROD, STACK, options
from tests.robustness.faulty import DAMAGES, damage


def test_cache_returns_the_same_mesh_and_survives_damage(tmp_path: Path, rod: MeshData) -> None:
    first = meshes.build(ROD, options(2.0), tmp_path)
    (file,) = tmp_path.glob("*.npz")
    second = meshes.build(ROD, options(2.0, order=2), tmp_path)  # the order is not the mesh's
    assert list(tmp_path.glob("*.npz")) == [file]
    for data in (first, second):
        for name in ("points", "cells", "cell_tags", "facets", "facet_tags"):
            assert np.array_equal(getattr(data, name), getattr(rod, name)), name
        assert data.boundaries == rod.boundaries
        assert data.interfaces == rod.interfaces
        assert data.notes == rod.notes
    good = file.read_bytes()
    for how in DAMAGES:
        damage(file, how)
        assert cache.cached_mesh(file) is None
        third = meshes.build(ROD, options(2.0), tmp_path)
        assert np.array_equal(third.cells, rod.cells)
        assert file.stat().st_size == len(good) and not list(tmp_path.glob("*.part"))


def test_cache_that_cannot_be_written_is_skipped(caplog: pytest.LogCaptureFixture) -> None:
    one = Blocks(blocks=(Block(name="a", size=["4 mm"] * 3),))
    assert len(meshes.build(one, options(4.0), Path("/proc/nowhere")).cells)
    assert "the mesh cannot be kept in /proc/nowhere" in caplog.text


def test_cache_distinguishes_cases() -> None:
    keys = {
        cache.mesh_hash(geometry, o)
        for geometry in (ROD, ROD.model_copy(update={"length": 21.0}), STACK)
        for o in (options(2.0), options(2.0, far_size="3 mm"), options(2.0, curved=True))
    }
    assert len(keys) == 9


@pytest.mark.parametrize("mask", [0o022, 0o002, 0o077])
def test_cache_is_private_to_its_user(tmp_path: Path, mask: int) -> None:
    before = os.umask(mask)
    try:
        meshes.build(Blocks(blocks=(Block(name="a", size=["4 mm"] * 3),)), options(4.0), tmp_path)
    finally:
        os.umask(before)
    (path,) = tmp_path.glob("*.npz")
    assert path.stat().st_mode & 0o777 == 0o600


def test_cache_key_has_the_version_of_gmsh() -> None:
    assert cache._gmsh_version() == gmsh.__version__
