"""Newton's method on a system by PETSc SNES: the loop, its line search and its stop criterion.

Newton is semismooth, with the generalized Jacobian of the system. The system passes its linear
solver: a Krylov method (`numerics.krylov`) or an exact inverse (`numerics.condensed`; for steps of
given energy `stepping.energy_control`). If an exact inverse eliminates linear unknowns, the loop
runs on the reduced system first, then on the whole one from there. `numerics.remedies` handles
failures.
"""

from __future__ import annotations

import ctypes
import logging
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from app.foundation.arrays import Ints
from app.foundation.errors import InputError, StoppedError
from app.numerics.krylov import BLOCK_NAMES, Linear
from app.numerics.lifetime import clean_up, weak
from app.numerics.preconditioners import PETSC, USED_OPTIONS, Options, options_set
from app.numerics.system import Measure, Reduced, System
from app.system.timing import Timing

log = logging.getLogger("mantle")

OUT_OF_MEMORY = 55  # PETSc's error
# Its reason for a residual that is not finite, which changed its name in 3.25.
NOT_FINITE = -4
REASONS = PETSc.SNES.ConvergedReason

NEWTON: Options = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "bt",
    "snes_linesearch_order": 1,
    # Useful steps are halved three times at most (measured); ten halvings lead nowhere.
    "snes_linesearch_minlambda": 1e-3,
    # A short step does not end the iteration: `_test` alone decides on convergence.
    "snes_stol": 0.0,
    "snes_max_linear_solve_fail": 3,
}
# Tolerance of the linear solver while contact points change their states.
LOOSE_TOLERANCE = 0.1
# Fraction of the contact points that counts as few.
FEW_POINTS = 0.01
# Largest tolerance of the linear solver while few change.
FINE_TOLERANCE = 0.01
# Power with which the tolerance falls with the residual (Eisenstat and Walker 1996).
TOLERANCE_POWER = (1 + math.sqrt(5)) / 2
# Residual below which Newton's method converges quadratically, if no states change.
QUADRATIC_RANGE = 0.01
# The next residual is this number times the square of the last one.
QUADRATIC_FACTOR = 100.0
# Absolute tolerance of the linear solver over that of Newton.
ABSOLUTE_TOLERANCE = 0.3
# Tolerance of the linear solver that suffices for the last iteration, over that of Newton.
LAST_TOLERANCE = 0.2
# Newton stalls if neither the residual nor the number of points that change state has fallen to
# this fraction of itself in a number of iterations. While fewer and fewer points change, the
# residual may stay before it falls (stance with cells of 4 mm: six iterations).
STALLED_RATIO = 0.5
# The number of iterations with backtracking.
STALLED_BACKTRACKS = 4
# The number with full steps, with which the residual may rise before it falls.
STALLED_FULL_STEPS = 15
# Residuals that differ by less than this part after a cycle of the states repeat.
SAME_RESIDUAL = 1e-2
# Number of iterates before the last one whose contact states are kept.
KEPT_ITERATES = 12
# The longest cycle that is recognized.
LONGEST_CYCLE = 5


class ActiveSet:
    """Active set: states of the contact points of this rank at the last iterates."""

    def __init__(self, comm: MPI.Comm) -> None:
        self._comm = comm
        self._states: list[Ints] = []

    def forget(self) -> None:
        """Forget all states before a new run."""
        self._states = []

    def add(self, status: Ints) -> None:
        """Append the states (n,) at an iterate."""
        self._states = [*self._states[-KEPT_ITERATES:], status.copy()]

    def points(self) -> int:
        """Number of points on all ranks; collective."""
        return int(self._comm.allreduce(len(self._states[-1]) if self._states else 0, MPI.SUM))

    def changes(self) -> int:
        """Number of points whose state changed between the last two iterates; collective."""
        changed_points = (
            int((self._states[-1] != self._states[-2]).sum()) if len(self._states) > 1 else 0
        )
        return int(self._comm.allreduce(changed_points, MPI.SUM))

    def period(self) -> int:
        """Length of the cycle in which all states repeat, seen twice; 0 without; collective."""
        states = self._states
        for period in range(2, LONGEST_CYCLE + 1):
            repeats = len(states) > 2 * period and all(
                np.array_equal(states[-1 - k], states[-1 - k - period]) for k in range(period + 1)
            )
            if self._comm.allreduce(repeats, MPI.LAND):
                alternates = not np.array_equal(states[-1], states[-2])
                return period if self._comm.allreduce(alternates, MPI.LOR) else 0
        return 0

    def oscillating(self) -> list[tuple[int, int, int, tuple[int, ...]]]:
        """Local points that changed their state last, those with most changes first.

        Tuples: row, number of changes, iterations counted, states.
        """
        if len(self._states) < 2:
            return []
        states = np.array(self._states)
        change_counts = (states[1:] != states[:-1]).sum(axis=0)
        # Points without recent changes are left out.
        changed_recently = (
            (states[-2:] != states[-3:-1]).any(axis=0) if len(states) > 2 else change_counts > 0
        )
        rows = np.flatnonzero(changed_recently)
        return [
            (
                int(k),
                int(change_counts[k]),
                len(states) - 1,
                tuple(sorted(s for s, _ in Counter(map(int, states[:, k])).most_common(3))),
            )
            for k in rows[np.argsort(-change_counts[rows], kind="stable")]
        ]


