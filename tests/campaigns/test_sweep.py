"""``mantle sweep``: who runs with whom, what is run again, its tables.

Most of it on a stand-in for ``mantle run``: it leaves what a run leaves, a slip of 0.01 mm divided
by the friction coefficient, and a line for every run that it finishes.
"""

from __future__ import annotations

import contextlib
import csv
import json
import logging
import os
import random
import re
import signal
import statistics
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from app.campaigns import batch, sweep, uncertainty
from app.campaigns.plan import Options
from app.campaigns.runs import Job
from app.case import sweep as sweep_file
from app.case.case import load, plain
from app.cli import main
from app.errors import ConvergenceError, MantleError, StoppedError, gravest
from app.schema import yaml_file
from app.soundness import cost
from tests import support
from tests.campaigns.test_points import CASE, FRICTION, SWEEP

STAND_IN = """\
import json, pathlib, sys, time
from app.case.case import load
from app.system.folders import FAILED
here, path, output = pathlib.Path(__file__).parent, *map(pathlib.Path, (sys.argv[1], sys.argv[3]))
loaded = load(path)
many = [(v.name, v.case) for v in loaded.variations()] or [("", loaded.config)]
code = 0
for name, case in many:
    folder = output / name
    if (folder / "DONE").exists():
        continue
    folder.mkdir(parents=True, exist_ok=True)
    friction = case.interfaces["lower_upper"].friction_coefficient
    time.sleep(float((here / "seconds").read_text()))
    # With a file to wait for only the first of a process does not, and none waits for ever.
    awaited, end = here / (here / "awaited").read_text(), time.monotonic() + 60
    while (here / "calls").exists() and not awaited.exists() and time.monotonic() < end:
        time.sleep(0.02)
    if str(friction) in (here / "broken").read_text().split():
        code = int((here / "code").read_text())
        if code != 4:
            break
        (folder / FAILED).write_text("the block slides away\\n")
        continue
    slip = {"slip_p99": round(0.01 / friction, 6), "slip_p99_error": 0.001}
    summary = {"interfaces": {"lower_upper": slip}, "timing": {"total": 1.5},
               "solver": {"dofs": 9, "newton_iterations": 3, "linear_iterations": 4}}
    (folder / "summary.json").write_text(json.dumps(summary))
    (folder / "DONE").write_text("")
    with (here / "calls").open("a") as file:
        file.write(f"{case.regions['lower'].youngs_modulus / 1e3:g} GPa, {friction}\\n")
sys.exit(code)
"""


