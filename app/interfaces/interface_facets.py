"""Facets of interfaces, on every rank in the same order for any partition."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from app.foundation.arrays import Bools, Floats, Ints
from meshes.facets import normals_and_areas

if TYPE_CHECKING:
    from mpi4py import MPI

# Edges are straight if their middles are closer to the chord than this fraction of its length.
STRAIGHT = 1e-9
# Three points that integrate second-order polynomials on a triangle (barycentric, equal weights).
QUADRATURE = np.full((3, 3), 1 / 6) + np.eye(3) / 2


@dataclass(frozen=True)
class InterfaceFacets:
    """Facets of interfaces, replicated on all ranks in canonical order.

    Attributes:
        interface: Index of the interface (f,).
        vertices: Vertex numbers of the mesh file, ascending (f, 3).
        bodies: Bodies on the master and on the slave side (f, 2).
        dofs: Global blocked dofs at the vertices, then at the edges opposite them (f, 3 or 6).
        nodes: Coordinates of the vertices, then of the middles of curved edges (f, 3 or 6, 3) [mm].
        normal: Unit normal from master to slave at each vertex (f, 3, 3).
        area: Integral of the linear shape function of each vertex (f, 3) [mm2].
        stiffness: Moduli of the master and the slave cell (f, 2) [MPa].
        rounded_angle: Angle up to which straight facets at an edge stand for a rounded one (f,)
            [rad].
    """

    interface: Ints
    vertices: Ints
    bodies: Ints
    dofs: Ints
    nodes: Floats
    normal: Floats
    area: Floats
    stiffness: Floats
    rounded_angle: Floats

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
        deviation = np.linalg.norm(self.nodes[:, 3:] - (start + end) / 2, axis=2)
        bent = (deviation > STRAIGHT * np.linalg.norm(end - start, axis=2)).any(axis=1)
        return ~np.isin(self.interface, self.interface[bent])


def gathered_arrays(comm: MPI.Comm, *arrays: NDArray) -> list[NDArray]:
    """Concatenate each array over the ranks, on every rank; collective."""
    arrays_of_ranks = comm.allgather(arrays)
    return [np.concatenate(parts) for parts in zip(*arrays_of_ranks, strict=True)]


def sorted_facets(
    interface: Ints,
    vertices: Ints,
    bodies: Ints,
    dofs: Ints,
    nodes: Floats,
    inside_slave: Floats,
    stiffness: Floats,
    rounded_angle: Floats,
) -> InterfaceFacets:
    """Facets of all ranks in an order that does not depend on the partition.

    The arguments are the attributes of `InterfaceFacets`, with facets and their vertices in any
    order. ``inside_slave`` is a point in each slave cell (f, 3) [mm].
    """
    # Sort the vertices of each facet, then the facets by interface and vertices.
    order = np.argsort(vertices, axis=1)
    vertices = np.take_along_axis(vertices, order, axis=1)
    rows = np.lexsort((*vertices.T[::-1], interface))
    vertices = vertices[rows]
    # The middle of an edge has the position of the opposite vertex, plus 3.
    order = np.concatenate([order, order + 3], axis=1)[rows]
    dofs = np.take_along_axis(dofs[rows], order[:, : dofs.shape[1]], axis=1)
    x = np.take_along_axis(nodes[rows], order[:, : nodes.shape[1], None], axis=1)
    flat_normals = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    # +1 if the normal by the order of the vertices is directed to the slave, else -1.
    sign = np.sign(np.einsum("fi,fi->f", flat_normals, inside_slave[rows] - x[:, 0]))
    _, area = normals_and_areas(x, QUADRATURE)
    return InterfaceFacets(
        interface=interface[rows],
        vertices=vertices,
        bodies=bodies[rows],
        dofs=dofs,
        nodes=x,
        normal=normals_and_areas(x, np.eye(3))[0] * sign[:, None, None],
        area=np.einsum("fq,qi->fi", area, QUADRATURE) / (2 * len(QUADRATURE)),
        stiffness=stiffness[rows],
        rounded_angle=rounded_angle[rows],
    )
