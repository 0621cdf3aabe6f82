"""A stem from a file of CAD, in place of the parametric one."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import tempfile
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import model_validator

from app.foundation import confined
from app.foundation.errors import GeometryError
from app.schema.paths import file
from app.schema.section import Pair, Section, Triple, fail
from app.schema.units import Length

_Point = Annotated[tuple[Length, Length, Length], Triple("[0 mm, 0 mm, 100 mm]")]
_Line = Annotated[tuple[_Point, _Point], Pair("[[0 mm, 0 mm, 0 mm], [0 mm, 0 mm, 100 mm]]")]


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
    def told(self) -> dict[str, Any]:
        """Where it is in the file, in words (mm)."""
        low, high, head, end, medial = (self.found["in_file"].round(2) + 0.0).tolist()
        name = self.step.name
        return {
            f"axis in {name}": f"{low} to {high} mm, medial {medial}",
            f"head's centre in {name}": f"{head} mm",
            f"end of the neck in {name}": f"{end} mm",
        }

    @property
    def femur_keys(self) -> dict[str, Any]:
        """Keys of a femur in which it is, with its shoulder at z = 0."""
        tip = -round(float(self.found["shoulder"]), 2)
        return self.values(tip) | {"stem_tip_z": tip, "stem": self}

    def values(self, tip: float) -> dict[str, float]:
        """Keys of a femur that the file answers, with its tip at a level (mm)."""
        found = self.found
        (offset, _, height), neck = found["head"], found["neck"]
        numbers = {"stem_length": found["shoulder"], "trunnion_diameter": 2.0 * found["radius"]}
        numbers |= {"head_offset": offset, "head_height": tip + height}
        numbers["tip_rounding"] = found["rounding"]
        angle = round(math.degrees(math.acos(-neck[2])), 3)
        exact = {key: round(float(number), 2) for key, number in numbers.items()}
        return exact | {"neck_angle": math.radians(angle)}


_READ: dict[str, dict[str, Any]] = {}  # by content: a case is read more than once
