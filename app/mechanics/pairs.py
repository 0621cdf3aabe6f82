r"""Pairs of surfaces in finite sliding: closest points, dual mortar rows, smooth gaps and normals.

Points are in the axes of the master, so that its surface never changes and its trees are built
once. The slave's nodes follow the master by :math:`u_s = Π u_m`, with

.. math:: Π = D^{-1} M, \quad M_{jk} = \int ψ_j N_k(\hat x), \quad D_j = W_j = \int N_j,
          \quad ψ_j = 4 N_j - 1,

The integrals are over the slave's flat facets; x̂ is the point of the master closest to x. ψ is dual
to N on a facet. D is therefore diagonal, and rows of Π sum to 1 (Wohlmuth 2000).
"""

from __future__ import annotations

from itertools import permutations
from typing import NamedTuple

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints, unit_vectors
from meshes.facets import foot

CANDIDATES = 16  # facets, by the distance of their centres, among which the closest is sought
NEIGHBOURS = 13  # through which the quadric of a node is fitted
FACING_COSINE = 0.5  # -cosine of the angle of two normals that face each other, at least
RIM_TOLERANCE = 0.01  # of a facet's size: a point beyond the rim by less than this is above it
# Weights and two coordinates of points that integrate polynomials of degree 6 on a triangle
# (Dunavant 1985); every permutation of the three coordinates is a point.
DEGREE_6 = (
    (0.11678627572637937, 0.24928674517091042, 0.24928674517091042),
    (0.050844906370206817, 0.063089014491502228, 0.063089014491502228),
    (0.082851075618373575, 0.31035245103378440, 0.053145049844816947),
)


class Pairs(NamedTuple):
    """Rows of Π, and how much of each slave node has a master.

    Attributes:
        rows: Slave node of each entry, rising (e,).
        columns: Master node of each entry, each pair once (e,).
        values: Entries (e,).
        covered: Fraction of the area of each slave node that faces the master (n,) [-].
        mortar: True for mortar rows (n,), False for shape functions at the closest point.
    """

    rows: Ints
    columns: Ints
    values: Floats
    covered: Floats
    mortar: Bools


