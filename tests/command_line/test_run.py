"""``mantle run``: files that a run leaves, and failures."""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
from collections.abc import Callable
from functools import partial
from html import unescape
from pathlib import Path
from typing import Any

from mpi4py import MPI  # noqa: F401  (h5py built for MPI needs it initialised)

import h5py
import numpy as np
import pytest

import mantle
import meshes
from app.case import new_case
from app.case.case import dump, load_case
from app.case.summary_numbers import maximum_with_parts
from app.foundation.verdict import recorded
from app.laws.loads import Force
from app.report import run_report
from app.simulation import finished_runs
from app.system import folders, identity
from meshes.femur_bone import FemurBone
from tests import frozen, support
from tests.cases.shipped import COARSE

FILES = {"case.yaml", "fields.vtkhdf", "final.vtkhdf", "history.csv", "provenance.json"}
FILES |= {"summary.json", "DONE", "report.html", "case.png"}
FIELDS = ("gap", "slip", "slip_path", "motion", "pressure", "shear", "status")

STEM = """
title: A small stem
geometry: {kind: cylinders, stem_radius: 7 mm, cement_thickness: 3 mm, bone_thickness: 4 mm,
           length: 12 mm, sector: quarter}
mesh: {order: 1, size: 3 mm, far_size: 4 mm}
regions:
  stem: {youngs_modulus: 110 GPa, poisson_ratio: 0.3}
  cement: {youngs_modulus: 2200 MPa, poisson_ratio: 0.3}
  bone: {youngs_modulus: 17 GPa, poisson_ratio: 0.3}
interfaces:
  stem_cement: {kind: contact, friction_coefficient: 0.4, gap: -0.01 mm, gap_history: [1, 1]}
  cement_bone: {kind: contact, friction_coefficient: 1.0}
supports:
  symmetry_x: {kind: roller, boundary: symmetry_x, axis: x}
  symmetry_y: {kind: roller, boundary: symmetry_y, axis: y}
  table: {kind: roller, boundary: bone_bottom, axis: z}
loads:
  push: {kind: force, boundary: stem_top, force: [0 N, 0 N, -20 N], history: [0, 1]}
stages:
  - {name: fit}
  - {name: push, increments: 2}
"""

# Pressed down, then pushed sideways beyond friction: 0.3 * 1 MPa * 36 mm2 = 10.8 N.
SLIDING = """
geometry: {kind: blocks, blocks: [{name: lower, size: [6 mm, 6 mm, 3 mm]},
                                  {name: upper, size: [6 mm, 6 mm, 3 mm]}]}
mesh: {order: 1, size: 2 mm, far_size: 2 mm}
regions:
  lower: {youngs_modulus: 1000 MPa, poisson_ratio: 0.3}
  upper: {youngs_modulus: 500 MPa, poisson_ratio: 0.3}
interfaces:
  lower_upper: {kind: contact, friction_coefficient: 0.3}
supports:
  floor: {kind: fixed, boundary: bottom}
loads:
  press: {kind: pressure, boundary: top, pressure: 1 MPa}
  push: {kind: force, boundary: upper_x_min, force: [20 N, 0 N, 0 N], history: [0, 1]}
stages:
  - {name: press}
  - {name: push, increments: 2, max_cut_backs: 2}
solver: {max_iterations: 8}
"""


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """``mantle run``, in series."""
    return support.on_ranks(1, "-m", "mantle", "run", *arguments, code=None)


def rows(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def balanced(summary: dict[str, Any]) -> bool:
    """Balances, without the trapezoidal sum of heat, which shows the error of time steps."""
    return max(v for k, v in summary["balance"].items() if k != "heat_quadrature") < 1e-8


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, str]:
    """A finished run: its case, its folder, its output."""
    folder = tmp_path_factory.mktemp("run")
    case, output = folder / "small.yaml", folder / "out"
    case.write_text(STEM)
    result = run(
        case, "-o", output, *support.sets("interfaces.cement_bone.friction_coefficient=0.8")
    )
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    return case, output, result.stdout


def test_run_summary_is_consistent(done: tuple[Path, Path, str]) -> None:
    """Interfaces carry the load to the table, and the stem subsides."""
    summary = support.summary(done[1])
    assert (summary["status"], summary["solver"]["steps"]) == ("converged", 3)
    assert summary["units"]["length"] == "mm" and summary["units"]["stress"] == "MPa"
    assert summary["solver"].keys() >= {"dofs", "newton_iterations", "ranks"}
    phases = {"mesh", "compile", "assemble", "solve", "output", "total"}
    assert summary["timing"].keys() >= phases
    assert summary["balance"].keys() >= {"force", "moment", "energy"} and balanced(summary)
    assert np.isfinite(list(frozen.numbers(done[1]).values())).all()
    quarter = np.pi / 4 * 12
    for name, radius in {"stem_cement": 7, "cement_bone": 10}.items():
        q = summary["interfaces"][name]
        # Friction on the stem bears the push, on the cement and on the bone.
        assert q["force"][2] == pytest.approx(-20, rel=1e-6)
        assert q["open_fraction"] + q["stick_fraction"] + q["slip_fraction"] == pytest.approx(1)
        assert q["area"] == pytest.approx(np.pi / 2 * radius * 12, rel=0.03)
    assert summary["stem"]["subsidence"] > 0
    for name, (a, b) in {"stem": (0, 7), "cement": (7, 10), "bone": (10, 14)}.items():
        volume = summary["regions"][name]["volume"]
        assert volume == pytest.approx(quarter * (b**2 - a**2), rel=0.1)
    # The press fit squeezes stem and cement, and stretches the bone around them.
    assert summary["regions"]["stem"]["hoop_p99"] < 0 < summary["regions"]["bone"]["hoop_p99"]


