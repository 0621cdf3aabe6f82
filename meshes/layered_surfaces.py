"""The nested surfaces of a femur with a stem, along lines across it, and their grid.

The neck cut is the section at station ``cut`` (`layers.Sections`). On each section a line runs from
a point of the stem's outline to the periosteum; along it lie the outer side of the mantle and the
endosteum. Cement is what is inside the lesser of the two. A stem without cement has no mantle: it
is exact, and where it reaches into the cortex the endosteum is its surface. Above the cut the stem
goes on alone: its body where it stands out, then a blend to the round neck and a cone to the
trunnion. A collar lies on the cut, around medial: there the lines of the bone go on through it.

Three parts answer: the stem in its mantle (`StemWithMantle`), the bone (`bone_layers`), and the
sections in which both are.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints
from app.foundation.errors import GeometryError
from app.foundation.implant import Implant
from app.foundation.layout import two_digits
from meshes import femur_stem
from meshes.bone_layers import BoneLayers
from meshes.cad_stem import CadStem, outline_length
from meshes.femur_stem import StemAboveCut
from meshes.layers import DIGITS_OF_NODES, Lines, Nodes, Sections, root
from meshes.placement import LEAST_SHOULDER_DEPTH
from meshes.reference_body import COARSENING_OF_CORE, ReferenceBody, Segment

if TYPE_CHECKING:
    from app.case.hips import Hip
    from app.case.shapes import MeshOptions

MANTLE_BELOW_PLUG = 0.6  # of the canal: where the outer side of the mantle goes below the plug
CAD_COARSER = 1.4  # as `COARSENING_OF_CORE`, of stems from CAD, whose shoulders are not convex
CAD_SPARED = 0.9  # as `LayeredSurfaces.spared`, of stems from CAD: their edges are sharp
VOID = "void"  # where no cells are
COLLAR = "collar"
COLLAR_SEARCH = 20  # places for each station at which the height of a collar's top is searched
COLLAR_CELL = 2.0  # of the height of cells of a collar over the distance of lines around: largest
STATION_SPACING = 0.3  # of a step above the neck cut: no station is nearer to the top of a collar
EDGE_DISTANCE = 0.02  # mm from a parabola at which the outline of a stem has an edge along
EDGE_LINES = 96  # lines on which edges along are searched
EDGE_SAMPLES = 16  # parts of a step in which an edge is searched
SHORTEST_STEP = 0.125  # shortest step at an edge over the largest step along the stem
LEAST_MANTLE = 1.0  # mm of cement for which there must be room
UNREPORTED_CORTEX = 0.05  # mm of cortex that a stem may take unreported
LEAST_CORTEX = 1.5  # mm of cortex that a stem without cement must leave where it takes some
SIDES_OF_STEM = (
    "medially",
    "antero-medially",
    "anteriorly",
    "antero-laterally",
    "laterally",
    "postero-laterally",
    "posteriorly",
    "postero-medially",
)


class StemWithMantle:
    """The stem and its mantle, if it has one, in sections, in the stem's axes.

    Attributes:
        shoulder: Height at the axis of the section at the shoulder, or of the cut [mm].
        plug: Height of the end of the cement plug [mm]. Without cement the outline ends there.
        is_cemented: True if there is a mantle.
        tip: The stem's end.
        middle: Height of the section where lines are counted [mm].
        around: Number of lines around.
        shaft: The stem below the cut.
        is_cad: True if it is from a file.
    """

    def __init__(self, geometry: Hip, mesh: MeshOptions) -> None:
        implant, placement = geometry.implant, geometry.placement
        self._implant, self._placement, self._mesh = implant, placement, mesh
        self.plug, self.is_cemented = implant.plug, geometry.is_cemented
        edge_height = femur_stem.shoulder_plane_height(implant, placement.slopes[0])
        self.shoulder = (
            edge_height if edge_height < placement.top - LEAST_SHOULDER_DEPTH else placement.top
        )
        self.is_cad = implant.cad is not None
        height = 0.0 if self.is_cad else implant.tip_height
        self.tip = femur_stem.Tip(implant.tip_z, height, self.plug)
        if implant.cad is not None:
            levels = implant.tip_z, self.shoulder
            shaft: Any = CadStem(implant.cad, levels, placement, mesh, implant.collar_thickness)
        else:
            shaft = replace(femur_stem.shaft_of(implant), lean=placement.slopes[1])
        self.middle = 0.25 * implant.tip_z + 0.75 * placement.top
        self.around = mesh.lines_around(shaft.section(self.middle), geometry.cement_thickness)
        self.shaft = shaft.divided(self.middle, self.around)
        self._thickness = femur_stem.thickness(
            geometry.cement_thickness, implant.tip_z, placement.top
        )

    @cached_property
    def upper(self) -> StemAboveCut | CadStem:
        """The stem above the neck cut, or above its shoulder."""
        if self.is_cad:
            return self.shaft
        levels = self.shoulder, self._placement.top, self._placement.slopes[0]
        return femur_stem.stem_above_cut(self._implant, self.shaft, self._mesh, *levels)

    def outline(self, phi: Floats, sections: Sections, zeta: Floats) -> Floats:
        """Points of the stem's outline at angles [turns] in sections at heights (n, 3) [mm]."""
        x = self.shaft.point(phi, zeta, sections.slope(zeta))[:, :2]
        x = x * self.tip.width(zeta)[:, None]
        above = zeta > self.shoulder
        if above.any() and isinstance(self.upper, StemAboveCut):
            x[above] = self.upper.point(phi[above], zeta[above])[:, :2]
        return sections.in_plane(x, zeta)

    def covered(self, zeta: Floats, start: Floats, end: Floats, oversize: float = 0.0) -> Floats:
        """Fraction of lines, from the stem's outline to the end (n, 3), that is in the mantle (n,).

        0 without cement. Above the shoulder it takes what it and the shaft would take if they went
        on to the cut, and has its thickness, along the lines, on the neck.
        """
        if not self.is_cemented:
            return np.zeros(len(zeta))
        direction, on_neck = end - start, np.full(len(zeta), -np.inf)
        length = np.sqrt((direction**2).sum(axis=1))
        is_above = zeta > self.shoulder
        if is_above.any() and not self.is_cad:
            x, y, z = start[is_above].T
            on_neck[is_above] = self._thickness(np.arctan2(y, x), z)

        def depth_in_mantle(fraction: Floats, k: Ints) -> Floats:
            depth = self.shaft.depth(self._thickness, start[k] + fraction[:, None] * direction[k])
            return np.asarray(np.maximum(depth, on_neck[k] - fraction * length[k]) + oversize)

        return root(depth_in_mantle, np.ones(len(start)))

    def draped(self, x: Floats, z: Floats) -> Floats:
        """Points (n, 3) inside sections at levels z, moved onto the bowls in them [mm]."""
        if not self.tip.height:
            return x
        theta = np.arctan2(x[:, 1], x[:, 0])
        share = np.hypot(x[:, 0], x[:, 1]) / (self.shaft.radius(theta, z) * self.tip.width(z))
        draped_points = np.column_stack([x[:, :2], z - self.tip.bulge(share, z)])
        return np.asarray(np.round(draped_points, DIGITS_OF_NODES))


