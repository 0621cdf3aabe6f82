"""Force, moment and energy balances, from forms assembled apart from the solver's matrices."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from app.arrays import Floats
from app.laws.materials import Elastic
from app.laws.values import amplitude
from app.mechanics.body_forms import assembled_vector
from app.mechanics.contact import TrialState
from app.mechanics.problem import Problem
from forms import elasticity, loads


class Balance:
    """Sums of force, moment and energy over the steps, relative to the largest so far.

    Work is summed by the trapezoidal rule, which is exact for linear bodies: external work (loads,
    supports, eigenstrains, thermal strain) equals the stored energy plus the work of the interface
    forces. Curing regions have no stored energy: the work of their stress in their strain, also
    trapezoidal, takes the place of stored energy and of the work of free strain.

    Args:
        about: Point that moments are taken about (3,) [mm].
    """

    saved = ("_work", "_spent", "_scale", "_largest", "force", "moment", "energy")

    def __init__(self, problem: Problem, about: Floats) -> None:
        self._problem = problem
        mechanics, scene = problem.mechanics, problem.scene
        dx = mechanics.cells()
        v = ufl.TestFunction(problem.space)
        displacements = problem.displacements()
        energy = [
            (e, U)
            for b, U in enumerate(displacements)
            if (e := mechanics.body_energy(b, U, dx)) != 0
        ]
        # Energy of all bodies and its derivative; a rigid body has none.
        whole = sum(e for e, _ in energy)
        forces = sum(ufl.derivative(e, U, v) for e, U in energy)
        self._elastic = [(mechanics.form(whole), mechanics.form(forces))] if energy else []
        self._strain_work = [
            (s.history, mechanics.form(self._work_of(e, elasticity.symmetric(s.strain))))
            for e in scene.elastic
            for s in e.eigenstrains
        ]
        elastic = {e.region: e for e in scene.elastic}
        self._swelling = [
            (free, mechanics.form(self._work_of(elastic[region], elasticity.swelling(test))))
            for region, free in mechanics.swelling.items()
            for test in [ufl.TestFunction(mechanics.scalars)]
        ]
        self._setting: list[tuple[fem.Function, fem.Form]] = []
        if s := problem.setting:
            forms = [(b, mechanics.form(s.internal_work(b, v))) for b in s.bodies]
            self._setting = [(displacements[b], form) for b, form in forms]
        # The traction k_i U_i of each bed of springs on each body.
        beds = [
            ([k[i] * U[i] for i in range(3)], ds)
            for f, k in zip(scene.foundations, mechanics.springs, strict=True)
            for b, U in enumerate(displacements)
            if (ds := mechanics.ds(f.boundary, b)) is not None
        ]
        self._springs = [mechanics.form(t[i] * ds) for t, ds in beds for i in range(3)]
        x = ufl.SpatialCoordinate(problem.tagged.mesh)
        arm = [x[i] - float(about[i]) for i in range(3)]
        self._spring_moments = [
            mechanics.form(
                (arm[(i + 1) % 3] * t[(i + 2) % 3] - arm[(i + 2) % 3] * t[(i + 1) % 3]) * ds
            )
            for t, ds in beds
            for i in range(3)
        ]
        nodes = problem.space.tabulate_dof_coordinates()[
            : len(problem.stiffness.constraints.reacting) // 3
        ]
        self._arm = nodes - about
        ends = problem.comm.allgather((nodes.min(0, initial=np.inf), nodes.max(0, initial=-np.inf)))
        low, high = np.min([e[0] for e in ends], axis=0), np.max([e[1] for e in ends], axis=0)
        self._diagonal = float(np.linalg.norm(high - low))
        self._rest = self._measure(problem.stiffness.K.createVecLeft(), None)
        self.begin()

    def begin(self) -> None:
        """Reset to the unloaded state."""
        self._work = self._spent = self._scale = self._largest = 0.0
        self._last = self._rest
        self.force = self.moment = self.energy = 0.0

    def go_on(self, u: PETSc.Vec, trial: TrialState | None) -> None:
        """Measure a restored state with updated displacements; collective."""
        self._last = self._measure(u, trial)

    def _work_of(self, e: Elastic, strain: Expr) -> Any:
        mechanics, problem = self._problem.mechanics, self._problem
        U = problem.displacements()[problem.bodies.of_region[e.region]]
        σ = elasticity.stress(
            lambda ε: mechanics.energy_density(e, ε), mechanics.elastic_strain(e, U)
        )
        return -loads.mechanical_work(σ, strain) * mechanics.over(e, mechanics.cells())

    def _measure(self, u: PETSc.Vec, trial: TrialState | None) -> dict:
        problem = self._problem
        internal = np.zeros(len(problem.stiffness.constraints.reacting))
        for _, form in self._elastic:
            internal += self._assemble(form)
        setting = [self._assemble(form) for _, form in self._setting]
        internal += sum(setting)
        loads = problem.forces.applied(problem.time)
        reaction = np.where(problem.stiffness.constraints.reacting, internal - loads.nodal, 0.0)

        def scalar(form: fem.Form) -> float:
            return float(problem.comm.allreduce(fem.assemble_scalar(form), MPI.SUM))

        jump = held_q = np.zeros_like(loads.jump)
        if trial is not None:
            jump, e = trial.jump.ravel().copy(), trial.equilibrium
            held_q = (e - trial.contact.own.project_free(e)).ravel()
        return {
            "u": problem.stiffness.constraints.expand(u).array.copy(),
            "q": jump,
            "loads_u": loads.nodal,
            "loads_q": loads.jump,
            "reaction": reaction,
            "reaction_q": held_q,
            "energy": sum(scalar(f) for f, _ in self._elastic),
            "amplitudes": [amplitude(h, problem.time) for h, _ in self._strain_work],
            "strain_work": [scalar(f) for _, f in self._strain_work],
            "swelling": [e.x.array[: _owned(e)].copy() for e, _ in self._swelling],
            "swelling_work": [self._assemble(form) for _, form in self._swelling],
            "setting": [U.x.array[: len(internal)].copy() for U, _ in self._setting],
            "setting_forces": setting,
            "springs": np.array([scalar(f) for f in self._springs]).reshape(-1, 3).sum(axis=0),
            "spring_moments": np.array([scalar(f) for f in self._spring_moments])
            .reshape(-1, 3)
            .sum(axis=0),
        }

    @staticmethod
    def _assemble(form: fem.Form) -> Floats:
        """Own entries of a linear form; collective."""
        return np.array(assembled_vector(form).array)

    def update(self, u: PETSc.Vec, trial: TrialState | None) -> None:
        """Add a committed step with updated displacements; collective."""
        old, new = self._last, self._measure(u, trial)
        self._last = new
        problem, comm = self._problem, self._problem.comm

        def work(force: str, motion: str) -> float:
            return float(np.dot((old[force] + new[force]) / 2, new[motion] - old[motion]))

        def works(forces: str, motions: str) -> float:
            pairs = zip(old[forces], new[forces], old[motions], new[motions], strict=True)
            return sum(float(np.dot((f0 + f1) / 2, u1 - u0)) for f0, f1, u0, u1 in pairs)

        external = work("loads_u", "u") + work("reaction", "u")
        external += work("loads_q", "q") + work("reaction_q", "q")
        external += works("swelling_work", "swelling")
        external = float(comm.allreduce(external, MPI.SUM)) + works("strain_work", "amplitudes")
        self._spent += float(comm.allreduce(works("setting_forces", "setting"), MPI.SUM))
        self._work += external
        contact = float(comm.allreduce(trial.contact.state.work.sum(), MPI.SUM)) if trial else 0.0
        spent = (new["energy"], self._spent, contact)
        free = problem.forces.free_work(new["u"])
        self._scale = max(self._scale, *map(abs, (self._work, *spent, free)))
        self.energy = _relative(self._work - sum(spent), self._scale)
        self._forces(new)

    def _forces(self, new: dict) -> None:
        problem, comm = self._problem, self._problem.comm
        loads_u = new["loads_u"].reshape(-1, 3)
        reaction = new["reaction"].reshape(-1, 3)
        sums = [
            comm.allreduce(values, MPI.SUM)
            for values in (
                loads_u.sum(axis=0),
                reaction.sum(axis=0),
                np.cross(self._arm, loads_u).sum(axis=0),
                np.cross(self._arm, reaction).sum(axis=0),
            )
        ]
        scale = float(sum(np.linalg.norm(r) for r in problem.forces.resultants(problem.time)))
        if not scale:
            # Free strain alone leaves reactions of rounding.
            scale = float(comm.allreduce(np.abs(reaction).sum(), MPI.SUM))
            scale = max(scale, problem.load_size)
        # After unloading only forces of rounding are left.
        scale = self._largest = max(self._largest, scale)
        self.force = _relative(float(np.linalg.norm(sums[0] + sums[1] - new["springs"])), scale)
        moment = sums[2] + sums[3] - new["spring_moments"]
        self.moment = _relative(float(np.linalg.norm(moment)), scale * self._diagonal)


def _owned(function: fem.Function) -> int:
    return int(function.function_space.dofmap.index_map.size_local)


def _relative(value: float, scale: float) -> float:
    return abs(value) / scale if scale else abs(value)
