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

from app.foundation.arrays import Bools, Floats
from app.foundation.errors import GeometryError
from app.patient import shaft
from app.patient.bone_surface import BoneSurface, place
from meshes.femur_stem import unit
from meshes.plane_sections import centroid, exits, section

RADII = (14.0, 36.0)  # mm: of heads
END = 90.0  # mm from an end of the bone within which its head is
SAMPLES = 2.5  # mm between samples
PAIRS = 1500  # pairs of samples that are tried
SMOOTH = 4.0  # mm over which normals are averaged
NEAR = 1.0  # mm from a sphere within which points belong to it
ALONG = math.cos(math.radians(18.0))  # cosine of a normal to the radius of its sphere, at least
COVERED = 0.33  # of a sphere, at least, by a head
ROBUST = 0.5  # mm: residuals of the head beyond it count less
STEP = 1.5  # mm between sections that are searched for the lesser trochanter
REACH = 0.7  # mm: decay of the weights of an outermost place
BESIDE = (-4.5, -1.5, 1.5, 4.5)  # mm: sections of the neck beside the least one, averaged
SECTORS = 12  # of the head, one left out at a time
# Usual values; others have a note.
USUAL_RADII = (18.0, 30.0)  # radius of the head [mm]
USUAL_NECKS = (110.0, 140.0)  # neck-shaft angle [deg]
USUAL_LENGTHS = (15.0, 25.0)  # length of a femur with condyles in radii of its head
SURE = 1.65  # standard deviations that hold 90 %
LONG = 150.0  # mm that a surface is long whose principal axis is the shaft's
# In radii of the head:
SHAFT = (0.8, 2.7)  # below the lesser trochanter, where the shaft's axis is
SHORT_SHAFT = (0.5, 0.75)  # the same where the surface ends there, at least
LEAST_SHAFT = 5.0  # mm of sections that have an axis
SHORT_SPREAD = math.radians(6.5)  # that holds 90 % of the shaft's axis if it is 1 radius long
AXIS_INSIDE = (1.0, 1.4, 1.8, 2.2, 2.6)  # below the lesser trochanter, levels of the shaft
CONDYLES_BELOW = 4.0  # below the lesser trochanter, at least, condyles are
TROCHANTER = (1.3, 3.4)  # below the head's centre, where the lesser trochanter is
CONDYLES = 3.0  # above the distal end
APART = 2.1  # between the condyles
WIDER = 1.8  # of the shaft's section: that of condyles, at least