def test_run_has_a_row_per_step(
    done: tuple[Path, Path, str],
) -> None:
    """The table has a row per step.

    The folder has the verdict, the provenance and the resolved case.
    """
    case, output, printed = done
    history, summary = rows(output / "history.csv"), support.summary(output)
    assert [float(r["time [-]"]) for r in history] == [1.0, 1.5, 2.0]
    for name, q in summary["interfaces"].items():
        for key, unit in (("gap_max", "mm"), ("pressure_max", "MPa"), ("slip_fraction", "-")):
            assert float(history[-1][f"{name} {key} [{unit}]"]) == pytest.approx(q[key], rel=1e-12)
    assert sum(int(r["newton [-]"]) for r in history) == summary["solver"]["newton_iterations"]
    lines = printed.splitlines()
    heads = [line.split() for line in lines if line.split()[:1] == ["step"]]
    steps = [line.split() for line in lines if line.lstrip()[:1] in "123" and line.endswith(" s")]
    assert {head.index("time") for head in heads} == {1}
    assert [float(step[1]) for step in steps] == [1.0, 1.5, 2.0]
    assert "satisfied to rounding" in printed and str(output) in lines[-1]
    assert {p.name for p in output.iterdir()} == FILES
    record = json.loads((output / "provenance.json").read_text())
    assert record["overrides"] == ["interfaces.cement_bone.friction_coefficient=0.8"]
    assert record["ranks"] == 1 and record["case"].endswith("small.yaml")
    assert load_case(output / "case.yaml").config == load_case(case, record["overrides"]).config


def test_run_fields_are_read_back(done: tuple[Path, Path, str]) -> None:
    """Fields have a node per body at the interfaces, and agree with the summary."""
    results = mantle.read(done[1])
    summary, f = results.summary, results.fields
    assert list(f.times) == [1.0, 1.5, 2.0] and list(f.regions) == ["stem", "cement", "bone"]
    stresses = {"stress", "von_mises", "principal_max", "principal_min"}
    at_interfaces = {f"{i}_{key}" for i in summary["interfaces"] for key in FIELDS}
    assert {*f.point_fields} == at_interfaces | {"displacement"} | stresses
    assert {*f.cell_fields} == {"region"} | stresses
    for name, q in summary["interfaces"].items():
        for key in FIELDS[:-1]:
            values = f.at_interface(name, key)
            if values.ndim == 2:
                values = np.linalg.norm(values, axis=1)
            # Fields of tractions are means over the areas of points, maxima point values.
            largest = "pressure_mean_max" if key == "pressure" else f"{key}_max"
            if key != "shear":
                assert values.max() == pytest.approx(q[largest], rel=1e-9, abs=1e-12), key
        status = f.at_interface(name, "status")
        assert set(status) <= {-1.0, 0.0, 1.0, 2.0} and (status >= 0).any()
        # Both sides of the interface have separate nodes, at the same places.
        on = f.points[status >= 0]
        radius = np.hypot(on[:, 0], on[:, 1])
        assert np.abs(radius - (7 if name == "stem_cement" else 10)).max() < 1e-6
        assert len(on) == 2 * len(np.unique(on.round(9), axis=0))
    σ, u = f.stress(), f.displacement()
    deviator = σ - np.trace(σ, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    mises = np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2)))
    np.testing.assert_allclose(f.on_cells("von_mises"), mises, rtol=1e-9, atol=1e-9)
    # At points it is between what the cells around have.
    six, at_points = f.on_cells("stress"), f.on_points("stress")
    assert (at_points.min(axis=0) >= six.min(axis=0) - 1e-9).all()
    assert (at_points.max(axis=0) <= six.max(axis=0) + 1e-9).all()
    with h5py.File(done[1] / "final.vtkhdf") as file:
        assert "Steps" not in file["VTKHDF"]
        np.testing.assert_array_equal(file["VTKHDF/PointData/displacement"][:], u)
        np.testing.assert_array_equal(file["VTKHDF/CellData/stress"][:], six)
    assert np.isfinite(u).all() and np.abs(u).max() > 1e-3
    for name, tag in f.regions.items():
        here = f.region == tag
        assert f.volumes()[here].sum() == pytest.approx(summary["regions"][name]["volume"])
        mean = np.trace(σ[here], axis1=1, axis2=2) / 3
        assert mean.max() == pytest.approx(summary["regions"][name]["mean_stress_max"])
        # The stress is that of the displacement beside it: E times the stretch of a cell.
        corners = f.cells[here]
        assert_stress(σ[here], f.points[corners], u[corners], *MATERIALS[name])


