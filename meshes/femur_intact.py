"""A proximal femur before the operation: cortical bone around cancellous bone, with head and neck.

Shaft, trochanters, canal and muscle patches are those of the femur with a stem, cell by cell: the
lines are those of the stem that is planned (`femur_surfaces`). What the operation would take away
is a blend from the neck cut to a round neck, and a sphere about the head's centre. Assumed, for
want of a published set that goes with this shaft: a neck of 0.70 of the head's diameter in
its middle (means are 48 and 33 mm in men, not verified), round and without anteversion, as the
implant; a cortex of 2 mm under the head, of 3.5 mm at the root of the neck, alike all around (it is
thicker below and thinner above); no cartilage; and no fovea.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from mantle.arrays import Floats

from . import layers, swept
from .data import MeshData
from .femur import patches
from .femur_surfaces import CLEAR, SPREAD, FemurSurfaces
from .layers import Lines
from .tags import assemble, number

REGIONS = ("cortical_bone", "cancellous_bone")
# Radius of the neck at the axis of the shaft and at the head's centre, over that of the head.
NECK = (0.76, 0.65)
# Cortex at the same places [mm]; the second is that of the head too.
CORTEX = (3.5, 2.0)
CORE = 0.35  # of sections of neck and head: where the innermost surface is
CAP = math.radians(50.0)  # half the opening of the cap that closes the head


class Intact(FemurSurfaces):
    """Surfaces of the whole bone, as `layers.Surfaces` wants them.

    Attributes:
        neck: Station at which the sphere of the head begins.
    """

    def _continue(self, geometry: Any) -> None:
        """Divide neck and head."""
        sine, cosine = math.sin(geometry.neck_angle), -math.cos(geometry.neck_angle)
        self._radius = geometry.head_radius
        self._axis = np.array([sine, 0.0, cosine])
        self._medial = np.array([cosine, 0.0, -sine])
        self._centre = np.array([geometry.head_offset, 0.0, geometry.head_height])
        self._length = geometry.head_offset / sine
        # The neck's cone meets the sphere at this distance from its centre.
        ring = NECK[1] * self._radius
        self._meet = math.sqrt(self._radius**2 - ring**2)
        first, last = math.asin(ring / self._radius), math.pi - CAP
        before = last - self.size / self._radius  # the cap's slab is as wide as others
        over = max(2, round(self._radius * (before - first) / self.size))
        self._angles = np.append(np.linspace(first, before, over + 1), last)
        self._bulge = np.append(np.linspace(0.0, 1.0, over + 1), 1.0)
        normal = np.array([self._steepest, 0.0, 1.0]) / math.hypot(self._steepest, 1.0)
        rise = float(self._axis @ normal)
        dip = NECK[0] * self._radius * math.sqrt(max(0.0, 1.0 - rise**2))
        above = float(normal @ (self._centre - [0.0, 0.0, self._top])) / rise
        # From the head's centre back to where a ring is clear of the cut.
        self._back = max(self._meet, above - (CLEAR + dip) / rise)
        blend = above - self._meet
        self.neck = self.cut + max(2, round(blend / self.size))
        self.stations = self.neck + len(self._angles)

    def outermost(self, slab: int) -> int:
        """Bone has all layers everywhere."""
        return 4

    def lines(self, phi: Floats, s: Floats) -> Lines:
        """Lines in the sections of shaft, neck and head."""
        at = np.minimum(s, self.cut)
        start, end, mantle, endosteum = self._across(phi, at)
        above = s > self.cut
        if above.any():
            turn, ratio = 2 * np.pi * phi[above], (mantle / endosteum)[above]
            part = np.clip((s[above] - self.cut) / (self.neck - self.cut), 0.0, 1.0)
            share = 1 - (1 - part) ** 2  # the neck is reached soon, the fossa is deep
            centre, radius, cortex = self._ring(part, s[above])
            out = np.cos(turn)[:, None] * self._medial + np.sin(turn)[:, None] * [0.0, 1.0, 0.0]
            ring = centre + radius[:, None] * out
            core = centre + CORE * radius[:, None] * out
            f = share[:, None]
            start[above] = (1 - f) * start[above] + f * core
            end[above] = (1 - f) * end[above] + f * ring
            inner = 1 - cortex / ((1 - CORE) * radius)
            endosteum[above] = (1 - share) * endosteum[above] + share * inner
            mantle[above] = (ratio + (SPREAD - ratio) * share) * endosteum[above]
        return Lines(start, end, mantle, endosteum)

    def _ring(self, part: Floats, s: Floats) -> tuple[Floats, Floats, Floats]:
        """Centre, radius and thickness of cortex of sections of neck (part < 1) and head."""
        angle = np.interp(s - self.neck, np.arange(len(self._angles)), self._angles)
        back = self._back + part * (self._meet - self._back)
        t = np.clip(1 - back / self._length, 0.0, 1.0)
        neck = (NECK[0] + (NECK[1] - NECK[0]) * t) * self._radius
        head = s > self.neck
        # The cone ends where it meets the sphere.
        radius = np.where(
            head, self._radius * np.sin(angle), neck + part * (NECK[1] * self._radius - neck)
        )
        along = np.where(head, -self._radius * np.cos(angle), -back)
        cortex = np.where(head, CORTEX[1], CORTEX[0] + (CORTEX[1] - CORTEX[0]) * t)
        return self._centre + along[:, None] * self._axis, radius, cortex

    def bend(self, x: Floats, way: Floats, s: Floats) -> Floats:
        """Sections of the head bulge until the last two are caps of spheres, a cortex apart."""
        over = s - self.neck
        number = np.arange(len(self._angles))
        angle = np.interp(over, number, self._angles)
        bulge = np.interp(over, number, self._bulge)
        last = np.clip(over - (len(number) - 2), 0.0, 1.0)
        bone = 1 - CORTEX[1] / ((1 - CORE) * self._radius * np.sin(angle))
        shell = np.clip((way - bone) / (1 - bone), 0.0, 1.0)
        within = np.minimum((CORE + (1 - CORE) * way) / (CORE + (1 - CORE) * bone), 1.0)
        # Inside the cortex part of a ball; the cortex is as thick everywhere, but in the last
        # section, which is all on the sphere.
        inner = self._radius - CORTEX[1] * (1 - last)
        sides = angle + last * (1 - shell) * CORTEX[1] / self._radius
        ball = inner + (self._radius - inner) * shell
        across = within * ball * np.sin(sides)
        along = -ball * np.cos(sides) + bulge * (
            np.sqrt(ball**2 - across**2) - ball * np.abs(np.cos(sides))
        )
        off = x - self._centre
        off -= (off * self._axis).sum(axis=1)[:, None] * self._axis
        off /= np.maximum(np.sqrt((off**2).sum(axis=1)), 1e-9)[:, None]
        bent = self._centre + across[:, None] * off + along[:, None] * self._axis
        part = np.clip(over, 0.0, 1.0)[:, None]
        return np.asarray((1 - part) * x + part * bent)

    def inside(self, x: Floats, s: Floats) -> Floats:
        """The last section is on the sphere."""
        last = s >= self.stations - 1
        off = x[last] - self._centre
        along = (off * self._axis).sum(axis=1)
        across = off - along[:, None] * self._axis
        rise = np.sqrt(self._radius**2 - (across**2).sum(axis=1))
        x = x.copy()
        x[last] = self._centre + across + rise[:, None] * self._axis
        return x


def build(geometry: Any, mesh: Any) -> MeshData:
    """Mesh the bone.

    Args:
        geometry: The parameters of the configuration's intact femur.
        mesh: ``size``, ``far`` [mm], ``curved``.

    Returns:
        Two regions, and the boundaries distal_cut, bone_surface, head and five muscle patches, the
        last two parts of bone_surface. Notes: head centre, layers.

    Raises:
        GeometryError: The stem that is planned does not fit the canal.
    """
    surfaces, times = _surfaces(geometry, mesh)
    made = swept.mesh(surfaces, times, mesh.curved)
    regions = number(REGIONS)
    cortical = (made.layer == 3) | (made.slab == surfaces.stations - 2)
    tags = np.where(cortical, regions["cortical_bone"], regions["cancellous_bone"])
    facets, owner = made.facets
    at = layers.on(made, facets)
    distal = at.s(0)
    masks = {"distal_cut": distal, "bone_surface": ~distal, "head": at.above(surfaces.neck)}
    shaft = at.rho(4) & ~at.above(surfaces.neck)
    masks |= patches(made.nodes.x, facets, shaft)
    data = assemble(
        made.nodes.x, made.cells, tags.astype(np.int32), regions, {}, masks, (facets, owner)
    )
    head = [geometry.head_offset, 0.0, geometry.head_height]
    notes = {"head_centre": head, "layers": layers.describe(made)}
    return replace(data, notes=notes, behind=made.partner.reshape(-1, 4) // 4)


def _surfaces(geometry: Any, mesh: Any) -> tuple[Intact, int]:
    """The surfaces before reaming, and how often the coarsest mesh is refined."""
    size, times = swept.steps(mesh.size)
    whole = geometry.model_copy(update={"canal_widening": 0.0})
    return Intact(whole, size, mesh.far * size / mesh.size), times
