"""Cycles of load: permanent and inducible motions of a sliding block on a spring, by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.case.summary import StageCycles
from app.results.cycles import sentences, trend
from tests import support

AREA = 16.0  # mm2
SPRING = 2.0  # MPa/mm
PRESS = 0.05  # MPa: 1000 GPa times 2e-7 mm over the 4 mm of both
FRICTION = 0.4
CASE = f"""
geometry: {{kind: blocks, blocks: [{{name: lower, size: [4 mm, 4 mm, 2 mm]}},
                                  {{name: upper, size: [4 mm, 4 mm, 2 mm]}}]}}
mesh: {{order: 1, size: 2 mm, far_size: 2 mm}}
regions:
  lower: {{youngs_modulus: 1000 GPa, poisson_ratio: 0}}
  upper: {{youngs_modulus: 1000 GPa, poisson_ratio: 0}}
interfaces: {{lower_upper: {{kind: contact, friction_coefficient: {FRICTION}}}}}
supports:
  floor: {{kind: fixed, boundary: bottom}}
  press: {{kind: displacement, boundary: top, z: -2e-4 um, history: [1, 1]}}
  side: {{kind: roller, boundary: top, axis: y}}
  spring: {{kind: foundation, boundary: top, stiffness: [{SPRING} MPa/mm, 0 MPa/mm, 0 MPa/mm]}}
output: {{fields: false, report: false}}
"""


@pytest.mark.parametrize(("pull", "way"), [(0.1, "stays"), (0.035, "vanishes")])
def test_cycles_of_a_block_on_a_spring(pull: float, way: str, tmp_path: Path) -> None:
    """The block slides back in every valley if the removed load exceeds friction twice."""
    valley, τ = 0.1, FRICTION * PRESS
    results = support.run(
        CASE,
        tmp_path,
        f"loads.pull={{kind: force, boundary: top, force: [{pull * AREA} N, 0 N, 0 N]}}",
        "loads.pull.history=[0, 1]",
        f"stages=[{{name: press}}, {{name: pull, cycles: 3, valley: {valley}, increments: 2}}]",
    )
    # Sliding, friction bears τ and the spring the rest; the blocks hardly deform.
    peak, back = (pull - τ) / SPRING, max(((1 - valley) * pull - 2 * τ) / SPRING, 0.0)
    cycles = results.summary["cycles"]["pull"]
    motion = {key: cycles[key]["lower_upper"]["motion_p99"] for key in ("permanent", "inducible")}
    assert motion["permanent"] == pytest.approx(peak - back, rel=1e-4)
    assert motion["inducible"] == pytest.approx(back, rel=1e-4, abs=1e-9)
    assert cycles["trend"] == way
    np.testing.assert_allclose(cycles["dissipation"], 2 * τ * AREA * back, rtol=1e-4, atol=1e-9)
    assert results.summary["interfaces"]["lower_upper"]["motion_p99"] == pytest.approx(
        peak, rel=1e-4
    )
    # Five ways of two increments, and the stage before.
    assert len(results.step_record["step"]) == 1 + 2 * 5
    (line,) = sentences(results.summary["cycles"])
    assert line.startswith("pull: permanent / inducible: motion p99 of lower_upper") and way in line


def test_cycles_trends() -> None:
    assert trend(20.0, [18.0, 18.0, 17.0]) == "stays"
    assert trend(20.0, [10.0, 5.0, 0.3]) == "vanishes"
    assert trend(20.0, [10.0, 5.0]) == "falls"
    assert trend(20.0, [10.0, 15.0]) == "grows"
    assert trend(26.0, [24.3, 22.5, 21.8, 20.9, 20.9]) == "falls"  # and settles


@pytest.mark.parametrize(
    ("per_cycle", "text"),
    [
        (
            [24.3, *[21.0] * 27, 20.9],
            "per cycle falls: 24.3 N mm in the second, 20.9 N mm in the last of 30",
        ),
        (
            [18.0, 17.0],
            "per cycle stays: 18 N mm in the second, 17 N mm in the last of 3 cycles (94 %)",
        ),
        ([18.0], "in the second of 2 cycles: 18 N mm"),
        ([0.0, 0.0], "per cycle vanishes: 0 N mm in the second, 0 N mm in the last of 3 cycles"),
    ],
)
def test_cycles_dissipation_is_first_last_and_ratio(per_cycle: list[float], text: str) -> None:
    """The summary has no number for each of a thousand cycles, and no trend of one cycle."""
    numbers = StageCycles(dissipation=per_cycle, trend=trend(25.0, per_cycle))
    (line,) = sentences({"walking": numbers})
    assert line.startswith(f"walking: dissipation {text}")
    assert line.count("N mm") <= 2
