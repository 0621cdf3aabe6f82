"""Triangles of the faces of OBJ and PLY files, which may have any number of corners."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from app.foundation.arrays import Floats
from app.foundation.errors import GeometryError
from app.patient.welding import Polygon, divided


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
        text = f"{int(lost.sum()):,} of its vertices are not numbers"
        text += f"; the first is vertex {number:,}"
        raise GeometryError(f"{path}: {text}")
    notes = []
    more = int((sizes > 3).sum())
    if more:
        notes.append(f"{more:,} faces with more than three corners divided")
    unused = len(points) - len(used)
    if unused:
        notes.append(f"{unused:,} vertices without a face left out")
    return points[divided(points, polygons)], notes
