"""Sides of interfaces with finite sliding: the surfaces of two bodies meshed apart."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from dolfinx import fem

from app.foundation.arrays import Floats, Ints
from app.interfaces.interface_facets import gathered_arrays
from app.mechanics.analytical_surfaces import AnalyticalSurface, fit_surface
from app.mechanics.pairs import SmoothSurface, orient
from app.scene.bodies import boundary_facets, facet_nodes
from meshes.distribute import TaggedMesh
from meshes.facets import bends_of_edges


@dataclass(frozen=True)
class Side:
    """Surface of a body at an interface with finite sliding, replicated.

    Attributes:
        dofs: Global blocked dofs of its vertices (n,), which are in the order of their numbers.
        x: Their positions (n, 3) [mm].
        triangles: Vertices of its facets, counterclockwise seen from outside (f, 3).
        outward: A vector out of the body for each facet (f, 3).
        edges: Dof of the middle of each edge, and its two vertices (e, 3); none at first order.
        halves: Matrices from the displacements of the two vertices to that of the middle
            (2, e, 3, 3).
    """

    dofs: Ints
    x: Floats
    triangles: Ints
    outward: Floats
    edges: Ints
    halves: Floats

    @classmethod
    def of(cls, tagged: TaggedMesh, space: fem.FunctionSpace, boundary: str) -> Side:
        """Gather a boundary on every rank; collective."""
        nodes = facet_nodes(tagged, space, boundary_facets(tagged, boundary))
        numbers, dofs, x, inside = gathered_arrays(tagged.mesh.comm, *nodes)
        # The same on any number of ranks.
        order = np.lexsort(np.sort(numbers, axis=1).T)
        numbers, dofs, x, inside = numbers[order], dofs[order], x[order], inside[order]
        _, first_rows, vertex = np.unique(numbers, return_index=True, return_inverse=True)
        vertices, triangles = dofs[:, :3].ravel()[first_rows], vertex.reshape(-1, 3)
        # The middle of an edge of a facet is opposite its vertex of the same number.
        edge_ends = triangles[:, [[1, 2], [2, 0], [0, 1]]]
        edges = np.concatenate([dofs[:, 3:, None], edge_ends[:, : dofs.shape[1] - 3]], axis=2)
        _, first_edge = np.unique(edges[..., 0], return_index=True)
        edges, middle = edges.reshape(-1, 3)[first_edge], x[:, 3:].reshape(-1, 3)
        outward, x = x[:, 0] - inside, x[:, :3].reshape(-1, 3)[first_rows]
        a, b = x[edges[:, 1:]].transpose(1, 0, 2)
        bending = bends_of_edges(a, b, middle[first_edge] if len(middle) else (a + b) / 2)
        halves = np.eye(3) / 2 + np.stack([-bending, bending])
        return cls(vertices, x, orient(x, triangles, outward), outward, edges, halves)

    @cached_property
    def smooth(self) -> SmoothSurface:
        """The smooth surface that its facets approximate."""
        return SmoothSurface(self.x, self.triangles, self.outward)

    @cached_property
    def surface(self) -> AnalyticalSurface | SmoothSurface:
        """The surface that gaps and normals are computed from: by formula if it has one."""
        corners = self.x[self.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1)[:, None]
        analytical = fit_surface(corners.reshape(-1, 3), np.repeat(normals, 3, axis=0))
        return analytical or self.smooth
