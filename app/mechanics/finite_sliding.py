r"""Contact points with finite sliding: their gaps, normals and slip over another body's surface.

The slave's surface follows the master's by the jump q (`mechanics.followers`). A point X of the
slave is at :math:`X - c + q` from the centre c of the master's rotation, wherever it has slid. Gap
and normal of the surface therefore follow from q alone, in axes rotated by R. They are linearized
about the jumps q_0 at which the points were paired with the surface last,

.. math:: G_n = g + n · (q - q_0).

The slip of a step is the motion less that of the body's surface. With w the rotation vector of the
step and a the arm of the touching point,

.. math:: ΔG_T = (1 - n ⊗ n) (q - q_{ref}), \qquad q_{ref} = q_{old} + w × a.

It is a length along arcs, so that dissipation does not depend on the step. Rigid and deformable
masters are alike here; `mechanics.followers` says in what they differ.

Pairing is a part of Newton's system, so it stands with the mechanics. What is made of slip and
pressure (wear, torque, heat of a cycle) is in the package `app/bearing`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints
from app.interfaces.interface_facets import gathered_arrays
from app.mechanics.body_forms import BodyForms
from app.mechanics.contact_state import LocalPoints
from app.mechanics.followers import Followers
from app.numerics.rigid_motions import rotation_vector
from app.scene.scene import Scene


@dataclass(frozen=True)
class Paired:
    """Points paired with the surfaces that they slide on (m of them).

    Attributes:
        gap: Distance from the surface (m,) [mm].
        normal: Unit normal of the surface (m, 3).
        arm: From the centre of the body to the point of its surface (m, 3) [mm].
    """

    gap: Floats
    normal: Floats
    arm: Floats


class FiniteSliding:
    """Contact points of this rank with finite sliding, and the bodies they slide on.

    Attributes:
        rows: Rows of these points among all points of this rank (m,).
        nodes: Local node of each (m,).
        interface_of_point: Interface of each (m,).
        followers: Sides of the interfaces, and the nodes that follow them.
        paired: The last pairing.
        jump_at_pairing: Jumps of all points of this rank at the last pairing (n, 3) [mm].
        jump_at_committed_pairing: The same for the committed state; None before the first commit.
        step_rotation: Rotation vector of the master of each point since the last committed step
            (m, 3).
        rotation: Rotation of the master of each point (m, 3, 3).

    Args:
        dof: Global blocked dofs of the points of this rank (n,).
    """

    saved = ("jump_at_committed_pairing",)

    def __init__(
        self, body_forms: BodyForms, points: LocalPoints, dof: Ints, followers: Followers
    ) -> None:
        self.followers = followers
        self._interfaces = list(followers.sides)
        self.rows: Ints = np.flatnonzero(np.isin(points.interface, self._interfaces))
        self.nodes: Ints = dof[self.rows] - body_forms.space.dofmap.index_map.local_range[0]
        self.interface_of_point = points.interface[self.rows]
        self._points, self._comm = points, body_forms.mesh.comm
        self.begin(body_forms.scene)

    @property
    def on_deformable(self) -> Bools:
        """Mask of the points whose masters deform (m,)."""
        return np.isin(self.interface_of_point, self.followers.deformable)

    def begin(self, scene: Scene) -> None:
        """Set the motions of a run."""
        self._scene, interfaces = scene, scene.parting_interfaces
        self._motion = {i: scene.motion_of(interfaces[i].master) for i in self._interfaces}
        centres = {i: np.array(m.about if m else np.zeros(3)) for i, m in self._motion.items()}
        self._centre = self._of_points(centres)
        self._arm = self._points.x[self.rows] - self._centre
        self._committed_load_time = 0.0
        self.jump_at_committed_pairing: Floats | None = None
        self.set_time(0.0)

    def _of_points(self, values: dict[int, Floats]) -> Floats:
        """Values of the interfaces at their points."""
        shape = values[self._interfaces[0]].shape
        return np.array([values[i] for i in self.interface_of_point]).reshape(-1, *shape)

    def set_time(self, load_time: float) -> None:
        """Set rotations to a time of loads, and those since that of the last committed step."""
        self._load_time = load_time
        rotations, committed_rotations = (
            {i: self._scene.rotation(m, t) for i, m in self._motion.items()}
            for t in (load_time, self._committed_load_time)
        )
        self.rotation = self._of_points(rotations)
        self.step_rotation = self._of_points(
            {i: rotation_vector(rotations[i] @ committed_rotations[i].T) for i in rotations}
        )

    def commit(self) -> None:
        """Commit the current pairs and rotations."""
        self._committed_load_time = self._load_time
        self.set_time(self._load_time)
        self.jump_at_committed_pairing = self.jump_at_pairing

    def find_pairs(self, jump: Floats) -> Paired:
        """Pair the points, at jumps of all points of this rank (n, 3) [mm]; collective."""
        self.paired, self.jump_at_pairing = self._pair_with_surfaces(jump), jump.copy()
        positions = self.positions_on_masters(jump)
        for i in self.followers.deformable:
            at_interface = self.interface_of_point == i
            # Numbers of points are in the order of the vertices.
            point_number = self._points.rows[self.rows[at_interface]]
            point_number, x = gathered_arrays(self._comm, point_number, positions[at_interface])
            self.followers.find_pairs(i, x[np.argsort(point_number)])
        return self.paired

    def touching(self, time: float) -> Floats:
        """Points of the surfaces touched last, in axes of the bodies at a time (m, 3) [mm]."""
        rotations = self._of_points(
            {i: self._scene.rotation(m, time) for i, m in self._motion.items()}
        )
        return self._centre + np.einsum("pji,pj->pi", rotations, self.paired.arm)

    def positions_on_masters(self, jump: Floats) -> Floats:
        """Points in the axes of the bodies that they slide on (m, 3) [mm]."""
        from_centre = self._arm + jump[self.rows]
        return self._centre + np.einsum("pji,pj->pi", self.rotation, from_centre)

    def _pair_with_surfaces(self, jump: Floats) -> Paired:
        from_centre, x = self._arm + jump[self.rows], self.positions_on_masters(jump)
        gap, normal = np.zeros(len(x)), np.zeros(x.shape)
        for i, (master, _) in self.followers.sides.items():
            at_interface = self.interface_of_point == i
            gap[at_interface], normal[at_interface] = master.surface.gap(x[at_interface])
        normal = np.einsum("pij,pj->pi", self.rotation, normal)
        return Paired(gap, normal, from_centre - gap[:, None] * normal)

    def reference(self, jump: Floats) -> Floats:
        """Jumps (n, 3) [mm] with zero slip relative to committed jumps (n, 3) [mm]."""
        reference = jump.copy()
        reference[self.rows] += np.cross(self.step_rotation, self.paired.arm)
        return reference

    def gap_error(self, jump: Floats) -> Floats:
        """Error at jumps (n, 3) [mm] of the gap linearized about those at the pairing (m,) [mm]."""
        paired, change = self.paired, (jump - self.jump_at_pairing)[self.rows]
        linear_gap = paired.gap + np.einsum("pi,pi->p", paired.normal, change)
        return np.abs(self._pair_with_surfaces(jump).gap - linear_gap)
