"""Periosteum and endosteum in the sections of a mesh: the protocols, and bone by radii.

Lines across the layers end on the periosteum, at angles about the centre of each section, which is
on the stem's axis. Below the plug the shaft may bow away from that axis: there the centre goes over
to the centre of the shaft or of the canal. Each line meets each surface once, because bone is
star-shaped about the centre in these sections, trochanters included. Near the neck cut sections are
parallel to it: a horizontal line would meet the trochanters several times.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.foundation.errors import GeometryError
from meshes.layers import CORE_OVER, Sections, root

RAY_LENGTH = 90.0  # mm: farther from the axis there is no bone
LINE_FRACTIONS = np.linspace(0.0, 1.2, 25)  # of a line: places that are in bone or not
TABLE_CORE = 0.5  # of the table's canal: the innermost surface below the plug


class StemShape(Protocol):
    """Shape of the stem and its mantle in sections."""

    def outline(self, phi: Floats, sections: Sections, zeta: Floats) -> Floats:
        """Points of the stem's outline at angles [turns] in sections at heights (n, 3) [mm]."""

    def covered(self, zeta: Floats, start: Floats, end: Floats, oversize: float = 0.0) -> Floats:
        """Fraction of lines from the outline to an end (n, 3) that is in the mantle (n,)."""


class BoneLayers(Protocol):
    """Bone in the sections of a mesh. Points are in the stem's axes (n, 3) [mm].

    Attributes:
        notes: What was measured and done, in words.
    """

    notes: list[str]

    def ends(self, theta: Floats, zeta: Floats) -> Floats:
        """Points of the periosteum at angles in sections at heights (n,)."""

    def canal(self, theta: Floats, zeta: Floats) -> Floats:
        """Points of the endosteum at angles in sections at heights (n,)."""

    def depth(self, x: Floats, zeta: Floats) -> Floats:
        """Depth of points in sections at heights within the endosteum (n,) [mm]."""

    def core(self, start: Floats, theta: Floats, zeta: Floats) -> Floats:
        """Points of the innermost surface below the plug, whose outline is ``start``."""

    def check(self, start: Floats, end: Floats) -> None:
        """Raise GeometryError if a line, from start to end, meets bone more than once."""


class LayeredBone(Protocol):
    """A femur before the operation, in the model's axes."""

    @property
    def neck(self) -> float:
        """Azimuth of the neck, from medial to anterior [rad]."""

    @property
    def has_condyles(self) -> bool:
        """True if the posterior condyles are known."""

    @property
    def mirrored(self) -> bool:
        """True if the model is the mirror image of the bone: a right femur."""

    @property
    def head(self) -> Floats:
        """Centre of the head (3,) [mm]."""

    @property
    def lowest(self) -> float:
        """Level at which the surface ends [mm]."""

    @property
    def drawn(self) -> tuple[Floats, Ints]:
        """Corners (n, 3) [mm] and triangles (m, 3) of the outer surface, for pictures."""

    def reach(self, azimuth: float, height: float) -> float:
        """Distance of the surface from the shaft's axis [mm].

        Raises:
            GeometryError: The axis is outside of the bone at this height.
        """

    @property
    def is_radial(self) -> bool:
        """True if its surfaces are functions of angle and height (`RadialBone`)."""

    def layers(self, geometry: Any, sections: Sections, stem: StemShape | None) -> BoneLayers:
        """Periosteum and endosteum in the sections of a mesh around a stem.

        ``geometry`` is the one that the bone is of. Without a stem, the canal is as wide as it may
        be made for any stem.

        Raises:
            GeometryError: The bone cannot be meshed in these sections.
        """


class RadialBone(Protocol):
    """Bone whose surfaces are functions of angle [rad] and height [mm] in the model's axes."""

    def periosteum(self, theta: Floats, z: Floats) -> Floats:
        """Distance of the periosteum from the z axis (n,) [mm]."""

    def endosteum(self, theta: Floats, z: Floats) -> Floats:
        """Distance of the endosteum from the z axis (n,) [mm]."""


