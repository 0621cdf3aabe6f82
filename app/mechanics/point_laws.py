"""Interface laws at the contact points of one rank, compiled from UFL: arrays in, arrays out.

Points with the same number of faces and laws of the same form share one compiled law. Laws with
friction are compiled only if the scene has friction, and laws of edges only if it has edges.

`PointLaws.evaluate` puts the parts together: `prescribed_slip` along jumps that supports prescribe,
`debonded_contact` on debonded shares, and the changes of remedies in `switches`.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray
from ufl import as_ufl
from ufl.core.expr import Expr

from app.foundation.arrays import Floats, Ints
from app.interfaces.faces import dual_vectors
from app.laws import interface_laws
from app.laws.interface_laws import DEFAULT_AUGMENTATION, AtPoint, InterfaceLaw
from app.mechanics import point_forces, prescribed_slip
from app.mechanics.contact_state import ContactState, LocalPoints
from app.mechanics.debonded_contact import Debonding, debonded_contact
from app.mechanics.point_forces import OUTPUTS, PointForces
from app.mechanics.prescribed_slip import Inputs, LawAtPoints, Outputs
from app.mechanics.switches import Switches, open_points, stick_points, tresca_response
from app.numerics import pointwise
from app.numerics.pointwise import Pointwise
from app.system.timing import Timing
from forms import contact
from forms.contact import OPEN

# An output with this prefix is the new value of an internal variable.
NEW = "new "
# Package of the laws of the program.
LAWS = interface_laws.__name__.rpartition(".")[0]
# Folders of the formulas and of the laws. Laws are compiled again if a module there changes, or if
# this module, `point_forces` or `pointwise` does.
SOURCE_FOLDERS = (Path(contact.__file__).parent, Path(interface_laws.__file__).parent)


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
        friction_coefficient: Friction coefficient (n,) [-]; 0 without friction.
        has_friction: True where the friction coefficient is above 0 (n,).
        is_contact: True where the law is contact, so that the slip follows from the jump; False
            where the law returns the slip (n,).
        has_contact: True where the law is contact, or has contact of the debonded area (n,).
        dissipates: True where the law declares the energy that it dissipates (n,).
        internal_variables: Shapes of the internal variables of the laws, by name.
        softest_stiffness: Stiffness k per area against the jump of each point, in its softest
            direction (n,) [MPa/mm].
        unscaled_augmentation: Augmentation by the keys of the case, before `scale_augmentation`
            (n,) [MPa/mm].
        augmentation: Augmentation r, the stiffness of the trial force (n,) [MPa/mm].
        compliance: Compliance c of the elastic layer in series (n, 3, 3) [mm/MPa]; 0 without one.
        layer_share: (1 + k c)^-1: stiffness of the layer over the sum of its and the bodies'
            (n, 3, 3) [-].
        multiplier_share: 1 - r c: factor of the equilibrium force in the multiplier (n, 3, 3) [-].
    """

    def __init__(self, comm: MPI.Comm, points: LocalPoints, timing: Timing) -> None:
        self._comm, self._points, self._timing = comm, points, timing
        self._groups_by_form: dict[tuple[Hashable, ...], list[CompiledGroup]] = {}

    def begin(
        self,
        laws: Sequence[InterfaceLaw],
        values: Mapping[str, Floats],
        factor: float,
        jump_stiffness: Floats,
    ) -> None:
        """Set the laws of a run, compiled once for all of the same form; collective.

        Args:
            laws: Law of each interface.
            values: Constants of the laws at local points (n,), by name.
            factor: Ratio of the default augmentation to the softest stiffness per area [-].
            jump_stiffness: Stiffness of each jump with all else held (n, 3, 3) [N/mm].
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

        def at_points(of_law: Callable[[InterfaceLaw], float]) -> NDArray[Any]:
            """Return a value of the law of each point (n,)."""
            return np.array([of_law(law) for law in laws])[points.interface]

        self.can_open = at_points(lambda law: law.can_open)
        self.friction_coefficient = at_points(lambda law: law.largest_friction)
        for law, has_law in self._laws:
            if "μ" in (law.debonded_contact or law).constants:
                self.friction_coefficient[has_law] = values["μ"][has_law]
        self.has_friction = self.friction_coefficient > 0
        self.is_contact = at_points(lambda law: law.is_contact)
        self.has_contact = at_points(lambda law: law.is_contact or law.debonded_contact is not None)
        self.dissipates = at_points(lambda law: law.dissipates)

        self._augmentation_scale = 1.0
        self._layer_stiffness = at_points(lambda law: min(law.layer or (np.inf,)))
        self.compliance = np.zeros((len(points), 3, 3))
        for law, has_law in self._laws:
            if law.layer is not None:
                self.compliance[has_law] = _compliance(
                    points.normals[has_law], points.faces[has_law], *law.layer
                )
        self.update_stiffness(jump_stiffness)

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

    def update_stiffness(self, jump_stiffness: Floats) -> None:
        """Set the softest stiffness, the augmentation, and the shares of layer and multiplier.

        The default augmentation is a factor times the smallest eigenvalue of the stiffness per
        area. So it changes with material, cure, mesh and order.

        Args:
            jump_stiffness: Stiffness of each jump with all else held (n, 3, 3) [N/mm].
        """
        self.softest_stiffness = np.linalg.eigvalsh(jump_stiffness)[:, 0] / self._points.weight
        softer = self.softest_stiffness[:, None, None] * self.compliance
        self.layer_share = np.linalg.inv(np.eye(3) + softer)
        self.unscaled_augmentation = self._layer_stiffness.copy()
        for law, has_law in self._laws:
            r = law.augmentation_of(self.softest_stiffness[has_law], self._factor)
            self.unscaled_augmentation[has_law] = np.minimum(r, self._layer_stiffness[has_law])
        self.scale_augmentation(self._augmentation_scale)

    def scale_augmentation(self, factor: float) -> None:
        """Multiply the augmentation of the case by a factor, until the next call.

        It stays at or below the stiffness of a layer, above which `multiplier_share` is negative.
        """
        self._augmentation_scale = factor
        self.augmentation = np.minimum(factor * self.unscaled_augmentation, self._layer_stiffness)
        layers = self.augmentation[:, None, None] * self.compliance
        self.multiplier_share = np.eye(3) - layers

    def factor_to_default_augmentation(self) -> float:
        """Geometric mean of r_default / r_case [-]; collective.

        r_default is the augmentation without keys of the case, r_case is `unscaled_augmentation`.
        Remedies use the factor to leave an unsuitable key `augmentation` or `augmentation_factor`.
        """
        is_augmented = self.has_contact
        default_augmentation = np.minimum(
            DEFAULT_AUGMENTATION * self.softest_stiffness, self._layer_stiffness
        )[is_augmented]
        case_augmentation = self.unscaled_augmentation[is_augmented]
        is_default = np.array_equal(default_augmentation, case_augmentation)
        if self._comm.allreduce(is_default, MPI.LAND):
            return 1.0
        logs = float(np.log(default_augmentation / case_augmentation).sum())
        total, count = self._comm.allreduce(np.array([logs, is_augmented.sum()]), MPI.SUM)
        return float(np.exp(total / count)) if count else 1.0

    def largest_augmentation(self) -> dict[int, float]:
        """Augmentation of each interface that can open [MPa/mm]; collective."""
        values = {}
        for i, (law, has_law) in enumerate(self._laws):
            if law.can_open:
                local = float(self.augmentation[has_law].max(initial=0.0))
                values[i] = float(self._comm.allreduce(local, MPI.MAX))
        return values

    # Forces

    def evaluate(
        self,
        multiplier: Floats,
        jump: Floats,
        initial_gap: Floats,
        state: ContactState,
        switches: Switches,
    ) -> PointForces:
        """Evaluate the laws at a trial state.

        Args:
            multiplier: Multiplier λ (n, 3) [MPa].
            jump: Jump (n, 3) [mm].
            initial_gap: Vectors of the initial gap (n, 3) [mm].
            state: Last converged state.
            switches: Changes of the laws by remedies.
        """
        points, r = self._points, self.augmentation
        inputs = {
            "multiplier": points.acting(multiplier),
            "jump": points.acting(jump),
            "initial_gap": initial_gap,
            "jump_old": points.acting(state.jump),
            "r": r,
            "frozen": np.full(len(points), float(switches.freezes_variables)),
        }
        trial_force = inputs["multiplier"] + r[:, None] * (inputs["jump"] + initial_gap)
        forces = PointForces.zeros(trial_force, r, state.internal_variables)
        for group in self._groups:
            rows, law = group.rows, group.law
            committed = {name: state.internal_variables[name] for name in law.internal_variables}
            inputs_at_rows = {k: v[rows] for k, v in (inputs | committed).items()}
            law_at_rows = self._law_at(group.kernel, rows, state.friction[rows])
            response = law_at_rows(inputs_at_rows)
            given = switches.tresca_trial_force
            if given is not None and law.is_contact and law.largest_friction > 0:
                excess = given[rows] - trial_force[rows]
                response = tresca_response(
                    law_at_rows, inputs_at_rows, response, points.normals[rows], excess
                )
            forces.force[rows] = response["force"]
            by_multiplier = response.get("by_multiplier", 0.0)
            forces.by_multiplier[rows] = by_multiplier
            forces.by_jump[rows] = response.get("by_jump", r[rows, None, None] * by_multiplier)
            pressures = response["pressures"]
            forces.pressures[rows, : pressures.shape[1]] = pressures
            forces.status[rows] = np.rint(response["status"]).astype(np.int64)
            if "debonded_share" in response:
                forces.bonded[rows] = response["debonded_share"] < 1
            elif not law.is_contact:
                forces.bonded[rows] = forces.status[rows] != OPEN
            for name in law.internal_variables:
                forces.internal_variables[name][rows] = response[NEW + name]
            for name in OUTPUTS.keys() & response.keys():
                forces.outputs[name][rows] = response[name]
            if group.debonded_kernel is not None:
                self._add_debonded_contact(
                    group, group.debonded_kernel, inputs, state, switches, forces
                )
        if switches.stuck.any():
            all_faces = np.ones((len(points), 3), dtype=bool)
            tangential_jump_old = points.tangential(state.jump, all_faces)
            sticking_force = multiplier + r[:, None] * (jump + initial_gap - tangential_jump_old)
            stick_points(forces, points, switches.stuck, sticking_force)
        # Opened points keep tractions of laws other than contact.
        opened = switches.opened & self.is_contact
        if opened.any():
            open_points(forces, opened)
        return forces

    def _law_at(
        self, kernel: Pointwise, rows: Ints, last_friction: Floats, numbers: Ints | None = None
    ) -> LawAtPoints:
        """Return a compiled law of some points, with its force along prescribed jumps.

        Args:
            kernel: The compiled law.
            rows: The points (n,).
            last_friction: Friction of the last converged state (n, 3) [MPa].
            numbers: Numbers of the points in the kernel (n,); None if it has these points alone.
        """

        def compiled(inputs: Inputs) -> Outputs:
            return kernel.named(numbers, **inputs)

        H, M = self._points.prescribed_tangents[rows], self.multiplier_share[rows]
        μ = self._constants["μ"][rows] if "μ" in self._constants else 0.0
        return partial(
            prescribed_slip.respond, compiled, H=H, M=M, last_friction=last_friction, μ=μ
        )

    def _add_debonded_contact(
        self,
        group: CompiledGroup,
        kernel: Pointwise,
        inputs: Inputs,
        state: ContactState,
        switches: Switches,
        forces: PointForces,
    ) -> None:
        """Add contact where the points of a group are debonded and not opened, in place.

        The kernel is the compiled contact law; inputs, state and forces are those of all points.
        """
        points, outputs = self._points, forces.outputs
        is_debonded = (outputs["debonded_share"] > 0) & ~switches.opened
        numbers = np.flatnonzero(is_debonded[group.rows])
        rows = group.rows[numbers]
        contact_inputs = {name: values[rows] for name, values in inputs.items()}
        if group.law.largest_friction > 0:
            contact_inputs["μ"] = self._constants["μ"][rows]
        debonding = Debonding(
            traction=forces.force[rows],
            traction_by_jump=forces.by_jump[rows],
            share=outputs["debonded_share"][rows],
            share_by_jump=outputs["debonded_share_by_jump"][rows],
        )
        added = debonded_contact(
            self._law_at(kernel, rows, state.friction[rows], numbers),
            contact_inputs,
            debonding,
            points.normals[rows],
            points.prescribed_tangents[rows],
        )
        forces.force[rows] += added.force
        forces.by_multiplier[rows] = added.by_multiplier
        forces.by_jump[rows] += added.by_jump
        forces.pressures[rows, : added.pressures.shape[1]] += added.pressures
        forces.status[rows] = added.status
        forces.debonded_friction_work[rows] = added.friction_work
        is_closed = added.status != OPEN
        closed = rows[is_closed]
        motion = (contact_inputs["jump"] + contact_inputs["initial_gap"])[is_closed]
        outputs["slip"][closed] = points.tangential(motion, forces.pressures[closed] > 0, closed)


def _compile_law(comm: MPI.Comm, normals: Floats, law: InterfaceLaw) -> Pointwise:
    """The law of n points with the same number m of faces, normals (n, m, 3)."""
    faces = [f"normal_{k}" for k in range(normals.shape[1])]
    duals = [f"dual_{k}" for k in range(normals.shape[1])]
    vectors = ["multiplier", "jump", "initial_gap", "jump_old", "star", *faces, *duals]

    def build(x: dict[str, Expr]) -> dict[str, Expr]:
        point = AtPoint(
            λ=x["multiplier"],
            jump=x["jump"],
            initial_gap=x["initial_gap"],
            jump_old=x["jump_old"],
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
    note_file = _note_file(law, f"{law.form} {len(faces)}")
    compiled = Pointwise(comm, len(normals), sizes, build, note_file)
    constant = {f: normals[:, k] for k, f in enumerate(faces)}
    dual = dual_vectors(normals)
    constant |= {d: dual[:, k] for k, d in enumerate(duals)}
    compiled.set(**constant)
    return compiled


def _note_file(law: InterfaceLaw, key: str) -> Path | None:
    """Return the path of the file that names the compiled code of a law (see `pointwise`).

    A law from outside of the program has none: its formula may be in any file.
    """
    if not type(law).__module__.startswith(f"{LAWS}."):
        return None
    sources = [file for folder in SOURCE_FOLDERS for file in sorted(folder.glob("*.py"))]
    modules = (pointwise.__file__, point_forces.__file__, __file__)
    return pointwise.note_of(key, [*sources, *map(Path, modules)])


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
