"""Slurm below a batch: what Snakemake has to know to run each case as a job of a cluster.

Only ``sbatch``, ``squeue`` and ``scancel`` are called: no accounting is needed. Jobs are found
again by their names, which tell the folder of the batch and the run. Of one name Slurm runs one
job at a time, whoever submitted it: where a batch was killed and its jobs go on, none is run twice.
"""

from __future__ import annotations

import hashlib
import shlex
import shutil
import subprocess
import time
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path

from app.errors import EnvironmentProblem
from app.system import ranks

STATUS = Path(__file__).with_name("slurm_status")
AT_ONCE = 1000  # jobs in the queue
LATENCY = 60  # s after which files that a node wrote are seen here
PATIENCE = 10.0  # s


def check() -> None:
    """See that cases can be submitted from here.

    Raises:
        EnvironmentProblem: There is no Slurm, or a Snakemake without ``--cluster``.
    """
    for program in ("sbatch", "squeue", "scancel"):
        if shutil.which(program) is None:
            raise EnvironmentProblem(
                f"Slurm was asked for, but {program} is not here (Debian: slurm-client); "
                "mantle has to be installed where jobs are submitted, not in a container there"
            )
    try:
        version = metadata.version("snakemake")
    except metadata.PackageNotFoundError:
        return  # which is reported elsewhere
    if not version.startswith("7."):
        raise EnvironmentProblem(f"Slurm needs Snakemake 7 (as in Debian 13); this is {version}")


def options(folder: Path, extra: Sequence[str], alone: bool) -> list[str]:
    """Options of Snakemake in place of ``--cores``.

    Args:
        folder: The folder of the batch.
        extra: Further options of sbatch; they win.
        alone: Whether nothing else may run on a node beside a case.
    """
    job = ["--job-name", _prefix(folder) + "{wildcards.id}", "--dependency", "singleton"]
    # A task per rank: of --cpus-per-task Open MPI makes a single slot.
    job += ["-n", "{threads}", "-c", "1", "-D", ".", "-o", "runs/{wildcards.id}.slurm"]
    job += ["--exclusive"] if alone else []
    job += [word.replace("{", "{{").replace("}", "}}") for word in extra]
    return [
        *("--cluster", shlex.join(["sbatch", "--parsable", *job])),
        *("--cluster-status", shlex.join(["sh", str(STATUS)])),
        *("--jobs", str(AT_ONCE), "--latency-wait", str(LATENCY)),
    ]


def environment(environ: Mapping[str, str]) -> dict[str, str]:
    """The environment that jobs inherit: without what keeps Open MPI to a single machine."""
    return {k: v for k, v in environ.items() if ranks.ONE_NODE.get(k) != v}


def cancel(folder: Path) -> None:
    """Cancel all jobs of a batch, and wait a little for them to leave.

    Args:
        folder: The folder of the batch.

    Raises:
        EnvironmentProblem: Slurm does not answer.
    """
    deadline = time.monotonic() + PATIENCE
    time.sleep(0.5)  # one may just have been submitted
    while (jobs := _jobs(folder)) and time.monotonic() < deadline:
        subprocess.run(["scancel", "--quiet", *jobs], check=False)
        time.sleep(0.5)


def _prefix(folder: Path) -> str:
    """Prefix of the names of all jobs of a batch."""
    return f"mantle-{hashlib.sha256(bytes(folder.resolve())).hexdigest()[:10]}-"


def _jobs(folder: Path) -> list[str]:
    """The jobs of a batch that wait or run.

    Raises:
        EnvironmentProblem: Slurm does not answer.
    """
    command = ["squeue", "--me", "--noheader", "--format=%i %j"]
    listed = subprocess.run(command, check=False, capture_output=True, text=True)
    if listed.returncode:
        raise EnvironmentProblem(f"jobs may be left in the queue; squeue: {listed.stderr.strip()}")
    prefix = _prefix(folder)
    lines = [line.split(maxsplit=1) for line in listed.stdout.splitlines()]
    return [words[0] for words in lines if words[-1].startswith(prefix)]
