"""First order on the same mesh: the coarse space of multigrid for displacements of second order."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Protocol

from petsc4py import PETSc

from dolfinx import fem
from dolfinx.fem.petsc import interpolation_matrix

from app.arrays import Bools
from app.mechanics.constraints import AllFree, Reduction, near_null_space
from app.numerics.preconditioners import Inverse, stiffness_options
from app.numerics.rigid_motions import rigid_modes
from app.scene.scene import Scene


class CoarseOrder:
    """Displacements of first order, and how they are interpolated.

    Attributes:
        space: The displacements of first order.
        size: Unknowns.
    """

    def __init__(self, space: fem.FunctionSpace, held: Callable[[], Bools]) -> None:
        """Find the vertices.

        Args:
            space: Displacements of second order; the unknowns are those of the nodes.
            held: Returns what supports hold of own unknowns (n,).
        """
        self._fine, self._held = space, held
        self.space = fem.functionspace(space.mesh, ("Lagrange", 1, (3,)))
        self.size = 3 * int(self.space.dofmap.index_map.size_global)

    @cached_property
    def _interpolation(self) -> PETSc.Mat:
        """Values of second order from those of first."""
        matrix = interpolation_matrix(self.space, self._fine)
        matrix.assemble()
        return matrix

    def prolongation(self) -> PETSc.Mat:
        """The interpolation, in which held and free unknowns do not mix; collective.

        The stiffness does not mix them either: so held vertices keep a diagonal of their own.
        """
        fine, coarse = fem.Function(self._fine), fem.Function(self.space)
        held, below = (f.x.petsc_vec for f in (fine, coarse))
        held.array[:] = self._held()
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
        """The rigid modes, for algebraic multigrid of a stiffness of first order."""
        x = self.space.tabulate_dof_coordinates()
        own = x[: self.space.dofmap.index_map.size_local]
        return near_null_space(matrix.comm, matrix, rigid_modes(own).reshape(-1, 6).T)


class Stiff(Protocol):
    """Whatever has a stiffness.

    Attributes:
        K: The stiffness.
        version: Counts how often it has changed.
        scene: What is solved.
        space: Of the displacement.
        reduction: From nodal displacements to unknowns.
        held: Own unknowns that supports hold (n,).
    """

    K: PETSc.Mat
    version: int
    scene: Scene
    space: fem.FunctionSpace
    reduction: Reduction
    held: Bools


def inverse_of(problem: Stiff) -> Inverse:
    """Factors of the stiffness or multigrid: by degree at second order, if unknowns are nodal."""
    K, order = problem.K, problem.scene.order
    nodal = order > 1 and isinstance(problem.reduction, AllFree)
    lower = CoarseOrder(problem.space, lambda: problem.held) if nodal else None
    options = stiffness_options("auto", K, order, lower)
    return Inverse(K, lambda: problem.version, options, lower)