class Bench:
    """A folder with a case, a sweep and the stand-in."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.out = folder, folder / "out"
        self.sweep = folder / "sweep.yaml"
        for name, text in {
            "sweep.yaml": SWEEP,
            "case.yaml": CASE,
            "mantle.py": STAND_IN,
            "broken": "",
            "code": "4",
            "seconds": "0",
            "awaited": ".",
        }.items():
            (folder / name).write_text(text)

    def run(self, *overrides: str) -> None:
        sweep.run(self.sweep, overrides, Options(self.out, 2))

    def calls(self) -> list[str]:
        """Modulus and friction of the runs finished since the last time."""
        path = self.folder / "calls"
        lines = path.read_text().splitlines() if path.exists() else []
        path.unlink(missing_ok=True)
        return sorted(lines)

    def rows(self) -> list[dict[str, str]]:
        with (self.out / "sweep.csv").open(newline="") as file:
            return list(csv.DictReader(file))

    def cases(self) -> list[dict[str, Any]]:
        return list(json.loads((self.out / "sweep.json").read_text())["cases"])


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    monkeypatch.setattr(batch, "MANTLE_RUN", (sys.executable, str(tmp_path / "mantle.py")))
    return Bench(tmp_path)


def finished(out: Path) -> list[Path]:
    """The DONE of every finished run."""
    runs = out / "runs"
    return [*runs.glob("case-*/DONE"), *runs.glob("shared-*/case-*/DONE")]


def test_cases_share_processes_and_have_a_row_each(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    """Two moduli: two processes with four cases each, which are those of the sweep."""
    caplog.set_level(logging.INFO, "mantle")
    bench.run("regions.upper.poisson_ratio=0.4")
    groups = sorted((bench.out / "cases").iterdir())
    assert len(groups) == 2 and all(g.name.startswith("shared-") for g in groups)
    found = {v.name: v.case for g in groups for v in load(g).variations()}
    rows, cases = bench.rows(), bench.cases()
    overrides = ["regions.upper.poisson_ratio=0.4"]
    planned = {p.point.name: p.case for p in sweep_file.read(bench.sweep, overrides)[1]}
    for row in cases:
        assert plain(found.pop(Path(row["folder"]).name)) == plain(planned[row["name"]])
        assert row["overrides"]["regions.upper.poisson_ratio"] == 0.4
    assert not found and len(rows) == 8
    assert rows[2] == {
        "case": "soft_friction_coefficient=0.4_pressure=1MPa",
        "status": "converged",
        "notes": "",
        "regions.lower.youngs_modulus": "1 GPa",
        FRICTION: "0.4",
        "loads.press.pressure": "1 MPa",
        "lower_upper.slip_p99 [mm]": "0.025",
        "lower_upper.slip_p99 error [mm]": "0.001",
        "unknowns [-]": "9",
        "newton [-]": "3",
        "krylov [-]": "4",
        "wall [s]": "1.5",
        "folder": cases[2]["folder"],
    }
    assert (bench.out / cases[2]["folder"] / "DONE").exists()
    told = [m for m in caplog.messages if m.startswith("[")]
    assert len(told) == 8 and told[-1].startswith("[8/8]")
    # The file may have been saved meanwhile.
    assert yaml_file.read(bench.out / "sweep.yaml").data == yaml_file.read(bench.sweep).data


def test_the_table_grows_while_cases_run(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch, "OFTEN", 0.0)
    (bench.folder / "awaited").write_text("out/sweep.json")
    written: list[list[str]] = []
    write = sweep.write_json

    def note(path: Path, data: Any) -> None:
        write(path, data)
        written.append([c["status"] for c in data["cases"]])

    monkeypatch.setattr(sweep, "write_json", note)
    bench.run()
    done = [statuses.count("converged") for statuses in written]
    assert 0 < done[0] < 8 and done[-1] == 8 and done == sorted(done)
    assert {s for statuses in written for s in statuses} == {"converged", "stopped"}


def test_an_interrupted_sweep_has_its_table(bench: Bench) -> None:
    (bench.folder / "awaited").write_text("nothing")

    def interrupt() -> None:
        deadline = time.monotonic() + 120
        while not finished(bench.out) and time.monotonic() < deadline:
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(StoppedError):
        bench.run()
    thread.join()
    assert {c["status"] for c in bench.cases()} == {"converged", "stopped"}


def test_only_what_failed_or_changed_runs_again(bench: Bench) -> None:
    (bench.folder / "broken").write_text("0.4")
    with pytest.raises(ConvergenceError, match="4 of 8 cases failed") as error:
        bench.run()
    assert "the block slides away" in str(error.value)
    assert len(bench.calls()) == 4
    assert [r["status"] for r in bench.rows()[:3]] == ["converged", "converged", "not converged"]
    (bench.folder / "broken").write_text("")
    bench.run()
    assert len(bench.calls()) == 4 and {c["status"] for c in bench.cases()} == {"converged"}
    bench.run()
    assert not bench.calls()
    bench.sweep.write_text(SWEEP.replace("[0.2, 0.4]", "[0.2, 0.4, 0.8]").replace("2 GPa", "3 GPa"))
    bench.run()
    # Two new ones of the soft block; of the hard one all.
    calls = bench.calls()
    assert [sum(c.startswith(modulus) for c in calls) for modulus in ("1 GPa", "3 GPa")] == [2, 6]
    assert len(bench.cases()) == 12


@pytest.mark.parametrize(
    ("option", "expected"),
    [
        ([], None),
        (["--slurm"], []),
        (["--slurm=--partition=long --comment='a b'"], ["--partition=long", "--comment=a b"]),
    ],
)
def test_options_of_slurm_reach_it(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, option: list[str], expected: list[str] | None
) -> None:
    given: list[object] = []

    def run(jobs: object, folder: object, cores: int, slurm: object, tell: object) -> list[object]:
        given.append(slurm)
        raise StoppedError("enough")

    monkeypatch.setattr(batch, "run", run)
    bench.out.mkdir()
    assert main(["sweep", str(bench.sweep), "-o", str(bench.out), *option]) == 5
    assert given == [expected]


def test_a_dry_run_runs_nothing(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["sweep", str(bench.sweep), "-o", str(bench.out), "--cores", "2"]
    assert main([*arguments, "--dry-run"]) == 0
    said = capsys.readouterr().out
    assert not bench.out.exists()
    assert "8 cases" in said and said.count("shares the matrices") == 6
    assert main(arguments) == 0
    capsys.readouterr()
    assert main([*arguments, "--dry-run"]) == 0
    assert capsys.readouterr().out.count("  done in 1.5 s") == 8


@pytest.mark.parametrize(("ranks", "each"), [(1, 30), (2, 15), (8, 15)])
def test_a_dry_run_tells_what_cores_take_together(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, ranks: int, each: int
) -> None:
    """Eight cases of half a minute of one core, on two: two minutes and some idling at the end."""
    monkeypatch.setattr(cost, "seconds", lambda case, alone: 30.0)
    said = sweep.dry_run(bench.sweep, [f"ranks={ranks}"], Options(bench.out, 2))
    assert said.splitlines()[-1].startswith("about 2 min for what is not done, on 2 cores")
    shown = [re.search(r"(\S+) s(  |$)", line) for line in said.splitlines()[3:-2]]
    assert [float(found[1]) for found in shown if found] == [each] * 8


@pytest.mark.parametrize(
    ("cores", "ranks", "sizes"), [(1, 1, [20]), (8, 2, [5] * 4), (64, 1, [1] * 20)]
)
def test_a_group_keeps_all_cores_busy(
    bench: Bench, cores: int, ranks: int, sizes: list[int]
) -> None:
    """Cases of one mesh share their matrices; what has begun stays where its state is."""
    case = bench.folder / "case.yaml"
    jobs = [Job(f"{i}", case, (f"{FRICTION}={i}",), ranks, share=True) for i in range(20)]
    results = batch.results_so_far(jobs, bench.out, cores)
    assert list(Counter(r.process for r in results).values()) == sizes
    last = results[-1].folder
    last.mkdir(parents=True)
    (last / "checkpoint-3.state").write_text("")
    again = batch.results_so_far(jobs, bench.out, 3 * ranks)
    assert again[-1].folder == last
    assert sorted(Counter(r.process for r in again[:-1]).values()) == [5, 7, 7]


@pytest.mark.parametrize("saved", ["checkpoint-3.state", "DONE"])
def test_names_of_folders_are_not_run(bench: Bench, saved: str) -> None:
    """A folder that somebody has left there is none of the runs, whatever its end is."""
    case = bench.folder / "case.yaml"
    jobs = [Job(f"{i}", case, (f"{FRICTION}=0.{i}",), share=True) for i in (1, 2)]
    expected = [r.folder for r in batch.results_so_far(jobs, bench.out, 1)]
    for folder in expected:
        for above in ("shared-$(touch PWNED)-1", "shared-0123456789-1;touch PWNED", "x"):
            place = bench.out / "runs" / above / folder.name
            place.mkdir(parents=True)
            (place / saved).write_text("")
    assert [r.folder for r in batch.results_so_far(jobs, bench.out, 1)] == expected
    bench.run()
    assert not list(bench.folder.rglob("PWNED"))
    assert "PWNED" not in (bench.out / "jobs.json").read_text()


@pytest.mark.parametrize(("code", "expected"), [(3, 3), (137, 70)])
def test_a_sweep_leaves_as_its_cases_did(bench: Bench, code: int, expected: int) -> None:
    (bench.folder / "broken").write_text("0.2 0.4")
    (bench.folder / "code").write_text(str(code))
    with pytest.raises(MantleError, match="8 of 8 cases failed") as error:
        bench.run()
    assert error.value.exit_code == expected


def test_the_gravest_exit_code_wins() -> None:
    assert gravest([4, 3, 4], "").exit_code == 4
    assert gravest([5, 2], "").exit_code == 5
    assert gravest([4, 69], "").exit_code == 69
    assert gravest([69, 1], "told").exit_code == 70
    assert str(gravest([4], "told")) == "told"


CONTROLLER = """\
import sys
from pathlib import Path
from app.campaigns import batch, sweep
from app.campaigns.plan import Options
batch.MANTLE_RUN = tuple(sys.argv[3:])
sweep.run(Path(sys.argv[1]), (), Options(Path(sys.argv[2]), 2))
"""


def killed(path: Path, out: Path, wanted: int, seconds: float, runs_too: bool) -> None:
    """Start a sweep, and kill it some time after it has so many finished runs.

    What it runs is killed too if asked for, as if the power failed.
    """
    child = subprocess.Popen(
        [sys.executable, "-c", CONTROLLER, str(path), str(out), *batch.MANTLE_RUN],
        env=os.environ | {"PYTHONPATH": str(support.ROOT)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    while child.poll() is None and len(finished(out)) < wanted:
        time.sleep(0.02)
    with contextlib.suppress(subprocess.TimeoutExpired):
        child.wait(seconds)
    child.kill()
    child.wait()
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            if runs_too and str(out).encode() in entry.read_bytes():
                os.kill(int(entry.parent.name), signal.SIGKILL)


def kill_again_and_again(path: Path, out: Path, every: int, times: int, longest: float) -> None:
    """A sweep killed at random moments keeps what it has, and ends with everything done."""

    def marks() -> dict[str, int]:
        return {str(p): p.stat().st_mtime_ns for p in finished(out)}

    random.seed(times)
    done: dict[str, int] = {}
    for k in range(times):
        more = min(len(done) + k % 2, every)
        killed(path, out, more, random.uniform(0.0, longest), runs_too=k % 3 != 2)
        now = marks()
        assert len(now) >= more and {path: now.get(path) for path in done} == done
        done = now
    sweep.run(path, (), Options(out, 2))
    now = marks()
    assert {path: now.get(path) for path in done} == done and len(now) == every
    cases = json.loads((out / "sweep.json").read_text())["cases"]
    assert {c["status"] for c in cases} == {"converged"}


def test_a_killed_sweep_goes_on(bench: Bench) -> None:
    """Once with all that it runs, and once alone: what it has left running is waited for."""
    (bench.folder / "seconds").write_text("0.3")
    kill_again_and_again(bench.sweep, bench.out, 8, 3, 0.5)


@pytest.mark.slow
def test_a_real_sweep_killed_ten_times_loses_nothing(tmp_path: Path) -> None:
    path = tmp_path / "sweep.yaml"
    path.write_text(
        f"""\