class LayeredSurfaces:
    """Nested surfaces of an operated femur as functions of angle and station, and their grid.

    Attributes:
        mesh: Mesh options of the case.
        stem: The stem in its mantle.
        sections: The planes up to the neck cut, one for each station.
        bone: Periosteum and endosteum in them.
        notes: Bone that a stem without cement takes and leaves, in words.
        innermost: Number of the innermost surface: 1, or 2 without a mantle (`layers`).
        through: Cells through each layer, at most.
        cement: Cells through the first layer; a fraction is the part, from the cut down, with one
            more.
        segments: Segments of the reference body, from below.
        mantle_stations: First and last station with a mantle. Where mantle and endosteum are one
            there, they are so at stations below and above, too. Without cement: stations with the
            outline of the stem.
        coarser: Size of the reference body inside the stem over that at its surface.
        spared: Part of the largest bend of a bad curved cell up to which edges keep theirs.
        mirrored: Steps whose prisms are split the other way around: there sections turn back.
        tip: Station of the stem's last section.
        collar: Stations of the neck cut and of the collar's top; the same without a collar.
    """

    coarser, spared = COARSENING_OF_CORE, 0.0
    mirrored = range(0)

    def __init__(self, geometry: Hip, mesh: MeshOptions) -> None:
        self.mesh, self._placement = mesh, geometry.placement
        self._geometry = geometry
        self.notes = list[str]()
        self.stem = StemWithMantle(geometry, mesh)
        self.innermost = 1 if self.stem.is_cemented else 2
        if self.stem.is_cad:
            self.spared = CAD_SPARED
            self.coarser = CAD_COARSER
        through = mesh.cells_through(geometry.cement_thickness)
        self.through: tuple[int, ...] = through if self.stem.is_cemented else through[1:]
        self.cement = mesh.along_cement(geometry.cement_thickness)
        zeta = self._station_heights(geometry.implant, self._placement.along(geometry.level))
        self.sections = Sections(self._placement, self.stem.shoulder, self.stem.plug, zeta)
        self.bone: BoneLayers = geometry.femur.layers(geometry, self.sections, self.stem)
        self._refuse()
        self._divide_above_cut(geometry.implant)

    @property
    def around(self) -> int:
        """Number of lines around."""
        return self.stem.around

    @property
    def cut(self) -> int:
        """Station of the neck cut."""
        return self.mantle_stations[1]

    def _station_heights(self, implant: Implant, distal: float) -> Floats:
        """Heights of the stations from a distal level to the cut (n,) [mm]; where parts begin."""
        mesh, tip, plug = self.mesh, self.stem.tip, self.stem.plug
        top, height = self._placement.top, implant.tip_height
        distances_below = _distances(mesh, plug - distal, "below")
        flank = tip.low + height
        distances_above = _distances(mesh, top - flank, "stem")
        depth = top - self.stem.shoulder
        if depth > 0:  # there is a station
            station_depth = distances_above[max(1, int(np.abs(distances_above - depth).argmin()))]
            distances_above = np.interp(
                distances_above,
                [0.0, station_depth, distances_above[-1]],
                [0.0, depth, distances_above[-1]],
            )
        if self.stem.is_cad:
            distances_above = top - self._with_heights_at_edges(top - distances_above)
        void_length, start = implant.tip_void, len(distances_below) - 1
        floor_level = tip.rim - void_length
        lengths = 2 * (floor_level - plug), void_length, height  # the end may be narrow
        counts = [mesh.steps(length) if length else 0 for length in lengths]
        levels = pairwise((plug, floor_level, tip.rim))
        inner_heights = [
            np.linspace(*ends, count + 1)[1:] for ends, count in zip(levels, counts, strict=False)
        ]
        tip_fractions = 1 - np.arange(1, counts[2] + 1) / max(counts[2], 1)
        if self.stem.is_cad:
            inner_heights.append(flank - height * tip_fractions)
        else:
            inner_heights.append(
                flank - tip.axis * np.sin(math.asin(femur_stem.RIM_SINE) * tip_fractions)
            )
        zeta = np.concatenate(
            [(plug - distances_below)[::-1], *inner_heights, (top - distances_above)[-2::-1]]
        )
        self._floor, self.tip = start + counts[0], start + counts[0] + counts[1]
        self.mantle_stations = (start, len(zeta) - 1)
        return zeta

    def _with_heights_at_edges(self, heights: Floats) -> Floats:
        """Heights of stations (n,) with more where the outline of the stem has edges along [mm].

        An edge, as at the foot of the neck or at a shoulder, is known by the distance of outlines
        from parabolas through the first, the middle and the last one of a step. A step is divided
        where this leaves the least distance.
        """
        sections = Sections(self._placement, self.stem.shoulder, self.stem.plug, heights)
        phi = np.arange(EDGE_LINES) / EDGE_LINES

        def outlines(levels: Floats) -> Floats:
            zeta = np.repeat(levels, EDGE_LINES)
            points = self.stem.outline(np.tile(phi, len(levels)), sections, zeta)
            return points[:, :2].reshape(len(levels), EDGE_LINES, 2)

        def divided(start: float, end: float, steps: int) -> list[float]:
            levels = np.linspace(start, end, steps + 1, dtype=float)
            x = outlines(levels)
            if _distance_from_parabola(x) < EDGE_DISTANCE or abs(end - start) < 2 * shortest_step:
                return [end]
            if steps < EDGE_SAMPLES:
                return divided(start, end, EDGE_SAMPLES)
            least = math.ceil(EDGE_SAMPLES * shortest_step / abs(end - start))
            splits = [k for k in range(2, steps, 2) if least <= k <= steps - least]
            worst_after = [
                max(_distance_from_parabola(x[: k + 1]), _distance_from_parabola(x[k:]))
                for k in splits
            ]
            if not splits:
                return [end]
            split = float(levels[splits[int(np.argmin(worst_after))]])
            return divided(start, split, EDGE_SAMPLES) + divided(split, end, EDGE_SAMPLES)

        shortest_step = self.mesh.step_along * SHORTEST_STEP
        all_heights = [float(heights[0])]
        for start, end in pairwise(heights):
            all_heights += divided(float(start), float(end), 4)
        return np.array(all_heights)

    def _divide_above_cut(self, implant: Implant) -> None:
        """Divide the stem above the cut."""
        bone = ("cancellous_bone", "cortical_bone")
        steps = self._set_stations_above_cut(implant)
        on_cut = Segment(self.collar[1] - self.cut, ("stem", *[COLLAR] * len(self.through)))
        upper = Segment(steps, ("stem",))
        segments: tuple[Segment, ...]
        if self.stem.is_cemented:
            segments = (
                Segment(self.mantle_stations[0], ("cancellous_bone", "cancellous_bone", *bone)),
                Segment(self._floor - self.mantle_stations[0], ("cement", "cement", *bone)),
                Segment(self.tip - self._floor, (VOID, "cement", *bone)),
                Segment(self.cut - self.tip, ("stem", "cement", *bone)),
                on_cut,
                upper,
            )
        else:
            segments = (
                Segment(self._floor, ("cancellous_bone", *bone)),
                Segment(self.tip - self._floor, (VOID, *bone)),
                Segment(self.cut - self.tip, ("stem", *bone)),
                on_cut,
                upper,
            )
        self.segments = tuple(segment for segment in segments if segment.steps)

    def _set_stations_above_cut(self, implant: Implant) -> int:
        """Set the stations above the cut, and return the number of steps above the collar.

        Raises:
            GeometryError: The stem has no room for its collar.
        """
        last = self.stem.upper.ends[-1]
        self.collar = (self.cut, self.cut)
        self._stations = np.arange(last + 1.0)
        thickness = implant.collar_thickness
        if not thickness:
            return last
        line_distance = outline_length(self.outline()) / self.around
        steps = max(self.mesh.steps(thickness), round(thickness / (COLLAR_CELL * line_distance)))
        # The station of the stem alone that is as high above the cut, around medial in the mean.
        on_cut = self._medial_points(0.0)
        stations, heights = [0.0], [0.0]
        for station in np.arange(1, COLLAR_SEARCH * last + 1) / COLLAR_SEARCH:
            if heights[-1] >= thickness:
                break
            above_cut = (self._medial_points(station) - on_cut) @ self.normal
            stations.append(station)
            heights.append(float(above_cut.mean()))
        if heights[-1] < thickness:
            raise GeometryError("geometry.stem.collar.thickness: the collar is above the head")
        top_station = float(np.interp(thickness, heights, stations))
        next_station = math.ceil(top_station + STATION_SPACING)
        self._stations = np.concatenate(
            [np.linspace(0.0, top_station, steps + 1), np.arange(next_station, last + 1.0)]
        )
        self.collar = (self.cut, self.cut + steps)
        return len(self._stations) - 1 - steps

    def _medial_points(self, station: float) -> Floats:
        """Points of the stem around medial at a station from the cut on (9, 3) [mm]."""
        return self.stem.upper.points(np.linspace(-0.1, 0.1, 9) % 1.0, np.full(9, station))

    @property
    def normal(self) -> Floats:
        """Unit normal of the neck cut in the stem's axes (3,)."""
        return self._placement.normal @ self._placement.rotation

    @property
    def spans(self) -> Ints:
        """Numbers of the sectors below the collar; sector k is between lines k and k + 1."""
        each_side = round(self.around * self._geometry.implant.collar_angle / (4 * math.pi))
        each_side = min(max(each_side, 1), (self.around - 1) // 2)
        return np.arange(-each_side, each_side) % self.around

    def is_left_out(self, body: ReferenceBody) -> Bools:
        """True for prisms of the reference body that are no part of the model (p,)."""
        names = np.array(body.names)[body.region]
        # A prism of a ring is between a line and the next: the first one is that of its space.
        line = np.sort(body.columns // len(body.rho), axis=1)[:, [0, -1]]
        first = np.where(line[:, 1] - line[:, 0] > 1, line[:, 1], line[:, 0])
        is_beside_collar = (names == COLLAR) & ~np.isin(first, self.spans)
        return np.asarray((names == VOID) | is_beside_collar)

    def to_model(self, x: Floats) -> Floats:
        """Points in the stem's axes (n, 3) in those of the model [mm]."""
        return self._placement.to_model(x)

    def outline(self) -> Floats:
        """Section of the stem, a quarter of its way from cut to tip (around, 2) [mm]."""
        x = self.stem.shaft.point(np.arange(self.around) / self.around, self.stem.middle, 0.0)
        return np.round(x[:, :2], DIGITS_OF_NODES)

    def heights(self, s: Floats) -> Floats:
        """Heights at the axis of the sections at stations s <= cut (n,) [mm]."""
        zeta = self.sections.zeta
        return np.interp(s, np.arange(len(zeta)), zeta)

    def lines(self, phi: Floats, s: Floats) -> Lines:
        """Lines at angles `phi` [turns] and stations `s` (n,); above the cut the stem's alone."""
        lines = self._lines_to_cut(phi, np.minimum(s, self.cut))
        if (s > self.cut).any():
            self._replace_above_cut(lines, phi, s)
        return lines

    def _replace_above_cut(self, lines: Lines, phi: Floats, s: Floats) -> None:
        """Replace the lines above the cut; in the collar they go on from those at the cut."""
        is_above = s > self.cut
        stations = np.interp(s[is_above] - self.cut, np.arange(len(self._stations)), self._stations)
        lines.start[is_above] = self.stem.upper.points(phi[is_above], stations)
        above_collar = s > self.collar[1]
        lines.end[above_collar] = lines.start[above_collar] + 1.0
        lines.mantle[above_collar], lines.endosteum[above_collar] = 0.3, 0.6
        in_collar = is_above & ~above_collar
        if in_collar.any():
            steps = self.collar[1] - self.cut
            height = (s[in_collar] - self.cut) * self._geometry.implant.collar_thickness / steps
            lines.end[in_collar] += height[:, None] * self.normal

    def place_end_nodes(
        self, nodes: Nodes, number: Ints, body: ReferenceBody
    ) -> tuple[Nodes, Ints]:
        """Drape the interior nodes of the plug over the bowl.

        Returns:
            The nodes, and the number of the representative of each.
        """
        x, mantle_start = nodes.x.copy(), self.mantle_stations[0]
        plug = (nodes.rho == 0) & (nodes.s > 2 * mantle_start) & (nodes.s <= 2 * self.tip)
        x[plug] = self.stem.draped(x[plug], self.heights(nodes.s[plug] / 2))
        return replace(nodes, x=x), number

    def arc(self, a: Floats, b: Floats) -> Floats:
        """Middles of edges from a to b (n, 3) in the shell of a ball (n, 3)."""
        return 0.5 * (a + b)

    def _lines_to_cut(self, phi: Floats, s: Floats) -> Lines:
        """Lines at stations up to the cut."""
        zeta, theta = self.heights(s), 2 * np.pi * phi
        end = self.bone.ends(theta, zeta)
        is_below = s < self.mantle_stations[0]
        # Below the plug lines start from the outline that the stem has at the plug's end.
        start_stations = np.where(is_below, float(self.mantle_stations[0]), s)
        start = self.stem.outline(phi, self.sections, self.heights(start_stations))
        start = self.bone.core(start, theta, zeta)
        direction = end - start

        def depth_in_canal(fraction: Floats, k: Ints) -> Floats:
            return self.bone.depth(start[k] + fraction[:, None] * direction[k], zeta[k])

        if not self.stem.is_cemented:
            # Where the stem is in the cortex, the endosteum is its surface.
            rows = np.flatnonzero(self.bone.depth(start, zeta) > 0)
            within_canal = np.zeros(len(s))
            within_canal[rows] = root(
                lambda fraction, k: depth_in_canal(fraction, rows[k]), np.ones(len(rows))
            )
            return Lines(start, end, np.zeros(len(s)), within_canal)
        endosteum = root(depth_in_canal, np.ones(len(start)))
        mantle = np.empty(len(s))
        mantle[~is_below] = self.stem.covered(zeta[~is_below], start[~is_below], end[~is_below])
        if is_below.any():
            # The mantle's outer side goes on below the plug from where it is at its end.
            lines_at_plug = self._lines_to_cut(phi[is_below], start_stations[is_below])
            ratio = lines_at_plug.mantle / lines_at_plug.endosteum
            depth = self.stem.plug - zeta[is_below]
            ratio += (MANTLE_BELOW_PLUG - ratio) * np.minimum(
                1.0, depth / (4 * self.mesh.step_along)
            )
            mantle[is_below] = ratio * endosteum[is_below]
        return Lines(start, end, mantle, endosteum)

    def _along_stem(self) -> tuple[Lines, Floats]:
        """Lines from the tip to the cut, and the heights of their sections (n,) [mm]."""
        stations, turns = np.linspace(self.tip, self.cut, 90), np.arange(72) / 72
        phi, s = (v.ravel() for v in np.meshgrid(turns, stations))
        return self._lines_to_cut(phi, s), self.heights(s)

    def _side(self, x: Floats, zeta: float) -> str:
        """Side of the stem's axis on which a point (3,) of a section is, and its place."""
        x = self._placement.to_model(x)
        offset = x - self._placement.to_model([0.0, 0.0, zeta])
        side = SIDES_OF_STEM[round(8 * np.arctan2(offset[1], offset[0]) / (2 * np.pi)) % 8]
        return f"{side} at {self._placement.point_in_words(x)}"

    def _refuse(self) -> None:
        """Raise GeometryError where the stem has no room for cement, or leaves too little bone."""
        if self.stem.is_cemented:
            self._refuse_narrow()
        else:
            self._refuse_thin()

    def _refuse_thin(self) -> None:
        """Raise GeometryError where a stem without cement leaves too little of the cortex."""
        lines, zeta = self._along_stem()
        cortex_taken = -self.bone.depth(lines.start, zeta)
        # The stem is outside of the bone where the way to the periosteum leads back to the axis.
        is_outside = ((lines.end - lines.start)[:, :2] * lines.end[:, :2]).sum(axis=1) < 0
        cortex_left = np.where(is_outside, -1.0, 1.0) * lines.length
        if not cortex_taken.max() > UNREPORTED_CORTEX:
            self.bone.check(lines.start, lines.end)
            return
        thinnest = int(np.where(cortex_taken > UNREPORTED_CORTEX, -cortex_left, -np.inf).argmax())
        location = self._side(lines.start[thinnest], zeta[thinnest])
        if cortex_left[thinnest] >= LEAST_CORTEX:
            self.bone.check(lines.start, lines.end)
            self.notes.append(
                f"the stem takes up to {cortex_taken.max():.1f} mm of the cortex and leaves, in the"
                f" section, at least {cortex_left[thinnest]:.1f} mm there, {location}"
            )
            return
        finding = (
            f"leaves {two_digits(cortex_left[thinnest])} mm of the cortex"
            f" (least: {LEAST_CORTEX:g} mm)"
        )
        if cortex_left[thinnest] <= 0:
            finding = f"is {two_digits(_rounded_up(-cortex_left[thinnest]))} mm outside the bone"
        key, _ = self._geometry.more_room
        raise GeometryError(f"{key}: the stem {finding} {location}; use a smaller stem, or move it")

    def _refuse_narrow(self) -> None:
        """Raise GeometryError where the stem has no room for cement."""
        lines, zeta = self._along_stem()
        canal_depth = self.bone.depth(lines.start, zeta)
        room = np.where(canal_depth > 0, lines.endosteum * lines.length, canal_depth)
        narrowest = int(np.nanargmin(room))  # no number where the axis is outside of the bone
        least_room = room[narrowest]
        if least_room >= LEAST_MANTLE:
            self.bone.check(lines.start, lines.end)
            return
        missing_room = _rounded_up(LEAST_MANTLE - least_room)
        finding = (
            f"leaves {two_digits(LEAST_MANTLE - missing_room)} mm for cement"
            f" (least: {LEAST_MANTLE:g} mm)"
        )
        if least_room < 0:
            finding = f"cuts {two_digits(_rounded_up(-least_room))} mm into the cortex"
        key, remedy = self._geometry.more_room
        location = self._side(lines.start[narrowest], zeta[narrowest])
        missing_text = f"{two_digits(missing_room)} mm more are needed there"
        raise GeometryError(f"{key}: the stem {finding} {location}; {remedy}; {missing_text}")


@lru_cache(maxsize=2)
def cached_surfaces(geometry: Hip, mesh: MeshOptions, files: str) -> LayeredSurfaces:
    """Return the surfaces of a patient. With a stem from CAD they take some seconds."""
    return LayeredSurfaces(geometry, mesh)


def _distance_from_parabola(x: Floats) -> float:
    """Largest distance, normal to them, of outlines from a parabola through three of them [mm].

    The outlines (2 n + 1, m, 2) are equally far apart; the three are first, middle and last.
    """
    t = np.linspace(0.0, 1.0, len(x))
    shapes = np.array([(1 - t) * (1 - 2 * t), 4 * t * (1 - t), t * (2 * t - 1)])
    parabola = np.einsum("ik,ijl->kjl", shapes, x[[0, len(x) // 2, -1]])
    along_x, along_y = np.moveaxis(np.roll(x, -1, axis=1) - np.roll(x, 1, axis=1), -1, 0)
    normal = np.stack([along_y, -along_x], axis=-1) / np.hypot(along_x, along_y)[..., None]
    return float(np.abs(((parabola - x) * normal).sum(axis=-1)).max())


def _rounded_up(length: float) -> float:
    """Length rounded up to a tenth, below that to a hundredth: never zero [mm]."""
    fractions = 10 if length > 0.1 else 100
    return math.ceil(fractions * length) / fractions


def _distances(mesh: MeshOptions, length: float, part: str) -> Floats:
    """Distances from 0 to a length in the steps of a mesh that grow [mm]."""
    growing, count, step = mesh.graded(length, part)
    all_distances = np.concatenate([growing, growing[-1] + step * np.arange(1, count + 1)])
    return np.asarray(all_distances * length / all_distances[-1])
