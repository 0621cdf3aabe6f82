"""A patient's bone in the axes of the model, the neck cut, and where the stem is in it.

The model's axes are those of the parametric femur: z along the shaft, proximal positive, 0 at the
lesser trochanter; x medial; y anterior. A right femur is mirrored into them. The stem's own axes
have their origin at the middle of its shoulder, z up its axis and x towards its head: placing the
stem is moving the bone, and sections are taken in the stem's axes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from app.arrays import Floats
from app.errors import GeometryError
from meshes import bone_frame, bone_surface, femur_stem
from meshes.bone_frame import Frame
from meshes.bone_surface import Surface, centroid, exits, section

LATERAL = 31.5  # mm from the axis to the greater trochanter of the parametric femur
HEAD, SHAFT = 54.0, 14.4  # mm: height of its head, half-width of its shaft at `LEVEL`
LEVEL = -50.0  # mm
BELOW_CUT = 8.0  # mm that the middle of a muscle's patch is below the cut, at least


@dataclass(frozen=True)
class Placement:
    """Bone, canal, cut and stem of a patient.

    Attributes:
        frame: Landmarks found on the bone.
        bone: Its surface, in the model's axes as all below.
        canal: Surface of its canal, or None.
        normal: Unit normal of the neck cut (3,): what is below is kept.
        level: normal . x of its points [mm].
        turn: Axes of the stem as columns (3, 3).
        foot: Where its axis meets the cut (3,) [mm].
        top: The same on its axis: height above the shoulder [mm].
        told: What was found, in words.
    """

    frame: Frame
    bone: Surface
    canal: Surface | None
    normal: Floats
    level: float
    turn: Floats
    foot: Floats
    top: float
    told: tuple[str, ...]

    def to_stem(self, x: Floats) -> Floats:
        """Points of the model (..., 3) in the stem's axes [mm]."""
        return np.asarray((x - self.foot) @ self.turn + [0.0, 0.0, self.top])

    def to_model(self, x: Floats) -> Floats:
        """Points in the stem's axes (..., 3) in those of the model [mm]."""
        return np.asarray((np.asarray(x) - [0.0, 0.0, self.top]) @ self.turn.T + self.foot)

    @property
    def slopes(self) -> tuple[float, float]:
        """Slope of the cut along x of the stem, and along y over that along x."""
        x, y, z = self.normal @ self.turn
        return x / z, y / x

    def where(self, x: Floats) -> str:
        """A point of the model (3,) in words."""
        below = (self.level - float(self.normal @ x)) / self.normal[2]
        return "({:.0f}, {:.0f}, {:.0f}) mm, {:.0f} mm below the cut".format(*x, below)

    @cached_property
    def trochanter_lost(self) -> float:
        """How far the greater trochanter's tip is above the cut, along its normal [mm]."""
        x = self.bone.points
        lateral = x[(x[:, 0] < 0) & (x[:, 2] > 0)]
        return float(max(0.0, (lateral @ self.normal).max() - self.level))

    def projected(self, places: Mapping[str, Any]) -> tuple[dict[str, Floats], list[str]]:
        """Points of the parametric femur on this bone below the cut, and how far they were moved.

        They are scaled to its head's height and its shaft, beside the greater trochanter to that.
        """
        x = self.bone.points
        up = float(self.frame.to_model(self.frame.head)[2]) / HEAD
        lines = section(x[:, :2], x[:, 2] - LEVEL * up, self.bone.triangles)
        wide = math.sqrt(centroid(lines)[1] / math.pi) / SHAFT
        beside = -float(x[(x[:, 2] > 0) & (x[:, 2] < 40 * up), 0].min()) / LATERAL
        kept = self.bone.corners.mean(axis=1)
        kept = kept[kept @ self.normal < self.level - BELOW_CUT]
        found, told = {}, []
        for name, place in places.items():
            px, py, pz = place
            lateral = px < 0 < pz
            scaled = np.array([px * (beside if lateral else wide), py * wide, pz * up])
            nearest = kept[((kept - scaled) ** 2).sum(axis=1).argmin()]
            found[name] = nearest
            told.append(f"{name}: {float(np.linalg.norm(nearest - scaled)):.0f}")
        return found, told


@lru_cache(maxsize=8)
def _found(
    path: Path, content: str, unit: str | None, landmarks: tuple[tuple[str, Any], ...]
) -> tuple[Frame, Surface]:
    """Frame and surface of the bone in a file, of which the content is a part of the key."""
    surface = bone_surface.read(path, unit)
    frame = bone_frame.find(surface, dict(landmarks))
    return frame, frame.surface(surface)


def place(geometry: Any) -> Placement:
    """Read the bone, find its landmarks, cut the neck and place the stem.

    Raises:
        GeometryError: A file is damaged or is no femur, or the stem's axis leaves the bone.
    """
    frame, bone = _found(
        geometry.bone.surface, geometry.content, geometry.bone.unit, geometry.known
    )
    told = [*bone.told, *frame.lines]
    canal = None
    if geometry.canal.surface:
        unit = geometry.canal.unit or geometry.bone.unit
        canal = frame.surface(bone_surface.read(geometry.canal.surface, unit))
    cut, insertion = geometry.resection, geometry.insertion
    azimuth = frame.azimuth if cut.azimuth is None else cut.azimuth
    sine = math.sin(cut.angle)
    normal = np.array([sine * math.cos(azimuth), sine * math.sin(azimuth), math.cos(cut.angle)])
    x = bone.points
    lines = section(x[:, :2], x[:, 2] - cut.height, bone.triangles)
    edge = float(exits(lines, np.array([azimuth]))[0][0])
    if not edge > 0:
        text = f"the shaft's axis is outside of the bone {cut.height:g} mm above the trochanter"
        raise GeometryError(f"geometry.resection.height: {text}; cut lower")
    level = float(normal @ [edge * math.cos(azimuth), edge * math.sin(azimuth), cut.height])
    version = insertion.version.angle
    if insertion.version.relative_to == "neck":
        version += frame.azimuth
    elif frame.version is None:
        text = "is told against the condyles, which this surface has not"
        raise GeometryError(f"geometry.insertion.version: {text}; give relative_to: neck")
    c, s, cv, sv = *_turn(version), *_turn(insertion.varus)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ [[cv, 0, sv], [0, 1, 0], [-sv, 0, cv]]
    way, side = np.array([math.cos(azimuth), math.sin(azimuth)]), insertion.anterior_offset
    shift = np.r_[insertion.medial_offset * way + side * np.array([-way[1], way[0]]), 0.0]
    shift[2] = level / normal[2] - float(normal @ shift) / normal[2]
    slope = float((normal @ turn)[0] / (normal @ turn)[2])
    half = float(femur_stem.body(geometry.implant).section(0.0)[0])
    top = insertion.depth - slope * half
    return Placement(frame, bone, canal, normal, level, turn, shift, top, tuple(told))


def _turn(angle: float) -> tuple[float, float]:
    return math.cos(angle), math.sin(angle)