MATERIALS = {"stem": (110e3, 0.3), "cement": (2200.0, 0.3), "bone": (17e3, 0.3)}


def assert_stress(σ: np.ndarray, x: np.ndarray, u: np.ndarray, E: float, ν: float) -> None:
    """Hooke's law on linear tetrahedra, by the displacements of nodes."""
    G = np.linalg.solve(x[:, 1:] - x[:, :1], u[:, 1:] - u[:, :1])
    ε = (G + G.transpose(0, 2, 1)) / 2
    λ, μ = E * ν / ((1 + ν) * (1 - 2 * ν)), E / (2 * (1 + ν))
    trace = np.trace(ε, axis1=1, axis2=2)
    exact = λ * trace[:, None, None] * np.eye(3) + 2 * μ * ε
    assert np.abs(σ - exact).max() < 1e-9 * np.abs(exact).max()


def test_run_keeps_or_replaces_finished_results(
    done: tuple[Path, Path, str], tmp_path: Path
) -> None:
    """Results of another configuration and incomplete ones are replaced on request."""
    case, output = done[0], tmp_path / "out"
    shutil.copytree(done[1], output)
    same = support.sets("interfaces.cement_bone.friction_coefficient=0.80")

    def stamps() -> dict[str, int]:
        return {p.name: p.stat().st_mtime_ns for p in output.iterdir()}

    before = stamps()
    result = run(case, "-o", output, *same)
    assert result.returncode == 0 and result.stdout.startswith(
        f"{output} has the finished results of this case already"
    )
    assert run(case, "-o", output).returncode == 2
    assert stamps() == before and result.stderr == ""
    (output / "DONE").unlink()
    assert run(case, "-o", output, *same).returncode == 2
    assert run(case, "-o", output, *same, "--restart", "auto").returncode == 0
    again = stamps()
    assert all(again[name] > before[name] for name in FILES)
    result = run(case, "-o", output, "--restart", "auto")
    assert result.returncode == 0 and "is finished" not in result.stdout
    assert all(stamps()[name] > again[name] for name in FILES)
    assert "friction_coefficient: 1.0" in (output / "case.yaml").read_text()
    # Replaced are results alone.
    (output / "DONE").write_text("old")
    (output / "notes.txt").write_text("mine")
    assert run(case, "-o", output, *support.sets("output.fields=false"), "--force").returncode == 0
    kept = (FILES - {"fields.vtkhdf", "final.vtkhdf"}) | {"notes.txt"}
    assert stamps().keys() == kept and (output / "DONE").read_text() == ""


def test_run_repeats_results_of_another_mesh_or_stack(tmp_path: Path) -> None:
    mesh = tmp_path / "box.msh"
    blocks = support.case(SLIDING)
    meshes.write_msh(meshes.build(blocks.geometry, blocks.mesh), mesh)
    geometry = f"{{kind: file, path: {mesh}, interfaces: {{lower_upper: [lower, upper]}}}}"
    tissues = [f"regions.{name}.tissue=other" for name in ("lower", "upper")]
    case = support.case(f"geometry: {geometry}\n{SLIDING[SLIDING.index('mesh:') :]}", *tissues)
    (tmp_path / "case.yaml").write_text(dump(case))

    def finished(**of: str) -> bool:
        record = json.dumps({"identity": identity.versions() | of})
        (tmp_path / "provenance.json").write_text(record)
        return finished_runs.finished(tmp_path, case)

    assert not finished()
    (tmp_path / "DONE").write_text("")
    assert finished()
    assert not any(finished(**{name: "0.1"}) for name in identity.versions())
    later = (tmp_path / "DONE").stat().st_mtime + 1
    os.utime(mesh, (later, later))
    assert not finished()


def test_run_that_diverges_leaves_its_last_state(tmp_path: Path) -> None:
    """The exit code is 4.

    One message names the free body, and the last converged state is on disk.
    """
    case, output = tmp_path / "sliding.yaml", tmp_path / "out"
    case.write_text(SLIDING)
    result = run(case, "-o", output, "--", "-pc_type", "bogus")
    assert result.returncode == 2 and "(-pc_type bogus): Unable to find" in result.stderr
    result = run(case, "-o", output, "--", "-snes_monitor", "-fieldsplit_displacement_pc_other")
    assert "PETSc did not use -fieldsplit_displacement_pc_other" in result.stderr
    assert result.returncode == 4 and "SNES Function norm" in result.stdout
    message = result.stderr
    assert "Traceback" not in message and message.count("stage 'push'") == 1
    assert "nothing holds body 'upper': it is free to move along x" in message
    for part in ("interface 'lower_upper'", "what to do: hold the "):
        assert part in message, message
    assert f"last converged state: time 1.5 (step 2) in {output}" in message
    assert not (output / "DONE").exists()
    assert not list(output.glob("*.partial"))
    summary = support.summary(output)
    assert summary["status"] == "not converged"
    # 10 N of 10.8 N were reached: the state is that one, not the failed one.
    assert summary["time"] == 1.5
    assert summary["interfaces"]["lower_upper"]["force"][0] == pytest.approx(-10, rel=1e-6)
    assert balanced(summary)
    with h5py.File(output / "fields.vtkhdf") as file:
        np.testing.assert_allclose(file["VTKHDF/Steps/Values"][:], [1.0, 1.5])
    assert [float(r["time [-]"]) for r in rows(output / "history.csv")] == [1.0, 1.5]