class TableLayers:
    """Bone by functions of angle and height in the model's axes."""

    def __init__(self, bone: RadialBone, sections: Sections) -> None:
        self.notes = list[str]()
        self._bone, self._sections = bone, sections
        # The shaft's axis, in the stem's axes.
        foot, axis = sections.placement.to_stem(np.zeros(3)), sections.placement.rotation[2]
        self._foot, self._tilt = foot, axis[:2] / axis[2]

    def _centre(self, zeta: Floats) -> Floats:
        """Centre of sections (n, 2) [mm]."""
        shaft = self._foot[:2] + np.outer(zeta - self._foot[2], self._tilt)
        return np.asarray(self._sections.below_plug(zeta)[:, None] * shaft)

    def _section_points(self, theta: Floats, zeta: Floats, radii: Floats) -> Floats:
        """Points of sections (n, 3), about their centres."""
        directions = np.stack([np.cos(theta), np.sin(theta)], axis=1)
        return self._sections.in_plane(self._centre(zeta) + radii[:, None] * directions, zeta)

    def _depth_inside(self, radius: Callable[[Floats, Floats], Floats], points: Floats) -> Floats:
        """Depth of points of the model inside a surface, across the z axis (n,) [mm]."""
        x, y, z = points.T
        return radius(np.arctan2(y, x), z) - np.hypot(x, y)

    def _exit_radii(
        self, radius: Callable[[Floats, Floats], Floats], theta: Floats, zeta: Floats
    ) -> Floats:
        """Radii, about the centres of sections, at which lines leave a surface (n,) [mm]."""
        to_model = self._sections.placement.to_model
        centre = to_model(self._section_points(theta, zeta, np.zeros(len(theta))))
        direction = to_model(self._section_points(theta, zeta, np.ones(len(theta)))) - centre

        def depth(r: Floats, k: Ints) -> Floats:
            return self._depth_inside(radius, centre[k] + r[:, None] * direction[k])

        return root(depth, np.full(len(theta), RAY_LENGTH))

    def ends(self, theta: Floats, zeta: Floats) -> Floats:
        """Points of the periosteum in sections (n, 3) [mm]."""
        return self._section_points(
            theta, zeta, self._exit_radii(self._bone.periosteum, theta, zeta)
        )

    def canal(self, theta: Floats, zeta: Floats) -> Floats:
        """Points of the endosteum in sections (n, 3) [mm]."""
        return self._section_points(
            theta, zeta, self._exit_radii(self._bone.endosteum, theta, zeta)
        )

    def depth(self, x: Floats, zeta: Floats) -> Floats:
        """Depth of points (n, 3) within the endosteum (n,) [mm]."""
        return self._depth_inside(self._bone.endosteum, self._sections.placement.to_model(x))

    def core(self, start: Floats, theta: Floats, zeta: Floats) -> Floats:
        """Points between the outline at the plug and a part of the canal (n, 3) [mm]."""
        x = start.copy()
        is_below = zeta < self._sections.plug
        theta, zeta = theta[is_below], zeta[is_below]
        radii = TABLE_CORE * self._exit_radii(self._bone.endosteum, theta, zeta)
        share = np.minimum((self._sections.plug - zeta) / CORE_OVER, 1.0)[:, None]
        xy = (1 - share) * start[is_below, :2] + share * self._section_points(theta, zeta, radii)[
            :, :2
        ]
        x[is_below] = self._sections.in_plane(xy, zeta)
        return x

    def check(self, start: Floats, end: Floats) -> None:
        """Raise GeometryError where lines meet a surface of bone more than once."""
        placement = self._sections.placement
        start, direction = placement.to_model(start), (end - start) @ placement.rotation.T
        surfaces = {"periosteum": self._bone.periosteum, "endosteum": self._bone.endosteum}
        for name, radius in surfaces.items():
            inside = np.array(
                [
                    self._depth_inside(radius, start + fraction * direction)
                    for fraction in LINE_FRACTIONS
                ]
            )
            crossings = ((inside[1:] > 0) != (inside[:-1] > 0)).sum(axis=0)
            crossing_lines = np.flatnonzero(crossings > 1)
            if len(crossing_lines):
                x = placement.point_in_words(start[crossing_lines[0]])
                raise GeometryError(
                    f"geometry: a line across the bone from {x} meets the {name} more than once;"
                    " move or rotate the stem, or smooth the surface there"
                )
