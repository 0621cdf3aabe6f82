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

import ctypes
import fcntl
import hashlib
import importlib.util
import json
import logging
import math
import os
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import IO, Any

from mantle.campaigns import cluster
from mantle.errors import ConvergenceError, EnvironmentProblem, InputError, StoppedError
from mantle.schema import case_file, config
from mantle.schema.variation_options import split
from mantle.soundness import sizing
from mantle.system import identity
from mantle.system.folders import FAILED, write_json, write_text

log = logging.getLogger("mantle")

MANTLE_RUN: tuple[str, ...] = (sys.executable, "-m", "mantle", "run")
SNAKEFILE = Path(__file__).with_name("Snakefile")
# Snakemake sets these to the cores of the job; ranks have one thread each.
THREADS = ("OMP", "GOTO", "OPENBLAS", "MKL")
# How the ids of runs begin, and of processes that several of them share.
CASE, SHARED = "case-", "shared-"
DIGITS = 10  # of a digest
LOG_LINES = 12
MEGABYTE = 1e6
POLL = 0.1  # s
OFTEN = 10.0  # s between reports on all runs that have ended so far
SAME_SIGNAL = 1.0  # s
BUSY = 0.5  # load of the machine beside runs whose time is compared
LOST = 70  # the exit code of a run that left none
_PR_SET_PDEATHSIG = 1


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
        exit_code: 0 if it is done, else that of ``mantle run``.
        seconds: Wall time: of the process, or of the run if it shared one.
        summary: ``summary.json``; empty unless the run is done.
        message: Why it failed: the last lines of its log; empty if it is done.
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
class _Run:
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
    case: config.Case
    ranks: int
    alone: bool
    process: str
    path: Path


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
    cases = _resolve(jobs)
    with _folder(folder) as lock:
        runs = _runs(jobs, cases, folder, cores if slurm is None else None)
        every = {r.id: r for r in runs}.values()
        pending = [r for r in every if _summary(r) is None]
        log.info("%d runs: %d done already, in %s", len(every), len(every) - len(pending), folder)
        if any(r.alone for r in pending) and (load := os.getloadavg()[0]) > BUSY:
            log.warning("the machine is busy (load %.1f): measured times will be too long", load)
        if pending:
            _write(pending, folder, cores if slurm is None else None)

            def tell() -> None:
                so_far(_look(jobs, folder, runs))

            _execute(pending, len(every), folder, cores, lock, slurm, tell)
        return [_result(job, folder, r) for job, r in zip(jobs, runs, strict=True)]


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
    return _look(jobs, folder, _runs(jobs, _resolve(jobs), folder, cores))


def _look(jobs: Sequence[Job], folder: Path, runs: Sequence[_Run]) -> list[Result]:
    results = [_result(job, folder, r) for job, r in zip(jobs, runs, strict=True)]
    stopped = partial(replace, exit_code=StoppedError.exit_code, message="")
    return [
        result if result.summary or _status(folder, r.process) or _left(r) else stopped(result)
        for result, r in zip(results, runs, strict=True)
    ]


def _resolve(jobs: Sequence[Job]) -> list[config.Case]:
    """The configuration of each job.

    Raises:
        InputError: All that is wrong with any of them.
    """
    cases, messages = [], []
    for job in jobs:
        try:
            case = config.load(job.case, job.overrides)
            cases.append(case)
        except InputError as error:
            messages += [f"{job.name}: {m}" if m.startswith("--set") else m for m in error.messages]
        if job.ranks < 1:
            messages.append(f"{job.name}: {job.ranks} is not a number of ranks; allowed: 1, 2, ...")
    if messages:
        raise InputError(list(dict.fromkeys(messages)))
    return cases


def _runs(
    jobs: Sequence[Job], cases: Sequence[config.Case], folder: Path, cores: int | None
) -> list[_Run]:
    """The run of each job: one and the same for all jobs of the same content.

    Args:
        jobs: The jobs.
        cases: The configuration of each.
        folder: The folder of the batch.
        cores: Those of this machine; None on a cluster.
    """
    done = {mark.parent.name[-DIGITS:]: mark.parent for mark in finished(folder)}
    saved = (folder / "runs").glob(f"{SHARED}*/*/checkpoint-*.h5")
    begun = {path.parent.name[-DIGITS:]: path.parent.parent.name for path in saved}
    digests = [
        _digest(case, (config.dump(case),), job.ranks)
        for job, case in zip(jobs, cases, strict=True)
    ]
    processes = _processes(jobs, cases, digests, cores)
    found: dict[str, _Run] = {}
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
        found[digest] = _Run(id, job.name, case, job.ranks, job.alone, process, path)
    return [found[digest] for digest in digests]


