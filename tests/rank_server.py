"""Persistent ranks that run one Python program after another.

`tests.support.on_ranks` starts them with a folder. Each rank waits for ``N.json``, the arguments of
Python. It runs Python with output in ``N.out`` and ``N.err``, and writes the exit code. Empty
arguments end the rank.
"""

from __future__ import annotations

import gc
import json
import os
import runpy
import sys
import time
import traceback
from itertools import count
from pathlib import Path

from mpi4py import MPI

from app import cli
from app.system import ranks

PAUSE = 0.01


def run(arguments: list[str]) -> int:
    """Run Python with these arguments; return its exit code."""
    sys.argv = arguments
    try:
        if arguments[:2] == ["-m", "mantle"]:
            return cli.main(arguments[2:])
        if arguments[0] == "-m":
            sys.argv = arguments[1:]
            runpy.run_module(arguments[1], run_name="__main__", alter_sys=True)
        else:
            runpy.run_path(arguments[0], run_name="__main__")
    except SystemExit as end:
        return int(end.code or 0)
    except Exception:
        traceback.print_exc()
        sys.stderr.flush()
        MPI.COMM_WORLD.Abort(1)
    return 0


def redirect(path: Path, descriptor: int) -> None:
    """Append the output of a file descriptor to a file."""
    target = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(target, descriptor)
    os.close(target)


def main(folder: Path) -> None:
    ranks.end_with_parent()
    comm = MPI.COMM_WORLD
    for number in count():
        order = folder / f"{number}.json"
        while not order.exists():
            time.sleep(PAUSE)
        for descriptor, name in ((1, "out"), (2, "err")):
            redirect(order.with_suffix(f".{name}"), descriptor)
        arguments = json.loads(order.read_text())
        if not arguments:
            return
        code = run(arguments)
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        gc.collect()  # destructors of PETSc and dolfinx objects are collective
        comm.barrier()
        order.with_suffix(f".{comm.rank}").write_text(f"{code}\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
