"""The discrete problem of a scene: residual and Jacobian of the coupled min-max problem.

Unknowns are blocks: the continuous displacement, and the jumps where the scene has contact. The
displacement block is assembled once; see `mechanics.contact` for the equations of the jump block.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from dolfinx import fem

from app.arrays import Floats, Ints
from app.mechanics.body_forms import BodyForms
from app.mechanics.constraints import near_null_space, reduction_of
from app.mechanics.contact import ContactInterfaces
from app.mechanics.contact_law import PointForces
from app.mechanics.curing_stress import CuringStress
from app.mechanics.external_forces import Forces
from app.mechanics.held_rows import ConstrainedRows
from app.mechanics.p_multigrid import inverse_of
from app.mechanics.thermal_strain import ThermalStiffness, ThermalStrain
from app.numerics.preconditioners import Inverse
from app.numerics.saved_state import node_keys
from app.scene.bodies import bodies_of
from app.scene.frames import frames_of
from app.scene.terms import Scene, amplitude
from app.system.timing import Timing
from meshes.distribute import TaggedMesh

# Rounding of K u in units of eps |diag(K) u|: about the root of the entries of a row.
ROUNDING = 2.0


@dataclass(frozen=True)
class TrialState:
    """Contact at a trial state: equilibrium (n, 3) [N], jumps (n, 3) [mm], the law."""

    contact: ContactInterfaces
    equilibrium: Floats
    jump: Floats
    law: PointForces


class Problem:
    """Operators and state of a scene.

    Attributes:
        contact: Contact of the interfaces, if there are any.
        thermal_strain: Thermal expansion of what has constant moduli, if anything expands.
        setting: Stress of what sets, if anything does.
        u: Displacement, the continuous field.
        frames: Nodes with axes of their own, if a support needs them.
        time: Current time: stage k runs from k to k + 1.
        version: Counts how often the stiffness has changed: preconditioners are of one version.
        inverse: Solves with the stiffness alone.
        supports: What the supports of the current stage meet of the stiffness.
        forces: Loads, eigenstrains and free strains.
        load_size: Norm of the nodal forces of loads and free strains [N].
    """

    saved = ("time", "_stage", "u", "mechanics", "contact", "setting")

    def __init__(
        self,
        scene: Scene,
        tagged: TaggedMesh,
        augmentation_factor: float,
        timing: Timing,
        like: Problem | None = None,
    ) -> None:
        """Assemble everything that does not change; collective.

        Args:
            scene: What is solved.
            tagged: Its mesh.
            augmentation_factor: Default augmentation over modulus and mesh size.
            timing: Where the seconds go.
            like: One with other contacts but the same stiffness, which never changes: its inverse
                serves both.

        Raises:
            InputError: The scene does not fit the mesh.
        """
        self.scene, self.tagged = scene, tagged
        self.comm = tagged.mesh.comm
        self.bodies = bodies_of(tagged, scene.contacts, scene.rigid)
        self.mechanics = BodyForms(scene, tagged, self.bodies, timing)
        self.space = self.mechanics.space
        self.u = self.mechanics.u
        self._owned = 3 * self.space.dofmap.index_map.size_local
        self._stage = self.version = 0
        self.frames = frames_of(scene, tagged, self.bodies, self.space)
        self._reduce()
        self.setting = (
            CuringStress(scene, self.mechanics, self.bodies, timing) if scene.cures else None
        )
        self._stiffness = self.mechanics.stiffness()
        self.K = self._constrained()
        self.K.setBlockSize(3)
        self.K.setOption(PETSc.Mat.Option.SPD, True)
        self.K.setNearNullSpace(near_null_space(self.comm, self.K, self.reduction.modes))
        own = inverse_of(self)
        self.inverse: Inverse = like.inverse if like is not None else own
        parts = scene, tagged, self.bodies, self.mechanics, self.reduction, self.frames
        self.contact = (
            ContactInterfaces(*parts, augmentation_factor, timing) if scene.contacts else None
        )
        self.supports.couple(self.contact)
        self.moved = {
            b: fem.Function(self.space, name=f"displacement {self.bodies.names[b]}")
            for b in (self.contact.moves if self.contact else ())
        }
        self.forces = Forces(scene, self.mechanics, self.bodies, self.contact)
        self.thermal_strain = (
            ThermalStrain(scene, self.mechanics, self.bodies) if self.mechanics.swelling else None
        )
        self.set_time(0.0)

    def begin(self, scene: Scene, augmentation_factor: float) -> None:
        """Reset to the unloaded state, with other loads and laws; matrices stay; collective.

        Args:
            scene: One that differs in the values of loads and in contact laws alone.
            augmentation_factor: Default augmentation over the local stiffness per area.
        """
        self.scene = scene
        self.set_stage(0, self.K.createVecRight())
        for state in (self.u, *self.moved.values(), *self.mechanics.swelling.values()):
            state.x.array[:] = 0
        if self.contact:
            self.contact.begin(scene.contacts, augmentation_factor)
        self.forces = Forces(scene, self.mechanics, self.bodies, self.contact, self.forces)
        self.set_time(0.0)

    # Construction

    def _reduce(self) -> None:
        """Find the unknowns that the supports of the current stage hold."""
        parts = self.scene, self.tagged, self.bodies, self.space
        self.reduction = reduction_of(*parts, self._stage, self.frames)
        self.held = self.reduction.held

    def _constrained(self) -> PETSc.Mat:
        """The stiffness with the supports of the current stage; these keep what they meet of it."""
        K = self.reduction.matrix(self.mechanics.matrix(self._stiffness))
        K.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.supports = ConstrainedRows(K, self.reduction)
        self._diagonal = K.getDiagonal()
        return K

    def _renew(self) -> None:
        """Assemble the stiffness and the coupling again, in the same matrices."""
        K = self._constrained()
        K.copy(self.K, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        if self.contact:
            self.contact.update_stiffness(self.mechanics, self.reduction)
        self.supports.couple(self.contact)
        self.version += 1
        self.set_time(self.time)

    # What a run remembers

    @property
    def row_keys(self) -> dict[str, Ints]:
        """Keys of nodes."""
        return {"u": node_keys(self.space), "mechanics": node_keys(self.mechanics.scalars)}

    def restored(self) -> None:
        """Make supports and stiffness those of the stage and of what has set; collective."""
        stage, self._stage = self._stage, 0
        self.set_stage(stage, self.K.createVecRight())
        if self.mechanics.growth:
            self._renew()
        self.set_time(self.time)

    def take_up(self, u: PETSc.Vec, q: PETSc.Vec | None) -> None:
        """Fill the unknowns with the restored displacement and jumps; collective."""
        self.reduction.contract(self.u.x.petsc_vec).copy(u)
        if self.contact:
            assert q is not None
            q.array[:] = self.contact.history.jump.ravel()
        self.spread(u, q)

    # State in time

    def set_stage(self, stage: int, u: PETSc.Vec) -> None:
        """Let go of the supports that do not hold in a stage, and hold on by those that do.

        Nothing is done unless they differ from those before.

        Args:
            stage: Number of the stage.
            u: The displacement, which stays.
        """
        then, self._stage = self._stage, stage
        if all(s.holds(then) == s.holds(stage) for s in self.scene.supports):
            return
        old = self.reduction
        self._reduce()
        self.reduction.carry(u, old)
        self._renew()
        self.K.setNearNullSpace(near_null_space(self.comm, self.K, self.reduction.modes))

    def set_time(self, time: float) -> None:
        """Set loads, supports and gaps to a time; the state itself does not move."""
        self.time = time
        action = self.forces.at(time)
        self.f, self.f_q = self.reduction.vector(action.nodal), action.jump
        self.load_size = float(self.f.norm())
        amplitudes = [amplitude(s.history, time) for s in self.scene.supports]
        self._given = self.supports.move(self.f, amplitudes)
        if self.contact:
            self.contact.set_time(time)
        self.mechanics.set_amplitudes(
            {
                (e.region, k): amplitude(s.history, time)
                for e in self.scene.elastic
                for k, s in enumerate(e.eigenstrains)
            }
        )

    def set_temperature(self, temperatures: Mapping[str, fem.Function]) -> None:
        """Swell to temperatures; the state itself does not move.

        Args:
            temperatures: For each region that expands, values at the vertices [K], ghosts included.
        """
        if self.thermal_strain:
            self.forces.set_free("heat", self.thermal_strain.set(temperatures))
        self.set_time(self.time)

    def set_cure(
        self, degrees: Mapping[str, fem.Function], strains: Mapping[str, fem.Function]
    ) -> None:
        """Say how far regions have set; takes effect at the next `update_stiffness`.

        Args:
            degrees: For each region that sets, the degree of cure at the vertices [-].
            strains: Its free strain accumulated since gelation at the vertices [-].
        """
        if self.setting:
            self.setting.set(degrees, strains)

    def update_stiffness(self) -> None:
        """Take in the stiffness and the stress of what has set so far; before every solve.

        The matrices are assembled again, in place, only if a modulus has changed; then `version`
        is another one.
        """
        if self.setting is None:
            return
        if self.setting.stiffen():
            self._renew()
        self.forces.set_free("cure", self.setting.forces())
        self.set_time(self.time)

    def thermal_stiffness(self, moves: Mapping[str, PETSc.Mat]) -> ThermalStiffness:
        """How the forces change with temperature; zero in supported rows; collective.

        Args:
            moves: For each region whose temperatures jumps move, what they add to the nodal ones.
        """
        assert self.thermal_strain is not None
        return self.thermal_strain.stiffness(
            moves, self.reduction, self.contact, self.supports.rows
        )

    def impose(self, u: PETSc.Vec) -> None:
        """Set the supported components of a displacement to their current values."""
        u.array[self.held] = self._given[self.held]

    # Residual and Jacobian

    def trial(self, u: PETSc.Vec, q: PETSc.Vec) -> TrialState:
        """Contact at a trial state; only for scenes with contact."""
        contact = self.contact
        assert contact is not None
        e = contact.equilibrium(u, q, self.f_q).copy()
        jump = q.array.reshape(-1, 3).copy()
        return TrialState(contact, e, jump, contact.law(e, jump))

    def residual_u(self, u: PETSc.Vec, q: PETSc.Vec | None, out: PETSc.Vec) -> None:
        """K u + C q - f [N]; in supported rows what is missing to the given displacements.

        A preconditioner of another stage moves these too: to leave them out would hide it.
        """
        self.K.mult(u, out)
        if self.contact:
            self.contact.C.multAdd(q, out, out)
        out.axpy(-1.0, self.f)
        out.array[self.held] = self.supports.typical * (u.array_r - self._given)[self.held]

    def force_scale(self, u: PETSc.Vec, q: PETSc.Vec | None) -> float:
        """Size of the forces in a state: loads, reactions and interface forces [N].

        Not what supports would have to push a model with that holds still: on a fine mesh that is
        far more than any force there is.
        """
        scale = self.load_size
        if self.contact:
            e = self.contact.equilibrium(u, q, self.f_q)
            for forces in (self.contact.let(e), self.f_q):
                scale += float(np.sqrt(self.comm.allreduce(float(np.sum(forces**2)), MPI.SUM)))
        return scale + float(self.supports.forces(u, q).norm())

    def rounding(self, u: PETSc.Vec) -> float:
        """Residual that rounding alone leaves at a displacement: a stiff body that moves [N]."""
        return ROUNDING * float(np.finfo(float).eps) * (self._diagonal * u).norm()

    # State

    def spread(self, u: PETSc.Vec, q: PETSc.Vec | None) -> None:
        """Put a state into the displacement functions of all bodies."""
        nodal = self.reduction.expand(u)
        self.u.x.petsc_vec.array[: self._owned] = nodal.array
        self.u.x.scatter_forward()
        if self.contact is None:
            return
        extra = nodal.duplicate()
        for body, B in self.contact.moves.items():
            B.mult(q, extra)
            function = self.moved[body]
            function.x.petsc_vec.array[: self._owned] = nodal.array + extra.array
            function.x.scatter_forward()

    def displacements(self) -> list[fem.Function]:
        """Displacement of each body, as last spread."""
        return self.mechanics.displacements(self.moved)

    def augmentation(self, trial: bool = False) -> dict[str, float]:
        """Augmentation or penalty of each interface [MPa/mm]; collective.

        Args:
            trial: Of penalties what they are solved with, not what they are.
        """
        return self.contact.augmentation(trial) if self.contact else {}

    def commit(self, trial: TrialState | None) -> None:
        """Make a converged state, whose displacements have been spread, the history."""
        if trial is not None:
            trial.contact.commit(trial.equilibrium, trial.jump, trial.law)
        if self.setting:
            self.setting.commit(self.displacements())
