"""Neck cut, and position of the stem in the bone.

The model's axes: z along the shaft, proximal positive, 0 at the lesser trochanter; x medial; y
anterior. The stem's axes have their origin on its axis, at the level that its keys count from, z up
its axis and x towards its head. Sections of the mesh are planes given in the stem's axes. They tilt
towards the plane of the neck cut.

A bone answers the questions of `bone_layers.LayeredBone`: `femur_bone.FemurBone` of the parametric
femur, or one of another package.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from app.foundation.arrays import Floats
from app.foundation.errors import GeometryError
from app.foundation.implant import Implant
from app.foundation.layout import fixed
from meshes import femur_stem

if TYPE_CHECKING:
    from app.case.hips import Hip

ROUNDING_OF_CUT_NORMAL = 1e-12  # of a cut's normal: rounded off
# Largest slope of the cut along y of the stem over that along x. Sections of the mesh are tilted by
# multiples of both slopes, which a cut that slopes along y alone does not have.
MOST_LEAN = 3.0
# Least depth of a shoulder below the cut [mm]; a higher one counts as at the cut.
LEAST_SHOULDER_DEPTH = 2.5
# Beginning of the message on a stem for which the search finds no room.
NO_POSITION = "no position within the limits of the search"


@dataclass(frozen=True, eq=False)  # arrays have no one truth: geometries compare their keys
class Placement:
    """The neck cut and the stem, in the model's axes.

    Attributes:
        normal: Unit normal of the neck cut (3,): the bone below it is kept.
        rotation: Axes of the stem as columns (3, 3).
        foot: Point in which its axis meets the cut (3,) [mm].
        top: Height of that point in the stem's axes [mm].
        mirrored: True if the model is the mirror image of the bone: a right femur.
    """

    normal: Floats
    rotation: Floats
    foot: Floats
    top: float
    mirrored: bool = False

    @cached_property
    def origin(self) -> Floats:
        """Origin of the stem's axes (3,) [mm]."""
        return np.asarray(self.foot - self.top * self.rotation[:, 2])

    def to_stem(self, x: ArrayLike) -> Floats:
        """Points of the model (..., 3) in the stem's axes [mm]."""
        return np.asarray((np.asarray(x) - self.origin) @ self.rotation)

    def to_model(self, x: ArrayLike) -> Floats:
        """Points in the stem's axes (..., 3) in those of the model [mm]."""
        return np.asarray(np.asarray(x) @ self.rotation.T + self.origin)

    def along(self, z: float) -> float:
        """Height in the stem's axes at which its axis is at a level of the model [mm]."""
        return float(self.top + (z - self.foot[2]) / self.rotation[2, 2])

    @cached_property
    def slopes(self) -> tuple[float, float]:
        """Slope of the cut along x of the stem, and along y over that along x.

        Raises:
            GeometryError: The cut slopes along y alone.
        """
        x, y, z = self.normal @ self.rotation
        if abs(y) <= ROUNDING_OF_CUT_NORMAL:
            return x / z, 0.0
        if abs(y) > MOST_LEAN * abs(x):
            across, sideways = (math.degrees(math.atan(abs(v) / z)) for v in (x, y))
            raise GeometryError(
                f"geometry.resection: against the stem the neck cut is inclined by {across:.2g} "
                f"degrees from lateral to medial, but by {sideways:.2g} degrees from front to back;"
                " expected less from front to back: a larger angle of the resection, or less"
                " flexion or version of the stem"
            )
        return x / z, y / x

    @property
    def tilt(self) -> float:
        """Slope of the stem's axis to the shaft's."""
        x, y, z = self.rotation[:, 2]
        return math.hypot(x, y) / float(z)

    def point_in_words(self, x: Floats) -> str:
        """A point of the model (3,) in words."""
        below = round(float(self.normal @ (self.foot - x)) / self.normal[2])
        side = "above" if below < 0 else "below"
        return f"({', '.join(fixed(v, 0) for v in x)}) mm, {abs(below)} mm {side} the cut"


@dataclass(frozen=True)
class Position:
    """Position of a stem in a bone. Lengths are in mm, angles in rad.

    Attributes:
        depth: Depth of the shoulder's lateral edge below the cut. None: the stem's levels are those
            of the model.
        varus: Tilt of the stem, its tip to lateral.
        flexion: Tilt of the stem, its tip to posterior.
        version: Azimuth of the stem's neck, from medial to anterior.
        medial: Distance of the stem's axis from the shaft's along the azimuth of the cut.
        anterior: Distance of the stem's axis from the shaft's across that.
    """

    depth: float | None
    varus: float
    flexion: float
    version: float
    medial: float
    anterior: float


