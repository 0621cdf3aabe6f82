"""Probes: displacements at named points in the files of a run."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import support

# Pressed without Poisson's effect: u_z = -p z / E, 1 MPa on 100 MPa, half of it in the first step.
BAR = """
geometry: {kind: blocks, blocks: [{name: bar, size: [4 mm, 4 mm, 6 mm]}]}
mesh: {size: 2 mm, far_size: 2 mm}
regions: {bar: {youngs_modulus: 100 MPa, poisson_ratio: 0}}
supports: {base: {kind: fixed, boundary: bottom}}
loads: {press: {kind: pressure, boundary: top, pressure: 1 MPa}}
stages: [{name: load, increments: 2}]
output: {probes: {tip: "[1.3, 2.1, 4.7] mm", low: {at: "[0.4, 0.2, 1.1] mm"}}}
"""


@pytest.mark.parametrize("order", [1, 2])
def test_probes_record_displacements(order: int, tmp_path: Path) -> None:
    results = support.run(BAR, tmp_path, f"mesh.order={order}")
    for name, z in (("tip", 4.7), ("low", 1.1)):
        end = results.summary["probes"][name]["displacement"]
        assert end == pytest.approx([0, 0, -0.01 * z], abs=1e-12)
        course = results.step_record[f"{name} displacement.z [mm]"]
        assert course == pytest.approx([-0.005 * z, -0.01 * z], abs=1e-12)
