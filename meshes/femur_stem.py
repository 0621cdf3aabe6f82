"""The implant of the parametric femur: a straight, tapered stem, its offset, its neck.

A section of the shaft is a rectangle with rounded corners. Its half-widths and its corner radius
are linear in z, so that the shaft is a ruled loft between two sections. If the shoulder is above
the neck cut, the shaft continues up to the shoulder. A loft of straight lines joins its last
section to a circular section of the neck. A cone joins this section to the trunnion. A fillet
rounds the transition.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from app.foundation.arrays import FloatOrFloats, Floats, unit_vectors
from app.foundation.errors import GeometryError
from app.foundation.implant import Implant
from meshes.data import StepKeys

if TYPE_CHECKING:
    from app.case.shapes import GradedThickness

# Mesh lines per length on a corner's arc, relative to a flat side.
ARC_WEIGHT = 1.6
# Largest ratio of a piece's fraction of the lines of a quarter to its fraction of the length.
MOST_LINES = 3.0
# Least number of lines around with which each piece has an integer number of lines.
LEAST_WHOLE = 12
# A rounded tip becomes a bowl where its ellipsoid has turned by 30 degrees.
RIM_COSINE = math.sqrt(0.75)  # cosine of that angle
RIM_SINE = 0.5  # sine of that angle
BOWL_DEPTH = 0.3  # depth of the bowl over that of the ellipsoid
# Range of the first round section of the neck, as a fraction of the neck's length.
BLEND_RANGE = (0.38, 0.8)
# Distance of the first round section from the cut [mm].
NECK_CLEARANCE = 2.0
# Least slope of the sections at a shoulder that stands out of the bone.
SHOULDER_SLOPE = 0.8
# Largest fraction of the straight lines before and after the fillet that it may use.
ARM_SHARE = 0.4
# Least length of the fillet before and after its bend [mm].
LEAST_ARM = 0.5
# Largest height of the shoulder above the cut at which it does not count as standing out [mm].
SHOULDER_RISE = 6.0


# Thickness of a mantle at angles [rad] and levels [mm] (n,) [mm].
Thickness = Callable[[Floats, Floats], Floats]


def thickness(given: float | GradedThickness, low: float, top: float) -> Thickness:
    """Thickness of a mantle at angles and levels, given from the tip's level to the cut's [mm]."""
    if isinstance(given, float):
        return lambda theta, z: np.full(np.shape(z), given)
    (fractions, means), (turns, ratios) = (np.transpose(table) for table in given.tables)

    def interpolated(theta: Floats, z: Floats) -> Floats:
        turn = turns[0] + np.mod(np.asarray(theta) / (2 * np.pi) - turns[0], 1.0)
        side = np.interp(turn, turns, np.arange(len(turns)))
        wave = np.floor(side) + 0.5 * (1 - np.cos(np.pi * (side % 1)))
        mean = np.interp((z - low) / (top - low), fractions, means)
        return np.asarray(mean * np.interp(wave, np.arange(len(turns)), ratios))

    return interpolated


def lines_per_piece(lengths: Floats, lines: int) -> Floats:
    """Numbers of lines (k,) on pieces of lengths (k,), one at least: the longest edge is least."""
    counts = np.ones(len(lengths))
    while counts.sum() < lines:
        counts[np.argmax(lengths / counts)] += 1
    return counts


def capped_shares(shares: Floats, weights: Floats) -> Floats:
    """Shares (k, ...) of at most `MOST_LINES` times their weights (k, ...); both sum to 1."""
    capped = np.minimum(shares, MOST_LINES * weights)
    room = MOST_LINES * weights - capped
    return np.asarray(capped + (1.0 - capped.sum(axis=0)) * room / room.sum(axis=0))


@dataclass(frozen=True)
class StemShaft:
    """Shaft of a stem: tapered rounded rectangles. Sizes are values at z = 0 plus slopes times z.

    Attributes:
        half: Values at z = 0 of half-width (x), half-depth (y) and corner radius, each a number or
            one for each point (n,) [mm].
        slope: Their slopes [-].
        lean: Slope of the planes of `point` along y over that along x.
        shares: Parts of a quarter's lines on its half side, its corner and its half front.
    """

    half: tuple[FloatOrFloats, FloatOrFloats, FloatOrFloats]
    slope: tuple[float, float, float]
    lean: float = 0.0
    shares: tuple[float, float, float] = (0.25, 0.5, 0.25)

    def section(self, z: FloatOrFloats) -> tuple[FloatOrFloats, FloatOrFloats, FloatOrFloats]:
        """Half-width, half-depth and corner radius at z [mm]."""
        a, b, r = (v + s * z for v, s in zip(self.half, self.slope, strict=True))
        return a, b, r

    def _weights(self, z: FloatOrFloats) -> Floats:
        """Lengths of half a side, a corner, which counts more, and half a front, (3, ...) [mm]."""
        a, b, r = self.section(np.asarray(z))
        return np.stack([b - r, ARC_WEIGHT * 0.5 * np.pi * r, a - r])

    def divided(self, z: float, around: int) -> StemShaft:
        """Return the shaft with shares of its section at z [mm] for a number of lines around.

        For multiples of 4 each piece has whole lines, so that lines are where arcs end.
        """
        weights = self._weights(z)
        if around % 4 == 0 and around >= LEAST_WHOLE:
            weights = lines_per_piece(weights, around // 4)
        side, corner, front = map(float, weights / weights.sum())
        return replace(self, shares=(side, corner, front))

    def _shares(self, z: FloatOrFloats) -> Floats:
        """Shares at levels z (3, ...).

        They are the same at all levels, so that lines stay at the ends of arcs. Only pieces that
        are too short for their lines have fewer, such as the flats of a round end.
        """
        weights = self._weights(z)
        shares = np.reshape(self.shares, (3,) + (1,) * (weights.ndim - 1))
        return capped_shares(shares, weights / weights.sum(axis=0))

    def radius(self, theta: Floats, z: Floats) -> Floats:
        """Distance from the z axis to the section's outline in the direction theta [mm]."""
        a, b, r = self.section(z)
        c, s = np.abs(np.cos(theta)), np.abs(np.sin(theta))
        with np.errstate(divide="ignore"):
            flat_radius = np.minimum(a / c, b / s)
        # The ray meets the corner's circle, centre (a - r, b - r), when the flat point is past it.
        along = (a - r) * c + (b - r) * s
        across = (a - r) * s - (b - r) * c
        corner = along + np.sqrt(np.maximum(r**2 - across**2, 0.0))
        is_rounded = (flat_radius * c > a - r) & (flat_radius * s > b - r)
        return np.where(is_rounded, corner, flat_radius)

    def point(self, phi: Floats, zeta: FloatOrFloats, slope: FloatOrFloats) -> Floats:
        """Points of the outline in the planes z = zeta - slope (x + lean y) (n, 3) [mm].

        Args:
            phi: Angle in turns from +x towards +y (n,); whole quarters are on the axes.
            zeta: Height of the planes at the z axis [mm], shape (n,) or ().
            slope: Slopes of the planes.
        """
        quarter = np.floor(4 * phi).astype(int) % 4
        quarter_fraction = 4 * phi - np.floor(4 * phi)
        quarter_fraction = np.where(quarter % 2 == 1, 1 - quarter_fraction, quarter_fraction)
        side, corner, front = self._shares(zeta)
        side_fraction = np.clip(quarter_fraction / side, 0.0, 1.0)
        angle = 0.5 * np.pi * np.clip((quarter_fraction - side) / corner, 0.0, 1.0)
        front_fraction = np.clip((quarter_fraction - side - corner) / front, 0.0, 1.0)
        # Sizes of the section at z are a = a0 + a1 z, b = b0 + b1 z and r = r0 + r1 z. The point is
        #   x = flat (a - r) + c r = x0 + x1 z,  y = side (b - r) + s r,  z = zeta - slope x.
        # The first and the last equation give x.
        c, s = np.cos(angle), np.sin(angle)
        (a0, b0, r0), (a1, b1, r1) = self.half, self.slope
        sign = np.where((quarter == 1) | (quarter == 2), -1.0, 1.0)
        flat = 1 - front_fraction
        x0 = sign * (flat * (a0 - r0) + c * r0)
        x1 = sign * (flat * (a1 - r1) + c * r1)
        x = (x0 + x1 * zeta) / (1 + slope * x1)
        z = zeta - slope * x
        y = side_fraction * (b0 - r0 + (b1 - r1) * z) + s * (r0 + r1 * z)
        y = np.where(quarter < 2, y, -y)
        if self.lean:  # the shaft tapers: each time the error is a few percent of what it was
            level = replace(self, lean=0.0)
            for _ in range(12):
                z = zeta - slope * (x + self.lean * y)
                x, y, _ = level.point(phi, z, 0.0).T
        return np.stack([x, y, z], axis=1)

    def offset(self, thickness: FloatOrFloats) -> StemShaft:
        """Surface at a distance: exact on the flats, within t (1/cos - 1) at the corners."""
        a, b, r = self.half
        across = [thickness / math.cos(math.atan(slope)) for slope in self.slope[:2]]
        return StemShaft((a + across[0], b + across[1], r + thickness), self.slope)

    def outside(self, thickness: Thickness, theta: Floats, z: Floats) -> Floats:
        """Distance from the z axis to the outer side of a mantle in the direction theta [mm]."""
        return self.offset(thickness(theta, z)).radius(theta, z)

    def depth(self, thickness: Thickness, x: Floats) -> Floats:
        """Depth of points (n, 3) within a mantle's outer side, across the z axis (n,) [mm]."""
        r = self.outside(thickness, np.arctan2(x[:, 1], x[:, 0]), x[:, 2])
        return np.asarray(r - np.hypot(x[:, 0], x[:, 1]))


