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
from dataclasses import replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.optimize.elementwise import find_root

from app.foundation.arrays import Floats, Ints
from app.foundation.errors import GeometryError
from meshes import femur_bone, femur_stem
from meshes.cad_stem import CadStem
from meshes.femur_bone import PERIOSTEUM
from meshes.layers import DIGITS, Lines, Nodes
from meshes.reference_body import COARSER, ReferenceBody, Segment

TURN = 60.0  # mm below the neck cut over which sections turn to it
CORE = 0.5  # of the canal: where the innermost surface goes below the plug
CORE_OVER = 30.0  # mm that it takes to get there
SPREAD = 0.6  # of the canal: where the outer side of the mantle goes below the plug
CAD_COARSER = 1.4  # as `COARSER`, of stems from CAD, whose shoulders are not convex
VOID = "void"  # where no cells are
DEEP = 2.5  # mm that a shoulder is below the cut at least, or else it is taken to be at it
LEAST_MANTLE = 1.0  # mm of cement for which there must be room
REACH = 90.0  # mm: farther from the axis there is no bone
SIDES = "medially antero-medially anteriorly antero-laterally laterally postero-laterally".split()
SIDES += ["posteriorly", "postero-medially"]
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
        coarser: Size of the reference body inside the stem over that at its surface.
        spared: Part of the largest bend of a bad curved cell up to which edges keep theirs.
        mirrored: Steps whose prisms are split the other way around: there sections turn back.
        tip: Station of the stem's last section.
        told: What was found, in words.
        key: Key that says where the stem is.
        remedy: What to change where it has no room.
    """

    coarser, spared = COARSER, 0.0
    mirrored = range(0)
    key = "geometry"
    remedy = "widen the canal (canal_widening), narrow the stem or move it proximally (stem_tip_z)"

    def __init__(self, geometry: Any, mesh: Any) -> None:
        implant, thickness = geometry.implant, geometry.cement_thickness
        self._implant = implant
        self.mesh, self._placed, self.told = mesh, geometry.placement, list[str]()
        placed = self._placed
        self._top, (self._steepest, self._lean) = placed.top, placed.slopes
        edge = femur_stem.edge(implant, self._steepest)
        self._shoulder = edge if edge < placed.top - DEEP else placed.top
        if stem := getattr(implant, "stem", None):
            ends = implant.stem_tip_z, self._shoulder
            self.spared = 0.9  # shoulder and neck have sharp edges
            self.coarser = CAD_COARSER
            self._body: Any = CadStem(stem.found, ends, placed, mesh)
        else:
            self._body = replace(femur_stem.body(implant), lean=self._lean)
        self._thickness = femur_stem.thickness(thickness, implant.stem_tip_z, placed.top)
        self._mantle = partial(self._body.depth, self._thickness)
        distal = placed.top + (geometry.distal_cut_z - placed.foot[2]) / placed.turn[2, 2]
        self._divide(implant, distal, thickness)
        self._measure(geometry)
        self._refuse()
        self._continue(implant)

    @cached_property
    def _upper(self) -> Any:
        """The stem above the neck cut, or above its shoulder."""
        if isinstance(self._body, CadStem):
            return self._body
        levels = self._shoulder, self._top, self._steepest
        return femur_stem.upper(self._implant, self._body, self.mesh, *levels)

    def _measure(self, geometry: Any) -> None:
        """Take the radii of periosteum and endosteum, in axes that turn with the stem."""
        self._canal = femur_bone.endosteum(geometry)
        self._periosteum = replace(PERIOSTEUM, turn=geometry.anteversion)

    def _divide(self, implant: Any, distal: float, thickness: Any) -> None:
        """Divide the bone from a distal level [mm] to the cut: stations, lines, cells."""
        mesh, plug = self.mesh, implant.stem_tip_z - implant.plug_length
        cad, height = isinstance(self._body, CadStem), implant.tip_height
        self._tip = femur_stem.Tip(implant.stem_tip_z, 0.0 if cad else height, plug)
        below = _distances(mesh, plug - distal, "below")
        flank = self._tip.low + height
        above = _distances(mesh, self._top - flank, "stem")
        if (depth := self._top - self._shoulder) > 0:  # there is a station
            near = above[max(1, int(np.abs(above - depth).argmin()))]
            above = np.interp(above, [0.0, near, above[-1]], [0.0, depth, above[-1]])
        void, start = implant.tip_void, len(below) - 1
        floor, rim = self._tip.rim - void, self._tip.rim
        lengths = 2 * (floor - plug), void, height  # the end may be narrow
        counts = [mesh.steps(length) if length else 0 for length in lengths]
        levels = pairwise((plug, floor, rim))
        inside = [np.linspace(*ends, n + 1)[1:] for ends, n in zip(levels, counts, strict=False)]
        off = 1 - np.arange(1, counts[2] + 1) / max(counts[2], 1)
        round_ = self._tip.axis * np.sin(math.asin(femur_stem.ZONE) * off)
        inside.append(flank - (height * off if cad else round_))
        self._zeta = np.concatenate([(plug - below)[::-1], *inside, (self._top - above)[-2::-1]])
        self._floor, self.tip = start + counts[0], start + counts[0] + counts[1]
        self.mantle = (start, len(self._zeta) - 1)
        self._middle = 0.25 * implant.stem_tip_z + 0.75 * self._top
        self.around = mesh.lines_around(self._body.section(self._middle))
        self._body = self._body.divided(self._middle, self.around)
        self.through, self.cement = mesh.cells_through(thickness), mesh.along_cement(thickness)

    @property
    def cut(self) -> int:
        """Station of the neck cut."""
        return self.mantle[1]

    def _continue(self, implant: Any) -> None:
        """Divide the stem above the cut."""
        bone = ("cancellous_bone", "cortical_bone")
        segments = (
            Segment(self.mantle[0], ("cancellous_bone", "cancellous_bone", *bone)),
            Segment(self._floor - self.mantle[0], ("cement", "cement", *bone)),
            Segment(self.tip - self._floor, (VOID, "cement", *bone)),
            Segment(self.cut - self.tip, ("stem", "cement", *bone)),
            Segment(self._upper.ends[-1], ("stem",)),
        )
        self.segments = tuple(segment for segment in segments if segment.steps)

    def to_model(self, x: Floats) -> Floats:
        """Points in the stem's axes (n, 3) in those of the model [mm]."""
        return np.asarray(self._placed.to_model(x))

    def outline(self) -> Floats:
        """Section of the stem, a quarter of its way from cut to tip (around, 2) [mm]."""
        x = self._body.point(np.arange(self.around) / self.around, self._middle, 0.0)
        return np.round(x[:, :2], DIGITS)

    def plane(self, s: Floats) -> tuple[Floats, Floats]:
        """Height at the axis [mm] and slope of the sections at stations s <= cut."""
        zeta = np.interp(s, np.arange(len(self._zeta)), self._zeta)
        return zeta, self._slope(zeta)

    def _slope(self, zeta: Floats) -> Floats:
        """Slope of the sections at heights on the axis."""
        t = np.clip((zeta - self._shoulder + TURN) / TURN, 0.0, 1.0)
        return np.asarray(self._steepest * t * t * (2 - t))

    def lines(self, phi: Floats, s: Floats) -> Lines:
        """Lines at angles `phi` [turns] and stations `s` (n,); above the cut the stem's alone."""
        lines = self._across(phi, np.minimum(s, self.cut))
        if (s > self.cut).any():
            self._beyond(lines, phi, s)
        return lines

    def _beyond(self, lines: Lines, phi: Floats, s: Floats) -> None:
        """Replace the lines above the cut."""
        above = s > self.cut
        lines.start[above] = self._upper.points(phi[above], s[above] - self.cut)
        lines.end[above] = lines.start[above] + 1.0
        lines.mantle[above], lines.endosteum[above] = 0.3, 0.6

    def ended(self, nodes: Nodes, number: Ints, body: ReferenceBody) -> tuple[Nodes, Ints]:
        """Hang the nodes inside sections of the plug; nodes, and what stands for each."""
        x, first = nodes.x.copy(), self.mantle[0]
        plug = (nodes.rho == 0) & (nodes.s > 2 * first) & (nodes.s <= 2 * self.tip)
        x[plug] = self.hung(x[plug], self.plane(nodes.s[plug] / 2)[0])
        return replace(nodes, x=x), number

    def hung(self, x: Floats, z: Floats) -> Floats:
        """Points (n, 3) inside sections at levels z, moved onto the bowls in them [mm]."""
        if not self._tip.height:
            return x
        theta = np.arctan2(x[:, 1], x[:, 0])
        part = np.hypot(x[:, 0], x[:, 1]) / (self._body.radius(theta, z) * self._tip.width(z))
        hung = np.column_stack([x[:, :2], z - self._tip.bulge(part, z)])
        return np.asarray(np.round(hung, DIGITS))

    def arc(self, a: Floats, b: Floats) -> Floats:
        """Middles of edges from a to b (n, 3) in the shell of a ball (n, 3)."""
        return 0.5 * (a + b)

    def _across(self, phi: Floats, s: Floats) -> Lines:
        """Lines at stations up to the cut."""
        zeta, slope = self.plane(s)
        theta = 2 * np.pi * phi
        end = self._ends(theta, zeta, slope)
        below = s < self.mantle[0]
        at = np.where(below, float(self.mantle[0]), s)
        z, tilt = self.plane(at)
        start = self._outline(phi, z, tilt)
        depth = np.where(below, self._zeta[self.mantle[0]] - zeta, 0.0)
        start = self._sink(start, theta, zeta, depth)
        endosteum = self._meets(self._inside, zeta, start, end)
        mantle = np.empty(len(s))
        mantle[~below] = self._covered(zeta[~below], start[~below], end[~below])
        if below.any():
            # The mantle's outer side goes on below the plug from where it is at its end.
            first = self._across(phi[below], at[below])
            ratio = first.mantle / first.endosteum
            ratio += (SPREAD - ratio) * np.minimum(1.0, depth[below] / (4 * self.mesh.step_along))
            mantle[below] = ratio * endosteum[below]
        return Lines(start, end, mantle, endosteum)

    def _outline(self, phi: Floats, zeta: Floats, slope: Floats) -> Floats:
        """Points of the stem's outline in sections (n, 3) [mm]."""
        x = self._body.point(phi, zeta, slope) * [[1.0, 1.0, 0.0]] * self._tip.width(zeta)[:, None]
        over = zeta > self._shoulder
        if over.any() and isinstance(self._body, femur_stem.Body):
            x[over] = self._upper.point(phi[over], zeta[over])
        x[:, 2] = zeta - slope * (x[:, 0] + self._lean * x[:, 1])
        return np.asarray(x)

    def _sink(self, start: Floats, theta: Floats, zeta: Floats, depth: Floats) -> Floats:
        """Points of the innermost surface below the plug, scaled to a part of the canal."""
        r = CORE * self._canal(theta, zeta)
        core = np.stack([r * np.cos(theta), r * np.sin(theta)], axis=1)
        part = np.clip(depth / CORE_OVER, 0.0, 1.0)[:, None]
        x = start.copy()
        x[:, :2] = (1 - part) * start[:, :2] + part * core
        x[:, 2] -= depth
        return x

    def _ends(self, theta: Floats, zeta: Floats, slope: Floats) -> Floats:
        """Points of the periosteum in sections (n, 3) [mm]."""
        c, d = np.cos(theta), np.sin(theta)
        r = root(
            lambda r, k: self._periosteum.radius(theta[k], zeta[k] - slope[k] * r * c[k]) - r,
            np.full(len(theta), REACH),
        )
        return np.stack([r * c, r * d, zeta - slope * r * c], axis=1)

    def _covered(self, zeta: Floats, start: Floats, end: Floats, more: float = 0.0) -> Floats:
        """Fraction of lines, from the stem's outline to the end (n, 3), that is in the mantle (n,).

        Above the shoulder it takes what it and the body would take if they went on to the cut, and
        has its thickness, along the lines, on the neck.
        """
        way, own = end - start, np.full(len(zeta), -np.inf)
        length = np.sqrt((way**2).sum(axis=1))
        if isinstance(self._body, femur_stem.Body) and (over := zeta > self._shoulder).any():
            x, y, z = start[over].T
            own[over] = self._thickness(np.arctan2(y, x), z)

        def within(part: Floats, k: Ints) -> Floats:
            depth = self._mantle(start[k] + part[:, None] * way[k])
            return np.asarray(np.maximum(depth, own[k] - part * length[k]) + more)

        return root(within, np.ones(len(start)))

    def _inside(self, x: Floats, zeta: Floats) -> Floats:
        """Depth of points (n, 3) in sections at heights (n,) within the endosteum [mm]."""
        return self._within(self._canal, x)

    @staticmethod
    def _meets(
        depth: Callable[[Floats, Floats], Floats], zeta: Floats, start: Floats, end: Floats
    ) -> Floats:
        """Fraction of lines, from start to end (n, 3), at which they leave a surface (n,).

        ``depth`` is that of points (k, 3), in sections at heights (k,), within it [mm].
        """
        way = end - start

        def within(part: Floats, k: Ints) -> Floats:
            return depth(start[k] + part[:, None] * way[k], zeta[k])

        return root(within, np.ones(len(start)))

    def _within(self, radius: Callable[[Floats, Floats], Floats], points: Floats) -> Floats:
        """Depth of points inside a surface r(theta, z), across the z axis (n,) [mm]."""
        x, y, z = points.T
        return radius(np.arctan2(y, x), z) - np.hypot(x, y)

    def _refuse(self) -> None:
        """Raise GeometryError where the stem has no room for cement."""
        along, around = np.linspace(self.tip, self.cut, 90), np.arange(72) / 72
        phi, s = (v.ravel() for v in np.meshgrid(around, along))
        lines, zeta = self._across(phi, s), self.plane(s)[0]
        inside = self._inside(lines.start, zeta)
        room = np.where(inside > 0, lines.endosteum * lines.length, inside)
        worst = int(np.nanargmin(room))  # no number where the axis is outside of the bone
        if (least := room[worst]) >= LEAST_MANTLE:
            self._check(lines)
            return
        x = self._placed.to_model(lines.start[worst])
        out = x - self._placed.to_model([0.0, 0.0, zeta[worst]])
        side = SIDES[round(8 * np.arctan2(out[1], out[0]) / (2 * np.pi)) % 8]
        missing = _rounded_up(LEAST_MANTLE - least)
        text = (
            f"leaves {LEAST_MANTLE - missing:.2g} mm for cement, of {LEAST_MANTLE:g} mm at least,"
        )
        if least < 0:
            text = f"cuts {_rounded_up(-least):.2g} mm into the cortex"
        where = f"{side} at {self._placed.where(x)}"
        needed = f"{missing:.2g} mm more are needed there"
        raise GeometryError(f"{self.key}: the stem {text} {where}; {self.remedy}; {needed}")

    def _check(self, lines: Lines) -> None:
        """Refuse lines that meet bone twice."""
        start, end = lines.start, lines.end
        for name, radius in (("periosteum", self._periosteum.radius), ("endosteum", self._canal)):
            inside = np.array([self._within(radius, start + part * (end - start)) for part in WAYS])
            twice = np.flatnonzero(((inside[1:] > 0) != (inside[:-1] > 0)).sum(axis=0) > 1)
            if len(twice):
                x = self._placed.where(self._placed.to_model(start[twice[0]]))
                raise GeometryError(
                    f"geometry: a line across the bone from {x} meets the {name} more than once;"
                    " sections must be star-shaped about the stem"
                )


def _rounded_up(length: float) -> float:
    """Length rounded up to a tenth, below that to a hundredth: never zero [mm]."""
    parts = 10 if length > 0.1 else 100
    return math.ceil(parts * length) / parts


def _distances(mesh: Any, length: float, part: str) -> Floats:
    """Distances from 0 to a length in the steps of a mesh that grow [mm]."""
    at, count, step = mesh.graded(length, part)
    every = np.concatenate([at, at[-1] + step * np.arange(1, count + 1)])
    return np.asarray(every * length / every[-1])
