"""Start of several MPI ranks of the application: ``-n N`` on the command line.

Only the standard library is used, so that it starts at once. Inside an existing ``mpirun`` or Slurm
step no ranks are started.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, MutableMapping, Sequence
from pathlib import Path
from typing import IO

from app.foundation.errors import EnvironmentProblem, StoppedError
from app.system import scratch

# Variables with the number of ranks, by process manager.
_WORLD_SIZES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS", "SLURM_NTASKS")
_WORLD_MARKS = ("OMPI_COMM_WORLD_SIZE", "PMIX_RANK", "PMI_RANK", "SLURM_STEP_ID")
# Variables with the rank of a process, by process manager.
RANK_VARIABLES = ("OMPI_COMM_WORLD_RANK", "PMIX_RANK", "PMI_RANK", "SLURM_PROCID")
# On one node only shared memory is needed; looking for a network fails audibly. A rank that waits
# lets others have its core: beside other work two ranks take half of the time.
ONE_NODE = {
    "OMPI_MCA_btl": "self,sm",
    "OMPI_MCA_mpi_yield_when_idle": "1",
    "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
}
_RULE = b"-" * 74 + b"\n"
_BANNER = re.compile(rb"-{74}\s+(prterun|mpirun|MPI_ABORT) ")
# Banners that repeat the application's message, and messages of a job manager that closes down.
# Open MPI 5.0.7 has no option to be quiet: it refuses --quiet and ignores prte_execute_quiet.
_REPEATED = re.compile(
    rb"exited with non-zero status|MPI_ABORT was invoked|calling\s\"abort\""
    rb"|PMIX ERROR: PMIX_ERR_UNREACH|^Abort is in progress|^\[warn\] Epoll "
)
_ENDED = re.compile(rb"exited on\ssignal")
_PR_SET_PDEATHSIG = 1
# Exit code of PETSc after a signal such as SIGSEGV, which it has reported.
_CRASHED = 59
# Time in which a second signal counts as the first one, arrived twice [s].
SAME_SIGNAL = 1.0
NOT_SAVED = (
    "stopped before the state was saved; --restart auto goes on from an earlier checkpoint, if any"
)
# The folder that holds app, forms, meshes, configs and mantle.py.
_FOLDER = str(Path(__file__).resolve().parents[2])


def world_size(environ: Mapping[str, str] = os.environ) -> int | None:
    """Number of ranks of the surrounding ``mpirun`` or Slurm step; 0 if unknown, None outside."""
    if not any(variable in environ for variable in _WORLD_MARKS):
        return None
    sizes = (environ.get(name, "") for name in _WORLD_SIZES)
    return next((int(size) for size in sizes if size.isdigit()), 0)


def rank(environ: Mapping[str, str] = os.environ) -> int:
    """MPI rank of this process, also before MPI starts; 0 if unknown."""
    values = (environ.get(name, "") for name in RANK_VARIABLES)
    return next((int(value) for value in values if value.isdigit()), 0)


def environment(environ: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Environment of the ranks: one thread each, a quiet Open MPI; variables already set stay."""
    defaults = {"OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}
    if not scratch.SCHEDULERS & environ.keys():
        defaults |= ONE_NODE
    if os.geteuid() == 0:
        defaults |= {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    return {**defaults, **environ}


def use_one_node(environ: MutableMapping[str, str] = os.environ) -> None:
    """Set Open MPI to shared memory where all ranks are on this node.

    Call it before MPI is initialised, for ranks started by a plain ``mpirun``.
    """
    size = environ.get("OMPI_COMM_WORLD_SIZE")
    if size is not None and environ.get("OMPI_COMM_WORLD_LOCAL_SIZE") == size:
        for name, value in ONE_NODE.items():
            environ.setdefault(name, value)


def find_program(environ: MutableMapping[str, str] = os.environ) -> None:
    """Let child processes import mantle, and nothing from the current folder.

    Python looks there first: an ``app.py`` or a ``numpy.py`` of the user's would be imported
    instead. Folders in PYTHONPATH stay, behind the program's.
    """
    folders = [f for f in environ.get("PYTHONPATH", "").split(os.pathsep) if f and f != _FOLDER]
    environ["PYTHONPATH"] = os.pathsep.join([_FOLDER, *folders])
    environ["PYTHONSAFEPATH"] = "1"


def end_with_parent() -> None:
    """End this rank when ``mpirun`` is killed: the others would wait for each other for ever."""
    if "OMPI_COMM_WORLD_SIZE" in os.environ:
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def stop_signals() -> list[signal.Signals]:
    """Signals that ask a run to stop; under ``nohup`` SIGHUP is ignored and not among them."""
    heard = signal.getsignal(signal.SIGHUP) != signal.SIG_IGN
    hang_up_signals = [signal.SIGHUP] if heard else []
    return [signal.SIGINT, signal.SIGTERM, signal.SIGUSR1, *hang_up_signals]


class _Stop:
    """Signal handler that passes the first signal on to mpirun, and ends the ranks at a second.

    The ranks get SIGUSR1, the one signal that mpirun passes on without ending them: they have time
    to save their state and leave.
    """

    def __init__(self, child: subprocess.Popen[bytes]) -> None:
        self.received: list[int] = []
        self._first = math.inf
        self._child = child

    def __call__(self, number: int, _frame: object) -> None:
        # One Ctrl-C may arrive twice: from the terminal and passed on by whatever started this.
        if self.received and time.monotonic() < self._first + SAME_SIGNAL:
            return
        self.received.append(number)
        self._first = min(self._first, time.monotonic())
        if len(self.received) == 1:
            self._child.send_signal(signal.SIGUSR1)
            notify("stopping when the state is saved (a second signal stops at once)")
        else:
            self._child.send_signal(signal.SIGTERM if len(self.received) < 4 else signal.SIGKILL)


def launch(ranks: int, command: Sequence[str]) -> int:
    """Run a command on several ranks and wait for it.

    At the first SIGINT (Ctrl-C), SIGTERM, SIGHUP or SIGUSR1 the ranks save their state and leave; a
    second one, a second later or more, ends them at once.

    Returns:
        The exit code of the first rank that failed, 0 if none did. 5: stopped before the ranks
        handled signals. 130: a second signal ended them. 70: a rank crashed.

    Raises:
        EnvironmentProblem: There is no mpirun.
    """
    # That of a virtual environment belongs to its MPI, and need not be in the PATH.
    search_folders = [str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)]
    mpirun = shutil.which("mpirun", path=os.pathsep.join(search_folders))
    if mpirun is None:
        raise EnvironmentProblem("-n needs mpirun, which is not installed (Debian: openmpi-bin)")
    libc = ctypes.CDLL(None)
    with scratch.variables() as of_scratch:
        child = subprocess.Popen(
            [mpirun, "-n", str(ranks), *command],
            env=environment() | of_scratch,
            stdin=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            # The terminal sends Ctrl-C to the whole process group, which would end mpirun at once.
            start_new_session=True,
            # Should this process be killed, mpirun and the ranks go too.
            preexec_fn=lambda: libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM),
        )
        stop = _Stop(child)
        for number in stop_signals():
            signal.signal(number, stop)
        relayed = child.stderr, sys.stderr.buffer, stop.received
        relay = threading.Thread(target=filter_messages, args=relayed, daemon=True)
        relay.start()
        code = child.wait()
        relay.join(timeout=2.0)
    if stop.received and (code < 0 or code == 1 or code > 128):
        # The ranks had no signal handlers yet (nothing to save), or a second signal killed them.
        once = len(stop.received) == 1
        early = "stopped: no step had converged, so nothing was written"
        notify(early if once else NOT_SAVED)
        return StoppedError.exit_code if once else 130
    # 128 + a signal: a rank crashed or was killed, which mpirun has reported.
    return 70 if code < 0 or code > 128 or code == _CRASHED else code


