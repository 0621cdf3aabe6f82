"""``report.html`` of a run: its first sentence, its numbers, no external files."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest

import mantle
from app.campaigns import uncertainty
from app.case.points import UncertainInputs
from app.case.quantities import TABLE
from app.cli import main
from app.foundation.verdict import Verdict, note
from app.plots import curves
from app.report import lead, pictures, run_report, step_curves, viewer
from app.report.input_spread import InputSpread
from app.report.page import Bullets, PageSection, table
from app.report.page import page as page_of
from app.report.sweep_results import CONVERGED, SweptCase
from app.results import verdicts
from app.schema import yaml_file
from tests.patient.bones import moved, parametric_femur, write
from tests.support import CONFIGS, summary

COARSE = {"mesh.size": "4 mm", "mesh.far_size": "6 mm", "mesh.order": 1}


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of cylinders whose title contains HTML."""
    out = tmp_path_factory.mktemp("run") / "out"
    title = "<script>alert(1)</script> & stem"
    mantle.run(mantle.load(CONFIGS / "cylinders.yaml", **COARSE, title=title), out)
    return out


def page(folder: Path) -> str:
    return (folder / "report.html").read_text()


def shown(html: str) -> str:
    """The text of a page."""
    return re.sub(r"<[^>]+>", " ", re.sub(r"<style>.*?</style>", "", html, flags=re.S))


def changed(done: Path, folder: Path, numbers: dict[str, Any]) -> str:
    """The page of a run with another summary."""
    shutil.copytree(done, folder, ignore=shutil.ignore_patterns("*.vtkhdf"))
    (folder / "summary.json").write_text(json.dumps(numbers))
    run_report.write(folder, 0.0)
    return page(folder)


def test_run_report_page_is_self_contained(done: Path) -> None:
    html = page(done)
    assert len(html) < 3e6
    outside_scripts = re.sub(
        r"<script.*?</script>", "", html, flags=re.S
    )  # the view: `test_viewer.py`
    assert not re.search(r"https?:|<script|<link|@import|url\(", outside_scripts)
    assert "default-src 'none'" in html  # and what the view asks of others is refused
    assert all(s.startswith("data:") for s in re.findall(r'src="([^"]*)"', html))
    ids = re.findall(r'\bid="([^"]*)"', html)
    assert len(ids) == len(set(ids)) > 4
    assert set(re.findall(r'href="#([^"]*)"', html)) <= set(ids)
    assert "&lt;script&gt;alert(1)" in html
    assert not list(done.glob("*.partial")) and not (done / "report").exists()
    assert (done / "case.png").exists() and "Bodies, supports and loads" in html
    assert html.count("Jasty") == 1  # why 30 um


def test_run_report_numbers_equal_the_summary(done: Path) -> None:
    html, numbers = shown(page(done)), summary(done)
    slip = TABLE["interfaces"]["slip_p99"].text(numbers["interfaces"]["stem_cement"])
    words = " ".join(html.split())
    assert f"{slip} µm slip of the stem in its cement 99 % of the surface slips less." in words
    assert "mesh and step: errors are not estimated; run with --error" in html
    for place, key in (("stem_cement", "pressure_p95"), ("cement_bone", "slip_max")):
        assert TABLE["interfaces"][key].text(numbers["interfaces"][place]) in html
    assert TABLE["regions"]["von_mises_p99"].text(numbers["regions"]["cement"]) in html
    assert "equilibrium: satisfied to rounding" in html and "youngs_modulus: 110000.0 MPa" in html
    assert "Gruen" not in html and "Temperatures" not in html and "Dead bone" not in html
    drawings = re.findall(r'<svg viewBox="0 0 340 .*?</svg>', page(done), re.S)
    assert any("slip, 99th percentile (µm)" in d and "stem-cement" in d for d in drawings)
    assert all("xmlns" not in d and " id=" not in d for d in drawings)


