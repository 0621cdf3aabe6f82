"""The shaft of a femur where its surface ends, and its continuation below.

Scans of a hip often end below the lesser trochanter. The shaft is then continued along the axis
of the last sections, in their shape and size.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from app.foundation.arrays import Floats, unit_vectors
from app.foundation.errors import GeometryError
from app.patient import welding
from app.patient.bone_surface import BoneSurface
from app.patient.measured_layers import LEAST_CORTEX, THETA
from meshes.data import connected
from meshes.femur_bone import CANAL, CONE_END, ISTHMUS, OUTER
from meshes.plane_sections import centroid, exits, mean_width

# Least downward part of a normal at the end of a surface [-].
LEAST_DOWNWARD = 0.5
# Distance above the end in which a smoothed edge may be round [mm].
EDGE_ROUNDING = 3.0
# Length of the last sections, whose axis is continued [mm].
LAST_LENGTH = 25.0
# Shortest length of sections that have an axis [mm].
SHORTEST_AXIS = 10.0
# Distance between sections [mm].
SECTION_STEP = 2.5
# Length of the rows of triangles below the end [mm].
ROW_LENGTH = 10.0
# Largest distance of a flat end's corners from its plane [mm].
FLATNESS = 1.0
# Parts of lateral, medial and antero-posterior half-width in the mean one [-].
HALF_WIDTHS = (0.25, 0.25, 0.5)
# Length below the end in which a continued canal becomes as wide as at its isthmus [mm].
ADAPTATION_LENGTH = 30.0
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
    downward = np.flatnonzero(normal @ up < -LEAST_DOWNWARD * np.linalg.norm(normal, axis=1))
    level_of_end = lowest
    corners = surface.triangles[downward]
    lowest_corners = level[corners].min(axis=1)
    if lowest_corners.min(initial=np.inf) < lowest + EDGE_ROUNDING:
        # Triangles are joined through their corners.
        triangle_rows = np.repeat(np.arange(len(downward)), 3)
        pieces = connected(
            len(downward) + len(level), triangle_rows, len(downward) + corners.ravel()
        )[: len(downward)]
        level_of_end = float(level[corners[pieces == pieces[lowest_corners.argmin()]]].max())
    if len(surface.rim):
        rim = surface.rim @ up
        middle = 0.5 * (lowest + float(level.max()))
        level_of_end = max(level_of_end, float(rim[rim < middle].max(initial=lowest)))
    return level_of_end + EDGE_ROUNDING


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
    area_vectors = 0.5 * np.cross(b - a, c - a)
    triangle_areas = np.linalg.norm(area_vectors, axis=1)
    area_vectors, a, triangle_areas = (
        area_vectors[triangle_areas > 0],
        a[triangle_areas > 0],
        triangle_areas[triangle_areas > 0],
    )
    normals = area_vectors / triangle_areas[:, None]
    # Planes by direction and distance from the origin.
    plane_keys = np.column_stack(
        [np.round(normals * 20), np.round((normals * a).sum(axis=1) / FLATNESS)]
    )
    _, plane = np.unique(plane_keys, axis=0, return_inverse=True)
    plane_areas = np.bincount(plane.ravel(), triangle_areas)
    largest_plane = int(plane_areas.argmax())
    inward = -unit_vectors(area_vectors[plane.ravel() == largest_plane].sum(axis=0))
    extends_beyond = (x @ inward).min() < (
        a[plane.ravel() == largest_plane] @ inward
    ).min() - FLATNESS
    return None if extends_beyond or plane_areas[largest_plane] < LEAST_AREA else inward


@dataclass(frozen=True, eq=False)
class Narrowing:
    """Width of the parametric femur relative to its width at one level.

    It is constant below the isthmus.

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
        return self.half_width(z) / self.half_width(self.end)

    def half_width(self, z: Floats | float) -> Floats:
        """Return mean half-widths of the parametric femur at levels of this one [mm]."""
        rows = self.table[np.argsort(self.table[:, 0])]
        levels = np.maximum(np.asarray(z) / self.size, ISTHMUS)
        return np.asarray(np.interp(levels, rows[:, 0], rows[:, 1:4] @ HALF_WIDTHS))


@dataclass(frozen=True, eq=False)
class CanalWidth:
    """Width of a continued canal relative to its width at the end.

    Attributes:
        narrowing: Width of the parametric canal relative to its width at the end.
        adaptation_factor: Factor on `narrowing` below `ADAPTATION_LENGTH` under the end; 1 at the
            end [-].
        isthmus: Mean width of the canal where it is narrowest [mm].
        is_assumed: True if the isthmus is not in the scan, so that its width is assumed or given.
        wall: Radii of canal and bone at the end in the directions `THETA` (2, n) [mm].
    """

    narrowing: Narrowing
    adaptation_factor: float
    isthmus: float
    is_assumed: bool
    wall: Floats

    def __call__(self, z: Floats) -> Floats:
        """Return the width at levels [-]."""
        adapted_fraction = np.clip((self.narrowing.end - z) / ADAPTATION_LENGTH, 0.0, 1.0)
        return np.asarray(
            self.narrowing(z) * (1.0 + adapted_fraction * (self.adaptation_factor - 1.0))
        )