base: {support.CONFIGS / "cylinders.yaml"}
set: {{mesh.size: 4 mm, ranks: 2}}
grid:
  geometry.cement_thickness: [2 mm, 4 mm, 5 mm]
  interfaces.stem_cement.friction_coefficient: [0.2, 0.4, 0.6, 0.8]
"""
    )
    kill_again_and_again(path, tmp_path / "out", 12, 10, 3.0)


@pytest.mark.slow
def test_shared_and_separate_runs_give_the_same(tmp_path: Path) -> None:
    """For real: two frictions in one process, and each alone."""
    push = "}\n  push: {kind: force, boundary: x_max, force: '[-8, 0, 0] N'}\n"
    (tmp_path / "case.yaml").write_text(CASE.rstrip("}\n") + push)
    path = tmp_path / "sweep.yaml"
    path.write_text(f"base: case.yaml\ngrid: {{{FRICTION}: [0.2, 0.6]}}\n")
    sweep.run(path, (), Options(tmp_path / "shared", 1))
    together = json.loads((tmp_path / "shared" / "sweep.json").read_text())["cases"]
    assert {c["folder"].split("/")[1] for c in together} == {together[0]["folder"].split("/")[1]}
    for friction, case in zip((0.2, 0.6), together, strict=True):
        path.write_text(f"base: case.yaml\nset: {{{FRICTION}: {friction}}}\n")
        sweep.run(path, (), Options(tmp_path / "alone", 1))
        alone = json.loads((tmp_path / "alone" / "sweep.json").read_text())["cases"][0]
        assert alone["folder"].count("/") == 1
        for name, value in case["numbers"].items():
            assert alone["numbers"][name] == pytest.approx(value, rel=1e-6, abs=1e-9), name


def test_samples_tell_spread_and_cause() -> None:
    """A number that grows with one input and not with the other; ranks by hand."""
    a, b = [0.1, 0.2, 0.3, 0.4, 0.5], [2, 5, 1, 4, 3]
    rows = [
        {
            "part": "p",
            "exit_code": 0,
            "overrides": {"a": f"{x} mm", "b": y},
            "numbers": {"stem.varus": 10 * x**3, "stem.retroversion": 1.0},
        }
        for x, y in zip(a, b, strict=True)
    ]
    failed = {"part": "p", "exit_code": 4, "overrides": {"a": "9 mm", "b": 9}, "numbers": {}}
    found = uncertainty.of_parts([*rows, failed], {"p": ["a", "b"]})["p"]
    assert found["samples"] == 5
    n = found["numbers"]["stem.varus"]
    assert n["mean"] == pytest.approx(0.45)
    assert n["deviation"] == pytest.approx(statistics.stdev(10 * x**3 for x in a))
    # Spearman: 1 - 6 sum d^2 / (n (n^2 - 1)), d = 1, 3, -2, 0, -2.
    assert n["correlation"] == pytest.approx({"a": 1.0, "b": 1 - 6 * 18 / 120})
    assert found["numbers"]["stem.retroversion"]["correlation"] == {}
    said = uncertainty.table({"p": found})
    assert "a +1.00, b +0.10" in said and "retroversion" not in said


@pytest.mark.slow
def test_the_sweep_for_learning(tmp_path: Path) -> None:
    """As shipped, but on a coarse mesh: friction holds the stem back, the mantle's modulus less."""
    path = support.ROOT / "configs" / "sweeps" / "friction_cylinders.yaml"
    overrides = ["mesh.size=6 mm", "mesh.far_size=6 mm", "mesh.order=1", "stages.1.increments=1"]
    sweep.run(path, overrides, Options(tmp_path, 2))
    found = json.loads((tmp_path / "sweep.json").read_text())
    shear = {c["name"]: c["numbers"]["stem_cement.shear_p95"] for c in found["cases"]}
    for thickness in (2, 4):
        part = f"friction/cement_thickness={thickness}mm_friction_coefficient="
        values = [shear[f"{part}{f}"] for f in (0.2, 0.4, 0.6, 0.8)]
        assert values == sorted(values) and values[3] > 2 * values[0]
    spread = found["uncertainty"]["uncertain"]["numbers"]["stem_cement.shear_p95"]
    friction, modulus = spread["correlation"].values()
    assert friction > 0.7 and friction > modulus
