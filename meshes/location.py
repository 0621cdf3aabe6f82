"""Points in the cells of a mesh: the cell that holds each of them, and the coordinates in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.foundation.arrays import Floats, Ints
from meshes.shape_functions import (
    GMSH_TETRAHEDRON,
    STRAIGHT,
    coordinates_in_curved,
    shape_functions,
)

# Points this far outside a cell still belong to it, in barycentric coordinates: cells cut curved
# surfaces. They have the value of the surface.
OUTSIDE_CELL = 0.1
# Digits to which barycentric coordinates are compared, so that rounding does not choose the cell.
DIGITS_OF_BARYCENTRIC = 9


@dataclass(frozen=True)
class Places:
    """Cells that hold points.

    Attributes:
        cell: Row of the cell, -1 if the point is in no cell (n,).
        barycentric: Barycentric coordinates in the reference cell, by its corners (n, 4).
        inside: Smallest barycentric coordinate before the point was moved into the cell (n,).
    """

    cell: Ints
    barycentric: Floats
    inside: Floats


def cells_of_points(points: Floats, cells: Ints, x: Floats) -> Places:
    """Find the cells that hold points.

    A point on a face of two cells belongs to the first of them.

    Args:
        points: Nodes of the mesh (k, 3) [mm].
        cells: Nodes of the cells in gmsh's order (m, 4 or 10).
        x: The points (n, 3) [mm].
    """
    cell = np.full(len(x), -1, dtype=np.int64)
    barycentric = np.zeros((len(x), 4))
    inside = np.full(len(x), -np.inf)
    if not len(cells):
        return Places(cell, barycentric, inside)
    nodes = points[cells]
    lower_corner, upper_corner = nodes.min(axis=1), nodes.max(axis=1)
    margin = 4 * OUTSIDE_CELL * (upper_corner - lower_corner)
    lower_corner -= margin
    upper_corner += margin
    for k in range(len(x)):
        point = x[k]
        near_cells = np.flatnonzero(
            (lower_corner <= point).all(axis=1) & (point <= upper_corner).all(axis=1)
        )
        if not len(near_cells):
            continue
        cell_coordinates = _coordinates_in_cells(nodes[near_cells], point)
        smallest = np.round(cell_coordinates.min(axis=1), DIGITS_OF_BARYCENTRIC)
        best_row = int(np.argmax(smallest))
        if smallest[best_row] < -OUTSIDE_CELL:
            continue
        cell[k] = near_cells[best_row]
        inside[k] = smallest[best_row]
        clipped = np.maximum(cell_coordinates[best_row], 0.0)
        barycentric[k] = clipped / clipped.sum()
    return Places(cell, barycentric, inside)


def barycentric_coordinates(corners: Floats, x: Floats) -> Floats:
    """Barycentric coordinates (..., 4) of points (..., 3) in straight cells (..., 4, 3)."""
    edges = (corners[..., 1:, :] - corners[..., :1, :]).swapaxes(-2, -1)
    last_three = np.linalg.solve(edges, (x - corners[..., 0, :])[..., None])[..., 0]
    return np.concatenate([1.0 - last_three.sum(axis=-1, keepdims=True), last_three], axis=-1)


def _coordinates_in_cells(x: Floats, point: Floats) -> Floats:
    """Barycentric coordinates (m, 4) of a point in the reference cells of cells (m, 4 or 10, 3)."""
    barycentric = barycentric_coordinates(x[:, :4], point)
    if x.shape[1] == 4:
        return barycentric
    # Far from a cell its quadratic map may have no inverse.
    is_close = np.flatnonzero(barycentric.min(axis=1) >= -2 * OUTSIDE_CELL)
    points = np.broadcast_to(point, (len(is_close), 3))
    barycentric[is_close] = coordinates_in_curved(
        points, x[is_close], barycentric[is_close], GMSH_TETRAHEDRON
    )
    return barycentric


def positions_in_cells(points: Floats, cells: Ints, barycentric: Floats) -> Floats:
    """Positions (n, 3) [mm] at barycentric coordinates (n, 4) of cells (n, 4 or 10)."""
    values = shape_functions(barycentric, GMSH_TETRAHEDRON if cells.shape[1] == 10 else STRAIGHT)
    return np.asarray(np.einsum("na,nai->ni", values, points[cells]))
