"""A proximal femur before the operation: cortical bone around cancellous bone, with head and neck.

Shaft, trochanters, canal and muscle patches are those of the femur with a stem, cell by cell: the
lines are those of the planned stem (`layered_surfaces`). The part that the operation removes is a
blend from the neck cut to a round neck, and a sphere about the head's centre. The nodes of the
sphere are on no lines: it is a ball of bulging sections in a shell, which a lid closes at its end.

No published set of dimensions goes with this shaft. Assumed are:

* a round neck, rotated as the implant. In its middle it has 0.70 of the head's diameter (means are
  48 and 33 mm in men, not verified);
* a cortex of 2 mm under the head and 3.5 mm at the root of the neck, the same all around (it is
  thicker below and thinner above);
* no cartilage, no fovea, and a round trochanter.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.foundation.implant import Implant
from meshes import swept
from meshes.data import MeshData
from meshes.femur import assembled
from meshes.layered_surfaces import LEAST_MANTLE, MANTLE_BELOW_PLUG, LayeredSurfaces
from meshes.layers import DIGITS_OF_NODES, Lines, Nodes
from meshes.reference_body import ReferenceBody, Segment

if TYPE_CHECKING:
    from app.case.femurs import IntactFemur
    from app.case.shapes import MeshOptions

REGIONS = ("cortical_bone", "cancellous_bone")
# Sections for the lines of the mesh over those of a planned stem without cement [-]. A slim stem
# fits every canal, even if the planned one cuts into the cortex.
SLIM_FACTOR = 0.6
SECTION_KEYS = ("half_width", "half_depth", "corner_radius")
# Radius of the neck at the axis of the shaft and at the head's centre, over that of the head.
NECK_RATIO = (0.76, 0.65)
# Cortex at the same places [mm]; the second is that of the head too.
CORTEX_THICKNESS = (3.5, 2.0)
# Size of the innermost surface over that of the section, in neck and head [-].
CORE_SHARE = 0.35
# Least number of steps along the head.
LEAST_STEPS = 5
# Length of the head along its axis over its radius [-].
HEAD_LENGTH = 1.4
# Least step along the head over the distance of its lines [-].
LEAST_STEP_RATIO = 0.6
# Half the opening of the lid that closes the head [rad].
CAP_ANGLE = math.radians(50.0)
# Distance of the first ring of the neck above the cut [mm].
CUT_CLEARANCE = 6.0
# Rise of the trochanter beyond the cut, across the shaft [mm].
TROCHANTER_RISE = 6.0


class IntactFemurSurfaces(LayeredSurfaces):
    """Surfaces of the intact bone; beyond station ``neck``, in the head, nodes are on no line.

    Attributes:
        neck: Station of the last section of the neck, where the head begins.
        ball: Station of the last section of the ball; beyond it a lid closes the shell.
    """

    _geometry: IntactFemur
    neck: int
    ball: int
    # Set by `_divide_above_cut`: radius of the head [mm], unit vectors along the neck and medial
    # to it, centre of the head [mm].
    _radius: float
    _axis: Floats
    _medial: Floats
    _centre: Floats
    # Length of the neck's axis from the shaft to the head's centre [mm].
    _length: float
    # Distance from the head's centre at which the neck's cone meets the sphere [mm].
    _sphere_distance: float
    # Distance from the head's centre at which the rings of the neck begin [mm].
    _ring_distance: float

    def _divide_above_cut(self, implant: Implant) -> None:
        geometry, placement = self._geometry, self._placement
        sine, cosine = math.sin(implant.neck_angle), -math.cos(implant.neck_angle)
        self._radius = geometry.head_radius
        self._axis = np.array([sine, 0.0, cosine])
        self._medial = np.array([cosine, 0.0, -sine])
        self._centre = np.array([implant.head_offset, 0.0, implant.head_height])
        self._length = implant.head_offset / sine
        # The neck's cone meets the sphere at this distance from its centre.
        ring = NECK_RATIO[1] * self._radius
        self._sphere_distance = math.sqrt(self._radius**2 - ring**2)
        steepest = placement.slopes[0]
        normal = np.array([steepest, 0.0, 1.0]) / math.hypot(steepest, 1.0)
        rise = float(self._axis @ normal)
        ring_dip = NECK_RATIO[0] * self._radius * math.sqrt(max(0.0, 1.0 - rise**2))
        cut_distance = float(normal @ (self._centre - [0.0, 0.0, placement.top])) / rise
        # From the head's centre back to where a ring is clear of the cut.
        self._ring_distance = max(
            self._sphere_distance, cut_distance - (CUT_CLEARANCE + ring_dip) / rise
        )
        blend_length = cut_distance - self._sphere_distance
        self.neck = self.cut + max(2, round(blend_length / self.mesh.step_along))
        self.mirrored = range(self.cut, self.neck)
        # The last section of the ball; beyond it the shell is closed by a lid.
        least_step = LEAST_STEP_RATIO * 2 * math.pi * self._radius / self.around
        self.ball = self.neck + max(
            LEAST_STEPS, round(HEAD_LENGTH * self._radius / max(self.mesh.step_along, least_step))
        )
        bone = ("cancellous_bone", "cancellous_bone", "cancellous_bone", "cortical_bone")
        self.segments = (Segment(self.ball, bone), Segment(1, ("cortical_bone",) * 3))

    def _replace_above_cut(self, lines: Lines, phi: Floats, s: Floats) -> None:
        """Blend the lines at the cut into those of the neck; lines of the head are not used."""
        is_above = s > self.cut
        start, end = lines.start[is_above], lines.end[is_above]
        endosteum = lines.endosteum[is_above]
        angle, ratio = 2 * np.pi * phi[is_above], lines.mantle[is_above] / endosteum
        fraction = np.minimum((s[is_above] - self.cut) / (self.neck - self.cut), 1.0)
        neck_share = 1 - (1 - fraction) ** 2  # the neck is reached soon
        neck_column = neck_share[:, None]
        centre, radius, cortex = self._ring(fraction)
        directions = np.cos(angle)[:, None] * self._medial + np.sin(angle)[:, None] * [
            0.0,
            1.0,
            0.0,
        ]
        ring = centre + radius[:, None] * directions
        start = (1 - neck_column) * start + neck_column * (
            centre + CORE_SHARE * radius[:, None] * directions
        )
        inner = 1 - cortex / ((1 - CORE_SHARE) * radius)
        # The trochanter rises beyond the cut before it falls to the neck. The largest value of
        # f (1 - f)^2 is 4/27.
        rise = (
            TROCHANTER_RISE
            * (27 / 4)
            * fraction
            * (1 - fraction) ** 2
            * (0.5 - 0.5 * np.cos(angle)) ** 2
        )
        end, endosteum = _extended(
            start,
            (1 - neck_column) * end + neck_column * ring,
            (1 - neck_share) * endosteum + neck_share * inner,
            rise,
        )
        lines.start[is_above], lines.end[is_above] = start, end
        lines.mantle[is_above] = (ratio + (MANTLE_BELOW_PLUG - ratio) * neck_share) * endosteum
        lines.endosteum[is_above] = endosteum
        lines.endosteum[s > self.neck] = 1.0  # one cell through the shell of the head

    def _ring(self, fraction: Floats) -> tuple[Floats, Floats, Floats]:
        """Centre, radius and cortical thickness of sections of the neck."""
        distance = self._ring_distance + fraction * (self._sphere_distance - self._ring_distance)
        t = np.clip(1 - distance / self._length, 0.0, 1.0)
        neck = (NECK_RATIO[0] + (NECK_RATIO[1] - NECK_RATIO[0]) * t) * self._radius
        # The cone ends where it meets the sphere.
        radius = neck + fraction * (NECK_RATIO[1] * self._radius - neck)
        return (
            self._centre - distance[:, None] * self._axis,
            radius,
            CORTEX_THICKNESS[0] + (CORTEX_THICKNESS[1] - CORTEX_THICKNESS[0]) * t,
        )

    def place_end_nodes(
        self, nodes: Nodes, number: Ints, body: ReferenceBody
    ) -> tuple[Nodes, Ints]:
        """Put the nodes of the head on sections, those of its cortex between two spheres."""
        nodes, number = super().place_end_nodes(nodes, number, body)
        column_count, steps = len(body.section), self.ball - self.neck
        in_head = nodes.s > 2 * self.neck
        layer, section = nodes.rho[in_head], nodes.s[in_head] // 2 - self.neck
        angle = np.pi * nodes.phi[in_head] / self.around
        radius_ratio = np.interp(
            layer, [1, 2, 3], [CORE_SHARE, CORE_SHARE + (1 - CORE_SHARE) * MANTLE_BELOW_PLUG, 1.0]
        )
        section_places = (radius_ratio * [np.cos(angle), np.sin(angle)]).T.reshape(
            -1, column_count, 2
        )
        rings = self.around * len(body.rho)
        section_places[:, rings:] = body.weights @ section_places[:, : rings : len(body.rho)]
        offsets = self._bulged(section_places.reshape(-1, 2), np.minimum(section, steps), steps)
        in_shell = (layer >= 3) | (section >= steps)
        outward = np.maximum(layer - 3, section - steps)
        radius = self._radius - CORTEX_THICKNESS[1] * (1 - outward)
        offsets[in_shell] *= (radius / np.sqrt((offsets**2).sum(axis=1)))[in_shell, None]
        x, rho = nodes.x.copy(), nodes.rho.copy()
        x[in_head] = np.round(self._centre + offsets, DIGITS_OF_NODES)
        rho[in_head] = np.where(in_shell, -3.0, 0.0)
        # The rim of the lid is that of the shell.
        stations = number.reshape(-1, column_count)
        outer = np.arange(len(body.rho) - 1, rings, len(body.rho))
        stations[-1, outer - self.through[2]] = stations[-2, outer]
        return replace(nodes, x=x, rho=rho, merged=nodes.merged & ~in_head), number[number]

    def _bulged(self, section_places: Floats, section: Ints, steps: int) -> Floats:
        """Positions on sections (n,) of the head within its cortex, from its centre (n, 3) [mm].

        Sections are even on the axis, and bulge until the last is a cap of the sphere.
        ``section_places`` are places in a section over its radius, medial and anterior (n, 2).
        """
        inner_radius = self._radius - CORTEX_THICKNESS[1]
        angles = np.linspace(math.asin(NECK_RATIO[1]), math.pi - CAP_ANGLE, steps + 1)
        rims = -inner_radius * np.cos(angles)
        bulge = (np.linspace(rims[0], inner_radius, steps + 1) - rims) / (
            inner_radius - np.abs(rims)
        )
        medial_offset, anterior_offset = section_places.T * inner_radius * np.sin(angles[section])
        cap_height = np.sqrt(inner_radius**2 - medial_offset**2 - anterior_offset**2)
        height = rims[section] + bulge[section] * (cap_height - np.abs(rims[section]))
        offsets = np.outer(medial_offset, self._medial) + np.outer(height, self._axis)
        offsets[:, 1] += anterior_offset
        return offsets

    def arc(self, a: Floats, b: Floats) -> Floats:
        """Middles of edges from a to b, at their mean distance from the head's centre (n, 3)."""
        a, b = a - self._centre, b - self._centre
        middle = 0.5 * (a + b)
        start_distance, end_distance, middle_distance = (
            np.sqrt((v**2).sum(axis=1)) for v in (a, b, middle)
        )
        return np.asarray(
            self._centre
            + (0.5 * (start_distance + end_distance) / middle_distance)[:, None] * middle
        )