def shaft_of(implant: Implant) -> StemShaft:
    """Shaft of a stem from its sections at the tip and at ``section_z``."""
    tip_level, section_level = implant.tip_z, implant.section_z
    tips = implant.tip_half_width, implant.tip_half_depth, implant.tip_corner_radius
    tops = implant.half_width, implant.half_depth, implant.corner_radius
    slopes = [
        (top - tip) / (section_level - tip_level) for tip, top in zip(tips, tops, strict=True)
    ]
    values = [tip - slope * tip_level for tip, slope in zip(tips, slopes, strict=True)]
    return StemShaft((values[0], values[1], values[2]), (slopes[0], slopes[1], slopes[2]))


def half_width(implant: Implant, z: Floats) -> Floats:
    """Half-width of a stem's shaft at heights (n,), also beyond its ends (n,) [mm].

    Of a stem from a file it is the lateral extent at the shoulder.
    """
    if implant.cad is not None:
        return np.full(len(z), float(implant.cad["lateral"]))
    return np.asarray(shaft_of(implant).section(z)[0])


def shoulder_plane_height(implant: Implant, slope: float) -> float:
    """Height at the axis of a section with a slope through the shoulder's lateral edge [mm]."""
    (lateral,) = half_width(implant, np.array([implant.shoulder]))
    return float(implant.shoulder - slope * lateral)


