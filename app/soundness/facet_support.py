"""Bodies that only the facets of a mesh hold, where the surface that they stand for does not.

A smooth stem turns in its cement without resistance. Its mesh is a prism, whose nodes have normals
that are off by a fraction of the angle between facets: contact resists the turn, with a stiffness
that means nothing and rotations that look like an answer.
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

from app.arrays import Floats
from app.mechanics.problem import Problem, TrialState
from app.numerics.rigid_motions import DIRECTIONS, add_relative, rigid_modes
from app.soundness.failure import held_bodies
from forms.contact import OPEN
from meshes.contact_points import ContactPoints

# A motion that contact resists by less than this part of what the spread of normals would give at
# random (0.01 for a smooth stem that turns, 0.8 to 100 where its taper resists).
SPREAD = 0.25
# The part of the jumps, squared, that has to be of such motions: 0.003 for a smooth stem pushed
# in, 0.15 and more for one that is turned.
PART = 0.05


def spread_of_normals(points: ContactPoints) -> Floats:
    """Covariance of the normals of the facets about each point's own (n, 3, 3) [-].

    Facets count for the face of their point that they are closest to.
    """
    total, area = np.zeros((len(points.x), 3, 3)), np.zeros(len(points.x))
    for triangles in points.triangles:
        x = points.x[triangles]
        n = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
        size = np.linalg.norm(n, axis=1)
        n = n / size[:, None]
        for corner in triangles.T:
            along = np.einsum("fki,fi->fk", points.normals[corner], n)
            rows, best = np.arange(len(n)), np.abs(along).argmax(axis=1)
            off = n * np.sign(along[rows, best])[:, None] - points.normals[corner, best]
            np.add.at(total, corner, size[:, None, None] * off[:, :, None] * off[:, None, :])
            np.add.at(area, corner, size)
    return total / np.where(area > 0, area, 1.0)[:, None, None]


def held_by_facets(problem: Problem, trial: TrialState) -> str:
    """A sentence if smooth contact has let a body go where only its mesh resists; collective.

    The stiffness of contact in relative rigid motions of the bodies is set beside what the spread
    of the normals of facets gives in the same motions: where the quotient is small, only the mesh
    resists. What all normals of an interface agree on is no spread: a taper, however slight.
    """
    if all(c.law.frictional or not c.law.can_open for c in problem.scene.contacts):
        return ""
    contact = trial.contact
    n, points = len(problem.bodies.names), contact.points
    size = np.linalg.norm(np.ptp(points.x, axis=0)) or 1.0
    R = rigid_modes((points.x[contact.mine] - points.x.mean(axis=0)) / size)
    A, N = _resistances(problem, trial, R)
    free = np.setdiff1d(np.arange(n), sorted(held_bodies(problem)))
    rows = (6 * free[:, None] + np.arange(6)).ravel()
    A, N = A[np.ix_(rows, rows)], N[np.ix_(rows, rows)]
    if not A.any():
        return ""
    # Where facets all agree there is nothing but rounding to compare with.
    N += np.finfo(float).eps * np.trace(A) * np.eye(len(rows))
    scale = np.linalg.inv(np.linalg.cholesky(N))
    values, vectors = np.linalg.eigh(scale @ A @ scale.T)
    few = values < SPREAD
    if not few.any():
        return ""
    # The part of the jumps in the span of such motions, by least squares.
    soft = np.zeros((6 * n, int(few.sum())))
    soft[rows] = scale.T @ vectors[:, few]
    master, slave = points.bodies[contact.mine].T
    parts = soft.reshape(n, 6, -1)
    moved = np.einsum("pij,pjk->pik", R, parts[slave] - parts[master])
    w, q = contact.weight, trial.jump
    turned, gram, everything = (
        problem.comm.allreduce(np.asarray(own), MPI.SUM)
        for own in (
            np.einsum("p,pi,pik->k", w, q, moved),
            np.einsum("p,pik,pil->kl", w, moved, moved),
            np.einsum("p,pi,pi->", w, q, q),
        )
    )
    amounts = np.linalg.lstsq(gram, turned, rcond=1e-12)[0]
    if amounts @ turned <= PART * everything:
        return ""
    body, mode = divmod(int(np.argmax(np.abs(soft @ amounts))), 6)
    far = float(np.linalg.norm(moved @ amounts, axis=1).max(initial=0.0))
    most = problem.comm.allreduce(far, MPI.MAX)
    who, way = problem.bodies.names[body], DIRECTIONS[mode]
    return (
        f"only the facets of the mesh hold body '{who}': on a smooth surface it is free to {way}; "
        f"it moved by {most:.3g} mm, a distance that depends on the mesh"
    )


def _resistances(problem: Problem, trial: TrialState, R: Floats) -> tuple[Floats, Floats]:
    """Resistance of contact to the motions of all bodies, and that due to the spread of normals.

    Args:
        problem: The problem.
        trial: A state.
        R: Rigid motions of unit size at own points (p, 3, 6).

    Returns:
        Two matrices (6 n, 6 n) for n bodies, in six motions each.
    """
    contact = trial.contact
    points, n = contact.points, len(problem.bodies.names)
    laws = [c.law for c in problem.scene.contacts]
    smooth = np.array([law.can_open and not law.frictional for law in laws])[contact.interface]
    r = np.where(trial.law.status == OPEN, 0.0, contact.stiffness * contact.weight)[:, None, None]
    B = trial.law.jacobian
    # Friction holds what it touches, though no stiffness tells so while it slips.
    S = np.where(smooth[:, None, None], (B + B.transpose(0, 2, 1)) / 2, np.eye(3))
    touching = np.einsum("pk,pki->pi", (trial.law.pressures > 0).astype(float), contact.normals)
    mean = r[:, :, 0] * np.einsum("pij,pi->pj", R, touching)
    law, noise = (
        r * (R.transpose(0, 2, 1) @ own @ R) for own in (S, spread_of_normals(points)[contact.mine])
    )
    A, N = np.zeros((2, 6 * n, 6 * n))
    sides = np.column_stack([points.interface, points.bodies])
    for group in np.unique(sides, axis=0):
        here = (sides[contact.mine] == group).all(axis=1)
        local = (law, noise, mean, r, np.ones(len(here)))
        stiff, rough, g, weight, count = (
            problem.comm.allreduce(np.asarray(x[here].sum(axis=0)), MPI.SUM) for x in local
        )
        # Normals that are off at random agree in the mean, the more of them the better.
        stiff += count * np.outer(g, g) / (weight.item() or 1.0)
        m, s = group[1:]
        add_relative(A, m, s, stiff)
        add_relative(N, m, s, rough)
    return A, N
