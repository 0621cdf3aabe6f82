"""Mean heat of a cycle for a ball in its cup, against lumped bodies and by symmetry."""

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
    """Compare temperatures and heat flow with two bodies of infinite conductivity.

    Args:
        result: The run.
        h: Conductance between the bodies [mW/K].
        head: Heat into the head [mW].
        liner: Heat into the liner [mW].
    """
    at_neck, at_shell = NECK * area("head_bore"), SHELL * area("liner_outer")
    above = np.linalg.solve([[at_neck + h, -h], [-h, at_shell + h]], [head, liner])
    thermal = result.summary["thermal"]
    means = [thermal["regions"][name]["temperature_mean"] for name in ("head", "liner")]
    assert means == pytest.approx(OUTSIDE + above, rel=1e-5)
    assert thermal["flows"]["through"]["bearing"] == pytest.approx(h * -np.diff(above)[0], rel=1e-4)


@pytest.mark.parametrize("changes", [(), ELASTIC], ids=["rigid", "elastic"])
def test_cycle_heat_of_friction_warms_two_lumped_bodies(
    changes: tuple[str, ...], tmp_path: Path
) -> None:
    """The heating power is the heat of a cycle over its duration of 1 s.

    The conductance between the bodies is that of the interface times the area of the cup.
    """
    coarse_steps = (
        STEADY,
        "motions.ball.largest_step=20 deg",
        f"interfaces.bearing.friction_heating={SHARE}",
    )
    heat = heated((1e6, 1e6), "50 W/(m^2 K)", *changes, *coarse_steps)
    result = support.run(CASE, tmp_path, *heat)
    power = result.summary["interfaces"]["bearing"]["dissipation_cycle"]
    assert result.summary["thermal"]["flows"]["into"]["friction bearing"] == pytest.approx(power)
    assert_lumped(result, 0.05 * area("liner_inner"), SHARE * power, (1 - SHARE) * power)


def test_cycle_heat_conductance_without_a_time_course(tmp_path: Path) -> None:
    """The conductance between the bodies is that per pressure times the total force on the cup."""
    no_rotation = "motions.ball={region: head, about: [0 mm, 0 mm, 0 mm]}"
    stages = "stages=[{name: press}, {name: warm, steady: true}]"
    heat_source = "heat.source={kind: source, regions: [head], density: 1e5 W/m^3}"
    frictionless = "interfaces.bearing={kind: contact, friction_coefficient: 0, sliding: finite}"
    changes = heated((1e6, 1e6), PRESSED, frictionless, no_rotation, stages)
    result = support.run(CASE, tmp_path, *changes, heat_source)
    run = Run(result.folder)
    liner = areas(run, "liner")
    volume = float(run.volumes()[run.region == run.regions["head"]].sum())
    total_pressure = float(liner @ run.on_points("bearing_pressure"))  # [N]
    assert total_pressure > LOAD
    assert_lumped(result, 1e-2 * total_pressure, 0.1 * volume)


def test_cycle_heat_of_a_spinning_ball_is_symmetric(tmp_path: Path) -> None:
    """The ball is pressed at 45 degrees to the axis of its rotation.

    The cup is warm at the pressed side. The ball is equally warm along a ring about the axis.
    """
    cycle_table = '["time [s], rotation z [deg]", "0, 0", "1, 120", "2, 240", "3, 360"]'
    changes = (
        f"motions.ball.rotation={{axes: zyx, cycle_table: {cycle_table}}}",
        "motions.ball.largest_step=10 deg",
        "loads.hip.force=[1400 N, 0 N, 1400 N]",
        "stages=[{name: press}, {name: turn, increments: 36}, {name: warm, steady: true}]",
        f"interfaces.bearing.friction_heating={SHARE}",
        "mesh.size=3 mm",
    )
    result = support.run(CASE, tmp_path, *heated((0.2, 0.2), PRESSED, *changes))
    run = Run(result.folder)
    temperature = run.on_points("temperature")
    first_harmonics = []  # amplitudes about the axis, of the ball and of the cup
    for region, radius in (("head", RADIUS), ("liner", RADIUS + 0.1)):
        nodes = run.nodes_of(run.regions[region])
        points = run.points[nodes]
        x, y, z = points.T
        polar, azimuth = np.degrees(np.arctan2(np.hypot(x, y), z)), np.arctan2(y, x)
        on_surface = np.abs(np.linalg.norm(points, axis=1) - radius) < 1e-3
        ring = on_surface & (np.abs(polar - 45) < 20)
        terms = [polar**k for k in range(5)] + [np.cos(azimuth), np.sin(azimuth)]
        fit = np.linalg.lstsq(np.stack(terms, 1)[ring], temperature[nodes[ring]])[0]
        first_harmonics.append(float(np.hypot(*fit[-2:])))
    of_ball, of_cup = first_harmonics
    assert of_ball < 0.01 * of_cup
