"""Refinement of any mesh by bisection: marked cells, and what conformity asks for beside them.

The edges of the marked cells are halved, then, until nothing changes, the longest edge of every
cell and of every face that has a halved edge (Plaza and Rivara 2003, after Rivara 1984). A cell is
cut at its halved edges in turn, the longest first, which cuts a face alike from both sides. Angles
stay bounded, however often it is repeated. Pieces of a curved cell are parts of the same quadratic
map: no surface moves, and the shape functions of the mesh before are among those of the new one.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import combinations

import numpy as np

from app.arrays import Bools, Floats, Ints
from app.errors import GeometryError
from meshes.data import EDGES, MeshData, canonical

# Barycentric coordinates of the nodes of a quadratic tetrahedron (10, 4).
NODES = np.concatenate([np.eye(4), np.eye(4)[np.array(EDGES)].mean(axis=1)])
# Edges of each face of a tetrahedron, as rows of EDGES.
FACE_EDGES = np.array(((0, 1, 2), (0, 3, 5), (2, 3, 4), (1, 4, 5)))
# Vertices of a quadratic facet with a node between them.
SIDES = ((0, 1), (1, 2), (2, 0))
# How far a place may be from the centre of its cell [mm].
NEAR = 1e-3
_BASE = 1 << 31  # more than there are nodes


def divided(data: MeshData, passes: Iterable[Floats]) -> MeshData:
    """Refine a mesh where cells are named by their centres, in one pass after the other.

    Args:
        data: The mesh.
        passes: For each pass, centres of the corners of cells to be divided (k, 3) [mm].

    Raises:
        GeometryError: A place is not the centre of a cell.
    """
    from scipy.spatial import cKDTree  # imported late: few meshes need it

    for places in passes:
        away, cell = cKDTree(centres(data)).query(places)
        if (away > NEAR).any():
            x, y, z = places[away.argmax()]
            raise GeometryError(
                f"mesh.divided: no cell has its centre at ({x:g}, {y:g}, {z:g}) mm; the file "
                "belongs to another mesh"
            )
        marked = np.zeros(len(data.cells), dtype=bool)
        marked[cell] = True
        data = canonical(divide(data, marked))
    return data


def centres(data: MeshData) -> Floats:
    """Centre of the corners of each cell (m, 3) [mm]."""
    return np.asarray(data.points[data.cells[:, :4]].mean(axis=1))


def divide(data: MeshData, marked: Bools) -> MeshData:
    """Halve the edges of marked cells (m,), and those that conformity and angles ask for.

    Regions, boundaries and interfaces are inherited.
    """
    edges = _Edges(data)
    edges.halve(marked)
    corners, parent = edges.cut(data.cells[:, :4])
    facets, of_facet = edges.cut(data.facets[:, :3])
    points = edges.points
    if data.curved:
        between = _Between(data, edges, corners, parent)
        points = between.points
        corners = np.column_stack([corners, between.nodes(corners, EDGES)])
        facets = np.column_stack([facets, between.nodes(facets, SIDES)])
    return replace(
        data,
        points=points,
        cells=corners,
        cell_tags=data.cell_tags[parent],
        facets=facets,
        facet_tags=data.facet_tags[of_facet],
        behind=None,
    )


class _Edges:
    """The edges of a mesh, which of them are halved, and the nodes in their middles.

    Attributes:
        keys: Both ends of each edge as one number, sorted (e,).
        halved: Which are halved (e,).
        middle: The node in the middle of each (e,).
        points: Nodes of the mesh, and of straight edges the middles that are new (n, 3) [mm].
    """

    def __init__(self, data: MeshData) -> None:
        """Number the edges."""
        pairs = data.cells[:, np.array(EDGES)]
        self.keys, row = np.unique(_key(pairs).ravel(), return_inverse=True)
        self._of_cell: Ints = row.reshape(-1, len(EDGES))
        ends = np.stack(np.divmod(self.keys, _BASE), axis=1)
        length = np.linalg.norm(np.diff(data.points[ends], axis=1)[:, 0], axis=1)
        # Place in the order of lengths, 0 the longest; equal but for rounding: in that of nodes.
        self._rank = np.empty(len(self.keys), dtype=np.int64)
        self._rank[np.lexsort((self.keys, -np.round(length, 9)))] = np.arange(len(self.keys))
        self.halved = np.zeros(len(self.keys), dtype=bool)
        self.points = data.points
        self.middle = np.full(len(self.keys), -1, dtype=np.int64)
        if data.curved:
            self.middle[self._of_cell] = data.cells[:, 4:]
        self._ends = ends

    def halve(self, marked: Bools) -> None:
        """Halve the edges of cells (m,), and the longest of all cells and faces that are cut."""
        new: Ints = self._of_cell[marked].ravel()
        while not self.halved[new].all():
            self.halved[new] = True
            longest = [new[:0]]
            for sides in (self._of_cell, self._of_cell[:, FACE_EDGES].reshape(-1, 3)):
                cut = sides[self.halved[sides].any(axis=1)]
                longest.append(cut[np.arange(len(cut)), self._rank[cut].argmin(axis=1)])
            new = np.concatenate(longest)
        if (self.middle < 0).any():
            ends = self._ends[self.halved]
            self.middle[self.halved] = len(self.points) + np.arange(len(ends))
            self.points = np.concatenate([self.points, self.points[ends].mean(axis=1)])

    def find(self, pairs: Ints) -> tuple[Ints, Bools]:
        """Numbers of the edges between nodes (..., 2), and whether there are such edges."""
        key = _key(pairs)
        at = np.minimum(np.searchsorted(self.keys, key), len(self.keys) - 1)
        return at, self.keys[at] == key

    def cut(self, corners: Ints) -> tuple[Ints, Ints]:
        """Cut cells (m, 4) or facets (m, 3) at halved edges; the pieces, and what each is of."""
        local = np.array(list(combinations(range(corners.shape[1]), 2)))
        parent: Ints = np.arange(len(corners), dtype=np.int64)
        whole: list[tuple[Ints, Ints]] = []
        while len(corners):
            at, there = self.find(corners[:, local])
            rank = np.where(there & self.halved[at], self._rank[at], len(self.keys))
            best, rows = rank.argmin(axis=1), np.arange(len(corners))
            cut = rank[rows, best] < len(self.keys)
            whole.append((corners[~cut], parent[~cut]))
            rows, best = rows[cut], best[cut]
            middle = self.middle[at[rows, best]]
            pieces = []
            for end in local[best].T:
                piece = corners[rows]
                piece[np.arange(len(rows)), end] = middle
                pieces.append(piece)
            corners, parent = np.concatenate(pieces), np.tile(parent[rows], 2)
        return np.concatenate([c for c, _ in whole]), np.concatenate([p for _, p in whole])


class _Between:
    """Nodes in the middles of the edges of the pieces of curved cells.

    Attributes:
        points: All nodes (n, 3) [mm].
    """

    def __init__(self, data: MeshData, edges: _Edges, corners: Ints, parent: Ints) -> None:
        """Put them where the quadratic maps of the cells before have them.

        Args:
            data: The mesh before.
            edges: Its edges.
            corners: Nodes at the corners of the pieces (p, 4).
            parent: The cell before that each is a piece of (p,).
        """
        pairs = corners[:, np.array(EDGES)]
        self._keys, first = np.unique(_key(pairs).ravel(), return_index=True)
        piece, edge = np.divmod(first, len(EDGES))
        ends, cells = pairs[piece, edge], data.cells[parent[piece]]
        at, old = edges.find(ends)
        self._node = np.where(old, edges.middle[at], -1)
        new = np.flatnonzero(~old)
        self._node[new] = len(data.points) + np.arange(len(new))
        ends, cells = ends[new], cells[new]
        place = (ends[:, :, None] == cells[:, None, :]).argmax(axis=2)
        λ = NODES[place].mean(axis=1)
        a, b = np.array(EDGES).T
        N = np.concatenate([λ * (2 * λ - 1), 4 * λ[:, a] * λ[:, b]], axis=1)
        moved = np.einsum("kn,kni->ki", N, data.points[cells])
        self.points = np.concatenate([data.points, moved])

    def nodes(self, corners: Ints, between: tuple[tuple[int, int], ...]) -> Ints:
        """Nodes between vertices of pieces or facets (k, 3 or 4); (k, edges)."""
        keys = _key(corners[:, np.array(between)])
        return np.asarray(self._node[np.searchsorted(self._keys, keys)])


def _key(pairs: Ints) -> Ints:
    """Two nodes (..., 2) as one number (...)."""
    return np.asarray(pairs.min(axis=-1) * _BASE + pairs.max(axis=-1))