def test_run_without_converged_step_leaves_a_diagnosis(tmp_path: Path) -> None:
    """The first step fails, so there are no numbers and no fields. A page gives the reason."""
    case, output = tmp_path / "sliding.yaml", tmp_path / "out"
    case.write_text(SLIDING.replace("history: [0, 1]", "history: [1, 1]"))
    changes = "stages=[{name: a, adaptive: false}, {name: b}]", "regions.upper.poisson_ratio=0.46"
    result = run(case, "-o", output, *support.sets(*changes))
    assert result.returncode == 4, result.stderr
    assert f"no step has converged: {output} has the case, but no numbers" in result.stderr
    # What check notes is in the log.
    assert "regions.upper is nearly incompressible: linear tetrahedra lock" in result.stderr
    assert not (output / "fields.vtkhdf").exists() and not (output / "DONE").exists()
    summary = support.summary(output)
    assert summary["status"] == "not converged" and summary["interfaces"] == {}
    for _ in range(2):  # after the run; and again as if it had been killed
        text = unescape((output / "report.html").read_text())
        assert summary["status"] in text
        assert all(verdict.what.lower() in text.lower() for verdict in recorded(summary))
        summary = {"status": "not finished"}
        (output / "summary.json").unlink(missing_ok=True)
        run_report.write(output)


# The push of 20 N finds no hold by friction of 0.3, that of 8 N does; 1.5 MPa would hold 16 N.
VARIED = (
    SLIDING
    + """
variations:
  slides: {}
  holds: {loads.push.force: [8 N, 0 N, 0 N]}
  pressed: {loads.push.force: [16 N, 0 N, 0 N], loads.press.pressure: 1.5 MPa}
"""
)


def test_run_failed_variation_does_not_stop_others(tmp_path: Path) -> None:
    """The exit code is 4, and the message names the variation and the reason.

    Finished ones are not repeated.
    """
    case, output = tmp_path / "varied.yaml", tmp_path / "out"
    case.write_text(VARIED)
    result = run(case, "-o", output)
    assert result.returncode == 4, result.stderr
    assert result.stderr.splitlines()[-1].startswith("1 of 3 variations did not converge: slides")
    assert not (output / "DONE").exists() and not (output / "slides" / "DONE").exists()
    assert "stage 'push'" in (output / "slides" / "FAILED").read_text()
    assert support.summary(output / "slides")["status"] == "not converged"
    table = json.loads((output / "variations.json").read_text())
    assert [r["status"] for r in table] == ["not converged", "converged", "converged"]
    for name in ("holds", "pressed"):
        assert {p.name for p in (output / name).iterdir()} == FILES - {"case.png"}
    numbers = rows(output / "variations.csv")
    assert [r["name"] for r in numbers] == ["slides", "holds", "pressed"]
    slip = support.summary(output / "pressed")["interfaces"]["lower_upper"]["slip_p99"]
    assert float(numbers[2]["lower_upper.slip_p99 [mm]"]) == pytest.approx(slip, rel=1e-12)
    # Only what failed is tried again, and what has changed is run: then all of them hold, and what
    # failed before says nothing any more.
    stamps = [(output / name / "DONE").stat().st_mtime_ns for name in ("holds", "pressed")]
    held = [
        *support.sets(
            "variations.slides={loads.push.force: [9 N, 0 N, 0 N]}",
            "variations.holds={loads.push.force: [7 N, 0 N, 0 N]}",
        ),
        *("--restart", "auto"),
    ]
    result = run(case, "-o", output, *held)
    assert result.returncode == 0, result.stderr
    assert "1 of 3 variations are finished already" in result.stdout
    assert (output / "DONE").exists() and not (output / "slides" / "FAILED").exists()
    assert (output / "holds" / "DONE").stat().st_mtime_ns > stamps[0]
    assert (output / "pressed" / "DONE").stat().st_mtime_ns == stamps[1]
    assert (
        f"{output} has the finished results of this case already"
        in run(case, "-o", output, *held[:-2]).stdout
    )
    # All of them are there, but not their table: it was killed in between.
    (output / "DONE").unlink()
    (output / "variations.csv").unlink()
    assert "3 of 3 variations" in run(case, "-o", output, *held).stdout
    assert (output / "DONE").exists() and (output / "variations.csv").exists()


