"""State of bodies with finite sliding, as they rotate and as their points change facets.

Nodes of a slave follow the facets of the master with which they are paired
(`mechanics.followers`). If a node is paired with another facet, the same displacement has different
unknowns and jumps. A step begins at the committed displacements, in the current pairs.
"""

from __future__ import annotations

from collections.abc import Mapping

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from dolfinx import fem

from app.foundation.arrays import Floats
from app.mechanics.body_forms import BodyForms
from app.mechanics.contact import ContactInterfaces, TrialState
from app.mechanics.finite_sliding import FiniteSliding
from app.mechanics.followers import Followers
from app.mechanics.stiffness import Stiffness
from app.scene.scene import Scene

# Bodies without contact move by this multiple of the distance to the first contact [-]. So some
# points overlap.
APPROACH_FACTOR = 1.25
# A point approaches the other side if the cosine of the angle between the normal and its motion is
# above this [-].
FACING_COSINE = 0.1

# Displacements of owned nodes without translations of rotating bodies, and these by motion.
SplitVectors = tuple[Floats, dict[str, Floats]]


class SlidingBodies:
    """State of bodies with finite sliding; made collectively.

    The order of calls is: `begin` at rest, or `restore_pairs` and `begin_at` after a restart. Then
    in each step `follow_pairs` when time or rotations change, `set_committed` and `approach` before
    the solve, `update_pairs` after each solve until it returns False, and `commit`.

    Attributes:
        work: Work of finite sliding at owned nodes since the beginning, and on rank 0 that of the
            translations of rotating bodies [N mm].

    Args:
        moved: Displacement of each body that jumps move.
    """

    saved = ("work",)

    def __init__(
        self,
        body_forms: BodyForms,
        stiffness: Stiffness,
        contact: ContactInterfaces,
        points: FiniteSliding,
        moved: Mapping[int, fem.Function],
    ) -> None:
        self._body_forms, self._stiffness, self._contact = body_forms, stiffness, contact
        self._points, self._moved = points, moved
        self._followers: Followers = points.followers
        self.begin(body_forms.scene)

    def begin(self, scene: Scene) -> None:
        """Begin a run at rest; collective."""
        self._followers.begin(scene)
        self._committed = self._committed_forces = self._followers.split_translations(
            np.zeros_like(self._nodal)
        )
        self.work = 0.0

    @property
    def _nodal(self) -> Floats:
        """Displacement of owned nodes (n, 3) [mm]."""
        nodes = self._body_forms.space.dofmap.index_map.size_local
        return np.asarray(self._body_forms.u.x.array[: 3 * nodes].reshape(-1, 3))

    def _split_displacements(self) -> SplitVectors:
        """Displacement of owned nodes, on slaves with their jumps; collective."""
        nodal = self._nodal.copy()
        for body, nodes in self._followers.slaves:
            nodal[nodes] = self._moved[body].x.array.reshape(-1, 3)[nodes]
        return self._followers.split_translations(nodal)

    def _contact_forces(self, trial: TrialState) -> SplitVectors:
        """Forces of finite sliding on owned nodes [N], and their sums on rotating bodies."""
        on_slaves = np.zeros_like(self._nodal)
        on_slaves[self._points.nodes] = trial.equilibrium[self._points.rows]
        forces = on_slaves - self._followers.forces_on_masters(on_slaves)
        return forces, self._followers.totals(forces)

    def _set_unknowns(self, displacements: SplitVectors, u: PETSc.Vec, q: PETSc.Vec) -> None:
        """Set unknowns and jumps to displacements, in current rotations and pairs; collective."""
        constraints, nodal = (
            self._stiffness.constraints,
            self._followers.join_translations(*displacements),
        )
        constraints.contract(nodal).copy(u)
        remaining_jump = nodal - constraints.expand(u).array.reshape(-1, 3)
        q.array.reshape(-1, 3)[self._points.rows] = remaining_jump[self._points.nodes]

    def restore_pairs(self) -> Floats:
        """Pair surfaces as in the restored state; collective.

        Returns:
            The restored displacement of owned nodes (n, 3) [mm], which pairs do not change.
        """
        jump = self._points.jump_at_committed_pairing
        if jump is not None:
            self._contact.gaps.set_pairs(jump)
            self.follow_pairs()
        return self._nodal

    def begin_at(self, trial: TrialState) -> None:
        """Begin at a restored state with updated displacements; collective."""
        self._store(trial)

    def _store(self, trial: TrialState) -> None:
        """Store displacements and contact forces of a state as committed; collective."""
        self._committed, self._committed_forces = (
            self._split_displacements(),
            self._contact_forces(trial),
        )

    def follow_pairs(self) -> None:
        """Let nodes follow the facets with which they are paired now; collective.

        The committed displacements are expressed in the current pairs.
        """
        if not self._followers.changed:
            return
        stiffness, coupling = self._stiffness, self._contact.coupling
        stiffness.constraints.update_followers()
        stiffness.update(paired=True)
        coupling.update(stiffness.constraints, paired=True)
        u, q = stiffness.K.createVecRight(), coupling.D.createVecRight()
        q.array[:] = self._contact.state.jump.ravel()
        self.set_committed(u, q)
        self._contact.gaps.committed_jump = q.array.reshape(-1, 3).copy()

    def approach(self, f: PETSc.Vec, u: PETSc.Vec, q: PETSc.Vec) -> None:
        """Move bodies without contact along forces f [N] until they overlap slightly; collective.

        Newton's method then starts with active contact points, however small the load is. From
        afar it would not find them.
        """
        contact, rows = self._contact, self._points.rows
        constraints = self._stiffness.constraints
        rigid_motion = constraints.rigid_motion_along(f)
        direction = constraints.expand(rigid_motion).array_r.reshape(-1, 3)[self._points.nodes]
        gap = contact.gaps.gap_at_pairing[rows]
        closing_speed = np.einsum("pi,pi->p", contact.local.normals[rows, 0], direction)
        is_closing = closing_speed > FACING_COSINE * np.linalg.norm(direction, axis=1)
        nearest = float(np.min(gap[is_closing] / closing_speed[is_closing], initial=np.inf))
        touches = (gap <= 0).any() or contact.state.force[rows].any()
        # Multiple of the direction up to the first contact.
        distance = contact.comm.allreduce(0.0 if touches else nearest, MPI.MIN)
        if np.isfinite(distance):
            u.axpy(APPROACH_FACTOR * distance, rigid_motion)
            q.array.reshape(-1, 3)[rows] -= APPROACH_FACTOR * distance * direction

    def set_committed(self, u: PETSc.Vec, q: PETSc.Vec) -> None:
        """Set unknowns and jumps to the committed displacements, in the current pairs."""
        self._set_unknowns(self._committed, u, q)

    def update_pairs(self, trial: TrialState, u: PETSc.Vec, q: PETSc.Vec) -> bool:
        """Pair points as `ContactGaps.update_pairs`; collective.

        Updated displacements are kept; u and q then express them in the current pairs.

        Returns:
            True if points were paired.
        """
        displacements = self._split_displacements()
        if not self._contact.gaps.update_pairs(trial.jump, trial.forces.pressures):
            return False
        self.follow_pairs()
        self._set_unknowns(displacements, u, q)
        return True

    def commit(self, trial: TrialState) -> None:
        """Commit a converged state with updated displacements; collective."""
        (f0, F0), (u0, t0) = self._committed_forces, self._committed
        self._store(trial)
        (f1, F1), (u1, t1) = self._committed_forces, self._committed
        work = float(((f0 + f1) * (u1 - u0)).sum())
        if self._body_forms.mesh.comm.rank == 0:
            work += sum(float((F0[k] + F1[k]) @ (t1[k] - t0[k])) for k in F1)
        self.work -= work / 2
