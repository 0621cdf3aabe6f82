"""Batches of runs: repeated and skipped runs, failures and interruptions."""

from __future__ import annotations

import json
import logging
import os
import re
import subprocess
from pathlib import Path

import pytest

import meshes
from app.campaigns import batch, scheduler
from app.campaigns.runs import Result, result_of, runs_of
from app.case.case import PlannedRun, load_case
from app.case.geometries import MeshFile
from app.foundation.errors import EnvironmentProblem, InputError, StoppedError
from app.soundness import cost, memory
from app.system import folders, identity
from tests.campaigns.bench import CASE, Bench, wait
from tests.support import CONFIGS

SIDES = "interfaces: {lower_upper: [lower, upper]}"


def test_batch_failures_are_isolated_and_repeated(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "mantle")
    bench.write(broken="2.0")
    jobs = [bench.job(1.0), bench.job(2.0), bench.job(3.0)]
    results = bench.run(*jobs)
    assert [r.planned for r in results] == jobs
    assert [r.exit_code for r in results] == [0, 1, 0]
    assert [r.summary.get("size") for r in results] == [1.0, None, 3.0]
    assert results[1].message == "the mesh is bad\nthe block slides away"
    assert not results[0].message
    assert all(0 < r.seconds < 20 for r in results)
    assert bench.sizes() == [1.0, 2.0, 3.0]
    lines = [m for m in caplog.messages if m.startswith("[")]
    assert [m[:6] for m in lines] == ["[1/3] ", "[2/3] ", "[3/3] "]
    assert any("size-2.0 failed with exit code 1" in m for m in lines)
    assert all(re.search(r"size-[13].0 done in \d+.\d s", m) for m in lines if "failed" not in m)
    bench.write(broken="")
    results = bench.run(*jobs)
    assert bench.sizes() == [2.0]
    assert [r.exit_code for r in results] == [0, 0, 0] and results[1].summary["size"] == 2.0
    # Nothing to do: Snakemake is not even started.
    before = {p: p.stat().st_mtime_ns for p in bench.out.rglob("[!.]*")}
    assert bench.run(*jobs) == results and not bench.sizes()
    assert {p: p.stat().st_mtime_ns for p in bench.out.rglob("[!.]*")} == before
    # What cannot be read is not done.
    (results[0].folder / "summary.json").write_text("{")
    bench.write(broken="1.0")
    assert bench.run(*jobs)[0].exit_code == 1 and bench.sizes() == [1.0]


def test_batch_repeats_only_changed_runs(bench: Bench) -> None:
    """A new name or another spelling repeats no run; another number of ranks does."""
    first = bench.run(bench.job(1.0), bench.job(2.0))
    assert bench.sizes() == [1.0, 2.0]

    def run() -> list[Result]:
        return bench.run(
            PlannedRun.load("another name" * 30, bench.case, ("mesh.size=0.1 cm",)),
            bench.job(2.0, "regions.upper.poisson_ratio=0.2"),
            bench.job(2.0, ranks=2),
            bench.job(3.0),
            PlannedRun.load("twin", bench.case, ("mesh.size=3000 um",), needs_idle_machine=True),
        )

    results = run()
    assert bench.taken("calls") == [
        f"{run} 1" for run in ("2 --restart auto -n 2", "2 --restart auto", "3 --restart auto")
    ]
    assert [r.summary["size"] for r in results] == [1, 2, 2, 3, 3]
    assert results[0].folder == first[0].folder
    assert results[3].folder == results[4].folder
    assert re.fullmatch("case-[0-9a-f]{10}", results[3].folder.name)
    assert len({r.folder for r in results}) == 4
    # Comments in the case file are not content.
    bench.case.write_text(CASE + "# a comment\n")
    run()
    assert not bench.sizes()


