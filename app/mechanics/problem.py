r"""The discrete problem of a scene: the equilibrium of its bodies and interfaces.

Unknowns are the continuous displacement u, and the jumps q of the contact points where the scene
has interfaces. `Problem.residual` is the sum of all terms,

.. math:: r_u = K u + C q - f, \qquad
          r_q = \underbrace{C^T u + D q - f_q}_{e} + W F,

with

- K, C, D: the elastic energy of the bodies (`BodyForms.body_energy`), its derivatives by u and q
  (`Stiffness.K`, `JumpCoupling.C`, `JumpCoupling.D`). They change when a region sets or its density
  changes (`update_stiffness`, `follow_density`) or when supports do (`set_stage`).
- f, f_q: the forces on u and q (`Forces.total_at`, by `set_time`). They are the work of the loads
  (`Load.work`), eigenstrains, thermal expansion (`set_temperature`, `ThermalStrain`), and the
  stress history of regions that set or creep (`update_stiffness`, `StressHistory`).
- e: the equilibrium of the contact points (`JumpCoupling.equilibrium`); W their areas.
- F: the forces of contact and other laws at equilibrium and jumps (`ContactInterfaces.trial`, by
  `PointLaws.evaluate` from `InterfaceLaw.response`). `mechanics.contact` has the law F = P(S).
- In rows that supports prescribe, r_u is the deviation from their values (`Stiffness.prescribed`).

`mechanics.systems` adds the Jacobian. Heat changes f, and K, C and D of regions that set; the
pressures and friction of `trial` change the heat (`stepping.contact_heat`), whose equations are in
`heat.implicit_step`.
"""

from __future__ import annotations

from collections.abc import Mapping

from petsc4py import PETSc

import numpy as np
from dolfinx import fem

from app.foundation.arrays import Floats, Ints
from app.laws.values import amplitude
from app.mechanics.body_forms import BodyForms
from app.mechanics.contact import ContactInterfaces, TrialState
from app.mechanics.creep import CreepState
from app.mechanics.external_forces import Forces
from app.mechanics.followers import Followers, finitely_sliding, refuse_motions
from app.mechanics.sliding_bodies import SlidingBodies
from app.mechanics.stiffness import Stiffness, rounding
from app.mechanics.stress_history import StressHistory
from app.mechanics.thermal_strain import ThermalStrain
from app.numerics.saved_state import node_keys
from app.scene.bodies import bodies_of
from app.scene.scene import Scene
from app.system.timing import Timing
from meshes.distribute import TaggedMesh


