"""Active set: states of the contact points over the Newton iterations, and which change."""

from __future__ import annotations

from collections import Counter

from mpi4py import MPI

import numpy as np

from app.arrays import Ints

# Iterations that are kept, and the longest cycle that is recognized.
KEPT, LONGEST = 12, 5


class ActiveSet:
    """States of the contact points of this rank at the last iterates."""

    def __init__(self, comm: MPI.Comm) -> None:
        self._comm = comm
        self._known: list[Ints] = []

    def forget(self) -> None:
        """Forget all states before a new run."""
        self._known = []

    def add(self, status: Ints) -> None:
        """Append the states (n,) at an iterate."""
        self._known = [*self._known[-KEPT:], status.copy()]

    def points(self) -> int:
        """Number of points on all ranks; collective."""
        return int(self._comm.allreduce(len(self._known[-1]) if self._known else 0, MPI.SUM))

    def changes(self) -> int:
        """Number of points whose state changed between the last two iterates; collective."""
        changed = int((self._known[-1] != self._known[-2]).sum()) if len(self._known) > 1 else 0
        return int(self._comm.allreduce(changed, MPI.SUM))

    def period(self) -> int:
        """Length of the cycle in which all states repeat, seen twice; 0 without; collective."""
        known = self._known
        for p in range(2, LONGEST + 1):
            again = len(known) > 2 * p and all(
                np.array_equal(known[-1 - k], known[-1 - k - p]) for k in range(p + 1)
            )
            if self._comm.allreduce(again, MPI.LAND):
                moves = not np.array_equal(known[-1], known[-2])
                return p if self._comm.allreduce(moves, MPI.LOR) else 0
        return 0

    def oscillating(self) -> list[tuple[int, int, int, tuple[int, ...]]]:
        """Points of this rank that changed their state last, the most oscillating first.

        Each with its row, the number of its changes, the iterations in which they were counted, and
        the states it alternates between.
        """
        if len(self._known) < 2:
            return []
        states = np.array(self._known)
        changes = (states[1:] != states[:-1]).sum(axis=0)
        # Points without recent changes are left out.
        late = (states[-2:] != states[-3:-1]).any(axis=0) if len(states) > 2 else changes > 0
        rows = np.flatnonzero(late)
        return [
            (
                int(k),
                int(changes[k]),
                len(states) - 1,
                tuple(sorted(s for s, _ in Counter(map(int, states[:, k])).most_common(3))),
            )
            for k in rows[np.argsort(-changes[rows], kind="stable")]
        ]
