"""``mantle sweep``: its file, who runs with whom, what is run again, its tables.

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

from app.campaigns import batch, scheduler, sweep, uncertainty
from app.campaigns.many import Options
from app.campaigns.runs import Job, finished
from app.case import sweep as sweep_file
from app.case.case import dump, load, plain
from app.cli import main
from app.errors import ConvergenceError, InputError, MantleError, StoppedError, gravest
from app.report import sweep_results
from app.schema import yaml_file
from app.soundness import cost
from tests import support

CASE = """\
geometry:
  kind: blocks
  blocks: [{name: lower, size: [4 mm, 4 mm, 4 mm]}, {name: upper, size: [4 mm, 4 mm, 4 mm]}]
mesh: {order: 1, size: 4 mm}
regions:
  lower: {youngs_modulus: 1 GPa, poisson_ratio: 0.3}
  upper: {youngs_modulus: 1 GPa, poisson_ratio: 0.3}
interfaces:
  lower_upper: {kind: contact, friction_coefficient: 1.0}
supports:
  base: {kind: fixed, boundary: bottom}
loads:
  press: {kind: pressure, boundary: top, pressure: 2 MPa}
"""

SWEEP = """\
base: case.yaml
set: {regions.upper.poisson_ratio: 0.25}
table:
  soft: {regions.lower.youngs_modulus: 1 GPa}
  hard: {regions.lower.youngs_modulus: 2 GPa}
grid:
  interfaces.lower_upper.friction_coefficient: [0.2, 0.4]
  loads.press.pressure: [1 MPa, 3 MPa]
"""

FRICTION = "interfaces.lower_upper.friction_coefficient"

STAND_IN = """\
import json, pathlib, sys, time
from app.case.case import dump, load, plain
from app.system.folders import FAILED
here, path, output = pathlib.Path(__file__).parent, *map(pathlib.Path, (sys.argv[1], sys.argv[3]))
case = load(path).config
many = [(v.name, v.case) for v in load(path).variations()] or [("", case)]
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
        self.sweep.write_text(SWEEP)
        (folder / "case.yaml").write_text(CASE)
        (folder / "mantle.py").write_text(STAND_IN)
        (folder / "broken").write_text("")
        (folder / "code").write_text("4")
        (folder / "seconds").write_text("0")
        (folder / "awaited").write_text(".")

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


def test_cases_that_share_a_stiffness_share_a_process(bench: Bench) -> None:
    bench.run()
    groups = sorted((bench.out / "cases").iterdir())
    assert len(groups) == 2 and all(g.name.startswith("shared-") for g in groups)
    for group in groups:
        varied = load(group).variations()
        assert {
            (v.case.interfaces["lower_upper"].friction_coefficient, v.case.loads["press"].pressure)
            for v in varied
        } == {(0.2, 1.0), (0.2, 3.0), (0.4, 1.0), (0.4, 3.0)}
        assert {v.case.regions["upper"].poisson_ratio for v in varied} == {0.25}
    # Each is the case that its own overrides make.
    planned = {p.point.name: p.case for p in sweep_file.read(bench.sweep)[1]}
    found = {v.name: v.case for g in groups for v in load(g).variations()}
    for row in bench.cases():
        case = found.pop(Path(row["folder"]).name)
        assert plain(case) == plain(planned[row["name"]])
    assert not found


def test_tables_have_a_row_for_each_case(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "mantle")
    bench.run()
    rows, cases = bench.rows(), bench.cases()
    assert len(rows) == len(cases) == 8
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
    assert cases[2]["errors"] == {"lower_upper.slip_p99": 0.001}
    assert sum(m.startswith("[") for m in caplog.messages) == 8
    assert "[8/8]" in next(m for m in reversed(caplog.messages) if m.startswith("["))


def test_the_table_grows_while_cases_run(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scheduler, "OFTEN", 0.0)
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


def test_overrides_hold_for_every_case(bench: Bench) -> None:
    bench.run("mesh.size=2 mm")
    _, planned = sweep_file.read(bench.sweep, ["mesh.size=2 mm"])
    assert {p.case.mesh.size for p in planned} == {2.0}
    # Above all in place of what is under set.
    bench.run("regions.upper.poisson_ratio=0.4", "ranks=2")
    record = json.loads((bench.out / "sweep.json").read_text())
    assert record["overrides"] == ["regions.upper.poisson_ratio=0.4", "ranks=2"]
    for case in record["cases"]:
        assert case["overrides"]["regions.upper.poisson_ratio"] == 0.4
        assert case["overrides"]["ranks"] == case["ranks"] == 2
        resolved = load(next((bench.out / "cases").glob(f"{case['folder'].split('/')[1]}*"))).config
        assert resolved.regions["upper"].poisson_ratio == 0.4
    _, planned = sweep_file.read(bench.sweep, ["ranks=3"])
    assert {p.ranks for p in planned} == {3}
    with pytest.raises(InputError, match="--set ranks: 'none' is not a number of ranks"):
        sweep_file.read(bench.sweep, ["ranks=none"])


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


