"""Stems: by numbers, or one from a CAD file; both make an `Implant`."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import tempfile
from dataclasses import fields
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import model_validator

from app.foundation import confined
from app.foundation.errors import GeometryError
from app.foundation.implant import Implant
from app.schema.paths import file
from app.schema.section import Pair, Section, Triple, fail
from app.schema.units import Dimension, Length, PositiveLength

_Point = Annotated[tuple[Length, Length, Length], Triple("[0 mm, 0 mm, 100 mm]")]
_Line = Annotated[tuple[_Point, _Point], Pair("[[0 mm, 0 mm, 0 mm], [0 mm, 0 mm, 100 mm]]")]
# Smallest and largest angle of a collar [deg].
COLLAR_ANGLES = (20.0, 320.0)
# Suffixes of CAD files that are read.
SUFFIXES = (".step", ".stp", ".iges", ".igs", ".brep")

length = partial(Dimension, "mm", "a length")
NeckDiameter = Annotated[float, length("10 mm", at_least=5.0)]
NeckFillet = Annotated[float, length("3 mm", at_least=2.0, at_most=10.0)]
TrunnionDiameter = Annotated[float, length("12 mm", at_least=5.0, at_most=22.0)]
HeadOffset = Annotated[float, length("43 mm", at_least=20.0, at_most=80.0)]
TipRounding = Annotated[float, length("2 mm", at_least=0.0, at_most=20.0)]


class Collar(Section):
    """A plate around the stem that rests on the neck cut, from the stem to the bone's surface."""

    thickness: Annotated[float, length("3 mm", at_least=1.0, at_most=10.0)] = 3.0
    """Thickness of the plate, 1 to 10 mm."""
    angle: Annotated[float, Dimension("rad", "an angle", "90 deg")] = math.radians(90.0)
    """Angle about the stem's axis over which it extends, half of it to each side of medial, 20 to
    320 deg. The mesh rounds it to whole pairs of lines and reports the result."""

    @model_validator(mode="after")
    def _beside_the_resection(self) -> Collar:
        least_angle, largest_angle = COLLAR_ANGLES
        if not least_angle <= round(math.degrees(self.angle), 9) <= largest_angle:
            fail(f"is not between {least_angle:g} and {largest_angle:g} deg", at=("angle",))
        return self


def collar_numbers(collar: Collar | None) -> dict[str, float]:
    """Thickness and angle of a collar by fields of `Implant`; both are zero without one."""
    if collar is None:
        return {"collar_thickness": 0.0, "collar_angle": 0.0}
    return {"collar_thickness": collar.thickness, "collar_angle": collar.angle}


class Stem(Section):
    """A straight tapered stem by its dimensions, with or without a collar."""

    content: ClassVar[str] = ""
    details: ClassVar[dict[str, str]] = {}

    length: PositiveLength = 147.0
    """Length from the shoulder to the tip."""
    tip_half_width: PositiveLength = 3.0
    """Half the medio-lateral width at the tip."""
    tip_half_depth: PositiveLength = 3.0
    """Half the antero-posterior depth at the tip."""
    tip_corner_radius: PositiveLength = 2.1
    """Radius of the section's corners at the tip."""
    tip_rounding: TipRounding = 2.0
    """Height of the stem's rounded end, 1 to 20 mm; 0 means a flat end, as above a void."""
    section_depth: PositiveLength = 14.0
    """Depth below the shoulder of the proximal section that the next three keys describe."""
    half_width: PositiveLength = 8.5
    """Half the medio-lateral width of that section."""
    half_depth: PositiveLength = 5.0
    """Half the antero-posterior depth of that section."""
    corner_radius: PositiveLength = 3.0
    """Radius of the corners of that section."""
    neck_diameter: NeckDiameter = 13.0
    """Diameter of the neck where it leaves the body: at least 5 mm, at most the body's width."""
    neck_fillet: NeckFillet = 3.0
    """Radius of the fillet between body and neck, 2 to 10 mm; at an obtuse angle it is larger."""
    trunnion_diameter: TrunnionDiameter = 12.0
    """Diameter of the neck's end, which carries the head, 5 to 22 mm."""
    head_offset: HeadOffset = 43.0
    """Medial distance of the head's centre from the stem's axis, 20 to 80 mm."""
    head_height: PositiveLength = 25.0
    """Height of the head's centre above the shoulder."""
    neck_angle: Annotated[float, Dimension("rad", "an angle", "130 deg")] = math.radians(130.0)
    """Angle between neck and stem (rad), 100 to 145 deg."""
    collar: Collar | None = None
    """Collar that rests on the neck cut: region `collar`, interface `collar_bone`. By default the
    stem has none."""

    @model_validator(mode="after")
    def _section_above_tip(self) -> Stem:
        if not self.section_depth < self.length:
            set_keys = self.model_fields_set
            if "length" in set_keys and "section_depth" not in set_keys:
                message = "puts the tip above the proximal section, which is at section_depth ="
                fail(f"{message} {self.section_depth:g} mm; set section_depth too", at=("length",))
            fail(f"must be below the stem's length, {self.length:g} mm", at=("section_depth",))
        return self

    def implant(
        self, tip_z: float | None, plug_length: float, tip_void: float, shoulder: float = 0.0
    ) -> Implant:
        """Implant whose tip, or whose shoulder, is at the given level (mm)."""
        numbers = dict(self)
        collar = numbers.pop("collar")
        tip = shoulder - self.length if tip_z is None else tip_z
        shoulder = tip + self.length
        levels = {
            "tip_z": tip,
            "section_z": shoulder - numbers.pop("section_depth"),
            "head_height": shoulder + self.head_height,
        }
        cement = {"plug_length": plug_length, "tip_void": tip_void}
        return Implant(**(numbers | levels | cement | collar_numbers(collar)))


