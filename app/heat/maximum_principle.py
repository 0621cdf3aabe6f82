r"""Discrete maximum principle: correct conduction that violates it, on any mesh.

On tetrahedra with obtuse dihedral angles conduction has positive off-diagonal entries
:math:`k_{ij}`: heat flows from cold to warm along those edges, and in short steps temperatures
leave the extremes of the data. Where a solution does, the edges of its nodes are removed by a
diffusion

.. math:: k_{ij} (e_i - e_j)(e_i - e_j)^T,

which is symmetric, conserves heat and leaves a constant temperature unchanged (Kuzmin and Turek,
doi:10.1006/jcph.2001.6955, there for all edges). With all edges of a node removed its backward
Euler value lies between those around and before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from app.arrays import Bools, Floats
from app.numerics.sparse import from_rows

# Distances from a bound, in parts of the range of the data, that count as outside and as near.
OUTSIDE = 1e-9
NEAR = 1e-5
# Entries of a matrix and heat into nodes below this part of the largest are rounding.
ZERO = 1e-12
# Least span [K]: temperatures are no better than their rounding.
LEAST = 1.0
SUBSET = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN


@dataclass(frozen=True)
class Bounds:
    """Bounds of temperatures [K].

    Attributes:
        low: Least temperature of the data, or minus infinity if something may cool below it.
        high: Largest, or infinity if something may heat above it.
        span: Range of the current temperatures.
    """

    low: float
    high: float
    span: float


class Extremes:
    """Extremes of all data so far: initial, given and surrounding temperatures.

    After any heating (a source, a flux, cure, friction) there is no upper bound, after any cooling
    no lower one.
    """

    saved = ("_low", "_high", "_heated", "_cooled")

    def __init__(self, comm: MPI.Comm, low: float, high: float, heated: bool) -> None:
        self._comm = comm
        self._low, self._high = low, high
        self._heated, self._cooled = heated, False

    def see(self, low: float, high: float, least: float, most: float) -> None:
        """Include given temperatures [K] and heat into nodes [N mm/s] of this rank; collective."""
        every = np.array(self._comm.allgather((low, high, least, most)))
        self._low = min(self._low, float(every[:, 0].min()))
        self._high = max(self._high, float(every[:, 1].max()))
        least, most = float(every[:, 2].min()), float(every[:, 3].max())
        self._cooled = self._cooled or least < -ZERO * most
        self._heated = self._heated or most > -ZERO * least

    def bounds(self, temperatures: Floats) -> Bounds:
        """Bounds of temperatures, given some of this rank [K]; collective."""
        local = temperatures.min(initial=np.inf), temperatures.max(initial=-np.inf)
        every = np.array(self._comm.allgather(local))
        span = max(self._high, float(every[:, 1].max())) - min(self._low, float(every[:, 0].min()))
        return Bounds(
            -np.inf if self._cooled else self._low, np.inf if self._heated else self._high, span
        )


class MaximumPrinciple:
    """Conduction matrices of bodies, corrected where necessary.

    Attributes:
        matrices: The corrected matrices.

    Args:
        K: Conduction matrix of each body, with its whole diagonal in the pattern.
        capacity: Capacity of own nodes in each body, zero where it has none.
    """

    saved = ("_flagged",)

    def __init__(self, comm: MPI.Comm, K: Sequence[PETSc.Mat], capacity: Sequence[Floats]) -> None:
        self._comm, self._K = comm, list(K)
        self._present = [c > 0 for c in capacity]
        self._edges = [_positive(comm, k) for k in K]
        self._degree = [_row_sums(p) for p in self._edges]
        self._flagged: list[Bools] = [np.zeros(len(c), dtype=bool) for c in capacity]
        self.matrices = list(K)

    def outside(self, T: Sequence[Floats], bounds: Bounds) -> bool:
        """Whether any temperature of a body is out of bounds; collective."""
        here = any(bool(o.any()) for o in self._offending(T, bounds))
        return bool(self._comm.allreduce(here, MPI.LOR))

    def correct(self, T: Sequence[Floats], bounds: Bounds) -> bool:
        """Remove edges of nodes at T [K] out of bounds; False if none are left; collective."""
        offending = self._offending(T, bounds)
        return self._flag(
            [
                f | (o & (d > 0))
                for f, o, d in zip(self._flagged, offending, self._degree, strict=True)
            ]
        )

    def take_back(self, T: Sequence[Floats], bounds: Bounds) -> bool:
        """Restore the edges of nodes no longer near their bounds; whether any; collective."""
        near = NEAR * max(bounds.span, LEAST)
        return self._flag(
            [
                f & (np.minimum(t - bounds.low, bounds.high - t) <= near)
                for f, t in zip(self._flagged, T, strict=True)
            ]
        )

    def restored(self) -> None:
        """Remove the edges of restored flagged nodes; collective."""
        flagged, self._flagged = self._flagged, [np.zeros_like(f) for f in self._flagged]
        self._flag(flagged)

    @property
    def flagged(self) -> int:
        """Number of nodes whose edges are removed; collective."""
        return int(self._comm.allreduce(sum(int(f.sum()) for f in self._flagged), MPI.SUM))

    def _offending(self, T: Sequence[Floats], bounds: Bounds) -> list[Bools]:
        slack = OUTSIDE * max(bounds.span, LEAST)
        return [
            here & ((t < bounds.low - slack) | (t > bounds.high + slack))
            for t, here in zip(T, self._present, strict=True)
        ]

    def _flag(self, flagged: list[Bools]) -> bool:
        """Set the flags; return whether any matrix changed."""
        changed = self._comm.allreduce(
            np.array([int((a != b).any()) for a, b in zip(flagged, self._flagged, strict=True)]),
            MPI.SUM,
        )
        self._flagged = flagged
        for b in np.flatnonzero(changed):
            self.matrices[b] = self._corrected(int(b))
        return bool(np.any(changed))

    def _corrected(self, b: int) -> PETSc.Mat:
        """The matrix of a body without the positive edges of its flagged nodes."""
        kept = self._edges[b].copy()
        clear = kept.createVecLeft()
        clear.array[:] = ~self._flagged[b]
        kept.diagonalScale(clear, clear)
        K = self._K[b].copy()
        K.axpy(-1.0, self._edges[b], structure=SUBSET)
        K.axpy(1.0, kept, structure=SUBSET)
        clear.array[:] = self._degree[b] - _row_sums(kept)
        K.setDiagonal(clear, addv=PETSc.InsertMode.ADD_VALUES)
        return K


def _positive(comm: MPI.Comm, K: PETSc.Mat) -> PETSc.Mat:
    begin, end = K.getOwnershipRange()
    start, columns, values = K.getValuesCSR()
    row = begin + np.repeat(np.arange(end - begin), np.diff(start))
    largest = comm.allreduce(float(np.abs(values).max(initial=0.0)), MPI.MAX)
    edge = (values > ZERO * largest) & (columns != row)
    count = np.bincount(row[edge] - begin, minlength=end - begin)
    pointer = np.concatenate([[0], np.cumsum(count)])
    sizes = (end - begin, end - begin)
    return from_rows(comm, sizes, pointer, columns[edge], values[edge])


def _row_sums(A: PETSc.Mat) -> Floats:
    one, sums = A.createVecRight(), A.createVecLeft()
    one.set(1.0)
    A.mult(one, sums)
    return np.asarray(sums.array.copy())
