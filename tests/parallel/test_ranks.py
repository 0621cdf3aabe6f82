"""The same mesh and steps on 1, 2 and 3 ranks give the same results."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests import support

# A tapered stem pressed in, then pushed down and sideways: parts of both interfaces are open,
# stick and slip. Steps are fixed.
CASE = """
title: Ranks
geometry:
  kind: cylinders
  stem_radius: 7 mm
  cement_thickness: 4 mm
  bone_thickness: 5 mm
  length: 24 mm
  taper: 1.5 deg
mesh: {order: 2, size: 5 mm, far_size: 6 mm}
regions:
  stem: {youngs_modulus: 110 GPa, poisson_ratio: 0.3}
  cement: {youngs_modulus: 2200 MPa, poisson_ratio: 0.35}
  bone: {youngs_modulus: 17 GPa, poisson_ratio: 0.3}
interfaces:
  stem_cement: {kind: contact, friction_coefficient: 0.3, gap: -0.002 mm, gap_history: [1, 1]}
  cement_bone: {kind: contact, friction_coefficient: 0.5}
supports:
  outer: {kind: displacement, boundary: bone_surface, x: 1e-5 * z, y: 0 mm, z: -1e-5 * x}
loads:
  push: {kind: force, boundary: stem_top, force: [0 N, 0 N, -900 N], history: [0, 1]}
  pull: {kind: body_force, regions: [cement], density: ["1e-3 * x", 0 N/mm^3, "-1e-4 * z"]}
  lateral: {kind: force, boundary: stem_top, force: [600 N, 200 N, 0 N], history: [0, 1]}
stages:
  - {name: fit, adaptive: false}
  - {name: push, increments: 2, adaptive: false}
solver: {tolerance: 1.0e-12}
output: {fields: false}
"""
STATES = ("open_fraction", "stick_fraction", "slip_fraction")
AREAS = ("area_slip_over_30um", "area_gap_over_30um")


@pytest.fixture(scope="module")
def summaries(tmp_path_factory: pytest.TempPathFactory) -> dict[int, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("ranks")
    case = folder / "case.yaml"
    case.write_text(CASE)
    found = {}
    for ranks in (1, 2, 3):
        output = folder / str(ranks)
        # The stiffness factored, or by multigrid.
        linear = "multigrid" if ranks == 3 else "direct"
        override = ("--set", f"solver.linear={linear}")
        support.on_ranks(ranks, "-m", "mantle", "run", case, "-o", output, *override)
        assert (output / "DONE").exists()
        found[ranks] = json.loads((output / "summary.json").read_text())
    return found


def numbers(values: dict[str, Any]) -> dict[str, list[float]]:
    """The numbers of a table; places of maxima apart, which jump between equal maxima."""
    return {
        name: value if isinstance(value, list) else [value]
        for name, value in values.items()
        if not name.endswith("_at")
    }


@pytest.mark.parallel
@pytest.mark.parametrize("ranks", [2, 3])
def test_results_do_not_depend_on_the_number_of_ranks(
    summaries: dict[int, dict[str, Any]], ranks: int
) -> None:
    one, other = summaries[1], summaries[ranks]
    assert other["solver"]["ranks"] == ranks
    assert other["solver"]["dofs"] == one["solver"]["dofs"]
    for name, expected in one["interfaces"].items():
        actual = other["interfaces"][name]
        # Two nodes' area, the rim's spacing being the mesh size.
        nodes = 2 * 3.0**2
        # What is compared to what: every quantity to the largest of its kind.
        scale = {
            "gap": expected["gap_max"],
            "slip": expected["slip_max"],
            "pressure": expected["pressure_max"],
            "shear": expected["pressure_max"],
            "penetration": expected["gap_max"],
            "dissipation": expected["dissipation"],
        }
        for key, values in numbers(expected).items():
            for a, b in zip(numbers(actual)[key], values, strict=True):
                if key in STATES:
                    assert abs(a - b) * expected["area"] <= nodes, (name, key)
                elif key in AREAS:
                    assert abs(a - b) <= nodes, (name, key)
                else:
                    size = scale.get(key.split("_")[0], max(map(abs, values)))
                    assert abs(a - b) <= 1e-6 * size, (name, key, a, b)
        # All kinds of points occur, or the comparison says little.
        assert expected["open_fraction"] > 0.02 and expected["slip_fraction"] > 0.02, name
    assert any(q["stick_fraction"] > 0.02 for q in one["interfaces"].values())
    for name, expected in one["regions"].items():
        largest = max(abs(v) for v in (expected["von_mises_max"], expected["principal_max"]))
        for key, values in numbers(expected).items():
            size = max(map(abs, values)) if key.startswith("volume") else largest
            for a, b in zip(numbers(other["regions"][name])[key], values, strict=True):
                assert abs(a - b) <= 1e-6 * size, (name, key, a, b)
    stem = numbers(one["stem"])
    motion = max(max(map(abs, values)) for values in stem.values())
    for key, values in stem.items():
        for a, b in zip(numbers(other["stem"])[key], values, strict=True):
            assert abs(a - b) <= 1e-6 * motion, (key, a, b)


@pytest.mark.parallel
def test_balances_close_on_any_number_of_ranks(summaries: dict[int, dict[str, Any]]) -> None:
    for summary in summaries.values():
        assert max(summary["balance"].values()) < 1e-8
        for q in summary["interfaces"].values():
            assert q["penetration_max"] < 1e-9


@pytest.mark.parallel
def test_an_error_on_one_rank_is_told_once_and_ends_all(tmp_path: Path) -> None:
    """An expression that is not finite at a few nodes, which one of the ranks has."""
    case = tmp_path / "case.yaml"
    case.write_text(CASE)
    for key, value in (
        ("supports.outer.x", "sqrt(z - 1e-3)"),
        ("loads.pull.density[1]", "log(z - 0.5)"),
    ):
        run = ("-m", "mantle", "run", case, "-o", tmp_path / "out", "--force")
        done = support.on_ranks(3, *run, "--set", f"{key}={value}", code=2)
        assert done.stderr.count(f"{key}: expression '{value}' is not finite at (") == 1


@pytest.mark.parallel
@pytest.mark.parametrize("order", [1, 2])
def test_multigrid_is_as_good_on_ranks(order: int, tmp_path: Path) -> None:
    """Each rank smooths its own part; with longer steps than on one rank that would diverge."""
    case, counts = tmp_path / "case.yaml", {}
    case.write_text(CASE)
    changes = (f"mesh.order={order}", f"mesh.size={2 * order} mm", "solver.linear=multigrid")
    overrides = [word for change in changes for word in ("--set", change)]
    for ranks in (1, 2):
        output = tmp_path / str(ranks)
        support.on_ranks(ranks, "-m", "mantle", "run", case, "-o", output, *overrides)
        solver = json.loads((output / "summary.json").read_text())["solver"]
        counts[ranks] = solver["linear_iterations"]
    assert counts[2] < 1.4 * counts[1]
