"""Stresses at nodes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.results.stresses import Stresses
from tests import support

# A rigid block on an elastic one without Poisson's ratio: its motion is prescribed.
BLOCKS = """
geometry: {kind: blocks, blocks: [{name: lower, size: [4 mm, 4 mm, 2 mm]},
                                  {name: upper, size: [4 mm, 4 mm, 2 mm]}]}
mesh: {order: 1, size: 2 mm, far_size: 2 mm}
regions: {lower: {youngs_modulus: 100 MPa, poisson_ratio: 0}, upper: {rigid: true}}
interfaces: {lower_upper: {kind: contact, friction_coefficient: 0}}
supports: {floor: {kind: fixed, boundary: bottom}}
"""
ELASTIC = BLOCKS.replace("rigid: true", "youngs_modulus: 100 MPa, poisson_ratio: 0")


def test_stresses_hoop_needs_an_axis() -> None:
    solved = support.solve(BLOCKS, "supports.lid={kind: fixed, boundary: top}")
    assert "hoop_p99" not in Stresses(solved.problem).numbers_of_region("lower")
    assert "hoop_p99" in Stresses(solved.problem, around_z=True).numbers_of_region("lower")


@pytest.mark.parametrize("order", [1, 2])
def test_stresses_uniform_at_every_node(order: int, tmp_path: Path) -> None:
    """A block without Poisson's ratio has 1 MPa, for any number of points of a cell."""
    text = ELASTIC + "loads: {press: {kind: pressure, boundary: top, pressure: 1 MPa}}\n"
    results = support.run(text, tmp_path, "interfaces={}", f"mesh.order={order}")
    stress = results.fields.on_points("stress")
    np.testing.assert_allclose(stress, np.tile([0, 0, -1, 0, 0, 0], (len(stress), 1)), atol=1e-9)
