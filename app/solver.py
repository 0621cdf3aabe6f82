"""The bridge to PETSc SNES: one nonlinear solve of a problem at its current time.

Blocks: the bonded stiffness, assembled and set up once, and the jump block, rebuilt at each
iteration. Newton is semismooth, with the generalized Jacobian of `app.jumps`; the Krylov method is
preconditioned by block Gauss-Seidel (PCFIELDSPLIT, multiplicative, displacement first).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from app.errors import StoppedError
from app.jumps import Jumps
from app.problem import Problem
from app.timing import Timing

Options = Mapping[str, str | int | float | bool]

PREFIX = "mantle_"
# Unknowns above which the displacement block is solved by algebraic multigrid.
DIRECT_LIMIT = 30_000
CONDITION_RTOL = 1e-4
CONDITION_ITERATIONS = 20

NEWTON: Options = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "bt",
    "snes_linesearch_order": 1,
    "snes_max_linear_solve_fail": 3,
    "snes_ksp_ew": True,
    "snes_ksp_ew_version": 2,
    "snes_ksp_ew_rtol0": 1e-2,
    "snes_ksp_ew_rtolmax": 1e-2,
    "ksp_type": "fgmres",
    "ksp_max_it": 200,
    "ksp_gmres_restart": 200,
}
SPLIT: Options = {
    "pc_type": "fieldsplit",
    "pc_fieldsplit_type": "multiplicative",
    "fieldsplit_u_ksp_type": "preonly",
    "fieldsplit_u_ksp_reuse_preconditioner": True,
    "fieldsplit_jump_ksp_type": "preonly",
    "fieldsplit_jump_pc_type": "lu",
    "fieldsplit_jump_pc_factor_mat_solver_type": "mumps",
}
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


@dataclass(frozen=True)
class Outcome:
    """What a nonlinear solve ended with.

    Attributes:
        converged: Whether the residual met its tolerance.
        iterations: Newton iterations.
        linear_iterations: Krylov iterations.
        residuals: Residual norm at each iteration, relative to the force scale.
        flips: Contact points whose state changed, at each iteration.
        linear_failed: Whether the linear solver gave up.
    """

    converged: bool
    iterations: int
    linear_iterations: int
    residuals: tuple[float, ...]
    flips: tuple[int, ...]
    linear_failed: bool


class Solver:
    """SNES on a problem: vectors, matrices and options, set up once."""

    def __init__(
        self,
        problem: Problem,
        tolerance: float,
        max_iterations: int,
        linear: str,
        options: Options,
        timing: Timing,
        stop: Callable[[], str] = str,
    ) -> None:
        """Create the solver; collective.

        Args:
            problem: What is solved.
            tolerance: Residual over force scale at which a solve has converged.
            max_iterations: Newton iterations allowed.
            linear: direct, multigrid or auto (by size).
            options: Raw PETSc options, without dash, that override the defaults.
            timing: Where the seconds go.
            stop: Names a signal that asks this rank to stop, or gives an empty text.
        """
        self.problem = problem
        self._timing = timing
        self._tolerance = tolerance
        self._stop = stop
        size = problem.K.getSize()[0]
        direct = linear == "direct" or (linear == "auto" and size <= DIRECT_LIMIT)
        block = DIRECT if direct else MULTIGRID
        defaults = dict(NEWTON) | {"snes_max_it": max_iterations}
        if problem.jumps:
            defaults |= dict(SPLIT) | {f"fieldsplit_u_{k}": v for k, v in block.items()}
        else:
            defaults |= block
        self._block = _Bonded(problem) if not problem.jumps else _Contact(problem)
        self.x = self._block.vector()
        self.failed = self._block.vector()
        self._residuals: list[float] = []
        self._flips: list[int] = []
        self._scale = 0.0
        self.snes = PETSc.SNES().create(problem.comm)
        self.snes.setOptionsPrefix(PREFIX)
        self.snes.setFunction(self._residual, self._block.vector())
        self.snes.setJacobian(self._jacobian, self._block.matrix())
        self.snes.setMonitor(self._monitor)
        self.snes.setConvergenceTest(self._converged)
        self.options = defaults | dict(options)
        self._configure()

    def _configure(self) -> None:
        """Hand the options to PETSc under the prefix, and take them out of its database again."""
        database = PETSc.Options(PREFIX)
        for key, value in self.options.items():
            database[key] = value
        self.snes.setFromOptions()
        ksp = self.snes.getKSP()
        self._block.configure(ksp)
        # The inner solvers read their options when they are set up: that has to be now.
        self._block.jacobian(self.x)
        pc = ksp.getPC()
        pc.setOperators(self._block.matrix())
        with self._timing.phase("factorize"):
            pc.setUp()
            pc.setUpOnBlocks()
        for key in self.options:
            database.delValue(key)

    # Callbacks

    def _residual(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        self._block.residual(x, f)

    def _jacobian(self, snes: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        self._block.jacobian(x)

    def _monitor(self, snes: PETSc.SNES, iteration: int, norm: float) -> None:
        # Every rank sees the same answer, so that none is left waiting for the others.
        names = [name for name in self.problem.comm.allgather(self._stop()) if name]
        if names:
            raise StoppedError(f"stopped by {names[0]}")
        self._flips.append(self._block.flips())

    def _converged(
        self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]
    ) -> PETSc.SNES.ConvergedReason:
        """Residual below its tolerance, or below what rounding leaves of it."""
        x = snes.getSolution()
        scale = self._scale_at(x)
        self._residuals.append(norms[2] / scale if scale else norms[2])
        limit = max(self._tolerance * scale, self._block.rounding(x))
        reasons = PETSc.SNES.ConvergedReason
        if not np.isfinite(norms[2]):
            return reasons.DIVERGED_FUNCTION_NANORINF
        return reasons.CONVERGED_FNORM_ABS if norms[2] <= limit else reasons.ITERATING

    def _scale_at(self, x: PETSc.Vec) -> float:
        """Size of the forces, of this state or of the converged ones before it [N]."""
        return max(self._scale, self.problem.force_scale(*self._block.parts(x)))

    # Solve

    def solve(self) -> Outcome:
        """Solve at the problem's current time, from the current iterate in ``x``."""
        self._block.impose(self.x)
        self._residuals, self._flips = [], []
        self._block.forget()
        with self._timing.phase("solve"):
            try:
                self.snes.solve(None, self.x)
            except PETSc.Error as error:
                # What a callback raised comes back wrapped.
                raise error.__cause__ or error from None
        reason = self.snes.getConvergedReason()
        if reason > 0:
            self._scale = self._scale_at(self.x)
        else:
            self.x.copy(self.failed)
        return Outcome(
            converged=reason > 0,
            iterations=self.snes.getIterationNumber(),
            linear_iterations=self.snes.getLinearSolveIterations(),
            residuals=tuple(self._residuals),
            flips=tuple(self._flips),
            linear_failed=reason == PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE,
        )

    def parts(self, x: PETSc.Vec | None = None) -> tuple[PETSc.Vec, PETSc.Vec | None]:
        """Displacement and jumps of a state, the current one by default."""
        return self._block.parts(self.x if x is None else x)

    def condition(self) -> float:
        """Condition of the last Jacobian: largest over smallest size of an eigenvalue; collective.

        By power iteration and by inverse iteration with the solver itself: an estimate, good to
        some per cent. One matrix in displacements and jumps, not what a displacement method has.
        """
        ksp, A = self.snes.getKSP(), self._block.matrix()
        ksp.setTolerances(rtol=CONDITION_RTOL)
        x, y = self._block.vector(), self._block.vector()
        sizes = []
        for apply in (A.mult, ksp.solve):
            x.setRandom()
            for _ in range(CONDITION_ITERATIONS):
                x.normalize()
                apply(x, y)
                x, y = y, x
            sizes.append(float(x.norm()))
        return sizes[0] * sizes[1]

    @property
    def block_sizes(self) -> dict[str, int]:
        """Unknowns by block."""
        return self._block.sizes()


