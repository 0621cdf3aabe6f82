"""Actions on all ranks: an error on one rank is raised on every rank, so that no rank waits."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, TypeVar

from app.foundation.errors import MantleError, RankError

if TYPE_CHECKING:
    from mpi4py import MPI

T = TypeVar("T")

# Time to wait for ranks without an error [s].
PATIENCE = 5.0


def all_ranks_arrive(comm: MPI.Comm) -> bool:
    """Return True if all ranks call this in time; ranks without an error wait elsewhere."""
    barrier = comm.Ibarrier()
    end = time.monotonic() + PATIENCE
    while not barrier.Test():
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


def agree(comm: MPI.Comm, error: MantleError) -> None:
    """Confirm that all ranks have met an error, before any collective reaction to it.

    Raises:
        RankError: They have not.
    """
    if not all_ranks_arrive(comm):
        raise RankError(error) from error


def everywhere(comm: MPI.Comm, action: Callable[[], T]) -> T:
    """Run a local action on every rank (collective). If it fails on one rank, raise on all."""
    error = None
    try:
        result = action()
    except Exception as caught:  # of any kind: the other ranks wait
        error = caught
    for rank_error in comm.allgather(error):
        if rank_error is not None:
            raise error or rank_error
    return result


def on_root(comm: MPI.Comm, action: Callable[[], T], share: bool = True) -> T | None:
    """Run an action on rank 0; share its result, or None, and raise its errors on every rank."""
    result = everywhere(comm, lambda: action() if comm.rank == 0 else None)
    return comm.bcast(result) if share else result


def distribute_tasks(comm: MPI.Comm, tasks: Sequence[Callable[[], T]]) -> list[T]:
    """Divide tasks among the ranks and return their results in order on rank 0, else nothing.

    Rank r takes task r and every further one by the number of ranks. Collective; an error in a
    task is raised on every rank.
    """
    results = comm.gather(everywhere(comm, lambda: [t() for t in tasks[comm.rank :: comm.size]]))
    if results is None:
        return []
    return [results[k % comm.size][k // comm.size] for k in range(len(tasks))]
