"""The nested surfaces of a femur with a cemented stem, along lines across it.

Sections are planes z = zeta(s) - slope(s) x. They are level along the stem and turn over the last
`TURN` millimetres to the neck cut, which is the section at station ``cut``. On each section a line
runs from a point of the stem's outline to the periosteum; along it lie the outer side of the mantle
and the endosteum. Cement is what is inside the lesser of the two. Above the cut the stem goes on
alone: its body where it stands out, then a blend to the round neck and a cone to the trunnion.

Along any line each surface is met once: sections of bone are star-shaped about the stem's axis.
Radii come from tables by `femur_bone.Tube`; any other function of angle and height would do that
is as smooth as the cells are small.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize.elementwise import find_root

from app.arrays import Floats, Ints
from app.errors import GeometryError
from meshes import femur_bone, femur_stem
from meshes.femur_bone import PERIOSTEUM
from meshes.layers import DIGITS, Lines, Nodes
from meshes.reference_body import ReferenceBody, Segment

TURN = 60.0  # mm below the neck cut over which sections turn to it
CORE = 0.5  # of the canal: where the innermost surface goes below the plug
CORE_OVER = 30.0  # mm that it takes to get there
SPREAD = 0.6  # of the canal: where the outer side of the mantle goes below the plug
LEAST_MANTLE = 1.0  # mm of cement for which there must be room
BLEND = (0.38, 0.8)  # of the neck's length: where it is round, at least and at most
CLEAR = 2.0  # mm that the round neck is above the cut
OUT = 0.8  # slope of the sections at the shoulder of a stem that stands out of the bone
SHOULDER = 6.0  # mm that the shoulder may be below or above the cut without standing out
REACH = 90.0  # mm: farther from the axis there is no bone
WAYS = np.linspace(0.0, 1.2, 25)  # of a line, where it is asked how often it meets bone
EXACT = 1e-11  # of roots, absolute and relative


def root(function: Callable[[Floats, Ints], Floats], high: Floats) -> Floats:
    """Zeros between 0 and `high` (n,) of functions that fall through zero; shape (n,).

    Args:
        function: Takes positions and numbers of the functions, both (k,); returns (k,).
        high: Upper ends (n,); the result where a function is positive there.
    """
    number = np.arange(len(high))
    found = high.copy()
    falls = function(high, number) < 0
    if falls.any():
        found[falls] = find_root(
            lambda x, k: function(x, k.astype(np.int64)),
            (np.zeros(int(falls.sum())), high[falls]),
            args=(number[falls].astype(float),),
            tolerances={"xatol": EXACT, "xrtol": EXACT},
        ).x
    return found


@dataclass(frozen=True)
class Neck:
    """The stem above the cut: an outline on the cut, round rings, the trunnion.

    Attributes:
        ring: Centre of the first round section [mm].
        head: Centre of the last, which is the head's (3,) [mm].
        axis: Unit vector from ring to head (3,).
        radii: Radii at ring and head [mm].
    """

    ring: Floats
    head: Floats
    axis: Floats
    radii: tuple[float, float]

    def circle(self, phi: Floats, along: Floats) -> Floats:
        """Points of rings at parts `along` of the cone (n, 3) [mm]; below 0 before its start."""
        down = np.array([self.axis[2], 0.0, -self.axis[0]])  # medial, across the axis
        turn = 2 * np.pi * phi
        radius = self.radii[0] + (self.radii[1] - self.radii[0]) * along
        centre = self.ring + along[:, None] * (self.head - self.ring)
        across = np.cos(turn)[:, None] * down + np.sin(turn)[:, None] * np.array([0.0, 1.0, 0.0])
        return np.asarray(centre + radius[:, None] * across)


class FemurSurfaces:
    """Nested surfaces of the operated femur as functions of angle and station, and their grid.

    Attributes:
        mesh: Mesh options of the case.
        around: Number of lines around.
        through: Cells through each layer, at most.
        cement: Cells through the first layer; a fraction is the part, from the cut down, with one
            more.
        segments: Segments of the reference body, from below.
        mantle: The first and the last section with a mantle, whose lines with mantle and endosteum
            in one continue below and above.
        mirrored: Steps whose prisms are split the other way around: there sections turn back.
        tip: Station of the stem's tip.
    """

    mirrored = range(0)

    def __init__(self, geometry: Any, mesh: Any) -> None:
        self.mesh, thickness = mesh, geometry.cement_thickness
        self._body = femur_stem.body(geometry)
        self._grown = self._body.offset(thickness)
        # In axes that turn with the stem.
        self._canal = femur_bone.endosteum(geometry)
        self._periosteum = replace(PERIOSTEUM, turn=geometry.anteversion)
        normal, level = femur_bone.resection(geometry)
        self._top, self._steepest = level / normal[2], normal[0] / normal[2]
        plug = geometry.stem_tip_z - geometry.plug_length
        below = _distances(mesh, plug - geometry.distal_cut_z, "below")
        above = _distances(mesh, self._top - geometry.stem_tip_z, "stem")
        steps, start = mesh.steps(geometry.stem_tip_z - plug), len(below) - 1
        inside = plug + (geometry.stem_tip_z - plug) * np.arange(1, steps + 1) / steps
        self._zeta = np.concatenate([(plug - below)[::-1], inside, (self._top - above)[-2::-1]])
        self.tip = start + steps
        self.mantle = (start, len(self._zeta) - 1)
        self._middle = 0.25 * geometry.stem_tip_z + 0.75 * self._top
        self.around = mesh.lines_around(self._body.section(self._middle), thickness)
        self.through, self.cement = mesh.cells_through(thickness), mesh.along_cement(thickness)
        self._refuse()
        self._continue(geometry)

    @property
    def cut(self) -> int:
        """Station of the neck cut."""
        return self.mantle[1]

    def _continue(self, geometry: Any) -> None:
        """Divide the stem above the cut."""
        self._neck, self._out = _neck(geometry, self._body, self._top, self._steepest)
        out = 0 if self._out is None else self.mesh.steps(self._out - self._top)
        base = self._top if self._out is None else self._out
        blend = float(np.linalg.norm(self._neck.ring - np.array([0.0, 0.0, base])))
        cone = float(np.linalg.norm(self._neck.head - self._neck.ring))
        self._above = np.cumsum([0, out, self.mesh.steps(blend), self.mesh.steps(cone)])
        bone = ("cancellous_bone", "cortical_bone")
        self.segments: tuple[Segment, ...] = (
            Segment(self.mantle[0], ("cancellous_bone", "cancellous_bone", *bone)),
            Segment(self.tip - self.mantle[0], ("cement", "cement", *bone)),
            Segment(self.cut - self.tip, ("stem", "cement", *bone)),
            Segment(int(self._above[-1]), ("stem",)),
        )

    def outline(self) -> Floats:
        """Section of the stem, a quarter of its way from cut to tip (around, 2) [mm]."""
        x = self._body.point(np.arange(self.around) / self.around, self._middle, 0.0)
        return np.round(x[:, :2], DIGITS)

    def plane(self, s: Floats) -> tuple[Floats, Floats]:
        """Height at the axis [mm] and slope of the sections at stations s <= cut."""
        zeta = np.interp(s, np.arange(len(self._zeta)), self._zeta)
        t = np.clip((zeta - self._top + TURN) / TURN, 0.0, 1.0)
        return zeta, self._steepest * t * t * (2 - t)

    def lines(self, phi: Floats, s: Floats) -> Lines:
        """Lines at angles `phi` [turns] and stations `s` (n,); above the cut the stem's alone."""
        lines = self._across(phi, np.minimum(s, self.cut))
        if (s > self.cut).any():
            self._beyond(lines, phi, s)
        return lines

    def _beyond(self, lines: Lines, phi: Floats, s: Floats) -> None:
        """Replace the lines above the cut."""
        above = s > self.cut
        lines.start[above] = self._stem_above(phi[above], s[above])
        lines.end[above] = lines.start[above] + 1.0
        lines.mantle[above], lines.endosteum[above] = 0.3, 0.6

    def ended(self, nodes: Nodes, number: Ints, body: ReferenceBody) -> tuple[Nodes, Ints]:
        """Take nodes of a ball at the end off their lines; nodes, and what stands for each."""
        return nodes, number

    def arc(self, a: Floats, b: Floats) -> Floats:
        """Middles of edges from a to b (n, 3) in the shell of a ball (n, 3)."""
        return 0.5 * (a + b)

    def _across(self, phi: Floats, s: Floats) -> Lines:
        """Lines at stations up to the cut."""
        zeta, slope = self.plane(s)
        theta = 2 * np.pi * phi
        c, d = np.cos(theta), np.sin(theta)
        r = root(
            lambda r, k: self._periosteum.radius(theta[k], zeta[k] - slope[k] * r * c[k]) - r,
            np.full(len(s), REACH),
        )
        end = np.stack([r * c, r * d, zeta - slope * r * c], axis=1)
        below = s < self.mantle[0]
        at = np.where(below, float(self.mantle[0]), s)
        start = self._body.point(phi, *self.plane(at))
        depth = np.where(below, self._zeta[self.mantle[0]] - zeta, 0.0)
        start = self._sink(start, theta, zeta, depth)
        endosteum = self._meets(self._canal, start, end)
        mantle = np.empty(len(s))
        mantle[~below] = self._meets(self._grown.radius, start[~below], end[~below])
        if below.any():
            # The mantle's outer side goes on below the plug from where it is at its end.
            first = self._across(phi[below], at[below])
            ratio = first.mantle / first.endosteum
            ratio += (SPREAD - ratio) * np.minimum(1.0, depth[below] / (4 * self.mesh.size))
            mantle[below] = ratio * endosteum[below]
        return Lines(start, end, mantle, endosteum)

    def _sink(self, start: Floats, theta: Floats, zeta: Floats, depth: Floats) -> Floats:
        """Points of the innermost surface below the plug, scaled to a part of the canal."""
        r = CORE * self._canal(theta, zeta)
        core = np.stack([r * np.cos(theta), r * np.sin(theta)], axis=1)
        part = np.clip(depth / CORE_OVER, 0.0, 1.0)[:, None]
        x = start.copy()
        x[:, :2] = (1 - part) * start[:, :2] + part * core
        x[:, 2] -= depth
        return x

    @staticmethod
    def _meets(radius: Callable[[Floats, Floats], Floats], start: Floats, end: Floats) -> Floats:
        """Fraction of lines, from start to end, at which they meet a surface r(theta, z) (n,)."""
        way = end - start

        def within(part: Floats, k: Ints) -> Floats:
            return FemurSurfaces._within(radius, start[k] + part[:, None] * way[k])

        return root(within, np.ones(len(start)))

    @staticmethod
    def _within(radius: Callable[[Floats, Floats], Floats], points: Floats) -> Floats:
        """Depth of points inside a surface r(theta, z), across the z axis (n,) [mm]."""
        x, y, z = points.T
        return radius(np.arctan2(y, x), z) - np.hypot(x, y)

    def _stem_above(self, phi: Floats, s: Floats) -> Floats:
        at = s - self.cut
        _, out, blend, cone = self._above
        x = np.empty((len(s), 3))
        body = at <= out
        if body.any():
            part = at[body] / max(out, 1)
            high = self._top if self._out is None else self._out
            steep = max(OUT, self._steepest)
            x[body] = self._body.point(
                phi[body],
                self._top + part * (high - self._top),
                self._steepest + part * (steep - self._steepest),
            )
        round_ = at >= blend
        x[round_] = self._neck.circle(phi[round_], (at[round_] - blend) / (cone - blend))
        loft = ~body & ~round_
        if loft.any():
            low = self._stem_above(phi[loft], np.full(int(loft.sum()), self.cut + float(out)))
            high_ = self._neck.circle(phi[loft], np.zeros(int(loft.sum())))
            part = ((at[loft] - out) / (blend - out))[:, None]
            x[loft] = (1 - part) * low + part * high_
        return x

    def _refuse(self) -> None:
        """Raise GeometryError where lines meet bone twice, or the stem has no room for cement."""
        along, around = np.linspace(self.tip, self.cut, 60), np.arange(72) / 72
        phi, s = (v.ravel() for v in np.meshgrid(around, along))
        lines = self._across(phi, s)
        start, end = lines.start, lines.end
        for name, radius in (("periosteum", self._periosteum.radius), ("endosteum", self._canal)):
            inside = np.array([self._within(radius, start + part * (end - start)) for part in WAYS])
            twice = np.flatnonzero(((inside[1:] > 0) != (inside[:-1] > 0)).sum(axis=0) > 1)
            if len(twice):
                x, y, z = start[twice[0]]
                raise GeometryError(
                    f"geometry: a line across the bone from ({x:.0f}, {y:.0f}, {z:.0f}) mm meets"
                    f" the {name} more than once; sections must be star-shaped about the stem"
                )
        room = lines.endosteum * lines.length
        outside = np.hypot(*start.T[:2]) - self._canal(np.arctan2(*start.T[1::-1]), start[:, 2])
        room = np.where(outside > 0, -outside, room)
        worst = int(room.argmin())
        if room[worst] >= LEAST_MANTLE:
            return
        toward = math.cos(2 * math.pi * phi[worst])
        side = "antero-posteriorly"
        if abs(toward) > 0.7:
            side = "medially" if toward > 0 else "laterally"
        raise GeometryError(
            f"geometry: the canal leaves {room[worst]:.2f} mm beside the stem at"
            f" z = {start[worst, 2]:.0f} mm, {side}; the mantle needs {LEAST_MANTLE:.1f} mm: widen"
            " the canal (canal_widening), narrow the stem or move it proximally (stem_tip_z)"
        )


