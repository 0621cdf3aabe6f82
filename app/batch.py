"""One engine for many runs: Snakemake over subprocesses of ``mantle run``, here or by Slurm.

A run lives in a directory named by its content, so that a finished one is never done twice, and a
failed or a changed one is::

    folder/cases/<id>.yaml      the resolved case
    folder/runs/<id>/           its run directory, complete once it holds DONE
    folder/runs/<id>.log        what it said
    folder/runs/<id>.status     its exit code, and when it began and ended
    folder/runs/<id>.lock       locked while it runs
    folder/runs/<id>.ok         for Snakemake: it is done
    folder/runs/<id>.slurm      what Slurm said of its job
    folder/snakemake.log        what Snakemake said
"""

from __future__ import annotations

import ctypes
import fcntl
import hashlib
import importlib.util
import json
import logging
import os
import re
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import IO, Any

from app import __version__, cluster, config
from app.errors import EnvironmentProblem, InputError, StoppedError
from app.folders import write_json, write_text

log = logging.getLogger("mantle")

MANTLE_RUN: tuple[str, ...] = (sys.executable, "-m", "app", "run")
SNAKEFILE = Path(__file__).with_name("Snakefile")
ROOT = Path(__file__).resolve().parents[1]
# Modules that no run imports: changing them leaves finished runs valid.
OUTSIDE = re.compile(
    r"app/(batch|bench\w*|cli|cluster|doctor|results|study\w*|verify\w*|work_precision)\.py"
)
# Snakemake sets these to the cores of the job; ranks have one thread each.
THREADS = ("OMP", "GOTO", "OPENBLAS", "MKL")
LOG_LINES = 12
POLL = 0.1  # s
MISSED = 15.0  # s after which Snakemake is told again to stop
SAME_SIGNAL = 1.0  # s
PATIENCE = 10.0  # s
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
    """

    name: str
    case: Path
    overrides: tuple[str, ...] = ()
    ranks: int = 1
    alone: bool = False


@dataclass(frozen=True)
class Result:
    """What became of a job.

    Attributes:
        job: The job.
        folder: Its run directory.
        exit_code: 0 if it is done, else that of ``mantle run``.
        seconds: Wall time of the process.
        summary: ``summary.json``; empty unless the run is done.
        message: Why it failed: the last lines of its log; empty if it is done.
    """

    job: Job
    folder: Path
    exit_code: int
    seconds: float
    summary: dict[str, Any]
    message: str


@dataclass(frozen=True)
class _Run:
    """A run directory and what goes into it; several jobs may share it."""

    id: str
    name: str
    text: str
    ranks: int
    alone: bool


def run(
    jobs: Sequence[Job], folder: Path, cores: int, slurm: Sequence[str] | None = None
) -> list[Result]:
    """Run what is not done yet.

    Args:
        jobs: What is wanted.
        folder: Where everything goes; used by one batch at a time.
        cores: How many cores of this machine to use at most.
        slurm: Each run is a job of a Slurm cluster, with these options of sbatch; all nodes see
            the folder. None: all run here.

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
        ids, runs = _runs(jobs, cases, folder)
        pending = [r for r in runs.values() if _summary(folder, r.id) is None]
        log.info("%d runs: %d done already, in %s", len(runs), len(runs) - len(pending), folder)
        if pending:
            _write(pending, folder, cores if slurm is None else None)
            _execute(pending, len(runs), folder, cores, lock, slurm)
        return [_result(job, folder, id) for job, id in zip(jobs, ids, strict=True)]


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
    jobs: Sequence[Job], cases: Sequence[config.Case], folder: Path
) -> tuple[list[str], dict[str, _Run]]:
    """The id of each job, and the runs by id: one for all jobs of the same content."""
    found = {path.name[-10:]: path.name for path in (folder / "runs").glob("*/")}
    ids: list[str] = []
    runs: dict[str, _Run] = {}
    for job, case in zip(jobs, cases, strict=True):
        text = config.dump(case)
        digest = _digest(case, text, job.ranks)
        name = re.sub(r"[^A-Za-z0-9_.-]", "_", job.name)
        # The name of a run is not its content: a renamed one is still the same.
        id = found.setdefault(digest, f"{name}-{digest}")
        ids.append(id)
        same = runs.get(id, _Run(id, job.name, text, job.ranks, job.alone))
        runs[id] = replace(same, alone=same.alone or job.alone)
    return ids, runs


def _digest(case: config.Case, text: str, ranks: int) -> str:
    """Ten hexadecimal digits of everything the result depends on."""
    parts = [text, str(ranks), _program()]
    if isinstance(case.geometry, config.MeshFile):
        parts.append(case.geometry.content)
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:10]


