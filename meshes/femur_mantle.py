"""The mantle after meshing: the film at the endosteum."""

from __future__ import annotations

from typing import Any

import numpy as np

from .data import (
    EDGES,
    Floats,
    Ints,
    cell_volumes,
    components,
    face_neighbours,
)
from .femur_bone import Tube
from .femur_stem import Body

ISLAND = 50.0  # mm^3: smaller pieces of cancellous bone between cement and cortex become cement
FILM = 0.6  # mm of cancellous bone below which the cement reaches the cortex
SWEEPS = 20
# A node of the endosteum belongs to the mantle when less than this part of the film would remain
# over it. 0.65 gives the volume of the exact clip to 1 % at 2 mm and 0.3 % at 4 mm of cement.
REMAINDER = 0.65


def fill_film(
    points: Floats,
    cells: Ints,
    tags: Any,
    regions: dict[str, int],
    canal: Tube,
    offset: Body,
    film: float,
    bottom: float,
) -> tuple[Any, dict[str, Any]]:
    """Give the film to the cement wherever the canal has no room for cancellous bone.

    A cell of the film becomes cement when all its nodes that are not already on the mantle lie
    where little of the film would remain between the offset surface and the endosteum. Deciding
    by nodes rather than by centroids makes ramps one element wide, close to the exact clip, where
    centroids make steps: at 2 mm of cement and 2.5 mm elements 1.5 % of the interface is steeper
    than 53 degrees instead of 3.3 %, none is pinched instead of 12 edges, and no cell is isolated.

    Args:
        points: Nodes, shape (n, 3).
        cells: Tetrahedra, shape (m, 4 or 10).
        tags: Region of each cell.
        regions: Region names to tags.
        canal: The endosteal surface.
        offset: The stem's surface at the prescribed thickness.
        film: Width of the film [mm].
        bottom: Lower end of the mantle [mm].

    Returns:
        The new tags, and notes: the volume given, the pieces of cancellous bone (a mantle that
        fills the canal divides it), and the number of pinched edges left.
    """
    cement, cancellous = regions["cement"], regions["cancellous_bone"]
    tags = tags.copy()
    x, y, z = points.T
    theta = np.arctan2(y, x)
    gap = canal.radius(theta, z) - offset.radius(theta, z)
    in_mantle = np.zeros(len(points), dtype=bool)
    in_mantle[cells[tags == cement]] = True
    # Cells of the film, which alone may change.
    x, y, z = points[cells[:, :4]].mean(axis=1).T
    theta = np.arctan2(y, x)
    in_film = np.hypot(x, y) > canal.radius(theta, z) - 1.5 * film
    free = (tags == cancellous) & in_film & (z > bottom)
    narrow = np.all((gap < REMAINDER * film)[cells[:, :4]] | in_mantle[cells[:, :4]], axis=1)
    before = float(cell_volumes(points, cells)[tags == cement].sum())
    tags[free & narrow] = cement
    neighbours = face_neighbours(cells)
    for _ in range(SWEEPS):
        changed = _smooth(tags, neighbours, free, cement, cancellous)
        changed += _fill_pinches(cells, tags, free, cement)
        changed += _fill_islands(points, cells, tags, neighbours, cement, cancellous, bottom)
        if not changed:
            break
    volumes = cell_volumes(points, cells)
    _, piece = components(neighbours, tags)
    own = tags == cancellous
    return tags, {
        "film_given_to_cement_mm3": float(volumes[tags == cement].sum()) - before,
        "cancellous_pieces_mm3": sorted(
            float(v) for v in np.bincount(piece[own], volumes[own]) if v > 0
        )[::-1],
        "pinched_edges": len(_pinched_edges(cells, tags == cement)),
    }


def _smooth(tags: Any, neighbours: Ints, free: Any, cement: int, cancellous: int) -> int:
    """Flip cells of the film with three or more faces to the other material; returns how many."""
    beside = np.where(neighbours >= 0, tags[neighbours], -1)
    to_cement = free & (tags == cancellous) & ((beside == cement).sum(axis=1) >= 3)
    back = free & (tags == cement) & ((beside == cancellous).sum(axis=1) >= 3)
    tags[to_cement] = cement
    tags[back] = cancellous
    return int(to_cement.sum() + back.sum())


def _fill_islands(
    points: Floats,
    cells: Ints,
    tags: Any,
    neighbours: Ints,
    cement: int,
    cancellous: int,
    bottom: float,
) -> int:
    """Make cement of small pieces of cancellous bone beside the mantle; returns how many cells."""
    _, piece = components(neighbours, tags)
    own = np.flatnonzero(tags == cancellous)
    volume = np.bincount(piece[own], cell_volumes(points, cells[own]), minlength=piece.max() + 1)
    small = own[volume[piece[own]] < ISLAND]
    small = small[points[cells[small, :4], 2].mean(axis=1) > bottom]
    tags[small] = cement
    return len(small)


def _boundary_edges(cells: Ints, inside: Any) -> tuple[Ints, Ints]:
    """Edges of the faces between the marked cells and the others, and how many such faces each."""
    neighbours = face_neighbours(cells)
    cell = np.repeat(np.arange(len(cells)), 4)
    other = neighbours.ravel()
    rows = inside[cell] & np.where(other >= 0, ~inside[other], True)
    faces = cells[:, [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]].reshape(-1, 3)[rows]
    edges = np.sort(faces[:, [(0, 1), (1, 2), (2, 0)]].reshape(-1, 2), axis=1)
    return np.unique(edges, axis=0, return_counts=True)


def _pinched_edges(cells: Ints, inside: Any) -> Ints:
    """Edges where the surface of the marked cells meets itself (four faces or more)."""
    edges, count = _boundary_edges(cells, inside)
    return edges[count > 2]


def _fill_pinches(cells: Ints, tags: Any, free: Any, cement: int) -> int:
    """Give the film around pinched edges to the cement; returns how many cells."""
    edges = _pinched_edges(cells, tags == cement)
    if not len(edges):
        return 0
    size = int(cells.max()) + 1
    ends = np.sort(cells[:, np.array(EDGES)], axis=2)
    around = np.isin(ends[..., 0] * size + ends[..., 1], edges[:, 0] * size + edges[:, 1])
    change = around.any(axis=1) & free & (tags != cement)
    tags[change] = cement
    return int(change.sum())
