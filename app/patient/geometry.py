"""Keys of `kind: patient`: bone and canal from surfaces, the operation, the stem."""

from __future__ import annotations

import hashlib
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from app.case.hips import (
    INSIDE,
    MUSCLES,
    Insertion,
    InsertionOrBest,
    OperatedHip,
    Resection,
    point,
)
from app.case.shapes import MeshOptions, Point3, Shape, range_of_thickness
from app.case.stems import Stem, StemFile
from app.foundation.arrays import Floats
from app.foundation.errors import GeometryError, InputError
from app.foundation.implant import Implant
from app.foundation.layout import alternatives
from app.schema.paths import file
from app.schema.section import Kinds, Pair, Section, Triple, fail
from app.schema.units import Length, Plain, PositiveLength
from meshes.placement import Placement, placement_of

if TYPE_CHECKING:
    from app.patient.bone import PatientBone
    from meshes.layered_surfaces import LayeredSurfaces

SHORTEST_INSIDE = 50.0  # mm of the stem in the bone
LONGER_SHAFT = 40.0  # mm by which a continued shaft is longer to find its influence
# Width by which an assumed canal is wider to find its influence [mm]. The standard deviation of the
# least width is 1.3 mm in women and 1.5 mm in men (96 volunteers, PMC8589507).
WIDER_CANAL = 2.0
LEAST_BELOW_PLUG = 5.0  # mm of bone below the plug, at least
SHAFT_BELOW_PLUG = 70.0  # mm of shaft below the plug, or what the surface has


SurfaceFile = Annotated[Path, file(".stl", ".ply", ".obj")]
ImageFile = Annotated[Path, file(folder=True)]
Unit = Literal["mm", "cm", "m", "inch"]
_Coordinate = Annotated[float, Plain(unit="mm")]
Place = Annotated[tuple[_Coordinate, _Coordinate, _Coordinate], Triple("[4.1, -28.4, -39.1]")]
Places = Annotated[tuple[Place, Place], Pair("[[31, -8, -98], [29, -17, -37]]")]


class Outline(Section):
    """Surface from a file of triangles, or around a label of an image."""

    surface: SurfaceFile | None = None
    """STL, PLY or OBJ file of its triangles; relative to the case file."""
    image: ImageFile | None = None
    """Labelled image in place of triangles: NIfTI, DICOM (slices or frames), or `values` and
    `affine` (to mm) in an `.npz`."""
    label: Annotated[int, Plain(integer=True)] | None = None
    """Label of its voxels in the image, a whole number."""
    unit: Unit | None = None
    """Unit of the file. By default the unit that gives the length of a femur, which is reported;
    for a canal the unit of the bone."""

    @model_validator(mode="after")
    def _has_one_source(self) -> Self:
        files = (self.surface is not None) + (self.image is not None)
        if (
            files > 1
            or files < isinstance(self, Bone)
            or bool(self.image) != (self.label is not None)
        ):
            fail("expected `surface`, or `image` and `label`")
        return self

    @property
    def path(self) -> Path | None:
        """File of the surface, if there is one."""
        return self.surface or self.image


class Bone(Outline):
    """Outer surface of a femur, whole or its proximal part."""

    side: Literal["left", "right"] | None = None
    """Side of the body; by default from the landmarks. A right femur is mirrored: x is medial, y is
    anterior."""
    extend: bool = True
    """The shaft is continued below the end of a scan, as far as stem and support need. `false`: the
    bone ends there."""


class Canal(Outline):
    """The medullary canal; without a file, with the width ratios of the parametric femur."""

    ct: ImageFile | None = None
    """CT of a bone that is given by a label. The canal is where CT numbers are below `threshold`,
    up to below the lesser trochanter."""
    threshold: Annotated[float, Plain(unit="HU")] = 600.0
    """CT number at the inner surface of the cortex."""
    isthmus: PositiveLength | None = None
    """Width of the canal where it is narrowest, the mean of both directions, if no file shows it:
    for example from a radiograph. By default it follows from the last sections of a scan that ends
    above that level, and from the parametric femur."""
    ream: Literal["none", "by", "broach"] = "none"
    """Reaming by the surgeon: none, by the same distance everywhere (`ream_by`), or as far as stem
    and cement mantle need. It leaves 2.5 mm of cortex. A thinner cortex keeps its thickness, but at
    least 1.5 mm."""
    ream_by: PositiveLength = 1.0
    """Distance by which the canal is widened with `ream: by`."""


