"""A patient's bone in the axes of the model: its surface, its canal and its landmarks.

A right femur is mirrored into the axes of the parametric femur (`meshes.placement`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from scipy.spatial import cKDTree

from app.foundation.arrays import Floats, Ints
from app.foundation.errors import GeometryError
from app.patient import bone_surface, ct_canal, label_surface, landmarks, shaft
from app.patient.bone_surface import BoneSurface
from app.patient.landmarks import Frame
from app.patient.measured_layers import MeasuredLayers
from app.patient.shaft import CanalByRatios, Continuation
from meshes import femur_bone
from meshes.bone_layers import StemShape
from meshes.femur_bone import HEAD_HEIGHT
from meshes.layers import Sections
from meshes.placement import Placement
from meshes.plane_sections import exits, mean_width

if TYPE_CHECKING:
    from app.patient.geometry import Bone, Canal, Patient

# Of the parametric femur [mm].
TROCHANTER_REACH = 31.5  # from the axis to the greater trochanter
SHAFT_RADIUS = 14.4  # radius of the shaft
SHAFT_LEVEL = -50.0  # level of that radius
CONTINUED_TO = -260.0  # level down to which a shaft is continued, as that of the parametric femur
TROCHANTER_ENDS = 0.75  # radii of the head below the apex where the lesser trochanter ends
CUT_DISTANCE = 6.0  # mm from the bone's end within which a canal ends with the scan
BELOW_CUT = 8.0  # mm that the middle of a muscle's patch is below the cut, at least


@dataclass(frozen=True, eq=False)
class PatientBone:
    """A patient's bone.

    Attributes:
        frame: Landmarks of the bone.
        surface: Its surface, in the model's axes.
        canal: Surface of its canal, or None.
        continuation: The shaft below the end of the scan, which both surfaces have; None: they end
            with the scan.
        by_ratios: The canal that replaces a surface; None: there is a surface.
    """

    frame: Frame
    surface: BoneSurface
    canal: BoneSurface | None
    continuation: Continuation | None = None
    by_ratios: CanalByRatios | None = None
    is_radial: ClassVar[bool] = False

    @property
    def neck(self) -> float:
        """Azimuth of the neck, from medial to anterior [rad]."""
        return self.frame.azimuth

    @property
    def has_condyles(self) -> bool:
        """True if the posterior condyles are on the surface."""
        return self.frame.version is not None

    @property
    def mirrored(self) -> bool:
        """True if the model is the mirror image of the patient's bone: a right femur."""
        return self.frame.side == "right"

    @property
    def side_doubt(self) -> str:
        """The other side as a doubt, if the axes of the file contradict the side; else empty.

        Medial of a left femur is to the right.
        """
        if (float(self.frame.axes[0, 0]) > 0.0) == (self.frame.side == "left"):
            return ""
        return "by the axes of the image it is the other side; is the image mirrored or rotated?"

    def reach(self, azimuth: float, height: float) -> float:
        """Distance of the surface from the shaft's axis [mm].

        Raises:
            GeometryError: The axis is outside of the bone at this height.
        """
        edge = float(exits(self.surface.level(height), np.array([azimuth]))[0][0])
        if not edge > 0:
            fault = f"the axis of the shaft is outside the bone {height:g} mm above the trochanter"
            raise GeometryError(f"geometry.resection.height: {fault}; cut lower")
        return edge

    @property
    def head(self) -> Floats:
        """Centre of the head (3,) [mm]."""
        return np.asarray(self.frame.to_model(self.frame.head))

    @property
    def drawn(self) -> tuple[Floats, Ints]:
        """Corners (n, 3) [mm] and triangles (m, 3) of the surface, for pictures."""
        return self.surface.points, self.surface.triangles

    @property
    def lowest(self) -> float:
        """Level at which the surface ends [mm]."""
        return float(self.surface.points[:, 2].min())

    @property
    def assumed_isthmus(self) -> float | None:
        """Mean width of the canal at its isthmus [mm], if no file shows it."""
        if self.by_ratios:
            return self.by_ratios.isthmus
        continued_canal = self.continuation.canal if self.continuation else None
        return continued_canal.isthmus if continued_canal and continued_canal.is_assumed else None

    @property
    def notes(self) -> list[str]:
        """Doubts about files, the size and shape of the bone, and an open proximal end."""
        doubts = [*self.frame.doubts(self.surface), *(self.canal.doubts if self.canal else ())]
        return list(dict.fromkeys(doubts))

    @property
    def size(self) -> float:
        """Height of the patient's head over that of the parametric femur."""
        return float(self.head[2]) / HEAD_HEIGHT

    def layers(
        self, geometry: Patient, sections: Sections, stem: StemShape | None
    ) -> MeasuredLayers:
        """Periosteum and endosteum in the sections of a mesh, the canal reamed.

        Raises:
            GeometryError: The stem's axis leaves the bone, or a surface crosses itself.
        """
        keys, implant = geometry.canal, geometry.implant
        scale = self.by_ratios.scale if self.by_ratios else 1.0
        bone = self.surface, self.canal, scale, self.size
        return MeasuredLayers(*bone, keys, implant, sections, stem)

    @cached_property
    def _skin(self) -> tuple[Any, Floats]:
        """Tree of the bone's corners, and outward normals there (n, 3)."""
        a, b, c = self.surface.corners.transpose(1, 0, 2)
        normals = np.zeros_like(self.surface.points)
        np.add.at(normals, self.surface.triangles, np.cross(b - a, c - a)[:, None])
        return cKDTree(self.surface.points), normals / np.linalg.norm(normals, axis=1)[:, None]

    def in_file(self, x: Floats, depth: float) -> Floats:
        """Points of the model (n, 3) in the file's axes, moved to a least depth in the bone [mm].

        Points below the end of the scan are moved up to its last section.
        """
        if self.continuation:
            x = self.continuation.scanned(x)
        tree, normals = self._skin
        _, nearest = tree.query(x)
        normal = normals[nearest]
        present_depth = ((self.surface.points[nearest] - x) * normal).sum(axis=1)
        moved_points = x - np.maximum(depth - present_depth, 0.0)[:, None] * normal
        return np.asarray(moved_points @ self.frame.axes + self.frame.origin)

    def trochanter_lost(self, placement: Placement) -> float:
        """Height of the greater trochanter's tip above the cut, along its normal [mm]."""
        x = self.surface.points - placement.foot
        return float((x[(x[:, 0] < 0) & (x[:, 2] > 0)] @ placement.normal).max(initial=0.0))

    def projected(
        self, places: Mapping[str, Any], placement: Placement
    ) -> tuple[dict[str, Floats], list[str]]:
        """Project points of the parametric femur onto this bone below the cut.

        They are scaled to the height of its head and the width of its shaft. Next to the greater
        trochanter they are scaled to its reach.

        Returns:
            Points by name (3,) [mm], and the distance by which each was moved, in words.
        """
        x, height_ratio = self.surface.points, self.size
        shaft_ratio = (
            mean_width(self.surface.level(SHAFT_LEVEL * height_ratio)) / 2.0 / SHAFT_RADIUS
        )
        trochanter_ratio = (
            -float(x[(x[:, 2] > 0) & (x[:, 2] < 40 * height_ratio), 0].min()) / TROCHANTER_REACH
        )
        candidates = self.surface.corners.mean(axis=1)
        candidates = candidates[(candidates - placement.foot) @ placement.normal < -BELOW_CUT]
        projections: dict[str, Floats] = {}
        distances = []
        for name, (px, py, pz) in places.items():
            scaled = np.array(
                [
                    px * (trochanter_ratio if px < 0 < pz else shaft_ratio),
                    py * shaft_ratio,
                    pz * height_ratio,
                ]
            )
            projections[name] = candidates[((candidates - scaled) ** 2).sum(axis=1).argmin()]
            distances.append(f"{name} {float(np.linalg.norm(projections[name] - scaled)):.0f}")
        return projections, distances


