"""The bone of the parametric femur: its outer and endosteal surfaces as r(theta, z).

Axes: z along the shaft, proximal positive, 0 at mid lesser trochanter; x medial; y anterior; theta
from x towards y. Sections are superellipses with different medial and lateral half-widths, from
the tables below by monotone cubic interpolation in z.

Canal widths follow the CT of 508 femora (ISTA 2014 abstract). Medio-lateral widths at
z = 20 ... -80 are 43.7, 35.0, 28.7, 24.0, 20.6, 16.7, 15.7 and 13.5 mm. Antero-posterior depths are
15.2 mm at z = -40 and 12.5 mm at z = -80. Noble's isthmus (12.3 by 16.9 mm, 1988) is deeper than
that sample is 30 mm above it. The two samples do not fit together, so the isthmus at z = -113 is
12.3 by 12.5 mm. Cortex and trochanter are assumed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from app.foundation.arrays import Floats, Ints

if TYPE_CHECKING:
    from meshes.bone_layers import BoneLayers
    from meshes.layers import Sections

# Level of the isthmus [mm].
ISTHMUS = -113.0
# Level above which the canal is the cone of the metaphysis [mm].
CONE_END = -50.0
# z, lateral, medial, antero-posterior half-width [mm], superellipse exponent
OUTER = np.array(
    [
        (50.0, 12.0, 15.0, 10.0, 2.2),
        (46.0, 22.0, 23.0, 16.0, 2.2),
        (42.0, 27.5, 26.5, 19.5, 2.3),
        (37.0, 30.5, 27.0, 21.5, 2.4),
        (30.0, 31.5, 26.5, 22.0, 2.5),
        (20.0, 28.0, 25.5, 20.5, 2.4),
        (10.0, 23.0, 24.0, 18.5, 2.2),
        (0.0, 19.5, 21.5, 17.0, 2.1),
        (-10.0, 17.3, 18.6, 16.0, 2.0),
        (-20.0, 16.0, 16.8, 15.2, 2.0),
        (-40.0, 14.9, 15.2, 14.4, 2.0),
        (-50.0, 14.5, 14.8, 14.2, 2.0),
        (-80.0, 13.8, 14.0, 13.8, 2.0),
        (-113.0, 13.5, 13.6, 13.6, 2.0),
        (-150.0, 13.8, 13.8, 14.0, 2.0),
        (-200.0, 14.5, 14.5, 14.8, 2.0),
        (-260.0, 15.5, 15.5, 16.0, 2.0),
    ]
)
CANAL = np.array(
    [
        (39.0, 26.0, 23.5, 17.5, 2.3),
        (30.0, 27.5, 23.0, 17.8, 2.4),
        (20.0, 23.2, 20.5, 15.5, 2.3),
        (10.0, 18.0, 17.0, 13.5, 2.2),
        (0.0, 14.0, 14.7, 12.0, 2.1),
        (-10.0, 11.6, 12.4, 10.6, 2.0),
        (-20.0, 10.2, 10.4, 9.4, 2.0),
        (-40.0, 8.35, 8.35, 7.6, 2.0),
        (-50.0, 7.85, 7.85, 7.2, 2.0),
        (-80.0, 6.75, 6.75, 6.25, 2.0),
        (-113.0, 6.15, 6.15, 6.25, 2.0),
        (-150.0, 6.8, 6.8, 6.9, 2.0),
        (-200.0, 8.0, 8.0, 8.0, 2.0),
        (-260.0, 9.5, 9.5, 9.5, 2.0),
    ]
)
TROCHANTER = (6.0, np.radians(-20.0), 0.40, 8.0)  # lesser: height, angle, spread in angle and z
HEAD_OFFSET = 43.0  # mm from the shaft's axis to the head's centre
HEAD_HEIGHT = 54.0  # mm: level of the head's centre
DRAWN_AROUND = 72  # points around in pictures
DRAWN_ALONG = 160  # sections in pictures
CORTEX_LEFT = 2.5  # mm of cortical bone that reaming leaves
# Levels [mm] between which a given thickness of the metaphyseal cortex blends into the table.
BLEND_LEVELS = (-50.0, -10.0)


def tube_triangles(along: int, around: int) -> Ints:
    """Triangles (m, 3) of a tube, whose points are ordered section by section.

    Seen from outside corners are counterclockwise if the sections rise and their points turn left.
    """
    row, column = (v.ravel() for v in np.mgrid[: along - 1, :around])
    a, b = row * around + column, row * around + (column + 1) % around
    return np.concatenate(
        [np.stack([a, b, b + around], axis=1), np.stack([a, b + around, a + around], axis=1)]
    )


def monotone(x: Floats, y: Floats) -> Callable[[Floats], Floats]:
    """Cubic interpolation of rows y (n, k) over rising x (n,), without extremes between them.

    The slopes are those of Fritsch and Butland (SIAM J. Sci. Stat. Comput. 5 (1984) 300), as in
    scipy's `PchipInterpolator`, whose import takes 0.07 s of each run of a hip.
    """
    h = np.diff(x)[:, None]
    m = np.diff(y, axis=0) / h
    before, after = 2 * h[1:] + h[:-1], h[1:] + 2 * h[:-1]
    # The weighted harmonic mean of the slopes on both sides; flat where they differ in sign.
    rises = m[:-1] * m[1:] > 0
    low, high = (np.where(rises, slope, 1.0) for slope in (m[:-1], m[1:]))
    inner = np.where(rises, (before + after) / (before / low + after / high), 0.0)
    first, last = _end_slope(h[:2], m[:2]), _end_slope(h[:-3:-1], m[:-3:-1])
    slopes = np.vstack([first, inner, last])
    square = (3 * m - 2 * slopes[:-1] - slopes[1:]) / h
    cube = (slopes[:-1] + slopes[1:] - 2 * m) / h**2

    def interpolated(places: Floats) -> Floats:
        k = np.clip(np.searchsorted(x, places, side="right") - 1, 0, len(h) - 1)
        t = (places - x[k])[..., None]
        return np.asarray(y[k] + t * (slopes[k] + t * (square[k] + t * cube[k])))

    return interpolated


def _end_slope(h: Floats, m: Floats) -> Floats:
    """One-sided slope (k,) at an end of the data.

    ``h`` (2, 1) and ``m`` (2, k) are the lengths and mean slopes of the two intervals next to it,
    the outer one first.
    """
    slope = ((2 * h[0] + h[1]) * m[0] - h[0] * m[1]) / (h[0] + h[1])
    slope = np.where(slope * m[0] > 0, slope, 0.0)
    steep = (m[0] * m[1] <= 0) & (np.abs(slope) > 3 * np.abs(m[0]))
    return np.asarray(np.where(steep, 3 * m[0], slope))


@dataclass(frozen=True)
class Tube:
    """A closed surface around the z axis between two levels.

    Attributes:
        table: Rows z, lateral, medial, antero-posterior half-width, exponent.
        bump: Height, angle, angular spread, axial spread of a Gaussian bump at z = 0.
        offset: Added to the radius [mm].
    """

    table: Floats
    bump: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)
    offset: float = 0.0

    @property
    def top(self) -> float:
        """Highest level [mm]."""
        return float(self.table[:, 0].max())

    @cached_property
    def _sections(self) -> Callable[[Floats], Floats]:
        rows = self.table[np.argsort(self.table[:, 0])]
        return monotone(rows[:, 0], rows[:, 1:])

    def radius(self, theta: Floats, z: Floats) -> Floats:
        """Distance from the z axis [mm]; beyond the table the end sections continue."""
        level = np.clip(z, self.table[:, 0].min(), self.top)
        lateral, medial, depth, n = np.moveaxis(self._sections(level), -1, 0)
        width = np.where(np.cos(theta) > 0, medial, lateral)
        r = ((np.abs(np.cos(theta)) / width) ** n + (np.abs(np.sin(theta)) / depth) ** n) ** (
            -1 / n
        )
        height, angle, spread, length = self.bump
        angle_difference = np.angle(np.exp(1j * (theta - angle)))  # from -pi to pi
        return (
            r
            + self.offset
            + height * np.exp(-((angle_difference / spread) ** 2) - (z / length) ** 2)
        )


PERIOSTEUM = Tube(OUTER, TROCHANTER)


@dataclass(frozen=True)
class FemurBone:
    """The bone of the table, in the model's axes.

    Attributes:
        neck: Azimuth of the neck, its anteversion [rad].
        widening: Reaming: distance by which the endosteum is moved outwards [mm].
        cortex: Thickness of the cortex above the levels `BLEND_LEVELS` [mm]; None: as in the table.
    """

    neck: float = 0.0
    widening: float = 0.0
    cortex: float | None = None
    has_condyles: ClassVar[bool] = True  # they are along x
    mirrored: ClassVar[bool] = False
    is_radial: ClassVar[bool] = True

    @cached_property
    def _canal(self) -> Tube:
        """The reamed canal."""
        return Tube(CANAL, offset=self.widening)

    @property
    def head(self) -> Floats:
        """Centre of the head (3,) [mm]."""
        direction = np.array([np.cos(self.neck), np.sin(self.neck)])
        return np.append(HEAD_OFFSET * direction, HEAD_HEIGHT)

    @property
    def drawn(self) -> tuple[Floats, Ints]:
        """Corners (n, 3) [mm] and triangles (m, 3) of the outer surface, for pictures."""
        levels = np.linspace(OUTER[-1, 0], OUTER[0, 0], DRAWN_ALONG)
        turns = 2 * np.pi * np.arange(DRAWN_AROUND) / DRAWN_AROUND
        theta, z = np.meshgrid(turns, levels)
        r = self.periosteum(theta, z)
        x = np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=-1)
        return x.reshape(-1, 3), tube_triangles(*theta.shape)

    @property
    def lowest(self) -> float:
        """Level at which the surface ends [mm]."""
        return float(OUTER[-1, 0])

    def reach(self, azimuth: float, height: float) -> float:
        """Distance of the periosteum from the shaft's axis [mm]."""
        return float(self.periosteum(np.array(azimuth), np.array(height)))

    def layers(self, geometry: object, sections: Sections, stem: object) -> BoneLayers:
        """Periosteum and endosteum in the sections of a mesh."""
        from meshes.bone_layers import TableLayers  # scipy, which a check of a case does without

        return TableLayers(self, sections)

    def periosteum(self, theta: Floats, z: Floats) -> Floats:
        """Distance of the periosteum from the z axis [mm]."""
        return PERIOSTEUM.radius(theta, z)

    def endosteum(self, theta: Floats, z: Floats) -> Floats:
        """Distance of the endosteum from the z axis [mm].

        Reaming leaves `CORTEX_LEFT`. A given thickness of the cortex blends into that of the table
        between the levels `BLEND_LEVELS`.
        """
        bone = self.periosteum(theta, z)
        canal = np.minimum(self._canal.radius(theta, z), bone - CORTEX_LEFT)
        if self.cortex is None:
            return canal
        t = np.clip((z - BLEND_LEVELS[0]) / (BLEND_LEVELS[1] - BLEND_LEVELS[0]), 0.0, 1.0)
        share = t * t * (3 - 2 * t)  # smooth from 0 to 1
        return np.asarray((1 - share) * canal + share * (bone - self.cortex))
