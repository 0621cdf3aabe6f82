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
  unknown of such a point is the mean jump, by area, of the point and its part of the corner; on
  an edge, the mean is over each face alone. Its law holds in the mean. A constant pressure is
  transmitted exactly, and areas sum to the area.
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
    VertexConstraints,
    vertices_of_bodies,
)
from app.interfaces.faces import drop_held, faces_around, projectors, shared
from app.interfaces.interface_facets import InterfaceFacets
from meshes.facets import bends

# A direction is tangential to a face below this cosine with its normal.
TANGENTIAL = 1e-6
# Decimals to which cosines between normals are compared.
COSINE_DECIMALS = 1


def contact_points(
    facets: InterfaceFacets,
    holds: VertexConstraints,
    interfaces: Sequence[str],
    axes: Mapping[int, Floats],
    by_face: bool = True,
) -> tuple[ContactPoints, Entries]:
    """Contact points of all interfaces, and the displacement of each body due to their jumps.

    Args:
        facets: All facets.
        holds: Constrained displacement components.
        interfaces: Names of the interfaces.
        axes: Local axes (3, 3) of vertices that have them.
        by_face: Whether each face of a point has a separate pressure. False for a field with one
            component, whose flux does not depend on normals.

    Raises:
        InputError: An interface has no point that could carry its force.
    """
    surface, doubt, stiffness, count = _surface(facets, holds, interfaces)
    of_points = {field.name: getattr(surface, field.name)[:count] for field in fields(Corners)}
    vertex, bodies = surface.vertex[:count], surface.bodies[:count]
    _check_rigid(vertex, bodies, surface.interface[:count], facets, holds, interfaces)
    prescribing_support, signs = _jumps_at_vertices(vertex, bodies, stiffness[:count], holds)
    local_axes = np.tile(np.eye(3), (count, 1, 1))
    for p in np.flatnonzero(np.isin(vertex, list(axes))):
        local_axes[p] = axes[int(vertex[p])]
    normals, faces = surface.normals[:count], surface.faces[:count]
    is_held = prescribing_support[:, :, 0] >= 0
    held_projectors = projectors(local_axes, is_held)
    normal_cosines = np.abs(np.einsum("pki,pic->pkc", normals, local_axes)).max(axis=1)
    held_tangents = projectors(local_axes, is_held & (normal_cosines < TANGENTIAL))
    drop_held(normals, faces, held_projectors)
    held_tangents[faces == 0] = 0.0
    points = ContactPoints(
        **of_points,
        doubt=doubt[:count],
        prescribing_support=prescribing_support,
        axes=local_axes,
        held_tangents=held_tangents,
        surface=surface,
    )
    entries = _entries(facets, points, signs)
    if count == len(surface.vertex):
        return points, entries
    # Imported here: interfaces that do not meet need no scipy.
    from app.interfaces.dependent_corners import handed_areas, in_means

    handed = handed_areas(facets, surface, held_projectors, interfaces, by_face)
    return in_means(facets, points, entries, handed, interfaces, by_face)


def _surface(
    facets: InterfaceFacets, holds: VertexConstraints, interfaces: Sequence[str]
) -> tuple[ContactSurface, Floats, Floats, int]:
    """Corners, points first, with the normals of their faces.

    Returns:
        The corners, the doubt about their normals (m,) [rad], the moduli on both sides (m, 2)
        [MPa], and the number of points.
    """
    facet = np.repeat(np.arange(len(facets.area)), 3)
    keys = np.column_stack([facets.interface[facet], facets.vertices.ravel(), facets.bodies[facet]])
    all_corners, first, corner_numbers = np.unique(
        keys, axis=0, return_index=True, return_inverse=True
    )
    corner_numbers = corner_numbers.ravel()
    normals, faces, area, doubt = faces_around(facets, corner_numbers, len(all_corners))
    supports = holds.supports_of(all_corners[:, 1], all_corners[:, 2:])
    prescribed: Bools = np.any(np.all(supports >= 0, axis=1), axis=1)
    is_point = _forest(facets, all_corners, corner_numbers, prescribed, normals, interfaces)
    order = np.concatenate([np.flatnonzero(is_point), np.flatnonzero(~is_point)])
    corners = np.argsort(order)[corner_numbers].reshape(-1, 3)
    stiffness = np.zeros((len(all_corners), 2))
    np.maximum.at(stiffness, corners.ravel(), facets.stiffness[facet])
    of_interface = [np.flatnonzero(facets.interface == i) for i in range(len(interfaces))]
    surface = ContactSurface(
        interface=all_corners[order, 0],
        vertex=all_corners[order, 1],
        dof=facets.dofs[:, :3].ravel()[first[order]],
        x=facets.x.reshape(-1, 3)[first[order]],
        bodies=all_corners[order, 2:],
        normals=normals[order],
        faces=faces[order],
        weight=area[order],
        triangles=tuple(corners[f] for f in of_interface),
        facets=tuple(of_interface),
    )
    return surface, doubt[order], stiffness, int(is_point.sum())


