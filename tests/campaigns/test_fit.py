"""``mantle fit``: known answers from a stand-in, verdicts, resumption, bad input."""

from __future__ import annotations

import json
import logging
import math
import os
import signal
import threading
from collections.abc import Sequence
from pathlib import Path
from random import Random
from typing import Any

import pytest

from app.campaigns import batch, fit, fit_verdicts
from app.campaigns.batch import Options
from app.campaigns.runs import Result
from app.case import fit as fit_file
from app.case.case import PlannedRun, plain_data
from app.cli import main
from app.foundation.errors import (
    ConvergenceError,
    InputError,
    MantleError,
    StoppedError,
    UnusableError,
)
from app.report import fit_report
from tests import support
from tests.campaigns.bench import FRICTION, Bench, wait

MODULUS = "regions.lower.youngs_modulus"


def means(friction: float, modulus: float, noise: float = 0.0) -> dict[str, float]:
    """Numbers of a model of two blocks: pressure and shear stress [MPa], slip [mm].

    Args:
        friction: Coefficient m.
        modulus: Modulus E [GPa].
        noise: Relative noise, the same for the same keys, as that of a mesh.
    """
    pressure = 2 * math.sqrt(modulus) * (1 + 0.3 * friction)
    exact = {
        "pressure_mean": pressure,
        "shear_mean": friction * pressure,
        "slip_mean": 0.01 / (modulus * (0.2 + friction)),
    }
    random = Random(f"{friction:.6g} {modulus:.6g}")
    return {key: value * (1 + noise * random.gauss()) for key, value in exact.items()}


MEASURED = means(0.45, 3.0)
PRESSURE = MEASURED["pressure_mean"]
SHEAR = MEASURED["shear_mean"]
SLIP = MEASURED["slip_mean"]
KEYS = f"""\
    {FRICTION}: {{low: 0.1, high: 0.9}}
    {MODULUS}: {{low: 1 GPa, high: 9 GPa, scale: logarithmic}}
"""
TARGETS = f"""\
    lower_upper.pressure_mean: {{value: {PRESSURE + 0.02} MPa, uncertainty: 0.04 MPa}}
    lower_upper.shear_mean: {{value: {SHEAR - 0.03} MPa, uncertainty: 0.04 MPa}}
    lower_upper.slip_mean: {{value: {1e3 * SLIP + 0.02} um, uncertainty: 0.05 um}}
"""


def file(keys: str = KEYS, targets: str = TARGETS, more: str = "") -> str:
    aim = f"  targets:\n{targets}" if targets else ""
    return f"base: case.yaml\nset: {{mesh.size: 3 mm}}\nfit:\n  keys:\n{keys}{aim}{more}"


@pytest.fixture
def noise(request: pytest.FixtureRequest) -> float:
    return float(getattr(request, "param", 0.0))


@pytest.fixture
def model(bench: Bench, noise: float, monkeypatch: pytest.MonkeyPatch) -> Bench:
    """The folder, in which `means` replaces the runs."""

    def run(planned: Sequence[PlannedRun], folder: Path, *options: object) -> list[Result]:
        folder.mkdir(exist_ok=True)
        results = []
        for each in planned:
            case = plain_data(each.case)
            modulus, _ = case["regions"]["lower"]["youngs_modulus"].split()
            law = case["interfaces"]["lower_upper"]
            numbers = means(law["friction_coefficient"], float(modulus) / 1e3, noise)
            summary: Any = {"interfaces": {"lower_upper": numbers}}
            results.append(Result(each, folder / "runs" / "one", 0, 1.0, summary, ""))
        return results

    monkeypatch.setattr(batch, "run", run)
    return bench


def search(bench: Bench, text: str, *overrides: str) -> Any:
    bench.write(**{"fit.yaml": text})
    return fit.run(bench.folder / "fit.yaml", overrides, Options(bench.out, 2))


def verdicts(record: Any) -> str:
    return "\n".join(v.get("where", "") + ": " + v["what"] for v in record["verdicts"])


