"""Records of each step of a run: rows, fields, calls and the summary."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import mantle
from app.case.case import load_case
from app.foundation.errors import StoppedError
from app.numerics import remedies
from app.numerics.newton import NewtonResult, Solver
from app.results.reading import Results
from app.simulation.recorder import AcceptedStep
from tests import support
from tests.cases import coupled
from tests.cases.blocks import HALVES

# A bar of two halves, 2 GPa and 1 GPa, each 2 mm long, is pulled by 3 MPa, then by half of this.
PULLED = f"""\
title: pulled bar
{HALVES}interfaces: {{lower_upper: {{kind: bonded}}}}
supports: {{base: {{kind: fixed, boundary: bottom}}}}
loads: {{pull: {{kind: pressure, boundary: top, pressure: -3 MPa, history: [1, 0.5]}}}}
stages: [{{name: on, increments: 3}}, {{name: off, increments: 2}}]
output: {{probes: {{tip: [2 mm, 2 mm, 4 mm]}}, report: false}}
"""
# The stretch under 3 MPa [mm], and the times of the five steps with their parts of the load.
STRETCH = 3 * (2 / 2000 + 2 / 1000)
TIMES = [1 / 3, 2 / 3, 1, 1.5, 2]
PARTS = [1 / 3, 2 / 3, 1, 0.75, 0.5]
# The same with contact, which a press closes; then a push makes all of it slip.
RUBBED = """\
geometry: {kind: blocks, blocks: [{name: lower, size: [4 mm, 4 mm, 2 mm]},
                                  {name: upper, size: [4 mm, 4 mm, 2 mm]}]}
mesh: {order: 1, size: 2 mm}
regions:
  lower: {youngs_modulus: 1 GPa, poisson_ratio: 0, tissue: other}
  upper: {rigid: true, tissue: other}
interfaces: {lower_upper: {kind: contact, friction_coefficient: 0.25}}
supports:
  base: {kind: fixed, boundary: bottom}
  press: {kind: displacement, boundary: top, z: -0.01 mm}
  push: {kind: displacement, boundary: top, x: 0.1 mm, y: 0 mm, history: [0, 1]}
stages: [{name: press}, {name: push, increments: 2}]
output: {fields: false, report: false}
"""
# An insulated block of 1000 kg/m3 and 1000 J/(kg K) is heated by 1 MW/m3: 1 K in each second.
HEATED = """\
geometry: {kind: blocks, blocks: [{name: block, size: [2 mm, 2 mm, 2 mm]}]}
mesh: {order: 1, size: 2 mm}
regions:
  block: {kind: conductor, thermal: {conductivity: 0.5 W/(m K), density: 1000 kg/m^3,
    specific_heat: 1000 J/(kg K), initial_temperature: 20 degC}}
heat: {inside: {kind: source, regions: [block], density: 1e6 W/m^3}}
stages: [{name: warm, duration: 4 s, increments: 4, adaptive: false}]
time: {method: backward_euler}
"""
# Two blocks between walls are warmed by 10 K in each second. Their stress along z is -E α ΔT, which
# is 0.1 MPa/K.
SQUEEZED = """\
geometry: {kind: blocks, blocks: [{name: lower, size: [2 mm, 2 mm, 2 mm]},
                                  {name: upper, size: [2 mm, 2 mm, 2 mm]}]}
mesh: {order: 1, size: 2 mm}
regions:
  lower: &block {youngs_modulus: 1 GPa, poisson_ratio: 0, tissue: other, thermal: {
    conductivity: 0.5 W/(m K), density: 1000 kg/m^3, specific_heat: 1000 J/(kg K),
    initial_temperature: 20 degC, thermal_expansion: 1e-4 1/K}}
  upper: *block