def _processes(
    jobs: Sequence[Job],
    cases: Sequence[config.Case],
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
    shared = list((folder / "runs").glob(f"{SHARED}*/*/DONE"))
    alone = (folder / "runs").glob("*/DONE")
    return shared + [mark for mark in alone if not mark.parent.name.startswith(SHARED)]


def _shared(case: config.Case) -> str:
    """Part of a case shared by the runs of one process, as text."""
    return json.dumps(split(config.plain(case))[0], sort_keys=True)


def _digest(case: config.Case, text: Sequence[str], ranks: int) -> str:
    """Hexadecimal digits of everything the result depends on."""
    parts = [*text, str(ranks), identity.text()]
    if isinstance(case.geometry, config.MeshFile):
        parts.append(case.geometry.content)
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:DIGITS]


@contextmanager
def _folder(folder: Path) -> Iterator[IO[str]]:
    """Make the folder and lock it.

    Raises:
        InputError: It cannot be written, or another batch uses it.
    """
    try:
        for name in ("cases", "runs"):
            (folder / name).mkdir(parents=True, exist_ok=True)
        file = (folder / ".lock").open("w")
    except OSError as error:
        raise InputError(f"-o {folder}: cannot be written: {error.strerror}") from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"-o {folder}: another batch is running in it") from None
        yield file


def _write(pending: Iterable[_Run], folder: Path, cores: int | None) -> None:
    """Write the cases and what Snakemake is to do; forget how earlier tries ended.

    What a killed batch left to Slurm may be running, and end at any time: it is let.

    Args:
        pending: The runs.
        folder: The folder of the batch.
        cores: Those of this machine; None on a cluster.

    Raises:
        InputError: The folder cannot be written.
    """
    shared: dict[str, list[_Run]] = {}
    for r in pending:
        shared.setdefault(r.process, []).append(r)
    jobs = {}
    try:
        for id, runs in shared.items():
            case, output = folder / "cases" / f"{id}.yaml", folder / "runs" / id
            write_text(case, _text(runs))
            for r in runs:
                (r.path / FAILED).unlink(missing_ok=True)
                if _summary(r) is None:
                    (r.path / "DONE").unlink(missing_ok=True)
            for kind in ("ok", "slurm", "status"):
                _file(folder, id, kind).unlink(missing_ok=True)
            ranks = runs[0].ranks
            command = [*MANTLE_RUN, case.resolve(), "-o", output.resolve(), "--keep"]
            command += ["--restart", "auto"]
            command += ["-n", ranks] if ranks > 1 else []
            alone = any(r.alone for r in runs)
            jobs[id] = {
                "command": shlex.join(map(str, ["env", *_environment(), *command])),
                "threads": ranks if not cores else cores if alone else min(ranks, cores),
                "memory": math.ceil(max(sizing.needed(r.case) for r in runs) / MEGABYTE),
            }
        write_json(folder / "jobs.json", jobs)
    except OSError as error:
        raise InputError(f"-o {folder}: cannot be written: {error.strerror}") from error


def _text(runs: Sequence[_Run]) -> str:
    """The case file of a process: of its run, or with each of those it is shared by a variation."""
    first = runs[0]
    if first.process == first.id:
        return config.dump(first.case)
    data = config.plain(first.case)
    _, base = split(data)
    variations = {}
    for r in runs:
        _, own = split(config.plain(r.case))
        keys = [key for key in base | own if base.get(key) != own.get(key)]
        variations[r.id] = {key: own.get(key) for key in keys}
    return case_file.written(data | {"variations": variations})


def _environment() -> list[str]:
    """Arguments of ``env`` that restore the variables that Snakemake changes."""
    one_thread = [f"{name}_NUM_THREADS=1" for name in THREADS]
    cache = os.environ.get("XDG_CACHE_HOME")
    return ["-u", "XDG_CACHE_HOME", *one_thread] + ([f"XDG_CACHE_HOME={cache}"] if cache else [])


