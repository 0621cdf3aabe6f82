"""Variations of a case on two ranks are those on one; a failure is one on both."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests import support

CASE = """
geometry:
  kind: cylinders
  stem_radius: 7 mm
  cement_thickness: 3 mm
  bone_thickness: 4 mm
  length: 18 mm
  taper: 3 deg
mesh: {order: 1, size: 4 mm, far_size: 4 mm}
regions:
  stem: {youngs_modulus: 110 GPa, poisson_ratio: 0.3}
  cement: {youngs_modulus: 2200 MPa, poisson_ratio: 0.3}
  bone: {youngs_modulus: 17 GPa, poisson_ratio: 0.3}
interfaces:
  stem_cement: {kind: contact, friction_coefficient: 0.4}
  cement_bone: {kind: contact, friction_coefficient: 1.0}
supports:
  foot: {kind: fixed, boundary: bone_bottom}
loads:
  down: {kind: force, boundary: stem_top, force: [0 N, 0 N, -900 N]}
  aside: {kind: force, boundary: stem_top, force: [200 N, 50 N, 0 N], history: [0, 1]}
stages:
  - {name: down}
  - {name: aside, adaptive: false}
solver: {tolerance: 1.0e-12, max_iterations: 12}
variations:
  tied: {interfaces.stem_cement: {kind: bonded}}
  lifted: {loads.aside.force: [0 N, 0 N, 2000 N]}
  slippery: {interfaces.stem_cement.friction_coefficient: 0.3, loads.*.history: [1, 1]}
  once: {loads.*.history: [1, 1]}
  slippery_twice: {interfaces.stem_cement.friction_coefficient: 0.3, loads.*.history: [2, 2]}
  twice: {loads.*.history: [2, 2]}
"""


@pytest.mark.parallel
def test_variations_on_two_ranks(tmp_path: Path) -> None:
    case = tmp_path / "case.yaml"
    case.write_text(CASE)
    tables: list[list[dict[str, Any]]] = []
    for ranks in (1, 2):
        output = tmp_path / str(ranks)
        # Nothing holds the stem that is lifted out.
        support.on_ranks(ranks, "-m", "mantle", "run", case, "-o", output, code=4)
        assert (output / "lifted" / "FAILED").exists() and not (output / "DONE").exists()
        assert len(list(output.glob("*/DONE"))) == 5
        tables.append(json.loads((output / "variations.json").read_text()))
    names = [row["name"] for row in tables[0]]
    assert names == [row["name"] for row in tables[1]] and len(names) == 6
    for one, two in zip(*tables, strict=True):
        assert one["status"] == two["status"]
        assert one["numbers"].keys() == two["numbers"].keys()
        # Whether a point that stays at its limit sticks or slips is a matter of rounding.
        for key in [k for k in one["numbers"] if not k.endswith("_fraction")]:
            kind = key.rpartition(".")[2].partition("_")[0]
            alike = [v for k, v in one["numbers"].items() if k.rpartition(".")[2].startswith(kind)]
            limit = 1e-8 * max(max(map(abs, alike)), 1e-6)
            assert two["numbers"][key] == pytest.approx(one["numbers"][key], abs=limit), key
    # What is finished stays, on two ranks too; what failed is tried again.
    output = tmp_path / "2"
    before = {p: p.stat().st_mtime_ns for p in output.glob("*/DONE")}
    again = support.on_ranks(
        2, "-m", "mantle", "run", case, "-o", output, "--restart", "auto", code=4
    )
    assert again.stdout.count("5 of 6 variations are finished already") == 1
    assert {p: p.stat().st_mtime_ns for p in output.glob("*/DONE")} == before
    table = json.loads((output / "variations.json").read_text())
    assert [(r["name"], r["numbers"]) for r in table] == [
        (r["name"], r["numbers"]) for r in tables[1]
    ]
    # Twice the load costs nothing on two ranks too.
    assert [row["newton_iterations"] for row in tables[1]][-1] == 0
