"""Critical friction coefficients of contact points, and warnings on friction beyond them.

A single contact point may have several equilibria. Let A be the tangential block of its stiffness,
and w its coupling row, the change of the normal force by slip. The critical friction coefficient is
the smallest value of t·At / |w·t| over unit vectors t of the tangent plane (derived in
`docs/theory.md`). In two dimensions it is Klarbring's k_T / |w|.

Take t = (cos θ, sin θ) in axes along and across w, and τ = tan θ. With [[a, b], [b, c]], the
symmetric part of A, the function is (a + 2 b τ + c τ²) / (|w| sqrt(1 + τ²)). It is stationary where
c τ³ + (2 c - a) τ + 2 b = 0.

A. Klarbring, Examples of non-uniqueness and non-existence of solutions to quasistatic contact
problems with friction, Ingenieur-Archiv 60 (1990) 529-541. P. Hild, Non-unique slipping in the
Coulomb friction model in two-dimensional linear elasticity, Q. J. Mech. Appl. Math. 57 (2004).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from app.foundation.arrays import Floats
from app.foundation.layout import point_text, several
from app.foundation.verdict import Reason, Severity, Verdict
from app.mechanics.contact import ContactInterfaces
from app.mechanics.problem import Problem


def critical_friction(stiffness: Floats, normals: Floats) -> Floats:
    """Smallest friction coefficient at which a point may have several equilibria or none.

    Args:
        stiffness: Stiffness against a jump of each point, positive definite (n, 3, 3).
        normals: Unit normals (n, 3).

    Returns:
        Critical coefficients (n,); infinite where slip does not change the normal force.
    """
    n = normals
    row = np.einsum("pi,pij->pj", n, stiffness)
    w = row - np.einsum("pi,pi->p", row, n)[:, None] * n
    size = np.linalg.norm(w, axis=1)
    coupled = size > np.finfo(float).eps * np.linalg.norm(row, axis=1)
    critical = np.full(len(n), np.inf)
    K, n, w, size = stiffness[coupled], n[coupled], w[coupled], size[coupled]
    coupled_direction = w / size[:, None]
    transverse = np.cross(n, coupled_direction)
    a = np.einsum("pi,pij,pj->p", coupled_direction, K, coupled_direction)
    b = np.einsum("pi,pij,pj->p", coupled_direction, (K + K.transpose(0, 2, 1)) / 2, transverse)
    c = np.einsum("pi,pij,pj->p", transverse, K, transverse)
    companion = np.zeros((len(n), 3, 3))
    companion[:, 1, 0] = companion[:, 2, 1] = 1
    companion[:, 0, 2] = -2 * b / c
    companion[:, 1, 2] = -(2 * c - a) / c
    # The real part of a complex root is not stationary. Its value is not below the minimum, so it
    # does no harm.
    τ = np.linalg.eigvals(companion).real
    value = (a[:, None] + 2 * b[:, None] * τ + c[:, None] * τ**2) / np.sqrt(1 + τ**2)
    critical[coupled] = value.min(axis=1) / size
    return critical


def critical_friction_of_points(contact: ContactInterfaces) -> Floats:
    """Smallest critical coefficient over the faces of each local point (n,).

    All other points are fixed. The estimate is on the safe side, because the bodies around a point
    are fixed, too. The exact stiffness, with deforming bodies, needs one solve per point. With it
    the smallest coefficient is 20 to 85 % larger on coarsened shipped cases. Friction below the
    critical coefficient is necessary for uniqueness, not sufficient.
    """
    stiffness = contact.coupling.jump_stiffness()
    # A point cannot move in directions that supports hold: they are stiff and uncoupled.
    free_projector = contact.local.free_projector
    stiffness = free_projector @ stiffness @ free_projector
    stiffness += np.trace(stiffness, axis1=1, axis2=2)[:, None, None] * contact.local.projector
    critical = np.full(len(contact.local), np.inf)
    for k in range(contact.local.normals.shape[1]):
        has_face = contact.local.faces > k
        critical[has_face] = np.minimum(
            critical[has_face],
            critical_friction(stiffness[has_face], contact.local.normals[has_face, k]),
        )
    return critical


@dataclass(frozen=True)
class CriticalFriction:
    """Critical friction of one interface.

    Attributes:
        interface: Its name.
        friction: Largest friction coefficient of the points beyond their critical one; of all
            points if there are none.
        smallest: Smallest critical coefficient of its points with friction.
        x: Point with the smallest critical coefficient [mm].
        points_beyond: Number of points whose critical coefficient is below their friction.
    """

    interface: str
    friction: float
    smallest: float
    x: Sequence[float]
    points_beyond: int

    def warnings(self) -> list[Verdict]:
        """Return a warning if the friction exceeds the critical coefficient of some points."""
        if not self.points_beyond:
            return []
        message = (
            f"friction coefficient {self.friction:g} exceeds the critical value at "
            f"{several(self.points_beyond, 'point')}, where solutions may not be unique; the "
            f"smallest critical value is {self.smallest:.3g}, at {point_text(self.x)}"
        )
        location = f"interface '{self.interface}'"
        return [Verdict(message, location, severity=Severity.WARNING, code=Reason.NOT_UNIQUE)]


def critical_friction_of_interfaces(problem: Problem) -> list[CriticalFriction]:
    """Critical friction of each interface with friction whose slip changes normal forces.

    Collective. The list is empty without contact, and without friction.
    """
    contact = problem.contact
    if contact is None or not any(c.law.largest_friction for c in problem.scene.parting_interfaces):
        return []
    of_interfaces = []
    critical, friction = critical_friction_of_points(contact), contact.laws.friction_coefficient
    for i, c in enumerate(problem.scene.parting_interfaces):
        at_interface = np.flatnonzero((contact.local.interface == i) & (friction > 0))
        local_smallest: tuple[float, tuple[float, ...]] = (np.inf, ())
        if len(at_interface):
            k = at_interface[np.argmin(critical[at_interface])]
            local_smallest = float(critical[k]), tuple(contact.local.x[k])
        smallest, x = min(problem.comm.allgather(local_smallest))
        beyond = at_interface[critical[at_interface] < friction[at_interface]]
        points_beyond = problem.comm.allreduce(len(beyond), MPI.SUM)
        counted = beyond if points_beyond else at_interface
        largest = float(friction[counted].max(initial=0.0))
        largest = problem.comm.allreduce(largest, MPI.MAX)
        if np.isfinite(smallest):
            of_interfaces.append(CriticalFriction(c.name, largest, smallest, x, points_beyond))
    return of_interfaces
