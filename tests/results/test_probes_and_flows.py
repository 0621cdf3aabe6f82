"""Displacements at named points and heat per time in the files of a run, against formulas."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import support
from tests.cases.blocks import WALL

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


@pytest.mark.parametrize("moduli", [None, (1, 2), (2, 1)])
def test_heat_flows_through_a_wall(moduli: tuple[int, int] | None, tmp_path: Path) -> None:
    """60 K over L1/k1 + 1/h + L2/k2 + 1/a, on 16 mm2, whichever side is the stiffer."""
    changes = ["supports={base: {kind: fixed, boundary: bottom}}"] if moduli else []
    for region, E in zip(("hot", "cold"), moduli or (), strict=False):
        solid = f"youngs_modulus: {E} GPa, poisson_ratio: 0.3"
        heat = "initial_temperature: 37 degC, density: 1000 kg/m^3, specific_heat: 1000 J/(kg K)"
        k = {"hot": 2, "cold": 0.5}[region]
        changes.append(
            f"regions.{region}={{{solid}, thermal: {{conductivity: {k} W/(m K), {heat}}}}}"
        )
    flows = support.run(WALL, tmp_path, *changes).summary["thermal"]["flows"]
    # In mm, mW and K: conductivities in mW/(mm K), coefficients in mW/(mm2 K).
    milliwatts = 60.0 / (5 / 2.0 + 1 / 0.4 + 3 / 0.5 + 1 / 0.2) * 16.0
    assert flows["into"] == pytest.approx({"stove": milliwatts, "air": -milliwatts}, rel=1e-6)
    assert flows["through"] == pytest.approx({"hot_cold": milliwatts}, rel=1e-6)
