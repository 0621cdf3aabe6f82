"""Remodelling of bone: the stimulus at the vertices, and the density in time by Heun's rule.

Arrays are by vertex of this rank, ghosts too, and region (n, r). The end of a step is projected on
the bounds; what that cuts is counted, so that the mass is that at the start, plus what was added,
plus what was cut.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import ufl

from app.foundation.arrays import Floats
from app.foundation.errors import ConvergenceError, InputError, MantleError
from app.laws.remodelling import Remodelling
from app.laws.values import field
from app.mechanics.body_forms import assembled_matrix, hats
from app.numerics.preconditioners import Inverse
from app.numerics.remedies import solve
from app.numerics.saved_state import node_keys
from app.scene.bodies import FACET_NODES, boundary_facets
from app.scene.scene import Stage
from app.soundness.failure import explain
from app.stepping.advance import Growth, Progress, Step, advance
from app.stepping.load_steps import LoadStepper

# Largest change of the density in a step [g/cm3].
MOST = 0.3
GROWTH = Growth(safety=0.9, least=0.2, most=2.0, failed=0.5)
# Largest part of a step by which it is repeated.
SHORTER = 0.9
# Part of a stage below which a step is too short.
SHORTEST = 1e-8
# Stands for zero as a divisor.
TINY = 1e-300
# Mass of 1 mm3 of 1 g/cm3 [g].
GRAM = 1e-3


class Remodeller:
    """Steps through stages in which bone remodels, beside the stepper of loads; made collectively.

    Attributes:
        mass: Mass of the bone that remodels: at the start, added, cut at the bounds [g].
        seconds: Time in which it has remodelled so far [s].

    Args:
        stresses: Strain energy at points of the cells (`results.stresses.Stresses`).
        reference: Stimulus of the intact femur (n, r), made when it is first needed; None where the
            case gives it.
    """

    saved = ("_progress", "_speed", "mass", "seconds", "steps")

    def __init__(
        self, stepper: LoadStepper, stresses: Any, reference: Callable[[], Floats | None]
    ) -> None:
        self._stepper, self._stresses, self._intact = stepper, stresses, reference
        self.problem, self.mechanics = stepper.problem, stepper.problem.mechanics
        law: Any = self.problem.scene.remodelling
        self._law: Remodelling = law
        # The integrals of the hat functions of the vertices [mm3].
        self._volume = self._integrals(lambda region: 1.0)
        self._filters = [self._filter(r, law.filter) for r in self.mechanics.remodels]
        self._states: dict[float, PETSc.Vec] = {}
        self._progress = Progress()
        # Change of the density in time at the last step's end [g/(cm3 s)], if it is known.
        self._speed: Floats | None = None
        self.mass = {"start": self.present, "added": 0.0, "cut": 0.0}
        self.seconds, self.steps = 0.0, 0

    @property
    def row_keys(self) -> dict[str, Any]:
        """Keys of vertices."""
        return {"_speed": node_keys(self.mechanics.scalars)}

    @property
    def present(self) -> float:
        """Mass of the bone that remodels [g]; collective."""
        return self._grams(self.mechanics.density)

    def _grams(self, density: Floats) -> float:
        own = self.mechanics.scalars.dofmap.index_map.size_local
        local = float((self._volume * density)[:own].sum())
        return GRAM * float(self.problem.comm.allreduce(local))

    def _largest(self, values: Floats) -> float:
        local = float(np.abs(values).max(initial=0.0))
        return float(self.problem.comm.allreduce(local, MPI.MAX))

    # The stimulus

    def _integrals(self, density: Callable[[str], Any]) -> Floats:
        """Integrals of a region's density (cells, points) times the hat functions of vertices."""
        m, s = self.mechanics, self._stresses
        cells = {r: density(r) * s.places(r)[1] @ hats(s.points[r]) for r in m.remodels}
        return np.array([m.vertex_sums(m.vertices(r), own) for r, own in cells.items()]).T

    def _filter(self, region: str, length: float | None) -> Callable[[Floats], Floats]:
        """Filter of values S of a region, S - l^2 div grad S = given, if it has a length l."""
        if length is None:
            return lambda given: given
        m, own = self.mechanics, self.mechanics.scalars.dofmap.index_map.size_local
        slopes = [ufl.grad(f(m.scalars)) for f in (ufl.TrialFunction, ufl.TestFunction)]
        dx = m.cells()(m.tagged.regions[region])
        A = assembled_matrix(m.form(m.constant(length**2) * ufl.inner(*slopes) * dx))
        # Vertices of other regions have no entries yet.
        A.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        volume = self._volume[:, m.remodels.index(region)]
        volume = np.where(volume > 0, volume, 1.0)
        A.setDiagonal(A.getDiagonal() + PETSc.Vec().createWithArray(volume[:own], comm=A.comm))
        inverse = Inverse(A, lambda: 0, {"pc_type": "jacobi"})

        def filtered(given: Floats) -> Floats:
            b, x = A.createVecs()
            b.array[:] = (volume * given)[:own]
            inverse.solve(b, x, 1e-10)
            return m.vertex_sums(np.arange(own, dtype=np.int32), x.array_r)

        return filtered

    def stimulus(self, cases: Sequence[tuple[int, float]]) -> Floats | None:
        """Strain energy per mass [J/g], the mean over load cases; None if one cannot be solved.

        The energy density at a vertex is its mean weighted with the vertex's hat function. A case
        is the stage whose supports hold and the time of its loads; each begins in the committed
        state of the interfaces. Collective.
        """
        problem, solver = self.problem, self._stepper.solver
        self._follow()
        energy = 0.0 * self._volume
        for k, time in cases:
            self._states.get(time, solver.x).copy(solver.x)
            problem.set_stage(k, solver.u_and_q()[0])
            problem.set_time(time)
            problem.update_stiffness()
            self._outcome = solve(solver)
            self._stepper.total.count(self._outcome)
            if not self._outcome.converged:
                return None
            self._states[time] = solver.x.copy()
            problem.update_displacements(*solver.u_and_q())
            energy += self._integrals(self._stresses.energy_density)
        S = energy / np.maximum(len(cases) * self._volume * self.mechanics.density, TINY)
        return np.array([f(own) for f, own in zip(self._filters, S.T, strict=True)]).T

    def _begin(self, k: int) -> None:
        """Find load cases, reference, and the bone that is free to remodel; collective."""
        problem, m, law = self.problem, self.mechanics, self._law
        self._cases = [(k, i + 1.0) for i in problem.scene.load_cases]
        K = self._intact()
        if K is None:
            given = field("remodelling.stimulus", law.stimulus or 0.0)(
                m.scalars.tabulate_dof_coordinates()
            )
            K = np.broadcast_to(given[:, None], self._volume.shape)
        self._reference = K
        least = problem.comm.allreduce(float(K[self._volume > 0].min(initial=np.inf)), MPI.MIN)
        if least <= 0:
            raise InputError(f"remodelling.stimulus: {least:g} J/g somewhere; it must be positive")
        clamps = [s.boundary for s in problem.scene.supports if s.clamps]
        clamps += [boundary for load in problem.scene.loads for boundary in load.boundaries]
        self._free = self._volume > 0
        for name in clamps if law.frozen is None else law.frozen:
            f = boundary_facets(problem.tagged, name)
            nodes = m.scalars.dofmap.list[f.cells[:, None], FACET_NODES[f.local, :3]]
            self._free &= m.vertex_sums(nodes, 1.0)[:, None] == 0

    # Steps

    def run_stage(self, k: int, stage: Stage, checkpoint_point: Callable[[], None]) -> None:
        """Remodel bone through a stage.

        Raises:
            ConvergenceError: A load case cannot be solved even after a short time.
        """
        stepper, m = self._stepper, self.mechanics
        self._begin(k)
        if not self._progress.step:
            self._progress = Progress(1.0 / stage.increments)
        self._k, self._stage = k, stage
        self._kept = m.density.copy(), stepper.solver.x.copy()
        try:
            if self._speed is None:
                self._speed = self._change()
            if self._speed is None:
                raise self._failure()
            self._limit(self._speed)
            advance(self, self, checkpoint_point)
        except MantleError:
            m.density[:] = self._kept[0]
            self._kept[1].copy(stepper.solver.x)
            self._follow()
            self.problem.update_displacements(*stepper.solver.u_and_q())
            raise
        self._progress, self._speed = Progress(), None

    def _follow(self) -> None:
        self.problem.follow_density()
        self._stresses.follow_density()

    def _change(self) -> Floats | None:
        """Change of the density in time [g/(cm3 s)]; None if a load case cannot be solved."""
        S = self.stimulus(self._cases)
        return None if S is None else self._free * self._law.speed(S, self._reference)

    @property
    def _duration(self) -> float:
        """Duration of the stage [s]."""
        return self._stage.remodels or 0.0

    def _limit(self, speed: Floats) -> None:
        """Shorten the next step so that no density changes by more than `MOST`; collective."""
        old, (low, high) = self.mechanics.density, self._law.density
        far = np.where(speed > 0, high - old, old - low) > MOST
        fastest = max(self._largest(speed[far]) * self._duration, TINY)
        self._progress.step = min(self._progress.step, MOST / fastest)

    def _failure(self) -> ConvergenceError:
        p = self._progress
        why = explain(self.problem, self._stepper.solver, self._outcome)
        return why.error(self._stage.name, p.done, [p.step])

    # Control of the steps

    @property
    def finished(self) -> bool:
        """Whether the stage is done."""
        return self._progress.done >= 1.0

    def propose(self) -> Step:
        """Return the next step."""
        return self._progress.next(1.0 / self._stage.increments)

    def judge(self, step: Step, error: float) -> bool:
        """Accept a step within its tolerance, and choose the next one."""
        p, factor = self._progress, GROWTH.factor(error)
        if error > 1.0:
            p.step = min(factor, SHORTER) * step.length
            return False
        # A step shortened by the end of an increment says little about a longer one.
        p.step = max(factor * step.length, p.step if step.whole else 0.0)
        p.done = step.end
        return True

    # Steps

    def try_step(self, step: Step) -> float:
        """Change the density by Heun's rule; return the error over the tolerance; collective."""
        self._old = self.mechanics.density.copy()
        speed = self._speed
        assert speed is not None
        seconds = self._duration * step.length
        euler = self._moved(seconds * speed)
        there = self._change()
        if there is None:
            return math.inf
        self._added = seconds * (speed + there) / 2
        self._heun = self._moved(self._added)
        error = self._largest(self._heun - euler) / self._law.tolerance
        if error <= 1.0:
            self._next = self._change()
            if self._next is None:
                return math.inf
        return error

    def _moved(self, change: Floats) -> Floats:
        """Change the density of the step's beginning, within its bounds; return it."""
        low, high = self._law.density
        new = np.where(self._free, np.clip(self._old + change, low, high), self._old)
        self.mechanics.density[:] = new
        return self.mechanics.density.copy()

    def refuse(self, step: Step) -> None:
        """Go back to the density at the beginning of a step.

        Raises:
            ConvergenceError: The next step would be too short.
        """
        self._stepper.total.rejected += 1
        self.mechanics.density[:] = self._old
        if self._progress.step <= SHORTEST:
            raise self._failure()

    def commit(self, step: Step, started: float) -> None:
        """Commit the step last tried; collective."""
        stepper, m = self._stepper, self.mechanics
        self.mass["added"] += self._grams(self._added)
        self.mass["cut"] += self._grams(self._heun - self._old - self._added)
        self.seconds += self._duration * step.length
        self.steps += 1
        assert self._next is not None
        self._speed = self._next
        time = self._k + step.end
        self.problem.set_time(time)
        stepper.commit(self._stage, time, self._outcome, started, step.whole)
        self._kept = m.density.copy(), stepper.solver.x.copy()
        self._limit(self._speed)

    def summary(self) -> dict[str, Any]:
        """Published numbers of the state last committed; collective."""
        mass = self.mass | {"end": self.present}
        mass["audit"] = (mass["end"] - sum(self.mass.values())) / mass["start"]
        return {"seconds": self.seconds, "steps": self.steps, "mass": mass}
