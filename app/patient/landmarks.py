"""Landmarks and axes of a femur from the triangles of its surface.

The head is a sphere, determined by pairs of points with normals. The shaft is a line through
centroids of sections. The lesser trochanter is the most prominent peak of the outline's reach
along the shaft. The neck is the plane of least area. Lengths go with the head's radius, so that
size does not matter.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d, uniform_filter
from scipy.optimize import least_squares, minimize
from scipy.signal import find_peaks
from scipy.spatial import cKDTree

from app.foundation.arrays import Bools, Floats, unit_vectors
from app.foundation.errors import GeometryError
from app.foundation.layout import fixed
from app.patient import shaft
from app.patient.bone_surface import BoneSurface, mean_point_text
from app.patient.given_landmarks import SHAFT_LEVEL, GivenLandmarks
from meshes.plane_sections import centroid, exits, lines_at_height

HEAD_RADII = (14.0, 36.0)  # mm: smallest and largest radius of a head
HEAD_FROM_END = 90.0  # mm from an end of the bone within which its head is
SAMPLE_SIZE = 2.5  # mm between samples
SAMPLE_PAIRS = 1500  # pairs of samples that are tried
NORMAL_SMOOTHING = 4.0  # mm over which normals are averaged
SPHERE_DISTANCE = 1.0  # mm from a sphere within which points belong to it
# Least cosine of the angle between a normal and the radius of its sphere.
LEAST_COSINE = math.cos(math.radians(18.0))
LEAST_COVERED = 0.33  # part of a sphere that a head covers, at least
OUTLIER_DISTANCE = 0.5  # mm: residuals of the head beyond it count less
SECTION_STEP = 1.5  # mm between sections that are searched for the lesser trochanter
REACH_DECAY = 0.7  # mm: decay of the weights of an outermost place
NECK_OFFSETS = (-4.5, -1.5, 1.5, 4.5)  # mm: sections of the neck beside the least one, averaged
HEAD_SECTORS = 12  # sectors of the head, one left out at a time
# Usual values; others have a note.
USUAL_RADII = (18.0, 30.0)  # radius of the head [mm]
USUAL_NECKS = (110.0, 140.0)  # neck-shaft angle [deg]
USUAL_LENGTHS = (15.0, 25.0)  # length of a femur with condyles in radii of its head
NORMAL_QUANTILE = 1.65  # standard deviations that hold 90 %
LONG_SURFACE = 150.0  # mm that a surface is long whose principal axis is the shaft's
# In radii of the head:
SHAFT_RANGE = (0.8, 2.7)  # below the lesser trochanter, where the shaft's axis is
SHORT_SHAFT_RANGE = (0.5, 0.75)  # the same where the surface ends there, at least
LEAST_SHAFT = 5.0  # mm of sections that have an axis
SHORT_SPREAD = math.radians(6.5)  # that holds 90 % of the shaft's axis if it is 1 radius long
# Levels of the shaft at which it must be solid, below the lesser trochanter.
SOLID_CHECK_LEVELS = (1.0, 1.4, 1.8, 2.2, 2.6)
CONDYLES_BELOW = 4.0  # below the lesser trochanter, at least, condyles are
TROCHANTER_RANGE = (1.3, 3.4)  # below the head's centre, where the lesser trochanter is
USUAL_TROCHANTER = 2.25  # the same in the parametric femur
# Distance above its usual place from which a peak at the end of a scan is no lesser trochanter.
FALSE_TROCHANTER = 0.5
BELOW = "below the lesser trochanter"
CONDYLE_HEIGHT = 3.0  # above the distal end
CONDYLE_DISTANCE = 2.1  # between the condyles
CONDYLE_AREA_RATIO = 1.8  # least area of a section of the condyles over the shaft's


@dataclass(frozen=True)
class Frame:
    """Landmarks of a femur and the axes of its model, medial, anterior and proximal.

    Attributes:
        head: Centre of the head (3,) [mm], in the surface's axes as all below.
        radius: Radius of the head [mm].
        origin: Point of the shaft's axis at the level of the lesser trochanter (3,) [mm].
        axes: Unit vectors medial, anterior, proximal (3, 3), left-handed for a right femur.
        neck: Unit vector along the neck to the head (3,).
        trochanter: Apex of the lesser trochanter (3,) [mm].
        side: ``left`` or ``right``.
        version: Angle of the neck to anterior of the condyles [rad]; None without condyles: then
            medial is along the neck.
        spread: Half-widths of the 90 % intervals of head [mm], neck, version and shaft [rad].
        length: Length of the surface along the shaft [mm].
        end: Level above which the surface is whole, in the model's axes [mm].
        given: Names of the landmarks that were given.
        given_doubts: Their names, and notes on them.
    """

    head: Floats
    radius: float
    origin: Floats
    axes: Floats
    neck: Floats
    trochanter: Floats
    side: str
    version: float | None
    spread: Mapping[str, float]
    length: float
    end: float
    given: tuple[str, ...]
    given_doubts: tuple[tuple[str, str], ...]

    def to_model(self, x: Floats) -> Floats:
        """Points (..., 3) in the model's axes, a right femur mirrored."""
        return np.asarray((x - self.origin) @ self.axes.T)

    @property
    def azimuth(self) -> float:
        """Angle of the neck about the shaft, from medial to anterior [rad]."""
        x, y, _ = self.axes @ self.neck
        return math.atan2(y, x)

    def surface(self, surface: BoneSurface) -> BoneSurface:
        """A surface in the model's axes, still outward."""
        corner_order = slice(None, None, -1 if np.linalg.det(self.axes) < 0 else 1)
        x, triangles = self.to_model(surface.points), surface.triangles[:, corner_order]
        return replace(surface, points=x, triangles=triangles)

    @property
    def details(self) -> dict[str, str]:
        """Landmarks in words, with the intervals that hold 90 %."""
        degrees, spread = math.degrees, self.spread
        places = [f"({', '.join(map(fixed, x))}) mm" for x in (self.head, self.trochanter)]
        head_spread = f" ± {spread['head']:.1f}"
        if "head_centre" in self.given:
            head_spread = ", given"
        if "lesser_trochanter" in self.given:
            places[1] += ", given"
        version = "unknown without condyles: medial is along the neck"
        if self.version is not None:
            version = f"{fixed(degrees(self.version))} deg ± {degrees(spread['version']):.1f}"
        angle = degrees(math.acos(-float(self.axes[2] @ self.neck)))
        angle_spread = degrees(math.hypot(spread["neck"], spread["shaft"]))
        return {
            "side": self.side + (", mirrored" if self.side == "right" else ""),
            "head": f"{places[0]}{head_spread}, radius {self.radius:.1f} mm",
            "lesser trochanter": places[1],
            "neck-shaft angle": f"{angle:.1f} deg ± {angle_spread:.1f}",
            "version": version,
        } | self._short_shaft

    @property
    def _short_shaft(self) -> dict[str, str]:
        """Interval of the shaft's axis, if it is known by a short part of the shaft."""
        if not self.spread["shaft"]:
            return {}
        range_text = (
            f"± {math.degrees(self.spread['shaft']):.0f} deg, by the {-self.end:.0f} mm of shaft"
        )
        return {"axis of the shaft": f"{range_text} below the lesser trochanter"}

    def doubts(self, surface: BoneSurface) -> list[str]:
        """Notes on a rare size or shape of the femur, and on an open proximal end.

        Args:
            surface: Its surface, whose `rim` and `borders` are in the axes of the file.
        """
        notes = list(surface.doubts)
        least, largest = USUAL_RADII
        if not least <= self.radius <= largest:
            doubt = (
                f"the head's radius is {self.radius:.1f} mm; expected {least:g} to {largest:g} mm"
            )
            notes.append(f"{doubt}. Is the unit or scale wrong?")
        angle = math.degrees(math.acos(-float(self.axes[2] @ self.neck)))
        least, largest = USUAL_NECKS
        if not least <= angle <= largest:
            doubt = (
                f"the neck-shaft angle is {angle:.1f} deg; expected {least:g} to {largest:g} deg"
            )
            cause = "Is the bone stretched along an axis"
            if self.given:
                names = ", ".join(f"landmarks.{name}" for name in self.given)
                cause = f"Is a given landmark wrong ({names}), or the bone stretched along an axis"
            notes.append(f"{doubt}. {cause}?")
        least, largest = (ratio * self.radius for ratio in USUAL_LENGTHS)
        if self.version is not None and not least <= self.length <= largest:
            doubt = f"it is {self.length:.0f} mm long with its condyles; expected {least:.0f} to"
            notes.append(f"{doubt} {largest:.0f} mm for its head. Is it stretched along an axis?")
        if len(surface.rim):
            proximal = self.to_model(surface.rim)[:, 2] > 0
            if proximal.any():
                location = mean_point_text(surface.rim[proximal])
                doubt = f"its surface is open at the proximal end, at {location}"
                notes.append(f"{doubt} ({int(proximal.sum())} edges); are triangles missing there?")
        heights = [float(self.to_model(border)[:, 2].mean()) for border in surface.borders]
        for border, height in zip(surface.borders, heights, strict=True):
            # The lowest one is the end of the scan, in the shaft.
            if height > min(0.0, min(heights)):
                doubt = f"the bone is cut by the border of the image at {mean_point_text(border)}"
                notes.append(f"{doubt} ({len(border):,} voxels); is a part of it missing?")
        return notes


