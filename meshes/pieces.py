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
    connected_components,
    exterior_facets,
    facet_areas,
    interface_nodes,
)
from meshes.facets import NODES, OPPOSITE, facet_shape_functions, nodal_normals, normals_and_areas

# Nodes this close, as a fraction of the mesh's diagonal, are meant to be one.
COINCIDENT = 1e-7
# Facets that meet at more than this angle are different faces [rad].
SMOOTH_ANGLE = np.radians(50)
# Least cosine between the normal of a facet and the reversed one of a facet on which it lies.
LEAST_COSINE = 0.9


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
class MeshPieces:
    """Pieces of a mesh and their contacts.

    Attributes:
        pieces: All pieces.
        touches: Facets shared by pieces of different regions.
        joined: Pairs of pieces of one region that share nodes.
        boundaries: For each boundary and piece the nodes of the piece on it (n,).
        normals: Mean unit normals at the nodes of some boundaries, zero elsewhere (n, 3).
        doubled: Positions of coincident nodes of each pair of regions (n, 3) [mm].
        sliding_boundaries: Boundaries of the two sides of interfaces meshed apart, by name.
    """

    data: MeshData
    pieces: tuple[Piece, ...]
    touches: tuple[Touch, ...]
    joined: frozenset[tuple[int, int]]
    boundaries: Mapping[str, Mapping[int, Ints]]
    normals: Mapping[str, Floats]
    doubled: Mapping[tuple[str, str], Floats]
    sliding_boundaries: Mapping[str, tuple[str, str]]

    @property
    def x(self) -> Floats:
        """Coordinates of all nodes (n, 3) [mm]."""
        return self.data.points

    def corners_of(self, region: str) -> Ints:
        """Corner nodes of the cells of a region (n, 4)."""
        return self.data.cells[self.data.cell_tags == self.data.regions[region], :4]

    def on_interface(self, name: str) -> Ints:
        """Corner nodes of the facets of an interface, or of its second side (n,)."""
        return interface_nodes(self.data, name, self.sliding_boundaries)


def pieces_of_mesh(
    data: MeshData,
    supported: Collection[str] = (),
    with_normals: Collection[str] = (),
    meshed_apart: Mapping[str, tuple[str, str]] | None = None,
) -> MeshPieces:
    """Connected pieces of a mesh, their contacts and boundaries.

    Args:
        data: The mesh.
        supported: Boundaries with supports.
        with_normals: Boundaries whose normals are computed.
        meshed_apart: Both boundaries of each interface that is meshed apart. The smaller one
            touches the other.
    """
    piece = connected_components(data.neighbours, data.cell_tags)
    count = int(piece.max()) + 1
    faces = cell_faces(data.cells)
    cell = np.repeat(np.arange(len(data.cells)), 4)
    # The pieces on both sides of each face, -1 outside.
    piece_of_face, behind = piece[cell], data.neighbours.ravel()
    piece_behind = np.where(behind < 0, -1, piece[behind])
    exterior = data.faces_of_facets >= 0
    cell_of_facet = data.faces_of_facets // 4
    piece_of_facet = np.where(exterior, piece[cell_of_facet], -1)
    is_free = piece_of_face != piece_behind
    tags = [t for name in supported for t in data.boundaries.get(name, ())]
    is_free[data.faces_of_facets[exterior & np.isin(data.facet_tags, tags)]] = False
    areas: Floats
    free: Floats
    areas, free = (
        np.bincount(
            piece_of_face[mask], facet_areas(data.points, faces[mask]), minlength=count
        ).astype(float)
        for mask in (piece_of_face != piece_behind, is_free)
    )
    middles = data.points[data.cells[:, :4]].mean(axis=1)
    pieces = _pieces(data, piece, middles, areas, free)
    rows = np.flatnonzero(piece_of_face < piece_behind)
    touches = _touches(data.points, faces[rows], piece_of_face[rows], piece_behind[rows])
    for sides in (meshed_apart or {}).values():
        touches += _facing(data, sides, piece_of_facet)
    return MeshPieces(
        data=data,
        pieces=tuple(pieces),
        touches=tuple(touches),
        joined=_joined(data.cells, piece, pieces),
        boundaries={name: _nodes_on(data, name, piece_of_facet) for name in data.boundaries},
        normals={name: _normals(data, name, cell_of_facet, middles) for name in with_normals},
        doubled=_doubled(data, piece, pieces),
        sliding_boundaries=meshed_apart or {},
    )


