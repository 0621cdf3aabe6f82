"""A patient's bone in the axes of the model, the neck cut, and where the stem is in it.

The model's axes are those of the parametric femur: z along the shaft, proximal positive, 0 at the
lesser trochanter; x medial; y anterior. A right femur is mirrored into them. The stem's own axes
have their origin at the middle of its shoulder, z up its axis and x towards its head: placing the
stem is moving the bone, and sections are taken in the stem's axes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from app.arrays import Floats
from app.errors import GeometryError
from meshes import bone_frame, bone_surface, femur_bone, femur_stem
from meshes.bone_frame import Frame
from meshes.bone_surface import BoneSurface, centroid, exits

# Of the parametric femur [mm]: from the axis to the greater trochanter, height of the head, radius
# of the shaft and its level.
LATERAL, HEAD, SHAFT, LEVEL = 31.5, 54.0, 14.4, -50.0
EXACT = 1e-12  # of a cut's normal: rounded off
BELOW_CUT = 8.0  # mm that the middle of a muscle's patch is below the cut, at least


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


@dataclass(frozen=True)
class PatientPlacement(Placement):
    """The same on a patient's bone.

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
        """Whether the model is the mirror image of what is operated on: a right femur."""
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
        """How far the greater trochanter's tip is above the cut, along its normal [mm]."""
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
        found, told = {}, []
        for name, (px, py, pz) in places.items():
            scaled = np.array([px * (beside if px < 0 < pz else wide), py * wide, pz * up])
            found[name] = kept[((kept - scaled) ** 2).sum(axis=1).argmin()]
            told.append(f"{name} {float(np.linalg.norm(found[name] - scaled)):.0f}")
        return found, told


@lru_cache(maxsize=8)
def _found(bone: Any, content: str, known: Any) -> tuple[Frame, BoneSurface]:
    """Frame and surface of the bone in a file, whose content is a part of the key."""
    surface = bone_surface.read(bone.path, bone.unit, bone.label)
    frame = bone_frame.find(surface, dict(known))
    return frame, frame.surface(surface)


def of_femur(geometry: Any) -> Placement:
    """The placement in the parametric femur: by default its stem is turned by its anteversion."""
    (x, _, z), level = femur_bone.resection(geometry)
    angle, given = geometry.anteversion, getattr(geometry, "insertion", None)
    way = np.array([math.cos(angle), math.sin(angle)])
    if given:
        angle = given.version.angle + (angle if given.version.relative_to == "neck" else 0.0)
    placed = Placement(*_put(given, angle, way, np.r_[x * way, z], level), level / z)
    return _deep(placed, geometry) if given and given.depth is not None else placed


def _put(
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


def _deep(placed: Any, geometry: Any) -> Any:
    """The same with the lateral edge of the stem's shoulder at its depth below the cut."""
    edge = femur_stem.edge(geometry.implant, placed.slopes[0])
    return replace(placed, top=edge + (geometry.insertion.depth or 0.0))


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
    put = _put(insertion, version, way, normal, level)
    return _deep(PatientPlacement(*put, 0.0, frame, bone, canal), geometry)
