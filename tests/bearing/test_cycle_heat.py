"""Heat of a ball in its cup, the mean of a cycle: against lumped bodies, and symmetry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import meshes
from app.results.reading import Results, Run
from tests import support
from tests.cases.worn_ball import (
    CASE,
    LOAD,
    NECK,
    OUTSIDE,
    RADIUS,
    SHARE,
    SHELL,
    areas,
    heated,
)

ELASTIC = (
    "regions.head={youngs_modulus: 200 GPa, poisson_ratio: 0.3}",
    "motions.ball.boundary=head_bore",
    "loads.hip.boundary=head_bore",
)
PRESSED = "{kind: pressure, open: 0 W/(m^2 K), per_pressure: 10 W/(m^2 K MPa)}"
STEADY = "stages=[{name: press}, {name: turn, increments: 6}, {name: warm, steady: true}]"


def area(boundary: str) -> float:
    """Area [mm2] of the facets of a boundary."""
    case = support.case(CASE)
    data = meshes.build(case.geometry, case.mesh)
    x = data.points[data.facets[np.isin(data.facet_tags, data.boundaries[boundary])]]
    return float(np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1).sum() / 2)


def assert_lumped(result: Results, h: float, head: float, liner: float = 0.0) -> None:
    """Two bodies that conduct perfectly, between them h [mW/K], heated by so much [mW]."""
    G, S = NECK * area("head_bore"), SHELL * area("liner_outer")
    above = np.linalg.solve([[G + h, -h], [-h, S + h]], [head, liner])
    thermal = result.summary["thermal"]
    means = [thermal["regions"][name]["temperature_mean"] for name in ("head", "liner")]
    assert means == pytest.approx(OUTSIDE + above, rel=1e-5)
    assert thermal["flows"]["through"]["bearing"] == pytest.approx(h * -np.diff(above)[0], rel=1e-4)


@pytest.mark.parametrize("changes", [(), ELASTIC], ids=["rigid", "elastic"])
def test_cycle_heat_of_friction_warms_two_lumped_bodies(
    changes: tuple[str, ...], tmp_path: Path
) -> None:
    """The heat of a cycle in its time of 1 s; between the bodies h times the cup's area."""
    few = STEADY, "motions.ball.largest_step=20 deg", f"interfaces.bearing.friction_heating={SHARE}"
    result = support.run(CASE, tmp_path, *heated((1e6, 1e6), "50 W/(m^2 K)", *changes, *few))
    power = result.summary["interfaces"]["bearing"]["dissipation_cycle"]
    assert result.summary["thermal"]["flows"]["into"]["friction bearing"] == pytest.approx(power)
    assert_lumped(result, 0.05 * area("liner_inner"), SHARE * power, (1 - SHARE) * power)


def test_cycle_heat_conductance_without_a_time_course(tmp_path: Path) -> None:
    """Conductance per pressure times the sum of the pressures on the cup."""
    still = "motions.ball={region: head, about: [0 mm, 0 mm, 0 mm]}"
    stages = "stages=[{name: press}, {name: warm, steady: true}]"
    warm = "heat.source={kind: source, regions: [head], density: 1e5 W/m^3}"
    rub = "interfaces.bearing={kind: contact, friction_coefficient: 0, sliding: finite}"
    changes = heated((1e6, 1e6), PRESSED, rub, still, stages)
    result = support.run(CASE, tmp_path, *changes, warm)
    run = Run(result.folder)
    liner = areas(run, "liner")
    volume = float(run.volumes()[run.region == run.regions["head"]].sum())
    pressed = float(liner @ run.on_points("bearing_pressure"))
    assert pressed > LOAD
    assert_lumped(result, 1e-2 * pressed, 0.1 * volume)


def test_cycle_heat_of_a_spinning_ball_is_symmetric(tmp_path: Path) -> None:
    """It is pressed beside the axis of its turns: the cup is warm there, the ball in a ring."""
    cycle_table = '["time [s], rotation z [deg]", "0, 0", "1, 120", "2, 240", "3, 360"]'
    few = (
        f"motions.ball.rotation={{axes: zyx, cycle_table: {cycle_table}}}",
        "motions.ball.largest_step=10 deg",
        "loads.hip.force=[1400 N, 0 N, 1400 N]",
        "stages=[{name: press}, {name: turn, increments: 36}, {name: warm, steady: true}]",
        f"interfaces.bearing.friction_heating={SHARE}",
        "mesh.size=3 mm",
    )
    result = support.run(CASE, tmp_path, *heated((0.2, 0.2), PRESSED, *few))
    run = Run(result.folder)
    T, first = run.on_points("temperature"), []
    for region, radius in (("head", RADIUS), ("liner", RADIUS + 0.1)):
        nodes = run.nodes_of(run.regions[region])
        v = run.points[nodes]
        x, y, z = v.T
        polar, round_z = np.degrees(np.arctan2(np.hypot(x, y), z)), np.arctan2(y, x)
        ring = (np.abs(np.linalg.norm(v, axis=1) - radius) < 1e-3) & (np.abs(polar - 45) < 20)
        parts = [polar**k for k in range(5)] + [np.cos(round_z), np.sin(round_z)]
        fit = np.linalg.lstsq(np.stack(parts, 1)[ring], T[nodes[ring]])[0]
        first.append(float(np.hypot(*fit[-2:])))
    assert first[0] < 0.01 * first[1]