@pytest.mark.parametrize("noise", [0.0, 0.002, 0.004], indirect=True)
def test_fit_recovers_friction_and_modulus_within_their_uncertainties(model: Bench) -> None:
    """The data have noise. The noise of the mesh is zero, or half of an uncertainty."""
    record = search(model, file())
    friction, modulus = record["keys"].values()
    assert abs(friction["number"] - 0.45) < 2 * friction["uncertainty"] < 0.05
    assert abs(modulus["number"] - 3.0) < 2 * modulus["uncertainty"] < 0.3
    assert friction["interval"][0] < 0.45 < friction["interval"][1]
    assert record["converged"] and not record["verdicts"]
    assert len(record["runs"]) <= 25
    assert record["misfit"] < 3.0
    best = next(run for run in record["runs"] if run["name"] == record["best"])
    assert best["values"] == {key: row["value"] for key, row in record["keys"].items()}
    fit_verdicts.raise_faults(record)


def test_fit_has_the_covariance_of_the_linear_problem(model: Bench) -> None:
    """Shear stress and pressure are exact data; derivatives are by hand."""
    pressure, shear = 2 * math.sqrt(3) * 1.135, 0.45 * 2 * math.sqrt(3) * 1.135
    targets = f"""\
    lower_upper.pressure_mean: {{value: {pressure} MPa, uncertainty: 0.04 MPa}}
    lower_upper.shear_mean: {{value: {shear} MPa, uncertainty: 0.04 MPa}}
"""
    record = search(model, file(targets=targets, more="  step: 0.005\n"))
    friction, modulus = record["keys"].values()
    assert friction["number"] == pytest.approx(0.45, abs=2e-3)
    assert modulus["number"] == pytest.approx(3.0, abs=2e-2)
    root = 2 * math.sqrt(3)
    by_friction = (0.3 * root, root * (1 + 0.6 * 0.45))
    by_modulus = (pressure / 6, shear / 6)
    determinant = by_friction[0] * by_modulus[1] - by_friction[1] * by_modulus[0]
    expected = 0.04 * math.hypot(*by_modulus) / abs(determinant)
    assert friction["uncertainty"] == pytest.approx(expected, rel=0.03)
    expected = 0.04 * math.hypot(*by_friction) / abs(determinant)
    assert modulus["uncertainty"] == pytest.approx(expected, rel=0.03)


def test_fit_names_a_key_without_influence(model: Bench) -> None:
    keys = KEYS + "    regions.upper.poisson_ratio: {low: 0.2, high: 0.4}\n"
    record = search(model, file(keys))
    (verdict,) = record["verdicts"]
    assert verdict["where"] == "regions.upper.poisson_ratio"
    assert "do not determine it: from one bound to the other (0.2 to 0.4)" in verdict["what"]
    assert "leave this key out" in verdict["remedy"]
    assert record["keys"]["regions.upper.poisson_ratio"]["uncertainty"] is None
    assert record["keys"][FRICTION]["uncertainty"] < 0.02
    with pytest.raises(UnusableError, match="poisson_ratio: the targets do not determine it"):
        fit_verdicts.raise_faults(record)


def test_fit_says_which_keys_its_targets_cannot_tell_apart(model: Bench) -> None:
    """One number rises with both keys."""
    targets = "    lower_upper.shear_mean: {value: 1.8 MPa, uncertainty: 0.04 MPa}\n"
    record = search(model, file(targets=targets))
    (verdict,) = record["verdicts"]
    assert verdict["where"] == f"{FRICTION}, {MODULUS}"
    assert verdict["what"].startswith(
        "2 keys and 1 targets: the targets do not determine these keys one by one"
    )
    assert "friction_coefficient against youngs_modulus" in verdict["what"]
    assert record["numbers"]["lower_upper.shear_mean"]["deviation"] == pytest.approx(0, abs=0.2)


def test_fit_says_that_a_target_cannot_be_reached_and_which_bound_stops_it(model: Bench) -> None:
    keys = KEYS.replace("high: 0.9", "high: 0.3")
    record = search(model, file(keys))
    texts = verdicts(record)
    assert f"{FRICTION}: is at its upper bound, 0.3" in texts
    assert "lower_upper.shear_mean: is 1.2" in texts and "cannot reach 1.739 MPa" in texts
    assert "uncertainties of 0.04 MPa remain" in texts
    with pytest.raises(UnusableError, match="widen the bounds"):
        fit_verdicts.raise_faults(record)


