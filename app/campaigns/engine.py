"""Snakemake: runs the jobs of a batch on this machine, or each as a job of a Slurm cluster.

On a cluster only ``sbatch``, ``squeue`` and ``scancel`` are called: no accounting is needed. Of
jobs of one name Slurm runs one at a time, whoever submitted it: where a batch was killed and its
jobs go on, none is run twice.
"""

from __future__ import annotations

import hashlib
import importlib.util
import logging
import os
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import metadata
from pathlib import Path

from app.errors import EnvironmentProblem
from app.soundness import memory
from app.system import ranks

log = logging.getLogger("mantle")

HERE = Path(__file__).parent
SNAKEFILE, SLURM_STATUS = HERE / "Snakefile", HERE / "slurm_status"
MEGABYTE = 1e6
POLL = 0.1  # s
SAME_SIGNAL = 1.0  # s
JOBS_AT_ONCE = 1000  # in the queue of Slurm
LATENCY = 60  # s after which files that a node wrote are seen here


def check(slurm: bool) -> None:
    """See that runs can be started from here.

    Raises:
        EnvironmentProblem: There is no Snakemake, no Slurm, or a Snakemake without ``--cluster``.
    """
    if importlib.util.find_spec("snakemake") is None:
        raise EnvironmentProblem("many runs need Snakemake (Debian: snakemake)")
    for program in ("sbatch", "squeue", "scancel") if slurm else ():
        if shutil.which(program) is None:
            raise EnvironmentProblem(
                f"Slurm was asked for, but {program} is not here (Debian: slurm-client); "
                "mantle has to be installed where jobs are submitted, not in a container there"
            )
    if slurm and not (version := metadata.version("snakemake")).startswith("7."):
        raise EnvironmentProblem(f"Slurm needs Snakemake 7 (as in Debian 13); this is {version}")


def execute(
    folder: Path, cores: int, slurm: Sequence[str] | None, alone: bool, watch: Callable[[], None]
) -> None:
    """Have Snakemake run what ``jobs.json`` lists.

    Args:
        folder: The folder of the batch.
        cores: Cores of this machine to use at most.
        slurm: Options of sbatch; None to run here.
        alone: Whether nothing else may run on a node beside a run.
        watch: Called all the time; whatever it raises stops the runs.

    Raises:
        KeyboardInterrupt: By SIGINT, SIGTERM or SIGHUP; all that ran has saved its state.
    """
    # Should this process be killed, Snakemake starts nothing more. What runs goes on under locks of
    # its own: who comes next waits for it.
    command = ["setpriv", "--pdeathsig", "KILL", sys.executable, "-m", "snakemake"]
    command += ["--snakefile", str(SNAKEFILE), "--keep-going", "--rerun-incomplete"]
    command += ["--nolock", "--scheduler", "greedy"]  # the lock of one that was killed would stay
    environ = dict(os.environ)
    if slurm is None:
        # As many at a time as there are cores for, and memory.
        megabytes = int(memory.available({}) / MEGABYTE)
        command += ["--cores", str(cores), "--resources", f"memory={megabytes}"]
    else:
        command += _slurm_options(folder, slurm, alone)
        # Jobs inherit it: without what keeps Open MPI to a single machine.
        environ = {k: v for k, v in environ.items() if ranks.ONE_NODE.get(k) != v}
    # Snakemake cannot do without a cache of its own, wherever home is.
    environ["XDG_CACHE_HOME"] = str(folder.resolve() / ".snakemake")
    with _interruptible(), (folder / "snakemake.log").open("w") as said:
        # In a session of its own: Ctrl-C is for this process, which passes it on once.
        child = subprocess.Popen(
            command,
            cwd=folder,
            env=environ,
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            while child.poll() is None:
                time.sleep(POLL)
                watch()
        except BaseException:
            _stop(child)
            raise


def _slurm_options(folder: Path, extra: Sequence[str], alone: bool) -> list[str]:
    """Options of Snakemake in place of ``--cores``; those of sbatch that are given win."""
    prefix = f"mantle-{hashlib.sha256(bytes(folder.resolve())).hexdigest()[:10]}-"
    job = ["--job-name", prefix + "{wildcards.id}", "--dependency", "singleton"]
    # A task per rank: of --cpus-per-task Open MPI makes a single slot.
    job += ["-n", "{threads}", "-c", "1", "-D", ".", "-o", "runs/{wildcards.id}.slurm"]
    job += ["--exclusive"] if alone else []
    job += [word.replace("{", "{{").replace("}", "}}") for word in extra]
    return [
        *("--cluster", shlex.join(["sbatch", "--parsable", *job])),
        *("--cluster-status", shlex.join(["sh", str(SLURM_STATUS)])),
        *("--cluster-cancel", "scancel"),
        *("--jobs", str(JOBS_AT_ONCE), "--latency-wait", str(LATENCY)),
    ]


@contextmanager
def _interruptible() -> Iterator[None]:
    """Have SIGTERM and SIGHUP end the block as Ctrl-C does."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {n: signal.signal(n, signal.default_int_handler) for n in numbers}
    try:
        yield
    finally:
        for n, handler in before.items():
            signal.signal(n, handler)


def _stop(child: subprocess.Popen[bytes]) -> None:
    """Interrupt Snakemake and its jobs and wait for them; kill them at the second interruption.

    On a cluster it cancels its jobs.
    """
    log.info("stopping; running cases save their state first (once more: stop at once)")
    end = time.monotonic() + SAME_SIGNAL
    _send(child, signal.SIGINT)
    while True:
        try:
            child.wait()
            return
        except KeyboardInterrupt:
            # One Ctrl-C may arrive twice: from the terminal and from whatever started this.
            if time.monotonic() > end:
                _send(child, signal.SIGKILL)


def _send(child: subprocess.Popen[bytes], number: int) -> None:
    """Send a signal to the process group of a child, if there is anybody in it."""
    with suppress(ProcessLookupError):
        os.killpg(child.pid, number)
