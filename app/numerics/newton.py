"""One nonlinear solve of a system at its current time, and what is tried when it fails."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

from app.arrays import Floats
from app.numerics.active_set import ActiveSet
from app.numerics.preconditioners import Options
from app.numerics.saved_state import State
from app.numerics.snes import REASONS, Snes
from app.numerics.system import Measure, System
from app.system.timing import Timing

log = logging.getLogger("mantle")

# Factors of the augmentation tried in turn, and whether Newton then continues from the current
# state or from the start: mostly the augmentation is too large.
AUGMENTATIONS = ((0.1, True), (0.01, True), (100.0, False), (0.1, False), (0.01, False))
# Factors of the default augmentation, if the case asks for another one and nothing has helped.
USUAL = (1.0, 0.1, 0.01)


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
    """Newton on a system, with its current state and remedies where it does not converge.

    Attributes:
        x: The current state.
        failed_state: Where the last solve that failed ended.
        snes: The solver of PETSc.
        options: Its options.
    """

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
        self._newton = Snes(system, tolerance, max_iterations, linear, options, timing, stop)
        self._names = list(system.blocks())
        self.x, self.snes = self._newton.x, self._newton.snes
        self.options = self._newton.options
        self.failed_state = self.vector()
        self._other = "basic" if self._newton.usual == "bt" else "bt"
        self._augmentation = 1.0
        self._forces: Floats | None = None

    def begin(self, tolerance: float) -> None:
        """Reset to the unloaded state; the matrices stay.

        Args:
            tolerance: Residual over scale at which a solve has converged from now on.
        """
        self.x.zeroEntries()
        self._newton.linear.sweep_interfaces()
        self._newton.scales, self._newton.tolerance = [], tolerance
        self._augmentation = 1.0

    def vector(self) -> PETSc.Vec:
        """A new vector of unknowns, zero."""
        return self._newton.vector()

    def blocks(self, x: PETSc.Vec | None = None) -> list[PETSc.Vec]:
        """Blocks of a state, of the current one by default."""
        return self._newton.blocks(x)

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
            "scales": list(self._newton.scales),
            "augmentation": self._augmentation,
        }

    def resume(self, state: State) -> None:
        """Restore unknowns, scales of residuals and augmentation; collective."""
        self.unpack(state["x"]).copy(self.x)
        self._newton.scales, self._augmentation = state["scales"], state["augmentation"]
        self._system.scale_augmentation(self._augmentation)
        self._newton.linear.renew()

    def meets(self, part: Measure) -> bool:
        """Whether a residual is within the tolerance."""
        return self._newton.meets(part)

    def residual(self, x: PETSc.Vec) -> PETSc.Vec:
        """Impose the supports on a state, then compute its residual; collective."""
        self._system.impose(self.blocks(x))
        f = self.vector()
        self._system.residual(self.blocks(x), self.blocks(f))
        return f

    def lead(self, forces: Floats) -> None:
        """Begin the next solve with a step in displacement, jumps and interface forces.

        Args:
            forces: Where it begins, beside ``x``: forces at own contact points (n, 3) [MPa].
        """
        self._forces = forces

    def _led(self) -> tuple[int, int]:
        """That step, if it was asked for; Newton and Krylov iterations."""
        forces, self._forces = self._forces, None
        if forces is None:
            return 0, 0
        self._system.linearize_at(forces)
        try:
            return self._newton.step()
        finally:
            self._system.linearize_at(None)

    def solve(self) -> NewtonResult:
        """Solve at the problem's current time, from the current iterate in ``x``."""
        self._system.impose(self.blocks())
        self._newton.residuals, self._newton.flips = [], []
        self._system.scale_augmentation(self._augmentation)
        newton, krylov = self._led()
        start = self.x.copy() if self._newton.has_kinks else self.x
        more = self._newton.run()
        newton, krylov = newton + more[0], krylov + more[1]
        tried: list[tuple[str, float]] = []
        for words in self._remedies(start):
            log.info("     %s: %s", self._trouble(), words)
            more = self._newton.run()
            newton, krylov = newton + more[0], krylov + more[1]
            tried.append((words, self._newton.residuals[-1]))
        augmentation = self._augmentation
        self._newton.use_search(self._newton.usual)
        if self._newton.met:
            self._newton.linear.sweep_interfaces()
            parts = self._newton.measure(self.x, self.snes.getFunction()[0])
            self._newton.scales = [p.scale for p in parts]
        else:
            self.x.copy(self.failed_state)
            self._augmentation = 1.0
        self._newton.linear.observe()
        return NewtonResult(
            converged=self._newton.met,
            iterations=newton,
            linear_iterations=krylov,
            residuals=tuple(self._newton.residuals),
            flips=tuple(self._newton.flips),
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
        nothing where full steps converge. At last an augmentation that the case asked for is
        replaced by the default, for it may be off by powers of ten.
        """
        if not self._newton.met and self._system.tie(True):
            start.copy(self.x)
            try:
                yield "closing and tying interfaces that are open everywhere"
            finally:
                self._system.tie(False)
            yield "releasing the tied interfaces"
        if not self._newton.met and self._newton.linear.factor_interfaces():
            start.copy(self.x)
            yield "factorizing the contact block"
        for factor, on in AUGMENTATIONS:
            if self._newton.met:
                return
            if on and self._lost():
                continue
            if factor != self._augmentation and self._system.scale_augmentation(factor):
                if not on:
                    start.copy(self.x)
                self._augmentation = factor
                yield f"augmentation {factor:g} r{self._values()}"
        if not self._lost() and self._newton.has_kinks:
            self._newton.use_search(self._other)
            yield "full Newton steps" if self._other == "basic" else "line search"
        if self._newton.met or (usual := self._system.usual_augmentation()) == 1.0:
            return
        self._newton.use_search(self._newton.usual)
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

    def _lost(self) -> bool:
        """Whether no remedy applies: converged, or the current state is not finite."""
        return self._newton.met or not np.isfinite(self.x.norm())

    def _trouble(self) -> str:
        """How far Newton got, in words."""
        if self._newton.met:
            return "converged"
        changing = ""
        if self._newton.flips[-1]:
            changing = f"; {self._newton.flips[-1]} contact points still change state"
        if period := self._system.active.period():
            changing += f", in a cycle of {period} iterations"
        return f"not converging (residual {self._newton.residuals[-1]:.1e}{changing})"

    def _values(self) -> str:
        """The augmentation in force, in words; collective."""
        found = self._system.augmentation().values()
        return f" (up to {max(found):.3g} MPa/mm)" if found else ""

    @property
    def met(self) -> bool:
        """Whether the last solve, if there was one, has converged."""
        return self._newton.met

    @property
    def active(self) -> ActiveSet:
        """States of the contact points at the last Jacobians."""
        return self._system.active

    @property
    def block_sizes(self) -> dict[str, int]:
        """Unknowns by block."""
        return {n: v.getSize() for n, v in self.named().items()}
