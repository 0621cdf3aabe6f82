"""A patient's femur with a cemented stem: bone and canal from surfaces, the operation, the stem."""

from __future__ import annotations

import hashlib
import math
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, ValidationInfo, model_validator

from app.case.femurs import BONE, MUSCLES, Femur
from app.case.shapes import Mantle, MeshOptions, Point3, Shape, Sides
from app.errors import GeometryError
from app.schema.section import Pair, Section, Triple, fail, show
from app.schema.units import Angle, Dimension, Length, Number, PositiveLength

if TYPE_CHECKING:
    from meshes.placement import Placement

SHAFT = 70.0  # mm of shaft below the plug, or what the surface has


def _file(value: object, info: ValidationInfo) -> Path:
    """A file, relative to the case's folder."""
    if not isinstance(value, str | Path):
        fail(f"{show(value)} is not a path; expected text")
    path: Path = (info.context or {}).get("folder", Path()) / Path(value).expanduser()
    if not path.is_file():
        fail(f"no such file: {path}")
    return path.resolve()


File = Annotated[Path, BeforeValidator(_file)]
Unit = Literal["mm", "cm", "m", "inch"]
Place = Annotated[tuple[Number, Number, Number], Triple("[4.1, -28.4, -39.1]")]
Places = Annotated[tuple[Place, Place], Pair("[[31, -8, -98], [29, -17, -37]]")]


class Bone(Section):
    """The outer surface of a femur, of all of it or of its proximal part."""

    surface: File
    """STL file of its triangles; relative to the case file."""
    unit: Unit | None = None
    """Unit of the file; by default the one that makes a femur of it, which is told."""
    side: Literal["left", "right"] | None = None
    """Side of the body; found by default. A right femur is mirrored: x is medial, y anterior."""


class Canal(Section):
    """The medullary canal."""

    surface: File | None = None
    """STL file of its surface, in the axes of the bone's; without it the canal has the part of the
    bone's radius that it has in mantle's own femur."""
    unit: Unit | None = None
    """Unit of the file; by default as of the bone."""
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


class Stem(Section):
    """A straight tapered collarless stem as that of the parametric femur, in axes of its own."""

    length: PositiveLength = 147.0
    """From the shoulder to the tip."""
    tip_half_width: PositiveLength = 3.0
    """Half the medio-lateral width at the tip."""
    tip_half_depth: PositiveLength = 3.0
    """Half the antero-posterior depth at the tip."""
    tip_corner_radius: PositiveLength = 2.1
    """Radius of the section's corners at the tip."""
    section_depth: PositiveLength = 14.0
    """Depth below the shoulder of the proximal section that the next three describe."""
    half_width: PositiveLength = 8.5
    """Half the medio-lateral width there."""
    half_depth: PositiveLength = 5.0
    """Half the antero-posterior depth there."""
    corner_radius: PositiveLength = 3.0
    """Radius of the section's corners there."""
    neck_diameter: PositiveLength = 9.8
    """Diameter of the neck where it leaves the body."""
    trunnion_diameter: PositiveLength = 12.0
    """Diameter of the neck's end, which carries the head."""
    head_offset: PositiveLength = 43.0
    """Medial distance of the head's centre from the stem's axis."""
    head_height: PositiveLength = 25.0
    """Height of the head's centre above the shoulder."""
    neck_angle: Angle = math.radians(130.0)
    """Angle between neck and stem (rad)."""
    plug_length: PositiveLength = 10.0
    """Length of cement below the tip."""

    @model_validator(mode="after")
    def _solid(self) -> Stem:
        if not self.section_depth < self.length:
            fail("is not above the tip", at=("section_depth",))
        for end in ("", "tip_"):
            half = min(getattr(self, f"{end}half_width"), getattr(self, f"{end}half_depth"))
            if getattr(self, f"{end}corner_radius") >= half:
                text = f"is not below the half-width and half-depth, {half:g} mm"
                fail(text, at=(f"{end}corner_radius",))
        return self

    def as_implant(self, cement: float) -> Femur:
        """The same in the parametric femur's keys, with the shoulder at z = 0."""
        named = {f"stem_{k}": v for k, v in self if k.startswith(("tip_", "half_", "corner_"))}
        same = ("neck_diameter", "trunnion_diameter", "head_offset", "head_height", "neck_angle")
        named |= {k: getattr(self, k) for k in (*same, "plug_length")}
        levels = {"stem_tip_z": -self.length, "stem_section_z": -self.section_depth}
        return Femur.model_construct(
            stem_length=self.length, cement_thickness=cement, **named, **levels
        )


class Resection(Section):
    """The cut across the neck."""

    height: Length = 8.0
    """Height above the lesser trochanter at which it leaves the medial cortex."""
    angle: Annotated[float, Dimension("rad", "an angle", "38 deg", at_least=0.0, below=1.2)] = (
        math.radians(38.0)
    )
    """Its angle to the transverse plane (rad), below 1.2."""
    azimuth: Angle | None = None
    """Direction of its normal about the shaft, from medial to anterior (rad); by default the
    neck's."""


class Version(Section):
    """Turn of the stem about the shaft's axis."""

    relative_to: Literal["neck", "condyles"] = "neck"
    """What it is measured against: the patient's neck, or the line of the posterior condyles."""
    angle: Angle = 0.0
    """The turn, the head to anterior (rad)."""