@dataclass(frozen=True)
class NewtonResult:
    """Outcome of a nonlinear solve.

    Attributes:
        converged: True if the residual is below its tolerance.
        iterations: Newton iterations.
        linear_iterations: Krylov iterations.
        residuals: Residual norm at each iteration, relative to the force scale.
        changes: Number of contact points that changed state, at each iteration.
        linear_failed: True if the linear solver failed.
        augmentation: Factor on `PointLaws.unscaled_augmentation`, that of the case, with which the
            state was solved.
        tried: Remedies in the order tried, each with its last residual; infinite if it converged.
        period: Length of the cycle in which contact states repeat at the end; 0 without.
    """

    converged: bool
    iterations: int
    linear_iterations: int
    residuals: tuple[float, ...]
    changes: tuple[int, ...]
    linear_failed: bool
    augmentation: float = 1.0
    tried: tuple[tuple[str, float], ...] = ()
    period: int = 0


class Solver:
    """Newton's method on a system, with its current state; made collectively.

    Attributes:
        x: The current state.
        failed_state: Last state of the last solve that failed.
        first_state: State at which plain Newton ended in the last solve.
        options: PETSc options of the SNES.
        active: States of the contact points at the last iterates.
        converged: True if the last run converged.
        residuals: Residual norm at each iterate of the last runs, relative to the scale.
        changes: Number of contact points that changed state, at each iterate.
        scales: Scales of the residuals of the last converged state, by part.
        tolerance: Residual over scale at which a run has converged.
        augmentation: The same factor at the start of the next solve: that of the last remedy by
            augmentation, and 1 after a solve that failed.
        timing: Seconds by phase.
        stop: Returns the name of a pending stop signal, or "".
        reduced: Solver of the system in which linear unknowns are eliminated, if there is one.

    Args:
        max_iterations: Newton iterations allowed in a run.
    """

    saved = ("scales", "augmentation")

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
        self.system, self.tolerance = system, tolerance
        self.active = ActiveSet(system.comm)
        self.timing, self.stop = timing, stop
        self._block_templates = system.blocks()
        self.linear = Linear(system, linear, options, timing)
        defaults = NEWTON | {"snes_max_it": max_iterations} | {**system.newton}
        self.options = defaults | self.linear.options | options
        self._line_search = self.usual_search
        self.x, self.failed_state, self.first_state = (self.vector() for _ in range(3))
        # It takes the place of a solution that an interrupted solve leaves locked. An error on one
        # rank lets no new vector be made: that is collective.
        self._spare_vector: PETSc.Vec | None = None
        self.residuals: list[float] = []
        self.changes: list[int] = []
        self.scales: list[float] = []
        self.converged = False
        self.augmentation = 1.0
        inverse = self.linear.exact
        self._reduced_system = inverse.reduced if inverse else None
        self.reduced: Solver | None = None
        if self._reduced_system is not None:
            settings = tolerance, max_iterations, linear, options, timing, stop
            self.reduced = Solver(self._reduced_system, *settings)
        snes = self.snes = PETSc.SNES().create(system.comm)
        snes.setOptionsPrefix(system.prefix)
        snes.setFunction(weak(self._function), self.vector())
        snes.setJacobian(weak(self._jacobian), self.linear.matrix)
        snes.setMonitor(weak(self._monitor))
        snes.setUpdate(weak(self._update))
        snes.setConvergenceTest(weak(self._test))
        try:
            with options_set(system.prefix, self.options):
                snes.setFromOptions()
                self.linear.attach(snes.getKSP(), self.blocks())
            if len(self._block_templates) == 1 and system.inverses:
                # SNES would set the shared inverse up once more; petsc4py has no such call.
                PETSC.SNESSetLagPreconditioner(ctypes.c_void_p(snes.handle), -1)
        except PETSc.Error as error:
            if not options or error.ierr == OUT_OF_MEMORY:
                raise
            option_text = " ".join(f"-{key} {value}".rstrip() for key, value in options.items())
            reason = str(error).strip().splitlines()[-1].removeprefix("[0] ")
            raise InputError(f"PETSc cannot use its options ({option_text}): {reason}") from error

    # States

    def vector(self) -> PETSc.Vec:
        """A new vector of unknowns, zero."""
        vectors = [v.duplicate() for v in self._block_templates.values()]
        for v in vectors:
            v.zeroEntries()
        if len(vectors) == 1:
            return vectors[0]
        return PETSc.Vec().createNest(vectors, comm=self.system.comm)

    def blocks(self, x: PETSc.Vec | None = None) -> list[PETSc.Vec]:
        """Blocks of a state, by default the current one."""
        x = self.x if x is None else x
        return [x] if len(self._block_templates) == 1 else list(x.getNestSubVecs())

    def blocks_by_name(self, x: PETSc.Vec | None = None) -> dict[str, PETSc.Vec]:
        """Blocks of a state by name, by default the current one."""
        return dict(zip(self._block_templates, self.blocks(x), strict=True))

    def u_and_q(self, x: PETSc.Vec | None = None) -> tuple[PETSc.Vec, PETSc.Vec | None]:
        """Displacement and jumps, if any, of a state, by default the current one."""
        blocks = self.blocks_by_name(x)
        return blocks["displacement"], blocks.get("jump")

    @property
    def block_sizes(self) -> dict[str, int]:
        """Unknowns by block."""
        return {name: v.getSize() for name, v in self._block_templates.items()}

    def begin(self, tolerance: float) -> None:
        """Reset to the unloaded state, with a tolerance of the residual; matrices are kept."""
        self.x.zeroEntries()
        self.linear.sweep_interfaces()
        self.scales, self.tolerance, self.augmentation = [], tolerance, 1.0

    def restored(self) -> None:
        """Apply the restored augmentation; the preconditioners are rebuilt."""
        if self.system.contact:
            self.system.contact.laws.scale_augmentation(self.augmentation)
        self.linear.renew()

    # Residual

    def residual(self, x: PETSc.Vec) -> PETSc.Vec:
        """Impose the supports on a state, then compute its residual; collective."""
        self.system.impose(self.blocks(x))
        f = self.vector()
        self.system.residual(self.blocks(x), self.blocks(f))
        return f

    def measure(self, x: PETSc.Vec, f: PETSc.Vec) -> list[Measure]:
        """Residual by part, with the scale of this state or of earlier converged ones."""
        measures = self.system.measure(self.blocks(x), self.blocks(f))
        earlier_scales = self.scales or [0.0] * len(measures)
        return [
            replace(p, scale=max(p.scale, s)) if p.lasting else p
            for p, s in zip(measures, earlier_scales, strict=True)
        ]

    def jacobian(self) -> PETSc.Mat:
        """Assemble the Jacobian at the current state; collective.

        A condensed solver has not assembled it, because it iterates on the reduced system.
        """
        self.linear.update(self.blocks())
        return self.linear.matrix

    # Iterations

    def run(self) -> tuple[int, int]:
        """Iterate from the current state; return Newton and Krylov iterations."""
        self.active.forget()
        self.converged = False
        self._spare_vector = self._spare_vector or self.vector()
        reduced_iterations = 0
        with self.timing.phase("solve"):
            if self.reduced and self._reduced_system:
                reduced_iterations = self._run_reduced(self.reduced, self._reduced_system)
            try:
                self.snes.solve(None, self.x)
            except PETSc.Error as error:
                # Exceptions raised in a callback come back wrapped, and leave the solution locked.
                self.x.copy(self._spare_vector)
                self.x, self._spare_vector = self._spare_vector, None
                raise error.__cause__ or error from None
        clean_up(self.system.comm)
        if self.snes.getConvergedReason() == NOT_FINITE:
            # PETSc calls neither monitor nor test if the residual is not finite.
            self.residuals.append(math.nan)
            self.changes.append(0)
        return (
            reduced_iterations + self.snes.getIterationNumber(),
            self.snes.getLinearSolveIterations(),
        )

    def _run_reduced(self, solver: Solver, system: Reduced) -> int:
        """Iterate on the reduced system, from and to the current state; return the iterations.

        The state stays if the reduced system ends with one that is not finite.
        """
        solver.residuals, solver.changes, solver.tolerance = [], [], self.tolerance
        system.begin(self.blocks(), self.tolerance).copy(solver.x)
        iterations, _ = solver.run()
        if np.isfinite(solver.x.norm()) and np.isfinite(solver.residuals[-1:]).all():
            system.end(self.blocks(), solver.x)
        self.residuals += solver.residuals
        self.changes += solver.changes
        return iterations

    @property
    def usual_search(self) -> str:
        """Line search in the options."""
        return str(self.options["snes_linesearch_type"])

    def use_search(self, kind: str) -> None:
        """Use a line search of PETSc: ``bt``, or ``basic`` for full steps."""
        if self.reduced:
            self.reduced.use_search(kind)
        if kind == self._line_search:
            return
        self._line_search = kind
        # A new line search has PETSc's defaults: it needs all options again.
        settings = {k: v for k, v in self.options.items() if k.startswith("snes_linesearch_")}
        with options_set(self.system.prefix, settings | {"snes_linesearch_type": kind}):
            self.snes.setFromOptions()

    # Callbacks

    def _function(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        self.system.residual(self.blocks(x), self.blocks(f))

    def _jacobian(self, snes: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, P: PETSc.Mat) -> None:
        self.linear.update(self.blocks(x))

    def _update(self, snes: PETSc.SNES, iteration: int) -> None:
        # A singular step may move free bodies far away, where rounding errors hide other forces.
        if iteration:
            self.system.remove_free_motions(self.blocks(snes.getSolution()))

    def _monitor(self, snes: PETSc.SNES, iteration: int, norm: float) -> None:
        # Every rank sees the same signal, so that none is left waiting for the others.
        signal_names = [name for name in self.system.comm.allgather(self.stop()) if name]
        if signal_names:
            raise StoppedError(f"stopped by {signal_names[0]}")
        log.debug("     Newton iteration %d, residual %.1e", iteration, self.residuals[-1])

    def _test(
        self, snes: PETSc.SNES, iteration: int, norms: tuple[float, float, float]
    ) -> PETSc.SNES.ConvergedReason:
        """Test whether each part is below its tolerance or its rounding, and no body runs away."""
        measures = self.measure(snes.getSolution(), snes.getFunction()[0])
        self.residuals.append(max(p.norm / p.scale if p.scale else p.norm for p in measures))
        self.active.add(self.system.status)
        self.changes.append(self.active.changes())
        limits = [p.limit(self.tolerance) for p in measures]
        is_small = all(p.norm <= limit for p, limit in zip(measures, limits, strict=True))
        if iteration < self.system.min_iterations:
            is_small = all(p.norm == 0.0 for p in measures)
        self.converged = is_small and not self.system.runs_away(self.blocks(snes.getSolution()))
        if self.converged:
            return REASONS.CONVERGED_FNORM_ABS
        if "ksp_atol" not in self.options:
            snes.getKSP().setTolerances(atol=ABSOLUTE_TOLERANCE * min(limits))
        if self._adapts_tolerance:
            snes.getKSP().setTolerances(rtol=self._linear_tolerance(iteration, measures))
        return REASONS.DIVERGED_LINE_SEARCH if self._has_stalled(iteration) else REASONS.ITERATING

    def _has_stalled(self, iteration: int) -> bool:
        """Return True if more iterations like the last ones do not help."""
        residuals, changes = self.residuals, self.changes
        window = STALLED_BACKTRACKS if self._line_search == "bt" else STALLED_FULL_STEPS
        if iteration >= window:
            stays = residuals[-1] > STALLED_RATIO * residuals[-1 - window]
            if stays and changes[-1] >= STALLED_RATIO * changes[-1 - window]:
                return True
        if self._line_search != "basic":
            return False
        # Full steps from the same states lead to the same states again.
        period = self.active.period()
        return period > 0 and abs(residuals[-1] / residuals[-1 - period] - 1) < SAME_RESIDUAL

    @property
    def _adapts_tolerance(self) -> bool:
        """True if the tolerance of the linear solver follows the residual."""
        return self.system.contact is not None and "ksp_rtol" not in self.options

    def _linear_tolerance(self, iteration: int, measures: list[Measure]) -> float:
        """Relative tolerance of the next linear solve, looser if a step changes contact states."""
        residuals = self.residuals
        if not iteration or self.changes[-1] >= FEW_POINTS * self.active.points():
            return LOOSE_TOLERANCE
        tolerance = min(FINE_TOLERANCE, (residuals[-1] / residuals[-2]) ** TOLERANCE_POWER)
        if self.changes[-1] or residuals[-1] > QUADRATIC_RANGE:
            return tolerance
        last_tolerance = LAST_TOLERANCE / max(p.norm / p.limit(self.tolerance) for p in measures)
        return min(tolerance, max(last_tolerance, QUADRATIC_FACTOR * residuals[-1]))


def unused(options: Iterable[str]) -> list[str]:
    """Raw options that no solver made so far has asked for: misspelt, or of another method."""
    block = re.compile(f"fieldsplit_({'|'.join(BLOCK_NAMES)}|temperature)_")
    return [f"-{key}" for key in options if not {key, block.sub("", key, count=1)} & USED_OPTIONS]


def raw_options(arguments: Sequence[str]) -> dict[str, str]:
    """PETSc options from the command line: ``-name value`` or ``-name``."""
    options: dict[str, str] = {}
    key = ""
    for argument in arguments:
        if argument.startswith("-") and not argument[1:2].isdigit():
            key = argument.lstrip("-")
            options[key] = ""
        elif key:
            options[key], key = argument, ""
    return options
