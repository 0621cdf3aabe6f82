"""Sparse matrices between unknowns of nodes and unknowns of interface points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from dolfinx.common import IndexMap
from numpy.typing import NDArray

from app.foundation.arrays import Floats, Ints

if TYPE_CHECKING:
    from scipy.sparse import csr_array


def owners(comm: MPI.Comm, index_map: IndexMap, dof: Ints) -> tuple[Ints, Ints]:
    """Assign replicated points, by their global dofs (n,), to the ranks that own these.

    Returns:
        The points of this rank, and the number of every point in the order of the ranks (n,).
    """
    range_ends = np.array(comm.allgather(index_map.local_range[1]))
    owner = np.searchsorted(range_ends, dof, side="right")
    order = np.argsort(owner, kind="stable")
    number_of_point = np.empty(len(order), dtype=np.int64)
    number_of_point[order] = np.arange(len(order))
    return order[owner[order] == comm.rank], number_of_point


def from_triplets(
    comm: MPI.Comm, rows: int, columns: int, i: Ints, j: Ints, v: Floats
) -> PETSc.Mat:
    """Matrix from triplets (owned local rows, global columns), duplicates summed; collective."""
    order = np.lexsort((j, i))
    i, j = i[order], j[order]
    is_first = np.ones(len(i), dtype=bool)
    is_first[1:] = (i[1:] != i[:-1]) | (j[1:] != j[:-1])
    first_entries = np.flatnonzero(is_first)
    start = np.searchsorted(i[first_entries], np.arange(rows + 1))
    values = np.add.reduceat(v[order], first_entries) if len(first_entries) else v
    return from_rows(comm, (rows, columns), start, j[first_entries], values)


def from_rows(
    comm: MPI.Comm, sizes: tuple[int, int], start: NDArray, columns: NDArray, values: Floats
) -> PETSc.Mat:
    """Matrix from compressed owned rows and its sizes on this rank; collective."""
    A = PETSc.Mat().createAIJ(
        ((sizes[0], None), (sizes[1], None)),
        csr=(
            start.astype(PETSc.IntType),
            columns.astype(PETSc.IntType),
            values.astype(PETSc.ScalarType),
        ),
        comm=comm,
    )
    A.assemble()
    # Ranks set their owned rows only: no messages about others.
    A.setOption(PETSc.Mat.Option.NO_OFF_PROC_ENTRIES, True)
    return A


def renew(A: PETSc.Mat, B: PETSc.Mat, new_pattern: bool) -> None:
    """Copy the values of B, and optionally its pattern, into A; collective."""
    if new_pattern:
        A.setPreallocationCSR(B.getValuesCSR())
        A.assemble()
    else:
        B.copy(A, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)


def diagonal(comm: MPI.Comm, values: Floats) -> PETSc.Mat:
    """Diagonal matrix of owned values (n,); collective."""
    n = len(values)
    start = comm.exscan(n) or 0  # type: ignore[attr-defined]  # mpi4py's stubs lack it
    return from_rows(comm, (n, n), np.arange(n + 1), start + np.arange(n), values)


def matrix_sum(matrices: Sequence[PETSc.Mat]) -> PETSc.Mat:
    """Sum of matrices that may differ in pattern, as a new one; collective."""
    first_matrix, *other_matrices = matrices
    total = first_matrix.copy()
    for A in other_matrices:
        total.axpy(1.0, A, structure=PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    total.setOption(PETSc.Mat.Option.NO_OFF_PROC_ENTRIES, True)
    return total


def block_diagonal(comm: MPI.Comm, n: int) -> PETSc.Mat:
    """Matrix with a dense 3 x 3 block for each owned point; collective."""
    return from_rows(comm, (3 * n, 3 * n), *_csr(comm, np.ones((n, 3, 3))))


def fill_blocks(A: PETSc.Mat, blocks: Floats) -> None:
    """Set a block diagonal matrix to blocks (n, 3, 3); collective."""
    A.setValuesCSR(*_csr(A.comm.tompi4py(), blocks))
    A.assemble()


def _csr(comm: MPI.Comm, blocks: Floats) -> tuple[NDArray, NDArray, NDArray]:
    n = len(blocks)
    start = comm.exscan(3 * n) or 0  # type: ignore[attr-defined]  # mpi4py's stubs lack it
    columns = start + np.repeat(3 * np.arange(n), 9) + np.tile(np.arange(3), 3 * n)
    return (
        (3 * np.arange(3 * n + 1)).astype(PETSc.IntType),
        columns.astype(PETSc.IntType),
        np.ascontiguousarray(blocks).ravel(),
    )


def diagonal_blocks(matrix: PETSc.Mat, size: int) -> Floats:
    """Blocks on the diagonal of a matrix, of this rank's rows (n, size, size)."""
    row_starts, columns, values = matrix.getDiagonalBlock().getValuesCSR()
    rows = np.repeat(np.arange(len(row_starts) - 1), np.diff(row_starts))
    k = rows // size == columns // size
    blocks = np.zeros(((len(row_starts) - 1) // size, size, size))
    blocks[rows[k] // size, rows[k] % size, columns[k] % size] = values[k]
    return blocks


def owned_rows(A: PETSc.Mat) -> csr_array:
    """Rows of a matrix that this rank has, with all columns."""
    from scipy.sparse import csr_array  # imported late: small cases do not need it

    row_starts, columns, values = A.getValuesCSR()
    return csr_array((values, columns, row_starts), shape=(len(row_starts) - 1, A.getSize()[1]))
