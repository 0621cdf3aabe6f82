"""Contact points: where the two sides of an interface can part, on a conforming mesh.

A contact point is a mesh vertex seen from one interface. It carries:

* the jump of that interface: the displacement of the slave side minus that of the master side;
* the normals of its faces. Facets that meet at less than 30 degrees are one face. A vertex on an
  edge has two faces, on a corner three;
* its area: the integral of its linear shape function over the facets around it, a third of each
  flat facet.

On curved cells normals are those of the curved facets, so that a smooth surface is one face on any
mesh. Straight facets have the normals of the smooth surface
that is fitted to their vertices (`smooth_normals`). The law acts along these normals; area and
force are those of the facets around the point.

Rules where things meet, for each displacement component of a vertex:

* The displacement of one body, the base, is the continuous field u itself; every other body there
  adds jumps to it. The base is a rigid body, then a body that a support holds in this component,
  otherwise the stiffest one; if they are equally stiff, it is the master. A jump that moves the
  softer side has nearly the stiffness of the two bodies in contact.
* A vertex with k bodies has k - 1 jumps. If more interfaces meet, the jumps of some follow from
  those of the others: these are dependent corners, which are no points. `_forest` chooses them
  independently of the order in the case file.
* A dependent corner gives its area and its jump to points of the same interface next to it. The
  unknown of such a point is the mean jump, by area, of the point and its part of the corner. Its
  law holds in the mean. A constant pressure is transmitted exactly, and areas sum to the area.
* Where supports hold both sides of a jump, the jump is given by them and the interface carries no
  reported force in that component; the normals drop it.
* The components are along x, y, z. A vertex that a support holds along another direction has local
  axes. The jumps themselves are along x, y, z everywhere.

All facets of the contact interfaces are gathered on every rank and sorted by the vertex numbers of
the mesh file, so that the result does not depend on the partition. They are few.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import partial

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints
from app.foundation.errors import InputError
from app.interfaces.corners import (
    ROUNDING,
    ContactPoints,
    ContactSurface,
    Corners,
    Entries,
    Holds,
    vertices_of_bodies,
)
from app.interfaces.faces import drop_held, faces_around, projectors, shared
from app.interfaces.interface_facets import InterfaceFacets
from meshes.facets import bends

# A direction is tangential to a face below this cosine with its normal.
TANGENTIAL = 1e-6
# Decimals to which cosines between normals are compared.
ALIKE = 1


def contact_points(
    facets: InterfaceFacets, holds: Holds, interfaces: Sequence[str], axes: Mapping[int, Floats]
) -> tuple[ContactPoints, Entries]:
    """Contact points of all interfaces, and the displacement of each body due to their jumps.

    ``interfaces`` are their names; ``axes`` (3, 3) are the local axes of vertices that have them.

    Raises:
        InputError: An interface has no point that could carry its force.
    """
    surface, doubt, stiffness, n = _surface(facets, holds, interfaces)
    of_points = {each.name: getattr(surface, each.name)[:n] for each in fields(Corners)}
    vertex, bodies = surface.vertex[:n], surface.bodies[:n]
    _check_rigid(vertex, bodies, surface.interface[:n], facets, holds, interfaces)
    given, signs = _jumps_at_vertices(vertex, bodies, stiffness[:n], holds)
    local_axes = np.tile(np.eye(3), (n, 1, 1))
    for p in np.flatnonzero(np.isin(vertex, list(axes))):
        local_axes[p] = axes[int(vertex[p])]
    normals, faces = surface.normals[:n], surface.faces[:n]
    is_held = given[:, :, 0] >= 0
    held = projectors(local_axes, is_held)
    across = np.abs(np.einsum("pki,pic->pkc", normals, local_axes)).max(axis=1)
    along = projectors(local_axes, is_held & (across < TANGENTIAL))
    drop_held(normals, faces, held)
    along[faces == 0] = 0.0
    points = ContactPoints(
        **of_points,
        doubt=doubt[:n],
        given=given,
        axes=local_axes,
        held_tangents=along,
        surface=surface,
    )
    entries = _entries(facets, points, signs)
    if n == len(surface.vertex):
        return points, entries
    # Imported here: interfaces that do not meet need no scipy.
    from app.interfaces.dependent_corners import handed_area, in_means

    return in_means(points, entries, handed_area(facets, surface, held, interfaces))


def _surface(
    facets: InterfaceFacets, holds: Holds, interfaces: Sequence[str]
) -> tuple[ContactSurface, Floats, Floats, int]:
    """Corners, points first, with the normals of their faces.

    Returns:
        The corners, the doubt about their normals (m,) [rad], the moduli on both sides (m, 2)
        [MPa], and the number of points.
    """
    facet = np.repeat(np.arange(len(facets.area)), 3)
    keys = np.column_stack([facets.interface[facet], facets.vertices.ravel(), facets.bodies[facet]])
    every, first, of = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    of = of.ravel()
    normals, faces, area, doubt = faces_around(facets, of, len(every))
    supports = holds.supports_of(every[:, 1], every[:, 2:])
    prescribed: Bools = np.any(np.all(supports >= 0, axis=1), axis=1)
    kept = _forest(facets, every, of, prescribed, normals, interfaces)
    order = np.concatenate([np.flatnonzero(kept), np.flatnonzero(~kept)])
    corners = np.argsort(order)[of].reshape(-1, 3)
    stiffness = np.zeros((len(every), 2))
    np.maximum.at(stiffness, corners.ravel(), facets.stiffness[facet])
    of_interface = [np.flatnonzero(facets.interface == i) for i in range(len(interfaces))]
    surface = ContactSurface(
        interface=every[order, 0],
        vertex=every[order, 1],
        dof=facets.dofs[:, :3].ravel()[first[order]],
        x=facets.x.reshape(-1, 3)[first[order]],
        bodies=every[order, 2:],
        normals=normals[order],
        faces=faces[order],
        weight=area[order],
        triangles=tuple(corners[f] for f in of_interface),
        facets=tuple(of_interface),
    )
    return surface, doubt[order], stiffness, int(kept.sum())


def _entries(facets: InterfaceFacets, points: ContactPoints, signs: Floats) -> Entries:
    """Displacement of the bodies by the jumps of the points.

    ``signs`` are those of the jumps in the displacement of each body (b, n, 3), along the axes of
    the points.
    """
    body, point = np.nonzero(signs.any(axis=2))
    blocks = projectors(points.axes[point], signs[body, point])
    blocks[np.abs(blocks) < ROUNDING] = 0.0
    moves = [(body, points.dof[point], point, blocks)]
    if facets.dofs.shape[1] == 6:
        moves.append(_at_edges(facets, points, body, point, blocks))
    body, node, point, blocks = (np.concatenate(part) for part in zip(*moves, strict=True))
    k, row, column = np.nonzero(blocks)
    value = blocks[k, row, column]
    return Entries(body[k], 3 * node[k] + row, 3 * point[k] + column, value)


def _forest(
    facets: InterfaceFacets,
    every: Ints,
    of: Ints,
    prescribed: Bools,
    normals: Floats,
    names: Sequence[str],
) -> Bools:
    """Mask of the corners that are points (m,): the edges of a forest of bodies at each vertex.

    At each vertex corners become points in this order:

    1. Corners of interfaces that would have no point at all.
    2. Corners whose jump supports prescribe: otherwise bodies between the two would be held, too.
    3. Corners without a point to which they could give their force.
    4. Corners whose normals agree with the others there: the bars of a T before its stem.
    5. Corners of the larger interface, then by name.

    Args:
        facets: All facets.
        every: Interface, vertex, master and slave of all corners (m, 4).
        of: Row in ``every`` of each corner of the facets (3 f,).
        prescribed: Mask of corners with both sides held along an axis (m,).
        normals: Unit normals of the corners (m, 3, 3).
        names: Names of the interfaces.
    """
    groups = shared(every[:, 1])
    crowded = np.zeros(len(every), dtype=bool)
    for rows in groups:
        crowded[rows] = len(rows) >= len(np.unique(every[rows, 2:]))
    corners = of.reshape(-1, 3)
    free = (~crowded[corners]).any(axis=1)
    supported = np.zeros(len(every), dtype=bool)
    supported[corners[free].ravel()] = True
    sides = np.unique(every[:, [0, 2, 3]], axis=0, return_inverse=True)[1].ravel()
    size = np.bincount(sides[of], facets.area.ravel())
    total = float(size.sum())
    needed = np.zeros(len(size), dtype=bool)

    def rank(p: int, rows: Ints) -> tuple[bool, bool, bool, float, float, str, int, int]:
        others = rows[rows != p]
        cosines = np.abs(np.einsum("ki,qji->kqj", normals[p], normals[others]))
        area = float(np.round(size[sides[p]] / total, 6))
        alike = float(np.round(cosines.max(initial=0.0), ALIKE))
        first = not needed[sides[p]], not prescribed[p], bool(supported[p])
        name = names[int(every[p, 0])]
        return (*first, -alike, -area, name, int(every[p, 2]), int(every[p, 3]))

    while True:
        kept = np.ones(len(every), dtype=bool)
        for rows in groups:
            if not crowded[rows[0]]:
                continue
            group = {int(body): int(body) for body in every[rows, 2:].ravel()}
            for p in sorted(map(int, rows), key=partial(rank, rows=rows)):
                a, b = (group[int(body)] for body in every[p, 2:])
                kept[p] = a != b
                group = {body: a if g == b else g for body, g in group.items()}
        bare = (np.bincount(sides, kept) == 0) & ~needed
        if not bare.any():
            return kept
        needed |= bare


def _jumps_at_vertices(
    vertex: Ints, sides: Ints, stiffness: Floats, holds: Holds
) -> tuple[Ints, Floats]:
    """Prescribed jumps, and how each body moves by the jumps, in the components of the vertices.

    Returns:
        ``given`` of ContactPoints; +1, -1 or 0 for each body, point and component (b, n, 3).
    """
    n = len(vertex)
    side = holds.supports_of(vertex, sides)
    rigid = holds.rigid_bodies(vertex, sides)
    held = side >= 0
    given = np.where(held.all(axis=1, keepdims=True), side, -1)
    # One interface at the vertex: the slave moves by +q, or the master by -q if the slave is the
    # base: it alone is held, both are and it comes first, or none is and it is stiffer.
    slave_is_base = held[:, 1] & (~held[:, 0] | (sides[:, 1] < sides[:, 0])[:, None])
    slave_is_base |= ~held.any(axis=1) & (stiffness[:, 1] > stiffness[:, 0])[:, None]
    one_is_rigid = rigid.any(axis=1)
    slave_is_base[one_is_rigid] = rigid[one_is_rigid, 1:]
    signs = np.zeros((int(sides.max()) + 1, n, 3))
    signs[sides[:, 0], np.arange(n)] = -1.0 * slave_is_base
    signs[sides[:, 1], np.arange(n)] = ~slave_is_base
    for rows in shared(vertex):
        signs[:, rows] = 0.0
        for c in range(3):
            base = [int(body) for body in sides[rows][rigid[rows]]]
            _tree(rows, sides, side[:, :, c], stiffness, given[:, :, c], signs[:, :, c], base)
    return given.transpose(0, 2, 1), signs


def _check_rigid(
    vertex: Ints,
    sides: Ints,
    interface: Ints,
    facets: InterfaceFacets,
    holds: Holds,
    names: Sequence[str],
) -> None:
    """Refuse vertices with two rigid bodies, of which only one can be the base.

    Args:
        vertex: Vertices of the points (n,).
        sides: Bodies of the points (n, 2).
        interface: Interfaces of the points (n,).
        facets: All facets.
        holds: Constrained components; which nodes move with rigid regions.
        names: Names of the interfaces.

    Raises:
        InputError: There is such a vertex; names the interfaces and the place.
    """
    rigid = holds.rigid & (holds.support < 0).any(axis=1)
    moves = {*vertices_of_bodies(holds.vertex[rigid], holds.body[rigid])}
    for rows in shared(vertex):
        v = int(vertex[rows[0]])
        if sum((v, int(body)) in moves for body in np.unique(sides[rows])) > 1:
            x, y, z = facets.x[facets.vertices == v][0]
            met = ", ".join(names[i] for i in np.unique(interface[rows]))
            raise InputError(
                f"interfaces {met}: two rigid regions that can move meet a third body at "
                f"({x:.4g}, {y:.4g}, {z:.4g}) mm; hold one of them in all directions by a support, "
                "or make it elastic"
            )


def _tree(
    rows: Ints,
    sides: Ints,
    support: Ints,
    stiffness: Floats,
    given: Ints,
    signs: Floats,
    rigid: Sequence[int],
) -> None:
    """Fill ``given`` and ``signs`` at a vertex with several interfaces, in one component.

    Walk the forest of bodies from a rigid body, else from a constrained one (the lowest), else from
    the stiffest one. Between two constrained bodies every jump on the way is prescribed. A free
    body moves with the body from which it is reached.
    """
    of, holding = sides[rows], support[rows]
    at = holding >= 0
    holder = dict(zip(map(int, of[at]), map(int, holding[at]), strict=True))
    bodies = dict.fromkeys(map(int, of.ravel()))
    stiffest = sorted(bodies, key=lambda b: float(stiffness[rows][of == b].max()), reverse=True)
    base: dict[int, int] = {}
    for root in (*rigid, *sorted(holder), *stiffest):
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
            other = holder.get(base[body], -1)
            given[p] = [holder.get(int(b), other) for b in sides[p]]


def _at_edges(
    facets: InterfaceFacets, points: ContactPoints, body: Ints, point: Ints, blocks: Floats
) -> tuple[Ints, Ints, Ints, Floats]:
    """Return the moves of edge nodes. The jump is linear: the middle has half of that of each end.

    The middle of a curved edge has its `bends`, too. Without them a second-order cylinder would not
    open between its nodes.

    Args:
        facets: All facets.
        points: All points.
        body: Body of each move of a vertex.
        point: Its point.
        blocks: Its blocks (3, 3).

    Returns:
        Body, dof of the edge, point and block (3, 3) of each move of an edge node.
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
