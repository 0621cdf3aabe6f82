"""Quality of meshes: one measure, vectorised, for generated and imported meshes alike."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from app.arrays import Floats, Ints
from app.errors import GeometryError
from meshes.data import (
    MeshData,
    cell_faces,
    cross,
    determinants,
    dot,
    edge_vectors,
    jacobians,
    match_faces,
)

BAD = 0.01  # below: refused
POOR = 0.1  # below: counted in the notes
WORST_SHOWN = 5

# Columns: the edges of a regular tetrahedron of edge 1 from its first vertex.
_REGULAR = np.array(
    [
        [1.0, 0.5, 0.5],
        [0.0, np.sqrt(3) / 2, np.sqrt(3) / 6],
        [0.0, 0.0, np.sqrt(2 / 3)],
    ]
)
_SAMPLES = np.vstack(
    [
        np.eye(4),
        [
            [0.5 * (k in pair) for k in range(4)]
            for pair in ((0, 1), (1, 2), (0, 2), (0, 3), (2, 3), (1, 3))
        ],
        np.full((1, 4), 0.25),
    ]
)


def sicn(points: Floats, cells: Ints) -> Floats:
    """Signed inverse condition number of every cell (m,): 1 regular, 0 flat, negative inverted.

    With A the map from the regular tetrahedron, it is 3 sign(det A) / (|A| |A^-1|) in Frobenius
    norms, gmsh's ``minSICN``; for curved cells the least value at the ten nodes and the centre.
    """
    if cells.shape[1] == 4:
        return np.concatenate([straight(*edges) for edges in edge_vectors(points, cells)])
    a = jacobians(points, cells, _SAMPLES) @ np.linalg.inv(_REGULAR)
    det = determinants(a)
    # |A^-1| = |cofactor(A)| / |det A|, finite for flat cells
    c0, c1, c2 = (np.cross(a[..., i], a[..., j]) for i, j in ((1, 2), (2, 0), (0, 1)))
    cofactor = np.sqrt(sum(np.sum(c * c, axis=-1) for c in (c0, c1, c2)))
    norm = np.sqrt(np.sum(a * a, axis=(-2, -1)))
    with np.errstate(invalid="ignore", divide="ignore"):
        value = np.where(norm * cofactor > 0, 3 * det / (norm * cofactor), 0.0)
    return value.min(axis=1)


def straight(a: Floats, b: Floats, c: Floats) -> Floats:
    """SICN of straight cells from the edges at their first corner (3, k); shape (k,).

    Both norms are sums over all edges and all faces: 18 V / sqrt(sum length^2 sum area^2).
    """
    d, e, f = cross(b, c), cross(c, a), cross(a, b)
    lengths = sum(dot(x, x) for x in (a, b, c, a - b, b - c, c - a))
    areas = sum(dot(x, x) for x in (d, e, f, d + e + f))
    scale = np.sqrt(lengths * areas)
    return 6 * dot(a, d) / np.where(scale > 0, scale, 1.0)


def describe(data: MeshData, quality: Floats) -> dict[str, Any]:
    """Quality notes: counts, least and median SICN, and the worst element of each region."""
    return {
        "cells": len(data.cells),
        "nodes": len(data.points),
        "sicn_min": float(quality.min()),
        "sicn_median": float(np.median(quality)),
        "sicn_below_0.1": int((quality < POOR).sum()),
        "sicn_min_by_region": {
            name: float(quality[data.cell_tags == tag].min())
            for name, tag in data.regions.items()
            if np.any(data.cell_tags == tag)
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
    turn = (a < b) ^ (b < c) ^ (a < c)
    middles = np.sort(faces[:, 3:], axis=1)
    unfit = (turn == turn[partner]) | (middles != middles[partner]).any(axis=1)
    count = (unfit & (partner >= 0)).reshape(-1, 4).sum(axis=1)
    return np.argsort(-count, kind="stable")[: np.count_nonzero(count)]


def places(
    points: Floats, cells: Ints, tags: npt.NDArray[np.int32], regions: Mapping[str, int], some: Ints
) -> list[str]:
    """A line for each of the first of some cells: its region and its centroid."""
    names = {tag: name for name, tag in regions.items()}
    lines = []
    for cell in some[:WORST_SHOWN]:
        x, y, z = points[cells[cell, :4]].mean(axis=0)
        region = names.get(int(tags[cell]), "?")
        lines.append(f"  {region} at ({x:.2f}, {y:.2f}, {z:.2f}) mm")
    return lines


def gate(data: MeshData, remedy: str) -> Floats:
    """Refuse a mesh with inverted or nearly flat elements; ``remedy`` ends the message.

    Returns:
        SICN of each cell (m,).

    Raises:
        GeometryError: Names the worst elements: region, centroid [mm] and SICN.
    """
    quality = sicn(data.points, data.cells)
    bad = int((quality < BAD).sum())
    if not bad:
        return quality
    worst = np.argsort(quality, kind="stable")[:bad]
    at = places(data.points, data.cells, data.cell_tags, data.regions, worst)
    lines = [f"{place}: {quality[cell]:.4f}" for place, cell in zip(at, worst, strict=False)]
    raise GeometryError(
        f"{bad} of {len(quality)} elements are inverted or nearly flat"
        f" (signed inverse condition number below {BAD}); the worst:\n"
        + "\n".join(lines)
        + f"\n{remedy}"
    )
