"""Factors of the matrix of heat, kept while they pay off.

From one implicit solve to the next the matrix changes little: not at all in equal time steps, on
the diagonal where something cures. Old factors then precondition the new matrix at the price of
some more Krylov iterations; when these have cost as much as new factors, they are rebuilt.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from app.numerics.preconditioners import FACTORED, configure, on_one_rank

# Number of solves with factors that cost one factorization (measured: 8 to 12 for 7 000 to 30 000).
WORTH = 10
# A change of the diagonal by this part requires new factors: the step has another length.
MOVED = 0.1


class KeptFactors:
    """Context of a PCPYTHON: a direct solver of the matrix of some earlier solve.

    Attributes:
        made: Number of factorizations.
    """

    def __init__(self) -> None:
        self.made = 0
        self._solves = self._applied = 0
        self._seen = self._current = -1

    def setUp(self, pc: PETSc.PC) -> None:
        """Factor the first matrix; collective."""
        if not self.made:
            self._of = pc.getOperators()[1]
            self._pc = PETSc.PC().create(self._of.comm)
            self._pc.setOptionsPrefix(f"mantle_heat_factors_{id(self)}_")
            self._joined = PETSc.Mat() if self._of.getType() == "nest" else self._of
            self._factor()

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Solve with the current factors, or with new ones if due; collective."""
        state = self._of.stateGet()
        moved = False
        if state != self._seen:
            self._seen, moved = state, self._moved()
            self._solves += 1
        if state != self._current and (moved or self._applied - self._solves >= WORTH):
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

    def _moved(self) -> bool:
        diagonal = self._of.getDiagonal()
        diagonal.axpy(-1.0, self._diagonal)
        return float(diagonal.norm(PETSc.NormType.N1)) > MOVED * self._size

    def _factor(self) -> None:
        if self._of.getType() == "nest":
            self._of.convert("aij", out=self._joined)
        self._joined.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self._pc.setReusePreconditioner(False)
        self._pc.setOperators(self._joined)
        if self.made:
            self._pc.setUp()
        else:
            configure(self._pc, on_one_rank(FACTORED, self._of.comm.size))
        self._pc.setReusePreconditioner(True)
        self._diagonal = self._of.getDiagonal()
        self._size = float(self._diagonal.norm(PETSc.NormType.N1))
        self.made += 1
        self._seen = self._current = self._of.stateGet()
        self._solves, self._applied = 1, 0
        if self.made == 1:
            self._x, self._y = self._joined.createVecs()


def _parts(x: PETSc.Vec) -> list[PETSc.Vec]:
    return list(x.getNestSubVecs()) if x.getType() == "nest" else [x]
