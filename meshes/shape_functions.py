r"""Shape functions of triangles and tetrahedra, straight or curved, in barycentric coordinates.

The nodes of an element are its vertices, then the middles of its edges if it is curved. With the
barycentric coordinates L of a point,

.. math:: N_k = L_k (2 L_k - 1), \qquad N_{ij} = 4 L_i L_j ,

and :math:`N_k = L_k` if the element is straight. Programs number the middles differently. So each
function takes the edges, pairs of vertices, in the order of the mid-side nodes. No edges means a
straight element.

====================  =======================  ================================================
order                 middles                  elements
====================  =======================  ================================================
GMSH_TRIANGLE         01 12 20                 facets of a `MeshData`, of strain gauges
OPPOSITE_TRIANGLE     12 20 01                 facets of interfaces: node 3 + k opposite vertex k
GMSH_TETRAHEDRON      01 12 02 03 23 13        cells of a `MeshData`
VTK_TETRAHEDRON       01 12 02 03 13 23        cells in the files of results
====================  =======================  ================================================
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from app.foundation.arrays import Floats

# Edges of an element in the order of their middle nodes, as pairs of vertices.
Edges = Sequence[tuple[int, int]]
STRAIGHT: Edges = ()
GMSH_TRIANGLE: Edges = ((0, 1), (1, 2), (2, 0))
OPPOSITE_TRIANGLE: Edges = ((1, 2), (2, 0), (0, 1))
GMSH_TETRAHEDRON: Edges = ((0, 1), (1, 2), (0, 2), (0, 3), (2, 3), (1, 3))
VTK_TETRAHEDRON: Edges = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
# Iterations of Newton's method in a curved element.
MOST_NEWTON_ITERATIONS = 12


def node_coordinates(vertices: int, edges: Edges) -> Floats:
    """Barycentric coordinates (v + e, v) of the nodes of an element with v vertices and e edges."""
    corners = np.eye(vertices)
    return np.vstack([corners, *(corners[[i, j]].mean(axis=0) for i, j in edges)])


def shape_functions(barycentric: Floats, edges: Edges) -> Floats:
    """Shape functions (q, v + e) [-] at points.

    Args:
        barycentric: Barycentric coordinates of the points by the v vertices (q, v).
        edges: The e edges in the order of their middle nodes; none for a straight element.
    """
    if not len(edges):
        return barycentric
    i, j = np.array(edges).T
    middles = 4 * barycentric[:, i] * barycentric[:, j]
    return np.concatenate([barycentric * (2 * barycentric - 1), middles], axis=1)


def slopes_of_shape_functions(barycentric: Floats, edges: Edges) -> Floats:
    """Derivatives dN/dLk - dN/dL0, k > 0, of the shape functions (q, v + e, v - 1) [-] at points.

    These are the derivatives with respect to the coordinates of the reference element, whose first
    vertex is the origin.

    Args:
        barycentric: Barycentric coordinates of the points by the v vertices (q, v).
        edges: The e edges in the order of their middle nodes; none for a straight element.
    """
    identity = np.eye(barycentric.shape[1])
    slopes = np.broadcast_to(identity, (len(barycentric), *identity.shape))
    if len(edges):
        i, j = np.array(edges).T
        middles = (
            4 * barycentric[:, j, None] * identity[i] + 4 * barycentric[:, i, None] * identity[j]
        )
        slopes = np.concatenate([(4 * barycentric[:, :, None] - 1) * identity, middles], axis=1)
    return np.asarray(slopes[:, :, 1:] - slopes[:, :, :1])


def coordinates_in_curved(x: Floats, nodes: Floats, start: Floats, edges: Edges) -> Floats:
    """Barycentric coordinates (n, v) of points (n, v - 1) in curved elements, by Newton's method.

    A point outside of its element may have no solution: its iterates stay near the element.

    Args:
        x: The points, one for each element.
        nodes: Nodes of the elements (n, v + e, v - 1).
        start: Barycentric coordinates at which the iterations begin (n, v).
        edges: The e edges in the order of their middle nodes.
    """
    barycentric = start
    for _ in range(MOST_NEWTON_ITERATIONS if len(x) else 0):
        residual = x - np.einsum("na,nai->ni", shape_functions(barycentric, edges), nodes)
        slopes = slopes_of_shape_functions(barycentric, edges)
        jacobian = np.einsum("naj,nai->nij", slopes, nodes)
        is_regular = np.abs(np.linalg.det(jacobian)) > 0
        step = np.zeros_like(residual)
        step[is_regular] = np.linalg.solve(jacobian[is_regular], residual[is_regular, :, None])[
            :, :, 0
        ]
        barycentric = barycentric + np.column_stack([-step.sum(axis=1), step])
        barycentric = np.clip(barycentric, -1.0, 2.0)
    return barycentric