def test_run_report_command_draws_maps_and_files(
    done: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A copy of the folder suffices for the report."""
    copy = tmp_path / "elsewhere"
    shutil.copytree(done, copy)
    (copy / "report.html").unlink()
    assert main(["report", str(copy)]) == 0
    assert capsys.readouterr().out.splitlines()[0] == str(copy / "report.html")
    names = {p.name for p in (copy / "report").iterdir()}
    pictures = ("curves", "interfaces", "map_stem_cement", "map_cement_bone")
    assert names == {f"{name}.{suffix}" for name in pictures for suffix in ("png", "svg", "pdf")}
    assert page(copy).count("data:image/png") == 4 and len(page(copy)) < 3e6


def test_run_report_can_be_switched_off(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A report that fails is a warning."""
    case = mantle.load(CONFIGS / "blocks.yaml", **{**COARSE, "output.report": False})
    mantle.run(case, tmp_path / "out")
    assert not (tmp_path / "out" / "report.html").exists()
    run_report.after_run(tmp_path / "nothing", MPI.COMM_SELF)
    assert "report.html was not written" in caplog.text


def test_run_report_without_3d_view_gives_the_reason(
    done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Units have their usual spelling."""

    def broken(folders: dict[str, Path]) -> str:
        raise IndexError("no <such> cell")

    numbers = summary(done)
    numbers["interfaces"]["stem_cement"]["penetration_max"] = 2e-3
    verdicts.record_verdicts(numbers, [note("a of 37 degC and 5 mm^2, um")])
    monkeypatch.setattr(viewer, "viewer", broken)
    html = changed(done, tmp_path / "run", numbers)
    assert "no view in three dimensions: IndexError: no &lt;such&gt; cell" in html
    assert 'id="view"' not in html and "equilibrium: satisfied to rounding" in html
    assert "bodies overlap by 2 µm at nodes" in html and "a of 37 °C and 5 mm², um" in html


def test_run_report_errors_are_in_the_verdicts(done: Path, tmp_path: Path) -> None:
    numbers = summary(done)
    interfaces, regions = numbers["interfaces"], numbers["regions"]
    peaks = {"stem_cement.gap_max": [[4.0, 0.0123], [8.0, 0.009]]}
    peaks |= {f"{name}.von_mises_max": [[4.0, 20.0], [12.0, 9.0]] for name in regions}
    error = {"companions": ["mesh 8 mm"], "failed": [], "unsettled": peaks}
    numbers["error"] = error
    for q in interfaces.values():
        q["slip_p99_error"] = 0.02 * q["slip_p99"]
    interfaces["cement_bone"]["pressure_p95_error"] = 10.0
    verdicts.record_verdicts(numbers, [])
    html = shown(changed(done, tmp_path / "run", numbers))
    line = "mesh and step: half of the percentiles have errors below ± 2 %; the largest error is"
    assert line in html
    line = "maxima that still change with the mesh: stem-cement gap 12.3 µm at 4 mm, 9.0 at 8"
    assert line in html and " ± " in html
    # The table has all of them.
    rows = " ".join(html[html.index("Maxima that still change with the mesh") :].split())
    assert "mesh 4 mm 8 mm 12 mm stem-cement gap, max (µm) 12.3 9.0 - " in rows
    assert all(f"{name} von Mises stress, max (MPa) 20.00 - 9.00" in rows for name in regions)

    assert "stem_cement" not in html[: html.index("Numbers")]

    numbers["error"] = error | {"companions": ["mesh 4 mm, 0.5 times"], "sources": "load step"}
    verdicts.record_verdicts(numbers, [])
    html = shown(changed(done, tmp_path / "steps", numbers))
    assert "load step: half" in html and "the error of the mesh is not estimated" in html


MODULUS = "regions.bone.youngs_modulus"
FRICTION = "interfaces.stem_cement.friction_coefficient"


def samples(run: Path, folder: Path, number: int = 20, thickness: str = "4.0 mm") -> Path:
    """A sweep: slip is 2, 4, ... um with the modulus of bone, and the gap falls with friction."""
    rows: list[dict[str, Any]] = []
    for k, other in ((k, 7 * k % 20) for k in range(number)):  # orders without relation
        case, numbers, sample = (
            yaml_file.read(run / "case.yaml").data,
            summary(run),
            folder / str(k),
        )
        case["geometry"]["cement_thickness"], case["mesh"]["size"] = thickness, "6.0 mm"
        case["regions"]["bone"]["youngs_modulus"] = f"{k + 1} MPa"
        case["interfaces"]["stem_cement"]["friction_coefficient"] = 0.01 * other
        law = {"slip_p99": 2e-3 * (k + 1), "gap_p99": -2e-3 * other}
        numbers["interfaces"]["stem_cement"] |= law
        sample.mkdir(parents=True)
        (sample / "case.yaml").write_text(yaml_file.to_yaml(case))
        (sample / "summary.json").write_text(json.dumps(numbers))
        rows.append({"name": sample.name, "folder": sample.name, "part": "", "status": "converged"})
        changes = {MODULUS: f"{k + 1} MPa", FRICTION: 0.01 * other}
        rows[-1] |= {"exit_code": 0, "numbers": law, "overrides": changes}
    rows.append(rows[-1] | {"name": "lost", "status": "not converged", "exit_code": 4})
    spreads = uncertainty.of_parts(rows, {"": UncertainInputs((MODULUS, FRICTION))})
    (folder / "sweep.json").write_text(json.dumps({"cases": rows, "uncertainty": spreads}))
    return folder


def test_run_report_folds_many_notes(done: Path, tmp_path: Path) -> None:
    numbers = summary(done)
    verdicts.record_verdicts(numbers, [note(f"number {k}") for k in range(4)])
    html = changed(done, tmp_path / "four", numbers)
    folded = re.search(
        r"<details><summary>4 notes on the input</summary>(.*?)</details>", html, re.S
    )
    assert folded and folded[1].count("number") == 4
    verdicts.record_verdicts(numbers, [note("number 1")])
    assert "notes on the input" not in changed(done, tmp_path / "one", numbers)


def test_run_report_failure_begins_with_its_cause(done: Path, tmp_path: Path) -> None:
    lost = Verdict("nothing holds body 'a'", "no convergence in stage 'b'", "hold it")
    numbers = {"status": "not converged", "time": 0.0, "timing": {"total": 1.0}, "interfaces": {}}
    numbers["verdicts"] = [lost.record(), Verdict("plain Newton only", "tried").record()]
    html = changed(done, tmp_path / "failed", numbers).replace("&#39;", "'")
    cause = "No convergence in stage 'b': nothing holds body 'a'. What to do: hold it."
    assert f'<p class="lead">{cause}</p>' in html and html.count("nothing holds") == 1
    assert '<span class="bad">not converged</span>' in html and "tried: plain Newton" in html


def test_run_report_draws_all_cycles_after_cooling() -> None:
    written = {"time [-]": [1, 1.5, 2], "seconds [s]": [9] * 3, "stem subsidence [mm]": [1, 2, 3]}
    columns = {key: np.array(values) for key, values in written.items()}
    panel = step_curves.over_time(columns)[0]
    assert panel.lines[0].x == [1, 1.5, 2] and "stage" in panel.x


def test_run_report_necrosis_has_a_spread(tmp_path: Path) -> None:
    """Of 0, 2 .. 18 mm3 the 5 and 95 % are 0.9 and 17.1.

    Groups by kinetics leave 9 of 82.5 of the variance of ranks.
    """
    key, of = "necrosis_47C_1min_volume", {"regions.cement.kinetics": [*"aaabbbcccc"]}
    numbers = [{f"bone.{key}": 2.0 * k} for k in range(10)]
    samples = [SweptCase("", tmp_path, CONVERGED, numbers=of_sample) for of_sample in numbers]
    summary = {"thermal": {"regions": {"bone": {key: 2.0}}}}
    blocks = run_report._tables(summary, all_parts=False, spread=InputSpread(samples, 10, of))
    follows = f"cement kinetics ({(1 - 9 / 7 / (82.5 / 9)) ** 0.5:+.2f})"
    name = "bone dead by 47 °C for 1 min, volume (mm³)"
    assert [name, "2.0", "-", "0.9 to 17.1", follows] in blocks[-1].rows


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (
            4.0,
            "Inputs matter more than the mesh: half the range from 5 to 95 % over 2 inputs exceeds"
            " the ± for 2 of 2 main numbers; the median ratio is 4.3; ",
        ),
        (40.0, "The mesh matters more than the inputs: half the range from 5 to 95 %"),
        (0.0, "The ± of main numbers was not estimated, so the two are not compared; "),
    ],
)
def test_run_report_inputs_next_to_mesh_errors(
    error: float, sentence: str, done: Path, tmp_path: Path
) -> None:
    """Percentiles of 2, 4 .. 40 by linear interpolation are 3.9 and 38.1; half of that is 17.1."""
    numbers = summary(done)
    errors = {f"{key}_p99_error": 1e-3 * error for key in ("slip", "gap")}
    numbers["interfaces"]["stem_cement"] |= errors | {"slip_p99": 0.05}
    changed(done, tmp_path / "run", numbers)
    run_report.write(tmp_path / "run", 0.0, samples(done, tmp_path / "sweep"))
    text = " ".join(shown(page(tmp_path / "run")).split())
    row = f"stem-cement slip, p99 (µm) 50.0 {error or '-'} 3.9 to 38.1 bone youngs modulus (+1.00)"
    assert sentence in text and row in text
    assert "-36.1 to -1.9 friction coefficient, stem-cement (-1.00)" in text


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ((20, "3.0 mm"), "is of another case than RUN: geometry.cement_thickness is 3 mm there"),
        ((9,), "9 samples converged; the 5th and 95th percentile need 10"),
        ((2,), "expected one part with converged samples (latin_hypercube)"),
        ((), "--spread: expected one DIR, the folder of a run"),
    ],
)
def test_run_report_refuses_a_sweep_of_another_case(
    more: tuple[Any, ...], message: str, done: Path, tmp_path: Path, capsys: Any
) -> None:
    sweep = samples(done, tmp_path / "sweep", *more)
    assert main(["report", str(done if more else sweep), "--spread", str(sweep)]) == 2
    assert message.replace("RUN", str(done)) in capsys.readouterr().err


def test_run_report_unusable_results_are_red(done: Path, tmp_path: Path) -> None:
    stopped = {"status": "stopped", "verdicts": [Verdict("stopped by SIGTERM").record()]}
    html = changed(done, tmp_path / "stop", summary(done) | stopped)
    assert '<span class="open">stopped</span>: the numbers are those of the last' in html
    assert "stopped by SIGTERM" in html and "equilibrium: satisfied" not in html
    numbers = summary(done) | {"status": "do not use"}
    numbers["balance"]["force"] = 1.0
    verdicts.record_verdicts(numbers, [])
    html = changed(done, tmp_path / "lost", numbers)
    text = "equilibrium: NOT satisfied: relative error of force 1.0e+00; allowed 1e-08"
    assert f'<span class="bad">do not use</span>: {text}' in html


def test_run_report_loads_of_ended_runs(done: Path) -> None:
    case = run_report.opened(done)
    case.__dict__["data"] = {"loads": {"hip": {"force": ["0 N", "0 N", "-900 N"]}}}
    numbers = summary(done)
    assert lead.loads(case, numbers) == "Hip force: 900 N."
    assert lead.loads(case, numbers | {"status": "stopped"}) == ""
    # Of several the largest, and their sum.
    case.data["loads"]["glutei"] = {"force": ["300 N", "0 N", "500 N"]}
    assert lead.loads(case, numbers) == "Hip force: 900 N. Sum of all 2 loads: 500 N."
    case.data["loads"]["push"] = {"kind": "pressure", "pressure": "1 MPa"}
    assert lead.loads(case, numbers) == "Hip force: 900 N."
    case.data["loads"]["glutei"]["force"] = ["0 N", "0 N", "70 N"]
    case.data["geometry"] = {"sector": "half"}
    del case.data["loads"]["hip"]
    words = "Largest load (glutei): 70 N on the half that is modelled."
    assert lead.loads(case, numbers) == words


def test_run_report_of_heat_and_mechanics(tmp_path: Path) -> None:
    numbers: dict[str, Any] = {"status": "converged", "interfaces": {}}
    numbers |= {"thermal": {"regions": {}}, "cure": {}}
    bone = {f"seconds_over_{t}": s for t, s in ((47, 174.0), (50, 116.0), (56, 0.0))}
    bone |= {"temperature_max": 54.16, "temperature_max_error": 0.5}
    bone |= {"necrosis_47C_1min_volume": 2583.0, "necrosis_cem43_16_volume": 4000.0}
    numbers["thermal"]["regions"] = {"bone": bone}
    numbers["cure"] = {"cement": {"degree_min": 0.99996}}
    hot, dead, cured = lead.large_numbers(numbers)
    assert (hot.value, hot.unit, hot.error) == ("54.2", "°C", "± 0.5 °C")
    assert hot.detail == "For up to 174 s above 47 °C, 116 s above 50 °C."
    assert (dead.value, dead.unit, dead.caption) == ("2,583", "mm³", "dead bone")
    assert dead.detail == "By the rule of 47 °C for 1 min. By other rules 0 to 4,000 mm³."
    assert (cured.value, cured.caption) == ("99.9", "least degree of cure of cement")


def test_run_report_of_heat_alone(tmp_path: Path) -> None:
    stages = [{"name": "hot", "duration": "20 s"}]
    rings = mantle.load(CONFIGS / "thermal_rings.yaml", **COARSE, stages=stages)
    mantle.run(rings, tmp_path / "out")
    html = page(tmp_path / "out")
    assert "highest temperature (°C)" in html and "Temperatures" in html and "Dead bone" in html
    assert "highest temperature of the bone" in html and "time (s)" in html


def test_run_report_of_variations(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    varied = {
        "bonded": {"interfaces.stem_cement": {"kind": "bonded"}},
        "smooth": {"interfaces.stem_cement.friction_coefficient": 0.2},
    }
    out = tmp_path / "out"
    mantle.run(mantle.load(CONFIGS / "cylinders.yaml", **COARSE, variations=varied), out)
    html = page(out)
    for name in varied:
        assert f'<a href="{name}/report.html">{name}</a>' in html
        assert "Input" in page(out / name)
    n = 1e3 * summary(out / "smooth")["interfaces"]["stem_cement"]["slip_p99"]
    assert f"{n:.4g}" in html and "2 of 2 variations converged" in html
    monkeypatch.setattr(pictures, "maps", lambda *given: ([], []))  # others test it
    assert main(["report", str(out)]) == 0
    assert "bonded/report.html" in capsys.readouterr().out


@pytest.mark.parametrize(
    "ends, ticks",
    [
        ((0.0, 2.0), [0.0, 0.5, 1.0, 1.5, 2.0]),
        ((0.0, 97.3), [0.0, 20.0, 40.0, 60.0, 80.0, 100.0]),
        ((37.0, 37.0), [30.0, 40.0]),
        ((-3e-9, 4e-9), [-4e-9, -2e-9, 0.0, 2e-9, 4e-9]),
    ],
)
def test_run_report_ticks_are_round(ends: tuple[float, float], ticks: list[float]) -> None:
    placed = curves.ticks(*ends)
    assert placed[: len(ticks)] == ticks and placed[0] <= ends[0] and placed[-1] >= ends[1]
    assert 2 <= len(placed) <= 9


def test_run_report_has_landmarks_if_the_files_of_the_case_are_there(tmp_path: Path) -> None:
    """The picture of the case needs the files of the case."""
    (tmp_path / "case.yaml").write_text("base: stance")
    config, _ = run_report._read_config(tmp_path)
    assert config is not None
    (landmarks,) = run_report._landmarks(config)
    assert isinstance(landmarks, Bullets)
    assert any(text.startswith("head of the stem: offset 43.0 mm") for text in landmarks.texts)
    (tmp_path / "case.yaml").write_text(
        "base: stance\ngeometry: {kind: patient, bone: {image: removed.nii.gz, label: 1}}"
    )
    config, reason = run_report._read_config(tmp_path)
    assert config is None
    (note,) = run_report._model(tmp_path, config, reason)
    assert isinstance(note, Bullets)
    assert "no picture of the case: InputError" in note.texts[0]


@pytest.mark.parametrize(
    ("interface", "is_cemented"), [("stem-cement", True), ("stem-bone", False)]
)
def test_run_report_limits_of_cemented_stems_are_on_their_pages(
    interface: str, is_cemented: bool
) -> None:
    blocks = table(["", interface], [["area of motion over 30 µm (mm²)", "7"]])
    html = page_of("A", [PageSection("numbers", "Numbers", blocks)], [])
    assert "Why 30 µm" in html
    assert ("cemented stems" in html) == is_cemented


def test_run_report_of_a_right_femur_says_that_it_is_mirrored(tmp_path: Path) -> None:
    mirror = np.diag([-1.0, 1.0, 1.0])
    for name, matrix in (("left", np.eye(3)), ("right", mirror)):
        folder = tmp_path / name
        folder.mkdir()
        write(folder / "bone.stl", moved(parametric_femur(), matrix, np.zeros(3)))
        (folder / "case.yaml").write_text(
            "base: stance\ngeometry: {kind: patient, bone: {surface: bone.stl, unit: mm}}\n"
            "loads: {library: one_leg_stance}\n"
        )
        config, _ = run_report._read_config(folder)
        assert config is not None
        sentence = run_report._mirrored(config)
        assert ("right femur" in sentence) == (name == "right")
