"""Stems: mantle's own by its numbers, or one from a file of CAD; both make an `Implant`."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import model_validator

from app.foundation import confined
from app.foundation.errors import GeometryError
from app.schema.paths import file
from app.schema.section import Pair, Section, Triple, fail
from app.schema.units import Angle, Dimension, Length, PositiveLength

_Point = Annotated[tuple[Length, Length, Length], Triple("[0 mm, 0 mm, 100 mm]")]
_Line = Annotated[tuple[_Point, _Point], Pair("[[0 mm, 0 mm, 0 mm], [0 mm, 0 mm, 100 mm]]")]


NECK_ANGLES = (100.0, 145.0)  # range of the angle between neck and shaft (deg)
FLAT = 1.0  # mm: a rounded end or a void that is shorter has flat cells
SECTION = ("half_width", "half_depth", "corner_radius")


@dataclass(frozen=True)
class Implant:
    """A stem with its plug, in axes of its own: z along it, x towards its head.

    Sections are rounded rectangles, given at the tip and at `section_z`, and linear in z; of a stem
    from a file they are None. Levels are in the stem's axes, lengths in mm.

    Attributes:
        tip_z: Level of the tip.
        length: From the shoulder to the tip.
        section_z: Level of the proximal section.
        tip_rounding: Height of the rounded end, 0: flat.
        plug_length: Length of cement below the tip.
        tip_void: Length without cement below the tip; the end is flat then.
        head_offset: Distance of the head's centre from the axis.
        head_height: Level of the head's centre.
        neck_angle: Angle between neck and stem [rad].
        stem: The file that it is from, None for mantle's own.
    """

    tip_z: float
    length: float
    section_z: float
    half_width: float
    half_depth: float
    corner_radius: float
    tip_half_width: float
    tip_half_depth: float
    tip_corner_radius: float
    neck_diameter: float
    neck_fillet: float
    trunnion_diameter: float
    head_offset: float
    head_height: float
    neck_angle: float
    tip_rounding: float
    plug_length: float
    tip_void: float
    stem: StemFile | None = None

    @property
    def shoulder(self) -> float:
        """Level of the shoulder."""
        return self.tip_z + self.length

    @property
    def plug(self) -> float:
        """Level of the end of the cement plug."""
        return self.tip_z - self.plug_length

    @property
    def tip_height(self) -> float:
        """Height of the rounded end; 0: it is flat."""
        return 0.0 if self.tip_void else self.tip_rounding

    def section(self, z: float) -> tuple[float, float, float]:
        """Half-width, half-depth and corner radius at a level, of a file those of a square."""
        if self.stem:
            half = float(self.stem.found["around"]) / 8
            return half, half, 0.0
        part = (z - self.tip_z) / (self.section_z - self.tip_z)
        half, depth, corner = (
            (1.0 - part) * getattr(self, f"tip_{name}") + part * getattr(self, name)
            for name in SECTION
        )
        return half, depth, corner

    def faults(self, cement: float) -> Iterator[tuple[str, str]]:
        """Fields that cannot be meshed, with the reason; the section's level must be right.

        Args:
            cement: Least thickness of the mantle (mm).
        """
        if 0.0 < self.tip_rounding < FLAT:
            yield "tip_rounding", "is neither 0 nor 1 mm at least"
        if not NECK_ANGLES[0] <= math.degrees(self.neck_angle) <= NECK_ANGLES[1]:
            yield "neck_angle", "is not between {:g} and {:g} deg".format(*NECK_ANGLES)
        if self.stem:
            return
        for end in ("", "tip_"):
            half = min(getattr(self, f"{end}half_width"), getattr(self, f"{end}half_depth"))
            if getattr(self, f"{end}corner_radius") >= half:
                text = f"is not below the half-width and half-depth, {half:g} mm"
                yield f"{end}corner_radius", text
        yield from self._degenerate(self.shoulder, "the shoulder", 0.0)
        yield from self._degenerate(self.plug, "the end of the plug", cement)
        width = 2.0 * self.section(self.shoulder)[0]
        if self.neck_diameter > width:
            text = f"is wider than the stem's shoulder; expected at most {width:.3g} mm"
            yield "neck_diameter", text

    def _degenerate(self, z: float, where: str, offset: float) -> Iterator[tuple[str, str]]:
        """Fields of a section, extrapolated to a level, that has no width or no flats there.

        ``where`` is the level in words, ``offset`` the thickness added around the section (mm).
        """
        sizes = {}
        for name, size in zip(SECTION, self.section(z), strict=True):
            rise = getattr(self, name) - getattr(self, f"tip_{name}")
            slope = rise / (self.section_z - self.tip_z)
            across = 1.0 if name == "corner_radius" else math.hypot(1.0, slope)
            sizes[name] = size + offset * across
        radius = sizes["corner_radius"]
        for name, size in sizes.items():
            if size <= 0.0 or (name != "corner_radius" and size <= radius):
                text = f"at {where}, z = {z:g} mm, it has become {size:.3g} mm"
                least = "positive" if size <= 0.0 else f"above the corner radius, {radius:.3g} mm,"
                yield name, f"{text}; expected sections that stay {least} there"


length = partial(Dimension, "mm", "a length")


NeckDiameter = Annotated[float, length("10 mm", at_least=5.0)]
NeckFillet = Annotated[float, length("3 mm", at_least=2.0, at_most=10.0)]
TrunnionDiameter = Annotated[float, length("12 mm", at_least=5.0, at_most=22.0)]
HeadOffset = Annotated[float, length("43 mm", at_least=20.0, at_most=80.0)]
TipRounding = Annotated[float, length("2 mm", at_least=0.0, at_most=20.0)]


class Stem(Section):
    """A straight tapered collarless stem as that of the parametric femur."""

    length: PositiveLength = 147.0
    """From the shoulder to the tip."""
    tip_half_width: PositiveLength = 3.0
    """Half the medio-lateral width at the tip."""
    tip_half_depth: PositiveLength = 3.0
    """Half the antero-posterior depth at the tip."""
    tip_corner_radius: PositiveLength = 2.1
    """Radius of the section's corners at the tip."""
    tip_rounding: TipRounding = 2.0
    """Height of the stem's rounded end, 1 to 20 mm; 0: it is flat, as it is over a void."""
    section_depth: PositiveLength = 14.0
    """Depth below the shoulder of the proximal section that the next three describe."""
    half_width: PositiveLength = 8.5
    """Half the medio-lateral width there."""
    half_depth: PositiveLength = 5.0
    """Half the antero-posterior depth there."""
    corner_radius: PositiveLength = 3.0
    """Radius of the section's corners there."""
    neck_diameter: NeckDiameter = 13.0
    """Diameter of the neck where it leaves the body: at least 5 mm, at most the body's width."""
    neck_fillet: NeckFillet = 3.0
    """Radius where the stem turns into the neck, 2 to 10 mm; a blunt turn has a larger one."""
    trunnion_diameter: TrunnionDiameter = 12.0
    """Diameter of the neck's end, which carries the head, 5 to 22 mm."""
    head_offset: HeadOffset = 43.0
    """Medial distance of the head's centre from the stem's axis, 20 to 80 mm."""
    head_height: PositiveLength = 25.0
    """Height of the head's centre above the shoulder."""
    neck_angle: Angle = math.radians(130.0)
    """Angle between neck and stem (rad), 100 to 145 deg."""

    @model_validator(mode="after")
    def _section_above_tip(self) -> Stem:
        if not self.section_depth < self.length:
            set_keys = self.model_fields_set
            if "length" in set_keys and "section_depth" not in set_keys:
                text = "puts the tip above the proximal section, which is at section_depth ="
                fail(f"{text} {self.section_depth:g} mm; set section_depth too", at=("length",))
            fail("is not above the tip", at=("section_depth",))
        return self

    content: ClassVar[str] = ""
    details: ClassVar[dict[str, str]] = {}

    def implant(self, **cement: float) -> Implant:
        """The implant with its shoulder at 0, ``plug_length`` and ``tip_void`` given (mm)."""
        numbers = dict(self)
        levels = {"tip_z": -self.length, "section_z": -numbers.pop("section_depth")}
        return Implant(**(numbers | levels | cement))