def test_run_interrupted_keeps_finished_variations(tmp_path: Path) -> None:
    case, output = tmp_path / "varied.yaml", tmp_path / "out"
    loads = [f"  v{i}: {{loads.push.force: '[{8 + 0.001 * i}, 0, 0] N'}}\n" for i in range(200)]
    case.write_text(SLIDING + "variations:\n" + "".join(loads))
    process = support.started("-m", "mantle", "run", case, "-o", output)
    assert process.stdout is not None
    while not process.stdout.readline().startswith("variation 3 "):
        assert process.poll() is None
    process.send_signal(signal.SIGTERM)
    _, message = process.communicate(timeout=60)
    assert process.returncode == 5
    assert "SIGTERM" in message and "of 200" in message
    done = sorted(p.parent.name for p in output.glob("*/DONE"))
    assert 2 <= len(done) < 200
    table = json.loads((output / "variations.json").read_text())
    assert sorted(r["name"] for r in table if r["status"] == "converged") == done


# Shipped configurations, coarsened, with numbers that have to come out.


def check_variations(s: dict[str, Any]) -> None:
    """Half of the load goes from the stem to the cement, times the factor of the variation."""
    factor = {"half_load": 0.5, "heavy_load": 1.5}.get(s["name"], 1.0)
    for q in s["interfaces"].values():
        expected = (-900 * factor, 150 * factor)
        assert (q["force"][2], q["force"][0]) == pytest.approx(expected, rel=1e-6)
    if s["name"] == "bonded":
        assert s["interfaces"].keys() == {"cement_bone"}


def check_bench(s: dict[str, Any]) -> None:
    """The stem bends above the pot. The resin is no bone, so there is no note on a femur."""
    assert "femur" not in s and s["section_loads"]
    assert 250.0 < maximum_with_parts(s["regions"]["stem"], "von_mises_p99") < 450.0
    assert s["regions"]["cement"]["von_mises_p99"] < 50.0
    assert 300.0 < s["stem_test"]["stem"]["level_stress"] < 450.0
    assert s["stem_test"]["stem"]["failing"] < 1e-6


def check_neck(s: dict[str, Any]) -> None:
    """The neck bears more than twice the force of the stem's test, on a shorter lever."""
    assert 300.0 < s["stem_test"]["stem"]["free_tension_p99"] < 500.0
    assert 0.5 < s["stem_test"]["stem"]["deflection"] < 1.5


HIP = (-399.5, -159.9, -1747.8)


def check_stance(s: dict[str, Any]) -> None:
    """Both interfaces transmit the hip force, because the cement bears no other load."""
    for q in s["interfaces"].values():
        assert q["force"] == pytest.approx(HIP, rel=1e-6)
    assert s["mantle"]["thickness"]["nominal"] == 4.0
    assert s["gruen"].keys() == {str(zone) for zone in range(1, 15)}
    for zone, q in s["gruen"].items():
        bone, interfaces = q["strain_energy_density"], q["interfaces"]
        assert bone.keys() == q["volume"].keys() and interfaces.keys() == s["interfaces"].keys()
        assert bone["cortical_bone"] > 0, zone
    for name, rest in s["interfaces"].items():
        surfaces = [rest, rest["rim"], rest["tip"]]
        area = sum(o["area"] for o in surfaces)
        assert rest["gap_p99"] < rest["rim"]["gap_p99"]
        # Both views divide the same; below the tip it is one zone of each.
        for view in (range(1, 8), range(8, 15)):
            parts = [s["gruen"][str(zone)]["interfaces"][name] for zone in view]
            assert sum(p["area"] for p in parts) == pytest.approx(area)
            for key in ("gap", "slip", "pressure", "shear"):
                assert max(p[f"{key}_max"] for p in parts) == maximum_with_parts(rest, f"{key}_max")
                mean, expected = (
                    sum(p["area"] * p[f"{key}_mean"] for p in of) for of in (parts, surfaces)
                )
                assert mean == pytest.approx(expected, rel=0.05)
        assert s["gruen"]["4"]["interfaces"][name] == s["gruen"]["11"]["interfaces"][name]


def check_intact(s: dict[str, Any]) -> None:
    """The case has bone alone.

    Far below the head its strain is that of a beam under the same forces.
    """
    assert s["interfaces"] == {}
    assert s["stem"] == {}
    assert "mantle" not in s
    assert s["regions"].keys() == {"cortical_bone", "cancellous_bone"}
    assert all(q["interfaces"] == {} for q in s["gruen"].values())
    # Each point of the bone is in one zone of each view.
    frontal, lateral = (
        sum(sum(s["gruen"][str(z)]["volume"].values()) for z in zones)
        for zones in (range(1, 8), range(8, 15))
    )
    assert frontal == pytest.approx(lateral, rel=0.01)
    density = s["gruen"]["4"]["strain_energy_density"]["cortical_bone"]
    assert density == pytest.approx(_beam(-127.0), rel=0.03)


