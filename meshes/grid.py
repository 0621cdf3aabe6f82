"""The grid of a femur's mesh: lines around, cells through the layers and steps along, by its size.

Plain numbers, which the estimate of a case takes too.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

LINES, COMPANION, COARSE = 8, 4, 10.0  # least number of lines around; above this size [mm]
# Cancellous and cortical bone [mm] that count as a cell of the size: cells grow away from cement.
CANCELLOUS, CORTICAL = 5.0, 4.4
THIN = 0.25  # of the mesh size, of a cell through a layer
# Steps along [mm]: times the size from the plug down, first, at most, and growth per mm; and from
# the neck cut down, beside whose rim the largest gaps are and where sections turn apart.
BELOW = (1.0, 1.4, 0.2)
STEM = (0.5, 1.0, 0.06)


def lines_around(perimeter: float, mesh: Any) -> int:
    """Lines around a stem of this perimeter, half-way through the mantle below the cut [mm]."""
    least = LINES if mesh.size <= COARSE else COMPANION
    return int(mesh.around or max(least, round(perimeter / mesh.size)))


def cells_through(cement: float, mesh: Any) -> tuple[int, int, int]:
    """Cells through cement of a thickness [mm], cancellous and cortical bone."""
    least = 1 if mesh.order > 1 else 2  # straight displacements lock in a mantle of one cell
    through = mesh.through_cement or max(least, math.ceil(cement / mesh.size))
    return through, max(1, round(CANCELLOUS / mesh.size)), max(1, round(CORTICAL / mesh.size))


def across(width: Any, cells: int, size: float) -> Any:
    """Cells through a layer of a width [mm]: fewer where they would be thinner than `THIN`."""
    return np.clip(np.floor(width / (THIN * size)), 1, cells)


def steps(length: float, size: float) -> int:
    """Equal steps of about a size in a length."""
    return max(1, round(length / size))


def graded(length: float, mesh: Any, grading: tuple[float, float, float]) -> list[float]:
    """Distances from 0 to a length in steps that grow, as in `BELOW` and `STEM` [mm]."""
    first, longest, growth = grading
    at = [0.0]
    while at[-1] < length:
        at.append(at[-1] + min(first * mesh.size + growth * at[-1], longest * mesh.size, mesh.far))
    if len(at) > 2 and at[-1] - length > 0.5 * (at[-1] - at[-2]):
        at.pop()
    return [distance * length / at[-1] for distance in at]
