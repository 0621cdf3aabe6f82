"""A patient's femur with a cemented stem: bone and canal from surfaces, the operation, the stem."""

from __future__ import annotations

import hashlib
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from app.case import femurs
from app.case.femurs import BONE, INSIDE, MUSCLES, Femur, Insertion, Resection
from app.case.shapes import Mantle, MeshOptions, Point3, Shape, Sides, Thickness, spread
from app.case.stems import StemFile
from app.foundation.errors import GeometryError, InputError
from app.foundation.files import parts
from app.schema.paths import ImageFile, SurfaceFile
from app.schema.section import Kinds, Pair, Section, Triple, fail
from app.schema.units import Angle, Dimension, Length, Number, Plain, PositiveLength

SHOULDER = 29.0  # mm: level of the shoulder of the parametric femur's stem
SHORTEST = 50.0  # mm of the stem in the bone
SHAFT = 70.0  # mm of shaft below the plug, or what the surface has


Unit = Literal["mm", "cm", "m", "inch"]
Place = Annotated[tuple[Number, Number, Number], Triple("[4.1, -28.4, -39.1]")]
Places = Annotated[tuple[Place, Place], Pair("[[31, -8, -98], [29, -17, -37]]")]


class Outline(Section):
    """A surface, or that of a label in an image."""

    surface: SurfaceFile | None = None
    """STL, PLY or OBJ file of its triangles; relative to the case file."""
    image: ImageFile | None = None
    """Labelled image in place of them: NIfTI, DICOM (slices or frames), or `values` and `affine`
    (to mm) in an `.npz`."""
    label: Annotated[int, Plain(integer=True)] | None = None
    """Number of its voxels in the image."""
    unit: Unit | None = None
    """Unit of the file; by default the one that makes a femur of the bone, which is told, and for
    a canal that of the bone."""

    @model_validator(mode="after")
    def _one(self) -> Self:
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
        """Its file, if there is one."""
        return self.surface or self.image


class Bone(Outline):
    """The outer surface of a femur, of all of it or of its proximal part."""

    side: Literal["left", "right"] | None = None
    """Side of the body; found by default. A right femur is mirrored: x is medial, y anterior."""


class Canal(Outline):
    """The medullary canal; without a file as wide a part of the bone as in mantle's own femur."""

    ream: Literal["none", "by", "broach"] = "none"
    """What the surgeon widens it by: nothing, the same everywhere (`ream_by`), or to what stem and
    mantle need. At least 1.5 mm of cortex are left."""
    ream_by: PositiveLength = 1.0
    """Distance by which it is widened with `ream: by`."""


class Landmarks(Section):
    """Landmarks that are given and not found, in mm in the axes of the bone's file."""

    head_centre: Place | None = None
    """Centre of the femoral head."""
    lesser_trochanter: Place | None = None
    """Apex of the lesser trochanter."""
    shaft: Places | None = None
    """Two points of the axis of the proximal shaft, the distal one first."""
    condyles: Places | None = None
    """The most posterior points of the condyles."""


def _of_femur(key: str) -> Any:
    """Default of a key of the parametric femur."""
    return Femur.model_fields[key].default


class Stem(Section):
    """A straight tapered collarless stem as that of the parametric femur."""

    length: PositiveLength = _of_femur("stem_length")
    """From the shoulder to the tip."""
    tip_half_width: PositiveLength = _of_femur("stem_tip_half_width")
    """Half the medio-lateral width at the tip."""
    tip_half_depth: PositiveLength = _of_femur("stem_tip_half_depth")
    """Half the antero-posterior depth at the tip."""
    tip_corner_radius: PositiveLength = _of_femur("stem_tip_corner_radius")
    """Radius of the section's corners at the tip."""
    section_depth: PositiveLength = SHOULDER - _of_femur("stem_section_z")
    """Depth below the shoulder of the proximal section that the next three describe."""
    half_width: PositiveLength = _of_femur("stem_half_width")
    """Half the medio-lateral width there."""
    half_depth: PositiveLength = _of_femur("stem_half_depth")
    """Half the antero-posterior depth there."""
    corner_radius: PositiveLength = _of_femur("stem_corner_radius")
    """Radius of the section's corners there."""
    neck_diameter: PositiveLength = _of_femur("neck_diameter")
    """Diameter of the neck where it leaves the body."""
    trunnion_diameter: PositiveLength = _of_femur("trunnion_diameter")
    """Diameter of the neck's end, which carries the head."""
    head_offset: PositiveLength = _of_femur("head_offset")
    """Medial distance of the head's centre from the stem's axis."""
    head_height: PositiveLength = _of_femur("head_height") - SHOULDER
    """Height of the head's centre above the shoulder."""
    neck_angle: Angle = _of_femur("neck_angle")
    """Angle between neck and stem (rad)."""

    @model_validator(mode="after")
    def _solid(self) -> Stem:
        if not self.section_depth < self.length:
            set_keys = self.model_fields_set
            if "length" in set_keys and "section_depth" not in set_keys:
                text = "puts the tip above the proximal section, which is at section_depth ="
                fail(f"{text} {self.section_depth:g} mm; set section_depth too", at=("length",))
            fail("is not above the tip", at=("section_depth",))
        femurs.check_stem(self, "", "tip_")
        return self

    @property
    def femur_keys(self) -> dict[str, Any]:
        """The same in the parametric femur's keys, with its shoulder at z = 0."""
        known = {k if k in Femur.model_fields else f"stem_{k}": v for k, v in self}
        levels = {"stem_tip_z": -self.length, "stem_section_z": -known.pop("stem_section_depth")}
        return known | levels


