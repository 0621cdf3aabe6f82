"""Remodelling of bone: the stimulus at the vertices, and the density in time by Heun's rule.

Arrays are by vertex of this rank, ghosts too, and region (n, r). The end of a step is projected on
the bounds; what that cuts is counted, so that the mass is that at the start, plus what was added,
plus what was cut.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import ufl

from app.foundation.arrays import Floats
from app.foundation.errors import InputError, MantleError
from app.laws.remodelling import Remodelling
from app.laws.supports import Fixed
from app.laws.values import field
from app.mechanics.body_forms import assembled_matrix, hats
from app.numerics.preconditioners import Inverse
from app.numerics.remedies import solve
from app.numerics.saved_state import node_keys
from app.scene.bodies import FACET_NODES, boundary_facets
from app.scene.scene import Stage
from app.soundness.failure import explain
from app.stepping.load_steps import LoadStepper, Progress

MOST = 0.3  # g/cm3 in a step
SHORTEST = 1e-8  # part of a stage that is no step any more
TINY = 1e-300  # stands for zero as a divisor
GRAM = 1e-3  # of 1 mm3 of 1 g/cm3


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
        if (K := self._intact()) is None:
            given = field("remodelling.stimulus", law.stimulus or 0.0)(
                m.scalars.tabulate_dof_coordinates()
            )
            K = np.broadcast_to(given[:, None], self._volume.shape)
        self._reference = K
        least = problem.comm.allreduce(float(K[self._volume > 0].min(initial=np.inf)), MPI.MIN)
        if least <= 0:
            raise InputError(f"remodelling.stimulus: {least:g} J/g somewhere; it must be positive")
        clamps = [s.boundary for s in problem.scene.supports if isinstance(s, Fixed)]
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
        problem, stepper, m = self.problem, self._stepper, self.mechanics
        self._begin(k)
        if not self._progress.step:
            self._progress = Progress(1.0 / stage.increments)
        p, kept = self._progress, (m.density.copy(), stepper.solver.x.copy())
        try:
            while p.done < 1.0:
                started, goal = clock.perf_counter(), p.goal(1.0 / stage.increments)
                self._speed = self._step(stage, goal)
                problem.set_time(k + p.done)
                stepper.commit(stage, k + p.done, self._outcome, started, p.done == goal)
                kept = m.density.copy(), stepper.solver.x.copy()
                checkpoint_point()
        except MantleError:
            m.density[:] = kept[0]
            kept[1].copy(stepper.solver.x)
            self._follow()
            problem.update_displacements(*stepper.solver.u_and_q())
            raise
        self._progress, self._speed = Progress(), None

    def _follow(self) -> None:
        self.problem.follow_density()
        self._stresses.follow_density()

    def _change(self) -> Floats | None:
        """Change of the density in time [g/(cm3 s)]; None if a load case cannot be solved."""
        S = self.stimulus(self._cases)
        return None if S is None else self._free * self._law.speed(S, self._reference)

    def _step(self, stage: Stage, goal: float) -> Floats:
        """Take a step that its error allows, to a goal in the stage at most; collective.

        Returns the change of the density in time at its end [g/(cm3 s)].
        """
        p, tolerance, (low, high) = self._progress, self._law.tolerance, self._law.density
        T, old, m = stage.remodels or 0.0, self.mechanics.density.copy(), self.mechanics

        def moved(change: Floats) -> Floats:
            m.density[:] = np.where(self._free, np.clip(old + change, low, high), old)
            return m.density.copy()

        speed = self._change() if self._speed is None else self._speed
        while speed is not None and p.step > SHORTEST:
            far = np.where(speed > 0, high - old, old - low) > MOST
            p.step = min(p.step, MOST / max(self._largest(speed[far]) * T, TINY))
            reach = p.reach(goal)
            part, factor = reach - p.done, 0.5
            euler = moved(T * part * speed)
            if (there := self._change()) is not None:
                change = T * part * (speed + there) / 2
                heun = moved(change)
                error = self._largest(heun - euler)
                factor = min(max(0.9 * (tolerance / max(error, TINY)) ** 0.5, 0.2), 2.0)
                if error <= tolerance and (end := self._change()) is not None:
                    self.mass["added"] += self._grams(change)
                    self.mass["cut"] += self._grams(heun - old - change)
                    self.seconds, self.steps = self.seconds + T * part, self.steps + 1
                    p.step, p.done = max(factor * part, p.step if reach == goal else 0.0), reach
                    return end
            self._stepper.total.rejected += 1
            p.step = min(factor, 0.9) * part
        why = explain(self.problem, self._stepper.solver, self._outcome)
        raise why.error(stage.name, p.done, [p.step])

    def summary(self) -> dict[str, Any]:
        """Published numbers of the state last committed; collective."""
        mass = self.mass | {"end": self.present}
        mass["audit"] = (mass["end"] - sum(self.mass.values())) / mass["start"]
        return {"seconds": self.seconds, "steps": self.steps, "mass": mass}
