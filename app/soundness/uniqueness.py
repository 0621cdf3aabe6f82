"""Friction coefficients beyond which a contact point alone may have several equilibria.

With A the tangential block of the stiffness of a point and w its coupling row (the normal force
that a slip takes), the least of t·At / |w·t| over unit vectors t of the tangent plane, in the plane
Klarbring's k_T / |w| (derived in `docs/theory.md`). With t = (cos θ, sin θ) in axes along and
across w, [[a, b], [b, c]] the symmetric part of A and τ = tan θ, this is the least value of
(a + 2 b τ + c τ²) / (|w| sqrt(1 + τ²)), stationary where c τ³ + (2 c - a) τ + 2 b = 0.

A. Klarbring, Examples of non-uniqueness and non-existence of solutions to quasistatic contact
problems with friction, Ingenieur-Archiv 60 (1990) 529-541. P. Hild, Non-unique slipping in the
Coulomb friction model in two-dimensional linear elasticity, Q. J. Mech. Appl. Math. 57 (2004).
"""

from __future__ import annotations

import logging

from mpi4py import MPI

import numpy as np

from app.arrays import Floats
from app.errors import Reason
from app.mechanics.contact import ContactInterfaces
from app.mechanics.problem import Problem
from app.system.layout import point_text

log = logging.getLogger("mantle")


def critical_friction(stiffness: Floats, normals: Floats) -> Floats:
    """Friction coefficient at which each point stops having one equilibrium for every load.

    Args:
        stiffness: Stiffness that a jump meets at each point, positive definite (n, 3, 3).
        normals: Unit normals (n, 3).

    Returns:
        Critical coefficients (n,); infinite where slip takes no normal force.
    """
    n = normals
    row = np.einsum("pi,pij->pj", n, stiffness)
    w = row - np.einsum("pi,pi->p", row, n)[:, None] * n
    size = np.linalg.norm(w, axis=1)
    bound = np.linalg.norm(row, axis=1)
    coupled = size > np.finfo(float).eps * bound
    critical = np.full(len(n), np.inf)
    K, n, w, size = stiffness[coupled], n[coupled], w[coupled], size[coupled]
    along = w / size[:, None]
    across = np.cross(n, along)
    a = np.einsum("pi,pij,pj->p", along, K, along)
    b = np.einsum("pi,pij,pj->p", along, (K + K.transpose(0, 2, 1)) / 2, across)
    c = np.einsum("pi,pij,pj->p", across, K, across)
    companion = np.zeros((len(n), 3, 3))
    companion[:, 1, 0] = companion[:, 2, 1] = 1
    companion[:, 0, 2] = -2 * b / c
    companion[:, 1, 2] = -(2 * c - a) / c
    # The real part of a complex root is just one more direction, of no smaller value.
    τ = np.linalg.eigvals(companion).real
    value = (a[:, None] + 2 * b[:, None] * τ + c[:, None] * τ**2) / np.sqrt(1 + τ**2)
    critical[coupled] = value.min(axis=1) / size
    return critical


def critical_friction_of_points(contact: ContactInterfaces) -> Floats:
    """Least critical coefficient of the faces of each own point, all else held (n,).

    An estimate, local and on the safe side. With the stiffness that a point meets while the bodies
    give way around it and its neighbours stick, friction below the critical would be necessary for
    uniqueness (not sufficient), but each point takes a solve: on the shipped cases, coarsened, the
    least such value is 20 to 85 % above the least found here.
    """
    stiffness = contact.coupling.local_stiffness()
    # A point does not move where supports hold it: nothing couples there, and it is stiff.
    free = np.eye(3) - contact.own.projector
    stiffness = free @ stiffness @ free
    stiffness += np.trace(stiffness, axis1=1, axis2=2)[:, None, None] * contact.own.projector
    critical = np.full(len(contact.own), np.inf)
    for k in range(contact.own.normals.shape[1]):
        on = contact.own.faces > k
        critical[on] = np.minimum(
            critical[on], critical_friction(stiffness[on], contact.own.normals[on, k])
        )
    return critical


def check(problem: Problem) -> dict[str, float]:
    """`look`, with the sentences as warnings."""
    found, sentences = look(problem)
    for sentence in sentences:
        log.warning("%s", sentence)
    return found


def look(problem: Problem) -> tuple[dict[str, float], list[str]]:
    """Least critical coefficient of each frictional interface, and what exceeds it; collective."""
    found: dict[str, float] = {}
    sentences: list[str] = []
    contact = problem.contact
    if contact is None:
        return found, sentences
    critical = critical_friction_of_points(contact)
    for i, term in enumerate(problem.scene.contacts):
        on = np.flatnonzero(contact.own.interface == i)
        k = on[np.argmin(critical[on])] if len(on) else 0
        here = (float(critical[k]), tuple(contact.own.x[k])) if len(on) else (np.inf, ())
        least, x = min(problem.comm.allgather(here))
        over = int((critical[on] < term.law.friction).sum())
        over = problem.comm.allreduce(over, MPI.SUM)
        if term.law.friction == 0 or not np.isfinite(least):
            continue
        found[term.name] = least
        if over:
            sentences.append(
                f"interface '{term.name}': friction coefficient {term.law.friction:g} "
                f"exceeds the critical one of {over} of its points (least {least:.3g}, at "
                f"{point_text(x)}): solutions may not be unique there [{Reason.NOT_UNIQUE}]"
            )
    return found, sentences
