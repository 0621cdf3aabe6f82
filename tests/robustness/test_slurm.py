"""Many runs by a real Slurm, whose daemons run in separate namespaces on this machine.

Each case is solved on two ranks. A wrapper between Slurm and ``mantle run`` records the end of
every call.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from app.campaigns import batch
from app.campaigns.runs import Result
from app.case.case import PlannedRun
from app.foundation.errors import EnvironmentProblem, StoppedError
from tests import support

pytestmark = pytest.mark.slow
PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "squeue", "scontrol", "unshare")
NAMESPACES = ("unshare", "-m", "-p", "-f", "--kill-child", "--propagation", "unchanged")
RANKS = 2
CASES = 6
PATIENCE = 240.0  # s

CONFIGURATION = """\
ClusterName=mantle
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SlurmdParameters=config_overrides
SchedulerParameters=sched_interval=2,bf_interval=2
MpiDefault=none
KillWait=5
NodeName={host} NodeAddr=127.0.0.1 CPUs=4 RealMemory=1000
PartitionName=all Nodes=ALL Default=YES State=UP
"""
# The first process of its namespace: with it all others end, jobs included.
DAEMONS = """\
mount --make-rprivate /proc && mount -t proc proc /proc || exit
munged --force --foreground --key-file=key --socket="$PWD/munge.socket" \\
    --pid-file="$PWD/munge.pid" --log-file="$PWD/munged.log" --seed-file="$PWD/munge.seed" &
while [ ! -S munge.socket ]; do sleep 0.1; done
slurmctld -D -c &
slurmd -D &
wait
"""
# Runs a case and writes down whether it was solved or was finished before.
COUNTED = """\
import pathlib, subprocess, sys, time
here = pathlib.Path(__file__).parent
while (here / "hold").exists():
    time.sleep(0.1)
done = subprocess.run(
    [sys.executable, "-m", "mantle", "run", *sys.argv[1:]], stdout=subprocess.PIPE, text=True
)
print(done.stdout)
what = "solved" if "converged: " in done.stdout else "finished" if "already" in done.stdout else "-"
with (here / "calls").open("a") as file:
    file.write(f"{pathlib.Path(sys.argv[3]).name} {done.returncode} {what}\\n")
sys.exit(done.returncode)
"""
CONTROLLER = """\
import logging, pathlib, sys
from app.campaigns import batch
from tests.robustness.test_slurm import batch_of
logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stdout)
batch_of(pathlib.Path(sys.argv[1]), int(sys.argv[2]))
"""


def ask(*command: str) -> str:
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def queue() -> dict[str, str]:
    """The states of the jobs that wait or run."""
    lines = ask("squeue", "--noheader", "--format=%i %T").splitlines()
    return {number: state for number, state in (line.split() for line in lines)}


@pytest.fixture(scope="module", autouse=True)
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A Slurm of one node with four processors, to which the environment points."""
    missing = [program for program in PROGRAMS if shutil.which(program) is None]
    if missing:
        pytest.skip(
            f"no {', '.join(missing)} here; ./mantle setup --all installs packages-optional.txt"
        )
    if subprocess.run([*NAMESPACES, "true"], capture_output=True).returncode:
        pytest.skip("this user may not open namespaces")
    folder = tmp_path_factory.mktemp("slurm")
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(2)]
    ports = [s.getsockname()[1] for s in sockets]
    for s in sockets:
        s.close()
    host = socket.gethostname().partition(".")[0]
    text = CONFIGURATION.format(host=host, ports=ports, folder=folder)
    (folder / "slurm.conf").write_text(text)
    (folder / "cgroup.conf").write_text("CgroupPlugin=disabled\n")
    (folder / "key").write_bytes(os.urandom(128))
    (folder / "key").chmod(0o400)
    for name in ("state", "spool"):
        (folder / name).mkdir()
    libc = ctypes.CDLL(None)
    with pytest.MonkeyPatch.context() as patch:
        # CI has Snakemake look every second instead of every ten.
        variables = {"SLURM_CONF": str(folder / "slurm.conf"), "CI": "true"}
        variables["PATH"] = os.environ["PATH"].replace("/run/mantle:", "")  # the Slurm of the host
        for name, value in (support.environment() | variables).items():
            patch.setenv(name, value)
        with (folder / "daemons.log").open("w") as printed:
            daemons = subprocess.Popen(
                [*NAMESPACES, "sh", "-c", DAEMONS],
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=printed,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=lambda: libc.prctl(1, signal.SIGKILL),  # whatever ends the tests
            )

        def ready() -> bool:
            assert daemons.poll() is None, (folder / "daemons.log").read_text()
            up = (folder / "munge.socket").exists()
            return up and "idle" in ask("sinfo", "--noheader", "--format=%T")

        try:
            wait(ready, 60)
            yield
        finally:
            daemons.kill()
            daemons.wait()


