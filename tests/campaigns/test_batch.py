"""Many runs: what is run again and what is not, how failures and interruptions end.

Most of these run a stand-in for ``mantle run``, which leaves what a run leaves in no time: a
summary with the mesh size, an exit code for the sizes that a file lists, a line for every call.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import logging
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

import meshes
from app.campaigns import batch, cluster, scheduler
from app.campaigns.runs import Job, Result
from app.case.case import load
from app.case.geometries import MeshFile
from app.errors import EnvironmentProblem, InputError, StoppedError
from app.system import identity, layout
from tests import support

CASE = """\
geometry:
  kind: blocks
  blocks: [{name: one, size: [4 mm, 4 mm, 4 mm]}]
mesh: {order: 1, size: 4 mm}
regions: {one: {youngs_modulus: 1 GPa, poisson_ratio: 0.3, tissue: other}}
supports: {base: {kind: fixed, boundary: bottom}}
"""

# Names without elements.
NO_MESH = """\
$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
2
2 1 "bottom"
3 2 "one"
$EndPhysicalNames
"""

STAND_IN = """\
import json, os, pathlib, re, sys, time
here = pathlib.Path(__file__).parent
case, output = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[3])
size = re.search(r"size: (\\S+) mm$", case.read_text(), re.M).group(1)
with (here / "calls").open("a") as file:
    file.write(" ".join([size, *sys.argv[4:], os.environ["OMP_NUM_THREADS"]]) + "\\n")
for word in (here / "broken").read_text().split():
    if word == size:
        sys.exit("the mesh is bad\\nmesh.size is cursed")
running = here / "running"
running.mkdir(exist_ok=True)
(running / size).touch()
def note():
    most = here / "most"
    count = len(list(running.iterdir()))
    most.write_text(str(max(count, int(most.read_text() if most.exists() else 0))))
    return count
try:
    time.sleep(float((here / "seconds").read_text()))
    # Some are to run at the same time: they wait for each other, but not for ever.
    wanted, end = int((here / "meet").read_text()), time.monotonic() + 60
    while note() < wanted and not (here / "met").exists() and time.monotonic() < end:
        time.sleep(0.02)
    if wanted > 1:
        (here / "met").touch()
    (running / size).unlink(missing_ok=True)
except KeyboardInterrupt:
    sys.exit(5)
output.mkdir(parents=True, exist_ok=True)
(output / "summary.json").write_text(json.dumps({"size": float(size)}))
(output / "DONE").write_text("")
"""


class Bench:
    """A folder with a case and the stand-in."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.case, self.out = folder, folder / "case.yaml", folder / "out put"
        self.case.write_text(CASE)
        (folder / "mantle.py").write_text(STAND_IN)
        self.break_()
        self.take(0)
        self.meet(1)

    def break_(self, *sizes: float) -> None:
        (self.folder / "broken").write_text(" ".join(map(str, sizes)))

    def take(self, seconds: float) -> None:
        (self.folder / "seconds").write_text(str(seconds))

    def meet(self, count: int) -> None:
        """So many have to run at the same time."""
        (self.folder / "meet").write_text(str(count))

    def calls(self) -> list[str]:
        """The calls since the last time."""
        path = self.folder / "calls"
        lines = path.read_text().splitlines() if path.exists() else []
        path.unlink(missing_ok=True)
        return sorted(lines)

    def job(self, size: float, *more: str, **options: object) -> Job:
        return Job(f"size-{size}", self.case, (f"mesh.size={size} mm", *more), **options)  # type: ignore[arg-type]

    def run(self, *jobs: Job) -> list[Result]:
        return batch.run(jobs, self.out, 2)

    def sizes(self) -> list[float]:
        return [float(line.split()[0]) for line in self.calls()]


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    monkeypatch.setattr(batch, "MANTLE_RUN", (sys.executable, str(tmp_path / "mantle.py")))
    return Bench(tmp_path)


