"""Cycle tables of motions and loads: from files and lines, written, evaluated."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from app.case.case import dump, load_case
from app.foundation.errors import InputError
from app.laws.cycle_tables import ROTATIONS, CycleTable
from app.laws.loads import Force
from app.laws.motions import Motion
from app.scene.scene import build_scene
from app.soundness import preview
from tests import support

GAIT = """\
time [ms], force [kN], rotation z [deg], rotation x [deg]

100, 0.3, 2, 25
600, 3, -10, -18
1100, 0.3, 2, 25
"""
CASE = """\
geometry:
  kind: blocks
  blocks:
    - {name: lower, size: "[10, 20, 5] mm"}
    - {name: upper, size: "[10, 20, 5] mm"}
mesh: {order: 1, size: 2 mm}
regions:
  lower: {youngs_modulus: 2.2 GPa, poisson_ratio: 0.3}
  upper: {rigid: true}
interfaces:
  lower_upper:
    kind: contact
    friction_coefficient: 0.06
    sliding: finite
    between: [bottom, top]
    wear_coefficient: 1.07e-6 mm^3/(N m)
supports:
  base: {kind: fixed, boundary: bottom}
motions:
  ball:
    region: upper
    about: [5 mm, 10 mm, 30 mm]
    rotation: {axes: yxz, cycle_table: gait.csv}
loads:
  hip:
    kind: force
    boundary: top
    force: "[0, 0, -1] N"
    cycle_table: gait.csv
    follows: ball
  side:
    kind: force
    boundary: top
    cycle_table: ["time [s], force x [N], force z [N]", "0, 10, 0", "2, 30, -8"]
"""


def motion(axes: str, **degrees: tuple[float, float]) -> Motion:
    heads = ["time [s]", *(f"rotation {axis} [deg]" for axis in degrees)]
    rows = [[k, *(v[k] for v in degrees.values())] for k in range(2)]
    rotation = {"axes": axes, "cycle_table": [heads, *rows]}
    about = ["0 mm", "0 mm", "0 mm"]
    return Motion.model_validate({"region": "head", "about": about, "rotation": rotation})


def about(axis: int, degrees: float) -> np.ndarray:
    """Rotation by Rodrigues' formula."""
    k = np.cross(np.eye(3)[axis], -np.eye(3))
    a = np.radians(degrees)
    return np.eye(3) + np.sin(a) * k + (1 - np.cos(a)) * k @ k


def test_cycle_tables_of_motion_and_load_are_written(tmp_path: Path) -> None:
    (tmp_path / "gait.csv").write_text(GAIT)
    (tmp_path / "case.yaml").write_text(CASE)
    case = load_case(tmp_path / "case.yaml").config
    assert support.case(dump(case)) == case
    ball, law = case.motions["ball"], case.interfaces["lower_upper"]
    assert np.degrees(ball.rotation.cycle_table.values_at(ROTATIONS, 0.75)) == pytest.approx(
        [3.5, 0, -4]
    )
    assert law.wear_coefficient == pytest.approx(1.07e-9, rel=1e-15)
    assert law.constants == {"μ": 0.06} and law.form == ("contact", True)
    forces = [load for load in case.loads.values() if isinstance(load, Force)]
    assert forces[0].force_at(0.25) == pytest.approx((0, 0, -1650))
    assert forces[1].force_at(0.5) == pytest.approx((20, 0, -4))
    assert forces[1].resultant == (30, 0, -8)


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ("600, x", "line 4: 'x kN' is not a force such as '1800 N'"),
        ("50, 3", "line 4: its time is not above 0.1 s, that of the row before"),
        ("600", "line 4: has 3 values; expected 4: time, force, rotation z, rotation x"),
    ],
)
def test_cycle_tables_faults_name_the_line(wrong: str, text: str, tmp_path: Path) -> None:
    (tmp_path / "gait.csv").write_text(GAIT.replace("600, 3", wrong, 1))
    (tmp_path / "case.yaml").write_text(CASE.partition("loads:")[0])
    with pytest.raises(InputError, match=re.escape(f"gait.csv: {text}")) as caught:
        load_case(tmp_path / "case.yaml")
    assert caught.value.messages[0].startswith(f"{tmp_path / 'case.yaml'}:23:27: motions.ball")


