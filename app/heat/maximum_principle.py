r"""Discrete maximum principle: correct conduction that violates it, on any mesh.

On tetrahedra with obtuse dihedral angles conduction has positive off-diagonal entries
:math:`k_{ij}`. Heat then flows from cold to warm along those edges, and in short steps temperatures
leave the extremes of the data. At such nodes the edges are removed by a diffusion

.. math:: k_{ij} (e_i - e_j)(e_i - e_j)^T,

which is symmetric, conserves heat and leaves a constant temperature unchanged (Kuzmin and Turek,
doi:10.1006/jcph.2001.6955, there for all edges). Without its edges the backward Euler value of a
node is between the values around it and before.
"""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from app.foundation.arrays import Bools, Floats
from app.numerics.sparse import from_rows

# Distances from a bound, as fractions of the range of the data, that count as outside and as near.
OUTSIDE_TOLERANCE = 1e-9
NEAR_BOUND = 1e-5
# Entries of a matrix and heat into nodes below this fraction of the largest are rounding.
ROUNDING_OF_ENTRIES = 1e-12
# Least span [K]: temperatures are no better than their rounding.
SMALLEST_SPAN = 1.0
SUBSET_PATTERN = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN


class MaximumPrinciple:
    """Conduction matrices of bodies, corrected where temperatures leave the extremes of the data.

    The data are all initial, given and surrounding temperatures so far. After any heating (a
    source, a flux, cure, friction) they have no upper bound, after any cooling no lower one.

    Attributes:
        matrices: The corrected matrices.
        version: Number of changes of them.

    Args:
        K: Conduction matrix of each body, with its whole diagonal in the pattern.
        capacity: Capacity of owned nodes in each body, zero where it has none (b, n).
        data: Initial and surrounding temperatures [K].
        heated: True if cure or friction heats.
    """

    saved = ("flagged", "data_low", "data_high", "heated", "cooled")

    def __init__(
        self, K: Sequence[PETSc.Mat], capacity: Floats, data: Sequence[float], heated: bool
    ) -> None:
        self._comm, self._K, self._has_capacity = K[0].comm.tompi4py(), list(K), capacity > 0
        self._edges = [_positive_entries(self._comm, k) for k in K]
        self._edge_sums = np.array([p.getRowSum().array for p in self._edges])
        self.flagged = list(np.zeros(capacity.shape, dtype=bool))
        self.data_low, self.data_high = min(data), max(data)
        self.heated, self.cooled = heated, False
        self.matrices, self.version = list(K), 0

    @property
    def low(self) -> float:
        """Least temperature of the data [K], or minus infinity if something may cool below it."""
        return -np.inf if self.cooled else self.data_low

    @property
    def high(self) -> float:
        """Largest temperature of the data [K], or infinity if something may heat above it."""
        return np.inf if self.heated else self.data_high

    def include_data(self, given: Floats, heats: Floats) -> None:
        """Include prescribed temperatures [K] and heat into owned nodes [N mm/s]; collective."""
        extremes = [-given.min(initial=np.inf), given.max(initial=-np.inf)]
        extremes += [-heats.min(initial=0.0), heats.max(initial=0.0)]
        global_extremes = np.array(extremes)
        self._comm.Allreduce(MPI.IN_PLACE, global_extremes, MPI.MAX)
        below, above, cooling, heating = map(float, global_extremes)
        self.data_low, self.data_high = min(self.data_low, -below), max(self.data_high, above)
        self.cooled = self.cooled or cooling > ROUNDING_OF_ENTRIES * heating
        self.heated = self.heated or heating > ROUNDING_OF_ENTRIES * cooling

    def is_violated(self, T: Floats) -> bool:
        """Return True if a temperature of a body (b, n) [K] is out of bounds; collective."""
        return bool(self._comm.allreduce(bool(self._is_out_of_bounds(T).any()), MPI.LOR))

    def correct(self, T: Floats) -> bool:
        """Remove edges of nodes at T [K] out of bounds; False if none are left; collective."""
        return self._set_flags(
            np.array(self.flagged) | (self._is_out_of_bounds(T) & (self._edge_sums > 0))
        )

    def restore_edges(self, T: Floats) -> None:
        """Restore the edges of nodes no longer near their bounds; collective."""
        is_near = np.minimum(T - self.low, self.high - T) <= NEAR_BOUND * self._temperature_range(T)
        self._set_flags(np.array(self.flagged) & is_near)

    def restored(self) -> None:
        """Remove the edges of restored flagged nodes; collective."""
        flagged = np.array(self.flagged)
        self.flagged = list(np.zeros_like(flagged))
        self._set_flags(flagged)

    def _temperature_range(self, T: Floats) -> float:
        """Range of data and current temperatures [K]; collective."""
        present_temperatures = T[self._has_capacity]
        extremes = np.array(
            [
                -present_temperatures.min(initial=self.data_low),
                present_temperatures.max(initial=self.data_high),
            ]
        )
        self._comm.Allreduce(MPI.IN_PLACE, extremes, MPI.MAX)
        return max(float(extremes.sum()), SMALLEST_SPAN)

    def _is_out_of_bounds(self, T: Floats) -> Bools:
        tolerance = OUTSIDE_TOLERANCE * self._temperature_range(T)
        return self._has_capacity & ((T < self.low - tolerance) | (T > self.high + tolerance))

    def _set_flags(self, flagged: Bools) -> bool:
        """Set the flags (b, n); return whether any matrix changed."""
        differs = (flagged != np.array(self.flagged)).any(axis=1)
        changed_rows = np.flatnonzero(self._comm.allreduce(differs.astype(int), MPI.SUM))
        self.flagged = list(flagged)
        for b in map(int, changed_rows):
            self.matrices[b] = self._corrected_matrix(b)
        self.version += len(changed_rows) > 0
        return len(changed_rows) > 0

    def _corrected_matrix(self, b: int) -> PETSc.Mat:
        """The matrix of a body without the positive edges of its flagged nodes."""
        kept_edges = self._edges[b].copy()
        unflagged = kept_edges.createVecLeft()
        unflagged.array[:] = ~self.flagged[b]
        kept_edges.diagonalScale(unflagged, unflagged)
        K = self._K[b].copy()
        K.axpy(-1.0, self._edges[b], structure=SUBSET_PATTERN)
        K.axpy(1.0, kept_edges, structure=SUBSET_PATTERN)
        unflagged.array[:] = self._edge_sums[b] - kept_edges.getRowSum().array
        K.setDiagonal(unflagged, addv=PETSc.InsertMode.ADD_VALUES)
        return K


def _positive_entries(comm: MPI.Comm, K: PETSc.Mat) -> PETSc.Mat:
    first_owned, after_owned = K.getOwnershipRange()
    start, columns, values = K.getValuesCSR()
    row = first_owned + np.repeat(np.arange(after_owned - first_owned), np.diff(start))
    largest = comm.allreduce(float(np.abs(values).max(initial=0.0)), MPI.MAX)
    edge = (values > ROUNDING_OF_ENTRIES * largest) & (columns != row)
    count = np.bincount(row[edge] - first_owned, minlength=after_owned - first_owned)
    pointer = np.concatenate([[0], np.cumsum(count)])
    sizes = (after_owned - first_owned, after_owned - first_owned)
    return from_rows(comm, sizes, pointer, columns[edge], values[edge])