def test_failures_are_isolated_and_alone_run_again(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "mantle")
    bench.break_(2.0)
    jobs = [bench.job(1.0), bench.job(2.0), bench.job(3.0)]
    results = bench.run(*jobs)
    assert [r.job for r in results] == jobs
    assert [r.exit_code for r in results] == [0, 1, 0]
    assert [r.summary for r in results] == [{"size": 1.0}, {}, {"size": 3.0}]
    assert results[1].message == "the mesh is bad\nmesh.size is cursed" and not results[0].message
    assert all(0 < r.seconds < 20 for r in results)
    assert bench.sizes() == [1.0, 2.0, 3.0]
    lines = [m for m in caplog.messages if m.startswith("[")]
    assert [m[:6] for m in lines] == ["[1/3] ", "[2/3] ", "[3/3] "]
    assert any("size-2.0 failed with exit code 1" in m for m in lines)
    assert all(re.search(r"size-[13].0 done in \d+.\d s", m) for m in lines if "failed" not in m)
    assert "left)" in lines[0] and "left" not in lines[2] and "(1 failed)" in lines[2]

    bench.break_()
    caplog.clear()
    results = bench.run(*jobs)
    assert bench.sizes() == [2.0]
    assert [r.exit_code for r in results] == [0, 0, 0] and results[1].summary == {"size": 2.0}
    assert re.search(r"\[3/3\] size-2.0 done", caplog.text)

    # Nothing to do: Snakemake is not even started.
    before = {p: p.stat().st_mtime_ns for p in bench.out.rglob("[!.]*")}
    assert bench.run(*jobs) == results and bench.calls() == []
    assert {p: p.stat().st_mtime_ns for p in bench.out.rglob("[!.]*")} == before


def test_what_changed_runs_again_and_the_same_runs_once(bench: Bench) -> None:
    """Also under another name or written otherwise, but not for another number of ranks."""
    first = bench.run(bench.job(1.0), bench.job(2.0))
    assert bench.sizes() == [1.0, 2.0]
    jobs = [
        Job("another name", bench.case, ("mesh.size=0.1 cm",)),
        bench.job(2.0, "regions.one.poisson_ratio=0.2"),
        bench.job(2.0, ranks=2),
        bench.job(3.0),
        Job("twin", bench.case, ("mesh.size=3000 um",), alone=True),
    ]
    results = bench.run(*jobs)
    assert bench.calls() == [
        "2.0 --restart auto -n 2 1",
        "2.0 --restart auto 1",
        "3.0 --restart auto 1",
    ]
    assert [r.summary["size"] for r in results] == [1, 2, 2, 3, 3]
    assert results[0].folder == first[0].folder
    assert results[3].folder == results[4].folder
    assert re.fullmatch("case-[0-9a-f]{10}", results[3].folder.name)
    assert len({r.folder for r in results}) == 4
    # Comments in the case file are not content.
    bench.case.write_text(CASE + "# a comment\n")
    bench.run(*jobs)
    assert bench.calls() == []


def test_a_changed_mesh_file_runs_again(bench: Bench) -> None:
    mesh = bench.folder / "box.msh"
    case = load(bench.case).config
    meshes.write_msh(meshes.build(case.geometry, case.mesh), mesh)
    text = re.sub(r"geometry:\n.*\n.*\n", "geometry: {kind: file, path: box.msh}\n", CASE)
    bench.case.write_text(text)
    (first,) = bench.run(bench.job(1.0))
    saved = load(next((bench.out / "cases").iterdir())).config
    assert isinstance(saved.geometry, MeshFile) and saved.geometry.path == mesh
    os.utime(mesh)
    assert bench.run(bench.job(1.0)) == [first] and len(bench.calls()) == 1
    mesh.write_text(mesh.read_text() + "\n")
    (second,) = bench.run(bench.job(1.0))
    assert second.folder != first.folder and len(bench.calls()) == 1


def test_a_name_may_be_longer_than_that_of_a_file(bench: Bench) -> None:
    job = Job("x" * 300, bench.case)
    (result,) = bench.run(job)
    assert result.exit_code == 0 and result.job.name == "x" * 300