def _entries(facets: InterfaceFacets, points: ContactPoints, signs: Floats) -> Entries:
    """Displacement of the bodies by the jumps of the points.

    ``signs`` are the signs of the jumps in the displacement of each body (b, n, 3), along the axes
    of the points.
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
    all_corners: Ints,
    corner_numbers: Ints,
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
        all_corners: Interface, vertex, master and slave of all corners (m, 4).
        corner_numbers: Row in ``all_corners`` of each corner of the facets (3 f,).
        prescribed: Mask of corners with both sides held along an axis (m,).
        normals: Unit normals of the corners (m, 3, 3).
        names: Names of the interfaces.
    """
    groups = shared(all_corners[:, 1])
    crowded = np.zeros(len(all_corners), dtype=bool)
    for rows in groups:
        crowded[rows] = len(rows) >= len(np.unique(all_corners[rows, 2:]))
    corners = corner_numbers.reshape(-1, 3)
    has_point = (~crowded[corners]).any(axis=1)
    supported = np.zeros(len(all_corners), dtype=bool)
    supported[corners[has_point].ravel()] = True
    sides = np.unique(all_corners[:, [0, 2, 3]], axis=0, return_inverse=True)[1].ravel()
    size = np.bincount(sides[corner_numbers], facets.area.ravel())
    total = float(size.sum())
    needed = np.zeros(len(size), dtype=bool)

    def rank(p: int, rows: Ints) -> tuple[bool, bool, bool, float, float, str, int, int]:
        other_points = rows[rows != p]
        cosines = np.abs(np.einsum("ki,qji->kqj", normals[p], normals[other_points]))
        area = float(np.round(size[sides[p]] / total, 6))
        largest_cosine = float(np.round(cosines.max(initial=0.0), COSINE_DECIMALS))
        preferences = not needed[sides[p]], not prescribed[p], bool(supported[p])
        name = names[int(all_corners[p, 0])]
        return (
            *preferences,
            -largest_cosine,
            -area,
            name,
            int(all_corners[p, 2]),
            int(all_corners[p, 3]),
        )

    while True:
        is_point = np.ones(len(all_corners), dtype=bool)
        for rows in groups:
            if not crowded[rows[0]]:
                continue
            group = {int(body): int(body) for body in all_corners[rows, 2:].ravel()}
            for p in sorted(map(int, rows), key=partial(rank, rows=rows)):
                a, b = (group[int(body)] for body in all_corners[p, 2:])
                is_point[p] = a != b
                group = {body: a if g == b else g for body, g in group.items()}
        without_point = (np.bincount(sides, is_point) == 0) & ~needed
        if not without_point.any():
            return is_point
        needed |= without_point


def _jumps_at_vertices(
    vertex: Ints, sides: Ints, stiffness: Floats, holds: VertexConstraints
) -> tuple[Ints, Floats]:
    """Prescribed jumps, and motion of each body due to the jumps, in the components of vertices.

    Returns:
        ``prescribing_support`` of ContactPoints; +1, -1 or 0 for each body, point and component
        (b, n, 3).
    """
    count = len(vertex)
    support_of_side = holds.supports_of(vertex, sides)
    rigid = holds.rigid_bodies(vertex, sides)
    is_held = support_of_side >= 0
    prescribing_support = np.where(is_held.all(axis=1, keepdims=True), support_of_side, -1)
    # One interface at the vertex: the slave moves by +q, or the master by -q if the slave is the
    # base: it alone is held, both are and it comes first, or none is and it is stiffer.
    slave_is_base = is_held[:, 1] & (~is_held[:, 0] | (sides[:, 1] < sides[:, 0])[:, None])
    slave_is_base |= ~is_held.any(axis=1) & (stiffness[:, 1] > stiffness[:, 0])[:, None]
    one_is_rigid = rigid.any(axis=1)
    slave_is_base[one_is_rigid] = rigid[one_is_rigid, 1:]
    signs = np.zeros((int(sides.max()) + 1, count, 3))
    signs[sides[:, 0], np.arange(count)] = -1.0 * slave_is_base
    signs[sides[:, 1], np.arange(count)] = ~slave_is_base
    for rows in shared(vertex):
        signs[:, rows] = 0.0
        for c in range(3):
            base = [int(body) for body in sides[rows][rigid[rows]]]
            _tree(
                rows,
                sides,
                support_of_side[:, :, c],
                stiffness,
                prescribing_support[:, :, c],
                signs[:, :, c],
                base,
            )
    return prescribing_support.transpose(0, 2, 1), signs