FRICTION_BY_SLIP = f"""\
base: case.yaml
set: {{mesh.size: 1 mm}}
fit:
  keys: {{{FRICTION}: {{low: 0.1, high: 0.9}}}}
  targets: {{lower_upper.slip_p99: {{value: 132 um, uncertainty: 3 um}}}}
"""


def test_fit_says_nothing_on_the_bound_of_a_key_that_is_not_determined(model: Bench) -> None:
    keys = KEYS + "    regions.upper.poisson_ratio: {low: 0.2, high: 0.4, start: 0.4}\n"
    record = search(model, file(keys))
    assert record["keys"]["regions.upper.poisson_ratio"]["at"] == "high"
    assert "bound, 0.4" not in verdicts(record) and "do not determine it" in verdicts(record)


def test_fit_goes_around_failed_runs_and_names_them(bench: Bench) -> None:
    """The slip is 0.04 * 0.99 / friction. The first difference fails, so the other side is run."""
    bench.write(broken="0.54", code="4")
    record = search(bench, FRICTION_BY_SLIP)
    (verdict,) = record["verdicts"]
    assert "1 of " in verdict["what"] and "block slides away" in verdict["what"]
    assert "start, +friction_coefficient" in verdict["what"]
    assert any(run["name"] == "start, -friction_coefficient" for run in record["runs"])
    assert record["keys"][FRICTION]["number"] == pytest.approx(0.3, abs=0.002)
    fit_verdicts.raise_faults(record)


def test_fit_whose_first_run_fails_asks_for_another_start(bench: Bench) -> None:
    bench.write(broken="0.5", code="4")
    with pytest.raises(ConvergenceError, match=r"first run failed: .*slides.*another start"):
        search(bench, FRICTION_BY_SLIP)


def test_fit_out_of_runs_has_its_best_run_and_continues(bench: Bench) -> None:
    record = search(bench, FRICTION_BY_SLIP, "fit.runs=3")
    assert len(record["runs"]) <= 3 and not record["converged"]
    assert record["misfit"] == min(run["misfit"] for run in record["runs"])
    with pytest.raises(ConvergenceError, match=r"fit.runs above 3; run the same command again to"):
        fit_verdicts.raise_faults(record)
    done = {p: p.stat().st_mtime_ns for p in bench.finished()}
    record = search(bench, FRICTION_BY_SLIP)
    assert record["converged"] and len(bench.finished()) == len(record["runs"])
    assert {p: p.stat().st_mtime_ns for p in done} == done


def test_fit_interrupted_resumes_from_the_runs_on_disk(bench: Bench) -> None:
    """All runs but the first wait for a file; a signal stops them."""
    bench.write(awaited="nothing")

    def interrupt() -> None:
        wait(bench.finished)
        os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(StoppedError, match="run the same command again"):
        search(bench, FRICTION_BY_SLIP)
    thread.join()
    done = {p: p.stat().st_mtime_ns for p in bench.finished()}
    bench.write(awaited=".")
    record = search(bench, FRICTION_BY_SLIP)
    assert done and {p: p.stat().st_mtime_ns for p in done} == done
    again = search(bench, FRICTION_BY_SLIP)
    assert again["runs"] == record["runs"]
    assert len(bench.finished()) == len(record["runs"])


def test_fit_minimises_a_key_under_a_constraint(model: Bench) -> None:
    """The softest block has a pressure of 4 MPa or more at friction 0.9: sqrt(E) = 2 / 1.27."""
    text = file(targets="", more=f"  minimise: {MODULUS}\n  constraints:\n")
    text += "    lower_upper.pressure_mean: {at_least: 4 MPa}\n"
    record = search(model, text)
    modulus = record["keys"][MODULUS]["number"]
    assert modulus == pytest.approx((2 / 1.27) ** 2, rel=0.02)
    assert record["keys"][FRICTION]["at"] == "high"
    assert record["numbers"]["lower_upper.pressure_mean"]["value"] >= 4.0
    assert record["misfit"] is None and len(record["runs"]) <= 40
    fit_verdicts.raise_faults(record)


