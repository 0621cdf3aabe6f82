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
from typing import Any

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.foundation.implant import Implant
from meshes import swept
from meshes.data import MeshData, MeshKeys
from meshes.femur import assembled
from meshes.geometry import IntactHipKeys
from meshes.layered_surfaces import LEAST_MANTLE, SPREAD, LayeredSurfaces
from meshes.layers import DIGITS, Lines, Nodes
from meshes.reference_body import ReferenceBody, Segment

REGIONS = ("cortical_bone", "cancellous_bone")
# Sections for the lines of the mesh over those of a planned stem without cement: a slim stem has
# room in the canal, whatever the planned one takes of the cortex.
SLIM = 0.6
SIZES = ("half_width", "half_depth", "corner_radius")
# Radius of the neck at the axis of the shaft and at the head's centre, over that of the head.
NECK = (0.76, 0.65)
# Cortex at the same places [mm]; the second is that of the head too.
CORTEX = (3.5, 2.0)
CORE = 0.35  # of sections of neck and head: where the innermost surface is
STEPS = 5  # along the head, at least
ARC = 1.4  # of the head's radius: the length of the head along its axis
WIDE = 0.6  # of the distance of lines on the head: its least step
CAP = math.radians(50.0)  # half the opening of the lid that closes the head
CLEAR = 6.0  # mm that the first ring of the neck is above the cut
RISE = 6.0  # mm that the trochanter rises beyond the cut, across the shaft


class Intact(LayeredSurfaces):
    """Surfaces of the intact bone; beyond station ``neck``, in the head, nodes are on no line."""

    _geometry: IntactHipKeys

    def _continue(self, implant: Implant) -> None:
        geometry, placed = self._geometry, self._placed
        sine, cosine = math.sin(implant.neck_angle), -math.cos(implant.neck_angle)
        self._radius = geometry.head_radius
        self._axis = np.array([sine, 0.0, cosine])
        self._medial = np.array([cosine, 0.0, -sine])
        self._centre = np.array([implant.head_offset, 0.0, implant.head_height])
        self._length = implant.head_offset / sine
        # The neck's cone meets the sphere at this distance from its centre.
        ring = NECK[1] * self._radius
        self._meet = math.sqrt(self._radius**2 - ring**2)
        steepest = placed.slopes[0]
        normal = np.array([steepest, 0.0, 1.0]) / math.hypot(steepest, 1.0)
        rise = float(self._axis @ normal)
        dip = NECK[0] * self._radius * math.sqrt(max(0.0, 1.0 - rise**2))
        above = float(normal @ (self._centre - [0.0, 0.0, placed.top])) / rise
        # From the head's centre back to where a ring is clear of the cut.
        self._back = max(self._meet, above - (CLEAR + dip) / rise)
        blend = above - self._meet
        self.neck = self.cut + max(2, round(blend / self.mesh.step_along))
        self.mirrored = range(self.cut, self.neck)
        # The last section of the ball; beyond it the shell is closed by a lid.
        wide = WIDE * 2 * math.pi * self._radius / self.around
        self.ball = self.neck + max(
            STEPS, round(ARC * self._radius / max(self.mesh.step_along, wide))
        )
        bone = ("cancellous_bone", "cancellous_bone", "cancellous_bone", "cortical_bone")
        self.segments = (Segment(self.ball, bone), Segment(1, ("cortical_bone",) * 3))

    def _beyond(self, lines: Lines, phi: Floats, s: Floats) -> None:
        """Blend the lines at the cut into those of the neck; lines of the head are not used."""
        above = s > self.cut
        start, end, mantle, endosteum = (v[above] for v in vars(lines).values())
        turn, ratio = 2 * np.pi * phi[above], mantle / endosteum
        part = np.minimum((s[above] - self.cut) / (self.neck - self.cut), 1.0)
        share = 1 - (1 - part) ** 2  # the neck is reached soon
        f = share[:, None]
        centre, radius, cortex = self._ring(part)
        out = np.cos(turn)[:, None] * self._medial + np.sin(turn)[:, None] * [0.0, 1.0, 0.0]
        ring = centre + radius[:, None] * out
        start = (1 - f) * start + f * (centre + CORE * radius[:, None] * out)
        inner = 1 - cortex / ((1 - CORE) * radius)
        # The trochanter rises beyond the cut before it falls to the neck.
        rise = RISE * 6.75 * part * (1 - part) ** 2 * (0.5 - 0.5 * np.cos(turn)) ** 2
        end, endosteum = _longer(
            start, (1 - f) * end + f * ring, (1 - share) * endosteum + share * inner, rise
        )
        lines.start[above], lines.end[above] = start, end
        lines.mantle[above] = (ratio + (SPREAD - ratio) * share) * endosteum
        lines.endosteum[above] = endosteum
        lines.endosteum[s > self.neck] = 1.0  # one cell through the shell of the head

    def _ring(self, part: Floats) -> tuple[Floats, Floats, Floats]:
        """Centre, radius and cortical thickness of sections of the neck."""
        back = self._back + part * (self._meet - self._back)
        t = np.clip(1 - back / self._length, 0.0, 1.0)
        neck = (NECK[0] + (NECK[1] - NECK[0]) * t) * self._radius
        # The cone ends where it meets the sphere.
        radius = neck + part * (NECK[1] * self._radius - neck)
        return (
            self._centre - back[:, None] * self._axis,
            radius,
            CORTEX[0] + (CORTEX[1] - CORTEX[0]) * t,
        )

    def ended(self, nodes: Nodes, number: Ints, body: ReferenceBody) -> tuple[Nodes, Ints]:
        """Put the nodes of the head on sections, those of its cortex between two spheres."""
        nodes, number = super().ended(nodes, number, body)
        c, steps = len(body.at), self.ball - self.neck
        head = nodes.s > 2 * self.neck
        j, k = nodes.rho[head], nodes.s[head] // 2 - self.neck
        turn = np.pi * nodes.phi[head] / self.around
        part = np.interp(j, [1, 2, 3], [CORE, CORE + (1 - CORE) * SPREAD, 1.0])
        flat = (part * [np.cos(turn), np.sin(turn)]).T.reshape(-1, c, 2)
        rings = self.around * len(body.rho)
        flat[:, rings:] = body.weights @ flat[:, : rings : len(body.rho)]
        off = self._bulged(flat.reshape(-1, 2), np.minimum(k, steps), steps)
        shell = (j >= 3) | (k >= steps)
        out = np.maximum(j - 3, k - steps)
        radius = self._radius - CORTEX[1] * (1 - out)
        off[shell] *= (radius / np.sqrt((off**2).sum(axis=1)))[shell, None]
        x, rho = nodes.x.copy(), nodes.rho.copy()
        x[head] = np.round(self._centre + off, DIGITS)
        rho[head] = np.where(shell, -3.0, 0.0)
        # The rim of the lid is that of the shell.
        stations, outer = number.reshape(-1, c), np.arange(len(body.rho) - 1, rings, len(body.rho))
        stations[-1, outer - self.through[2]] = stations[-2, outer]
        return replace(nodes, x=x, rho=rho, merged=nodes.merged & ~head), number[number]

    def _bulged(self, flat: Floats, k: Ints, steps: int) -> Floats:
        """Positions on sections k (n,) of the head within its cortex, from its centre (n, 3) [mm].

        Sections are even on the axis, and bulge until the last is a cap of the sphere. ``flat`` are
        places in a section over its radius, medial and anterior (n, 2).
        """
        within = self._radius - CORTEX[1]
        angles = np.linspace(math.asin(NECK[1]), math.pi - CAP, steps + 1)
        rims = -within * np.cos(angles)
        bulge = (np.linspace(rims[0], within, steps + 1) - rims) / (within - np.abs(rims))
        down, ahead = flat.T * within * np.sin(angles[k])
        cap = np.sqrt(within**2 - down**2 - ahead**2)
        up = rims[k] + bulge[k] * (cap - np.abs(rims[k]))
        off = np.outer(down, self._medial) + np.outer(up, self._axis)
        off[:, 1] += ahead
        return off

    def arc(self, a: Floats, b: Floats) -> Floats:
        """At the mean distance of a and b from the head's centre."""
        a, b = a - self._centre, b - self._centre
        middle = 0.5 * (a + b)
        far, near, now = (np.sqrt((v**2).sum(axis=1)) for v in (a, b, middle))
        return np.asarray(self._centre + (0.5 * (far + near) / now)[:, None] * middle)


