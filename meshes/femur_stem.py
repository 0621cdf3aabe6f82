"""The implant of the parametric femur: a straight, tapered stem, its offset, its neck.

A section of the body is a rectangle with rounded corners whose half-widths and corner radius are
linear in z, so that the body is a ruled loft between two sections. Above the neck cut the body goes
on where it stands out. From its last section straight lines lead to a round ring, and on along a
cone to the trunnion; where they turn they are rounded.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol

import numpy as np

from app.foundation.arrays import FloatOrFloats, Floats
from app.foundation.errors import GeometryError
from app.foundation.implant import Implant
from meshes.data import StepKeys

ARC_WEIGHT = 1.6  # lines on a corner's arc over those on a flat of its length: it bends
MOST_LINES = 3.0  # lines on a piece of a quarter over those by its length, at most
LEAST_WHOLE = 12  # lines around from which each piece has whole lines
# A rounded tip becomes a bowl where its ellipsoid has turned by 30 degrees.
RIM_COSINE = math.sqrt(0.75)  # cosine of that angle
RIM_SINE = 0.5  # sine of that angle
BOWL_DEPTH = 0.3  # depth of the bowl over that of the ellipsoid
BLEND_RANGE = (0.38, 0.8)  # of the neck's length: where it is round, at least and at most
NECK_CLEARANCE = 2.0  # mm that the round neck is above the cut
SHOULDER_SLOPE = 0.8  # slope of the sections at the shoulder of a stem that stands out of the bone
ARM_SHARE = 0.4  # of the lines before and after the turn to the neck: what it may take
LEAST_ARM = 0.5  # mm before and after it
SHOULDER_RISE = 6.0  # mm that the shoulder may be above the cut without standing out


# Thickness of a mantle at angles [rad] and levels [mm] (n,) [mm].
Thickness = Callable[[Floats, Floats], Floats]


class Graded(Protocol):
    """Thickness of a mantle by height and side."""

    @property
    def tables(self) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
        """Mean thickness [mm] by fraction of the height; ratio to it by angle in turns."""


def thickness(given: float | Graded, low: float, top: float) -> Thickness:
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


def allotted(lengths: Floats, lines: int) -> Floats:
    """Numbers of lines (k,) on pieces of lengths (k,), one at least: the longest edge is least."""
    counts = np.ones(len(lengths))
    while counts.sum() < lines:
        counts[np.argmax(lengths / counts)] += 1
    return counts


def limited(shares: Floats, weights: Floats) -> Floats:
    """Shares (k, ...) of at most `MOST_LINES` times their weights (k, ...); both sum to 1."""
    capped = np.minimum(shares, MOST_LINES * weights)
    room = MOST_LINES * weights - capped
    return np.asarray(capped + (1.0 - capped.sum(axis=0)) * room / room.sum(axis=0))


@dataclass(frozen=True)
class Body:
    """A tapered rounded rectangle: value + slope * z for half-width, half-depth and corner.

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

    def divided(self, z: float, around: int) -> Body:
        """Return the body with shares of its section at z [mm] for a number of lines around.

        For multiples of 4 each piece has whole lines, so that lines are where arcs end.
        """
        weights = self._weights(z)
        if around % 4 == 0 and around >= LEAST_WHOLE:
            weights = allotted(weights, around // 4)
        side, corner, front = map(float, weights / weights.sum())
        return replace(self, shares=(side, corner, front))

    def _shares(self, z: FloatOrFloats) -> Floats:
        """Shares at levels z (3, ...).

        They are the same at all levels, so that lines stay at the ends of arcs. Only pieces that
        are too short for their lines have fewer, such as the flats of a round end.
        """
        weights = self._weights(z)
        shares = np.reshape(self.shares, (3,) + (1,) * (weights.ndim - 1))
        return limited(shares, weights / weights.sum(axis=0))

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
        # x = X a + U r and y = Y b + V r of the section where the plane meets the point.
        c, s = np.cos(angle), np.sin(angle)
        (a0, b0, r0), (a1, b1, r1) = self.half, self.slope
        sign = np.where((quarter == 1) | (quarter == 2), -1.0, 1.0)
        flat = 1 - front_fraction
        x0, x1 = (sign * (flat * (p - q) + c * q) for p, q in ((a0, r0), (a1, r1)))
        x = (x0 + x1 * zeta) / (1 + slope * x1)
        z = zeta - slope * x
        y = side_fraction * (b0 - r0 + (b1 - r1) * z) + s * (r0 + r1 * z)
        y = np.where(quarter < 2, y, -y)
        if self.lean:  # the body tapers: each time the error is a few percent of what it was
            level = replace(self, lean=0.0)
            for _ in range(12):
                z = zeta - slope * (x + self.lean * y)
                x, y, _ = level.point(phi, z, 0.0).T
        return np.stack([x, y, z], axis=1)

    def offset(self, thickness: FloatOrFloats) -> Body:
        """Surface at a distance: exact on the flats, within t (1/cos - 1) at the corners."""
        a, b, r = self.half
        across = [thickness / math.cos(math.atan(slope)) for slope in self.slope[:2]]
        return Body((a + across[0], b + across[1], r + thickness), self.slope)

    def outside(self, thickness: Thickness, theta: Floats, z: Floats) -> Floats:
        """Distance from the z axis to the outer side of a mantle in the direction theta [mm]."""
        return self.offset(thickness(theta, z)).radius(theta, z)

    def depth(self, thickness: Thickness, x: Floats) -> Floats:
        """Depth of points (n, 3) within a mantle's outer side, across the z axis (n,) [mm]."""
        r = self.outside(thickness, np.arctan2(x[:, 1], x[:, 0]), x[:, 2])
        return np.asarray(r - np.hypot(x[:, 0], x[:, 1]))


def body(implant: Implant) -> Body:
    """The stem's body from its sections at the tip and at ``section_z``."""
    tip_level, section_level = implant.tip_z, implant.section_z
    tips = implant.tip_half_width, implant.tip_half_depth, implant.tip_corner_radius
    tops = implant.half_width, implant.half_depth, implant.corner_radius
    slopes = [
        (top - tip) / (section_level - tip_level) for tip, top in zip(tips, tops, strict=True)
    ]
    values = [tip - slope * tip_level for tip, slope in zip(tips, slopes, strict=True)]
    return Body((values[0], values[1], values[2]), (slopes[0], slopes[1], slopes[2]))


def edge(implant: Implant, slope: float) -> float:
    """Height at the axis of a section with a slope through the shoulder's lateral edge [mm]."""
    if implant.cad is not None:
        return float(implant.shoulder - slope * implant.cad["lateral"])
    return float(implant.shoulder - slope * body(implant).section(implant.shoulder)[0])


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
        """Width of sections at levels z [mm], over that of the body."""
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
class Upper:
    """The stem above the neck cut.

    Attributes:
        body: The stem below the neck cut.
        planes: Height at the axis [mm] and slope of the body's sections at the cut and at its end.
        buried: Depth of the body's end below the cut, along the axis; both planes are there then.
        rings: Centres of the first and the last round section, which is the head's (2, 3) [mm].
        radii: Their radii [mm].
        arm: Length before and after the first ring over which lines turn [mm].
        ends: Stations, from 0 at the cut, at which the body, the lines to the ring, their turn and
            the cone end.
    """

    body: Body
    planes: tuple[tuple[float, float], tuple[float, float]]
    rings: Floats
    radii: tuple[float, float]
    buried: float = 0.0
    arm: float = 0.0
    ends: tuple[int, ...] = ()

    def ring(self, phi: Floats, end: int) -> Floats:
        """Points of the first or the last round section (n, 3) [mm]."""
        axis = unit(self.rings[1] - self.rings[0])
        angles = 2 * np.pi * phi[:, None]
        directions = np.cos(angles) * [axis[2], 0.0, -axis[0]] + np.sin(angles) * [0.0, 1.0, 0.0]
        return np.asarray(self.rings[end] + self.radii[end] * directions)

    def line_directions(self, phi: Floats) -> tuple[Floats, Floats]:
        """Vectors from the body to the first ring, and from there to the last one (n, 3) [mm]."""
        ring = self.ring(phi, 0)
        return ring - self.body.point(phi, *self.planes[1]), self.ring(phi, 1) - ring

    def point(self, phi: Floats, zeta: FloatOrFloats) -> Floats:
        """Points in planes above the body's end, parallel to it (n, 3) [mm]."""
        (direction, _), (base, slope) = self.line_directions(phi), self.planes[1]
        rise = direction[:, 2] + slope * (direction[:, 0] + self.body.lean * direction[:, 1])
        return np.asarray(self.ring(phi, 0) + ((zeta - base) / rise - 1)[:, None] * direction)

    def points(self, phi: Floats, s: Floats) -> Floats:
        """Points at stations above the cut (n, 3) [mm]: the sum of the parts up to there.

        Lines turn from one direction to another by a quadratic Bézier curve.
        """
        body_part, loft_part, turn_part, cone_part = (
            np.clip((s - a) / max(b - a, 1), 0.0, 1.0)[:, None]
            for a, b in pairwise((0, *self.ends))
        )
        planes = zip(*self.planes, strict=True)
        x = self.body.point(phi, *(a + body_part[:, 0] * (b - a) for a, b in planes))
        to_ring, along_cone = self.line_directions(phi)
        before_ring, after_ring = self.arm * unit(to_ring), self.arm * unit(along_cone)
        if self.buried:
            offset = self.point(phi, self.planes[1][0] + self.buried) - x
            x, to_ring = x + offset, to_ring - offset
        x += loft_part * (to_ring - before_ring) + cone_part * (along_cone - after_ring)
        return np.asarray(x + (1 - (1 - turn_part) ** 2) * before_ring + turn_part**2 * after_ring)

    def with_fillet(self, radius: float) -> Upper:
        """Return the stem whose lines turn with at least this radius [mm].

        Where the directions are theta apart the curve has the least radius
        arm cos(theta / 2)^2 / sin(theta / 2); the arm is one for all lines, that of the sharpest
        turn. A blunt one is longer, so that cells along it have a volume.

        Raises:
            GeometryError: There is no room.
        """
        to_ring, along_cone = self.line_directions(np.arange(72) / 72)
        cosine = float((unit(to_ring) * unit(along_cone)).sum(axis=1).min())
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


def unit(x: Floats) -> Floats:
    """Vectors (..., 3) over their lengths."""
    return np.asarray(x / np.sqrt((x**2).sum(axis=-1, keepdims=True)))


def upper(
    implant: Implant, body: Body, mesh: StepKeys, low: float, top: float, cut_slope: float
) -> Upper:
    """Return the stem above the neck cut.

    The cut meets the axis at the height `top` with the slope `cut_slope`. The shoulder's lateral
    edge is in a parallel plane at the height `low` <= `top`.

    Raises:
        GeometryError: The neck is not above the cut.
    """
    sine, cosine = math.sin(implant.neck_angle), -math.cos(implant.neck_angle)
    axis = np.array([sine, 0.0, cosine])
    head_centre = np.array([implant.head_offset, 0.0, implant.head_height])
    length = implant.head_offset / sine
    slope = max(SHOULDER_SLOPE, cut_slope)
    shoulder = implant.shoulder
    edge_height = shoulder - slope * float(body.section(shoulder)[0])
    base, slope = (edge_height, slope) if edge_height > top + SHOULDER_RISE else (low, cut_slope)
    buried = max(top - low, 0.0)
    clearance = (
        NECK_CLEARANCE if low == top else implant.neck_fillet + buried / math.hypot(slope, 1.0)
    )
    neck_radius, trunnion_radius = 0.5 * implant.neck_diameter, 0.5 * implant.trunnion_diameter
    normal = np.array([slope, 0.0, 1.0]) / math.hypot(slope, 1.0)
    # How far the lowest point of a ring is from its centre towards the section below.
    ring_dip = neck_radius * math.sqrt(max(0.0, 1.0 - float(axis @ normal) ** 2))
    rise = float(axis @ normal)
    # The neck's axis is in the section that it leaves at this fraction of its length, or below.
    neck_root = head_centre - length * axis
    least_fraction = (clearance + ring_dip - float(normal @ (neck_root - [0.0, 0.0, base]))) / (
        rise * length
    )
    if rise <= 0 or least_fraction > BLEND_RANGE[1]:
        raise GeometryError(
            f"geometry: the neck, {implant.neck_diameter:g} mm thick towards a head"
            f" {implant.head_height - shoulder:g} mm above the shoulder, does not clear the neck"
            " cut; raise the head or cut lower"
        )
    ring_fraction = max(BLEND_RANGE[0], least_fraction)
    ring = neck_root + ring_fraction * length * axis
    planes, centres = ((min(base, top), cut_slope), (base, slope)), np.stack([ring, head_centre])
    stem_above = Upper(body, planes, centres, (neck_radius, trunnion_radius), buried).with_fillet(
        implant.neck_fillet
    )
    blend = float(np.linalg.norm(ring - [0.0, 0.0, max(base, top)]))
    cone = (1.0 - ring_fraction) * length
    lengths = (
        max(base - top, 0.0),
        blend - stem_above.arm,
        2 * stem_above.arm,
        cone - stem_above.arm,
    )
    steps = np.cumsum([mesh.steps(length) if length else 0 for length in lengths])
    return replace(stem_above, ends=tuple(map(int, steps)))
