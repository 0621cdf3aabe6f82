"""The runs of a batch: what identifies them, the files they leave and their results."""

from __future__ import annotations

import hashlib
import json
import math
import re
import signal
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from app.case.case import Case, dump, load, plain
from app.case.geometries import MeshFile
from app.case.variations import CHANGED, split
from app.errors import ConvergenceError, InputError, UnusableError
from app.results.closing_lines import reasons_not_to_use
from app.system import identity
from app.system.folders import FAILED

# How the ids of runs begin, and of processes that several of them share.
CASE, SHARED = "case-", "shared-"
DIGITS = 10  # of a digest
RUN = re.compile(rf"{CASE}[0-9a-f]{{{DIGITS}}}", re.ASCII)
PROCESS = re.compile(rf"{SHARED}[0-9a-f]{{{DIGITS}}}-[0-9]+", re.ASCII)
LOG_LINES = 12
LOST = 70  # the exit code of a run that left none


@dataclass(frozen=True)
class Job:
    """A run that is wanted.

    Attributes:
        name: For people; several jobs may have the same.
        case: The case file.
        overrides: ``key=value`` each, as after ``--set``.
        ranks: Number of MPI ranks.
        alone: Whether nothing else runs beside it, so that its time can be compared.
        share: Whether it may share a process with others that mesh and stiffness have in common.
    """

    name: str
    case: Path
    overrides: tuple[str, ...] = ()
    ranks: int = 1
    alone: bool = False
    share: bool = False


@dataclass(frozen=True)
class Result:
    """Result of a job.

    Attributes:
        job: The job.
        folder: Its run directory.
        exit_code: 0 if it is done, else that of ``mantle run``: of one that is done, but not to be
            used, too.
        seconds: Wall time: of the process, or of the run if it shared one.
        summary: ``summary.json``; empty unless the run is done.
        message: Why it failed: the last lines of its log; empty if it is done and of use.
        process: Who ran it; several jobs may share one.
    """

    job: Job
    folder: Path
    exit_code: int
    seconds: float
    summary: dict[str, Any]
    message: str
    process: str = ""


@dataclass(frozen=True)
class BatchRun:
    """A run directory and what goes into it; several jobs may have the same.

    Attributes:
        id: Its name.
        name: For people.
        case: Its case.
        ranks: Number of MPI ranks.
        alone: As of the job.
        process: The id of the process that runs it: its own, or one that it shares.
        path: Its run directory.
    """

    id: str
    name: str
    case: Case
    ranks: int
    alone: bool
    process: str
    path: Path

    @property
    def ended(self) -> bool:
        """Whether its directory tells that it is done or has not converged."""
        return (self.path / "DONE").exists() or (self.path / FAILED).exists()

    def summary(self) -> dict[str, Any] | None:
        """``summary.json`` of a run that is done; None if it is not."""
        if not (self.path / "DONE").exists():
            return None
        try:
            return dict(json.loads((self.path / "summary.json").read_text(encoding="utf-8")))
        except (OSError, ValueError):
            return None


def resolve(jobs: Sequence[Job]) -> list[Case]:
    """Read the configuration of each job.

    Raises:
        InputError: All that is wrong with any of them.
    """
    cases, messages = [], []
    for job in jobs:
        try:
            case = load(job.case, job.overrides).config
            cases.append(case)
        except InputError as error:
            messages += [f"{job.name}: {m}" if m.startswith("--set") else m for m in error.messages]
        if job.ranks < 1:
            messages.append(f"{job.name}: {job.ranks} is not a number of ranks; allowed: 1, 2, ...")
    if messages:
        raise InputError(list(dict.fromkeys(messages)))
    return cases


def runs_of(
    jobs: Sequence[Job], cases: Sequence[Case], folder: Path, cores: int | None
) -> list[BatchRun]:
    """The run of each job: one and the same for all jobs of the same content.

    Args:
        jobs: The jobs.
        cases: The configuration of each.
        folder: The folder of the batch.
        cores: Those of this machine; None on a cluster.
    """
    done = {mark.parent.name[-DIGITS:]: mark.parent for mark in finished(folder)}
    saved = (folder / "runs").glob(f"{SHARED}*/*/checkpoint-*.state")
    begun = {path.parent.name[-DIGITS:]: path.parent.parent.name for path in saved if _named(path)}
    digests = []
    for job, case in zip(jobs, cases, strict=True):
        # The same case, made in two ways, may have two titles.
        own = case.model_copy(update={"title": case.title.partition(CHANGED)[0]})
        digests.append(_digest(case, (dump(own),), job.ranks))
    processes = _processes(jobs, cases, digests, cores)
    found: dict[str, BatchRun] = {}
    for job, case, digest in zip(jobs, cases, digests, strict=True):
        if digest in found:
            alone = found[digest].alone or job.alone
            found[digest] = replace(found[digest], alone=alone)
            continue
        id = f"{CASE}{digest}"
        process = processes.get(digest, id)
        if process != id:
            process = begun.get(digest, process)  # where the state of the run is
        path = done.get(digest, folder / "runs" / process / (id if process != id else ""))
        found[digest] = BatchRun(id, job.name, case, job.ranks, job.alone, process, path)
    return [found[digest] for digest in digests]