class Problem:
    """Operators and state of a scene; made collectively.

    Attributes:
        stiffness: Stiffness of the bodies, with its constraints.
        forces: Loads, eigenstrains and free strains.
        contact: Contact of the interfaces, if there are any.
        stress_history: Stress history of regions that set or creep, if any.
        thermal_strain: Thermal expansion of regions with constant moduli, if any.
        u: Displacement, the continuous field.
        jump_displacements: Displacement of each body that jumps move.
        followers: Nodes of surfaces with finite sliding, if there are any.
        sliding_bodies: State of bodies with such surfaces.
        time: Current time: stage k runs from k to k + 1.
        load_time: Time on the load histories at the current time.
        f: Forces on the unknowns of the displacement at that time [N].
        f_q: Forces on the jumps [N].
        prescribed: Values of constrained unknowns (n,).
        size_of_loads: Norm of the nodal forces of loads and free strains [N].
        size: Diagonal of the bounding box of the model [mm].

    Args:
        augmentation_factor: Ratio of the default augmentation to the softest stiffness [-].
        same_stiffness: Problem with other parting interfaces and the same constant stiffness, whose
            inverse is shared.

    Raises:
        InputError: The scene does not fit the mesh.
    """

    saved = ("time", "stiffness", "u", "body_forms", "contact", "stress_history", "sliding_bodies")

    def __init__(
        self,
        scene: Scene,
        tagged: TaggedMesh,
        augmentation_factor: float,
        timing: Timing,
        same_stiffness: Problem | None = None,
    ) -> None:
        self.scene, self.tagged = scene, tagged
        self.comm = tagged.mesh.comm
        points = tagged.mesh.geometry.x
        # A rank may be without cells, and then it has no points.
        lower_corner = self.comm.allreduce(points.min(axis=0, initial=np.inf), np.minimum)
        upper_corner = self.comm.allreduce(points.max(axis=0, initial=-np.inf), np.maximum)
        self.size = float(np.linalg.norm(upper_corner - lower_corner))
        self.bodies = bodies_of(tagged, scene.parting_interfaces, scene.rigid)
        self.body_forms = BodyForms(scene, tagged, self.bodies, timing)
        self.space = self.body_forms.space
        self.u = self.body_forms.u
        self.stress_history = (
            StressHistory(self.body_forms) if self.body_forms.path_dependent_regions else None
        )
        refuse_motions(self.body_forms)
        self.followers = Followers(self.body_forms) if finitely_sliding(scene) else None
        shared_stiffness = same_stiffness.stiffness if same_stiffness else None
        self.stiffness: Stiffness = Stiffness(self.body_forms, shared_stiffness, self.followers)
        self.contact = (
            ContactInterfaces(self.body_forms, self.stiffness, augmentation_factor)
            if scene.parting_interfaces
            else None
        )
        self.jump_displacements = {
            body: fem.Function(self.space, name=f"displacement {self.bodies.names[body]}")
            for body in (self.contact.coupling.jump_to_displacement if self.contact else ())
        }
        self.sliding_bodies: SlidingBodies | None = None
        sliding_points = self.contact.finite_sliding if self.contact else None
        if self.contact and sliding_points:
            self.sliding_bodies = SlidingBodies(
                self.body_forms,
                self.stiffness,
                self.contact,
                sliding_points,
                self.jump_displacements,
            )
        self.forces = Forces(scene, self.body_forms, self.contact)
        self.thermal_strain = (
            ThermalStrain(self.body_forms) if self.body_forms.free_strain else None
        )
        self.set_time(0.0)

    def begin(self, scene: Scene, augmentation_factor: float) -> None:
        """Reset to the unloaded state, with other loads and laws; matrices stay; collective.

        Args:
            scene: Scene that differs in the values of loads and in contact laws alone.
            augmentation_factor: Ratio of the default augmentation to the softest stiffness [-].
        """
        self.scene = scene
        self.set_stage(0, self.stiffness.K.createVecRight())
        for function in self._functions:
            function.x.array[:] = 0
        if self.stress_history:
            self.stress_history.begin()
        if self.sliding_bodies:
            self.sliding_bodies.begin(scene)
        if self.contact:
            self.contact.begin(scene, augmentation_factor)
        self.forces = Forces(scene, self.body_forms, self.contact, self.forces)
        self.set_time(0.0)

    def _reassemble(self) -> None:
        self.stiffness.update()
        self._follow_stiffness()

    def _follow_stiffness(self) -> None:
        if self.contact:
            self.contact.update_stiffness()
        self.set_time(self.time)

    # Saved state

    @property
    def row_keys(self) -> dict[str, Ints]:
        """Keys of the nodes that own the rows of saved arrays, by attribute."""
        return {"u": node_keys(self.space), "body_forms": node_keys(self.body_forms.scalars)}

    def restored(self) -> None:
        """Update supports and stiffness to the restored stage and cure; collective."""
        stage = self.stiffness.stage
        # The matrices are those of the first stage.
        self.stiffness.stage = 0
        self.set_stage(stage, self.stiffness.K.createVecRight())
        if self.body_forms.modulus_ratio:
            self._reassemble()
        self.follow_density()
        self.set_time(self.time)

    def restore_unknowns(self, u: PETSc.Vec, q: PETSc.Vec | None) -> None:
        """Set the unknowns to the restored displacement and jumps; collective."""
        owned = 3 * self.space.dofmap.index_map.size_local
        nodal = (
            self.sliding_bodies.restore_pairs() if self.sliding_bodies else self.u.x.array[:owned]
        )
        self.stiffness.constraints.contract(nodal).copy(u)
        if self.contact:
            assert q is not None
            self.contact.commit(self.contact.state, self.time)
            q.array[:] = self.contact.state.jump.ravel()
        self.update_displacements(u, q)
        if self.sliding_bodies and q is not None:
            self.sliding_bodies.begin_at(self.trial(u, q))
        if self.stress_history:
            self.stress_history.begin_at(self.displacements())

    @property
    def creep(self) -> CreepState | None:
        """State of the regions that creep, if any."""
        return self.stress_history.creep if self.stress_history else None

    # State in time

    def set_stage(self, stage: int, u: PETSc.Vec) -> None:
        """Activate the supports of a stage; reassemble if they changed; collective.

        The displacement of the unknowns u is kept.
        """
        if self.stiffness.set_stage(stage, u):
            self._follow_stiffness()

    def set_time(self, time: float) -> None:
        """Set loads, supports and gaps to a time; the state itself is unchanged."""
        self.time, self.load_time = time, self.scene.load_time(time)
        if self.followers:
            self.followers.set_time(self.load_time)
        if self.contact:
            self.contact.set_time(self.load_time)
        if self.sliding_bodies:
            self.sliding_bodies.follow_pairs()
        self._set_forces(self.load_time)

    def _set_forces(self, load_time: float) -> None:
        total = self.forces.total_at(load_time)
        nodal = PETSc.Vec().createWithArray(total.nodal, comm=self.comm)
        self.f, self.f_q = self.stiffness.constraints.vector(nodal), total.jump
        self.size_of_loads = float(self.f.norm())
        amplitudes = [amplitude(s.history, load_time) for s in self.scene.supports]
        self.prescribed = self.stiffness.prescribed(self.f, amplitudes)
        self.body_forms.set_amplitudes(
            {
                (elastic.region, k): amplitude(strain.history, load_time)
                for elastic in self.scene.elastic
                for k, strain in enumerate(elastic.eigenstrains)
            }
        )

    def set_temperature(self, temperatures: Mapping[str, fem.Function]) -> None:
        """Set the temperatures of thermal expansion; the state itself is unchanged.

        Args:
            temperatures: Values at the vertices of each expanding region [K], ghosts included.
        """
        if self.thermal_strain:
            self.forces.set_eigenforces("heat", self.thermal_strain.set(temperatures))
            if self.stress_history:
                self.stress_history.set_free_strain(self.body_forms.free_strain)
        self.set_time(self.time)

    def update_stiffness(self) -> None:
        """Update stiffness and prestress of regions with stress history before a solve; collective.

        Matrices are assembled again, in place, only if a modulus has changed.
        """
        if self.stress_history is None:
            return
        if self.stress_history.update_moduli():
            self._reassemble()
        self.forces.set_eigenforces("stress history", self.stress_history.forces())
        self.set_time(self.time)

    def follow_density(self) -> None:
        """Update moduli and matrices where densities change; collective."""
        if self.body_forms.density_regions:
            self.body_forms.follow_density()
            if self.thermal_strain:
                self.thermal_strain.assemble()
                self.forces.set_eigenforces("heat", self.thermal_strain.forces())
            self._reassemble()

    def impose(self, u: PETSc.Vec) -> None:
        """Set the constrained unknowns of a displacement to their current values."""
        is_constrained = self.stiffness.constraints.constrained
        u.array[is_constrained] = self.prescribed[is_constrained]

    # Residual and Jacobian

    def trial(self, u: PETSc.Vec, q: PETSc.Vec) -> TrialState:
        """Contact at a trial state; only for scenes with contact."""
        assert self.contact is not None
        return self.contact.trial(u, q, self.f_q)

    def residual(
        self, u: PETSc.Vec, q: PETSc.Vec | None, r_u: PETSc.Vec, r_q: PETSc.Vec | None = None
    ) -> TrialState | None:
        """Sum the terms of equilibrium into r_u and r_q [N]; return contact at the state with r_q.

        In constrained rows the residual is the deviation from the prescribed values: a kept
        preconditioner of another stage does not leave these rows unchanged.
        """
        # Bodies: elastic energy, loads and free strains, supports.
        self.stiffness.K.mult(u, r_u)
        if self.contact:
            self.contact.coupling.C.multAdd(q, r_u, r_u)
        r_u.axpy(-1.0, self.f)
        is_constrained = self.stiffness.constraints.constrained
        r_u.array[is_constrained] = (
            self.stiffness.mean_diagonal * (u.array_r - self.prescribed)[is_constrained]
        )
        if self.contact is None or q is None or r_q is None:
            return None
        # Interfaces: equilibrium of the contact points, and the forces of their laws.
        trial = self.contact.trial(u, q, self.f_q)
        jumps = q.array_r.reshape(-1, 3)
        r_q.array[:] = self.contact.residual(trial.equilibrium, jumps, trial.forces).ravel()
        return trial

    def update_pairs(self, u: PETSc.Vec, q: PETSc.Vec | None) -> bool:
        """As `SlidingBodies.update_pairs`; False without finite sliding; collective."""
        if q is None or self.sliding_bodies is None:
            return False
        trial = self.trial(u, q)
        self.update_displacements(u, q)
        paired = self.sliding_bodies.update_pairs(trial, u, q)
        if paired:
            self._set_forces(self.load_time)
        return paired

    def size_of_forces(self, u: PETSc.Vec, q: PETSc.Vec | None) -> float:
        """Size of all forces in a state: loads, interface forces and reactions [N]; collective.

        The forces that a change of the prescribed displacements alone would cause are no scale: on
        a fine mesh they exceed all others by far.
        """
        reactions = self.stiffness.reactions * u
        if self.contact is None:
            return self.size_of_loads + float(reactions.norm())
        forces_of_jumps = self.contact.coupling.C * q
        reactions.array[:] += forces_of_jumps.array_r[self.stiffness.constraints.constrained]
        e = self.contact.coupling.equilibrium(u, q, self.f_q)
        return self.size_of_loads_and_interface_forces(e) + float(reactions.norm())

    def size_of_loads_and_interface_forces(self, e: Floats) -> float:
        """Size of loads and interface forces, from equilibrium e (n, 3) [N]; collective."""
        assert self.contact is not None
        forces = self.contact.local.project_free(e), self.f_q
        local_squares = np.array([float(np.sum(force**2)) for force in forces])
        return self.size_of_loads + float(np.sqrt(self.comm.allreduce(local_squares)).sum())

    def rounding(self, u: PETSc.Vec, q: PETSc.Vec | None = None) -> float:
        """Residual that rounding alone causes [N]; large for a stiff body that moves."""
        error = rounding(self.stiffness.diagonal, u)
        if self.contact and q is not None:
            error += rounding(self.contact.coupling.D.getDiagonal(), q)
        return error

    # State

    def update_displacements(self, u: PETSc.Vec, q: PETSc.Vec | None) -> None:
        """Update the displacement of each body from the unknowns."""
        nodal = self.stiffness.constraints.expand(u)
        owned = nodal.getLocalSize()
        self.u.x.petsc_vec.array[:owned] = nodal.array
        self.u.x.scatter_forward()
        if self.contact is None:
            return
        jump_displacement = nodal.duplicate()
        for body, B in self.contact.coupling.jump_to_displacement.items():
            B.mult(q, jump_displacement)
            function = self.jump_displacements[body]
            function.x.petsc_vec.array[:owned] = nodal.array + jump_displacement.array
            function.x.scatter_forward()

    @property
    def contact_work(self) -> float:
        """Work of the interface forces since the beginning, the part of this rank [N mm]."""
        if self.contact is None:
            return 0.0
        work = self.contact.state.work
        if self.sliding_bodies is None:
            return float(work.sum())
        assert self.contact.finite_sliding
        return (
            float(np.delete(work, self.contact.finite_sliding.rows).sum())
            + self.sliding_bodies.work
        )

    def displacements(self) -> list[fem.Function]:
        """Displacement of each body, as last updated."""
        return [self.jump_displacements.get(b, self.u) for b in range(len(self.bodies.names))]

    @property
    def _functions(self) -> list[fem.Function]:
        """Displacements and thermal strains, which change before a step is committed."""
        strains = self.body_forms.free_strain.values()
        return [self.u, *self.jump_displacements.values(), *strains]

    def keep(self) -> None:
        """Keep time, displacements and thermal strains for `return_to_kept`."""
        self._kept = self.time, [f.x.array.copy() for f in self._functions]

    def return_to_kept(self) -> None:
        """Return to the time, displacements and thermal strains last kept; collective."""
        time, values = self._kept
        for function, kept in zip(self._functions, values, strict=True):
            function.x.array[:] = kept
        if self.thermal_strain:
            self.forces.set_eigenforces("heat", self.thermal_strain.forces())
        self.set_time(time)

    def commit(self, trial: TrialState | None) -> None:
        """Commit a converged state, after `update_displacements`."""
        if trial is not None:
            trial.contact.commit(trial.committed(), self.time)
            if self.sliding_bodies:
                self.sliding_bodies.commit(trial)
        if self.stress_history:
            self.stress_history.commit(self.displacements())
