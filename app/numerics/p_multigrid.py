"""First order on the same mesh: the coarse space of multigrid for displacements of second order."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

from petsc4py import PETSc

from dolfinx import fem
from dolfinx.fem.petsc import interpolation_matrix

from app.arrays import Bools, Floats
from app.numerics.rigid_motions import rigid_modes


class CoarseOrder:
    """Displacements of first order below those of second order, whose unknowns are nodal.

    Attributes:
        space: The displacements of first order.
        size: Number of unknowns.
    """

    def __init__(self, fine: fem.FunctionSpace, constrained: Callable[[], Bools]) -> None:
        self._fine, self._constrained = fine, constrained
        self.space = fem.functionspace(fine.mesh, ("Lagrange", 1, (3,)))
        self.size = 3 * int(self.space.dofmap.index_map.size_global)

    @cached_property
    def _interpolation(self) -> PETSc.Mat:
        matrix = interpolation_matrix(self.space, self._fine)
        matrix.assemble()
        return matrix

    def prolongation(self) -> PETSc.Mat:
        """The interpolation, decoupled between constrained and free unknowns; collective.

        The stiffness decouples them too, so constrained vertices keep a diagonal of their own.
        """
        fine, coarse = fem.Function(self._fine), fem.Function(self.space)
        held, below = (f.x.petsc_vec for f in (fine, coarse))
        held.array[:] = self._constrained()
        fine.x.scatter_forward()
        coarse.interpolate(fine)
        of_held, of_free = self._interpolation.copy(), self._interpolation.copy()
        of_held.diagonalScale(held, below)
        for vector in (held, below):
            vector.scale(-1.0)
            vector.shift(1.0)
        of_free.diagonalScale(held, below)
        of_free.axpy(1.0, of_held, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        return of_free

    def rigid(self, matrix: PETSc.Mat) -> PETSc.NullSpace:
        """Rigid modes for algebraic multigrid of a stiffness of first order."""
        x = self.space.tabulate_dof_coordinates()
        own = x[: self.space.dofmap.index_map.size_local]
        return near_null_space(matrix, rigid_modes(own).reshape(-1, 6).T)


def near_null_space(K: PETSc.Mat, modes: Floats) -> PETSc.NullSpace:
    """The six rigid modes (6, n), orthonormal, for algebraic multigrid."""
    vectors: list[PETSc.Vec] = []
    for values in modes:
        vector = K.createVecLeft()
        vector.array[:] = values
        for other in vectors:
            vector.axpy(-vector.dot(other), other)
        vector.normalize()
        vectors.append(vector)
    return PETSc.NullSpace().create(vectors=vectors, comm=K.comm)