@pytest.mark.slow
def test_how_long_a_run_took_is_known_however_it_was_done(bench: Bench) -> None:
    """In company, and wanted alone; alone, and wanted in company; and where no status was left."""
    bench.run()
    bench.calls()
    alone = SWEEP.replace("[0.2, 0.4]", "[0.2]").replace("[1 MPa, 3 MPa]", "[1 MPa]")
    bench.sweep.write_text(alone)
    bench.run()
    assert not bench.calls() and [r["wall [s]"] for r in bench.rows()] == ["1.5", "1.5"]
    bench.sweep.write_text(alone.replace("0.25", "0.26"))
    bench.run()
    statuses = {p.stem: p.read_text().split() for p in (bench.out / "runs").glob("case-*.status")}
    took = {id: float(end) - float(begin) for id, (_, begin, end) in statuses.items()}
    assert len(took) == len(bench.calls()) == 2
    bench.sweep.write_text(SWEEP.replace("0.25", "0.26"))
    bench.run()
    assert len(bench.calls()) == 6
    old = [c for c in bench.cases() if c["folder"].count("/") == 1]
    assert len(old) == 2
    assert all(c["seconds"] == round(took[Path(c["folder"]).name], 2) for c in old)
    for path in (bench.out / "runs").glob("*.status"):
        path.unlink()
    bench.run()
    assert {c["seconds"] for c in bench.cases()} == {1.5}


def test_many_axes_with_long_values(bench: Bench) -> None:
    """The names of cases are as long as they like; those of folders are not made of them."""
    modulus = "regions.lower.youngs_modulus"
    bench.sweep.write_text(
        f"""\
base: case.yaml
table: {{{"x" * 90}: {{}}}}
grid:
  {modulus}: [1.000000000000001 GPa, 2.000000000000002 GPa]
  {FRICTION}: [0.200000000000000001, 0.4]
  loads.press.pressure: [1.000000000000001 MPa, 3 MPa]
  solver.augmentation_factor: [0.1, 0.200000000000000001]
"""
    )
    bench.run()
    rows = bench.rows()
    assert len({r["case"] for r in rows}) == 16 and all(len(r["case"]) > 150 for r in rows)
    assert {r["status"] for r in rows} == {"converged"}
    assert len({r["folder"] for r in rows}) == 16
    for row in rows:
        assert re.fullmatch(r"runs/shared-[0-9a-f]{10}-1/case-[0-9a-f]{10}", row["folder"])
    assert [c.name for c in sweep_results.read(bench.out).cases] == [r["case"] for r in rows]
    bench.calls()
    bench.run()
    assert not bench.calls()