@contextlib.contextmanager
def mpi_settings() -> Iterator[None]:
    """Set the environment variables of MPI and compilers for the block, then restore them.

    MPI starts within the block. It gets a folder that stays until this process ends, unless it has
    been started or has other ranks. Open MPI does not search a network if all ranks are on this
    node.
    """
    environment_before = dict(os.environ)
    use_one_node()
    if world_size() is None and "mpi4py.MPI" not in sys.modules:
        process = contextlib.ExitStack()
        atexit.register(process.close)
        os.environ |= process.enter_context(scratch.variables())
    try:
        yield
    finally:
        # Libraries that are imported in the block set variables, too.
        for name in os.environ.keys() - environment_before.keys():
            del os.environ[name]
        os.environ |= environment_before


def filter_messages(source: IO[bytes], target: IO[bytes], received: Sequence[int] = ()) -> None:
    """Copy the output of ranks and mpirun, without banners that repeat the application's message.

    mpirun takes ten lines to report the exit code of a rank; the application gives the reason in
    one. Reports of crashes stay, but not of ranks ended by a signal after one was ``received``.
    """
    closing = False  # mpirun has begun to end the job; its banners leave blanks behind
    for line in source:
        block = line
        while block.startswith(_RULE) and (line := source.readline()):
            block += line
            if line == _RULE or not _BANNER.match(block):  # its end, or the application's
                break
        if _REPEATED.search(block) or (received and _ENDED.search(block)):
            closing = True
        elif not closing or block.strip(b" \n\0"):
            _write(target, block)


def _write(target: IO[bytes], text: bytes) -> None:
    with contextlib.suppress(BrokenPipeError):
        target.write(text)
        target.flush()


def notify(message: str) -> None:
    """Print a message to standard error, unless it is closed."""
    _write(sys.stderr.buffer, f"mantle: {message}\n".encode())