def _beam(z: float) -> float:
    """Mean strain energy density of the cortex at a height, by the theory of beams [MPa].

    Zone 4 reaches from 2 mm above the stem's tip at -118 mm to 20 mm below it, so its middle is at
    -127 mm. The sections of the parametric femur are integrated over angles.
    """
    case = load_case(support.CONFIGS / "intact.yaml").config
    force, moment, at = np.zeros(3), np.zeros(3), np.array([0.0, 0.0, z])
    for pull in case.loads.values():
        assert isinstance(pull, Force)
        place = np.array(case.geometry.points.get(pull.boundary, pull.at))
        force += pull.force
        moment += np.cross(place - at, pull.force)
    theta = np.linspace(0.0, 2 * np.pi, 360, endpoint=False)
    heights = np.full_like(theta, z)
    outer = FemurBone().periosteum(theta, heights)
    inner = FemurBone().endosteum(theta, heights)
    area = np.pi * np.mean(outer**2 - inner**2)
    about_x = np.pi / 2 * np.mean((outer**4 - inner**4) * np.sin(theta) ** 2)
    about_y = np.pi / 2 * np.mean((outer**4 - inner**4) * np.cos(theta) ** 2)
    tension = force[2] ** 2 / (17000 * area)
    bending = moment[0] ** 2 / (17000 * about_x) + moment[1] ** 2 / (17000 * about_y)
    torsion = moment[2] ** 2 / (3300 * (about_x + about_y))
    return float((tension + bending + torsion) / (2 * area))


def check_hot(s: dict[str, Any]) -> None:
    """Temperatures stay between those of bone and cement at the start; the cement is hottest."""
    regions = s["thermal"]["regions"]
    assert regions["cement"]["temperature_max"] == pytest.approx(100, abs=1e-6)
    for r in regions.values():
        assert 37 - 1e-6 < r["temperature_min"] <= r["temperature_max"] < 100 + 1e-6
    for q in s["thermal"]["interfaces"].values():
        assert q["temperature_jump_max"] == pytest.approx(63, abs=1e-6)
        assert q["entropy_production_min"] >= -1e-12 * q["entropy_production_max"]


def check_rings(s: dict[str, Any]) -> None:
    """The peak of the bone is that of an independent solution in one dimension, to its error."""
    check_hot(s)
    q = s["thermal"]["interfaces"]["cement_bone"]
    # 50.6 to 52.6 for mantles of 2 to 5 mm with this conductance.
    assert 50.6 - 1.0 < q["temperature_max_second"] < 52.6 + 1.0
    assert 0 < q["temperature_max_second_error"] < 1.5


def check_cure(s: dict[str, Any]) -> None:
    """All cement sets and warms the bone, at most by the heat of cure."""
    cement = s["cure"]["cement"]
    assert 0.99 < cement["degree_min"] <= cement["degree_max"] <= 1
    assert 600 < cement["time_50"] < cement["time_90"] < 3000
    assert 45 < s["thermal"]["regions"]["cement"]["temperature_max"] < 22 + 90
    assert s["thermal"]["interfaces"]["cement_bone"]["temperature_max_second"] > 40


def check_residual(s: dict[str, Any]) -> None:
    """The cement has set and shrunk onto the stem, and transmits the hip force."""
    check_cure(s)
    assert s["interfaces"]["stem_cement"]["pressure_mean"] > 0.1
    stem = np.array(s["interfaces"]["stem_cement"]["force"])
    np.testing.assert_allclose(stem, HIP, rtol=0.05, atol=20)


def check_history(s: dict[str, Any], steps: int = 3) -> None:
    """After some steps all motion at a peak is permanent or inducible."""
    cycles = s["cycles"]["walking"]
    whole = cycles["permanent"]["stem"]["subsidence"] + cycles["inducible"]["stem"]["subsidence"]
    assert whole == pytest.approx(s["stem"]["subsidence"])
    assert len(cycles["dissipation"]) == steps - 1
    for name, inducible in cycles["inducible"].items():
        most = s["interfaces"].get(name, {}).get("motion_p99", np.inf)
        assert (
            0
            < inducible.get("motion_p99", 1e-9)
            < most + cycles["permanent"][name].get("motion_p99", 0)
        )


def check_bone(s: dict[str, Any]) -> None:
    """Bone is lost where the stem shields the cortex, and grows at the stem's end."""
    mass, zones = s["remodelling"]["mass"], s["gruen"]
    assert abs(mass["audit"]) < 1e-10 and s["remodelling"]["seconds"] == pytest.approx(2 * 31557600)
    assert (
        zones["6"]["bone_mass_change"]["cortical_bone"]
        < -0.005
        < zones["3"]["bone_mass_change"]["all"]
    )


def check_fatigue(summary: dict[str, Any]) -> None:
    """Rim and tip of the mantle have the most damage. A stumble does not break it."""
    assert summary["regions"]["cement"]["failure_probability"] < 1e-3
    for q in summary["fatigue"].values():
        assert 0 < q["damage_p99"] < q["damage_max"]
        assert max(q[part]["damage_max"] for part in ("rim", "tip")) > q["damage_max"]
    assert summary["fatigue"].keys() == {"verdonschot", "murphy"}