def find_landmarks(surface: BoneSurface, given: Mapping[str, Any] | None = None) -> Frame:
    """Find the landmarks of a femur.

    Args:
        surface: Its surface, of the whole bone or of its proximal part.
        given: Known landmarks: ``head_centre``, ``lesser_trochanter``, ``shaft`` (two points, the
            distal one first), ``condyles`` (two points) [mm], ``side``.

    Raises:
        GeometryError: It is no femur: no head, no lesser trochanter, no single side.
    """
    return _Finder(surface, given or {}).frame()


class _Finder:
    """Triangles of a femur by areas, centres and normals, and the landmarks they determine."""

    def __init__(self, surface: BoneSurface, given: Mapping[str, Any]) -> None:
        self.given, self.x, self.triangles = given, surface.points, surface.triangles
        a, b, c = surface.corners.transpose(1, 0, 2)
        self.normal = 0.5 * np.cross(b - a, c - a)
        self.area, self.centre = _norms(self.normal), (a + b + c) / 3
        self.surface = surface
        self.checked = GivenLandmarks(surface, dict(given))
        self._find_head(self._long_axis())
        if "shaft" in given:
            self.checked.check_shaft(self.head, self.radius, self.up)
        self.origin = self.head - SHAFT_LEVEL * self.radius * self.up
        self.depth = float(self.head @ self.up - (self.x @ self.up).min())
        for _ in range(3):
            self._find_shaft()
            self._find_trochanter()
        if "lesser_trochanter" in given:
            depths = TROCHANTER_RANGE[0] * self.radius, TROCHANTER_RANGE[1] * self.radius
            self.checked.check_trochanter(self.point, self.up, self.head, depths)
        if "condyles" in given:
            self.checked.check_condyles(self.up)
        self.below = float(self.origin @ self.up) - shaft.end_level(surface, self.up)
        self._check_shaft()
        self._check_solid()
        self.low = float((self.x @ self.up).min())
        section_depths = self.point @ self.up - self.low - 1.2 * self.radius, 0.0
        distal, middle = (
            centroid(self._section(self.point - depth * self.up))[1] for depth in section_depths
        )
        trochanter_height = float(self.origin @ self.up) - self.low
        self.has_condyles = (
            trochanter_height > CONDYLES_BELOW * self.radius
            and distal > CONDYLE_AREA_RATIO * middle
        )

    def _long_axis(self) -> Floats:
        """Unit vector along the bone (3,).

        For a short bone it is normal to the flat end of the surface.
        """
        offsets = self.centre - np.average(self.centre, axis=0, weights=self.area)
        axes = np.linalg.eigh((offsets * self.area[:, None]).T @ offsets)[1]
        length = float(np.ptp(self.x @ axes[:, 2]))
        end_normal = shaft.flat_end(self.surface) if length < LONG_SURFACE else None
        return np.asarray(axes[:, 2] if end_normal is None else end_normal)

    def frame(self) -> Frame:
        """The landmarks."""
        neck, neck_spread = self._neck()
        up, medial = self.up, unit_vectors(neck - (neck @ self.up) * self.up)
        side = self._side(np.asarray(np.cross(up, medial)))
        anterior_sign = 1.0 if side == "left" else -1.0  # of up x medial, if that is anterior
        version, version_spread = None, 0.0
        if self.has_condyles or "condyles" in self.given:
            condyle_axis = self._condyles(-anterior_sign * np.cross(up, medial))
            condyle_axis *= np.sign(condyle_axis @ medial)
            version = math.atan2(
                anterior_sign * medial @ np.cross(up, condyle_axis), medial @ condyle_axis
            )
            condyle_spread = NORMAL_QUANTILE * self.rms / (CONDYLE_DISTANCE * self.radius)
            version_spread = math.hypot(
                neck_spread / math.sqrt(1 - float(up @ neck) ** 2), condyle_spread
            )
            medial = condyle_axis
        axes = np.stack([medial, anterior_sign * np.cross(up, medial), up])
        missing_shaft = (
            max(0.0, SHAFT_RANGE[1] - self.below / self.radius)
            if "shaft" not in self.given
            else 0.0
        )
        shaft_spread = SHORT_SPREAD * missing_shaft / (SHAFT_RANGE[1] - 1.0)
        intervals = {
            "head": self.spread,
            "neck": neck_spread,
            "version": version_spread,
            "shaft": shaft_spread,
        }
        frame_parts = self.origin, axes, neck, self.trochanter
        length = float(np.ptp(self.x @ up))
        return Frame(
            self.head,
            self.radius,
            *frame_parts,
            side,
            version,
            intervals,
            length,
            -self.below,
            self.checked.names,
            tuple(self.checked.doubts),
        )

    def _samples(self) -> tuple[Floats, Floats, Floats]:
        """Centres (q, 3), averaged unit normals (q, 3) and areas (q,) of boxes of `SAMPLE_SIZE`."""
        box = np.floor((self.centre - self.centre.min(axis=0)) / SAMPLE_SIZE).astype(np.int64)
        box_of_triangle = np.unique(box, axis=0, return_inverse=True)[1].ravel()
        area = np.asarray(np.bincount(box_of_triangle, self.area), dtype=float)
        sums: list[Any] = [
            np.stack([np.bincount(box_of_triangle, vectors[:, i]) for i in range(3)], axis=1)
            for vectors in (self.area[:, None] * self.centre, self.normal)
        ]
        x, normal = sums[0] / area[:, None], sums[1]
        tree = cKDTree(x)
        normal = (
            normal + tree.sparse_distance_matrix(tree, NORMAL_SMOOTHING).tocsr().sign() @ normal
        )
        return x, normal / _norms(normal)[:, None], area

    def _find_head(self, axis: Floats) -> None:
        """Find centre, radius and spread of the head, and the proximal direction."""
        x, normal, area = self._samples()
        spheres = []
        for up in (axis, -axis):
            near_end = x @ up > (x @ up).max() - HEAD_FROM_END
            spheres.append((*_largest_sphere(x[near_end], normal[near_end], area[near_end]), up))
        covered_part, centre, radius, self.up = max(spheres, key=lambda candidate: candidate[0])
        if covered_part < LEAST_COVERED:
            fault = "has no head at either end: its surface covers at most"
            fault += f" {100 * covered_part:.0f} % of a sphere, at {mean_point_text(centre)}"
            remedy = "expected a femur with its head, in the right unit"
            raise GeometryError(f"geometry.bone: {fault}; {remedy}")
        for _ in range(4):
            offsets = x - centre
            distances = _norms(offsets)
            on_sphere = (np.abs(distances - radius) < 2 * SPHERE_DISTANCE) & (
                _row_dots(offsets, normal) > LEAST_COSINE * distances
            )
            pole = unit_vectors(area[on_sphere] @ (offsets[on_sphere] / distances[on_sphere, None]))
            offsets = self.centre - centre
            near_cap = np.flatnonzero(
                (offsets @ pole > 0) & (np.abs(_norms(offsets) - radius) < 0.25 * radius)
            )
            points, areas = self.centre[near_cap], self.area[near_cap]
            centre, radius = _fitted_sphere(points, areas, centre, radius)
        offsets, (first_axis, second_axis) = points - centre, _perpendicular_axes(pole)
        sector_angle = np.arctan2(offsets @ first_axis, offsets @ second_axis) / (2 * np.pi) + 0.5
        kept_sectors = [np.floor(HEAD_SECTORS * sector_angle) != k for k in range(HEAD_SECTORS)]
        centres = np.array(
            [
                _fitted_sphere(points[is_kept], areas[is_kept], centre, radius)[0]
                for is_kept in kept_sectors
            ]
        )
        variance = (HEAD_SECTORS - 1) * centres.var(axis=0).sum()
        self.rms = math.sqrt(float(np.average((_norms(offsets) - radius) ** 2, weights=areas)))
        self.head, self.radius, self.spread = centre, radius, NORMAL_QUANTILE * math.sqrt(variance)
        if "head_centre" in self.given:
            self.checked.check_head(centre)
            self.head, self.spread = np.array(self.given["head_centre"]), 0.0

    def _find_shaft(self) -> None:
        """Find a point of the shaft's axis and its direction, from an estimate."""
        if "shaft" in self.given:
            distal, self.point = map(np.array, self.given["shaft"])
            self.up = unit_vectors(self.point - distal)
            return
        depth_of_end = float(self.origin @ self.up) - shaft.end_level(self.surface, self.up)
        lowest_depth = min(depth_of_end, SHAFT_RANGE[1] * self.radius)
        # The lesser trochanter draws centroids aside, so that a long shaft begins farther below it.
        shaft_share = (lowest_depth / self.radius - SHORT_SHAFT_RANGE[1]) / (
            SHAFT_RANGE[1] - SHORT_SHAFT_RANGE[1]
        )
        least_depth = self.radius * (
            SHORT_SHAFT_RANGE[0] + (SHAFT_RANGE[0] - SHORT_SHAFT_RANGE[0]) * max(shaft_share, 0.0)
        )
        depths = np.linspace(min(least_depth, lowest_depth - LEAST_SHAFT), lowest_depth, 33)
        points = [self.origin - depth * self.up for depth in depths]
        plane = np.stack(_perpendicular_axes(self.up))
        centroids = np.array(
            [point + centroid(self._section(point))[0] @ plane for point in points]
        )
        self.point = centroids.mean(axis=0)
        axis = np.linalg.svd(centroids - self.point, full_matrices=False)[2][0]
        self.up = axis * np.sign(axis @ self.up)

    def _check_shaft(self) -> None:
        """Refuse a surface that ends so high that the direction of the shaft is not known."""
        least_length = SHORT_SHAFT_RANGE[1] * self.radius
        if self.below >= least_length or "shaft" in self.given:
            return
        found_above = self.below - (least_length - self._missing_length)
        is_false = self.below <= 0.0 or found_above > FALSE_TROCHANTER * self.radius
        if is_false and "lesser_trochanter" not in self.given:
            # What was found is none, since the lesser trochanter is not in the scan.
            raise self._without_trochanter(f"has 0 mm of complete shaft {BELOW}")
        shaft_length = max(self.below, 0.0)
        raise GeometryError(
            f"geometry.bone: has {shaft_length:.0f} mm of complete shaft {BELOW},"
            f" and ends {self.depth:.0f} mm below the head's centre. The direction of the shaft"
            f" needs {least_length:.0f} mm: use a scan that ends"
            f" {least_length - self.below:.0f} mm lower, or give"
            " landmarks.shaft"
        )

    @property
    def _missing_length(self) -> float:
        """Length that a scan lacks below its end if its lesser trochanter has the usual place."""
        needed_depth = (USUAL_TROCHANTER + SHORT_SHAFT_RANGE[1]) * self.radius
        return needed_depth + shaft.EDGE_ROUNDING - self.depth

    def _without_trochanter(self, fault: str) -> GeometryError:
        """Return the error on a scan that does not contain the whole lesser trochanter."""
        usual_depth, least_length = (
            USUAL_TROCHANTER * self.radius,
            SHORT_SHAFT_RANGE[1] * self.radius,
        )
        return GeometryError(
            f"geometry.bone: {fault}, and the surface ends {self.depth:.0f} mm below the head's"
            " centre."
            f" The lesser trochanter usually is about {usual_depth:.0f} mm below it, and the"
            f" direction of the shaft needs {least_length:.0f} mm of shaft below that: use a scan"
            f" that ends about {self._missing_length:.0f} mm lower, or give landmarks.shaft and"
            " landmarks.lesser_trochanter"
        )

    def _check_solid(self) -> None:
        """Refuse a surface that has the wall of the canal, as one body with the outer surface."""
        origin_height = float((self.origin - self.point) @ self.up)
        levels = [below for below in SOLID_CHECK_LEVELS if below * self.radius < self.below]
        times_around = []
        for below in levels[-2:]:
            lines = self._section(self.point + (origin_height - below * self.radius) * self.up)
            (x, y), (u, v) = lines[:, 0].T, lines[:, 1].T
            angles = np.arctan2(x * v - y * u, x * u + y * v)
            times_around.append(round(float(angles.sum()) / (2.0 * math.pi)))
        # Once around the bone, and once back around the canal.
        if times_around and not any(times_around):
            raise GeometryError(
                "geometry.bone: its shaft is hollow: the surface includes the wall of the canal."
                " Give the outer surface alone, and the canal as a separate file (geometry.canal)"
            )

    def _section(self, point: Floats) -> Floats:
        """Lines (k, 2, 2) of the section through a point across the shaft, about the point."""
        x = (self.x - point) @ np.column_stack([*_perpendicular_axes(self.up), self.up])
        return lines_at_height(x[:, :2], x[:, 2], self.triangles)

    def _find_trochanter(self) -> None:
        """Find the apex of the lesser trochanter, and the point of the axis at its level."""
        up, radius = self.up, self.radius
        if "lesser_trochanter" in self.given:
            self.trochanter = np.array(self.given["lesser_trochanter"])
        else:
            axis_at_head = self.point + ((self.head - self.point) @ up) * up
            medial = unit_vectors(self.head - axis_at_head)
            angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 22)[:, None]
            directions = np.cos(angles) * medial + np.sin(angles) * np.cross(up, medial)
            depths = np.arange(0.3 * radius, 4.2 * radius, SECTION_STEP)
            depths = depths[depths < ((axis_at_head - self.x) @ up).max() - 1.0]
            plane_directions = (directions @ np.column_stack(_perpendicular_axes(up))).T
            section_reaches = [
                (
                    self._section(axis_at_head - axis_depth * up).reshape(-1, 2) @ plane_directions
                ).max(0)
                for axis_depth in depths
            ]
            reach = gaussian_filter1d(np.array(section_reaches), 1.5 / SECTION_STEP, axis=0)
            peaks = np.zeros(reach.T.shape)
            for prominence, profile in zip(peaks, reach.T, strict=True):
                peak_rows, properties = find_peaks(profile, prominence=0.5)
                prominence[peak_rows] = properties["prominences"]
            least_depth, largest_depth = (ratio * radius for ratio in TROCHANTER_RANGE)
            peaks[:, (depths < least_depth) | (depths > largest_depth)] = 0.0
            if not peaks.any():
                location = mean_point_text(self.head)
                fault = f"no lesser trochanter was detected below the head at {location}"
                if self._missing_length > 0.0:
                    raise self._without_trochanter(fault)
                fault += f", and the surface ends {self.depth:.0f} mm below it"
                remedy = "expected a proximal femur, or landmarks.lesser_trochanter"
                raise GeometryError(f"geometry.bone: {fault}; {remedy}")
            # It stands out in several directions, a false peak beside the neck in one.
            shared_peaks = np.where(peaks > 0, uniform_filter(peaks, 5, mode="constant"), 0.0)
            best_direction, best_depth = np.unravel_index(shared_peaks.argmax(), peaks.shape)
            direction, depth = directions[best_direction], depths[best_depth]
            for _ in range(3):
                near_apex = np.abs((self.centre - axis_at_head) @ up + depth) < 0.4 * radius
                self.trochanter = self._outermost(direction, near_apex)
                offset = self.trochanter - self.point
                direction = unit_vectors(offset - (offset @ up) * up)
        self.origin = self.point + ((self.trochanter - self.point) @ up) * up

    def _outermost(self, direction: Floats, is_marked: Bools) -> Floats:
        """Mean point (3,) of the part of marked triangles that reaches farthest in a direction."""
        x = self.centre[is_marked]
        weight = self.area[is_marked] * np.exp(
            (x @ direction - (x @ direction).max()) / REACH_DECAY
        )
        return np.asarray(weight @ x / weight.sum())

    def _neck(self) -> tuple[Floats, float]:
        """Unit vector along the neck to the head, and its spread [rad]."""
        head, radius, up = self.head, self.radius, self.up
        near_head = (_norms(self.x - head) < 3.2 * radius)[self.triangles].all(axis=1)
        used_rows, triangles = np.unique(self.triangles[near_head], return_inverse=True)
        x, triangles = self.x[used_rows], triangles.reshape(-1, 3)
        angles = 2 * np.pi * np.arange(72) / 72
        rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        neck_estimate = unit_vectors(head - (self.origin + 0.6 * radius * up))
        first_axis, second_axis = _perpendicular_axes(neck_estimate, up)

        def cut(parameters: Floats, offset: float) -> tuple[float, Floats]:
            """Area and centroid of a section."""
            axis = unit_vectors(
                neck_estimate + parameters[0] * first_axis + parameters[1] * second_axis
            )
            centre = head - (parameters[2] * radius + offset) * axis
            plane = np.stack(_perpendicular_axes(axis, up))
            for _ in range(2):
                section_x = (x - centre) @ np.vstack([plane, axis]).T
                radii, _ = exits(
                    lines_at_height(section_x[:, :2], section_x[:, 2], triangles), angles
                )
                centre = centre + (radii**3 / (1.5 * (radii**2).sum())) @ rays @ plane
            return math.pi * float((radii**2).mean()), centre

        start_parameters = np.array([0.0, 0.0, 0.75])
        simplex = start_parameters + np.vstack([np.zeros(3), np.diag([0.15, 0.15, 0.1])])
        options = {"xatol": 3e-4, "fatol": 1e-3, "initial_simplex": simplex}
        optimum = minimize(
            lambda parameters: np.mean([cut(parameters, offset)[0] for offset in NECK_OFFSETS]),
            start_parameters,
            method="Nelder-Mead",
            options=options,
        ).x
        neck_vector = head - np.mean([cut(optimum, offset)[1] for offset in NECK_OFFSETS], axis=0)
        spread = math.hypot(self.spread, 0.75 * self.rms) / float(np.linalg.norm(neck_vector))
        return unit_vectors(neck_vector), spread

    def _side(self, anterior_of_left: Floats) -> str:
        """The side; ``anterior_of_left`` is anterior of a left femur (3,).

        The lesser trochanter and the condyles are posterior.
        """
        posterior_offset = -float((self.trochanter - self.origin) @ anterior_of_left) / self.radius
        if self.has_condyles:
            distal = self.centre @ self.up < self.low + 1.5 * self.radius
            offsets = (self.centre[distal] - self.origin) @ anterior_of_left
            posterior_offset -= float(np.average(offsets, weights=self.area[distal])) / self.radius
        side, given_side = "left" if posterior_offset > 0 else "right", self.given.get("side")
        if abs(posterior_offset) < 0.15:
            fault = (
                "left or right cannot be determined: the lesser trochanter is not behind the neck"
            )
            if not given_side:
                raise GeometryError(f"geometry.bone: {fault}; give geometry.bone.side")
        elif given_side not in (None, side):
            distance = abs(float((self.trochanter - self.origin) @ anterior_of_left))
            fault = f"the lesser trochanter is {distance:.0f} mm behind the axis of a {side} femur"
            raise GeometryError(
                f"geometry.bone.side: {fault}, so that this is no {given_side} one; the side (or"
                " the name that gives it) is wrong, or the file is mirrored"
            )
        return str(given_side or side)

    def _condyles(self, posterior: Floats) -> Floats:
        """Direction of the line between the most posterior points of the condyles (3,)."""
        up, distal = self.up, self.centre @ self.up < self.low + CONDYLE_HEIGHT * self.radius
        for _ in range(5):
            transverse = np.cross(posterior, up)
            transverse_positions = self.centre @ transverse
            middle = 0.5 * (transverse_positions[distal].min() + transverse_positions[distal].max())
            condyle_points = [
                self._outermost(posterior, distal & (side * (transverse_positions - middle) > 0))
                for side in (1, -1)
            ]
            line = np.subtract(*self.given.get("condyles", condyle_points))
            line = unit_vectors(line - (line @ up) * up)
            posterior = np.cross(up, line) * np.sign(np.cross(up, line) @ posterior)
        return line