class Landmarks(Section):
    """Landmarks that are given, in mm in the axes of the bone's file."""

    head_centre: Place | None = None
    """Centre of the femoral head."""
    lesser_trochanter: Place | None = None
    """Apex of the lesser trochanter."""
    shaft: Places | None = None
    """Two points of the axis of the proximal shaft, the distal one first."""
    condyles: Places | None = None
    """The most posterior points of the condyles."""


class Patient(OperatedHip):
    """A patient's proximal femur with a stem, in cement or without.

    Axes: z along the shaft, proximal positive, 0 at the apex of the lesser trochanter; y anterior.
    x is medial, along the posterior condyles. It is along the neck if the surface has no condyles.
    """

    shape_keys: ClassVar[str] = "geometry.insertion or geometry.resection"

    kind: Literal["patient"] = "patient"
    bone: Bone
    """Outer surface of the bone."""
    canal: Canal = Field(default_factory=Canal)
    """Medullary canal, and its reaming."""
    landmarks: Landmarks = Field(default_factory=Landmarks)
    """Given landmarks; the others are detected."""
    stem: Annotated[Stem | StemFile, Kinds(".")] = Field(default_factory=Stem)
    """The implant: its dimensions, or a CAD file."""
    resection: Resection = Field(default_factory=Resection)
    """The cut across the neck."""
    insertion: InsertionOrBest = Field(default_factory=Insertion)
    """Position of the stem; or `best`: the position with the most room."""
    distal_cut_z: Length | None = None
    """Level at which the shaft is cut and held; by default 70 mm below the plug, or where the
    surface ends."""

    @model_validator(mode="after")
    def _check_placement(self) -> Patient:
        if self.canal.ct and (self.canal.path or not self.bone.image):
            fail("needs a bone with `image` and `label`, and no second canal", at=("canal", "ct"))
        self.check_end()
        if self.canal.ream == "by" and not self.is_cemented:
            message = "`by` makes room for cement, but there is none; expected broach or none"
            fail(message, at=("canal", "ream"))
        implant = self.implant
        for field, message in implant.faults(range_of_thickness(self.cement_thickness)[0]):
            fail(message, at=("stem", field))
        try:
            self._check_length(placement_of(self))
            self.search()
            placement = self.placement
        except (GeometryError, InputError) as error:
            files = {
                "bone": (self.bone.path, self.bone.image),
                "canal": (self.canal.path, self.canal.image, self.canal.ct),
            }
            for part_name, paths in files.items():
                if str(error).startswith(tuple(f"{path}:" for path in paths if path)):
                    fail(str(error), at=(part_name,))
            key, _, message = str(error).partition(": ")
            keys_below = key.removeprefix("geometry").removeprefix(".").split(".")
            fail(
                message + self._given_landmarks(key), at=tuple(name for name in keys_below if name)
            )
        lowest_z = self.femur.lowest
        plug_z = float(placement.to_model([0.0, 0.0, implant.plug])[2])
        level = self.distal_cut_z
        if level is None:
            level = self.__dict__["distal_cut_z"] = round(
                max(plug_z - SHAFT_BELOW_PLUG, lowest_z + 3.0), 1
            )
        if not lowest_z + 2.0 < level < plug_z - 2.0:
            continuation = self.femur.continuation
            end_text = f"the end of the surface, {lowest_z:.0f} mm,"
            if continuation:
                end_text = (
                    f"the end of the surface, {continuation.scan_end:.0f} mm and continued to"
                    f" {lowest_z:.0f} mm,"
                )
            message = f"{level:g} mm is not between {end_text} and"
            fail(f"{message} {self.plug_end}, {plug_z:.0f} mm", at=("distal_cut_z",))
        least_length = max(INSIDE * implant.length, SHORTEST_INSIDE)
        length_inside = implant.length + placement.top
        if length_inside < least_length:
            message = f"leaves {length_inside:.0f} mm of the stem below the cut"
            fail(f"{message}; expected at least {least_length:.0f} mm", at=("insertion", "depth"))
        return self

    def _check_length(self, placement: Placement) -> None:
        """Refuse a bone that ends beside the stem or its plug, before its position is searched."""
        plug_z = float(placement.to_model([0.0, 0.0, self.implant.plug])[2])
        missing_length = self.femur.lowest + LEAST_BELOW_PLUG - plug_z
        if self.distal_cut_z is None and missing_length > 0.0:
            fail(
                f"puts {self.plug_end} at z = {plug_z:.0f} mm, but the bone ends at"
                f" {self.femur.lowest:.0f} mm: {missing_length:.0f} mm of bone are missing; set"
                " geometry.bone.extend: true, or use a shorter stem",
                at=("stem", "length"),
            )

    def without_effect(self, mesh: MeshOptions) -> dict[tuple[str, ...], str]:
        """Return the keys of the case that have no effect with the others, and the reason."""
        keys = super().without_effect(mesh)
        canal = self.canal
        if not canal.ct:
            source = f"{canal.path.name} has the canal" if canal.path else "no CT is given (ct)"
            keys["geometry", "canal", "threshold"] = source
        if canal.ream != "by":
            reason = f"the canal is not reamed by it (ream: {canal.ream})"
            keys["geometry", "canal", "ream_by"] = reason
        if self.femur.assumed_isthmus is None:
            keys["geometry", "canal", "isthmus"] = "the canal is measured there"
        if not canal.surface:
            keys["geometry", "canal", "unit"] = "no surface of the canal is given"
        if not self.bone.surface:
            keys["geometry", "bone", "unit"] = "an image says its unit"
        return keys

    @property
    def implant(self) -> Implant:
        """The stem in its axes, with its shoulder at 0."""
        return self.stem.implant(None, self.plug_length, self.void)

    @cached_property
    def surface_contents(self) -> tuple[str, str]:
        """Hashes of the files of the bone and of the canal at the first access."""
        return _content(self.bone.path), _content(self.canal.path, self.canal.ct)

    @property
    def content(self) -> str:
        """Hashes of the files of bone, canal and stem."""
        return "".join(self.surface_contents) + self.stem.content

    @property
    def known(self) -> tuple[tuple[str, Any], ...]:
        """Landmarks that are given."""
        return tuple((k, v) for k, v in [("side", self.bone.side), *self.landmarks] if v)

    def _given_landmarks(self, key: str) -> str:
        """The given landmarks as a cause of an error, in words; empty if its key names one."""
        names = ", ".join(f"landmarks.{name}" for name, value in self.landmarks if value)
        if not names or key.startswith("geometry.landmarks"):
            return ""
        return f". Given landmarks may be wrong: {names}"

    @cached_property
    def femur(self) -> PatientBone:
        """The bone before the operation."""
        from app.patient.bone import read  # most of scipy, 0.11 s, which other cases do without

        return read(self.bone, self.canal, self.surface_contents, self.known)

    @cached_property
    def placement(self) -> Placement:
        """Cut and stem in the model's axes."""
        return placement_of(self)

    @property
    def shoulder_depth(self) -> float:
        """Depth of the stem's shoulder below the cut (mm)."""
        return self.insertion.depth or 0.0

    @property
    def level(self) -> float:
        """Level at which the shaft is cut, in the model's axes (mm)."""
        assert self.distal_cut_z is not None  # since the geometry was validated
        return self.distal_cut_z

    @property
    def distal_height(self) -> float:
        """Height at which the shaft is cut, in the stem's axes (mm)."""
        return float(self.placement.along(self.level))

    @property
    def more_room(self) -> tuple[str, str]:
        """Key of the stem's position, and the remedies where the stem has no room."""
        remedies = (
            *self.ways_to_widen_canal,
            "use a smaller or shorter stem",
            "change varus and offsets (insertion: best, or mantle place)",
        )
        return "geometry.insertion", alternatives(remedies)

    @property
    def ways_to_widen_canal(self) -> tuple[str, ...]:
        """The key that reams the canal; none if it is broached."""
        return () if self.canal.ream == "broach" else ("ream (canal.ream: broach)",)

    def surfaces(self, mesh: MeshOptions) -> LayeredSurfaces:
        """The nested surfaces that are checked and meshed, kept by the content of its files."""
        # It imports most of scipy, which other cases do without.
        from meshes.layered_surfaces import cached_surfaces

        return cached_surfaces(self, mesh, self.content)

    def check_fit(self, mesh: MeshOptions) -> None:
        """Raise InputError, with the place, if the stem does not fit into the bone."""
        try:
            self.surfaces(mesh)
        except GeometryError as error:
            key = str(error).partition(": ")[0]
            raise InputError(f"{error}{self._given_landmarks(key)}") from error

    @cached_property
    def points(self) -> dict[str, Point3]:
        """Centre of the implant's head and muscles' insertions on this bone (mm)."""
        insertions, _ = self.femur.projected(MUSCLES, self.placement)
        places = {name: point(x) for name, x in insertions.items()}
        return {"head_centre": self.head_centre} | places

    @property
    def skin(self) -> Floats:
        """Points of the bone's surface between the cuts (n, 3) (mm)."""
        x, placement = self.femur.surface.points, self.placement
        return x[((x - placement.foot) @ placement.normal < 0) & (x[:, 2] > self.level)]

    def in_file(self, x: Floats, depth: float) -> Floats:
        """Points (n, 3) in the axes of the bone's file, moved to a least depth in the bone."""
        return self.femur.in_file(x, depth)

    @property
    def is_mirrored(self) -> bool:
        """True for a right femur."""
        return self.femur.mirrored

    @property
    def continued_below(self) -> float | None:
        """Level below which the model has a continued shaft (mm); None: it has none."""
        continuation = self.femur.continuation
        return continuation.end if continuation and continuation.end > self.level else None

    @property
    def other_bones(self) -> dict[str, Shape]:
        """The geometry with other bone where none was measured, by what differs, in words."""
        bones = dict[str, Shape]()
        level = self.level - LONGER_SHAFT
        if self.continued_below is not None and level >= self.femur.lowest + 2.0:
            longer = self.model_copy(update={"distal_cut_z": level})
            bones[f"{LONGER_SHAFT:g} mm more of the continued shaft"] = longer
        isthmus = self.femur.assumed_isthmus
        if isthmus is not None and (self.femur.by_ratios or self.continued_below is not None):
            canal = self.canal.model_copy(update={"isthmus": isthmus + WIDER_CANAL})
            wider = self.model_copy(update={"canal": canal})
            # The copy has the femur that this geometry has read.
            wider.__dict__.pop("femur")
            bones[f"a canal {WIDER_CANAL:g} mm wider in the shaft"] = wider
        return bones

    @property
    def _continued(self) -> dict[str, str]:
        """The continued part of the shaft, in words."""
        end_level, continuation = self.continued_below, self.femur.continuation
        if end_level is None or continuation is None:
            return {}
        plug_z = float(self.placement.to_model([0.0, 0.0, self.implant.plug])[2])
        range_text = (
            f"below z = {end_level:.0f} mm, {end_level - continuation.scan_end:.0f} mm above the"
            f" level where the scan ends: {end_level - self.level:.0f} mm"
        )
        beside_stem = (
            f", {end_level - plug_z:.0f} mm of them beside stem and plug"
            if end_level > plug_z
            else ""
        )
        return {"continued shaft": range_text + beside_stem}

    @property
    def details(self) -> dict[str, str]:
        """Landmarks of the bone, repairs of its surfaces, places of stem and muscles, in words."""
        femur = self.femur
        details = dict(femur.frame.details)
        for name, surface in (("surface", femur.surface), ("surface of the canal", femur.canal)):
            if surface and surface.notes:
                details[name] = ", ".join(surface.notes)
        details |= self._continued
        if femur.assumed_isthmus is not None:
            source = "assumed" if self.canal.isthmus is None else "given"
            details["canal"] = f"{femur.assumed_isthmus:.1f} mm wide at its isthmus, {source}"
        lost_height = femur.trochanter_lost(self.placement)
        if lost_height > 0.5:
            details["not modelled"] = (
                f"the greater trochanter above the cut, {lost_height:.0f} mm of it"
            )
        muscle_distances = ", ".join(femur.projected(MUSCLES, self.placement)[1])
        return details | self.stem.details | {"muscles moved (mm)": muscle_distances}


def _content(*files: Path | None) -> str:
    """Hash of files; an image may have several."""
    from app.patient import images  # scipy, which other cases do without

    files_of_paths = [file for path in files if path for file in images.files_of(path)]
    return hashlib.sha256(b"".join(path.read_bytes() for path in files_of_paths)).hexdigest()