@dataclass(frozen=True)
class Frame:
    """Landmarks of a femur and the axes of its model, medial, anterior and proximal.

    Attributes:
        head: Centre of the head (3,) [mm], in the surface's axes as all below.
        radius: Of the head [mm].
        origin: Point of the shaft's axis at the level of the lesser trochanter (3,) [mm].
        axes: Unit vectors medial, anterior, proximal (3, 3), left-handed for a right femur.
        neck: Unit vector along the neck to the head (3,).
        trochanter: Apex of the lesser trochanter (3,) [mm].
        side: ``left`` or ``right``.
        version: Angle of the neck to anterior of the condyles [rad]; None without condyles: then
            medial is along the neck.
        spread: That holds 90 %, of head [mm], neck, version and shaft [rad].
        length: Of the surface along the shaft [mm].
        end: Level above which the surface is whole, in the model's axes [mm].
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

    def to_model(self, x: Floats) -> Floats:
        """Points (..., 3) in the model's axes, a right femur mirrored."""
        return np.asarray((x - self.origin) @ self.axes.T)

    @property
    def azimuth(self) -> float:
        """Angle of the neck to anterior of medial, about the shaft [rad]."""
        x, y, _ = self.axes @ self.neck
        return math.atan2(y, x)

    def surface(self, surface: BoneSurface) -> BoneSurface:
        """A surface in the model's axes, still outward."""
        way = slice(None, None, -1 if np.linalg.det(self.axes) < 0 else 1)
        x, triangles = self.to_model(surface.points), surface.triangles[:, way]
        return replace(surface, points=x, triangles=triangles)

    @property
    def details(self) -> dict[str, str]:
        """Landmarks in words, with the intervals that hold 90 %."""
        turn, s = math.degrees, self.spread
        places = ["({:.1f}, {:.1f}, {:.1f}) mm".format(*x) for x in (self.head, self.trochanter)]
        version = "unknown without condyles: medial is along the neck"
        if self.version is not None:
            version = f"{turn(self.version):.1f} deg ± {turn(s['version']):.1f}"
        angle = turn(math.acos(-float(self.axes[2] @ self.neck)))
        return {
            "side": self.side + (", mirrored" if self.side == "right" else ""),
            "head": f"{places[0]} ± {s['head']:.1f}, radius {self.radius:.1f} mm",
            "lesser trochanter": places[1],
            "neck-shaft angle": f"{angle:.1f} deg ± {turn(math.hypot(s['neck'], s['shaft'])):.1f}",
            "version": version,
        } | self._short_shaft

    @property
    def _short_shaft(self) -> dict[str, str]:
        """Interval of the shaft's axis, if it is known by a short part of the shaft."""
        if not self.spread["shaft"]:
            return {}
        text = f"± {math.degrees(self.spread['shaft']):.0f} deg, by the {-self.end:.0f} mm of shaft"
        return {"axis of the shaft": f"{text} below the lesser trochanter"}

    def doubts(self, surface: BoneSurface) -> list[str]:
        """Notes on a rare size or shape of the femur, and on an open proximal end.

        Args:
            surface: Its surface, whose `rim` and `borders` are in the axes of the file.
        """
        notes = list(surface.doubts)
        low, high = USUAL_RADII
        if not low <= self.radius <= high:
            text = f"the head's radius is {self.radius:.1f} mm; expected {low:g} to {high:g} mm"
            notes.append(f"{text}. Is the unit or scale wrong?")
        angle = math.degrees(math.acos(-float(self.axes[2] @ self.neck)))
        low, high = USUAL_NECKS
        if not low <= angle <= high:
            text = f"the neck-shaft angle is {angle:.0f} deg; expected {low:g} to {high:g} deg"
            notes.append(f"{text}. Is the bone stretched along an axis?")
        low, high = (ratio * self.radius for ratio in USUAL_LENGTHS)
        if self.version is not None and not low <= self.length <= high:
            text = f"it is {self.length:.0f} mm long with its condyles; expected {low:.0f} to"
            notes.append(f"{text} {high:.0f} mm for its head. Is it stretched along an axis?")
        if len(surface.rim):
            proximal = self.to_model(surface.rim)[:, 2] > 0
            if proximal.any():
                text = f"its surface is open at the proximal end, at {place(surface.rim[proximal])}"
                notes.append(f"{text} ({int(proximal.sum())} edges); are triangles missing there?")
        heights = [float(self.to_model(border)[:, 2].mean()) for border in surface.borders]
        for border, height in zip(surface.borders, heights, strict=True):
            # The lowest one is the end of the scan, in the shaft.
            if height > min(0.0, min(heights)):
                text = f"the bone is cut by the border of the image at {place(border)}"
                notes.append(f"{text} ({len(border):,} voxels); is a part of it missing?")
        return notes