def _largest_sphere(x: Floats, normal: Floats, area: Floats) -> tuple[float, Floats, float]:
    """Covered part, centre and radius of the sphere that covers most of itself."""
    pairs = np.random.default_rng(1).integers(len(x), size=(2, SAMPLE_PAIRS))
    point_differences, normal_differences = (v[pairs[0]] - v[pairs[1]] for v in (x, normal))
    radii = _row_dots(point_differences, normal_differences) / np.maximum(
        _row_dots(normal_differences, normal_differences), 1e-12
    )
    is_valid = (
        (_row_dots(normal_differences, normal_differences) > 0.05)
        & (radii > HEAD_RADII[0])
        & (radii < HEAD_RADII[1])
    )
    spheres = [(0.0, x[0], 1.0)]
    for row, radius in zip(pairs[0][is_valid], radii[is_valid], strict=True):
        centre = x[row] - radius * normal[row]
        offsets = x - centre
        near_rows = np.flatnonzero(
            np.abs(_row_dots(offsets, offsets) - radius * radius) < 2 * radius * SPHERE_DISTANCE
        )
        sphere_rows = near_rows[
            _row_dots(offsets[near_rows], normal[near_rows]) > LEAST_COSINE * radius
        ]
        spheres.append((area[sphere_rows].sum() / (4 * math.pi * radius * radius), centre, radius))
    return max(spheres, key=lambda sphere: sphere[0])