def test_batch_repeats_runs_with_a_changed_mesh_file(bench: Bench) -> None:
    mesh = bench.folder / "box.msh"
    case = load_case(bench.case).config
    meshes.write_msh(meshes.build(case.geometry, case.mesh), mesh)
    text = re.sub(r"geometry:\n.*\n.*\n", "geometry: {kind: file, path: box.msh, SIDES}\n", CASE)
    bench.case.write_text(text.replace("SIDES", SIDES))
    first = bench.run(bench.job(1.0))
    saved = load_case(next((bench.out / "cases").iterdir())).config
    assert isinstance(saved.geometry, MeshFile) and saved.geometry.path == mesh
    os.utime(mesh)
    assert bench.run(bench.job(1.0)) == first and len(bench.sizes()) == 1
    mesh.write_text(mesh.read_text() + "\n")
    second = bench.run(bench.job(1.0))
    assert second[0].folder != first[0].folder and len(bench.sizes()) == 1


@pytest.mark.parametrize("part", ["mantle", "dolfinx", "petsc", "gmsh", "blas"])
def test_batch_repeats_runs_of_another_stack(
    part: str, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    def exit_code() -> int:
        return result_of(runs_of([job], bench.out, 1)[0], over=False).exit_code

    job = bench.job(1.0)
    known = dict.fromkeys(identity.versions(), "1")
    monkeypatch.setattr(identity, "versions", lambda: known)
    folder = runs_of([job], bench.out, 1)[0].path
    folder.mkdir(parents=True)
    for name in ("summary.json", "DONE"):
        (folder / name).write_text("{}")
    assert exit_code() == 0
    known[part] = "2"
    assert exit_code() == 5


@pytest.mark.parametrize(
    ("timed", "gigabytes", "together"),
    [(False, 3, True), (True, 3, False), (False, 5, False)],
)
def test_batch_jobs_share_cores_and_memory(
    timed: bool,
    gigabytes: int,
    together: bool,
    bench: Bench,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two jobs run on two cores with 8 GB, with one thread each. Timed jobs run alone."""
    monkeypatch.setattr(memory, "available_memory", lambda environ: 8e9)
    monkeypatch.setattr(memory, "needed", lambda case: gigabytes * 1e9)
    bench.write(seconds="0.2", meet="2" if together else "1")
    bench.run(*(bench.job(s, timed=timed) for s in (1.0, 2.0)))
    assert (bench.folder / "met").exists() == together
    # Snakemake would give each as many threads as cores.
    assert all(line.endswith(" 1") for line in bench.taken("calls"))


def test_batch_stops_if_the_table_cannot_be_written(bench: Bench) -> None:
    """One case has failed, the other is running."""
    bench.write(seconds="60", broken="2.0")

    def tell(results: object) -> None:
        wait(lambda: len((bench.folder / "calls").read_text().splitlines()) == 2)
        raise InputError("the disk is full")

    with pytest.raises(InputError, match="the disk is full"):
        batch.run([bench.job(1.0), bench.job(2.0)], bench.out, 2, so_far=tell)
    assert not bench.processes()


def test_batch_folder_has_one_batch_at_a_time(bench: Bench) -> None:
    bench.out.write_text("a file")
    with pytest.raises(StoppedError, match="cannot write"):
        bench.run(bench.job(1.0))
    bench.out.unlink()
    bench.out.mkdir()
    with folders.claim(bench.out), pytest.raises(InputError, match="another run writes"):
        bench.run(bench.job(1.0))


def test_batch_reports_a_broken_snakemake(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bad = bench.folder / "Snakefile"
    bad.write_text("rule: nonsense nonsense\n")
    monkeypatch.setattr(scheduler, "SNAKEFILE", bad)
    with pytest.raises(EnvironmentProblem, match=r"Snakemake failed(?s:.*)SyntaxError"):
        bench.run(bench.job(1.0))


def test_batch_reports_missing_slurm_first(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(bench.folder))
    with pytest.raises(EnvironmentProblem, match="sbatch is not installed") as error:
        batch.run([bench.job(1.0)], bench.out, 2, slurm=("--mem=1G",))
    assert error.value.exit_code == 69 and not bench.out.exists()


@pytest.mark.parametrize(
    ("answer", "code", "state"),
    [
        ("COMPLETED", 0, "success"),
        ("PENDING", 0, "running"),
        ("COMPLETING", 0, "running"),
        ("TIMEOUT", 0, "failed"),
        ("CANCELLED", 0, "failed"),
        ("", 0, "failed"),
        ("slurm_load_jobs error: Invalid job id specified", 1, "failed"),
        ("slurm_load_jobs error: Unable to contact slurm controller", 1, "running"),
    ],
)
def test_batch_states_of_jobs(answer: str, code: int, state: str, tmp_path: Path) -> None:
    squeue = tmp_path / "squeue"
    squeue.write_text(f"#!/bin/sh\necho '{answer}'\nexit {code}\n")
    squeue.chmod(0o755)
    path = f"{tmp_path}:{os.environ['PATH']}"
    done = subprocess.run(
        ["sh", scheduler.SLURM_STATUS, "17"], env={"PATH": path}, capture_output=True, text=True
    )
    assert (done.stdout, done.stderr, done.returncode) == (f"{state}\n", "", 0)


def test_batch_of_real_runs(tmp_path: Path) -> None:
    """``mantle run`` solves the cases on two ranks. One block is pulled off and fails."""
    case = tmp_path / "case.yaml"
    case.write_text(CASE)
    jobs = [
        PlannedRun.load("two", case, ranks=2),
        PlannedRun.load("off", case, ("loads.press.pressure=-2 MPa",)),
    ]
    two, off = batch.run(jobs, tmp_path / "out", 2)
    assert two.exit_code == 0 and two.summary["status"] == "converged"
    assert two.summary["solver"]["ranks"] == 2 and (two.folder / "fields.vtkhdf").exists()
    assert off.exit_code == 4 and "nothing holds body 'upper'" in off.message and not off.summary


WICKED = [
    "$(touch PWNED)",
    "`touch PWNED`",
    "; touch PWNED; :",
    "' ; touch PWNED ; '",
    '" ; touch PWNED ; "',
    "a\ntouch PWNED\n",
    "{wildcards.id} {{x}} {input:q}",
    "../../../PWNED",
    "-o PWNED --force",
    "| tee PWNED > PWNED & \\",
    "%(x)s ${HOME} ~ * ?",
]


def test_batch_names_and_values_are_never_commands(bench: Bench) -> None:
    """Snakemake, the shell and Python execute neither names of cases nor values in them."""
    bench.out = bench.folder / "out ;$(touch PWNED) '{x}"
    jobs = [PlannedRun.load(word, bench.case, (f"title={json.dumps(word)}",)) for word in WICKED]
    results = bench.run(*jobs)
    assert [r.exit_code for r in results] == [0] * len(jobs), results
    for word, result in zip(WICKED, results, strict=True):
        case = load_case(bench.out / "cases" / f"{result.folder.name}.yaml").config
        assert case.title.split() == word.split()
    everything = [*bench.folder.rglob("*"), *bench.folder.parent.glob("*")]
    assert not [p for p in everything if p.name == "PWNED"]


def test_batch_run_killed_for_memory_names_its_need(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The system kills a run by SIGKILL.

    The exit code is that of the environment, and fewer runs start at once.
    """
    stance = CONFIGS / "stance.yaml"
    case = load_case(stance).config
    need = cost.gigabytes(case)
    monkeypatch.setattr(memory, "available_memory", lambda: 2.4e9 * need)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(9)))
    job = PlannedRun.load("stance", stance, ranks=3)
    (run,) = runs_of([job], tmp_path, 6)
    run.path.parent.mkdir(parents=True)
    run.file("status").write_text("100.0 130.0 137\n")
    result = result_of(run)
    assert result.exit_code == EnvironmentProblem.exit_code
    memories = f"each run needs about {need:.1f} GB, {2.4 * need:.1f} GB are available"
    assert f"killed, probably out of memory: {memories}" in result.message
    assert "run the same command again to continue, with --cores 6: at most 2" in result.message
    # All cores can be used with the memory that is left.
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(6)))
    assert result_of(run).message.endswith("are available; run the same command again to continue")
    # Another signal is reported as it is.
    run.file("status").write_text("100.0 130.0 139\n")
    other = result_of(run)
    assert other.exit_code == 139 and other.message == "killed by SIGSEGV"