interfaces: {lower_upper: {kind: contact, friction_coefficient: 0, conductance: 1e4 W/(m^2 K)}}
supports:
  bottom: {kind: roller, boundary: bottom, axis: z}
  top: {kind: roller, boundary: top, axis: z}
  lower_x: {kind: roller, boundary: lower_x_min, axis: x}
  lower_y: {kind: roller, boundary: lower_y_min, axis: y}
  upper_x: {kind: roller, boundary: upper_x_min, axis: x}
  upper_y: {kind: roller, boundary: upper_y_min, axis: y}
heat:
  bath: {kind: temperature, regions: [lower, upper], time_course: [[0 s, 20 degC], [4 s, 60 degC]]}
stages: [{name: warm, duration: 4 s, increments: 4, adaptive: false}]
time: {mechanical_step: 5 K}
"""
# Fields are written only when the run has stopped.
LATE_FIELDS = ("output.every=99", "output.report=false")


def rows_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "history.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def pulled(tmp_path_factory: pytest.TempPathFactory) -> tuple[mantle.Results, list[AcceptedStep]]:
    """The bar with fields at every second increment: results and reported steps."""
    folder, steps = tmp_path_factory.mktemp("pulled"), []
    path = folder / "case.yaml"
    path.write_text(PULLED)
    case = load_case(path, ["output.every=2"])
    return mantle.run(case, folder / "out", progress=steps.append), steps


def test_recorder_writes_a_row_for_each_step(
    pulled: tuple[mantle.Results, list[AcceptedStep]],
) -> None:
    """The stretch of each row follows Hooke's law."""
    record = pulled[0].step_record
    np.testing.assert_array_equal(record["step"], range(1, 6))
    np.testing.assert_allclose(record["time [-]"], TIMES, rtol=1e-14)
    stretch = STRETCH * np.array(PARTS)
    np.testing.assert_allclose(record["tip displacement.z [mm]"], stretch, rtol=1e-9)
    assert (record["force balance [-]"] < 1e-9).all()
    assert (np.diff(record["wall [s]"]) >= 0).all()


def test_recorder_reports_each_row(pulled: tuple[mantle.Results, list[AcceptedStep]]) -> None:
    results, steps = pulled
    assert [(s.number, s.stage) for s in steps] == [
        (1, "on"),
        (2, "on"),
        (3, "on"),
        (4, "off"),
        (5, "off"),
    ]
    assert {(s.folder, s.end) for s in steps} == {(results.folder, 2.0)}
    rows = rows_of(results.folder)
    assert [list(s.row) for s in steps] == [list(row) for row in rows]
    title = "tip displacement.z [mm]"
    assert [s.row[title] for s in steps] == pytest.approx([float(row[title]) for row in rows])


def test_recorder_writes_fields_at_every_second_increment_and_at_the_end(
    pulled: tuple[mantle.Results, list[AcceptedStep]],
) -> None:
    fields = pulled[0].fields
    np.testing.assert_allclose(fields.times, [2 / 3, 1.5, 2], rtol=1e-14)
    top = fields.points[:, 2] > 4 - 1e-9
    for step, part in enumerate((2 / 3, 0.75, 0.5)):
        stretch = fields.displacement(step)[top, 2]
        np.testing.assert_allclose(stretch, part * STRETCH, rtol=1e-6)


def test_recorder_summary_is_that_of_the_last_step(
    pulled: tuple[mantle.Results, list[AcceptedStep]],
) -> None:
    results, steps = pulled
    summary = results.summary
    assert (summary["status"], summary["title"]) == ("converged", "pulled bar")
    assert summary["time"] == 2.0
    tip = summary["probes"]["tip"]["displacement"]
    assert tip[2] == pytest.approx(0.5 * STRETCH, rel=1e-9)
    solver = summary["solver"]
    # Three components at each node; no jumps.
    unknowns = 3 * len(results.fields.points)
    assert solver["dofs"] == unknowns and solver["blocks"] == {"displacement": unknowns}
    assert (solver["steps"], solver["rejected_steps"], solver["augmentation"]) == (5, 0, {})
    newton = [step.row["newton [-]"] for step in steps]
    assert solver["newton_iterations"] == sum(n for n in newton if n is not None)
    assert summary["balance"].keys() == {"force", "moment", "energy"}
    memory = summary["memory"]
    assert memory["per_unknown"] == pytest.approx(1e3 * memory["peak"] / unknowns, rel=1e-3)


