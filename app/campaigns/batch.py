"""Many runs of ``mantle run`` by Snakemake, on this machine or by Slurm.

The name of a run directory is a digest of the run's inputs. So a finished run is never repeated; a
failed or changed one is run again::

    folder/cases/<id>.yaml      the resolved case; <id> is case- and a digest of all inputs
    folder/runs/<id>/           its run directory, complete once it holds DONE
    folder/runs/<id>.log        its output
    folder/runs/<id>.status     when it began and ended, and its exit code
    folder/runs/<id>.lock       locked while it runs
    folder/runs/<id>.ok         mark for Snakemake that it is done
    folder/runs/<id>.slurm      the output of its Slurm job
    folder/jobs.json            the jobs for Snakemake
    folder/snakemake.log        the output of Snakemake

Runs that may share a stiffness matrix (`PlannedRun.share`) are variations of one process, or of as
many processes as keep the cores busy. The case and the files beside ``runs/<id>`` then have the id
of the process, and the run directories are inside its folder.
"""

from __future__ import annotations

import logging
import math
import os
import shlex
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from app.campaigns import scheduler
from app.campaigns.runs import BatchRun, Result, result_of, runs_of, tail
from app.case.case import PlannedRun, dump, plain_data
from app.case.variations import shared_and_varied
from app.foundation import layout
from app.foundation.errors import EnvironmentProblem, StoppedError
from app.foundation.layout import duration, several
from app.schema import yaml_file
from app.soundness import cost, memory
from app.system.folders import FAILED_FILE, claim, write_json, write_text, writing

log = logging.getLogger("mantle")

MANTLE_RUN: tuple[str, ...] = (sys.executable, "-m", "mantle", "run")
# Beginnings of the variables that set the threads of BLAS. Snakemake sets them to the cores of the
# job, but a rank needs one thread.
THREADS = ("OMP", "GOTO", "OPENBLAS", "MKL")
# Load average above which the machine is too busy for runs whose times are compared.
BUSY = 0.5
# Time between reports on all runs that have ended so far [s].
OFTEN = 10.0
# Factor on the time of a batch: some cores are idle at its end, because runs differ in length.
IDLE = 1.1


@dataclass(frozen=True)
class Options:
    """Options of a command that makes many runs.

    Attributes:
        folder: Folder of the results; finished runs in it are not repeated.
        pattern: Text in the names of the selected runs; empty for all.
        tier: quick, default or long.
        slurm: Options of sbatch, to make each run a Slurm job; None to run here.
        dry_run: True to log the table of planned runs only.
    """

    folder: Path
    cores: int
    pattern: str = ""
    tier: str = "default"
    slurm: Sequence[str] | None = None
    dry_run: bool = False


def run(
    planned: Sequence[PlannedRun],
    folder: Path,
    cores: int,
    slurm: Sequence[str] | None = None,
    so_far: Callable[[Sequence[Result]], object] = lambda results: None,
) -> list[Result]:
    """Make the runs that are not done yet; return a result for each, failed ones included.

    Args:
        planned: The runs.
        folder: Folder of the batch; used by one batch at a time.
        cores: Largest number of cores of this machine to use.
        slurm: Options of sbatch, to make each run a Slurm job; all nodes must see the folder. None
            to run on this machine.
        so_far: Function that is called with the results so far when runs end, and on interruption.

    Raises:
        InputError: The folder is in use.
        StoppedError: Interrupted, and the same call continues; or the folder cannot be written.
        EnvironmentProblem: Snakemake or Slurm is missing or failed.
    """
    scheduler.check(slurm is not None)
    local_cores = cores if slurm is None else None
    runs = runs_of(planned, folder, local_cores)
    total = len({r.id for r in runs})
    next_report = 0.0
    pending: dict[str, BatchRun] = {}

    def results() -> list[Result]:
        pairs = zip(planned, runs, strict=True)
        return [result_of(r, planned_run, over=r.id not in pending) for planned_run, r in pairs]

    def watch() -> None:
        nonlocal next_report
        if (
            _log_ended(pending, total, lambda r: r.ended)
            and pending
            and time.monotonic() > next_report
        ):
            so_far(results())
            next_report = time.monotonic() + OFTEN

    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    with claim(folder):
        pending = {r.id: r for r in runs if r.summary() is None}
        finished = total - len(pending)
        already = f"; {finished} of them are finished already" if finished else ""
        log.info("%s in %s%s", several(total, "run"), folder, already)
        needs_idle_machine = any(r.planned.needs_idle_machine for r in pending.values())
        load = os.getloadavg()[0]
        if needs_idle_machine and load > BUSY:
            log.warning("the machine is busy (load %.1f): measured times will be too long", load)
        if pending:
            _write(pending.values(), folder, local_cores)
            try:
                scheduler.execute(folder, cores, slurm, needs_idle_machine, watch)
            except KeyboardInterrupt:
                so_far(results())
                message = f"stopped after {total - len(pending)} of {total} runs in {folder}"
                raise StoppedError(f"{message}; run the same command again to continue") from None
            # A run that began without an end has failed.
            _log_ended(pending, total, lambda r: r.ended or r.file("status").exists())
        if pending:
            logs = [r.file("slurm") for r in pending.values()]
            log_file = next((path for path in logs if path.exists()), folder / "snakemake.log")
            raise EnvironmentProblem(f"Snakemake failed, see {log_file}:\n{tail(log_file)}")
    return results()


