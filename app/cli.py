# PYTHON_ARGCOMPLETE_OK
"""The command line: ``mantle run | check | mesh | study | sweep | report | verify | ...``.

`command_line.parser` has the options, `command_line.commands` the commands; this module handles
errors and exit codes. With python3-argcomplete installed,
``eval "$(register-python-argcomplete mantle)"`` completes commands and options in bash.

`foundation.errors.EXIT_CODES` lists the exit codes.
"""

from __future__ import annotations

import io
import os
import sys
import time
import traceback
from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING

from app.command_line.commands import dispatch
from app.command_line.parser import parser
from app.command_line.streams import painted, silence
from app.foundation import files
from app.foundation.collective import all_ranks_arrive
from app.foundation.errors import InputError, MantleError, RankError, StoppedError
from app.soundness import memory
from app.system import form_cache, ranks
from app.system.folders import settle_cache
from app.system.ranks import rank

if TYPE_CHECKING:
    from mpi4py import MPI

# Time that other ranks get to print their error before the job ends [s].
GRACE = 1.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command, that of the process by default, and return its exit code."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        # Paths may contain undecodable bytes.
        sys.stdout.reconfigure(line_buffering=True, errors="backslashreplace")
    if "_ARGCOMPLETE" in os.environ:
        import argcomplete

        argcomplete.autocomplete(parser())  # prints what may follow, and ends this process
    os.environ["OMP_NUM_THREADS"] = os.environ.get("OMP_NUM_THREADS") or "1"
    ranks.find_program()
    ranks.use_one_node()
    ranks.end_with_parent()
    try:
        message = settle_cache()
        if message and rank() == 0:
            print(f"mantle: {message}", file=sys.stderr)
        for name in filter(None, os.environ.get("MANTLE_EXTENSIONS", "").split(",")):
            _extend(name)
        return dispatch(list(sys.argv[1:] if arguments is None else arguments))
    except MantleError as error:
        return _leave(error)
    except KeyboardInterrupt:
        # A run handles signals from its beginning (`stopping.signals`): this one came before it.
        if rank() == 0:
            run = (sys.argv[1:] if arguments is None else [*arguments])[:1] == ["run"]
            disk = ": no step had converged, so nothing was written" if run else ""
            print(f"stopped{disk}", file=sys.stderr, flush=True)
        _abort(StoppedError.exit_code)
        return StoppedError.exit_code
    except BrokenPipeError:
        silence(sys.stdout)
        return 0
    except Exception as error:
        problem = (
            memory.error_without_memory(error)
            or form_cache.error_of_compilation(error)
            or files.error_of_refused_path(error)
        )
        if problem is not None:
            return _leave(problem)
        print(
            f"mantle: internal error on rank {rank()}; please report it with what follows\n"
            + traceback.format_exc(),
            file=sys.stderr,
            flush=True,
        )
        _abort(MantleError.exit_code)
        return MantleError.exit_code


def _leave(error: MantleError) -> int:
    """Print an error once and exit with all ranks. Ranks that do not reach this are ended."""
    if rank() == 0:
        print(painted(error, "bad", sys.stderr), file=sys.stderr, flush=True)
    else:
        # mpirun ends all ranks when the first one exits. Wait, so that rank 0 can print its error.
        time.sleep(GRACE)
    world = _world()
    if world is not None and (isinstance(error, RankError) or not all_ranks_arrive(world)):
        if rank() != 0:
            print(f"rank {rank()}: {error}", file=sys.stderr, flush=True)
        _abort(error.exit_code)
    return error.exit_code


def _world() -> MPI.Comm | None:
    """Communicator of all ranks, or None for a single rank."""
    mpi = sys.modules.get("mpi4py.MPI")
    if mpi is None or not mpi.Is_initialized() or mpi.Is_finalized():
        return None
    return mpi.COMM_WORLD if mpi.COMM_WORLD.size > 1 else None


def _extend(name: str) -> None:
    """Import laws, loads and quantities of another package.

    Raises:
        InputError: It cannot be imported.
    """
    try:
        import_module(name)
    except Exception as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{at.filename}:{at.lineno}"
        if isinstance(error, SyntaxError) and error.filename:
            place = f"{error.filename}:{error.lineno}:{error.offset}"
        raise InputError(
            f"{place}: MANTLE_EXTENSIONS: '{name}' cannot be imported: "
            f"{type(error).__name__}: {error}"
        ) from error


def _abort(code: int) -> None:
    """End all ranks, if there are others: they may be waiting for this one."""
    world = _world()
    if world is not None:
        sys.stdout.flush()
        world.Abort(code)