def _processes(
    jobs: Sequence[Job],
    cases: Sequence[Case],
    digests: Sequence[str],
    cores: int | None,
) -> dict[str, str]:
    """The process of each run that shares one, by its digest.

    None has more runs than what all cores do at once allows: where the runs of a group are more,
    several processes have the same matrices.
    """
    ranks = {digest: job.ranks for job, digest in zip(jobs, digests, strict=True)}
    several = cores and not any(job.alone for job in jobs)  # what runs alone is one process
    longest = math.ceil(sum(ranks.values()) / cores) if cores and several else len(ranks)
    groups: dict[str, list[str]] = {}
    for job, case, digest in zip(jobs, cases, digests, strict=True):
        if job.share:
            group = groups.setdefault(_digest(case, (_shared(case),), job.ranks), [])
            group += [digest] if digest not in group else []
    found = {}
    for partner, group in groups.items():
        number = math.ceil(len(group) / longest)
        for i, digest in enumerate(group if len(group) > 1 else ()):
            found[digest] = f"{SHARED}{partner}-{i * number // len(group) + 1}"
    return found


def finished(folder: Path) -> list[Path]:
    """The DONE of every finished run, whether it shared a process or not."""
    marks = [*(folder / "runs").glob(f"{SHARED}*/*/DONE"), *(folder / "runs").glob("*/DONE")]
    return [mark for mark in marks if _named(mark) and mark.parent.name.startswith(CASE)]


def _named(path: Path) -> bool:
    """Whether a file is in the folder of a run that has a name given here, and nothing else.

    Such names stand in commands of a shell.
    """
    run, above = path.parent.name, path.parent.parent.name
    return bool(RUN.fullmatch(run) and (above == "runs" or PROCESS.fullmatch(above)))


def _shared(case: Case) -> str:
    """Part of a case shared by the runs of one process, as text."""
    return json.dumps(split(plain(case))[0], sort_keys=True)


def _digest(case: Case, text: Sequence[str], ranks: int) -> str:
    """Hexadecimal digits of everything the result depends on."""
    parts = [*text, str(ranks), identity.text()]
    if isinstance(case.geometry, MeshFile):
        parts.append(case.geometry.content)
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:DIGITS]


def file_of(folder: Path, id: str, kind: str) -> Path:
    """A file beside a run directory."""
    return folder / "runs" / f"{id}.{kind}"


def status_of(folder: Path, id: str) -> tuple[int, float] | None:
    """Exit code and seconds of a run; None while there are none."""
    try:
        code, begin, end = file_of(folder, id, "status").read_text().split()
        return int(code), float(end) - float(begin)
    except (OSError, ValueError):
        return None


def result_of(job: Job, folder: Path, run: BatchRun) -> Result:
    """How a run has ended."""
    status = status_of(folder, run.process)
    code, seconds = status or (LOST, 0.0)
    result = partial(Result, job, run.path, process=run.process)
    if (summary := run.summary()) is not None:
        # It may have been done in another process than the one it would be given now, or in one
        # that was killed before it could tell how long it took.
        own = status_of(folder, run.path.name) if run.path.parent == folder / "runs" else None
        total = summary.get("timing", {}).get("total", 0.0)
        why = "; ".join(reasons_not_to_use(summary))
        code = UnusableError.exit_code if why else 0
        return result(code, own[1] if own else total, summary, f"do not use: {why}" if why else "")
    with suppress(OSError):
        # In a process that goes on without it, what it said stands in its folder.
        why = (run.path / FAILED).read_text(encoding="utf-8").strip()
        return result(ConvergenceError.exit_code, 0.0, {}, why)
    message = tail(file_of(folder, run.process, "log"))
    if status is None:
        message += "\n" + tail(file_of(folder, run.process, "slurm"))
    if code > 128 and code - 128 in set(signal.Signals):
        message += f"\nkilled by {signal.Signals(code - 128).name}"
    return result(code or LOST, seconds, {}, message.strip())


def tail(path: Path) -> str:
    """The last lines of a log."""
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return ""
    return "\n".join([line for line in lines if line.strip()][-LOG_LINES:])