class Insertion(Section):
    """Where the stem is put."""

    depth: Length = 0.0
    """How deep the lateral edge of the shoulder is below the cut."""
    varus: Annotated[float, Dimension("rad", "an angle", "2 deg", at_least=-0.2, at_most=0.2)] = 0.0
    """Tilt of the stem, its tip to lateral (rad), about where its axis meets the cut."""
    version: Version = Field(default_factory=Version)
    """Turn of the stem about the shaft's axis."""
    medial_offset: Length = 0.0
    """How far the stem's axis is medial of the shaft's, along the cut's azimuth."""
    anterior_offset: Length = 0.0
    """How far it is anterior of it."""


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

    muscles: ClassVar[dict[str, Point3]] = MUSCLES

    kind: Literal["patient"] = "patient"
    bone: Bone
    """Its outer surface."""
    canal: Canal = Field(default_factory=Canal)
    """Its medullary canal, and how it is reamed."""
    landmarks: Landmarks = Field(default_factory=Landmarks)
    """Landmarks that are given and not found."""
    stem: Stem = Field(default_factory=Stem)
    """The implant."""
    resection: Resection = Field(default_factory=Resection)
    """The cut across the neck."""
    insertion: Insertion = Field(default_factory=Insertion)
    """Where the stem is put."""
    cement_thickness: Annotated[
        float, Dimension("mm", "a length", "4 mm", at_least=1.0, at_most=8.0)
    ] = 4.0
    """Thickness of the mantle where the canal has room for it, 1 to 8 mm."""
    distal_cut_z: Length | None = None
    """Level at which the shaft is cut and held; by default 70 mm below the plug, or where the
    surface ends."""

    @model_validator(mode="after")
    def _placed(self) -> Patient:
        try:
            placed = self.placement
            low = float(placed.bone.points[:, 2].min()) + 3.0
            plug = self._plug(placed)
            if self.distal_cut_z is not None and not low <= self.distal_cut_z < plug - 5.0:
                text = f"expected {low:.0f} to {plug - 5.0:.0f} mm, above the end of the surface"
                fail(f"{text} and below the plug", at=("distal_cut_z",))
            if plug - 5.0 < low:
                text = f"ends {low - 3.0:.0f} mm from the lesser trochanter, above the end of the"
                fail(f"{text} plug at {plug:.0f} mm; shorten the stem", at=("bone", "surface"))
        except GeometryError as error:
            key, _, text = str(error).removeprefix("geometry").lstrip(".").partition(": ")
            fail(text, at=tuple(key.split("."))) if key else fail(text)
        return self

    def _plug(self, placed: Placement) -> float:
        """Level of the end of the plug (mm)."""
        depth = self.stem.length + self.stem.plug_length + placed.top
        return float(placed.foot[2] - depth * placed.turn[2, 2])

    def distal_level(self, placed: Placement) -> float:
        """Level of the distal cut (mm)."""
        if self.distal_cut_z is not None:
            return self.distal_cut_z
        return max(self._plug(placed) - SHAFT, float(placed.bone.points[:, 2].min()) + 5.0)

    @property
    def implant(self) -> Femur:
        """The stem in the parametric femur's keys."""
        return self.stem.as_implant(self.cement_thickness)

    @cached_property
    def content(self) -> str:
        """Hash of its files at the first access."""
        paths = [p for p in (self.bone.surface, self.canal.surface) if p]
        return hashlib.sha256(b"".join(p.read_bytes() for p in paths)).hexdigest()

    @property
    def known(self) -> tuple[tuple[str, Any], ...]:
        """Landmarks that are given."""
        side = {"side": self.bone.side} if self.bone.side else {}
        return tuple((side | {k: v for k, v in self.landmarks if v is not None}).items())

    @cached_property
    def placement(self) -> Placement:
        """Bone, cut and stem in the model's axes."""
        from meshes.placement import place  # imported late: it brings scipy

        return place(self)

    @property
    def head_centre(self) -> Point3:
        """Centre of the implant's head in the model's axes (mm)."""
        x, y, z = self.placement.to_model([self.stem.head_offset, 0.0, self.stem.head_height])
        return float(x), float(y), float(z)

    @cached_property
    def points(self) -> dict[str, Point3]:
        """Centre of the implant's head and muscles' insertions on this bone (mm)."""
        found, _ = self.placement.projected(self.muscles)
        places = {name: (float(x), float(y), float(z)) for name, (x, y, z) in found.items()}
        return {"head_centre": self.head_centre, **places}

    @property
    def mantles(self) -> tuple[Mantle, ...]:
        """The mantle around the stem, with a plug below its tip."""
        half = max(self.stem.tip_half_width, self.stem.tip_half_depth)
        tip = self.placement.to_model([0.0, 0.0, -self.stem.length])[2]
        return (Mantle(self.cement_thickness, float(tip) + half * abs(self.insertion.varus)),)

    @property
    def interface_area(self) -> float:
        """Approximate area of both interfaces (mm2)."""
        stem = self.stem
        around = 2.0 * (stem.half_width + stem.tip_half_width + stem.half_depth)
        around += 2.0 * stem.tip_half_depth
        return (2.0 * around + 2.0 * math.pi * self.cement_thickness) * stem.length

    def estimate_cells(self, mesh: MeshOptions) -> int:
        """Estimated number of tetrahedra: of the parametric femur with this stem, to a third."""
        shoulder = Femur.model_fields["stem_tip_z"].default + 147.0
        moved = {"stem_tip_z": shoulder - self.stem.length}
        return self.implant.model_copy(update=moved | {"resection_height": 5.0}).estimate_cells(
            mesh
        )


