"""Contact points: where the two sides of an interface can part, on a conforming mesh.

A contact point is a mesh vertex seen from one interface. It carries the jump of that interface (the
displacement of the slave side minus that of the master side), the normals of its faces (facets that
meet at less than 30 degrees are one face; a vertex on an edge has two faces, on a corner three) and
its area: for each facet around it the integral of its linear shape function, a third of the
facet where it is flat. On curved cells normals are those of the curved facets, so that a smooth
surface is one face however coarse the mesh. Straight facets have the normals of the smooth surface
that is fitted to their vertices (`meshes.smooth_normals`): the force of a point is that of the
facets around it, whatever the direction in which its law acts.

Rules where things meet, for each displacement component of a vertex:

* The displacement of one body, the base, is the continuous field u itself; every other body there
  adds jumps to it. The base is a body that a support holds in this component, otherwise the stiffer
  one, of equals the master: a jump that moves the softer side meets about what it meets in truth.
* A vertex with k bodies has k - 1 jumps: interfaces are taken in the order of the case file, and
  one that would close a cycle is not enforced at that vertex.
* Where supports hold both sides of a jump, the jump is given by them and the interface carries no
  reported force in that component; the normals drop it.
* The components are those along x, y, z, or along the axes of a vertex that has its own because a
  support holds it along another direction. The jumps themselves are along x, y, z everywhere.

All facets of the contact interfaces are gathered on every rank and sorted by the vertex numbers of
the mesh file, so that the result does not depend on the partition. They are few.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

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

# Parts of a jump below this are rounding.
ROUNDING = 1e-12


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
        weight: Area of the point (n,) [mm2].
        doubt: Standard error of the direction of its normals (n,) [rad].
        given: Supports (master, slave) that fix each component of the jump, -1 where it is free
            (n, 3, 2).
        axes: Axes of these components, as columns (n, 3, 3).
        triangles: For each interface, its facets as rows of contact points (f_i, 3).
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
    doubt: Floats
    given: Ints
    axes: Floats
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
        value: +1 or -1, halved at the edge nodes of second-order elements (m,).
    """

    body: Ints
    row: Ints
    column: Ints
    value: Floats


def contact_points(
    facets: InterfaceFacets, holds: Holds, interfaces: int, axes: Mapping[int, Floats]
) -> tuple[ContactPoints, Entries]:
    """Contact points of all interfaces, and the displacement of each body due to their jumps.

    ``interfaces`` is their number; ``axes`` (3, 3) are those of vertices that have their own.
    """
    facet = np.repeat(np.arange(len(facets.area)), 3)
    keys = np.column_stack([facets.interface[facet], facets.vertices.ravel(), facets.bodies[facet]])
    every, first, of = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    kept = _without_cycles(every)
    interface, vertex, *_ = every[kept].T
    bodies, n = every[kept, 2:], len(vertex)
    corner_point = np.where(kept, np.cumsum(kept) - 1, -1)[of]
    triangles = corner_point.reshape(-1, 3)
    normals, faces, weight, doubt = faces_around(facets, corner_point, n)
    stiffness = np.zeros((len(every), 2))
    np.maximum.at(stiffness, of, facets.stiffness[facet])
    given, signs = _jumps_at_vertices(vertex, bodies, stiffness[kept], holds)
    local_axes = np.tile(np.eye(3), (n, 1, 1))
    for p in np.flatnonzero(np.isin(vertex, list(axes))):
        local_axes[p] = axes[int(vertex[p])]
    drop_held(normals, faces, projectors(local_axes, given[:, :, 0] >= 0))
    whole = (triangles >= 0).all(axis=1)
    of_interface = [np.flatnonzero(whole & (facets.interface == i)) for i in range(interfaces)]
    points = ContactPoints(
        interface=interface,
        vertex=vertex,
        dof=facets.dofs[:, :3].ravel()[first][kept],
        x=facets.x.reshape(-1, 3)[first][kept],
        bodies=bodies,
        faces=faces,
        normals=normals,
        weight=weight,
        doubt=doubt,
        given=given,
        axes=local_axes,
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
    value = blocks[k, row, column]
    return points, Entries(body[k], 3 * node[k] + row, 3 * point[k] + column, value)


def _without_cycles(points: Ints) -> Bools:
    """Mask of the points kept: at each vertex a forest of bodies, earlier interfaces first.

    ``points`` are their interface, vertex, master and slave (n, 4).
    """
    kept = np.ones(len(points), dtype=bool)
    for rows in shared(points[:, 1]):
        group = {int(body): int(body) for body in points[rows, 2:].ravel()}
        for p in rows:
            a, b = (group[int(body)] for body in points[p, 2:])
            kept[p] = a != b
            group = {body: a if g == b else g for body, g in group.items()}
    return kept


def _jumps_at_vertices(
    vertex: Ints, sides: Ints, stiffness: Floats, holds: Holds
) -> tuple[Ints, Floats]:
    """Prescribed jumps, and how each body moves by the jumps, in the components of the vertices.

    Returns:
        ``given`` of ContactPoints; +1, -1 or 0 for each body, point and component (b, n, 3).
    """
    n = len(vertex)
    # The support that holds each side of each point, component by component.
    holding = zip(map(int, holds.vertex), map(int, holds.body), strict=True)
    table, free = dict(zip(holding, holds.support, strict=True)), np.full(3, -1)
    of_sides = zip(map(int, np.repeat(vertex, 2)), map(int, sides.ravel()), strict=True)
    side = np.array([table.get(at, free) for at in of_sides]).reshape(n, 2, 3)
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