@dataclass(frozen=True)
class Tip:
    """The end of the stem: a zone of an ellipsoid in the shape of its sections, and a shallow bowl.

    The bowl begins where sections are narrowed to `RIM_COSINE`. Its depth is `BOWL_DEPTH` of the
    ellipsoid's: with the whole depth, cells at its rim would have a straight angle. The surfaces
    that continue in the plug below widen again.

    Attributes:
        low: Level of the tip [mm].
        height: Height of zone and bowl [mm]; 0: the end is flat.
        plug: Level of the plug's end [mm].
    """

    low: float
    height: float
    plug: float

    @property
    def axis(self) -> float:
        """Half an axis of the ellipsoid, along the stem [mm]."""
        return self.height / (RIM_SINE + BOWL_DEPTH * (1.0 - RIM_SINE))

    @property
    def rim(self) -> float:
        """Level of the last section [mm]."""
        return self.low + self.height - RIM_SINE * self.axis

    def width(self, z: Floats) -> Floats:
        """Width of sections at levels z [mm], over that of the shaft."""
        if not self.height:
            return np.ones_like(z)
        depth = np.clip((self.low + self.height - z) / self.axis, 0.0, RIM_SINE)
        width, plug = np.sqrt(1.0 - depth**2), (self.rim - z) / (self.rim - self.plug)
        return np.asarray(width + (1.0 - width) * np.clip(plug, 0.0, 1.0))

    def bulge(self, share: Floats, z: Floats) -> Floats:
        """Distance of sections below their outlines at parts of their width [mm].

        The last section is the bowl; in the plug sections get flat again.
        """
        depth = np.sqrt(np.maximum(1.0 - (RIM_COSINE * share) ** 2, 0.0)) - RIM_SINE
        level = np.clip((z - self.plug) / (self.rim - self.plug), 0.0, 1.0)
        return np.asarray(BOWL_DEPTH * self.axis * depth * level)


