"""The cement mantle as meshed: thickness, clipped area, volume."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from app.arrays import Floats, Ints
from meshes.contact_facets import shape_functions
from meshes.data import MeshData, cell_volumes, facet_areas, interface_facets

CLIPPED = 0.9  # of the nominal thickness: thinner is where the canal had no room
PARTS = 3  # into which the edges of facets are divided, to follow their curvature
NEAREST = 12  # candidates for the nearest facet
# Evenly spread points in a tetrahedron, for its fraction below a level (barycentric).
LATTICE = np.array(
    [(i, j, k, 5 - i - j - k) for i in range(6) for j in range(6 - i) for k in range(6 - i - j)]
)
LATTICE = (LATTICE + 0.25) / 6


def describe(data: MeshData, nominal: float, tip: float) -> dict[str, Any]:
    """Thickness and volume of the cement between interfaces stem_cement and cement_bone.

    Args:
        data: The mesh.
        nominal: Nominal thickness [mm].
        tip: Level of the stem's tip [mm]. The plug below it and the stem's face there, which has
            the plug before it, have no thickness.

    Returns:
        ``thickness`` [mm]: distance of the stem's surface from the bone's, with percentiles by the
        stem's area, and the part of that area where it is below `CLIPPED` of the nominal one;
        ``volume`` of the cement and ``plug_volume`` below the tip [mm^3].
    """
    facets, _, _ = interface_facets(data, "stem_cement")
    facets = facets[data.points[facets[:, :3], 2].max(axis=1) > tip + 1e-6]
    stem = triangles(data.points, facets)
    area = facet_areas(stem.reshape(-1, 3), np.arange(3 * len(stem)).reshape(-1, 3))
    bone = triangles(data.points, interface_facets(data, "cement_bone")[0])
    away = distance(stem.mean(axis=1), bone)
    order = np.argsort(away)
    share = (np.cumsum(area[order]) - 0.5 * area[order]) / area.sum()
    p5, median, p95 = np.interp([0.05, 0.5, 0.95], share, away[order])
    cells = data.cells[data.cell_tags == data.regions["cement"]]
    volumes = cell_volumes(data.points, cells)
    z = data.points[cells[:, :4], 2]
    below = (z.max(axis=1) < tip).astype(float)
    cut = (z.min(axis=1) < tip) & (z.max(axis=1) >= tip)
    below[cut] = (z[cut] @ LATTICE.T < tip).mean(axis=1)
    return {
        "thickness": {
            "nominal": nominal,
            "min": float(away.min()),
            "p5": float(p5),
            "median": float(median),
            "mean": float(np.average(away, weights=area)),
            "p95": float(p95),
            "max": float(away.max()),
            "clipped_fraction": float(area[away < CLIPPED * nominal].sum() / area.sum()),
        },
        "volume": float(volumes.sum()),
        "plug_volume": float(volumes @ below),
    }


def triangles(points: Floats, facets: Ints) -> Floats:
    """Flat triangles (n, 3, 3) [mm] of facets, approximate for curved ones."""
    if facets.shape[1] == 3:
        return points[facets]
    nodes = [(i, j) for i in range(PARTS + 1) for j in range(PARTS + 1 - i)]
    row = {node: k for k, node in enumerate(nodes)}
    corners = [[(i, j), (i + 1, j), (i, j + 1)] for i, j in nodes if i + j < PARTS]
    corners += [[(i + 1, j), (i + 1, j + 1), (i, j + 1)] for i, j in nodes if i + j < PARTS - 1]
    at = np.array([(i, j, PARTS - i - j) for i, j in nodes]) / PARTS
    # `shape_functions` has the middle of 12 before that of 20 and 01.
    x = points[facets[:, [0, 1, 2, 4, 5, 3]]]
    fine = np.einsum("qn,fni->fqi", shape_functions(at, 6), x)
    return fine[:, [[row[node] for node in corner] for corner in corners]].reshape(-1, 3, 3)


def distance(points: Floats, surface: Floats) -> Floats:
    """Distance of points (n, 3) from the triangles (m, 3, 3) nearest to them [mm]."""
    a, b, c = surface.transpose(1, 0, 2)
    # Candidates by the distance to vertices, edge middles and centres.
    samples = np.concatenate([a, b, c, (a + b) / 2, (b + c) / 2, (c + a) / 2, (a + b + c) / 3])
    _, found = cKDTree(samples).query(points, k=NEAREST)
    found = found % len(surface)
    return np.min([_to_triangle(points, a[f], b[f], c[f]) for f in found.T], axis=0)


def _to_triangle(p: Floats, a: Floats, b: Floats, c: Floats) -> Floats:
    """Distance of each point p from the triangle a, b, c; all of shape (n, 3)."""
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1)
    result = np.abs(np.sum((p - a) * normal, axis=1)) / size
    inside = np.ones(len(p), dtype=bool)
    edges = np.full(len(p), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        side = end - start
        inside &= np.sum(np.cross(side, p - start) * normal, axis=1) >= 0
        s = np.clip(np.sum((p - start) * side, axis=1) / np.sum(side * side, axis=1), 0.0, 1.0)
        edges = np.minimum(edges, np.linalg.norm(p - start - s[:, None] * side, axis=1))
    return np.where(inside, result, edges)
