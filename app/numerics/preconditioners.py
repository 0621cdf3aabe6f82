"""Preconditioners: options of factors and multigrid, and inverses that solvers share.

The coarse space of multigrid for displacements of second order is first order on the same mesh.
Its smoother multiplies with the matrix in single precision.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property

from petsc4py import PETSc

from dolfinx import fem
from dolfinx.fem.petsc import interpolation_matrix

from app.foundation.arrays import Bools, Floats
from app.numerics.lifetime import function_space
from app.numerics.rigid_motions import rigid_modes
from app.numerics.single_precision import SinglePrecision

Options = dict[str, str | int | float | bool]
PETSC = ctypes.CDLL(PETSc.__file__)
# Names of options that PETSc has asked for, without prefix.
USED_OPTIONS: set[str] = set()

# Unknowns above which a block of nodal unknowns is solved by multigrid. With MUMPS, which several
# ranks need, a contact solve takes 3.3 CPU s against 3.8 at 19 000 unknowns of first order, 7.1
# against 6.2 at 35 000; with CHOLMOD 2.5 against 2.3 at 24 000 of second, 6.4 against 5.2 at
# 46 000. Bonded bodies, which need one solve, lose less than a tenth by multigrid up to 90 000.
DIRECT_LIMIT = 25_000
CHOLESKY: Options = {"pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps"}
SERIAL_CHOLESKY: Options = {
    "pc_type": "cholesky",
    # Wheels have no CHOLMOD.
    "pc_factor_mat_solver_type": (
        "cholmod" if PETSc.Sys.hasExternalPackage("cholmod") else "mumps"
    ),
}
MULTIGRID: Options = {
    "pc_type": "gamg",
    "pc_gamg_agg_nsmooths": 1,
    "pc_gamg_threshold": 0.01,
    "pc_gamg_aggressive_coarsening": 1,
    "pc_gamg_coarse_eq_limit": 1000,
    "mg_coarse_pc_type": "cholesky",
    "mg_levels_ksp_type": "richardson",
    "mg_levels_ksp_max_it": 1,
    # Full steps: 1.5 of one saves an eighth of the iterations on one rank, and diverges on two,
    # where a sweep of the local part of each rank overshoots.
    "mg_levels_pc_type": "sor",
}
# Second order: a smoother, and first order on the same mesh below, factored or by two cycles
# of the above. The smoother needs products with the matrix alone, in single precision
# (`SinglePrecision`): 80 iterations of a hip with contact and 153 000 unknowns take 3.0 CPU s in
# it, 5.3 in double precision.
MULTIGRID_BY_DEGREE: Options = {
    "pc_type": "mg",
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_ksp_chebyshev_kind": "opt_fourth",
    "mg_levels_ksp_max_it": 4,
    "mg_levels_pc_type": "pbjacobi",
}
FACTORED_COARSE: Options = {"ksp_type": "preonly"}
MULTIGRID_COARSE: Options = {"ksp_type": "richardson", "ksp_max_it": 2}
# A block of interface unknowns: one symmetric sweep over the points does what factors do, in a
# fifth of the time; where conductance lets temperatures jump, factors are needed.
SWEEP: Options = {"pc_type": "sor"}
INTERFACE: Options = {"pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
# Largest number of unknowns of a matrix that is factored where multigrid fails.
FACTOR_LIMIT = 300_000


def is_direct(linear: str, size: int) -> bool:
    """Return True if a block is factored; ``linear`` is direct, multigrid or auto (by size)."""
    return linear == "direct" or (linear == "auto" and size <= DIRECT_LIMIT)


def stiffness_options(linear: str, K: PETSc.Mat, coarse_order: CoarseOrder | None) -> Options:
    """Options for a stiffness; ``linear`` is direct, multigrid or auto (by size)."""
    if is_direct(linear, K.getSize()[0]):
        return factor_options(K)
    if coarse_order is None:
        return MULTIGRID
    if is_direct("auto", coarse_order.size):
        coarse_options = FACTORED_COARSE | on_one_rank(SERIAL_CHOLESKY, K.comm.size)
    else:
        coarse_options = MULTIGRID_COARSE | MULTIGRID
    return MULTIGRID_BY_DEGREE | {
        f"mg_coarse_{key}": value for key, value in coarse_options.items()
    }


def factor_options(matrix: PETSc.Mat) -> Options:
    """Options that factor a symmetric positive definite matrix."""
    if matrix.comm.size > 1 and matrix.getSize()[0] > DIRECT_LIMIT:
        return CHOLESKY
    return on_one_rank(SERIAL_CHOLESKY, matrix.comm.size)


def on_one_rank(options: Options, ranks: int) -> Options:
    """Options of a preconditioner set up on one rank for all.

    The rounding of factors on several ranks depends on the order of their messages. Up to the size
    at which matrices are factored, one rank is no slower. Measured with 16 000 unknowns on two
    ranks: 13 CPU s of solving on one rank, 19 on both.
    """
    if ranks == 1:
        return options
    inner = {f"telescope_{key}": value for key, value in options.items()}
    outer: Options = {
        "pc_type": "telescope",
        "pc_telescope_reduction_factor": ranks,
        "telescope_ksp_type": "preonly",
    }
    return {**outer, **inner}


class CoarseOrder:
    """First-order displacements as coarse level of second-order ones with nodal unknowns."""

    def __init__(self, fine: fem.FunctionSpace, constrained: Callable[[], Bools]) -> None:
        self._fine, self._constrained = fine, constrained
        self.space = function_space(fine.mesh, ("Lagrange", 1, (3,)))
        self.size = 3 * int(self.space.dofmap.index_map.size_global)

    @cached_property
    def _interpolation(self) -> PETSc.Mat:
        matrix = interpolation_matrix(self.space, self._fine)
        matrix.assemble()
        return matrix

    def prolongation(self) -> PETSc.Mat:
        """The interpolation, decoupled between constrained and free unknowns; collective.

        The stiffness decouples them too, so constrained vertices keep a diagonal.
        """
        fine, coarse = fem.Function(self._fine), fem.Function(self.space)
        held_fine, held_coarse = (f.x.petsc_vec for f in (fine, coarse))
        held_fine.array[:] = self._constrained()
        fine.x.scatter_forward()
        coarse.interpolate(fine)
        held_part, free_part = self._interpolation.copy(), self._interpolation.copy()
        held_part.diagonalScale(held_fine, held_coarse)
        for vector in (held_fine, held_coarse):
            vector.scale(-1.0)
            vector.shift(1.0)
        free_part.diagonalScale(held_fine, held_coarse)
        free_part.axpy(1.0, held_part, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        return free_part


def near_null_space(K: PETSc.Mat, modes: Floats) -> PETSc.NullSpace:
    """Near null space of K for algebraic multigrid: the rigid modes (6, n), made orthonormal."""
    vectors: list[PETSc.Vec] = []
    for values in modes:
        vector = K.createVecLeft()
        vector.array[:] = values
        for earlier_vector in vectors:
            vector.axpy(-vector.dot(earlier_vector), earlier_vector)
        vector.normalize()
        vectors.append(vector)
    return PETSc.NullSpace().create(vectors=vectors, comm=K.comm)


class Inverse:
    """An approximate inverse of a symmetric positive definite matrix, made on first use.

    Attributes:
        pc: The preconditioner, set up once, and again only by `refresh`.
        coarse_order: First-order displacements, if usable.

    Args:
        matrix: The matrix, which may change in place.
        version: Returns the number of its changes.
        options: Initial PETSc options of the preconditioner.
    """

    def __init__(
        self,
        matrix: PETSc.Mat,
        version: Callable[[], int],
        options: Options,
        coarse_order: CoarseOrder | None = None,
    ) -> None:
        self._matrix, self._version, self.coarse_order = matrix, version, coarse_order
        self._options = dict(options)
        self._set_up_version: int | None = None
        self._smoothed: SinglePrecision | None = None  # the smoother's, in use
        self.pc = PETSc.PC().create(matrix.comm)
        self._krylov = PETSc.KSP().create(matrix.comm)
        self._krylov.setType("cg")
        self._krylov.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)
        self._krylov.setInitialGuessNonzero(True)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self._matrix.getSize()[0])

    @property
    def outdated(self) -> bool:
        """True if the matrix has changed since the last setup."""
        return self._set_up_version != self._version()

    def use(self, options: Options) -> None:
        """Choose PETSc options; other ones than before require a new setup."""
        if dict(options) != self._options:
            self._options, self._set_up_version = dict(options), None

    def make(self) -> None:
        """Set up on first use; collective."""
        if self._set_up_version is None:
            self.pc.reset()
            self.refresh()

    def refresh(self) -> None:
        """Set up for the current matrix; collective."""
        pc = self.pc
        pc.setReusePreconditioner(False)
        pc.setOptionsPrefix(f"mantle_inverse_{id(self)}_")
        operator, self._smoothed = self._matrix, None
        if self._options["pc_type"] == MULTIGRID_BY_DEGREE["pc_type"]:
            pc.reset()  # levels would keep the diagonal blocks of the matrix before
            self._set_coarse_level()
            self._smoothed = SinglePrecision(self._matrix)
            operator = self._smoothed.matrix
            pc.setUseAmat(True)
        pc.setOperators(operator, self._matrix)
        configure(pc, self._options)
        if pc.getFailedReason() == PETSc.PC.FailedReason.FACTOR_OUTMEMORY:
            raise MemoryError(f"factorization of a matrix of {self.size:,} unknowns")
        pc.setReusePreconditioner(True)
        self._set_up_version = self._version()

    def _set_coarse_level(self) -> None:
        assert self.coarse_order is not None
        P = self.coarse_order.prolongation()
        below = self._matrix.PtAP(P)
        below.setBlockSize(3)
        below.setOption(PETSc.Mat.Option.SPD, True)
        x = self.coarse_order.space.tabulate_dof_coordinates()[: below.getLocalSize()[0] // 3]
        below.setNearNullSpace(near_null_space(below, rigid_modes(x).reshape(-1, 6).T))
        self.pc.setType(MULTIGRID_BY_DEGREE["pc_type"])
        self.pc.setMGLevels(2)
        self.pc.setMGInterpolation(1, P)
        self.pc.getMGCoarseSolve().setOperators(below)

    def fall_back(self) -> bool:
        """Factor the matrix instead of approximating its inverse, if it is not too large."""
        multigrid = (MULTIGRID["pc_type"], MULTIGRID_BY_DEGREE["pc_type"])
        if self._options.get("pc_type") not in multigrid or self.size > FACTOR_LIMIT:
            return False
        self.use(factor_options(self._matrix))
        self.make()
        return True

    def solve(self, b: PETSc.Vec, x: PETSc.Vec, rtol: float) -> int:
        """Solve with the matrix by conjugate gradients; return the iterations; collective.

        x is the initial guess, then the solution; ``rtol`` the residual relative to that of b.
        """
        self.make()
        if self.outdated:
            self.refresh()
        self._krylov.setPC(self.pc)
        self._krylov.setOperators(self._matrix)
        self._krylov.setTolerances(rtol=rtol)
        self._krylov.solve(b, x)
        return int(self._krylov.getIterationNumber())


def configure(pc: PETSc.PC, options: Options) -> None:
    """Set up a preconditioner by PETSc options under its prefix."""
    with options_set(pc.getOptionsPrefix(), options):
        pc.setFromOptions()
        # Inner solvers read their options at setup, while these are set.
        pc.setUp()


@contextmanager
def options_set(prefix: str | None, options: Options) -> Iterator[None]:
    """Hold options under a prefix in PETSc's database while the block runs."""
    database = PETSc.Options(prefix)
    for key, value in options.items():
        database[key] = value
    try:
        yield
    finally:
        is_asked = ctypes.c_int()  # petsc4py cannot report whether PETSc has asked for an option
        for key in options:
            name = f"{database.prefix or ''}{key}".encode()
            PETSC.PetscOptionsUsed(None, name, ctypes.byref(is_asked))
            USED_OPTIONS.update([key] * is_asked.value)
            database.delValue(key)
