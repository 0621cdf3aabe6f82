"""Linear algebra of a nonlinear solve: Krylov method, preconditioners, and when they are made.

The Krylov method is preconditioned by block Gauss-Seidel (PCFIELDSPLIT, multiplicative, in the
order of the blocks). Preconditioners of the large blocks are set up once and kept while they are
good enough; that of the stiffness belongs to the problem, so that everything that solves with it
shares it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from petsc4py import PETSc

from app.timing import Timing

if TYPE_CHECKING:
    from app.systems import System

Options = Mapping[str, str | int | float | bool]

# Unknowns above which a block of nodal unknowns is solved by algebraic multigrid.
DIRECT_LIMIT = 30_000
DIRECT: Options = {"pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps"}
MULTIGRID: Options = {
    "pc_type": "gamg",
    "pc_gamg_agg_nsmooths": 1,
    "pc_gamg_threshold": 0.01,
    "pc_gamg_aggressive_coarsening": 1,
    "pc_gamg_coarse_eq_limit": 1000,
    "mg_coarse_pc_type": "cholesky",
    "mg_levels_ksp_type": "richardson",
    "mg_levels_ksp_max_it": 1,
    "mg_levels_pc_type": "sor",
}
# A block of interface unknowns.
INTERFACE: Options = {"pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
KRYLOV: Options = {"ksp_type": "fgmres", "ksp_max_it": 200, "ksp_gmres_restart": 200}
# Of several blocks: Gauss-Seidel. A block's preconditioner stays until it has to be made again.
SPLIT: Options = {"pc_type": "fieldsplit", "pc_fieldsplit_type": "multiplicative"}
# Blocks of nodal unknowns keep their preconditioners from one Jacobian to the next.
KEPT = ("displacement", "temperature")
# Krylov iterations per Newton iteration beyond which they are made again, if matrices changed.
STALE = 25


def block(linear: str, size: int) -> Options:
    """Options for a block of nodal unknowns; ``linear`` is direct, multigrid or auto (by size)."""
    direct = linear == "direct" or (linear == "auto" and size <= DIRECT_LIMIT)
    return DIRECT if direct else MULTIGRID


class Inverse:
    """An approximate inverse of a symmetric positive definite matrix, made on first use."""

    def __init__(self, matrix: PETSc.Mat, version: Callable[[], int]) -> None:
        """Take the matrix as it is.

        Args:
            matrix: The matrix, which may change in place.
            version: Counts how often it has changed.
        """
        self._matrix, self._version = matrix, version
        self._made: int | None = None
        self._ksp = PETSc.KSP().create(matrix.comm)
        self._ksp.setType("cg")
        self._ksp.setNormType(PETSc.KSP.NormType.UNPRECONDITIONED)

    def solve(self, b: PETSc.Vec, x: PETSc.Vec, rtol: float) -> int:
        """Solve with the matrix by conjugate gradients; collective.

        Args:
            b: Right-hand side.
            x: Initial guess, then the solution.
            rtol: Residual relative to that of ``b`` at which to stop.

        Returns:
            Iterations.
        """
        ksp, fresh = self._ksp, self._made is None
        if self._made != self._version():
            self._made = self._version()
            ksp.setOperators(self._matrix)
        if fresh:
            ksp.setOptionsPrefix(_prefix(self._matrix))
            _with_options(ksp, block("auto", self._matrix.getSize()[0]))
        ksp.setTolerances(rtol=rtol)
        ksp.setInitialGuessNonzero(True)
        ksp.solve(b, x)
        return int(ksp.getIterationNumber())


def _prefix(matrix: PETSc.Mat) -> str:
    """A prefix of options of its own."""
    return f"mantle_inverse_{id(matrix)}_"


def _with_options(ksp: PETSc.KSP, options: Options) -> None:
    """Configure a solver by PETSc options that nobody else sees."""
    database = PETSc.Options(ksp.getOptionsPrefix())
    for key, value in options.items():
        database[key] = value
    ksp.setFromOptions()
    # Inner solvers read their options when they are set up: that has to be now.
    ksp.setUp()
    for key in options:
        database.delValue(key)


class Linear:
    """The linear solver of a system inside its Newton iteration.

    Attributes:
        matrix: The Jacobian: one matrix, or one of blocks (MATNEST).
        options: PETSc options it asks for.
    """

    def __init__(self, system: System, linear: str, timing: Timing) -> None:
        """Put the blocks together; collective.

        Args:
            system: What is solved.
            linear: direct, multigrid or auto (by size).
            timing: Where the seconds go.
        """
        self._system, self._timing = system, timing
        blocks = system.blocks()
        self._names = list(blocks)
        matrices = system.matrices()
        if len(blocks) == 1:
            self.matrix: PETSc.Mat = matrices[0][0]
        else:
            self.matrix = PETSc.Mat().createNest(matrices, comm=system.comm)
            self.matrix.assemble()
        parts = system.options(linear)
        # Options of blocks, or of all at once.
        self._split = len(blocks) > 1 and set(parts) == set(blocks)
        self.options = dict(KRYLOV)
        for name, of_block in parts.items():
            prefix = f"fieldsplit_{name}_" if self._split else ""
            self.options |= {f"{prefix}{key}": value for key, value in of_block.items()}
            if prefix:
                self.options |= dict(SPLIT) | {f"{prefix}ksp_type": "preonly"}
        self._version = system.version
        self._made = 0
        self._worn = False

    def attach(self, ksp: PETSc.KSP, x: list[PETSc.Vec]) -> None:
        """Set the preconditioners up, of the Jacobian at a state; options are set; collective."""
        self._ksp = ksp
        pc = ksp.getPC()
        if self._split:
            fields = self.matrix.getNestISs()[0]
            pc.setFieldSplitIS(*zip(self._names, fields, strict=True))
        # The inner solvers read their options when they are set up: that has to be now.
        self._system.jacobian(x)
        self.matrix.assemble()
        pc.setOperators(self.matrix)
        with self._timing.phase("factorize"):
            pc.setUp()
            pc.setUpOnBlocks()
        self._keep(True)

    def update(self, x: list[PETSc.Vec]) -> None:
        """Set the Jacobian to a state; preconditioners are made again where that is due."""
        self._system.jacobian(x)
        self.matrix.assemble()
        if self._version != self._system.version or self._worn:
            self._version, self._worn = self._system.version, False
            self._keep(False)
            self._made = 1
        elif self._made:
            self._made = 0
            self._keep(True)

    def took(self, newton: int, krylov: int) -> None:
        """Learn what a nonlinear solve took."""
        self._worn = krylov > STALE * newton

    def _keep(self, keep: bool) -> None:
        """Say whether preconditioners of nodal unknowns outlive the next Jacobian."""
        if not self._split:
            self._ksp.getPC().setReusePreconditioner(keep)
            return
        inner_solvers = self._ksp.getPC().getFieldSplitSubKSP()
        for name, inner in zip(self._names, inner_solvers, strict=True):
            if name in KEPT:
                inner.getPC().setReusePreconditioner(keep)
