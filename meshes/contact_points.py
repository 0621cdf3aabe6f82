"""Contact points: where the two sides of an interface can part, on a conforming mesh.

A contact point is a mesh vertex seen from one interface. It carries:

* the jump of that interface: the displacement of the slave side minus that of the master side;
* the normals of its faces. Facets that meet at less than 30 degrees are one face. A vertex on an
  edge has two faces, on a corner three;
* its area: the integral of its linear shape function over the facets around it, a third of each
  flat facet.

On curved cells normals are those of the curved facets, so that a smooth surface is one face on any
mesh. Straight facets have the normals of the smooth surface
that is fitted to their vertices (`meshes.smooth_normals`). The law acts along these normals; area
and force are those of the facets around the point.

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
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints
from app.foundation.errors import InputError
from meshes.contact_facets import (
    InterfaceFacets,
    bends,
    drop_held,
    faces_around,
    projectors,
    shared,
)

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Parts of a jump below this are rounding.
ROUNDING = 1e-12
# Number in place of a support where the supports of a rigid region together prescribe the motion.
RIGIDLY = np.iinfo(np.int64).max
# A direction is tangential to a face below this cosine with its normal.
TANGENTIAL = 1e-6
# Decimals to which cosines between normals are compared.
ALIKE = 1


@dataclass(frozen=True)
class ContactSurface:
    """Corners of the facets of all interfaces: the n points, then the dependent corners (m).

    Attributes:
        interface: Index of the interface (m,).
        vertex: Vertex number of the mesh file (m,).
        dof: Global blocked dof at the vertex (m,).
        x: Position (m, 3) [mm].
        bodies: Bodies (master, slave) (m, 2).
        normals: Unit normals of the faces, zero beyond their number (m, 3, 3).
        faces: Number of faces (m,).
        weight: Area of the corner alone (m,) [mm2].
        triangles: For each interface, its facets as rows of corners (f_i, 3).
        facets: For each interface, the numbers of these facets (f_i,).
        shares: Weights of the points in the values of the corners (m, n); None if all are points.
        jumps: Jumps of the corners by those of the points (3 m, 3 n); None if all are points.
    """

    interface: Ints
    vertex: Ints
    dof: Ints
    x: Floats
    bodies: Ints
    normals: Floats
    faces: Ints
    weight: Floats
    triangles: tuple[Ints, ...]
    facets: tuple[Ints, ...]
    shares: csr_array | None = None
    jumps: csr_array | None = None

    def spread(self, values: Floats) -> Floats:
        """Values at the corners (m, ...) from those at the points (n, ...)."""
        if self.shares is None:
            return values
        flat = self.shares @ values.reshape(len(values), -1)
        return np.asarray(flat.reshape(-1, *values.shape[1:]))

    def true_jumps(self, jumps: Floats) -> Floats:
        """Jumps at the corners (m, 3) from the mean jumps of the points (n, 3) [mm]."""
        if self.jumps is None:
            return jumps
        return np.asarray((self.jumps @ jumps.ravel()).reshape(-1, 3))

    def spread_status(self, status: Ints) -> Ints:
        """States of the corners (m,); a dependent corner has that of its largest share."""
        if self.shares is None:
            return status
        return status[np.asarray(self.shares.toarray().argmax(axis=1)).ravel()]


@dataclass(frozen=True)
class Holds:
    """Constrained displacement components of vertices, body by body, replicated.

    Attributes:
        vertex: Vertex numbers of the mesh file (h,).
        body: Body (h,).
        support: Index of the support of each component, -1 where it is free (h, 3); `RIGIDLY`
            where the supports of a rigid region together prescribe the motion.
        rigid: Mask of nodes that move with a rigid region of the body (h,).
    """

    vertex: Ints
    body: Ints
    support: Ints
    rigid: Bools


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
        weight: Area of the point, with its part of dependent corners (n,) [mm2].
        doubt: Standard error of the direction of its normals (n,) [rad].
        given: Supports (master, slave) that fix each component of the jump, -1 where it is free
            (n, 3, 2).
        axes: Axes of these components, as columns (n, 3, 3).
        along: Projectors on prescribed directions that are tangential to all faces: friction acts
            along them, too (n, 3, 3).
        surface: All corners of the facets, also the dependent ones.
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
    along: Floats
    surface: ContactSurface

    @property
    def triangles(self) -> tuple[Ints, ...]:
        """For each interface, its facets as rows of corners of ``surface`` (f_i, 3)."""
        return self.surface.triangles

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
    facets: InterfaceFacets, holds: Holds, interfaces: Sequence[str], axes: Mapping[int, Floats]
) -> tuple[ContactPoints, Entries]:
    """Contact points of all interfaces, and the displacement of each body due to their jumps.

    ``interfaces`` are their names; ``axes`` (3, 3) are the local axes of vertices that have them.

    Raises:
        InputError: An interface has no point that could carry its force.
    """
    facet = np.repeat(np.arange(len(facets.area)), 3)
    keys = np.column_stack([facets.interface[facet], facets.vertices.ravel(), facets.bodies[facet]])
    every, first, of = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    of = of.ravel()
    normals, faces, area, doubt = faces_around(facets, of, len(every))
    supports = _supports_of(every[:, 1], every[:, 2:], holds)
    prescribed: Bools = np.any(np.all(supports >= 0, axis=1), axis=1)
    kept = _forest(facets, every, of, prescribed, normals, interfaces)
    # Points first, then dependent corners.
    order = np.concatenate([np.flatnonzero(kept), np.flatnonzero(~kept)])
    place = np.argsort(order)
    n, corners = int(kept.sum()), place[of].reshape(-1, 3)
    every, first, normals, faces, area = (v[order] for v in (every, first, normals, faces, area))
    interface, vertex, *_ = every.T
    bodies = every[:, 2:]
    stiffness = np.zeros((len(every), 2))
    np.maximum.at(stiffness, corners.ravel(), facets.stiffness[facet])
    _check_rigid(vertex[:n], bodies[:n], interface[:n], facets, holds, interfaces)
    given, signs = _jumps_at_vertices(vertex[:n], bodies[:n], stiffness[:n], holds)
    local_axes = np.tile(np.eye(3), (n, 1, 1))
    for p in np.flatnonzero(np.isin(vertex[:n], list(axes))):
        local_axes[p] = axes[int(vertex[p])]
    held = projectors(local_axes, given[:, :, 0] >= 0)
    dof, x = facets.dofs[:, :3].ravel()[first], facets.x.reshape(-1, 3)[first]
    of_interface = [np.flatnonzero(facets.interface == i) for i in range(len(interfaces))]
    surface = ContactSurface(
        interface=interface,
        vertex=vertex,
        dof=dof,
        x=x,
        bodies=bodies,
        normals=normals.copy(),
        faces=faces.copy(),
        weight=area,
        triangles=tuple(corners[f] for f in of_interface),
        facets=tuple(of_interface),
    )
    across = np.abs(np.einsum("pki,pic->pkc", normals[:n], local_axes)).max(axis=1)
    along = projectors(local_axes, (given[:, :, 0] >= 0) & (across < TANGENTIAL))
    drop_held(normals[:n], faces[:n], held)
    along[faces[:n] == 0] = 0.0
    surface.normals[:n], surface.faces[:n] = normals[:n], faces[:n]
    points = ContactPoints(
        interface=interface[:n],
        vertex=vertex[:n],
        dof=dof[:n],
        x=x[:n],
        bodies=bodies[:n],
        faces=faces[:n],
        normals=normals[:n],
        weight=area[:n],
        doubt=doubt[order[:n]],
        given=given,
        axes=local_axes,
        along=along,
        surface=surface,
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
    entries = Entries(body[k], 3 * node[k] + row, 3 * point[k] + column, value)
    if n == len(every):
        return points, entries
    return _in_means(points, entries, _handed_area(facets, corners, surface, held, interfaces))


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


def _handed_area(
    facets: InterfaceFacets,
    corners: Ints,
    surface: ContactSurface,
    held: Floats,
    names: Sequence[str],
) -> csr_array:
    """Areas that dependent corners give to points of their interface (m - n, n) [mm2].

    These points are the other corners of its facets, otherwise the nearest points of the same
    sides. A point with a prescribed component that the corner does not have is the last choice.

    Raises:
        InputError: There is no such point.
    """
    # Imported here: interfaces that do not meet need no scipy.
    from scipy.sparse import csr_array

    n, m = len(held), len(surface.weight)
    same = np.column_stack([surface.interface, surface.bodies])
    loose = ~held.any(axis=(1, 2))
    at_vertex: dict[int, Floats] = {}
    for p in np.flatnonzero(~loose):
        v = int(surface.vertex[p])
        at_vertex[v] = np.maximum(at_vertex.get(v, 0.0), np.abs(held[p]))
    rows: list[int] = []
    columns: list[int] = []
    areas: list[float] = []
    for f, k in zip(*np.nonzero(corners >= n), strict=True):
        c = int(corners[f, k])
        here = at_vertex.get(int(surface.vertex[c]), np.zeros((3, 3)))

        def takes(p: Ints, here: Floats = here) -> Bools:
            return np.asarray((np.abs(held[p]) <= here + ROUNDING).all(axis=(1, 2)))

        near = corners[f][corners[f] < n]
        to = near[takes(near)]
        if not len(to):
            every = np.flatnonzero((same[:n] == same[c]).all(axis=1))
            free = every[takes(every)]
            some = free if len(free) else every
            if not len(some):
                x, y, z = surface.x[c]
                raise InputError(
                    f"interfaces.{names[int(surface.interface[c])]}: all its nodes lie on lines "
                    f"where interfaces meet, e.g. at ({x:.4g}, {y:.4g}, {z:.4g}) mm, so none can "
                    "carry its force; use a finer mesh"
                )
            away = np.linalg.norm(surface.x[some] - surface.x[c], axis=1)
            to = some[np.isclose(away, away.min(), rtol=1e-6)]
        rows += [c - n] * len(to)
        columns += to.tolist()
        areas += [float(facets.area[f, k]) / len(to)] * len(to)
    return csr_array((areas, (rows, columns)), shape=(m - n, n))


def _in_means(
    points: ContactPoints, entries: Entries, handed: csr_array
) -> tuple[ContactPoints, Entries]:
    """Return points and entries with mean jumps as unknowns.

    The mean jumps D of the points are those of their jumps d and of the jumps A d of the dependent
    corners, by area: D = G d. The entries for D are those for d times G^-1. A component that
    supports prescribe stays the jump of the point.
    """
    # Imported here: interfaces that do not meet need no scipy.
    from scipy.sparse import bsr_array, csc_array, csr_array, diags_array, eye_array, vstack
    from scipy.sparse.linalg import inv

    n, surface = len(points.vertex), points.surface
    weight = points.weight + handed.sum(axis=0)
    A = _dependent_jumps(surface, n)
    of_point = diags_array(points.weight / weight, format="csr")
    mean = csr_array(of_point + csr_array(handed.multiply(1 / weight[None])).T @ A)
    blocks = np.eye(3) - projectors(points.axes, points.held)
    free = bsr_array((blocks, np.arange(n), np.arange(n + 1)), shape=(3 * n, 3 * n)).tocsr()
    one = eye_array(3 * n, format="csr")
    G = one + free @ (_three(mean) - one)
    affected = np.flatnonzero(np.diff(G.indptr) != 1)
    changed = np.unique(np.concatenate([affected, G[affected].indices]))
    part = csr_array(inv(csc_array(G[changed][:, changed])))
    local = part.tocoo()
    stay = np.setdiff1d(np.arange(3 * n), changed)
    row = np.concatenate([stay, changed[local.row]])
    column = np.concatenate([stay, changed[local.col]])
    value = np.concatenate([np.ones(len(stay)), local.data])
    keep = np.abs(value) > ROUNDING
    inverse = csr_array((value[keep], (row[keep], column[keep])), shape=(3 * n, 3 * n))
    parts = []
    for b in np.unique(entries.body):
        here = entries.body == b
        at, rows = np.unique(entries.row[here], return_inverse=True)
        where = rows.ravel(), entries.column[here]
        B = csr_array((entries.value[here], where), shape=(len(at), 3 * n)) @ inverse
        B = B.tocoo()
        on = np.abs(B.data) > ROUNDING
        parts.append((np.full(on.sum(), b), at[B.row[on]], B.col[on].astype(np.int64), B.data[on]))
    body, row, column, value = (np.concatenate(part) for part in zip(*parts, strict=True))
    total = diags_array(1 / surface.weight[n:], format="csr")
    every = vstack([eye_array(n, format="csr"), total @ handed], format="csr")
    jumps = _three(csr_array(vstack([eye_array(n, format="csr"), A], format="csr"))) @ inverse
    surface = replace(surface, shares=csr_array(every), jumps=csr_array(jumps))
    return replace(points, weight=weight, surface=surface), Entries(body, row, column, value)


def _three(scalar: csr_array) -> csr_array:
    """Return factors (m, n) for each of three components (3 m, 3 n)."""
    # Imported here: interfaces that do not meet need no scipy.
    from scipy.sparse import csr_array, eye_array, kron

    return csr_array(kron(scalar, eye_array(3), format="csr"))


def _dependent_jumps(surface: ContactSurface, n: int) -> csr_array:
    """Signs of the jumps of the n points in the jumps of the dependent corners (m - n, n)."""
    # Imported here: interfaces that do not meet need no scipy.
    from scipy.sparse import csr_array

    rows: list[int] = []
    columns: list[int] = []
    values: list[float] = []
    for c in range(n, len(surface.vertex)):
        at = np.flatnonzero(surface.vertex[:n] == surface.vertex[c])
        master, slave = map(int, surface.bodies[c])
        path: dict[int, dict[int, float]] = {master: {}}
        for _ in at:
            for p in map(int, at):
                a, b = map(int, surface.bodies[p])
                if a in path and b not in path:
                    path[b] = path[a] | {p: 1.0}
                elif b in path and a not in path:
                    path[a] = path[b] | {p: -1.0}
        rows += [c - n] * len(path[slave])
        columns += path[slave].keys()
        values += path[slave].values()
    return csr_array((values, (rows, columns)), shape=(len(surface.vertex) - n, n))


def _supports_of(vertex: Ints, sides: Ints, holds: Holds) -> Ints:
    """Return the support that holds each side of points along each axis, or -1 (n, 2, 3)."""
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
    moved = zip(map(int, holds.vertex[holds.rigid]), map(int, holds.body[holds.rigid]), strict=True)
    with_rigid = set(moved)
    of_sides = zip(map(int, np.repeat(vertex, 2)), map(int, sides.ravel()), strict=True)
    rigid = np.array([at in with_rigid for at in of_sides], dtype=bool).reshape(n, 2)
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
            base = sides[rows][rigid[rows]].tolist()
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
    moves = set(zip(map(int, holds.vertex[rigid]), map(int, holds.body[rigid]), strict=True))
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
