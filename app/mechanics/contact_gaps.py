r"""Gaps of the contact points, over time and as points slide to other places.

The gap vector of a point is G = q + g, with its jump q and the vector g of its initial gap. The
keys of an interface and their history give the initial gap at a time. In small sliding nothing else
changes it. In finite sliding it is that of the point on the other side with which the contact point
was paired last, at the jump q_0 and the distance d along the normal n,

.. math:: n · g = g_{keys} + d - n · q_0.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

from app.foundation.arrays import Floats
from app.interfaces.corners import ContactPoints
from app.laws.values import gap_at, gap_settled
from app.mechanics.contact_state import LocalPoints
from app.mechanics.finite_sliding import FiniteSliding
from app.mechanics.point_laws import PointLaws
from app.scene.scene import Scene

# Largest rounding error of the time at the end of a stage, which is a whole number [-].
TIME_ROUNDING = 1e-9
# Points are paired again if errors of gaps may change a pressure by more than this fraction of the
# largest pressure [-].
PAIRING_ACCURACY = 1e-3


class ContactGaps:
    """Gaps of the contact points of this rank (n of them).

    Attributes:
        initial_gap: Vectors g of the initial gap at the current time and pairs (n, 3) [mm].
        committed_jump: Jumps of the committed state, expressed in the current pairs (n, 3) [mm].
        end_of_insertion: End of the last stage in which the gap of press fits changes. It is the
            same whole number on the load histories and in times of the run.

    Args:
        comm: All ranks.
        points: All contact points.
        local: The points of this rank. Pairing changes their normals.
        laws: Laws at the points of this rank. Pairing sets their normals.
        finite_sliding: Points with finite sliding, if any.
    """

    initial_gap: Floats

    def __init__(
        self,
        comm: MPI.Comm,
        points: ContactPoints,
        local: LocalPoints,
        laws: PointLaws,
        finite_sliding: FiniteSliding | None,
    ) -> None:
        self._comm, self._points, self._local = comm, points, local
        self._laws, self._finite_sliding = laws, finite_sliding

    def begin(self, scene: Scene, gap: Floats) -> None:
        """Begin a run at rest; `set_time` has to follow.

        Args:
            scene: The scene, with the histories of gaps and the motions of bodies.
            gap: Initial gap of all points by the keys, at full amplitude (all points,) [mm].
        """
        self._interfaces = scene.parting_interfaces
        self._full_gap = gap[self._local.rows]
        settling_times = (
            gap_settled(gap[self._points.interface == i], c.gap_history)
            for i, c in enumerate(self._interfaces)
            if c.press_fit
        )
        self.end_of_insertion = max(settling_times, default=0.0) + TIME_ROUNDING
        if self._finite_sliding is not None:
            self._finite_sliding.begin(scene)
        self._committed_time = 0.0
        self.committed_jump: Floats = np.zeros((len(self._local), 3))

    def set_time(self, load_time: float, jump: Floats) -> None:
        """Set the initial gaps to a time of the loads; collective.

        Args:
            load_time: In stage k it is between k and k + 1.
            jump: Jumps of the committed state (n, 3) [mm], at which points are paired.
        """
        gap = np.zeros(len(self._local))
        for i, c in enumerate(self._interfaces):
            at_interface = self._local.interface == i
            gap[at_interface] = gap_at(self._full_gap[at_interface], c.gap_history, load_time)
        self._gap_by_keys = gap
        if self._finite_sliding is None:
            self.initial_gap = initial_gap_vectors(self._local.normals, gap)
        else:
            self._finite_sliding.set_time(load_time)
            self.set_pairs(jump)

    def set_pairs(self, jump: Floats) -> None:
        """Pair the points with finite sliding at jumps (n, 3) [mm]; collective."""
        assert self._finite_sliding is not None
        rows, normals = self._finite_sliding.rows, self._local.normals
        paired = self._finite_sliding.find_pairs(jump)
        normals[rows, 0] = paired.normal
        self._laws.set_normals(rows)
        gap = self._gap_by_keys.copy()
        gap[rows] += paired.gap - np.einsum("pi,pi->p", paired.normal, jump[rows])
        self.initial_gap = initial_gap_vectors(normals, gap)

    def update_pairs(self, jump: Floats, pressures: Floats) -> bool:
        """Pair points if errors of gaps change pressures by more than `PAIRING_ACCURACY`.

        Args:
            jump: Jumps (n, 3) [mm].
            pressures: Pressures of the faces (n, 3) [MPa].

        Returns:
            True if points were paired; collective.
        """
        assert self._finite_sliding is not None
        rows = self._finite_sliding.rows
        pressure = pressures[rows, 0]
        error = self._laws.softest_stiffness[rows] * self._finite_sliding.gap_error(jump)
        largest = pressure.max(initial=0.0), error[pressure > 0].max(initial=0.0)
        largest_pressure, largest_error = (
            self._comm.allreduce(float(value), MPI.MAX) for value in largest
        )
        if largest_error <= PAIRING_ACCURACY * largest_pressure:
            return False
        self.set_pairs(jump)
        return True

    def commit(self, jump: Floats, time: float) -> None:
        """Commit jumps (n, 3) [mm] at a time of the run, with the current pairs."""
        self.committed_jump, self._committed_time = jump, time
        if self._finite_sliding is not None:
            self._finite_sliding.commit()

    @property
    def is_inserting(self) -> bool:
        """True if the last committed step ended before all press fits have their final gap."""
        return 0.0 < self._committed_time <= self.end_of_insertion

    @property
    def reference(self) -> Floats:
        """Jumps with zero slip relative to the last committed step (n, 3) [mm]."""
        if self._finite_sliding is None:
            return self.committed_jump
        return self._finite_sliding.reference(self.committed_jump)

    @property
    def gap_at_pairing(self) -> Floats:
        """Gap along the normal when points were paired last (n,) [mm].

        Without finite sliding: the gap that the keys give.
        """
        gap = self._gap_by_keys.copy()
        if self._finite_sliding is not None:
            gap[self._finite_sliding.rows] += self._finite_sliding.paired.gap
        return gap

    def gap_vector(self, jump: Floats) -> Floats:
        """Gap vectors G of jumps (n, 3) [mm]; in finite sliding along the normal alone."""
        gaps = jump + self.initial_gap
        if self._finite_sliding is not None:
            rows = self._finite_sliding.rows
            n = self._local.normals[rows, 0]
            gaps[rows] = np.einsum("pi,pi->p", gaps[rows], n)[:, None] * n
        return gaps

    def openings(self, jump: Floats) -> Floats:
        """Normal components of the gap vector of jumps (n, 3) on the faces (n, 3) [mm]."""
        return self._local.along_normals(jump + self.initial_gap)


def initial_gap_vectors(normals: Floats, gap: Floats) -> Floats:
    """Vectors g (n, 3) with g . n_k the given initial gap on every face of each point [mm].

    Args:
        normals: Unit normals of the faces, zero beyond their number (n, 3, 3).
        gap: Initial gap (n,) [mm].
    """
    return np.linalg.pinv(normals).sum(axis=2) * gap[:, None]