class _Bonded:
    """One block: no interface can move."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem

    def vector(self) -> PETSc.Vec:
        return self._problem.K.createVecLeft()

    def matrix(self) -> PETSc.Mat:
        return self._problem.K

    def parts(self, x: PETSc.Vec) -> tuple[PETSc.Vec, None]:
        return x, None

    def sizes(self) -> dict[str, int]:
        return {"displacement": self._problem.K.getSize()[0]}

    def rounding(self, x: PETSc.Vec) -> float:
        return self._problem.rounding(x)

    def impose(self, x: PETSc.Vec) -> None:
        self._problem.impose(x)

    def residual(self, x: PETSc.Vec, f: PETSc.Vec) -> None:
        self._problem.residual_u(x, None, f)

    def jacobian(self, x: PETSc.Vec) -> None:
        """The stiffness is constant."""

    def configure(self, ksp: PETSc.KSP) -> None:
        """Nothing beyond the options."""

    def flips(self) -> int:
        return 0

    def forget(self) -> None:
        """No state."""


class _Contact:
    """Two blocks: displacement and jumps."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        (self._jumps,) = problem.jumps
        j: Jumps = self._jumps
        C = j.C.copy()
        C.zeroRows(problem.supported_rows(), diag=0.0)
        self._rows = _block_diagonal(j)
        self._A_qu = self._rows.matMult(j.Ct)
        self._A_qq = self._rows.matMult(j.D)
        self._added = _block_diagonal(j)
        self._A = PETSc.Mat().createNest([[problem.K, C], [self._A_qu, self._A_qq]])
        self._A.assemble()
        self._last: NDArray[np.int64] | None = None
        self._changed = 0

    def vector(self) -> PETSc.Vec:
        return PETSc.Vec().createNest(
            [self._problem.K.createVecLeft(), self._jumps.D.createVecLeft()],
            comm=self._problem.comm,
        )

    def matrix(self) -> PETSc.Mat:
        return self._A

    def parts(self, x: PETSc.Vec) -> tuple[PETSc.Vec, PETSc.Vec]:
        u, q = x.getNestSubVecs()
        return u, q

    def sizes(self) -> dict[str, int]:
        return {
            "displacement": self._problem.K.getSize()[0],
            "jump": self._jumps.D.getSize()[0],
        }

    def rounding(self, x: PETSc.Vec) -> float:
        return self._problem.rounding(self.parts(x)[0])

    def impose(self, x: PETSc.Vec) -> None:
        u, q = self.parts(x)
        self._problem.impose(u)
        held = self._jumps.held.ravel()
        q.array[held] = self._jumps.given.ravel()[held]

    def residual(self, x: PETSc.Vec, f: PETSc.Vec) -> None:
        u, q = self.parts(x)
        f_u, f_q = self.parts(f)
        self._problem.residual_u(u, q, f_u)
        trial = self._problem.trial(u, q)
        f_q.array[:] = self._jumps.residual(trial.equilibrium, trial.jump, trial.law).ravel()

    def jacobian(self, x: PETSc.Vec) -> None:
        trial = self._problem.trial(*self.parts(x))
        times, added = self._jumps.row_factors(trial.law)
        _fill(self._rows, times)
        _fill(self._added, added)
        self._rows.matMult(self._jumps.Ct, result=self._A_qu)
        self._rows.matMult(self._jumps.D, result=self._A_qq)
        self._A_qq.axpy(1.0, self._added, structure=PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        self._A.assemble()
        status = trial.law.status
        self._changed = -1 if self._last is None else int((status != self._last).sum())
        self._last = status.copy()

    def configure(self, ksp: PETSc.KSP) -> None:
        u, jump = self._A.getNestISs()[0]
        ksp.getPC().setFieldSplitIS(("u", u), ("jump", jump))

    def flips(self) -> int:
        return self._problem.comm.allreduce(max(self._changed, 0), MPI.SUM)

    def forget(self) -> None:
        self._last, self._changed = None, 0


def _block_diagonal(j: Jumps) -> PETSc.Mat:
    """Matrix with a dense 3 x 3 block per contact point."""
    n = len(j.mine)
    A = PETSc.Mat().createAIJ(
        ((3 * n, None), (3 * n, None)), csr=_csr(j.comm, np.ones((n, 3, 3))), comm=j.comm
    )
    A.assemble()
    return A


def _fill(A: PETSc.Mat, blocks: NDArray[np.float64]) -> None:
    A.setValuesCSR(*_csr(A.comm.tompi4py(), blocks))
    A.assemble()


def _csr(comm: MPI.Comm, blocks: NDArray[np.float64]) -> tuple[NDArray, NDArray, NDArray]:
    """Rows of a block diagonal matrix in compressed form."""
    n = len(blocks)
    start = comm.exscan(3 * n) or 0  # type: ignore[attr-defined]  # mpi4py's stubs lack it
    columns = start + np.repeat(3 * np.arange(n), 9) + np.tile(np.arange(3), 3 * n)
    return (
        (3 * np.arange(3 * n + 1)).astype(PETSc.IntType),
        columns.astype(PETSc.IntType),
        np.ascontiguousarray(blocks).ravel(),
    )
