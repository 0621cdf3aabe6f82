"""The shaft of a femur where its surface ends, and its continuation below.

Scans of a hip often end below the lesser trochanter. The shaft is then continued along the axis
of the last sections, in their shape and size.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from app.foundation.arrays import Floats
from app.patient import welding
from app.patient.bone_surface import BoneSurface
from meshes.data import connected
from meshes.femur_stem import unit
from meshes.plane_sections import centroid

# Least downward part of a normal at the end of a surface [-].
FACING = 0.5
# Distance above the end in which a smoothed edge may be round [mm].
ROUND = 3.0
# Length of the last sections, whose axis is continued [mm].
LAST = 25.0
# Shortest length of sections that have an axis [mm].
SHORTEST = 10.0
# Distance between sections [mm].
STEP = 2.5
# Length of the rows of triangles below the end [mm].
ROW = 10.0
# Largest distance of a flat end's corners from its plane [mm].
FLAT = 1.0
# Parts of lateral, medial and antero-posterior half-width in the mean one [-].
HALF_WIDTHS = (0.25, 0.25, 0.5)
# Level of the parametric femur's isthmus [mm].
ISTHMUS = -113.0
# Least area of a flat end [mm^2].
LEAST_AREA = 100.0


def end_level(surface: BoneSurface, up: Floats) -> float:
    """Return the level above which a surface is whole [mm].

    Args:
        surface: Surface of a bone, closed or open at its end.
        up: Unit vector away from the end (3,).
    """
    level = surface.points @ up
    lowest = float(level.min())
    a, b, c = surface.corners.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    down = np.flatnonzero(normal @ up < -FACING * np.linalg.norm(normal, axis=1))
    end = lowest
    corners = surface.triangles[down]
    lows = level[corners].min(axis=1)
    if lows.min(initial=np.inf) < lowest + ROUND:
        # Triangles are joined through their corners.
        row = np.repeat(np.arange(len(down)), 3)
        parts = connected(len(down) + len(level), row, len(down) + corners.ravel())[: len(down)]
        end = float(level[corners[parts == parts[lows.argmin()]]].max())
    if len(surface.rim):
        rim = surface.rim @ up
        middle = 0.5 * (lowest + float(level.max()))
        end = max(end, float(rim[rim < middle].max(initial=lowest)))
    return end + ROUND


def flat_end(surface: BoneSurface) -> Floats | None:
    """Return the unit normal of the largest flat or open end of a surface (3,), inwards.

    None: The surface has no such end.
    """
    x = surface.points
    if len(surface.rim):
        rim = surface.rim - surface.rim.mean(axis=0)
        normal = np.linalg.svd(rim, full_matrices=False)[2][2]
        return np.asarray(normal * np.sign((x.mean(axis=0) - surface.rim.mean(axis=0)) @ normal))
    a, b, c = surface.corners.transpose(1, 0, 2)
    area = 0.5 * np.cross(b - a, c - a)
    size = np.linalg.norm(area, axis=1)
    area, a, size = area[size > 0], a[size > 0], size[size > 0]
    normals = area / size[:, None]
    # Planes by direction and distance from the origin.
    keys = np.column_stack([np.round(normals * 20), np.round((normals * a).sum(axis=1) / FLAT)])
    _, plane = np.unique(keys, axis=0, return_inverse=True)
    areas = np.bincount(plane.ravel(), size)
    best = int(areas.argmax())
    inward = -unit(area[plane.ravel() == best].sum(axis=0))
    beyond = (x @ inward).min() < (a[plane.ravel() == best] @ inward).min() - FLAT
    return None if beyond or areas[best] < LEAST_AREA else inward


@dataclass(frozen=True, eq=False)
class Narrowing:
    """Width of the parametric femur at levels over that at a level, constant below the isthmus.

    Attributes:
        table: Its rows: level, lateral, medial, antero-posterior half-width [mm].
        end: Level at which the width is 1 [mm].
        size: Size of the femur over that of the parametric one [-].
    """

    table: Floats
    end: float
    size: float

    def __call__(self, z: Floats) -> Floats:
        """Return the width at levels [-]."""
        rows = self.table[np.argsort(self.table[:, 0])]
        mean = rows[:, 1:4] @ HALF_WIDTHS
        at, one = (
            np.interp(np.maximum(level / self.size, ISTHMUS), rows[:, 0], mean)
            for level in (z, self.end)
        )
        return np.asarray(at / one)


@dataclass(frozen=True, eq=False)
class Continuation:
    """A shaft below the end of a surface, in the model's axes.

    Attributes:
        end: Level at which it begins [mm].
        centre: Centroid of the section there (2,) [mm].
        slope: Change of the centroid with the level (2,) [-].
        low: Level at which it ends [mm].
        width: Width at a level over that at the end, of the bone.
    """

    end: float
    centre: Floats
    slope: Floats
    low: float
    width: Narrowing

    def surface(self, above: BoneSurface, width: Narrowing) -> BoneSurface:
        """Return a surface that is continued below the end.

        Args:
            above: The surface, of the bone or of its canal.
            width: Its width at levels over that at the end.
        """
        lines = above.level(self.end)
        n = max(2, int((self.end - self.low) / ROW) + 1)
        z: Floats = np.linspace(self.end, self.low, n, dtype=float)
        rings = self._at(lines[None], z[:, None, None], width)
        rings = np.concatenate(
            [rings, np.broadcast_to(z[:, None, None, None], (*rings.shape[:3], 1))], axis=3
        )
        p, q = rings[:, :, 0], rings[:, :, 1]
        sides = [
            np.stack([p[:-1], p[1:], q[:-1]], axis=2),
            np.stack([q[:-1], p[1:], q[1:]], axis=2),
        ]
        middle = np.broadcast_to(
            np.r_[self._at(self.centre, z[-1:], width)[0], self.low], p[-1].shape
        )
        corners = np.concatenate(
            [
                clipped(above, self.end),
                *(part.reshape(-1, 3, 3) for part in sides),
                np.stack([middle, q[-1], p[-1]], axis=1),
            ]
        )
        welded = welding.weld(corners)
        return replace(above, points=welded.points, triangles=welded.triangles)

    def _at(self, x: Floats, z: Floats, width: Narrowing) -> Floats:
        """Return points of the last section (..., 2) moved to levels (...)."""
        z = z[..., None]
        return np.asarray(self.centre + (z - self.end) * self.slope + width(z) * (x - self.centre))

    def scanned(self, x: Floats) -> Floats:
        """Return points (n, 3), those below the end moved up to the last section."""
        z = np.minimum(x[:, 2:], self.end)
        below = x[:, :2] - self.centre - (z - self.end) * self.slope
        return np.column_stack(
            [self.centre + below / self.width(z), np.maximum(x[:, 2:], self.end)]
        )


def clipped(surface: BoneSurface, level: float) -> Floats:
    """Return the triangles (m, 3, 3) of a surface above a level, those across it divided."""
    x = surface.corners
    above = x[..., 2] >= level
    count = above.sum(axis=1)
    kept = [x[count == 3]]
    for number in (1, 2):
        part, odd = x[count == number], above[count == number] == (number == 1)
        # The corner that is alone on its side of the level comes first.
        first = odd.argmax(axis=1)
        order = (first[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(part, order[..., None], axis=1).transpose(1, 0, 2)
        ab, ac = (a + ((level - a[:, 2]) / (e[:, 2] - a[:, 2]))[:, None] * (e - a) for e in (b, c))
        if number == 1:
            kept.append(np.stack([a, ab, ac], axis=1))
        else:
            kept += [np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)]
    return np.concatenate(kept)


def axis_of_end(surface: BoneSurface, end: float, top: float) -> tuple[Floats, Floats]:
    """Return centroid (2,) at the end and its change with the level (2,) by the last sections.

    Args:
        surface: The bone, in the model's axes.
        end: Level at which it ends.
        top: Highest level of the shaft. Above `SHORTEST` below it, the change is taken as zero.
    """
    levels = np.arange(end, min(end + LAST, top) + 1e-9, STEP)
    middles = np.array([centroid(surface.level(z))[0] for z in levels.tolist()])
    if not len(middles) or levels[-1] - end < SHORTEST:
        return centroid(surface.level(end))[0], np.zeros(2)
    slope, at_end = np.polyfit(levels - end, middles, 1)
    return at_end, slope