class SmoothSurface:
    """Triangulated surface of a body that approximates a smooth one.

    Attributes:
        x: Nodes (n, 3) [mm], all of them in a triangle.
        triangles: Nodes of the facets (f, 3), counterclockwise seen from outside.
        normals: Outward unit normals of the smooth surface at the nodes (n, 3).
        areas: Integrals of the nodes' linear shape functions (n,) [mm2].

    Args:
        outward: A vector out of the body for each facet (f, 3).
    """

    def __init__(self, x: Floats, triangles: Ints, outward: Floats) -> None:
        from scipy.spatial import cKDTree  # imported late: few runs need it

        self.x, self.triangles = x, orient(x, triangles, outward)
        vectors = _area_vectors(x[self.triangles])
        self._area = np.linalg.norm(vectors, axis=1)
        self.areas = _sum_by_node(triangles, np.repeat(self._area / 3, 3), len(x))
        neighbours = cKDTree(x).query(x, min(NEIGHBOURS + 1, len(x)))[1][:, 1:]
        self.normals = _fitted_normals(x, self.triangles, vectors, neighbours)
        centres = x[triangles].mean(axis=1)
        self._tree = cKDTree(centres)
        self._radius = np.linalg.norm(x[triangles] - centres[:, None], axis=2).max(axis=1)
        # Edges of one facet only, as the edge opposite each vertex (f, 3), and their nodes (n,).
        edges = np.sort(self.triangles[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2), axis=1)
        _, edge_number, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
        is_rim = count[edge_number.ravel()] == 1
        self._rim_edge = is_rim.reshape(-1, 3)
        self._rim_node = np.isin(np.arange(len(x)), edges[is_rim])

    def closest(self, points: Floats) -> tuple[Ints, Floats, Floats]:
        """Closest points of the surface: facet (p,), shape functions (p, 3), distance (p,) [mm].

        Distances are positive outside.
        """
        count = min(CANDIDATES, len(self.triangles))
        centre_distance, nearest = self._tree.query(points, range(1, count + 1))
        corners = self.x[self.triangles]
        facet, barycentric = np.zeros(len(points), dtype=np.int64), np.zeros((len(points), 3))
        smallest_distance = np.full(len(points), np.inf)
        for candidate, from_centre in zip(nearest.T, centre_distance.T, strict=True):
            # No facet is closer than its centre less its radius.
            rows = np.flatnonzero(from_centre - self._radius[candidate] < smallest_distance)
            foot_barycentric = foot(points[rows], corners[candidate[rows]])
            foot_points = np.einsum("pk,pki->pi", foot_barycentric, corners[candidate[rows]])
            distance = np.linalg.norm(points[rows] - foot_points, axis=1)
            is_closer = distance < smallest_distance[rows]
            closer_rows = rows[is_closer]
            facet[closer_rows], barycentric[closer_rows], smallest_distance[closer_rows] = (
                candidate[closer_rows],
                foot_barycentric[is_closer],
                distance[is_closer],
            )
        outward_distance = np.einsum(
            "pi,pi->p",
            points - self._mean(self.x, facet, barycentric),
            self.normal(facet, barycentric),
        )
        return facet, barycentric, np.copysign(smallest_distance, outward_distance)

    def _mean(self, nodal: Floats, facet: Ints, barycentric: Floats) -> Floats:
        return np.einsum("pk,pki->pi", barycentric, nodal[self.triangles[facet]])

    def normal(self, facet: Ints, barycentric: Floats) -> Floats:
        """Unit normals of the smooth surface at points of facets (p, 3)."""
        return unit_vectors(self._mean(self.normals, facet, barycentric))

    def faces(self, points: Floats, normals: Floats, facet: Ints, barycentric: Floats) -> Bools:
        """Mask of points (p,) whose outward unit normals (p, 3) face their closest points."""
        is_above = self.distance_beyond_rim(points, facet, barycentric) <= RIM_TOLERANCE * np.sqrt(
            self._area[facet]
        )
        return is_above & (
            np.einsum("pi,pi->p", self.normal(facet, barycentric), normals) < -FACING_COSINE
        )

    def distance_beyond_rim(self, points: Floats, facet: Ints, barycentric: Floats) -> Floats:
        """Distance of points beyond the rim, along the surface, 0 if above it (p,) [mm]."""
        normal = self.normal(facet, barycentric)
        offset = points - self._mean(self.x, facet, barycentric)
        tangential = offset - np.einsum("pi,pi,pj->pj", offset, normal, normal)
        at_rim = ((barycentric == 0) & self._rim_edge[facet]).any(axis=1)
        at_rim |= ((barycentric == 1) & self._rim_node[self.triangles[facet]]).any(axis=1)
        return np.where(at_rim, np.linalg.norm(tangential, axis=1), 0.0)

    def gap(self, points: Floats) -> tuple[Floats, Floats]:
        r"""Distance from the smooth surface (p,) [mm], positive outside, and its normal (p, 3).

        .. math:: g = (x - p)·n - \frac{\sum_i L_i (x_i - p)·n_i}{1 + |\sum_i L_i n_i|}

        p is the closest point of a flat facet, n_i are the normals at its vertices x_i. The smooth
        surface rises over the facet by about half of the rise of its tangent planes at the
        vertices. On spheres and cylinders the formula is exact.
        """
        facet, barycentric, _ = self.closest(points)
        mean = self._mean(self.normals, facet, barycentric)
        p = self._mean(self.x, facet, barycentric)
        size, nodes = np.linalg.norm(mean, axis=1), self.triangles[facet]
        rise = np.einsum(
            "pk,pki,pki->p", barycentric, self.x[nodes] - p[:, None], self.normals[nodes]
        )
        n = mean / size[:, None]
        return np.einsum("pi,pi->p", points - p, n) - rise / (1 + size), n

    def deposit(self, points: Floats, values: Floats) -> Floats:
        """Sums at the nodes (n, k) of values at points (p, k), by the closest points."""
        facet, barycentric, _ = self.closest(points)
        nodes, n = self.triangles[facet], len(self.x)
        return np.column_stack([_sum_by_node(nodes, barycentric * v[:, None], n) for v in values.T])

    def sample_density(
        self, density: Floats, quadrature: int = 12, x: Floats | None = None
    ) -> tuple[Floats, Floats]:
        """Points on the facets (p, 3) and the part there of integrals of densities (n, k) (p, k).

        Deposits from these points leave no holes on a surface of smaller facets. Points without a
        density are left out.

        Args:
            density: Densities at the nodes (n, k).
            quadrature: Points per facet: 12, 48, 192 ...
            x: Moved nodes (n, 3) [mm]; None if they have not moved.
        """
        barycentric, weight = triangle_rule(quadrature)
        has_density = density[self.triangles].any(axis=(1, 2))
        triangles = self.triangles[has_density]
        points = np.einsum("qk,fki->fqi", barycentric, (self.x if x is None else x)[triangles])
        facet_parts = np.einsum(
            "f,q,qk,fkv->fqv", self._area[has_density], weight, barycentric, density[triangles]
        )
        return points.reshape(-1, 3), facet_parts.reshape(-1, density.shape[1])


def orient(x: Floats, triangles: Ints, outward: Floats) -> Ints:
    """Triangles counterclockwise seen from where vectors (f, 3) point."""
    inverse = np.einsum("fi,fi->f", _area_vectors(x[triangles]), outward) < 0
    return np.where(inverse[:, None], triangles[:, ::-1], triangles)


