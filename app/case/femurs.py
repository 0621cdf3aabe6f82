"""The parametric femur, with a cemented stem and before the operation."""

from __future__ import annotations

import math
from dataclasses import fields
from importlib import import_module
from typing import Annotated, Any, ClassVar, Literal

from pydantic import model_validator

from app.case.hips import INSIDE, MUSCLES, OF_BONE, Hip, Insertion, OperatedHip, Resection
from app.case.shapes import MeshOptions, Point3, spread
from app.case.stems import (
    HeadOffset,
    Implant,
    NeckDiameter,
    NeckFillet,
    Stem,
    StemFile,
    TipRounding,
    TrunnionDiameter,
    length,
)
from app.schema.section import fail
from app.schema.units import Angle, Dimension, Length, PositiveLength

# Beginnings of keys that a stem from a file replaces, all but `stem_tip_z`.
OF_STEM = ("stem_", "tip_rounding", "neck_", "trunnion_", "head_")
MEDIAL = 24.747  # mm from the shaft's axis to the medial cortex, where the cut usually leaves it
# The stem by default: mantle's own, whose shoulder is at z = 29 mm.
STEM: dict[str, Any] = {name: field.default for name, field in Stem.model_fields.items()}


def _key(field: str) -> str:
    """Key of a field of `Implant`."""
    return field if field in _Femur.model_fields or field == "stem" else f"stem_{field}"