def wait(condition: Callable[[], bool], seconds: float = PATIENCE) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def batch_of(folder: Path, cases: int, *options: str) -> list[Result]:
    """Three cases of blocks in contact with different friction, on two ranks each."""
    (folder / "counted.py").write_text(COUNTED)
    batch.MANTLE_RUN = (sys.executable, str(folder / "counted.py"))
    jobs = [
        PlannedRun.load(
            f"blocks {i}",
            support.CONFIGS / "blocks.yaml",
            ("mesh.size=4 mm", f"interfaces.cement_metal.friction_coefficient={0.3 + 0.1 * i}"),
            ranks=RANKS,
        )
        for i in range(cases)
    ]
    return batch.run(jobs, folder / "out put", 1, slurm=options)


def start(folder: Path, cases: int = CASES) -> subprocess.Popen[str]:
    return support.started("-c", CONTROLLER, folder, str(cases))


def output_of(process: subprocess.Popen[str], seconds: float = PATIENCE) -> str:
    return "".join(process.communicate(timeout=seconds))


def calls(folder: Path) -> list[str]:
    """Ends of the calls of ``mantle run``, without the case."""
    path = folder / "calls"
    return path.read_text().splitlines() if path.exists() else []


def test_slurm_killed_batch_is_resumed(tmp_path: Path) -> None:
    first = start(tmp_path)
    wait(lambda: len(calls(tmp_path)) > 0)
    first.kill()
    first.communicate()
    left = queue()
    assert set(left.values()) >= {"RUNNING", "PENDING"}  # two at a time: it was midway
    second = start(tmp_path)
    printed = output_of(second)
    assert second.returncode == 0, printed
    assert f"[{CASES}/{CASES}]" in printed and "failed" not in printed
    assert queue() == {}
    solved = [line.split()[0] for line in calls(tmp_path) if line.endswith(" 0 solved")]
    assert len(solved) == len(set(solved))
    assert CASES == len(set(solved))
    # Those that were left in the queue were submitted again, and were finished already.
    others = [line for line in calls(tmp_path) if not line.endswith(" 0 solved")]
    assert others and all(line.endswith(" 0 finished") for line in others)
    for run in solved:
        folder = tmp_path / "out put" / "runs" / run
        summary = support.summary(folder)
        assert (folder / "DONE").exists() and summary["status"] == "converged"
        assert summary["solver"]["ranks"] == RANKS
        assert "converged: " in folder.with_name(f"{run}.log").read_text()


def test_slurm_running_case_is_waited_for(tmp_path: Path) -> None:
    """The batch waits although there is room for another job."""
    (tmp_path / "hold").write_text("")
    first = start(tmp_path, 1)
    wait(lambda: any((tmp_path / "out put" / "runs").glob("*.log")))
    first.kill()
    first.communicate()
    second = start(tmp_path, 1)
    wait(lambda: len(queue()) == 2)
    time.sleep(3)
    assert sorted(queue().values()) == ["PENDING", "RUNNING"]
    (tmp_path / "hold").unlink()
    printed = output_of(second)
    assert "[1/1] blocks 0 done" in printed, printed
    assert [line.partition(" ")[2] for line in calls(tmp_path)] == ["0 solved", "0 finished"]


