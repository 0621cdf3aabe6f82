"""Corners where interfaces meet and whose jumps follow from the jumps of the points there.

A dependent corner gives its area and its jump to points of its interface next to it. The unknown of
such a point is the mean jump, by area, of the point and its part of the corner.

A point on an edge of its interface has several faces, each with its area and its pressure. A facet
of a dependent corner belongs to one of them. Along the normal of this face the mean is over the
area of the face alone, and along the normals of the other faces the corner has no part. A constant
pressure on each face is then transmitted exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import bsr_array, csc_array, csr_array, eye_array, kron, vstack
from scipy.sparse.linalg import inv

from app.foundation.arrays import Bools, Floats, Ints
from app.foundation.errors import InputError
from app.interfaces.corners import (
    ROUNDING,
    ContactPoints,
    ContactSurface,
    Dependence,
    Entries,
)
from app.interfaces.faces import dual_vectors, projectors
from app.interfaces.interface_facets import InterfaceFacets

# A facet belongs to the face with the nearest normal, if the cosine between both is at least this.
SAME_FACE = 0.5
# Largest entry of the inverse of the matrix of mean jumps. One above 100 was not seen, except of
# singular matrices, whose inverses have 1e14 by rounding.
LARGEST_INVERSE = 1e6


@dataclass(frozen=True)
class HandedAreas:
    """Areas that dependent corners give to points (k of them).

    Attributes:
        corner: Corner that gives the area (k,).
        point: Point that receives it (k,).
        normal: Unit normal at the corner of the facet to which the area belongs (k, 3).
        area: Area (k,) [mm2].
    """

    corner: Ints
    point: Ints
    normal: Floats
    area: Floats


def handed_areas(
    facets: InterfaceFacets,
    surface: ContactSurface,
    held: Floats,
    names: Sequence[str],
    by_face: bool,
) -> HandedAreas:
    """Areas that dependent corners give to points of their interface.

    These points are the other corners of its facets, otherwise the nearest points of the same
    sides that have a face along the facet. A point with a prescribed component that the corner does
    not have is the last choice.

    Args:
        facets: All facets.
        surface: All corners, points first.
        held: Projectors on the prescribed directions of the points (n, 3, 3).
        names: Names of the interfaces.
        by_face: Whether each face of a point has a separate pressure.

    Raises:
        InputError: There is no such point.
    """
    n = len(held)
    corners = np.concatenate(surface.triangles)
    numbers = np.concatenate(surface.facets)
    sides_of_corner = np.column_stack([surface.interface, surface.bodies])
    is_free = ~held.any(axis=(1, 2))
    at_vertex: dict[int, Floats] = {}
    for p in np.flatnonzero(~is_free):
        v = int(surface.vertex[p])
        at_vertex[v] = np.maximum(at_vertex.get(v, 0.0), np.abs(held[p]))
    rows: list[tuple[int, int, int, int]] = []
    areas: list[float] = []
    for f, k in zip(*np.nonzero(corners >= n), strict=True):
        c, number = int(corners[f, k]), int(numbers[f])
        held_at_corner = at_vertex.get(int(surface.vertex[c]), np.zeros((3, 3)))

        def takes(p: Ints, held_at_corner: Floats = held_at_corner) -> Bools:
            return np.asarray((np.abs(held[p]) <= held_at_corner + ROUNDING).all(axis=(1, 2)))

        neighbours = corners[f][corners[f] < n]
        receivers = neighbours[takes(neighbours)]
        if not len(receivers):
            candidates = np.flatnonzero((sides_of_corner[:n] == sides_of_corner[c]).all(axis=1))
            normal = facets.normal[number, k]
            if by_face and normal @ held_at_corner @ normal < SAME_FACE:
                candidates = candidates[_faces_along(surface.normals[candidates], normal) >= 0]
            admissible = candidates[takes(candidates)]
            receivers_of_sides = admissible if len(admissible) else candidates
            if not len(receivers_of_sides):
                x, y, z = surface.x[c]
                raise InputError(
                    f"interfaces.{names[int(surface.interface[c])]}: all nodes of a face lie on "
                    f"lines where interfaces meet, e.g. at ({x:.4g}, {y:.4g}, {z:.4g}) mm, so none "
                    "can carry its force; use a finer mesh"
                )
            distances = np.linalg.norm(surface.x[receivers_of_sides] - surface.x[c], axis=1)
            receivers = receivers_of_sides[np.isclose(distances, distances.min(), rtol=1e-6)]
        rows += [(c, int(p), number, int(k)) for p in receivers]
        areas += [float(facets.area[number, k]) / len(receivers)] * len(receivers)
    corner, point, facet, k = np.array(rows).T
    return HandedAreas(corner, point, facets.normal[facet, k], np.array(areas))


def _faces_along(normals: Floats, normal: Floats) -> Ints:
    """Number of the face of each point (n, 3, 3) that is along a normal (3,) or (n, 3), or -1."""
    cosines = np.abs(np.einsum("pki,pi->pk", normals, np.broadcast_to(normal, normals[:, 0].shape)))
    return np.where(cosines.max(axis=1) >= SAME_FACE, cosines.argmax(axis=1), -1)


def _face_areas(facets: InterfaceFacets, surface: ContactSurface, normals: Floats) -> Floats:
    """Areas (m, 3) of the faces of corners, with these unit normals (m, 3, 3) [mm2]."""
    corners = np.concatenate(surface.triangles).ravel()
    numbers = np.concatenate(surface.facets)
    faces = _faces_along(normals[corners], facets.normal[numbers].reshape(-1, 3))
    area = np.zeros((len(surface.weight), 3))
    belongs_to_face = faces >= 0
    np.add.at(
        area,
        (corners[belongs_to_face], faces[belongs_to_face]),
        facets.area[numbers].ravel()[belongs_to_face],
    )
    return area


def in_means(
    facets: InterfaceFacets,
    points: ContactPoints,
    entries: Entries,
    handed: HandedAreas,
    names: Sequence[str],
    by_face: bool,
) -> tuple[ContactPoints, Entries]:
    """Return points and entries with mean jumps as unknowns.

    The mean jumps D of the points are those of their jumps d and of the jumps A d of the dependent
    corners: D = G d. The entries for D are those for d times G^-1. A component that supports
    prescribe stays the jump of the point.

    Args:
        facets: All facets.
        points: Points, each with its area alone.
        entries: Displacement of the bodies due to d.
        handed: Areas that the points receive.
        names: Names of the interfaces.
        by_face: Whether each face of a point has a separate pressure. A field with one component
            has the same flux on all faces.

    Raises:
        InputError: The mean jumps do not determine the jumps.
    """
    n, surface = len(points.vertex), points.surface
    normals = surface.normals if by_face else np.zeros_like(surface.normals)
    weight = points.weight + np.bincount(handed.point, handed.area, n)
    face = _faces_along(normals[handed.point], handed.normal)
    own_face_area = _face_areas(facets, surface, normals)
    face_area = own_face_area[:n].copy()
    on_face = face >= 0
    receivers = handed.point[on_face], face[on_face]
    np.add.at(face_area, receivers, handed.area[on_face])

    # Share of a corner in the force of a point: the pressure of a face on the area that it gives
    # to this face, and friction by area.
    duals = dual_vectors(normals[:n])
    tangential = np.eye(3) - np.einsum("pki,pkj->pij", normals[:n], duals)
    share = (handed.area / weight[handed.point])[:, None, None] * tangential[handed.point]
    along = normals[receivers][:, :, None] * duals[receivers][:, None, :]
    share[on_face] += (handed.area[on_face] / face_area[receivers])[:, None, None] * along
    handed_share = np.zeros((n, 3, 3))
    np.add.at(handed_share, handed.point, share)

    shape = len(surface.vertex) - n, n
    to_corners = _blocks(share, handed.corner - n, handed.point, shape)
    A = _three(_dependent_jumps(surface, n))
    identity = eye_array(3 * n, format="csr")
    free_directions = _diagonal(np.eye(3) - projectors(points.axes, points.held))
    mean_of_others = csr_array(to_corners.T @ A - _diagonal(handed_share.swapaxes(1, 2)))
    G = csr_array(identity + free_directions @ mean_of_others)
    inverse = _inverse(G, surface, names)
    parts = []
    for b in np.unique(entries.body):
        of_body = entries.body == b
        node_rows, rows = np.unique(entries.row[of_body], return_inverse=True)
        positions = rows.ravel(), entries.column[of_body]
        B = csr_array((entries.value[of_body], positions), shape=(len(node_rows), 3 * n)) @ inverse
        B = B.tocoo()
        is_nonzero = np.abs(B.data) > ROUNDING
        parts.append(
            (
                np.full(is_nonzero.sum(), b),
                node_rows[B.row[is_nonzero]],
                B.col[is_nonzero].astype(np.int64),
                B.data[is_nonzero],
            )
        )
    body, row, column, value = (np.concatenate(part) for part in zip(*parts, strict=True))
    # Forces of a point and of corners are per area of each.
    kept_force = (np.eye(3) - handed_share) * (weight / points.weight)[:, None, None]
    handed_forces = _diagonal(np.eye(3) / surface.weight[n:, None, None]) @ to_corners
    handed_forces = handed_forces @ _diagonal(np.eye(3) * weight[:, None, None])
    by_area = (handed.area / surface.weight[handed.corner], (handed.corner - n, handed.point))
    dependence = Dependence(
        values=csr_array(vstack([eye_array(n), csr_array(by_area, shape=shape)])),
        forces=csr_array(vstack([_diagonal(kept_force), handed_forces])),
        pressures=_pressures(surface, normals, handed, face, own_face_area, face_area, weight),
        jumps=csr_array(vstack([identity, A]) @ inverse),
    )
    surface = replace(surface, dependence=dependence)
    return replace(points, weight=weight, surface=surface), Entries(body, row, column, value)


def _inverse(G: csr_array, surface: ContactSurface, names: Sequence[str]) -> csr_array:
    """Return the inverse of the matrix of mean jumps (3 n, 3 n), which has mostly unit rows.

    Raises:
        InputError: The matrix is singular.
    """
    affected = np.flatnonzero(np.diff(G.indptr) != 1)
    changed = np.unique(np.concatenate([affected, G[affected].indices]))
    part = csc_array(G[changed][:, changed])
    try:
        local = csr_array(inv(part)).tocoo()
    except RuntimeError:  # exactly singular
        local = None
    if local is None or not np.abs(local.data).max(initial=0.0) < LARGEST_INVERSE:
        direction = np.linalg.svd(part.toarray())[2][-1]
        p = int(changed[np.abs(direction).argmax()] // 3)
        x, y, z = surface.x[p]
        raise InputError(
            f"interfaces.{names[int(surface.interface[p])]}: too few of its nodes near "
            f"({x:.4g}, {y:.4g}, {z:.4g}) mm are beside the lines where interfaces meet, so its "
            "pressure there is not determined; use a finer mesh"
        )
    unchanged = np.setdiff1d(np.arange(G.shape[0]), changed)
    row = np.concatenate([unchanged, changed[local.row]])
    column = np.concatenate([unchanged, changed[local.col]])
    value = np.concatenate([np.ones(len(unchanged)), local.data])
    keep = np.abs(value) > ROUNDING
    return csr_array((value[keep], (row[keep], column[keep])), shape=G.shape)


def _pressures(
    surface: ContactSurface,
    normals: Floats,
    handed: HandedAreas,
    face: Ints,
    own_face_area: Floats,
    face_area: Floats,
    weight: Floats,
) -> csr_array:
    """Return ``Dependence.pressures``.

    Args:
        surface: All corners, points first.
        normals: Unit normals of their faces (m, 3, 3).
        handed: Areas that the points receive.
        face: Face of the point that receives each area, or -1 (k,).
        own_face_area: Areas of the faces of corners (m, 3) [mm2].
        face_area: Areas of the faces of points with what they receive (n, 3) [mm2].
        weight: Areas of the points with what they receive (n,) [mm2].
    """
    m, n = len(surface.weight), len(weight)
    # Pressure on the area of a face from that on the area of the point.
    to_face = np.divide(weight[:, None], face_area, where=face_area > 0, out=np.zeros((n, 3)))
    kept_pressure = to_face * own_face_area[:n] / surface.weight[:n, None]
    face_of_corner = _faces_along(normals[handed.corner], handed.normal)
    used = np.flatnonzero((face >= 0) & (face_of_corner >= 0))
    corner, point = handed.corner[used], handed.point[used]
    value = handed.area[used] / surface.weight[corner] * to_face[point, face[used]]
    rows = np.concatenate([np.arange(3 * n), 3 * corner + face_of_corner[used]])
    columns = np.concatenate([np.arange(3 * n), 3 * point + face[used]])
    values = np.concatenate([kept_pressure.ravel(), value])
    return csr_array((values, (rows, columns)), shape=(3 * m, 3 * n))


def _diagonal(blocks: Floats) -> csr_array:
    """Return the matrix (3 n, 3 n) of blocks on the diagonal (n, 3, 3)."""
    n = len(blocks)
    return csr_array(bsr_array((blocks, np.arange(n), np.arange(n + 1)), shape=(3 * n, 3 * n)))


def _blocks(blocks: Floats, row: Ints, column: Ints, shape: tuple[int, int]) -> csr_array:
    """Return the matrix of the sums of blocks (k, 3, 3) at rows and columns of blocks."""
    i, j = np.meshgrid(np.arange(3), np.arange(3), indexing="ij")
    rows, columns = 3 * row[:, None, None] + i, 3 * column[:, None, None] + j
    size = 3 * shape[0], 3 * shape[1]
    return csr_array((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=size)


def _three(scalar: csr_array) -> csr_array:
    """Return factors (m, n) for each of three components (3 m, 3 n)."""
    return csr_array(kron(scalar, eye_array(3), format="csr"))


def _dependent_jumps(surface: ContactSurface, n: int) -> csr_array:
    """Matrix (m - n, n) of signs +1, -1, 0: jumps of dependent corners from jumps of points."""
    rows: list[int] = []
    columns: list[int] = []
    values: list[float] = []
    for c in range(n, len(surface.vertex)):
        points_at_vertex = np.flatnonzero(surface.vertex[:n] == surface.vertex[c])
        master, slave = map(int, surface.bodies[c])
        path: dict[int, dict[int, float]] = {master: {}}
        for _ in points_at_vertex:
            for p in map(int, points_at_vertex):
                a, b = map(int, surface.bodies[p])
                if a in path and b not in path:
                    path[b] = path[a] | {p: 1.0}
                elif b in path and a not in path:
                    path[a] = path[b] | {p: -1.0}
        rows += [c - n] * len(path[slave])
        columns += path[slave].keys()
        values += path[slave].values()
    return csr_array((values, (rows, columns)), shape=(len(surface.vertex) - n, n))