class _Femur(Hip):
    """A proximal femur, the operation and the implant."""

    canal_widening: Annotated[float, length("1 mm", at_least=0.0, at_most=5.0)] = 0.0
    """Reaming: distance by which the endosteal surface is moved outwards, 0 to 5 mm."""
    metaphyseal_cortex: Annotated[float, length("2 mm", at_least=1.5, at_most=4.0)] | None = None
    """Thickness of the cortex across the shaft's axis above z = -10 mm, reamed or not, 1.5 to 4 mm;
    down to -50 mm it goes over to that of the shaft. By default it is 3.5 to 7 mm there. In cells
    of 6 mm the worst shape (SICN) is 0.12 at 2 mm, 0.09 at 1.5 mm."""
    stem_length: PositiveLength = STEM["length"]
    """From the shoulder to the tip; two thirds of it at least are below the neck cut."""
    stem_tip_z: Length = -118.0
    """Level of the tip."""
    stem_tip_half_width: PositiveLength = STEM["tip_half_width"]
    """Half the medio-lateral width at the tip."""
    stem_tip_half_depth: PositiveLength = STEM["tip_half_depth"]
    """Half the antero-posterior depth at the tip."""
    stem_tip_corner_radius: PositiveLength = STEM["tip_corner_radius"]
    """Radius of the section's corners at the tip."""
    tip_rounding: TipRounding = STEM["tip_rounding"]
    """Height of the stem's rounded end, 1 to 20 mm; 0: it is flat, as it is over a void."""
    stem_section_z: Length = 15.0
    """Level of the proximal section that the next three describe."""
    stem_half_width: PositiveLength = STEM["half_width"]
    """Half the medio-lateral width there."""
    stem_half_depth: PositiveLength = STEM["half_depth"]
    """Half the antero-posterior depth there."""
    stem_corner_radius: PositiveLength = STEM["corner_radius"]
    """Radius of the section's corners there."""
    neck_diameter: NeckDiameter = STEM["neck_diameter"]
    """Diameter of the neck where it leaves the body: at least 5 mm, at most the body's width."""
    neck_fillet: NeckFillet = STEM["neck_fillet"]
    """Radius where the stem turns into the neck, 2 to 10 mm; a blunt turn has a larger one."""
    trunnion_diameter: TrunnionDiameter = STEM["trunnion_diameter"]
    """Diameter of the neck's end, which carries the head, 5 to 22 mm."""
    head_offset: HeadOffset = STEM["head_offset"]
    """Medial distance of the head's centre from the shaft axis, 20 to 80 mm."""
    head_height: Annotated[float, length("54 mm", at_least=20.0, at_most=100.0)] = 54.0
    """Height of the head's centre above mid lesser trochanter, 20 to 100 mm; no part of the stem's
    body is higher. A low head bends the neck's root: in cells of 4 mm the worst shape (SICN) is
    0.13 down to 45 mm, that of the bone, 0.11 at 40 mm and 0.05 at 32 mm."""
    neck_angle: Annotated[float, Dimension("rad", "an angle", "130 deg")] = STEM["neck_angle"]
    """Angle between neck and shaft (rad), 100 to 145 deg."""
    anteversion: Angle = 0.0
    """Turn of stem, neck and neck cut about the shaft's axis, the head to anterior (rad)."""
    resection_height: Length = 5.0
    """Height above mid lesser trochanter at which the cut leaves the medial cortex."""
    resection_angle: Angle = math.radians(38.0)
    """Angle of the cut to the transverse plane (rad)."""
    distal_cut_z: Annotated[float, length("-200 mm", at_least=-350.0)] = -200.0
    """Level at which the shaft is cut and held: below the plug, at least -350 mm."""

    @model_validator(mode="after")
    def _consistent(self) -> _Femur:
        self._check_stem()
        implant = self.implant
        if self.distal_cut_z >= implant.plug:
            text = f"is not below the cement plug; expected below {implant.plug:g} mm"
            fail(text, at=("distal_cut_z",))
        self.check_end()
        if not 0.0 <= self.resection_angle < math.pi / 2:
            fail("is not between 0 and 90 deg", at=("resection_angle",))
        if self.cut_height >= self.head_height:
            text = f"puts the neck cut at z = {self.cut_height:.3g} mm on the shaft's axis, above"
            fail(f"{text} the head's centre at {self.head_height:g} mm", at=("resection_height",))
        inside = (self.cut_height - self.stem_tip_z) / INSIDE
        longest = self.head_height - self.stem_tip_z
        if self.stem_length > min(inside, longest):
            where = "out of the bone" if inside < longest else "above the head's centre"
            text = f"{self.stem_length:g} mm puts the shoulder at z = {implant.shoulder:g} mm, too"
            text += f" far {where}; expected at most {min(inside, longest):.3g} mm"
            fail(text, at=("stem_length",))
        return self

    def _check_stem(self) -> None:
        """Refuse a stem that cannot be meshed."""
        implant = self.implant
        if not implant.stem and not implant.tip_z < implant.section_z < implant.shoulder:
            self._refuse_section(implant.shoulder)
        for field, text in implant.faults(spread(self.cement_thickness)[0]):
            fail(text, at=(_key(field),))

    def _refuse_section(self, shoulder: float) -> None:
        """Fail at the key that puts the proximal section beside the stem."""
        levels = ("stem_section_z", "stem_length", "stem_tip_z")
        key = next((k for k in levels if k in self.model_fields_set), levels[0])
        text = f"puts the stem between z = {self.stem_tip_z:g} and {shoulder:g} mm, without its"
        text = f"{text} proximal section at {self.stem_section_z:g} mm (stem_section_z)"
        if key == levels[0]:
            text = f"is not between the stem's tip at z = {self.stem_tip_z:g} mm and its"
            text = f"{text} shoulder at {shoulder:g} mm"
        default = type(self).model_fields
        usual = default["stem_tip_z"].default + default["stem_length"].default
        tip = usual - self.stem_length
        if key == "stem_length" and tip < self.stem_section_z < usual:
            text = f"{text}; set stem_tip_z: {tip:g} mm too to cut the stem at its tip"
        fail(text, at=(key,))

    @property
    def implant(self) -> Implant:
        """The stem in axes of its own, which have the model's levels."""
        numbers = {field.name: getattr(self, _key(field.name)) for field in fields(Implant)}
        return Implant(**numbers)

    @property
    def femur(self) -> Any:
        """The bone before the operation (`meshes.femur_bone.FemurBone`)."""
        bone = import_module("meshes.femur_bone").FemurBone
        return bone(self.anteversion, self.canal_widening, self.metaphyseal_cortex)

    @property
    def resection(self) -> Resection:
        """The cut across the neck."""
        return Resection.model_construct(height=self.resection_height, angle=self.resection_angle)

    @property
    def more_room(self) -> tuple[str, str]:
        """The key that says where the stem is, and what to change where it has no room."""
        text = "widen the canal (canal_widening), narrow the stem or move it proximally"
        return "geometry", f"{text} (stem_tip_z)"

    def surfaces(self, mesh: MeshOptions) -> Any:
        """The nested surfaces that are meshed (`meshes.layered_surfaces.LayeredSurfaces`)."""
        return import_module("meshes.layered_surfaces").LayeredSurfaces(self, mesh)

    @property
    def points(self) -> dict[str, Point3]:
        """Centre of the head and muscles' insertions (mm)."""
        return {"head_centre": self.head_centre, **MUSCLES}

    @property
    def cut_height(self) -> float:
        """Approximate height at which the neck cut meets the shaft's axis (mm)."""
        return self.resection_height + MEDIAL * math.tan(self.resection_angle)

    @property
    def distal_height(self) -> float:
        """Height at which the shaft is cut (mm)."""
        return self.distal_cut_z

    @property
    def widening(self) -> float:
        """Distance by which the table's endosteum is moved outwards (mm)."""
        return self.canal_widening