def _pieces(
    data: MeshData, piece_of_cell: Ints, middles: Floats, areas: Floats, free: Floats
) -> list[Piece]:
    """The connected pieces of a mesh.

    Args:
        data: The mesh.
        piece_of_cell: Piece of each cell (m,).
        middles: Middles of the cells (m, 3) [mm].
        areas: Surface of each piece [mm2].
        free: Part of it without support and contact [mm2].
    """
    name_of_tag = {tag: name for name, tag in data.regions.items()}
    volumes = cell_volumes(data.points, data.cells)
    pieces = []
    for k, (area, free_area) in enumerate(zip(areas, free, strict=True)):
        in_piece = piece_of_cell == k
        volume = float(volumes[in_piece].sum())
        centre = volumes[in_piece] @ middles[in_piece] / volume
        box = np.ptp(data.points[np.unique(data.cells[in_piece, :4])], axis=0)
        region = name_of_tag[int(data.cell_tags[in_piece][0])]
        free_fraction = float(free_area / area)
        pieces.append(
            Piece(region, int(in_piece.sum()), centre, volume, float(area), box, free_fraction)
        )
    return pieces


def _touches(points: Floats, facets: Ints, first_piece: Ints, second_piece: Ints) -> list[Touch]:
    middle, x = np.full((1, 3), 1 / 3), points[facets[:, OPPOSITE[: facets.shape[1]]]]
    centres = (facet_shape_functions(middle, facets.shape[1]) @ x)[:, 0]
    normals, double_areas = (values[:, 0] for values in normals_and_areas(x, middle))
    touches = []
    for a, b in sorted({(int(a), int(b)) for a, b in zip(first_piece, second_piece, strict=True)}):
        is_between = (first_piece == a) & (second_piece == b)
        bend = _bend(facets[is_between], normals[is_between]) if facets.shape[1] == 3 else 0.0
        touches.append(
            Touch(
                (a, b), centres[is_between], normals[is_between], double_areas[is_between] / 2, bend
            )
        )
    return touches


def _facing(data: MeshData, sides: tuple[str, str], piece_of_facet: Ints) -> list[Touch]:
    """Contact of two boundaries meshed apart, on the facets of the smaller one.

    ``piece_of_facet`` has the piece of each tagged facet.
    """
    masks = [np.isin(data.facet_tags, data.boundaries.get(name, ())) for name in sides]
    smaller, larger = sorted(
        masks, key=lambda side: facet_areas(data.points, data.facets[side]).sum()
    )
    other_piece = np.full(smaller.sum(), piece_of_facet[larger][0] if smaller.any() else 0)
    return _touches(data.points, data.facets[smaller], piece_of_facet[smaller], other_piece)


def _bend(facets: Ints, normals: Floats) -> float:
    """Mean angle between neighbouring facets, except at sharp edges of the surface [rad]."""
    _, _, angles = _neighbours(facets, normals)
    smooth = angles[angles < SMOOTH_ANGLE]
    return float(smooth.mean()) if len(smooth) else 0.0


