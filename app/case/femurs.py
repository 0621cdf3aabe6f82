"""The parametric femur, with a stem and before the operation."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, ModelWrapValidatorHandler, PrivateAttr, model_validator

from app.case.former_keys import FORMER_KEYS_OF_FEMURS, new_name
from app.case.hips import INSIDE, MUSCLES, OF_BONE, Hip, InsertionOrBest, OperatedHip
from app.case.shapes import MeshOptions, Point3, range_of_thickness
from app.case.stems import Stem, StemFile, length
from app.foundation.errors import GeometryError
from app.foundation.implant import Implant
from app.foundation.layout import alternatives
from app.foundation.verdict import Verdict
from app.schema.section import Kinds, Section, fail
from app.schema.units import Angle, Dimension, Length

# At run time `meshes` is imported where it is used, as in `app.case.hips`.
if TYPE_CHECKING:
    from meshes.femur_bone import FemurBone
    from meshes.layered_surfaces import LayeredSurfaces

MEDIAL = 24.747  # mm from the shaft's axis to the medial cortex, where the cut usually leaves it
HEAD_LEVELS = (20.0, 100.0)  # mm: levels of the head's centre
SHOULDER = 29.0  # mm: level of the stem's shoulder without `tip_z`
# Levels in earlier versions without a key (mm).
OLD_SECTION = 15.0
OLD_HEAD = 54.0
STEM_LENGTH: float = Stem.model_fields["length"].default
_LEVEL = Dimension("mm", "a length", "4 mm")


class FemurResection(Section):
    """The cut across the neck of a parametric femur."""

    azimuth: ClassVar[None] = None

    height: Length = 5.0
    """Height above mid lesser trochanter at which the cut leaves the medial cortex."""
    angle: Angle = math.radians(38.0)
    """Angle to the transverse plane (rad)."""


def _with_present_keys(given_keys: dict[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the keys under their current names, and a map from former to current names.

    Levels of section and head were those of the model. They are now depth below the shoulder and
    height above it.
    """
    replaced = {
        former_key: key
        for former_key, key in FORMER_KEYS_OF_FEMURS.items()
        if former_key in given_keys
    }
    if not replaced:
        return given_keys, {}
    keys = {key: value for key, value in given_keys.items() if key not in replaced}
    if "stem_tip_z" in given_keys:
        if "tip_z" in given_keys:
            fail("is the former name of tip_z; keep one", at=("stem_tip_z",))
        keys["tip_z"] = given_keys["stem_tip_z"]
    numbers = {
        key.removeprefix("stem."): given_keys[former_key]
        for former_key, key in replaced.items()
        if key.startswith("stem.")
    }
    stem = given_keys.get("stem")
    if numbers and stem is not None:
        former_key = next(key for key in replaced if key != "stem_tip_z")
        is_file = isinstance(stem, StemFile) or (isinstance(stem, dict) and "step" in stem)
        message = f"is the former name of {replaced[former_key]}; write it below `stem`"
        if is_file:
            message = "is given by the file of the stem; leave it out"
        fail(message, at=(former_key,))
    if stem is None and (numbers or "stem_tip_z" in given_keys):
        shoulder = SHOULDER
        if "tip_z" in keys:
            shoulder = _LEVEL.read(keys["tip_z"])
            shoulder += _LEVEL.read(numbers.get("length", f"{STEM_LENGTH} mm"))
        section_level = _LEVEL.read(given_keys.get("stem_section_z", f"{OLD_SECTION} mm"))
        head_level = _LEVEL.read(given_keys.get("head_height", f"{OLD_HEAD} mm"))
        if not section_level < shoulder < head_level:
            message = f"puts the shoulder at z = {shoulder:g} mm; expected it between the proximal"
            message += (
                f" section at {section_level:g} mm and the head's centre at {head_level:g} mm"
            )
            fail(message, at=(next(iter(replaced)),))
        numbers["section_depth"] = f"{shoulder - section_level!r} mm"
        numbers["head_height"] = f"{head_level - shoulder!r} mm"
        keys["stem"] = numbers
    return keys, replaced


