"""A bone's surface as triangles from a file: read, welded, checked.

Only what changes no shape is repaired: equal corners are one, triangles without area go, and all
are turned outwards. A surface may be open at its distal end, where a scan ends, and nowhere else.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from app.arrays import Floats, Ints
from app.errors import GeometryError

UNITS = {"mm": 1.0, "m": 1000.0, "cm": 10.0, "inch": 25.4}
EXTENT = (100.0, 600.0)  # mm that a femur, or a proximal part of one, is long
WELD = 1e-4  # mm within which corners are one
MOST = 400_000  # triangles; more are thinned
THIN = 0.7  # mm: edge of the boxes whose corners become one then
RIM = 15.0  # mm: an open end is within this distance of the distal end
HEADER = 84  # bytes before the triangles of a binary STL file, each of 50


@dataclass(frozen=True)
class Surface:
    """Triangles that enclose a body, outward; they may be open at one end.

    Attributes:
        points: Corners (n, 3) [mm].
        triangles: Their rows (m, 3).
        told: What was found and repaired, in words.
    """

    points: Floats
    triangles: Ints
    told: tuple[str, ...] = ()

    @property
    def corners(self) -> Floats:
        """Corners of each triangle (m, 3, 3) [mm]."""
        return self.points[self.triangles]


def read(path: Path, unit: str | None = None) -> Surface:
    """Read a surface; without a unit it is the one that makes a femur of it, and this is told.

    Raises:
        GeometryError: The file is damaged, or its triangles are not the surface of one body.
    """
    corners = _stl(path)
    if not len(corners) or not np.isfinite(corners).all():
        raise GeometryError(f"{path}: has no triangles, or corners that are no numbers")
    extent = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    told = []
    if unit is None:
        fits = [u for u, mm in UNITS.items() if EXTENT[0] <= extent * mm <= EXTENT[1]]
        if not fits:
            raise GeometryError(
                f"{path}: is {extent:.3g} long, which is no femur in mm, cm, m or inch; expected"
                f" {EXTENT[0]:g} to {EXTENT[1]:g} mm"
            )
        unit = fits[0]
        told.append(f"unit: {unit}, as the surface is {extent:.4g} long")
    elif not EXTENT[0] <= extent * UNITS[unit] <= EXTENT[1]:
        raise GeometryError(
            f"{path}: is {extent * UNITS[unit]:.4g} mm long in {unit}; expected {EXTENT[0]:g} to"
            f" {EXTENT[1]:g} mm: another unit?"
        )
    corners = corners * UNITS[unit]
    size = WELD
    if len(corners) > MOST:
        size = THIN
        told.append(f"{len(corners):,} triangles: corners within {THIN} mm made one")
    points, triangles = _welded(corners, size)
    if thinned := size > WELD:
        told[-1] += f", {len(triangles):,} are left"
    return _checked(path, points, triangles, told, thinned)


def _stl(path: Path) -> Floats:
    """Corners of triangles (m, 3, 3) of an STL file, binary or text, in its unit."""
    data = path.read_bytes()
    count = int(np.frombuffer(data[80:HEADER].ljust(4, b"\0"), "<u4")[0])
    if len(data) >= HEADER and len(data) == HEADER + 50 * count:
        kind = np.dtype([("v", "<f4", (4, 3)), ("attribute", "<u2")])
        return np.frombuffer(data[HEADER:], kind)["v"][:, 1:].astype(float)
    words = data.split()
    if words[:1] != [b"solid"]:
        raise GeometryError(f"{path}: is no STL file, or not all of one: {len(data):,} bytes")
    at = np.flatnonzero(np.array(words) == b"vertex")
    try:
        values = np.array([[float(words[k + j]) for j in (1, 2, 3)] for k in at])
        return values.reshape(-1, 3, 3)
    except (IndexError, ValueError):
        text = f"{path}: its text ends or is damaged after {len(at):,} corners"
        raise GeometryError(text) from None


def _welded(corners: Floats, size: float) -> tuple[Floats, Ints]:
    """Points (n, 3) and triangles (m, 3): corners in one box of a size are their mean."""
    flat = corners.reshape(-1, 3)
    key = np.round((flat - flat.min(axis=0)) / size).astype(np.int64)
    wide = key.max(axis=0) + 1
    key = (key[:, 0] * wide[1] + key[:, 1]) * wide[2] + key[:, 2]
    _, of, count = np.unique(key, return_inverse=True, return_counts=True)
    points = np.stack([np.bincount(of, flat[:, i]) / count for i in range(3)], axis=1)
    triangles = of.reshape(-1, 3)
    ordered = np.sort(triangles, axis=1)
    real = (ordered[:, 1:] != ordered[:, :-1]).all(axis=1)
    triangles, ordered = triangles[real], ordered[real]
    # Two on the same corners are a fold without thickness: both go.
    n = len(points)
    key = (ordered[:, 0] * n + ordered[:, 1]) * n + ordered[:, 2] if n < 2_000_000 else ordered
    _, first, times = np.unique(key, axis=0, return_index=True, return_counts=True)
    triangles = triangles[np.sort(first[times % 2 == 1])]
    used, of = np.unique(triangles, return_inverse=True)
    return points[used], of.reshape(-1, 3)


def _checked(path: Path, x: Floats, triangles: Ints, told: list[str], thinned: bool) -> Surface:
    """The surface turned outwards; refused if it is open on a side, or not of one body."""
    n, m = len(x), len(triangles)
    ends = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    key, way = np.sort(ends, axis=1) @ [n, 1], ends[:, 0] < ends[:, 1]
    order = np.argsort(key, kind="stable")
    key, owner = key[order], order // 3
    first = np.flatnonzero(np.r_[True, key[1:] != key[:-1]])
    times = np.diff(np.r_[first, len(key)])
    pair = first[times == 2]
    graph = coo_array((np.ones(len(pair)), (owner[pair], owner[pair + 1])), (m, m)).tocsr()
    bodies, body = connected_components(graph, directed=False)
    sizes = np.bincount(body)
    if not thinned and bodies > 1:
        second = int(np.argsort(sizes)[-2])
        raise GeometryError(
            f"{path}: has {bodies} bodies, of {sizes.max():,} and {sizes[second]:,} triangles, the"
            f" second about {_place(x[triangles[body == second]])}; expected one: keep the femur"
        )
    lone = first[times % 2 == 1] if thinned else first[times != 2]
    low = _distal_end(x)
    edges = ends[order[lone]]
    away = low(x[edges].mean(axis=1))
    if (side := away > RIM).any():
        more = int(times[times != 2].max())
        what = "is open" if more == 1 else f"has an edge of {more} triangles"
        raise GeometryError(
            f"{path}: {what} at {_place(x[edges[side]])} ({int(side.sum())} edges), which is not"
            " at the distal end; close it where the surface was made"
        )
    if len(lone):
        told.append(f"open at the distal end: {len(lone)} edges")
    if not thinned:
        same = way[order[pair]] == way[order[pair + 1]]
        flipped = _flipped(graph, owner[pair], owner[pair + 1], same)
        if 0 < flipped.sum() < m:
            told.append(f"{min(int(flipped.sum()), m - int(flipped.sum()))} triangles turned over")
        triangles = np.where(flipped[:, None], triangles[:, ::-1], triangles)
    a, b, c = (x[triangles[:, k]] - x.mean(axis=0) for k in range(3))
    if float((np.cross(a, b) * c).sum()) < 0:
        triangles = triangles[:, ::-1]
    return Surface(x, triangles, tuple(told))


def _distal_end(x: Floats):  # type: ignore[no-untyped-def]
    """Distance from the narrower end of the longest axis (k,) of points, as a function."""
    centre = x.mean(axis=0)
    axis = np.linalg.svd(x[:: max(1, len(x) // 20_000)] - centre, full_matrices=False)[2][0]
    along = (x - centre) @ axis

    def distance(y: Floats) -> Floats:
        at = (y - centre) @ axis
        return np.minimum(at - along.min(), along.max() - at)

    return distance


def _flipped(graph, a: Ints, b: Ints, same):  # type: ignore[no-untyped-def]
    """Triangles (m,) that face the other way than the first, by pairs a, b that face alike."""
    m = graph.shape[0]
    order, before = breadth_first_order(graph, 0, directed=False)
    keys = np.minimum(a, b) * m + np.maximum(a, b)
    rank = np.argsort(keys)
    step = np.sort(np.stack([order[1:], before[order[1:]]], axis=1), axis=1) @ [m, 1]
    turn = same[rank[np.searchsorted(keys[rank], step)]]
    flipped = np.zeros(m, dtype=bool)
    for t, p, other in zip(order[1:], before[order[1:]], turn, strict=True):
        flipped[t] = flipped[p] ^ other
    return flipped


def _place(x: Floats) -> str:
    """Middle of points (..., 3) in words."""
    return "({:.0f}, {:.0f}, {:.0f}) mm".format(*x.reshape(-1, 3).mean(axis=0))


def section(x: Floats, height: Floats, triangles: Ints) -> Floats:
    """Lines (k, 2, d) in which triangles meet height 0, with the body to their left seen from above.

    Args:
        x: Places of the corners, of any dimension (n, d) [mm].
        height: Signed distance of the corners from the section, or what vanishes with it (n,).
        triangles: Outward triangles (m, 3).
    """
    above = height >= 0
    one, other, third = above[triangles].T
    own = triangles[(one != other) | (other != third)]
    after = np.roll(own, -1, axis=1)
    met = above[own] != above[after]
    a, b = own[met], after[met]
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


def exits(lines: Floats, angles: Floats, bridged: float = 0.0) -> tuple[Floats, Floats]:
    """Where rays from 0 first leave what lines (k, 2, 2) enclose, and how often they meet it.

    Args:
        lines: Lines of a section about its centre [mm].
        angles: Of the rays, from x towards y (j,).
        bridged: Gaps that are narrower do not end a ray [mm].

    Returns:
        Radii (j,) [mm], nan for a ray that meets nothing, and numbers of crossings (j,).
    """
    ray = np.stack([np.cos(angles), np.sin(angles)])
    across = lines @ np.stack([ray[1], -ray[0]])  # (k, 2, j)
    k, j = np.nonzero((across[:, 0] >= 0) != (across[:, 1] >= 0))
    part = across[k, 0, j] / (across[k, 0, j] - across[k, 1, j])
    x = (1 - part)[:, None] * lines[k, 0] + part[:, None] * lines[k, 1]
    r = (x * ray[:, j].T).sum(axis=1)
    j, r = j[r > 0], r[r > 0]
    order = np.lexsort((r, j))
    j, r = j[order], r[order]
    first = np.searchsorted(j, np.arange(len(angles)))
    times = np.bincount(j, minlength=len(angles))
    found = np.full(len(angles), np.nan)
    found[times > 0] = r[first[times > 0]]
    for at in np.flatnonzero(times > 2):
        own = r[first[at] : first[at] + times[at]]
        gaps = own[2::2] - own[1:-1:2]
        found[at] = own[2 * int(np.argmax(np.r_[own[1:-1:2] - own[:-2:2] > bridged, True]))]
    return found, times
