"""The implant of the parametric femur: a straight, tapered, collarless stem and its offset.

A section of the body is a rectangle with rounded corners whose half-widths and corner radius are
linear in z, so that the body is a ruled loft between two sections.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from .data import Floats


@dataclass(frozen=True)
class Body:
    """A tapered rounded rectangle: value + slope * z for half-width, half-depth and corner.

    Attributes:
        half: Values at z = 0 of half-width (x), half-depth (y) and corner radius [mm].
        slope: Their slopes.
    """

    half: tuple[float, float, float]
    slope: tuple[float, float, float]

    def section(self, z: Any) -> tuple[Any, Any, Any]:
        """Half-width, half-depth and corner radius at z [mm]."""
        a, b, r = (v + s * z for v, s in zip(self.half, self.slope, strict=True))
        return a, b, r

    def radius(self, theta: Floats, z: Floats) -> Floats:
        """Distance from the z axis to the section's outline in the direction theta [mm]."""
        a, b, r = self.section(z)
        c, s = np.abs(np.cos(theta)), np.abs(np.sin(theta))
        with np.errstate(divide="ignore"):
            flat = np.minimum(a / c, b / s)
        # The ray meets the corner's circle, centre (a - r, b - r), when the flat point is past it.
        along = (a - r) * c + (b - r) * s
        across = (a - r) * s - (b - r) * c
        corner = along + np.sqrt(np.maximum(r**2 - across**2, 0.0))
        rounded = (flat * c > a - r) & (flat * s > b - r)
        return np.where(rounded, corner, flat)

    def offset(self, thickness: float) -> Body:
        """The surface at a distance: exact on the flats, within t (1/cos - 1) at the corners."""
        grown = (
            thickness / math.cos(math.atan(self.slope[0])),
            thickness / math.cos(math.atan(self.slope[1])),
            thickness,
        )
        values = tuple(v + g for v, g in zip(self.half, grown, strict=True))
        return Body((values[0], values[1], values[2]), self.slope)


def body(geometry: Any) -> Body:
    """The stem's body from its sections at the tip and at ``stem_section_z``."""
    low, high = geometry.stem_tip_z, geometry.stem_section_z
    values, slopes = [], []
    for name in ("half_width", "half_depth", "corner_radius"):
        tip, top = getattr(geometry, f"stem_tip_{name}"), getattr(geometry, f"stem_{name}")
        slopes.append((top - tip) / (high - low))
        values.append(tip - slopes[-1] * low)
    return Body((values[0], values[1], values[2]), (slopes[0], slopes[1], slopes[2]))


def loft(gmsh: Any, shape: Body, low: float, high: float) -> int:
    """The body between two levels as a solid; returns its tag."""
    wires = [_wire(gmsh, z, *shape.section(z)) for z in (low, high)]
    made = gmsh.model.occ.addThruSections(wires, makeSolid=True, makeRuled=True)
    return int(next(tag for dim, tag in made if dim == 3))


def _wire(gmsh: Any, z: float, a: float, b: float, r: float) -> int:
    """A rectangle with rounded corners at level z."""
    occ = gmsh.model.occ
    starts, ends, centres = [], [], []
    for sx, sy in ((1, 1), (-1, 1), (-1, -1), (1, -1)):
        centre = (sx * (a - r), sy * (b - r))
        first, second = (sx * a, centre[1]), (centre[0], sy * b)
        if sx * sy < 0:
            first, second = second, first
        starts.append(occ.addPoint(*first, z))
        ends.append(occ.addPoint(*second, z))
        centres.append(occ.addPoint(*centre, z))
    edges = []
    for k in range(4):
        edges.append(occ.addCircleArc(starts[k], centres[k], ends[k]))
        edges.append(occ.addLine(ends[k], starts[(k + 1) % 4]))
    return int(occ.addWire(edges, checkClosed=True))


def neck(gmsh: Any, geometry: Any, shape: Body) -> int:
    """The neck, a cone from the stem's axis to the trunnion disc at the head centre."""
    sine, cosine = math.sin(geometry.neck_angle), -math.cos(geometry.neck_angle)
    length = geometry.head_offset / sine
    start = geometry.head_height - length * cosine
    inside = shape.section(start)[0] / sine  # along the axis, until the body's flank
    growth = 0.5 * (geometry.trunnion_diameter - geometry.neck_diameter) / (length - inside)
    first = 0.5 * geometry.neck_diameter - growth * inside
    if abs(growth) < 1e-9:
        return int(
            gmsh.model.occ.addCylinder(0, 0, start, length * sine, 0, length * cosine, first)
        )
    return int(
        gmsh.model.occ.addCone(
            0,
            0,
            start,
            length * sine,
            0,
            length * cosine,
            first,
            0.5 * geometry.trunnion_diameter,
        )
    )
