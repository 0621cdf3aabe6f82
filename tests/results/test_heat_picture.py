"""Pictures of heat: what is drawn has the right size; that it is drawn at all."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem

from app.results import temperature_section
from tests.results.test_thermal_quantities import BODIES, ZERO, two_blocks


def test_a_section_is_whole_and_outlined() -> None:
    tagged = two_blocks(MPI.COMM_SELF)
    space = fem.functionspace(tagged.mesh, ("Lagrange", 1))
    z = space.tabulate_dof_coordinates()[:, 2]
    T = [ZERO + 40 + z, ZERO + 80 - z]
    corners, tags = temperature_section._corners(tagged, space.dofmap.list, BODIES.of_region, T)
    triangles, outline = temperature_section._cut(corners, tags, 1, 1.7)
    x, t = triangles[:, :, :3], triangles[:, :, 3]
    area = np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1) / 2
    assert area.sum() == pytest.approx(16)
    bone = x[:, :, 2].mean(axis=1) < 2
    assert t[bone] == pytest.approx(40 + x[bone][:, :, 2])
    assert t[~bone] == pytest.approx(80 - x[~bone][:, :, 2])
    # Around it and, from either side, between the regions.
    length = np.linalg.norm(outline[:, 1, :3] - outline[:, 0, :3], axis=1)
    assert length.sum() == pytest.approx(16 + 2 * 4)


def test_pictures_are_written(tmp_path: Path) -> None:
    tagged = two_blocks(MPI.COMM_SELF)
    space = fem.functionspace(tagged.mesh, ("Lagrange", 1))
    T = ZERO + 40 + 4 * space.tabulate_dof_coordinates()[:, 2]
    path = tmp_path / "section.png"
    operators: Any = SimpleNamespace(
        tagged=tagged, forms=SimpleNamespace(space=space), bodies=BODIES
    )
    for z in (0.0, 2.0, 4.0):
        record: Any = SimpleNamespace(hottest=[T, T], hottest_time=12.0, hottest_at=(1.0, 1.0, z))
        temperature_section.section(path, operators, record)
        assert path.read_bytes().startswith(b"\x89PNG")
        path.unlink()