def check_debonding(summary: dict[str, Any]) -> None:
    """A weak bond is damaged on a part of its area, and the fracture energy is dissipated."""
    q = summary["interfaces"]["cement_bone"]
    assert 0 <= q["area_broken"] < q["area_damaged"]
    assert 0 < q["damage_mean"] < 1
    assert 0 < q["dissipation"]
    assert q["zone_elements"] == pytest.approx(q["zone_length"] / q["facet_size"])


def check_creep(s: dict[str, Any]) -> None:
    """Ten years of walking give a mean point a fraction of its elastic strain as creep."""
    assert s["creep"]["cycles"] == 1e7 and s["creep"]["dissipation"] > 0
    assert 1e-4 < s["regions"]["cement"]["creep_strain_mean"] < 2e-3
    assert s["stem"]["subsidence"] > 0.03


def check_strength(summary: dict[str, Any]) -> None:
    """Six times the stance fails a part of each bond, most at the rim. Layers have broken."""
    rigid = summary["name"] == "bonded"
    q = summary["bonds" if rigid else "interfaces"]["cement_bone"]
    assert q["failure_index_p99"] < q["rim"]["failure_index_p99"]
    assert 0 < q["strength_fraction"] < q["rim"]["strength_fraction"] < 1
    assert ("dissipation" in q) != rigid and q.get("dissipation", 1) > 0
    assert summary["balance"]["energy"] < 1e-9


def check_gait(s: dict[str, Any]) -> None:
    """The torque is a little above mu F R.

    The worn volume is k over mu times the work of friction.
    """
    q = s["interfaces"]["bearing"]
    assert 1.0 < q["torque_max"] / (0.06 * 3000 * 14) < 1.1
    assert q["wear_volume"] == pytest.approx(1.07e-9 / 0.06 * q["dissipation_cycle"], rel=1e-9)


def check_pressed(s: dict[str, Any]) -> None:
    """The head sinks like in an axisymmetric solution, `tests/reference/axisymmetric.py`."""
    centre = s["interfaces"]["bearing"]["centre"]
    assert centre[2] - 0.1 == pytest.approx(0.04538, rel=0.05)


def check_warm(s: dict[str, Any]) -> None:
    """After an hour neck and shell conduct the heat of friction.

    Their temperatures are those that this needs.
    """
    flows = s["thermal"]["flows"]["into"]
    assert flows["friction bearing"] == pytest.approx(
        s["interfaces"]["bearing"]["dissipation_cycle"]
    )
    assert sum(flows.values()) == pytest.approx(0, abs=0.01 * flows["friction bearing"])
    assert 40 < s["thermal"]["regions"]["head"]["temperature_end_max"] < 60


def check_drawn(s: dict[str, Any]) -> None:
    """Friction is mu N, and the last cycle equals the one before it."""
    assert s["interfaces"]["sole"]["force"] == pytest.approx([120, 0, -400], abs=1e-5)
    assert max(s["cycles"]["draw"]["change"]["sole"].values()) < 1e-6
    assert s["cycles"]["draw"]["dissipation"][-1] == pytest.approx(120 * 60, rel=1e-3)


def check_press_fit(s: dict[str, Any]) -> None:
    """The stem moves little, and less than including its insertion. The bone presses on it."""
    q = s["interfaces"]["stem_bone"]
    assert 0.001 < q["micromotion_mean"] < q["micromotion_p99"] < 0.1
    assert q["motion_p99"] > 0.02
    assert 1.0 < q["insertion_pressure_mean"] < 20.0
    assert "cement" not in s["regions"]
    assert "mantle" not in s


def check_gauges(s: dict[str, Any]) -> None:
    """Gauges agree with linear fits to the strain nearby. The shaft bends to medial."""
    for side, sign in (("medial", -1), ("lateral", 1)):
        for level in (40, 80):
            strain = s["probes"][f"{side}_{level}"]["strain"]
            assert strain * sign > 0
            assert strain == pytest.approx(s["femur"][f"strain_{side}_{level}"], rel=0.05)
    assert s["femur"]["head_displacement"][2] < 0


def check_collar(s: dict[str, Any]) -> None:
    """Collar and flanks carry the hip force along the shaft, which is the stem's axis."""
    check_press_fit(s)
    assert 0.1 < s["stem"]["collar_share"] < 0.6
    total = s["stem"]["collar_force"] / s["stem"]["collar_share"]
    assert total == pytest.approx(1747.8, rel=1e-6)


CHECKS: dict[str, Callable[[dict[str, Any]], None]] = {
    "iso_7206_4.yaml": check_bench,
    "iso_7206_6.yaml": check_neck,
    "stance.yaml": check_stance,
    "stance_cocr.yaml": check_stance,
    "pressed.yaml": check_press_fit,
    "collar.yaml": check_collar,
    "thin_femur.yaml": check_stance,
    "composite_intact.yaml": check_gauges,
    "composite_stem.yaml": check_gauges,
    "intact.yaml": check_intact,
    "variations.yaml": check_variations,
    "thermal_100C.yaml": check_hot,
    "thermal_rings.yaml": check_rings,
    "cure.yaml": check_cure,
    "history.yaml": check_history,
    "day.yaml": check_fatigue,
    "fatigue.yaml": check_fatigue,
    "debonding.yaml": check_debonding,
    "remodelling.yaml": check_bone,
    "creep_taper.yaml": check_creep,
    "life.yaml": check_creep,
    "interface_strength.yaml": check_strength,
    "head_cup.yaml": check_gait,
    "head_cup_heat.yaml": check_warm,
    "head_cup_static.yaml": check_pressed,
    "sliding_block.yaml": check_drawn,
    "walk.yaml": partial(check_history, steps=4),
    "residual.yaml": check_residual,
}


