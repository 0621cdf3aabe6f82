"""Length of the process zone, in which an interface is breaking.

w is the spent fraction of the fracture energy, and the zone is the area with 0 < w < 1. By the
co-area formula, the integral of the gradient of w is the largest w times the mean length of the
contours of w. The length of the zone is its area over this mean length,

.. math:: l = A(0 < w < 1) w_{max} / ∫ |∇w| dA .
"""

from __future__ import annotations

import numpy as np

from app.foundation.arrays import Floats
from app.results.percentiles import SurfaceField

# Spent fraction of the energy at which a point counts as broken: exponential softening never ends.
BROKEN = 0.99
# Fewest elements over a process zone that resolve it.
RESOLVED = 3


def zone(x: Floats, w: Floats, area: Floats) -> float:
    """Return the length of the process zone [mm]; 0 without triangles.

    It is at most the size of the surface, because uniform damage has no gradient.

    Args:
        x: Corners of triangles (f, 3, 3) [mm].
        w: Spent fraction of the fracture energy at these corners (f, 3) [-].
        area: Areas of the triangles (f,) [mm2].
    """
    field = SurfaceField(w, area, x)
    zone_area = field.area_above(0.0) - field.area_above(BROKEN)
    if not w.max(initial=0.0) or zone_area <= 0:
        return 0.0
    edges, edge_changes = x[:, 1:] - x[:, :1], w[:, 1:] - w[:, :1]
    metric = np.einsum("fai,fbi->fab", edges, edges)
    square = np.einsum("fa,fab,fb->f", edge_changes, np.linalg.inv(metric), edge_changes)
    slope = float(area @ np.sqrt(np.maximum(square, 0.0))) / (zone_area * w.max())
    return 1 / max(slope, 1 / float(np.linalg.norm(np.ptp(x.reshape(-1, 3), axis=0))))
