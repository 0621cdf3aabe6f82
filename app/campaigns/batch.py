"""One engine for many runs: Snakemake over subprocesses of ``mantle run``, here or by Slurm.

A run lives in a directory named by its content, so that a finished one is never done twice, and a
failed or a changed one is::

    folder/cases/<id>.yaml      the resolved case; <id> is case- and a digest of all it depends on
    folder/runs/<id>/           its run directory, complete once it holds DONE
    folder/runs/<id>.log        what it said
    folder/runs/<id>.status     its exit code, and when it began and ended
    folder/runs/<id>.lock       locked while it runs
    folder/runs/<id>.ok         for Snakemake: it is done
    folder/runs/<id>.slurm      what Slurm said of its job
    folder/snakemake.log        what Snakemake said

Runs that may share a stiffness (`Job.share`) are variations of one process, or of as many as keep
the cores busy. The last of these files bear its id, and the run directories stand inside its own.
"""

from __future__ import annotations

import fcntl
import logging
import math
import os
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import IO

from app import files
from app.campaigns import cluster
from app.campaigns.runs import (
    BatchRun,
    Job,
    Result,
    file_of,
    resolve,
    result_of,
    runs_of,
    status_of,
)
from app.campaigns.scheduler import MEGABYTE, execute
from app.case.case import dump, plain
from app.case.variations import split
from app.errors import InputError, StoppedError
from app.schema import yaml_text
from app.soundness import memory
from app.system.folders import FAILED, write_json, write_text

log = logging.getLogger("mantle")

MANTLE_RUN: tuple[str, ...] = (sys.executable, "-m", "mantle", "run")
# Snakemake sets these to the cores of the job; ranks have one thread each.
THREADS = ("OMP", "GOTO", "OPENBLAS", "MKL")
BUSY = 0.5  # load of the machine beside runs whose time is compared


def run(
    jobs: Sequence[Job],
    folder: Path,
    cores: int,
    slurm: Sequence[str] | None = None,
    so_far: Callable[[Sequence[Result]], object] = lambda results: None,
) -> list[Result]:
    """Run what is not done yet.

    Args:
        jobs: What is wanted.
        folder: Where everything goes; used by one batch at a time.
        cores: How many cores of this machine to use at most.
        slurm: Each run is a job of a Slurm cluster, with these options of sbatch; all nodes see
            the folder. None: all run here.
        so_far: Given what `look` would say, from time to time as runs end, and if interrupted.

    Returns:
        A result for each job, in their order. A failed job is a result too.

    Raises:
        InputError: Any job is wrong: all their defects at once, before anything runs. Or the
            folder cannot be written or is in use.
        StoppedError: Interrupted; the same call goes on from there.
        EnvironmentProblem: Snakemake or Slurm is missing or failed.
    """
    if slurm is not None:
        cluster.check()
    cases = resolve(jobs)
    with _folder(folder) as lock:
        runs = runs_of(jobs, cases, folder, cores if slurm is None else None)
        every = {r.id: r for r in runs}.values()
        pending = [r for r in every if r.summary() is None]
        log.info("%d runs: %d done already, in %s", len(every), len(every) - len(pending), folder)
        if any(r.alone for r in pending) and (load := os.getloadavg()[0]) > BUSY:
            log.warning("the machine is busy (load %.1f): measured times will be too long", load)
        if pending:
            _write(pending, folder, cores if slurm is None else None)

            def tell() -> None:
                so_far(_look(jobs, folder, runs))

            execute(pending, len(every), folder, cores, lock, slurm, tell)
        return [result_of(job, folder, r) for job, r in zip(jobs, runs, strict=True)]


def look(jobs: Sequence[Job], folder: Path, cores: int) -> list[Result]:
    """Results of jobs so far; runs nothing.

    Args:
        jobs: As of `run`.
        folder: The same; it need not exist.
        cores: The same.

    Returns:
        A result for each job; those that have not ended count as stopped.

    Raises:
        InputError: Any job is wrong.
    """
    return _look(jobs, folder, runs_of(jobs, resolve(jobs), folder, cores))


def _look(jobs: Sequence[Job], folder: Path, runs: Sequence[BatchRun]) -> list[Result]:
    results = [result_of(job, folder, r) for job, r in zip(jobs, runs, strict=True)]
    stopped = partial(replace, exit_code=StoppedError.exit_code, message="")
    return [
        result if result.summary or status_of(folder, r.process) or r.ended else stopped(result)
        for result, r in zip(results, runs, strict=True)
    ]


@contextmanager
def _folder(folder: Path) -> Iterator[IO[str]]:
    """Make the folder and lock it.

    Raises:
        InputError: It cannot be written, or another batch uses it.
    """
    try:
        for name in ("cases", "runs"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        file = open(files.lock_file(folder / ".lock"), "w")
    except OSError as error:
        raise InputError(f"-o {folder}: cannot be written: {error.strerror}") from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"-o {folder}: another batch is running in it") from None
        yield file


def _write(pending: Iterable[BatchRun], folder: Path, cores: int | None) -> None:
    """Write the cases and what Snakemake is to do; forget how earlier tries ended.

    What a killed batch left to Slurm may be running, and end at any time: it is let.

    Args:
        pending: The runs.
        folder: The folder of the batch.
        cores: Those of this machine; None on a cluster.

    Raises:
        InputError: The folder cannot be written.
    """
    shared: dict[str, list[BatchRun]] = {}
    for r in pending:
        shared.setdefault(r.process, []).append(r)
    jobs = {}
    try:
        for id, runs in shared.items():
            case, output = folder / "cases" / f"{id}.yaml", folder / "runs" / id
            write_text(case, _text(runs))
            for r in runs:
                (r.path / FAILED).unlink(missing_ok=True)
                if r.summary() is None:
                    (r.path / "DONE").unlink(missing_ok=True)
            for kind in ("ok", "slurm", "status"):
                file_of(folder, id, kind).unlink(missing_ok=True)
            ranks = runs[0].ranks
            command = [*MANTLE_RUN, case.resolve(), "-o", output.resolve()]
            command += ["--restart", "auto"]
            command += ["-n", ranks] if ranks > 1 else []
            alone = any(r.alone for r in runs)
            jobs[id] = {
                "command": shlex.join(map(str, ["env", *_environment(), *command])),
                "threads": ranks if not cores else cores if alone else min(ranks, cores),
                "memory": math.ceil(max(memory.needed(r.case) for r in runs) / MEGABYTE),
            }
        write_json(folder / "jobs.json", jobs)
    except OSError as error:
        raise InputError(f"-o {folder}: cannot be written: {error.strerror}") from error


def _text(runs: Sequence[BatchRun]) -> str:
    """The case file of a process: of its run, or with each of those it is shared by a variation."""
    first = runs[0]
    if first.process == first.id:
        return dump(first.case)
    data = plain(first.case)
    _, base = split(data)
    variations = {}
    for r in runs:
        _, own = split(plain(r.case))
        keys = [key for key in base | own if base.get(key) != own.get(key)]
        variations[r.id] = {key: own.get(key) for key in keys}
    return yaml_text.to_yaml(data | {"variations": variations})


def _environment() -> list[str]:
    """Arguments of ``env`` that restore the variables that Snakemake changes."""
    one_thread = [f"{name}_NUM_THREADS=1" for name in THREADS]
    cache = os.environ.get("XDG_CACHE_HOME")
    return ["-u", "XDG_CACHE_HOME", *one_thread] + ([f"XDG_CACHE_HOME={cache}"] if cache else [])
