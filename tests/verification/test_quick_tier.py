"""A quick tier of ``mantle verify``: problems with known answers, each some seconds.

All of them, with their finest rungs: ``mantle verify`` and `tests/verification/test_mutations.py`.
"""

from __future__ import annotations

from pathlib import Path

import pytest

import mantle
from mantle.results.reading import Run
from mantle.schema import loaded_case
from mantle.verification.problem import CASES
from mantle.verification.problems import problems
from mantle.verification.verify import CheckResult

QUICK = (
    "klarbring",
    "cattaneo_stick_width",
    "hertz_ball_pressure",
    "hertz_line_pressure",
    "cook_0.499",
    "lame_plane_strain_3",
    "lame_p2_curved",
    "patch_fibre_111",
    "uniaxial_along_fibre",
    "incline",
    "foundation_bar_end",
    "oval_fit_p1",
    "oval_pressure_p2",
    "sine_p2",
    "layers_bonded",
    "heat_slab",
    "heat_bars",
    "heat_contact_resistance",
    "cure_adiabatic_23C",
    "cure_isothermal_23C",
    "cure_heat",
    "cure_order_backward_euler",
)
PROBLEMS = {p.name: p for p in problems(False)}


@pytest.mark.parametrize("name", QUICK)
def test_the_answer_is_the_known_one(name: str, tmp_path: Path) -> None:
    problem = PROBLEMS[name]
    samples = []
    for k, point in enumerate(problem.points):
        folder = tmp_path / str(k)
        mantle.run(loaded_case.load(CASES / problem.case, point.overrides), folder)
        samples.append(point.measure(Run(folder)))
    if problem.direct:
        samples.append(problem.direct())
    result = CheckResult(problem, tuple(samples), 0.0)
    assert result.passed, (result.as_json(), problem.tolerance)