def test_the_sweep_file_is_read_once(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may be saved, half written too, while the sweep runs."""
    monkeypatch.setattr(scheduler, "OFTEN", 0.0)
    (bench.folder / "seconds").write_text("0.3")
    write = sweep.write_json

    def save(path: Path, data: Any) -> None:
        write(path, data)
        bench.sweep.write_text("base: [")

    monkeypatch.setattr(sweep, "write_json", save)
    bench.run()
    assert {c["status"] for c in bench.cases()} == {"converged"}
    bench.sweep.write_text(SWEEP)
    assert yaml_file.read(bench.out / "sweep.yaml").data == yaml_file.read(bench.sweep).data


@pytest.mark.parametrize(
    ("cores", "ranks", "sizes"),
    [(1, 1, [20]), (8, 2, [5] * 4), (64, 1, [1] * 20)],
)
def test_a_group_keeps_all_cores_busy(
    bench: Bench, cores: int, ranks: int, sizes: list[int]
) -> None:
    """ContactSamples of friction share their matrices; what has begun stays where its state is."""
    jobs = [
        Job(f"{i}", bench.folder / "case.yaml", (f"{FRICTION}={i}",), ranks, share=True)
        for i in range(20)
    ]
    results = batch.look(jobs, bench.out, cores)
    counts = Counter(r.process for r in results)
    assert list(counts.values()) == sizes
    last = results[-1].folder
    last.mkdir(parents=True)
    (last / "checkpoint-3.state").write_text("")
    again = batch.look(jobs, bench.out, 3 * ranks)
    assert again[-1].folder == last
    assert sorted(Counter(r.process for r in again[:-1]).values()) == [5, 7, 7]


@pytest.mark.parametrize("saved", ["checkpoint-3.state", "DONE"])
def test_names_of_folders_are_not_run(bench: Bench, saved: str) -> None:
    """A folder that somebody has left there is none of the runs, whatever its end is."""
    jobs = [
        Job(f"{i}", bench.folder / "case.yaml", (f"{FRICTION}=0.{i}",), 1, share=True)
        for i in (1, 2)
    ]
    expected = [r.folder for r in batch.look(jobs, bench.out, 1)]
    digests = [folder.name.removeprefix("case-") for folder in expected]
    for digest in digests:
        for above in ("shared-$(touch PWNED)-1", "shared-0123456789-1;touch PWNED", "x"):
            for name in (f"case-{digest}", f"`touch PWNED`{digest}"):
                place = bench.out / "runs" / above / name
                place.mkdir(parents=True)
                (place / saved).write_text("")
        place = bench.out / "runs" / f"';touch PWNED;'{digest}"
        place.mkdir()
        (place / saved).write_text("")
    assert [r.folder for r in batch.look(jobs, bench.out, 1)] == expected
    sweep.run(bench.sweep, [], Options(bench.out, 2))
    assert (
        not list(bench.folder.rglob("PWNED"))
        and "PWNED" not in (bench.out / "jobs.json").read_text()
    )


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
import time
from collections import Counter
from pathlib import Path
from app.campaigns import batch, sweep; from app.campaigns.many import Options
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


def kill_again_and_again(path: Path, out: Path, times: int, longest: float) -> None:
    """A sweep killed at random moments keeps what it has, and ends with everything done."""

    def marks() -> dict[str, int]:
        return {str(p): p.stat().st_mtime_ns for p in finished(out)}

    every = len({dump(p.case) for p in sweep_file.read(path)[1]})
    random.seed(times)
    done: dict[str, int] = {}
    for k in range(times):
        more = min(len(done) + k % 2, every)
        killed(path, out, more, random.uniform(0.0, longest), runs_too=k % 3 != 2)
        now = marks()
        assert len(now) >= more and {path: now.get(path) for path in done} == done
        done = now
    assert done
    sweep.run(path, (), Options(out, 2))
    now = marks()
    assert {path: now.get(path) for path in done} == done
    assert len(now) == every
    cases = json.loads((out / "sweep.json").read_text())["cases"]
    assert {c["status"] for c in cases} == {"converged"}


@pytest.mark.slow
def test_a_killed_sweep_loses_nothing(bench: Bench) -> None:
    (bench.folder / "seconds").write_text("0.5")
    kill_again_and_again(bench.sweep, bench.out, 2, 1.0)


@pytest.mark.slow
def test_a_real_sweep_killed_ten_times_loses_nothing(tmp_path: Path) -> None:
    path = tmp_path / "sweep.yaml"
    path.write_text(
        """\
base: BASE
set: {mesh.size: 4 mm, ranks: 2}
grid:
  geometry.cement_thickness: [2 mm, 4 mm, 5 mm]
  interfaces.stem_cement.friction_coefficient: [0.2, 0.4, 0.6, 0.8]
""".replace("BASE", str(support.CONFIGS / "cylinders.yaml"))
    )
    kill_again_and_again(path, tmp_path / "out", 10, 3.0)


@pytest.mark.slow
def test_shared_and_separate_runs_give_the_same(tmp_path: Path) -> None:
    """For real: two frictions in one process, and each alone."""
    (tmp_path / "case.yaml").write_text(
        CASE.replace(
            "top, pressure: 2 MPa",
            "top, pressure: 2 MPa}\n  push: {kind: force, boundary: x_max, force: '[-8, 0, 0] N'",
        )
    )
    path = tmp_path / "sweep.yaml"
    path.write_text(f"base: case.yaml\ngrid: {{{FRICTION}: [0.2, 0.6]}}\n")
    sweep.run(path, (), Options(tmp_path / "shared", 1))
    together = json.loads((tmp_path / "shared" / "sweep.json").read_text())["cases"]
    assert {c["folder"].split("/")[1] for c in together} == {together[0]["folder"].split("/")[1]}
    for friction, case in zip((0.2, 0.6), together, strict=True):
        path.write_text(f"base: case.yaml\nset: {{{FRICTION}: {friction}}}\n")
        sweep.run(path, (), Options(tmp_path / "alone", 1))
        (alone,) = json.loads((tmp_path / "alone" / "sweep.json").read_text())["cases"]
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
    assert n["mean"] == pytest.approx(0.45) and n["deviation"] == pytest.approx(
        statistics.stdev(10 * x**3 for x in a)
    )
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
        names = [
            f"friction/cement_thickness={thickness}mm_friction_coefficient={f}"
            for f in (0.2, 0.4, 0.6, 0.8)
        ]
        values = [shear[name] for name in names]
        assert values == sorted(values) and values[3] > 2 * values[0]
    spread = found["uncertainty"]["uncertain"]["numbers"]["stem_cement.shear_p95"]
    friction, modulus = spread["correlation"].values()
    assert friction > 0.7 and friction > modulus
