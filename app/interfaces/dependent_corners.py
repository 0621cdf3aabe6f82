"""Dependent corners, whose jumps follow from the jumps of the points at the same vertex.

Interfaces meet at such a vertex. A dependent corner gives its area and its jump to points of its
interface next to it. The unknown of such a point is the mean jump, by area, of the point and its
part of the corner.

A point on an edge of its interface has several faces, each with its area and its pressure. A facet
of a dependent corner belongs to one of them. Along the normal of this face the mean is over the
area of the face alone. Along the normals of the other faces the corner has no part. A constant
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
    ROUNDING_OF_JUMP_FACTORS,
    ContactPoints,
    ContactSurface,
    Dependence,
    Entries,
)
from app.interfaces.faces import dual_vectors, projectors
from app.interfaces.interface_facets import InterfaceFacets

# A facet belongs to the face with the nearest normal, if the cosine between both is at least this.
SAME_FACE = 0.5
# Largest entry of the inverse of the matrix of mean jumps. Regular matrices had at most 100, and
# matrices that are singular up to rounding had 1e14.
LARGEST_INVERSE = 1e6


@dataclass(frozen=True)
class TransferredAreas:
    """Areas that dependent corners give to points (k of them).

    Attributes:
        corner: Corner that gives the area (k,).
        point: Point that receives the area (k,).
        normal: Unit normal at the corner, of the facet to which the area belongs (k, 3).
        area: Area (k,) [mm2].
    """

    corner: Ints
    point: Ints
    normal: Floats
    area: Floats


def transferred_areas(
    facets: InterfaceFacets,
    surface: ContactSurface,
    prescribed_projectors: Floats,
    names: Sequence[str],
    by_face: bool,
) -> TransferredAreas:
    """Areas that dependent corners give to points of their interface.

    The points that receive an area are the other corners of the facet. If all of these are
    dependent, it is the nearest point of the same sides with a face along the facet. A point with a
    prescribed component that the corner does not have is the last choice.

    Args:
        facets: All facets.
        surface: All corners, points first.
        prescribed_projectors: Projectors on the prescribed directions of the points (n, 3, 3).
        names: Names of the interfaces.
        by_face: True if each face of a point has a separate pressure.

    Raises:
        InputError: There is no such point.
    """
    point_count = len(prescribed_projectors)
    corners = np.concatenate(surface.triangles)
    facet_rows = np.concatenate(surface.facets)
    sides = np.column_stack([surface.interface, surface.bodies])
    prescribed_at_vertex: dict[int, Floats] = {}
    for p in np.flatnonzero(prescribed_projectors.any(axis=(1, 2))):
        v = int(surface.vertex[p])
        prescribed_at_vertex[v] = np.maximum(
            prescribed_at_vertex.get(v, 0.0), np.abs(prescribed_projectors[p])
        )
    transferred_rows: list[tuple[int, int, int, int]] = []
    areas: list[float] = []
    for triangle, k in zip(*np.nonzero(corners >= point_count), strict=True):
        corner = int(corners[triangle, k])
        facet = int(facet_rows[triangle])
        prescribed_at_corner = prescribed_at_vertex.get(
            int(surface.vertex[corner]), np.zeros((3, 3))
        )

        def is_admissible(p: Ints, prescribed_at_corner: Floats = prescribed_at_corner) -> Bools:
            """Mask of points without prescribed components that the corner does not have."""
            is_within = (
                np.abs(prescribed_projectors[p]) <= prescribed_at_corner + ROUNDING_OF_JUMP_FACTORS
            )
            return np.asarray(is_within.all(axis=(1, 2)))

        neighbours = corners[triangle][corners[triangle] < point_count]
        receivers = neighbours[is_admissible(neighbours)]
        if not len(receivers):
            is_same_side = (sides[:point_count] == sides[corner]).all(axis=1)
            candidates = np.flatnonzero(is_same_side)
            normal = facets.normal[facet, k]
            if by_face and normal @ prescribed_at_corner @ normal < SAME_FACE:
                has_face = _faces_along(surface.normals[candidates], normal) >= 0
                candidates = candidates[has_face]
            admissible = candidates[is_admissible(candidates)]
            if len(admissible):
                candidates = admissible
            receivers = _nearest_points(surface, corner, candidates, names)
        transferred_rows += [(corner, int(p), facet, int(k)) for p in receivers]
        areas += [float(facets.area[facet, k]) / len(receivers)] * len(receivers)
    corner_rows, point_rows, facet_of_area, corner_of_facet = np.array(transferred_rows).T
    normals = facets.normal[facet_of_area, corner_of_facet]
    return TransferredAreas(corner_rows, point_rows, normals, np.array(areas))


def _nearest_points(
    surface: ContactSurface, corner: int, candidates: Ints, names: Sequence[str]
) -> Ints:
    """Points nearest to a corner, several if they are equally near.

    Raises:
        InputError: There are no candidates.
    """
    if not len(candidates):
        x, y, z = surface.x[corner]
        raise InputError(
            f"interfaces.{names[int(surface.interface[corner])]}: all nodes of a face lie "
            f"on lines where interfaces meet, e.g. at ({x:.4g}, {y:.4g}, {z:.4g}) mm, so "
            "none can carry its force; use a finer mesh"
        )
    distances = np.linalg.norm(surface.x[candidates] - surface.x[corner], axis=1)
    return candidates[np.isclose(distances, distances.min(), rtol=1e-6)]


def _faces_along(normals: Floats, direction: Floats) -> Ints:
    """Index of the face of each point that is along a direction, or -1 (n,).

    Args:
        normals: Unit normals of the faces of points (n, 3, 3).
        direction: Unit normal, one for all points (3,) or one for each (n, 3).
    """
    directions = np.broadcast_to(direction, normals[:, 0].shape)
    cosines = np.abs(np.einsum("pki,pi->pk", normals, directions))
    return np.where(cosines.max(axis=1) >= SAME_FACE, cosines.argmax(axis=1), -1)


def _face_areas(facets: InterfaceFacets, surface: ContactSurface, normals: Floats) -> Floats:
    """Areas of the faces of corners (m, 3), with these unit normals (m, 3, 3) [mm2]."""
    corners = np.concatenate(surface.triangles).ravel()
    facet_rows = np.concatenate(surface.facets)
    faces = _faces_along(normals[corners], facets.normal[facet_rows].reshape(-1, 3))
    corner_area = facets.area[facet_rows].ravel()
    has_face = faces >= 0
    area = np.zeros((len(surface.weight), 3))
    np.add.at(area, (corners[has_face], faces[has_face]), corner_area[has_face])
    return area


def with_mean_jumps(
    facets: InterfaceFacets,
    points: ContactPoints,
    entries: Entries,
    transferred: TransferredAreas,
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
        transferred: Areas that the points receive.
        names: Names of the interfaces.
        by_face: True if each face of a point has a separate pressure. A field with one component
            has the same flux on all faces.

    Raises:
        InputError: The mean jumps do not determine the jumps.
    """
    n, surface = len(points.vertex), points.surface
    normals = surface.normals if by_face else np.zeros_like(surface.normals)
    weight = points.weight + np.bincount(transferred.point, transferred.area, n)
    face = _faces_along(normals[transferred.point], transferred.normal)
    corner_face_area = _face_areas(facets, surface, normals)
    face_area = corner_face_area[:n].copy()
    is_on_face = face >= 0
    np.add.at(
        face_area, (transferred.point[is_on_face], face[is_on_face]), transferred.area[is_on_face]
    )
    share = _force_shares(normals[:n], transferred, face, face_area, weight)
    transferred_share = np.zeros((n, 3, 3))
    np.add.at(transferred_share, transferred.point, share)

    # Mean jumps: the jumps A d of dependent corners replace a share of the jumps d of the points.
    shape = len(surface.vertex) - n, n
    to_corners = _blocks(share, transferred.corner - n, transferred.point, shape)
    A = _three(_dependent_jumps(surface, n))
    identity = eye_array(3 * n, format="csr")
    free_directions = _diagonal(np.eye(3) - projectors(points.axes, points.is_prescribed))
    change_by_corners = csr_array(to_corners.T @ A - _diagonal(transferred_share.swapaxes(1, 2)))
    G = csr_array(identity + free_directions @ change_by_corners)
    inverse = _inverse(G, surface, names)

    # Forces of a point and of corners are per area of each.
    kept_force = (np.eye(3) - transferred_share) * (weight / points.weight)[:, None, None]
    transferred_forces = _diagonal(np.eye(3) / surface.weight[n:, None, None]) @ to_corners
    transferred_forces = transferred_forces @ _diagonal(np.eye(3) * weight[:, None, None])
    corner_fraction = transferred.area / surface.weight[transferred.corner]
    transferred_values = csr_array(
        (corner_fraction, (transferred.corner - n, transferred.point)), shape=shape
    )
    dependence = Dependence(
        values=csr_array(vstack([eye_array(n), transferred_values])),
        forces=csr_array(vstack([_diagonal(kept_force), transferred_forces])),
        pressures=_pressures(
            surface, normals, transferred, face, corner_face_area, face_area, weight
        ),
        jumps=csr_array(vstack([identity, A]) @ inverse),
    )
    surface = replace(surface, dependence=dependence)
    points = replace(points, weight=weight, surface=surface)
    return points, _transformed(entries, inverse)


