"""``mantle study``: report and files, by numbers that follow the laws of `stand_in`."""

from __future__ import annotations

import csv
import json
import logging
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from app.campaigns import study
from app.campaigns.batch import Options
from app.campaigns.runs import Result
from app.campaigns.study_results import Measured
from app.campaigns.work_precision import NOT_CONVERGING, ReferenceValue
from app.case import quantities, summary_numbers
from app.case import study as study_file
from app.cli import main
from app.foundation.errors import MantleError
from app.plots import curves, figures, labels
from tests.campaigns import bench as points
from tests.campaigns.bench import CASE, Bench

STUDY = (
    points.STUDY.replace("set: {output.condition: true}\n", "")
    .replace(", solver.condition", "")
    .replace("0.5 mm]", "0.5 mm, 0.25 mm]")
)
PENALTY = """\
base: ../case.yaml
set: {mesh.size: 2 mm, output.condition: true}
study:
  quantities:
    - lower_upper.penetration_max
    - lower_upper.slip_p99
    - solver.newton_iterations
    - solver.condition
    - timing.total
  lines:
    penalty:
      interfaces.lower_upper.kind: penalty
      interfaces.lower_upper.penalty: &r [1e2 MPa/mm, 1 GPa/mm, 1e4 MPa/mm, 1e6 MPa/mm]
    exact: {interfaces.lower_upper.augmentation: *r}
  reference: {run: {}}
"""


FAST = ReferenceValue(2.0, 1e-6, None, NOT_CONVERGING)


@pytest.fixture
def file(bench: Bench) -> Path:
    """A study in the folder of the case and the stand-in."""
    path = bench.folder / "study.yaml"
    path.write_text(STUDY)
    return path


def read(folder: Path) -> tuple[dict[str, Any], list[dict[str, str]]]:
    with (folder / "study.csv").open() as file:
        return json.loads((folder / "study.json").read_text()), list(csv.DictReader(file))


def test_study_errors_orders_front_and_advice(file: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "mantle")
    out = file.parent / "out"
    study.run(file, [], Options(out, 2))
    record, rows = read(out)
    slip, pressure = record["quantities"].values()
    # The ladder ends at h = 0.25: what it corrects there is its uncertainty.
    assert slip["reference"]["value"] == pytest.approx(0.04, rel=1e-9)
    assert slip["reference"]["uncertainty"] == pytest.approx(0.04 * 0.01 / 16, rel=1e-6)
    assert slip["reference"]["order"] == pytest.approx(2, abs=1e-6)
    assert pressure["reference"]["value"] == pytest.approx(5, rel=1e-9)
    assert pressure["reference"]["order"] == pytest.approx(1, abs=1e-6)
    assert slip["exponents"] == pytest.approx({"P1": 2, "P2": 2}, abs=1e-6)
    assert pressure["exponents"] == pytest.approx({"P1": 1, "P2": 1}, abs=1e-6)
    errors = [p["error"] for p in pressure["points"]]
    assert errors == pytest.approx([0.16, 0.08, 0.04, 0.08, 0.04, 0.03])
    assert [p["time"] for p in pressure["points"]] == pytest.approx([2, 4, 8, 2, 4, 16 / 3])
    assert [p["pareto"] for p in pressure["points"]] == [False] * 3 + [True] * 3
    assert slip["advice"] == (
        "lower_upper.slip_p99 within 2 % costs 8.0 s (P1 at 1 mm), 0.8 % is reached by no run "
        "(closest 1 % in 8.0 s, P1 at 1 mm)"
    )
    assert pressure["advice"] == (
        "lower_upper.pressure_p99 within 2 % is reached by no run "
        "(closest 3 % in 5.3 s, P2 at 1.5 mm)"
    )
    assert record["advice"].startswith("every number within 2 % is reached by no run (closest 3 %")
    two = "study.reference={run: {mesh.order: 2, mesh.size: [0.8 mm, 0.5 mm]}}"  # 5.08, 5.05 MPa
    study.run(file, [two, "study.target=0.025"], Options(out, 2))
    assert (
        "lower_upper.pressure_p99 within 2.5 % costs 5.3 s (P2 at 1.5 mm), 1 % is reached by no run"
    ) in caplog.text
    assert len(rows) == 12 and {r["unit"] for r in rows} == {"mm", "MPa"}
    assert [float(r["error [-]"]) for r in rows[6:]] == pytest.approx(errors)
    assert rows[0]["mesh [s]"] == "3.0" and rows[0]["newton iterations"] == "4"
    assert "lower_upper.slip_p99: reference 40 um ± 0.062 %" in caplog.text
    assert "error goes with mesh.size^2.0 along P1, mesh.size^2.0 along P2" in caplog.text
    assert (out / "study.png").read_bytes()[:4] == b"\x89PNG"
    assert not (out / "study_parameters.png").exists()
    assert len(list((out / "runs").glob("*/"))) == 9
    # As if the finest of first order were the truth: errors fall by 5 and all, at h^2 at most.
    values = "{lower_upper.slip_p99: 39.6 um, lower_upper.pressure_p99: 5 MPa}"
    study.run(file, [f"study.reference={{values: {values}}}"], Options(out, 2))
    assert "error goes with not yet converging along P1, mesh.size^" in caplog.text
    measured = Measured("a", quantities.quantity_or_fail("stem.varus"), True, FAST, [], {}, [])
    assert "reference is not yet converging; refine" in study._costs(0.02, "a", [], [measured])