Known = tuple[tuple[str, Any], ...]


@lru_cache(maxsize=8)
def _surface(
    path: Path, unit: str | None, label: int | None, content: str, known: Known
) -> tuple[Frame, BoneSurface]:
    """Frame and surface of the bone in a file; the hash of its content is a part of the key."""
    surface = bone_surface.read(path, unit, label)
    frame = landmarks.find_landmarks(surface, dict(known))
    return frame, frame.surface(surface)


def read(bone: Bone, canal: Canal, contents: tuple[str, str], known: Known) -> PatientBone:
    """Read a bone and its canal, and find its landmarks.

    Args:
        bone: Keys of its outer surface.
        canal: Keys of its canal, which may have no file.
        contents: Hashes of their files.
        known: Landmarks that are given, by name (`landmarks.find_landmarks`).

    Raises:
        GeometryError: A file is damaged or is no femur.
    """
    assert bone.path
    outer = bone.path, bone.unit, bone.label
    canal_file = canal.path, canal.unit or bone.unit, canal.label
    inner = (canal.ct, None, None) if canal.ct else canal_file
    threshold = canal.threshold if canal.ct else None
    return _read(outer, inner, threshold, bone.extend, canal.isthmus, contents, known)


@lru_cache(maxsize=4)
def _read(
    outer: tuple[Path, str | None, int | None],
    inner: tuple[Path | None, str | None, int | None],
    threshold: float | None,
    extend: bool,
    isthmus: float | None,
    contents: tuple[str, str],
    known: Known,
) -> PatientBone:
    """Read a bone and its canal; a threshold is that of CT numbers."""
    path, unit, label = outer
    frame, surface = _surface(path, unit, label, contents[0], known)
    canal_surface = None
    canal_path, canal_unit, canal_label = inner
    if canal_path and threshold is not None and label is not None:
        body = label_surface.body(path, label)
        canal_surface = ct_canal.read(canal_path, body, threshold, frame, surface)
    elif canal_path:
        least_length = bone_surface.LEAST_CANAL
        canal_surface = frame.surface(
            bone_surface.read(canal_path, canal_unit, canal_label, least_length)
        )
    if not extend or frame.version is not None:
        bone = PatientBone(frame, surface, canal_surface)
    else:
        bone = _continued(frame, surface, canal_surface, isthmus)
    if bone.canal is not None:
        return bone
    return replace(bone, by_ratios=shaft.canal_by_ratios(bone.surface, bone.size, isthmus))


