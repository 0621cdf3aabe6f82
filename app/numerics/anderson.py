"""Anderson's acceleration of a fixed-point iteration."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

from app.arrays import Floats


class Anderson:
    """Iterates of x = g(x), each the combination of the last ones with the least residual.

    D. G. Anderson, J ACM 12 (1965) 547.

    Args:
        depth: How many earlier iterates are used.
    """

    def __init__(self, comm: MPI.Comm, depth: int) -> None:
        self._comm, self._depth = comm, depth
        self._f: list[Floats] = []
        self._g: list[Floats] = []

    def next(self, x: Floats, g: Floats) -> Floats:
        """The iterate after x, of which g is the image; rows of this rank; collective."""
        self._f, self._g = [*self._f, (g - x).ravel()], [*self._g, g]
        if len(self._f) == 1:
            return g
        del self._f[: -self._depth - 1], self._g[: -self._depth - 1]
        F = np.diff(self._f, axis=0)
        normal = self._comm.allreduce(np.vstack([F @ F.T, F @ self._f[-1]]))
        weights = np.linalg.lstsq(normal[:-1], normal[-1], rcond=1e-14)[0]
        return np.asarray(g - np.einsum("k,k...->...", weights, np.diff(self._g, axis=0)))
