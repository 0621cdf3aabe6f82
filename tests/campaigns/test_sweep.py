"""``mantle sweep``: groups of cases, repeated runs, tables."""

from __future__ import annotations

import contextlib
import csv
import json
import logging
import os
import random
import re
import signal
import subprocess
import sys
import threading
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from app.campaigns import batch, sweep
from app.campaigns.batch import Options
from app.campaigns.runs import runs_of
from app.case import sweep as sweep_file
from app.case.case import PlannedRun, load_case, plain_data
from app.cli import main
from app.foundation.errors import ConvergenceError, StoppedError, worst_error
from app.schema import yaml_file
from app.soundness import cost
from tests import support
from tests.campaigns.bench import FRICTION, SWEEP, Bench, wait


def run(bench: Bench, *overrides: str) -> None:
    sweep.run(bench.sweep, overrides, Options(bench.out, 2))


def cases_of(folder: Path) -> list[dict[str, Any]]:
    return list(json.loads((folder / "sweep.json").read_text())["cases"])


def test_sweep_cases_share_processes_and_have_a_row_each(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    """Two moduli give two processes with four cases each."""
    caplog.set_level(logging.INFO, "mantle")
    overrides = ["regions.upper.poisson_ratio=0.4", "output.error=true"]
    run(bench, *overrides)
    groups = sorted((bench.out / "cases").iterdir())
    assert len(groups) == 2 and all(g.name.startswith("shared-") for g in groups)
    grouped = {v.name: v.case for g in groups for v in load_case(g).variations}
    with (bench.out / "sweep.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    cases = cases_of(bench.out)
    planned = {p.name: p.case for p in sweep_file.read(bench.sweep, overrides)[1]}
    for row in cases:
        assert plain_data(grouped.pop(Path(row["folder"]).name)) == plain_data(planned[row["name"]])
        assert row["overrides"]["regions.upper.poisson_ratio"] == 0.4
    assert not grouped and len(rows) == 8
    assert rows[2] == {
        "case": "soft_friction_coefficient=0.4_pressure=1MPa",
        "status": "converged",
        "notes": "",
        "regions.lower.youngs_modulus": "1 GPa",
        FRICTION: "0.4",
        "loads.press.pressure": "1 MPa",
        "lower_upper.slip_p99 [mm]": "0.084",
        "lower_upper.slip_p99 error [mm]": "0.032",
        "lower_upper.penetration_max [mm]": "0.0",
        "unknowns [-]": "3",
        "newton [-]": "4",
        "krylov [-]": "5",
        "wall [s]": "8.0",
        "folder": cases[2]["folder"],
    }
    assert (bench.out / cases[2]["folder"] / "DONE").exists()
    progress = [m for m in caplog.messages if m.startswith("[")]
    assert len(progress) == 8 and progress[-1].startswith("[8/8]")
    # The file may have been saved meanwhile.
    assert yaml_file.read(bench.out / "sweep.yaml").data == yaml_file.read(bench.sweep).data


def test_sweep_table_grows_while_cases_run(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch, "OFTEN", 0.0)
    bench.write(awaited="out put/sweep.json")
    written: list[list[str]] = []
    write = sweep.write_json

    def note(path: Path, data: Any) -> None:
        write(path, data)
        written.append([c["status"] for c in data["cases"]])

    monkeypatch.setattr(sweep, "write_json", note)
    run(bench)
    done = [statuses.count("converged") for statuses in written]
    assert 0 < done[0] < 8 and done[-1] == 8 and done == sorted(done)
    assert {s for statuses in written for s in statuses} == {"converged", "stopped"}


@pytest.mark.parametrize("code", ["5", "1"])
def test_sweep_interrupted_has_its_table_and_resumes(code: str, bench: Bench) -> None:
    """No process stays, and finished runs are not repeated.

    Python that is interrupted before it has started leaves with 1.
    """
    bench.write(awaited="nothing", interrupted=code)

    def interrupt() -> None:
        wait(bench.finished)
        os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(StoppedError, match="of 8 runs"):
        run(bench)
    thread.join()
    assert not bench.processes()
    assert {c["status"] for c in cases_of(bench.out)} == {"converged", "stopped"}
    done = {p: p.stat().st_mtime_ns for p in bench.finished()}
    bench.write(awaited=".")
    run(bench)
    assert len(bench.finished()) == 8
    assert {p: p.stat().st_mtime_ns for p in done} == done
    assert {c["status"] for c in cases_of(bench.out)} == {"converged"}


def test_sweep_repeats_only_failed_or_changed_cases(bench: Bench) -> None:
    bench.write(broken="0.4", code="4")
    with pytest.raises(ConvergenceError, match=r"4 of 8 cases failed(?s:.*)block slides away"):
        run(bench)
    assert len(bench.taken("runs")) == 4
    statuses = [c["status"] for c in cases_of(bench.out)[:3]]
    assert statuses == ["converged", "converged", "not converged"]
    changed = SWEEP.replace("[0.2, 0.4]", "[0.2, 0.4, 0.8]").replace("2 GPa", "3 GPa")
    bench.write(broken="", **{"sweep.yaml": changed})
    run(bench)
    # Of the soft block those that failed and two new ones; of the hard one all.
    runs = bench.taken("runs")
    assert [sum(r.startswith(modulus) for r in runs) for modulus in ("1", "3")] == [4, 6]
    assert [c["status"] for c in cases_of(bench.out)] == ["converged"] * 12
    run(bench)
    assert not bench.taken("runs")


@pytest.mark.parametrize(
    ("option", "expected"),
    [
        ([], None),
        (["--slurm"], []),
        (["--slurm=--partition=long --comment='a b'"], ["--partition=long", "--comment=a b"]),
    ],
)
def test_sweep_passes_options_to_slurm(
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


def test_sweep_dry_run_runs_nothing(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["sweep", str(bench.sweep), "-o", str(bench.out), "--cores", "2"]
    assert main([*arguments, "--dry-run"]) == 0
    printed = capsys.readouterr().out
    assert not bench.out.exists()
    assert "8 cases" in printed and printed.count("shares the matrices") == 6
    assert main(arguments) == 0
    capsys.readouterr()
    assert main([*arguments, "--dry-run"]) == 0
    assert capsys.readouterr().out.count("  done in 8.0 s") == 8


@pytest.mark.parametrize(("ranks", "each"), [(1, 30), (2, 15), (8, 15)])
def test_sweep_dry_run_estimates_time_on_cores(
    bench: Bench,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    ranks: int,
    each: int,
) -> None:
    """Eight cases of half a minute take two minutes on two cores, and some idle time."""
    caplog.set_level(logging.INFO, "mantle")
    monkeypatch.setattr(cost, "estimated_seconds", lambda case, alone: 30.0)
    sweep.run(bench.sweep, [f"ranks={ranks}"], Options(bench.out, 2, dry_run=True))
    printed = caplog.messages[0].splitlines()
    assert printed[-1].startswith("about 2 min for the remaining runs on 2 cores")
    shown = [re.search(r"(\S+) s(  |$)", line) for line in printed[3:-2]]
    assert [float(match[1]) for match in shown if match] == [each] * 8


def shared_jobs(bench: Bench, number: int, ranks: int = 1) -> list[PlannedRun]:
    return [
        PlannedRun.load(f"{i}", bench.case, (f"{FRICTION}={i + 1}",), ranks, share=True)
        for i in range(number)
    ]


@pytest.mark.parametrize(
    ("cores", "ranks", "sizes"), [(1, 1, [20]), (8, 2, [5] * 4), (64, 1, [1] * 20)]
)
def test_sweep_groups_use_all_cores(bench: Bench, cores: int, ranks: int, sizes: list[int]) -> None:
    """Cases of one mesh share their matrices. A run that has begun resumes in the same group."""
    jobs = shared_jobs(bench, 20, ranks)
    runs = runs_of(jobs, bench.out, cores)
    assert list(Counter(r.process for r in runs).values()) == sizes
    last = runs[-1].path
    last.mkdir(parents=True)
    (last / "checkpoint-3.state").write_text("")
    again = runs_of(jobs, bench.out, 3 * ranks)
    assert again[-1].path == last
    assert sorted(Counter(r.process for r in again[:-1]).values()) == [5, 7, 7]


@pytest.mark.parametrize("saved", ["checkpoint-3.state", "DONE"])
def test_sweep_ignores_foreign_folders(bench: Bench, saved: str) -> None:
    """A folder that is not of the sweep is none of its runs, even if it has finished."""
    jobs = shared_jobs(bench, 2)
    expected = [r.path for r in runs_of(jobs, bench.out, 1)]
    for folder in expected:
        for above in ("shared-$(touch PWNED)-1", "shared-0123456789-1;touch PWNED", "x"):
            place = bench.out / "runs" / above / folder.name
            place.mkdir(parents=True)
            (place / saved).write_text("")
    assert [r.path for r in runs_of(jobs, bench.out, 1)] == expected
    batch.run(jobs, bench.out, 1)
    assert not list(bench.folder.rglob("PWNED"))
    assert "PWNED" not in (bench.out / "jobs.json").read_text()


def test_sweep_exit_code_is_the_highest() -> None:
    assert worst_error([4, 3, 4], "").exit_code == 4
    assert worst_error([5, 2], "").exit_code == 5
    assert worst_error([4, 69], "").exit_code == 69
    assert worst_error([69, 1], "text").exit_code == 70
    assert str(worst_error([4], "text")) == "text"


CONTROLLER = """\
import sys
from pathlib import Path
from app.campaigns import batch, sweep
from app.campaigns.batch import Options
batch.MANTLE_RUN = tuple(sys.argv[3:])
sweep.run(Path(sys.argv[1]), (), Options(Path(sys.argv[2]), 2))
"""


def test_sweep_resumes_after_kills(bench: Bench) -> None:
    """A sweep killed at random moments keeps finished runs, and ends with all runs done.

    Two kills end all processes, like a power failure. One kill ends the sweep alone, and the sweep
    waits for the remaining runs.
    """
    bench.write(seconds="0.3")

    def marks() -> dict[Path, int]:
        return {p: p.stat().st_mtime_ns for p in bench.finished()}

    random.seed(3)
    done: dict[Path, int] = {}
    for k in range(3):
        more = min(len(done) + k % 2, 8)
        child = subprocess.Popen(
            [sys.executable, "-c", CONTROLLER, bench.sweep, bench.out, *batch.MANTLE_RUN],
            env=support.environment(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        wait(lambda: child.poll() is not None or len(bench.finished()) >= more)  # noqa: B023
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(random.uniform(0.0, 0.5))
        child.kill()
        child.wait()
        for number in bench.processes() if k % 3 != 2 else ():
            os.kill(number, signal.SIGKILL)
        now = marks()
        assert len(now) >= more and {path: now.get(path) for path in done} == done
        done = now
    run(bench)
    now = marks()
    assert {path: now.get(path) for path in done} == done and len(now) == 8
    assert {c["status"] for c in cases_of(bench.out)} == {"converged"}


@pytest.mark.slow
def test_sweep_shipped_for_learning(tmp_path: Path) -> None:
    """The shipped sweep has a coarse mesh here. Shear stress grows with friction.

    The modulus of the mantle matters less.
    """
    path = support.ROOT / "configs" / "sweeps" / "friction_cylinders.yaml"
    overrides = ["mesh.size=6 mm", "mesh.far_size=6 mm", "mesh.order=1", "stages.1.increments=1"]
    sweep.run(path, overrides, Options(tmp_path, 2))
    written = json.loads((tmp_path / "sweep.json").read_text())
    shear = {c["name"]: c["numbers"]["stem_cement.shear_p95"] for c in written["cases"]}
    for thickness in (2, 4):
        part = f"friction/cement_thickness={thickness}mm_friction_coefficient="
        values = [shear[f"{part}{f}"] for f in (0.2, 0.4, 0.6, 0.8)]
        assert values == sorted(values) and values[3] > 2 * values[0]
    spread = written["uncertainty"]["uncertain"]["numbers"]["stem_cement.shear_p95"]
    friction, modulus = spread["correlation"].values()
    assert friction > 0.7 and friction > modulus