def test_fit_maximises_a_number_between_bounds(model: Bench) -> None:
    """The shear stress is largest at a pressure of 4 MPa.

    Both keys follow from this active bound.
    """
    text = file(targets="", more="  maximise: lower_upper.shear_mean\n  constraints:\n")
    text += "    lower_upper.pressure_mean: {at_least: 1 MPa, at_most: 4 MPa}\n"
    record = search(model, text)
    assert record["numbers"]["lower_upper.shear_mean"]["value"] == pytest.approx(3.6, rel=0.02)
    assert record["numbers"]["lower_upper.pressure_mean"]["value"] <= 4.0


def test_fit_without_a_run_that_meets_the_constraints_names_the_closest(model: Bench) -> None:
    text = file(targets="", more=f"  minimise: {MODULUS}\n  constraints:\n")
    text += "    lower_upper.pressure_mean: {at_least: 40 MPa}\n"
    record = search(model, text)
    words = r"no run meets all constraints; .* 7.6\d* MPa, and it must be at least 40 MPa"
    with pytest.raises(UnusableError, match=words):
        fit_verdicts.raise_faults(record)


def test_fit_of_a_minimum_out_of_runs_has_its_best_run(model: Bench) -> None:
    text = file(targets="", more=f"  minimise: {MODULUS}\n  runs: 6\n  constraints:\n")
    record = search(model, text + "    lower_upper.pressure_mean: {at_least: 4 MPa}\n")
    assert len(record["runs"]) <= 6 and not record["converged"]
    feasible = [r for r in record["runs"] if r["numbers"]["lower_upper.pressure_mean"] >= 4]
    assert record["best"] == min(feasible, key=lambda r: r["shares"][1])["name"]
    with pytest.raises(ConvergenceError, match=r"fit.runs above 6"):
        fit_verdicts.raise_faults(record)


def test_fit_of_a_key_without_constraints_goes_to_its_bound(model: Bench) -> None:
    record = search(model, file(targets="", more=f"  maximise: {FRICTION}\n"))
    assert record["keys"][FRICTION]["at"] == "high"
    texts = verdicts(record)
    assert f"{MODULUS}: has no influence on the numbers" in texts


def test_fit_writes_json_csv_table_and_page(model: Bench, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "mantle")
    record = search(model, file())
    assert json.loads((model.out / "fit.json").read_text()) == record
    rows = (model.out / "fit.csv").read_text().splitlines()
    assert rows[0].startswith(f"run,{FRICTION},{MODULUS},lower_upper.pressure_mean [MPa],")
    assert len(rows) == 1 + len(record["runs"])
    texts = "\n".join(caplog.messages)
    assert "start: friction_coefficient 0.5, youngs_modulus 3 GPa: " in texts
    assert "95 % interval" in texts and "to repeat it: mantle run " in texts
    assert main(["report", str(model.out)]) == 0
    html = (model.out / fit_report.PAGE).read_text()
    for words in ("Fitted keys", "95 % interval", "Path of the search", "data:image/png"):
        assert words in html


def test_fit_page_of_a_minimum_names_its_objective(model: Bench) -> None:
    text = file(targets="", more=f"  minimise: {MODULUS}\n  constraints:\n")
    search(model, text + "    lower_upper.pressure_mean: {at_least: 4 MPa}\n")
    html = fit_report.write(model.out).read_text()
    assert f"{MODULUS} is the smallest of all runs that meet the constraints." in html


def test_fit_dry_run_lists_the_first_run(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "mantle")
    bench.write(**{"fit.yaml": file()})
    options = Options(bench.out, 2, dry_run=True)
    assert fit.run(bench.folder / "fit.yaml", (), options) is None
    assert "the first of at most 40 runs" in caplog.text and not bench.out.exists()


