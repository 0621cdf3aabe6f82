"""Contact points: where the two sides of an interface can part, on a conforming mesh.

A contact point is a mesh vertex seen from one interface. It carries the jump of that interface (the
displacement of the slave side minus that of the master side), the normals of its faces (facets that
meet at less than 30 degrees are one face; a vertex on an edge has two faces, on a corner three) and
its area: for each facet around it the integral of its linear shape function, a third of the
facet where it is flat. On curved cells normals are those of the curved facets, so that a smooth
surface is one face however coarse the mesh.

Rules where things meet, for each displacement component of a vertex:

* The displacement of one body, the base, is the continuous field u itself; every other body there
  adds jumps to it. The base is a body that a support holds in this component, otherwise the stiffer
  one, of equals the master: a jump that moves the softer side meets about what it meets in truth.
* A vertex with k bodies has k - 1 jumps. Where more interfaces meet, the jump of one follows from
  the others; its neighbours stand in for it with its area (`meshes.redundant_points`).
* Where supports hold both sides of a jump, the jump is given by them and the interface carries no
  reported force in that component; the normals drop it. Friction knows the slip along it: where it
  is tangential to the faces, the law gives the force.
* The components are those along x, y, z, or along the axes of a vertex that has its own because a
  support holds it along another direction. The jumps themselves are along x, y, z everywhere.

All facets of the contact interfaces are gathered on every rank and sorted by the vertex numbers of
the mesh file, so that the result does not depend on the partition. They are few.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from app.arrays import Bools, Floats, Ints
from meshes.contact_facets import (
    InterfaceFacets,
    bends,
    drop_held,
    faces_around,
    projectors,
    shared,
)
from meshes.redundant_points import ROUNDING, meeting

# An axis is tangential to a face if its cosine with the normal is below this.
TANGENTIAL = 1e-6

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True)
class Holds:
    """Constrained displacement components of vertices, body by body, replicated.

    Attributes:
        vertex: Vertex numbers of the mesh file (h,).
        body: Body (h,).
        support: Index of the support of each component, -1 where it is free (h, 3).
    """

    vertex: Ints
    body: Ints
    support: Ints


@dataclass(frozen=True)
class Corners:
    """Corners of the facets: contact points (n), then those for which others stand in (l), m in all.

    Attributes:
        interface: Index of the interface (m,).
        dof: Global blocked dof at the vertex (m,).
        x: Position (m, 3) [mm].
        bodies: Bodies (master, slave) (m, 2).
        faces: Number of faces (m,).
        normals: Unit normals of the faces, zero beyond ``faces`` (m, 3, 3).
        near: Part that each of the others takes of values at points (l, n); None: there are none.
        jump: Jump of the others by those of the points (3 l, 3 n).
    """

    interface: Ints
    dof: Ints
    x: Floats
    bodies: Ints
    faces: Ints
    normals: Floats
    near: csr_array | None = None
    jump: csr_array | None = None

    def __len__(self) -> int:
        """Number of corners."""
        return len(self.x)

    def values(self, at_points: Floats) -> Floats:
        """Values (m, ...), interpolated from those at points (n, ...)."""
        if self.near is None:
            return at_points
        flat = at_points.reshape(len(at_points), -1)
        return np.concatenate([flat, self.near @ flat]).reshape(len(self), *at_points.shape[1:])

    def nearby(self, at_points: Ints) -> Ints:
        """Values (m,), from those at points (n,): of the others that of the nearest."""
        if self.near is None:
            return at_points
        return np.concatenate([at_points, at_points[self.near.argmax(axis=1).ravel()]])

    def only_points(self, at_points: Floats) -> Floats:
        """Values (m, ...) that add up over the points (n, ...): zero at the others."""
        none = np.zeros((len(self) - len(at_points), *at_points.shape[1:]))
        return np.concatenate([at_points, none])

    def jumps(self, at_points: Floats) -> Floats:
        """Jumps (m, 3) from those of points (n, 3): the mean ones there, of the others the true."""
        if self.jump is None:
            return at_points
        return np.concatenate([at_points, (self.jump @ at_points.ravel()).reshape(-1, 3)])


@dataclass(frozen=True)
class ContactPoints:
    """Contact points, replicated on all ranks in canonical order (n of them).

    Attributes:
        interface: Index of the interface (n,).
        vertex: Vertex number of the mesh file (n,).
        dof: Global blocked dof at the vertex (n,).
        x: Position (n, 3) [mm].
        bodies: Bodies (master, slave) (n, 2).
        faces: Number of faces, 1 to 3, or 0 where supports hold every component (n,).
        normals: Unit normals of the faces, zero beyond ``faces`` (n, 3, 3).
        weight: Area of the point, with what others hand to it (n,) [mm2].
        given: Supports (master, slave) that fix each component of the jump, -1 where it is free
            (n, 3, 2).
        axes: Axes of these components, as columns (n, 3, 3).
        along: Projectors on prescribed axes that are tangential to all faces (n, 3, 3).
        corners: The points, and the other corners of the facets.
        triangles: For each interface, its facets as rows of corners (f_i, 3).
        facets: For each interface, the numbers of these facets (f_i,).
    """

    interface: Ints
    vertex: Ints
    dof: Ints
    x: Floats
    bodies: Ints
    faces: Ints
    normals: Floats
    weight: Floats
    given: Ints
    axes: Floats
    along: Floats
    corners: Corners
    triangles: tuple[Ints, ...]
    facets: tuple[Ints, ...]

    @property
    def held(self) -> Bools:
        """Components of the jump prescribed by supports (n, 3)."""
        return self.given[:, :, 0] >= 0


@dataclass(frozen=True)
class Entries:
    """Displacement of bodies due to jumps, as triplets.

    Body b moves by u + B_b q with q the jumps, three per contact point.

    Attributes:
        body: Body (m,).
        row: Global unrolled dof (m,).
        column: 3 point + component (m,).
        value: +1 or -1, halved at the edge nodes of second-order elements, and parts of them where
            unknowns are mean jumps (m,).
    """

    body: Ints
    row: Ints
    column: Ints
    value: Floats


def contact_points(
    facets: InterfaceFacets, holds: Holds, names: Sequence[str], axes: Mapping[int, Floats]
) -> tuple[ContactPoints, Entries]:
    """Contact points of all interfaces, and the displacement of each body due to their jumps.

    ``names`` are those of the interfaces; ``axes`` (3, 3) are those of vertices that have their
    own.

    Raises:
        InputError: Others meet an interface at so many points that none is left.
    """
    facet = np.repeat(np.arange(len(facets.area)), 3)
    keys = np.column_stack([facets.interface[facet], facets.vertices.ravel(), facets.bodies[facet]])
    every, first, of = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    normals, faces, area = faces_around(facets, of, len(every))
    supports = _supports_of(every[:, 1], every[:, 2:], holds)
    prescribed: Bools = np.any(np.all(supports >= 0, axis=1), axis=1)
    kept, meet = meeting(facets, every, of, prescribed, normals, area, names)
    # Points first, then corners for which they stand in.
    order = np.argsort(~kept, kind="stable")
    place, n = np.argsort(order), int(kept.sum())
    triangles = place[of].reshape(-1, 3)
    normals, faces = normals[order], faces[order]
    interface, vertex, bodies = every[order, 0], every[order, 1], every[order, 2:]
    dof, x = facets.dofs[:, :3].ravel()[first][order], facets.x.reshape(-1, 3)[first][order]
    weight = area[kept] + (meet.share.sum(axis=0) if meet else 0.0)
    stiffness = np.zeros((len(every), 2))
    np.maximum.at(stiffness, of, facets.stiffness[facet])
    given, signs = _jumps_at_vertices(vertex[:n], bodies[:n], stiffness[kept], holds)
    local_axes = np.tile(np.eye(3), (n, 1, 1))
    for p in np.flatnonzero(np.isin(vertex[:n], list(axes))):
        local_axes[p] = axes[int(vertex[p])]
    held = projectors(local_axes, given[:, :, 0] >= 0)
    jumps, corners = None, Corners(interface, dof, x, bodies, faces, normals)
    if meet:
        at = [names[i] for i in interface[:n]]
        jumps = meet.jumps(weight, np.eye(3) - held, x[:n], at)
        corners = replace(corners, near=meet.near, jump=meet.ways_round(jumps))
    across = np.abs(np.einsum("pki,pic->pkc", normals[:n], local_axes)).max(axis=1)
    along = projectors(local_axes, (given[:, :, 0] >= 0) & (across < TANGENTIAL))
    drop_held(normals[:n], faces[:n], held)
    of_interface = [np.flatnonzero(facets.interface == i) for i in range(len(names))]
    points = ContactPoints(
        interface=interface[:n],
        vertex=vertex[:n],
        dof=dof[:n],
        x=x[:n],
        bodies=bodies[:n],
        faces=faces[:n],
        normals=normals[:n],
        weight=weight,
        given=given,
        axes=local_axes,
        along=along,
        corners=corners,
        triangles=tuple(triangles[f] for f in of_interface),
        facets=tuple(of_interface),
    )
    # From the axes of the points to x, y, z.
    body, point = np.nonzero(signs.any(axis=2))
    blocks = projectors(points.axes[point], signs[body, point])
    blocks[np.abs(blocks) < ROUNDING] = 0.0
    moves = [(body, points.dof[point], point, blocks)]
    if facets.dofs.shape[1] == 6:
        moves.append(_at_edges(facets, points, body, point, blocks))
    body, node, point, blocks = (np.concatenate(part) for part in zip(*moves, strict=True))
    k, row, column = np.nonzero(blocks)
    entries = Entries(body[k], 3 * node[k] + row, 3 * point[k] + column, blocks[k, row, column])
    return points, entries if jumps is None else _of_means(entries, jumps)


def _of_means(entries: Entries, jumps: csr_array) -> Entries:
    """Displacement of bodies by the mean jumps, from that by jumps, which are 3 n by 3 n of them."""
    from scipy.sparse import csr_array

    shape, parts = (int(entries.row.max()) + 1, jumps.shape[0]), []
    for b in np.unique(entries.body):
        here = entries.body == b
        at = entries.row[here], entries.column[here]
        moved = (csr_array((entries.value[here], at), shape=shape) @ jumps).tocoo()
        on = np.abs(moved.data) > ROUNDING
        row, column = moved.row[on].astype(np.int64), moved.col[on].astype(np.int64)
        parts.append((np.full(len(row), b), row, column, moved.data[on]))
    return Entries(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _supports_of(vertex: Ints, sides: Ints, holds: Holds) -> Ints:
    """Support that holds each side of points along each axis, -1 where none does (n, 2, 3)."""
    holding = zip(map(int, holds.vertex), map(int, holds.body), strict=True)
    table, free = dict(zip(holding, holds.support, strict=True)), np.full(3, -1)
    of_sides = zip(map(int, np.repeat(vertex, 2)), map(int, sides.ravel()), strict=True)
    return np.array([table.get(at, free) for at in of_sides]).reshape(len(vertex), 2, 3)


def _jumps_at_vertices(
    vertex: Ints, sides: Ints, stiffness: Floats, holds: Holds
) -> tuple[Ints, Floats]:
    """Prescribed jumps, and how each body moves by the jumps, in the components of the vertices.

    Returns:
        ``given`` of ContactPoints; +1, -1 or 0 for each body, point and component (b, n, 3).
    """
    n, side = len(vertex), _supports_of(vertex, sides, holds)
    held = side >= 0
    given = np.where(held.all(axis=1, keepdims=True), side, -1)
    # One interface at the vertex: the slave moves by +q, or the master by -q if the slave is the
    # base: it alone is held, both are and it comes first, or none is and it is stiffer.
    slave_is_base = held[:, 1] & (~held[:, 0] | (sides[:, 1] < sides[:, 0])[:, None])
    slave_is_base |= ~held.any(axis=1) & (stiffness[:, 1] > stiffness[:, 0])[:, None]
    signs = np.zeros((int(sides.max()) + 1, n, 3))
    signs[sides[:, 0], np.arange(n)] = -1.0 * slave_is_base
    signs[sides[:, 1], np.arange(n)] = ~slave_is_base
    for rows in shared(vertex):
        signs[:, rows] = 0.0
        for c in range(3):
            _tree(rows, sides, side[:, :, c], stiffness, given[:, :, c], signs[:, :, c])
    return given.transpose(0, 2, 1), signs


def _tree(
    rows: Ints, sides: Ints, support: Ints, stiffness: Floats, given: Ints, signs: Floats
) -> None:
    """Fill ``given`` and ``signs`` at a vertex with several interfaces, in one component.

    Walks the forest of bodies from a constrained body (the lowest), else from the stiffest.
    Between two constrained bodies every jump on the way is prescribed; a free body goes with the
    one it was reached from.
    """
    of, holding = sides[rows], support[rows]
    at = holding >= 0
    holder = dict(zip(map(int, of[at]), map(int, holding[at]), strict=True))
    bodies = dict.fromkeys(map(int, of.ravel()))
    stiffest = sorted(bodies, key=lambda b: float(stiffness[rows][of == b].max()), reverse=True)
    base: dict[int, int] = {}
    for root in (*sorted(holder), *stiffest):
        if root in base:
            continue
        base[root] = root
        for p in [*rows] * len(rows):  # as far as the longest chain
            master, slave = map(int, sides[p])
            for here, there, sign in ((master, slave, 1.0), (slave, master, -1.0)):
                if here in base and there not in base:
                    base[there] = root
                    signs[there, rows] = signs[here, rows]
                    signs[there, p] = sign
    for body in holder:
        for p in rows[signs[body, rows] != 0]:
            given[p] = [holder.get(int(b), holder[base[body]]) for b in sides[p]]


def _at_edges(
    facets: InterfaceFacets, points: ContactPoints, body: Ints, point: Ints, blocks: Floats
) -> tuple[Ints, Ints, Ints, Floats]:
    """Moves of edge nodes: the jump is linear along an edge, its middle takes half of both ends.

    That of a curved edge takes its `bends`, too: without, the opening of a cylinder is lost between
    its nodes at second order.

    Takes body, point and (3, 3) block of each move of a vertex; returns body, dof of the edge,
    point and block of each move of an edge node.
    """
    # Every (edge, body) of the interfaces once, with both ends; vertices are sorted, so that an
    # edge runs the same way in every facet.
    a, b = [1, 0, 0], [2, 2, 1]
    edges = np.stack([facets.dofs[:, 3:], facets.vertices[:, a], facets.vertices[:, b]], axis=2)
    of_sides = [
        np.column_stack([edges.reshape(-1, 3), np.repeat(side, 3)]) for side in facets.bodies.T
    ]
    rows, first = np.unique(np.concatenate(of_sides), axis=0, return_index=True)
    bend: Floats = np.zeros((len(rows), 3, 3))
    if facets.nodes.shape[1] == 6:
        corner = first % (3 * len(edges))
        start, end = (facets.x[:, k].reshape(-1, 3)[corner] for k in (a, b))
        bend = bends(start, end, facets.nodes[:, 3:].reshape(-1, 3)[corner])
    # A jump prescribed at both ends may be constrained in the middle too.
    known, one, number = np.unique(points.vertex, return_index=True, return_inverse=True)
    held = np.zeros((len(known), 3), dtype=bool)
    np.logical_or.at(held, number, points.held)
    at = projectors(points.axes[one], held)[np.searchsorted(known, rows[:, 1:3])]
    bend = (np.eye(3) - at[:, 0] @ at[:, 1]) @ bend
    middles = np.concatenate([np.eye(3) / 2 - bend, np.eye(3) / 2 + bend])
    # Of each (end, edge, body), the moves of the body at the end.
    stride = int(known[-1]) + 1
    key = body * stride + points.vertex[point]
    wanted = (rows[:, 3] * stride + rows[:, 1:3].T).ravel()
    order = np.argsort(key, kind="stable")
    low = np.searchsorted(key, wanted, "left", order)
    high = np.searchsorted(key, wanted, "right", order)
    end = np.repeat(np.arange(len(wanted)), high - low)
    inside = np.arange(len(end)) + (high - np.cumsum(high - low))[end]
    edge, move = rows[end % len(rows)], order[inside]
    return edge[:, 3], edge[:, 0], point[move], middles[end] @ blocks[move]