def test_study_ignores_accidentally_accurate_runs() -> None:
    """Errors are 4, 1, 3 and 1.5 %; the reference is known to 1.2 %."""
    runs = [
        SimpleNamespace(line="P2", key="mesh.size", label=f"{h} mm", time=t)
        for h, t in ((8, 1.0), (6, 2.0), (4, 4.0), (2, 8.0))
    ]
    measured = SimpleNamespace(errors=[0.04, 0.012, 0.03, 0.015], uncertainty=0.012, reference=None)
    assert study._costs(0.05, "slip", runs, [measured]) == (  # type: ignore[arg-type, list-item]
        "slip within 5 % costs 1.0 s (P2 at 8 mm), 2 % costs 8.0 s (P2 at 2 mm), "
        "1 % is below the uncertainty of the reference, 1.2 %"
    )


def test_study_with_known_values_and_target(file: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Estimates are twice and eight times the true error. Overrides of --set apply to every run."""
    caplog.set_level(logging.INFO, "mantle")
    values = "{lower_upper.slip_p99: 40 um, lower_upper.pressure_p99: 5 MPa}"
    overrides = ["output.error=true", f"study.reference={{values: {values}}}", "study.target=0.05"]
    study.run(file, overrides, Options(file.parent / "out", 2))
    record, rows = read(file.parent / "out")
    assert record["within"] == {"numbers": 12, "covered": 12}
    assert [float(r["effectivity [-]"]) for r in rows] == pytest.approx([2] * 6 + [8] * 6)
    assert "the truth lies within ± for 12 of 12 numbers" in caplog.text
    assert record["advice"].startswith("every number within 5 % costs 4.0 s (P2 at 2 mm), 2 % is")
    assert record["quantities"]["lower_upper.slip_p99"]["reference"]["uncertainty"] == 0
    assert record["reference_runs"] == []


def test_study_of_some_lines_and_quick_tier(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The option ``-k`` selects lines.

    The quick tier has the first two points of each line and of the reference. A dry run only prints
    them.
    """
    options = ["study", str(file), "-o", str(file.parent / "out"), "--cores", "2", "-k", "P2"]
    assert main([*options, "--dry-run"]) == 0
    printed = capsys.readouterr().out
    assert "study.yaml: 6 runs" in printed and "P2/size=4mm" in printed and "P1/" not in printed
    assert not (file.parent / "out").exists()
    assert main([*options, "--tier", "quick", "--dry-run"]) == 0
    assert "study.yaml: 4 runs" in capsys.readouterr().out
    assert main([*options[:-1], "P3"]) == 2
    assert "-k P3: no line has this in its name; allowed: P1, P2" in capsys.readouterr().err


def test_study_shows_failed_points(file: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "mantle")
    (file.parent / "broken").write_text("4")
    out = file.parent / "out"
    study.run(file, [], Options(out, 2))
    record, rows = read(out)
    failed = "failed (exit code 1)"
    assert [r["status"] for r in rows[:4]] == [failed, "done", "done", failed]
    assert rows[0]["value"] == ""
    assert rows[0]["error [-]"] == ""
    assert rows[0]["time [s]"] == ""
    assert record["runs"][0]["message"].endswith("the block slides away")
    assert re.search(r"P1 +mesh.size 4 mm +failed \(exit code 1\)", caplog.text)
    with pytest.raises(MantleError, match="every run of the study failed") as error:
        file.write_text(STUDY.replace("[0.8 mm, 0.5 mm, 0.25 mm]", "[4 mm, 4 mm]"))
        study.run(file, ["study.lines={P1: {mesh.size: [4 mm]}}"], Options(out, 2))
    assert error.value.exit_code == 70  # the stand-in leaves with 1, which mantle run never does
    record, _ = read(out)
    assert record["quantities"]["lower_upper.slip_p99"]["reference"] is None
    assert "no advice on lower_upper.slip_p99: no run has a known error" in caplog.text


def test_study_over_a_penalty(file: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Quantities without an error have values only.

    One run is the reference, and the picture is over the penalty.
    """
    caplog.set_level(logging.INFO, "mantle")
    path, out = file.parent / "studies" / "penalty.yaml", file.parent / "out"
    path.parent.mkdir()
    path.write_text(PENALTY)
    (file.parent / "broken").write_text("1e6")
    study.run(path, ["mesh.far_size=6 mm", "study.target=0.1"], Options(out, 2))
    record, rows = read(out)
    assert Path(record["case"]).samefile(file.parent / "case.yaml")
    assert record["overrides"][-1] == "mesh.far_size=6 mm" and record["target"] == 0.1
    depth, slip, newton, condition, time = record["quantities"].values()
    reference = {"value": 0.0384, "uncertainty": 0, "order": None, "method": "of one run"}
    assert slip["reference"] == reference
    errors = [p["error"] for p in slip["points"]]
    assert errors == pytest.approx([0.1, 0.01, 0.001, None, 0, 0, 0, 0], abs=1e-12)
    assert slip["exponents"] == {"penalty": pytest.approx(-1), "exact": None}
    values = [p["value"] for p in depth["points"]]
    assert values == pytest.approx([2e-2, 2e-3, 2e-4, None, 0, 0, 0, 0])
    for each, value in ((newton, 4), (condition, 1e5), (time, 10)):
        assert [p["value"] for p in each["points"]] == [value] * 3 + [None] + [value] * 4
    for each in (depth, newton, condition, time):
        assert each["reference"] is None and each["advice"] == "" and not each["compared"]
        assert {p["error"] for p in each["points"]} == {None}
    assert record["advice"] == "" and slip["advice"].startswith(
        "lower_upper.slip_p99 within 10 % costs"
    )
    assert "reference 38.4 um, of one run" in caplog.text
    assert "lower_upper.penetration_max\n" in caplog.text
    assert [r["number [internal]"] for r in rows[:3]] == ["100.0", "1000.0", "10000.0"]
    for name in ("study.png", "study_parameters.png"):
        assert (out / name).read_bytes()[:4] == b"\x89PNG" and name in caplog.text
    # Only what shows something is drawn, and nothing is left of another study.
    study.run(path, ["mesh.far_size=6 mm", "study.quantities=[timing.total]"], Options(out, 2))
    names = {p.name for p in out.iterdir()}
    assert "study_parameters.png" in names and "study.png" not in names


@pytest.mark.parametrize(
    ("values", "scale"),
    [
        ([1.0, 2.0, 29.0], "linear"),
        ([1.0, 2.0, 31.0], "log"),
        ([1.0, 1e-3, 1e-15], "symlog"),
        ([1.0, 1e-3, -1.0], "linear"),
        ([], "linear"),
    ],
)
def test_study_picture_axes_over_decades_are_logarithmic(values: list[float], scale: str) -> None:
    from matplotlib.figure import Figure

    axes = Figure().subplots()
    curves.span_decades(axes, values)
    assert axes.get_yscale() == scale


def test_study_picture_labels_do_not_overlap() -> None:
    """Six points are close together.

    Each label is free of others inside the frame, or is left out.
    """
    figure = figures.new(5, 4)
    axes = figure.subplots()
    at = [(1, 1), (1.02, 1), (1, 1.03), (1.5, 1), (0, 0), (2, 2)]
    axes.plot(*zip(*at, strict=True), "o")
    notes = [axes.annotate("2.5 mm", xy, xytext=(5, 5), textcoords="offset points") for xy in at]
    figure.draw_without_rendering()
    labels.place_labels(axes)
    boxes = [note.get_window_extent() for note in notes if note.get_visible()]
    assert len(boxes) >= 4 and all(box.count_overlaps(boxes) == 1 for box in boxes)
    assert all(axes.bbox.count_contains(box.corners()) == 4 for box in boxes)
    assert not any(box.count_contains(axes.transData.transform(at)) for box in boxes)


def test_study_lines_vary_ranks_laws_and_list_items(file: Path) -> None:
    file.write_text("""\
base: case.yaml
study:
  quantities: [lower_upper.slip_p99]
  lines:
    law:
      interfaces.lower_upper:
        - {kind: penalty, friction_coefficient: 1.0, penalty: 1e3 MPa/mm}
        - {kind: penalty, friction_coefficient: 1.0, penalty: 1e4 MPa/mm}
    stiffness:
      interfaces.lower_upper.kind: penalty
      interfaces.lower_upper.penalty: [1e3 MPa/mm, 1e4 MPa/mm]
    ranks: {ranks: [1, 2]}
    steps: {stages.0.name: only, "stages[0].increments": [1, 2], solver.tolerance: 1e-8}
  reference: {values: {lower_upper.slip_p99: 0.04 mm}}
""")
    planned = study_file.read(file)[1]
    runs = [study._study_run(Result(p, file, 4, 0.0, {}, "")) for p in planned]
    assert [r.label for r in runs] == ["#1", "#2", "1e3 MPa/mm", "1e4 MPa/mm", *"1212"]
    assert [r.x for r in runs] == [None, None, 1e3, 1e4, 1, 2, 1, 2]
    assert [r.unit for r in runs] == ["", "", "MPa/mm", "MPa/mm", "", "", "", ""]
    assert [p.ranks for p in planned] == [1, 1, 1, 1, 1, 2, 1, 1] and all(
        p.needs_idle_machine for p in planned
    )
    laws = [p.case.interfaces["lower_upper"] for p in planned]
    assert [getattr(law, "penalty", None) for law in laws[:5]] == [1e3, 1e4, 1e3, 1e4, None]
    assert laws[0] == laws[2] and laws[1] == laws[3]
    assert [p.case.stages[0].increments for p in planned[6:]] == [1, 2]


# Numbers of laws, strengths, tissues and axes that the blocks do not have.
ELSEWHERE = {
    *("hoop_p99", "creep_strain_max", "creep_strain_mean", "failure_risk", "failure_probability"),
    *("unbonded_fraction", "area_damaged", "area_broken", "damage_mean", "zone_length"),
    *("zone_elements", "strength_fraction", "failure_index_max", "failure_index_p99"),
    *("failure_load_factor", *(f"volume_over_{s}_MPa" for s in (3, 5, 7, 9, 11))),
    # Of finite sliding.
    *(f"{name}.{axis}" for name in ("torque", "centre") for axis in "xyz"),
    *("torque_size", "torque_along", "torque_max", "eccentricity", "dissipation_cycle"),
    *("slid_max", "slid_mean", "slid_max_master", "friction_power", "temperature_swing"),
    "uncovered_fraction",
    # Of press fits.
    *(f"micromotion_{part}" for part in ("mean", "p95", "p99", "max")),
    *("area_micromotion_over_40um", "area_micromotion_over_150um"),
    *("area_inducible_over_40um", "area_inducible_over_150um", "insertion_gap_mean"),
    *("insertion_gap_p95", "insertion_open_fraction"),
    *(f"insertion_pressure_{part}" for part in ("mean", "p95", "max")),
    *("insertion_hoop_strain_p99", "insertion_hoop_strain_max"),
    "insertion_compressive_strain_p99",
    # Of curved interfaces with straight facets.
    "pressure_by_facets",
    "compression_max",  # of elastic layers
    *(f"wear_volume{times}" for times in ("", "_million")),
    *(
        f"wear_depth_{how}{side}{times}"
        for how in ("max", "p99")
        for side in ("", "_master")
        for times in ("", "_million")
    ),
}


def test_study_of_real_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The patch test has 2 MPa on any mesh. Every quantity of the schema is in a summary."""
    rollers = """\
  base: {kind: roller, boundary: bottom, axis: z}
  left: {kind: roller, boundary: x_min, axis: x}
  front: {kind: roller, boundary: y_min, axis: y}
"""
    case = CASE.replace("  base: {kind: fixed, boundary: bottom}\n", rollers)
    (tmp_path / "case.yaml").write_text(case)
    path, out = tmp_path / "study.yaml", tmp_path / "out"
    path.write_text("""\
base: case.yaml
study:
  quantities: [lower_upper.pressure_mean, lower_upper.force.z]
  lines: {size: {mesh.size: [4 mm, 2 mm]}}
  reference: {values: {lower_upper.pressure_mean: 2 MPa, lower_upper.force.z: 32 N}}
""")
    assert main(["study", str(path), "-o", str(out), "--cores", "2"]) == 0
    record, rows = read(out)
    assert [abs(float(r["value"])) for r in rows] == pytest.approx([2, 2, 32, 32])
    points = record["quantities"]["lower_upper.pressure_mean"]["points"]
    assert all(p["error"] < 1e-9 for p in points)
    assert re.search(r"within 2 % costs .* \(size at [24] mm\)", capsys.readouterr().out)
    summary = json.loads((Path(record["runs"][0]["folder"]) / "summary.json").read_text())
    for section in ("interfaces", "regions"):
        name = next(iter(summary[section]))
        for key in (n for q in quantities.TABLE[section].values() for n in q.names):
            if key not in ELSEWHERE:
                assert summary_numbers.read(summary, f"{name}.{key}") is not None, key
