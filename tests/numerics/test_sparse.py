"""Sparse matrices from triplets."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

from app.numerics.sparse import from_triplets


def test_sparse_triplets_are_summed() -> None:
    rng = np.random.default_rng(4)
    i, j, v = rng.integers(0, 5, 60), rng.integers(0, 7, 60), rng.random(60)
    expected = np.zeros((5, 7))
    np.add.at(expected, (i, j), v)
    A = from_triplets(MPI.COMM_SELF, 5, 7, i, j, v)
    np.testing.assert_allclose(A[:, :], expected)
    none = np.zeros(0, dtype=np.int64)
    assert from_triplets(MPI.COMM_SELF, 2, 3, none, none, np.zeros(0)).norm() == 0.0