class Femur(_Femur, OperatedHip):
    """A proximal femur with a straight tapered collarless stem in a cement mantle.

    Axes: z along the shaft, proximal positive, 0 at mid lesser trochanter; x medial; y anterior.
    The table of bone sections belongs to the mesher; the parameters here are those of the operation
    and the implant. Defaults: an Exeter-class 150 mm stem in an average femur.
    """

    kind: Literal["femur"] = "femur"
    stem: StemFile | None = None
    """A stem from a file of CAD, placed by `stem_tip_z`. The other keys of stem, neck, trunnion and
    head are left out then."""
    insertion: Insertion | None = None
    """Where the stem is put, other than along the shaft's axis, turned by `anteversion`."""

    @property
    def shoulder_depth(self) -> float | None:
        """Depth of the stem's shoulder below the cut (mm); None: as `stem_tip_z` says."""
        return self.insertion.depth if self.insertion else None

    @property
    def more_room(self) -> tuple[str, str]:
        """The key that says where the stem is, and what to change where it has no room."""
        if not self.insertion:
            return super().more_room
        text = "change insertion, widen the canal (canal_widening), or take a smaller or shorter"
        return "geometry.insertion", f"{text} stem"

    @property
    def found(self) -> dict[str, Any]:
        """Values that a stem's file answers, by key."""
        if not self.stem:
            return {}
        return {_key(field): value for field, value in self.stem.values(self.stem_tip_z).items()}

    @property
    def details(self) -> dict[str, str]:
        """Places of axis, head and neck of a stem in its file."""
        return self.stem.details if self.stem else {}

    @property
    def content(self) -> str:
        """Hash of the stem's file; empty without."""
        return self.stem.content if self.stem else ""

    def _check_stem(self) -> None:
        """Take the numbers of a stem's file, and refuse a stem that cannot be meshed."""
        if self.stem:
            replaced = [k for k in Femur.model_fields if k.startswith(OF_STEM)]
            for key in replaced:
                if key == "stem_tip_z":
                    continue
                value = self.found.get(key)
                if key in self.model_fields_set and getattr(self, key) != value:
                    fail("is the file's, where `stem` is one; expected no such key", at=(key,))
                self.__dict__[key] = value
        super()._check_stem()

    @property
    def proud(self) -> float:
        """Height of the stem's shoulder above the neck cut, along the shaft's axis (mm)."""
        return self.implant.shoulder - self.cut_height


class IntactFemur(_Femur):
    """The same femur before the operation: bone alone, with its head and neck.

    The operation and the implant are those that are planned: they do not change the bone, but say
    which of it will be left, and that is what Gruen zones are of. So their strain energy can be
    compared with that of a femur of the same numbers.
    """

    mesher: ClassVar[str] = "meshes.femur_intact"
    tissues: ClassVar[dict[str, str]] = OF_BONE
    boundary_names: ClassVar[tuple[str, ...]] = ("distal_cut", "bone_surface", "head", *MUSCLES)

    insertion: ClassVar[None] = None
    stem: ClassVar[None] = None

    kind: Literal["intact_femur"] = "intact_femur"
    head_radius: Annotated[float, length("23 mm", at_least=18.0, at_most=30.0)] = 23.0
    """Radius of the femoral head, 18 to 30 mm; the neck has about two thirds of it."""

    def estimate_cells(self, mesh: MeshOptions) -> int:
        """Estimated number of tetrahedra, to 12 %."""
        cells, _, whole = self._cells(mesh)
        length = self.head_offset / math.sin(self.neck_angle)
        neck = mesh.steps(length - 1.07 * self.head_radius)
        return round(cells + whole * (neck + max(5, 1.4 * self.head_radius / mesh.step_along)))
