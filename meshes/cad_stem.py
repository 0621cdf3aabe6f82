"""A stem from CAD in a hip: points of its surface in the sections of the mesh.

Above the neck cut sections turn on until they are across the neck, about points that lead from the
stem's axis to the neck's, from the cut on or from the shoulder, if that is lower. Rays from these
points meet the surface, which is triangles, once.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from app.arrays import Floats
from app.errors import GeometryError
from meshes.bone_surface import met, section
from meshes.femur_stem import unit
from meshes.mantle import distance
from meshes.placement import Placement

CORNERS = 0.35  # of a quarter's length: what its corner counts more
ROUND = 720  # rays around
THETA = 2 * np.pi * np.arange(ROUND) / ROUND
HIDDEN = 4.0  # mm of metal that a ray may meet beyond a gap: the corner of a shoulder
TIP = 3.0  # mm above the tip, and below the shoulder, from which the mantle goes on beyond
NECK = 0.38  # of the neck's length: what the points between axis and neck head for
INSIDE = 1e-3  # mm that the last section is within the neck


def outline(x: Floats, origin: Floats, plane: Floats) -> Floats:
    """Where rays from a point leave triangles (m, 3, 3) in a plane (`ROUND`, 3) [mm].

    Angles are from the first to the second of two directions in it (2, 3).

    Raises:
        ValueError: The point is outside, or rays meet the surface again.
    """
    x = x.reshape(-1, 3) - origin
    ray, r = met(section(x, x @ np.cross(*plane)) @ np.linalg.pinv(plane), THETA)
    near, far = np.full(ROUND, np.inf), np.zeros(ROUND)
    np.minimum.at(near, ray, r)
    np.maximum.at(far, ray, r)
    if not (np.isfinite(near).all() and (far - near).max() < HIDDEN):
        raise ValueError
    ends = near * [np.cos(THETA), np.sin(THETA)]
    return np.asarray(origin + ends.T @ plane)


def around(x: Floats) -> float:
    """Length of an outline [mm]."""
    return float(np.sqrt(((x - np.roll(x, 1, axis=0)) ** 2).sum(axis=1)).sum())


class CadStem:
    """A stem as `stem_file.read` finds it; ``ends`` are the steps above the neck cut."""

    def __init__(
        self, found: dict[str, Any], ends: tuple[float, float], placed: Placement, mesh: Any
    ) -> None:
        """Ends are the level of the tip and the height of the shoulder, or of the cut [mm]."""
        (self._low, high), self._placed = ends, placed
        self._high = self._low + found["shoulder"] - TIP if high < placed.top else np.inf
        way, shift = [1.0, -1.0 if placed.mirrored else 1.0, 1.0], np.array([0.0, 0.0, self._low])
        self._x, self._coarse = found["x"] * way + shift, found["coarse"] * way + shift
        self._kept = lru_cache(maxsize=4096)(self._section)
        end, up = found["end"] * way + shift, found["neck"] * way
        bend = end - (1 - NECK) * end[0] / up[0] * up
        self._path = np.array([[0.0, 0.0, high], bend, end - INSIDE * up])
        medial = unit(np.array([1.0, 0.0, 0.0]) - up[0] * up)
        steepest, self._lean = placed.slopes
        self._planes = np.stack([self._plane(steepest), [medial, np.cross(up, medial)]])
        self._cut = self._along(placed.top, steepest)
        length = np.linalg.norm(np.diff(self._path, axis=0), axis=1).sum()
        self.ends = (mesh.steps((1 - self._cut) * length),)

    def _plane(self, slope: float) -> Floats:
        """Directions in a section, over x and over y (2, 3)."""
        return np.array([[1.0, 0.0, -slope], [0.0, 1.0, -slope * self._lean]])

    def _along(self, height: float, slope: float) -> float:
        """Where the path meets a section, of its length; 0 if it begins above."""
        p, q, r = self._path @ [slope, slope * self._lean, 1.0]
        if (rise := height - p) <= 0:
            return 0.0
        return float(rise / (q - p + np.sqrt((q - p) ** 2 + (p - 2 * q + r) * rise)))

    def _section(self, height: float, slope: float, part: float = 0.0) -> tuple[Floats, Floats]:
        """Outline (`ROUND` + 1, 3) [mm], and its length and bend up to there in turns.

        A part above 0 is that of the way from the cut to the neck's end.
        """
        t, at = 1 - part, self._cut + (1 - self._cut) * part
        plane = t * t * self._planes[0] + (1 - t * t) * self._planes[1]
        if part <= 0:
            at, plane = self._along(height, slope), self._plane(slope)
        origin = np.array([(1 - at) ** 2, 2 * (1 - at) * at, at * at]) @ self._path
        if at <= 0:
            origin = np.array([0.0, 0.0, height])
        try:
            x = outline(self._x, origin, plane)
        except ValueError:
            where = self._placed.where(self._placed.to_model(origin))
            raise GeometryError(
                f"geometry.stem: around {where}, the section of the stem is met more than once from"
                " there: a collar, or a neck that leaves the body below the neck cut? Move it"
                " proximally (stem_tip_z, insertion.depth), cut lower (resection_height,"
                " resection.height), or leave the collar out"
            ) from None
        edges = np.roll(x, -1, axis=0) - x
        length = np.sqrt((edges**2).sum(axis=1))
        along = edges / length[:, None]
        bend = np.arccos(np.clip((along * np.roll(along, 1, axis=0)).sum(axis=1), -1.0, 1.0))
        bend += np.roll(bend, -1)
        more = CORNERS if part <= 0 else 0.0  # above, corners are those of shoulder and neck
        weight = length / length.sum() + more * bend / bend.sum()
        return np.concatenate([x, x[:1]]), np.append(0.0, np.cumsum(weight)) / weight.sum()

    def _at(self, phi: Floats, *planes: Floats) -> Floats:
        """Points of outlines (n, 3) [mm], one outline for all with the same arguments (n,)."""
        keys, of = np.unique(np.stack(planes, axis=1), axis=0, return_inverse=True)
        found = np.empty((len(phi), 3))
        for k in range(len(keys)):
            own = of.ravel() == k
            x, at = self._kept(*keys[k])
            found[own] = np.stack([np.interp(phi[own], at, v) for v in x.T], axis=1)
        return found

    def section(self, z: float) -> tuple[float, float, float]:
        """Half-width, half-depth and corner radius of a square of the same length around [mm]."""
        half = around(self._kept(z, 0.0)[0]) / 8
        return half, half, 0.0

    def divided(self, z: float, around: int) -> CadStem:
        """Itself."""
        return self

    def point(self, phi: Floats, zeta: Any, slope: Any) -> Floats:
        """Points of outlines as `femur_stem.Body.point`; below the tip they are those above."""
        zeta, slope = (np.broadcast_to(v, phi.shape) for v in (zeta, slope))
        return self._at(phi, self._low + np.abs(zeta - self._low), slope)

    def points(self, phi: Floats, s: Floats) -> Floats:
        """Points at stations above the cut (n, 3) [mm]."""
        zero = np.zeros(len(phi))
        return self._at(phi, zero, zero, np.asarray(s) / self.ends[-1])

    def depth(self, thickness: Callable[..., Any], x: Floats) -> Floats:
        """Depth of points (n, 3) within the surface at a distance [mm], or that of what is below.

        Below the tip, and above a shoulder below the cut, it goes on as it is there.
        """
        x = np.stack([x[:, 0], x[:, 1], np.maximum(x[:, 2], self._low + TIP)], axis=1)
        wanted = thickness(np.arctan2(x[:, 1], x[:, 0]), x[:, 2])
        away = distance(x, self._coarse)
        if (over := x[:, 2] > self._high).any():
            edge, at = self._kept(self._high, 0.0)[0][:-1, :2], x[over, :2]
            turn = np.arctan2(at[:, 1], at[:, 0])
            out = np.hypot(*at.T) - np.interp(turn, THETA, np.hypot(*edge.T), period=2 * np.pi)
            beside = np.where(out > 0, cKDTree(edge).query(at)[0], 0.0)
            away[over] = np.minimum(away[over], beside)
        return np.asarray(wanted - away)