@dataclass(frozen=True, eq=False)
class CutPlane:
    """The plane of the neck cut, in the model's axes.

    Attributes:
        normal: Unit normal (3,): the bone below it is kept.
        level: Product of the normal with points of the plane [mm].
        direction: Direction of its azimuth across the shaft (2,).
    """

    normal: Floats
    level: float
    direction: Floats

    @classmethod
    def of(cls, geometry: Hip) -> CutPlane:
        """The cut of a bone.

        Raises:
            GeometryError: It is beside the bone.
        """
        femur, cut = geometry.femur, geometry.resection
        azimuth = femur.neck if cut.azimuth is None else cut.azimuth
        direction = np.array([math.cos(azimuth), math.sin(azimuth)])
        normal = np.r_[math.sin(cut.angle) * direction, math.cos(cut.angle)]
        level = float(normal @ [*(femur.reach(azimuth, cut.height) * direction), cut.height])
        return cls(normal, level, direction)

    def put(self, implant: Implant, position: Position, mirrored: bool) -> Placement:
        """The placement of a stem."""
        anterior = np.array([-self.direction[1], self.direction[0]])
        offset = position.medial * self.direction + position.anterior * anterior
        foot = np.r_[offset, (self.level - float(self.normal[:2] @ offset)) / self.normal[2]]
        rotation = _rotation(position)
        placement = Placement(self.normal, rotation, foot, self.level / self.normal[2], mirrored)
        if position.depth is None:
            return placement
        edge = femur_stem.shoulder_plane_height(implant, placement.slopes[0])
        return replace(placement, top=edge + position.depth)


def _rotation(position: Position) -> Floats:
    """Axes of a stem as columns (3, 3): flexion first, then varus, then version."""
    (c, s), (cv, sv), (cf, sf) = (
        (math.cos(angle), math.sin(angle))
        for angle in (position.version, position.varus, position.flexion)
    )
    version = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return version @ [[cv, 0, sv], [0, 1, 0], [-sv, 0, cv]] @ [[1, 0, 0], [0, cf, sf], [0, -sf, cf]]


def position(geometry: Hip) -> Position:
    """Position of the stem of a geometry.

    Without ``insertion`` the stem is along the shaft's axis, turned to the neck. Without
    ``shoulder_depth`` its height is the one that its keys give.

    Raises:
        GeometryError: Condyles are asked for that are not there.
    """
    femur, insertion = geometry.femur, geometry.insertion
    if not insertion:
        return Position(geometry.shoulder_depth, 0.0, 0.0, femur.neck, 0.0, 0.0)
    version = insertion.version.angle
    if insertion.version.relative_to == "neck":
        version += femur.neck
    elif not femur.has_condyles:
        reason = "is measured from the condyles, which this surface does not have"
        raise GeometryError(f"geometry.insertion.version: {reason}; set relative_to: neck")
    tilts = (insertion.varus, insertion.flexion)
    offsets = (insertion.medial_offset, insertion.anterior_offset)
    return Position(geometry.shoulder_depth, *tilts, version, *offsets)


def placement_of(geometry: Hip) -> Placement:
    """Cut the neck of a bone and place the stem in it.

    Raises:
        GeometryError: The cut is beside the bone, or condyles are asked for that are not there.
    """
    return CutPlane.of(geometry).put(geometry.implant, position(geometry), geometry.femur.mirrored)


def shoulder_level(implant: Implant, placement: Placement, x: Floats) -> Floats:
    """Level function of a stem's shoulder at points (n, 3): not positive on it (n,) [mm].

    The shoulder is the surface above the section through its lateral edge, within the shaft
    continued upwards: medially the stem is wider. If the shoulder is at the cut or above, all
    levels are positive.
    """
    edge = femur_stem.shoulder_plane_height(implant, placement.slopes[0])
    if edge > placement.top - LEAST_SHOULDER_DEPTH:
        return np.full(len(x), implant.length)
    local = placement.to_stem(x)
    slope, lean = placement.slopes
    section = edge - slope * (local[:, 0] + lean * local[:, 1])
    medial = femur_stem.half_width(implant, local[:, 2])
    return np.asarray(np.maximum(section - local[:, 2], local[:, 0] - medial))


def lengthening(geometry: Hip) -> float:
    """Change of the leg length by the operation: of the height of the head along the shaft [mm]."""
    return float(stem_head(geometry)[2] - geometry.femur.head[2])


def stem_head(geometry: Hip) -> Floats:
    """Centre of the stem's head in the model's axes (3,) [mm]."""
    implant = geometry.implant
    return geometry.placement.to_model([implant.head_offset, 0.0, implant.head_height])


def head_in_words(geometry: Hip) -> str:
    """Offset, leg length and version of the stem's head, with their changes by the operation.

    The offset is the distance of the head's centre from the shaft's axis. Version is the azimuth of
    the neck about it.
    """
    placement, femur = geometry.placement, geometry.femur
    head, intact = stem_head(geometry), femur.head
    offset, intact_offset = math.hypot(*head[:2]), math.hypot(*intact[:2])
    version = math.degrees(math.atan2(placement.rotation[1, 0], placement.rotation[0, 0]))
    changes = offset - intact_offset, lengthening(geometry), version - math.degrees(femur.neck)
    offset_change, length_change, rotation = (fixed(change, sign="+") for change in changes)
    return (
        f"offset {fixed(offset)} mm ({offset_change} against the intact head),"
        f" leg length {length_change} mm, version {fixed(version)} deg ({rotation})"
    )