def test_fit_of_a_number_that_runs_do_not_have_is_refused_at_its_place(model: Bench) -> None:
    targets = "    stem.subsidence: {value: 30 um, uncertainty: 3 um}\n"
    model.write(**{"fit.yaml": file(targets=targets)})
    with pytest.raises(InputError, match=r"fit.yaml:8:5: fit.targets.stem.subsidence: the geom"):
        fit_file.read(model.folder / "fit.yaml")
    targets = "    upper.hoop_p99: {value: 30 MPa, uncertainty: 3 MPa}\n"
    with pytest.raises(InputError, match=r"fit.yaml:8:5: .*is not in summary.json of this case"):
        search(model, file(targets=targets))


BAD = {
    "unknown key": (
        KEYS.replace(FRICTION, FRICTION + "s"),
        TARGETS,
        "",
        "fit.yaml:5:5: fit.keys.interfaces.lower_upper.friction_coefficients: unknown key",
    ),
    "unknown number": (
        KEYS,
        TARGETS.replace("shear_mean", "shear_men"),
        "",
        "fit.yaml:9:5: fit.targets.lower_upper.shear_men: 'lower_upper.shear_men' is not "
        "<interface>.<key>, <region>.<key> or stem.<key>; did you mean 'shear_mean'?",
    ),
    "reversed": (
        KEYS.replace("low: 0.1, high: 0.9", "low: 0.9, high: 0.1"),
        TARGETS,
        "",
        f"fit.yaml:5:5: fit.keys.{FRICTION}: 0.9 is not below 0.1",
    ),
    "outside": (
        KEYS.replace("low: 0.1", "low: -0.1"),
        TARGETS,
        "",
        f"fit.yaml:5:51: fit.keys.{FRICTION}.low: -0.1 must not be negative",
    ),
    "start": (
        KEYS.replace("high: 0.9", "high: 0.9, start: 0.95"),
        TARGETS,
        "",
        "start: 0.95 is not within the bounds, 0.1 to 0.9",
    ),
    "unit of start": (
        KEYS.replace("high: 9 GPa", "high: 9 GPa, start: 900 MPa"),
        TARGETS,
        "",
        "start: '900 MPa' is not a number with the unit GPa of the bounds",
    ),
    "no uncertainty": (
        KEYS,
        "    lower_upper.slip_mean: {value: 5 um}\n",
        "",
        "fit.yaml:8:5: fit.targets.lower_upper.slip_mean: 'uncertainty' is missing; expected: "
        "standard uncertainty of the value",
    ),
    "no certainty": (
        KEYS,
        "    lower_upper.slip_mean: {value: 5 um, uncertainty: 0 um}\n",
        "",
        "fit.targets.lower_upper.slip_mean.uncertainty: '0 um' is not positive",
    ),
    "unit": (
        KEYS,
        "    lower_upper.slip_mean: {value: 5 MPa, uncertainty: 1 um}\n",
        "",
        "fit.targets.lower_upper.slip_mean.value: '5 MPa' is not a length",
    ),
    "no aim": (KEYS, "", "", "fit.yaml:3:1: fit: expected one of targets, minimise and maximise"),
    "two aims": (KEYS, TARGETS, f"  minimise: {MODULUS}\n", "expected one of targets, minimise"),
    "constraint": (
        KEYS,
        TARGETS,
        "  constraints:\n    lower_upper.slip_mean: {at_most: 5 um}\n",
        "fit.constraints: need minimise or maximise",
    ),
    "no bound": (
        KEYS,
        "",
        f"  minimise: {MODULUS}\n  constraints:\n    lower_upper.slip_mean: {{}}\n",
        "fit.constraints.lower_upper.slip_mean: has no bound; expected at_least, at_most or both",
    ),
    "reversed constraint": (
        KEYS,
        "",
        f"  minimise: {MODULUS}\n  constraints:\n"
        "    lower_upper.slip_mean: {at_least: 5 um, at_most: 4 um}\n",
        "at_least: '5 um' is above at_most",
    ),
    "run": (
        KEYS,
        "",
        "  minimise: timing.total\n",
        "fit.minimise: timing.total describes the run, not the model",
    ),
    "few runs": (KEYS, TARGETS, "  runs: 2\n", "fit.runs: 2 runs are too few for the start and"),
    "large step": (KEYS, TARGETS, "  step: 0.7\n", "fit.step: 0.7: input should be less than"),
}


