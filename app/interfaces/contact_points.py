"""Contact points on a conforming mesh: vertices at which the two sides of an interface can part.

A contact point is a mesh vertex on one interface; a vertex on several interfaces has several
points. A point has:

* the jump of that interface: the displacement of the slave side minus that of the master side;
* the normals of its faces. Facets that meet at less than 30 degrees are one face. A vertex on an
  edge has two faces, on a corner three;
* its area: the integral of its linear shape function over the facets around it, a third of each
  flat facet.

On curved cells normals are those of the curved facets, so that a smooth surface is one face on any
mesh. Straight facets have the normals of the smooth surface that is fitted to their vertices
(`smooth_normals`). The law acts along these normals; area and force are those of the facets around
the point.

Rules for each displacement component of a vertex where bodies and interfaces meet:

* One body is the base. Its displacement is the continuous field u itself, and every other body at
  the vertex adds jumps to u. The base is a rigid body if there is one, then a body with a support
  of this component, then the stiffest body; of two equally stiff bodies it is the master. A jump
  that moves the softer side has nearly the stiffness of the two bodies in contact.
* A vertex with k bodies has k - 1 jumps. If more interfaces than that meet, some jumps follow from
  the others. Corners with such jumps are dependent corners; they are no points. `_independent`
  chooses them independently of the order in the case file.
* A dependent corner gives its area and its jump to points of the same interface next to it. The
  unknown of such a point is the mean jump, by area, of the point and its part of the corner. On an
  edge, the mean is over each face alone. The law then holds in the mean: a constant pressure is
  transmitted exactly, and the areas of the points sum to the area of the interface.
* If supports prescribe both sides of a jump, the jump is prescribed. The interface then has no
  reported force in this component, and the component is projected out of the normals.
* The components are along x, y, z. A vertex with a support along another direction has local axes.
  The jumps themselves are always along x, y, z.

All facets of the interfaces are gathered on every rank; they are few. They are sorted by
the vertex numbers of the mesh file, so that the result does not depend on the partition.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import partial

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints
from app.foundation.errors import InputError
from app.interfaces.corners import (
    ROUNDING_OF_JUMP_FACTORS,
    ContactPoints,
    ContactSurface,
    Corners,
    Entries,
    VertexConstraints,
    vertex_body_pairs,
)
from app.interfaces.faces import drop_prescribed, faces_around, projectors, shared
from app.interfaces.interface_facets import InterfaceFacets
from meshes.data import connected
from meshes.facets import bends_of_edges

# A direction is tangential to a face below this cosine with its normal.
TANGENTIAL = 1e-6
# Decimals to which cosines between normals are compared.
COSINE_DECIMALS = 1


def contact_points(
    facets: InterfaceFacets,
    constraints: VertexConstraints,
    interfaces: Sequence[str],
    axes: Mapping[int, Floats],
    by_face: bool = True,
) -> tuple[ContactPoints, Entries]:
    """Contact points of all interfaces, and the displacement of each body due to their jumps.

    Args:
        facets: All facets.
        constraints: Constrained displacement components of vertices.
        interfaces: Names of the interfaces.
        axes: Local axes (3, 3), by vertex, of vertices that have them.
        by_face: True if each face of a point has a separate pressure. False for a field with one
            component, whose flux does not depend on normals.

    Raises:
        InputError: An interface has no point that could carry its force.
    """
    surface, normal_error, stiffness, count = _surface(facets, constraints, interfaces)
    # Views of the first corners: changes of their normals and faces below also change `surface`.
    first_corners = {field.name: getattr(surface, field.name)[:count] for field in fields(Corners)}
    vertex, bodies = surface.vertex[:count], surface.bodies[:count]
    normals, faces = surface.normals[:count], surface.faces[:count]
    _refuse_two_rigid_bodies(
        vertex, bodies, surface.interface[:count], facets, constraints, interfaces
    )
    prescribing_support, signs = _jumps_at_vertices(vertex, bodies, stiffness[:count], constraints)
    local_axes = np.tile(np.eye(3), (count, 1, 1))
    for p in np.flatnonzero(np.isin(vertex, list(axes))):
        local_axes[p] = axes[int(vertex[p])]
    is_prescribed = prescribing_support[:, :, 0] >= 0
    prescribed_projectors = projectors(local_axes, is_prescribed)
    normal_cosines = np.abs(np.einsum("pki,pic->pkc", normals, local_axes)).max(axis=1)
    is_tangential = normal_cosines < TANGENTIAL
    prescribed_tangents = projectors(local_axes, is_prescribed & is_tangential)
    drop_prescribed(normals, faces, prescribed_projectors)
    prescribed_tangents[faces == 0] = 0.0
    points = ContactPoints(
        **first_corners,
        normal_error=normal_error[:count],
        prescribing_support=prescribing_support,
        axes=local_axes,
        prescribed_tangents=prescribed_tangents,
        surface=surface,
    )
    entries = _entries(facets, points, signs)
    if count == len(surface.vertex):
        return points, entries
    # Imported late: interfaces that do not meet need no scipy.
    from app.interfaces.dependent_corners import transferred_areas, with_mean_jumps

    transferred = transferred_areas(facets, surface, prescribed_projectors, interfaces, by_face)
    return with_mean_jumps(facets, points, entries, transferred, interfaces, by_face)


def _surface(
    facets: InterfaceFacets, constraints: VertexConstraints, interfaces: Sequence[str]
) -> tuple[ContactSurface, Floats, Floats, int]:
    """Corners, points first, with the normals of their faces.

    Returns:
        The corners, the standard error of their normals (m,) [rad], the moduli on both sides
        (m, 2) [MPa], and the number of points.
    """
    facet = np.repeat(np.arange(len(facets.area)), 3)
    keys = np.column_stack([facets.interface[facet], facets.vertices.ravel(), facets.bodies[facet]])
    # Corners in the order of interface, vertex, master and slave, and one facet corner of each.
    all_corners, facet_corner, corner_rows = np.unique(
        keys, axis=0, return_index=True, return_inverse=True
    )
    corner_rows = corner_rows.ravel()
    normals, faces, area, normal_error = faces_around(facets, corner_rows, len(all_corners))
    supports = constraints.supports_of(all_corners[:, 1], all_corners[:, 2:])
    is_prescribed: Bools = np.any(np.all(supports >= 0, axis=1), axis=1)
    is_point = _independent(facets, all_corners, corner_rows, is_prescribed, normals, interfaces)
    order = np.concatenate([np.flatnonzero(is_point), np.flatnonzero(~is_point)])
    corners = np.argsort(order)[corner_rows].reshape(-1, 3)
    stiffness = np.zeros((len(all_corners), 2))
    np.maximum.at(stiffness, corners.ravel(), facets.stiffness[facet])
    facet_rows = [np.flatnonzero(facets.interface == i) for i in range(len(interfaces))]
    surface = ContactSurface(
        interface=all_corners[order, 0],
        vertex=all_corners[order, 1],
        dof=facets.dofs[:, :3].ravel()[facet_corner[order]],
        x=facets.x.reshape(-1, 3)[facet_corner[order]],
        bodies=all_corners[order, 2:],
        normals=normals[order],
        faces=faces[order],
        weight=area[order],
        triangles=tuple(corners[rows] for rows in facet_rows),
        facets=tuple(facet_rows),
    )
    return surface, normal_error[order], stiffness, int(is_point.sum())


def _entries(facets: InterfaceFacets, points: ContactPoints, signs: Floats) -> Entries:
    """Displacement of the bodies due to the jumps of the points.

    ``signs`` are the signs of the jumps in the displacement of each body (b, n, 3), along the axes
    of the points.
    """
    body, point = np.nonzero(signs.any(axis=2))
    blocks = projectors(points.axes[point], signs[body, point])
    blocks[np.abs(blocks) < ROUNDING_OF_JUMP_FACTORS] = 0.0
    node = points.dof[point]
    if facets.dofs.shape[1] == 6:
        edge_body, edge_node, edge_point, edge_blocks = _edge_moves(
            facets, points, body, point, blocks
        )
        body = np.concatenate([body, edge_body])
        node = np.concatenate([node, edge_node])
        point = np.concatenate([point, edge_point])
        blocks = np.concatenate([blocks, edge_blocks])
    move, row, column = np.nonzero(blocks)
    value = blocks[move, row, column]
    return Entries(body[move], 3 * node[move] + row, 3 * point[move] + column, value)


def _independent(
    facets: InterfaceFacets,
    all_corners: Ints,
    corner_rows: Ints,
    is_prescribed: Bools,
    normals: Floats,
    names: Sequence[str],
) -> Bools:
    """Mask of the corners that are points (m,): corners with independent jumps.

    At a vertex, bodies and corners are the nodes and edges of a graph. The points are the edges of
    a spanning forest. Corners become points in this order:

    1. Corners of interfaces that would have no point at all.
    2. Corners whose jump supports prescribe. Otherwise bodies between the two would be held, too.
    3. Corners without a point to which they could give their force.
    4. Corners whose normals agree with others of the vertex: the bars of a T before its stem.
    5. Corners of the larger interface, then by name.

    Args:
        facets: All facets.
        all_corners: Interface, vertex, master and slave of all corners (m, 4).
        corner_rows: Row in ``all_corners`` of each corner of the facets (3 f,).
        is_prescribed: Mask of the corners whose jump supports prescribe along an axis (m,).
        normals: Unit normals of the corners (m, 3, 3).
        names: Names of the interfaces.
    """
    corners_of_vertices = shared(all_corners[:, 1])
    body_count = int(all_corners[:, 2:].max()) + 1
    # A vertex with as many corners as bodies, or more, has dependent corners.
    is_crowded = np.zeros(len(all_corners), dtype=bool)
    for rows in corners_of_vertices:
        is_crowded[rows] = len(rows) >= len(np.unique(all_corners[rows, 2:]))
    corners = corner_rows.reshape(-1, 3)
    has_point = (~is_crowded[corners]).any(axis=1)
    # Corners with a point of the same interface in one of their facets.
    is_near_point = np.zeros(len(all_corners), dtype=bool)
    is_near_point[corners[has_point].ravel()] = True
    # An interface between other bodies counts separately.
    pair = np.unique(all_corners[:, [0, 2, 3]], axis=0, return_inverse=True)[1].ravel()
    area_of_pair = np.bincount(pair[corner_rows], facets.area.ravel())
    total_area = float(area_of_pair.sum())
    needs_point = np.zeros(len(area_of_pair), dtype=bool)

    def preference(
        corner: int, corners_of_vertex: Ints
    ) -> tuple[bool, bool, bool, float, float, str, int, int]:
        """Key by which the corners of a vertex are sorted: lower ones become points first."""
        interface, _, master, slave = map(int, all_corners[corner])
        other_corners = corners_of_vertex[corners_of_vertex != corner]
        cosines = np.abs(np.einsum("ki,qji->kqj", normals[corner], normals[other_corners]))
        largest_cosine = float(np.round(cosines.max(initial=0.0), COSINE_DECIMALS))
        area_fraction = float(np.round(area_of_pair[pair[corner]] / total_area, 6))
        return (
            not needs_point[pair[corner]],
            not is_prescribed[corner],
            bool(is_near_point[corner]),
            -largest_cosine,
            -area_fraction,
            names[interface],
            master,
            slave,
        )

    while True:
        is_point = np.ones(len(all_corners), dtype=bool)
        for rows in corners_of_vertices:
            if not is_crowded[rows[0]]:
                continue
            by_preference = sorted(map(int, rows), key=partial(preference, corners_of_vertex=rows))
            is_point[by_preference] = _spanning_forest(all_corners[by_preference, 2:], body_count)
        has_no_point = (np.bincount(pair, is_point) == 0) & ~needs_point
        if not has_no_point.any():
            return is_point
        needs_point |= has_no_point


def _spanning_forest(edges: Ints, node_count: int) -> Bools:
    """Mask of the edges (k, 2) of a graph that form a spanning forest, the first ones preferred."""
    start, end = edges.T
    is_in_forest = np.zeros(len(edges), dtype=bool)
    for n in range(len(edges)):
        # Nodes that the edges before this one connect have the same group.
        group = connected(node_count, start[:n], end[:n])
        is_in_forest[n] = group[start[n]] != group[end[n]]
    return is_in_forest


def _jumps_at_vertices(
    vertex: Ints, sides: Ints, stiffness: Floats, constraints: VertexConstraints
) -> tuple[Ints, Floats]:
    """Prescribed jumps, and motion of each body due to the jumps, in the components of vertices.

    Args:
        vertex: Vertices of the points (n,).
        sides: Master and slave of the points (n, 2).
        stiffness: Moduli of master and slave (n, 2) [MPa].
        constraints: Constrained components of vertices.

    Returns:
        ``prescribing_support`` of ContactPoints (n, 3, 2), and the signs +1, -1 or 0 of the jumps
        in the displacement of each body (b, n, 3).
    """
    count = len(vertex)
    support_of_side = constraints.supports_of(vertex, sides)
    is_rigid = constraints.rigid_bodies(vertex, sides)
    is_held = support_of_side >= 0
    prescribing_support = np.where(is_held.all(axis=1, keepdims=True), support_of_side, -1)
    # Vertices on one interface: the slave moves by +q. If the slave is the base, the master moves
    # by -q. The slave is the base if it alone is held, if both sides are held and it has the lower
    # number, or if no side is held and it is stiffer.
    slave_is_base = is_held[:, 1] & (~is_held[:, 0] | (sides[:, 1] < sides[:, 0])[:, None])
    slave_is_base |= ~is_held.any(axis=1) & (stiffness[:, 1] > stiffness[:, 0])[:, None]
    one_is_rigid = is_rigid.any(axis=1)
    slave_is_base[one_is_rigid] = is_rigid[one_is_rigid, 1:]
    signs = np.zeros((int(sides.max()) + 1, count, 3))
    signs[sides[:, 0], np.arange(count)] = -1.0 * slave_is_base
    signs[sides[:, 1], np.arange(count)] = ~slave_is_base
    for rows in shared(vertex):
        signs[:, rows] = 0.0
        rigid_bodies = [int(body) for body in sides[rows][is_rigid[rows]]]
        for component in range(3):
            _set_jumps_at_vertex(
                rows,
                sides,
                support_of_side[:, :, component],
                stiffness,
                prescribing_support[:, :, component],
                signs[:, :, component],
                rigid_bodies,
            )
    return prescribing_support.transpose(0, 2, 1), signs


def _refuse_two_rigid_bodies(
    vertex: Ints,
    sides: Ints,
    interface: Ints,
    facets: InterfaceFacets,
    constraints: VertexConstraints,
    names: Sequence[str],
) -> None:
    """Refuse vertices with two rigid bodies that can move: only one body can be the base.

    Args:
        vertex: Vertices of the points (n,).
        sides: Master and slave of the points (n, 2).
        interface: Interfaces of the points (n,).
        facets: All facets.
        constraints: Constrained components of vertices, and masks of rigid regions.
        names: Names of the interfaces.

    Raises:
        InputError: There is such a vertex; names the interfaces and the position.
    """
    moves_rigidly = constraints.rigid & (constraints.support < 0).any(axis=1)
    rigid_pairs = {
        *vertex_body_pairs(constraints.vertex[moves_rigidly], constraints.body[moves_rigidly])
    }
    for rows in shared(vertex):
        v = int(vertex[rows[0]])
        rigid_count = sum((v, int(body)) in rigid_pairs for body in np.unique(sides[rows]))
        if rigid_count > 1:
            x, y, z = facets.x[facets.vertices == v][0]
            meeting_names = ", ".join(names[i] for i in np.unique(interface[rows]))
            raise InputError(
                f"interfaces {meeting_names}: two rigid regions that can move meet a third body at "
                f"({x:.4g}, {y:.4g}, {z:.4g}) mm; hold one of them in all directions by a support, "
                "or make it elastic"
            )


def _set_jumps_at_vertex(
    rows: Ints,
    sides: Ints,
    support: Ints,
    stiffness: Floats,
    prescribing_support: Ints,
    signs: Floats,
    rigid_bodies: Sequence[int],
) -> None:
    """Set prescribed jumps and signs of one component at a vertex on several interfaces.

    Walk the forest of bodies from a rigid body, then from a held body (the lowest number), then
    from the stiffest body. All jumps between two held bodies are prescribed. A body that is not
    held moves with the body from which it is reached.

    Args:
        rows: Points at the vertex (k,).
        sides: Master and slave of all points (n, 2).
        support: Support of the component on both sides, or -1 (n, 2).
        stiffness: Moduli of both sides (n, 2) [MPa].
        prescribing_support: Supports that prescribe the jump (n, 2); set in place.
        signs: Signs of the jumps in the displacement of each body (b, n); set in place.
        rigid_bodies: Rigid bodies at the vertex.
    """
    point_sides, point_supports = sides[rows], support[rows]
    is_held = point_supports >= 0
    held_bodies = map(int, point_sides[is_held])
    support_of_body = dict(zip(held_bodies, map(int, point_supports[is_held]), strict=True))
    bodies = dict.fromkeys(map(int, point_sides.ravel()))

    def largest_stiffness(body: int) -> float:
        return float(stiffness[rows][point_sides == body].max())

    stiffest_first = sorted(bodies, key=largest_stiffness, reverse=True)
    root_of_body: dict[int, int] = {}
    for root in (*rigid_bodies, *sorted(support_of_body), *stiffest_first):
        if root in root_of_body:
            continue
        root_of_body[root] = root
        # A chain has at most as many points as the vertex: as many passes reach its end.
        for p in [*rows] * len(rows):
            master, slave = map(int, sides[p])
            for reached, unreached, sign in ((master, slave, 1.0), (slave, master, -1.0)):
                if reached in root_of_body and unreached not in root_of_body:
                    root_of_body[unreached] = root
                    signs[unreached, rows] = signs[reached, rows]
                    signs[unreached, p] = sign
    for body in support_of_body:
        root_support = support_of_body.get(root_of_body[body], -1)
        for p in rows[signs[body, rows] != 0]:
            prescribing_support[p] = [support_of_body.get(int(b), root_support) for b in sides[p]]


def _edge_moves(
    facets: InterfaceFacets, points: ContactPoints, body: Ints, point: Ints, blocks: Floats
) -> tuple[Ints, Ints, Ints, Floats]:
    """Moves of the nodes in the middle of edges, from the moves of vertices.

    A move is the block (3, 3) that a jump adds to the displacement of a body at a node. The jump is
    linear along an edge: its middle has half the jump of each end. The middle of a curved edge
    also has its `bends`. Without them a second-order cylinder would not open between its nodes.

    Args:
        facets: All facets.
        points: All points.
        body: Body of each move of a vertex (k,).
        point: Point of each move (k,).
        blocks: Block of each move (k, 3, 3).

    Returns:
        Body, dof of the edge, point and block (3, 3) of each move of an edge node.
    """
    # Every pair of edge and body at the interfaces once, with both ends of the edge. The vertices
    # of facets are sorted, so that an edge has the same direction in every facet.
    starts = [1, 0, 0]
    ends = [2, 2, 1]
    edges_of_facets = np.stack(
        [facets.dofs[:, 3:], facets.vertices[:, starts], facets.vertices[:, ends]], axis=2
    )
    edges_of_sides = [
        np.column_stack([edges_of_facets.reshape(-1, 3), np.repeat(side_bodies, 3)])
        for side_bodies in facets.bodies.T
    ]
    edges, first_rows = np.unique(np.concatenate(edges_of_sides), axis=0, return_index=True)
    edge_dof = edges[:, 0]
    edge_ends = edges[:, 1:3]
    edge_body = edges[:, 3]
    bend: Floats = np.zeros((len(edges), 3, 3))
    if facets.nodes.shape[1] == 6:
        facet_edge = first_rows % (3 * len(edges_of_facets))
        start = facets.x[:, starts].reshape(-1, 3)[facet_edge]
        end = facets.x[:, ends].reshape(-1, 3)[facet_edge]
        bend = bends_of_edges(start, end, facets.nodes[:, 3:].reshape(-1, 3)[facet_edge])
    # A component that is prescribed at both ends may also be constrained in the middle: no bend.
    vertices, first_points, vertex_row = np.unique(
        points.vertex, return_index=True, return_inverse=True
    )
    is_prescribed = np.zeros((len(vertices), 3), dtype=bool)
    np.logical_or.at(is_prescribed, vertex_row, points.is_prescribed)
    vertex_projectors = projectors(points.axes[first_points], is_prescribed)
    end_projectors = vertex_projectors[np.searchsorted(vertices, edge_ends)]
    bend = (np.eye(3) - end_projectors[:, 0] @ end_projectors[:, 1]) @ bend
    # Factors of the jumps at the starts of all edges, then at their ends.
    end_factors = np.concatenate([np.eye(3) / 2 - bend, np.eye(3) / 2 + bend])
    # For each end of each edge, the moves of the edge's body at this vertex: keys are equal.
    stride = int(vertices[-1]) + 1
    move_key = body * stride + points.vertex[point]
    end_key = (edge_body * stride + edge_ends.T).ravel()
    edge_end, move = _pairs_of_equal(end_key, move_key)
    edge = edge_end % len(edges)
    return edge_body[edge], edge_dof[edge], point[move], end_factors[edge_end] @ blocks[move]


def _pairs_of_equal(first: Ints, second: Ints) -> tuple[Ints, Ints]:
    """All pairs of equal entries, as rows of both arrays, in the order of the first array."""
    order = np.argsort(second, kind="stable")
    low = np.searchsorted(second, first, "left", order)
    high = np.searchsorted(second, first, "right", order)
    count = high - low
    first_rows = np.repeat(np.arange(len(first)), count)
    position_in_order = np.arange(len(first_rows)) + (high - np.cumsum(count))[first_rows]
    return first_rows, order[position_in_order]