def test_slurm_interrupted_batch_leaves_no_job(tmp_path: Path) -> None:
    process = start(tmp_path)
    wait(lambda: set(queue().values()) >= {"RUNNING", "PENDING"})
    process.send_signal(signal.SIGINT)
    printed = output_of(process, 60)
    assert "StoppedError: stopped after" in printed, printed
    wait(lambda: queue() == {}, 30)
    done = len(list((tmp_path / "out put" / "runs").glob("*/DONE")))
    assert done < CASES
    time.sleep(3)
    assert queue() == {} and len(calls(tmp_path)) == done


def test_slurm_job_ended_by_slurm_is_a_failed_run(tmp_path: Path) -> None:
    """The options for sbatch need quotes."""
    process = start(tmp_path, 1)
    wait(lambda: "RUNNING" in queue().values())
    (number,) = queue()
    wait(lambda: any((tmp_path / "out put" / "runs").glob("*.log")))
    ask("scancel", number)
    printed = output_of(process, 60)
    assert "failed with exit code 70" in printed, printed
    logs = [p.read_text() for p in (tmp_path / "out put" / "runs").glob("*.slurm")]
    assert len(logs) == 1 and "CANCELLED" in logs[0]
    comment = '{it\'s} a "test"'
    (result,) = batch_of(tmp_path, 1, f"--comment={comment}")
    assert result.exit_code == 0 and result.summary["solver"]["ranks"] == RANKS
    newest = max(ask("squeue", "--noheader", "--states=all", "--format=%i").split(), key=int)
    assert f"Comment={comment} " in ask("scontrol", "show", "job", "-o", newest)


SWEEP = f"""\
base: {support.CONFIGS}/blocks.yaml
set: {{mesh.size: 4 mm, ranks: {RANKS}}}
grid:
  regions.metal.youngs_modulus: [{", ".join(f"{100 + 10 * i} GPa" for i in range(CASES))}]
"""


@pytest.mark.skipif("MANTLE_TREE" not in os.environ, reason="not in a tree of the launcher")
def test_slurm_jobs_use_the_tree_of_the_launcher(tmp_path: Path) -> None:
    """The batch is interrupted and repeated.

    The tree is the host's, and jobs leave no cache at home.
    """
    folder = tmp_path / "it's {mine}"
    folder.mkdir()
    (folder / "sweep.yaml").write_text(SWEEP)
    variables = {
        "MANTLE_INSIDE": "",
        "MANTLE_BACKEND": "tree",
        "XDG_CACHE_HOME": str(folder / "cache"),
    }

    def sweep() -> subprocess.Popen[str]:
        return subprocess.Popen(
            ["sh", support.ROOT / "mantle", "sweep", "sweep.yaml", "-o", "out", "--slurm"],
            cwd=folder,
            env=os.environ | variables,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    first = sweep()
    wait(lambda: first.poll() is not None or any(folder.glob("out/runs/*/DONE")))
    os.killpg(first.pid, signal.SIGINT)
    printed = output_of(first, 60)
    assert first.returncode == StoppedError.exit_code and "stopped after" in printed, printed
    wait(lambda: queue() == {}, 30)
    done = {path: path.stat().st_mtime_ns for path in folder.glob("out/runs/*/DONE")}
    assert 0 < len(done) < CASES
    second = sweep()
    printed = output_of(second)
    assert second.returncode == 0 and f"{len(done)} done already" in printed, printed
    assert len(list(folder.glob("out/runs/*/DONE"))) == CASES
    assert done == {path: path.stat().st_mtime_ns for path in done}
    for run in folder.glob("out/runs/*/"):
        summary = support.summary(run)
        assert summary["status"] == "converged" and summary["solver"]["ranks"] == RANKS
    assert not list((folder / "cache" / "fenics").iterdir())


def test_slurm_refusals_are_reported(tmp_path: Path) -> None:
    with pytest.raises(EnvironmentProblem, match="invalid partition specified: nowhere"):
        batch_of(tmp_path, 1, "--partition", "nowhere")


def test_slurm_early_end_of_a_job_is_reported(tmp_path: Path) -> None:
    with pytest.raises(EnvironmentProblem, match=r"\.slurm:\n."):
        batch_of(tmp_path, 1, "--export=PATH=/nowhere")
