"""Contact points: where the two sides of an interface can part, on a conforming mesh.

A contact point is a mesh vertex seen from one interface. It carries the jump of that interface (the
displacement of the slave side minus that of the master side), the normals of its faces (facets that
meet at less than 30 degrees are one face; a vertex on an edge has two faces, on a corner three) and
their areas: for each facet around it the integral of its linear shape function, a third of the
facet where it is flat. On curved cells normals are those of the curved facets, so that a smooth
surface is one face however coarse the mesh.

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
from dataclasses import dataclass, replace

import numpy as np

from app.arrays import Bools, Floats, Ints
from meshes.contact_faces import distinct_rows, drop_held, faces_around, projectors, shared
from meshes.contact_facets import InterfaceFacets

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
        areas: Area of each face (n, 3) [mm2].
        weight: Area of the point (n,) [mm2].
        given: Supports (master, slave) that fix each component of the jump, -1 where it is free
            (n, 3, 2).
        axes: Axes of these components, as columns (n, 3, 3).
        triangles: For each interface, its facets as rows of contact points (f_i, 3).
        facets: For each interface, the numbers of these facets (f_i,).
        unenforced: Number of (vertex, interface) pairs left out because they close a cycle.
    """

    interface: Ints
    vertex: Ints
    dof: Ints
    x: Floats
    bodies: Ints
    faces: Ints
    normals: Floats
    areas: Floats
    weight: Floats
    given: Ints
    axes: Floats
    triangles: tuple[Ints, ...]
    facets: tuple[Ints, ...]
    unenforced: int

    @property
    def held(self) -> Bools:
        """Components of the jump prescribed by supports (n, 3)."""
        return self.given[:, :, 0] >= 0

    @property
    def held_part(self) -> Floats:
        """Projectors on the prescribed part of the jump (n, 3, 3)."""
        return projectors(self.axes, self.held)


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
    facets: InterfaceFacets, holds: Holds, interfaces: int, axes: Mapping[int, Floats] | None = None
) -> tuple[ContactPoints, Entries]:
    """Contact points of all interfaces, and the displacement of each body due to their jumps.

    Args:
        facets: The facets of all contact interfaces.
        holds: Constrained components at the vertices of these facets.
        interfaces: Number of contact interfaces.
        axes: Axes (3, 3) of components, for vertices that have their own.
    """
    bodies = int(max(facets.master.max(), facets.slave.max())) + 1
    facet = np.repeat(np.arange(len(facets.area)), 3)
    pair = facets.master[facet] * bodies + facets.slave[facet]
    key = np.stack([facets.interface[facet], facets.vertices.ravel(), pair], axis=1)
    every, first, of = distinct_rows(key)
    kept = _without_cycles(every[:, 1], every[:, 2] // bodies, every[:, 2] % bodies)
    number = np.where(kept, np.cumsum(kept) - 1, -1)
    corner_point = number[of]
    normals, areas, faces = faces_around(facets, corner_point, int(kept.sum()))
    triangles = corner_point.reshape(-1, 3)
    vertex = every[kept, 1]
    sides = np.stack([every[kept, 2] // bodies, every[kept, 2] % bodies], axis=1)
    stiffness = np.zeros((len(vertex), 2))
    at_point = corner_point >= 0
    np.maximum.at(stiffness, corner_point[at_point], facets.stiffness[facet[at_point]])
    given, at_vertex = _jumps_at_vertices(vertex, sides, stiffness, holds)
    own, own_axes = axes or {}, np.tile(np.eye(3), (len(vertex), 1, 1))
    turned = np.isin(vertex, list(own))
    for p in np.flatnonzero(turned):
        own_axes[p] = own[int(vertex[p])]
    drop_held(normals, areas, faces, projectors(own_axes, given[:, :, 0] >= 0))
    dof = facets.vertex_dofs.ravel()[first][kept]
    whole = (triangles >= 0).all(axis=1)
    of_interface = [np.flatnonzero(whole & (facets.interface == i)) for i in range(interfaces)]
    points = ContactPoints(
        interface=every[kept, 0],
        vertex=vertex,
        dof=dof,
        x=facets.x.reshape(-1, 3)[first][kept],
        bodies=sides,
        faces=faces,
        normals=normals,
        areas=areas,
        weight=areas.sum(axis=1),
        given=given,
        axes=own_axes,
        triangles=tuple(triangles[f] for f in of_interface),
        facets=tuple(of_interface),
        unenforced=int((~kept).sum()),
    )
    at_vertex = _along_xyz(at_vertex, points.axes, turned)
    vertices = replace(at_vertex, row=3 * dof[at_vertex.row // 3] + at_vertex.row % 3)
    if facets.edge_dofs.shape[1] == 0:
        return points, vertices
    return points, _join(vertices, _at_edges(facets, points, at_vertex))


def _without_cycles(vertex: Ints, master: Ints, slave: Ints) -> Bools:
    """Mask of the points kept: at each vertex a forest of bodies, earlier interfaces first."""
    kept = np.ones(len(vertex), dtype=bool)
    for rows in shared(vertex):
        group = {int(b): int(b) for p in rows for b in (master[p], slave[p])}
        for p in rows:
            a, b = group[int(master[p])], group[int(slave[p])]
            kept[p] = a != b
            group = {body: a if g == b else g for body, g in group.items()}
    return kept


def _jumps_at_vertices(
    vertex: Ints, sides: Ints, stiffness: Floats, holds: Holds
) -> tuple[Ints, Entries]:
    """Prescribed jumps, and the displacement of each body due to jumps.

    Returns:
        ``given`` of ContactPoints, and entries whose rows are 3 point + component, of any point of
        the vertex that moves; both in the components of the vertex.
    """
    n = len(vertex)
    # The support that holds each side of each point, component by component.
    table = {
        (int(v), int(b)): s for v, b, s in zip(holds.vertex, holds.body, holds.support, strict=True)
    }
    rows_of_side = np.full((2 * n, 3), -1, dtype=np.int64)
    if table:
        for row, v, b in zip(rows_of_side, np.repeat(vertex, 2), sides.ravel(), strict=True):
            row[:] = table.get((int(v), int(b)), -1)
    side = rows_of_side.reshape(n, 2, 3)
    held = side >= 0
    given = np.where(held.all(axis=1, keepdims=True), side, -1)
    # One interface at the vertex: the slave moves by +q, or the master by -q if the slave is the
    # base: it alone is held, both are and it comes first, or none is and it is stiffer.
    slave_is_base = held[:, 1] & (~held[:, 0] | (sides[:, 1] < sides[:, 0])[:, None])
    slave_is_base |= ~held.any(axis=1) & (stiffness[:, 1] > stiffness[:, 0])[:, None]
    moving = np.where(slave_is_base, sides[:, :1], sides[:, 1:])
    sign = np.where(slave_is_base, -1.0, 1.0)
    point = np.repeat(np.arange(n), 3)
    column = np.arange(3 * n)
    alone = np.ones(n, dtype=bool)
    extra: list[tuple[int, int, int, float]] = []
    for rows in shared(vertex):
        alone[rows] = False
        for c in range(3):
            extra += _tree(rows, sides, side[:, :, c], given[:, :, c], c, stiffness)
    pick = alone[point]
    more = np.array(extra, dtype=np.float64).reshape(-1, 4)
    where = np.concatenate([point[pick], more[:, 1].astype(np.int64)])
    columns = np.concatenate([column[pick], more[:, 2].astype(np.int64)])
    return given.transpose(0, 2, 1), Entries(
        np.concatenate([moving.ravel()[pick], more[:, 0].astype(np.int64)]),
        3 * where + columns % 3,
        columns,
        np.concatenate([sign.ravel()[pick], more[:, 3]]),
    )


def _along_xyz(entries: Entries, axes: Floats, turned: Bools) -> Entries:
    """Rotate entries of points with axes of their own to displacements and jumps along x, y, z."""
    pick = turned[entries.column // 3]
    if not pick.any():
        return entries
    point, c = np.divmod(entries.column[pick], 3)
    along = axes[point, :, c]
    value = entries.value[pick, None, None] * along[:, :, None] * along[:, None, :]
    keys = np.broadcast_arrays(
        entries.body[pick, None, None],
        (entries.row[pick] - c)[:, None, None] + np.arange(3)[:, None],
        3 * point[:, None, None] + np.arange(3),
    )
    rows, _, number = distinct_rows(np.stack([k.ravel() for k in keys], axis=1))
    total: Floats = np.bincount(number, value.ravel(), len(rows)).astype(np.float64)
    rows, total = rows[(kept := np.abs(total) > ROUNDING)], total[kept]
    plain = Entries(*(getattr(entries, k)[~pick] for k in vars(entries)))
    return _join(plain, Entries(rows[:, 0], rows[:, 1], rows[:, 2], total))


def _tree(
    rows: Ints, sides: Ints, support: Ints, given: Ints, c: int, stiffness: Floats
) -> list[tuple[int, int, int, float]]:
    """Triplets (body, point, column, sign) at a vertex with several interfaces, one component.

    Walks the forest of bodies from a constrained body (the lowest), else from the stiffest.
    Between two constrained bodies every jump on the way is prescribed; a free body goes with the
    one it was reached from. Fills ``given`` in place.
    """
    holder = {
        int(sides[p, k]): int(support[p, k]) for p in rows for k in (0, 1) if support[p, k] >= 0
    }
    modulus: dict[int, float] = {}
    for p in rows:
        for body, value in zip(map(int, sides[p]), stiffness[p], strict=True):
            modulus[body] = max(modulus.get(body, 0.0), value)
    bodies = sorted(holder) + sorted(modulus, key=modulus.__getitem__, reverse=True)
    path: dict[int, list[tuple[int, float]]] = {}
    out = []
    for root in bodies:
        if root in path:
            continue
        path[root] = []
        queue = [root]
        while queue:
            here = queue.pop(0)
            for p in rows:
                m, s = int(sides[p, 0]), int(sides[p, 1])
                if here not in (m, s):
                    continue
                there, sign = (s, 1.0) if here == m else (m, -1.0)
                if there in path:
                    continue
                path[there] = [*path[here], (int(p), sign)]
                queue.append(there)
        for body in sorted(holder):
            if body != root and body in path:
                for p, _ in path[body]:
                    ends = [holder.get(int(b), holder[root]) for b in sides[p]]
                    given[p] = ends
    for body, steps in path.items():
        out += [(body, p, 3 * p + c, sign) for p, sign in steps]
    # Each triplet moves the body's own vertex; any point of this vertex names its dof.
    return out


def _at_edges(facets: InterfaceFacets, points: ContactPoints, at_vertex: Entries) -> Entries:
    r"""Entries of edge nodes: the jump is linear along an edge, its middle takes half of both ends.

    The middle of a curved edge is off its chord by σ, along which a linear jump changes too. With t
    the unit vector from end a to end b and L their distance,

    .. math:: q_m = (q_a + q_b) / 2 + (σ ⊗ t - t ⊗ σ) (q_b - q_a) / L

    is exact for translations, for rotations and for a widening in the plane of the edge. Without
    it, the opening of a cylinder is lost between its nodes at second order.

    ``at_vertex`` are the entries of the vertices, with rows 3 point + component.
    """
    vertex, (where, moved) = points.vertex, np.divmod(at_vertex.row, 3)
    # Every (edge, body) of the interfaces once, with both ends.
    ends = np.stack(
        [facets.vertices[:, [1, 2]], facets.vertices[:, [0, 2]], facets.vertices[:, [0, 1]]], 1
    )
    rows = np.concatenate(
        [
            np.column_stack([facets.edge_dofs.ravel(), np.repeat(side, 3), ends.reshape(-1, 2)])
            for side in (facets.master, facets.slave)
        ]
    )
    rows, _, _ = distinct_rows(rows)
    stride = int(max(facets.vertices.max(), vertex.max())) + 1
    # A jump prescribed at both ends may be constrained in the middle too.
    known, first, number = np.unique(vertex, return_index=True, return_inverse=True)
    held = np.zeros((len(known), 3), dtype=bool)
    np.logical_or.at(held, number, points.held)
    at = projectors(points.axes[first], held)[np.searchsorted(known, rows[:, 2:])]
    bends = (np.eye(3) - at[:, 0] @ at[:, 1]) @ _bends(facets, rows[:, 0])
    key = at_vertex.body * stride + vertex[where]
    order = np.argsort(key, kind="stable")
    key = key[order]
    pieces = []
    for end, sign in ((2, -1.0), (3, 1.0)):
        wanted = rows[:, 1] * stride + rows[:, end]
        lo, hi = np.searchsorted(key, wanted, "left"), np.searchsorted(key, wanted, "right")
        count = hi - lo
        edge = np.repeat(np.arange(len(rows)), count)
        inside = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        entry = order[np.repeat(lo, count) + inside]
        block: Floats = np.eye(3) / 2 + sign * bends[edge]
        turned = block[np.arange(len(entry)), :, moved[entry]] * at_vertex.value[entry, None]
        used = turned != 0
        pieces.append(
            Entries(
                np.repeat(rows[edge, 1], 3)[used.ravel()],
                (3 * rows[edge, :1] + np.arange(3))[used],
                np.repeat(at_vertex.column[entry], 3)[used.ravel()],
                turned[used],
            )
        )
    return _join(*pieces)


def _bends(facets: InterfaceFacets, edges: Ints) -> Floats:
    """(σ ⊗ t - t ⊗ σ) / L of edges, given by their dofs (e, 3, 3); zero where facets are flat."""
    if not facets.bend.shape[1]:
        return np.zeros((len(edges), 3, 3))
    _, first = np.unique(facets.edge_dofs.ravel(), return_index=True)
    here = first[np.searchsorted(facets.edge_dofs.ravel()[first], edges)]
    # Vertices are sorted, so that an edge runs the same way in every facet.
    start, end = facets.x[:, [1, 0, 0]], facets.x[:, [2, 2, 1]]
    chord = (end - start).reshape(-1, 3)[here]
    bend = facets.bend.reshape(-1, 3)[here]
    both = np.einsum("ei,ej->eij", bend, chord)
    length2 = np.einsum("ei,ei->e", chord, chord)
    return np.asarray((both - both.transpose(0, 2, 1)) / length2[:, None, None])


def _join(*parts: Entries) -> Entries:
    return Entries(*map(np.concatenate, zip(*(vars(p).values() for p in parts), strict=True)))