def _fitted_sphere(x: Floats, area: Floats, centre: Floats, radius: float) -> tuple[Floats, float]:
    """Sphere through points (n, 3) by their areas, outliers counting less."""
    weights = np.sqrt(area / area.mean())

    def residuals(sphere: Floats) -> Floats:
        return np.asarray(weights * (_norms(x - sphere[:3]) - sphere[3]))

    def jacobian(sphere: Floats) -> Floats:
        offsets = sphere[:3] - x
        return np.column_stack([weights[:, None] * offsets / _norms(offsets)[:, None], -weights])

    start_values = np.r_[centre, radius]
    solution = least_squares(
        residuals, start_values, jacobian, loss="soft_l1", f_scale=OUTLIER_DISTANCE
    ).x
    return solution[:3], float(solution[3])


def _perpendicular_axes(axis: Floats, hint: Floats | None = None) -> tuple[Floats, Floats]:
    """Two unit vectors that are right-handed with an axis (3,), the first across a hint."""
    first_axis = unit_vectors(
        np.cross(np.eye(3)[np.abs(axis).argmin()] if hint is None else hint, axis)
    )
    return first_axis, np.asarray(np.cross(axis, first_axis))


def _row_dots(a: Floats, b: Floats) -> Floats:
    return np.einsum("ni,ni->n", a, b)


def _norms(x: Floats) -> Floats:
    return np.sqrt(_row_dots(x, x))
