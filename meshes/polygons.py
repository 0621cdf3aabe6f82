"""Division of polygons, the faces of surface files, into triangles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.foundation.errors import GeometryError

Polygon = Sequence[int]


def corners_of(
    path: Path, points: Floats, polygons: Sequence[Polygon], place: Callable[[int], str]
) -> tuple[Floats, list[str]]:
    """Return corners (m, 3, 3) of the triangles of all faces of a file, and notes on them.

    Args:
        path: The file.
        points: Its vertices (n, 3).
        polygons: Vertices of each face, from 0.
        place: Name of a face by its number, for messages.

    Raises:
        GeometryError: A face has fewer than three corners, or a corner that is no vertex of the
            file or has coordinates that are no numbers.
    """
    sizes = np.array([len(polygon) for polygon in polygons], dtype=np.int64)
    if not len(sizes):
        raise GeometryError(f"{path}: has no faces")
    small = sizes < 3
    if small.any():
        k = int(small.argmax())
        raise GeometryError(f"{path}: {place(k)} has {sizes[k]} corners; expected at least three")
    flat = np.fromiter((i for polygon in polygons for i in polygon), np.int64, sizes.sum())
    outside = (flat < 0) | (flat >= len(points))
    if outside.any():
        k = int(np.repeat(np.arange(len(sizes)), sizes)[outside][0])
        text = f"has a corner that is none of the {len(points):,} vertices"
        raise GeometryError(f"{path}: {place(k)} {text}")
    used = np.unique(flat)
    lost = ~np.isfinite(points[used]).all(axis=1)
    if lost.any():
        number = int(used[lost][0]) + 1
        text = f"{int(lost.sum()):,} of its vertices are no numbers, the first is number {number:,}"
        raise GeometryError(f"{path}: {text}")
    notes = []
    more = int((sizes > 3).sum())
    if more:
        notes.append(f"{more:,} faces of more than three corners divided")
    unused = len(points) - len(used)
    if unused:
        notes.append(f"{unused:,} vertices without a face left out")
    return points[divided(points, polygons)], notes


def divided(points: Floats, polygons: Sequence[Polygon]) -> Ints:
    """Return the triangles (m, 3) of polygons, in the order of their numbers of corners."""
    sizes = np.array([len(polygon) for polygon in polygons])
    parts: list[Ints] = []
    for size in np.unique(sizes):
        rows: Ints = np.array([polygons[k] for k in np.flatnonzero(sizes == size)], dtype=np.int64)
        parts.append(rows if size == 3 else _fans(points, rows))
    return np.concatenate(parts)


def _fans(points: Floats, rows: Ints) -> Ints:
    """Return the triangles (m, 3) of polygons of one size (n, k).

    A polygon is a fan from one corner if no triangle of the fan is turned over, otherwise `_ears`
    divides it.
    """
    with np.errstate(all="ignore"):  # of corners that are too far for a bone
        x = points[rows]
        out = x[:, 1:] - x[:, :1]
        normal = np.cross(out[:, :-1], out[:, 1:]).sum(axis=1)
        least = []
        for start in range(rows.shape[1]):
            turned = np.roll(x, -start, axis=1)
            out = turned[:, 1:] - turned[:, :1]
            areas = np.einsum("nki,ni->nk", np.cross(out[:, :-1], out[:, 1:]), normal)
            least.append(areas.min(axis=1))
        areas = np.array(least)
        best = areas.argmax(axis=0)
        convex = areas.max(axis=0) > 0
        turn = (best[:, None] + np.arange(rows.shape[1])) % rows.shape[1]
        fans = np.take_along_axis(rows, turn, axis=1)[convex]
        first = np.repeat(fans[:, :1], rows.shape[1] - 2, axis=1)
        made = np.stack([first, fans[:, 1:-1], fans[:, 2:]], axis=2).reshape(-1, 3)
        clipped = [
            row[_ears(corners, up)]
            for row, corners, up in zip(rows[~convex], x[~convex], normal[~convex], strict=True)
        ]
    return np.concatenate([made, *clipped])


def _ears(x: Floats, normal: Floats) -> Ints:
    """Return the triangles (k - 2, 3) of a polygon with corners (k, 3), by ear clipping."""
    drop = int(np.abs(normal).argmax())
    xy = np.delete(x, drop, axis=1) * ([1, -1] if drop == 1 else [1, 1])
    if normal[drop] < 0:
        xy = xy * [1, -1]

    def twice_area(a: Floats, b: Floats, c: Floats) -> Floats:
        (p, q), (r, s) = np.moveaxis(b - a, -1, 0), np.moveaxis(c - a, -1, 0)
        return np.asarray(p * s - q * r)

    left, found = list(range(len(x))), []
    while len(left) > 3:
        best = 0  # a polygon that crosses itself may have no ear: any corner is cut off
        for k in range(len(left)):
            a, b, c = (xy[left[(k + step) % len(left)]] for step in (-1, 0, 1))
            if twice_area(a, b, c) <= 0:
                continue
            rest = xy[[i for i in left if not ((xy[i] == [a, b, c]).all(axis=1)).any()]]
            sides = [twice_area(rest, *side) for side in ((a, b), (b, c), (c, a))]
            if not (np.array(sides) >= 0).all(axis=0).any():
                best = k
                break
        found.append([left[best - 1], left[best], left[(best + 1) % len(left)]])
        del left[best]
    return np.array([*found, left])
