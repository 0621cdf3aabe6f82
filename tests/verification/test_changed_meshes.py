"""Changed meshes: rotated, scaled, mirrored, badly shaped."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from app.case.case import load_case
from app.verification import changed_meshes
from meshes import build
from meshes.data import cell_volumes
from meshes.quality import sicn
from tests.support import CONFIGS


def blocks(*overrides: str) -> Any:
    case = load_case(CONFIGS / "blocks.yaml", ["mesh.size=4 mm", *overrides]).config
    return build(case.geometry, case.mesh, None)


def test_changed_meshes_rotated_and_scaled_keep_their_volume() -> None:
    data = blocks()
    R = changed_meshes.ROTATION
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1)
    assert np.trace(R) == pytest.approx(1 + 2 * np.cos(np.radians(40)))
    whole = cell_volumes(data.points, data.cells).sum()
    turned = changed_meshes.CHANGES["turned"](data)
    assert cell_volumes(turned.points, turned.cells).sum() == pytest.approx(whole)
    small = changed_meshes.CHANGES["metres"](data)
    assert cell_volumes(small.points, small.cells).sum() == pytest.approx(1e-9 * whole)


def test_changed_meshes_flattened_cells_fill_the_blocks() -> None:
    data = blocks()
    bad = changed_meshes.flattened(data, 0.012)
    quality = sicn(bad.points, bad.cells)
    assert 0.012 <= quality.min() < 0.05 < sicn(data.points, data.cells).min()
    for tag in data.regions.values():
        on = data.cell_tags == tag
        volume = cell_volumes(bad.points, bad.cells[on]).sum()
        assert volume == pytest.approx(cell_volumes(data.points, data.cells[on]).sum())


def test_changed_meshes_mirrored_quarter_is_the_whole() -> None:
    sizes = ["mesh.size=6 mm", "mesh.far_size=8 mm", "mesh.order=1"]
    case = load_case(CONFIGS / "cylinders.yaml", sizes).config
    quarter = build(case.geometry, case.mesh, None)
    whole = changed_meshes.mirrored(quarter)
    volumes = cell_volumes(whole.points, whole.cells)
    assert volumes.min() > 0
    assert volumes.sum() == pytest.approx(4 * cell_volumes(quarter.points, quarter.cells).sum())
    assert len(np.unique(np.round(whole.points, 7), axis=0)) == len(whole.points)
    assert not any(name.startswith("symmetry") for name in whole.boundaries)
