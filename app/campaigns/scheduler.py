"""Snakemake as a process of a batch: start it, follow its runs, stop it."""

from __future__ import annotations

import ctypes
import importlib.util
import logging
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from app.campaigns import cluster
from app.campaigns.runs import LOST, BatchRun, Job, file_of, result_of, status_of, tail
from app.errors import EnvironmentProblem, StoppedError
from app.soundness import memory
from app.system.layout import duration

log = logging.getLogger("mantle")

SNAKEFILE = Path(__file__).with_name("Snakefile")
MEGABYTE = 1e6
POLL = 0.1  # s
OFTEN = 10.0  # s between reports on all runs that have ended so far
SAME_SIGNAL = 1.0  # s
_PR_SET_PDEATHSIG = 1


def execute(
    pending: Sequence[BatchRun],
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
    command, environ = _command(pending, folder, cores, slurm)
    libc = ctypes.CDLL(None)
    said, cache = folder / "snakemake.log", folder.resolve() / ".snakemake"
    progress = _Progress(pending, total, folder)
    with _interruptible(), said.open("w") as output:
        child = subprocess.Popen(
            command,
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
        try:
            _follow(child, progress, so_far)
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
        lines = tail(said)
        raise EnvironmentProblem(f"Snakemake failed, see {said}:\n{lines}")


def _command(
    pending: Sequence[BatchRun], folder: Path, cores: int, slurm: Sequence[str] | None
) -> tuple[list[str], dict[str, str]]:
    """The command line of Snakemake and its environment."""
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(SNAKEFILE)]
    command += ["--keep-going", "--nolock", "--rerun-incomplete", "--scheduler", "greedy"]
    environ = dict(os.environ)
    if slurm is None:
        # As many at a time as there are cores for, and memory.
        megabytes = int(memory.available({}) / MEGABYTE)
        command += ["--cores", str(cores), "--resources", f"memory={megabytes}"]
    else:
        command += cluster.options(folder, slurm, any(r.alone for r in pending))
        environ = cluster.environment(environ)
    return command, environ


def _follow(
    child: subprocess.Popen[bytes], progress: _Progress, so_far: Callable[[], None]
) -> None:
    """Tell of each run that ends, and from time to time of all, until Snakemake has ended."""
    reported, due = progress.count, time.monotonic()
    while child.poll() is None:
        time.sleep(POLL)
        progress.tell()
        if progress.count > reported and time.monotonic() > due:
            reported, due = progress.count, time.monotonic() + OFTEN
            so_far()


class _Progress:
    """Tells of each run that has ended."""

    def __init__(self, pending: Sequence[BatchRun], total: int, folder: Path) -> None:
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
            ended = status_of(self._folder, run.process) is not None
            ended |= run.process != run.id and run.ended
            if not ended and not (lost and file_of(self._folder, run.process, "slurm").exists()):
                continue
            result = result_of(Job(run.name, run.path), self._folder, run)
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


def _settle(pending: Sequence[BatchRun], folder: Path) -> None:
    """Wait until the results of runs that are done can be seen here, on a shared file system."""
    deadline = time.monotonic() + cluster.LATENCY
    for r in pending:
        while (status_of(folder, r.process) or (LOST, 0.0))[0] == 0 and r.summary() is None:
            if time.monotonic() > deadline:
                return
            os.listdir(r.path)  # has it look again
            time.sleep(1)


def _send(group: int, number: int) -> None:
    """Send a signal to a process group, if there is anybody in it."""
    with suppress(ProcessLookupError):
        os.killpg(group, number)