def _check_rigid(
    vertex: Ints,
    sides: Ints,
    interface: Ints,
    facets: InterfaceFacets,
    holds: VertexConstraints,
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
            names_there = ", ".join(names[i] for i in np.unique(interface[rows]))
            raise InputError(
                f"interfaces {names_there}: two rigid regions that can move meet a third body at "
                f"({x:.4g}, {y:.4g}, {z:.4g}) mm; hold one of them in all directions by a support, "
                "or make it elastic"
            )


def _tree(
    rows: Ints,
    sides: Ints,
    support: Ints,
    stiffness: Floats,
    prescribing_support: Ints,
    signs: Floats,
    rigid: Sequence[int],
) -> None:
    """Fill both arrays at a vertex with several interfaces, in one component.

    Walk the forest of bodies from a rigid body, else from a constrained one (the lowest), else from
    the stiffest one. Between two constrained bodies every jump on the way is prescribed. A free
    body moves with the body from which it is reached.
    """
    point_sides, holding = sides[rows], support[rows]
    is_supported = holding >= 0
    support_of_body = dict(
        zip(map(int, point_sides[is_supported]), map(int, holding[is_supported]), strict=True)
    )
    bodies = dict.fromkeys(map(int, point_sides.ravel()))
    stiffest = sorted(
        bodies, key=lambda b: float(stiffness[rows][point_sides == b].max()), reverse=True
    )
    base: dict[int, int] = {}
    for root in (*rigid, *sorted(support_of_body), *stiffest):
        if root in base:
            continue
        base[root] = root
        for p in [*rows] * len(rows):  # as far as the longest chain
            master, slave = map(int, sides[p])
            for reached, unreached, sign in ((master, slave, 1.0), (slave, master, -1.0)):
                if reached in base and unreached not in base:
                    base[unreached] = root
                    signs[unreached, rows] = signs[reached, rows]
                    signs[unreached, p] = sign
    for body in support_of_body:
        for p in rows[signs[body, rows] != 0]:
            other_support = support_of_body.get(base[body], -1)
            prescribing_support[p] = [support_of_body.get(int(b), other_support) for b in sides[p]]


def _at_edges(
    facets: InterfaceFacets, points: ContactPoints, body: Ints, point: Ints, blocks: Floats
) -> tuple[Ints, Ints, Ints, Floats]:
    """Return the moves of edge nodes. The jump is linear: the middle has half the jump of each end.

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
    vertices, first_points, number = np.unique(
        points.vertex, return_index=True, return_inverse=True
    )
    is_held = np.zeros((len(vertices), 3), dtype=bool)
    np.logical_or.at(is_held, number, points.held)
    end_projectors = projectors(points.axes[first_points], is_held)[
        np.searchsorted(vertices, rows[:, 1:3])
    ]
    bend = (np.eye(3) - end_projectors[:, 0] @ end_projectors[:, 1]) @ bend
    middles = np.concatenate([np.eye(3) / 2 - bend, np.eye(3) / 2 + bend])
    # Of each (end, edge, body), the moves of the body at the end.
    stride = int(vertices[-1]) + 1
    key = body * stride + points.vertex[point]
    needed_keys = (rows[:, 3] * stride + rows[:, 1:3].T).ravel()
    order = np.argsort(key, kind="stable")
    low = np.searchsorted(key, needed_keys, "left", order)
    high = np.searchsorted(key, needed_keys, "right", order)
    end = np.repeat(np.arange(len(needed_keys)), high - low)
    inside = np.arange(len(end)) + (high - np.cumsum(high - low))[end]
    edge, move = rows[end % len(rows)], order[inside]
    return edge[:, 3], edge[:, 0], point[move], middles[end] @ blocks[move]