def table_of_planned_runs(title: str, planned: Sequence[PlannedRun], options: Options) -> str:
    """Titled table of planned runs: size, estimated cost, status. Runs nothing."""
    runs = runs_of(planned, options.folder, options.cores)
    rows = []
    wall = 0.0
    counted: set[object] = set()
    for planned_run, r in zip(planned, runs, strict=True):
        seconds = cost.estimated_seconds(planned_run.case, r.process not in counted)  # on one core
        seconds_alone = seconds / min(planned_run.ranks, options.cores)
        expected_time = duration(seconds_alone)
        note = f"shares the matrices of {r.process}" if r.process in counted else ""
        if r.path in counted:
            note, expected_time = "the same as one above", "-"
        elif r.summary() is not None:
            note, expected_time = f"done in {duration(result_of(r).seconds)}", "-"
        counted |= {r.process, r.path}
        if expected_time != "-":
            wall += seconds_alone if planned_run.needs_idle_machine else seconds / options.cores
        size = layout.count(round(cost.estimated_unknowns(planned_run.case), -2))
        rows.append((planned_run.name, planned_run.ranks, size, expected_time, note))
    run_table = layout.text_table(("case", "ranks", "unknowns", "about", ""), rows)
    expected_time = duration(IDLE * wall)
    return (
        f"{title}\n\n{run_table}\n\nabout {expected_time} for the remaining runs on"
        f" {options.cores} cores"
    )


def _log_ended(
    pending: dict[str, BatchRun], total: int, has_ended: Callable[[BatchRun], bool]
) -> bool:
    """Log the pending runs that have ended and remove them; return True if there are any."""
    ended = [r for r in pending.values() if has_ended(r)]
    for r in ended:
        del pending[r.id]
        result = result_of(r)
        code = result.exit_code
        outcome_text = (
            f"failed with exit code {code}" if code else f"done in {duration(result.seconds)}"
        )
        log.info("[%d/%d] %s %s", total - len(pending), total, r.planned.name, outcome_text)
    return bool(ended)


def _write(pending: Iterable[BatchRun], folder: Path, cores: int | None) -> None:
    """Write the cases and the jobs for Snakemake; delete marks of earlier attempts.

    Raises:
        InputError: The folder cannot be written.
    """
    runs_of_process: dict[str, list[BatchRun]] = {}
    for r in pending:
        runs_of_process.setdefault(r.process, []).append(r)
    jobs = {}
    with writing(folder):
        for name in ("cases", "runs"):
            (folder / name).mkdir(exist_ok=True)
        for id, runs in runs_of_process.items():
            case, output = folder / "cases" / f"{id}.yaml", folder / "runs" / id
            write_text(case, _text(runs))
            for r in runs:
                (r.path / FAILED_FILE).unlink(missing_ok=True)
                if r.summary() is None:  # a run that a killed batch left may still be ending
                    (r.path / "DONE").unlink(missing_ok=True)
            for kind in ("ok", "slurm", "status"):
                runs[0].file(kind).unlink(missing_ok=True)
            ranks = runs[0].planned.ranks
            command = [*MANTLE_RUN, case.resolve(), "-o", output.resolve(), "--restart", "auto"]
            if ranks > 1:
                command += ["-n", ranks]
            if not cores:
                threads = ranks
            elif any(r.planned.needs_idle_machine for r in runs):
                threads = cores
            else:
                threads = min(ranks, cores)
            needed_memory = max(memory.needed(r.planned.case) for r in runs)
            jobs[id] = {
                "command": shlex.join(map(str, ["env", *_environment(cores), *command])),
                "threads": threads,
                "memory": math.ceil(needed_memory / scheduler.MEGABYTE),
            }
        write_json(folder / "jobs.json", jobs)


def _text(runs: Sequence[BatchRun]) -> str:
    """Return the case file of a process: its only run, or all its runs as variations."""
    first_run = runs[0]
    if not first_run.shares_process:
        return dump(first_run.planned.case)
    data = plain_data(first_run.planned.case)
    _, base = shared_and_varied(data)
    variations = {}
    for r in runs:
        _, values = shared_and_varied(plain_data(r.planned.case))
        keys = [key for key in base | values if base.get(key) != values.get(key)]
        variations[r.id] = {key: values.get(key) for key in keys}
    return yaml_file.to_yaml(data | {"variations": variations})


def _environment(cores: int | None) -> list[str]:
    """Return arguments of ``env`` that undo settings of Snakemake."""
    one_thread = [f"{name}_NUM_THREADS=1" for name in THREADS]
    if not cores and scheduler.TREE_JOB.exists():
        return one_thread  # each node has its cache
    cache = os.environ.get("XDG_CACHE_HOME")
    arguments = ["-u", "XDG_CACHE_HOME", *one_thread]
    if cache:
        arguments.append(f"XDG_CACHE_HOME={cache}")
    return arguments