def _execute(
    pending: Sequence[_Run],
    total: int,
    folder: Path,
    cores: int,
    lock: IO[str],
    slurm: Sequence[str] | None,
    so_far: Callable[[], None],
) -> None:
    """Have Snakemake run the pending runs, and tell how it goes.

    Raises:
        StoppedError: Interrupted.
        EnvironmentProblem: Snakemake or Slurm is missing or failed.
    """
    if importlib.util.find_spec("snakemake") is None:
        raise EnvironmentProblem("many runs need Snakemake (Debian: snakemake)")
    command = [sys.executable, "-m", "snakemake", "--snakefile", SNAKEFILE]
    command += ["--keep-going", "--nolock", "--rerun-incomplete", "--scheduler", "greedy"]
    environ = dict(os.environ)
    if slurm is None:
        # As many at a time as there are cores for, and memory.
        memory = int(sizing.available({}) / MEGABYTE)
        command += ["--cores", cores, "--resources", f"memory={memory}"]
    else:
        command += cluster.options(folder, slurm, any(r.alone for r in pending))
        environ = cluster.environment(environ)
    libc = ctypes.CDLL(None)
    said, cache = folder / "snakemake.log", folder.resolve() / ".snakemake"
    progress = _Progress(pending, total, folder)
    with _interruptible(), said.open("w") as output:
        child = subprocess.Popen(
            list(map(str, command)),
            cwd=folder,
            # Snakemake cannot do without a cache of its own, wherever home is.
            env=environ | {"XDG_CACHE_HOME": str(cache)},
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            # Ctrl-C is for this process, which passes it on once.
            start_new_session=True,
            # Should this process be killed, Snakemake starts nothing more. What runs goes on under
            # locks of its own: who comes next waits for it.
            preexec_fn=lambda: libc.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL),
            pass_fds=(lock.fileno(),),
        )
        reported, due = progress.count, time.monotonic()
        try:
            while child.poll() is None:
                time.sleep(POLL)
                progress.tell()
                if progress.count > reported and time.monotonic() > due:
                    reported, due = progress.count, time.monotonic() + OFTEN
                    so_far()
        except BaseException as error:
            if slurm is None:
                log.info("stopping; running cases save their state first (once more: stop at once)")
                _end(child)
            else:
                log.info("stopping; the jobs are cancelled")
                _cancel(child, folder)
            if not isinstance(error, KeyboardInterrupt):
                raise  # the report so far cannot be written
            so_far()
            raise StoppedError(
                f"stopped after {progress.count} of {total} runs in {folder}; "
                "the same command continues"
            ) from None
    progress.tell()
    if slurm is not None:
        _settle(pending, folder)
        progress.tell(lost=True)
    if progress.open:
        lines = _tail(said)
        raise EnvironmentProblem(f"Snakemake failed, see {said}:\n{lines}")


class _Progress:
    """Tells of each run that has ended."""

    def __init__(self, pending: Sequence[_Run], total: int, folder: Path) -> None:
        self.open = {r.id: r for r in pending}
        self._total, self._folder = total, folder
        self._begin, self._new, self._failed = time.monotonic(), 0, 0

    @property
    def count(self) -> int:
        """Runs that have ended, those of earlier calls included."""
        return self._total - len(self.open)

    def tell(self, lost: bool = False) -> None:
        """Look for runs that have ended since the last time.

        Args:
            lost: Whether those have too that Slurm began and that left no exit code.
        """
        for run in list(self.open.values()):
            ended = _status(self._folder, run.process) is not None
            ended |= run.process != run.id and _left(run)
            if not ended and not (lost and _file(self._folder, run.process, "slurm").exists()):
                continue
            result = _result(Job(run.name, run.path), self._folder, run)
            code = result.exit_code
            del self.open[run.id]
            self._new += 1
            self._failed += code != 0
            notes = [f"{self._failed} failed"] if self._failed else []
            if self.open:
                left = (time.monotonic() - self._begin) / self._new * len(self.open)
                notes.append(f"about {duration(left)} left")
            time_ = duration(result.seconds)
            log.info(
                "[%d/%d] %s %s%s",
                self.count,
                self._total,
                run.name,
                f"done in {time_}" if code == 0 else f"failed with exit code {code}",
                f" ({', '.join(notes)})" if notes else "",
            )