class Patient(Shape):
    """A patient's proximal femur with a cemented stem.

    Axes: z along the shaft, proximal positive, 0 at the apex of the lesser trochanter; x medial,
    along the posterior condyles, or along the neck where the surface has no condyles; y anterior.
    """

    is_around_z: ClassVar[bool] = True
    has_gruen_zones: ClassVar[bool] = True
    has_curved_surfaces: ClassVar[bool] = True
    coarsest_size: ClassVar[float] = 20.0
    joined: ClassVar[tuple[tuple[str, ...], ...]] = (BONE,)
    tissues: ClassVar[dict[str, str]] = Femur.tissues
    boundary_names: ClassVar[tuple[str, ...]] = Femur.boundary_names
    interface_sides: ClassVar[dict[str, Sides]] = Femur.interface_sides

    kind: Literal["patient"] = "patient"
    bone: Bone
    """Its outer surface."""
    canal: Canal = Field(default_factory=Canal)
    """Its medullary canal, and how it is reamed."""
    landmarks: Landmarks = Field(default_factory=Landmarks)
    """Landmarks that are given and not found."""
    stem: Annotated[Stem | StemFile, Kinds(".")] = Field(default_factory=Stem)
    """The implant: mantle's own by its numbers, or one from a file of CAD."""
    resection: Resection = Field(default_factory=Resection)
    """The cut across the neck."""
    insertion: Insertion = Field(default_factory=Insertion)
    """Where the stem is put."""
    cement_thickness: Thickness = 4.0
    """Thickness of the mantle where the canal has room, 1 to 8 mm: one, or by height and side."""
    plug_length: PositiveLength = _of_femur("plug_length")
    """Length of cement below the tip."""
    tip_void: Annotated[float, Dimension("mm", "a length", "5 mm", at_least=0.0)] = 0.0
    """Length without cement below the end, flat then; from 1 mm to 1 mm less than the plug."""
    distal_cut_z: Length | None = None
    """Level at which the shaft is cut and held; by default 70 mm below the plug, or where the
    surface ends."""

    @model_validator(mode="after")
    def _placed(self) -> Patient:
        femurs.check_end(self)
        try:
            placed = self.placement
        except (GeometryError, InputError) as error:
            for part in ("bone", "canal"):
                if str(error).startswith(f"{getattr(self, part).path}:"):
                    fail(str(error), at=(part,))
            key, _, text = str(error).removeprefix("geometry.").partition(": ")
            fail(text, at=tuple(key.split(".")))
        low = float(self.femur.surface.points[:, 2].min())
        plug = self.implant.stem_tip_z - self.plug_length
        plug = float(placed.to_model([0.0, 0.0, plug])[2])
        level = self.distal_cut_z
        if level is None:
            if plug < low + 5.0:
                text = (
                    f"puts the plug's end at z = {plug:.0f} mm; expected 5 mm above the surface's"
                )
                fail(f"{text}, at {low:.0f} mm", at=("stem", "length"))
            level = self.__dict__["distal_cut_z"] = round(max(plug - SHAFT, low + 3.0), 1)
        if not low + 2.0 < level < plug - 2.0:
            text = f"{level:g} mm is not between the end of the surface and that of the plug"
            fail(f"{text}, {low:.0f} and {plug:.0f} mm", at=("distal_cut_z",))
        length = self.implant.stem_length
        least, inside = max(INSIDE * length, SHORTEST), length + placed.top
        if inside < least:
            text = f"leaves {inside:.0f} mm of the stem below the cut; expected {least:.0f} mm"
            fail(text, at=("insertion", "depth"))
        return self

    @property
    def implant(self) -> Femur:
        """The stem in the parametric femur's keys, in axes of its own."""
        own = {k: getattr(self, k) for k in ("cement_thickness", "plug_length", "tip_void")}
        return Femur.model_construct(**own | self.stem.femur_keys)

    @cached_property
    def content(self) -> str:
        """Hash of its files at the first access."""
        given = [path for path in (self.bone.path, self.canal.path) if path]
        paths = [file for path in given for file in parts(path)]
        return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()

    @property
    def known(self) -> tuple[tuple[str, Any], ...]:
        """Landmarks that are given."""
        return tuple((k, v) for k, v in [("side", self.bone.side), *self.landmarks] if v)

    @cached_property
    def femur(self) -> Any:
        """The bone before the operation (`meshes.patient_bone.PatientBone`)."""
        # By name: no other case needs most of scipy, which takes 0.11 s.
        return import_module("meshes.patient_bone").read(self)

    @cached_property
    def placement(self) -> Any:
        """Cut and stem in the model's axes (`meshes.placement.Placement`)."""
        return import_module("meshes.placement").place(self)

    @property
    def shoulder_depth(self) -> float:
        """Depth of the stem's shoulder below the cut (mm)."""
        return self.insertion.depth or 0.0

    @property
    def more_room(self) -> tuple[str, str]:
        """The key that says where the stem is, and what to change where it has no room."""
        text = "ream (canal.ream: broach), take a smaller or shorter stem, or change varus and"
        return "geometry.insertion", f"{text} offsets"

    def grid(self, mesh: MeshOptions) -> dict[str, Any]:
        """Cells through the layers."""
        through = mesh.cells_through(self.cement_thickness)
        return {"cells through cement, cancellous and cortical bone": through}

    def surfaces(self, mesh: MeshOptions) -> Any:
        """The nested surfaces that are checked and meshed, kept by the content of its files."""
        files = self.content, getattr(self.stem, "content", "")
        return import_module("meshes.layered_surfaces").kept(self, mesh, files)

    def check_fit(self, mesh: MeshOptions) -> None:
        """Raise InputError, with the place, if the stem does not fit into the bone."""
        try:
            self.surfaces(mesh)
        except GeometryError as error:
            raise InputError(str(error)) from error

    @property
    def head_centre(self) -> Point3:
        """Centre of the implant's head (mm)."""
        return femurs.placed_head(self)

    @cached_property
    def points(self) -> dict[str, Point3]:
        """Centre of the implant's head and muscles' insertions on this bone (mm)."""
        found, _ = self.femur.projected(MUSCLES, self.placement)
        return {"head_centre": self.head_centre} | {k: femurs.point(x) for k, x in found.items()}

    @property
    def skin(self) -> Any:
        """Points of the bone's surface between the cuts (n, 3) (mm)."""
        x, placed = self.femur.surface.points, self.placement
        return x[((x - placed.foot) @ placed.normal < 0) & (x[:, 2] > self.distal_cut_z)]

    def in_image(self, x: Any, depth: float) -> Any:
        """Points (n, 3) in the axes of the bone's file, at a depth below its surface at least."""
        return self.femur.in_file(x, depth)

    @property
    def told(self) -> dict[str, Any]:
        """What was found and done, in words."""
        femur = self.femur
        found = dict(femur.frame.told)
        for name, surface in (("surface", femur.surface), ("surface of the canal", femur.canal)):
            if surface and surface.notes:
                found[name] = ", ".join(surface.notes)
        lost = femur.trochanter_lost(self.placement)
        if lost > 0.5:
            found["left out"] = f"the greater trochanter's tip, {lost:.0f} mm above the cut"
        if isinstance(self.stem, StemFile):
            found |= self.stem.told
        return found | {
            "muscles moved (mm)": ", ".join(femur.projected(MUSCLES, self.placement)[1])
        }

    @property
    def notes(self) -> tuple[str, ...]:
        """Doubts about the bone: its size, its shape, an open end."""
        return tuple(f"geometry.bone: {text}" for text in self.femur.notes)

    @property
    def mantles(self) -> tuple[Mantle, ...]:
        """The mantle around the stem, with a plug below its tip."""
        return (Mantle(spread(self.cement_thickness)[1], femurs.flanks_end(self)),)

    @property
    def _in_own_femur(self) -> Femur:
        """The stem in the parametric femur."""
        implant = self.implant
        levels = {"stem_tip_z": SHOULDER - implant.stem_length, "stem_section_z": SHOULDER - 14.0}
        return implant.model_copy(update=levels)

    @property
    def stem_perimeter(self) -> float:
        """Length around the stem where lines are counted (mm), as in the parametric femur."""
        return self._in_own_femur.stem_perimeter

    def interface_nodes(self, mesh: MeshOptions) -> float:
        """Number of nodes on each interface, as in the parametric femur."""
        return self._in_own_femur.interface_nodes(mesh)

    @property
    def interface_area(self) -> float:
        """Approximate area of both interfaces (mm2), of the parametric femur with this stem."""
        return self.implant.interface_area

    def estimate_cells(self, mesh: MeshOptions) -> int:
        """Estimated number of tetrahedra, of the parametric femur with this stem."""
        return self._in_own_femur.estimate_cells(mesh)