def _neighbours(facets: Ints, normals: Floats) -> tuple[Ints, Ints, Floats]:
    """Pairs of facets that share an edge (e,) and (e,), and the angles between them (e,) [rad]."""
    edges = np.sort(facets[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    order = np.lexsort(edges.T)
    pairs = np.flatnonzero((edges[order][1:] == edges[order][:-1]).all(axis=1))
    first, second = order[pairs] // 3, order[pairs + 1] // 3
    cosines = np.einsum("ei,ei->e", normals[first], normals[second])
    return first, second, np.arccos(np.clip(cosines, -1.0, 1.0))


def _joined(cells: Ints, piece_of_cell: Ints, pieces: list[Piece]) -> frozenset[tuple[int, int]]:
    """Pieces of one region that meet in edges or corners alone."""
    nodes = [np.unique(cells[piece_of_cell == k, :4]) for k in range(len(pieces))]
    return frozenset(
        (a, b)
        for a, b in combinations(range(len(pieces)), 2)
        if pieces[a].region == pieces[b].region and np.isin(nodes[a], nodes[b]).any()
    )


def _nodes_on(data: MeshData, name: str, piece_of_facet: Ints) -> dict[int, Ints]:
    """Nodes of each piece on a boundary, from the piece of each tagged facet, -1 if none."""
    on_boundary = np.isin(data.facet_tags, data.boundaries[name]) & (piece_of_facet >= 0)
    return {
        int(k): np.unique(data.facets[on_boundary & (piece_of_facet == k)])
        for k in np.unique(piece_of_facet[on_boundary])
    }


def _normals(data: MeshData, name: str, cell: Ints, middles: Floats) -> Floats:
    """Mean normals of a boundary at all nodes (n, 3), zero off the boundary.

    ``cell`` is the cell of each tagged facet, -1 if none; ``middles`` are points in cells [mm].
    """
    on_boundary = np.isin(data.facet_tags, data.boundaries.get(name, ())) & (cell >= 0)
    facets, sums = data.facets[on_boundary], np.zeros(data.points.shape)
    facets = facets[:, OPPOSITE[: facets.shape[1]]]
    node_points = NODES[: facets.shape[1]]
    np.add.at(
        sums, facets, nodal_normals(data.points[facets], middles[cell[on_boundary]], node_points)
    )
    size = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.divide(sums, size, out=sums, where=size > 0)


def coincident(points: Floats) -> Ints:
    """Pairs of points (k, 2) that are equal but for rounding.

    Sorting along a random direction leaves few candidates.
    """
    tolerance = COINCIDENT * float(np.linalg.norm(np.ptp(points, axis=0)))
    projections = points @ np.random.default_rng(0).normal(size=3)
    order = np.argsort(projections)
    sorted_, pairs = projections[order], [np.zeros((0, 2), dtype=np.int64)]
    for shift in range(1, len(points)):
        candidates = np.flatnonzero(sorted_[shift:] - sorted_[:-shift] <= 3 * tolerance)
        if not len(candidates):
            break
        a, b = order[candidates], order[candidates + shift]
        is_same = np.linalg.norm(points[a] - points[b], axis=1) <= tolerance
        pairs.append(np.sort(np.column_stack([a, b])[is_same], axis=1))
    return np.concatenate(pairs)


def _doubled(
    data: MeshData, piece_of_cell: Ints, pieces: list[Piece]
) -> dict[tuple[str, str], Floats]:
    """Positions where two nodes coincide, by the pair of their regions."""
    piece_of_node = np.zeros(len(data.points), dtype=np.int64)
    piece_of_node[data.cells] = piece_of_cell[:, None]
    places: dict[tuple[str, str], list[Floats]] = {}
    for a, b in coincident(data.points):
        first_region, second_region = sorted(pieces[int(piece_of_node[k])].region for k in (a, b))
        places.setdefault((first_region, second_region), []).append(data.points[a])
    return {region_pair: np.array(x) for region_pair, x in places.items()}


def touching_without_shared_nodes(data: MeshData) -> dict[tuple[str, str], tuple[float, Floats]]:
    """Faces of two bodies that lie on each other and share no node.

    A facet lies on another body if its middle is within a facet of that body with the opposite
    direction, as near to it as straight facets of one smooth surface are.

    Returns:
        Area [mm2] and a point on it (3,) [mm], by the pair of regions.
    """
    name_of_tag = {tag: region for region, tag in data.regions.items()}
    facets, cells = exterior_facets(data.cells)
    facets = facets[:, :3]
    bodies = connected_components(data.neighbours, np.zeros(len(data.cells), dtype=np.int32))
    body = bodies[cells]
    if body.max(initial=0) == 0:
        return {}
    x = data.points[facets]
    area_vectors = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    areas = np.linalg.norm(area_vectors, axis=1) / 2
    lengths = np.maximum(2 * areas, np.finfo(float).tiny)
    normals: Floats = np.asarray(area_vectors / lengths[:, None], dtype=float)
    middles = x.mean(axis=1)
    rise = _rise(x, facets, normals)
    tolerance = COINCIDENT * float(np.linalg.norm(np.ptp(data.points, axis=0)))
    area: dict[tuple[str, str], float] = {}
    point_on_pair: dict[tuple[str, str], Floats] = {}
    for a, b in combinations(range(int(body.max()) + 1), 2):
        body_facets = [np.flatnonzero(body == k) for k in (a, b)]
        margin = max(float(rise[rows].max()) for rows in body_facets) + tolerance
        near_facets = _in_common_box(x, body_facets, margin)
        if not all(map(len, near_facets)):
            continue
        pair_areas: dict[tuple[str, str], list[float]] = {}
        for rows_of_one, rows_of_other in (near_facets, near_facets[::-1]):
            facet_below = _lies_on(
                middles[rows_of_one],
                normals[rows_of_one],
                rise[rows_of_one] + tolerance,
                x[rows_of_other],
                normals[rows_of_other],
                rise[rows_of_other],
            )
            lying_rows = np.flatnonzero(facet_below >= 0)
            lying_facets = rows_of_one[lying_rows]
            facets_below = rows_of_other[facet_below[lying_rows]]
            tags = np.sort(
                np.column_stack(
                    [data.cell_tags[cells[lying_facets]], data.cell_tags[cells[facets_below]]]
                )
            )
            for tag in np.unique(tags, axis=0):
                of_pair = lying_facets[(tags == tag).all(axis=1)]
                lower, upper = sorted(name_of_tag[int(t)] for t in tag)
                pair_areas.setdefault((lower, upper), []).append(float(areas[of_pair].sum()))
                point_on_pair.setdefault((lower, upper), middles[of_pair[0]])
        for pair, side_areas in pair_areas.items():
            area[pair] = area.get(pair, 0.0) + max(side_areas)
    return {pair: (area[pair], point_on_pair[pair]) for pair in area}


def _in_common_box(x: Floats, body_facets: list[Ints], margin: float) -> list[Ints]:
    """Facets of each body in the common part of the bounding boxes of the bodies.

    Args:
        x: Corners of all facets (k, 3, 3) [mm].
        body_facets: Rows of the facets of each body.
        margin: Distance by which the common box is extended [mm].
    """
    lower = np.max([x[rows].min(axis=(0, 1)) for rows in body_facets], axis=0) - margin
    upper = np.min([x[rows].max(axis=(0, 1)) for rows in body_facets], axis=0) + margin
    is_inside = (x.max(axis=1) >= lower).all(axis=1) & (x.min(axis=1) <= upper).all(axis=1)
    return [rows[is_inside[rows]] for rows in body_facets]


def _rise(x: Floats, facets: Ints, normals: Floats) -> Floats:
    """Largest distance of each facet from the smooth surface through its nodes (k,) [mm]."""
    first_facet, second_facet, angle = _neighbours(facets, normals)
    angle[(angle > SMOOTH_ANGLE) | (angle < 1e-6)] = 0.0
    bend = np.zeros(len(facets))
    np.maximum.at(bend, first_facet, angle)
    np.maximum.at(bend, second_facet, angle)
    length = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).max(axis=1)
    return np.asarray(length * bend / 8)


def _lies_on(
    middles: Floats,
    normals: Floats,
    tolerances: Floats,
    x: Floats,
    other_normals: Floats,
    rise: Floats,
) -> Ints:
    """Return the facet on which each middle lies, -1 if on none (k,)."""
    from scipy.spatial import cKDTree

    centres = x.mean(axis=1)
    count = min(12, len(centres))
    facet = np.full(len(middles), -1, dtype=np.int64)
    _, candidates = cKDTree(centres).query(middles, count)
    for column in candidates.reshape(len(middles), count).T:
        offset = middles - x[column, 0]
        normal = other_normals[column]
        height = np.einsum("ki,ki->k", offset, normal)
        inside = np.abs(height) <= tolerances + rise[column]
        inside &= np.einsum("ki,ki->k", normals, normal) < -LEAST_COSINE
        for i in range(3):
            start, end = x[column, i], x[column, (i + 1) % 3]
            side = np.einsum("ki,ki->k", np.cross(end - start, middles - start), normal)
            inside &= side >= -1e-9 * np.einsum("ki,ki->k", end - start, end - start)
        facet[inside & (facet < 0)] = column[inside & (facet < 0)]
    return facet