def duration(seconds: float) -> str:
    """Seconds for people: 12.3 s, 40 s, 5 min, 1.5 h."""
    if seconds < 20:
        return f"{seconds:.1f} s"
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


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


def _end(child: subprocess.Popen[bytes]) -> None:
    """End Snakemake, pass an interruption on to its jobs, wait for them; kill at the second."""
    begin = time.monotonic()
    # It has nothing to save, and a signal may find it holding a lock that its handler waits for.
    child.kill()
    _send(child.pid, signal.SIGINT)
    while True:
        try:
            while _others(child.pid):
                time.sleep(POLL)
            child.wait()
            return
        except KeyboardInterrupt:
            # One Ctrl-C may arrive twice: from the terminal and from whatever started this.
            if time.monotonic() > begin + SAME_SIGNAL:
                _send(child.pid, signal.SIGKILL)


def _others(group: int) -> bool:
    """Whether a process group has more living members than its leader."""
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            # pid (name) state parent group ...; the name may hold anything.
            state, _, of = stat.read_text(errors="replace").rpartition(")")[2].split()[:3]
            if int(of) == group and state != "Z" and stat.parent.name != str(group):
                return True
    return False


def _cancel(child: subprocess.Popen[bytes], folder: Path) -> None:
    """End Snakemake and cancel its jobs.

    Raises:
        EnvironmentProblem: Slurm does not answer.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # it takes some seconds, and they would be in vain
    _send(child.pid, signal.SIGKILL)
    child.wait()
    cluster.cancel(folder)


def _settle(pending: Sequence[_Run], folder: Path) -> None:
    """Wait until the results of runs that are done can be seen here, on a shared file system."""
    deadline = time.monotonic() + cluster.LATENCY
    for r in pending:
        while (_status(folder, r.process) or (LOST, 0.0))[0] == 0 and _summary(r) is None:
            if time.monotonic() > deadline:
                return
            os.listdir(r.path)  # has it look again
            time.sleep(1)


def _send(group: int, number: int) -> bool:
    """Send a signal to a process group; whether there was anybody."""
    try:
        os.killpg(group, number)
    except ProcessLookupError:
        return False
    return True


def _file(folder: Path, id: str, kind: str) -> Path:
    """A file beside a run directory."""
    return folder / "runs" / f"{id}.{kind}"


def _status(folder: Path, id: str) -> tuple[int, float] | None:
    """Exit code and seconds of a run; None while there are none."""
    try:
        code, begin, end = _file(folder, id, "status").read_text().split()
        return int(code), float(end) - float(begin)
    except (OSError, ValueError):
        return None


def _left(run: _Run) -> bool:
    """Whether a run that shares a process has ended before that: done, or not converged."""
    return (run.path / "DONE").exists() or (run.path / FAILED).exists()


def _summary(run: _Run) -> dict[str, Any] | None:
    """The summary of a run that is done; None if it is not."""
    try:
        return (
            dict(json.loads((run.path / "summary.json").read_text(encoding="utf-8")))
            if (run.path / "DONE").exists()
            else None
        )
    except (OSError, ValueError):
        return None


def _result(job: Job, folder: Path, run: _Run) -> Result:
    """How a run has ended."""
    status = _status(folder, run.process)
    code, seconds = status or (LOST, 0.0)
    result = partial(Result, job, run.path, process=run.process)
    if (summary := _summary(run)) is not None:
        # It may have been done in another process than the one it would be given now, or in one
        # that was killed before it could tell how long it took.
        own = _status(folder, run.path.name) if run.path.parent == folder / "runs" else None
        total = summary.get("timing", {}).get("total", 0.0)
        return result(0, own[1] if own else total, summary, "")
    with suppress(OSError):
        # In a process that goes on without it, what it said stands in its folder.
        why = (run.path / FAILED).read_text(encoding="utf-8").strip()
        return result(ConvergenceError.exit_code, 0.0, {}, why)
    message = _tail(_file(folder, run.process, "log"))
    if status is None:
        message += "\n" + _tail(_file(folder, run.process, "slurm"))
    if code > 128 and code - 128 in set(signal.Signals):
        message += f"\nkilled by {signal.Signals(code - 128).name}"
    return result(code or LOST, seconds, {}, message.strip())


def _tail(path: Path) -> str:
    """The last lines of a log."""
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return ""
    return "\n".join([line for line in lines if line.strip()][-LOG_LINES:])
