"""Rows of constrained unknowns: prescribed values, reactions."""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np

from app.arrays import Floats
from app.mechanics.constraints import Constraints
from app.mechanics.contact import ContactInterfaces


class ConstrainedRows:
    """The rows of the stiffness that the supports of a stage constrain.

    Attributes:
        rows: Their global numbers, on this rank.
        typical: Mean diagonal of the stiffness, set in constrained rows to keep scales alike.
    """

    def __init__(self, K: PETSc.Mat, constraints: Constraints) -> None:
        first, _ = K.getOwnershipRange()
        self.rows = (first + np.flatnonzero(constraints.constrained)).astype(np.int32)
        self._unit = constraints.unit
        self._lifts = [_lift(K, unit) for unit in self._unit]
        self._index = PETSc.IS().createGeneral(self.rows, comm=K.comm)
        self._by_displacement = K.createSubMatrix(self._index)
        self._by_jumps: PETSc.Mat | None = None
        diagonal = K.getDiagonal()
        self.typical = float(diagonal.sum()) / diagonal.getSize()
        K.zeroRowsColumns(self.rows, diag=self.typical)

    def couple(self, contact: ContactInterfaces | None) -> None:
        """Add the reactions to jumps, from the coupling."""
        if contact:
            self._by_jumps = contact.coupling.C.createSubMatrix(self._index)

    def move(self, f: PETSc.Vec, amplitudes: Sequence[float]) -> Floats:
        """Prescribed displacements at amplitudes (n,); their forces are added to f [N]."""
        given = np.zeros(len(f.array_r))
        for a, unit, lift in zip(amplitudes, self._unit, self._lifts, strict=True):
            given += a * unit
            f.axpy(a, lift)
        return given

    def forces(self, u: PETSc.Vec, q: PETSc.Vec | None) -> PETSc.Vec:
        """Reactions of the supports in a state, without loads [N]."""
        found = self._by_displacement.createVecLeft()
        self._by_displacement.mult(u, found)
        if self._by_jumps is not None:
            self._by_jumps.multAdd(q, found, found)
        return found


def _lift(K: PETSc.Mat, unit: Floats) -> PETSc.Vec:
    """Minus the forces of a support's displacements at full amplitude."""
    given, forces = K.createVecRight(), K.createVecLeft()
    given.array[:] = unit
    K.mult(given, forces)
    forces.scale(-1)
    return forces
