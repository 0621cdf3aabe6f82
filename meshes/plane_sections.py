"""Plane sections of triangles: their lines, the enclosed area, and rays from a point in it."""

from __future__ import annotations

import numpy as np

from app.foundation.arrays import Floats, Ints


def section(x: Floats, height: Floats, triangles: Ints | None = None) -> Floats:
    """Lines (k, 2, d) in which triangles meet height 0, the body to their left, seen from above.

    Args:
        x: Places of the corners, of any dimension (n, d) [mm].
        height: Height of the corners over the section (n,).
        triangles: Outward triangles (m, 3); by default every three corners are one.
    """
    above = height >= 0
    if triangles is None:
        triangles = np.arange(len(x)).reshape(-1, 3)
    one, other, third = above[triangles].T
    crossed = triangles[(one != other) | (other != third)]
    after = np.roll(crossed, -1, axis=1)
    met = above[crossed] != above[after]
    a, b = crossed[met], after[met]
    part = (height[a] / (height[a] - height[b]))[:, None]
    ends = ((1 - part) * x[a] + part * x[b]).reshape(-1, 2, x.shape[1])
    falls = above[a][::2]  # the first end of each line is where the triangle's edge goes down
    return np.where(falls[:, None, None], ends, ends[:, ::-1])


def centroid(lines: Floats) -> tuple[Floats, float]:
    """Centroid (2,) and area of what lines (k, 2, 2) enclose."""
    a, b = lines[:, 0], lines[:, 1]
    twice = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    area = float(twice.sum()) / 2
    return np.asarray((twice[:, None] * (a + b)).sum(axis=0) / (6 * area)), area


def met(lines: Floats, angles: Floats) -> tuple[Ints, Floats]:
    """Where rays from 0 at angles (j,) meet lines (k, 2, 2): numbers of rays, and radii (n,)."""
    ray = np.stack([np.cos(angles), np.sin(angles)])
    across = lines @ np.stack([ray[1], -ray[0]])  # (k, 2, j)
    k, j = np.nonzero((across[:, 0] >= 0) != (across[:, 1] >= 0))
    part = (across[k, 0, j] / (across[k, 0, j] - across[k, 1, j]))[:, None]
    r = (((1 - part) * lines[k, 0] + part * lines[k, 1]) * ray[:, j].T).sum(axis=1)
    return j[r > 0], r[r > 0]


def exits(lines: Floats, angles: Floats, bridged: float = 0.0) -> tuple[Floats, Ints]:
    """Where rays from 0 first leave what lines (k, 2, 2) enclose, and how often they meet it.

    Args:
        lines: Lines of a section about its centre [mm].
        angles: Of the rays, from x towards y (j,).
        bridged: Gaps that are narrower do not end a ray [mm].

    Returns:
        Radii (j,) [mm], nan for a ray that meets nothing, and numbers of crossings (j,).
    """
    j, r = met(lines, angles)
    order = np.lexsort((r, j))
    times = np.bincount(j, minlength=len(angles))
    radii = np.full(len(angles), np.nan)
    for at, crossings in enumerate(np.split(r[order], np.cumsum(times)[:-1])):
        if len(crossings):
            wide = crossings[1:-1:2] - crossings[:-2:2] > bridged
            radii[at] = crossings[2 * int(np.argmax([*wide, True]))]
    return radii, times
