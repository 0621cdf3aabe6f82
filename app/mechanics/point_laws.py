"""Interface laws at the contact points of one rank: UFL in, arrays out; their trial stiffness.

Points with the same number of faces and laws of the same form share one compiled law. A scene
without friction, or without edges, never compiles the laws with friction, or those of edges.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import numpy as np
from ufl import as_ufl
from ufl.core.expr import Expr

from app.foundation.arrays import Bools, Floats, Ints
from app.interfaces.faces import dual_vectors
from app.laws import interface_laws
from app.laws.interface_laws import DEFAULT_AUGMENTATION, AtPoint, InterfaceLaw
from app.mechanics.contact_state import ContactState, LocalPoints
from app.numerics import pointwise
from app.numerics.pointwise import Pointwise
from app.system.timing import Timing
from forms import contact
from forms.contact import OPEN, SLIP, STICK

# Outputs that a law may have, with their shapes (see `forms.contact.Response`).
OUTPUTS: dict[str, tuple[int, ...]] = {
    "slip": (3,),
    "stored": (),
    "dissipated": (),
    "dissipated_by_jump": (3,),
    "debonded_share": (),
    "debonded_share_by_jump": (3,),
}
# Prefix of the outputs with new internal variables.
NEW = "new "
# A prescribed slip below this fraction of the jumps counts as zero.
SLIP_ROUNDING = 1e-13
# So does one whose trial force is below this fraction of the whole trial force: it is smaller than
# the errors of the friction along it, which would decide about stick and slip.
REST_TOLERANCE = 1e-11
# The force along a prescribed jump has converged within this fraction of the trial force.
FORCE_TOLERANCE = 1e-12
# Upper bound of such a force over the trial force [-]. It is above the limit of friction.
UPPER_BOUND = 1e3
# Package of the laws of the program.
LAWS = interface_laws.__name__.rpartition(".")[0]
# Folders of its modules and of those with formulas. If the text of one changes, or that of this
# module or `pointwise`, laws are compiled again.
SOURCE_FOLDERS = (Path(contact.__file__).parent, Path(interface_laws.__file__).parent)


@dataclass(frozen=True)
class PointForces:
    """Forces, derivatives and states of the laws at n points.

    Attributes:
        force: Interface force per area (n, 3) [MPa].
        by_multiplier: Generalized derivative of the force by the multiplier (n, 3, 3) [-].
        by_jump: Generalized derivative of the force by the jump (n, 3, 3) [MPa/mm].
        augmentation: Augmentation r, the stiffness of the trial force (n,) [MPa/mm].
        pressures: Pressure on each face, positive in compression (n, 3) [MPa].
        status: OPEN, STICK or SLIP (n,).
        internal_variables: New values of the internal variables of the laws, by name: (n, ...).
        debonded_friction_work: Energy per area that friction of the debonded area dissipates in the
            step (n,) [N/mm].
        outputs: Values of `OUTPUTS`, by name: (n, ...); 0 for laws without them.
    """

    force: Floats
    by_multiplier: Floats
    by_jump: Floats
    augmentation: Floats
    pressures: Floats
    status: Ints
    internal_variables: Mapping[str, Floats]
    debonded_friction_work: Floats
    outputs: Mapping[str, Floats]

    @classmethod
    def zeros(cls, augmentation: Floats, internal_variables: Mapping[str, Floats]) -> PointForces:
        """Return no forces at points of an augmentation (n,) [MPa/mm]; variables are unchanged."""
        n = len(augmentation)
        return cls(
            force=np.zeros((n, 3)),
            by_multiplier=np.zeros((n, 3, 3)),
            by_jump=np.zeros((n, 3, 3)),
            augmentation=augmentation,
            pressures=np.zeros((n, 3)),
            status=np.zeros(n, dtype=np.int64),
            internal_variables={name: values.copy() for name, values in internal_variables.items()},
            debonded_friction_work=np.zeros(n),
            outputs={name: np.zeros((n, *shape)) for name, shape in OUTPUTS.items()},
        )

    @property
    def traction_stiffness(self) -> Floats:
        """Stiffness of the traction alone: `by_jump` - r `by_multiplier` (n, 3, 3) [MPa/mm]."""
        return self.by_jump - self.augmentation[:, None, None] * self.by_multiplier

    @property
    def resisted(self) -> Floats:
        """Fraction of a jump increment that the law resists (n, 3, 3) [-].

        It is `by_multiplier` + k / (k + r), with k the positive principal values of
        `traction_stiffness`.
        """
        K, r = self.traction_stiffness, self.augmentation[:, None]
        sizes, axes = np.linalg.eigh((K + K.transpose(0, 2, 1)) / 2)
        shares = np.maximum(sizes, 0.0) / (np.abs(sizes) + r)
        return self.by_multiplier + (axes * shares[:, None, :]) @ axes.transpose(0, 2, 1)


@dataclass(frozen=True)
class CompiledGroup:
    """Local points with the same number of faces and laws of the same form.

    Attributes:
        rows: The points (n,).
        law: A law of this form.
        kernel: The compiled law.
        debonded_kernel: The compiled contact law of the debonded area, if there is any.
    """

    rows: Ints
    law: InterfaceLaw
    kernel: Pointwise
    debonded_kernel: Pointwise | None


class PointLaws:
    """Laws of the interfaces at the contact points of this rank, during one run.

    Attributes:
        can_open: True where the law can open (n,).
        frictional: True where the law has friction (n,).
        has_contact: True where the law is contact, or has contact of the debonded area (n,).
        dissipates: True where the law declares the energy that it dissipates (n,).
        internal_variables: Shapes of the internal variables of the laws, by name.
        constrained: Mask of points that a remedy forces to stick (n,).
        opened: Mask of points whose contact a remedy switches off (n,). Layers and cohesion still
            act.
        local_stiffness: Stiffness k per area against the jump of each point (n,) [MPa/mm].
        default_augmentation: Default augmentation (n,) [MPa/mm].
        augmentation: Augmentation r, the stiffness of the trial force (n,) [MPa/mm].
        compliance: Compliance C of the elastic layer in series (n, 3, 3) [mm/MPa]; 0 without one.
        layer_share: (1 + k C)^-1: stiffness of the layer over the sum of its and the bodies'
            (n, 3, 3) [-].
        multiplier_share: 1 - r C: factor of the equilibrium force in the trial force (n, 3, 3) [-].
        slides: True where the slip follows from contact, False where the law returns it (n,).
        frozen: True while the internal variables of the laws stay at the last state.
        limiting_force: Trial forces (n, 3) whose pressures limit friction [MPa]; None: those of
            the state itself, as in Coulomb's law.
    """

    def __init__(self, comm: MPI.Comm, points: LocalPoints, timing: Timing) -> None:
        self._comm, self._points, self._timing = comm, points, timing
        self._groups_by_form: dict[tuple[Hashable, ...], list[CompiledGroup]] = {}
        self.frozen = False

    def begin(
        self,
        laws: Sequence[InterfaceLaw],
        values: Mapping[str, Floats],
        factor: float,
        local_stiffness: Floats,
    ) -> None:
        """Set the laws of a run, compiled once for all of the same form; collective.

        Args:
            laws: Law of each interface.
            values: Constants of the laws at local points (n,), by name.
            factor: Default augmentation over the local stiffness per area [-].
            local_stiffness: Stiffness of each jump with all else held (n, 3, 3) [N/mm].
        """
        points, forms = self._points, tuple(law.form for law in laws)
        if forms not in self._groups_by_form:
            with self._timing.phase("compile", "contact"):
                self._groups_by_form[forms] = self._compile_groups(laws)
        self._factor, self._constants = factor, values
        self._groups = self._groups_by_form[forms]
        self._laws = [(law, points.interface == i) for i, law in enumerate(laws)]
        for group in self._groups:
            group.kernel.set(**{name: values[name][group.rows] for name in group.law.constants})
        self.internal_variables = {
            k: shape for law in laws for k, shape in law.internal_variables.items()
        }
        self.can_open = np.array([law.can_open for law in laws])[points.interface]
        self.frictional = np.array([law.friction > 0 for law in laws])[points.interface]
        self.slides = np.array([law.is_contact for law in laws])[points.interface]
        has_contact = [law.is_contact or law.debonded_contact is not None for law in laws]
        self.has_contact = np.array(has_contact)[points.interface]
        self.dissipates = np.array([law.dissipates for law in laws])[points.interface]

        self.constrained = np.zeros(len(points), dtype=bool)
        self.opened = np.zeros(len(points), dtype=bool)
        self.limiting_force: Floats | None = None
        self._trial_force: Floats = np.zeros((len(points), 3))
        self._augmentation_scale = 1.0
        self._layer_stiffness = np.array([min(law.layer or (np.inf,)) for law in laws])[
            points.interface
        ]
        self.compliance = np.zeros((len(points), 3, 3))
        for law, at_points in self._laws:
            if law.layer is not None:
                self.compliance[at_points] = _compliance(
                    points.normals[at_points], points.faces[at_points], *law.layer
                )
        self.update_stiffness(local_stiffness)

    def _compile_groups(self, laws: Sequence[InterfaceLaw]) -> list[CompiledGroup]:
        points, forms = self._points, list(dict.fromkeys(law.form for law in laws))
        number_of_law = np.array([forms.index(law.form) for law in laws], dtype=np.int64)
        number_of_point = number_of_law[points.interface]
        # Compilation is collective: every rank compiles each pair of face count and form that
        # occurs on any rank.
        local_pairs = {
            (int(face_count), int(number))
            for face_count, number in zip(points.faces, number_of_point, strict=True)
            if face_count
        }
        all_pairs: set[tuple[int, int]] = set().union(*self._comm.allgather(local_pairs))
        groups = []
        for face_count, number in sorted(all_pairs):
            rows = np.flatnonzero((points.faces == face_count) & (number_of_point == number))
            law = next(law for law in laws if law.form == forms[number])
            normals = points.normals[rows, :face_count]
            kernel = _compile_law(self._comm, normals, law)
            debonded_kernel = None
            if law.debonded_contact is not None:
                debonded_kernel = _compile_law(self._comm, normals, law.debonded_contact)
            groups.append(CompiledGroup(rows, law, kernel, debonded_kernel))
        return groups

    def set_normals(self, points: Ints) -> None:
        """Set the normals of points of one face to their current values."""
        for group in self._groups:
            if np.isin(group.rows, points).any():
                normal = self._points.normals[group.rows, 0]
                group.kernel.set(normal_0=normal, dual_0=normal)

    # Stiffness of the trial force

    def update_stiffness(self, stiffness: Floats) -> None:
        """Set the default augmentation.

        By default it is a factor times the local stiffness per area in its softest direction: it
        follows materials, cure, mesh and order.

        Args:
            stiffness: Stiffness of each jump with all else held (n, 3, 3) [N/mm].
        """
        self.local_stiffness = np.linalg.eigvalsh(stiffness)[:, 0] / self._points.weight
        softer = self.local_stiffness[:, None, None] * self.compliance
        self.layer_share = np.linalg.inv(np.eye(3) + softer)
        self.default_augmentation = self._layer_stiffness.copy()
        for law, at_points in self._laws:
            # An r above the layer's stiffness would make `multiplier_share` negative.
            r = law.augmentation_of(self.local_stiffness[at_points], self._factor)
            self.default_augmentation[at_points] = np.minimum(r, self._layer_stiffness[at_points])
        self.scale_augmentation(self._augmentation_scale)

    def freeze(self) -> bool:
        """Freeze the internal variables; return True if there are any."""
        self.frozen = bool(self.internal_variables)
        return self.frozen

    def unfreeze(self) -> None:
        """Let the internal variables change."""
        self.frozen = False

    def scale_augmentation(self, factor: float) -> None:
        """Multiply the default augmentation by a factor, until the next call."""
        self._augmentation_scale = factor
        self.augmentation = factor * self.default_augmentation
        layers = self.augmentation[:, None, None] * self.compliance
        self.multiplier_share = np.eye(3) - layers

    def limit_friction(self) -> bool:
        """Limit friction by given pressures, zero at first; collective.

        With given pressures the problem is that of Tresca: it is convex, and has one solution.
        Friction of the debonded area of a cohesive law stays as it is.

        Returns:
            True if there is contact with friction.
        """
        has_local_friction = bool((self.frictional & self.slides).any())
        has_friction = bool(self._comm.allreduce(has_local_friction, MPI.LOR))
        if has_friction:
            self.limiting_force = np.zeros((len(self._points), 3))
        return has_friction

    def release_friction(self) -> None:
        """Limit friction by the pressures of the state."""
        self.limiting_force = None

    def relax_limits(self, share: float) -> float:
        """Move the given pressures by a share towards those of the last state; collective.

        The last state is the one of the last evaluation under given pressures.

        Returns:
            Norm of the difference of the trial forces over that of the last ones [-].
        """
        if self.limiting_force is None:
            raise ValueError("friction is not limited by given pressures")
        difference = self._trial_force - self.limiting_force
        self.limiting_force = self.limiting_force + share * difference
        squares = np.array([(difference**2).sum(), (self._trial_force**2).sum()])
        change, size = np.sqrt(self._comm.allreduce(squares, MPI.SUM))
        return float(change / size) if size else 0.0

    def default_augmentation_ratio(self) -> float:
        """Geometric mean of the default augmentation over the one of the case [-]; collective.

        Remedies use it to leave an unsuitable key `augmentation` or `augmentation_factor`.
        """
        has_augmentation = np.array([law.has_augmentation for law, _ in self._laws])
        is_augmented = has_augmentation[self._points.interface]
        default_augmentation = np.minimum(
            DEFAULT_AUGMENTATION * self.local_stiffness, self._layer_stiffness
        )[is_augmented]
        is_default = np.array_equal(default_augmentation, self.default_augmentation[is_augmented])
        if self._comm.allreduce(is_default, MPI.LAND):
            return 1.0
        logs = float(np.log(default_augmentation / self.default_augmentation[is_augmented]).sum())
        total, count = self._comm.allreduce(np.array([logs, is_augmented.sum()]), MPI.SUM)
        return float(np.exp(total / count)) if count else 1.0

    def largest_augmentation(self) -> dict[int, float]:
        """Augmentation of each interface that can open [MPa/mm]; collective."""
        values = {}
        for i, (law, at_points) in enumerate(self._laws):
            if law.can_open:
                local = float(self.augmentation[at_points].max(initial=0.0))
                values[i] = float(self._comm.allreduce(local, MPI.MAX))
        return values

    # Forces

    def evaluate(
        self, force: Floats, jump: Floats, gap: Floats, state: ContactState
    ) -> PointForces:
        """Evaluate the laws at a trial state: multiplier (n, 3) [MPa], jump and gap (n, 3) [mm]."""
        points, n, r = self._points, len(self._points), self.augmentation
        inputs = {
            "force": points.acting(force),
            "jump": points.acting(jump),
            "gap": gap,
            "old": points.acting(state.jump),
            "r": r,
            "frozen": np.full(n, float(self.frozen)),
        }
        if self.limiting_force is not None:
            self._trial_force = inputs["force"] + r[:, None] * (inputs["jump"] + gap)
        point_forces = PointForces.zeros(r, state.internal_variables)
        for group in self._groups:
            rows, law = group.rows, group.law
            committed = {name: state.internal_variables[name] for name in law.internal_variables}
            inputs_at_rows = {k: v[rows] for k, v in (inputs | committed).items()}
            response = self._evaluate_law(rows, group.kernel, inputs_at_rows, state.friction[rows])
            if self.limiting_force is not None and law.is_contact and law.friction > 0:
                response = self._with_given_limits(
                    rows, group.kernel, inputs_at_rows, state.friction[rows], response
                )
            point_forces.force[rows] = response["force"]
            by_multiplier = response.get("by_multiplier", 0.0)
            point_forces.by_multiplier[rows] = by_multiplier
            point_forces.by_jump[rows] = response.get(
                "by_jump", r[rows, None, None] * by_multiplier
            )
            pressures = response["pressures"]
            point_forces.pressures[rows, : pressures.shape[1]] = pressures
            point_forces.status[rows] = np.rint(response["status"]).astype(np.int64)
            for name in law.internal_variables:
                point_forces.internal_variables[name][rows] = response[NEW + name]
            for name in OUTPUTS.keys() & response.keys():
                point_forces.outputs[name][rows] = response[name]
            if group.debonded_kernel is not None:
                contact_inputs = {name: inputs_at_rows[name] for name in inputs}
                self._add_debonded_contact(
                    rows, law, group.debonded_kernel, contact_inputs, state, point_forces
                )
        if self.constrained.any():
            self._constrain(point_forces, force, jump + gap, state.jump)
        # Cohesive tractions stay.
        is_opened = self.opened & self.slides
        if is_opened.any():
            for values in (
                point_forces.force,
                point_forces.by_multiplier,
                point_forces.by_jump,
                point_forces.pressures,
            ):
                values[is_opened] = 0.0
            point_forces.status[is_opened] = OPEN
        return point_forces

    def _evaluate_law(
        self, rows: Ints, kernel: Pointwise, inputs: dict[str, Floats], last_friction: Floats
    ) -> dict[str, Floats]:
        r"""Evaluate a law, with its force along prescribed tangential jumps.

        Along a prescribed jump, equilibrium contains the support reaction. The interface force F_h
        there follows from the law alone:

        .. math:: F_h = H P(F + M F_h),

        with H the projector on the prescribed directions and M the share of the multiplier. Where
        the jump changes in the step, Newton's method solves for F_h at each point. Where the jump
        is at rest, F_h is the friction of the last converged state.

        F_h is along the prescribed slip, so its size is one unknown per point. The residual
        H P - F_h is not negative for F_h = 0 and negative for a large one, so that a root is
        between these bounds. Each iterate replaces one of the bounds. Bisection replaces a Newton
        step that leaves the bounds, or that follows one which did not halve the residual.

        At a point of one face the residual decreases and is concave on the side of the start, so
        that the iterates approach the root from one side. They are slowest where the force across
        the slip equals the limit of friction: a triple root, at which each iteration leaves 2/3 of
        the error. At an edge, the set of touching faces can change with F_h. Where the force jumps
        across zero there, no root exists, and the bounds close at the jump.

        Args:
            rows: Local points of the law (n,).
            kernel: The compiled law.
            inputs: Inputs of the law by name, without F_h in the force.
            last_friction: Friction in the last converged state (n, 3) [MPa].

        Returns:
            Outputs of the law, with total derivatives.
        """
        H = self._points.prescribed_tangents[rows]
        if not H.any():
            return kernel.named(**inputs)
        M = self.multiplier_share[rows]
        is_sliding, direction, scale, last = _prescribed_slip(H, inputs, last_friction)
        lower, upper = np.zeros(len(rows)), UPPER_BOUND * scale
        size, last_residual = upper.copy(), np.full(len(rows), np.inf)
        tolerance = FORCE_TOLERANCE * scale
        while True:
            F_h = np.where(is_sliding[:, None], size[:, None] * direction, last)
            force = inputs["force"] + np.einsum("pij,pj->pi", M, F_h)
            response = kernel.named(**(inputs | {"force": force}))
            if "by_jump" in response:
                # A traction that depends on the jump alone.
                return response
            P_F = response["by_multiplier"]
            residual = np.einsum("pi,pi->p", direction, response["force"]) - size
            slope = 1 - np.einsum("pi,pij,pjk,pk->p", direction, P_F, M, direction)
            # A point that has converged stays: rounding could move it from slip to stick.
            is_unfinished = is_sliding & (np.abs(residual) > tolerance)
            is_unfinished &= upper - lower > tolerance
            if not is_unfinished.any():
                break
            np.copyto(lower, size, where=residual > 0)
            np.copyto(upper, size, where=residual < 0)
            # Without a positive slope the step is infinite, which leaves the bounds.
            step = np.divide(residual, slope, out=np.full(len(rows), np.inf), where=slope > 0)
            is_within = (size + step >= lower) & (size + step <= upper)
            is_halved = np.abs(residual) <= last_residual / 2
            new_size = np.where(is_within & is_halved, size + step, (lower + upper) / 2)
            np.copyto(size, new_size, where=is_unfinished)
            last_residual = np.abs(residual)
        # Implicit derivative of F_h by the multiplier F.
        factor = np.divide(1.0, slope, out=np.zeros(len(rows)), where=is_sliding & (slope != 0))
        F_h_by_F = np.einsum("p,pi,pk,pkj->pij", factor, direction, direction, P_F)
        return response | {"by_multiplier": P_F + P_F @ M @ F_h_by_F}

    def _with_given_limits(
        self,
        rows: Ints,
        kernel: Pointwise,
        inputs: dict[str, Floats],
        last_friction: Floats,
        response: dict[str, Floats],
    ) -> dict[str, Floats]:
        """Replace friction by that of the law under the given pressures.

        Args:
            rows: Local points of the law (n,).
            kernel: The compiled law.
            inputs: Inputs of the law by name.
            last_friction: Friction in the last converged state (n, 3) [MPa].
            response: Outputs of the law under the pressures of the state.
        """
        assert self.limiting_force is not None
        normals = self._points.normals[rows]
        along_normals = _span_projectors(normals)
        excess = self.limiting_force[rows] - self._trial_force[rows]
        gap = inputs["gap"] + np.einsum("pij,pj->pi", along_normals, excess) / inputs["r"][:, None]
        given = self._evaluate_law(rows, kernel, inputs | {"gap": gap}, last_friction)
        faces = response["pressures"].shape[1]
        pressed, given_pressed = (
            np.where(values["pressures"][:, :, None] > 0, normals[:, :faces], 0.0)
            for values in (response, given)
        )
        friction = given["force"] - _normal_force(given["pressures"], normals)
        across_pressed = np.eye(3) - _span_projectors(given_pressed)
        across_normals = np.eye(3) - along_normals
        by_multiplier = _span_projectors(pressed)
        by_multiplier += across_pressed @ given["by_multiplier"] @ across_normals
        is_open = (response["status"] == OPEN) & (given["status"] == OPEN)
        return response | {
            "force": _normal_force(response["pressures"], normals) + friction,
            "by_multiplier": by_multiplier,
            "status": np.where(is_open, OPEN, np.maximum(given["status"], STICK)),
        }

    def _add_debonded_contact(
        self,
        rows: Ints,
        law: InterfaceLaw,
        contact: Pointwise,
        inputs: dict[str, Floats],
        state: ContactState,
        point_forces: PointForces,
    ) -> None:
        r"""Add contact on the debonded share s of a law of traction T.

        .. math:: F = T + P(F - T + r D) \quad \text{with the friction coefficient } s μ

        Its code is that of contact alone: one kernel for T and P together takes ffcx minutes.
        """
        points, r = self._points, inputs["r"]
        debonded_share = point_forces.outputs["debonded_share"][rows]
        in_contact = (debonded_share > 0) & ~self.opened[rows]
        traction, traction_by_jump = point_forces.force[rows], point_forces.by_jump[rows]
        free_projector = np.eye(3) - points.prescribed_tangents[rows]
        inputs["force"] = inputs["force"] - np.einsum("pij,pj->pi", free_projector, traction)
        if law.friction > 0:
            inputs["μ"] = self._constants["μ"][rows] * debonded_share
        response = self._evaluate_law(rows, contact, inputs, state.friction[rows])
        contact_force = response["force"]
        by_multiplier = response["by_multiplier"]
        pressures = response["pressures"]
        status = np.rint(response["status"]).astype(np.int64)
        friction = contact_force - _normal_force(pressures, points.normals[rows])
        is_slipping = in_contact & (status == SLIP)
        by_jump = by_multiplier @ (r[:, None, None] * np.eye(3) - free_projector @ traction_by_jump)
        # The disc of friction grows with the debonded share.
        share_by_jump = point_forces.outputs["debonded_share_by_jump"][rows]
        by_share = np.zeros(len(rows))
        by_share[is_slipping] = 1 / debonded_share[is_slipping]
        by_jump += by_share[:, None, None] * friction[:, :, None] * share_by_jump[:, None, :]
        contact_rows = rows[in_contact]
        point_forces.force[contact_rows] += contact_force[in_contact]
        point_forces.by_multiplier[contact_rows] = by_multiplier[in_contact]
        point_forces.by_jump[contact_rows] += by_jump[in_contact]
        point_forces.pressures[contact_rows, : pressures.shape[1]] += pressures[in_contact]
        point_forces.status[contact_rows] = status[in_contact]
        force_deficit = np.einsum("pij,pj->pi", free_projector, inputs["force"] - contact_force)
        slip = inputs["jump"] - inputs["old"] + force_deficit / r[:, None]
        point_forces.debonded_friction_work[rows] = np.where(
            is_slipping, np.einsum("pi,pi->p", friction, slip), 0.0
        )
        motion = np.zeros_like(point_forces.force)
        motion[rows] = inputs["jump"] + inputs["gap"]
        tangential_motion = points.tangential(motion, point_forces.pressures > 0)
        closed = contact_rows[status[in_contact] != OPEN]
        point_forces.outputs["slip"][closed] = tangential_motion[closed]

    def _constrain(
        self, point_forces: PointForces, force: Floats, opening: Floats, jump_old: Floats
    ) -> None:
        """Replace the response of constrained points by stick, in place."""
        points, constrained = self._points, self.constrained
        slip_old = points.tangential(jump_old, np.ones((len(points), 3), dtype=bool))
        trial = force + self.augmentation[:, None] * (opening - slip_old)
        point_forces.force[constrained] = points.project_free(trial)[constrained]
        point_forces.by_multiplier[constrained] = np.eye(3)
        point_forces.by_jump[constrained] = (self.augmentation[:, None, None] * np.eye(3))[
            constrained
        ]
        point_forces.status[constrained] = STICK


def _normal_force(pressures: Floats, normals: Floats) -> Floats:
    """Force (n, 3) of the pressures (n, k) of the first k faces, by normals (n, 3, 3) [MPa]."""
    return -np.einsum("pk,pki->pi", pressures, normals[:, : pressures.shape[1]])


def _span_projectors(normals: Floats) -> Floats:
    """Projectors (n, 3, 3) on the span of normals (n, m, 3), of which zero ones count for none."""
    return np.asarray(np.linalg.pinv(normals) @ normals)


def _prescribed_slip(
    H: Floats, inputs: Mapping[str, Floats], last_friction: Floats
) -> tuple[Bools, Floats, Floats, Floats]:
    """Prescribed slip of the step at each point.

    Args:
        H: Projectors on the prescribed directions (n, 3, 3).
        inputs: Inputs of the law by name.
        last_friction: Friction in the last converged state (n, 3) [MPa].

    Returns:
        Mask of the points whose prescribed jump changes (n,), direction of the change (n, 3), size
        of the trial force (n,) [MPa], and last friction along prescribed directions (n, 3) [MPa].
    """
    jump, old_jump = inputs["jump"], inputs["old"]
    slip = np.einsum("pij,pj->pi", H, jump - old_jump)
    size = np.linalg.norm(slip, axis=1)
    jump_sizes = np.linalg.norm(jump, axis=1) + np.linalg.norm(old_jump, axis=1)
    opening = np.linalg.norm(jump + inputs["gap"], axis=1)
    scale = np.linalg.norm(inputs["force"], axis=1) + inputs["r"] * opening
    is_sliding = (size > SLIP_ROUNDING * jump_sizes) & (inputs["r"] * size > REST_TOLERANCE * scale)
    direction = slip / np.where(is_sliding, size, 1.0)[:, None]
    return is_sliding, direction, scale, np.einsum("pij,pj->pi", H, last_friction)


def _compile_law(comm: MPI.Comm, normals: Floats, law: InterfaceLaw) -> Pointwise:
    """The law of n points with the same number m of faces, normals (n, m, 3)."""
    faces = [f"normal_{k}" for k in range(normals.shape[1])]
    duals = [f"dual_{k}" for k in range(normals.shape[1])]
    vectors = ["force", "jump", "gap", "old", "star", *faces, *duals]

    def build(x: dict[str, Expr]) -> dict[str, Expr]:
        point = AtPoint(
            F=x["force"],
            jump=x["jump"],
            initial_gap=x["gap"],
            jump_old=x["old"],
            S_star=x["star"],
            normals=contact.Faces.of([x[f] for f in faces], [x[d] for d in duals]),
            r=x["r"],
            constants={name: x[name] for name in law.constants},
            internal_variables={name: x[name] for name in law.internal_variables},
            frozen=x["frozen"],
        )
        response = law.response(point)
        names = ("force", "by_multiplier", "by_jump", "pressures", "status", *OUTPUTS)
        outputs = {name: getattr(response, name) for name in names}
        outputs |= {NEW + name: as_ufl(e) for name, e in response.internal_variables.items()}
        return {name: e for name, e in outputs.items() if e is not None}

    sizes = dict.fromkeys(vectors, 3) | dict.fromkeys((*law.constants, "r", "frozen"), 1)
    sizes |= {name: int(np.prod(shape)) for name, shape in law.internal_variables.items()}
    cache_file = _cache_file_of(law, f"{law.form} {len(faces)}")
    compiled = Pointwise(comm, len(normals), sizes, build, cache_file)
    constant = {f: normals[:, k] for k, f in enumerate(faces)}
    dual = dual_vectors(normals)
    constant |= {d: dual[:, k] for k, d in enumerate(duals)}
    compiled.set(**constant)
    return compiled


def _cache_file_of(law: InterfaceLaw, key: str) -> Path | None:
    """Return the path of the note of a compiled law.

    A law from outside of the program has none: its formula may be in any file.
    """
    if not type(law).__module__.startswith(f"{LAWS}."):
        return None
    sources = [file for folder in SOURCE_FOLDERS for file in sorted(folder.glob("*.py"))]
    return pointwise.note_of(key, [*sources, Path(pointwise.__file__), Path(__file__)])


def _compliance(
    normals: Floats, faces: Ints, normal_stiffness: float, tangential_stiffness: float
) -> Floats:
    """Compliance (n, 3, 3) [mm/MPa] of a layer with two stiffnesses [MPa/mm].

    Faces share the area of a point: their stiffnesses are averaged. The normal stiffness may be
    infinite.
    """
    normal_projectors = np.einsum("pki,pkj->pij", normals, normals)
    if np.isinf(normal_stiffness):  # rigid along every normal
        return (
            np.eye(3) - np.linalg.pinv(normal_projectors) @ normal_projectors
        ) / tangential_stiffness
    mean = normal_projectors / np.maximum(faces, 1)[:, None, None]
    return np.linalg.inv(
        tangential_stiffness * np.eye(3) + (normal_stiffness - tangential_stiffness) * mean
    )


def gap_vectors(normals: Floats, gap: Floats) -> Floats:
    """Vectors g (n, 3) with g . n_k the given normal gap on every face of each point [mm].

    Args:
        normals: Unit normals of the faces, zero beyond their number (n, 3, 3).
        gap: Initial gap (n,) [mm].
    """
    return np.linalg.pinv(normals).sum(axis=2) * gap[:, None]
