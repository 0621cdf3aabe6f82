"""Geometry of triangular facets by their nodes: normals, areas, shape functions, feet of points."""

from __future__ import annotations

import numpy as np

from app.foundation.arrays import Floats
from meshes.data import tangents
from meshes.shape_functions import OPPOSITE_TRIANGLE, STRAIGHT, node_coordinates, shape_functions

# Nodes of a facet: its vertices, and the middles of the edges opposite them.
NODES = node_coordinates(3, OPPOSITE_TRIANGLE)
# Nodes of gmsh's facets in this order.
OPPOSITE = [0, 1, 2, 4, 5, 3]


def normals_and_areas(x: Floats, barycentric: Floats) -> tuple[Floats, Floats]:
    """Unit normals (f, q, 3) and area elements (f, q) of facets at barycentric points (q, 3)."""
    if x.shape[1] == 6:
        a, b = tangents(x, barycentric, OPPOSITE_TRIANGLE)
    else:
        edge_columns = (x[:, 1:] - x[:, :1]).transpose(1, 2, 0)[..., None]
        a, b = np.broadcast_to(edge_columns, (*edge_columns.shape[:3], len(barycentric)))
    normal = np.moveaxis(np.ascontiguousarray(np.cross(a, b, axis=0)), 0, -1)
    size = np.linalg.norm(normal, axis=2)
    return normal / size[:, :, None], size


def nodal_normals(x: Floats, inside: Floats, barycentric: Floats) -> Floats:
    """Outward normals (f, q, 3) at barycentric points (q, 3), as long as the facet areas [mm2].

    ``x`` are the nodes of the facets (f, 3 or 6, 3), ``inside`` points in their cells (f, 3) [mm].
    """
    normals, size = normals_and_areas(x, barycentric)
    flat_normals = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    outward = np.sign(np.einsum("fi,fi->f", flat_normals, x[:, 0] - inside))
    return normals * (outward * size.mean(axis=1) / 2)[:, None, None]


def facet_shape_functions(barycentric: Floats, nodes: int) -> Floats:
    """Shape functions of facets with 3 or 6 nodes at barycentric points (q, 3) -> (q, nodes).

    Node 3 + k of six is the middle of the edge opposite vertex k.
    """
    return shape_functions(barycentric, OPPOSITE_TRIANGLE if nodes == 6 else STRAIGHT)


def bends_of_edges(start: Floats, end: Floats, middle: Floats) -> Floats:
    r"""Factors by which the ends of curved edges move their middles, in addition to the mean.

    The middle is off the chord by the vector σ. Linear displacements change along σ too. With t the
    unit vector from end a to end b and L their distance, the displacement of the middle

    .. math:: u_m = (u_a + u_b) / 2 + (σ ⊗ t - t ⊗ σ) (u_b - u_a) / L

    is exact for translations, for rotations and for a widening in the plane of the edge. The result
    (e, 3, 3) is the factor of the difference u_b - u_a.
    """
    offset, chord = middle - (start + end) / 2, end - start
    outer_products = np.einsum("ei,ej->eij", offset, chord)
    length2 = np.einsum("ei,ei->e", chord, chord)
    return (outer_products - outer_products.transpose(0, 2, 1)) / length2[:, None, None]


def foot(x: Floats, corners: Floats) -> Floats:
    """Barycentric coordinates (n, 3) of the point of each triangle nearest to x (n, 3)."""
    edges, offsets = np.roll(corners, -1, axis=1) - corners, x[:, None] - corners
    fractions = np.einsum("nki,nki->nk", offsets, edges) / np.einsum("nki,nki->nk", edges, edges)
    # The foot of the perpendicular, if it is inside, from products of the edges a and b and of d,
    # which is from their common vertex to x.
    a, b, d = edges[:, 0], -edges[:, 2], offsets[:, 0]
    aa, ab, bb, da, db = (
        np.einsum("ni,ni->n", p, q) for p, q in ((a, a), (a, b), (b, b), (d, a), (d, b))
    )
    v, w = bb * da - ab * db, aa * db - ab * da
    inner = np.stack([aa * bb - ab**2 - v - w, v, w], axis=1) / (aa * bb - ab**2)[:, None]
    s = np.clip(fractions, 0.0, 1.0)[:, :, None]
    on_edges = (1 - s) * np.eye(3) + s * np.roll(np.eye(3), 1, axis=1)
    distances = np.linalg.norm(np.einsum("nek,nki->nei", on_edges, corners) - x[:, None], axis=2)
    edge = on_edges[np.arange(len(x)), distances.argmin(axis=1)]
    return np.where((inner >= 0).all(axis=1)[:, None], inner, edge)
