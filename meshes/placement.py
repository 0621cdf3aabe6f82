"""The neck cut, and where the stem is in the bone.

The model's axes: z along the shaft, proximal positive, 0 at the lesser trochanter; x medial; y
anterior. The stem's own axes have their origin at the middle of its shoulder, z up its axis and x
towards its head: placing the stem is moving the bone, and sections are taken in the stem's axes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from app.foundation.arrays import Floats
from meshes import femur_bone, femur_stem

EXACT = 1e-12  # of a cut's normal: rounded off


@dataclass(frozen=True, eq=False)  # arrays have no one truth: geometries compare their keys
class Placement:
    """The neck cut and the stem, in the model's axes.

    Attributes:
        normal: Unit normal of the neck cut (3,): what is below is kept.
        turn: Axes of the stem as columns (3, 3).
        foot: Where its axis meets the cut (3,) [mm].
        top: The same on its axis: height in the stem's axes [mm].
    """

    normal: Floats
    turn: Floats
    foot: Floats
    top: float

    def to_stem(self, x: Any) -> Floats:
        """Points of the model (..., 3) in the stem's axes [mm]."""
        return np.asarray((x - self.foot) @ self.turn + [0.0, 0.0, self.top])

    def to_model(self, x: Any) -> Floats:
        """Points in the stem's axes (..., 3) in those of the model [mm]."""
        return np.asarray(np.subtract(x, [0.0, 0.0, self.top]) @ self.turn.T + self.foot)

    @property
    def slopes(self) -> tuple[float, float]:
        """Slope of the cut along x of the stem, and along y over that along x."""
        x, y, z = self.normal @ self.turn
        return x / z, y / x if abs(y) > EXACT else 0.0

    @property
    def mirrored(self) -> bool:
        """Whether the model is the mirror image of what is operated on."""
        return False

    def where(self, x: Floats) -> str:
        """A point of the model (3,) in words."""
        below = round(float(self.normal @ (self.foot - x)) / self.normal[2])
        side = "above" if below < 0 else "below"
        return "({:.0f}, {:.0f}, {:.0f}) mm".format(*x) + f", {abs(below)} mm {side} the cut"


def of_femur(geometry: Any) -> Placement:
    """The placement in the parametric femur: by default its stem is turned by its anteversion."""
    (x, _, z), level = femur_bone.resection(geometry)
    angle, given = geometry.anteversion, getattr(geometry, "insertion", None)
    way = np.array([math.cos(angle), math.sin(angle)])
    if given:
        angle = given.version.angle + (angle if given.version.relative_to == "neck" else 0.0)
    placed = Placement(*put(given, angle, way, np.r_[x * way, z], level), level / z)
    return deep(placed, geometry) if given and given.depth is not None else placed


def put(
    insertion: Any, version: float, way: Floats, normal: Floats, level: float
) -> tuple[Floats, Floats, Floats]:
    """Normal of a cut, its level and azimuth (2,) given, axes of a stem, and where it meets it."""
    varus, aside = 0.0, np.zeros(2)
    if insertion:
        varus = insertion.varus
        medial, anterior = insertion.medial_offset, insertion.anterior_offset
        aside = medial * way + anterior * np.array([-way[1], way[0]])
    c, s, cv, sv = (f(v) for v in (version, varus) for f in (math.cos, math.sin))
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ [[cv, 0, sv], [0, 1, 0], [-sv, 0, cv]]
    return normal, turn, np.r_[aside, (level - float(normal[:2] @ aside)) / normal[2]]


def deep(placed: Any, geometry: Any) -> Any:
    """The same with the lateral edge of the stem's shoulder at its depth below the cut."""
    edge = femur_stem.edge(geometry.implant, placed.slopes[0])
    return replace(placed, top=edge + (geometry.insertion.depth or 0.0))