def test_run_covers_every_shipped_case() -> None:
    assert {p.name for p in support.CONFIGS.glob("*.yaml")} == COARSE.keys()


# Notes that are right. Coarsened, some cases are one linear cell thick.
TRUE_NOTES = (
    "linear cells of",
    "linear cells are then too stiff",
    "from memory",
    "creeps a",
    "the stem takes",
    "collar: rests on",
    "the law of one interface holds only as a mean",
    "the conductance does not change where the interface opens",
)
QUICK = ("blocks.yaml", "cylinders.yaml", "stance.yaml")


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n in QUICK else pytest.mark.slow) for n in COARSE]
)
def test_run_of_a_shipped_case(name: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = run(support.CONFIGS / name, "-o", out, *support.sets(*COARSE[name]))
    assert result.returncode == 0, result.stderr
    notes = [line for line in result.stderr.splitlines() if "note: " in line]
    assert all(any(words in note for words in TRUE_NOTES) for note in notes), notes
    assert (out / "DONE").exists()
    folders = {p.parent for p in out.glob("**/summary.json")}
    assert len(folders) == {"variations.yaml": 8, "interface_strength.yaml": 3}.get(name, 1)
    for folder in folders:
        assert (folder / "DONE").exists()
        summary = support.summary(folder) | {"name": folder.name}
        assert balanced(summary)
        exact = [q for q in summary["interfaces"].values() if not q["stored_energy"]]
        assert all(q["penetration_max"] < 1e-9 for q in exact)  # layers and bonds yield
        if name in CHECKS:
            CHECKS[name](summary)


def test_run_of_a_case_with_a_base_can_be_repeated(tmp_path: Path) -> None:
    new_case.write(tmp_path / "blocks", "blocks")
    new_case.write(tmp_path / "cylinders", "cylinders")
    over = tmp_path / "over.yaml"
    over.write_text("base: blocks.yaml\nregions: {metal: {material: CoCrMo}}\n", encoding="utf-8")
    first = mantle.run(mantle.load(over), tmp_path / "first")
    mantle.run(mantle.load(tmp_path / "first" / "case.yaml"), tmp_path / "again")
    assert frozen.numbers(tmp_path / "first") == frozen.numbers(tmp_path / "again")
    record = json.loads((tmp_path / "first" / "provenance.json").read_text(encoding="utf-8"))
    names = [Path(name).name for name in record["based_on_sha256"]]
    assert names == ["blocks.yaml", "library.yaml"]
    # A run is finished if its resolved case is equal, however the file is written.
    assert mantle.run(mantle.load(over), tmp_path / "first").summary == first.summary
    pushed = mantle.run(
        mantle.load(tmp_path / "cylinders.yaml", mesh__size="4 mm"), tmp_path / "pushed"
    )
    slip = pushed.summary["interfaces"]["stem_cement"]["slip_p99"]
    assert slip == pytest.approx(0.1, rel=0.02)  # all of the way that it is pushed


def test_run_of_a_run_imports_no_mesher_pictures_or_scipy(tmp_path: Path) -> None:
    """Each of these imports costs a tenth of a second or more."""
    path = support.CONFIGS / "blocks.yaml"
    case = load_case(path).config
    meshes.build(case.geometry, case.mesh, folders.cache("meshes"))
    script = (
        "import sys; from app.cli import main; "
        f"assert main(['run', {str(path)!r}, '-o', {str(tmp_path)!r}, "
        "'--set', 'output.report=false']) == 0; "
        "print(*sys.modules)"
    )
    loaded = set(support.python("-c", script).stdout.splitlines()[-1].split())
    assert "dolfinx" in loaded
    assert not loaded & {"gmsh", "matplotlib", "pandas", "pint", "scipy.sparse", "scipy.spatial"}


def test_run_of_a_parametric_femur_imports_nothing_for_patients() -> None:
    """Imports of the search for landmarks on a patient's bone take 0.15 s."""
    path = str(support.CONFIGS / "stance.yaml")
    script = (
        "import sys; from pathlib import Path; from app.case.case import load_case; "
        f"assert load_case(Path({path!r})).config.geometry.placement.top > 0; print(*sys.modules)"
    )
    loaded = set(support.python("-c", script).stdout.splitlines()[-1].split())
    assert "meshes.placement" in loaded
    for_patients = {
        f"scipy.{name}" for name in ("interpolate", "ndimage", "optimize", "signal", "stats")
    }
    assert not loaded & (for_patients | {"app.patient.bone"})
