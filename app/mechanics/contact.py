r"""Contact: unknown jumps at contact points, coupled to the bonded displacement.

With U_b = u + B_b q the displacement of body b, q the jumps (three per contact point) and K_b the
stiffness of body b, the equilibrium of a linear scene reads

.. math:: K u + C q = f, \qquad C^T u + D q - f_q + W F = 0,
          \qquad C = \sum_b K_b B_b, \quad D = \sum_b B_b^T K_b B_b, \quad f_q = \sum_b B_b^T f_b,

W the areas of the contact points and F their forces. W is diagonal, so the second line gives F and
the law F = P(F + r D(q)) becomes one equation per point, with e = C^T u + D q - f_q:

.. math:: e + W P(-e/W + r D(q)) = 0.

Its Jacobian rows are (1 - P') [C^T, D] + r W P'. Open points (P' = 0) are plain equilibrium, points
that stick (P' = 1) say that the jump does not change: all points sticking is the bonded problem.
"""

from __future__ import annotations

from dataclasses import replace

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from dolfinx import fem
from pydantic_core import PydanticCustomError

from app.arrays import Bools, Floats, Ints
from app.errors import InputError
from app.laws.values import amplitude, gap_at
from app.mechanics.body_forms import BodyForms, assembled_matrix
from app.mechanics.constraints import Constraints
from app.mechanics.contact_law import PointForces, PointLaw, gap_vectors
from app.mechanics.contact_points import ContactState, OwnPoints, prescribed_jump, refuse_supports
from app.mechanics.sliding import ACCURACY, Sliding
from app.mechanics.trial_state import TrialState
from app.numerics.sparse import diagonal_blocks, from_triplets, matrix_sum, owners
from app.scene.bodies import Bodies, contact_facets
from app.scene.frames import Frames, held_at
from app.scene.scene import Scene
from app.system.timing import Timing
from meshes.contact_points import Entries, contact_points
from meshes.distribute import TaggedMesh


