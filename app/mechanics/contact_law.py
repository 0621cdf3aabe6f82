"""Interface laws at the contact points of one rank: UFL in, arrays out; their trial stiffness.

Points with the same number of faces and laws of the same form share one compiled law. A scene
without friction, or without edges, never compiles these laws.
"""

from __future__ import annotations

import sys
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
from forms import cohesion, contact
from forms.contact import OPEN, SLIP, STICK

# Outputs that a law may have, with their shapes (see `forms.contact.Response`).
OUTPUTS: dict[str, tuple[int, ...]] = {
    "slip": (3,),
    "stored": (),
    "dissipated": (),
    "dissipated_by_jump": (3,),
    "broken": (),
    "broken_by_jump": (3,),
}
# A prescribed slip, or an error of its force, below this part of its size counts as zero.
REST_TOLERANCE = 1e-13
# Start of the local Newton iterations for that force, as a multiple of the trial force.
START_FACTOR = 1e3
# Most local Newton iterations.
LOCAL_ITERATIONS = 50
# The modules that define a law, together with the module of its class. If their text changes, the
# law is compiled again.
SOURCES = (cohesion, contact, interface_laws, pointwise, sys.modules[__name__])


@dataclass(frozen=True)
class PointForces:
    """Forces, derivatives and states of the laws at n points.

    Attributes:
        force: Interface force per area (n, 3) [MPa].
        by_multiplier: Generalized derivative of the force by the multiplier (n, 3, 3) [-].
        by_jump: Generalized derivative of the force by the jump (n, 3, 3) [MPa/mm].
        stiffness: Stiffness of the trial force (n,) [MPa/mm].
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
    stiffness: Floats
    pressures: Floats
    status: Ints
    internal_variables: Mapping[str, Floats]
    debonded_friction_work: Floats
    outputs: Mapping[str, Floats]

    @property
    def by_law(self) -> Floats:
        """Derivative by the jump without the trial force of contact (n, 3, 3) [MPa/mm]."""
        return self.by_jump - self.stiffness[:, None, None] * self.by_multiplier

    @property
    def resisted(self) -> Floats:
        """Part of a change of the jump that is resisted (n, 3, 3) [-].

        For contact it is the derivative by the multiplier. The law adds its stiffness over the sum
        of its stiffness and that of the trial force.
        """
        of_law, r = self.by_law, self.stiffness[:, None]
        sizes, axes = np.linalg.eigh((of_law + of_law.transpose(0, 2, 1)) / 2)
        resisted_shares = np.maximum(sizes, 0.0) / (np.abs(sizes) + r)
        return self.by_multiplier + (axes * resisted_shares[:, None, :]) @ axes.transpose(0, 2, 1)


# Rows of points with the same number of faces and laws of the same form, with their compiled law
# and the compiled contact law of the debonded area.
Group = tuple[Ints, InterfaceLaw, Pointwise, Pointwise | None]


class PointLaw:
    """Laws of the interfaces at the contact points of this rank, during one run.

    Attributes:
        can_open: True where the law can open (n,).
        frictional: True where the law has friction (n,).
        has_contact: True where the law is contact, or has contact of the debonded area (n,).
        dissipates: True where the law declares the energy that it dissipates (n,).
        internal_variables: Shapes of the internal variables of the laws, by name.
        constrained: Points that stick, for any law (n,).
        opened: Points without contact force, for any law (n,). Layers and cohesion still act.
        local_stiffness: Stiffness per area against the jump of each point (n,) [MPa/mm].
        default_stiffness: Default stiffness of the trial force (n,) [MPa/mm].
        stiffness: Current stiffness of the trial force (n,) [MPa/mm].
        compliance: Compliance of the elastic layer in series (n, 3, 3) [mm/MPa].
        layer_share: Stiffness of the layer over the sum of its and the bodies' (n, 3, 3) [-]: the
            identity without a layer.
        multiplier_share: Factor of the equilibrium force in the trial force (n, 3, 3): 1 without
            a layer.
        slides: True where the slip follows from contact, False where the law returns it (n,).
        frozen: True while the internal variables of the laws stay at the last state.
    """

    frozen = False

    def __init__(self, comm: MPI.Comm, points: LocalPoints, timing: Timing) -> None:
        self._comm, self._points, self._timing = comm, points, timing
        self._groups_by_form: dict[tuple[Hashable, ...], list[Group]] = {}

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
        self._factor, self._groups = factor, self._groups_by_form[forms]
        self._laws = [(law, points.interface == i) for i, law in enumerate(laws)]
        for rows, law, compiled, _ in self._groups:
            constants = {name: values[name][rows] for name in law.values}
            compiled.set(**constants)
        self.internal_variables = {
            k: shape for law in laws for k, shape in law.internal_variables.items()
        }
        self.can_open = np.array([law.can_open for law in laws])[points.interface]
        self.frictional = np.array([law.friction > 0 for law in laws])[points.interface]
        self.slides = np.array([law.is_contact for law in laws])[points.interface]
        has_contact = [law.is_contact or law.debonded_contact is not None for law in laws]
        self.has_contact = np.array(has_contact)[points.interface]
        self.dissipates = np.array([law.dissipates for law in laws])[points.interface]
        # Friction coefficient of the debonded area.
        self._friction = values.get("friction_coefficient", np.zeros(len(points)))
        self.constrained = np.zeros(len(points), dtype=bool)
        self.opened = np.zeros(len(points), dtype=bool)
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

    def _compile_groups(self, laws: Sequence[InterfaceLaw]) -> list[Group]:
        points, forms = self._points, list(dict.fromkeys(law.form for law in laws))
        form_of_point = np.array([forms.index(law.form) for law in laws], dtype=np.int64)[
            points.interface
        ]
        local_groups = {
            (int(face_count), int(form_number))
            for face_count, form_number in zip(points.faces, form_of_point, strict=True)
            if face_count
        }
        compiled_groups = []
        for face_count, form_number in sorted(set().union(*self._comm.allgather(local_groups))):
            rows = np.flatnonzero((points.faces == face_count) & (form_of_point == form_number))
            law = next(law for law in laws if law.form == forms[form_number])
            normals = points.normals[rows, :face_count]
            compiled = _compile_law(self._comm, normals, law)
            debonded = (
                None
                if law.debonded_contact is None
                else _compile_law(self._comm, normals, law.debonded_contact)
            )
            compiled_groups.append((rows, law, compiled, debonded))
        return compiled_groups

    def set_normals(self, points: Ints) -> None:
        """Set the normals of points of one face to their current values."""
        for rows, _, compiled, _ in self._groups:
            if np.isin(rows, points).any():
                normal = self._points.normals[rows, 0]
                compiled.set(normal_0=normal, dual_0=normal)

    # Stiffness of the trial force

    def update_stiffness(self, stiffness: Floats) -> None:
        """Set the default stiffness of the trial force.

        By default it is a factor times the local stiffness per area in its softest direction: it
        follows materials, cure, mesh and order.

        Args:
            stiffness: Stiffness of each jump with all else held (n, 3, 3) [N/mm].
        """
        self.local_stiffness = np.linalg.eigvalsh(stiffness)[:, 0] / self._points.weight
        softer = self.local_stiffness[:, None, None] * self.compliance
        self.layer_share = np.linalg.inv(np.eye(3) + softer)
        self.default_stiffness = self._layer_stiffness.copy()
        for law, at_points in self._laws:
            # Above the stiffness of a layer the multiplier would enter with a negative sign.
            r = law.trial_stiffness(self.local_stiffness[at_points], self._factor)
            self.default_stiffness[at_points] = np.minimum(r, self._layer_stiffness[at_points])
        self.scale_augmentation(self._augmentation_scale)

    def freeze(self, on: bool) -> bool:
        """Freeze the internal variables, or let them change; return True if there are any."""
        self.frozen = on and bool(self.internal_variables)
        return bool(self.internal_variables)

    def scale_augmentation(self, factor: float) -> None:
        """Multiply the default augmentation by a factor, until the next call."""
        self._augmentation_scale = factor
        self.stiffness = factor * self.default_stiffness
        layers = self.stiffness[:, None, None] * self.compliance
        self.multiplier_share = np.eye(3) - layers

    def default_augmentation_ratio(self) -> float:
        """Geometric mean of the default augmentation over the one of the case [-]; collective."""
        is_augmented = np.array([law.augmented for law, _ in self._laws])[self._points.interface]
        default_stiffness = np.minimum(
            DEFAULT_AUGMENTATION * self.local_stiffness, self._layer_stiffness
        )[is_augmented]
        is_default = np.array_equal(default_stiffness, self.default_stiffness[is_augmented])
        if self._comm.allreduce(is_default, MPI.LAND):
            return 1.0
        logs = float(np.log(default_stiffness / self.default_stiffness[is_augmented]).sum())
        total, count = self._comm.allreduce(np.array([logs, is_augmented.sum()]), MPI.SUM)
        return float(np.exp(total / count)) if count else 1.0

    def augmentation(self) -> dict[int, float]:
        """Augmentation of each interface that can open [MPa/mm]; collective."""
        values = {}
        for i, (law, at_points) in enumerate(self._laws):
            if law.can_open:
                local = float(self.stiffness[at_points].max(initial=0.0))
                values[i] = float(self._comm.allreduce(local, MPI.MAX))
        return values

    # Forces

    def evaluate(
        self, force: Floats, jump: Floats, gap: Floats, state: ContactState
    ) -> PointForces:
        """Evaluate the laws at a trial state: multiplier (n, 3) [MPa], jump and gap (n, 3) [mm]."""
        points, n, r = self._points, len(self._points), self.stiffness
        inputs = {
            "force": points.acting(force),
            "jump": points.acting(jump),
            "gap": gap,
            "old": points.acting(state.jump),
            "r": r,
            "live": np.full(n, float(not self.frozen)),
        }
        point_forces = PointForces(
            force=np.zeros((n, 3)),
            by_multiplier=np.zeros((n, 3, 3)),
            by_jump=np.zeros((n, 3, 3)),
            stiffness=r,
            pressures=np.zeros((n, 3)),
            status=np.zeros(n, dtype=np.int64),
            internal_variables={
                name: values.copy() for name, values in state.internal_variables.items()
            },
            debonded_friction_work=np.zeros(n),
            outputs={name: np.zeros((n, *shape)) for name, shape in OUTPUTS.items()},
        )
        for rows, law, compiled, debonded in self._groups:
            law_inputs = inputs | {
                name: state.internal_variables[name] for name in law.internal_variables
            }
            law_inputs = {k: v[rows] for k, v in law_inputs.items()}
            response = self._evaluate_law(rows, compiled, law_inputs, state.friction[rows])
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
                point_forces.internal_variables[name][rows] = response[f"new {name}"]
            for name in OUTPUTS.keys() & response.keys():
                point_forces.outputs[name][rows] = response[name]
            if debonded is not None:
                contact_inputs = {name: law_inputs[name] for name in inputs}
                self._add_debonded_contact(rows, law, debonded, contact_inputs, state, point_forces)
        if self.constrained.any():
            self._constrain(point_forces, force, jump + gap, state.jump)
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
        self, rows: Ints, compiled: Pointwise, inputs: dict[str, Floats], last_friction: Floats
    ) -> dict[str, Floats]:
        r"""Evaluate a law, with its force along prescribed tangential jumps.

        Supports bear a part of the force along a prescribed jump, so that equilibrium does not give
        it. The law gives this force F_h:

        .. math:: F_h = H P(F + M F_h),

        with H the projector on the prescribed directions and M the share of the multiplier. Where
        the jump changes in the step, Newton's method solves for F_h at each point. Where the jump
        is at rest, F_h is the friction of the last converged state.

        Args:
            rows: Local points of the law (n,).
            compiled: The law.
            inputs: Inputs of the law by name, without F_h in the force.
            last_friction: Friction in the last converged state (n, 3) [MPa].

        Returns:
            Outputs of the law, with total derivatives.
        """
        H = self._points.held_tangents[rows]
        if not H.any():
            return compiled.named(**inputs)
        M = self.multiplier_share[rows]
        slides, scale, F_h = _start_of_held_force(H, inputs, last_friction)
        for _ in range(LOCAL_ITERATIONS):
            force = inputs["force"] + np.einsum("pij,pj->pi", M, F_h)
            response = compiled.named(**(inputs | {"force": force}))
            if "by_jump" in response:
                # A traction that depends on the jump alone.
                return response
            P_F = response["by_multiplier"]
            jacobian = np.eye(3) - np.where(slides[:, None, None], H @ P_F @ M @ H, 0.0)
            residual = np.einsum("pij,pj->pi", H, response["force"]) - F_h
            residual = np.where(slides[:, None], residual, 0.0)
            if (np.abs(residual).max(axis=1) <= REST_TOLERANCE * scale).all():
                break
            F_h = F_h + np.linalg.solve(jacobian, residual[:, :, None])[:, :, 0]
        # Implicit derivative of F_h by the multiplier F.
        F_h_by_F = np.where(slides[:, None, None], np.linalg.solve(jacobian, H @ P_F), 0.0)
        return response | {"by_multiplier": P_F + P_F @ M @ F_h_by_F}

    def _add_debonded_contact(
        self,
        rows: Ints,
        law: InterfaceLaw,
        contact: Pointwise,
        inputs: dict[str, Floats],
        state: ContactState,
        point_forces: PointForces,
    ) -> None:
        r"""Add contact on the broken share s of a law of traction T.

        .. math:: F = T + P(F - T + r D) \quad \text{with the friction coefficient } s μ

        Its code is that of contact alone: one kernel for T and P together takes ffcx minutes.
        """
        points, r = self._points, inputs["r"]
        broken_share = point_forces.outputs["broken"][rows]
        in_contact = (broken_share > 0) & ~self.opened[rows]
        traction, traction_by_jump = point_forces.force[rows], point_forces.by_jump[rows]
        free_projector = np.eye(3) - points.held_tangents[rows]
        inputs["force"] = inputs["force"] - np.einsum("pij,pj->pi", free_projector, traction)
        if law.friction > 0:
            inputs["μ"] = self._friction[rows] * broken_share
        response = self._evaluate_law(rows, contact, inputs, state.friction[rows])
        contact_force = response["force"]
        by_multiplier = response["by_multiplier"]
        pressures = response["pressures"]
        status = np.rint(response["status"]).astype(np.int64)
        friction = contact_force + np.einsum(
            "pk,pki->pi", pressures, points.normals[rows, : pressures.shape[1]]
        )
        is_slipping = in_contact & (status == SLIP)
        by_jump = by_multiplier @ (r[:, None, None] * np.eye(3) - free_projector @ traction_by_jump)
        # The disc of friction grows with the broken share.
        by_share = np.where(is_slipping, 1 / np.where(in_contact, broken_share, 1.0), 0.0)[
            :, None, None
        ]
        by_jump += (
            by_share
            * friction[:, :, None]
            * point_forces.outputs["broken_by_jump"][rows][:, None, :]
        )
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
        self, point_forces: PointForces, force: Floats, opening: Floats, old_jump: Floats
    ) -> None:
        points, constrained = self._points, self.constrained
        old_slip = points.tangential(old_jump, np.ones((len(points), 3), dtype=bool))
        trial = force + self.stiffness[:, None] * (opening - old_slip)
        point_forces.force[constrained] = points.project_free(trial)[constrained]
        point_forces.by_multiplier[constrained] = np.eye(3)
        point_forces.by_jump[constrained] = (self.stiffness[:, None, None] * np.eye(3))[constrained]
        point_forces.status[constrained] = STICK


def _start_of_held_force(
    H: Floats, inputs: Mapping[str, Floats], last_friction: Floats
) -> tuple[Bools, Floats, Floats]:
    """Start of Newton's method for the force along prescribed tangential jumps.

    It is far along the slip, so that all iterates slip.

    Args:
        H: Projectors on the prescribed directions (n, 3, 3).
        inputs: Inputs of the law by name.
        last_friction: Friction in the last converged state (n, 3) [MPa].

    Returns:
        Mask of the points whose prescribed jump changes (n,), size of the trial force (n,) [MPa],
        and first force (n, 3) [MPa]. At points at rest this is the last friction.
    """
    jump, old_jump = inputs["jump"], inputs["old"]
    slip = np.einsum("pij,pj->pi", H, jump - old_jump)
    size = np.linalg.norm(slip, axis=1)
    is_sliding = size > REST_TOLERANCE * (
        np.linalg.norm(jump, axis=1) + np.linalg.norm(old_jump, axis=1)
    )
    opening = np.linalg.norm(jump + inputs["gap"], axis=1)
    scale = np.linalg.norm(inputs["force"], axis=1) + inputs["r"] * opening
    direction = slip / np.where(is_sliding, size, 1.0)[:, None]
    at_rest = np.einsum("pij,pj->pi", H, last_friction)
    return (
        is_sliding,
        scale,
        np.where(is_sliding[:, None], START_FACTOR * scale[:, None] * direction, at_rest),
    )


def _compile_law(comm: MPI.Comm, normals: Floats, law: InterfaceLaw) -> Pointwise:
    """The law of n points with the same number m of faces, normals (n, m, 3)."""
    faces = [f"normal_{k}" for k in range(normals.shape[1])]
    duals = [f"dual_{k}" for k in range(normals.shape[1])]
    vectors = ["force", "jump", "gap", "old", "star", *faces, *duals]

    def build(x: dict[str, Expr]) -> dict[str, Expr]:
        values = {name: x[name] for name in law.values}
        internal_variables = {name: x[name] for name in law.internal_variables}
        state = (x["force"], x["jump"], x["gap"], x["old"], x["star"])
        normals_of_point = contact.Faces.of([x[f] for f in faces], [x[d] for d in duals])
        at_point = AtPoint(*state, normals_of_point, x["r"], values, internal_variables, x["live"])
        response = law.response(at_point)
        output_names = ("force", "by_multiplier", "by_jump", "pressures", "status", *OUTPUTS)
        outputs = {name: getattr(response, name) for name in output_names}
        outputs |= {f"new {name}": as_ufl(e) for name, e in response.internal_variables.items()}
        return {name: e for name, e in outputs.items() if e is not None}

    sizes = dict.fromkeys(vectors, 3) | dict.fromkeys((*law.values, "r", "live"), 1)
    sizes |= {name: int(np.prod(shape)) for name, shape in law.internal_variables.items()}
    note = _note(law, f"{law.form} {len(faces)}")
    compiled = Pointwise(comm, len(normals), sizes, build, note)
    constant = {f: normals[:, k] for k, f in enumerate(faces)}
    dual = dual_vectors(normals)
    constant |= {d: dual[:, k] for k, d in enumerate(duals)}
    compiled.set(**constant)
    return compiled


def _note(law: InterfaceLaw, key: str) -> Path | None:
    module = sys.modules[type(law).__module__]
    has_file = getattr(module, "__file__", None) is not None
    return pointwise.note_of(key, (*SOURCES, module)) if has_file else None


def _compliance(normals: Floats, faces: Ints, across: float, along: float) -> Floats:
    """Compliance (n, 3, 3) [mm/MPa] of a layer with two stiffnesses [MPa/mm].

    Faces share the area of a point: their stiffnesses are averaged. The one across may be infinite.
    """
    across_all = np.einsum("pki,pkj->pij", normals, normals)
    if np.isinf(across):  # rigid along every normal
        return (np.eye(3) - np.linalg.pinv(across_all) @ across_all) / along
    mean = across_all / np.maximum(faces, 1)[:, None, None]
    return np.linalg.inv(along * np.eye(3) + (across - along) * mean)


def gap_vectors(normals: Floats, gap: Floats) -> Floats:
    """Vectors g (n, 3) with g . n_k the given normal gap on every face of each point [mm].

    Args:
        normals: Unit normals of the faces, zero beyond their number (n, 3, 3).
        gap: Initial gap (n,) [mm].
    """
    return np.linalg.pinv(normals).sum(axis=2) * gap[:, None]