def _distances(mesh: Any, length: float, part: str) -> Floats:
    """Distances from 0 to a length in the steps of a mesh that grow [mm]."""
    at, count, step = mesh.graded(length, part)
    every = np.concatenate([at, at[-1] + step * np.arange(1, count + 1)])
    return np.asarray(every * length / every[-1])


def _neck(
    geometry: Any, body: femur_stem.Body, top: float, steep: float
) -> tuple[Neck, float | None]:
    """The neck, and the height at the axis of the end of a protruding body [mm].

    Raises:
        GeometryError: The shoulder is far below the cut, or the neck is not above it.
    """
    sine, cosine = math.sin(geometry.neck_angle), -math.cos(geometry.neck_angle)
    axis = np.array([sine, 0.0, cosine])
    head = np.array([geometry.head_offset, 0.0, geometry.head_height])
    length = geometry.head_offset / sine
    slope = max(OUT, steep)
    shoulder = geometry.stem_tip_z + geometry.stem_length
    out = shoulder - slope * float(body.section(shoulder)[0])
    if out < top - SHOULDER:
        raise GeometryError(
            f"geometry.stem_length: the stem's shoulder, at z = {shoulder:g} mm, is"
            f" {top - out:.0f} mm below the neck cut; lengthen the stem, move it proximally"
            " (stem_tip_z) or cut lower (resection_height)"
        )
    base, slope = (out, slope) if out > top + SHOULDER else (top, steep)
    first, last = 0.5 * geometry.neck_diameter, 0.5 * geometry.trunnion_diameter
    normal = np.array([slope, 0.0, 1.0]) / math.hypot(slope, 1.0)
    # How far the lowest point of a ring is from its centre towards the section below.
    dip = first * math.sqrt(max(0.0, 1.0 - float(axis @ normal) ** 2))
    rise = float(axis @ normal)
    # The neck's axis is in the section that it leaves at this part of its length, or below.
    root_ = head - length * axis
    needed = (CLEAR + dip - float(normal @ (root_ - [0.0, 0.0, base]))) / (rise * length)
    if rise <= 0 or needed > BLEND[1]:
        raise GeometryError(
            f"geometry.head_height: the neck, {geometry.neck_diameter:g} mm thick towards a head"
            f" at z = {geometry.head_height:g} mm, does not clear the neck cut; raise the head"
            " or cut lower (resection_height)"
        )
    part = max(BLEND[0], needed)
    ring = root_ + part * length * axis
    return Neck(ring, head, axis, (first, last)), (base if base > top else None)
