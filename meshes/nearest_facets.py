"""Flat triangles of facets, and the triangles nearest to points."""

from __future__ import annotations

import numpy as np

from app.foundation.arrays import Floats, Ints
from meshes.facets import OPPOSITE, facet_shape_functions, foot

# Number of parts into which the edges of curved facets are divided.
EDGE_PARTS = 3
# Number of candidates for the nearest triangle.
CANDIDATES = 12
# Triangles whose longest edge exceeds this multiple of the median have more samples.
LARGE_FACTOR = 2.0


def triangles(points: Floats, facets: Ints, parts: int = EDGE_PARTS) -> Floats:
    """Flat triangles (n, 3, 3) [mm] of facets, approximate for curved ones."""
    if facets.shape[1] == 3:
        return points[facets]
    nodes = [(i, j) for i in range(parts + 1) for j in range(parts + 1 - i)]
    row = {node: k for k, node in enumerate(nodes)}
    corners = [[(i, j), (i + 1, j), (i, j + 1)] for i, j in nodes if i + j < parts]
    corners += [[(i + 1, j), (i + 1, j + 1), (i, j + 1)] for i, j in nodes if i + j < parts - 1]
    barycentric = np.array([(i, j, parts - i - j) for i, j in nodes]) / parts
    x = points[facets[:, OPPOSITE]]
    fine = np.einsum("qn,fni->fqi", facet_shape_functions(barycentric, 6), x)
    return fine[:, [[row[node] for node in corner] for corner in corners]].reshape(-1, 3, 3)


def _samples(surface: Floats) -> tuple[Floats, Ints]:
    """Points (k, 3) all over triangles (m, 3, 3) [mm], and the triangle of each (k,).

    They are vertices, middles of edges and centres. Triangles that are larger than most, such as
    those of the flat sides of a stem from CAD, have more points at about the same distance.
    """
    a, b, c = surface.transpose(1, 0, 2)
    samples = [a, b, c, (a + b) / 2, (b + c) / 2, (c + a) / 2, (a + b + c) / 3]
    triangle_of: list[Ints] = [np.arange(len(surface))] * len(samples)
    longest = np.sqrt(((surface - np.roll(surface, 1, axis=1)) ** 2).sum(axis=2)).max(axis=1)
    division_counts = np.ceil(longest / (LARGE_FACTOR * np.median(longest))).astype(np.int64)
    for divisions in np.unique(division_counts[division_counts > 1]):
        barycentric = _corners_and_centres(int(divisions))
        large = np.flatnonzero(division_counts == divisions)
        samples.append((barycentric @ surface[large]).reshape(-1, 3))
        triangle_of.append(np.repeat(large, len(barycentric)))
    return np.concatenate(samples), np.concatenate(triangle_of)


def _corners_and_centres(divisions: int) -> Floats:
    """Barycentric coordinates (k, 3) of the parts of a triangle divided n times along each side.

    They are multiples of 1 / (3 n). Those of a corner are multiples of 3 in this unit. Those of a
    centre, the mean of three corners, have all the remainder 1 or all the remainder 2.
    """
    n = 3 * divisions
    grid = [(i, j, n - i - j) for i in range(n + 1) for j in range(n + 1 - i)]
    samples = [triple for triple in grid if len({k % 3 for k in triple}) == 1]
    return np.array(samples) / n


def distance_from_triangles(points: Floats, surface: Floats) -> Floats:
    """Distance of points (n, 3) from the triangles (m, 3, 3) nearest to them [mm]."""
    triangle, barycentric = nearest(points, surface)
    return np.linalg.norm(np.einsum("nk,nki->ni", barycentric, surface[triangle]) - points, axis=1)


def nearest(points: Floats, surface: Floats) -> tuple[Ints, Floats]:
    """Nearest triangle (m, 3, 3) of each point (n, 3), and barycentric coordinates there (n, 3)."""
    from scipy.spatial import cKDTree  # 0.1 s, which most runs do without

    samples, triangle_of = _samples(surface)
    _, candidates = cKDTree(samples).query(points, k=min(CANDIDATES, len(samples)))
    nearest_triangle = np.zeros(len(points), dtype=np.int64)
    least_distance = np.full(len(points), np.inf)
    barycentric = np.zeros((len(points), 3))
    for candidate in triangle_of[candidates].T:
        foot_weights = foot(points, surface[candidate])
        distances = np.linalg.norm(
            np.einsum("nk,nki->ni", foot_weights, surface[candidate]) - points, axis=1
        )
        is_nearer = distances < least_distance
        nearest_triangle[is_nearer], least_distance[is_nearer], barycentric[is_nearer] = (
            candidate[is_nearer],
            distances[is_nearer],
            foot_weights[is_nearer],
        )
    return nearest_triangle, barycentric