class StemFile(Section):
    """A stem from CAD: one solid with a neck. Points are in the coordinates of the file."""

    step: Annotated[Path, file(".step", ".stp", ".iges", ".igs", ".brep")]
    """STEP, IGES or BREP file; relative to the case file."""
    unit: Literal["mm", "cm", "m", "um", "inch"] = "mm"
    """What a millimetre of the file is, if it names no unit or a wrong one: STEP and IGES files
    name theirs, and are read in millimetres."""
    head_centre: _Point | None = None
    """Centre of the head; by default that of the face that ends the neck."""
    axis: _Line | None = None
    """Two points of the stem's axis, the distal one first; by default it is fitted to sections of
    the distal half."""
    taper_face: _Point | None = None
    """A point of the planar face that ends the neck; by default it is the one farthest to medial
    and proximal."""

    @model_validator(mode="after")
    def _readable(self) -> StemFile:
        try:
            _ = self.found
        except (GeometryError, OSError) as error:
            fail(str(error), at=("step",))
        return self

    @cached_property
    def content(self) -> str:
        """Hash of the file and of what is given beside it, at the first access."""
        given = json.dumps(self.model_dump(exclude={"step"})).encode()
        return hashlib.sha256(self.step.read_bytes() + given).hexdigest()

    @property
    def found(self) -> dict[str, Any]:
        """What `meshes.stem_file.read` finds.

        Raises:
            GeometryError: The file has no stem.
        """
        if self.content not in _READ:
            with tempfile.TemporaryDirectory(prefix="mantle-gmsh-") as folder:
                shutil.copy(self.step, folder)
                request = dict(self) | {"path": str(self.step), "step": None}
                _READ[self.content] = confined.ask("meshes.stem_file:read", request, folder)
        return _READ[self.content]

    @property
    def details(self) -> dict[str, str]:
        """Places of its axis, head and neck in the file, in words (mm)."""
        low, high, head, end, medial = (self.found["in_file"].round(2) + 0.0).tolist()
        name = self.step.name
        return {
            f"axis in {name}": f"{low} to {high} mm, medial {medial}",
            f"head's centre in {name}": f"{head} mm",
            f"end of the neck in {name}": f"{end} mm",
        }

    def values(self, tip: float) -> dict[str, float]:
        """Numbers that the file answers, by fields of `Implant`, with its tip at a level (mm)."""
        found = self.found
        (offset, _, height), neck = found["head"], found["neck"]
        numbers = {"length": found["shoulder"], "trunnion_diameter": 2.0 * found["radius"]}
        numbers |= {"head_offset": offset, "head_height": tip + height}
        numbers["tip_rounding"] = found["rounding"]
        angle = round(math.degrees(math.acos(-neck[2])), 3)
        exact = {key: round(float(number), 2) for key, number in numbers.items()}
        return exact | {"neck_angle": math.radians(angle)}

    def implant(self, **cement: float) -> Implant:
        """The implant with its shoulder at 0, ``plug_length`` and ``tip_void`` given (mm)."""
        tip = -round(float(self.found["shoulder"]), 2)
        unknown: dict[str, Any] = dict.fromkeys(field.name for field in fields(Implant))
        numbers: dict[str, Any] = unknown | self.values(tip) | cement
        return Implant(**(numbers | {"tip_z": tip, "stem": self}))


_READ: dict[str, dict[str, Any]] = {}  # by content: a case is read more than once
