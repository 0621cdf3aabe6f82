"""Facets of contact interfaces, and the faces that they form around contact points.

Facets are on every rank in the same order for any partition. A face is a set of facets that meet
smoothly; it has one normal and one area.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from app.foundation.arrays import Bools, Floats, Ints
from meshes.data import connected, tangents
from meshes.smooth_normals import slid_along, smooth_normals, unit_sums

if TYPE_CHECKING:
    from mpi4py import MPI

FACE_ANGLE = np.deg2rad(30.0)
# Straight facets that meet at up to this angle are one face if their nodes lie on one quadric, as
# in a coarse mesh of a cylinder or cone with nine facets around.
COARSE_ANGLE = np.deg2rad(44.0)
# Nodes lie on the fitted surface if the doubt about its normal is below this [rad].
EXACT = 1e-4
# Edges are straight if their middles are this close to the chord, as a part of its length.
STRAIGHT = 1e-9
MAX_FACES = 3
# Faces are independent while the Gram determinant of their normals stays above this.
INDEPENDENT = 0.05

# Three points that integrate second-order polynomials on a triangle (barycentric, equal weights).
QUADRATURE = np.full((3, 3), 1 / 6) + np.eye(3) / 2
# The vertices of a triangle, and the middles of the edges opposite them.
NODES = np.concatenate([np.eye(3), (1 - np.eye(3)) / 2])


@dataclass(frozen=True)
class InterfaceFacets:
    """Facets of the contact interfaces, replicated on all ranks in canonical order.

    Attributes:
        interface: Index of the interface (f,).
        vertices: Vertex numbers of the mesh file, rising (f, 3).
        bodies: Bodies on the master and on the slave side (f, 2).
        dofs: Global blocked dofs at the vertices, then at the edges opposite them (f, 3 or 6).
        nodes: Coordinates of the vertices, then of the middles of curved edges (f, 3 or 6, 3) [mm].
        normal: Unit normal from master to slave at each vertex (f, 3, 3).
        area: Integral of the linear shape function of each vertex (f, 3) [mm2].
        stiffness: Moduli of the master and the slave cell (f, 2) [MPa].
    """

    interface: Ints
    vertices: Ints
    bodies: Ints
    dofs: Ints
    nodes: Floats
    normal: Floats
    area: Floats
    stiffness: Floats

    @property
    def x(self) -> Floats:
        """Coordinates of the vertices (f, 3, 3) [mm]."""
        return self.nodes[:, :3]

    @cached_property
    def straight(self) -> Bools:
        """Mask of the facets of interfaces whose facets are all straight (f,)."""
        if self.nodes.shape[1] == 3:
            return np.ones(len(self.area), dtype=bool)
        start, end = self.nodes[:, [1, 2, 0]], self.nodes[:, [2, 0, 1]]
        off = np.linalg.norm(self.nodes[:, 3:] - (start + end) / 2, axis=2)
        bent = (off > STRAIGHT * np.linalg.norm(end - start, axis=2)).any(axis=1)
        return ~np.isin(self.interface, self.interface[bent])


def gather(comm: MPI.Comm, *arrays: NDArray) -> list[NDArray]:
    """Concatenate each array over the ranks, on every rank."""
    pieces = comm.allgather(arrays)
    return [np.concatenate([p[k] for p in pieces]) for k in range(len(arrays))]


def sorted_facets(
    interface: Ints,
    vertices: Ints,
    bodies: Ints,
    dofs: Ints,
    nodes: Floats,
    inside_slave: Floats,
    stiffness: Floats,
) -> InterfaceFacets:
    """Put the facets of all ranks in canonical order.

    Arguments are those of `InterfaceFacets` in any order of the facets and of the vertices in them,
    and a point inside each slave cell (f, 3) [mm].
    """
    # The three vertices of a facet in rising order, then the facets by interface and vertices.
    order = np.argsort(vertices, axis=1)
    vertices = np.take_along_axis(vertices, order, axis=1)
    rows = np.lexsort((*vertices.T[::-1], interface))
    order, vertices = np.concatenate([order, order + 3], axis=1)[rows], vertices[rows]
    dofs = np.take_along_axis(dofs[rows], order[:, : dofs.shape[1]], axis=1)
    x = np.take_along_axis(nodes[rows], order[:, : nodes.shape[1], None], axis=1)
    flat = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    towards = np.sign(np.einsum("fi,fi->f", flat, inside_slave[rows] - x[:, 0]))
    _, area = surface(x, QUADRATURE)
    return InterfaceFacets(
        interface=interface[rows],
        vertices=vertices,
        bodies=bodies[rows],
        dofs=dofs,
        nodes=x,
        normal=surface(x, np.eye(3))[0] * towards[:, None, None],
        area=np.einsum("fq,qi->fi", area, QUADRATURE) / (2 * len(QUADRATURE)),
        stiffness=stiffness[rows],
    )


def surface(x: Floats, at: Floats) -> tuple[Floats, Floats]:
    """Unit normals (f, q, 3) and area elements (f, q) of facets at barycentric points (q, 3)."""
    if x.shape[1] == 6:
        a, b = tangents(x, at, ((1, 2), (2, 0), (0, 1)))
    else:
        flat = (x[:, 1:] - x[:, :1]).transpose(1, 2, 0)[..., None]
        a, b = np.broadcast_to(flat, (*flat.shape[:3], len(at)))
    normal = np.moveaxis(np.ascontiguousarray(np.cross(a, b, axis=0)), 0, -1)
    size = np.linalg.norm(normal, axis=2)
    return normal / size[:, :, None], size


def nodal_normals(x: Floats, inside: Floats, at: Floats) -> Floats:
    """Outward normals (f, q, 3) at barycentric points (q, 3), as long as the facet areas [mm2].

    ``x`` are the nodes of the facets (f, 3 or 6, 3), ``inside`` points in their cells (f, 3) [mm].
    """
    normals, size = surface(x, at)
    flat = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    away = np.sign(np.einsum("fi,fi->f", flat, x[:, 0] - inside))
    return normals * (away * size.mean(axis=1) / 2)[:, None, None]


def shape_functions(at: Floats, nodes: int) -> Floats:
    """Shape functions of facets with 3 or 6 nodes at barycentric points (q, 3) -> (q, nodes).

    Node 3 + k of six is the middle of the edge opposite vertex k.
    """
    if nodes == 3:
        return at
    middles = 4 * at[:, [1, 2, 0]] * at[:, [2, 0, 1]]
    return np.concatenate([at * (2 * at - 1), middles], axis=1)


def bends(start: Floats, end: Floats, middle: Floats) -> Floats:
    r"""Part of the difference of its ends in the displacement of the middle of a curved edge.

    The middle is off the chord by σ, along which linear displacements change too. With t the unit
    vector from end a to end b and L their distance,

    .. math:: u_m = (u_a + u_b) / 2 + (σ ⊗ t - t ⊗ σ) (u_b - u_a) / L

    is exact for translations, for rotations and for a widening in the plane of the edge. Returned
    are the factors (e, 3, 3) of the difference.
    """
    off, chord = middle - (start + end) / 2, end - start
    both = np.einsum("ei,ej->eij", off, chord)
    length2 = np.einsum("ei,ei->e", chord, chord)
    return (both - both.transpose(0, 2, 1)) / length2[:, None, None]


def foot(x: Floats, corners: Floats) -> Floats:
    """Barycentric coordinates (n, 3) of the point of each triangle nearest to x (n, 3)."""
    edges, off = np.roll(corners, -1, axis=1) - corners, x[:, None] - corners
    along = np.einsum("nki,nki->nk", off, edges) / np.einsum("nki,nki->nk", edges, edges)
    # The foot of the perpendicular, if it is inside, by products of two edges and the way to x.
    a, b, d = edges[:, 0], -edges[:, 2], off[:, 0]
    aa, ab, bb, da, db = (
        np.einsum("ni,ni->n", p, q) for p, q in ((a, a), (a, b), (b, b), (d, a), (d, b))
    )
    v, w = bb * da - ab * db, aa * db - ab * da
    inner = np.stack([aa * bb - ab**2 - v - w, v, w], axis=1) / (aa * bb - ab**2)[:, None]
    s = np.clip(along, 0.0, 1.0)[:, :, None]
    on_edges = (1 - s) * np.eye(3) + s * np.roll(np.eye(3), 1, axis=1)
    away = np.linalg.norm(np.einsum("nek,nki->nei", on_edges, corners) - x[:, None], axis=2)
    edge = on_edges[np.arange(len(x)), away.argmin(axis=1)]
    return np.where((inner >= 0).all(axis=1)[:, None], inner, edge)


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
    used = point >= 0
    pairs = np.stack([point[used], label[used]], axis=1)
    groups, first, group = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
    corner_area, corner_normal = facets.area.ravel()[used], of_corner[used]
    area, normal = np.zeros(len(groups)), np.zeros((len(groups), 3))
    np.add.at(area, group, corner_area)
    np.add.at(normal, group, corner_area[:, None] * corner_normal)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # A body slides on all of an interface at once.
    corner = np.flatnonzero(used)[first]
    sides = np.column_stack([facets.interface, facets.bodies])[corner // 3]
    x, off = facets.x.reshape(-1, 3)[corner], doubt_of_corner[corner]
    for side in np.unique(sides[facets.straight[corner // 3]], axis=0):
        here = (sides == side).all(axis=1)
        normal[here] = slid_along(x[here], normal[here], off[here], area[here])
    normals, faces, weight = np.zeros((n, 3, 3)), np.ones(n, dtype=np.int64), np.zeros(n)
    owner = groups[:, 0]
    normals[owner, 0] = normal
    np.add.at(weight, owner, area)
    for rows in shared(owner):
        ns = _distinct(normal[rows], area[rows])
        p, faces[p] = owner[rows[0]], len(ns)
        normals[p, : len(ns)] = ns
    doubt = np.zeros(n)
    np.maximum.at(doubt, point[used], doubt_of_corner[used])
    return normals, faces, weight, doubt


def _normals_of_surface(facets: InterfaceFacets, label: Ints) -> tuple[Floats, Floats]:
    """Normals at facet corners (3 f, 3), and the doubt about them (3 f,) [rad].

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
        here, at = np.unique(corners[rows], return_inverse=True)
        parts = x[here], at.reshape(-1, 3), facets.normal[rows], facets.area[rows]
        smooth = smooth_normals(*parts)
        normal[here], doubt[here] = smooth.normal, smooth.doubt
    return normal[node.ravel()], doubt[node.ravel()]


