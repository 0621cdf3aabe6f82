r"""The Jacobian of an implicit solve of heat, refilled with the same pattern, and its factors.

With A_b = M_b/h + K_b + R_b of each body, the blocks are

.. math:: \sum_b A_b, \qquad C = \sum_b A_b B_b, \qquad C^T,
          \qquad \sum_b B_b^T A_b B_b - W \, ∂q/∂τ.

Rows and columns of given temperatures and jumps are zero but for their diagonal. To the first block
comes the exchange of surfaces with finite sliding, without its part by jumps of nodes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from petsc4py import PETSc

import numpy as np

from app.foundation.arrays import Bools, Floats
from app.heat.temperature_jumps import TemperatureJumps
from app.numerics.preconditioners import FACTORED, configure, on_one_rank
from app.numerics.sparse import matrix_sum, renew

# Number of solves with factors that cost one factorization (measured: 8 to 12 for 7 000 to 30 000).
WORTH = 10
# A change of the diagonal by this part requires new factors: the step has another length.
MOVED = 0.1

SUBSET = PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN
SAME = PETSc.Mat.Structure.SAME_NONZERO_PATTERN


class HeatMatrices:
    """Blocks of the Jacobian.

    Attributes:
        matrix: One block, or two by two with jumps.
        version: Number of changes of the linear parts.

    Args:
        K: Conduction matrix of each body, with its whole diagonal in the pattern.
        jumps: The jumps, if there are any.
        held: Owned nodes whose continuous temperature is given.
    """

    def __init__(self, K: Sequence[PETSc.Mat], jumps: TemperatureJumps | None, held: Bools) -> None:
        self.version = 0
        self._jumps, self._held = jumps, held
        self._bodies = [k.copy() for k in K]
        self._exchange: PETSc.Mat | None = None
        self._A = matrix_sum(self._bodies)
        self._keep_pattern()
        start = self._A.getOwnershipRange()[0]
        self._rows = (start + np.flatnonzero(held)).astype(PETSc.IntType)
        self._diagonal = self._A.createVecLeft()
        self.matrix = [[self._A]]
        if jumps is not None:
            self._C = {b: self._bodies[b].matMult(B) for b, B in jumps.moves.items()}
            self._D = {b: B.transposeMatMult(self._C[b]) for b, B in jumps.moves.items()}
            self._linear = matrix_sum(list(self._C.values())), matrix_sum(list(self._D.values()))
            self._linear[1].setOption(PETSc.Mat.Option.SYMMETRIC, True)
            C, D = (m.copy() for m in self._linear)
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
        renew(self._A, matrix_sum([*self._bodies, exchange]), True)
        self._keep_pattern()

    def fill(self, K: Sequence[PETSc.Mat], added: Floats) -> None:
        """Set the linear parts; collective.

        K is conduction by body, ``added`` capacity and exchange, on diagonals (b, n) [N mm/(s K)].
        """
        self.version += 1
        self._A.zeroEntries()
        for A, k, diagonal in zip(self._bodies, K, added, strict=True):
            k.copy(A, structure=SAME)
            self._diagonal.array[:] = diagonal
            A.setDiagonal(self._diagonal, addv=PETSc.InsertMode.ADD_VALUES)
            self._A.axpy(1.0, A, structure=SUBSET)
        if self._jumps is not None:
            C, D = self._linear
            C.zeroEntries()
            D.zeroEntries()
            for b, B in self._jumps.moves.items():
                self._bodies[b].matMult(B, result=self._C[b])
                B.transposeMatMult(self._C[b], result=self._D[b])
                C.axpy(1.0, self._C[b], structure=SUBSET)
                D.axpy(1.0, self._D[b], structure=SUBSET)
        if self._exchange is not None:
            self._A.axpy(1.0, self._exchange, structure=SUBSET)
        self._A.getDiagonal(self._diagonal)
        self._typical = float(self._diagonal.sum()) / self._diagonal.getSize()
        self._A.zeroRowsColumns(self._rows, diag=self._typical)
        self._A.getDiagonal(self._diagonal)

    def set(self, by_jump: Floats | None, growth: Mapping[int, Floats]) -> None:
        """Complete the Jacobian [N mm/(s K)]; collective.

        Args:
            by_jump: Part of the interfaces in the diagonal of the jumps.
            growth: Derivative by temperature of the heat released at owned nodes, by body.
        """
        if growth:
            new = self._diagonal.copy()
            new.array[:] -= np.where(self._held, 0.0, sum(growth.values()))
            self._A.setDiagonal(new)
        j = self._jumps
        if j is None or by_jump is None:
            return
        (_, C), (Ct, D) = self.matrix
        for linear, full in zip(self._linear, (C, D), strict=True):
            linear.copy(full, structure=SAME)
        for b, released in growth.items():
            if b in j.moves:
                scaled, left = j.moves[b].copy(), j.moves[b].createVecLeft()
                left.array[:] = released
                scaled.diagonalScale(left)
                C.axpy(-1.0, scaled, structure=SUBSET)
                D.axpy(-1.0, j.moves[b].transposeMatMult(scaled), structure=SUBSET)
        free = self.vectors()
        for v, held in zip(free, (self._held, j.held), strict=True):
            v.array[:] = ~held
        diagonal = D.getDiagonal()
        diagonal.array[:] += by_jump
        D.setDiagonal(diagonal)
        diagonal.array[:] = np.where(j.held, self._typical, diagonal.array)
        C.diagonalScale(free[0], free[1])
        D.diagonalScale(free[1], free[1])
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
        made: Number of factorizations.
    """

    def __init__(self) -> None:
        self.made = 0
        # Matrices and applications since the last factorization.
        self._solves = self._applied = 0
        # PETSc's state numbers of the matrix last seen, and of the matrix factored.
        self._seen = self._factored = -1
        self._entries = 0.0

    def setUp(self, pc: PETSc.PC) -> None:
        """Factor the first matrix; collective."""
        if not self.made:
            self._of = pc.getOperators()[1]
            self._factor()

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Solve with the current factors, or with new ones if due; collective.

        New factors are due if the matrix has changed, and its diagonal by more than `MOVED`, or if
        the old factors have cost `WORTH` more applications than there were matrices.
        """
        state = self._of.stateGet()
        far = False
        if state != self._seen:
            self._seen, far = state, self._far()
            self._solves += 1
        if state != self._factored and (far or self._applied - self._solves >= WORTH):
            self._factor()
        self._applied += 1
        self._x.array[:] = np.concatenate([v.array_r for v in _parts(x)])
        self._pc.apply(self._x, self._y)
        begin = 0
        for v in _parts(y):
            v.array[:] = self._y.array_r[begin : begin + v.getLocalSize()]
            begin += v.getLocalSize()
        # A block vector does not notice changes of its blocks, and caches its norm.
        y.stateIncrease()

    def _far(self) -> bool:
        """Return True if the diagonal differs much from that of the factored matrix; collective."""
        diagonal = self._of.getDiagonal()
        diagonal.axpy(-1.0, self._diagonal)
        return float(diagonal.norm(PETSc.NormType.N1)) > MOVED * self._size

    def _factor(self) -> None:
        nest = self._of.getType() == "nest"
        block = self._of.getNestSubMatrix(0, 0) if nest else self._of
        entries = block.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]
        new = entries != self._entries  # the first matrix, or another pattern
        if new:
            self._joined = PETSc.Mat() if nest else self._of
            self._pc = PETSc.PC().create(self._of.comm)
            self._pc.setOptionsPrefix(f"mantle_heat_factors_{id(self)}_")
            self._entries = entries
        if nest:
            self._of.convert("aij", out=self._joined)
        self._joined.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._pc.setReusePreconditioner(False)
        self._pc.setOperators(self._joined)
        if new:
            configure(self._pc, on_one_rank(FACTORED, self._of.comm.size))
        else:
            self._pc.setUp()
        self._pc.setReusePreconditioner(True)
        self._diagonal = self._of.getDiagonal()
        self._size = float(self._diagonal.norm(PETSc.NormType.N1))
        self.made += 1
        self._seen = self._factored = self._of.stateGet()
        self._solves, self._applied = 1, 0
        if self.made == 1:
            self._x, self._y = self._joined.createVecs()


def _parts(x: PETSc.Vec) -> list[PETSc.Vec]:
    return list(x.getNestSubVecs()) if x.getType() == "nest" else [x]
