"""A grid of a file whose arrays have names and whose sets have none: MED, VTU and XDMF."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from app.arrays import Floats, Ints


@dataclass
class FileGrid:
    """Points (n, 3), cells by meshio's name of their kind, and arrays.

    ``data`` holds for each array its values on each block of ``cells``; ``of_points`` are the names
    of arrays of points, ``groups`` the names in MED by the values of ``cell_tags``.
    """

    points: Floats
    cells: list[tuple[str, Ints]] = field(default_factory=list)
    data: dict[str, list[np.ndarray]] = field(default_factory=dict)
    of_points: list[str] = field(default_factory=list)
    groups: dict[int, list[str]] | None = None
    nodes: dict[str, Ints] = field(default_factory=dict)
