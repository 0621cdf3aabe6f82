"""A patient's bone in the axes of the model, its neck cut, and where the stem is in it.

A right femur is mirrored into the axes of the parametric femur (`meshes.placement`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from app.foundation.arrays import Floats
from app.foundation.errors import GeometryError
from meshes import bone_frame, bone_surface
from meshes.bone_frame import Frame
from meshes.bone_surface import BoneSurface, centroid, exits
from meshes.placement import Placement, deep, put

# Of the parametric femur [mm]: from the axis to the greater trochanter, height of the head, radius
# of the shaft and its level.
LATERAL, HEAD, SHAFT, LEVEL = 31.5, 54.0, 14.4, -50.0
BELOW_CUT = 8.0  # mm that the middle of a muscle's patch is below the cut, at least


@dataclass(frozen=True)
class PatientPlacement(Placement):
    """The neck cut and the stem on a patient's bone.

    Attributes:
        frame: Landmarks found on the bone.
        bone: Its surface, in the model's axes.
        canal: Surface of its canal, or None.
    """

    frame: Frame
    bone: BoneSurface
    canal: BoneSurface | None

    @property
    def notes(self) -> list[str]:
        """Doubts about the size and shape of the bone, and about an open proximal end."""
        return self.frame.doubts(self.bone)

    @property
    def mirrored(self) -> bool:
        """True if the model is the mirror image of the patient's bone: a right femur."""
        return self.frame.side == "right"

    @property
    def size(self) -> float:
        """Height of the patient's head over that of the parametric femur."""
        return float(self.frame.to_model(self.frame.head)[2]) / HEAD

    @cached_property
    def _skin(self) -> tuple[Any, Floats]:
        """Tree of the bone's corners, and outward normals there (n, 3)."""
        a, b, c = self.bone.corners.transpose(1, 0, 2)
        normals = np.zeros_like(self.bone.points)
        np.add.at(normals, self.bone.triangles, np.cross(b - a, c - a)[:, None])
        return cKDTree(self.bone.points), normals / np.linalg.norm(normals, axis=1)[:, None]

    def in_file(self, x: Floats, depth: float) -> Floats:
        """Points of the model (n, 3) in the file's axes, at a depth in the bone at least [mm]."""
        tree, normals = self._skin
        _, near = tree.query(x)
        n = normals[near]
        below = ((self.bone.points[near] - x) * n).sum(axis=1)
        moved = x - np.maximum(depth - below, 0.0)[:, None] * n
        return np.asarray(moved @ self.frame.axes + self.frame.origin)

    @property
    def trochanter_lost(self) -> float:
        """Height of the greater trochanter's tip above the cut, along its normal [mm]."""
        x = self.bone.points - self.foot
        return float((x[(x[:, 0] < 0) & (x[:, 2] > 0)] @ self.normal).max(initial=0.0))

    def projected(self, places: Mapping[str, Any]) -> tuple[dict[str, Floats], list[str]]:
        """Points of the parametric femur on this bone below the cut, and how far they were moved.

        They are scaled to its head's height and its shaft, beside the greater trochanter to that.
        """
        x, up = self.bone.points, self.size
        wide = math.sqrt(centroid(self.bone.level(LEVEL * up))[1] / math.pi) / SHAFT
        beside = -float(x[(x[:, 2] > 0) & (x[:, 2] < 40 * up), 0].min()) / LATERAL
        kept = self.bone.corners.mean(axis=1)
        kept = kept[(kept - self.foot) @ self.normal < -BELOW_CUT]
        found: dict[str, Floats] = {}
        distances = []
        for name, (px, py, pz) in places.items():
            scaled = np.array([px * (beside if px < 0 < pz else wide), py * wide, pz * up])
            found[name] = kept[((kept - scaled) ** 2).sum(axis=1).argmin()]
            distances.append(f"{name} {float(np.linalg.norm(found[name] - scaled)):.0f}")
        return found, distances


@lru_cache(maxsize=8)
def _found(bone: Any, content: str, known: Any) -> tuple[Frame, BoneSurface]:
    """Frame and surface of the bone in a file, whose content is a part of the key."""
    surface = bone_surface.read(bone.path, bone.unit, bone.label)
    frame = bone_frame.find(surface, dict(known))
    return frame, frame.surface(surface)


def place(geometry: Any) -> PatientPlacement:
    """Read the bone, find its landmarks, cut the neck and place the stem.

    Raises:
        GeometryError: A file is damaged or is no femur, or the cut is beside the bone.
    """
    given, canal = geometry.bone, None
    frame, bone = _found(given, geometry.content, geometry.known)
    if path := geometry.canal.path:
        unit = geometry.canal.unit or given.unit
        canal = frame.surface(bone_surface.read(path, unit, geometry.canal.label))
    cut, insertion = geometry.resection, geometry.insertion
    azimuth = frame.azimuth if cut.azimuth is None else cut.azimuth
    way = np.array([math.cos(azimuth), math.sin(azimuth)])
    normal = np.r_[math.sin(cut.angle) * way, math.cos(cut.angle)]
    edge = float(exits(bone.level(cut.height), np.array([azimuth]))[0][0])
    if not edge > 0:
        text = f"{cut.height:g} mm above the trochanter the shaft's axis is outside of the bone"
        raise GeometryError(f"geometry.resection.height: {text}; cut lower")
    version = insertion.version.angle
    if insertion.version.relative_to == "neck":
        version += frame.azimuth
    elif frame.version is None:
        text = "is against the condyles, which this surface does not have"
        raise GeometryError(f"geometry.insertion.version: {text}; give relative_to: neck")
    level = float(normal @ [*(edge * way), cut.height])
    axes = put(insertion, version, way, normal, level)
    return deep(PatientPlacement(*axes, 0.0, frame, bone, canal), geometry)
