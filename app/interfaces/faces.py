"""Faces around contact points: sets of facets that meet smoothly, with one normal and one area."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints
from app.interfaces.interface_facets import InterfaceFacets
from app.interfaces.smooth_normals import slid_along, smooth_normals, unit_sums
from meshes.data import connected

# Facets that meet at less than this angle are one face.
FACE_ANGLE = np.deg2rad(30.0)
# Straight facets that meet at up to this angle are one face if their nodes lie on one quadric, as
# in a coarse mesh of a cylinder or cone with nine facets around.
COARSE_ANGLE = np.deg2rad(44.0)
# Nodes lie on the fitted surface if the doubt about its normal is below this [rad].
EXACT = 1e-4
# Most faces of a point.
MAX_FACES = 3
# Faces are independent while the Gram determinant of their normals stays above this.
INDEPENDENT = 0.05


def faces_around(
    facets: InterfaceFacets, point: Ints, n: int
) -> tuple[Floats, Ints, Floats, Floats]:
    """Group the facets around each of n points into faces.

    ``point`` is the contact point of each facet corner, -1 where not enforced (3 f,).

    Returns:
        Normals (n, 3, 3) and number of faces (n,), total area (n,) [mm2], and the largest doubt
        about a normal (n,) [rad].
    """
    label = _smooth_groups(facets)
    of_corner, doubt_of_corner = _normals_of_surface(facets, label)
    is_used = point >= 0
    pairs = np.stack([point[is_used], label[is_used]], axis=1)
    groups, first, group = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
    corner_area, corner_normal = facets.area.ravel()[is_used], of_corner[is_used]
    area, normal = np.zeros(len(groups)), np.zeros((len(groups), 3))
    np.add.at(area, group, corner_area)
    np.add.at(normal, group, corner_area[:, None] * corner_normal)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # A body slides on all of an interface at once.
    corner = np.flatnonzero(is_used)[first]
    sides = np.column_stack([facets.interface, facets.bodies])[corner // 3]
    x, doubt_of_group = facets.x.reshape(-1, 3)[corner], doubt_of_corner[corner]
    for side in np.unique(sides[facets.straight[corner // 3]], axis=0):
        of_side = (sides == side).all(axis=1)
        normal[of_side] = slid_along(
            x[of_side], normal[of_side], doubt_of_group[of_side], area[of_side]
        )
    normals, faces, weight = np.zeros((n, 3, 3)), np.ones(n, dtype=np.int64), np.zeros(n)
    owner = groups[:, 0]
    normals[owner, 0] = normal
    np.add.at(weight, owner, area)
    for rows in shared(owner):
        ns = _distinct(normal[rows], area[rows])
        p, faces[p] = owner[rows[0]], len(ns)
        normals[p, : len(ns)] = ns
    doubt = np.zeros(n)
    np.maximum.at(doubt, point[is_used], doubt_of_corner[is_used])
    return normals, faces, weight, doubt


def _normals_of_surface(facets: InterfaceFacets, label: Ints) -> tuple[Floats, Floats]:
    """Normals at facet corners (3 f, 3), and their uncertainty (3 f,) [rad].

    Straight facets have the normals of the smooth surface that they approximate. Curved ones have
    the mean of their normals; its doubt is the angle between the means by area and by number.
    """
    _, first, node = np.unique(label, return_index=True, return_inverse=True)
    corners, x = node.reshape(-1, 3), facets.x.reshape(-1, 3)[first]
    normal = unit_sums(facets.normal, facets.area, corners, len(x))
    by_number = unit_sums(facets.normal, np.ones_like(facets.area), corners, len(x))
    doubt = np.linalg.norm(normal - by_number, axis=1)
    if facets.straight.any():
        rows = np.flatnonzero(facets.straight)
        smooth_nodes, local_corners = np.unique(corners[rows], return_inverse=True)
        parts = (
            x[smooth_nodes],
            local_corners.reshape(-1, 3),
            facets.normal[rows],
            facets.area[rows],
        )
        smooth = smooth_normals(*parts)
        normal[smooth_nodes], doubt[smooth_nodes] = smooth.normal, smooth.doubt
    return normal[node.ravel()], doubt[node.ravel()]


def _smooth_groups(facets: InterfaceFacets) -> Ints:
    """Label facet corners (3 f,): equal where facets around a vertex join by smooth edges."""
    facet_count = len(facets.area)
    local = np.array([[1, 2], [0, 2], [0, 1]])
    edges = facets.vertices[:, local].reshape(-1, 2)
    side = np.repeat(np.column_stack([facets.interface, facets.bodies]), 3, axis=0)
    edge = np.unique(np.column_stack([side, edges]), axis=0, return_inverse=True)[1]
    count = np.bincount(edge)
    order = np.argsort(edge, kind="stable")
    start = (np.cumsum(count) - count)[count == 2]
    a, b = order[start], order[start + 1]
    # Normals in the middle of the edge, from those at its ends.
    ends = facets.normal[np.arange(facet_count)[:, None, None], local].sum(axis=2).reshape(-1, 3)
    ends /= np.linalg.norm(ends, axis=1, keepdims=True)
    cosine = np.einsum("ei,ei->e", ends[a], ends[b])
    # Corner numbers of the two ends of the edge in either facet (vertices are sorted: ends agree).
    corners_of_one, corners_of_other = (
        3 * (a // 3)[:, None] + local[a % 3],
        3 * (b // 3)[:, None] + local[b % 3],
    )

    def joined_by(smooth: Bools) -> Ints:
        return connected(
            3 * facet_count, corners_of_one[smooth].ravel(), corners_of_other[smooth].ravel()
        )

    smooth = cosine > np.cos(FACE_ANGLE)
    coarse = ~smooth & (cosine > np.cos(COARSE_ANGLE)) & facets.straight[a // 3]
    if coarse.any():
        _, doubt = _normals_of_surface(facets, joined_by(smooth | coarse))
        smooth |= coarse & (doubt[corners_of_one] < EXACT).all(axis=1)
    return joined_by(smooth)


def _distinct(normals: Floats, areas: Floats) -> Floats:
    """Return the normals of at most three independent faces, the others merged into the nearest.

    They are in the order of their areas. Faces of equal area are in the order of the mesh.
    """
    order: Ints = np.argsort(-np.round(areas, 9), kind="stable").astype(np.int64)
    distinct: list[Floats] = []
    sums: list[Floats] = []
    for row in map(int, order):
        normal, area = np.asarray(normals[row]), float(areas[row])
        candidate = np.array([*distinct, normal])
        if len(distinct) < MAX_FACES and np.linalg.det(candidate @ candidate.T) > INDEPENDENT:
            distinct.append(normal)
            sums.append(area * normal)
            continue
        k = int(np.argmax(np.array(distinct) @ normal))
        if distinct[k] @ normal > 0:
            sums[k] = sums[k] + area * normal
            distinct[k] = sums[k] / np.linalg.norm(sums[k])
    return np.array(distinct)


def drop_held(normals: Floats, faces: Ints, held: Floats) -> None:
    """Project constrained directions out of the normals, in place; empty faces are dropped.

    ``held`` are projectors on the constrained directions of each point (n, 3, 3).
    """
    for p in np.flatnonzero(held.any(axis=(1, 2))):
        ns = normals[p, : faces[p]] @ (np.eye(3) - held[p])
        size = np.linalg.norm(ns, axis=1)
        remaining = size > INDEPENDENT
        normals[p], faces[p] = 0, 0
        if remaining.any():
            distinct = _distinct(ns[remaining] / size[remaining, None], np.ones(remaining.sum()))
            normals[p, : len(distinct)], faces[p] = distinct, len(distinct)


def dual_vectors(normals: Floats) -> Floats:
    """Dual vectors of the normals of faces (n, k, 3), zero where a normal is zero.

    Their products with a vector are its components along the normals.
    """
    return np.asarray(np.linalg.pinv(normals).swapaxes(1, 2), dtype=np.float64)


def projectors(axes: Floats, weights: Bools | Floats) -> Floats:
    """Sums (n, 3, 3) of projectors on axes, which are columns (n, 3, 3), by weights (n, 3)."""
    return np.asarray(np.einsum("nic,nc,njc->nij", axes, weights, axes))


def shared(vertex: Ints) -> list[Ints]:
    """Rows of each vertex that occurs in more than one row."""
    order = np.argsort(vertex, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(vertex[order])) + 1)
    return [rows for rows in parts if len(rows) > 1]


def spread_of_normals(x: Floats, normals: Floats, triangles: Sequence[Ints]) -> Floats:
    """Covariance of facet normals about the normals of their points (n, 3, 3) [-].

    A facet counts for the face of its point with the closest normal, of unit normals (n, k, 3).
    ``triangles`` are the facets' points (f, 3), by interface.
    """
    total, area = np.zeros((len(x), 3, 3)), np.zeros(len(x))
    for corners in triangles:
        a, b, c = x[corners].transpose(1, 0, 2)
        n = np.cross(b - a, c - a)
        size = np.linalg.norm(n, axis=1)
        n = n / size[:, None]
        for corner in corners.T:
            cosines = np.einsum("fki,fi->fk", normals[corner], n)
            rows, best = np.arange(len(n)), np.abs(cosines).argmax(axis=1)
            deviation = n * np.sign(cosines[rows, best])[:, None] - normals[corner, best]
            np.add.at(
                total, corner, size[:, None, None] * deviation[:, :, None] * deviation[:, None, :]
            )
            np.add.at(area, corner, size)
    return total / np.where(area > 0, area, 1.0)[:, None, None]