def find(surface: BoneSurface, given: Mapping[str, Any] | None = None) -> Frame:
    """Find the landmarks of a femur; ``given`` has those that are known.

    Args:
        surface: Its surface, of the whole bone or of its proximal part.
        given: Of ``head_centre``, ``lesser_trochanter``, ``shaft`` (two points, the distal one
            first), ``condyles`` (two points) [mm], ``side``.

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
        self.area, self.centre = _far(self.normal), (a + b + c) / 3
        self.surface = surface
        self._find_head(self._long_axis())
        self.origin = self.head - 1.75 * self.radius * self.up
        self.depth = float(self.head @ self.up - (self.x @ self.up).min())
        for _ in range(3):
            self._find_shaft()
            self._find_trochanter()
        self.below = float(self.origin @ self.up) - shaft.end_level(surface, self.up)
        self._check_shaft()
        self._check_solid()
        self.low = float((self.x @ self.up).min())
        levels = self.point @ self.up - self.low - 1.2 * self.radius, 0.0
        distal, middle = (centroid(self._section(self.point - z * self.up))[1] for z in levels)
        below = float(self.origin @ self.up) - self.low
        self.has_condyles = below > CONDYLES_BELOW * self.radius and distal > WIDER * middle

    def _long_axis(self) -> Floats:
        """Unit vector along the bone (3,), of a short one across the flat end of its surface."""
        off = self.centre - np.average(self.centre, axis=0, weights=self.area)
        axes = np.linalg.eigh((off * self.area[:, None]).T @ off)[1]
        length = float(np.ptp(self.x @ axes[:, 2]))
        end = shaft.flat_end(self.surface) if length < LONG else None
        return np.asarray(axes[:, 2] if end is None else end)

    def frame(self) -> Frame:
        """The landmarks."""
        neck, spread = self._neck()
        up, medial = self.up, unit(neck - (neck @ self.up) * self.up)
        side = self._side(np.asarray(np.cross(up, medial)))
        way = 1.0 if side == "left" else -1.0  # of up x medial, if that is anterior
        version, turn = None, 0.0
        if self.has_condyles or "condyles" in self.given:
            across = self._condyles(-way * np.cross(up, medial))
            across *= np.sign(across @ medial)
            version = math.atan2(way * medial @ np.cross(up, across), medial @ across)
            condyles = SURE * self.rms / (APART * self.radius)
            turn = math.hypot(spread / math.sqrt(1 - float(up @ neck) ** 2), condyles)
            medial = across
        axes = np.stack([medial, way * np.cross(up, medial), up])
        lacking = (
            max(0.0, SHAFT[1] - self.below / self.radius) if "shaft" not in self.given else 0.0
        )
        lean = SHORT_SPREAD * lacking / (SHAFT[1] - 1.0)
        intervals = {"head": self.spread, "neck": spread, "version": turn, "shaft": lean}
        places = self.origin, axes, neck, self.trochanter
        length = float(np.ptp(self.x @ up))
        return Frame(self.head, self.radius, *places, side, version, intervals, length, -self.below)

    def _samples(self) -> tuple[Floats, Floats, Floats]:
        """Centres (q, 3), averaged unit normals (q, 3) and areas (q,) of boxes of `SAMPLES`."""
        box = np.floor((self.centre - self.centre.min(axis=0)) / SAMPLES).astype(np.int64)
        of = np.unique(box, axis=0, return_inverse=True)[1].ravel()
        area = np.asarray(np.bincount(of, self.area), dtype=float)
        sums: list[Any] = [
            np.stack([np.bincount(of, v[:, i]) for i in range(3)], axis=1)
            for v in (self.area[:, None] * self.centre, self.normal)
        ]
        x, normal = sums[0] / area[:, None], sums[1]
        tree = cKDTree(x)
        normal = normal + tree.sparse_distance_matrix(tree, SMOOTH).tocsr().sign() @ normal
        return x, normal / _far(normal)[:, None], area

    def _find_head(self, axis: Floats) -> None:
        """Centre, radius and spread of the head, and the way to proximal."""
        x, normal, area = self._samples()
        spheres = []
        for up in (axis, -axis):
            end = x @ up > (x @ up).max() - END
            spheres.append((*_sphere(x[end], normal[end], area[end]), up))
        covered, centre, radius, self.up = max(spheres, key=lambda f: f[0])
        if covered < COVERED:
            text = "has no head at either end: its surface covers at most"
            text += f" {100 * covered:.0f} % of a sphere, at {place(centre)}"
            remedy = "expected a femur with its head, in the right unit"
            raise GeometryError(f"geometry.bone: {text}; {remedy}")
        for _ in range(4):
            out = x - centre
            far = _far(out)
            on = (np.abs(far - radius) < 2 * NEAR) & (_dot(out, normal) > ALONG * far)
            pole = unit(area[on] @ (out[on] / far[on, None]))
            out = self.centre - centre
            cap = np.flatnonzero((out @ pole > 0) & (np.abs(_far(out) - radius) < 0.25 * radius))
            points, size = self.centre[cap], self.area[cap]
            centre, radius = _fit(points, size, centre, radius)
        out, (one, other) = points - centre, _across(pole)
        turn = np.arctan2(out @ one, out @ other) / (2 * np.pi) + 0.5
        parts = [np.floor(SECTORS * turn) != k for k in range(SECTORS)]
        left = np.array([_fit(points[p], size[p], centre, radius)[0] for p in parts])
        variance = (SECTORS - 1) * left.var(axis=0).sum()
        self.rms = math.sqrt(float(np.average((_far(out) - radius) ** 2, weights=size)))
        self.head, self.radius, self.spread = centre, radius, SURE * math.sqrt(variance)
        if "head_centre" in self.given:
            self.head, self.spread = np.array(self.given["head_centre"]), 0.0

    def _find_shaft(self) -> None:
        """A point of the shaft's axis and its direction, from an estimate."""
        if "shaft" in self.given:
            distal, self.point = map(np.array, self.given["shaft"])
            self.up = unit(self.point - distal)
            return
        below = float(self.origin @ self.up) - shaft.end_level(self.surface, self.up)
        low = min(below, SHAFT[1] * self.radius)
        # The lesser trochanter draws centroids aside, so that a long shaft begins farther below it.
        part = (low / self.radius - SHORT_SHAFT[1]) / (SHAFT[1] - SHORT_SHAFT[1])
        high = self.radius * (SHORT_SHAFT[0] + (SHAFT[0] - SHORT_SHAFT[0]) * max(part, 0.0))
        depths = np.linspace(min(high, low - LEAST_SHAFT), low, 33)
        points = [self.origin - depth * self.up for depth in depths]
        plane = np.stack(_across(self.up))
        middles = np.array([p + centroid(self._section(p))[0] @ plane for p in points])
        self.point = middles.mean(axis=0)
        axis = np.linalg.svd(middles - self.point, full_matrices=False)[2][0]
        self.up = axis * np.sign(axis @ self.up)

    def _check_shaft(self) -> None:
        """Refuse a surface that ends so high that the direction of the shaft is not known."""
        least = SHORT_SHAFT[1] * self.radius
        if self.below < least and "shaft" not in self.given:
            below = max(self.below, 0.0)
            raise GeometryError(
                f"geometry.bone: has {below:.0f} mm of complete shaft below the lesser trochanter,"
                f" and ends {self.depth:.0f} mm below the head's centre. The direction of the shaft"
                f" needs {least:.0f} mm: use a scan that ends {least - below:.0f} mm lower, or give"
                " landmarks.shaft"
            )

    def _check_solid(self) -> None:
        """Refuse a surface that has the wall of the canal, as one body with the outer surface."""
        at = float((self.origin - self.point) @ self.up)
        levels = [below for below in AXIS_INSIDE if below * self.radius < self.below]
        times_around = []
        for below in levels[-2:]:
            lines = self._section(self.point + (at - below * self.radius) * self.up)
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
        x = (self.x - point) @ np.column_stack([*_across(self.up), self.up])
        return section(x[:, :2], x[:, 2], self.triangles)

    def _find_trochanter(self) -> None:
        """The apex of the lesser trochanter, and the point of the axis at its level."""
        up, radius = self.up, self.radius
        if "lesser_trochanter" in self.given:
            self.trochanter = np.array(self.given["lesser_trochanter"])
        else:
            top = self.point + ((self.head - self.point) @ up) * up
            medial = unit(self.head - top)
            turns = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 22)[:, None]
            ways = np.cos(turns) * medial + np.sin(turns) * np.cross(up, medial)
            depths = np.arange(0.3 * radius, 4.2 * radius, STEP)
            depths = depths[depths < ((top - self.x) @ up).max() - 1.0]
            flat = (ways @ np.column_stack(_across(up))).T
            rows = [(self._section(top - d * up).reshape(-1, 2) @ flat).max(0) for d in depths]
            reach = gaussian_filter1d(np.array(rows), 1.5 / STEP, axis=0)
            peaks = np.zeros(reach.T.shape)
            for prominence, profile in zip(peaks, reach.T, strict=True):
                at, properties = find_peaks(profile, prominence=0.5)
                prominence[at] = properties["prominences"]
            low, high = (part * radius for part in TROCHANTER)
            peaks[:, (depths < low) | (depths > high)] = 0.0
            if not peaks.any():
                text = f"no lesser trochanter was detected below the head at {place(self.head)}"
                text += f", and the surface ends {self.depth:.0f} mm below it"
                remedy = "expected a proximal femur, or landmarks.lesser_trochanter"
                raise GeometryError(f"geometry.bone: {text}; {remedy}")
            # It stands out in several directions, a false peak beside the neck in one.
            shared = np.where(peaks > 0, uniform_filter(peaks, 5, mode="constant"), 0.0)
            best, at = np.unravel_index(shared.argmax(), peaks.shape)
            way, depth = ways[best], depths[at]
            for _ in range(3):
                near = np.abs((self.centre - top) @ up + depth) < 0.4 * radius
                self.trochanter = self._outermost(way, near)
                out = self.trochanter - self.point
                way = unit(out - (out @ up) * up)
        self.origin = self.point + ((self.trochanter - self.point) @ up) * up

    def _outermost(self, way: Floats, within: Bools) -> Floats:
        """Mean place (3,) of what reaches farthest in a direction, of marked triangles."""
        x = self.centre[within]
        weight = self.area[within] * np.exp((x @ way - (x @ way).max()) / REACH)
        return np.asarray(weight @ x / weight.sum())

    def _neck(self) -> tuple[Floats, float]:
        """Unit vector along the neck to the head, and its spread [rad]."""
        head, radius, up = self.head, self.radius, self.up
        near = (_far(self.x - head) < 3.2 * radius)[self.triangles].all(axis=1)
        used, triangles = np.unique(self.triangles[near], return_inverse=True)
        x, triangles = self.x[used], triangles.reshape(-1, 3)
        angles = 2 * np.pi * np.arange(72) / 72
        rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        toward = unit(head - (self.origin + 0.6 * radius * up))
        one, other = _across(toward, up)

        def cut(p: Floats, beside: float) -> tuple[float, Floats]:
            """Area and centroid of a section."""
            axis = unit(toward + p[0] * one + p[1] * other)
            centre, plane = head - (p[2] * radius + beside) * axis, np.stack(_across(axis, up))
            for _ in range(2):
                y = (x - centre) @ np.vstack([plane, axis]).T
                r, _ = exits(section(y[:, :2], y[:, 2], triangles), angles)
                centre = centre + (r**3 / (1.5 * (r**2).sum())) @ rays @ plane
            return math.pi * float((r**2).mean()), centre

        start = np.array([0.0, 0.0, 0.75])
        simplex = start + np.vstack([np.zeros(3), np.diag([0.15, 0.15, 0.1])])
        options = {"xatol": 3e-4, "fatol": 1e-3, "initial_simplex": simplex}
        least = minimize(
            lambda p: np.mean([cut(p, beside)[0] for beside in BESIDE]),
            start,
            method="Nelder-Mead",
            options=options,
        ).x
        out = head - np.mean([cut(least, beside)[1] for beside in BESIDE], axis=0)
        spread = math.hypot(self.spread, 0.75 * self.rms) / float(np.linalg.norm(out))
        return unit(out), spread

    def _side(self, left: Floats) -> str:
        """The side; ``left`` is anterior of a left femur (3,).

        The lesser trochanter and the condyles are posterior.
        """
        behind = -float((self.trochanter - self.origin) @ left) / self.radius
        if self.has_condyles:
            distal = self.centre @ self.up < self.low + 1.5 * self.radius
            out = (self.centre[distal] - self.origin) @ left
            behind -= float(np.average(out, weights=self.area[distal])) / self.radius
        side, given = "left" if behind > 0 else "right", self.given.get("side")
        if abs(behind) < 0.15:
            text = (
                "left or right cannot be determined: the lesser trochanter is not behind the neck"
            )
            if not given:
                raise GeometryError(f"geometry.bone: {text}; give geometry.bone.side")
        elif given not in (None, side):
            off = abs(float((self.trochanter - self.origin) @ left))
            text = f"the lesser trochanter is {off:.0f} mm behind the axis of a {side} femur"
            raise GeometryError(f"geometry.bone.side: {text}; leave side out, or mirror the file")
        return str(given or side)

    def _condyles(self, back: Floats) -> Floats:
        """Direction of the line between the most posterior points of the condyles (3,)."""
        up, distal = self.up, self.centre @ self.up < self.low + CONDYLES * self.radius
        for _ in range(5):
            across = np.cross(back, up)
            at = self.centre @ across
            middle = 0.5 * (at[distal].min() + at[distal].max())
            ends = [self._outermost(back, distal & (s * (at - middle) > 0)) for s in (1, -1)]
            line = np.subtract(*self.given.get("condyles", ends))
            line = unit(line - (line @ up) * up)
            back = np.cross(up, line) * np.sign(np.cross(up, line) @ back)
        return line


