"""The grid of a femur's mesh: lines around, cells through the layers and steps along, by its size.

Plain numbers, which the estimate of a case takes too.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from app.arrays import Floats

LINES, COMPANION, COARSE = 8, 4, 10.0  # least number of lines around; above this size [mm]
# Least length of a cell through cement, cancellous and cortical bone over the mesh size: in bone
# there are as many as have room, in cement at most as many as `through_cement`. Widest bone [mm].
THROUGH = (0.25, 1.0, 1.25)
CANCELLOUS, CORTICAL = 15.0, 8.0
# Steps along [mm]: times the size from the plug down, first, at most, and growth per mm; and from
# the neck cut down, beside whose rim the largest gaps are and where sections turn apart.
BELOW = (1.0, 1.4, 0.2)
STEM = (0.6, 1.0, 0.06)


def lines_around(section: tuple[float, float, float], cement: float, mesh: Any) -> int:
    """Lines around a rounded rectangle, by its perimeter half-way through the mantle.

    ``section`` is half-width, half-depth and corner radius, ``cement`` the mantle's thickness [mm].
    """
    half, depth, corner = section
    perimeter = 4.0 * (half + depth - 2.0 * corner) + 2.0 * math.pi * (corner + 0.5 * cement)
    least = LINES if mesh.size <= COARSE else COMPANION
    return int(mesh.around or max(least, round(perimeter / mesh.size)))


def through_cement(cement: float, mesh: Any) -> float:
    """Cells through cement of a thickness [mm].

    A fraction is the part, from the neck cut down, with one more.
    """
    return float(mesh.through_cement or max(2.0, 1.75 * cement / mesh.size - 0.5))


def cells_through(cement: float, mesh: Any) -> tuple[int, int, int]:
    """Cells at most through cement of a thickness [mm], cancellous and cortical bone."""
    widest = zip((CANCELLOUS, CORTICAL), THROUGH[1:], strict=True)
    bone = (max(1, round(width / (length * mesh.size))) for width, length in widest)
    return math.ceil(through_cement(cement, mesh)), next(bone), next(bone)


def across(width: Any, layer: int, cells: Any, size: float) -> Any:
    """Cells through a layer, 0 to 2, where it is of a width [mm]."""
    return np.clip(np.round(width / (THROUGH[layer] * size)), 1, cells)


def steps(length: float, size: float) -> int:
    """Equal steps of about a size in a length."""
    return max(1, round(length / size))


def graded(
    length: float, mesh: Any, grading: tuple[float, float, float]
) -> tuple[list[float], int, float]:
    """Divide a length [mm] into steps that grow, as in `BELOW` and `STEM`.

    Returns:
        Distances from 0 where steps grow, and the number and size of equal steps after them.
    """
    first, longest, growth = grading
    largest = min(longest * mesh.size, mesh.far)
    at = [0.0]
    while (step := first * mesh.size + growth * at[-1]) < largest and at[-1] + 0.5 * step < length:
        at.append(at[-1] + step)
    return at, max(round((length - at[-1]) / largest), int(len(at) == 1)), largest


def distances(length: float, mesh: Any, grading: tuple[float, float, float]) -> Floats:
    """Distances from 0 to a length in steps that grow [mm]."""
    at, count, step = graded(length, mesh, grading)
    every = np.concatenate([at, at[-1] + step * np.arange(1, count + 1)])
    return np.asarray(every * length / every[-1])


def graded_steps(length: float, mesh: Any, grading: tuple[float, float, float]) -> int:
    """Number of steps that grow in a length."""
    at, count, _ = graded(length, mesh, grading)
    return len(at) - 1 + count
