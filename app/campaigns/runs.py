"""Runs of a batch: their identity by content, their files, and their results."""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
import signal
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import cast

from app.case.case import Case, PlannedRun, dump, named_files, plain_data
from app.case.summary import Summary
from app.case.variations import CHANGED, shared_and_varied
from app.foundation.errors import (
    ConvergenceError,
    EnvironmentProblem,
    MantleError,
    StoppedError,
    UnusableError,
)
from app.results.verdicts import reasons_not_to_use
from app.soundness import cost, memory
from app.system import identity
from app.system.folders import FAILED_FILE, saved

# Prefix of the id of a run.
PREFIX_OF_ID = "case-"
# Prefix of the id of a process that several runs share.
SHARED = "shared-"
# Digits of a digest in an id.
DIGITS_OF_ID = 10
# Pattern of ids. Ids are checked because they become part of shell commands.
NAMED = re.compile(rf"({SHARED}[0-9a-f]{{10}}-[0-9]+/)?{PREFIX_OF_ID}[0-9a-f]{{10}}", re.ASCII)
# Number of lines of a log in a message.
LOG_LINES = 12
# Beginning of the line of a log that says why a run did not converge.
NOT_CONVERGED = "no convergence"
# Exit code of a run without a recorded one.
LOST = MantleError.exit_code


@dataclass(frozen=True)
class Result:
    """Result of a run.

    Attributes:
        planned: The run as planned.
        folder: Run directory.
        exit_code: 0 if it is done and usable, otherwise the exit code of ``mantle run``.
        seconds: Wall time of the process [s]; of the run if it shares the process with others.
        summary: ``summary.json``; empty unless the run is done.
        message: Reason of a failure or of an unusable result, with the last lines of the log;
            otherwise empty.
    """

    planned: PlannedRun
    folder: Path
    exit_code: int
    seconds: float
    summary: Summary
    message: str


@dataclass(frozen=True)
class BatchRun:
    """A run directory with its run, which planned runs with equal content have in common.

    Attributes:
        id: Prefix and digest of its inputs.
        planned: The first of these planned runs. It needs an idle machine if one of them does.
        path: Run directory: the directory of its process, or inside it if runs share the process.
    """

    id: str
    planned: PlannedRun
    path: Path

    @property
    def shares_process(self) -> bool:
        """Return True if other runs share the process."""
        return self.path.parent.name.startswith(SHARED)

    @property
    def process(self) -> str:
        """Id of its process."""
        return self.path.parent.name if self.shares_process else self.id

    def file(self, kind: str) -> Path:
        """Return the file of its process with a suffix (``log``, ``status``, ``ok``, ``slurm``)."""
        folder = self.path.parent if self.shares_process else self.path
        return folder.with_name(f"{folder.name}.{kind}")

    def status(self) -> tuple[int, float] | None:
        """Exit code and seconds of its process; None until it ends."""
        try:
            begin_time, end_time, code = self.file("status").read_text().split()
            return int(code), float(end_time) - float(begin_time)
        except (OSError, ValueError):
            return None

    @property
    def ended(self) -> bool:
        """Return True if the run is done or has failed."""
        end_marks = (
            self.path / "DONE",
            self.path / FAILED_FILE,
        )  # its process may continue with other runs
        return self.status() is not None or any(end_mark.exists() for end_mark in end_marks)

    def summary(self) -> Summary | None:
        """``summary.json`` of a run that is done; None if it is not."""
        if not (self.path / "DONE").exists():
            return None
        try:
            summary_text = (self.path / "summary.json").read_text(encoding="utf-8")
            return cast(Summary, json.loads(summary_text))
        except (OSError, ValueError):
            return None


def runs_of(planned: Sequence[PlannedRun], folder: Path, cores: int | None) -> list[BatchRun]:
    """Return the run directory of each planned run; planned runs with equal content have the same.

    Runs that share a stiffness matrix are divided among several processes, each with this matrix,
    so that all ``cores`` of this machine are busy. On a cluster ``cores`` is None, and one process
    makes them all.
    """
    unique: dict[str, PlannedRun] = {}
    ids: list[str] = []
    ids_by_matrix: dict[str, list[str]] = {}
    for run in planned:
        id = PREFIX_OF_ID + _digest(_content(run.case), run)
        ids.append(id)
        first_run = unique.setdefault(id, run)
        needs_idle_machine = first_run.needs_idle_machine or run.needs_idle_machine
        unique[id] = replace(first_run, needs_idle_machine=needs_idle_machine)
        if run.share:
            shared_data, _ = shared_and_varied(plain_data(run.case))
            ids_of_matrix = ids_by_matrix.setdefault(
                _digest(json.dumps(shared_data, sort_keys=True), run), []
            )
            if id not in ids_of_matrix:
                ids_of_matrix.append(id)
    longest = len(unique)
    # Runs whose times are compared stay in one process.
    are_timed = any(run.needs_idle_machine for run in planned)
    if cores and not are_timed:
        longest = math.ceil(sum(run.ranks for run in unique.values()) / cores)
    paths = {id: folder / "runs" / id for id in unique}
    for digest, ids_of_matrix in ids_by_matrix.items():
        if len(ids_of_matrix) == 1:
            continue
        processes = math.ceil(len(ids_of_matrix) / longest)
        for i, id in enumerate(ids_of_matrix):
            process = f"{SHARED}{digest}-{i * processes // len(ids_of_matrix) + 1}"
            paths[id] = folder / "runs" / process / id
    paths |= _begun(folder)
    return [BatchRun(id, unique[id], paths[id]) for id in ids]


