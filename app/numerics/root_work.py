"""Work that rank 0 does alone: with threads of BLAS, while the other ranks sleep."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from mpi4py import MPI

from threadpoolctl import ThreadpoolController

# Time between two looks at whether all ranks have come [s].
POLLING_INTERVAL = 2e-4


def usable_cores(comm: MPI.Comm) -> int:
    """Number of cores that all ranks on this node may use together; collective."""
    node = comm.Split_type(MPI.COMM_TYPE_SHARED)
    number = min(node.size, len(os.sched_getaffinity(0)))
    node.Free()
    return number


@contextmanager
def blas_threads(number: int) -> Iterator[None]:
    """Give BLAS and LAPACK this number of threads in the block."""
    with _controller().limit(limits=number, user_api="blas"):
        yield


@cache
def _controller() -> ThreadpoolController:
    return ThreadpoolController()


def wait(comm: MPI.Comm) -> None:
    """Wait for all ranks asleep: blocking calls of MPI keep a core busy; collective."""
    request = comm.Ibarrier()
    while not request.Test():
        time.sleep(POLLING_INTERVAL)
