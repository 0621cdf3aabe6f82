"""Facets of contact interfaces, on every rank in the same order for any partition."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from app.arrays import Floats, Ints

if TYPE_CHECKING:
    from mpi4py import MPI

# Three points that integrate second-order polynomials on a triangle (barycentric, equal weights).
QUADRATURE = np.full((3, 3), 1 / 6) + np.eye(3) / 2
# The vertices of a triangle, and the middles of the edges opposite them.
NODES = np.concatenate([np.eye(3), (1 - np.eye(3)) / 2])


@dataclass(frozen=True)
class InterfaceFacets:
    """Facets of the contact interfaces, replicated on all ranks in canonical order.

    Attributes:
        interface: Index of the interface (f,).
        vertices: Vertex numbers of the mesh file (f, 3).
        master: Body on the master side (f,).
        slave: Body on the slave side (f,).
        vertex_dofs: Global blocked dof at each vertex (f, 3).
        edge_dofs: Global blocked dof at each edge (f, 3), edge k opposite vertex k; (f, 0) for P1.
        x: Vertex coordinates (f, 3, 3) [mm].
        normal: Unit normal from master to slave at each vertex (f, 3, 3).
        area: Integral of the linear shape function of each vertex (f, 3) [mm2].
        bend: Offset of the middle of each edge, opposite vertex k, from its chord (f, 3, 3) [mm];
            (f, 0, 3) for flat facets.
        stiffness: Moduli of the master and the slave cell (f, 2) [MPa].
    """

    interface: Ints
    vertices: Ints
    master: Ints
    slave: Ints
    vertex_dofs: Ints
    edge_dofs: Ints
    x: Floats
    normal: Floats
    area: Floats
    bend: Floats
    stiffness: Floats

    @property
    def nodes(self) -> Floats:
        """Coordinates of the nodes (f, 3 or, where facets are curved, 6, 3) [mm]."""
        chords = (self.x[:, [1, 2, 0]] + self.x[:, [2, 0, 1]]) / 2
        return np.concatenate([self.x, chords[:, : self.bend.shape[1]] + self.bend], axis=1)


def gather(comm: MPI.Comm, *arrays: NDArray) -> list[NDArray]:
    """Concatenate each array over the ranks, on every rank."""
    pieces = comm.allgather(arrays)
    return [np.concatenate([p[k] for p in pieces]) for k in range(len(arrays))]


def sorted_facets(
    comm: MPI.Comm,
    interface: Ints,
    vertices: Ints,
    bodies: Ints,
    dofs: tuple[Ints, Ints],
    x: Floats,
    inside_slave: Floats,
    stiffness: Floats,
) -> InterfaceFacets:
    """Gather the facets of every rank and put them in canonical order.

    Args:
        comm: Communicator.
        interface: Index of the interface (f,).
        vertices: Vertex numbers of the mesh file (f, 3).
        bodies: Bodies on the master and on the slave side (f, 2).
        dofs: Global blocked dofs at the vertices (f, 3) and at the edges opposite them (f, 3) or
            (f, 0).
        x: Coordinates of the vertices (f, 3, 3), and where cells are curved of the middles of the
            edges opposite them (f, 6, 3) [mm].
        inside_slave: A point inside the slave cell (f, 3) [mm].
        stiffness: Modulus of the master and of the slave cell (f, 2) [MPa].
    """
    interface, vertices, bodies, vertex_dofs, edge_dofs, x, inside_slave, stiffness = gather(
        comm, interface, vertices, bodies, *dofs, x, inside_slave, stiffness
    )
    # The three vertices of a facet in rising order, then the facets by interface and vertices.
    order = np.argsort(vertices, axis=1)
    vertices = np.take_along_axis(vertices, order, axis=1)
    vertex_dofs = np.take_along_axis(vertex_dofs, order, axis=1)
    if edge_dofs.shape[1]:
        edge_dofs = np.take_along_axis(edge_dofs, order, axis=1)
    both = np.concatenate([order + k for k in range(0, x.shape[1], 3)], axis=1)
    x = np.take_along_axis(x, both[:, :, None], axis=1)
    rows = np.lexsort((vertices[:, 2], vertices[:, 1], vertices[:, 0], interface))
    vertices, x, inside_slave = vertices[rows], x[rows], inside_slave[rows]
    flat = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    towards = np.sign(np.einsum("fi,fi->f", flat, inside_slave - x[:, 0]))
    at_corners, _ = surface(x, np.eye(3))
    chords = (x[:, [1, 2, 0]] + x[:, [2, 0, 1]]) / 2
    _, area = surface(x, QUADRATURE)
    return InterfaceFacets(
        interface=interface[rows],
        vertices=vertices,
        master=bodies[rows, 0],
        slave=bodies[rows, 1],
        vertex_dofs=vertex_dofs[rows],
        edge_dofs=edge_dofs[rows],
        x=x[:, :3],
        normal=at_corners * towards[:, None, None],
        area=np.einsum("fq,qi->fi", area, QUADRATURE) / (2 * len(QUADRATURE)),
        bend=x[:, 3:] - chords[:, : x.shape[1] - 3],
        stiffness=stiffness[rows],
    )


def surface(x: Floats, at: Floats) -> tuple[Floats, Floats]:
    """Unit normals (f, q, 3) and area elements (f, q) of facets at barycentric points (q, 3)."""
    # Derivatives of the shape functions by the barycentric coordinates (q, nodes, 3).
    d = np.broadcast_to(np.eye(3), (len(at), 3, 3))
    if x.shape[1] == 6:
        vertices = (4 * at[:, :, None] - 1) * np.eye(3)
        middles = 4 * at[:, [2, 0, 1]][:, :, None] * np.eye(3)[[1, 2, 0]]
        middles += 4 * at[:, [1, 2, 0]][:, :, None] * np.eye(3)[[2, 0, 1]]
        d = np.concatenate([vertices, middles], axis=1)
    t = np.einsum("qnk,fni->fqki", d, x)
    cross = np.cross(t[:, :, 1] - t[:, :, 0], t[:, :, 2] - t[:, :, 0])
    size = np.linalg.norm(cross, axis=2)
    return cross / size[:, :, None], size


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
