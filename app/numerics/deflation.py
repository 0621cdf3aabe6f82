r"""Deflation: a preconditioner that solves for a coarse space of motions exactly.

A body that slides on its interfaces, or bends away from them, meets little resistance. A
preconditioner that treats displacement and jumps one after the other hardly reduces such motions:
Krylov methods stall until they have resolved each of them. With Z the motions and A the Jacobian, a
preconditioner M becomes (A-DEF1, Tang et al. 2009, https://doi.org/10.1007/s10915-009-9272-6)

.. math:: Q + M (1 - A Q), \qquad Q = Z (Z^T A Z)^{-1} Z^T.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from app.foundation.arrays import Floats
from app.numerics.sparse import block_diagonal, diagonal, fill, matrix_sum

# Motions with less than this part of the largest stiffness are left to the Krylov method.
NOTHING = 1e-10
# The others are stiffened by this part, as the motions of small boxes may be linearly dependent.
STIFFER = 1e-8
# The free directions of a point have changed if its projector differs by this, its stiffness if it
# differs by this part of the larger one.
DIFFERENT = 0.5
# Part of the points that may change before the motions are updated.
STALE = 0.03


class CoarseSpace:
    """Motions of displacement and jumps that a Jacobian hardly resists: the columns of Z.

    Attributes:
        displacement: The rows of the displacement.
        jump: The rows of the jumps in the free directions of this `version`.
        version: Number of changes; 0 while there are no motions.

    Args:
        jump: The rows of the jumps in all directions.
    """

    def __init__(self, displacement: PETSc.Mat, jump: PETSc.Mat) -> None:
        self.displacement, self._all = displacement, jump
        self._comm, points = jump.comm.tompi4py(), jump.getLocalSize()[0] // 3
        self._known, self._stiffness = np.zeros((points, 3, 3)), np.zeros(points)
        self._free = block_diagonal(self._comm, points)
        self.jump = self._free.matMult(jump)
        self._forces, self._moved = jump.createVecLeft(), jump.createVecLeft()
        self.version = 0

    def update(self, free: Floats, stiffness: Floats) -> None:
        """Set the free directions (as `set_free_directions`) if many points changed; collective.

        A bond that breaks does not change its free directions, but the stiffness (n,) of its point.
        """
        differs = np.abs(free - self._known).max(axis=(1, 2)) > DIFFERENT
        larger = np.maximum(stiffness, self._stiffness)
        differs |= np.abs(stiffness - self._stiffness) > DIFFERENT * larger
        changed, points = self._comm.allreduce(np.array([differs.sum(), len(free)]))
        if changed > STALE * points or (changed and not self.version):
            self.set_free_directions(free)
            self._stiffness = stiffness

    def set_free_directions(self, free: Floats) -> None:
        """Restrict jumps to free directions, by projectors at local points (n, 3, 3)."""
        self.version += 1
        self._known = free
        fill(self._free, free)
        self._free.matMult(self._all, result=self.jump)

    def work(self, u: PETSc.Vec, q: PETSc.Vec, out: PETSc.Vec) -> None:
        """Work of forces on displacement and jumps in each motion: Z^T r."""
        self._free.mult(q, self._forces)
        self._all.multTranspose(self._forces, out)
        self.displacement.multTransposeAdd(u, out, out)

    def moved(self, weights: PETSc.Vec, u: PETSc.Vec, q: PETSc.Vec) -> None:
        """Displacement and jumps of a combination of motions: Z w."""
        self.displacement.mult(weights, u)
        self._all.mult(weights, self._moved)
        self._free.mult(self._moved, q)


class Deflated:
    """Context of a PCPYTHON on matrices of blocks: another preconditioner, deflated.

    Attributes:
        inner: The other preconditioner.

    Args:
        blocks: Names of the blocks, "displacement" and "jump" among them; others are not deflated.
        motions: Returns the motions at the current Jacobian, or None.
    """

    def __init__(
        self, inner: PETSc.PC, blocks: Sequence[str], motions: Callable[[], CoarseSpace | None]
    ) -> None:
        self.inner, self._current = inner, motions
        self._u, self._q = blocks.index("displacement"), blocks.index("jump")
        self._made = 0
        self._motions: CoarseSpace | None = None
        self._moved: PETSc.Vec | None = None

    def setUp(self, pc: PETSc.PC) -> None:
        """Set up for the current Jacobian; collective."""
        self._A = pc.getOperators()[0]
        self.inner.setOperators(self._A)
        self.inner.setUp()
        motions = self._current()
        if motions is None:
            return
        if motions is not self._motions:
            self._motions, self._made = motions, 0
            self._weights = motions.displacement.createVecRight()
            self._part = self._weights.duplicate()
            self._products: dict[str, PETSc.Mat] = defaultdict(PETSc.Mat)
            self._sum: PETSc.Mat | None = None
            self._factors = PETSc.PC().create(self._A.comm)
            self._factors.setType("lu")
            self._factors.setFactorSolverType("mumps")
        if motions.version != self._made:
            self._galerkin(motions)
            self._made = motions.version

    def _galerkin(self, motions: CoarseSpace) -> None:
        A, u, q, made = self._A, self._u, self._q, self._products
        Zu, Zq = motions.displacement, motions.jump
        if self._sum is None:
            Zut, self._Zqt = (Z.transpose(PETSc.Mat()) for Z in (Zu, Zq))
            made["K Zu"] = A.getNestSubMatrix(u, u).matMult(Zu)
            made["uu"] = Zut.matMult(made["K Zu"])
            made["Zu C"] = Zut.matMult(A.getNestSubMatrix(u, q))
        Zq.transpose(self._Zqt)
        A.getNestSubMatrix(q, u).matMult(Zu, result=made["A Zu"])
        A.getNestSubMatrix(q, q).matMult(Zq, result=made["A Zq"])
        made["Zu C"].matMult(Zq, result=made["uq"])
        self._Zqt.matMult(made["A Zu"], result=made["qu"])
        self._Zqt.matMult(made["A Zq"], result=made["qq"])
        parts = [made[name] for name in ("uu", "uq", "qu", "qq")]
        shift = np.abs(sum(P.getDiagonal().array for P in parts))
        comm = A.comm.tompi4py()
        largest = comm.allreduce(shift.max(initial=0.0), MPI.MAX)
        # Motions without stiffness are left out.
        shift = np.where(shift <= NOTHING * largest, largest or 1.0, STIFFER * shift)
        parts.append(diagonal(comm, shift))
        if self._sum is None:
            self._sum = matrix_sum(parts)
        else:
            self._sum.zeroEntries()
            for part in parts:
                self._sum.axpy(1.0, part, structure=PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        self._factors.setOperators(self._sum)
        self._factors.setUp()

    def apply(self, pc: PETSc.PC, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """Solve for the motions, then apply the other preconditioner to the remaining residual."""
        motions = self._motions
        if motions is None or not self._made:
            self.inner.apply(r, z)
            return
        if self._moved is None:
            self._moved, self._rest = r.duplicate(), r.duplicate()
            for block in self._moved.getNestSubVecs():
                block.zeroEntries()
        given, moved = r.getNestSubVecs(), self._moved.getNestSubVecs()
        motions.work(given[self._u], given[self._q], self._part)
        self._factors.apply(self._part, self._weights)
        self._weights.scale(-1.0)
        motions.moved(self._weights, moved[self._u], moved[self._q])
        self._moved.stateIncrease()
        r.copy(self._rest)
        for i, rest in enumerate(self._rest.getNestSubVecs()):
            for j in (self._u, self._q):
                if i == j == self._u:  # the largest block by far
                    self._products["K Zu"].multAdd(self._weights, rest, rest)
                    continue
                block = self._A.getNestSubMatrix(i, j)
                if block:
                    block.multAdd(moved[j], rest, rest)
        self._rest.stateIncrease()
        self.inner.apply(self._rest, z)
        z.axpy(-1.0, self._moved)
