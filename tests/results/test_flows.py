"""Heat per time through boundaries and interfaces, against resistances in series."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from app.cli import main

WALL = """
geometry:
  kind: blocks
  blocks: [{name: hot, size: [4 mm, 4 mm, 5 mm]}, {name: cold, size: [4 mm, 4 mm, 3 mm]}]
mesh: {order: 1, size: 2 mm, far_size: 2 mm}
regions:
  hot:
    kind: conductor
    tissue: other
    thermal: &heat
      {conductivity: 2 W/(m K), density: 1000 kg/m^3, specific_heat: 1000 J/(kg K),
       initial_temperature: 37 degC}
  cold: {kind: conductor, tissue: other, thermal: {<<: *heat, conductivity: 0.5 W/(m K)}}
interfaces: {hot_cold: {kind: bonded, conductance: 400 W/(m^2 K)}}
heat:
  stove: {kind: temperature, boundary: bottom, temperature: 80 degC}
  air: {kind: convection, boundary: top, coefficient: 200 W/(m^2 K), ambient: 20 degC}
stages: [{name: rest, steady: true}]
"""


def test_heat_flows_through_a_wall(tmp_path: Path) -> None:
    """60 K over L1/k1 + 1/h + L2/k2 + 1/a, on 16 mm2."""
    path, folder = tmp_path / "case.yaml", tmp_path / "out"
    path.write_text(WALL)
    assert main(["run", str(path), "-o", str(folder)]) == 0
    flows = json.loads((folder / "summary.json").read_text())["thermal"]["flows"]
    # In mm, mW and K: conductivities in mW/(mm K), coefficients in mW/(mm2 K).
    milliwatts = 60.0 / (5 / 2.0 + 1 / 0.4 + 3 / 0.5 + 1 / 0.2) * 16.0
    assert flows["into"] == pytest.approx({"stove": milliwatts, "air": -milliwatts}, rel=1e-6)
    assert flows["through"] == pytest.approx({"hot_cold": milliwatts}, rel=1e-6)
