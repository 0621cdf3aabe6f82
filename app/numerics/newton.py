"""The bridge to PETSc SNES: one nonlinear solve of a system at its current time.

Newton is semismooth, with the generalized Jacobian of the system; its linear solver is that of
`numerics.krylov`.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from petsc4py import PETSc

import numpy as np

from mantle.errors import StoppedError
from mantle.numerics.active_set import ActiveSet
from mantle.numerics.krylov import Linear
from mantle.numerics.preconditioners import INTERFACE, Options, configure
from mantle.numerics.state import State
from mantle.numerics.system import Measure, System
from mantle.system.timing import Timing

log = logging.getLogger("mantle")

REASONS = PETSc.SNES.ConvergedReason

CONDITION_ITERATIONS = 20

NEWTON: Options = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "bt",
    "snes_linesearch_order": 1,
    # Steps that lead on are halved three times at most (measured); ten halvings lead nowhere.
    "snes_linesearch_minlambda": 1e-3,
    # A short step is no reason to stop: what has converged is decided here alone.
    "snes_stol": 0.0,
    "snes_max_linear_solve_fail": 3,
    "snes_ksp_ew": True,
    "snes_ksp_ew_version": 2,
    "snes_ksp_ew_rtol0": 1e-2,
    "snes_ksp_ew_rtolmax": 1e-2,
}
# While contact points change their states, no direction is worth more.
KINKS: Options = {"snes_ksp_ew_rtol0": 0.1, "snes_ksp_ew_rtolmax": 0.1}
# Absolute tolerance of the linear solver over that of Newton.
ENOUGH = 0.3
# Newton is not converging if the residual has not fallen to this part of itself in so many
# iterations; with full steps it may rise before it falls.
HARDLY, STUCK, STUCK_WHOLE = 0.5, {"bt": 4}, 15
# Residuals that differ by less than this part after a cycle of the states will go on doing so.
CYCLING = 1e-2
# Factors of the augmentation tried in turn, and whether Newton then continues from the current
# state or from the start: mostly the augmentation is too large.
AUGMENTATIONS = ((0.1, True), (0.01, True), (100.0, False), (0.1, False), (0.01, False))
# Factors of the default augmentation, if the case asks for another one and nothing has helped.
USUAL = (1.0, 0.1, 0.01)
# Factors of the friction coefficients, in turn, if Newton does not converge with all of it.
FRICTIONS = (0.25, 0.5, 0.75, 1.0)


@dataclass(frozen=True)
class NewtonResult:
    """Outcome of a nonlinear solve.

    Attributes:
        converged: Whether the residual met its tolerance.
        iterations: Newton iterations.
        linear_iterations: Krylov iterations.
        residuals: Residual norm at each iteration, relative to the force scale.
        flips: Contact points whose state changed, at each iteration.
        linear_failed: Whether the linear solver gave up.
        augmentation: Multiple of the augmentation in force that it ended with.
        tried: What was changed in turn where Newton did not converge, in words, and the residual
            that it ended with.
        period: After how many iterations the states of the contact points came back in the end; 0
            if they did not.
    """

    converged: bool
    iterations: int
    linear_iterations: int
    residuals: tuple[float, ...]
    flips: tuple[int, ...]
    linear_failed: bool
    augmentation: float = 1.0
    tried: tuple[tuple[str, float], ...] = ()
    period: int = 0


class Solver:
    """SNES on a system: vectors, matrices and options, set up once."""

    def __init__(
        self,
        system: System,
        tolerance: float,
        max_iterations: int,
        linear: str,
        options: Options,
        timing: Timing,
        stop: Callable[[], str] = str,
    ) -> None:
        """Create the solver; collective.

        Args:
            system: What is solved.
            tolerance: Residual over scale at which a solve has converged.
            max_iterations: Newton iterations allowed.
            linear: direct, multigrid or auto (by size).
            options: Raw PETSc options, without dash, that override the defaults.
            timing: Where the seconds go.
            stop: Returns the name of a pending stop signal, or "".
        """
        self._system = system
        self._timing = timing
        self._tolerance = tolerance
        self._stop = stop
        blocks = system.blocks()
        self._names = list(blocks)
        self._vectors = list(blocks.values())
        self._linear = Linear(system, linear, timing)
        self._A = self._linear.matrix
        self._has_kinks = "jump" in blocks
        defaults = dict(NEWTON) | {"snes_max_it": max_iterations}
        defaults |= dict(KINKS if self._has_kinks else {}) | dict(system.newton)
        self.options = defaults | self._linear.options | dict(options)
        self.x = self.vector()
        self.failed_state = self.vector()
        self._residuals: list[float] = []
        self._flips: list[int] = []
        self._scales: list[float] = []
        self.snes = PETSc.SNES().create(system.comm)
        self.snes.setOptionsPrefix(system.prefix)
        self.snes.setFunction(self._residual, self.vector())
        self.snes.setJacobian(self._jacobian, self._A)
        self.snes.setMonitor(self._monitor)
        self.snes.setConvergenceTest(self._converged)
        self.snes.getKSP().setMonitor(self._watch)
        self._search = self._usual = str(self.options["snes_linesearch_type"])
        self._other = "basic" if self._usual == "bt" else "bt"
        self._augmentation = 1.0
        self._met = False
        self._enough = 0.0 if "ksp_atol" in options else ENOUGH
        self._configure()

    def begin(self) -> None:
        """Reset to the unloaded state; the matrices stay."""
        self.x.zeroEntries()
        self._linear.sweep_interfaces()
        self._scales, self._augmentation = [], 1.0

    def vector(self) -> PETSc.Vec:
        """A new vector of unknowns, zero."""
        vectors = [v.duplicate() for v in self._vectors]
        for v in vectors:
            v.zeroEntries()
        if len(vectors) == 1:
            return vectors[0]
        return PETSc.Vec().createNest(vectors, comm=self._system.comm)

    def blocks(self, x: PETSc.Vec | None = None) -> list[PETSc.Vec]:
        """Blocks of a state, of the current one by default."""
        x = self.x if x is None else x
        return [x] if len(self._vectors) == 1 else list(x.getNestSubVecs())

    def parts(self, x: PETSc.Vec | None = None) -> tuple[PETSc.Vec, PETSc.Vec | None]:
        """Displacement and jumps, if any, of a state, of the current one by default."""
        named = self.named(x)
        return named["displacement"], named.get("jump")

    def named(self, x: PETSc.Vec | None = None) -> dict[str, PETSc.Vec]:
        """Blocks of a state by name, of the current one by default."""
        return dict(zip(self._names, self.blocks(x), strict=True))

    def pack(self, x: PETSc.Vec) -> State:
        """A vector of unknowns as rows to be saved."""
        return self._system.pack(self.blocks(x))

    def unpack(self, state: State) -> PETSc.Vec:
        """Return the vector of unknowns that a saved state holds."""
        x = self.vector()
        self._system.unpack(state, self.blocks(x))
        return x

    def state(self) -> State:
        """Unknowns, scales of the residuals and augmentation, to be saved."""
        return {
            "x": self.pack(self.x),
            "scales": list(self._scales),
            "augmentation": self._augmentation,
        }

    def resume(self, state: State) -> None:
        """Restore unknowns, scales of residuals and augmentation; collective."""
        self.unpack(state["x"]).copy(self.x)
        self._scales, self._augmentation = state["scales"], state["augmentation"]
        self._system.scale_augmentation(self._augmentation)
        self._linear.renew()

    def _configure(self) -> None:
        """Hand the options to PETSc under the prefix, and take them out of its database again."""
        database = PETSc.Options(self._system.prefix)
        for key, value in self.options.items():
            database[key] = value
        self.snes.setFromOptions()
        self._linear.attach(self.snes.getKSP(), self.blocks())
        for key in self.options:
            database.delValue(key)

    # Callbacks

    def _residual(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        self._system.residual(self.blocks(x), self.blocks(f))

    def _jacobian(self, snes: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        self._linear.update(self.blocks(x))

    def _monitor(self, snes: PETSc.SNES, iteration: int, norm: float) -> None:
        # Every rank sees the same answer, so that none is left waiting for the others.
        names = [name for name in self._system.comm.allgather(self._stop()) if name]
        if names:
            raise StoppedError(f"stopped by {names[0]}")
        self._flips.append(self._system.active.flips())
        self._timing.tell(f"Newton iteration {iteration}, residual {self._residuals[-1]:.1e}")

    def _watch(self, ksp: PETSc.KSP, iteration: int, norm: float) -> None:
        self._timing.tell(f"Newton iteration {len(self._flips)}, Krylov iteration {iteration}")

    def _converged(
        self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]
    ) -> PETSc.SNES.ConvergedReason:
        """Each part below its tolerance, or below what rounding leaves of it."""
        parts = self._measure(snes.getSolution(), snes.getFunction()[0])
        self._residuals.append(max(p.norm / p.scale if p.scale else p.norm for p in parts))
        self._met = all(map(self.meets, parts))
        if self._met:
            return REASONS.CONVERGED_FNORM_ABS
        if self._enough:
            snes.getKSP().setTolerances(atol=self._enough * min(map(self._limit, parts)))
        last, window = self._residuals, STUCK.get(self._search, STUCK_WHOLE)
        stuck = iteration >= window and last[-1] > HARDLY * last[-1 - window]
        # Whole steps from the same states lead to the same states again.
        period = self._system.active.period() if self._search == "basic" and not stuck else 0
        stuck |= period > 0 and abs(last[-1] / last[-1 - period] - 1) < CYCLING
        return REASONS.DIVERGED_LINE_SEARCH if stuck else REASONS.ITERATING

    def meets(self, part: Measure) -> bool:
        """Whether a residual is within the tolerance."""
        return part.norm <= self._limit(part)

    def _limit(self, part: Measure) -> float:
        """Norm that a residual may have."""
        return max(self._tolerance * part.scale, part.rounding)

    def _measure(self, x: PETSc.Vec, f: PETSc.Vec) -> list[Measure]:
        """Residual by part, beside the scale of this state or of the converged ones before it."""
        parts = self._system.measure(self.blocks(x), self.blocks(f))
        known = self._scales or [0.0] * len(parts)
        return [
            replace(p, scale=max(p.scale, s)) if p.lasting else p
            for p, s in zip(parts, known, strict=True)
        ]

    def residual(self, x: PETSc.Vec) -> PETSc.Vec:
        """Impose the supports on a state, then compute its residual; collective."""
        self._system.impose(self.blocks(x))
        f = self.vector()
        self._system.residual(self.blocks(x), self.blocks(f))
        return f

    # Solve

    def solve(self) -> NewtonResult:
        """Solve at the problem's current time, from the current iterate in ``x``."""
        self._system.impose(self.blocks())
        self._residuals, self._flips = [], []
        self._system.scale_augmentation(self._augmentation)
        start = self.x.copy() if self._has_kinks else self.x
        newton, krylov = self._newton()
        tried: list[tuple[str, float]] = []
        for words in self._remedies(start):
            log.info("     %s: %s", self._trouble(), words)
            more = self._newton()
            newton, krylov = newton + more[0], krylov + more[1]
            tried.append((words, self._residuals[-1]))
        augmentation = self._augmentation
        self._use_search(self._usual)
        if self._met:
            self._linear.sweep_interfaces()
            parts = self._measure(self.x, self.snes.getFunction()[0])
            self._scales = [p.scale for p in parts]
        else:
            self.x.copy(self.failed_state)
            self._augmentation = 1.0
        self._linear.observe()
        return NewtonResult(
            converged=self._met,
            iterations=newton,
            linear_iterations=krylov,
            residuals=tuple(self._residuals),
            flips=tuple(self._flips),
            linear_failed=self.snes.getConvergedReason() == REASONS.DIVERGED_LINEAR_SOLVE,
            augmentation=augmentation,
            tried=tuple(tried),
            period=self._system.active.period(),
        )

    def _remedies(self, start: PETSc.Vec) -> Iterator[str]:
        """Apply one remedy after the other while Newton has not converged; yield each in words.

        In this order: interfaces that are open everywhere are tied and released, so that a body
        that a clearance leaves free comes into contact. The contact block is factorized, for SOR
        may give poor directions. The augmentation is scaled: a large one makes contact points
        change state back and forth, and Newton continues from the current state with a smaller one.
        The line search is switched on or off: at a kink of the contact law it may cut steps to
        nothing where full steps converge. Friction starts small and grows. At last an augmentation
        that the case asked for is replaced by the default, for it may be off by powers of ten.
        """
        if not self._met and self._system.tie(True):
            start.copy(self.x)
            try:
                yield "closing and tying interfaces that are open everywhere"
            finally:
                self._system.tie(False)
            yield "releasing the tied interfaces"
        if not self._met and self._linear.factor_interfaces():
            start.copy(self.x)
            yield "factorizing the contact block"
        for factor, on in AUGMENTATIONS:
            if self._met:
                return
            if on and self._lost():
                continue
            if factor != self._augmentation and self._system.scale_augmentation(factor):
                if not on:
                    start.copy(self.x)
                self._augmentation = factor
                yield f"augmentation {factor:g} r{self._values()}"
        if not self._lost() and self._has_kinks:
            self._use_search(self._other)
            yield "full Newton steps" if self._other == "basic" else "line search"
        if not self._met:
            yield from self._with_less_friction(start)
        if self._met or (usual := self._system.usual_augmentation()) == 1.0:
            return
        start.copy(self.x)
        for share in USUAL:
            if self._lost():
                return
            self._augmentation = share * usual
            self._system.scale_augmentation(self._augmentation)
            yield (
                f"augmentation {self._augmentation:.3g} r, {share:g} times the default"
                f"{self._values()}"
            )

    def _with_less_friction(self, start: PETSc.Vec) -> Iterator[str]:
        """Solve from the start with friction that grows in steps to its full value."""
        self._use_search(self._usual)
        self._augmentation = 1.0
        self._system.scale_augmentation(1.0)
        start.copy(self.x)
        try:
            for share in FRICTIONS:
                if not self._system.scale_friction(share) or not np.isfinite(self.x.norm()):
                    return
                yield f"{share:.0%} of the friction coefficients"
        finally:
            self._system.scale_friction(1.0)

    def _lost(self) -> bool:
        """Whether no remedy applies: converged, or the current state is not finite."""
        return self._met or not np.isfinite(self.x.norm())

    def _trouble(self) -> str:
        """How far Newton got, in words."""
        if self._met:
            return "converged"
        changing = ""
        if self._flips[-1]:
            changing = f"; {self._flips[-1]} contact points still change state"
        if period := self._system.active.period():
            changing += f", in a cycle of {period} iterations"
        return f"not converging (residual {self._residuals[-1]:.1e}{changing})"

    def _values(self) -> str:
        """The augmentation in force, in words; collective."""
        found = self._system.augmentation().values()
        return f" (up to {max(found):.3g} MPa/mm)" if found else ""

    def _newton(self) -> tuple[int, int]:
        """Iterate from the current state; Newton and Krylov iterations."""
        self._system.active.forget()
        self._met = False
        with self._timing.phase("solve"):
            try:
                self.snes.solve(None, self.x)
            except PETSc.Error as error:
                # What a callback raised comes back wrapped.
                raise error.__cause__ or error from None
        if self.snes.getConvergedReason() == REASONS.DIVERGED_FNORM_NAN:
            # PETSc calls neither monitor nor test with a residual that is not a number.
            self._residuals.append(math.nan)
            self._flips.append(0)
        return self.snes.getIterationNumber(), self.snes.getLinearSolveIterations()

    def _use_search(self, kind: str) -> None:
        """Use a line search of PETSc: ``bt``, or ``basic`` for full steps."""
        if kind == self._search:
            return
        database = PETSc.Options(self._system.prefix)
        self._search = kind
        # One of another type begins with the defaults of PETSc: it needs all options again.
        settings = {k: v for k, v in self.options.items() if k.startswith("snes_linesearch_")}
        settings |= {"snes_linesearch_type": kind}
        for key, value in settings.items():
            database[key] = value
        self.snes.setFromOptions()
        for key in settings:
            database.delValue(key)

    def condition(self) -> float:
        """Condition of the last Jacobian: largest over smallest singular value; collective.

        By power iteration with A^T A, and with its inverse by factors of A: an estimate, good to
        some per cent. One matrix in displacements and jumps, not what a displacement method has.

        Raises:
            MemoryError: There is none for the factors.
        """
        A = self._A.convert("aij", PETSc.Mat())
        factors = PETSc.PC().create(A.comm)
        factors.setOperators(A)
        configure(factors, INTERFACE)
        if factors.getFailedReason() == PETSc.PC.FailedReason.FACTOR_OUTMEMORY:
            raise MemoryError(f"factorization of a matrix of {A.getSize()[0]:,} unknowns")
        x, y = A.createVecs()
        sizes = []
        for apply, back in ((A.mult, A.multTranspose), (factors.apply, factors.applyTranspose)):
            x.setRandom()
            for _ in range(CONDITION_ITERATIONS):
                x.normalize()
                apply(x, y)
                back(y, x)
            sizes.append(math.sqrt(x.norm()))
        return sizes[0] * sizes[1]

    @property
    def active(self) -> ActiveSet:
        """States of the contact points at the last Jacobians."""
        return self._system.active

    @property
    def block_sizes(self) -> dict[str, int]:
        """Unknowns by block."""
        return {n: v.getSize() for n, v in zip(self._names, self._vectors, strict=True)}
