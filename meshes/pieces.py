"""Connected pieces of a mesh, their contacts, and accidental connections.

A piece is a part of a region whose cells are joined by faces. All here is small beside the mesh and
serves judging a case before anything is solved (`soundness.well_posedness`).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from app.foundation.arrays import Floats, Ints
from meshes.data import (
    MeshData,
    cell_faces,
    cell_volumes,
    components,
    exterior_facets,
    facet_areas,
    interface_nodes,
    same_triangles,
)
from meshes.facets import NODES, nodal_normals, shape_functions, surface

# Nodes this close, in parts of the mesh's diagonal, are meant to be one.
COINCIDENT = 1e-7
# Facets that meet at more than this angle are different faces [rad].
SMOOTH = np.radians(50)
# Least cosine between the normal of a facet and the reversed one of a facet on which it lies.
FACING = 0.9

# Nodes of a facet, the middle of each edge in the place of the vertex opposite, as in `NODES`.
OPPOSITE = [0, 1, 2, 4, 5, 3]


@dataclass(frozen=True)
class Piece:
    """A connected part of a region.

    Attributes:
        cells: Number of cells.
        centre: Centroid (3,) [mm].
        volume: Volume [mm3].
        surface: Area of its surface [mm2].
        box: Edges of its bounding box (3,) [mm].
        free: Unsupported fraction of its surface.
    """

    region: str
    cells: int
    centre: Floats
    volume: float
    surface: float
    box: Floats
    free: float

    @property
    def edge(self) -> float:
        """Edge of a regular tetrahedron of the mean cell volume [mm]."""
        return float((6 * np.sqrt(2) * self.volume / self.cells) ** (1 / 3))

    @property
    def thickness(self) -> float:
        """Thickness of a bar, plate or shell of its length, volume and surface [mm].

        The lesser side h of a section b h with perimeter 2 (b + h), exact for a block.
        """
        length = float(self.box.max())
        section = self.volume / length
        quarter = (self.surface - 2 * section) / length / 4
        return quarter - float(np.sqrt(max(quarter**2 - section, 0.0)))


@dataclass(frozen=True)
class Touch:
    """Facets between two pieces.

    Attributes:
        pieces: The two pieces.
        x: Middles of the facets (n, 3) [mm].
        normals: Their unit normals (n, 3).
        areas: Their areas (n,) [mm2].
        bend: Mean angle between neighbouring facets of a smooth face; 0 if they are curved [rad].
    """

    pieces: tuple[int, int]
    x: Floats
    normals: Floats
    areas: Floats
    bend: float


@dataclass(frozen=True)
class Parts:
    """Pieces of a mesh and their contacts.

    Attributes:
        pieces: All pieces.
        touches: Facets shared by pieces of different regions.
        joined: Pairs of pieces of one region that share nodes.
        boundaries: For each boundary and piece the nodes of the piece on it (n,).
        normals: Mean unit normals at the nodes of some boundaries, zero elsewhere (n, 3).
        doubled: Positions of coincident nodes of each pair of regions (n, 3) [mm].
        faces: Boundaries of the two sides of interfaces that are meshed apart, by name.
    """

    data: MeshData
    pieces: tuple[Piece, ...]
    touches: tuple[Touch, ...]
    joined: frozenset[tuple[int, int]]
    boundaries: Mapping[str, Mapping[int, Ints]]
    normals: Mapping[str, Floats]
    doubled: Mapping[tuple[str, str], Floats]
    faces: Mapping[str, tuple[str, str]]

    @property
    def x(self) -> Floats:
        """Coordinates of all nodes (n, 3) [mm]."""
        return self.data.points

    def corners_of(self, region: str) -> Ints:
        """Corner nodes of the cells of a region (n, 4)."""
        return self.data.cells[self.data.cell_tags == self.data.regions[region], :4]

    def on_interface(self, name: str) -> Ints:
        """Corner nodes of the facets of an interface, or of its second side (n,)."""
        return interface_nodes(self.data, name, self.faces)


def parts(
    data: MeshData,
    held: Collection[str] = (),
    curved: Collection[str] = (),
    apart: Mapping[str, tuple[str, str]] | None = None,
) -> Parts:
    """Connected pieces of a mesh, their contacts and boundaries.

    ``held`` are the boundaries with supports, ``curved`` those whose normals are wanted, ``apart``
    the two of each interface that is meshed apart: the smaller one touches the other.
    """
    names = {tag: name for name, tag in data.regions.items()}
    piece = components(data.neighbours, data.cell_tags)
    count = int(piece.max()) + 1
    faces = cell_faces(data.cells)
    cell = np.repeat(np.arange(len(data.cells)), 4)
    # The pieces on both sides of each face, -1 outside.
    mine, behind = piece[cell], data.neighbours.ravel()
    other = np.where(behind < 0, -1, piece[behind])
    outside = np.flatnonzero(behind < 0)
    keys, on = same_triangles(faces[outside, :3], data.facets[:, :3])
    order = np.argsort(keys)
    at = order[np.searchsorted(keys, on, sorter=order).clip(max=len(keys) - 1)]
    exterior = keys[at] == on
    cell_of_facet = np.where(exterior, cell[outside[at]], -1)
    piece_of_facet = np.where(exterior, piece[cell_of_facet], -1)
    bare = mine != other
    tags = [t for name in held for t in data.boundaries.get(name, ())]
    bare[outside[np.isin(keys, on[np.isin(data.facet_tags, tags)])]] = False
    areas, free = (
        np.bincount(mine[some], facet_areas(data.points, faces[some]), minlength=count)
        for some in (mine != other, bare)
    )
    volumes = cell_volumes(data.points, data.cells)
    middles = data.points[data.cells[:, :4]].mean(axis=1)
    pieces = []
    for k in range(count):
        here = piece == k
        volume = float(volumes[here].sum())
        centre = volumes[here] @ middles[here] / volume
        box = np.ptp(data.points[np.unique(data.cells[here, :4])], axis=0)
        region, part = names[int(data.cell_tags[here][0])], float(free[k] / areas[k])
        pieces.append(Piece(region, int(here.sum()), centre, volume, float(areas[k]), box, part))
    rows = np.flatnonzero(mine < other)
    touches = _touches(data.points, faces[rows], mine[rows], other[rows])
    for sides in (apart or {}).values():
        touches += _facing(data, sides, piece_of_facet)
    return Parts(
        data=data,
        pieces=tuple(pieces),
        touches=tuple(touches),
        joined=_joined(data.cells, piece, pieces),
        boundaries={name: _nodes_on(data, name, piece_of_facet) for name in data.boundaries},
        normals={name: _normals(data, name, cell_of_facet, middles) for name in curved},
        doubled=_doubled(data, piece, pieces),
        faces=apart or {},
    )


def _touches(points: Floats, facets: Ints, first: Ints, second: Ints) -> list[Touch]:
    middle, x = np.full((1, 3), 1 / 3), points[facets[:, OPPOSITE[: facets.shape[1]]]]
    centres = (shape_functions(middle, facets.shape[1]) @ x)[:, 0]
    normals, double = (v[:, 0] for v in surface(x, middle))
    touches = []
    for a, b in sorted({(int(a), int(b)) for a, b in zip(first, second, strict=True)}):
        here = (first == a) & (second == b)
        bend = _bend(facets[here], normals[here]) if facets.shape[1] == 3 else 0.0
        touches.append(Touch((a, b), centres[here], normals[here], double[here] / 2, bend))
    return touches


def _facing(data: MeshData, sides: tuple[str, str], piece: Ints) -> list[Touch]:
    """Touch of two boundaries, on the smaller one, from the piece of each tagged facet."""
    on = [np.isin(data.facet_tags, data.boundaries.get(name, ())) for name in sides]
    small, large = sorted(on, key=lambda side: facet_areas(data.points, data.facets[side]).sum())
    second = np.full(small.sum(), piece[large][0] if small.any() else 0)
    return _touches(data.points, data.facets[small], piece[small], second)


def _bend(facets: Ints, normals: Floats) -> float:
    """Mean angle between neighbouring facets, except at sharp edges of the surface [rad]."""
    _, _, angles = _neighbours(facets, normals)
    smooth = angles[angles < SMOOTH]
    return float(smooth.mean()) if len(smooth) else 0.0


def _neighbours(facets: Ints, normals: Floats) -> tuple[Ints, Ints, Floats]:
    """Pairs of facets that share an edge (e,) and (e,), and the angles between them (e,) [rad]."""
    edges = np.sort(facets[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    order = np.lexsort(edges.T)
    same = np.flatnonzero((edges[order][1:] == edges[order][:-1]).all(axis=1))
    one, two = order[same] // 3, order[same + 1] // 3
    cosines = np.einsum("ei,ei->e", normals[one], normals[two])
    return one, two, np.arccos(np.clip(cosines, -1.0, 1.0))


def _joined(cells: Ints, piece: Ints, pieces: list[Piece]) -> frozenset[tuple[int, int]]:
    """Pieces of one region that meet in edges or corners alone."""
    nodes = [np.unique(cells[piece == k, :4]) for k in range(len(pieces))]
    return frozenset(
        (a, b)
        for a, b in combinations(range(len(pieces)), 2)
        if pieces[a].region == pieces[b].region and np.isin(nodes[a], nodes[b]).any()
    )


def _nodes_on(data: MeshData, name: str, piece: Ints) -> dict[int, Ints]:
    """Nodes of each piece on a boundary, from the piece of each tagged facet, -1 if none."""
    here = np.isin(data.facet_tags, data.boundaries[name]) & (piece >= 0)
    return {int(k): np.unique(data.facets[here & (piece == k)]) for k in np.unique(piece[here])}


def _normals(data: MeshData, name: str, cell: Ints, middles: Floats) -> Floats:
    """Mean normals of a boundary at all nodes (n, 3), zero off the boundary.

    ``cell`` is the cell of each tagged facet, -1 if none; ``middles`` are points in cells [mm].
    """
    here = np.isin(data.facet_tags, data.boundaries.get(name, ())) & (cell >= 0)
    facets, sums = data.facets[here], np.zeros(data.points.shape)
    facets = facets[:, OPPOSITE[: facets.shape[1]]]
    at = NODES[: facets.shape[1]]
    np.add.at(sums, facets, nodal_normals(data.points[facets], middles[cell[here]], at))
    size = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.divide(sums, size, out=sums, where=size > 0)


def coincident(points: Floats) -> Ints:
    """Pairs of points (k, 2) that are equal but for rounding.

    Sorting along a random direction leaves few candidates.
    """
    near = COINCIDENT * float(np.linalg.norm(np.ptp(points, axis=0)))
    along = points @ np.random.default_rng(0).normal(size=3)
    order = np.argsort(along)
    sorted_, pairs = along[order], [np.zeros((0, 2), dtype=np.int64)]
    for shift in range(1, len(points)):
        close = np.flatnonzero(sorted_[shift:] - sorted_[:-shift] <= 3 * near)
        if not len(close):
            break
        a, b = order[close], order[close + shift]
        same = np.linalg.norm(points[a] - points[b], axis=1) <= near
        pairs.append(np.sort(np.column_stack([a, b])[same], axis=1))
    return np.concatenate(pairs)


def _doubled(data: MeshData, piece: Ints, pieces: list[Piece]) -> dict[tuple[str, str], Floats]:
    """Positions where two nodes coincide, by the pair of their regions."""
    of_node = np.zeros(len(data.points), dtype=np.int64)
    of_node[data.cells] = piece[:, None]
    places: dict[tuple[str, str], list[Floats]] = {}
    for a, b in coincident(data.points):
        one, two = sorted(pieces[int(of_node[k])].region for k in (a, b))
        places.setdefault((one, two), []).append(data.points[a])
    return {names: np.array(x) for names, x in places.items()}


def lying(data: MeshData) -> dict[tuple[str, str], tuple[float, Floats]]:
    """Faces of two bodies that lie on each other and share no node.

    A facet lies on another body if its middle is within a facet of that body with the opposite
    direction, as near to it as straight facets of one smooth surface are.

    Returns:
        Area [mm2] and a point on it (3,) [mm], by the pair of regions.
    """
    names = {tag: name for name, tag in data.regions.items()}
    facets, cells = exterior_facets(data.cells)
    facets = facets[:, :3]
    bodies = components(data.neighbours, np.zeros(len(data.cells), dtype=np.int32))
    body = bodies[cells]
    if body.max(initial=0) == 0:
        return {}
    x = data.points[facets]
    normals = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    areas = np.linalg.norm(normals, axis=1) / 2
    normals /= np.maximum(2 * areas, np.finfo(float).tiny)[:, None]
    middles = x.mean(axis=1)
    rise = _rise(x, facets, np.asarray(normals, dtype=float))
    least = COINCIDENT * float(np.linalg.norm(np.ptp(data.points, axis=0)))
    area: dict[tuple[str, str], float] = {}
    place: dict[tuple[str, str], Floats] = {}
    for a, b in combinations(range(int(body.max()) + 1), 2):
        each = [np.flatnonzero(body == k) for k in (a, b)]
        margin = max(float(rise[rows].max()) for rows in each) + least
        low = np.max([x[rows].min(axis=(0, 1)) for rows in each], axis=0) - margin
        high = np.min([x[rows].max(axis=(0, 1)) for rows in each], axis=0) + margin
        # Facets in the box that both bodies share.
        near = [
            rows[
                (x[rows].max(axis=1) >= low).all(axis=1) & (x[rows].min(axis=1) <= high).all(axis=1)
            ]
            for rows in each
        ]
        if not all(map(len, near)):
            continue
        both: dict[tuple[str, str], list[float]] = {}
        for one, two in (near, near[::-1]):
            on = _lies_on(
                middles[one], normals[one], rise[one] + least, x[two], normals[two], rise[two]
            )
            hit = np.flatnonzero(on >= 0)
            first, second = one[hit], two[on[hit]]
            tags = np.sort(
                np.column_stack([data.cell_tags[cells[first]], data.cell_tags[cells[second]]])
            )
            for tag in np.unique(tags, axis=0):
                here = first[(tags == tag).all(axis=1)]
                lower, upper = sorted(names[int(t)] for t in tag)
                both.setdefault((lower, upper), []).append(float(areas[here].sum()))
                place.setdefault((lower, upper), middles[here[0]])
        for pair, measured in both.items():
            area[pair] = area.get(pair, 0.0) + max(measured)
    return {pair: (area[pair], place[pair]) for pair in area}


def _rise(x: Floats, facets: Ints, normals: Floats) -> Floats:
    """Largest distance of each facet from the smooth surface through its nodes (k,) [mm]."""
    one, two, angle = _neighbours(facets, normals)
    angle[(angle > SMOOTH) | (angle < 1e-6)] = 0.0
    bend = np.zeros(len(facets))
    np.maximum.at(bend, one, angle)
    np.maximum.at(bend, two, angle)
    length = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).max(axis=1)
    return np.asarray(length * bend / 8)


def _lies_on(
    middles: Floats, normals: Floats, within: Floats, x: Floats, other: Floats, rise: Floats
) -> Ints:
    """Return the facet on which each middle lies, -1 if on none (k,)."""
    from scipy.spatial import cKDTree

    centres = x.mean(axis=1)
    count = min(12, len(centres))
    facet = np.full(len(middles), -1, dtype=np.int64)
    _, candidates = cKDTree(centres).query(middles, count)
    for column in candidates.reshape(len(middles), count).T:
        offset = middles - x[column, 0]
        n = other[column]
        height = np.einsum("ki,ki->k", offset, n)
        inside = np.abs(height) <= within + rise[column]
        inside &= np.einsum("ki,ki->k", normals, n) < -FACING
        for i in range(3):
            start, end = x[column, i], x[column, (i + 1) % 3]
            side = np.einsum("ki,ki->k", np.cross(end - start, middles - start), n)
            inside &= side >= -1e-9 * np.einsum("ki,ki->k", end - start, end - start)
        facet[inside & (facet < 0)] = column[inside & (facet < 0)]
    return facet