@dataclass(frozen=True)
class StemAboveCut:
    """The stem above the neck cut.

    Attributes:
        shaft: The stem below the neck cut.
        planes: Height at the axis [mm] and slope of the shaft's sections at the cut and at its end.
        buried: Depth of the shaft's end below the cut, along the axis; both planes are there then.
        rings: Centres of the first and the last round section, which is the head's (2, 3) [mm].
        radii: Their radii [mm].
        arm: Length before and after the first ring over which lines turn [mm].
        ends: Stations, from 0 at the cut, at which the shaft, the lines to the ring, their turn and
            the cone end.
    """

    shaft: StemShaft
    planes: tuple[tuple[float, float], tuple[float, float]]
    rings: Floats
    radii: tuple[float, float]
    buried: float = 0.0
    arm: float = 0.0
    ends: tuple[int, ...] = ()

    def ring(self, phi: Floats, end: int) -> Floats:
        """Points of the first or the last round section (n, 3) [mm]."""
        axis = unit_vectors(self.rings[1] - self.rings[0])
        angles = 2 * np.pi * phi[:, None]
        directions = np.cos(angles) * [axis[2], 0.0, -axis[0]] + np.sin(angles) * [0.0, 1.0, 0.0]
        return np.asarray(self.rings[end] + self.radii[end] * directions)

    def line_directions(self, phi: Floats) -> tuple[Floats, Floats]:
        """Vectors from the shaft to the first ring, and from there to the last one (n, 3) [mm]."""
        ring = self.ring(phi, 0)
        return ring - self.shaft.point(phi, *self.planes[1]), self.ring(phi, 1) - ring

    def point(self, phi: Floats, zeta: FloatOrFloats) -> Floats:
        """Points in planes above the end of the shaft, parallel to it (n, 3) [mm]."""
        (direction, _), (base, slope) = self.line_directions(phi), self.planes[1]
        rise = direction[:, 2] + slope * (direction[:, 0] + self.shaft.lean * direction[:, 1])
        return np.asarray(self.ring(phi, 0) + ((zeta - base) / rise - 1)[:, None] * direction)

    def points(self, phi: Floats, s: Floats) -> Floats:
        """Points at stations above the cut (n, 3) [mm]: the sum of the parts up to there.

        The fillet is a quadratic Bézier curve.
        """
        shaft_part, loft_part, turn_part, cone_part = (
            np.clip((s - a) / max(b - a, 1), 0.0, 1.0)[:, None]
            for a, b in pairwise((0, *self.ends))
        )
        planes = zip(*self.planes, strict=True)
        x = self.shaft.point(phi, *(a + shaft_part[:, 0] * (b - a) for a, b in planes))
        to_ring, along_cone = self.line_directions(phi)
        before_ring, after_ring = (
            self.arm * unit_vectors(to_ring),
            self.arm * unit_vectors(along_cone),
        )
        if self.buried:
            offset = self.point(phi, self.planes[1][0] + self.buried) - x
            x, to_ring = x + offset, to_ring - offset
        x += loft_part * (to_ring - before_ring) + cone_part * (along_cone - after_ring)
        return np.asarray(x + (1 - (1 - turn_part) ** 2) * before_ring + turn_part**2 * after_ring)

    def with_fillet(self, radius: float) -> StemAboveCut:
        """Return the stem whose lines turn with at least this radius [mm].

        A bend by the angle theta has the least radius arm cos(theta / 2)^2 / sin(theta / 2). All
        lines have the arm of the sharpest bend. It is at least `LEAST_ARM`, so that cells there are
        not flat.

        Raises:
            GeometryError: There is no room.
        """
        to_ring, along_cone = self.line_directions(np.arange(72) / 72)
        cosine = float((unit_vectors(to_ring) * unit_vectors(along_cone)).sum(axis=1).min())
        arm = radius * math.sqrt(2 * (1 - cosine)) / (1 + cosine)
        room = ARM_SHARE * math.sqrt(
            min((directions**2).sum(axis=1).min() for directions in (to_ring, along_cone))
        )
        if arm > room:
            raise GeometryError(
                f"geometry.stem.neck_fillet: {radius:g} mm does not fit between the neck cut and"
                f" the head; expected at most {radius * room / arm:.3g} mm"
            )
        return replace(self, arm=max(arm, LEAST_ARM))


