"""Displacements at named points, against those of a uniform strain."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from app.cli import main

# Pressed without Poisson's effect: u_z = -p z / E, 1 MPa on 100 MPa, half of it in the first step.
BAR = """
geometry: {{kind: {kind}}}
mesh: {{order: {order}, size: 2 mm, far_size: 2 mm}}
regions: {{{regions}}}
supports: {{base: {{kind: fixed, boundary: bottom}}}}
loads: {{press: {{kind: pressure, boundary: top, pressure: 1 MPa}}}}
stages: [{{name: load, increments: 2}}]
output: {{probes: {{tip: "[1.3, 2.1, 4.7] mm", low: {{at: "[0.4, 0.2, 1.1] mm"}}}}}}
"""
BLOCK = "blocks, blocks: [{name: bar, size: [4 mm, 4 mm, 6 mm]}]"
ELASTIC = "{youngs_modulus: 100 MPa, poisson_ratio: 0, tissue: other}"


@pytest.mark.parametrize("order", [1, 2])
def test_probes_record_displacements(order: int, tmp_path: Path) -> None:
    path, folder = tmp_path / "case.yaml", tmp_path / "out"
    path.write_text(BAR.format(kind=BLOCK, order=order, regions=f"bar: {ELASTIC}"))
    assert main(["run", str(path), "-o", str(folder)]) == 0
    probes = json.loads((folder / "summary.json").read_text())["probes"]
    rows = list(csv.DictReader((folder / "history.csv").read_text().splitlines()))
    for name, z in (("tip", 4.7), ("low", 1.1)):
        assert probes[name]["displacement"] == pytest.approx([0, 0, -0.01 * z], abs=1e-12)
        course = [float(row[f"{name} displacement.z [mm]"]) for row in rows]
        assert course == pytest.approx([-0.005 * z, -0.01 * z], abs=1e-12)
