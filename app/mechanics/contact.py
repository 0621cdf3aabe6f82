r"""Contact: unknown jumps at contact points, coupled to the bonded displacement.

The displacement of body b is U_b = u + B_b q, with q the jumps, three per contact point. K_b is the
stiffness of the body. The equilibrium of a linear scene is

.. math:: K u + C q = f, \qquad C^T u + D q - f_q + W F = 0,
          \qquad C = \sum_b K_b B_b, \quad D = \sum_b B_b^T K_b B_b, \quad f_q = \sum_b B_b^T f_b,

with W the diagonal matrix of the areas of the contact points, and F their tractions [MPa]. So F is
-e/W, with e = C^T u + D q - f_q. Without elastic layers F is the multiplier, too. With the vector
ΔG(q) of `forms.contact`, the law F = P(F + r ΔG) is then one equation per point:

.. math:: e + W P(-e/W + r ΔG(q)) = 0.

Its Jacobian rows are (1 - P') [C^T, D] + r W P'. At open points (P' = 0) the row is equilibrium. At
points that stick (P' = 1) the row prescribes the jump. If all points stick from rest and without
gaps, the solution is the bonded one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from pydantic_core import PydanticCustomError

from app.foundation.arrays import Bools, Floats, Ints
from app.foundation.errors import InputError
from app.interfaces.contact_points import contact_points
from app.interfaces.corners import BY_RIGID_REGION
from app.interfaces.interface_facets import gathered_arrays
from app.laws.values import amplitude
from app.mechanics.body_forms import BodyForms
from app.mechanics.contact_gaps import ContactGaps
from app.mechanics.contact_motions import ContactMotions
from app.mechanics.contact_remedies import ContactRemedies
from app.mechanics.contact_state import (
    ContactState,
    LocalPoints,
    prescribed_jump,
    refuse_supports,
    refuse_supports_of_free_regions,
    with_rigid_regions,
)
from app.mechanics.finite_sliding import FiniteSliding
from app.mechanics.jump_coupling import JumpCoupling
from app.mechanics.point_forces import PointForces, normal_force
from app.mechanics.point_laws import PointLaws
from app.mechanics.stiffness import Stiffness
from app.numerics.sparse import owners
from app.scene.bodies import facets_of_interfaces
from app.scene.frames import vertex_constraints
from app.scene.scene import Scene
from forms.contact import OPEN, SLIP

# A face counts as closed if its gap is below this fraction of the motion, or of the jump [-].
CLOSED_GAP = 1e-6


@dataclass(frozen=True)
class TrialState:
    """Contact at a trial state.

    Attributes:
        contact: The contact of all interfaces.
        equilibrium: Residual e of equilibrium at local points (n, 3) [N].
        jump: Jumps of local points (n, 3) [mm].
        forces: Forces by the laws, and their derivatives.
    """

    contact: ContactInterfaces
    equilibrium: Floats
    jump: Floats
    forces: PointForces

    def friction_and_slip(self) -> tuple[Floats, Floats]:
        """Friction [MPa] and slip [mm] of a step by the laws, each (n, 3).

        Both are exactly zero, without errors of the solver, at points that are open or stick, that
        have no friction, or whose law is not contact alone.
        """
        contact, law = self.contact, self.forces
        force = law.force - normal_force(law.pressures, contact.local.normals)
        force_deficit = contact.local.project_free(contact.multiplier(self.equilibrium) - force)
        motion = (
            self.jump - contact.gaps.reference + force_deficit / contact.laws.augmentation[:, None]
        )
        has_friction = contact.laws.has_friction & contact.laws.is_contact
        is_slipping = (has_friction & (law.status == SLIP))[:, None]
        closed_faces = self._closed_faces(motion)
        friction = np.where(is_slipping, contact.local.tangential(force, closed_faces), 0.0)
        slip = np.where(is_slipping, contact.local.tangential(motion, closed_faces), 0.0)
        return friction, slip

    def _closed_faces(self, motion: Floats) -> Bools:
        """Faces that count as closed for a motion (n, 3): pressed, or with a small gap.

        At an edge the tangential direction is along the edge. If friction on one face holds the
        point against another face, there is a force across the edge too, but no slip.
        """
        rounding = CLOSED_GAP * np.linalg.norm(motion, axis=1)
        is_nearly_closed = self.contact.gaps.openings(self.jump) <= rounding[:, None]
        return np.asarray((self.forces.pressures > 0) | is_nearly_closed)

    def slip(self, friction: Floats) -> Floats:
        """Slip (n, 3) [mm] under a friction (n, 3) [MPa]: the definition of slip in the program.

        It is the tangential part of the jump at a point in contact (d_T of eq. 3), without the
        elastic part of a layer; 0 where the point is open. In small sliding it follows from the
        current jump and friction. In finite sliding it is summed over the steps, and kept where the
        point opens.
        """
        contact = self.contact
        sliding_motion = self.tangential_in_contact(self.jump - self._layer_stretch(friction))
        slip = np.where(
            contact.laws.is_contact[:, None], sliding_motion, self.forces.outputs["slip"]
        )
        if contact.finite_sliding is not None:
            rows = contact.finite_sliding.rows
            slip[rows] = (
                contact.state.slip[rows]
                + self.tangential_in_contact(self.jump - contact.gaps.reference)[rows]
            )
        return slip

    def _layer_stretch(self, friction: Floats) -> Floats:
        return np.einsum("pij,pj->pi", self.contact.laws.compliance, friction)

    def tangential_in_contact(self, motion: Floats) -> Floats:
        """Tangential part of a motion where points touch, 0 where they are open (n, 3) [mm]."""
        is_touching = (self.contact.laws.can_open & (self.forces.status != OPEN))[:, None]
        tangential = self.contact.local.tangential(motion, self._closed_faces(motion))
        return np.where(is_touching, tangential, 0.0)

    def committed(self) -> ContactState:
        """State of the points after a converged step: jump, tractions, path, dissipation.

        *path*: A point that ends a step in contact slides by the tangential part of the step: the
        motion for which the law computes its friction. Open points do not slide.

        *dissipation*: That of friction, of the law, and of the debonded area. Friction is the
        implicit sum: new friction times the slip of the step. The incremental potential (eq. 55)
        makes it non-negative at each point. The trapezoidal rule is negative when friction
        reverses.

        *work*: By the trapezoidal rule, so that the energy balance closes.

        *contact_work*: Work of the pressures in the gap, which is zero in exact load steps. So it
        is the error of steps in which points close or open. It contains the normal energy of a
        layer, which is released when the layer opens.
        """
        contact, law = self.contact, self.forces
        before = contact.state
        weight = contact.local.weight
        step, gap_vector = self.jump - contact.gaps.reference, contact.gaps.gap_vector(self.jump)
        # Equilibrium along a prescribed jump contains the support reaction: take the law's force.
        force = contact.forces(self.equilibrium) + contact.local.prescribed_tangential(law.force)
        normal = normal_force(law.pressures, contact.local.normals)
        friction = force - normal
        outputs, slip = law.outputs, self.slip(friction)
        friction_work = np.einsum("pi,pi->p", *self.friction_and_slip())
        dissipated = weight * (outputs["dissipated"] + law.debonded_friction_work + friction_work)
        layer_energy = np.einsum("pi,pij,pj->p", force, contact.laws.compliance, force) / 2
        slip_step = self.tangential_in_contact(
            step - self._layer_stretch(friction - before.friction)
        )
        slip_step = np.where(contact.laws.is_contact[:, None], slip_step, slip - before.slip)
        slip_length = np.linalg.norm(slip_step, axis=1)
        contact_work = (
            np.einsum(
                "pi,pi->p",
                before.force - before.friction + normal,
                gap_vector - before.gap_vector,
            )
            / 2
        )
        return ContactState(
            jump=self.jump.copy(),
            jump_at_insertion=before.jump_at_insertion,
            force=force,
            friction=friction,
            gap_vector=gap_vector,
            slip=slip,
            step_slip=slip_length,
            path=before.path + slip_length,
            stored=weight * (outputs["stored"] + layer_energy),
            dissipation=before.dissipation + dissipated,
            smallest_dissipation=np.minimum(before.smallest_dissipation, dissipated),
            contact_work=before.contact_work + weight * contact_work,
            work=before.work
            + weight
            * np.einsum(
                "pi,pi->p", (force + before.force) / 2, self.jump - contact.gaps.committed_jump
            ),
            internal_variables=law.internal_variables,
        )


class ContactInterfaces:
    """Contact of all interfaces on this rank: its parts, the committed state, and the residual.

    Attributes:
        points: All contact points, replicated.
        facets: All interface facets, replicated.
        edge_lengths: Mean edge of the facets of each interface [mm].
        local: The points of this rank.
        coupling: Coupling of the jumps to the displacement.
        laws: Laws at the local points.
        finite_sliding: Points with finite sliding, if any.
        gaps: Gaps of the local points.
        motions: Rigid motions of the bodies at the points.
        remedies: Changes of the laws that remedies of Newton's method ask for.
        state: Committed state of the local points.
        prescribed: Jumps prescribed by supports at the current time (n, 3) [mm].

    Raises:
        InputError: An interface has no facets on this mesh.
    """

    saved = ("state", "finite_sliding")

    def __init__(
        self,
        body_forms: BodyForms,
        stiffness: Stiffness,
        augmentation_factor: float,
    ) -> None:
        scene, tagged, bodies = body_forms.scene, body_forms.tagged, body_forms.bodies
        self._supports, self._stiffness = scene.supports, stiffness
        self.comm = body_forms.mesh.comm
        space, interfaces = body_forms.space, scene.parting_interfaces
        self.facets = facets_of_interfaces(tagged, bodies, space, interfaces, scene.moduli)
        holds, axes = vertex_constraints(
            stiffness.frames, tagged, bodies, space, scene.supports, self.facets
        )
        if scene.rigid:
            constraints_of_stages = stiffness.constraints_of_stages()
            holds = with_rigid_regions(body_forms, constraints_of_stages, self.facets, holds, axes)
            refuse_supports_of_free_regions(scene, bodies, holds, self.facets, axes)
        self.points, entries = contact_points(
            self.facets, holds, [c.name for c in interfaces], axes
        )
        refuse_supports(scene, self.points)
        slides_finitely = np.isin(
            self.points.interface, [i for i, c in enumerate(interfaces) if c.between]
        )
        # A point with finite sliding has one face: the surface under it.
        self.points.faces[slides_finitely], self.points.normals[slides_finitely, 1:] = 1, 0.0
        rows, self._number_of_point = owners(self.comm, space.dofmap.index_map, self.points.dof)
        self.local = LocalPoints.of(self.points, rows)
        edges = np.linalg.norm(self.facets.x - np.roll(self.facets.x, 1, axis=1), axis=2)
        self.edge_lengths = [
            float(edges[self.facets.interface == i].mean()) for i in range(len(interfaces))
        ]
        self._nodes = self.points.dof[rows] - space.dofmap.index_map.local_range[0]
        self._unit_jumps = self._jumps_by_supports()
        self.coupling = JumpCoupling(
            body_forms, stiffness.constraints, entries, self._number_of_point, len(rows)
        )
        self.finite_sliding: FiniteSliding | None = None
        if stiffness.followers:
            dof = self.points.dof[rows]
            self.finite_sliding = FiniteSliding(body_forms, self.local, dof, stiffness.followers)
        self.laws = PointLaws(self.comm, self.local, body_forms.timing)
        self.gaps = ContactGaps(self.comm, self.points, self.local, self.laws, self.finite_sliding)
        self.motions = ContactMotions(
            body_forms,
            stiffness,
            self.points,
            self.local,
            has_finite_sliding=self.finite_sliding is not None,
        )
        self.remedies = ContactRemedies(
            self.comm, self.points, self.local, self.laws, self.motions, self._held_points
        )
        self.begin(scene, augmentation_factor)

    def begin(self, scene: Scene, augmentation_factor: float) -> None:
        """Reset to the unloaded state, with other laws of the same interfaces; collective.

        The default augmentation is ``augmentation_factor`` times the softest stiffness per area.
        """
        self._interfaces = scene.parting_interfaces
        fields = [{"gap": c.gap, **c.constants} for c in self._interfaces]
        values = {
            name: np.zeros(len(self.points.weight)) for constants in fields for name in constants
        }
        for i, (c, constants) in enumerate(zip(self._interfaces, fields, strict=True)):
            # On every rank at all points, so that an error is raised on every rank.
            at_interface = self.points.interface == i
            for name, value_at in constants.items():
                values[name][at_interface] = value_at(self.points.x[at_interface])
            try:
                c.law.check({name: values[name][at_interface] for name in c.constants})
            except PydanticCustomError as error:
                key = ".".join(("interfaces", c.name, *(error.context or {})["at"]))
                raise InputError(f"{key}: {error}") from error
        local_values = {
            name: values_at_all[self.local.rows] for name, values_at_all in values.items()
        }
        laws = [c.law for c in self._interfaces]
        self.laws.begin(laws, local_values, augmentation_factor, self.coupling.jump_stiffness())
        self.gaps.begin(scene, values["gap"])
        self.remedies.begin()
        self.state: ContactState = ContactState.at_rest(
            len(self.local), self.laws.internal_variables
        )
        self.set_time(0.0)
        self.state.gap_vector = self.gaps.gap_vector(self.state.jump)

    def _jumps_by_supports(self) -> list[Floats]:
        """Jumps of local points that each support prescribes at full amplitude (n, 3) [mm]."""
        constraints, local = self._stiffness.constraints, self.local
        jumps = []
        for k, support in enumerate(self._supports):
            unit_displacement = np.zeros((len(local), 3))
            if (self.points.prescribing_support == BY_RIGID_REGION).any():
                unit = PETSc.Vec().createWithArray(constraints.unit[k].copy(), comm=self.comm)
                unit_displacement = constraints.expand(unit).array_r.reshape(-1, 3)[self._nodes]
            jumps.append(prescribed_jump(self.points, local.rows, k, support, unit_displacement))
        return jumps

    def update_stiffness(self) -> None:
        """Reassemble the coupling for changed stiffness or supports."""
        self.motions.update_supports()
        self._unit_jumps = self._jumps_by_supports()
        self.coupling.update(self._stiffness.constraints)
        self.laws.update_stiffness(self.coupling.jump_stiffness())

    def set_time(self, load_time: float) -> None:
        """Set gaps and prescribed jumps to a time of the loads."""
        self.gaps.set_time(load_time, self.state.jump)
        self.prescribed = np.zeros((len(self.local), 3))
        for support, jump in zip(self._supports, self._unit_jumps, strict=True):
            self.prescribed += amplitude(support.history, load_time) * jump

    def commit(self, state: ContactState, time: float) -> None:
        """Set the committed state, and its time in the run."""
        if time <= self.gaps.end_of_insertion:
            state.jump_at_insertion = state.jump
        self.state = state
        self.gaps.commit(state.jump, time)

    def _touching(self) -> Bools:
        """Mask of points that touch: committed jumps and forces, gaps of the current time (n,)."""
        is_closed = (self.gaps.openings(self.state.jump) <= 0) & self.local.is_face
        return np.asarray(self.state.force.any(axis=1) | is_closed.any(axis=1))

    def _held_points(self) -> tuple[Bools, Bools]:
        """Masks of points that touch or are bonded, and that resist any jump (n,)."""
        state, switches = self.state, self.remedies.switches
        forces = self.laws.evaluate(state.force, state.jump, self.gaps.initial_gap, state, switches)
        touching = self._touching() | forces.bonded
        return touching, self._sticking(touching, forces.bonded)

    def is_apart(self) -> bool:
        """Return True if no point touches in the committed state; collective."""
        return not self.comm.allreduce(bool(self._touching().any()), MPI.LOR)

    def unresisted_motions(self, forces: PointForces) -> Floats:
        """Rigid motions that nothing resists in a state (6 bodies, k); collective."""
        return self.motions.unresisted(self._sticking(forces.touching, forces.bonded))

    def motions_resisted_by_open_points(self, forces: PointForces) -> Floats:
        """Rigid motions that only open points resist (6 bodies, k); collective."""
        sticking = self._sticking(forces.touching, forces.bonded)
        return self.motions.resisted_by_open_points(forces.touching, sticking)

    def _sticking(self, touching: Bools, bonded: Bools) -> Bools:
        """Mask of points that resist any jump, by friction, a bond or a remedy (n,)."""
        return bonded | self.remedies.switches.stuck | (touching & self.laws.has_friction)

    def augmentation(self) -> dict[str, float]:
        """Augmentation of each interface that can open [MPa/mm], by name; collective."""
        values = self.laws.largest_augmentation()
        return {self._interfaces[i].name: value for i, value in values.items()}

    def gather(self, values: Floats) -> Floats:
        """Gather values (n, ...) of local points to the values of all points; collective."""
        return np.asarray(gathered_arrays(self.comm, values)[0][self._number_of_point])

    @property
    def row_keys(self) -> Ints:
        """Keys of local contact points."""
        return self.local.rows

    # Residual and Jacobian

    def trial(self, u: PETSc.Vec, q: PETSc.Vec, f_q: Floats) -> TrialState:
        """Trial state at a displacement and jumps, under forces f_q on the jumps [N]."""
        e = self.coupling.equilibrium(u, q, f_q).copy()
        jump = self.with_prescribed(q.array.reshape(-1, 3))
        return TrialState(self, e, jump, self.evaluate(e, jump))

    def forces(self, e: Floats) -> Floats:
        """Interface force per area from equilibrium (n, 3) [MPa]; zero where supports hold."""
        return self.local.project_free(-e / self.local.weight[:, None])

    def multiplier(self, e: Floats) -> Floats:
        """Multiplier λ, the part of the trial force without r ΔG (n, 3) [MPa].

        Without a layer it is the traction F = -e/W. With an elastic layer of compliance c it is
        λ = F - r c (F - F_old), with F_old the friction of the last converged state, which has no
        normal part. Contact then holds for the jump without the stretch of the layer, for any r.
        """
        F, layers = self.forces(e), np.eye(3) - self.laws.multiplier_share
        return F - np.einsum("pij,pj->pi", layers, F - self.state.friction)

    def evaluate(self, e: Floats, q: Floats) -> PointForces:
        """The laws at local points for equilibrium and jumps."""
        forces = self.laws.evaluate(
            self.multiplier(e),
            self.with_prescribed(q),
            self.gaps.initial_gap,
            replace(self.state, jump=self.gaps.reference),
            self.remedies.switches,
        )
        self.remedies.last_trial_force = forces.trial_force
        return forces

    def with_prescribed(self, q: Floats) -> Floats:
        """Return jumps (n, 3) with prescribed components in place of the solver's [mm]."""
        return self.local.project_free(q) + self.prescribed

    def residual(self, e: Floats, q: Floats, law: PointForces) -> Floats:
        """Residual e + W P at local points (n, 3) [N]; prescribed jumps where supports hold."""
        local, project_free = self.local, self.local.project_free
        r = e + local.weight[:, None] * law.force
        scale = self.laws.augmentation * local.weight
        return project_free(r) + scale[:, None] * (q - project_free(q) - self.prescribed)

    def row_factors(self, law: PointForces) -> tuple[Floats, Floats]:
        """Derivatives of the residual: factors of [C^T, D], and blocks added to D, both (n, 3, 3).

        For contact they are 1 - P' and r W P' in the free directions; see the module's docstring.
        In prescribed directions the blocks are r W.
        """
        free_projector, weight = self.local.free_projector, self.local.weight
        P = free_projector @ law.by_multiplier @ self.laws.multiplier_share @ free_projector
        by_jump = free_projector @ law.by_jump @ free_projector
        scale = (self.laws.augmentation * weight)[:, None, None]
        return free_projector - P, weight[:, None, None] * by_jump + scale * self.local.projector
