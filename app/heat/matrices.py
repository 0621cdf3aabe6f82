r"""The Jacobian of an implicit solve of heat, refilled with the same pattern, and its factors.

With A_b = M_b/h + K_b + R_b of each body, the blocks are

.. math:: \sum_b A_b, \qquad C = \sum_b A_b B_b, \qquad C^T,
          \qquad \sum_b B_b^T A_b B_b - W \, ∂q/∂τ.

Rows and columns of prescribed temperatures and jumps are zero except for their diagonal. The first
block also has the exchange of surfaces with finite sliding, without its part by jumps of nodes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from petsc4py import PETSc

import numpy as np

from app.foundation.arrays import Bools, Floats
from app.heat.temperature_jumps import TemperatureJumps
from app.numerics.preconditioners import CHOLESKY, configure, on_one_rank
from app.numerics.sparse import matrix_sum, renew

# Number of solves with factors that cost one factorization (measured: 8 to 12 for 7 000 to 30 000).
REFACTOR_APPLICATIONS = 10
# A change of the diagonal by this part requires new factors: the step has another length.
CHANGED_DIAGONAL = 0.1

SUBSET_PATTERN = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN
SAME_PATTERN = PETSc.Mat.Structure.SAME_NONZERO_PATTERN


class HeatMatrices:
    """Blocks of the Jacobian.

    Attributes:
        matrix: One block, or two by two with jumps.
        version: Number of changes of the linear parts.

    Args:
        K: Conduction matrix of each body, with its whole diagonal in the pattern.
        jumps: The jumps, if there are any.
        is_prescribed: Mask of owned nodes whose continuous temperature is prescribed.
    """

    def __init__(
        self, K: Sequence[PETSc.Mat], jumps: TemperatureJumps | None, is_prescribed: Bools
    ) -> None:
        self.version = 0
        self._jumps = jumps
        self._is_prescribed = is_prescribed
        self._by_body = [k.copy() for k in K]
        self._exchange: PETSc.Mat | None = None
        self._A = matrix_sum(self._by_body)
        self._keep_pattern()
        start = self._A.getOwnershipRange()[0]
        self._prescribed_rows = (start + np.flatnonzero(is_prescribed)).astype(PETSc.IntType)
        self._diagonal = self._A.createVecLeft()
        self.matrix = [[self._A]]
        if jumps is not None:
            self._C = {b: self._by_body[b].matMult(B) for b, B in jumps.jump_to_temperature.items()}
            self._D = {
                b: B.transposeMatMult(self._C[b]) for b, B in jumps.jump_to_temperature.items()
            }
            self._linear_blocks = (
                matrix_sum(list(self._C.values())),
                matrix_sum(list(self._D.values())),
            )
            self._linear_blocks[1].setOption(PETSc.Mat.Option.SYMMETRIC, True)
            C, D = (m.copy() for m in self._linear_blocks)
            self.matrix = [[self._A, C], [C.transpose(PETSc.Mat()), D]]

    def vectors(self) -> list[PETSc.Vec]:
        """A new vector for each block, zero."""
        vectors = [self.matrix[k][k].createVecRight() for k in range(len(self.matrix))]
        for v in vectors:
            v.set(0.0)
        return vectors

    def _keep_pattern(self) -> None:
        self._A.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self._A.setOption(PETSc.Mat.Option.SYMMETRIC, True)

    def set_exchange(self, exchange: PETSc.Mat) -> None:
        """Set the exchange of surfaces with finite sliding, before `fill`; collective."""
        self._exchange = exchange
        renew(self._A, matrix_sum([*self._by_body, exchange]), True)
        self._keep_pattern()

    def fill(self, K: Sequence[PETSc.Mat], added_diagonals: Floats) -> None:
        """Set the linear parts; collective.

        K is conduction by body, ``added_diagonals`` capacity and exchange, on diagonals (b, n) [N
        mm/(s K)].
        """
        self.version += 1
        self._A.zeroEntries()
        for A, k, diagonal in zip(self._by_body, K, added_diagonals, strict=True):
            k.copy(A, structure=SAME_PATTERN)
            self._diagonal.array[:] = diagonal
            A.setDiagonal(self._diagonal, addv=PETSc.InsertMode.ADD_VALUES)
            self._A.axpy(1.0, A, structure=SUBSET_PATTERN)
        if self._jumps is not None:
            C, D = self._linear_blocks
            C.zeroEntries()
            D.zeroEntries()
            for b, B in self._jumps.jump_to_temperature.items():
                self._by_body[b].matMult(B, result=self._C[b])
                B.transposeMatMult(self._C[b], result=self._D[b])
                C.axpy(1.0, self._C[b], structure=SUBSET_PATTERN)
                D.axpy(1.0, self._D[b], structure=SUBSET_PATTERN)
        if self._exchange is not None:
            self._A.axpy(1.0, self._exchange, structure=SUBSET_PATTERN)
        self._A.getDiagonal(self._diagonal)
        self._mean_diagonal = float(self._diagonal.sum()) / self._diagonal.getSize()
        self._A.zeroRowsColumns(self._prescribed_rows, diag=self._mean_diagonal)
        self._A.getDiagonal(self._diagonal)

    def set(self, by_jump: Floats | None, heat_by_temperature: Mapping[int, Floats]) -> None:
        """Complete the Jacobian [N mm/(s K)]; collective.

        Args:
            by_jump: Part of the interfaces in the diagonal of the jumps.
            heat_by_temperature: Derivative by temperature of the heat released at owned nodes, by
                body.
        """
        if heat_by_temperature:
            diagonal_of_temperature = self._diagonal.copy()
            diagonal_of_temperature.array[:] -= np.where(
                self._is_prescribed, 0.0, sum(heat_by_temperature.values())
            )
            self._A.setDiagonal(diagonal_of_temperature)
        jumps = self._jumps
        if jumps is None or by_jump is None:
            return
        (_, C), (Ct, D) = self.matrix
        for linear, block in zip(self._linear_blocks, (C, D), strict=True):
            linear.copy(block, structure=SAME_PATTERN)
        for b, released in heat_by_temperature.items():
            if b in jumps.jump_to_temperature:
                scaled, node_factors = (
                    jumps.jump_to_temperature[b].copy(),
                    jumps.jump_to_temperature[b].createVecLeft(),
                )
                node_factors.array[:] = released
                scaled.diagonalScale(node_factors)
                C.axpy(-1.0, scaled, structure=SUBSET_PATTERN)
                D.axpy(
                    -1.0,
                    jumps.jump_to_temperature[b].transposeMatMult(scaled),
                    structure=SUBSET_PATTERN,
                )
        is_free = self.vectors()
        is_free[0].array[:] = ~self._is_prescribed
        is_free[1].array[:] = ~jumps.prescribed
        diagonal = D.getDiagonal()
        diagonal.array[:] += by_jump
        D.setDiagonal(diagonal)
        diagonal.array[:] = np.where(jumps.prescribed, self._mean_diagonal, diagonal.array)
        C.diagonalScale(is_free[0], is_free[1])
        D.diagonalScale(is_free[1], is_free[1])
        D.setDiagonal(diagonal)
        C.transpose(Ct)

    def diagonal(self) -> list[Floats]:
        """Diagonals of the diagonal blocks as last set."""
        return [self.matrix[k][k].getDiagonal().array.copy() for k in range(len(self.matrix))]


class KeptFactors:
    """Context of a PCPYTHON: factors of the matrix of some earlier solve, while they pay off.

    From one implicit solve to the next the matrix changes little: not at all in equal time steps,
    and on the diagonal where something cures. Old factors then precondition the new matrix, with
    some more Krylov iterations. The factors are rebuilt when these have cost as much.

    Attributes:
        factorizations: Number of factorizations.
    """

    def __init__(self) -> None:
        self.factorizations = 0
        # Matrices and applications since the last factorization.
        self._solves = self._applications = 0
        # PETSc's state numbers of the matrix last seen, and of the matrix factored; -1 before.
        self._seen_state = self._factored_state = -1
        self._entries = 0.0

    def setUp(self, pc: PETSc.PC) -> None:
        """Factor the first matrix; collective."""
        if self._factored_state < 0:
            self._matrix = pc.getOperators()[1]
            self._factor()
            self._x, self._y = self._single_matrix.createVecs()

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Solve with the current factors, or with new ones if due; collective.

        New factors are due if the matrix has changed, and its diagonal by more than
        `CHANGED_DIAGONAL`, or if the old factors have cost `REFACTOR_APPLICATIONS` more
        applications than there were matrices.
        """
        state = self._matrix.stateGet()
        has_changed = False
        if state != self._seen_state:
            self._seen_state, has_changed = state, self._has_changed_much()
            self._solves += 1
        if state != self._factored_state and (
            has_changed or self._applications - self._solves >= REFACTOR_APPLICATIONS
        ):
            self._factor()
        self._applications += 1
        self._x.array[:] = np.concatenate([v.array_r for v in _subvectors(x)])
        self._pc.apply(self._x, self._y)
        first_row = 0
        for v in _subvectors(y):
            v.array[:] = self._y.array_r[first_row : first_row + v.getLocalSize()]
            first_row += v.getLocalSize()
        # A block vector does not notice changes of its blocks, and caches its norm.
        y.stateIncrease()

    def _has_changed_much(self) -> bool:
        """Return True if the diagonal differs much from that of the factored matrix; collective."""
        diagonal = self._matrix.getDiagonal()
        diagonal.axpy(-1.0, self._diagonal)
        return float(diagonal.norm(PETSc.NormType.N1)) > CHANGED_DIAGONAL * self._size

    def _factor(self) -> None:
        nest = self._matrix.getType() == "nest"
        block = self._matrix.getNestSubMatrix(0, 0) if nest else self._matrix
        entries = block.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]
        has_new_pattern = entries != self._entries  # the first matrix, or another pattern
        if has_new_pattern:
            self._single_matrix = PETSc.Mat() if nest else self._matrix
            self._pc = PETSc.PC().create(self._matrix.comm)
            self._pc.setOptionsPrefix(f"mantle_heat_factors_{id(self)}_")
            self._entries = entries
        if nest:
            self._matrix.convert("aij", out=self._single_matrix)
        self._single_matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._pc.setReusePreconditioner(False)
        self._pc.setOperators(self._single_matrix)
        if has_new_pattern:
            configure(self._pc, on_one_rank(CHOLESKY, self._matrix.comm.size))
        else:
            self._pc.setUp()
        self._pc.setReusePreconditioner(True)
        self._diagonal = self._matrix.getDiagonal()
        self._size = float(self._diagonal.norm(PETSc.NormType.N1))
        self.factorizations += 1
        self._seen_state = self._factored_state = self._matrix.stateGet()
        self._solves, self._applications = 1, 0


def _subvectors(x: PETSc.Vec) -> list[PETSc.Vec]:
    return list(x.getNestSubVecs()) if x.getType() == "nest" else [x]
