"""Snakemake: run the jobs of a batch on this machine, or each as a job of a Slurm cluster.

On a cluster only ``sbatch``, ``squeue`` and ``scancel`` are called: no accounting is needed. Slurm
runs jobs of the same name one after another. So if a batch was killed while its jobs continue, a
new batch does not run them a second time. Where the launcher runs mantle in its own Debian tree,
``sbatch``, ``squeue`` and ``scancel`` are those of the host, and each job enters the tree by a
script of the launcher.
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
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib import metadata
from pathlib import Path

from app.foundation.errors import EnvironmentProblem
from app.soundness import memory
from app.system import ranks

log = logging.getLogger("mantle")

HERE = Path(__file__).parent
SNAKEFILE = HERE / "Snakefile"
# Script from which Snakemake gets the status of a Slurm job.
SLURM_STATUS = HERE / "slurm_status"
MEGABYTE = 1e6
# Time between checks of Snakemake [s].
POLL = 0.1
# Largest number of jobs in the queue of Slurm.
JOBS_AT_ONCE = 1000
# Template of the script of a Slurm job if mantle runs in the launcher's tree.
TREE_JOB = Path("/run/mantle/job")
# Time until this machine sees a file that a node has written [s].
LATENCY = 60


Watch = Callable[[], None]


def check(slurm: bool) -> None:
    """Check that Snakemake is installed, and Slurm if it is used.

    Raises:
        EnvironmentProblem: Either is missing, or Snakemake has no ``--cluster``.
    """
    if importlib.util.find_spec("snakemake") is None:
        raise EnvironmentProblem("many runs need Snakemake (Debian: snakemake)")
    for program in ("sbatch", "squeue", "scancel") if slurm else ():
        if shutil.which(program) is None:
            raise EnvironmentProblem(
                f"Slurm was requested, but {program} is not installed (Debian: slurm-client); run "
                "mantle where jobs are submitted, outside a container"
            )
    if slurm:
        version = metadata.version("snakemake")
        if not version.startswith("7."):
            message = f"Slurm needs Snakemake 7 (as in Debian 13); this is {version}"
            raise EnvironmentProblem(message)


def execute(
    folder: Path, cores: int, slurm: Sequence[str] | None, exclusive: bool, watch: Watch
) -> None:
    """Run the jobs of ``jobs.json`` by Snakemake, on this machine or by Slurm.

    Args:
        folder: Folder of the batch.
        cores: Number of cores of this machine.
        slurm: Options of sbatch; None to run on this machine.
        exclusive: True if a Slurm job has its node for itself.
        watch: Function that is called repeatedly. An exception from it stops the runs.

    Raises:
        KeyboardInterrupt: By SIGINT, SIGTERM or SIGHUP; running cases have saved their state.
    """
    # If this process is killed, Snakemake starts nothing more. Running cases continue and
    # keep their locks, for which the next batch waits.
    command = ["setpriv", "--pdeathsig", "KILL", sys.executable, "-m", "snakemake"]
    command += ["--snakefile", str(SNAKEFILE), "--keep-going", "--rerun-incomplete"]
    command += ["--nolock", "--scheduler", "greedy"]  # a killed Snakemake would leave its lock
    environ = dict(os.environ)
    if slurm is None:
        # Snakemake runs as many jobs at once as cores and memory allow.
        megabytes = int(memory.available_memory({}) / MEGABYTE)
        command += ["--cores", str(cores), "--resources", f"memory={megabytes}"]
    else:
        command += _slurm_options(folder, slurm, exclusive)
        # Jobs inherit the environment: drop settings that keep Open MPI to one machine.
        environ = {k: v for k, v in environ.items() if ranks.ONE_NODE.get(k) != v}
    # Snakemake needs a writable cache; the home directory may be read-only.
    environ["XDG_CACHE_HOME"] = str(folder.resolve() / ".snakemake")
    with _interruptible(), (folder / "snakemake.log").open("w") as log_file:
        # In a separate session: this process gets Ctrl-C and passes it on once.
        child = subprocess.Popen(
            command,
            cwd=folder,
            env=environ,
            stdin=subprocess.DEVNULL,
            stdout=log_file,
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


def _slurm_options(folder: Path, extra: Sequence[str], exclusive: bool) -> list[str]:
    """Return options of Snakemake for Slurm; options in ``extra`` override those for sbatch."""
    prefix = f"mantle-{hashlib.sha256(bytes(folder.resolve())).hexdigest()[:10]}-"
    job_options = ["--job-name", prefix + "{wildcards.id}", "--dependency", "singleton"]
    # One task per rank, because Open MPI counts the cores of --cpus-per-task as a single slot.
    job_options += ["-n", "{threads}", "-c", "1", "-D", ".", "-o", "runs/{wildcards.id}.slurm"]
    if exclusive:
        job_options.append("--exclusive")
    job_options += [option.replace("{", "{{").replace("}", "}}") for option in extra]
    options = ["--cluster", shlex.join(["sbatch", "--parsable", *job_options])]
    options += ["--cluster-status", shlex.join(["sh", str(SLURM_STATUS)])]
    options += ["--cluster-cancel", "scancel"]
    if TREE_JOB.exists():
        options += ["--jobscript", str(TREE_JOB)]
    options += ["--jobs", str(JOBS_AT_ONCE), "--latency-wait", str(LATENCY)]
    return options


@contextmanager
def _interruptible() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the block like Ctrl-C."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    handlers_before = {n: signal.signal(n, signal.default_int_handler) for n in numbers}
    try:
        yield
    finally:
        for n, handler in handlers_before.items():
            signal.signal(n, handler)


def _stop(child: subprocess.Popen[bytes]) -> None:
    """Interrupt Snakemake and its jobs and wait; kill them at the second interruption.

    On a cluster Snakemake cancels its jobs.
    """
    log.info(
        "stopping when the running cases have saved their state (a second signal stops at once)"
    )
    end = time.monotonic() + ranks.SAME_SIGNAL
    _send(child, signal.SIGINT)
    while child.poll() is None:
        try:
            child.wait()
        except KeyboardInterrupt:
            # One Ctrl-C may arrive twice: from the terminal and from the parent process.
            if time.monotonic() > end:
                _send(child, signal.SIGKILL)


def _send(child: subprocess.Popen[bytes], number: int) -> None:
    """Send a signal to the process group of a child, if it still exists."""
    with suppress(ProcessLookupError):
        os.killpg(child.pid, number)