def test_recorder_keeps_the_last_step_of_a_stopped_run(tmp_path: Path) -> None:
    """The stop comes with the fourth row. Its state is on disk, and no attempt is counted."""
    path = tmp_path / "case.yaml"
    path.write_text(PULLED)

    def stop(step: AcceptedStep) -> None:
        if step.number == 4:
            raise StoppedError("enough")

    with pytest.raises(StoppedError) as stopped:
        mantle.run(load_case(path), tmp_path / "out", progress=stop)
    place = f"last converged state: time 1.5 (step 4) in {tmp_path / 'out'}"
    assert place in str(stopped.value) and "enough" in str(stopped.value)
    assert len(rows_of(tmp_path / "out")) == 4
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert (summary["status"], summary["time"]) == ("stopped", 1.5)
    assert summary["solver"]["steps"] == 4
    assert summary["solver"]["rejected_steps"] is None
    tip = summary["probes"]["tip"]["displacement"][2]
    assert tip == pytest.approx(0.75 * STRETCH, rel=1e-9)
    assert "enough" in json.dumps(summary["verdicts"])
    assert not (tmp_path / "out" / "DONE").exists()


def test_recorder_says_that_no_step_has_converged(tmp_path: Path) -> None:
    """One Newton iteration is too few for a push that makes some points slip."""
    path = tmp_path / "case.yaml"
    path.write_text(RUBBED)
    changes = ["solver.max_iterations=1", "stages.0.adaptive=false", "supports.push.history=[1, 1]"]
    with pytest.raises(mantle.ConvergenceError) as failed:
        mantle.run(load_case(path, changes), tmp_path / "out")
    words = f"no step has converged: {tmp_path / 'out'} has the case, but no numbers"
    assert words in str(failed.value)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["status"] == "not converged" and summary["time"] == 0.0
    assert summary["interfaces"] == {} and summary["solver"]["steps"] == 0


def test_recorder_columns_of_interfaces_and_their_critical_friction(tmp_path: Path) -> None:
    """The layer of 2 mm is pressed by 0.01 mm: p = E 0.01/2 = 5 MPa. The push makes all of it slip.

    Half of the push is 0.05 mm.
    """
    results = support.run(RUBBED, tmp_path)
    record = results.step_record
    assert record["lower_upper pressure_p95 [MPa]"][0] == pytest.approx(5.0, rel=1e-9)
    slip = record["lower_upper slip_max [mm]"]
    assert slip[0] == pytest.approx(0, abs=1e-9)
    assert slip[2] - slip[1] == pytest.approx(0.05, rel=2e-3)
    interface = results.summary["interfaces"]["lower_upper"]
    assert interface["slip_max"] == pytest.approx(slip[-1])
    assert interface["shear_mean"] == pytest.approx(0.25 * interface["pressure_mean"], rel=1e-6)
    assert interface["slip_fraction"] == pytest.approx(1.0)
    assert interface["critical_friction"] > 0
    assert set(results.summary["solver"]["augmentation"]) == {"lower_upper"}


def stopped(
    monkeypatch: pytest.MonkeyPatch, folder: Path, text: str, solve: str, count: int, *options: str
) -> Results:
    """Results of a run that is stopped at the end of a solve, before its step is committed.

    ``solve`` is the module of `app.stepping` that calls the solver, ``count`` the number of calls.
    """
    path = folder / "case.yaml"
    path.write_text(text)
    calls: list[NewtonResult] = []

    def solve_and_stop(solver: Solver) -> NewtonResult:
        calls.append(remedies.solve(solver))
        if len(calls) == count:
            raise StoppedError("enough")
        return calls[-1]

    with monkeypatch.context() as patch:
        patch.setattr(f"app.stepping.{solve}.solve", solve_and_stop)
        with pytest.raises(StoppedError, match="enough"):
            mantle.run(load_case(path, [*options, *LATE_FIELDS]), folder / "out")
    return Results(folder / "out")


