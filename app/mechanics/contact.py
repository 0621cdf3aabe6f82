r"""The jump block: unknown jumps at contact points, coupled to the bonded displacement.

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

from collections.abc import Callable, Hashable, Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from app.arrays import Bools, Floats, Ints
from app.case.run_options import USUAL_AUGMENTATION
from app.mechanics.body_forms import BodyForms
from app.mechanics.constraints import Reduction
from app.mechanics.contact_law import PointForces, PointLaw, gap_vectors
from app.mechanics.contact_state import ContactState
from app.mechanics.held_jumps import refuse_moving_rigid, refuse_released
from app.mechanics.jump_moves import jump_moves
from app.numerics.sparse import diagonal_blocks, matrix_sum, owners
from app.scene.bodies import Bodies, contact_facets
from app.scene.frames import Frames, held_at
from app.scene.laws import InterfaceLaw
from app.scene.terms import ContactTerm, Scene, amplitude, gap_at
from app.system.timing import Timing
from forms.contact import OPEN, SLIP, STICK
from meshes.contact_facets import InterfaceFacets
from meshes.contact_points import contact_points
from meshes.distribute import TaggedMesh

# A face is closed, to separate slip from opening, if its gap is below this fraction of the step.
CLOSED = 1e-6


class ContactInterfaces:
    """Contact of all interfaces on this rank: points, coupling to the bodies, law, state.

    Attributes:
        points: All contact points, replicated.
        facets: All interface facets, replicated.
        mine: Rows of ``points`` that this rank owns (n,).
        held: Projectors on what supports give of each own jump (n, 3, 3).
        edge_lengths: Mean edge of the facets of each interface [mm].
        augmented: Whether each own point is of an augmented-Lagrangian interface (n,).
        stiffness: Stiffness of the trial force of each own point (n,) [MPa/mm].
        share: Part of the force of equilibrium in the trial force: 1 for an augmentation (n,).
    """

    saved = ("history",)

    def __init__(
        self,
        scene: Scene,
        tagged: TaggedMesh,
        bodies: Bodies,
        mechanics: BodyForms,
        reduction: Reduction,
        frames: Frames | None,
        augmentation_factor: float,
        timing: Timing,
    ) -> None:
        """Find the contact points and assemble the coupling; collective.

        Raises:
            InputError: An interface has no facets on this mesh.
        """
        self._supports = scene.supports
        self.comm = tagged.mesh.comm
        space = mechanics.space
        self.facets: InterfaceFacets = contact_facets(
            tagged, bodies, space, scene.contacts, scene.moduli
        )
        holds, axes = held_at(frames, tagged, bodies, space, scene.supports, self.facets)
        self.points, entries = contact_points(self.facets, holds, len(scene.contacts), axes)
        refuse_released(scene.supports, self.points)
        refuse_moving_rigid(scene, bodies, holds, self.points, entries)
        self.mine, place = owners(self.comm, space.dofmap.index_map, self.points.dof)
        self.weight = self.points.weight[self.mine]
        self.normals = self.points.normals[self.mine]
        self.faces = self.points.faces[self.mine]
        self.held = self.points.held_part[self.mine]
        self.interface = self.points.interface[self.mine]
        edges = np.linalg.norm(self.facets.x - np.roll(self.facets.x, 1, axis=1), axis=2)
        self.edge_lengths = [
            float(edges[self.facets.interface == i].mean()) for i in range(len(scene.contacts))
        ]
        self._given = [self._given_by(s) for s in range(len(scene.supports))]
        self.moves, self._strips = jump_moves(mechanics, entries, place, len(self.mine))
        self.C, self.D, self.Ct = self._coupling(mechanics, reduction)
        self._work = self.Ct.createVecLeft()
        self._laws: dict[tuple[Hashable, ...], PointLaw] = {}
        self._timing = timing
        self.begin(scene.contacts, augmentation_factor)

    def begin(self, contacts: Sequence[ContactTerm], augmentation_factor: float) -> None:
        """Reset to the unloaded state, with other laws of the same interfaces; collective.

        Args:
            contacts: Interfaces of the same surfaces as ever.
            augmentation_factor: Default augmentation over the local stiffness per area.
        """
        self._contacts, self._factor = contacts, augmentation_factor
        self.augmented = np.array([c.law.augmented for c in contacts])[self.interface]
        self._law = self._law_of([c.law for c in contacts])
        self._tied = np.zeros(len(self.mine), dtype=bool)
        self.default_stiffness = self._default_stiffness()
        self._augmentation_scale = 1.0
        self._stiffen()
        full = np.zeros(len(self.points.weight))
        for i, c in enumerate(contacts):
            # On every rank at all points, so that an error is raised on every rank.
            here = self.points.interface == i
            full[here] = c.gap(self.points.x[here])
        self._full_gap = full[self.mine]
        self.set_time(0.0)
        zero, none = np.zeros((len(self.mine), 3)), np.zeros(len(self.mine))
        own = {k: np.zeros((len(none), *shape)) for k, shape in self._law.history.items()}
        self.history = ContactState(
            zero, zero, zero, self.gap, zero, none, none, none, none, none, own
        )

    # Construction

    def _law_of(self, laws: Sequence[InterfaceLaw]) -> PointLaw:
        """The law of all points, compiled once for laws of the same forms."""
        self._frictional = np.array([law.frictional for law in laws])[self.interface]
        self._can_open = np.array([law.can_open for law in laws])[self.interface]
        forms = tuple(law.form for law in laws)
        if forms not in self._laws:
            with self._timing.phase("compile", "contact"):
                self._laws[forms] = PointLaw(
                    self.comm, self.normals, self.faces, laws, self.interface
                )
        self._laws[forms].set(laws)
        return self._laws[forms]

    def tie(self, on: bool) -> bool:
        """Tie interfaces that were open everywhere so far, or none; collective if it does.

        Tied sides touch, whatever that takes, and do not slip: a body that nothing else holds is
        brought to the one it is pushed against. Returns whether there are any.
        """
        self._tied = np.zeros(len(self.mine), dtype=bool)
        if not on:
            return False
        for i in range(len(self._contacts)):
            here = self.interface == i
            touched = (self._clearance <= 0) | self.history.force.any(axis=1)
            if not self.comm.allreduce(bool(touched[here].any()), MPI.LOR):
                self._tied |= here
        return bool(self.comm.allreduce(bool(self._tied.any()), MPI.LOR))

    def _default_stiffness(self) -> Floats:
        """Stiffness of the trial force of each own point, as its law has it (n,) [MPa/mm].

        By default it is a factor of what the jump meets per area with all else held, in its softest
        direction: that follows materials, setting, mesh and order by itself.
        """
        self._met = np.linalg.eigvalsh(self.local_stiffness())[:, 0] / self.weight
        return self._by_law(lambda law, here, met: law.trial_stiffness(met, self._factor))

    def _by_law(self, value: Callable[[InterfaceLaw, Bools, Floats], Floats]) -> Floats:
        """Values of own points (n,), as the law of each interface has them.

        Args:
            value: Gives them from a law, its points, and the stiffness that their jumps meet.
        """
        values = np.zeros(len(self.mine))
        for i, c in enumerate(self._contacts):
            here = self.interface == i
            values[here] = value(c.law, here, self._met[here])
        return values

    def _given_by(self, s: int) -> Floats:
        """Own jumps (n, 3) that a support gives at full amplitude [mm]."""
        master, slave = self.points.given[:, :, 0] == s, self.points.given[:, :, 1] == s
        sign = slave.astype(float) - master
        rows = np.flatnonzero(sign.any(axis=1))
        jump, axes = np.zeros(sign.shape), self.points.axes[rows]
        values = np.einsum("pic,pi->pc", axes, self._supports[s].values(self.points.x[rows]))
        jump[rows] = np.einsum("pic,pc->pi", axes, sign[rows] * values)
        return jump[self.mine]

    def _coupling(
        self, mechanics: BodyForms, reduction: Reduction
    ) -> tuple[PETSc.Mat, PETSc.Mat, PETSc.Mat]:
        """Assemble C, D and the transpose of C."""
        KB = {b: mechanics.matrix(self._strips[b]).matMult(B) for b, B in self.moves.items()}
        C = reduction.rows(matrix_sum(list(KB.values())))
        D = matrix_sum([B.transposeMatMult(KB[b]) for b, B in self.moves.items()])
        return C, D, C.copy().transpose()

    def update_stiffness(self, mechanics: BodyForms, reduction: Reduction) -> None:
        """Assemble the coupling again, in the same matrices: stiffness or supports have changed."""
        new = self._coupling(mechanics, reduction)
        for matrix, values in zip((self.C, self.D, self.Ct), new, strict=True):
            values.copy(matrix, structure=PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
        self.default_stiffness = self._default_stiffness()
        self._stiffen()

    # State in time

    def set_time(self, time: float) -> None:
        """Set gaps and given jumps to a time."""
        gap = self._clearance = np.zeros(len(self.mine))
        for i, c in enumerate(self._contacts):
            here = self.interface == i
            gap[here] = gap_at(self._full_gap[here], c.history, time)
        self.gap = gap_vectors(self.normals, self.faces, gap)
        self.given = np.zeros((len(self.mine), 3))
        for support, jump in zip(self._supports, self._given, strict=True):
            self.given += amplitude(support.history, time) * jump

    def scale_augmentation(self, factor: float) -> None:
        """Multiply the default augmentation by a factor, until the next call."""
        self._augmentation_scale = factor
        self._stiffen()

    def usual_augmentation(self) -> float:
        """Multiple of the augmentation asked for that would be chosen, in the mean; collective."""
        here = self.augmented
        usual = USUAL_AUGMENTATION * self._met[here]
        own = np.array_equal(usual, self.default_stiffness[here])
        if self.comm.allreduce(own, MPI.LAND):
            return 1.0
        logs = float(np.log(usual / self.default_stiffness[here]).sum())
        total, count = self.comm.allreduce(np.array([logs, here.sum()]), MPI.SUM)
        return float(np.exp(total / count)) if count else 1.0

    def augmentation(self, trial: bool = False) -> dict[str, float]:
        """Augmentation or penalty of each interface that can open [MPa/mm]; collective.

        Args:
            trial: Of penalties what they are solved with, not what they are.
        """
        values = {}
        for i, c in enumerate(self._contacts):
            if c.law.can_open:
                stiffness = self.stiffness if c.law.augmented or trial else self.default_stiffness
                local = float(stiffness[self.interface == i].max(initial=0.0))
                values[c.name] = float(self.comm.allreduce(local, MPI.MAX))
        return values

    def _stiffen(self) -> None:
        """Stiffness of the trial forces S, and the share of the force of equilibrium in them."""
        full = self.default_stiffness
        self.stiffness = self._by_law(
            lambda law, here, met: law.softened_stiffness(full[here], met, self._augmentation_scale)
        )
        self.share = self._by_law(
            lambda law, here, met: law.multiplier_share(self.stiffness[here], full[here])
        )

    # Residual and Jacobian

    def equilibrium(self, u: PETSc.Vec, q: PETSc.Vec, f_q: Floats) -> Floats:
        """Equilibrium e = C^T u + D q - f_q at own points (n, 3) [N]; -e is the force W F."""
        self.Ct.mult(u, self._work)
        self.D.multAdd(q, self._work, self._work)
        return self._work.array.reshape(-1, 3) - f_q.reshape(-1, 3)

    def forces(self, e: Floats) -> Floats:
        """Interface force per area from equilibrium (n, 3) [MPa]; zero where supports hold."""
        return self.let(-e / self.weight[:, None])

    def let(self, vectors: Floats) -> Floats:
        """The part of vectors at own points that supports do not give (n, 3)."""
        return vectors - np.einsum("pij,pj->pi", self.held, vectors)

    def law(self, e: Floats, q: Floats) -> PointForces:
        """The law at own points for a trial state."""
        F = self._multiplier(self.forces(e))
        law = self._law.evaluate(
            self.let(F),
            self.let(q),
            self.gap,
            self.let(self.history.jump),
            self.stiffness,
            self.history.own,
        )
        if self._tied.any():
            old, n = self.history.jump, self.normals
            slid = old - np.einsum("pik,pkj,pj->pi", np.linalg.pinv(n), n, old)
            trial = F + self.stiffness[:, None] * (q + self.gap - slid)
            law.force[self._tied] = self.let(trial)[self._tied]
            law.jacobian[self._tied] = np.eye(3)
            law.by_jump[self._tied] = (self.stiffness[:, None, None] * np.eye(3))[self._tied]
            law.status[self._tied] = STICK
        return law

    def _multiplier(self, F: Floats) -> Floats:
        """The part of the trial force that is no stretch: of a penalty only the friction before."""
        share = self.share[:, None]
        return share * F + (1 - share) * self.history.friction

    def residual(self, e: Floats, q: Floats, law: PointForces) -> Floats:
        """Residual e + W P at own points (n, 3) [N]; the given jumps where supports hold."""
        r = e + self.weight[:, None] * law.force
        scale = self.stiffness * self.weight
        return self.let(r) + scale[:, None] * (q - self.let(q) - self.given)

    def row_factors(self, law: PointForces) -> tuple[Floats, Floats]:
        """Blocks (n, 3, 3) that multiply [C^T, D], and those added to D, in the Jacobian rows."""
        free = np.eye(3) - self.held
        P, by_jump = free @ law.jacobian @ free, free @ law.by_jump @ free
        scale = (self.stiffness * self.weight)[:, None, None]
        times = free - self.share[:, None, None] * P
        return times, self.weight[:, None, None] * by_jump + scale * self.held

    def local_stiffness(self) -> Floats:
        """Stiffness that the jump of each own point meets with all else held (n, 3, 3) [N/mm]."""
        return diagonal_blocks(self.D, 3)

    @property
    def row_keys(self) -> Ints:
        """Keys of own contact points."""
        return self.mine

    def commit(self, e: Floats, q: Floats, law: PointForces) -> None:
        """Make a converged state the history.

        A point slides by the tangential part of a step at whose end it is in contact: the motion
        for which the law gives its friction. What it moves while it is open is no slip.

        Dissipation is the implicit sum, new friction times the step's slip: what the incremental
        potential (eq. 55) makes non-negative at each point, where the trapezoidal rule is negative
        when friction reverses. Work is trapezoidal, so that the energy balance closes.

        Contact without tension does no work in its total gap (jump and initial gap; a changing gap
        does do work in the jump), so ``contact_work`` is what the load steps make of points that
        close or open within a step. For a penalty it is the energy stored in its springs,
        r/2 g^2 per area, which comes back when they let go; their tangential part is no slip and is
        taken out of the dissipation.
        """
        old = self.history
        step = q - old.jump
        opening = q + self.gap
        F = self.forces(e)
        normal = np.einsum("pk,pki->pi", law.pressures, self.normals)
        friction = F + normal
        touching = self._can_open & (law.status != OPEN)
        slid = np.where(touching[:, None], self._tangential(step, opening, law), 0.0)
        dissipated = self.weight * np.einsum("pi,pi->p", *self.rubbing(e, q, law))
        pushed = np.einsum("pi,pi->p", old.force - old.friction - normal, opening - old.opening) / 2
        self.history = ContactState(
            jump=q.copy(),
            force=F,
            friction=friction,
            opening=opening,
            slip=old.slip + slid,
            path=old.path + np.linalg.norm(slid, axis=1),
            dissipation=old.dissipation + dissipated,
            least=np.minimum(old.least, dissipated),
            contact_work=old.contact_work + self.weight * pushed,
            work=old.work + self.weight * np.einsum("pi,pi->p", (F + old.force) / 2, step),
            own=law.history,
        )

    def rubbing(self, e: Floats, q: Floats, law: PointForces) -> tuple[Floats, Floats]:
        """Friction [MPa] and slip [mm] of a step as the law has them, each (n, 3).

        None where a point is open or sticks, though the solver's tolerance leaves some.
        """
        force = law.force + np.einsum("pk,pki->pi", law.pressures, self.normals)
        missing = self._multiplier(self.forces(e)) - force
        slip = q - self.history.jump + missing / self.stiffness[:, None]
        slides = (self._frictional & (law.status == SLIP))[:, None]
        force, slip = (
            np.where(slides, self._tangential(slip, q + self.gap, law, v), 0.0)
            for v in (force, slip)
        )
        return force, slip

    def _tangential(
        self, step: Floats, opening: Floats, law: PointForces, of: Floats | None = None
    ) -> Floats:
        """Part of a step, or of other vectors, tangential to the closed faces (n, 3).

        At an edge that is the part along it: the force of a point that friction on one face holds
        against another acts across the edge too, but nothing slips there.
        """
        gap = np.einsum("pi,pki->pk", opening, self.normals)
        closed = (law.pressures > 0) | (gap <= CLOSED * np.linalg.norm(step, axis=1)[:, None])
        n = np.where(closed[:, :, None], self.normals, 0.0)
        whole = step if of is None else of
        return whole - np.einsum("pik,pkj,pj->pi", np.linalg.pinv(n), n, whole)
