"""Room for cement around a stem, in any position: its distance from the widest possible canal.

The canal is known in sections that are fixed to the bone: those of a stem along the shaft's axis,
turned to the neck. Its signed distance is kept on a grid, so that a position takes a millisecond.
The page of `mantle place` and the search for a position (`best_position`) interpolate on this grid.

Cement fills the canal up to a given distance from the stem. Its thickness at a point of the stem is
therefore the given one or the room there, whichever is less. A stem without cement may reach into
the cortex: its canal is then the one that leaves the least cortex allowed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from app.foundation.arrays import Floats, unit_vectors
from app.foundation.errors import GeometryError
from app.foundation.implant import Implant
from meshes import femur_stem
from meshes.cad_stem import CadStem
from meshes.layered_surfaces import LEAST_CORTEX, SIDES_OF_STEM
from meshes.layers import Sections
from meshes.placement import LEAST_SHOULDER_DEPTH, CutPlane, Placement, Position

if TYPE_CHECKING:
    from app.case.hips import Hip

# Distances between nodes of the grid [mm]. The canal is straighter along z.
GRID_STEP = np.array([1.0, 1.0, 2.0])
DISTANCE_UNIT = 0.002  # mm: distances on the grid are multiples of it
GRID_MARGIN = 8.0  # mm of the grid beyond the canal
CANAL_AROUND = 144  # points around the canal
CANAL_STEP = 0.75  # mm between sections of the canal
POINT_SPACING = 0.4  # mm: largest distance of the canal from its nearest point
BELOW_TIP = 45.0  # mm below the stem's tip down to which the canal is known
END_MARGIN = 3.0  # mm above the end of the bone
STEM_AROUND = 72  # points around the stem
STEM_STEP = 1.0  # mm between sections of the stem
BODY_SECTIONS = 140  # sections of the body of mantle's parametric stem
NECK_SECTIONS = 20  # sections of each part of the neck


@dataclass(frozen=True, eq=False)
class WidestCanal:
    """The widest possible canal of a bone below its neck cut, in the model's axes.

    Attributes:
        cut: The neck cut.
        points: Points of its surface in sections from below (n, `CANAL_AROUND`, 3) [mm].
        low: First node of the grid (3,) [mm].
        distances: Distances of the nodes from the surface in `DISTANCE_UNIT`, positive within
            (i, j, k).
    """

    cut: CutPlane
    points: Floats
    low: Floats
    distances: Floats

    def room(self, x: Floats) -> Floats:
        """Distance of points (n, 3) from the surface, positive within (n,) [mm].

        It is linear between nodes. Beyond the grid the distance from it is subtracted.
        """
        grid_position = (x - self.low) / GRID_STEP
        nearest = np.clip(grid_position, 0.0, np.array(self.distances.shape) - 1)
        outside_distance = np.linalg.norm((grid_position - nearest) * GRID_STEP, axis=-1)
        room = map_coordinates(self.distances, nearest.T, order=1)
        return np.asarray(DISTANCE_UNIT * room - outside_distance)


def widest_canal(geometry: Hip) -> WidestCanal:
    """The widest possible canal of a geometry.

    Raises:
        GeometryError: The shaft's axis leaves the bone, or a surface crosses itself.
    """
    cut, implant, femur = CutPlane.of(geometry), geometry.implant, geometry.femur
    placement = cut.put(implant, Position(0.0, 0.0, 0.0, femur.neck, 0.0, 0.0), femur.mirrored)
    tip_end = placement.to_model([0.0, 0.0, implant.tip_z])[2] - BELOW_TIP
    lowest_level = placement.along(max(float(tip_end), femur.lowest + END_MARGIN))
    count = int((placement.top - lowest_level) / CANAL_STEP) + 1
    zeta = np.asarray(np.linspace(lowest_level, placement.top, count), dtype=float)
    sections = Sections(placement, placement.top, implant.plug, zeta)
    layers = femur.layers(geometry, sections, None)
    theta, levels = np.meshgrid(2 * np.pi * np.arange(CANAL_AROUND) / CANAL_AROUND, zeta)
    angles, heights = theta.ravel(), levels.ravel()
    points = layers.canal(angles, heights)
    if not geometry.is_cemented:
        ends = layers.ends(angles, heights)
        points = ends - LEAST_CORTEX * unit_vectors(ends - points)
    points = placement.to_model(points)
    return canal_of(cut, points.reshape(len(zeta), CANAL_AROUND, 3))


def canal_of(cut: CutPlane, points: Floats) -> WidestCanal:
    """A canal with points of its surface in sections from below (n, k, 3) [mm]."""
    lower_corner = points.min(axis=(0, 1)) - GRID_MARGIN
    size = (
        np.ceil((points.max(axis=(0, 1)) + GRID_MARGIN - lower_corner) / GRID_STEP).astype(int) + 1
    )
    nodes = (
        lower_corner
        + np.stack(np.meshgrid(*map(np.arange, size), indexing="ij"), axis=-1) * GRID_STEP
    )
    distances = np.round(_signed_distances(nodes.reshape(-1, 3), points) / DISTANCE_UNIT)
    return WidestCanal(cut, points, lower_corner, distances.reshape(size))


def _signed_distances(x: Floats, surface: Floats) -> Floats:
    """Distances of points (n, 3) from a tube of points (m, k, 3), positive within (n,) [mm].

    Near the surface the distance is that from the tangent plane at the nearest point; beyond the
    ends of the tube it is that from the nearest point.
    """
    tangents = np.roll(surface, -1, axis=1) - np.roll(surface, 1, axis=1)
    outward = np.cross(tangents, np.gradient(surface, axis=0)).reshape(-1, 3)
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    points = surface.reshape(-1, 3)
    distances, nearest = cKDTree(points).query(x)
    plane_distances = ((points[nearest] - x) * outward[nearest]).sum(axis=1)
    least_distances = np.sqrt(np.maximum(distances**2 - POINT_SPACING**2, 0.0))
    return np.asarray(
        np.copysign(np.maximum(np.abs(plane_distances), least_distances), plane_distances)
    )


class _Steps:
    """Steps of the lines along a neck, in place of mesh options."""

    def steps(self, length: float) -> int:
        """Number of steps along a length [mm]."""
        return max(1, round(length / STEM_STEP))


@dataclass(frozen=True, eq=False)
class StemSurface:
    """Surface of a stem, in its axes.

    The body of a parametric stem ends in a plane that depends on the cut. Its neck begins there.

    Attributes:
        implant: The stem.
        start: Points where its lines along the body begin, at the end of its flanks (m, 3) [mm].
        direction: Change of these lines for each millimetre along the axis (m, 3).
        points: Points in sections of a stem from a file (n, m, 3) [mm]; None for a parametric stem.
    """

    implant: Implant
    start: Floats
    direction: Floats
    points: Floats | None = None

    @classmethod
    def of(cls, implant: Implant, placement: Placement, around: int = STEM_AROUND) -> StemSurface:
        """The surface of a stem. The sections of a stem from a file are those of the placement."""
        low = implant.tip_z + implant.tip_height
        turns = np.arange(around) / around
        if implant.cad is None:
            body = femur_stem.shaft_of(implant)
            start, end = (body.point(turns, np.full(around, z), 0.0) for z in (low, low + 1.0))
            return cls(implant, start, end - start)
        steps = _Steps()
        shoulder = _shoulder(implant, placement)
        stem = CadStem(implant.cad, (implant.tip_z, shoulder), placement, steps)
        count = int((placement.top - low) / STEM_STEP) + 1
        zeta = np.asarray(np.linspace(low, placement.top, count), dtype=float)
        sections = Sections(placement, shoulder, implant.plug, zeta)
        phi, levels = (v.ravel() for v in np.meshgrid(turns, zeta))
        body_points = stem.point(phi, levels, sections.slope(levels))
        stations = np.linspace(0.0, stem.ends[-1], NECK_SECTIONS)[1:]
        phi, levels = (v.ravel() for v in np.meshgrid(turns, stations))
        points = np.concatenate([body_points, stem.points(phi, levels)]).reshape(-1, around, 3)
        return cls(implant, points[0], np.zeros((around, 3)), points)

    def placed_points(self, placement: Placement) -> Floats:
        """Points in sections from the end of its flanks to the end of its neck (n, m, 3) [mm].

        The turn to the neck is not rounded.

        Raises:
            GeometryError: The neck does not clear the cut.
        """
        if self.points is not None:
            return self.points
        implant, slopes = self.implant, placement.slopes
        shoulder = _shoulder(implant, placement)
        shaft = replace(femur_stem.shaft_of(implant), lean=slopes[1])
        upper = femur_stem.stem_above_cut(
            implant, shaft, _Steps(), shoulder, placement.top, slopes[0]
        )
        height, slope = upper.planes[1]
        rise = np.array([slope, slope * slopes[1], 1.0])
        length = (height - self.start @ rise) / (self.direction @ rise)
        fraction = np.linspace(0.0, 1.0, BODY_SECTIONS)[:, None, None]
        flanks = self.start + fraction * (length[:, None] * self.direction)
        turns = np.arange(len(self.start)) / len(self.start)
        first_ring, last_ring = upper.ring(turns, 0), upper.ring(turns, 1)
        fraction = np.linspace(0.0, 1.0, NECK_SECTIONS)[1:, None, None]
        blend = flanks[-1] + fraction * (first_ring - flanks[-1])
        return np.concatenate([flanks, blend, first_ring + fraction * (last_ring - first_ring)])

    def cemented(self, placement: Placement, cut: CutPlane) -> Floats:
        """Points below the cut, and points where lines along the stem meet it (n, 3) [mm]."""
        points = self.placed_points(placement)
        height = placement.to_model(points) @ cut.normal - cut.level
        is_below = height < 0
        row, column = np.nonzero(is_below[:-1] & ~is_below[1:])
        fraction = height[row, column] / (height[row, column] - height[row + 1, column])
        lower_points, upper_points = points[row, column], points[row + 1, column]
        return np.concatenate(
            [points[is_below], lower_points + fraction[:, None] * (upper_points - lower_points)]
        )


def _shoulder(implant: Implant, placement: Placement) -> float:
    """Height at the axis of the section at the shoulder, or of the cut, as meshed [mm]."""
    edge = femur_stem.shoulder_plane_height(implant, placement.slopes[0])
    return edge if edge < placement.top - LEAST_SHOULDER_DEPTH else placement.top


@dataclass(frozen=True, eq=False)
class Fit:
    """Fit of a stem in a position.

    Attributes:
        least: Least room for cement; negative where the stem cuts the cortex [mm].
        place: Point of the stem with the least room, in the model's axes (3,) [mm].
        side: Side of the stem on which that point is.
    """

    least: float
    place: Floats
    side: str

    def words(self, placement: Placement) -> str:
        """The least room with its place."""
        location = f"{self.side} at {placement.point_in_words(self.place)}"
        if self.least < 0:
            return f"none: the stem cuts {-self.least:.2f} mm into the cortex {location}"
        return f"at least {self.least:.2f} mm, {location}"


def fit(canal: WidestCanal, stem: StemSurface, placement: Placement) -> Fit:
    """The fit of a stem.

    Raises:
        GeometryError: No part of the stem is below the cut.
    """
    points = stem.cemented(placement, canal.cut)
    if not len(points):
        raise GeometryError("geometry.insertion.depth: the stem is above the neck cut")
    x = placement.to_model(points)
    room = canal.room(x)
    narrowest = int(room.argmin())
    offset = placement.rotation[:, :2] @ points[narrowest, :2]
    side = SIDES_OF_STEM[round(8 * np.arctan2(offset[1], offset[0]) / (2 * np.pi)) % 8]
    return Fit(float(room[narrowest]), x[narrowest], side)


def fit_of(geometry: Hip) -> Fit:
    """The fit of the stem of a geometry.

    Raises:
        GeometryError: The shaft's axis leaves the bone, or the stem is above the neck cut.
    """
    placement = geometry.placement
    return fit(widest_canal(geometry), StemSurface.of(geometry.implant, placement), placement)