def test_recorder_writes_the_temperature_of_the_last_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The third solve gives the rate at the start and steps to 1 s and 2 s: the last is stopped."""
    results = stopped(monkeypatch, tmp_path, HEATED, "heat_state", 3)
    assert results.step_record["seconds [s]"].tolist() == [1.0]
    for name in ("temperature", "temperature_peak"):
        np.testing.assert_allclose(results.fields.on_points(name), 21.0, rtol=1e-9)


@pytest.mark.parametrize(("solves", "warming", "row"), [(3, 10, 10), (4, 15, 10), (5, 20, 20)])
def test_recorder_writes_the_stress_of_the_last_step_of_mechanics(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, solves: int, warming: float, row: float
) -> None:
    """Mechanics follow each heat step of 10 K in two steps of 5 K; the last solve is stopped.

    The heat is that of the last row.
    """
    results = stopped(monkeypatch, tmp_path, SQUEEZED, "load_steps", solves)
    summary, fields = results.summary, results.fields
    pressure = 0.1 * warming
    for region in ("lower", "upper"):
        assert summary["regions"][region]["principal_min"] == pytest.approx(-pressure, rel=1e-8)
    interface = summary["interfaces"]["lower_upper"]
    assert interface["pressure_mean"] == pytest.approx(pressure, rel=1e-8)
    np.testing.assert_allclose(fields.on_points("principal_min"), -pressure, rtol=1e-8)
    for name in ("temperature", "temperature_peak"):
        np.testing.assert_allclose(fields.on_points(name), 20.0 + row, rtol=1e-9)


def test_recorder_writes_heat_and_stress_of_the_last_step_solved_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The third of four heat steps is stopped. A shorter run ends with the second."""
    results = stopped(monkeypatch, tmp_path, coupled.CASE, "heat_state", 3)
    shorter = ("stages.1.duration=1 s", "stages.1.increments=2", "supports.slide.history=[0, 0.5]")
    expected = support.run(coupled.CASE, tmp_path / "shorter", *shorter)
    for name in (
        "temperature",
        "lower_upper_temperature_jump",
        "lower_upper_heat_flux",
        "lower_upper_pressure",
        "displacement",
        "stress",
    ):
        values = expected.fields.on_points(name)
        atol = 1e-9 * np.abs(values).max()
        np.testing.assert_allclose(results.fields.on_points(name), values, 1e-9, atol)
    for name in ("regions", "interfaces"):
        for place, numbers in expected.summary[name].items():
            assert results.summary[name][place] == pytest.approx(numbers, rel=1e-9)


def test_recorder_writes_displacements_of_the_last_step_with_finite_sliding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second step is stopped after points were paired again; its load is a side force."""
    text = f"{support.HEAD_CUP}motions: {{ball: {{region: head, about: head_centre}}}}\n"
    press = "loads.press={kind: force, boundary: head_bore, force: [300 N, 100 N, 2000 N]}"
    expected = support.run(text, tmp_path / "pressed", press).fields.displacement()
    options = (
        press.replace("]}", "], history: [1, 1]}"),
        "loads.side={kind: force, boundary: head_bore, force: [1500 N, 0 N, 0 N], history: [0, 1]}",
        "stages=[{name: press}, {name: side}]",
    )
    results = stopped(monkeypatch, tmp_path, text, "load_steps", 4, *options)
    assert results.step_record["time [-]"].tolist() == [1.0]
    np.testing.assert_allclose(results.fields.displacement(), expected, 1e-9, 1e-9)
