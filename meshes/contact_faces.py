"""Faces around contact points: facets that meet smoothly, with one normal and one area each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from app.arrays import Bools, Floats, Ints
from meshes.contact_facets import InterfaceFacets
from meshes.data import connected

FACE_ANGLE = np.deg2rad(30.0)
MAX_FACES = 3
# Faces are independent while the Gram determinant of their normals stays above this.
INDEPENDENT = 0.05


def faces_around(facets: InterfaceFacets, point: Ints, n: int) -> tuple[Floats, Floats, Ints]:
    """Group the facets around each of n points into faces.

    ``point`` is the contact point of each facet corner, -1 where not enforced (3 f,).

    Returns:
        Normals (n, 3, 3), areas (n, 3) [mm2] and number of faces (n,).
    """
    label = _smooth_groups(facets)
    used = point >= 0
    groups, _, group = distinct_rows(np.stack([point[used], label[used]], axis=1))
    corner_area, corner_normal = facets.area.ravel()[used], facets.normal.reshape(-1, 3)[used]
    area = np.asarray(np.bincount(group, corner_area, len(groups)), dtype=np.float64)
    sums = np.stack(
        [np.bincount(group, corner_area * corner_normal[:, i], len(groups)) for i in range(3)],
        axis=1,
    )
    normal = sums / np.linalg.norm(sums, axis=1, keepdims=True)
    normals, areas = np.zeros((n, 3, 3)), np.zeros((n, 3))
    owner = groups[:, 0]
    single = np.bincount(owner, minlength=n)[owner] == 1
    normals[owner[single], 0], areas[owner[single], 0] = normal[single], area[single]
    faces = np.ones(n, dtype=np.int64)
    for rows in shared(owner):
        p = owner[rows[0]]
        ns, areas_p = _distinct(normal[rows], area[rows])
        faces[p] = len(ns)
        normals[p, : len(ns)], areas[p, : len(ns)] = ns, areas_p
    return normals, areas, faces


def _smooth_groups(facets: InterfaceFacets) -> Ints:
    """Label facet corners (3 f,): equal where facets around a vertex join by smooth edges."""
    f = len(facets.area)
    local = np.array([[1, 2], [0, 2], [0, 1]])
    edges = facets.vertices[:, local].reshape(-1, 2)
    side = np.repeat(np.stack([facets.interface, facets.master, facets.slave], axis=1), 3, axis=0)
    _, _, edge = distinct_rows(np.column_stack([side, edges]))
    count = np.bincount(edge)
    order = np.argsort(edge, kind="stable")
    start = np.concatenate([[0], np.cumsum(count)])[:-1][count == 2]
    a, b = order[start], order[start + 1]
    # Normals in the middle of the edge, from those at its ends.
    ends = facets.normal[np.arange(f)[:, None, None], local].sum(axis=2).reshape(-1, 3)
    ends /= np.linalg.norm(ends, axis=1, keepdims=True)
    smooth = np.einsum("ei,ei->e", ends[a], ends[b]) > np.cos(FACE_ANGLE)
    a, b = a[smooth], b[smooth]
    # Corner numbers of the two ends of the edge in either facet (vertices are sorted: ends agree).
    one, two = 3 * (a // 3)[:, None] + local[a % 3], 3 * (b // 3)[:, None] + local[b % 3]
    return connected(3 * f, one.ravel(), two.ravel())


def _distinct(normals: Floats, areas: Floats) -> tuple[Floats, Floats]:
    """At most three independent faces: the largest kept, the others merged into the nearest."""
    order = np.lexsort((normals[:, 2], normals[:, 1], normals[:, 0], -np.round(areas, 9)))
    ns: list[Floats] = []
    sums: list[Floats] = []
    sizes: list[float] = []
    for n, area in zip(normals[order], areas[order], strict=True):
        candidate = np.array([*ns, n])
        if not ns or (len(ns) < MAX_FACES and np.linalg.det(candidate @ candidate.T) > INDEPENDENT):
            ns.append(n)
            sums.append(area * n)
            sizes.append(area)
            continue
        k = int(np.argmax(np.array(ns) @ n))
        sizes[k] += area
        if ns[k] @ n > 0:
            sums[k] = sums[k] + area * n
            ns[k] = sums[k] / np.linalg.norm(sums[k])
    return np.array(ns), np.array(sizes)


def drop_held(normals: Floats, areas: Floats, faces: Ints, held: Floats) -> None:
    """Project constrained directions out of the normals, in place; empty faces are dropped.

    Args:
        normals: Of the faces of each point (n, 3, 3).
        areas: Of the faces (n, 3) [mm2].
        faces: Their number (n,).
        held: Projectors on constrained directions (n, 3, 3).
    """
    for p in np.flatnonzero(held.any(axis=(1, 2))):
        ns = normals[p, : faces[p]] @ (np.eye(3) - held[p])
        size = np.linalg.norm(ns, axis=1)
        left = size > INDEPENDENT
        total = areas[p].sum()
        normals[p], areas[p], faces[p] = 0, 0, 0
        areas[p, 0] = total
        if left.any():
            kept, kept_areas = _distinct(ns[left] / size[left, None], np.ones(left.sum()))
            faces[p] = len(kept)
            normals[p, : len(kept)] = kept
            areas[p, : len(kept)] = total * kept_areas / kept_areas.sum()


def projectors(axes: Floats, which: Bools) -> Floats:
    """Projectors (n, 3, 3) on the axes chosen by a mask (n, 3); axes are columns (n, 3, 3)."""
    return np.asarray(np.einsum("nic,nc,njc->nij", axes, which, axes))


def distinct_rows(rows: Ints) -> tuple[Ints, Ints, Ints]:
    """Distinct rows in rising order, index of the first of each, and inverse.

    As `np.unique` with ``axis=0``, ten times as fast.
    """
    order = np.lexsort(rows.T[::-1])
    ordered = rows[order]
    new = np.ones(len(rows), dtype=bool)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    number = np.empty(len(rows), dtype=np.int64)
    number[order] = np.cumsum(new) - 1
    return ordered[new], order[new], number


def shared(vertex: Ints) -> list[Ints]:
    """Rows of each vertex that occurs in more than one row."""
    order = np.argsort(vertex, kind="stable")
    ends = np.concatenate([[0], np.flatnonzero(np.diff(vertex[order])) + 1, [len(order)]])
    many = np.flatnonzero(np.diff(ends) > 1)
    return [order[a:b] for a, b in zip(ends[many], ends[many + 1], strict=True)]


def spread_of_normals(x: Floats, normals: Floats, triangles: Sequence[Ints]) -> Floats:
    """Covariance of facet normals about the normals of their points (n, 3, 3) [-].

    A facet counts for the face of its point with the closest normal.

    Args:
        x: Points (n, 3).
        normals: Unit normals of their faces (n, k, 3).
        triangles: Points of the facets (f, 3), by interface.
    """
    total, area = np.zeros((len(x), 3, 3)), np.zeros(len(x))
    for corners in triangles:
        a, b, c = x[corners].transpose(1, 0, 2)
        n = np.cross(b - a, c - a)
        size = np.linalg.norm(n, axis=1)
        n = n / size[:, None]
        for corner in corners.T:
            along = np.einsum("fki,fi->fk", normals[corner], n)
            rows, best = np.arange(len(n)), np.abs(along).argmax(axis=1)
            off = n * np.sign(along[rows, best])[:, None] - normals[corner, best]
            np.add.at(total, corner, size[:, None, None] * off[:, :, None] * off[:, None, :])
            np.add.at(area, corner, size)
    return total / np.where(area > 0, area, 1.0)[:, None, None]
