"""The linear solver inside Newton's method: Krylov method, and when preconditioners are rebuilt.

The Krylov method is preconditioned by block Gauss-Seidel (PCFIELDSPLIT, multiplicative, in the
order of the blocks). Preconditioners of the large blocks are set up once and kept while they are
good enough. The preconditioner of the stiffness belongs to the problem, whose solvers share it.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping

from petsc4py import PETSc

from app.numerics.deflation import Deflated
from app.numerics.lifetime import python_pc
from app.numerics.preconditioners import INTERFACE, SWEEP, Inverse, Options, configure
from app.numerics.system import System
from app.system.timing import Timing

log = logging.getLogger("mantle")

KRYLOV_OPTIONS: Options = {"ksp_type": "fgmres", "ksp_max_it": 300, "ksp_gmres_restart": 100}
SYMMETRIC_OPTIONS: Options = {"ksp_type": "cg", "ksp_norm_type": "unpreconditioned"}
# For several blocks: Gauss-Seidel. A block's preconditioner is kept until it is rebuilt on purpose.
SPLIT_OPTIONS: Options = {"pc_type": "fieldsplit", "pc_fieldsplit_type": "multiplicative"}
# Blocks of nodal unknowns keep their preconditioners from one Jacobian to the next.
REUSED_BLOCKS = ("displacement", "temperature")
# Excess Krylov iterations that cost as much as new preconditioners.
SETUP_ITERATIONS = 30
# Krylov iterations per digit of the residual.
USUAL_ITERATIONS = 8
# Iterations of the estimate of a condition number.
CONDITION_ITERATIONS = 20
# Names of the blocks and methods in the log.
BLOCK_NAMES = {
    "displacement": "bodies",
    "jump": "contact",
    "temperature_jump": "jumps of temperature",
}
METHOD_NAMES = {
    "cg": "CG",
    "fgmres": "FGMRES",
    "gamg": "algebraic multigrid",
    "mg": "multigrid by degree",
    "cholesky": "Cholesky",
    "telescope": "direct on one rank",
    "lu": "LU",
    "sor": "SOR",
}


class Linear:
    """The linear solver of a system inside its Newton iteration: direct, multigrid or auto.

    Attributes:
        matrix: The Jacobian: one matrix, or one of blocks (MATNEST).
        options: PETSc options that the solver needs.
        factored: True while contact blocks are factorized instead of swept.
        exact: The inverse of the Jacobian, if the system has one.
    """

    def __init__(self, system: System, linear: str, raw_options: Options, timing: Timing) -> None:
        self._system, self._timing = system, timing
        blocks = system.blocks()
        self._names = list(blocks)
        matrices = system.matrices()
        if len(matrices) == 1:
            self.matrix: PETSc.Mat = matrices[0][0]
        else:
            self.matrix = PETSc.Mat().createNest(matrices, comm=system.comm)
            self.matrix.assemble()
        # Options for parts of a Krylov method ask for one.
        asks_for_krylov = any(key.startswith(("ksp_", "pc_", "fieldsplit_")) for key in raw_options)
        self.exact = None if asks_for_krylov else system.condensed(linear)
        if self.exact:
            self.options: Options = {"ksp_type": "preonly"}
        options_by_block = {} if self.exact else system.options(linear)
        # Options by block, or of all blocks at once.
        self._is_split = len(blocks) > 1 and set(options_by_block) == set(blocks)
        if not self.exact:
            self.options = dict(KRYLOV_OPTIONS)
        for name, block_options in options_by_block.items():
            prefix = f"fieldsplit_{name}_" if self._is_split else ""
            self.options |= {f"{prefix}{key}": value for key, value in block_options.items()}
            if prefix:
                self.options |= dict(SPLIT_OPTIONS) | {f"{prefix}ksp_type": "preonly"}
        if len(blocks) == 1 and system.inverses:
            self.options |= SYMMETRIC_OPTIONS
        self._inverses: list[Inverse] = []
        self._reused: list[PETSc.PC] = []
        # Preconditioners of contact blocks, by SOR unless they are factored.
        self._swept: list[PETSc.PC] = []
        self.factored = False
        self._sizes = [v.getSize() for v in blocks.values()]
        self._version = system.version
        self._is_unrated = False
        self._excess_iterations = self._iterations = self._digits = 0.0

    def attach(self, ksp: PETSc.KSP, x: list[PETSc.Vec]) -> None:
        """Set up the preconditioners for the Jacobian at a state, after the options; collective."""
        self._ksp = ksp
        ksp.setConvergenceHistory(reset=True)
        if self.exact:
            with self._timing.phase("factorize"):
                self.exact.renew()
            ksp.setPC(python_pc(self.exact, self._system.comm))
            return
        pc = ksp.getPC()
        self._system.jacobian(x)
        self.matrix.assemble()
        options = PETSc.Options(ksp.getOptionsPrefix()).getAll()
        reused_solvers: list[PETSc.PC] = []
        with self._timing.phase("factorize"):
            if self._is_split and pc.getType() == "fieldsplit":
                block_solvers = self._set_up_gauss_seidel(pc, options)
                reused_solvers = [
                    block_solvers[n]
                    for n in REUSED_BLOCKS
                    if n in block_solvers and n not in self._system.inverses
                ]
            elif len(self._names) == 1 and self._system.inverses:
                pc = self._use_shared_inverse(self._names[0], options)
                block_solvers = {self._names[0]: pc}
            else:
                reused_solvers = [pc]
                block_solvers = {" and ".join(BLOCK_NAMES.get(n, n) for n in self._names): pc}
            coarse = self._system.coarse_space() if self._is_split else None
            if coarse is not None:
                self._deflated = Deflated(pc, self._names, self._system.coarse_space)
                pc = python_pc(self._deflated, self._system.comm)
            ksp.setPC(pc)
            pc.setOperators(self.matrix)
            pc.setUp()
            pc.setUpOnBlocks()
        self._swept = [
            part for part in block_solvers.values() if part.getType() == SWEEP["pc_type"]
        ]
        for part in reused_solvers:
            part.setReusePreconditioner(True)
        self._reused = reused_solvers
        deflated = "; rigid sliding modes deflated" if coarse is not None else ""
        log.info("solver: %s%s", self._description(block_solvers), deflated)

    def _set_up_gauss_seidel(self, pc: PETSc.PC, options: Options) -> dict[str, PETSc.PC]:
        """Gauss-Seidel over the blocks, each with a separate or a shared preconditioner."""
        fields = self.matrix.getNestISs()[0]
        pc.setFieldSplitIS(*zip(self._names, fields, strict=True))
        block_solvers = {}
        for name, block_solver in zip(self._names, pc.getFieldSplitSubKSP(), strict=True):
            if name in self._system.inverses:
                prefix = f"fieldsplit_{name}_"
                block_options = {
                    key[len(prefix) :]: value
                    for key, value in options.items()
                    if key.startswith(prefix)
                }
                block_solver.setPC(self._use_shared_inverse(name, block_options))
            block_solvers[name] = block_solver.getPC()
        return block_solvers

    def _use_shared_inverse(self, name: str, options: Options) -> PETSc.PC:
        inverse = self._system.inverses[name]
        inverse.use({k: v for k, v in options.items() if not k.startswith(("ksp_", "snes_"))})
        inverse.make()
        self._inverses.append(inverse)
        return inverse.pc

    def update(self, x: list[PETSc.Vec]) -> None:
        """Set the Jacobian to a state; rebuild the preconditioners if due."""
        self.observe()
        self._system.jacobian(x)
        self.matrix.assemble()
        if self._excess_iterations > SETUP_ITERATIONS:
            self._version = self._system.version
            self._excess_iterations = self._iterations = self._digits = 0.0
            for inverse in self._inverses:
                inverse.refresh()
            for pc in self._reused:
                pc.setReusePreconditioner(False)
                pc.setUp()
                pc.setReusePreconditioner(True)
        self._is_unrated = True

    def observe(self) -> None:
        """Rate the preconditioners by the iterations of the last linear solve, once for each.

        They are kept until the excess of iterations costs more than rebuilding them.
        """
        if not self._is_unrated:
            return
        self._is_unrated = False
        has_failed = self._ksp.getConvergedReason() < 0
        norms = self._ksp.getConvergenceHistory()
        iterations = max(len(norms) - 1, 0)
        if self._version == self._system.version:
            remedy = self._fall_back() if has_failed else ""
            if remedy:
                log.info("     linear solver did not converge: %s", remedy)
            if iterations and norms[-1] > 0:
                self._iterations += iterations
                self._digits += math.log10(norms[0] / norms[-1])
        elif has_failed:
            self._excess_iterations = math.inf
        elif iterations and norms[-1] > 0:
            usual_iterations = (
                self._iterations / self._digits if self._digits > 0 else USUAL_ITERATIONS
            )
            self._excess_iterations += iterations - usual_iterations * math.log10(
                norms[0] / norms[-1]
            )

    def renew(self) -> None:
        """Rebuild the preconditioners at the next Jacobian."""
        self._excess_iterations = math.inf

    def factor_interfaces(self) -> bool:
        """Factorize contact blocks preconditioned by SOR so far; return whether there are any."""
        if self.factored or not self._swept:
            return False
        self.factored = True
        for pc in self._swept:
            pc.setType(str(INTERFACE["pc_type"]))
            pc.setFactorSolverType(str(INTERFACE["pc_factor_mat_solver_type"]))
        return True

    def sweep_interfaces(self) -> None:
        """Use SOR again for the contact blocks that `factor_interfaces` has factorized."""
        for pc in self._swept if self.factored else ():
            pc.setType(str(SWEEP["pc_type"]))
        self.factored = False

    def _fall_back(self) -> str:
        """Factorize the contact block, then the stiffness; return which, or ""."""
        if self.factor_interfaces():
            return "factorizing the contact block"
        if any([i.fall_back() for i in self._inverses]):
            return "factorizing the stiffness"
        return ""

    def _description(self, block_solvers: Mapping[str, PETSc.PC]) -> str:
        krylov, *kinds = [
            METHOD_NAMES.get(kind, kind)
            for kind in (self._ksp.getType(), *(pc.getType() for pc in block_solvers.values()))
        ]
        sizes = dict(zip(self._names, self._sizes, strict=True))
        blocks = [
            f"{BLOCK_NAMES.get(name, name)} ({sizes.get(name, sum(self._sizes)):,} dofs): {kind}"
            for name, kind in zip(block_solvers, kinds, strict=True)
        ]
        return "; ".join(
            [krylov + (" with field split" if len(block_solvers) > 1 else ""), *blocks]
        )


def condition_number(A: PETSc.Mat) -> float:
    """Condition number of a Jacobian: largest over smallest singular value; collective.

    Estimated to some per cent by power iteration with A^T A, and with its inverse by factors of A.
    The matrix has displacements and jumps, unlike that of a displacement method.

    Raises:
        MemoryError: The factors do not fit into memory.
    """
    A = A.convert("aij", PETSc.Mat())
    factors = PETSc.PC().create(A.comm)
    factors.setOperators(A)
    configure(factors, INTERFACE)
    if factors.getFailedReason() == PETSc.PC.FailedReason.FACTOR_OUTMEMORY:
        raise MemoryError(f"factorization of a matrix of {A.getSize()[0]:,} unknowns")
    x, y = A.createVecs()
    sizes = []
    for apply, apply_transpose in (
        (A.mult, A.multTranspose),
        (factors.apply, factors.applyTranspose),
    ):
        x.setRandom()
        for _ in range(CONDITION_ITERATIONS):
            x.normalize()
            apply(x, y)
            apply_transpose(y, x)
        sizes.append(math.sqrt(x.norm()))
    return sizes[0] * sizes[1]
