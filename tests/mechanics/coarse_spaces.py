"""Matrices of coarse spaces."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from app.numerics.sparse import from_rows


def sparse(values: np.ndarray) -> PETSc.Mat:
    """A sparse matrix with these entries."""
    rows, columns = values.shape
    start, numbers = columns * np.arange(rows + 1), np.tile(np.arange(columns), rows)
    return from_rows(MPI.COMM_SELF, (rows, columns), start, numbers, values.ravel())


# All directions of two points.
ALL = np.tile(np.eye(3), (2, 1, 1))
