"""Faces around contact points: sets of facets that meet smoothly, with one normal and one area."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints
from app.interfaces.interface_facets import InterfaceFacets
from app.interfaces.smooth_normals import slid_along, smooth_normals, unit_sums
from meshes.data import connected

# Facets that meet at less than this angle are one face. Where the geometry has rounded edges, it
# gives a larger angle for straight facets, since friction on a false edge may have no equilibrium.
FACE_ANGLE = np.deg2rad(30.0)
# Straight facets that meet at up to this angle are one face if their nodes lie on one quadric, as
# in a coarse mesh of a cylinder or cone with nine facets around.
COARSE_ANGLE = np.deg2rad(44.0)
# Nodes lie on the fitted surface if the standard error of its normal is below this [rad].
EXACT = 1e-4
# Largest number of faces of a point.
MAX_FACES = 3
# Faces are independent while the Gram determinant of their normals stays above this. Normals
# without their prescribed directions must be longer than this.
INDEPENDENT = 0.05


def faces_around(
    facets: InterfaceFacets, point: Ints, point_count: int
) -> tuple[Floats, Ints, Floats, Floats]:
    """Group the facets around each of n points into faces.

    ``point`` is the contact point of each facet corner, or -1 if it has none (3 f,).

    Returns:
        Normals (n, 3, 3) and number of faces (n,), total area (n,) [mm2], and the largest standard
        error of a normal (n,) [rad].
    """
    label = _smooth_groups(facets)
    corner_normal, corner_error = _normals_of_surface(facets, label)
    is_used = point >= 0
    # A group: the facet corners of a point that are joined by smooth edges.
    pairs = np.stack([point[is_used], label[is_used]], axis=1)
    groups, first_row, group = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
    corner_area = facets.area.ravel()[is_used]
    area = np.zeros(len(groups))
    np.add.at(area, group, corner_area)
    normal = np.zeros((len(groups), 3))
    np.add.at(normal, group, corner_area[:, None] * corner_normal[is_used])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # A body slides on all of an interface at once: the groups of one interface between two bodies
    # are corrected together.
    corner = np.flatnonzero(is_used)[first_row]
    x, error = facets.x.reshape(-1, 3)[corner], corner_error[corner]
    surfaces = np.column_stack([facets.interface, facets.bodies])[corner // 3]
    for surface in np.unique(surfaces[facets.straight[corner // 3]], axis=0):
        rows = np.flatnonzero((surfaces == surface).all(axis=1))
        normal[rows] = slid_along(x[rows], normal[rows], error[rows], area[rows])
    point_of_group = groups[:, 0]
    weight = np.zeros(point_count)
    np.add.at(weight, point_of_group, area)
    normals = np.zeros((point_count, 3, 3))
    normals[point_of_group, 0] = normal
    faces = np.ones(point_count, dtype=np.int64)
    for rows in shared(point_of_group):
        distinct = _distinct(normal[rows], area[rows])
        p = point_of_group[rows[0]]
        faces[p] = len(distinct)
        normals[p, : len(distinct)] = distinct
    largest_error = np.zeros(point_count)
    np.maximum.at(largest_error, point[is_used], corner_error[is_used])
    return normals, faces, weight, largest_error


def _normals_of_surface(facets: InterfaceFacets, label: Ints) -> tuple[Floats, Floats]:
    """Normals at facet corners (3 f, 3), and their standard error (3 f,) [rad].

    Straight facets have the normals of the smooth surface that they approximate. Curved facets have
    the mean of their normals, by area. Its error is the angle to the mean without weights.
    """
    _, first_corner, node = np.unique(label, return_index=True, return_inverse=True)
    corners, x = node.reshape(-1, 3), facets.x.reshape(-1, 3)[first_corner]
    normal = unit_sums(facets.normal, facets.area, corners, len(x))
    unweighted = unit_sums(facets.normal, np.ones_like(facets.area), corners, len(x))
    error = np.linalg.norm(normal - unweighted, axis=1)
    if facets.straight.any():
        straight_rows = np.flatnonzero(facets.straight)
        smooth_nodes, local_corners = np.unique(corners[straight_rows], return_inverse=True)
        smooth = smooth_normals(
            x[smooth_nodes],
            local_corners.reshape(-1, 3),
            facets.normal[straight_rows],
            facets.area[straight_rows],
        )
        normal[smooth_nodes] = smooth.normal
        error[smooth_nodes] = smooth.error
    return normal[node.ravel()], error[node.ravel()]


def _smooth_groups(facets: InterfaceFacets) -> Ints:
    """Label facet corners (3 f,): labels at a vertex are equal if smooth edges join the facets."""
    facet_count = len(facets.area)
    # Ends of the edge opposite each vertex of a facet.
    ends = np.array([[1, 2], [0, 2], [0, 1]])
    edge_vertices = facets.vertices[:, ends].reshape(-1, 2)
    surface = np.repeat(np.column_stack([facets.interface, facets.bodies]), 3, axis=0)
    edge = np.unique(np.column_stack([surface, edge_vertices]), axis=0, return_inverse=True)[1]
    facets_per_edge = np.bincount(edge)
    by_edge = np.argsort(edge, kind="stable")
    start = (np.cumsum(facets_per_edge) - facets_per_edge)[facets_per_edge == 2]
    # Facet edges that are the same edge of two facets.
    one, other = by_edge[start], by_edge[start + 1]
    # Normals in the middle of the edges, from the normals at both ends.
    facet_rows = np.arange(facet_count)[:, None, None]
    middle_normal = facets.normal[facet_rows, ends].sum(axis=2).reshape(-1, 3)
    middle_normal /= np.linalg.norm(middle_normal, axis=1, keepdims=True)
    cosine = np.einsum("ei,ei->e", middle_normal[one], middle_normal[other])
    # Facet corners at both ends of the edge. The vertices of facets are sorted: the ends agree.
    corners_of_one = 3 * (one // 3)[:, None] + ends[one % 3]
    corners_of_other = 3 * (other // 3)[:, None] + ends[other % 3]

    def joined_by(is_smooth: Bools) -> Ints:
        return connected(
            3 * facet_count, corners_of_one[is_smooth].ravel(), corners_of_other[is_smooth].ravel()
        )

    angle = np.where(facets.straight, np.maximum(FACE_ANGLE, facets.rounded_angle), FACE_ANGLE)
    is_smooth = cosine > np.cos(angle[one // 3])
    is_coarse = ~is_smooth & (cosine > np.cos(COARSE_ANGLE)) & facets.straight[one // 3]
    if is_coarse.any():
        _, error = _normals_of_surface(facets, joined_by(is_smooth | is_coarse))
        is_smooth |= is_coarse & (error[corners_of_one] < EXACT).all(axis=1)
    return joined_by(is_smooth)


def _distinct(normals: Floats, areas: Floats) -> Floats:
    """Normals of at most three independent faces. Further faces are merged into the nearest one.

    They are in the order of their areas. Faces of equal area are in the order of the mesh.
    """
    by_area: Ints = np.argsort(-np.round(areas, 9), kind="stable").astype(np.int64)
    distinct: list[Floats] = []
    sums: list[Floats] = []
    for row in map(int, by_area):
        normal, area = np.asarray(normals[row]), float(areas[row])
        candidate = np.array([*distinct, normal])
        if len(distinct) < MAX_FACES and np.linalg.det(candidate @ candidate.T) > INDEPENDENT:
            distinct.append(normal)
            sums.append(area * normal)
            continue
        nearest = int(np.argmax(np.array(distinct) @ normal))
        if distinct[nearest] @ normal > 0:
            sums[nearest] = sums[nearest] + area * normal
            distinct[nearest] = sums[nearest] / np.linalg.norm(sums[nearest])
    return np.array(distinct)


def drop_prescribed(normals: Floats, faces: Ints, prescribed_projectors: Floats) -> None:
    """Project prescribed directions out of the normals and drop faces along them, in place.

    Args:
        normals: Unit normals of the faces (n, 3, 3).
        faces: Numbers of faces (n,).
        prescribed_projectors: Projectors on the prescribed directions of each point (n, 3, 3).
    """
    for p in np.flatnonzero(prescribed_projectors.any(axis=(1, 2))):
        free_parts = normals[p, : faces[p]] @ (np.eye(3) - prescribed_projectors[p])
        size = np.linalg.norm(free_parts, axis=1)
        remains = size > INDEPENDENT
        normals[p] = 0
        faces[p] = 0
        if remains.any():
            unit_normals = free_parts[remains] / size[remains, None]
            distinct = _distinct(unit_normals, np.ones(remains.sum()))
            normals[p, : len(distinct)] = distinct
            faces[p] = len(distinct)


def dual_vectors(normals: Floats) -> Floats:
    """Dual vectors of the normals of faces (n, k, 3), zero where a normal is zero.

    The products of the duals with a vector are the components of the vector along the normals.
    """
    return np.asarray(np.linalg.pinv(normals).swapaxes(1, 2), dtype=np.float64)


def projectors(axes: Floats, weights: Bools | Floats) -> Floats:
    """Sums (n, 3, 3) of projectors on axes, which are columns (n, 3, 3), by weights (n, 3)."""
    return np.asarray(np.einsum("nic,nc,njc->nij", axes, weights, axes))


def shared(vertex: Ints) -> list[Ints]:
    """Rows of each vertex that occurs in more than one row."""
    by_vertex = np.argsort(vertex, kind="stable")
    rows_of_vertices = np.split(by_vertex, np.flatnonzero(np.diff(vertex[by_vertex])) + 1)
    return [rows for rows in rows_of_vertices if len(rows) > 1]


def spread_of_normals(x: Floats, normals: Floats, triangles: Sequence[Ints]) -> Floats:
    """Covariance of facet normals about the normals of their points (n, 3, 3) [-].

    A facet counts for the face of its point whose normal is closest to the normal of the facet.

    Args:
        x: Points (n, 3) [mm].
        normals: Unit normals of their faces (n, k, 3).
        triangles: Points of the facets (f, 3), by interface.
    """
    weighted_sum = np.zeros((len(x), 3, 3))
    total_weight = np.zeros(len(x))
    for corners in triangles:
        a, b, c = x[corners].transpose(1, 0, 2)
        facet_normal = np.cross(b - a, c - a)
        weight = np.linalg.norm(facet_normal, axis=1)
        facet_normal = facet_normal / weight[:, None]
        facet_rows = np.arange(len(corners))
        for point in corners.T:
            cosines = np.einsum("fki,fi->fk", normals[point], facet_normal)
            face = np.abs(cosines).argmax(axis=1)
            sign = np.sign(cosines[facet_rows, face])
            deviation = facet_normal * sign[:, None] - normals[point, face]
            square = weight[:, None, None] * deviation[:, :, None] * deviation[:, None, :]
            np.add.at(weighted_sum, point, square)
            np.add.at(total_weight, point, weight)
    return weighted_sum / np.where(total_weight > 0, total_weight, 1.0)[:, None, None]
