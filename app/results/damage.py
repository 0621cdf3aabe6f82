"""Size of the zone in which an interface breaks.

With w the spent part of the fracture energy, the zone is where 0 < w < 1. By the co-area formula
the integral of the slope of w is its largest value times the mean length of its contours. The area
of the zone over that length is its width,

.. math:: l = A(0 < w < 1) w_{max} / ∫ |∇w| dA .
"""

from __future__ import annotations

import numpy as np

from app.foundation.arrays import Floats
from app.results.percentiles import SurfaceField

# Part of the energy at which a point counts as broken: exponential softening never ends.
BROKEN = 0.99
# Fewest elements over a process zone that resolve it.
RESOLVED = 3


def zone(x: Floats, w: Floats, area: Floats) -> float:
    """Length of the zone [mm] of w (f, 3) at the corners (f, 3, 3) of triangles; 0 without any.

    It is not above the size of the surface: uniform damage has no slope.
    """
    field = SurfaceField(w, area, x)
    zone = field.area_above(0.0) - field.area_above(BROKEN)
    if not w.max(initial=0.0) or zone <= 0:
        return 0.0
    e, dw = x[:, 1:] - x[:, :1], w[:, 1:] - w[:, :1]
    metric = np.einsum("fai,fbi->fab", e, e)
    square = np.einsum("fa,fab,fb->f", dw, np.linalg.inv(metric), dw)
    slope = float(area @ np.sqrt(np.maximum(square, 0.0))) / (zone * w.max())
    return 1 / max(slope, 1 / float(np.linalg.norm(np.ptp(x.reshape(-1, 3), axis=0))))
