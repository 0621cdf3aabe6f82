"""Stiffness between the jumps of contact and the displacement."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
from dolfinx import fem

from app.foundation.arrays import Bools, Floats, Ints
from app.interfaces.corners import Entries
from app.mechanics.body_forms import BodyForms, assemble_form_matrix
from app.mechanics.constraints import Constraints
from app.numerics.sparse import diagonal_blocks, from_triplets, matrix_sum, renew


class JumpCoupling:
    """Stiffness between jumps and displacement, reassembled when the stiffness changes.

    Attributes:
        jump_to_displacement: Matrices from jumps to displacements, by body.
        C: Forces on the displacement by jumps.
        D: Forces on jumps by jumps.
        Ct: The transpose of C.

    Args:
        entries: Displacement of each body by all jumps.
        number: Number of each contact point in the order of the ranks.
        owned: Number of contact points of this rank.
    """

    def __init__(
        self,
        body_forms: BodyForms,
        constraints: Constraints,
        entries: Entries,
        number: Ints,
        owned: int,
    ) -> None:
        comm, index_map = body_forms.mesh.comm, body_forms.space.dofmap.index_map
        start, end = (3 * k for k in index_map.local_range)
        self.jump_to_displacement: dict[int, PETSc.Mat] = {}
        self._strips: dict[int, fem.Form] = {}
        for body in map(int, np.unique(entries.body)):
            of_body = entries.body == body
            row = entries.row[of_body]
            column = entries.column[of_body]
            value = entries.value[of_body]
            column = 3 * number[column // 3] + column % 3
            local = (row >= start) & (row < end)
            self.jump_to_displacement[body] = from_triplets(
                comm, end - start, 3 * owned, row[local] - start, column[local], value[local]
            )
            touched_nodes: Bools = np.isin(
                np.concatenate([np.arange(start // 3, end // 3), index_map.ghosts]),
                np.unique(row // 3),
            )
            self._strips[body] = body_forms.strip_stiffness(body, touched_nodes)
        self._KB: dict[int, PETSc.Mat] = {}
        self.C, self.D, self.Ct = self._assemble(constraints)
        self._work = self.Ct.createVecLeft()

    def _assemble(
        self, constraints: Constraints, paired: bool = False
    ) -> tuple[PETSc.Mat, PETSc.Mat, PETSc.Mat]:
        moves, KB = self.jump_to_displacement, self._KB
        if not paired:
            for b, B in moves.items():
                KB[b] = assemble_form_matrix(self._strips[b]).matMult(B)
        C = constraints.rows(matrix_sum(list(KB.values())))
        D = matrix_sum([B.transposeMatMult(KB[b]) for b, B in moves.items()])
        return C, D, C.copy().transpose()

    def update(self, constraints: Constraints, paired: bool = False) -> None:
        """Reassemble, in the same matrices, for changed stiffness, supports, or pairs alone."""
        new_coupling = self._assemble(constraints, paired)
        for matrix, values in zip((self.C, self.D, self.Ct), new_coupling, strict=True):
            renew(matrix, values, constraints.follows)

    def equilibrium(self, u: PETSc.Vec, q: PETSc.Vec, f_q: Floats) -> Floats:
        """Equilibrium e = C^T u + D q - f_q at local points (n, 3) [N]; -e is the force W F."""
        self.Ct.mult(u, self._work)
        self.D.multAdd(q, self._work, self._work)
        return self._work.array.reshape(-1, 3) - f_q.reshape(-1, 3)

    def jump_stiffness(self) -> Floats:
        """Stiffness of the jump of each local point with all else held (n, 3, 3) [N/mm]."""
        return diagonal_blocks(self.D, 3)
