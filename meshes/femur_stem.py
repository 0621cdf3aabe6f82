"""The implant of the parametric femur: a straight, tapered, collarless stem and its offset.

A section of the body is a rectangle with rounded corners whose half-widths and corner radius are
linear in z, so that the body is a ruled loft between two sections.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from app.arrays import Floats

CORNERS = 0.35  # of a quarter's length: what its corner counts more


@dataclass(frozen=True)
class Body:
    """A tapered rounded rectangle: value + slope * z for half-width, half-depth and corner.

    Attributes:
        half: Values at z = 0 of half-width (x), half-depth (y) and corner radius [mm].
        slope: Their slopes [-].
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

    def point(self, phi: Floats, zeta: Any, slope: Any) -> Floats:
        """Points of the outline in the planes z = zeta - slope x (n, 3) [mm].

        Corners take more of the turn than their length: they bend most.

        Args:
            phi: Angle in turns from +x towards +y (n,); whole quarters are on the axes.
            zeta: Height of the planes at the z axis [mm], shape (n,) or ().
            slope: Slopes of the planes.
        """
        quarter = np.floor(4 * phi).astype(int) % 4
        part = 4 * phi - np.floor(4 * phi)
        part = np.where(quarter % 2 == 1, 1 - part, part)
        a, b, r = self.section(zeta)
        side, corner, front = b - r, 0.5 * np.pi * r, a - r
        more = CORNERS * (side + corner + front)
        at = part * (side + corner + front + more)
        beside = np.clip(at / side, 0.0, 1.0)
        angle = 0.5 * np.pi * np.clip((at - side) / (corner + more), 0.0, 1.0)
        across = np.clip((at - side - corner - more) / front, 0.0, 1.0)
        # x = X a + U r and y = Y b + V r of the section where the plane meets the point.
        c, s = np.cos(angle), np.sin(angle)
        (a0, b0, r0), (a1, b1, r1) = self.half, self.slope
        sign = np.where((quarter == 1) | (quarter == 2), -1.0, 1.0)
        flat = 1 - across
        x0, x1 = (sign * (flat * (p - q) + c * q) for p, q in ((a0, r0), (a1, r1)))
        x = (x0 + x1 * zeta) / (1 + slope * x1)
        z = zeta - slope * x
        y = beside * (b0 - r0 + (b1 - r1) * z) + s * (r0 + r1 * z)
        return np.stack([x, np.where(quarter < 2, y, -y), z], axis=1)

    def offset(self, thickness: float) -> Body:
        """The surface at a distance: exact on the flats, within t (1/cos - 1) at the corners."""
        a, b, r = self.half
        across = [thickness / math.cos(math.atan(slope)) for slope in self.slope[:2]]
        return Body((a + across[0], b + across[1], r + thickness), self.slope)


def body(geometry: Any) -> Body:
    """The stem's body from its sections at the tip and at ``stem_section_z``."""
    low, high = geometry.stem_tip_z, geometry.stem_section_z
    values, slopes = [], []
    for name in ("half_width", "half_depth", "corner_radius"):
        tip, top = getattr(geometry, f"stem_tip_{name}"), getattr(geometry, f"stem_{name}")
        slopes.append((top - tip) / (high - low))
        values.append(tip - slopes[-1] * low)
    return Body((values[0], values[1], values[2]), (slopes[0], slopes[1], slopes[2]))