def _longer(start: Floats, end: Floats, endosteum: Floats, by: Floats) -> tuple[Floats, Floats]:
    """Extend lines: their ends, and the position of the endosteum under a cortex as thick."""
    way = end - start
    length = np.sqrt((way**2).sum(axis=1))
    return end + (by / length)[:, None] * way, (endosteum * length + by) / (length + by)


def build(geometry: IntactHipKeys, mesh: MeshKeys) -> MeshData:
    """Mesh the bone: two regions.

    Boundaries are distal_cut, bone_surface, head and six muscle patches, the last two parts of
    bone_surface; notes have the head centre and layers. ``mesh`` are options of a case.

    Raises:
        GeometryError: The planned stem does not fit the canal.
    """
    changes: dict[str, Any] = {"canal_widening": 0.0}
    if not geometry.is_cemented:
        stem, keys = geometry.stem, [f"{end}{key}" for end in ("", "tip_") for key in SIZES]
        slim = stem.model_copy(update={key: SLIM * getattr(stem, key) for key in keys})
        changes |= {"cement_thickness": LEAST_MANTLE, "stem": slim, "tip_void": 0.0}
    surfaces = Intact(geometry.model_copy(update=changes), mesh)
    made = swept.mesh(surfaces, bool(mesh.curved))
    facets, _ = made.facets
    distal, head = made.on(facets, s=0), made.above(facets, surfaces.neck)
    masks = {"distal_cut": distal, "bone_surface": ~distal, "head": head}
    x = geometry.placement.to_model(made.nodes.x)
    return assembled(geometry, made, x, REGIONS, {}, masks)
