r"""Rigid motions of bodies solved for apart: what contact holds weakly no local method finds.

A body that slides on its interfaces as a whole meets little resistance, and a preconditioner that
treats displacement and jumps in turn leaves such motions almost as they were: Krylov methods stall
until they have found each of them. With Z the motions and A the Jacobian, a preconditioner M
becomes (A-DEF1, Tang et al. 2009, https://doi.org/10.1007/s10915-009-9272-6)

.. math:: Q + M (1 - A Q), \qquad Q = Z (Z^T A Z)^{-1} Z^T.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from dolfinx import fem, la
from numpy.typing import NDArray

from app.bodies import cell_tags
from app.reduction import rigid_modes

if TYPE_CHECKING:
    from app.problem import Problem

Floats = NDArray[np.float64]

# A direction of which a law resists less than this is free.
RESISTED = 0.5
# Motions that this part of the strongest resistance holds are left to the Krylov method.
NOTHING = 1e-10


class Deflated:
    """Context of a PCPYTHON on matrices of blocks: another preconditioner, deflated.

    Attributes:
        inner: The other preconditioner.
    """

    def __init__(self, inner: PETSc.PC, motions: Callable[[], Sequence[Floats]]) -> None:
        """Take what is to be deflated.

        Args:
            inner: The preconditioner.
            motions: Gives Z at the current Jacobian: the own rows of each block (n, m).
        """
        self.inner, self._motions = inner, motions

    def setUp(self, pc: PETSc.PC) -> None:
        """Take in a Jacobian; collective."""
        A = pc.getOperators()[0]
        self.inner.setOperators(A)
        self.inner.setUp()
        self._comm = A.comm.tompi4py()
        self._Z = [np.ascontiguousarray(z.T) for z in self._motions()]
        norms = np.sqrt(self._sum(np.array([np.sum(z**2, axis=1) for z in self._Z])))
        self._Z = [z / np.where(norms > 0, norms, 1.0)[:, None] for z in self._Z]
        x, y = A.createVecs()
        cuts = np.cumsum([z.shape[1] for z in self._Z])[:-1]
        self._AZ = [np.empty_like(z) for z in self._Z]
        for k, motion in enumerate(zip(*self._Z, strict=True)):
            x.array[:] = np.concatenate(motion)
            A.mult(x, y)
            for rows, values in zip(self._AZ, np.split(y.array_r, cuts), strict=True):
                rows[k] = values
        galerkin = self._sum(np.array([z @ y.T for z, y in zip(self._Z, self._AZ, strict=True)]))
        self._inverse = np.linalg.pinv(galerkin, rcond=NOTHING)
        self._rest: PETSc.Vec | None = None

    def apply(self, pc: PETSc.PC, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """The motions first, then the other preconditioner on what they leave."""
        given = r.getNestSubVecs()
        weights = self._inverse @ self._sum(
            np.array([z @ v.array_r for z, v in zip(self._Z, given, strict=True)])
        )
        if self._rest is None:
            self._rest = r.duplicate()
        for left, v, y in zip(self._rest.getNestSubVecs(), given, self._AZ, strict=True):
            left.array[:] = v.array_r - weights @ y
        self._rest.stateIncrease()
        self.inner.apply(self._rest, z)
        for v, motion in zip(z.getNestSubVecs(), self._Z, strict=True):
            v.array[:] += weights @ motion
        # A vector of blocks does not see that these have changed, and remembers its norm.
        z.stateIncrease()

    def _sum(self, parts: Floats) -> Floats:
        """Sum over blocks and ranks."""
        total = parts.sum(axis=0)
        self._comm.Allreduce(MPI.IN_PLACE, total)
        return np.asarray(total)


def free_directions(slope: Floats) -> Floats:
    """Projectors on the jumps that a contact law does not resist.

    Args:
        slope: Generalized derivative P' of the law at each point (n, 3, 3).

    Returns:
        Orthogonal projectors on what P' all but maps to zero (n, 3, 3).
    """
    values, vectors = np.linalg.eigh(slope.transpose(0, 2, 1) @ slope)
    free = np.where(values < RESISTED**2, 1.0, 0.0)
    return np.asarray(np.einsum("pik,pk,pjk->pij", vectors, free, vectors))


class Motions:
    """Six rigid motions of each body while all others stay, of displacement and jumps."""

    def __init__(self, problem: Problem) -> None:
        """Find the nodes of the bodies; collective."""
        (j,) = problem.jumps
        reduction, x = problem.reduction, j.points.x
        # About the middle of the interfaces, turns as large as shifts: well conditioned.
        centre = x.mean(axis=0)
        frame = np.eye(6)
        frame[:3, 3:] = -rigid_modes(centre[None])[0, :, 3:]
        frame[:, 3:] /= np.linalg.norm(np.ptp(x, axis=0)) or 1.0
        modes = reduction.modes.T @ frame
        self._at_points = rigid_modes(x[j.mine]) @ frame
        self._held = j.held
        bodies = range(len(problem.bodies.names))
        self._displacement = np.hstack([self._of(problem, b, modes) for b in bodies])
        master, slave = (j.points.bodies[j.mine].T[..., None] == list(bodies)).astype(float)
        self._signs = slave - master

    def _of(self, problem: Problem, body: int, modes: Floats) -> Floats:
        """Motions of a body in own unknowns of displacement (n, 6), the jumps left out."""
        reduction, space = problem.reduction, problem.space
        cells = np.flatnonzero(problem.bodies.of_tag[cell_tags(problem.tagged)] == body)
        marks = fem.Function(space)
        marks.x.array.reshape(-1, 3)[np.unique(space.dofmap.list[cells])] = 1
        marks.x.scatter_reverse(la.InsertMode.add)
        own = marks.x.array[: 3 * space.dofmap.index_map.size_local] > 0
        (j,) = problem.jumps
        if body in j.moves:
            # Where the jumps move a body, its nodes are those of the others.
            own &= np.diff(j.moves[body].getValuesCSR()[0]) == 0
        touched = np.zeros(len(modes), dtype=bool)
        vector = problem.K.createVecLeft()
        for mode in reduction.modes:
            vector.array[:] = mode
            nodal = reduction.expand(vector)
            nodal.array[~own] = 0
            touched |= reduction.vector(nodal).array != 0
        return np.where((touched & ~problem.held)[:, None], modes, 0.0)

    def at(self, slope: Floats) -> list[Floats]:
        """Motions of displacement (n, m) and of the jumps that a law lets go (n, m).

        Args:
            slope: Generalized derivative P' of the law at own points (n, 3, 3).
        """
        free = free_directions(slope)
        free[self._held[:, :, None] | self._held[:, None, :]] = 0
        along = free @ self._at_points
        jumps = self._signs[:, None, :, None] * along[:, :, None, :]
        return [self._displacement, jumps.reshape(3 * len(free), -1)]