@lru_cache(maxsize=1)
def _program() -> str:
    """The version and a hash of the sources, which change more often."""
    digest = hashlib.sha256()
    for package in ("app", "forms", "meshes"):
        for path in sorted((ROOT / package).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            if not OUTSIDE.fullmatch(name):
                digest.update(f"{name}\0".encode() + path.read_bytes())
    return f"{__version__} {digest.hexdigest()}"


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
    jobs = {}
    try:
        for r in pending:
            case, output = folder / "cases" / f"{r.id}.yaml", folder / "runs" / r.id
            write_text(case, r.text)
            if (output / "DONE").exists() and _summary(folder, r.id) is None:
                (output / "DONE").unlink()  # its summary cannot be read
            for kind in ("ok", "slurm", "status"):
                _file(folder, r.id, kind).unlink(missing_ok=True)
            command = [*MANTLE_RUN, case.resolve(), "-o", output.resolve(), "--keep"]
            command += ["-n", r.ranks] if r.ranks > 1 else []
            jobs[r.id] = {
                "command": shlex.join(map(str, ["env", *_environment(), *command])),
                "threads": r.ranks if not cores else cores if r.alone else min(r.ranks, cores),
            }
        write_json(folder / "jobs.json", jobs)
    except OSError as error:
        raise InputError(f"-o {folder}: cannot be written: {error.strerror}") from error


def _environment() -> list[str]:
    """What Snakemake changes in the environment and a run needs as it was, for ``env``."""
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
    environ, last = dict(os.environ), int(signal.SIGTERM)
    if slurm is None:
        command += ["--cores", cores]
    else:
        command += cluster.options(folder, slurm, any(r.alone for r in pending))
        environ, last = cluster.environment(environ), int(signal.SIGKILL)
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    libc = ctypes.CDLL(None)
    said, cache = folder / "snakemake.log", folder.resolve() / ".snakemake"
    progress = _Progress(pending, total, folder)
    with _interruptible(), said.open("w") as output:
        child = subprocess.Popen(
            list(map(str, command)),
            cwd=folder,
            # Snakemake cannot do without a cache of its own, wherever home is.
            env=environ | {"PYTHONPATH": path, "XDG_CACHE_HOME": str(cache)},
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            # Ctrl-C is for this process, which passes it on once.
            start_new_session=True,
            # Should this process be killed, Snakemake starts nothing more, and the folder stays
            # locked until what runs has ended; what a cluster runs goes on and has its own locks.
            preexec_fn=lambda: libc.prctl(_PR_SET_PDEATHSIG, last),
            pass_fds=(lock.fileno(),),
        )
        try:
            while child.poll() is None:
                time.sleep(POLL)
                progress.tell()
        except KeyboardInterrupt:
            if slurm is None:
                log.info("stopping; running cases save their state first (once more: stop at once)")
                _end(child)
            else:
                log.info("stopping; the jobs are cancelled")
                _cancel(child, folder)
            raise StoppedError(
                f"stopped after {progress.count} of {total} runs; "
                f"the same command goes on from there (in {folder})"
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
        self.open = {r.id: r.name for r in pending}
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
        for id, name in list(self.open.items()):
            status = _status(self._folder, id)
            if status is None and lost and _file(self._folder, id, "slurm").exists():
                status = LOST, 0.0
            if status is None:
                continue
            code, seconds = status
            del self.open[id]
            self._new += 1
            self._failed += code != 0
            notes = [f"{self._failed} failed"] if self._failed else []
            if self.open:
                left = (time.monotonic() - self._begin) / self._new * len(self.open)
                notes.append(f"about {duration(left)} left")
            log.info(
                "[%d/%d] %s %s%s",
                self.count,
                self._total,
                name,
                f"done in {duration(seconds)}" if code == 0 else f"failed with exit code {code}",
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
    """Pass an interruption on to Snakemake and its jobs, and wait for them; kill at the second."""
    begin = time.monotonic()
    _send(child.pid, signal.SIGINT)
    while True:
        try:
            try:
                child.wait(MISSED)
            except subprocess.TimeoutExpired:
                # It may miss one while it starts a job.
                child.send_signal(signal.SIGINT)
                child.wait()
            deadline = time.monotonic() + PATIENCE
            while _send(child.pid, 0) and time.monotonic() < deadline:
                time.sleep(POLL)
            _send(child.pid, signal.SIGKILL)
            return
        except KeyboardInterrupt:
            # One Ctrl-C may arrive twice: from the terminal and from whatever started this.
            if time.monotonic() > begin + SAME_SIGNAL:
                _send(child.pid, signal.SIGKILL)


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
        while (_status(folder, r.id) or (LOST, 0.0))[0] == 0 and _summary(folder, r.id) is None:
            if time.monotonic() > deadline:
                return
            os.listdir(folder / "runs" / r.id)  # has it look again
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


def _summary(folder: Path, id: str) -> dict[str, Any] | None:
    """The summary of a run that is done; None if it is not."""
    path = folder / "runs" / id
    try:
        return (
            dict(json.loads((path / "summary.json").read_text(encoding="utf-8")))
            if (path / "DONE").exists()
            else None
        )
    except (OSError, ValueError):
        return None


def _result(job: Job, folder: Path, id: str) -> Result:
    """How a run has ended."""
    status = _status(folder, id)
    code, seconds = status or (LOST, 0.0)
    path, summary = folder / "runs" / id, _summary(folder, id)
    if summary is not None:
        return Result(job, path, 0, seconds, summary, "")
    message = _tail(_file(folder, id, "log"))
    if status is None:
        message += "\n" + _tail(_file(folder, id, "slurm"))
    if code > 128 and code - 128 in set(signal.Signals):
        message += f"\nkilled by {signal.Signals(code - 128).name}"
    return Result(job, path, code or LOST, seconds, {}, message.strip())


def _tail(path: Path) -> str:
    """The last lines of a log."""
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return ""
    return "\n".join([line for line in lines if line.strip()][-LOG_LINES:])
