r"""Balances of force, moment and energy from separate forms, and of heat.

For the discrete solution the following sum of the heat integrator is exact to the tolerance of the
solver. The steps have lengths Δt, and the stages of a step have weights :math:`b_i`:

.. math:: E(t) - E(0) = \sum_{steps} Δt \sum_i b_i \sum_c Q_c(t_i),

E is the stored heat and :math:`Q_c` the flow into the model by condition c. A second sum uses the
trapezoidal rule with the flows at the ends of the steps. It does not use the stages; its defect is
the error of this rule.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from app.foundation.arrays import Floats
from app.laws.materials import Elastic
from app.laws.values import amplitude
from app.mechanics.body_forms import assemble_form_vector
from app.mechanics.contact import TrialState
from app.mechanics.problem import Problem
from forms import elasticity, loads

# Rounding of the assembled forces, in units of the scale. Up to 100 times this value the forces
# count as balanced.
ROUNDING_OF_FORCES = 1e-10

# Pairs of forces and the motions in which they do work.
Pairs = list[tuple[Floats, Floats]]


@dataclass(frozen=True)
class _State:
    """Forces and motions of this rank's nodes in a state.

    Attributes:
        external: Loads, reactions and free strains with their motions.
        setting: Forces of curing regions with their displacement.
        energy: Stored energy [N mm].
        outer: Loads, reactions, forces of springs and between separately meshed bodies
            (3 nodes,) [N].
        reaction: Reactions alone (3 nodes,) [N].
        unbalanced: Residual forces on unknowns and jumps [N].
    """

    external: Pairs
    setting: Pairs
    energy: float
    outer: Floats
    reaction: Floats
    unbalanced: Floats


class Balance:
    """Balances of force, moment and energy over the steps.

    Defects are relative to a scale, the largest one so far. The scale of forces is the largest of
    loads, reactions, and forces of free strains and of contact. The scale of energy is the sum of
    the absolute work of all of these. Neither scale is below the rounding of the assembled terms,
    which are the only forces in a body that has moved without strain.

    Work is summed by the trapezoidal rule, which is exact for linear bodies. External work (loads,
    supports, eigenstrains, thermal strain) equals the stored energy plus the work of the interface
    forces. Regions that set or creep have no stored energy. For them the work of their stress,
    also by the trapezoidal rule, replaces stored energy and the work of free strain. If the density
    of a region changes, this holds for all regions, because stored energy changes with stiffness.

    Attributes:
        external_work: Work of loads, supports and free strains so far [N mm].
        setting_work: Work of the stress of regions that set or creep so far [N mm].
        energy_scale: Scale of the defect of energy: the largest energy so far [N mm].
        force_scale: Scale of the defect of force: the largest force so far [N].
        force, moment, energy: Relative defects of the last step [-].

    Args:
        about: Reference point of moments (3,) [mm].
    """

    saved = (
        "external_work",
        "setting_work",
        "energy_scale",
        "force_scale",
        "force",
        "moment",
        "energy",
    )

    def __init__(self, problem: Problem, about: Floats) -> None:
        self._problem = problem
        body_forms, scene = problem.body_forms, problem.scene
        dx = body_forms.cells()
        v = ufl.TestFunction(problem.space)
        displacements = problem.displacements()
        energies = [body_forms.body_energy(b, U, dx) for b, U in enumerate(displacements)]
        energy = {b: body_energy for b, body_energy in enumerate(energies) if body_energy != 0}
        # Energy of all bodies, and its derivatives by body; a rigid body has no energy. Without
        # free strains the energy is half the work of its derivatives.
        has_free_strain = body_forms.free_strain or any(
            elastic_region.eigenstrains for elastic_region in scene.elastic
        )
        self._elastic = None
        if energy and has_free_strain:
            self._elastic = body_forms.form(sum(energy.values()))
        self._internal = []
        for b, body_energy in energy.items():
            forces = ufl.derivative(body_energy, displacements[b], v)
            self._internal.append((b, body_forms.form(forces)))
        self._strain_work = []
        for elastic_region in scene.elastic:
            for eigenstrain in elastic_region.eigenstrains:
                work = self._work_of(elastic_region, elasticity.symmetric(eigenstrain.strain))
                self._strain_work.append((eigenstrain.history, body_forms.form(work)))
        elastic = {elastic_region.region: elastic_region for elastic_region in scene.elastic}
        swelling = elasticity.isotropic_strain(ufl.TestFunction(body_forms.scalars))
        self._swelling = []
        for region, free_strain in body_forms.free_strain.items():
            if region not in body_forms.path_dependent_regions:
                work = self._work_of(elastic[region], swelling)
                self._swelling.append((free_strain, body_forms.form(work)))
        if body_forms.density_regions:
            self._strain_work, self._swelling = [], []
        self._setting: list[tuple[int, fem.Form]] = []
        self._set: fem.Form | None = None
        stress_history = problem.stress_history
        if stress_history:
            self._set = body_forms.form(stress_history.complementary_energy())
            self._setting = [
                (b, body_forms.form(stress_history.internal_work(b, v)))
                for b in stress_history.bodies
            ]
        # Work of the traction k_i U_i of each elastic foundation on each body.
        spring_works = []
        for foundation, spring_moduli in zip(scene.foundations, body_forms.springs, strict=True):
            for b, U in enumerate(displacements):
                ds = body_forms.ds(foundation.boundary, b)
                if ds is not None:
                    spring_works.append(sum(spring_moduli[i] * U[i] * v[i] for i in range(3)) * ds)
        self._springs = body_forms.form(sum(spring_works)) if spring_works else None
        nodes = problem.space.tabulate_dof_coordinates()[
            : len(problem.stiffness.constraints.reacting) // 3
        ]
        self._nodes, self._about = nodes, about
        self._state_at_rest = self._measure(problem.stiffness.K.createVecLeft(), None)
        self.begin()

    def begin(self) -> None:
        """Reset to the unloaded state."""
        self.external_work = self.setting_work = self.energy_scale = self.force_scale = 0.0
        self._last_state = self._state_at_rest
        self.force = self.moment = self.energy = 0.0

    def continue_from(self, u: PETSc.Vec, trial: TrialState | None) -> None:
        """Evaluate a restored state, whose displacements are updated; collective."""
        self._last_state = self._measure(u, trial)

    def _work_of(self, elastic_region: Elastic, strain: Expr) -> ufl.Form:
        body_forms, problem = self._problem.body_forms, self._problem
        U = problem.displacements()[problem.bodies.body_of_region[elastic_region.region]]
        σ = elasticity.stress(
            lambda ε: body_forms.energy_density(elastic_region, ε),
            body_forms.elastic_strain(elastic_region, U),
        )
        return -loads.mechanical_work(σ, strain) * body_forms.over(
            elastic_region, body_forms.cells()
        )

    def _elastic_energy(self, elastic: Sequence[tuple[int, PETSc.Vec]]) -> float:
        """Stored energy of this rank [N mm], from the internal forces [N] of each body.

        Without free strains it is half the work of the forces in the displacements.
        """
        if self._elastic:
            return float(fem.assemble_scalar(self._elastic))
        displacements = self._problem.displacements()
        works = []
        for b, body_forces in elastic:
            forces = body_forces.array_r
            works.append(float(forces @ displacements[b].x.array[: len(forces)]))
        return sum(works) / 2

    def _work_of_free_strains(self) -> Pairs:
        """Forces of free strains [N mm] and eigenstrains, with their values."""
        pairs: Pairs = []
        for free_strain, form in self._swelling:
            work = assemble_form_vector(form).array.copy()
            pairs.append((work, free_strain.x.array[: len(work)].copy()))
        for load_history, form in self._strain_work:
            strain = np.array([amplitude(load_history, self._problem.load_time)])
            pairs.append((np.array([fem.assemble_scalar(form)]), strain))
        return pairs

    def _measure(self, u: PETSc.Vec, trial: TrialState | None) -> _State:
        """Forces and motions of a state, whose displacements are updated; collective."""
        problem, constraints = self._problem, self._problem.stiffness.constraints
        displacements = problem.displacements()
        setting = [(b, assemble_form_vector(form)) for b, form in self._setting]
        elastic = [(b, assemble_form_vector(form)) for b, form in self._internal]
        energy = self._elastic_energy(elastic)
        inner = problem.forces.action([*elastic, *setting])
        if problem.body_forms.density_regions:
            setting, energy = [*setting, *elastic], 0.0
        acting = problem.forces.applied(problem.load_time)
        unbalanced, jump = inner.nodal - acting.nodal, np.zeros_like(acting.jump)
        on_masters = passed_to_masters = 0.0 * unbalanced
        followers = problem.followers
        if followers:
            on_masters = followers.forces_on_masters(unbalanced)
        reaction = np.where(constraints.reacting, unbalanced + on_masters, 0.0)
        unbalanced_vector = constraints.vector(
            PETSc.Vec().createWithArray(unbalanced, comm=problem.comm)
        )
        contact_residual = held_q = jump
        if trial is not None:
            jump, equilibrium = trial.jump.ravel().copy(), trial.equilibrium
            local, force = trial.contact.local, trial.contact.state.force
            tangential_forces = local.weight[:, None] * local.prescribed_tangential(force)
            held_q = (equilibrium - local.project_free(equilibrium) + tangential_forces).ravel()
            contact_residual = inner.jump - acting.jump - equilibrium.ravel()
        outer, displacement = acting.nodal + reaction, constraints.expand(u).array.copy()
        if followers:
            passed_to_masters = followers.zero_elsewhere(unbalanced) - on_masters
            outer, displacement, passed_to_masters = map(
                followers.to_global_axes, (outer, displacement, passed_to_masters)
            )
        external = [(outer, displacement), (acting.jump + held_q, jump)]
        external += self._work_of_free_strains()
        springs = assemble_form_vector(self._springs).array if self._springs else 0.0
        setting_forces = [
            (body_forces.array, displacements[b].x.array[: len(outer)].copy())
            for b, body_forces in setting
        ]
        total = np.concatenate(
            [unbalanced_vector.array[~constraints.constrained], contact_residual]
        )
        return _State(
            external,
            setting_forces,
            energy,
            outer - springs + passed_to_masters,
            reaction,
            total,
        )

    def update(self, u: PETSc.Vec, trial: TrialState | None) -> None:
        """Add a committed step, whose displacements are updated; collective."""
        previous, current = self._last_state, self._measure(u, trial)
        self._last_state = current
        problem, comm = self._problem, self._problem.comm
        contact = problem.contact_work
        works = (
            _work(a, b)
            for a, b in ((previous.external, current.external), (previous.setting, current.setting))
        )
        local = [*works, contact, current.energy]
        work, setting_work, *stored = comm.allreduce(np.array(local)).tolist()
        self.external_work += work
        self.setting_work += setting_work
        used_work = (self.setting_work, *stored)
        (_, displacement), (_, jump), *_ = current.external
        free_strain_work = problem.forces.free_work(problem.load_time, displacement, jump)
        cure_work = comm.allreduce(fem.assemble_scalar(self._set)) if self._set else 0.0
        q = PETSc.Vec().createWithArray(jump, comm=comm) if trial else None
        rounding = problem.rounding(u, q) / ROUNDING_OF_FORCES
        largest_displacement = comm.allreduce(np.abs(displacement).max(initial=0.0), MPI.MAX)
        sizes = (
            self.external_work,
            *used_work,
            free_strain_work,
            cure_work,
            rounding * largest_displacement,
        )
        self.energy_scale = max(self.energy_scale, *map(abs, sizes))
        self.energy = _relative(self.external_work - sum(used_work), self.energy_scale)
        self._forces(current, max(problem.size_of_forces(u, q), rounding))

    def _forces(self, current: _State, scale: float) -> None:
        problem, comm = self._problem, self._problem.comm
        outer = current.outer.reshape(-1, 3)
        followers = problem.followers
        arm = (followers.rotated_positions(self._nodes) if followers else self._nodes) - self._about
        sums = np.array([outer.sum(axis=0), np.cross(arm, outer).sum(axis=0)])
        force, moment = comm.allreduce(sums)
        loads = sum(np.linalg.norm(r) for r in problem.forces.resultants(problem.load_time))
        reactions = comm.allreduce(np.abs(current.reaction).sum(), MPI.SUM)
        # After unloading only rounding errors of forces are left.
        scale = self.force_scale = max(self.force_scale, scale, float(loads), float(reactions))
        unbalanced_size = float(np.sqrt(comm.allreduce(current.unbalanced @ current.unbalanced)))
        self.force = _relative(max(unbalanced_size, float(np.linalg.norm(force))), scale)
        largest_arm = comm.allreduce(np.linalg.norm(arm, axis=1).max(initial=0.0), MPI.MAX)
        self.moment = _relative(float(np.linalg.norm(moment)), scale * float(largest_arm))


def _work(previous: Pairs, current: Pairs) -> float:
    """Work of forces in the motions between two states, by the trapezoidal rule [N mm]."""
    pairs = zip(previous, current, strict=True)
    return sum(float(np.dot((f0 + f1) / 2, u1 - u0)) for (f0, u0), (f1, u1) in pairs)


def _relative(value: float, scale: float) -> float:
    return abs(value) / scale if scale else abs(value)


# Heat

Flows = Mapping[str, float]


class HeatBalance:
    """Sums of heat over the steps.

    Attributes:
        heat: Largest defect of the integrator's sum after any step, relative to the heat that had
            moved [-].
        quadrature: Defect of the trapezoidal sum, relative to the same heat [-].
        heats: Heat that has entered by each condition so far, by the integrator's sum [N mm].

    Args:
        stored: Heat stored at the start [N mm].
        flows: Flow into the model by each condition at the start [N mm/s]. Empty if it is unknown,
            because it is infinite where initial and prescribed temperatures differ. The first step
            is then summed with the flows at its end.
    """

    saved = (
        *("stored_at_start", "stored", "last_flows", "stage_sum", "end_sum", "moved"),
        *("heat", "quadrature", "heats"),
    )

    def __init__(self, stored: float, flows: Flows) -> None:
        self.stored_at_start = self.stored = stored
        self.last_flows = dict(flows)
        self.stage_sum = self.end_sum = self.moved = 0.0
        self.heat = self.quadrature = 0.0
        self.heats: dict[str, float] = {}

    def update(
        self,
        step: float,
        heats: Flows,
        end: Flows,
        stored: float,
        moved: float,
        rounding_heat: float = 0.0,
    ) -> None:
        """Add an accepted step.

        Args:
            step: Length of the step [s].
            heats: Heat that entered by each condition, summed over the stages of the step [N mm].
            end: Flows at the end [N mm/s].
            stored: Heat stored at the end [N mm].
            moved: Heat that moved within the model in the step [N mm], the scale of the balances
                (`ThermalRecord.moved_heat`).
            rounding_heat: Heat below which the balance would only compare rounding errors [N mm].
        """
        for name, heat in heats.items():
            self.heats[name] = self.heats.get(name, 0.0) + heat
        self.stage_sum += sum(heats.values())
        begin = self.last_flows or end
        self.end_sum += step * (sum(begin.values()) + sum(end.values())) / 2
        self.last_flows = dict(end)
        self.moved += max(sum(map(abs, heats.values())), moved)
        self.stored = stored
        if self.moved >= rounding_heat:
            gained, scale = stored - self.stored_at_start, self.moved or 1.0
            self.heat = max(self.heat, abs(self.stage_sum - gained) / scale)
            self.quadrature = abs(self.end_sum - gained) / scale

    def steady(self, flows: Flows, stored: float, rounding: float) -> None:
        """Add a steady state: the sum of all flows is compared with zero, without storage.

        Args:
            flows: Flows into the model, by condition [N mm/s].
            stored: Heat stored [N mm].
            rounding: Rounding error of flows that cancel; smaller defects count as zero [N mm/s].
        """
        total_flow = sum(abs(f) for f in flows.values())
        if total_flow > rounding:
            self.heat = max(self.heat, abs(sum(flows.values())) / total_flow)
        # Later steps are summed from this state.
        self.end_sum += stored - self.stored
        self.stage_sum += stored - self.stored
        self.stored, self.last_flows = stored, dict(flows)