@pytest.mark.parametrize("name", BAD)
def test_fit_bad_input_is_refused_at_its_place(name: str, bench: Bench) -> None:
    keys, targets, more, words = BAD[name]
    path = bench.folder / "fit.yaml"
    path.write_text(file(keys, targets, more))
    with pytest.raises(InputError) as error:
        fit_file.read(path)
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("command", "content", "words"),
    [
        ("fit", "base: case.yaml\ngrid: {mesh.size: [1 mm]}\n", "expected a fit file: base: CASE"),
        ("sweep", file(), "this is a fit: use mantle fit"),
        ("run", file(), "is a fit file, not a case; use mantle fit"),
    ],
)
def test_fit_files_and_others_are_told_apart(
    command: str, content: str, words: str, bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    bench.write(**{"other.yaml": content})
    assert main([command, str(bench.folder / "other.yaml")]) == InputError.exit_code
    assert words in capsys.readouterr().err


@pytest.mark.parametrize("name", ["push_in", "thinnest"])
def test_fit_files_that_are_shipped_are_valid(name: str) -> None:
    assert fit_file.read(support.CONFIGS / "fits" / f"{name}.yaml").fit.keys


def test_fit_set_of_a_fitted_key_is_refused(bench: Bench) -> None:
    bench.write(**{"fit.yaml": file()})
    with pytest.raises(MantleError, match=r"--set .*fixes it for every case"):
        fit_file.read(bench.folder / "fit.yaml", [f"{FRICTION}=0.3"])


@pytest.mark.slow  # 12 runs of 2 s
def test_fit_of_a_push_in_test_recovers_friction_and_modulus(tmp_path: Path) -> None:
    """The data of the shipped file are those of 0.35 and 2.5 GPa with noise."""
    path = support.CONFIGS / "fits" / "push_in.yaml"
    record: Any = fit.run(path, (), Options(tmp_path / "out", 2))
    friction, modulus = record["keys"].values()
    assert abs(friction["number"] - 0.35) < 2 * friction["uncertainty"] < 0.03
    assert abs(modulus["number"] - 2.5) < 2 * modulus["uncertainty"] < 0.3
    assert record["converged"] and len(record["runs"]) <= 25 and not record["verdicts"]


@pytest.mark.slow  # 12 runs of 2 s, each on another mesh
def test_fit_finds_the_thinnest_ring_of_a_shrink_fit(tmp_path: Path) -> None:
    """Lame's pressure in plane strain (`configs/verification/lame_plane_strain.yaml`)."""
    core, ring, nu, delta, b = 110e3, 2200.0, 0.3, 0.01, 7.0

    def pressure(thickness: float) -> float:
        c = b + thickness + 1.5
        of_ring = (1 + nu) / ring * ((1 - 2 * nu) * b**2 + c**2) / (c**2 - b**2)
        return delta / b / (of_ring + (1 + nu) * (1 - 2 * nu) / core)

    assert pressure(1.5) == pytest.approx(1.02740, abs=1e-5)
    (tmp_path / "fit.yaml").write_text(f"""\
base: {support.CONFIGS / "verification" / "lame_plane_strain.yaml"}
set: {{output.fields: false}}
fit:
  keys: {{geometry.cement_thickness: {{low: 1 mm, high: 4 mm}}}}
  minimise: geometry.cement_thickness
  constraints: {{stem_cement.pressure_mean: {{at_least: {pressure(2.0)} MPa}}}}
""")
    record: Any = fit.run(tmp_path / "fit.yaml", (), Options(tmp_path / "out", 2))
    thickness = record["keys"]["geometry.cement_thickness"]["number"]
    assert thickness == pytest.approx(2.0, abs=0.03)
    assert record["numbers"]["stem_cement.pressure_mean"]["value"] >= pressure(2.0)
    assert record["converged"] and not record["verdicts"]