def _force_shares(
    normals: Floats, transferred: TransferredAreas, face: Ints, face_area: Floats, weight: Floats
) -> Floats:
    """Share of a corner in the force of a point, for each area that it gives (k, 3, 3) [-].

    The corner has a share of the pressure of a face by the area that it gives to this face, and a
    share of friction by the whole area.

    Args:
        normals: Unit normals of the faces of points (n, 3, 3).
        transferred: Areas that the points receive.
        face: Face of the point that receives each area, or -1 (k,).
        face_area: Areas of the faces of points, with the received areas (n, 3) [mm2].
        weight: Areas of the points, with the received areas (n,) [mm2].
    """
    duals = dual_vectors(normals)
    tangential = np.eye(3) - np.einsum("pki,pkj->pij", normals, duals)
    area_fraction = transferred.area / weight[transferred.point]
    share = area_fraction[:, None, None] * tangential[transferred.point]
    is_on_face = face >= 0
    faces = transferred.point[is_on_face], face[is_on_face]
    along_normal = normals[faces][:, :, None] * duals[faces][:, None, :]
    face_fraction = transferred.area[is_on_face] / face_area[faces]
    share[is_on_face] += face_fraction[:, None, None] * along_normal
    return np.asarray(share)


def _transformed(entries: Entries, inverse: csr_array) -> Entries:
    """Entries of the products B_b G^-1, from the entries of B_b and the inverse (3 n, 3 n)."""
    bodies: list[Ints] = []
    rows: list[Ints] = []
    columns: list[Ints] = []
    values: list[Floats] = []
    for body in np.unique(entries.body):
        is_of_body = entries.body == body
        dofs, row = np.unique(entries.row[is_of_body], return_inverse=True)
        triplets = entries.value[is_of_body], (row.ravel(), entries.column[is_of_body])
        B = csr_array(triplets, shape=(len(dofs), inverse.shape[0]))
        product = (B @ inverse).tocoo()
        is_nonzero = np.abs(product.data) > ROUNDING_OF_JUMP_FACTORS
        bodies.append(np.full(is_nonzero.sum(), body))
        rows.append(dofs[product.row[is_nonzero]])
        columns.append(product.col[is_nonzero].astype(np.int64))
        values.append(product.data[is_nonzero])
    return Entries(
        body=np.concatenate(bodies),
        row=np.concatenate(rows),
        column=np.concatenate(columns),
        value=np.concatenate(values),
    )