def mortar(
    x: Floats, triangles: Ints, master: SmoothSurface, quadrature: int = 12, reach: float = np.inf
) -> Pairs:
    """Rows of Π.

    A node has a mortar row if all its facets face the master within ``reach`` [mm]. A row that the
    master covers in part would be wrong, not small.

    Args:
        x: Nodes of the slave in the axes of the master (n, 3) [mm].
        triangles: Facets of the slave, counterclockwise seen from outside (f, 3).
        master: The other surface.
        quadrature: Points per facet: 12, 48, 192 ...
        reach: Distance beyond which shape functions do, which have fewer entries [mm].
    """
    barycentric, weight = triangle_rule(quadrature)
    vectors = _area_vectors(x[triangles])
    area, node_count, point_count = np.linalg.norm(vectors, axis=1), len(x), len(weight)
    node_area = _sum_by_node(triangles, np.repeat(area / 3, 3), node_count)
    points = np.einsum("qk,fki->fqi", barycentric, x[triangles]).reshape(-1, 3)
    facet, master_barycentric, distance = master.closest(points)
    faces = master.faces(
        points, np.repeat(unit_vectors(vectors), point_count, axis=0), facet, master_barycentric
    )
    covered_area = np.einsum(
        "f,q,qk,fq->fk", area, weight, barycentric, faces.reshape(-1, point_count)
    )
    covered_fraction = _sum_by_node(triangles, covered_area, node_count) / node_area
    is_near = (faces & (np.abs(distance) <= reach)).reshape(-1, point_count).all(axis=1)
    is_mortar = ~np.isin(np.arange(node_count), triangles[~is_near])
    dual = (
        np.einsum("f,q,qk->fqk", area, weight, 4 * barycentric - 1) / node_area[triangles][:, None]
    )
    entries = dual[..., None] * master_barycentric.reshape(-1, point_count, 1, 3)
    rows = np.broadcast_to(triangles[:, None, :, None], entries.shape)
    columns = np.broadcast_to(master.triangles[facet].reshape(-1, point_count, 1, 3), entries.shape)
    in_mortar_row, other_nodes = is_mortar[rows], np.flatnonzero(~is_mortar)
    facet, master_barycentric, _ = master.closest(x[other_nodes])
    key = np.concatenate([rows[in_mortar_row], np.repeat(other_nodes, 3)]) * len(master.x)
    key += np.concatenate([columns[in_mortar_row], master.triangles[facet].ravel()])
    pair, entry_of_pair = np.unique(key, return_inverse=True)
    values = _sum_by_node(
        entry_of_pair,
        np.concatenate([entries[in_mortar_row], master_barycentric.ravel()]),
        len(pair),
    )
    return Pairs(*np.divmod(pair, len(master.x)), values, covered_fraction, is_mortar)


def triangle_rule(points: int) -> tuple[Floats, Floats]:
    """Points on a triangle (q, 3), barycentric, and weights that sum to 1 (q,).

    Of degree 6 on the triangle (12 points), or on the parts that halved edges make (48, 192 ...).
    """
    orbits = [sorted(set(permutations((a, b, 1 - a - b)))) for _, a, b in DEGREE_6]
    barycentric = np.concatenate(orbits)
    weight = np.repeat([w for w, _, _ in DEGREE_6], [len(orbit) for orbit in orbits])
    sub_triangles = [(1 - np.eye(3)) / 2, *((np.eye(3) + corner) / 2 for corner in np.eye(3))]
    while len(barycentric) < points:
        barycentric, weight = (
            np.concatenate([barycentric @ sub_triangle for sub_triangle in sub_triangles]),
            np.tile(weight / 4, 4),
        )
    return barycentric, weight / weight.sum()


def _fitted_normals(x: Floats, triangles: Ints, vectors: Floats, neighbours: Ints) -> Floats:
    """Unit normals (n, 3) at nodes of quadrics through them, fitted to near ones (n, k)."""
    n = unit_vectors(
        np.stack([_sum_by_node(triangles, np.repeat(v, 3), len(x)) for v in vectors.T], 1)
    )
    axes = np.linalg.svd(n[:, None])[2][:, 1:]  # two tangents of each node
    offset = x[neighbours] - x[:, None]
    offset /= np.linalg.norm(offset, axis=2).max(axis=1)[:, None, None]
    a, b = np.einsum("nki,nji->jnk", offset, axes)
    height = np.einsum("nki,ni->nk", offset, n)
    squares = a * a, a * b, b * b, a * height, b * height, height * height
    inverse_fit = np.linalg.pinv(np.stack([a, b, *squares], axis=2))
    slope = np.einsum("njk,nk->nj", inverse_fit[:, :2], height)
    return unit_vectors(n - np.einsum("nj,nji->ni", slope, axes))


def _area_vectors(corners: Floats) -> Floats:
    """Normals of triangles (f, 3, 3), as long as their areas (f, 3)."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2


def _sum_by_node(node: Ints, values: Floats, node_count: int) -> Floats:
    """Sums (n,) of values by place."""
    return np.bincount(node.ravel(), values.ravel(), node_count).astype(np.float64)
