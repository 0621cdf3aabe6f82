r"""Schur complement of the last unknowns of a symmetric matrix, by substructures on all ranks.

.. math:: \begin{pmatrix} K & C \\ C^T & D \end{pmatrix}

The last unknowns are the columns of C, behind nodes of K that are kept. Each rank eliminates its
interior: its rows of K without kept nodes and without the nodes that ranks share. Each entry of K
between the rows of two ranks has a shared node: these nodes are a smallest vertex cover of such
entries. Rank 0 adds the Schur complements of all ranks and eliminates the shared nodes. One rank
shares none.

The border of the interiors are the shared nodes, the kept ones and the columns of C, in this order.
A node has three unknowns. Method of J. S. Przemieniecki (1963), Matrix structural analysis of
substructures, AIAA Journal 1, 138-147.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from scipy.linalg import blas, lapack
from scipy.sparse import coo_array, csr_array, hstack
from scipy.sparse.csgraph import maximum_bipartite_matching

from app.foundation.arrays import Floats, Ints
from app.numerics.dense import mirror_upper
from app.numerics.factor import factor_class
from app.numerics.root_work import blas_threads, usable_cores, wait
from app.numerics.sparse import owned_rows

# K, C and D, distributed by rows.
Matrices = tuple[PETSc.Mat, PETSc.Mat, PETSc.Mat]


class Substructures:
    """Factors of the interiors on their ranks, and of the shared nodes on rank 0.

    Attributes:
        factor_entries: Entries of the factors of all ranks.

    Args:
        kept_nodes: Nodes of K that are kept, sorted, the same on all ranks.
    """

    def __init__(self, matrices: Matrices, kept_nodes: Ints) -> None:
        self.comm = matrices[0].comm.tompi4py()
        self._threads, self._kept_nodes = usable_cores(self.comm), kept_nodes
        self._pattern: tuple[Ints, ...] | None = None
        self.renew(matrices)

    def renew(self, matrices: Matrices) -> None:
        """Set the matrices; collective. The factors are analysed if the pattern has changed.

        `factorize` follows.
        """
        k, c, d = (owned_rows(A) for A in matrices)
        pattern = k.indptr, k.indices, c.indptr, c.indices
        is_analysed = self._pattern is not None and all(map(np.array_equal, self._pattern, pattern))
        is_analysed = self.comm.allreduce(is_analysed, MPI.LAND)
        if not is_analysed:
            self._pattern = pattern
            self._divide_nodes(k, c, matrices[0].getOwnershipRanges() // 3)
        interior = self._rows_of_interior(k), self._rows_of_interior(c)
        if not is_analysed:
            self._find_touched_border(*interior)
        self._interior_matrix = self._interior_matrix_of(*interior)
        self._border_matrix = self._border_matrix_of(k, c, d, matrices[2].getOwnershipRange()[0])
        if not is_analysed:
            self._analyse()

    def _divide_nodes(self, k: csr_array, c: csr_array, first_nodes: Ints) -> None:
        """Divide the nodes into interiors and the border; the ranks begin at ``first_nodes``."""
        first_node, after_node = first_nodes[self.comm.rank : self.comm.rank + 2]
        shared_unknowns = unknowns_of(_shared_nodes(self.comm, k, first_nodes, self._kept_nodes))
        self._shared_unknowns, kept_unknowns = len(shared_unknowns), unknowns_of(self._kept_nodes)
        self._first_jump = self._shared_unknowns + len(kept_unknowns)
        self._border_size = self._first_jump + c.shape[1]
        # Place in the border of all unknowns of K, -1 of those inside.
        self._place_in_border = np.full(k.shape[1], -1)
        self._place_in_border[shared_unknowns] = np.arange(self._shared_unknowns)
        self._place_in_border[kept_unknowns] = np.arange(self._shared_unknowns, self._first_jump)
        owned = self._place_in_border[3 * first_node : 3 * after_node]
        self._owned_interior, self._owned_border = (
            np.flatnonzero(owned < 0),
            np.flatnonzero(owned >= 0),
        )
        self._border_place_of_owned = owned[self._owned_border]
        self._column_of_unknown = np.full(k.shape[1], -1, dtype=np.int32)
        self._column_of_unknown[3 * first_node + self._owned_interior] = np.arange(
            len(self._owned_interior)
        )

    def _rows_of_interior(self, A: csr_array) -> csr_array:
        """Rows of the interior among owned rows; on one rank these are often all."""
        return A[self._owned_interior] if len(self._owned_border) else A

    def _find_touched_border(self, k: csr_array, c: csr_array) -> None:
        """Find the part of the border that the interior's rows of K and C meet."""
        border_place = self._place_in_border[k.indices]
        is_touched = np.zeros(self._border_size, dtype=bool)
        is_touched[border_place[border_place >= 0]] = True
        is_touched[self._first_jump + c.indices] = True
        self._touched_border = np.flatnonzero(is_touched.reshape(-1, 3).any(axis=1).repeat(3))
        interior_size = len(self._owned_interior)
        outside = np.flatnonzero(self._place_in_border >= 0)
        self._interior_column = np.full(self._border_size, -1, dtype=np.int32)
        self._interior_column[self._touched_border] = np.arange(len(self._touched_border))
        self._column_of_unknown[outside] = (
            interior_size + self._interior_column[self._place_in_border[outside]]
        )

    def _interior_matrix_of(self, k: csr_array, c: csr_array) -> csr_array:
        """Rows of the interior: first its columns, then those of the border that it touches."""
        n = len(self._owned_interior)
        first_jump_column = int(np.searchsorted(self._touched_border, self._first_jump))
        k = csr_array(
            (k.data, self._column_of_unknown[k.indices], k.indptr), shape=(n, n + first_jump_column)
        )
        columns = self._interior_column[self._first_jump + c.indices] - first_jump_column
        c = csr_array(
            (c.data, columns, c.indptr), shape=(n, len(self._touched_border) - first_jump_column)
        )
        return csr_array(hstack([k, c], format="csr"))

    def _border_matrix_of(
        self, k: csr_array, c: csr_array, d: csr_array, first_row: int
    ) -> coo_array:
        """Matrix of the border: of all ranks on rank 0, elsewhere of owned rows; collective."""
        k_entries = k[self._owned_border].tocoo()
        c_entries = c[self._owned_border].tocoo()
        d_entries = d.tocoo()
        column = self._place_in_border[k_entries.col]
        in_border = column >= 0
        coupled = self._border_place_of_owned[c_entries.row], self._first_jump + c_entries.col
        rows = [
            self._border_place_of_owned[k_entries.row[in_border]],
            *coupled,
            self._first_jump + first_row + d_entries.row,
        ]
        columns = [column[in_border], *coupled[::-1], self._first_jump + d_entries.col]
        data = [k_entries.data[in_border], c_entries.data, c_entries.data, d_entries.data]
        arrays = tuple(np.concatenate(v) for v in (rows, columns, data))
        of_all_ranks = self.comm.gather(arrays) or [arrays]
        i, j, values = (np.concatenate(v) for v in zip(*of_all_ranks, strict=True))
        entries = coo_array((values, (i, j)), shape=(self._border_size, self._border_size))
        entries.sum_duplicates()
        return entries

    def _analyse(self) -> None:
        factor_type = factor_class()
        assert factor_type is not None
        self._factor = factor_type(self._interior_matrix)
        s, last_unknowns = self._shared_unknowns, self._border_size - self._shared_unknowns
        self.factor_entries = self.comm.allreduce(self._factor.entries) + s * (
            s / 2 + last_unknowns
        )

    def factorize(self) -> Floats | None:
        """Factor the matrices; collective.

        Call it once after each `renew`: it releases the matrix of the interior.

        Returns:
            Schur complement of the last unknowns on rank 0, None elsewhere.

        Raises:
            ArithmeticError: The matrix of an interior is not positive definite.
        """
        comm = self.comm
        complement = self._factor.factorize(self._interior_matrix)
        del self._interior_matrix
        borders_of_ranks = comm.gather(self._touched_border)
        wait(comm)
        if borders_of_ranks is None:
            comm.Send(complement, 0)
            return None
        if len(complement) == self._border_size:
            S = complement
        else:
            S = np.zeros((self._border_size, self._border_size))
            S[np.ix_(self._touched_border, self._touched_border)] = complement
        for rank in range(1, comm.size):
            touched = borders_of_ranks[rank]
            complement = np.empty((len(touched), len(touched)))
            comm.Recv(complement, rank)
            S[np.ix_(touched, touched)] += complement
        S[self._border_matrix.row, self._border_matrix.col] += self._border_matrix.data
        return self._eliminate_shared(S) if self._shared_unknowns else S

    def _eliminate_shared(self, A: Floats) -> Floats:
        """Eliminate the shared nodes from the matrix of the border (b, b)."""
        s = self._shared_unknowns
        with blas_threads(self._threads):
            # The transpose of an array in C's order is in Fortran's.
            self._shared_factor, failed_pivot = lapack.dpotrf(A[:s, :s].T, lower=1)
            if failed_pivot:
                raise ArithmeticError(f"LAPACK: pivot {failed_pivot} of the shared nodes")
            coupling = np.asfortranarray(A[:s, s:])
            self._shared_coupling = blas.dtrsm(
                1.0, self._shared_factor, coupling, lower=1, overwrite_b=1
            )
            border_block = np.ascontiguousarray(A[s:, s:])
            S = blas.dsyrk(
                -1.0, self._shared_coupling, 1.0, border_block.T, trans=1, lower=1, overwrite_c=1
            ).T
        return mirror_upper(S)

    def reduce(self, r: Floats) -> Floats | None:
        """Forces on the last unknowns when those before are in equilibrium; collective.

        Args:
            r: Forces on owned rows of K.

        Returns:
            They are :math:`r_l - E^T A^{-1} r_e` on rank 0, None elsewhere. A is the matrix of all
            eliminated unknowns: interiors and shared nodes. E is its coupling with the last
            unknowns: kept nodes and the columns of C. The forces on these two are r_e and r_l.
        """
        total = np.zeros(self._border_size)
        total[self._touched_border] = self._factor.reduce(r[self._owned_interior])
        total[self._border_place_of_owned] += r[self._owned_border]
        forces = np.empty_like(total) if self.comm.rank == 0 else None
        self.comm.Reduce(total, forces)
        if forces is None:
            return None
        shared_forces = forces[: self._shared_unknowns]
        last_forces = forces[self._shared_unknowns :]
        if self._shared_unknowns:
            self._shared_forces = blas.dtrsv(self._shared_factor, shared_forces, lower=1)
            last_forces = last_forces - self._shared_coupling.T @ self._shared_forces
        return last_forces

    def expand(self, x: Floats | None) -> Floats:
        """Owned unknowns of K under the forces last reduced, by the last ones x; collective.

        Args:
            x: Last unknowns on rank 0, None elsewhere.
        """
        border = np.empty(self._border_size)
        if x is not None:
            border[self._shared_unknowns :] = x
            if self._shared_unknowns:
                right_side = self._shared_forces - self._shared_coupling @ x
                border[: self._shared_unknowns] = blas.dtrsv(
                    self._shared_factor, right_side, lower=1, trans=1
                )
        wait(self.comm)
        self.comm.Bcast(border)
        unknowns = np.empty(len(self._owned_interior) + len(self._owned_border))
        unknowns[self._owned_interior] = self._factor.expand(border[self._touched_border])
        unknowns[self._owned_border] = border[self._border_place_of_owned]
        return unknowns


