"""Quality of meshes, generated and imported alike: one measure; curved cells straightened by it."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import count, product
from typing import Any

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints
from app.foundation.errors import GeometryError
from meshes.data import MeshData, Tags, cell_faces, dot, edge_vectors, match_faces, tangents
from meshes.shape_functions import GMSH_TETRAHEDRON, node_coordinates

BAD = 0.01  # below: refused
POOR = 0.1  # below: counted in the notes, and curved cells are straightened
LENGTH_FACTORS = (0.5, 0.25)  # of their length: cells that are good then are only long
WORST_SHOWN = 5
FIRST_STEP = 0.25  # of a node's longest edge: the first step that it is moved by
LAST_STEP = 1e-3  # of that edge: the last
GAIN = 1e-4  # SICN that a step has to gain: less may be rounding
HALVINGS = 7  # halvings of a bend; what is still bad then is made straight
ROUNDING_OF_MIDDLE_NODES = 1e-9  # of the size, by which middle nodes of straight edges may be off

# Directions to the faces, edges and corners of a cube (26, 3).
_AROUND = np.array([way for way in product((-1.0, 0.0, 1.0), repeat=3) if any(way)])
_AROUND /= np.sqrt((_AROUND**2).sum(axis=1, keepdims=True))

# Nodes and centre of a curved cell.
_SAMPLES = np.vstack([node_coordinates(4, GMSH_TETRAHEDRON), np.full((1, 4), 0.25)])


class PoorCellsError(GeometryError):
    """Cells are inverted or nearly flat; another mesh size may avoid them."""


def sicn(points: Floats, cells: Ints) -> Floats:
    """Signed inverse condition number of every cell (m,): 1 regular, 0 flat, negative inverted.

    With A the map from the regular tetrahedron, it is 3 sign(det A) / (|A| |A^-1|) in Frobenius
    norms (gmsh's ``minSICN``). Curved cells have the least value at the ten nodes and the centre.
    """
    if cells.shape[1] == 4:
        return np.concatenate([_by_edges(*edges) for edges in edge_vectors(points, cells)])
    return _by_edges(*tangents(points[cells], _SAMPLES, GMSH_TETRAHEDRON)).min(axis=1)


def _by_edges(a: Floats, b: Floats, c: Floats) -> Floats:
    """SICN of straight cells from the edges at their first corner (3, ...).

    Both norms are sums over all edges and all faces: 18 V / sqrt(sum length^2 sum area^2).
    """
    d, e, f = (np.cross(x, y, axis=0) for x, y in ((b, c), (c, a), (a, b)))
    lengths = sum(dot(x, x) for x in (a, b, c, a - b, b - c, c - a))
    areas = sum(dot(x, x) for x in (d, e, f, d + e + f))
    scale = np.sqrt(lengths * areas)
    return 6 * dot(a, d) / np.where(scale > 0, scale, 1.0)


def notes_on_quality(data: MeshData, quality: Floats) -> dict[str, Any]:
    """Quality notes: counts, least and median SICN, and the least of each region."""
    return {
        "cells": len(data.cells),
        "nodes": len(data.points),
        "sicn_min": float(quality.min()),
        "sicn_median": float(np.median(quality)),
        "sicn_below_0.1": int((quality < POOR).sum()),
        "sicn_min_by_region": {
            name: float(quality[data.cell_tags == tag].min()) for name, tag in data.regions.items()
        },
    }


def overlapping(cells: Ints) -> Ints:
    """Cells that overlap a neighbour, where all have a positive volume (k,), the worst first.

    Cells on either side of a face see it the other way around. Where all do, volumes add up to
    the volume within the boundary. Middle nodes of a face have to be the same from either side.

    Raises:
        ValueError: A face belongs to more than two cells.
    """
    partner, faces = match_faces(cells), cell_faces(cells)
    a, b, c = faces[:, :3].T
    orientation = (a < b) ^ (b < c) ^ (a < c)
    middles = np.sort(faces[:, 3:], axis=1)
    mismatched = (orientation == orientation[partner]) | (middles != middles[partner]).any(axis=1)
    faulty = (mismatched & (partner >= 0)).reshape(-1, 4).sum(axis=1)
    return np.argsort(-faulty, kind="stable")[: np.count_nonzero(faulty)]


def places(
    points: Floats, cells: Ints, tags: Tags, regions: Mapping[str, int], rows: Ints
) -> list[str]:
    """A line for each of the first of some cells: its region and its centroid."""
    name_of_tag = {tag: name for name, tag in regions.items()}
    x = points[cells[rows[:WORST_SHOWN], :4]].mean(axis=1)
    lines = "  {} at ({:.2f}, {:.2f}, {:.2f}) mm"
    return [
        lines.format(name_of_tag[int(tags[cell])], *centroid)
        for cell, centroid in zip(rows, x, strict=False)
    ]


def check(
    points: Floats, cells: Ints, tags: Tags, regions: Mapping[str, int], reason: str = ""
) -> Floats:
    """Refuse inverted and nearly flat cells; ``reason`` follows their number in the message.

    Returns:
        SICN of each cell (m,).

    Raises:
        PoorCellsError: Names the worst cells: region, centroid [mm] and SICN.
    """
    quality = sicn(points, cells)
    bad_count = int((quality < BAD).sum())
    if not bad_count:
        return quality
    worst_cells = np.argsort(quality, kind="stable")[:bad_count]
    descriptions = places(points, cells, tags, regions, worst_cells)
    lines = [
        f"{location}: {quality[cell]:.4f}"
        for location, cell in zip(descriptions, worst_cells, strict=False)
    ]
    raise PoorCellsError(
        f"{bad_count} of {len(quality)} elements are inverted or nearly flat"
        f" (signed inverse condition number below {BAD}){reason}; the worst:\n" + "\n".join(lines)
    )


def straightened(points: Floats, cells: Ints) -> Floats:
    """Points with the middle nodes of quadratic cells half-way between their vertices."""
    first_corner, second_corner = np.array(GMSH_TETRAHEDRON).T
    x = points.copy()
    x[cells[:, 4:]] = 0.5 * (points[cells[:, first_corner]] + points[cells[:, second_corner]])
    return x


def bent(points: Floats, cells: Ints) -> bool:
    """Return True if any edge of quadratic cells is curved by more than rounding."""
    deviation = np.abs(straightened(points, cells) - points)[cells].max()
    return bool(deviation > ROUNDING_OF_MIDDLE_NODES * np.ptp(points, axis=0).max())


def untangle(points: Floats, cells: Ints, spared: float = 0.0) -> Floats:
    """Move the middle nodes of bad quadratic cells towards the middles of their straight edges.

    Middle nodes on a curved surface invert some cells next to it. Remedies of gmsh were measured on
    a femur of 31,000 cells. Its elastic optimiser took over eight minutes, its fast curving four
    minutes. Halving the bend of a fifth of the curved edges took two seconds and left no cell below
    0.1.

    Args:
        points: Nodes (n, 3) [mm].
        cells: Nodes of quadratic cells (m, 10).
        spared: Edges of a bad cell are kept if their bend is below this part of its largest one.

    Returns:
        The nodes (n, 3), vertices unchanged [mm].
    """
    chord = straightened(points, cells)
    required_quality = np.minimum(POOR, 0.85 * sicn(points, cells[:, :4]))
    bend = np.ones((len(points), 1))
    size = np.linalg.norm(points - chord, axis=1)
    changed_cells: Ints = np.arange(len(cells))  # cells whose nodes have moved
    # It ends: a bad cell has a bent edge, and its edges get straight.
    for step in count():
        current = chord + bend * (points - chord)
        bad_cells = changed_cells[
            sicn(current, cells[changed_cells]) < required_quality[changed_cells]
        ]
        if not len(bad_cells):
            break
        is_moved = np.zeros(len(points), dtype=bool)
        bends = (bend[:, 0] * size)[cells[bad_cells, 4:]]
        is_moved[cells[bad_cells, 4:][bends >= spared * bends.max(axis=1, keepdims=True)]] = True
        bend[is_moved] *= 0.5 if step < HALVINGS * (3 if spared else 1) else 0.0
        changed_cells = np.flatnonzero(is_moved[cells[:, 4:]].any(axis=1))
    return np.asarray(current)


def quality_without_length(points: Floats, cells: Ints) -> Floats:
    """SICN of cells (m,) that may be long along z: the best of those with their length reduced."""
    scaled_quality = [
        sicn(points * [1.0, 1.0, length_factor], cells) for length_factor in (1.0, *LENGTH_FACTORS)
    ]
    return np.asarray(np.max(scaled_quality, axis=0))


def _poor(points: Floats, cells: Ints, quality: Floats) -> Ints:
    """Cells that are poor, and not only long along z (k,)."""
    poor = np.flatnonzero(quality < POOR)
    return poor[quality_without_length(points, cells[poor]) < POOR]


def relaxed_nodes(points: Floats, cells: Ints, free: Bools, digits: int) -> Floats:
    """Move free nodes of poor straight cells until the cells are good, or get no better.

    Sections of a stem where its shoulder goes over to the neck are not convex: nodes that are
    means of the outline can lie outside of it. Each node in turn takes the best of 26 places
    around it, by the worst of its cells; its step is halved where none is better (Freitag and
    Ollivier-Gooch, Int. J. Numer. Meth. Eng. 40 (1997)).

    Args:
        points: Nodes (n, 3) [mm].
        cells: Tetrahedra (m, 4), of which inverted ones have a negative volume.
        free: Nodes that may be moved (n,).
        digits: Decimals [mm] that places are rounded to.

    Returns:
        The nodes (n, 3).
    """
    x, quality = points.copy(), sicn(points, cells)
    poor = _poor(x, cells, quality)
    if not free[cells[poor]].any():
        return x
    order = np.argsort(cells.ravel(), kind="stable")
    cell_start = np.searchsorted(cells.ravel()[order], np.arange(len(x) + 1))
    steps: dict[int, tuple[float, float]] = {}  # of each node: the next and the last one
    while True:
        worst_quality: dict[int, float] = {}
        for cell in _poor(x, cells, quality):
            for node in cells[cell][free[cells[cell]]]:
                worst_quality[int(node)] = min(
                    worst_quality.get(int(node), 1.0), round(quality[cell], digits)
                )
        moving = [k for k in worst_quality if k not in steps or steps[k][0] >= steps[k][1]]
        if not moving:
            return x
        for node in sorted(moving, key=lambda k: (worst_quality[k], k)):
            node_cells = order[cell_start[node] : cell_start[node + 1]] // 4
            corners = x[cells[node_cells]]
            if node not in steps:
                edge = float(np.sqrt(((corners - x[node]) ** 2).sum(axis=2)).max())
                steps[node] = FIRST_STEP * edge, LAST_STEP * edge
            step, last_step = steps[node]
            trial_places = np.round(x[node] + step * _AROUND, digits)
            trial_corners = np.where(
                (cells[node_cells] == node)[:, :, None], trial_places[:, None, None], corners
            )
            trial_cells = np.arange(trial_corners.size // 3).reshape(-1, 4)
            tried_quality = sicn(trial_corners.reshape(-1, 3), trial_cells).reshape(
                len(trial_places), len(node_cells)
            )
            best_trial = int(np.round(tried_quality.min(axis=1), digits).argmax())
            if tried_quality[best_trial].min() > quality[node_cells].min() + GAIN:
                x[node], quality[node_cells] = trial_places[best_trial], tried_quality[best_trial]
            else:
                steps[node] = 0.5 * step, last_step