def _content(case: Case) -> str:
    """Return a case as YAML, without the changes that its title names: they are no content."""
    title, _, _ = case.title.partition(CHANGED)
    return dump(case.model_copy(update={"title": title}))


def _begun(folder: Path) -> dict[str, Path]:
    """Directories of runs that are done or have saved their state, by id."""
    runs = folder / "runs"
    directories = [*runs.glob(f"{SHARED}*/{PREFIX_OF_ID}*"), *runs.glob(f"{PREFIX_OF_ID}*")]
    run_directories = [path for path in directories if NAMED.fullmatch(str(path.relative_to(runs)))]
    finished = {path.name: path for path in run_directories if (path / "DONE").exists()}
    return {path.name: path for path in run_directories if saved(path)} | finished


def _digest(case_text: str, run: PlannedRun) -> str:
    """Return the hexadecimal digest of a case as text, ranks, program and files that it names."""
    digested_texts = [
        case_text,
        str(run.ranks),
        json.dumps(identity.versions(), sort_keys=True),
        run.case.geometry.content,
        *(hashlib.sha256(path.read_bytes()).hexdigest() for path in named_files(run.case)),
    ]
    return hashlib.sha256("\0".join(digested_texts).encode()).hexdigest()[:DIGITS_OF_ID]


def result_of(run: BatchRun, planned: PlannedRun | None = None, *, over: bool = True) -> Result:
    """Return the result of a run.

    Args:
        run: The run.
        planned: Planned run of the same content to which the result belongs; the first by default.
        over: False if the run has not ended. It then counts as stopped, unless it is done.
    """
    status = run.status()
    code, seconds = status or (LOST, 0.0)
    result = partial(Result, planned or run.planned, run.path)
    summary = run.summary()
    if summary is not None:
        if run.shares_process or status is None:  # or it was killed before its time was written
            seconds = summary.get("timing", {}).get("total", 0.0)
        reasons = "; ".join(reasons_not_to_use(summary))
        code = UnusableError.exit_code if reasons else 0
        return result(code, seconds, summary, f"do not use: {reasons}" if reasons else "")
    if not over:
        return result(StoppedError.exit_code, 0.0, {}, "")
    with suppress(OSError):
        # A process that continues with other runs writes the reason of a failure into its folder.
        reasons = (run.path / FAILED_FILE).read_text(encoding="utf-8").strip()
        return result(ConvergenceError.exit_code, 0.0, {}, reasons)
    message = tail(run.file("log"))
    if status is None:
        message += "\n" + tail(run.file("slurm"))
    if code == 128 + signal.SIGKILL:
        message += f"\n{_killed(run)}"
        code = EnvironmentProblem.exit_code
    elif code > 128 and code - 128 in set(signal.Signals):
        message += f"\nkilled by {signal.Signals(code - 128).name}"
    return result(code or LOST, seconds, {}, message.strip())


def _killed(run: BatchRun) -> str:
    """Return the message on a run that the system killed, with needed and available memory."""
    available_memory = memory.available_memory()
    needed_memory = cost.gigabytes(run.planned.case, available_memory)
    message = "killed, probably out of memory: "
    if needed_memory:
        message += f"each run needs about {needed_memory:.1f} GB, "
    message += f"{available_memory / 1e9:.1f} GB are available"
    again = "run the same command again to continue"
    if needed_memory:
        ranks, cores = run.planned.ranks, len(os.sched_getaffinity(0))
        at_once = max(1, int(available_memory / 1e9 / needed_memory))
        # If runs on all cores fit, something else took the memory.
        if at_once * ranks < cores:
            again += f", with --cores {at_once * ranks}: at most {at_once} at once"
    return f"{message}; {again}"


def tail(path: Path) -> str:
    """Return the last lines of a log; an empty text if it cannot be read."""
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return ""
    return "\n".join([line for line in lines if line.strip()][-LOG_LINES:])


def reason(message: str) -> str:
    """Return the most important line of a message.

    It is the line on missing convergence if there is one, otherwise the last line.
    """
    lines = [line.strip() for line in message.splitlines() if line.strip()]
    return next((line for line in lines if line.startswith(NOT_CONVERGED)), ["", *lines][-1])
