"""Torque, wear and heat of a rigid ball that rotates in its cup, against sums over the fields."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from app.foundation.verdict import recorded
from app.report import pictures, run_report
from app.results import closing_lines
from app.results.reading import Results, Run
from tests import support
from tests.cases.worn_ball import CASE, FRICTION, LOAD, RADIUS, WEAR, areas


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """Two cycles of rotation about y."""
    return support.run(CASE, tmp_path_factory.mktemp("ball"))


def test_friction_cycles_torque_is_the_sum_of_friction_moments(ball: Results) -> None:
    """The ball turns about y.

    Friction at n acts along y x n with the size μ p and the arm R |y x n|.
    """
    run = Run(ball.folder)
    liner = areas(run, "liner")
    p, n = (
        run.on_points("bearing_pressure"),
        run.points / np.linalg.norm(run.points, axis=1)[:, None],
    )
    force = FRICTION * p * liner
    expected = RADIUS * (force * np.hypot(n[:, 0], n[:, 2])).sum()
    result = ball.summary["interfaces"]["bearing"]
    assert "uncovered_fraction" not in result
    assert result["torque_along"] == pytest.approx(-expected, rel=1e-3)
    assert abs(result["torque"][1]) == pytest.approx(expected, rel=1e-3)
    assert result["torque_max"] >= result["torque_size"] * (1 - 1e-12)
    assert result["force"][2] == pytest.approx(LOAD, rel=1e-9)
    np.testing.assert_allclose(result["force"][:2], 0, atol=1e-6)


def test_friction_cycles_torque_work_equals_dissipation(ball: Results) -> None:
    """While the ball rotates in one sense, dissipated energy is the integral of M dθ."""
    record = ball.step_record
    θ = np.interp(record["time [-]"] * 2 % 1, [0, 0.3, 0.7, 1], np.radians([0, 20, -10, 0]))
    spent = np.diff(record["bearing dissipation [N mm]"])
    M = record["bearing torque_along [N mm]"]
    steady = slice(-4, None)
    assert spent[steady] == pytest.approx(-(M[1:] * np.abs(np.diff(θ)))[steady], rel=1e-4)


def test_friction_cycles_wear_follows_archard_on_both_sides(ball: Results) -> None:
    """Worn volume k E / μ and slid area are equal on liner and ball, by the facets of each."""
    run, result = Run(ball.folder), ball.summary["interfaces"]["bearing"]
    expected = WEAR * result["dissipation_cycle"] / FRICTION
    assert result["wear_volume"] == pytest.approx(expected, rel=1e-12)
    worn, slid = (run.on_points(f"bearing_{key}") for key in ("wear", "slid"))
    sides = [areas(run, name) for name in ("liner", "head")]
    assert [float(side @ worn) for side in sides] == pytest.approx([expected] * 2, rel=1e-9)
    assert sides[0] @ slid == pytest.approx(sides[1] @ slid, rel=1e-9)
    assert result["wear_depth_max_million"] == pytest.approx(1e6 * worn[sides[0] > 0].max())


@pytest.mark.parametrize("friction", [0.02, 0.0])
def test_friction_cycles_wear_by_the_friction_of_each_zone(
    friction: float, ball: Results, tmp_path: Path
) -> None:
    """A zone that covers the cup: its coefficient counts, not that of the interface.

    The worn volume by Archard's law depends on pressure and slid distance, hardly on friction.
    """
    zone = f"{{all: {{above: -50 mm, friction_coefficient: {friction}}}}}"
    result = support.run(CASE, tmp_path, f"interfaces.bearing.zones={zone}")
    numbers = result.summary["interfaces"]["bearing"]
    usual = ball.summary["interfaces"]["bearing"]["wear_volume"]
    assert numbers["wear_volume"] == pytest.approx(usual, rel=0.05)
    energy = numbers["wear_volume"] / WEAR * friction
    assert numbers["dissipation_cycle"] == pytest.approx(energy, rel=1e-9, abs=1e-9)
    run = Run(result.folder)
    worn = run.on_points("bearing_wear")
    volumes = [float(areas(run, name) @ worn) for name in ("liner", "head")]
    assert volumes == pytest.approx([numbers["wear_volume"]] * 2, rel=1e-9)


def test_friction_cycles_errors_cover_a_finer_mesh(tmp_path: Path) -> None:
    once = ("mesh.order=2", "stages=[{name: press}, {name: turn, increments: 6}]")
    meshes = {"fine": ("mesh.size=3 mm",), "coarse": ("output.error=true",)}
    runs = [support.run(CASE, tmp_path / name, *once, *change) for name, change in meshes.items()]
    assert not runs[1].summary["error"]["failed"]  # on 10 mm, too, the ball stays in its cup
    fine, coarse = (run.summary["interfaces"]["bearing"] for run in runs)
    for key in ("torque_max", "dissipation_cycle", "slid_max", "wear_volume"):
        assert 0 < abs(coarse[key] - fine[key]) < coarse[f"{key}_error"] < 0.3 * coarse[key]


def test_friction_cycles_reports_the_share_facing_a_bore(tmp_path: Path) -> None:
    """The bore of the ball has an opening of 13 mm, which turns from -z to -x."""
    cycle_table = '["time [s], rotation y [deg]", "0, 0", "1, 90"]'
    moved = (f"motions.ball.rotation.cycle_table={cycle_table}", "motions.ball.largest_step=45 deg")
    result = support.run(CASE, tmp_path, *moved, "stages=[{name: press}, {name: turn}]")
    run = Run(result.folder)
    liner, (x, y, z) = areas(run, "liner"), run.points.T
    share = liner @ ((x < 0) & (np.hypot(y, z) < 6.5 / RADIUS * np.hypot(x, np.hypot(y, z))))
    uncovered = result.summary["interfaces"]["bearing"]["uncovered_fraction"]
    assert uncovered == pytest.approx(share / liner.sum(), rel=0.02) and uncovered > 0.05
    sentence = f"bearing: {100 * uncovered:.1f} % of the slave surface left the master at some time"
    assert sentence in [*closing_lines.closing_tables(result.summary)]


def test_friction_cycles_difference_of_the_last_two_cycles(ball: Results) -> None:
    """The first cycle begins at the first contact, the second at the end of the first."""
    change = ball.summary["cycles"]["turn"]["change"]["bearing"]
    spent = ball.step_record["bearing dissipation [N mm]"]
    ends = spent[[0, (len(spent) - 1) // 2, -1]]
    first, last = np.diff(ends)
    assert ball.summary["interfaces"]["bearing"]["dissipation_cycle"] == pytest.approx(last)
    assert change["dissipation"] == pytest.approx(abs(last - first) / last, rel=1e-6)
    assert 0 < change["torque"] < 0.05 and 0 < change["centre"] < 1e-3
    expected_text = f"% of the torque, {100 * change['dissipation']:.2g} % of the dissipation"
    assert any(expected_text in str(verdict) for verdict in recorded(ball.summary))


def test_friction_cycles_fields_follow_the_rotated_ball(ball: Results) -> None:
    """The fields are in space.

    The page has a sentence and a map of the cup that keeps arcs from its pole.
    """
    run = Run(ball.folder)
    k = int(np.argmin(np.abs(run.times - 1.2)))
    θ = math.radians(np.interp(2 * run.times[k] % 1, [0, 0.3, 0.7, 1], [0, 20, -10, 0]))
    R = np.array([[math.cos(θ), 0, math.sin(θ)], [0, 1, 0], [-math.sin(θ), 0, math.cos(θ)]])
    row = int(np.argmin(np.abs(ball.step_record["time [-]"] - run.times[k])))
    centre = [ball.step_record[f"bearing centre.{axis} [mm]"][row] for axis in "xyz"]
    head = run.nodes_of(run.regions["head"])
    x = run.points[head]
    np.testing.assert_allclose(x + run.displacement(k)[head], x @ R.T + centre, atol=1e-9)
    files = [path.name for path in run_report.write(ball.folder)]
    assert "map_bearing.png" in files
    page = (ball.folder / "report.html").read_text()
    assert "largest friction torque of bearing" in page and "slips less" not in page
    assert "30 µm" not in page
    inner = x[np.linalg.norm(x, axis=1) > RADIUS - 1e-6]
    inner = inner[inner[:, 2] > 0][:99].reshape(-1, 3, 3)
    flat = pictures.flattened_cup(np.concatenate([inner, inner * [-1, -1, 1]]))
    assert flat is not None
    arcs = RADIUS * np.arccos(inner[..., 2] / RADIUS)
    assert np.linalg.norm(flat[: len(inner)], axis=2) == pytest.approx(arcs, abs=1e-6)


def test_friction_cycles_power_and_temperature_amplitude(tmp_path: Path) -> None:
    """Power is energy over the period of 1 s.

    The amplitude is 2 q sqrt(t/π) over both effusivities.
    """
    thermal = (
        "{{conductivity: {} W/(m K), density: 1000 kg/m^3, specific_heat: 1000 J/(kg K), "
        "initial_temperature: 37 degC}}"
    )
    result = support.run(
        CASE,
        tmp_path,
        f"regions.head.thermal={thermal.format(16)}",
        f"regions.liner.thermal={thermal.format(0.25)}",
        "interfaces.bearing.conductance=1000 W/(m^2 K)",
        "heat.pelvis={kind: temperature, boundary: liner_outer, temperature: 37 degC}",
        "heat.neck={kind: temperature, boundary: head_surface, temperature: 37 degC}",
        "stages=[{name: press}, {name: rest, steady: true}, {name: turn, increments: 6}]",
    ).summary["interfaces"]["bearing"]
    assert result["friction_power"] == pytest.approx(1e-3 * result["dissipation_cycle"])
    flux = result["wear_depth_max"] * FRICTION / WEAR  # N/mm: mW/mm2 through 1 s
    effusivity = 1e-3 * (math.sqrt(16e6) + math.sqrt(0.25e6))  # N/(mm K s^1/2)
    swing = 2 * flux * math.sqrt(0.5 / math.pi) / effusivity
    assert result["temperature_swing"] == pytest.approx(swing, rel=1e-9)
