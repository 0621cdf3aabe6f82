"""Remodelling of bone: the stimulus at the vertices, and the density in time by Heun's rule.

Arrays are by vertex of this rank, ghosts too, and region (n, r). The end of a step is projected on
the bounds; what that cuts is counted, so that the mass is that at the start, plus what was added,
plus what was cut.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import ufl

from app.arrays import Floats
from app.errors import ConvergenceError, InputError, MantleError
from app.laws.supports import Fixed
from app.laws.values import field
from app.mechanics.body_forms import assembled_matrix, hats
from app.numerics.remedies import solve
from app.scene.bodies import FACET_NODES, boundary_facets
from app.scene.scene import Stage
from app.soundness.failure import explain
from app.stepping.load_steps import LoadStep, LoadStepper, Progress

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

    saved = ("_progress", "_start", "mass", "seconds", "steps", "rejected")

    def __init__(
        self, stepper: LoadStepper, stresses: Any, reference: Callable[[], Floats | None]
    ) -> None:
        self._stepper, self._stresses, self._intact = stepper, stresses, reference
        problem, law = stepper.problem, stepper.problem.scene.remodelling
        assert law is not None
        self.problem, self._law, self.mechanics = problem, law, problem.mechanics
        # The integrals of the hat functions of the vertices [mm3].
        self._volume = self._integrals(lambda region: 1.0)
        self._filters = [self._filter(r, law.filter) for r in self.mechanics.remodels]
        self._states: dict[float, PETSc.Vec] = {}
        self._progress, contact = Progress(), problem.contact
        self._start: Any = contact and contact.state
        self.mass = {"start": self.present, "added": 0.0, "cut": 0.0}
        self.seconds, self.steps, self.rejected = 0.0, 0, 0

    @property
    def row_keys(self) -> dict[str, Any]:
        """Keys of own contact points."""
        contact = self.problem.contact
        return {"_start": contact.row_keys} if contact else {}

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
        krylov = PETSc.KSP().create(A.comm)
        krylov.setOperators(A)
        krylov.setType("cg")
        krylov.getPC().setType("jacobi")
        krylov.setTolerances(rtol=1e-10)

        def filtered(given: Floats) -> Floats:
            b, x = A.createVecs()
            b.array[:] = (volume * given)[:own]
            krylov.solve(b, x)
            return m.vertex_sums(np.arange(own, dtype=np.int32), x.array_r)

        return filtered

    def stimulus(self, cases: Sequence[tuple[int, float]]) -> Floats | None:
        """Strain energy per mass [J/g], the mean over load cases; None if one cannot be solved.

        The energy density at a vertex is its mean weighted with the vertex's hat function. Each
        case, the number of the stage whose supports hold and the time of its loads, begins in the
        state of the interfaces in which the stage did. Collective.
        """
        problem, solver = self.problem, self._stepper.solver
        problem.follow_density()
        self._stresses.follow_density()
        energy = 0.0 * self._volume
        for k, time in cases:
            if problem.contact:
                problem.contact.state = self._start
            self._states.get(time, solver.x).copy(solver.x)
            problem.set_stage(k, solver.u_and_q()[0])
            problem.set_time(time)
            problem.update_stiffness()
            self._outcome = solve(solver)
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
            given = field("remodelling.stimulus", law.stimulus or 0.0)(m.vertex_places)
            K = np.broadcast_to(given[:, None], self._volume.shape)
        self._reference = K
        least = float(self._reference[self._volume > 0].min(initial=np.inf))
        if (least := problem.comm.allreduce(least, MPI.MIN)) <= 0:
            raise InputError(f"remodelling.stimulus: {least:g} J/g somewhere; it must be positive")
        held: Sequence[str] | None = law.frozen
        if held is None:
            held = [s.boundary for s in problem.scene.supports if isinstance(s, Fixed)]
            held += [boundary for load in problem.scene.loads for boundary in load.boundaries]
        self._free = self._volume > 0
        for name in held:
            f = boundary_facets(problem.tagged, name)
            nodes = m.scalars.dofmap.list[f.cells[:, None], FACET_NODES[f.local, :3]]
            self._free &= m.vertex_sums(nodes, 1.0)[:, None] == 0

    # Steps

    def run_stage(self, k: int, stage: Stage, checkpoint_point: Callable[[], None]) -> None:
        """Remodel bone through a stage.

        Raises:
            ConvergenceError: A load case cannot be solved even after a short time.
        """
        problem, solver, whole = self.problem, self._stepper.solver, 1.0 / stage.increments
        contact, m = problem.contact, self.mechanics
        if not self._progress.step:
            self._progress, self._start = Progress(whole), contact and contact.state
        p = self._progress
        self._begin(k)
        kept: Any = (m.density.copy(), solver.x.copy(), contact and contact.state)
        try:
            speed = self._speed()
            while p.done < 1.0:
                started, goal = clock.perf_counter(), p.goal(whole)
                speed = self._step(stage, goal, speed)
                self._commit(stage, k, started, p.done == goal, kept[2])
                kept = m.density.copy(), solver.x.copy(), contact and contact.state
                checkpoint_point()
        except MantleError:
            m.density[:] = kept[0]
            kept[1].copy(solver.x)
            if contact is not None:
                contact.state = kept[2]
            problem.follow_density()
            self._stresses.follow_density()
            problem.update_displacements(*solver.u_and_q())
            raise
        self._progress = Progress()

    def _speed(self) -> Floats | None:
        """Change of the density in time [g/(cm3 s)]; None if a load case cannot be solved."""
        S = self.stimulus(self._cases)
        return None if S is None else self._free * self._law.speed(S, self._reference)

    def _step(self, stage: Stage, goal: float, speed: Floats | None) -> Floats:
        """Take a step that its error allows; returns the speed at its end; collective.

        Args:
            stage: The stage.
            goal: Where in it the step ends at the latest.
            speed: Change of the density in time; None if a load case cannot be solved.
        """
        p, T, old, bounds = (
            self._progress,
            stage.remodels or 0.0,
            self.mechanics.density.copy(),
            self._law.density,
        )
        while speed is not None and p.step > SHORTEST:
            room = np.where(speed > 0, bounds[1] - old, old - bounds[0])
            fastest = self._largest(speed[room > MOST])
            p.step = min(p.step, MOST / max(fastest * T, TINY))
            reach = p.reach(goal)
            dt, factor = T * (reach - p.done), 0.5
            euler = np.where(self._free, np.clip(old + dt * speed, *bounds), old)
            self.mechanics.density[:] = euler
            if (there := self._speed()) is not None:
                change = dt / 2 * (speed + there)
                heun = np.where(self._free, np.clip(old + change, *bounds), old)
                self.mechanics.density[:] = heun
                error = self._largest(heun - euler)
                factor = min(max(0.9 * (self._law.tolerance / max(error, TINY)) ** 0.5, 0.2), 2.0)
                if error <= self._law.tolerance and (end := self._speed()) is not None:
                    self.mass["added"] += self._grams(change)
                    self.mass["cut"] += self._grams(heun - old - change)
                    self.seconds, self.steps = self.seconds + dt, self.steps + 1
                    longer = factor * (reach - p.done)
                    p.step, p.done = max(longer, p.step if reach == goal else 0.0), reach
                    return end
            self.rejected += 1
            p.step = min(factor, 0.9) * (reach - p.done)
        why = explain(self.problem, self._stepper.solver, self._outcome)
        raise ConvergenceError(why.text(stage.name, p.done, [p.step]))

    def _commit(self, stage: Stage, k: int, started: float, whole: bool, last: Any) -> None:
        """Commit and report the state of the last load case; `last` is that before; collective."""
        problem, stepper, time = self.problem, self._stepper, k + self._progress.done
        problem.set_time(time)
        u, q = stepper.solver.u_and_q()
        trial = problem.trial(u, q) if q is not None else None
        problem.commit(trial)
        if contact := problem.contact:
            # Work is summed from step to step, not from the start of the stage.
            now = contact.state
            work = np.einsum("pi,pi->p", (now.force + last.force) / 2, now.jump - last.jump)
            contact.state = replace(now, work=last.work + contact.own.weight * work)
        stepper.total.steps += 1
        stepper.total.count(self._outcome)
        number, seconds = stepper.total.steps, clock.perf_counter() - started
        stepper.on_step(LoadStep(number, stage.name, time, self._outcome, seconds, whole), trial)

    def summary(self) -> dict[str, Any]:
        """Published numbers of the state last committed; collective."""
        mass = self.mass | {"end": self.present}
        audit = mass["end"] - mass["start"] - mass["added"] - mass["cut"]
        return {
            "seconds": self.seconds,
            "steps": self.steps,
            "rejected": self.rejected,
            "mass": mass | {"audit": audit / mass["start"]},
        }