def _continued(
    frame: Frame, surface: BoneSurface, canal: BoneSurface | None, isthmus: float | None
) -> PatientBone:
    """The bone with its shaft continued below the end of the scan.

    Raises:
        GeometryError: The given isthmus (mm) is too wide for the bone.
    """
    size = float(frame.to_model(frame.head)[2]) / HEAD_HEIGHT
    top_level = -TROCHANTER_ENDS * frame.radius
    end, canal_width = frame.end, None
    canal_end = math.inf if canal is None else float(canal.points[:, 2].min())
    if canal_end < end + CUT_DISTANCE:
        # Both are continued from a level at which both are whole.
        end = max(end, canal_end + shaft.EDGE_ROUNDING)
    centre, slope = shaft.axis_of_end(surface, end, top_level)
    outer = shaft.Narrowing(femur_bone.OUTER, end, size)
    if canal is not None and canal_end < end:
        canal_width = shaft.canal_width(surface, canal, outer, centre, top_level, isthmus)
    scan_end = float(surface.points[:, 2].min())
    continuation = Continuation(
        end, centre, slope, CONTINUED_TO * size, outer, canal_width, scan_end
    )
    if canal is not None and canal_width is not None:
        canal = continuation.surface(canal, canal_width)
    return PatientBone(frame, continuation.surface(surface, outer), canal, continuation)