def stem_above_cut(
    implant: Implant, shaft: StemShaft, mesh: StepKeys, low: float, top: float, cut_slope: float
) -> StemAboveCut:
    """Return the stem above the neck cut.

    The cut meets the axis at the height `top` with the slope `cut_slope`. The shoulder's lateral
    edge is in a parallel plane at the height `low` <= `top`.

    Raises:
        GeometryError: The neck is not above the cut.
    """
    base, slope = _last_plane_of_shaft(implant, shaft, low, top, cut_slope)
    buried = max(top - low, 0.0)
    clearance = NECK_CLEARANCE
    if low != top:
        clearance = implant.neck_fillet + buried / math.hypot(slope, 1.0)
    ring, head_centre, cone_length = _neck_ends(implant, base, slope, clearance)
    planes, centres = ((min(base, top), cut_slope), (base, slope)), np.stack([ring, head_centre])
    radii = 0.5 * implant.neck_diameter, 0.5 * implant.trunnion_diameter
    above_cut = StemAboveCut(shaft, planes, centres, radii, buried)
    above_cut = above_cut.with_fillet(implant.neck_fillet)
    loft_length = float(np.linalg.norm(ring - [0.0, 0.0, max(base, top)]))
    arm = above_cut.arm
    lengths = (max(base - top, 0.0), loft_length - arm, 2 * arm, cone_length - arm)
    stations = np.cumsum([mesh.steps(length) if length else 0 for length in lengths])
    return replace(above_cut, ends=tuple(map(int, stations)))


def _last_plane_of_shaft(
    implant: Implant, shaft: StemShaft, low: float, top: float, cut_slope: float
) -> tuple[float, float]:
    """Height at the axis [mm] and slope of the last section of the shaft.

    It is at the shoulder if that stands out of the bone, else at the height `low`.
    """
    slope = max(SHOULDER_SLOPE, cut_slope)
    shoulder = implant.shoulder
    height = shoulder - slope * float(shaft.section(shoulder)[0])
    return (height, slope) if height > top + SHOULDER_RISE else (low, cut_slope)


def _neck_ends(
    implant: Implant, base: float, slope: float, clearance: float
) -> tuple[Floats, Floats, float]:
    """Centres of the first round section of the neck and of the head (3,), and their distance [mm].

    Args:
        implant: The implant.
        base: Height at the axis of the last section of the shaft [mm].
        slope: Slope of this section.
        clearance: Least distance of the first round section from it [mm].

    Raises:
        GeometryError: The neck is not above the cut.
    """
    sine, cosine = math.sin(implant.neck_angle), -math.cos(implant.neck_angle)
    axis = np.array([sine, 0.0, cosine])
    head_centre = np.array([implant.head_offset, 0.0, implant.head_height])
    length = implant.head_offset / sine
    neck_root = head_centre - length * axis
    normal = np.array([slope, 0.0, 1.0]) / math.hypot(slope, 1.0)
    rise = float(axis @ normal)
    # Distance of the lowest point of a round section from its centre, towards the shaft.
    dip = 0.5 * implant.neck_diameter * math.sqrt(max(0.0, 1.0 - rise**2))
    # Fraction of the neck's length above which round sections have the clearance.
    least_fraction = (clearance + dip - float(normal @ (neck_root - [0.0, 0.0, base]))) / (
        rise * length
    )
    if rise <= 0 or least_fraction > BLEND_RANGE[1]:
        raise GeometryError(
            f"geometry: the neck, {implant.neck_diameter:g} mm thick towards a head"
            f" {implant.head_height - implant.shoulder:g} mm above the shoulder, does not clear"
            " the neck cut; raise the head or cut lower"
        )
    fraction = max(BLEND_RANGE[0], least_fraction)
    return neck_root + fraction * length * axis, head_centre, (1.0 - fraction) * length
