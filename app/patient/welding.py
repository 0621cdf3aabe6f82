"""Joining of loose triangles to a surface, and division of polygons into triangles.

The shape does not change. Corners that agree up to rounding become one. Repeated facets are kept
once. An edge that is divided on one side only is divided on both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import cKDTree

from app.foundation.arrays import Bools, Floats, Ints
from app.foundation.layout import two_digits
from meshes.data import connected

Polygon = Sequence[int]

# Corners at a smaller distance are merged [mm].
WELD_DISTANCE = 1e-4
# Corners at a smaller distance are merged, as a fraction of the largest coordinate [-].
ROUNDING_OF_CORNERS = 4 * float(np.finfo(np.float32).eps)
SHORT_PERCENTILE = 1.0  # percentile of the lengths of edges that counts as a short edge
# Nearer corners of open edges are one, too: as a part of a short edge, and at most [mm].
WIDER_PART = 0.1
WIDER_MOST = 0.05
# A nearer corner divides an open edge [mm], and at most as a part of the edge.
ON_EDGE = 0.01
ON_EDGE_PART = 0.02


@dataclass
class Welded:
    """Triangles of common corners.

    Attributes:
        points: Corners (n, 3) [mm].
        triangles: Their rows (m, 3).
        notes: What was joined or left out, in words.
    """

    points: Floats
    triangles: Ints
    notes: list[str] = field(default_factory=list)


def weld(corners: Floats) -> Welded:
    """Return the surface of triangles with corners (m, 3, 3) [mm]."""
    all_corners = corners.reshape(-1, 3)
    points, point_of_corner = np.unique(all_corners, axis=0, return_inverse=True)
    distance = max(WELD_DISTANCE, ROUNDING_OF_CORNERS * float(np.abs(all_corners).max(initial=0.0)))
    cluster_of_point = _clusters(points, distance)
    points, point_of_corner = (
        _means(points, cluster_of_point),
        cluster_of_point[point_of_corner.ravel()],
    )
    surface = _without_repeats(Welded(points, point_of_corner.reshape(-1, 3)))
    if not open_edges(surface.triangles).size:
        return surface
    return _divided_edges(_welded_wider(surface, distance))


def thin(surface: Welded, size: float) -> Welded:
    """Return a surface on which all corners in a box of a size [mm] are one."""
    origin = surface.points.min(axis=0)
    box = np.round((surface.points - origin) / size).astype(np.int64)
    _, box_of_point = np.unique(box, axis=0, return_inverse=True)
    points = _means(surface.points, box_of_point.ravel())
    triangles = box_of_point.ravel()[surface.triangles]
    triangles = triangles[_has_three(triangles)]
    # Two triangles with the same corners are a fold without thickness: both are left out.
    _, first_rows, counts = np.unique(
        np.sort(triangles, axis=1), axis=0, return_index=True, return_counts=True
    )
    kept_triangles = triangles[np.sort(first_rows[counts % 2 == 1])]
    note = (
        f"{len(kept_triangles):,} of {len(surface.triangles):,} triangles left after merging"
        " corners"
    )
    notes = [*surface.notes, f"{note} within {size} mm"]
    return _used(Welded(points, kept_triangles, notes))


def open_edges(triangles: Ints) -> Ints:
    """Return the corners (k, 2) of edges that belong to one triangle, in its direction."""
    ends, key = _edges(triangles)
    _, edge_of_end, counts = np.unique(key, return_inverse=True, return_counts=True)
    return np.asarray(ends[counts[edge_of_end.ravel()] == 1])


def apart(surface: Welded) -> float:
    """Return the median distance of corners of open edges from the nearest such corner [mm]."""
    rim = surface.points[np.unique(open_edges(surface.triangles))]
    return float(np.median(cKDTree(rim).query(rim, 2)[0][:, 1]))


def _edges(triangles: Ints) -> tuple[Ints, Ints]:
    """Return the ends (3 m, 2) of the edges of triangles (m, 3), and a number of each (3 m,).

    The number does not depend on the direction of an edge.
    """
    end_corners = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    low, high = np.sort(end_corners, axis=1).T
    return end_corners, low * (triangles.max(initial=0) + 1) + high


def _clusters(points: Floats, size: float) -> Ints:
    """Return the number of the group of each point (n,). Points nearer than a size share one."""
    first_point, second_point = cKDTree(points).query_pairs(size, output_type="ndarray").T
    return connected(len(points), first_point, second_point)


def _means(points: Floats, group: Ints) -> Floats:
    """Return the mean points (k, 3) of groups of points."""
    count = np.bincount(group)
    return np.stack([np.bincount(group, points[:, i]) / count for i in range(3)], axis=1)


def _has_three(triangles: Ints) -> Bools:
    """Return the mask of triangles with three different corners (m,)."""
    ordered = np.sort(triangles, axis=1)
    return np.asarray((ordered[:, 1:] != ordered[:, :-1]).all(axis=1))


def _used(surface: Welded) -> Welded:
    """Drop points without a triangle."""
    used_points, triangles = np.unique(surface.triangles, return_inverse=True)
    return Welded(surface.points[used_points], triangles.reshape(-1, 3), surface.notes)


def _without_repeats(surface: Welded) -> Welded:
    """Drop triangles with equal corners, copies of facets, and folds without thickness."""
    has_area = _has_three(surface.triangles)
    notes = list(surface.notes)
    if not has_area.all():
        notes.append(f"{int((~has_area).sum()):,} triangles without area left out")
    triangles = surface.triangles[has_area]
    ordered = np.sort(triangles, axis=1)
    _, first_rows, counts = np.unique(ordered, axis=0, return_index=True, return_counts=True)
    fold = _folds(triangles[first_rows], counts % 2 == 0)
    if fold.any():
        notes.append(f"{int(counts[fold].sum()):,} triangles of folds without thickness left out")
    repeat_count = int((counts - 1)[~fold].sum())
    if repeat_count:
        notes.append(f"{repeat_count:,} doubled facets left out")
    return _used(Welded(surface.points, triangles[np.sort(first_rows[~fold])], notes))


def _folds(facets: Ints, is_repeated: Bools) -> Bools:
    """Return the mask of doubled facets (m,) that are two touching sheets, and no copies.

    At the edge of a patch of copies there is one other facet. Where a fold begins there are two.
    """
    copies = np.flatnonzero(is_repeated)
    _, edge_keys = _edges(facets)
    _, edge_numbers = np.unique(edge_keys, return_inverse=True)
    edge_numbers = edge_numbers.reshape(-1, 3)
    edge_count = edge_numbers.max(initial=-1) + 1
    other_counts = np.bincount(edge_numbers[~is_repeated].ravel(), minlength=edge_count)
    doubled_counts = np.bincount(edge_numbers[is_repeated].ravel(), minlength=edge_count)
    copy_rows = np.repeat(np.arange(len(copies)), 3)
    copy_edges = edge_numbers[copies].ravel()
    order = np.argsort(copy_edges, kind="stable")
    is_shared = np.diff(copy_edges[order]) == 0
    patch = connected(
        len(copies), copy_rows[order][:-1][is_shared], copy_rows[order][1:][is_shared]
    )
    votes = np.where(
        other_counts[copy_edges] % 2 == 1, 1, np.where(other_counts[copy_edges] > 0, -1, 0)
    ) * (doubled_counts[copy_edges] == 1)
    fold = np.zeros(len(facets), dtype=bool)
    if len(copies):
        fold[copies] = np.bincount(patch[copy_rows], votes)[patch] < 0
    return fold


def _welded_wider(surface: Welded, weld_distance: float) -> Welded:
    """Join corners of open edges that are nearer to each other than a part of a short edge."""
    ends, _ = _edges(surface.triangles)
    lengths = np.linalg.norm(np.subtract(*surface.points[ends].transpose(1, 0, 2)), axis=1)
    wider_distance = (
        min(WIDER_PART * float(np.percentile(lengths, SHORT_PERCENTILE)), WIDER_MOST)
        if len(lengths)
        else 0.0
    )
    if wider_distance <= weld_distance:
        return surface
    rim = np.unique(open_edges(surface.triangles))
    representative = np.arange(len(surface.points))
    group = _clusters(surface.points[rim], wider_distance)
    _, first_rows = np.unique(group, return_index=True)
    representative[rim] = rim[first_rows][group]
    if (representative[rim] == rim).all():
        return surface
    _, merged_rows = np.unique(representative, return_inverse=True)
    points = _means(surface.points, merged_rows)
    largest_move = float(np.linalg.norm(points[merged_rows] - surface.points, axis=1).max())
    merged_count = int((representative[rim] != rim).sum())
    merged_text = (
        f"{merged_count:,} corners within {two_digits(wider_distance)} mm of another merged with it"
    )
    notes = [*surface.notes, f"{merged_text}, moved by at most {largest_move:.1g} mm"]
    return _without_repeats(Welded(points, merged_rows[surface.triangles], notes))


def _divided_edges(surface: Welded) -> Welded:
    """Divide open edges at the corners of open edges that lie on them."""
    edges, x = open_edges(surface.triangles), surface.points
    rim = np.unique(edges)
    if not len(rim):
        return surface
    start, end = x[edges[:, 0]], x[edges[:, 1]]
    direction, length = end - start, np.linalg.norm(end - start, axis=1)
    tree = cKDTree(x[rim])
    corners_on_edge: dict[tuple[int, int], list[int]] = {}
    for k, near_rows in enumerate(tree.query_ball_point((start + end) / 2, length / 2)):
        candidates = rim[near_rows]
        fraction = (x[candidates] - start[k]) @ direction[k] / length[k] ** 2
        distance = np.linalg.norm(
            x[candidates] - start[k] - fraction[:, None] * direction[k], axis=1
        )
        is_inner = np.isin(candidates, edges[k], invert=True) & (fraction > 0) & (fraction < 1)
        on_edge = is_inner & (distance < min(ON_EDGE, ON_EDGE_PART * length[k]))
        if on_edge.any():
            a, b = (int(corner) for corner in edges[k])
            corners_on_edge[a, b] = [
                int(i) for i in candidates[on_edge][np.argsort(fraction[on_edge])]
            ]
    if not corners_on_edge:
        return surface
    rows, is_whole = [], np.ones(len(surface.triangles), dtype=bool)
    for t in np.flatnonzero(np.isin(surface.triangles, edges).any(axis=1)):
        a, b, c = (int(corner) for corner in surface.triangles[t])
        sides = ((a, b), (b, c), (c, a))
        if any(side in corners_on_edge for side in sides):
            is_whole[t] = False
            rows.append([i for side in sides for i in (side[0], *corners_on_edge.get(side, ()))])
    triangles = np.concatenate([surface.triangles[is_whole], triangles_of_polygons(x, rows)])
    note = f"{len(corners_on_edge):,} edges that were divided on one side only are divided on both"
    return _without_repeats(Welded(x, triangles, [*surface.notes, note]))


def triangles_of_polygons(points: Floats, polygons: Sequence[Polygon]) -> Ints:
    """Return the triangles (m, 3) of polygons, in the order of their numbers of corners."""
    sizes = np.array([len(polygon) for polygon in polygons])
    triangles_by_size: list[Ints] = []
    for size in np.unique(sizes):
        rows: Ints = np.array([polygons[k] for k in np.flatnonzero(sizes == size)], dtype=np.int64)
        triangles_by_size.append(rows if size == 3 else _fans(points, rows))
    return np.concatenate(triangles_by_size)


def _fans(points: Floats, rows: Ints) -> Ints:
    """Return the triangles (m, 3) of polygons of one size (n, k).

    A polygon is a fan from one corner if no triangle of the fan is turned over, otherwise `_ears`
    divides it.
    """
    with np.errstate(all="ignore"):  # of corners that are too far for a bone
        x = points[rows]
        spokes = x[:, 1:] - x[:, :1]
        normal = np.cross(spokes[:, :-1], spokes[:, 1:]).sum(axis=1)
        least_areas = []
        for start_corner in range(rows.shape[1]):
            rotated = np.roll(x, -start_corner, axis=1)
            spokes = rotated[:, 1:] - rotated[:, :1]
            areas = np.einsum("nki,ni->nk", np.cross(spokes[:, :-1], spokes[:, 1:]), normal)
            least_areas.append(areas.min(axis=1))
        areas = np.array(least_areas)
        best_start = areas.argmax(axis=0)
        convex = areas.max(axis=0) > 0
        rotation = (best_start[:, None] + np.arange(rows.shape[1])) % rows.shape[1]
        fans = np.take_along_axis(rows, rotation, axis=1)[convex]
        first_corners = np.repeat(fans[:, :1], rows.shape[1] - 2, axis=1)
        fan_triangles = np.stack([first_corners, fans[:, 1:-1], fans[:, 2:]], axis=2).reshape(-1, 3)
        clipped = [
            row[_ears(corners, polygon_normal)]
            for row, corners, polygon_normal in zip(
                rows[~convex], x[~convex], normal[~convex], strict=True
            )
        ]
    return np.concatenate([fan_triangles, *clipped])


def _ears(x: Floats, normal: Floats) -> Ints:
    """Return the triangles (k - 2, 3) of a polygon with corners (k, 3), by ear clipping."""
    dropped_axis = int(np.abs(normal).argmax())
    xy = np.delete(x, dropped_axis, axis=1) * ([1, -1] if dropped_axis == 1 else [1, 1])
    if normal[dropped_axis] < 0:
        xy = xy * [1, -1]

    def twice_area(a: Floats, b: Floats, c: Floats) -> Floats:
        (p, q), (r, s) = np.moveaxis(b - a, -1, 0), np.moveaxis(c - a, -1, 0)
        return np.asarray(p * s - q * r)

    remaining_corners, ears = list(range(len(x))), []
    while len(remaining_corners) > 3:
        best_ear = 0  # a polygon that crosses itself may have no ear: any corner is cut off
        for k in range(len(remaining_corners)):
            a, b, c = (
                xy[remaining_corners[(k + step) % len(remaining_corners)]] for step in (-1, 0, 1)
            )
            if twice_area(a, b, c) <= 0:
                continue
            other_corners = xy[
                [i for i in remaining_corners if not ((xy[i] == [a, b, c]).all(axis=1)).any()]
            ]
            sides = [twice_area(other_corners, *side) for side in ((a, b), (b, c), (c, a))]
            if not (np.array(sides) >= 0).all(axis=0).any():
                best_ear = k
                break
        ears.append(
            [
                remaining_corners[best_ear - 1],
                remaining_corners[best_ear],
                remaining_corners[(best_ear + 1) % len(remaining_corners)],
            ]
        )
        del remaining_corners[best_ear]
    return np.array([*ears, remaining_corners])
