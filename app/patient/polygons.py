"""Triangles of the faces of OBJ and PLY files, which may have any number of corners."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from app.foundation.arrays import Floats
from app.foundation.errors import GeometryError
from app.patient.welding import Polygon, triangles_of_polygons


def corners_of(
    path: Path, points: Floats, polygons: Sequence[Polygon], face_name: Callable[[int], str]
) -> tuple[Floats, list[str]]:
    """Return corners (m, 3, 3) of the triangles of all faces of a file, and notes on them.

    Args:
        path: The file.
        points: Its vertices (n, 3).
        polygons: Vertices of each face, from 0.
        face_name: Name of a face by its number, for messages.

    Raises:
        GeometryError: A face has fewer than three corners, or a corner that is no vertex of the
            file or has coordinates that are no numbers.
    """
    sizes = np.array([len(polygon) for polygon in polygons], dtype=np.int64)
    if not len(sizes):
        raise GeometryError(f"{path}: has no faces")
    is_small = sizes < 3
    if is_small.any():
        face = int(is_small.argmax())
        raise GeometryError(
            f"{path}: {face_name(face)} has {sizes[face]} corners; expected at least three"
        )
    face_vertices = np.fromiter((i for polygon in polygons for i in polygon), np.int64, sizes.sum())
    is_outside = (face_vertices < 0) | (face_vertices >= len(points))
    if is_outside.any():
        face = int(np.repeat(np.arange(len(sizes)), sizes)[is_outside][0])
        fault = f"has a corner that is none of the {len(points):,} vertices"
        raise GeometryError(f"{path}: {face_name(face)} {fault}")
    used_vertices = np.unique(face_vertices)
    is_lost = ~np.isfinite(points[used_vertices]).all(axis=1)
    if is_lost.any():
        number = int(used_vertices[is_lost][0]) + 1
        fault = f"{int(is_lost.sum()):,} of its vertices are not numbers"
        fault += f"; the first is vertex {number:,}"
        raise GeometryError(f"{path}: {fault}")
    notes = []
    divided_count = int((sizes > 3).sum())
    if divided_count:
        notes.append(f"{divided_count:,} faces with more than three corners divided")
    unused = len(points) - len(used_vertices)
    if unused:
        notes.append(f"{unused:,} vertices without a face left out")
    return points[triangles_of_polygons(points, polygons)], notes