def test_cycle_tables_by_name_or_file(tmp_path: Path) -> None:
    (tmp_path / "lib").mkdir()
    (tmp_path / "lib" / "gait.csv").write_text(GAIT)
    (tmp_path / "lib" / "below.yaml").write_text(CASE)
    (tmp_path / "case.yaml").write_text("base: lib/below.yaml\n")
    config = load_case(
        tmp_path / "case.yaml", ["motions.ball.rotation.cycle_table=iso_14242_1"]
    ).config
    cycle_table, of_load = (
        config.motions["ball"].rotation.cycle_table,
        config.loads["hip"].cycle_table,
    )
    assert of_load.rows[-1] == "1100, 0.3, 2, 25" and cycle_table.status == "unverified"
    x, y, z = (np.degrees(cycle_table.columns[name]) for name in ROTATIONS)
    for angles, least, most in ((x, -18, 25), (y, -4, 7), (z, -2, 10)):
        assert (angles.min(), angles.max()) == pytest.approx((least, most))
        assert angles[0] == pytest.approx(angles[-1])
    force = dict(zip(cycle_table.columns["time"], cycle_table.columns["force"], strict=True))
    assert force[0.12] == 3000
    assert force[0.5] == 3000
    assert force[0.62] == 300
    assert force[1.0] == 300
    assert "unverified: all motions" in preview.case_in_words(
        config, {"regions": {"lower": {}, "upper": {}}}
    )


def test_cycle_tables_first_axis_is_the_outermost() -> None:
    turn = motion("yxz", x=(0, 40), y=(0, -30), z=(0, 70))
    assert turn.rotation_at(0.0) == pytest.approx(np.eye(3))
    expected = about(1, -15) @ about(0, 20) @ about(2, 35)
    assert turn.rotation_at(0.5) == pytest.approx(expected, abs=1e-15)
    other = motion("zxy", x=(0, 40), y=(0, -30), z=(0, 70)).rotation_at(0.5)
    assert other == pytest.approx(about(2, 35) @ about(0, 20) @ about(1, -15), abs=1e-15)


def test_cycle_tables_missing_columns_are_zero() -> None:
    cycle_table = CycleTable.model_validate(["time [s], rotation y [deg]", "0, 0", "1, 90"])
    assert cycle_table.values_at(ROTATIONS, 1.0) == pytest.approx([0, np.pi / 2, 0])


def test_cycle_tables_factor_of_a_force() -> None:
    """The force of the case has a course in per cent, linear between rows."""
    rows = ["time [s], factor [%]", "0, 100", "1, 20", "3, 100"]
    key = {"kind": "force", "boundary": "top", "cycle_table": rows}
    force = Force.model_validate(key | {"force": "[0, 300, -400] N"})
    assert force.resultant == (0.0, 300.0, -400.0)
    assert force.force_at(1 / 6) == pytest.approx((0.0, 180.0, -240.0))
    assert force.force_at(2 / 3) == pytest.approx((0.0, 180.0, -240.0))
    for wrong, text in (
        (key, "is zero; expected the force that the factors of the cycle table multiply"),
        (key | {"cycle_table": ["time [s], factor [N]", "0, 1", "1, 2"]}, "a share has no unit"),
        (
            key | {"cycle_table": ["time [s], factor [%], force [N]", "0, 1, 2", "1, 2, 3"]},
            "has time, factor, force; expected force, factor, or some of force x, force y, force z",
        ),
    ):
        with pytest.raises(ValidationError, match=text):
            Force.model_validate(wrong)


def test_cycle_tables_force_sizes_over_time() -> None:
    """The load grows in a stage and then has two cycles.

    Another load with a history has its valleys too.
    """
    text = CASE.partition("motions:")[0].replace("{rigid: true}", "{youngs_modulus: 2 GPa}")
    text = text.replace("youngs_modulus: 2 GPa}", "youngs_modulus: 2 GPa, poisson_ratio: 0.3}")
    loads = """\
loads:
  hip:
    kind: force
    boundary: top
    force: "[0, 30, -40] N"
    cycle_table: ["time [s], factor [%]", "0, 100", "1, 20", "2, 100"]
  push: {kind: force, boundary: top, force: "[0, 0, -5] N", history: [1, 0.5]}
stages: [{name: rise}, {name: gait, cycles: 2}]
"""
    text = text.replace("    sliding: finite\n    between: [bottom, top]\n", "")
    text = text.replace("    wear_coefficient: 1.07e-6 mm^3/(N m)\n", "")
    scene = build_scene(support.case(text + loads))
    sizes = scene.force_sizes(np.array([0.0, 0.5, 1.0, 1.25, 1.5, 2.0]))
    assert sizes["hip"] == pytest.approx([0, 25, 50, 10, 50, 50])
    assert sizes["push"] == pytest.approx([0, 2.5, 5, 4.375, 3.75, 2.5])
