"""Rigid motions of bodies at the contact points, and what resists them.

Nothing resists an *unresisted* motion, neither supports nor points, open or touching. A body
*floats* if it has a motion that neither supports nor touching points resist. Open points may still
stop such a motion.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from app.foundation.arrays import Bools, Floats
from app.interfaces.corners import ContactPoints
from app.mechanics.body_forms import BodyForms
from app.mechanics.contact_state import LocalPoints
from app.mechanics.stiffness import Stiffness, support_resistance
from app.numerics.rigid_motions import (
    FREE_RESISTANCE,
    motions_outside,
    relative_resistance,
    rigid_modes,
)

# A body takes part in a free motion of unit size if its components exceed this size.
MOVING_SIZE = 1e-3
# A motion changes no gap if its resistance, a slope squared, is below this fraction of the largest.
ZERO_RESISTANCE = 1e-14


class ContactMotions:
    """Rigid motions of all bodies against each other, at the points of this rank.

    Args:
        body_forms: The bodies.
        stiffness: Their stiffness and supports.
        points: All contact points.
        local: The points of this rank.
        has_finite_sliding: True if an interface has finite sliding. Then no motion counts as
            unresisted.
    """

    # Resistance of the active supports to rigid motions, by body.
    _support_resistance: dict[int, Floats] | None = None

    def __init__(
        self,
        body_forms: BodyForms,
        stiffness: Stiffness,
        points: ContactPoints,
        local: LocalPoints,
        *,
        has_finite_sliding: bool,
    ) -> None:
        self._comm = body_forms.mesh.comm
        self._body_forms, self._stiffness = body_forms, stiffness
        self._body_count = len(body_forms.bodies.names)
        self._points, self._local = points, local
        self._has_finite_sliding = has_finite_sliding

    def update_supports(self) -> None:
        """Forget the resistance of supports, because other supports act."""
        self._support_resistance = None

    def numbers_of_floating_bodies(self, touching: Bools, sticking: Bools) -> set[int]:
        """Numbers of bodies that neither supports nor touching points hold; collective.

        Args:
            touching: Mask of local points that touch or are bonded (n,).
            sticking: Mask of those that resist any jump; the others resist only along the normals
                of their faces (n,).
        """
        free_motions = self._weakly_resisted_motions(
            sticking, touching & ~sticking, FREE_RESISTANCE
        )
        takes_part = (
            np.linalg.norm(free_motions.reshape(self._body_count, -1), axis=1) > MOVING_SIZE
        )
        return {int(body) for body in np.flatnonzero(takes_part)}

    def unresisted(self, sticking: Bools) -> Floats:
        """Rigid motions that nothing resists (6 bodies, k); collective.

        In such a motion bodies slide along all their faces, touching or not, and no sticking point
        moves. Forces and gaps do not change. An example is the rotation of a frictionless stem
        about its axis. Motions have the components of `relative`. There are none with finite
        sliding.

        Args:
            sticking: Mask of local points that resist any jump (n,).
        """
        if self._has_finite_sliding:
            return np.zeros((6 * self._body_count, 0))
        return self._weakly_resisted_motions(sticking, ~sticking, ZERO_RESISTANCE)

    def resisted_by_open_points(self, touching: Bools, sticking: Bools) -> Floats:
        """Rigid motions that only open points resist (6 bodies, k); collective.

        The motions of `unresisted` are not among them. Arguments are those of
        `numbers_of_floating_bodies`.
        """
        if self._has_finite_sliding:
            return np.zeros((6 * self._body_count, 0))
        weakly_resisted = self._weakly_resisted_motions(
            sticking, touching & ~sticking, FREE_RESISTANCE
        )
        return motions_outside(weakly_resisted, self.unresisted(sticking))

    def _weakly_resisted_motions(self, stick: Bools, slide: Bools, threshold: float) -> Floats:
        """Rigid motions resisted by less than a threshold (6 bodies, k); collective.

        Args:
            stick: Mask of local points that resist their jump (n,).
            slide: Mask of local points that resist their opening (n,).
            threshold: Ratio of the threshold to the largest resistance [-].
        """
        faces = np.einsum("pki,pkj->pij", self._local.normals, self._local.normals)
        B = stick[:, None, None] * np.eye(3) + slide[:, None, None] * faces
        B *= self._local.weight[:, None, None]
        resistance_of_points = self.jumps_by_motion.transpose(0, 2, 1) @ B @ self.jumps_by_motion
        local_resistance = relative_resistance(
            resistance_of_points, self._local.bodies, self._body_count
        )
        resistance = self._comm.allreduce(local_resistance)
        area = float(self._points.weight.sum())
        if self._support_resistance is None:
            self._support_resistance = support_resistance(
                self._body_forms, self._stiffness, *self.frame
            )
        for body, body_resistance in self._support_resistance.items():
            rows = slice(6 * body, 6 * body + 6)
            resistance[rows, rows] += area * body_resistance
        sizes, motions = np.linalg.eigh(resistance)
        return np.asarray(motions[:, sizes <= threshold * max(sizes[-1], area)])

    @property
    def frame(self) -> tuple[Floats, float]:
        """Origin of rigid motions (3,) [mm], and the length by which rotations are divided [mm]."""
        x = self._points.x
        return np.asarray(x.mean(axis=0)), float(np.linalg.norm(np.ptp(x, axis=0))) or 1.0

    def rigid(self, x: Floats) -> Floats:
        """Rigid motions of a body at points x (n, 3) [mm] -> (n, 3, 6)."""
        origin, size = self.frame
        return rigid_modes((x - origin) / size)

    def relative(self, motions: Floats) -> Floats:
        """Jumps of local points by rigid motions of all bodies (6 bodies, k) -> (n, 3, k)."""
        of_bodies = motions.reshape(self._body_count, 6, -1)
        master, slave = self._local.bodies.T
        return self.jumps_by_motion @ (of_bodies[slave] - of_bodies[master])

    @cached_property
    def jumps_by_motion(self) -> Floats:
        """Jumps of local points by motions of the slave against the master (n, 3, 6)."""
        surface = self._points.surface
        return surface.mean_jumps(self.rigid(surface.x))[self._local.rows]
