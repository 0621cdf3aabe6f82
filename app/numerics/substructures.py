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
from app.numerics.factor import library
from app.numerics.root_work import blas_threads, cores, wait

# K, C and D, distributed by rows.
Matrices = tuple[PETSc.Mat, PETSc.Mat, PETSc.Mat]


class Substructures:
    """Factors of the interiors on their ranks, and of the shared nodes on rank 0.

    Attributes:
        operations: Floating-point operations of the factors on the rank that has the most.
        entries: Entries of the factors of all ranks.

    Args:
        kept: Nodes of K that are kept, sorted, the same on all ranks.
    """

    def __init__(self, matrices: Matrices, kept: Ints) -> None:
        self.comm = matrices[0].comm.tompi4py()
        self._threads, self._kept = cores(self.comm), kept
        self._pattern: tuple[Ints, ...] | None = None
        self.renew(matrices)

    def renew(self, matrices: Matrices) -> None:
        """Set the matrices; collective. The factors are analysed if the pattern is another."""
        k, c, d = (owned_rows(A) for A in matrices)
        pattern = k.indptr, k.indices, c.indptr, c.indices
        known = self._pattern is not None and all(map(np.array_equal, self._pattern, pattern))
        known = self.comm.allreduce(known, MPI.LAND)
        if not known:
            self._pattern = pattern
            self._divide(k, c, matrices[0].getOwnershipRanges() // 3)
        inside = self._interior(k), self._interior(c)
        if not known:
            self._meet(*inside)
        self._rows = self._interior_rows(*inside)
        self._entries = self._border_entries(k, c, d, matrices[2].getOwnershipRange()[0])
        if not known:
            self._analyse()

    def _divide(self, k: csr_array, c: csr_array, starts: Ints) -> None:
        """Divide the nodes into interiors and the border; ``starts`` are the ranks' first ones."""
        low, high = starts[self.comm.rank : self.comm.rank + 2]
        shared = unknowns_of(_shared_nodes(self.comm, k, starts, self._kept))
        self._shared, kept = len(shared), unknowns_of(self._kept)
        self._first_jump = self._shared + len(kept)
        self._border = self._first_jump + c.shape[1]
        # Place in the border of all unknowns of K, -1 of those inside.
        self._place = np.full(k.shape[1], -1)
        self._place[shared] = np.arange(self._shared)
        self._place[kept] = np.arange(self._shared, self._first_jump)
        owned = self._place[3 * low : 3 * high]
        self._inside, self._outside = np.flatnonzero(owned < 0), np.flatnonzero(owned >= 0)
        self._owned_place = owned[self._outside]
        self._column = np.full(k.shape[1], -1, dtype=np.int32)
        self._column[3 * low + self._inside] = np.arange(len(self._inside))

    def _interior(self, A: csr_array) -> csr_array:
        """The interior's rows of the owned ones; on one rank often all."""
        return A[self._inside] if len(self._outside) else A

    def _meet(self, k: csr_array, c: csr_array) -> None:
        """Find the part of the border that the interior's rows of K and C meet."""
        place = self._place[k.indices]
        met = np.zeros(self._border, dtype=bool)
        met[place[place >= 0]] = True
        met[self._first_jump + c.indices] = True
        self._met = np.flatnonzero(met.reshape(-1, 3).any(axis=1).repeat(3))
        n, outside = len(self._inside), np.flatnonzero(self._place >= 0)
        self._local = np.full(self._border, -1, dtype=np.int32)
        self._local[self._met] = np.arange(len(self._met))
        self._column[outside] = n + self._local[self._place[outside]]

    def _interior_rows(self, k: csr_array, c: csr_array) -> csr_array:
        """The interior's rows; its columns first, then the columns of the border that it meets."""
        n, first = len(self._inside), int(np.searchsorted(self._met, self._first_jump))
        k = csr_array((k.data, self._column[k.indices], k.indptr), shape=(n, n + first))
        columns = self._local[self._first_jump + c.indices] - first
        c = csr_array((c.data, columns, c.indptr), shape=(n, len(self._met) - first))
        return csr_array(hstack([k, c], format="csr"))

    def _border_entries(self, k: csr_array, c: csr_array, d: csr_array, low: int) -> coo_array:
        """Entries of the border's rows and columns: all on rank 0, else owned ones; collective."""
        a, b, e = k[self._outside].tocoo(), c[self._outside].tocoo(), d.tocoo()
        column = self._place[a.col]
        keep = column >= 0
        coupled = self._owned_place[b.row], self._first_jump + b.col
        rows = [self._owned_place[a.row[keep]], *coupled, self._first_jump + low + e.row]
        columns = [column[keep], *coupled[::-1], self._first_jump + e.col]
        data = [a.data[keep], b.data, b.data, e.data]
        arrays = tuple(np.concatenate(v) for v in (rows, columns, data))
        every = self.comm.gather(arrays) or [arrays]
        i, j, values = (np.concatenate(v) for v in zip(*every, strict=True))
        entries = coo_array((values, (i, j)), shape=(self._border, self._border))
        entries.sum_duplicates()
        return entries

    def _analyse(self) -> None:
        kind = library()
        assert kind is not None
        self._factor = kind(self._rows)
        s, last = self._shared, self._border - self._shared
        of_shared = s**3 / 3 + s**2 * last + s * last**2
        self.operations = of_shared + self.comm.allreduce(self._factor.operations, MPI.MAX)
        self.entries = self.comm.allreduce(self._factor.entries) + s * (s / 2 + last)

    def factorize(self) -> Floats | None:
        """Factor the matrices.

        Returns:
            S on rank 0, None elsewhere; collective.

        Raises:
            ArithmeticError: The matrix of an interior is not positive definite.
        """
        comm = self.comm
        part = self._factor.factorize(self._rows)
        del self._rows
        places = comm.gather(self._met)
        wait(comm)
        if places is None:
            comm.Send(part, 0)
            return None
        if len(part) == self._border:
            S = part
        else:
            S = np.zeros((self._border, self._border))
            S[np.ix_(self._met, self._met)] = part
        for rank in range(1, comm.size):
            met = places[rank]
            part = np.empty((len(met), len(met)))
            comm.Recv(part, rank)
            S[np.ix_(met, met)] += part
        entries = self._entries
        S[entries.row, entries.col] += entries.data
        return self._without_shared(S) if self._shared else S

    def _without_shared(self, A: Floats) -> Floats:
        """Eliminate the shared nodes from the matrix of the border (b, b)."""
        s = self._shared
        with blas_threads(self._threads):
            # The transpose of an array in C's order is in Fortran's.
            self._L, bad = lapack.dpotrf(A[:s, :s].T, lower=1)
            if bad:
                raise ArithmeticError(f"LAPACK: pivot {bad} of the shared nodes")
            right = np.asfortranarray(A[:s, s:])
            self._X = blas.dtrsm(1.0, self._L, right, lower=1, overwrite_b=1)
            rest = np.ascontiguousarray(A[s:, s:])
            S = blas.dsyrk(-1.0, self._X, 1.0, rest.T, trans=1, lower=1, overwrite_c=1).T
        return mirror_upper(S)

    def reduce(self, r: Floats) -> Floats | None:
        """Forces on the last unknowns when those before are in equilibrium; collective.

        Args:
            r: Forces on owned rows of K.

        Returns:
            They are :math:`r_l - E^T A^{-1} r` on rank 0, None elsewhere.
        """
        total = np.zeros(self._border)
        total[self._met] = self._factor.reduce(r[self._inside])
        total[self._owned_place] += r[self._outside]
        forces = np.empty_like(total) if self.comm.rank == 0 else None
        self.comm.Reduce(total, forces)
        if forces is None:
            return None
        shared, last = forces[: self._shared], forces[self._shared :]
        if self._shared:
            self._half = blas.dtrsv(self._L, shared, lower=1)
            last = last - self._X.T @ self._half
        return last

    def expand(self, x: Floats | None) -> Floats:
        """Owned unknowns of K under the forces last reduced, by the last ones x; collective.

        Args:
            x: Last unknowns on rank 0, None elsewhere.
        """
        border = np.empty(self._border)
        if x is not None:
            border[self._shared :] = x
            if self._shared:
                left = self._half - self._X @ x
                border[: self._shared] = blas.dtrsv(self._L, left, lower=1, trans=1)
        wait(self.comm)
        self.comm.Bcast(border)
        unknowns = np.empty(len(self._inside) + len(self._outside))
        unknowns[self._inside] = self._factor.expand(border[self._met])
        unknowns[self._outside] = border[self._owned_place]
        return unknowns


def owned_rows(A: PETSc.Mat) -> csr_array:
    """Rows of a matrix that this rank has, with all columns."""
    starts, columns, values = A.getValuesCSR()
    return csr_array((values, columns, starts), shape=(len(starts) - 1, A.getSize()[1]))


def unknowns_of(nodes: Ints) -> Ints:
    """The three unknowns of each node (3 n,)."""
    return (3 * nodes[:, None] + np.arange(3)).ravel()


def _shared_nodes(comm: MPI.Comm, k: csr_array, starts: Ints, kept: Ints) -> Ints:
    """Nodes between the interiors of all ranks, sorted; collective.

    ``k`` are owned rows of K, ``starts`` the first nodes of the ranks and the number of all nodes,
    ``kept`` the nodes that are kept.
    """
    if comm.size == 1:
        return np.zeros(0, dtype=np.int64)
    low, high = starts[comm.rank : comm.rank + 2]
    columns = k.indices // 3
    crossing = (columns < low) | (columns >= high)
    rows = low + np.repeat(np.arange(k.shape[0]) // 3, np.diff(k.indptr))[crossing]
    pairs = np.unique(np.stack([rows, columns[crossing]], axis=1), axis=0)
    # Both ranks have each pair.
    pairs = pairs[(pairs[:, 0] < pairs[:, 1]) & ~np.isin(pairs, kept).any(axis=1)]
    pairs = np.concatenate(comm.allgather(pairs))
    ranks = np.searchsorted(starts, pairs, side="right") - 1
    covers: list[Ints] = [np.zeros(0, dtype=np.int64)]
    for of in np.unique(ranks, axis=0):
        covers.append(vertex_cover(pairs[(ranks == of).all(axis=1)]))
    return np.unique(np.concatenate(covers))


def vertex_cover(pairs: Ints) -> Ints:
    """Smallest set of nodes that contains a node of each pair (n, 2).

    No node is the first of one pair and the second of another. The set follows from a largest
    matching (D. Kőnig, 1931): start at the first nodes that are not matched. Go to second nodes by
    any pair, and back by pairs of the matching. The set consists of the first nodes that are not
    reached, and of the second nodes that are reached.
    """
    (a, i), (b, j) = (np.unique(v, return_inverse=True) for v in pairs.T)
    graph = csr_array((np.ones(len(i), dtype=np.int8), (i, j)), shape=(len(a), len(b)))
    second = maximum_bipartite_matching(graph, perm_type="column")
    first = np.full(len(b), -1)
    first[second[second >= 0]] = np.flatnonzero(second >= 0)
    reached_a, reached_b = second < 0, np.zeros(len(b), dtype=bool)
    front = np.flatnonzero(reached_a)
    while len(front):
        there = np.unique(graph[front].indices)
        there = there[~reached_b[there]]
        reached_b[there] = True
        front = first[there]  # matched: else the matching could grow
        reached_a[front] = True
    return np.concatenate([a[~reached_a], b[reached_b]])