Width = Callable[[Floats], Floats]


@dataclass(frozen=True, eq=False)
class Continuation:
    """A shaft below the end of a surface, in the model's axes.

    Attributes:
        end: Level at which it begins [mm].
        centre: Centroid of the section there (2,) [mm].
        slope: Change of the centroid with the level (2,) [-].
        low: Level at which it ends [mm].
        width: Width at a level over that at the end, of the bone.
        canal: Width of the canal; None if the scan has no canal at its end.
        scan_end: Lowest level of the scanned surface [mm]; its edge, up to `end`, is not used.
    """

    end: float
    centre: Floats
    slope: Floats
    low: float
    width: Narrowing
    canal: CanalWidth | None
    scan_end: float

    def surface(self, above: BoneSurface, width: Width) -> BoneSurface:
        """Return a surface that is continued below the end.

        Args:
            above: The surface, of the bone or of its canal.
            width: Its width at levels over that at the end.
        """
        section_lines = above.level(self.end)
        ring_count = max(2, int((self.end - self.low) / ROW_LENGTH) + 1)
        z: Floats = np.linspace(self.end, self.low, ring_count, dtype=float)
        rings = self._points_at_levels(section_lines[None], z[:, None, None], width)
        rings = np.concatenate(
            [rings, np.broadcast_to(z[:, None, None, None], (*rings.shape[:3], 1))], axis=3
        )
        ring_starts, ring_ends = rings[:, :, 0], rings[:, :, 1]
        side_triangles = [
            np.stack([ring_starts[:-1], ring_starts[1:], ring_ends[:-1]], axis=2),
            np.stack([ring_ends[:-1], ring_starts[1:], ring_ends[1:]], axis=2),
        ]
        end_centre = np.broadcast_to(
            np.r_[self._points_at_levels(self.centre, z[-1:], width)[0], self.low],
            ring_starts[-1].shape,
        )
        corners = np.concatenate(
            [
                clipped(above, self.end),
                *(part.reshape(-1, 3, 3) for part in side_triangles),
                np.stack([end_centre, ring_ends[-1], ring_starts[-1]], axis=1),
            ]
        )
        welded = welding.weld(corners)
        return replace(above, points=welded.points, triangles=welded.triangles)

    def _points_at_levels(self, x: Floats, z: Floats, width: Width) -> Floats:
        """Return points of the last section (..., 2) moved to levels (...)."""
        z = z[..., None]
        return np.asarray(self.centre + (z - self.end) * self.slope + width(z) * (x - self.centre))

    def scanned(self, x: Floats) -> Floats:
        """Return points (n, 3). Points below the end are moved up to the last section."""
        z = np.minimum(x[:, 2:], self.end)
        offset = x[:, :2] - self.centre - (z - self.end) * self.slope
        bone_width = self.width(z[:, 0])
        scale = 1.0 / bone_width
        if self.canal:
            r, theta = np.hypot(*offset.T), np.arctan2(offset[:, 1], offset[:, 0])
            canal_at_end, bone_at_end = (
                np.interp(theta, THETA, radii, period=2 * np.pi) for radii in self.canal.wall
            )
            width_of_canal = self.canal(z[:, 0])
            inner, outer = width_of_canal * canal_at_end, bone_width * bone_at_end
            # Points of the wall stay at the same fraction of its thickness.
            thickness_fraction = (r - inner) / (outer - inner)
            r_in_wall = canal_at_end + thickness_fraction * (bone_at_end - canal_at_end)
            is_in_wall = r > inner
            scale = np.where(
                is_in_wall, r_in_wall / np.where(is_in_wall, r, 1.0), 1 / width_of_canal
            )
        return np.column_stack(
            [self.centre + scale[:, None] * offset, np.maximum(x[:, 2:], self.end)]
        )


