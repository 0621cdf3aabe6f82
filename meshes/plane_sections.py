"""Plane sections of triangles: their lines, the enclosed area, and rays from a point in it."""

from __future__ import annotations

import math

import numpy as np

from app.foundation.arrays import Floats, Ints


def lines_at_height(x: Floats, height: Floats, triangles: Ints | None = None) -> Floats:
    """Lines (k, 2, d) in which triangles meet height 0, the body to their left, seen from above.

    Args:
        x: Places of the corners, of any dimension (n, d) [mm].
        height: Height of the corners over the section (n,).
        triangles: Outward triangles (m, 3); by default every three corners are one.
    """
    is_above = height >= 0
    if triangles is None:
        triangles = np.arange(len(x)).reshape(-1, 3)
    first_above, second_above, third_above = is_above[triangles].T
    crossed = triangles[(first_above != second_above) | (second_above != third_above)]
    next_crossed = np.roll(crossed, -1, axis=1)
    is_crossed = is_above[crossed] != is_above[next_crossed]
    a, b = crossed[is_crossed], next_crossed[is_crossed]
    fraction = (height[a] / (height[a] - height[b]))[:, None]
    end_points = ((1 - fraction) * x[a] + fraction * x[b]).reshape(-1, 2, x.shape[1])
    # The first end of each line is where the triangle's edge falls.
    starts_falling = is_above[a][::2]
    return np.where(starts_falling[:, None, None], end_points, end_points[:, ::-1])


def centroid(lines: Floats) -> tuple[Floats, float]:
    """Centroid (2,) and area of the region that lines (k, 2, 2) enclose."""
    twice_areas = _twice_areas(lines)
    area = float(twice_areas.sum()) / 2
    weighted = twice_areas[:, None] * lines.sum(axis=1)
    return np.asarray(weighted.sum(axis=0) / (6 * area)), area


def mean_width(lines: Floats) -> float:
    """Diameter of the circle whose area lines (k, 2, 2) enclose; 0 without lines."""
    return math.sqrt(2.0 * max(float(_twice_areas(lines).sum()), 0.0) / math.pi)


def _twice_areas(lines: Floats) -> Floats:
    """Twice the areas of the triangles of lines (k, 2, 2) with the origin, signed (k,)."""
    a, b = lines[:, 0], lines[:, 1]
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def ray_crossings(lines: Floats, angles: Floats) -> tuple[Ints, Floats]:
    """Crossings of rays from 0 at angles (j,) with lines (k, 2, 2).

    Returns:
        Number of the ray and radius of each crossing (n,).
    """
    ray = np.stack([np.cos(angles), np.sin(angles)])
    across = lines @ np.stack([ray[1], -ray[0]])  # (k, 2, j)
    k, j = np.nonzero((across[:, 0] >= 0) != (across[:, 1] >= 0))
    fraction = (across[k, 0, j] / (across[k, 0, j] - across[k, 1, j]))[:, None]
    r = (((1 - fraction) * lines[k, 0] + fraction * lines[k, 1]) * ray[:, j].T).sum(axis=1)
    return j[r > 0], r[r > 0]


def exits(lines: Floats, angles: Floats, bridged: float = 0.0) -> tuple[Floats, Ints]:
    """Radii at which rays from 0 first leave the region that lines (k, 2, 2) enclose.

    Args:
        lines: Lines of a section about its centre [mm].
        angles: Angles of the rays, from x towards y (j,).
        bridged: Gaps that are narrower do not end a ray [mm].

    Returns:
        Radii (j,) [mm], nan for a ray that meets nothing, and numbers of crossings (j,).
    """
    j, r = ray_crossings(lines, angles)
    order = np.lexsort((r, j))
    counts = np.bincount(j, minlength=len(angles))
    radii = np.full(len(angles), np.nan)
    for ray_number, crossings in enumerate(np.split(r[order], np.cumsum(counts)[:-1])):
        if len(crossings):
            is_wide = crossings[1:-1:2] - crossings[:-2:2] > bridged
            radii[ray_number] = crossings[2 * int(np.argmax([*is_wide, True]))]
    return radii, counts
