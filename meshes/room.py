"""Room for cement around a stem, in any position: its distance from the widest possible canal.

The canal is known in sections that are fixed to the bone: those of a stem along the shaft's axis,
turned to the neck. Its signed distance is kept on a grid, so that a position takes a millisecond:
the page of `mantle place` interpolates the same numbers, and the search for a position
(`best_position`) too.

Cement is within a distance from the stem and within the canal. Its thickness at a point of the stem
is therefore the lesser of the thickness that is asked for and the room there. A stem without cement
may reach into the cortex: its canal is then what leaves the least cortex.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from app.foundation.arrays import Floats
from app.foundation.errors import GeometryError
from app.foundation.implant import Implant
from meshes import femur_stem
from meshes.cad_stem import CadStem
from meshes.geometry import HipKeys
from meshes.layered_surfaces import DEEP, LEAST_CORTEX, SIDES
from meshes.layers import Sections
from meshes.placement import CutPlane, Placement, Position

STEP = np.array([1.0, 1.0, 2.0])  # mm between nodes of the grid; the canal is straighter along z
UNIT = 0.002  # mm: distances on the grid are multiples of it
MARGIN = 8.0  # mm of the grid beyond the canal
AROUND = 144  # points around the canal
ALONG = 0.75  # mm between sections of the canal
BETWEEN = 0.4  # mm: largest distance of the canal from its nearest point
BELOW = 45.0  # mm below the stem's tip down to which the canal is known
END = 3.0  # mm above the end of the bone
STEM_AROUND = 72  # points around the stem
STEM_ALONG = 1.0  # mm between sections of the stem
BODY_ALONG = 140  # sections of the body of mantle's parametric stem
NECK_ALONG = 20  # sections of each part of the neck


@dataclass(frozen=True, eq=False)
class WidestCanal:
    """The widest possible canal of a bone below its neck cut, in the model's axes.

    Attributes:
        cut: The neck cut.
        points: Points of its surface in sections from below (n, `AROUND`, 3) [mm].
        low: First node of the grid (3,) [mm].
        distances: Distances of the nodes from the surface, in `UNIT`; positive within (i, j, k).
    """

    cut: CutPlane
    points: Floats
    low: Floats
    distances: Floats

    def room(self, x: Floats) -> Floats:
        """Distance of points (..., 3) from the surface, positive within (...) [mm].

        It is linear between nodes. Beyond the grid the distance from it is subtracted.
        """
        most = np.array(self.distances.shape) - 1
        at = (x - self.low) / STEP
        within = np.clip(at, 0.0, most)
        beyond = np.linalg.norm((at - within) * STEP, axis=-1)
        i = np.minimum(within.astype(np.int64), most - 1)
        part = within - i
        room = np.zeros(x.shape[:-1])
        for corner in np.ndindex(2, 2, 2):
            weight = np.where(corner, part, 1.0 - part).prod(axis=-1)
            node = i + corner
            room += weight * self.distances[node[..., 0], node[..., 1], node[..., 2]]
        return np.asarray(UNIT * room - beyond)


def canal(geometry: HipKeys) -> WidestCanal:
    """The widest possible canal of a geometry.

    Raises:
        GeometryError: The shaft's axis leaves the bone, or a surface crosses itself.
    """
    cut, implant, femur = CutPlane.of(geometry), geometry.implant, geometry.femur
    placed = cut.put(implant, Position(0.0, 0.0, 0.0, femur.neck, 0.0, 0.0), femur.mirrored)
    end = placed.to_model([0.0, 0.0, implant.tip_z])[2] - BELOW
    low = placed.along(max(float(end), femur.lowest + END))
    count = int((placed.top - low) / ALONG) + 1
    zeta = np.asarray(np.linspace(low, placed.top, count), dtype=float)
    sections = Sections(placed, placed.top, implant.plug, zeta)
    layers = femur.layers(geometry, sections, None)
    theta, levels = np.meshgrid(2 * np.pi * np.arange(AROUND) / AROUND, zeta)
    around, along = theta.ravel(), levels.ravel()
    points = layers.canal(around, along)
    if not geometry.is_cemented:
        ends = layers.ends(around, along)
        points = ends - LEAST_CORTEX * femur_stem.unit(ends - points)
    points = placed.to_model(points)
    return canal_of(cut, points.reshape(len(zeta), AROUND, 3))


def canal_of(cut: CutPlane, points: Floats) -> WidestCanal:
    """A canal with points of its surface in sections from below (n, k, 3) [mm]."""
    first = points.min(axis=(0, 1)) - MARGIN
    size = np.ceil((points.max(axis=(0, 1)) + MARGIN - first) / STEP).astype(int) + 1
    nodes = first + np.stack(np.meshgrid(*map(np.arange, size), indexing="ij"), axis=-1) * STEP
    distances = np.round(_signed(nodes.reshape(-1, 3), points) / UNIT)
    return WidestCanal(cut, points, first, distances.reshape(size))


def _signed(x: Floats, surface: Floats) -> Floats:
    """Distances of points (n, 3) from a tube of points (m, k, 3), positive within (n,) [mm].

    Near the surface the distance is that from the tangent plane at the nearest point; beyond the
    ends of the tube it is that from the nearest point.
    """
    around = np.roll(surface, -1, axis=1) - np.roll(surface, 1, axis=1)
    outward = np.cross(around, np.gradient(surface, axis=0)).reshape(-1, 3)
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    places = surface.reshape(-1, 3)
    away, nearest = cKDTree(places).query(x)
    plane = ((places[nearest] - x) * outward[nearest]).sum(axis=1)
    beside = np.sqrt(np.maximum(away**2 - BETWEEN**2, 0.0))
    return np.asarray(np.copysign(np.maximum(np.abs(plane), beside), plane))


class _Steps:
    """Steps of the lines along a neck, in place of mesh options."""

    def steps(self, length: float) -> int:
        """Number of steps along a length [mm]."""
        return max(1, round(length / STEM_ALONG))


@dataclass(frozen=True, eq=False)
class StemSurface:
    """Surface of a stem, in its axes.

    The body of a parametric stem ends in a plane that depends on the cut. Its neck begins there.

    Attributes:
        implant: The stem.
        start: Points where its lines along the body begin, at the end of its flanks (m, 3) [mm].
        way: Change of these lines for each millimetre along the axis (m, 3).
        points: Points in sections of a stem from a file (n, m, 3) [mm]; None: a parametric stem.
    """

    implant: Implant
    start: Floats
    way: Floats
    points: Floats | None = None

    @classmethod
    def of(cls, implant: Implant, placed: Placement, around: int = STEM_AROUND) -> StemSurface:
        """The surface of a stem; of a file in sections of this placement."""
        low = implant.tip_z + implant.tip_height
        turns = np.arange(around) / around
        if implant.cad is None:
            body = femur_stem.body(implant)
            start, end = (body.point(turns, np.full(around, z), 0.0) for z in (low, low + 1.0))
            return cls(implant, start, end - start)
        steps = _Steps()
        shoulder = _shoulder(implant, placed)
        stem = CadStem(implant.cad, (implant.tip_z, shoulder), placed, steps)
        count = int((placed.top - low) / STEM_ALONG) + 1
        zeta = np.asarray(np.linspace(low, placed.top, count), dtype=float)
        sections = Sections(placed, shoulder, implant.plug, zeta)
        phi, levels = (v.ravel() for v in np.meshgrid(turns, zeta))
        body_points = stem.point(phi, levels, sections.slope(levels))
        stations = np.linspace(0.0, stem.ends[-1], NECK_ALONG)[1:]
        phi, levels = (v.ravel() for v in np.meshgrid(turns, stations))
        points = np.concatenate([body_points, stem.points(phi, levels)]).reshape(-1, around, 3)
        return cls(implant, points[0], np.zeros((around, 3)), points)

    def at(self, placed: Placement) -> Floats:
        """Points in sections from the end of its flanks to that of its neck (n, m, 3) [mm].

        The turn to the neck is not rounded.

        Raises:
            GeometryError: The neck does not clear the cut.
        """
        if self.points is not None:
            return self.points
        implant, slopes = self.implant, placed.slopes
        shoulder = _shoulder(implant, placed)
        body = replace(femur_stem.body(implant), lean=slopes[1])
        upper = femur_stem.upper(implant, body, _Steps(), shoulder, placed.top, slopes[0])
        height, slope = upper.planes[1]
        rise = np.array([slope, slope * slopes[1], 1.0])
        length = (height - self.start @ rise) / (self.way @ rise)
        part = np.linspace(0.0, 1.0, BODY_ALONG)[:, None, None]
        flanks = self.start + part * (length[:, None] * self.way)
        turns = np.arange(len(self.start)) / len(self.start)
        first, last = upper.ring(turns, 0), upper.ring(turns, 1)
        part = np.linspace(0.0, 1.0, NECK_ALONG)[1:, None, None]
        blend = flanks[-1] + part * (first - flanks[-1])
        return np.concatenate([flanks, blend, first + part * (last - first)])

    def cemented(self, placed: Placement, cut: CutPlane) -> Floats:
        """Points below the cut, and where lines along the stem meet it (n, 3) [mm]."""
        points = self.at(placed)
        height = placed.to_model(points) @ cut.normal - cut.level
        below = height < 0
        row, turn = np.nonzero(below[:-1] & ~below[1:])
        part = height[row, turn] / (height[row, turn] - height[row + 1, turn])
        low, high = points[row, turn], points[row + 1, turn]
        return np.concatenate([points[below], low + part[:, None] * (high - low)])


def _shoulder(implant: Implant, placed: Placement) -> float:
    """Height at the axis of the section at the shoulder, or of the cut, as meshed [mm]."""
    edge = femur_stem.edge(implant, placed.slopes[0])
    return edge if edge < placed.top - DEEP else placed.top


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

    def words(self, placed: Placement) -> str:
        """The least room with its place."""
        where = f"{self.side} at {placed.where(self.place)}"
        if self.least < 0:
            return f"none: the stem cuts {-self.least:.2f} mm into the cortex {where}"
        return f"at least {self.least:.2f} mm, {where}"


def fit(canal: WidestCanal, stem: StemSurface, placed: Placement) -> Fit:
    """The fit of a stem.

    Raises:
        GeometryError: No part of the stem is below the cut.
    """
    points = stem.cemented(placed, canal.cut)
    if not len(points):
        raise GeometryError("geometry.insertion.depth: the stem is above the neck cut")
    x = placed.to_model(points)
    room = canal.room(x)
    worst = int(room.argmin())
    out = placed.turn[:, :2] @ points[worst, :2]
    side = SIDES[round(8 * np.arctan2(out[1], out[0]) / (2 * np.pi)) % 8]
    return Fit(float(room[worst]), x[worst], side)


def room_in_words(geometry: HipKeys) -> str:
    """Least room around the stem of a geometry, with its place.

    Raises:
        GeometryError: The shaft's axis leaves the bone, or the stem is above the neck cut.
    """
    placed = geometry.placement
    stem = StemSurface.of(geometry.implant, placed)
    return fit(canal(geometry), stem, placed).words(placed)