def unknowns_of(nodes: Ints) -> Ints:
    """The three unknowns of each node (3 n,)."""
    return (3 * nodes[:, None] + np.arange(3)).ravel()


def _shared_nodes(comm: MPI.Comm, k: csr_array, first_nodes: Ints, kept_nodes: Ints) -> Ints:
    """Nodes between the interiors of all ranks, sorted; collective.

    ``k`` are owned rows of K, ``kept_nodes`` the nodes that are kept. ``first_nodes`` are the first
    nodes of the ranks and the number of all nodes.
    """
    if comm.size == 1:
        return np.zeros(0, dtype=np.int64)
    first_node, end_node = first_nodes[comm.rank : comm.rank + 2]
    columns = k.indices // 3
    crossing = (columns < first_node) | (columns >= end_node)
    rows = first_node + np.repeat(np.arange(k.shape[0]) // 3, np.diff(k.indptr))[crossing]
    pairs = np.unique(np.stack([rows, columns[crossing]], axis=1), axis=0)
    # Both ranks have each pair.
    pairs = pairs[(pairs[:, 0] < pairs[:, 1]) & ~np.isin(pairs, kept_nodes).any(axis=1)]
    pairs = np.concatenate(comm.allgather(pairs))
    ranks = np.searchsorted(first_nodes, pairs, side="right") - 1
    covers: list[Ints] = [np.zeros(0, dtype=np.int64)]
    for rank_pair in np.unique(ranks, axis=0):
        covers.append(vertex_cover(pairs[(ranks == rank_pair).all(axis=1)]))
    return np.unique(np.concatenate(covers))


def vertex_cover(pairs: Ints) -> Ints:
    """Smallest set of nodes that contains a node of each pair (n, 2).

    No node is the first of one pair and the second of another. The set follows from a largest
    matching (D. Kőnig, 1931): start at the first nodes that are not matched. Go to second nodes by
    any pair, and back by pairs of the matching. The set consists of the first nodes that are not
    reached, and of the second nodes that are reached. For example, with the matching 2-5 and 3-6::

        1 --- 5 === 2       From 1 to 5, and back to 2: these three are reached.
        6 === 3 --- 7       The set is 3 (first, not reached) and 5 (second, reached).
    """
    (first_nodes, row_of_pair), (second_nodes, column_of_pair) = (
        np.unique(v, return_inverse=True) for v in pairs.T
    )
    # Rows are first nodes, columns are second nodes.
    graph = csr_array(
        (np.ones(len(row_of_pair), dtype=np.int8), (row_of_pair, column_of_pair)),
        shape=(len(first_nodes), len(second_nodes)),
    )
    column_of_row = maximum_bipartite_matching(graph, perm_type="column")
    row_of_column = np.full(len(second_nodes), -1)
    row_of_column[column_of_row[column_of_row >= 0]] = np.flatnonzero(column_of_row >= 0)
    first_reached, second_reached = column_of_row < 0, np.zeros(len(second_nodes), dtype=bool)
    frontier = np.flatnonzero(first_reached)
    while len(frontier):
        neighbours = np.unique(graph[frontier].indices)
        neighbours = neighbours[~second_reached[neighbours]]
        second_reached[neighbours] = True
        frontier = row_of_column[neighbours]  # matched: else the matching could grow
        first_reached[frontier] = True
    return np.concatenate([first_nodes[~first_reached], second_nodes[second_reached]])
