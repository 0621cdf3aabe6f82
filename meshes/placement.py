"""The neck cut, and where the stem is in the bone.

The model's axes: z along the shaft, proximal positive, 0 at the lesser trochanter; x medial; y
anterior. The stem's axes have their origin on its axis, at the level that its keys count from, z up
its axis and x towards its head. Sections of the mesh are planes of the stem's axes.

A bone answers the questions of `ResectedBone`: `femur_bone.FemurBone` of the parametric femur, or
one of another package.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from app.foundation.arrays import Floats
from app.foundation.errors import GeometryError
from meshes import femur_stem

EXACT = 1e-12  # of a cut's normal: rounded off


@dataclass(frozen=True, eq=False)  # arrays have no one truth: geometries compare their keys
class Placement:
    """The neck cut and the stem, in the model's axes.

    Attributes:
        normal: Unit normal of the neck cut (3,): the bone below it is kept.
        turn: Axes of the stem as columns (3, 3).
        foot: Point in which its axis meets the cut (3,) [mm].
        top: Height of that point in the stem's axes [mm].
        mirrored: True if the model is the mirror image of the bone: a right femur.
    """

    normal: Floats
    turn: Floats
    foot: Floats
    top: float
    mirrored: bool = False

    @cached_property
    def origin(self) -> Floats:
        """Origin of the stem's axes (3,) [mm]."""
        return np.asarray(self.foot - self.top * self.turn[:, 2])

    def to_stem(self, x: Any) -> Floats:
        """Points of the model (..., 3) in the stem's axes [mm]."""
        return np.asarray((x - self.origin) @ self.turn)

    def to_model(self, x: Any) -> Floats:
        """Points in the stem's axes (..., 3) in those of the model [mm]."""
        return np.asarray(np.asarray(x) @ self.turn.T + self.origin)

    def along(self, z: float) -> float:
        """Height in the stem's axes at which its axis is at a level of the model [mm]."""
        return float(self.top + (z - self.foot[2]) / self.turn[2, 2])

    @cached_property
    def slopes(self) -> tuple[float, float]:
        """Slope of the cut along x of the stem, and along y over that along x."""
        x, y, z = self.normal @ self.turn
        return x / z, y / x if abs(y) > EXACT else 0.0

    @property
    def tilt(self) -> float:
        """Slope of the stem's axis to the shaft's."""
        x, y, z = self.turn[:, 2]
        return math.hypot(x, y) / float(z)

    def where(self, x: Floats) -> str:
        """A point of the model (3,) in words."""
        below = round(float(self.normal @ (self.foot - x)) / self.normal[2])
        side = "above" if below < 0 else "below"
        return "({:.0f}, {:.0f}, {:.0f}) mm".format(*x) + f", {abs(below)} mm {side} the cut"


class ResectedBone(Protocol):
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

    def reach(self, azimuth: float, height: float) -> float:
        """Distance of the surface from the shaft's axis [mm].

        Raises:
            GeometryError: The axis is outside of the bone at this height.
        """


def place(geometry: Any) -> Placement:
    """Cut the neck of a bone and place the stem in it.

    Without ``insertion`` the stem is along the shaft's axis, turned to the neck. Without
    ``shoulder_depth`` its height is the one that its keys give.

    Raises:
        GeometryError: The cut is beside the bone, or condyles are asked for that are not there.
    """
    femur, cut, insertion = geometry.femur, geometry.resection, geometry.insertion
    azimuth = femur.neck if cut.azimuth is None else cut.azimuth
    way = np.array([math.cos(azimuth), math.sin(azimuth)])
    normal = np.r_[math.sin(cut.angle) * way, math.cos(cut.angle)]
    level = float(normal @ [*(femur.reach(azimuth, cut.height) * way), cut.height])
    version, varus, aside = femur.neck, 0.0, np.zeros(2)
    if insertion:
        version, varus = insertion.version.angle, insertion.varus
        if insertion.version.relative_to == "neck":
            version += femur.neck
        elif not femur.has_condyles:
            text = "is against the condyles, which this surface does not have"
            raise GeometryError(f"geometry.insertion.version: {text}; give relative_to: neck")
        anterior = np.array([-way[1], way[0]])
        aside = insertion.medial_offset * way + insertion.anterior_offset * anterior
    c, s = math.cos(version), math.sin(version)
    cv, sv = math.cos(varus), math.sin(varus)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ [[cv, 0, sv], [0, 1, 0], [-sv, 0, cv]]
    foot = np.r_[aside, (level - float(normal[:2] @ aside)) / normal[2]]
    placed = Placement(normal, turn, foot, level / normal[2], femur.mirrored)
    if geometry.shoulder_depth is None:
        return placed
    edge = femur_stem.edge(geometry.implant, placed.slopes[0])
    return replace(placed, top=edge + geometry.shoulder_depth)
