"""Plane sections of meshes for pictures."""

from __future__ import annotations

import numpy as np
import pytest

from app.plots.sections import cut_tetrahedra
from tests.meshes.simple import STACK, mesh


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_sections_of_a_block_have_exact_areas(axis: int) -> None:
    data = mesh(STACK, 2.0)
    size = np.array([10.0, 8.0, 12.0])
    at = float(size[axis]) * 0.3
    area = 0.0
    for corners, _ in cut_tetrahedra(data.points, data.cells, axis, at):
        fan = corners[:, 1:] - corners[:, :1]
        area += 0.5 * np.linalg.norm(np.cross(fan[:, :-1], fan[:, 1:]), axis=2).sum()
        assert np.allclose(corners[..., axis], at)
    assert area == pytest.approx(size.prod() / size[axis])
