"""The bridge to PETSc SNES: Newton's method on a system, its options and when it has converged.

Newton is semismooth, with the generalized Jacobian of the system; its linear solver is that of
`numerics.krylov`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from petsc4py import PETSc

from app.errors import StoppedError
from app.numerics.krylov import Linear
from app.numerics.preconditioners import Options
from app.numerics.system import Measure, System
from app.system.timing import Timing

REASONS = PETSc.SNES.ConvergedReason

NEWTON: Options = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "bt",
    "snes_linesearch_order": 1,
    # Steps that lead on are halved three times at most (measured); ten halvings lead nowhere.
    "snes_linesearch_minlambda": 1e-3,
    # A short step is no reason to stop: what has converged is decided here alone.
    "snes_stol": 0.0,
    "snes_max_linear_solve_fail": 3,
}
# Tolerance of the linear solver while contact points change their states, when less than a part of
# them, few, do, and the power with which it falls with the residual (Eisenstat and Walker 1996).
ROUGH, FEW, FINE, POWER = 0.1, 0.01, 0.01, (1 + math.sqrt(5)) / 2
# When no states change and the residual is below this, the next one is some times its square.
NEAR, SQUARE = 0.01, 100.0
# Tolerances of the linear solver over those of Newton: the absolute one, and one that suffices.
ENOUGH, SUFFICES = 0.3, 0.2
# Newton is not converging if the residual has not fallen to this part of itself in so many
# iterations; with full steps it may rise before it falls.
HARDLY, STUCK, STUCK_WHOLE = 0.5, {"bt": 4}, 15
# Residuals that differ by less than this part after a cycle of the states will go on doing so.
CYCLING = 1e-2


class Snes:
    """SNES on a system: vectors, matrices and options, set up once.

    Attributes:
        x: The current state.
        snes: The solver of PETSc.
        options: Its options.
        linear: Its linear solver.
        has_kinks: Whether there are contact points, whose states change.
        usual: The line search of the options.
        met: Whether the last run converged.
        residuals: Residual norms of the last runs, relative to the scale.
        flips: Contact points whose state changed, at each iterate.
        scales: Of the residuals of the last converged state, by part.
        tolerance: Residual over scale at which a run has converged.
    """

    def __init__(
        self,
        system: System,
        tolerance: float,
        max_iterations: int,
        linear: str,
        options: Options,
        timing: Timing,
        stop: Callable[[], str],
    ) -> None:
        """Set SNES up; collective.

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
        self.tolerance = tolerance
        self._stop = stop
        blocks = system.blocks()
        self._vectors = list(blocks.values())
        self.linear = Linear(system, linear, timing)
        self.has_kinks = "jump" in blocks
        defaults = dict(NEWTON) | {"snes_max_it": max_iterations}
        defaults |= dict(system.newton)
        self.options = defaults | self.linear.options | dict(options)
        self.x = self.vector()
        self.residuals: list[float] = []
        self.flips: list[int] = []
        self.scales: list[float] = []
        self.met = False
        self.snes = PETSc.SNES().create(system.comm)
        self.snes.setOptionsPrefix(system.prefix)
        self.snes.setFunction(self._residual, self.vector())
        self.snes.setJacobian(self._jacobian, self.linear.matrix)
        self.snes.setMonitor(self._monitor)
        self.snes.setConvergenceTest(self._converged)
        self.snes.getKSP().setMonitor(self._watch)
        self._search = self.usual = str(self.options["snes_linesearch_type"])
        self._enough = 0.0 if "ksp_atol" in options else ENOUGH
        self._follows = self.has_kinks and "ksp_rtol" not in options
        self._configure()

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

    def _configure(self) -> None:
        """Hand the options to PETSc under the prefix, and take them out of its database again."""
        database = PETSc.Options(self._system.prefix)
        for key, value in self.options.items():
            database[key] = value
        self.snes.setFromOptions()
        self.linear.attach(self.snes.getKSP(), self.blocks())
        for key in self.options:
            database.delValue(key)

    # Callbacks

    def _residual(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        self._system.residual(self.blocks(x), self.blocks(f))

    def _jacobian(self, snes: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        self.linear.update(self.blocks(x))

    def _monitor(self, snes: PETSc.SNES, iteration: int, norm: float) -> None:
        # Every rank sees the same answer, so that none is left waiting for the others.
        names = [name for name in self._system.comm.allgather(self._stop()) if name]
        if names:
            raise StoppedError(f"stopped by {names[0]}")
        told = f"Newton iteration {iteration}, residual {self.residuals[-1]:.1e}"
        self._timing.tell(told, blocking=iteration == 0)

    def _watch(self, ksp: PETSc.KSP, iteration: int, norm: float) -> None:
        self._timing.tell(f"Newton iteration {len(self.flips) - 1}, Krylov iteration {iteration}")

    def _converged(
        self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]
    ) -> PETSc.SNES.ConvergedReason:
        """Each part below its tolerance, or below what rounding leaves of it."""
        parts = self.measure(snes.getSolution(), snes.getFunction()[0])
        self.residuals.append(max(p.norm / p.scale if p.scale else p.norm for p in parts))
        self._system.look()
        self.flips.append(self._system.active.flips())
        self.met = all(map(self.meets, parts))
        if self.met:
            return REASONS.CONVERGED_FNORM_ABS
        if self._enough:
            snes.getKSP().setTolerances(atol=self._enough * min(map(self._limit, parts)))
        if self._follows:
            snes.getKSP().setTolerances(rtol=self._linear_tolerance(iteration, parts))
        last, window = self.residuals, STUCK.get(self._search, STUCK_WHOLE)
        stuck = iteration >= window and last[-1] > HARDLY * last[-1 - window]
        # Whole steps from the same states lead to the same states again.
        period = self._system.active.period() if self._search == "basic" and not stuck else 0
        stuck |= period > 0 and abs(last[-1] / last[-1 - period] - 1) < CYCLING
        return REASONS.DIVERGED_LINE_SEARCH if stuck else REASONS.ITERATING

    def _linear_tolerance(self, iteration: int, parts: list[Measure]) -> float:
        """Relative tolerance of the next linear solve: less where its step leads to other states.

        Args:
            iteration: Newton iterations so far.
            parts: The residual.
        """
        last = self.residuals
        if not iteration or not self._few():
            return ROUGH
        eta = min(FINE, (last[-1] / last[-2]) ** POWER)
        if self.flips[-1] or last[-1] > NEAR:
            return eta
        suffices = SUFFICES / max(p.norm / self._limit(p) for p in parts)
        return min(eta, max(suffices, SQUARE * last[-1]))

    def _few(self) -> bool:
        """Whether only few contact points have just changed their states; collective."""
        return self.flips[-1] < FEW * self._system.active.points()

    def meets(self, part: Measure) -> bool:
        """Whether a residual is within the tolerance."""
        return part.norm <= self._limit(part)

    def _limit(self, part: Measure) -> float:
        """Norm that a residual may have."""
        return max(self.tolerance * part.scale, part.rounding)

    def measure(self, x: PETSc.Vec, f: PETSc.Vec) -> list[Measure]:
        """Residual by part, beside the scale of this state or of the converged ones before it."""
        parts = self._system.measure(self.blocks(x), self.blocks(f))
        known = self.scales or [0.0] * len(parts)
        return [
            replace(p, scale=max(p.scale, s)) if p.lasting else p
            for p, s in zip(parts, known, strict=True)
        ]

    def step(self) -> tuple[int, int]:
        """One whole step from the current state, solved roughly; Newton and Krylov iterations."""
        f, dx, ksp = self.vector(), self.vector(), self.snes.getKSP()
        with self._timing.phase("solve"):
            self._system.residual(self.blocks(), self.blocks(f))
            self.linear.update(self.blocks())
            if self._follows:
                ksp.setTolerances(rtol=ROUGH)
            ksp.setOperators(self.linear.matrix)
            ksp.solve(f, dx)
        if math.isfinite(dx.norm()):
            self.x.axpy(-1.0, dx)
        return 1, int(ksp.getIterationNumber())

    def run(self) -> tuple[int, int]:
        """Iterate from the current state; Newton and Krylov iterations."""
        self._system.active.forget()
        self.met = False
        with self._timing.phase("solve"):
            try:
                self.snes.solve(None, self.x)
            except PETSc.Error as error:
                # What a callback raised comes back wrapped.
                raise error.__cause__ or error from None
        if self.snes.getConvergedReason() == REASONS.DIVERGED_FNORM_NAN:
            # PETSc calls neither monitor nor test with a residual that is not a number.
            self.residuals.append(math.nan)
            self.flips.append(0)
        return self.snes.getIterationNumber(), self.snes.getLinearSolveIterations()

    def use_search(self, kind: str) -> None:
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


def raw_options(arguments: Sequence[str]) -> dict[str, str]:
    """PETSc options from the command line: ``-name value`` or ``-name``."""
    options: dict[str, str] = {}
    key = ""
    for word in arguments:
        if word.startswith("-") and not word[1:2].isdigit():
            key = word.lstrip("-")
            options[key] = ""
        elif key:
            options[key], key = word, ""
    return options
