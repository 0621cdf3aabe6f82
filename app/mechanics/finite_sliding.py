r"""Large slip: points that slide far over the surface of a rigid body that turns as it is told.

The slave's surface follows the master's by the jump q: :math:`u_s = t + q`, t the translation of
the body. A point X of the slave is at :math:`X - c + q` from the centre c of the body, wherever it
has gone, so that gap and normal of the surface follow from q alone, in axes turned by R. They are
linearized about q where the points were paired with the surface last,

.. math:: D_n = g + n · (q - q_0).

Slip of a step is what the body's surface did not bring along. With w the rotation vector of the
step and a the arm of the touching point,

.. math:: D_T = (1 - n ⊗ n) (q - q_{ref}), \qquad q_{ref} = q_{old} + w × a.

It is a length along arcs, so that dissipation does not depend on the step.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.foundation.errors import InputError
from app.mechanics.body_forms import BodyForms
from app.mechanics.contact_points import OwnPoints
from app.mechanics.followers import Followers, Side
from app.mechanics.pairs import SmoothSurface
from app.mechanics.rigid_surfaces import RigidSurface, fitted
from app.numerics.rigid_motions import rotation_vector
from app.scene.bodies import boundary_facets, facet_nodes
from app.scene.scene import Scene
from meshes.contact_facets import NODES, gather, nodal_normals

# Points are paired anew if the pressure may be wrong by this part of the largest.
ACCURACY = 1e-3


@dataclass(frozen=True)
class Paired:
    """Points paired with the surfaces that they slide on (m of them).

    Attributes:
        gap: Distance from the surface (m,) [mm].
        normal: Its unit normal (m, 3).
        arm: From the centre of the body to the point of its surface (m, 3) [mm].
    """

    gap: Floats
    normal: Floats
    arm: Floats


class FiniteSliding:
    """Own contact points that slide far, with the bodies they slide on.

    Attributes:
        rows: These among own points (m,).
        nodes: Local node of each (m,).
        of: Interface of each (m,).
        masters: What the sides of the interfaces slide on, as meshed, by number.
        paired: As of the last pairing.
        turn: Rotation vector of the body of each point since the last committed step (m, 3).
        rotation: Rotation of the body of each point (m, 3, 3).

    Args:
        dof: Global blocked dofs of the own points (n,).

    Raises:
        InputError: A rigid region has a surface without a formula.
    """

    def __init__(
        self,
        mechanics: BodyForms,
        own: OwnPoints,
        dof: Ints,
        followers: Followers | None,
    ) -> None:
        scene, tagged, space = mechanics.scene, mechanics.tagged, mechanics.space
        apart = [i for i, c in enumerate(scene.contacts) if c.between]
        self.rows: Ints = np.flatnonzero(np.isin(own.interface, apart))
        self.nodes: Ints = dof[self.rows] - space.dofmap.index_map.local_range[0]
        self.of = own.interface[self.rows]
        self._own, self._apart = own, apart
        self._comm, self._followers = tagged.mesh.comm, followers
        self.masters = (
            {i: master for i, (master, _) in followers.sides.items()} if followers else {}
        )
        self._surfaces: dict[int, RigidSurface | SmoothSurface] = {}
        for i in apart:
            c, deforms = scene.contacts[i], i in self.masters
            name = (c.between or ("",))[0]
            if not deforms:
                self.masters[i] = Side.of(tagged, space, name)
            _, _, x, inside = facet_nodes(tagged, space, boundary_facets(tagged, name))
            normals = nodal_normals(x[:, :3], inside, NODES[:3]).reshape(-1, 3)
            nodes, n = gather(self._comm, x[:, :3].reshape(-1, 3), normals)
            found = fitted(nodes, n / np.linalg.norm(n, axis=1)[:, None])
            if not (found or deforms):
                raise InputError(
                    f"interfaces.{c.name}: boundary '{name}' of the rigid region is no plane, "
                    "sphere or cylinder; allowed: these, or an elastic region"
                )
            self._surfaces[i] = found or self.masters[i].smooth
        self.begin(scene)

    def begin(self, scene: Scene) -> None:
        """Set the motions of a run."""
        self._scene, regions = scene, {i: scene.contacts[i].master for i in self._apart}
        self._motion = {i: scene.motion_of(region) for i, region in regions.items()}
        centres = {i: np.array(m.about if m else np.zeros(3)) for i, m in self._motion.items()}
        self._arm = self._own.x[self.rows] - self._each(centres)
        self._centre = self._each(centres)
        self.set_time(0.0, 0.0)

    def _each(self, values: dict[int, Floats]) -> Floats:
        """Values of the interfaces at their points."""
        return np.array([values[i] for i in self.of]).reshape(-1, *values[self._apart[0]].shape)

    def set_time(self, committed: float, time: float) -> None:
        """Set rotations to a time, and turns since that of the last committed step."""
        now, before = (
            {i: self._scene.rotation(m, t) for i, m in self._motion.items()}
            for t in (time, committed)
        )
        self.rotation = self._each(now)
        self.turn = self._each({i: rotation_vector(now[i] @ before[i].T) for i in now})

    def pair(self, jump: Floats) -> Paired:
        """Pair the points, at jumps of all own points (n, 3) [mm]; collective."""
        self.paired = self._at(jump)
        for i in self._followers.sides if self._followers else ():
            here = self.of == i
            number = self._own.rows[self.rows[here]]  # in the order of the vertices
            number, x = gather(self._comm, number, self.places(jump)[here])
            assert self._followers is not None
            self._followers.pair(i, x[np.argsort(number)])
        return self.paired

    def touching(self, time: float) -> Floats:
        """Where points touched last, in axes of the bodies as turned at a time (m, 3) [mm]."""
        R = self._each({i: self._scene.rotation(m, time) for i, m in self._motion.items()})
        return self._centre + np.einsum("pji,pj->pi", R, self.paired.arm)

    def places(self, jump: Floats) -> Floats:
        """Points in the axes of the bodies that they slide on (m, 3) [mm]."""
        way = self._arm + jump[self.rows]
        return self._centre + np.einsum("pji,pj->pi", self.rotation, way)

    def _at(self, jump: Floats) -> Paired:
        way, R, x = self._arm + jump[self.rows], self.rotation, self.places(jump)
        gap, normal = np.zeros(len(x)), np.zeros(x.shape)
        for i, surface in self._surfaces.items():
            here = self.of == i
            gap[here], normal[here] = surface.gap(x[here])
        normal = np.einsum("pij,pj->pi", R, normal)
        return Paired(gap, normal, way - gap[:, None] * normal)

    def reference(self, jump: Floats) -> Floats:
        """Jumps (n, 3) [mm] at which nothing has slid since the committed ones."""
        found = jump.copy()
        found[self.rows] += np.cross(self.turn, self.paired.arm)
        return found

    def error(self, before: Floats, jump: Floats) -> Floats:
        """Error of the gap linearized about jumps before, at jumps; both (n, 3): (m,) [mm]."""
        known, change = self.paired, (jump - before)[self.rows]
        line = known.gap + np.einsum("pi,pi->p", known.normal, change)
        return np.abs(self._at(jump).gap - line)
