"""Shape functions of triangles and tetrahedra in each order of nodes."""

from __future__ import annotations

import numpy as np
import pytest

from meshes import shape_functions as sf
from meshes.facets import NODES, facet_shape_functions

# Number of vertices and edges of the elements.
ORDERS = {
    "straight triangle": (3, sf.STRAIGHT),
    "gmsh's triangle": (3, sf.GMSH_TRIANGLE),
    "opposite nodes": (3, sf.OPPOSITE_TRIANGLE),
    "straight tetrahedron": (4, sf.STRAIGHT),
    "gmsh's tetrahedron": (4, sf.GMSH_TETRAHEDRON),
    "VTK's tetrahedron": (4, sf.VTK_TETRAHEDRON),
}
of_each_order = pytest.mark.parametrize(("vertices", "edges"), ORDERS.values(), ids=ORDERS)


@of_each_order
def test_shape_functions_are_one_at_their_node(vertices: int, edges: sf.Edges) -> None:
    corners = np.eye(vertices)
    nodes = np.vstack([corners, *(corners[[i, j]].mean(axis=0) for i, j in edges)])
    assert sf.shape_functions(nodes, edges) == pytest.approx(np.eye(len(nodes)))


@of_each_order
def test_shape_functions_have_slopes_of_differences(vertices: int, edges: sf.Edges) -> None:
    """Central differences are exact for quadratic functions."""
    points = np.random.default_rng(3).dirichlet(np.ones(vertices), 5)
    slopes = sf.slopes_of_shape_functions(points, edges)
    for k in range(1, vertices):
        step = 0.1 * (np.eye(vertices)[k] - np.eye(vertices)[0])
        ahead, behind = (sf.shape_functions(points + s * step, edges) for s in (1, -1))
        assert slopes[:, :, k - 1] == pytest.approx((ahead - behind) / 0.2, abs=1e-12)
    assert slopes.sum(axis=1) == pytest.approx(0, abs=1e-12)


def test_shape_functions_of_facets_have_nodes_opposite_vertices() -> None:
    assert facet_shape_functions(NODES, 6) == pytest.approx(np.eye(6))
    assert facet_shape_functions(NODES, 3) is NODES


@pytest.mark.parametrize("edges", [sf.GMSH_TRIANGLE, sf.GMSH_TETRAHEDRON])
def test_shape_functions_coordinates_in_curved_elements_give_back_the_points(
    edges: sf.Edges,
) -> None:
    """Elements whose middle nodes are moved by up to a twentieth of an edge."""
    rng = np.random.default_rng(5)
    vertices = max(max(edge) for edge in edges) + 1
    reference = np.vstack([np.zeros(vertices - 1), np.eye(vertices - 1)])
    middles = np.stack([reference[[i, j]].mean(axis=0) for i, j in edges])
    nodes = np.tile(np.vstack([reference, middles]), (20, 1, 1))
    nodes[:, vertices:] += rng.uniform(-0.05, 0.05, (20, len(edges), vertices - 1))
    barycentric = rng.dirichlet(np.ones(vertices), 20)
    x = np.einsum("na,nai->ni", sf.shape_functions(barycentric, edges), nodes)
    start = np.full((20, vertices), 1 / vertices)
    found = sf.coordinates_in_curved(x, nodes, start, edges)
    assert found == pytest.approx(barycentric, abs=1e-12)