@pytest.mark.parametrize("part", ["mantle", "dolfinx", "petsc", "gmsh", "blas"])
def test_what_another_stack_has_done_is_not_done(
    part: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = tmp_path / "case.yaml"
    case.write_text(CASE)
    known = dict.fromkeys(identity.parts(), "1")
    monkeypatch.setattr(identity, "parts", lambda: known)
    (planned,) = batch.look([Job("one", case)], tmp_path / "out", 1)
    planned.folder.mkdir(parents=True)
    (planned.folder / "summary.json").write_text("{}")
    (planned.folder / "DONE").write_text("")
    assert batch.look([Job("one", case)], tmp_path / "out", 1)[0].exit_code == 0
    known[part] = "2"
    assert batch.look([Job("one", case)], tmp_path / "out", 1)[0].exit_code == 5


def test_bad_jobs_are_told_together_before_anything_runs(bench: Bench) -> None:
    jobs = [
        bench.job(1.0),
        Job("a", bench.case, ("mesh.sise=2 mm",)),
        Job("b", bench.case, ("mesh.size=2 N",)),
        Job("c", bench.folder / "none.yaml"),
        Job("d", bench.case, ranks=0),
    ]
    with pytest.raises(InputError) as error:
        bench.run(*jobs)
    messages = error.value.messages
    assert len(messages) == 4
    for message, start in zip(messages, ("a: --set mesh.sise", "b: --set mesh.size"), strict=False):
        assert message.startswith(start)
    assert "none.yaml: no such file" in messages[2] and messages[3].startswith("d: 0 is not")
    assert not bench.out.exists() and bench.calls() == []
    bench.out.write_text("a file")
    with pytest.raises(InputError, match="cannot be written"):
        bench.run(bench.job(1.0))


def test_alone_means_alone_and_one_thread_each(bench: Bench) -> None:
    """Two jobs at a time on two cores, unless they are to be timed."""
    bench.take(0.2)
    bench.run(*(bench.job(s, alone=True) for s in (1.0, 2.0)))
    assert (bench.folder / "most").read_text() == "1"
    # Snakemake would give each as many threads as cores.
    assert all(line.endswith(" 1") for line in bench.calls())
    bench.meet(2)
    bench.run(*(bench.job(s) for s in (3.0, 4.0)))
    assert (bench.folder / "most").read_text() == "2"
    assert all(line.endswith(" 1") for line in bench.calls())


@pytest.mark.slow
def test_runs_that_need_most_of_the_memory_run_one_by_one(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the cores; less than half of the memory each, they run together."""
    monkeypatch.setattr(batch.sizing, "available", lambda environ: 8e9)
    monkeypatch.setattr(batch.sizing, "needed", lambda case: 5e9)
    bench.take(0.2)
    bench.run(*(bench.job(s) for s in (1.0, 2.0)))
    assert (bench.folder / "most").read_text() == "1"
    monkeypatch.setattr(batch.sizing, "needed", lambda case: 3e9)
    bench.meet(2)
    bench.run(*(bench.job(s) for s in (3.0, 4.0)))
    assert (bench.folder / "most").read_text() == "2"


def left_running(bench: Bench) -> list[str]:
    """Other processes that have to do with the batch."""
    here, found = str(bench.folder).encode(), []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            if here in path.read_bytes() and path.parent.name != str(os.getpid()):
                found.append(path.parent.name)
    return found


def test_nothing_runs_on_where_the_table_cannot_be_written(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One case has failed, the other is running."""
    monkeypatch.setattr(scheduler, "OFTEN", 0.0)
    bench.take(60)
    bench.break_(2.0)

    def tell(results: object) -> None:
        deadline = time.monotonic() + 120
        while len((bench.folder / "calls").read_text().splitlines()) < 2:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        raise InputError("the disk is full")

    with pytest.raises(InputError, match="the disk is full"):
        batch.run([bench.job(1.0), bench.job(2.0)], bench.out, 2, so_far=tell)
    assert not left_running(bench)


def test_interruption_leaves_nothing_running_and_is_resumed(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    """The third of three is interrupted; afterwards only it runs."""
    caplog.set_level(logging.INFO, "mantle")
    bench.run(bench.job(1.0), bench.job(2.0))
    bench.calls()
    bench.take(60)
    jobs = [bench.job(s) for s in (1.0, 2.0, 3.0)]

    def interrupt() -> None:
        deadline = time.monotonic() + 120
        while not (bench.folder / "calls").exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with pytest.raises(StoppedError, match="stopped after") as error:
        bench.run(*jobs)
    thread.join()
    assert error.value.exit_code == 5
    assert not left_running(bench)
    assert bench.sizes() == [3.0]
    bench.take(0)
    assert [r.exit_code for r in bench.run(*jobs)] == [0, 0, 0]
    assert bench.sizes() == [3.0]


def test_a_killed_batch_does_not_block_the_next(bench: Bench) -> None:
    """Everything is killed while a case runs; and while it lives, no second batch may start."""
    bench.take(60)
    script = (
        "import sys, pathlib; from app.campaigns import batch;"
        "from app.campaigns.runs import Job;"
        "batch.MANTLE_RUN = tuple(sys.argv[2:4]);"
        "case = pathlib.Path(sys.argv[1]) / 'case.yaml';"
        "job = Job('size-1.0', case, ('mesh.size=1.0 mm',));"
        "batch.run([job], case.parent / 'out put', 1)"
    )
    first = subprocess.Popen(
        [sys.executable, "-c", script, bench.folder, *batch.MANTLE_RUN],
        env=support.environment(),
        stdout=subprocess.DEVNULL,
    )
    deadline = time.monotonic() + 120
    while not (bench.folder / "calls").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    with pytest.raises(InputError, match="another batch"):
        bench.run(bench.job(1.0))
    mine = [
        path.parent
        for path in Path("/proc").glob("[0-9]*/cmdline")
        if path.parent.name != str(os.getpid()) and str(bench.folder).encode() in path.read_bytes()
    ]
    children = [
        int(path.parent.name)
        for path in Path("/proc").glob("[0-9]*/stat")
        if path.parent in mine or path.read_text().rpartition(")")[2].split()[1] == str(first.pid)
    ]
    assert len(children) >= 3  # the batch, Snakemake, the case
    for number in children:
        os.kill(number, signal.SIGKILL)
    first.wait()
    bench.calls()
    bench.take(0)
    deadline = time.monotonic() + 120
    while True:  # until the last of them has let go of the lock
        try:
            (result,) = bench.run(bench.job(1.0))
            break
        except InputError:
            assert time.monotonic() < deadline
            time.sleep(0.1)
    assert result.exit_code == 0 and bench.sizes() == [1.0]


def test_a_broken_snakemake_is_told(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bad = bench.folder / "Snakefile"
    bad.write_text("rule: nonsense nonsense\n")
    monkeypatch.setattr(scheduler, "SNAKEFILE", bad)
    with pytest.raises(EnvironmentProblem, match=r"Snakemake failed(?s:.*)SyntaxError"):
        bench.run(bench.job(1.0))


def test_a_result_that_cannot_be_read_runs_again(bench: Bench) -> None:
    """`mantle run` would take it for finished."""
    (first,) = bench.run(bench.job(1.0))
    bench.calls()
    (first.folder / "summary.json").write_text("{")
    bench.break_(1.0)
    (second,) = bench.run(bench.job(1.0))
    assert second.exit_code == 1 and bench.sizes() == [1.0]
    assert not (first.folder / "DONE").exists()


@pytest.mark.slow
def test_two_controllers_run_a_case_in_turn(bench: Bench) -> None:
    """The second waits for what the first left running, as Slurm does when a batch is killed."""
    bench.take(1.0)
    (first,) = bench.run(bench.job(1.0))
    bench.calls()
    (first.folder / "DONE").unlink()
    lock = first.folder.with_name(f"{first.folder.name}.lock").open("w")
    fcntl.flock(lock, fcntl.LOCK_EX)
    ends: list[float] = []

    def leave() -> None:
        time.sleep(2.0)
        assert not (bench.folder / "calls").exists()
        ends.append(time.time())
        lock.close()

    thread = threading.Thread(target=leave)
    thread.start()
    (second,) = bench.run(bench.job(1.0))
    thread.join()
    begin = float((first.folder.with_name(f"{first.folder.name}.status")).read_text().split()[1])
    assert second.exit_code == 0 and ends and begin >= ends[0]
    assert bench.sizes() == [1.0]


def test_missing_slurm_is_told_before_anything_is_written(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(bench.folder))
    with pytest.raises(EnvironmentProblem, match="sbatch is not here") as error:
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
def test_states_of_jobs(answer: str, code: int, state: str, tmp_path: Path) -> None:
    squeue = tmp_path / "squeue"
    squeue.write_text(f"#!/bin/sh\necho '{answer}'\nexit {code}\n")
    squeue.chmod(0o755)
    path = f"{tmp_path}:{os.environ['PATH']}"
    done = subprocess.run(
        ["sh", cluster.STATUS, "17"], env={"PATH": path}, capture_output=True, text=True
    )
    assert (done.stdout, done.stderr, done.returncode) == (f"{state}\n", "", 0)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(1.234, "1.2 s"), (45.6, "46 s"), (300, "5 min"), (5400, "1.5 h")],
)
def test_duration(seconds: float, text: str) -> None:
    assert layout.duration(seconds) == text


def test_real_runs(tmp_path: Path) -> None:
    """``mantle run`` itself, on two ranks beside a case with a bad mesh."""
    case = tmp_path / "case.yaml"
    case.write_text(CASE)
    (tmp_path / "bad.msh").write_text(NO_MESH)
    bad_mesh = ("geometry={kind: file, path: bad.msh}",)
    jobs = [Job("two", case, ranks=2), Job("bad", case, bad_mesh)]
    two, bad = batch.run(jobs, tmp_path / "out", 2)
    assert two.exit_code == 0 and two.summary["status"] == "converged"
    assert two.summary["solver"]["ranks"] == 2 and (two.folder / "fields.vtkhdf").exists()
    assert bad.exit_code == 3 and "bad.msh" in bad.message and bad.summary == {}


def test_two_runs_at_once_make_their_mesh_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = support.case(CASE)
    data = meshes.build(case.geometry, case.mesh)
    made = []

    def generate(geometry: object, mesh: object) -> meshes.MeshData:
        made.append(1)
        time.sleep(0.3)
        return data

    monkeypatch.setattr(meshes, "_generate", generate)
    threads = [
        threading.Thread(target=meshes.build, args=(case.geometry, case.mesh, tmp_path))
        for _ in range(2)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(made) == 1


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


@pytest.mark.parametrize("words", [WICKED[::3], pytest.param(WICKED, marks=pytest.mark.slow)])
def test_names_values_and_folders_are_never_commands(bench: Bench, words: list[str]) -> None:
    """Neither those of cases nor what is in them, by Snakemake, the shell or Python."""
    bench.out = bench.folder / "out ;$(touch PWNED) '{x}"
    jobs = [
        Job(word, bench.case, ("mesh.size=4 mm", f"title={json.dumps(word)}")) for word in words
    ]
    results = bench.run(*jobs)
    assert [r.exit_code for r in results] == [0] * len(jobs), results
    assert len(bench.calls()) == len(jobs)
    for word, result in zip(words, results, strict=True):
        assert result.folder.parent == bench.out / "runs"
        case = load(bench.out / "cases" / f"{result.folder.name}.yaml").config
        assert case.title == load(bench.case, jobs[words.index(word)].overrides).config.title
        assert case.title.split() == word.split()
    everything = [*bench.folder.rglob("*"), *bench.folder.parent.glob("*")]
    assert not [p for p in everything if p.name == "PWNED"]