def _sphere(x: Floats, normal: Floats, area: Floats) -> tuple[float, Floats, float]:
    """Covered part, centre and radius of the sphere that covers most of itself."""
    pairs = np.random.default_rng(1).integers(len(x), size=(2, PAIRS))
    apart, turned = (v[pairs[0]] - v[pairs[1]] for v in (x, normal))
    radii = _dot(apart, turned) / np.maximum(_dot(turned, turned), 1e-12)
    good = (_dot(turned, turned) > 0.05) & (radii > RADII[0]) & (radii < RADII[1])
    spheres = [(0.0, x[0], 1.0)]
    for k, r in zip(pairs[0][good], radii[good], strict=True):
        centre = x[k] - r * normal[k]
        out = x - centre
        near = np.flatnonzero(np.abs(_dot(out, out) - r * r) < 2 * r * NEAR)
        on = near[_dot(out[near], normal[near]) > ALONG * r]
        spheres.append((area[on].sum() / (4 * math.pi * r * r), centre, r))
    return max(spheres, key=lambda f: f[0])


def _fit(x: Floats, area: Floats, centre: Floats, radius: float) -> tuple[Floats, float]:
    """Sphere through points (n, 3) by their areas, outliers counting less."""
    root = np.sqrt(area / area.mean())

    def off(p: Floats) -> Floats:
        return np.asarray(root * (_far(x - p[:3]) - p[3]))

    def slope(p: Floats) -> Floats:
        out = p[:3] - x
        return np.column_stack([root[:, None] * out / _far(out)[:, None], -root])

    start = np.r_[centre, radius]
    solution = least_squares(off, start, slope, loss="soft_l1", f_scale=ROBUST).x
    return solution[:3], float(solution[3])


def _across(axis: Floats, hint: Floats | None = None) -> tuple[Floats, Floats]:
    """Two unit vectors that are right-handed with an axis (3,), the first across a hint."""
    one = unit(np.cross(np.eye(3)[np.abs(axis).argmin()] if hint is None else hint, axis))
    return one, np.asarray(np.cross(axis, one))


def _dot(a: Floats, b: Floats) -> Floats:
    return np.einsum("ni,ni->n", a, b)


def _far(x: Floats) -> Floats:
    return np.sqrt(_dot(x, x))