class _Femur(Hip):
    """A proximal femur, the operation and the implant."""

    canal_widening: Annotated[float, length("1 mm", at_least=0.0, at_most=5.0)] = 0.0
    """Reaming: distance by which the endosteal surface is moved outwards, 0 to 5 mm."""
    metaphyseal_cortex: Annotated[float, length("2 mm", at_least=1.5, at_most=4.0)] | None = None
    """Thickness of the cortex above z = -10 mm, perpendicular to the shaft's axis, 1.5 to 4 mm,
    reamed or not. From there to z = -50 mm it changes to the thickness of the shaft. By default it
    is 3.5 to 7 mm. With cells of 6 mm the lowest quality (SICN) is 0.12 at 2 mm, 0.09 at 1.5 mm."""
    stem: Annotated[Stem | StemFile, Kinds(".")] = Field(default_factory=Stem)
    """The implant: its dimensions, or a CAD file."""
    tip_z: Length | None = None
    """Level of the stem's tip. By default the shoulder is at 29 mm, so the tip of a shorter stem is
    higher: at -118 mm for a length of 147 mm."""
    anteversion: Angle = 0.0
    """Rotation of stem, neck and neck cut about the shaft's axis; positive moves the head
    anteriorly (rad)."""
    resection: FemurResection = Field(default_factory=FemurResection)
    """The cut across the neck."""
    distal_cut_z: Annotated[float, length("-200 mm", at_least=-350.0)] = -200.0
    """Level at which the shaft is cut and held: below the plug, at least -350 mm."""

    # Former keys that were given, with their present names.
    _replaced: dict[str, str] = PrivateAttr(default_factory=dict)

    @model_validator(mode="wrap")
    @classmethod
    def _renamed(cls, value: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        replaced: dict[str, str] = {}
        if isinstance(value, dict):
            value, replaced = _with_present_keys(value)
        femur = handler(value)
        if replaced:
            femur._replaced = replaced
        return femur

    @model_validator(mode="after")
    def _consistent(self) -> _Femur:
        implant = self.implant
        for field, message in implant.faults(range_of_thickness(self.cement_thickness)[0]):
            fail(message, at=("stem", field))
        if self.distal_cut_z >= implant.plug:
            message = f"is not below {self.plug_end}; expected below {implant.plug:g} mm"
            fail(message, at=("distal_cut_z",))
        self.check_end()
        if self.canal_widening and not self.is_cemented:
            message = "is for cemented stems; without cement the stem itself displaces the bone"
            fail(f"{message}; leave it out", at=("canal_widening",))
        if not 0.0 <= self.resection.angle < math.pi / 2:
            fail("is not between 0 and 90 deg", at=("resection", "angle"))
        if not HEAD_LEVELS[0] <= implant.head_height <= HEAD_LEVELS[1]:
            message = f"puts the head's centre at z = {implant.head_height:.3g} mm"
            fail(
                f"{message}; expected {HEAD_LEVELS[0]:g} to {HEAD_LEVELS[1]:g} mm",
                at=("stem", "head_height"),
            )
        if self.cut_height >= implant.head_height:
            message = (
                f"puts the neck cut at z = {self.cut_height:.3g} mm on the shaft's axis, above"
            )
            message += f" the head's centre at {implant.head_height:g} mm"
            fail(message, at=("resection", "height"))
        inside = (self.cut_height - implant.tip_z) / implant.length
        if inside < INSIDE:
            message = (
                f"the stem is at z = {implant.tip_z:g} to {implant.shoulder:g} mm; {inside:.0%}"
            )
            message += f" of its length are below the neck cut, expected at least {INSIDE:.0%}"
            fail(message, at=("tip_z",))
        return self

    @property
    def former_keys(self) -> list[Verdict]:
        """Notes on former names of keys that were given."""
        return [
            new_name(f"geometry.{former_key}", present_key)
            for former_key, present_key in self._replaced.items()
        ]

    @property
    def content(self) -> str:
        """Hash of the stem's file; empty without."""
        return self.stem.content

    @property
    def implant(self) -> Implant:
        """The stem in its axes, which have the model's levels."""
        return self.stem.implant(self.tip_z, self.plug_length, self.void, SHOULDER)

    @property
    def femur(self) -> FemurBone:
        """The bone before the operation."""
        from meshes.femur_bone import FemurBone

        return FemurBone(self.anteversion, self.canal_widening, self.metaphyseal_cortex)

    @property
    def more_room(self) -> tuple[str, str]:
        """Key of the stem's position, and the advice if the stem does not fit."""
        remedies = (
            *self.ways_to_widen_canal,
            "narrow the stem",
            "move it proximally (tip_z)",
        )
        return "geometry", alternatives(remedies)

    @property
    def ways_to_widen_canal(self) -> tuple[str, ...]:
        """The key that widens the canal."""
        return ("widen the canal (canal_widening)",)

    def surfaces(self, mesh: MeshOptions) -> LayeredSurfaces:
        """The nested surfaces that are meshed."""
        from meshes.layered_surfaces import LayeredSurfaces

        return LayeredSurfaces(self, mesh)

    @property
    def points(self) -> dict[str, Point3]:
        """Centre of the head and muscles' insertions (mm)."""
        return {"head_centre": self.head_centre, **MUSCLES}

    @property
    def cut_height(self) -> float:
        """Approximate height at which the neck cut meets the shaft's axis (mm)."""
        return self.resection.height + MEDIAL * math.tan(self.resection.angle)

    @property
    def level(self) -> float:
        """Level at which the shaft is cut (mm)."""
        return self.distal_cut_z

    @property
    def distal_height(self) -> float:
        """Height of the distal cut in the stem's axes; equal to `level` (mm)."""
        return self.distal_cut_z

    @property
    def widening(self) -> float:
        """Distance by which the table's endosteum is moved outwards (mm)."""
        return self.canal_widening


class Femur(_Femur, OperatedHip):
    """A proximal femur with a straight tapered stem, in a cement mantle or without.

    Axes: z along the shaft, proximal positive, 0 at mid lesser trochanter; x medial; y anterior.
    The sections of the bone are fixed; the keys describe the operation and the implant. Defaults: a
    stem of the Exeter type, 147 mm long, in an average femur.
    """

    kind: Literal["femur"] = "femur"
    insertion: InsertionOrBest | None = None
    """Position of the stem, if it is not on the shaft's axis, rotated by `anteversion`; or `best`:
    the position near it with the most room."""

    @model_validator(mode="after")
    def _searched(self) -> Femur:
        try:
            self.search()
        except GeometryError as error:
            key, _, message = str(error).removeprefix("geometry.").partition(": ")
            fail(message, at=tuple(key.split(".")))
        return self

    def without_effect(self, mesh: MeshOptions) -> dict[tuple[str, ...], str]:
        """Keys of the case that do nothing beside others, with the reason; given ones or not."""
        keys = super().without_effect(mesh)
        if self.shoulder_depth is not None:
            keys["geometry", "tip_z"] = "insertion.depth says where the stem is"
        return keys

    @property
    def shoulder_depth(self) -> float | None:
        """Depth of the stem's shoulder below the cut (mm); None: as `tip_z` says."""
        return self.insertion.depth if self.insertion else None

    @property
    def more_room(self) -> tuple[str, str]:
        """Key of the stem's position, and the advice if the stem does not fit."""
        if not self.insertion:
            return super().more_room
        remedies = (
            "change insertion (insertion: best, or mantle place)",
            *self.ways_to_widen_canal,
            "use a smaller or shorter stem",
        )
        return "geometry.insertion", alternatives(remedies)

    @property
    def details(self) -> dict[str, str]:
        """Places of axis, head and neck of a stem in its file."""
        return self.stem.details


class IntactFemur(_Femur):
    """The same femur before the operation: bone alone, with its head and neck.

    The keys of the operation and the implant describe what is planned. They do not change the bone,
    but define the bone that will remain, to which the Gruen zones belong. So strain energies can be
    compared with those of a femur with the same keys.
    """

    mesher: ClassVar[str] = "meshes.femur_intact"
    tissues: ClassVar[dict[str, str]] = OF_BONE
    boundary_names: ClassVar[tuple[str, ...]] = ("distal_cut", "bone_surface", "head", *MUSCLES)

    insertion: ClassVar[None] = None

    stem: Stem = Field(default_factory=Stem)
    """The planned implant: its dimensions."""

    kind: Literal["intact_femur"] = "intact_femur"
    head_radius: Annotated[float, length("23 mm", at_least=18.0, at_most=30.0)] = 23.0
    """Radius of the femoral head, 18 to 30 mm; the neck has about two thirds of it."""

    def estimate_cells(self, mesh: MeshOptions) -> int:
        """Estimated number of tetrahedra, to 12 %."""
        cells, _, whole_cells = self._cells(mesh)
        implant = self.implant
        length = implant.head_offset / math.sin(implant.neck_angle)
        neck = mesh.steps(length - 1.07 * self.head_radius)
        return round(
            cells + whole_cells * (neck + max(5, 1.4 * self.head_radius / mesh.step_along))
        )