class StemFile(Section):
    """A stem from CAD: one solid with a neck. Points are in the coordinates of the file."""

    step: Annotated[Path, file(*SUFFIXES)]
    """STEP, IGES or BREP file; relative to the case file."""
    unit: Literal["mm", "cm", "m", "um", "inch"] = "mm"
    """Unit of a file that names none or a wrong one. STEP and IGES files name their unit, and are
    converted to millimetres; this key then gives the true length of such a millimetre."""
    head_centre: _Point | None = None
    """Centre of the head; by default that of the face that ends the neck."""
    axis: _Line | None = None
    """Two points of the stem's axis, the distal one first; by default it is fitted to sections of
    the distal half."""
    taper_face: _Point | None = None
    """A point of the planar face that ends the neck; by default it is the one farthest to medial
    and proximal."""
    collar: Collar | None = None
    """Collar that rests on the neck cut, as for a parametric stem; the file must have none."""

    @model_validator(mode="after")
    def _readable(self) -> StemFile:
        try:
            _ = self.shape
        except (GeometryError, OSError) as error:
            fail(str(error), at=("step",))
        return self

    @cached_property
    def content(self) -> str:
        """Hash of the file and of the keys by which it is read; computed at the first access."""
        key_text = json.dumps(self.model_dump(exclude={"step", "collar"})).encode()
        return hashlib.sha256(self.step.read_bytes() + key_text).hexdigest()

    @property
    def shape(self) -> dict[str, Any]:
        """Triangles, axis, head and neck, by name, as `meshes.stem_file.read` returns them.

        Raises:
            GeometryError: The file has no stem.
        """
        if self.content not in _SHAPES:
            with tempfile.TemporaryDirectory(prefix="mantle-gmsh-") as folder:
                shutil.copy(self.step, folder)
                request = dict(self) | {"path": str(self.step), "step": None}
                del request["collar"]
                _SHAPES[self.content] = confined.ask("meshes.stem_file:read", request, folder)
        return _SHAPES[self.content]

    @property
    def details(self) -> dict[str, str]:
        """Length and head, and the places of axis, head and neck in the file, in words (mm)."""
        low, high, head, end, medial = (self.shape["in_file"].round(2) + 0.0).tolist()
        name = self.step.name
        numbers = self.values(0.0)
        angle = math.degrees(numbers["neck_angle"])
        return {
            "length of the stem": f"{numbers['length']:g} mm",
            "offset of its head": f"{numbers['head_offset']:g} mm",
            "angle of its neck": f"{angle:g} deg",
            f"axis in {name}": f"{low} to {high} mm, medial {medial}",
            f"head's centre in {name}": f"{head} mm",
            f"end of the neck in {name}": f"{end} mm",
        }

    def values(self, tip: float) -> dict[str, float]:
        """Numbers that the file answers, by fields of `Implant`, with its tip at a level (mm)."""
        shape = self.shape
        (offset, _, height), neck = shape["head"], shape["neck"]
        numbers = {"length": shape["shoulder"], "trunnion_diameter": 2.0 * shape["radius"]}
        numbers |= {"head_offset": offset, "head_height": tip + height}
        numbers["tip_rounding"] = shape["rounding"]
        angle = round(math.degrees(math.acos(-neck[2])), 3)
        exact = {key: round(float(number), 2) for key, number in numbers.items()}
        return exact | {"neck_angle": math.radians(angle)}

    def implant(
        self, tip_z: float | None, plug_length: float, tip_void: float, shoulder: float = 0.0
    ) -> Implant:
        """Implant whose tip, or whose shoulder, is at the given level (mm)."""
        tip = shoulder - round(float(self.shape["shoulder"]), 2) if tip_z is None else tip_z
        unset_fields: dict[str, Any] = dict.fromkeys(field.name for field in fields(Implant))
        cement = {"plug_length": plug_length, "tip_void": tip_void}
        numbers: dict[str, Any] = (
            unset_fields | self.values(tip) | cement | collar_numbers(self.collar)
        )
        return Implant(**(numbers | {"tip_z": tip, "cad": self.shape}))


# Shapes of files that were read, by `StemFile.content`: a case is read more than once.
_SHAPES: dict[str, dict[str, Any]] = {}