class JumpCoupling:
    """Stiffness between jumps and displacement, reassembled when the stiffness changes.

    Attributes:
        jump_to_displacement: Matrices from jumps to displacements, by body.
        C: Forces on the displacement by jumps.
        D: Forces on jumps by jumps.
        Ct: The transpose of C.

    Args:
        entries: Displacement of each body by all jumps.
        number: Number of each contact point in the order of the ranks.
        own: Number of contact points of this rank.
    """

    def __init__(
        self,
        mechanics: BodyForms,
        constraints: Constraints,
        entries: Entries,
        number: Ints,
        own: int,
    ) -> None:
        comm, index_map = mechanics.mesh.comm, mechanics.space.dofmap.index_map
        start, end = (3 * k for k in index_map.local_range)
        self.jump_to_displacement: dict[int, PETSc.Mat] = {}
        self._strips: dict[int, fem.Form] = {}
        for body in map(int, np.unique(entries.body)):
            here = entries.body == body
            row, column, value = entries.row[here], entries.column[here], entries.value[here]
            column = 3 * number[column // 3] + column % 3
            local = (row >= start) & (row < end)
            self.jump_to_displacement[body] = from_triplets(
                comm, end - start, 3 * own, row[local] - start, column[local], value[local]
            )
            moved: Bools = np.isin(
                np.concatenate([np.arange(start // 3, end // 3), index_map.ghosts]),
                np.unique(row // 3),
            )
            self._strips[body] = mechanics.strip_stiffness(body, moved)
        self.C, self.D, self.Ct = self._assembled(mechanics, constraints)
        self._work = self.Ct.createVecLeft()

    def _assembled(
        self, mechanics: BodyForms, constraints: Constraints
    ) -> tuple[PETSc.Mat, PETSc.Mat, PETSc.Mat]:
        moves = self.jump_to_displacement
        KB = {b: assembled_matrix(self._strips[b]).matMult(B) for b, B in moves.items()}
        C = constraints.rows(matrix_sum(list(KB.values())))
        D = matrix_sum([B.transposeMatMult(KB[b]) for b, B in moves.items()])
        return C, D, C.copy().transpose()

    def update(self, mechanics: BodyForms, constraints: Constraints) -> None:
        """Reassemble, in the same matrices, for changed stiffness or supports."""
        new = self._assembled(mechanics, constraints)
        for matrix, values in zip((self.C, self.D, self.Ct), new, strict=True):
            values.copy(matrix, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)

    def equilibrium(self, u: PETSc.Vec, q: PETSc.Vec, f_q: Floats) -> Floats:
        """Equilibrium e = C^T u + D q - f_q at own points (n, 3) [N]; -e is the force W F."""
        self.Ct.mult(u, self._work)
        self.D.multAdd(q, self._work, self._work)
        return self._work.array.reshape(-1, 3) - f_q.reshape(-1, 3)

    def local_stiffness(self) -> Floats:
        """Stiffness of the jump of each own point with all else held (n, 3, 3) [N/mm]."""
        return diagonal_blocks(self.D, 3)


class ContactInterfaces:
    """Contact of all interfaces on this rank: points, coupling to the bodies, laws, state.

    Attributes:
        points: All contact points, replicated.
        facets: All interface facets, replicated.
        edge_lengths: Mean edge of the facets of each interface [mm].
        own: The points of this rank.
        coupling: Their coupling to the displacement.
        law: Their laws.
        state: Their committed state.
        gap: Initial gap at the current time (n, 3) [mm].
        large: Points that slide far, if any.
        reference: Jumps at which nothing has slid since the last committed step (n, 3) [mm].
        prescribed: Jumps prescribed by supports at the current time (n, 3) [mm].
        linear_about: Forces (n, 3) [MPa] about which the laws are linearized; None: about none.

    Raises:
        InputError: An interface has no facets on this mesh.
    """

    saved = ("state",)
    linear_about: Floats | None = None

    def __init__(
        self,
        scene: Scene,
        tagged: TaggedMesh,
        bodies: Bodies,
        mechanics: BodyForms,
        constraints: Constraints,
        frames: Frames | None,
        augmentation_factor: float,
        timing: Timing,
    ) -> None:
        self._supports = scene.supports
        self.comm = tagged.mesh.comm
        space, parts = mechanics.space, len(scene.contacts)
        self.facets = contact_facets(tagged, bodies, space, scene.contacts, scene.moduli)
        holds, axes = held_at(frames, tagged, bodies, space, scene.supports, self.facets)
        self.points, entries = contact_points(self.facets, holds, parts, axes)
        refuse_supports(scene, bodies, holds, self.points, entries)
        rows, number = owners(self.comm, space.dofmap.index_map, self.points.dof)
        self.own = OwnPoints.of(self.points, rows)
        edges = np.linalg.norm(self.facets.x - np.roll(self.facets.x, 1, axis=1), axis=2)
        self.edge_lengths = [float(edges[self.facets.interface == i].mean()) for i in range(parts)]
        self._by_supports = [
            prescribed_jump(self.points, k, s)[rows] for k, s in enumerate(scene.supports)
        ]
        self.coupling = JumpCoupling(mechanics, constraints, entries, number, len(rows))
        far = any(c.between for c in scene.contacts)
        self.large = Sliding(scene, tagged, space, self.own) if far else None
        self.law = PointLaw(self.comm, self.own, timing)
        self.begin(scene, augmentation_factor)

    def begin(self, scene: Scene, augmentation_factor: float) -> None:
        """Reset to the unloaded state, with other laws of the same interfaces; collective.

        The default augmentation is ``augmentation_factor`` times the local stiffness per area.
        """
        contacts = self._contacts = scene.contacts
        fields = [{"gap": c.gap, **c.values} for c in contacts]
        values = {name: np.zeros(len(self.points.weight)) for every in fields for name in every}
        for i, (c, every) in enumerate(zip(contacts, fields, strict=True)):
            # On every rank at all points, so that an error is raised on every rank.
            here = self.points.interface == i
            for name, at in every.items():
                values[name][here] = at(self.points.x[here])
            try:
                c.law.check({name: values[name][here] for name in c.values})
            except PydanticCustomError as error:
                key = ".".join(("interfaces", c.name, *(error.context or {})["at"]))
                raise InputError(f"{key}: {error}") from error
        own = {name: full[self.own.rows] for name, full in values.items()}
        self._full_gap = own["gap"]
        laws = [c.law for c in contacts]
        self.law.begin(laws, own, augmentation_factor, self.coupling.local_stiffness())
        if self.large is not None:
            self.large.begin(scene)
        self._committed = 0.0
        self.state: ContactState = ContactState.at_rest(self.own.x * 0.0, self.law.history)
        self.set_time(0.0)
        self.state.opening = self.opening(self.state.jump)

    def update_stiffness(self, mechanics: BodyForms, constraints: Constraints) -> None:
        """Reassemble the coupling for changed stiffness or supports."""
        self.coupling.update(mechanics, constraints)
        self.law.update_stiffness(self.coupling.local_stiffness())

    def set_time(self, time: float) -> None:
        """Set gaps and prescribed jumps to a time."""
        gap = self._clearance = np.zeros(len(self.own))
        for i, c in enumerate(self._contacts):
            here = self.own.interface == i
            gap[here] = gap_at(self._full_gap[here], c.history, time)
        if self.large is None:
            self.gap = gap_vectors(self.own.normals, self.own.faces, gap)
        else:
            self.large.set_time(self._committed, time)
            self._pair(self.state.jump)
        self.prescribed = np.zeros((len(self.own), 3))
        for support, jump in zip(self._supports, self._by_supports, strict=True):
            self.prescribed += amplitude(support.history, time) * jump

    def _pair(self, jump: Floats) -> None:
        """Pair the points that slide far, at jumps (n, 3) [mm]: gaps, normals, reference."""
        assert self.large is not None
        rows, own, found = self.large.rows, self.own, self.large.pair(jump)
        own.normals[rows, 0] = found.normal
        self.law.turn_normals(rows)
        self._paired_at, gap = jump.copy(), self._clearance.copy()
        gap[rows] += found.gap - np.einsum("pi,pi->p", found.normal, jump[rows])
        self.gap = gap_vectors(own.normals, own.faces, gap)

    def pair(self, trial: TrialState) -> bool:
        """Pair the points that slide far anew if their gaps are wrong in a state; collective."""
        if self.large is None:
            return False
        rows = self.large.rows
        pressure = trial.law.pressures[rows, 0]
        wrong = self.law.met[rows] * self.large.error(self._paired_at, trial.jump)
        local = pressure.max(initial=0.0), wrong[pressure > 0].max(initial=0.0)
        largest, by = self.comm.allreduce(np.array(local), MPI.MAX)
        if by <= ACCURACY * largest:
            return False
        self._pair(trial.jump)
        return True

    def commit(self, state: ContactState, time: float) -> None:
        """Set the committed state, and its time."""
        self.state, self._committed = state, time
        if self.large is not None:
            self.large.set_time(time, time)

    @property
    def reference(self) -> Floats:
        """Jumps at which nothing has slid since the last committed step (n, 3) [mm]."""
        return self.state.jump if self.large is None else self.large.reference(self.state.jump)

    def opening(self, jump: Floats) -> Floats:
        """Jumps (n, 3) with the initial gap; where points slide far along the normal alone."""
        found = jump + self.gap
        if self.large is not None:
            rows, n = self.large.rows, self.own.normals[self.large.rows, 0]
            found[rows] = np.einsum("pi,pi->p", found[rows], n)[:, None] * n
        return found

    def tie(self, on: bool) -> bool:
        """Tie interfaces that were open everywhere so far, or none; collective if it does.

        The sides of a tied interface touch and stick, so that a body that nothing else holds is
        brought to the one it is pushed against. Returns whether there are such interfaces.
        """
        tied = self.law.tied = np.zeros(len(self.own), dtype=bool)
        if not on:
            return False
        for i in range(len(self._contacts)):
            here = self.own.interface == i
            touched = (self._clearance <= 0) | self.state.force.any(axis=1)
            if not self.comm.allreduce(bool(touched[here].any()), MPI.LOR):
                tied |= here
        return bool(self.comm.allreduce(bool(tied.any()), MPI.LOR))

    def augmentation(self) -> dict[str, float]:
        """As `PointLaw.augmentation`, by the name of the interface; collective."""
        values = self.law.augmentation()
        return {self._contacts[i].name: value for i, value in values.items()}

    def freeze(self, on: bool) -> bool:
        """Hold the history of the laws at its last state, or let it go on; whether there is any."""
        self.law.frozen = on and bool(self.law.history)
        return bool(self.law.history)

    def usual_augmentation(self) -> float:
        """As `PointLaw.usual_augmentation`; collective."""
        return self.law.usual_augmentation()

    def scale_augmentation(self, factor: float) -> None:
        """As `PointLaw.scale_augmentation`."""
        self.law.scale_augmentation(factor)

    @property
    def row_keys(self) -> Ints:
        """Keys of own contact points."""
        return self.own.rows

    # Residual and Jacobian

    def trial(self, u: PETSc.Vec, q: PETSc.Vec, f_q: Floats) -> TrialState:
        """A trial state: displacement and jumps, under forces f_q on the jumps [N].

        Where the law F = P(F + r d) in displacement, jumps and forces is linearized about forces
        F_0, P(F_0 + r d) + P' (F - F_0) stands for the force, F that of equilibrium.
        """
        e = self.coupling.equilibrium(u, q, f_q).copy()
        jump, known = q.array.reshape(-1, 3).copy(), self.linear_about
        if known is None:
            return TrialState(self, e, jump, self.evaluate(e, jump))
        law = self.evaluate(-self.own.weight[:, None] * known, jump)
        change = self.forces(e) - self.own.project_free(known)
        by_force = law.by_multiplier @ self.law.multiplier_share
        force = law.force + np.einsum("pij,pj->pi", by_force, change)
        return TrialState(self, e, jump, replace(law, force=force))

    def forces(self, e: Floats) -> Floats:
        """Interface force per area from equilibrium (n, 3) [MPa]; zero where supports hold."""
        return self.own.project_free(-e / self.own.weight[:, None])

    def multiplier(self, e: Floats) -> Floats:
        """Multiplier part of the trial force (n, 3) [MPa].

        An elastic layer of compliance C is exact contact of D - C (F - F_old), across without
        F_old: S = F + r (D - C (F - F_old)) yields it for any r.
        """
        F, layers = self.forces(e), np.eye(3) - self.law.multiplier_share
        return F - np.einsum("pij,pj->pi", layers, F - self.state.friction)

    def evaluate(self, e: Floats, q: Floats) -> PointForces:
        """The laws at own points for equilibrium and jumps."""
        state = self.state
        if self.large is not None:
            state = replace(state, jump=self.reference)
        return self.law.evaluate(self.multiplier(e), q, self.gap, state)

    def residual(self, e: Floats, q: Floats, law: PointForces) -> Floats:
        """Residual e + W P at own points (n, 3) [N]; prescribed jumps where supports hold."""
        own, free = self.own, self.own.project_free
        r = e + own.weight[:, None] * law.force
        scale = self.law.stiffness * own.weight
        return free(r) + scale[:, None] * (q - free(q) - self.prescribed)

    def row_factors(self, law: PointForces) -> tuple[Floats, Floats]:
        """Blocks (n, 3, 3) that multiply [C^T, D], and those added to D, in the Jacobian rows."""
        held, weight = self.own.projector, self.own.weight
        free = np.eye(3) - held
        P = free @ law.by_multiplier @ self.law.multiplier_share @ free
        by_jump = free @ law.by_jump @ free
        scale = (self.law.stiffness * weight)[:, None, None]
        return free - P, weight[:, None, None] * by_jump + scale * held
