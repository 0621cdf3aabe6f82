"""Estimated times against times measured on one idle core."""

from __future__ import annotations

import re

import pytest

from app.case.case import load_case
from app.soundness import cost
from meshes import build
from tests import support
from tests.cases.separate_bodies import block_under_plate
from tests.support import CONFIGS

NO_ERRORS = "output.error=false"
# Processor time of the whole command, with all forms compiled and no mesh kept.
MEASURED = {
    ("stance",): 25.0,
    ("stance", NO_ERRORS): 21.4,
    ("stance", NO_ERRORS, "mesh.size=8 mm"): 14.5,
    ("stance", NO_ERRORS, "mesh.size=5 mm"): 37.1,
    ("stance", NO_ERRORS, "mesh.size=4 mm"): 64.4,
    ("stance_cocr",): 25.0,
    ("intact",): 19.8,
    ("blocks",): 2.9,
    ("cylinders",): 7.9,
    ("thermal_rings",): 7.9,
    ("cure",): 42.5,
    ("thermal_100C",): 69.7,
    ("residual",): 220.0,
    ("day",): 86.0,
    ("walk",): 496.0,
    ("start/blocks",): 2.4,
    ("start/cylinders",): 3.9,
    ("start/femur",): 6.0,
}


@pytest.mark.parametrize("case", MEASURED, ids=" ".join)
def test_cost_times_are_within_a_factor_of_two(case: tuple[str, ...]) -> None:
    name, *changes = case
    seconds = cost.estimated_seconds(load_case(CONFIGS / f"{name}.yaml", changes).config)
    assert 0.5 < seconds / MEASURED[case] < 2


def test_cost_cycles_after_shakedown_take_one_iteration() -> None:
    """The time of a cycle falls after the first 50: `walk` has 2238 iterations in 1999 solves."""
    cycles = (11, 51, 551, 1051)
    short, shaken, long, longest = (
        cost.estimated_seconds(load_case(CONFIGS / "walk.yaml", [f"stages[0].cycles={n}"]).config)
        for n in cycles
    )
    assert longest - long == pytest.approx(long - shaken)
    assert (long - shaken) / 500 < 0.7 * (shaken - short) / 40


def test_cost_time_is_printed_by_check() -> None:
    text = cost.estimated_size(load_case(CONFIGS / "variations.yaml").config)
    assert " s on one core, " in text and "for all variations" in text
    assert "5 s more to compile forms at the first run" in text
    heat = load_case(CONFIGS / "thermal_rings.yaml").config
    stance = load_case(CONFIGS / "stance.yaml").config
    assert cost.compiling(heat) < 3.0 < 10.0 < cost.compiling(stance)


def contact_line(name: str, *changes: str, available: float = 1e10) -> str:
    text = cost.estimated_size(load_case(CONFIGS / f"{name}.yaml", changes).config, available)
    return "".join(line for line in text.splitlines() if line.startswith("  contact: "))


def test_cost_check_names_the_solver_and_reason() -> None:
    """The choice depends on the number of solves, order, memory and options.

    With heat of contact there is no choice.
    """
    small = contact_line("stance", "mesh.size=10 mm")
    condensed = r"1 solve of [\d,]+ displacement unknowns by condensation onto the jumps, [\d.]+ GB"
    assert re.search(f"{condensed}$", small)
    krylov = "1 solve by a Krylov method, because "
    limit = "displacement unknowns exceed 60,000, the limit of condensation"
    large = re.search(f"{krylov}(.*) {limit}", contact_line("stance"))
    assert large and 140_000 < int(large[1].replace(",", "")) < 170_000
    first = contact_line("stance", "mesh.order=1")
    assert f"{krylov}at first order condensation is faster from 4 solves on" in first
    asked = contact_line("stance", "solver.linear=multigrid")
    assert f"{krylov}solver.linear is multigrid" in asked
    little = contact_line("stance", "solver.linear=condensed", available=1e9)
    assert f"{krylov}condensation needs " in little and little.endswith(" and may take 0.5 GB")
    few = contact_line("blocks", "mesh.order=2", "mesh.size=10 mm")
    assert f"{krylov}condensation is not faster for " in few
    assert "1999 solves of " in contact_line("walk")
    assert not contact_line("cure")


def test_cost_phases_add_up() -> None:
    case = load_case(CONFIGS / "stance.yaml").config
    phases = cost.phases(case)
    assert all(seconds > 1.0 for seconds in phases.values())
    assert sum(phases.values()) < cost.estimated_seconds(case)


def test_cost_rigid_head_has_no_unknowns() -> None:
    case = load_case(support.CONFIGS / "head_cup.yaml").config
    size = cost.exact_size(case, build(case.geometry, case.mesh))
    counted = re.search(r"([\d,]+) unknowns", size)
    assert (
        counted and 0.8 < cost.estimated_unknowns(case) / float(counted[1].replace(",", "")) < 1.25
    )


def test_cost_counts_nodes_of_the_second_side() -> None:
    case = support.case(block_under_plate())
    description = cost.exact_size(case, build(case.geometry, case.mesh))
    assert " interface nodes with a jump" in description and " 0 interface nodes" not in description