def _extended(
    start: Floats, end: Floats, endosteum: Floats, extension: Floats
) -> tuple[Floats, Floats]:
    """Extend lines at their ends and keep the thickness of the cortex."""
    direction = end - start
    length = np.sqrt((direction**2).sum(axis=1))
    return end + (extension / length)[:, None] * direction, (endosteum * length + extension) / (
        length + extension
    )


def build(geometry: IntactFemur, mesh: MeshOptions) -> MeshData:
    """Mesh the bone: two regions.

    Boundaries are distal_cut, bone_surface, head and six muscle patches. ``head`` and the muscle
    patches are parts of ``bone_surface``. Notes have the head centre and layers. ``mesh`` are
    options of a case.

    Raises:
        GeometryError: The planned stem does not fit the canal.
    """
    changes: dict[str, Any] = {"canal_widening": 0.0}
    if not geometry.is_cemented:
        stem = geometry.stem
        keys = [f"{prefix}{key}" for prefix in ("", "tip_") for key in SECTION_KEYS]
        slim_stem = stem.model_copy(update={key: SLIM_FACTOR * getattr(stem, key) for key in keys})
        changes |= {"cement_thickness": LEAST_MANTLE, "stem": slim_stem, "tip_void": 0.0}
    surfaces = IntactFemurSurfaces(geometry.model_copy(update=changes), mesh)
    swept_mesh = swept.meshed_layers(surfaces, bool(mesh.curved))
    facets, _ = swept_mesh.facets
    distal, head = swept_mesh.on(facets, s=0), swept_mesh.above(facets, surfaces.neck)
    masks = {"distal_cut": distal, "bone_surface": ~distal, "head": head}
    x = geometry.placement.to_model(swept_mesh.nodes.x)
    return assembled(geometry, swept_mesh, x, REGIONS, {}, masks)