def _smooth_groups(facets: InterfaceFacets) -> Ints:
    """Label facet corners (3 f,): equal where facets around a vertex join by smooth edges."""
    f = len(facets.area)
    local = np.array([[1, 2], [0, 2], [0, 1]])
    edges = facets.vertices[:, local].reshape(-1, 2)
    side = np.repeat(np.column_stack([facets.interface, facets.bodies]), 3, axis=0)
    edge = np.unique(np.column_stack([side, edges]), axis=0, return_inverse=True)[1]
    count = np.bincount(edge)
    order = np.argsort(edge, kind="stable")
    start = (np.cumsum(count) - count)[count == 2]
    a, b = order[start], order[start + 1]
    # Normals in the middle of the edge, from those at its ends.
    ends = facets.normal[np.arange(f)[:, None, None], local].sum(axis=2).reshape(-1, 3)
    ends /= np.linalg.norm(ends, axis=1, keepdims=True)
    cosine = np.einsum("ei,ei->e", ends[a], ends[b])
    # Corner numbers of the two ends of the edge in either facet (vertices are sorted: ends agree).
    one, two = 3 * (a // 3)[:, None] + local[a % 3], 3 * (b // 3)[:, None] + local[b % 3]

    def joined_by(smooth: Bools) -> Ints:
        return connected(3 * f, one[smooth].ravel(), two[smooth].ravel())

    smooth = cosine > np.cos(FACE_ANGLE)
    coarse = ~smooth & (cosine > np.cos(COARSE_ANGLE)) & facets.straight[a // 3]
    if coarse.any():
        _, doubt = _normals_of_surface(facets, joined_by(smooth | coarse))
        smooth |= coarse & (doubt[one] < EXACT).all(axis=1)
    return joined_by(smooth)


def _distinct(normals: Floats, areas: Floats) -> Floats:
    """At most three independent faces: the largest kept, the others merged into the nearest.

    They are in the order of their areas, equal ones in that of the mesh, whatever the axes are.
    """
    order: Ints = np.argsort(-np.round(areas, 9), kind="stable").astype(np.int64)
    ns: list[Floats] = []
    sums: list[Floats] = []
    for row in map(int, order):
        n, area = np.asarray(normals[row]), float(areas[row])
        candidate = np.array([*ns, n])
        if len(ns) < MAX_FACES and np.linalg.det(candidate @ candidate.T) > INDEPENDENT:
            ns.append(n)
            sums.append(area * n)
            continue
        k = int(np.argmax(np.array(ns) @ n))
        if ns[k] @ n > 0:
            sums[k] = sums[k] + area * n
            ns[k] = sums[k] / np.linalg.norm(sums[k])
    return np.array(ns)


def drop_held(normals: Floats, faces: Ints, held: Floats) -> None:
    """Project constrained directions out of the normals, in place; empty faces are dropped.

    ``held`` are projectors on the constrained directions of each point (n, 3, 3).
    """
    for p in np.flatnonzero(held.any(axis=(1, 2))):
        ns = normals[p, : faces[p]] @ (np.eye(3) - held[p])
        size = np.linalg.norm(ns, axis=1)
        left = size > INDEPENDENT
        normals[p], faces[p] = 0, 0
        if left.any():
            kept = _distinct(ns[left] / size[left, None], np.ones(left.sum()))
            normals[p, : len(kept)], faces[p] = kept, len(kept)


def projectors(axes: Floats, which: Bools | Floats) -> Floats:
    """Sums (n, 3, 3) of projectors on axes, which are columns (n, 3, 3), by weights (n, 3)."""
    return np.asarray(np.einsum("nic,nc,njc->nij", axes, which, axes))


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
            along = np.einsum("fki,fi->fk", normals[corner], n)
            rows, best = np.arange(len(n)), np.abs(along).argmax(axis=1)
            off = n * np.sign(along[rows, best])[:, None] - normals[corner, best]
            np.add.at(total, corner, size[:, None, None] * off[:, :, None] * off[:, None, :])
            np.add.at(area, corner, size)
    return total / np.where(area > 0, area, 1.0)[:, None, None]
