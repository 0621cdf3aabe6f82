"""Files to which a mesh file refers."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from app.case.geometries import MeshFile
from app.case.mesh_names import content_hash
from tests.mesh_files.spellings import MATERIALS, cut, pvtu, vtu


def later(path: Path, raw: bytes) -> None:
    """Write a file with a later time of modification than all others."""
    path.write_bytes(raw)
    stamp = path.stat().st_mtime + 10
    os.utime(path, (stamp, stamp))


def test_named_files_are_part_of_the_content(tmp_path: Path) -> None:
    """A changed piece gives another mesh, also in a process that has read the former piece."""
    path = pvtu(tmp_path, 2)
    before, first = content_hash(path), MeshFile(path=path)
    assert first.region_names == MATERIALS
    points, cells, arrays = cut(2)[1]
    changed = {"material": np.where(arrays["material"] == 8, 4, 3)}
    later(tmp_path / "box_1.vtu", vtu([(points, cells, changed)]))
    assert content_hash(path) != before
    assert {*MeshFile(path=path).region_names} == {*MATERIALS, "material_4"}
    assert MeshFile(path=path).modified > path.stat().st_mtime + 5