def _inverse(G: csr_array, surface: ContactSurface, names: Sequence[str]) -> csr_array:
    """Return the inverse of the matrix of mean jumps (3 n, 3 n), which has mostly unit rows.

    Raises:
        InputError: The matrix is singular.
    """
    # Only the part without unit rows is inverted, with the rows on which it depends.
    other_rows = np.flatnonzero(np.diff(G.indptr) != 1)
    changed = np.unique(np.concatenate([other_rows, G[other_rows].indices]))
    part = csc_array(G[changed][:, changed])
    try:
        inverse_part = csr_array(inv(part)).tocoo()
    except RuntimeError:  # exactly singular
        inverse_part = None
    if inverse_part is None or not np.abs(inverse_part.data).max(initial=0.0) < LARGEST_INVERSE:
        singular_direction = np.linalg.svd(part.toarray())[2][-1]
        p = int(changed[np.abs(singular_direction).argmax()] // 3)
        x, y, z = surface.x[p]
        raise InputError(
            f"interfaces.{names[int(surface.interface[p])]}: too few of its nodes near "
            f"({x:.4g}, {y:.4g}, {z:.4g}) mm are beside the lines where interfaces meet, so its "
            "pressure there is not determined; use a finer mesh"
        )
    unchanged = np.setdiff1d(np.arange(G.shape[0]), changed)
    row = np.concatenate([unchanged, changed[inverse_part.row]])
    column = np.concatenate([unchanged, changed[inverse_part.col]])
    value = np.concatenate([np.ones(len(unchanged)), inverse_part.data])
    is_nonzero = np.abs(value) > ROUNDING_OF_JUMP_FACTORS
    return csr_array((value[is_nonzero], (row[is_nonzero], column[is_nonzero])), shape=G.shape)


def _pressures(
    surface: ContactSurface,
    normals: Floats,
    transferred: TransferredAreas,
    face: Ints,
    corner_face_area: Floats,
    face_area: Floats,
    weight: Floats,
) -> csr_array:
    """Return ``Dependence.pressures``.

    Args:
        surface: All corners, points first.
        normals: Unit normals of their faces (m, 3, 3).
        transferred: Areas that the points receive.
        face: Face of the point that receives each area, or -1 (k,).
        corner_face_area: Areas of the faces of corners (m, 3) [mm2].
        face_area: Areas of the faces of points, with the received areas (n, 3) [mm2].
        weight: Areas of the points, with the received areas (n,) [mm2].
    """
    m, n = len(surface.weight), len(weight)
    # Factors from the pressure on the area of the point to the pressure on the area of its face.
    face_factor = np.divide(weight[:, None], face_area, where=face_area > 0, out=np.zeros((n, 3)))
    kept_factors = face_factor * corner_face_area[:n] / surface.weight[:n, None]
    face_of_corner = _faces_along(normals[transferred.corner], transferred.normal)
    used = np.flatnonzero((face >= 0) & (face_of_corner >= 0))
    corner, point = transferred.corner[used], transferred.point[used]
    corner_fraction = transferred.area[used] / surface.weight[corner]
    transferred_factors = corner_fraction * face_factor[point, face[used]]
    rows = np.concatenate([np.arange(3 * n), 3 * corner + face_of_corner[used]])
    columns = np.concatenate([np.arange(3 * n), 3 * point + face[used]])
    values = np.concatenate([kept_factors.ravel(), transferred_factors])
    return csr_array((values, (rows, columns)), shape=(3 * m, 3 * n))


def _diagonal(blocks: Floats) -> csr_array:
    """Return the block-diagonal matrix (3 n, 3 n) of blocks (n, 3, 3)."""
    n = len(blocks)
    return csr_array(bsr_array((blocks, np.arange(n), np.arange(n + 1)), shape=(3 * n, 3 * n)))


def _blocks(blocks: Floats, row: Ints, column: Ints, shape: tuple[int, int]) -> csr_array:
    """Return the matrix of blocks (k, 3, 3) at block rows and columns (k,); equal places add up."""
    i, j = np.meshgrid(np.arange(3), np.arange(3), indexing="ij")
    rows, columns = 3 * row[:, None, None] + i, 3 * column[:, None, None] + j
    size = 3 * shape[0], 3 * shape[1]
    return csr_array((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=size)


def _three(scalar: csr_array) -> csr_array:
    """Return the matrix (3 m, 3 n) that applies factors (m, n) to each of three components."""
    return csr_array(kron(scalar, eye_array(3), format="csr"))


def _dependent_jumps(surface: ContactSurface, n: int) -> csr_array:
    """Matrix (m - n, n) of signs +1, -1, 0: jumps of dependent corners from jumps of points."""
    rows: list[int] = []
    columns: list[int] = []
    values: list[float] = []
    for corner in range(n, len(surface.vertex)):
        points_at_vertex = np.flatnonzero(surface.vertex[:n] == surface.vertex[corner])
        master, slave = map(int, surface.bodies[corner])
        # Signs of the jumps that sum to the motion of a body relative to the master, by body.
        signs: dict[int, dict[int, float]] = {master: {}}
        # A path has at most as many points as the vertex: as many passes reach every body.
        for _ in points_at_vertex:
            for p in map(int, points_at_vertex):
                point_master, point_slave = map(int, surface.bodies[p])
                if point_master in signs and point_slave not in signs:
                    signs[point_slave] = signs[point_master] | {p: 1.0}
                elif point_slave in signs and point_master not in signs:
                    signs[point_master] = signs[point_slave] | {p: -1.0}
        rows += [corner - n] * len(signs[slave])
        columns += signs[slave].keys()
        values += signs[slave].values()
    return csr_array((values, (rows, columns)), shape=(len(surface.vertex) - n, n))
