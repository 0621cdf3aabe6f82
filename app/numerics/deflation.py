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
from app.numerics.sparse import block_diagonal, diagonal, fill_blocks, matrix_sum

# Motions with less than this fraction of the largest stiffness are left to the Krylov method.
ZERO_STIFFNESS = 1e-10
# The others are stiffened by this part, as the motions of small boxes may be linearly dependent.
DIAGONAL_SHIFT = 1e-8
# The free directions of a point have changed if its projector differs by this, its stiffness if it
# differs by this fraction of the larger one.
CHANGED_POINT = 0.5
# Fraction of the points that may change before the motions are updated.
CHANGED_SHARE = 0.03


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
        self.displacement, self._all_jumps = displacement, jump
        self._comm, points = jump.comm.tompi4py(), jump.getLocalSize()[0] // 3
        self._free_directions, self._stiffness = np.zeros((points, 3, 3)), np.zeros(points)
        self._projector = block_diagonal(self._comm, points)
        self.jump = self._projector.matMult(jump)
        self._forces, self._all_jump_motion = jump.createVecLeft(), jump.createVecLeft()
        self.version = 0

    def update(self, free_projectors: Floats, stiffness: Floats) -> None:
        """Set the free directions (as `set_free_directions`) if many points changed; collective.

        A bond that breaks does not change its free directions, but the stiffness (n,) of its point.
        """
        differs = np.abs(free_projectors - self._free_directions).max(axis=(1, 2)) > CHANGED_POINT
        larger = np.maximum(stiffness, self._stiffness)
        differs |= np.abs(stiffness - self._stiffness) > CHANGED_POINT * larger
        changed_points, points = self._comm.allreduce(
            np.array([differs.sum(), len(free_projectors)])
        )
        if changed_points > CHANGED_SHARE * points or (changed_points and not self.version):
            self.set_free_directions(free_projectors)
            self._stiffness = stiffness

    def set_free_directions(self, free_projectors: Floats) -> None:
        """Restrict jumps to free directions, by projectors at local points (n, 3, 3)."""
        self.version += 1
        self._free_directions = free_projectors
        fill_blocks(self._projector, free_projectors)
        self._projector.matMult(self._all_jumps, result=self.jump)

    def work(self, u: PETSc.Vec, q: PETSc.Vec, work_of_motions: PETSc.Vec) -> None:
        """Work of forces on displacement and jumps in each motion: Z^T r."""
        self._projector.mult(q, self._forces)
        self._all_jumps.multTranspose(self._forces, work_of_motions)
        self.displacement.multTransposeAdd(u, work_of_motions, work_of_motions)

    def combine(self, weights: PETSc.Vec, u: PETSc.Vec, q: PETSc.Vec) -> None:
        """Displacement and jumps of a combination of motions: Z w."""
        self.displacement.mult(weights, u)
        self._all_jumps.mult(weights, self._all_jump_motion)
        self._projector.mult(self._all_jump_motion, q)


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
        self.inner, self._current_motions = inner, motions
        self._displacement_block, self._jump_block = (
            blocks.index("displacement"),
            blocks.index("jump"),
        )
        self._version = 0
        self._motions: CoarseSpace | None = None
        self._coarse_solution: PETSc.Vec | None = None

    def setUp(self, pc: PETSc.PC) -> None:
        """Set up for the current Jacobian; collective."""
        self._A = pc.getOperators()[0]
        self.inner.setOperators(self._A)
        self.inner.setUp()
        motions = self._current_motions()
        if motions is None:
            return
        if motions is not self._motions:
            self._motions, self._version = motions, 0
            self._weights = motions.displacement.createVecRight()
            self._work = self._weights.duplicate()
            self._products: dict[str, PETSc.Mat] = defaultdict(PETSc.Mat)
            self._coarse_matrix: PETSc.Mat | None = None
            self._coarse_factors = PETSc.PC().create(self._A.comm)
            self._coarse_factors.setType("lu")
            self._coarse_factors.setFactorSolverType("mumps")
        if motions.version != self._version:
            self._assemble_coarse_matrix(motions)
            self._version = motions.version

    def _assemble_coarse_matrix(self, motions: CoarseSpace) -> None:
        A, u, q, products = self._A, self._displacement_block, self._jump_block, self._products
        Zu, Zq = motions.displacement, motions.jump
        if self._coarse_matrix is None:
            Zut, self._Zqt = (Z.transpose(PETSc.Mat()) for Z in (Zu, Zq))
            products["K Zu"] = A.getNestSubMatrix(u, u).matMult(Zu)
            products["uu"] = Zut.matMult(products["K Zu"])
            products["Zu C"] = Zut.matMult(A.getNestSubMatrix(u, q))
        Zq.transpose(self._Zqt)
        A.getNestSubMatrix(q, u).matMult(Zu, result=products["A Zu"])
        A.getNestSubMatrix(q, q).matMult(Zq, result=products["A Zq"])
        products["Zu C"].matMult(Zq, result=products["uq"])
        self._Zqt.matMult(products["A Zu"], result=products["qu"])
        self._Zqt.matMult(products["A Zq"], result=products["qq"])
        terms = [products[name] for name in ("uu", "uq", "qu", "qq")]
        shift = np.abs(sum(P.getDiagonal().array for P in terms))
        comm = A.comm.tompi4py()
        largest = comm.allreduce(shift.max(initial=0.0), MPI.MAX)
        # Motions without stiffness are left out.
        shift = np.where(shift <= ZERO_STIFFNESS * largest, largest or 1.0, DIAGONAL_SHIFT * shift)
        terms.append(diagonal(comm, shift))
        if self._coarse_matrix is None:
            self._coarse_matrix = matrix_sum(terms)
        else:
            self._coarse_matrix.zeroEntries()
            for term in terms:
                self._coarse_matrix.axpy(
                    1.0, term, structure=PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN
                )
        self._coarse_factors.setOperators(self._coarse_matrix)
        self._coarse_factors.setUp()

    def apply(self, pc: PETSc.PC, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """Solve for the motions, then apply the other preconditioner to the remaining residual."""
        motions = self._motions
        if motions is None or not self._version:
            self.inner.apply(r, z)
            return
        if self._coarse_solution is None:
            self._coarse_solution, self._remaining = r.duplicate(), r.duplicate()
            for block in self._coarse_solution.getNestSubVecs():
                block.zeroEntries()
        residual_blocks = r.getNestSubVecs()
        solution_blocks = self._coarse_solution.getNestSubVecs()
        motions.work(
            residual_blocks[self._displacement_block], residual_blocks[self._jump_block], self._work
        )
        self._coarse_factors.apply(self._work, self._weights)
        self._weights.scale(-1.0)
        motions.combine(
            self._weights,
            solution_blocks[self._displacement_block],
            solution_blocks[self._jump_block],
        )
        self._coarse_solution.stateIncrease()
        r.copy(self._remaining)
        for i, remaining_block in enumerate(self._remaining.getNestSubVecs()):
            for j in (self._displacement_block, self._jump_block):
                if i == j == self._displacement_block:  # the largest block by far
                    self._products["K Zu"].multAdd(self._weights, remaining_block, remaining_block)
                    continue
                block = self._A.getNestSubMatrix(i, j)
                if block:
                    block.multAdd(solution_blocks[j], remaining_block, remaining_block)
        self._remaining.stateIncrease()
        self.inner.apply(self._remaining, z)
        z.axpy(-1.0, self._coarse_solution)