def canal_width(
    bone: BoneSurface,
    canal: BoneSurface,
    outer: Narrowing,
    centre: Floats,
    shaft_top: float,
    isthmus: float | None,
) -> CanalWidth:
    """Return the width of a canal below the end of a scan.

    A canal's width in the metaphysis is a poor estimate of its width at the isthmus. So the ratio
    of canal and bone at the end is weighted against the ratio of the parametric femur. Its weight
    is the measured fraction of the shaft between its top and `CONE_END`.

    Args:
        bone: The bone, in the model's axes.
        canal: Its canal.
        outer: Width of the continued bone.
        centre: Centroid of the bone's last section (2,) [mm].
        shaft_top: Level at which the shaft begins [mm].
        isthmus: Mean width of the canal at its isthmus [mm], if it is given.

    Raises:
        GeometryError: This isthmus leaves too thin a cortex.
    """
    end, size = outer.end, outer.size
    inner = Narrowing(CANAL, end, size)
    bone_width, width_at_end = (mean_width(surface.level(end)) for surface in (bone, canal))
    isthmus_level = np.array(min(ISTHMUS * size, end - ADAPTATION_LENGTH))
    parametric_bone, parametric_canal = (
        float(narrowing.half_width(end)) for narrowing in (outer, inner)
    )
    excess = (width_at_end / bone_width) / (parametric_canal / parametric_bone)
    measured_fraction = float(np.clip((shaft_top - end) / (shaft_top - CONE_END * size), 0.0, 1.0))
    adaptation_factor = (1.0 + measured_fraction * (excess - 1.0)) / excess
    narrowed_width = width_at_end * float(inner(isthmus_level))
    is_assumed = end > ISTHMUS * size
    if isthmus is not None and is_assumed:
        adaptation_factor = isthmus / narrowed_width
        _check_isthmus(isthmus, bone_width * float(outer(isthmus_level)))
    wall = np.array([exits(surface.level(end) - centre, THETA)[0] for surface in (canal, bone)])
    return CanalWidth(
        inner, adaptation_factor, adaptation_factor * narrowed_width, is_assumed, wall
    )


def _check_isthmus(isthmus: float, bone_width: float) -> None:
    """Raise GeometryError if a given width leaves too thin a cortex in a bone (both mm)."""
    widest = bone_width - 2.0 * LEAST_CORTEX
    if isthmus > widest:
        raise GeometryError(
            f"geometry.canal.isthmus: {isthmus:g} mm leaves less than {LEAST_CORTEX:g} mm of"
            f" cortex; expected at most {widest:.1f} mm"
        )


@dataclass(frozen=True)
class CanalByRatios:
    """A canal that no file has: it has the ratios of the parametric femur to the bone.

    Attributes:
        isthmus: Its mean width at the isthmus [mm].
        scale: This width over that by the ratios alone [-].
    """

    isthmus: float
    scale: float


def canal_by_ratios(bone: BoneSurface, size: float, isthmus: float | None) -> CanalByRatios:
    """Return the canal of a bone that has none.

    Args:
        bone: The bone, in the model's axes.
        size: Its size over that of the parametric femur [-].
        isthmus: Mean width of the canal at its isthmus [mm], if it is given.

    Raises:
        GeometryError: This isthmus leaves too thin a cortex.
    """
    level = max(ISTHMUS * size, float(bone.points[:, 2].min()) + EDGE_ROUNDING)
    outer, inner = (Narrowing(table, level, size).half_width(level) for table in (OUTER, CANAL))
    bone_width = mean_width(bone.level(level))
    width = bone_width * float(inner / outer)
    if isthmus is None:
        return CanalByRatios(width, 1.0)
    _check_isthmus(isthmus, bone_width)
    return CanalByRatios(isthmus, isthmus / width)


def clipped(surface: BoneSurface, level: float) -> Floats:
    """Return the triangles (m, 3, 3) of a surface above a level. Crossing ones are divided."""
    x = surface.corners
    is_above = x[..., 2] >= level
    corners_above = is_above.sum(axis=1)
    kept_triangles = [x[corners_above == 3]]
    for number_above in (1, 2):
        crossing = x[corners_above == number_above]
        is_alone = is_above[corners_above == number_above] == (number_above == 1)
        # The corner that is alone on its side of the level comes first.
        alone_corner = is_alone.argmax(axis=1)
        corner_order = (alone_corner[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(crossing, corner_order[..., None], axis=1).transpose(1, 0, 2)
        ab, ac = (
            a + ((level - a[:, 2]) / (other[:, 2] - a[:, 2]))[:, None] * (other - a)
            for other in (b, c)
        )
        if number_above == 1:
            kept_triangles.append(np.stack([a, ab, ac], axis=1))
        else:
            kept_triangles += [np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)]
    return np.concatenate(kept_triangles)


def axis_of_end(surface: BoneSurface, end: float, top: float) -> tuple[Floats, Floats]:
    """Return centroid (2,) at the end and its change with the level (2,) by the last sections.

    Args:
        surface: The bone, in the model's axes.
        end: Level at which it ends.
        top: Highest level of the shaft. The change is zero if less than `SHORTEST_AXIS` of the
            shaft lies between the end and this level.
    """
    levels = np.arange(end, min(end + LAST_LENGTH, top) + 1e-9, SECTION_STEP)
    centroids = np.array([centroid(surface.level(z))[0] for z in levels.tolist()])
    if not len(centroids) or levels[-1] - end < SHORTEST_AXIS:
        return centroid(surface.level(end))[0], np.zeros(2)
    slope, at_end = np.polyfit(levels - end, centroids, 1)
    return at_end, slope
