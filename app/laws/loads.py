"""Conditions at boundaries: supports and loads."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BeforeValidator,
    GetCoreSchemaHandler,
    ValidationInfo,
    model_validator,
)
from pydantic_core import core_schema

from app.laws.materials import History
from app.schema.expressions import Varying
from app.schema.section import ITEMS, TAG, Extensible, Kinds, Name, Section, Word, fail, show
from app.schema.units import Axis, Dimension, ForceVector, Length, Stiffness, Stress
from app.schema.vectors import Triple, spread_unit

LengthField = Annotated[float | str, Varying(Dimension("mm", "a length", "0.05 mm"))]
ForceDensityField = Annotated[
    float | str, Varying(Dimension("N/mm^3", "a force per volume", "1e-5 N/mm^3"))
]


def _some_stages(names: tuple[str, ...]) -> tuple[str, ...]:
    if not names:
        fail("is empty; expected names of stages")
    return names


StageNames = Annotated[tuple[Name, ...], ITEMS, AfterValidator(_some_stages)] | None


class Fixed(Section):
    """No displacement at all."""

    kind: Literal["fixed"] = "fixed"
    boundary: Name
    """Boundary of the geometry."""
    stages: StageNames = None
    """Stages in which it holds; all by default."""

    @property
    def held_axes(self) -> str:
        """Axes along which the model cannot move freely."""
        return "xyz"


class _Normal:
    """Marks a field that is a direction or the word `face`."""

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Either, told apart before it is read."""

        def check(value: object) -> object:
            if isinstance(value, list | tuple) or value == "face":
                return value
            fail(f"{show(value)} is no direction; expected e.g. [1, 1, 0], or face")

        kinds: dict[Any, core_schema.CoreSchema] = {
            TAG + "face": core_schema.literal_schema(["face"]),
            TAG + "axis": handler.generate_schema(Axis),
        }
        union = core_schema.tagged_union_schema(
            kinds, lambda value: TAG + ("face" if value == "face" else "axis")
        )
        return core_schema.no_info_before_validator_function(check, union)


class Roller(Section):
    """No displacement along one direction: of `axis` and `normal` exactly one."""

    kind: Literal["roller"] = "roller"
    boundary: Name
    """Boundary of the geometry."""
    axis: Annotated[Literal["x", "y", "z"], Word()] | None = None
    """The direction, if it is an axis."""
    normal: Annotated[Axis | Literal["face"], _Normal()] | None = None
    """The direction; any length but zero, normalised. `face`: at each node along the outward
    normal of the boundary there, the mean of its facets."""
    stages: StageNames = None
    """Stages in which it holds; all by default."""

    @model_validator(mode="after")
    def _one(self) -> Roller:
        either = "expected axis: x, y or z, or normal: [1, 1, 0] or face"
        if self.axis is not None and self.normal is not None:
            fail(f"stands beside axis; {either}", at=("normal",))
        if self.axis is None and self.normal is None:
            fail(f"has no direction; {either}")
        return self

    @property
    def held_axes(self) -> str:
        """Axes along which the model cannot move freely."""
        return self.axis or ""

    @property
    def felt_axes(self) -> str:
        """Axes along which it may resist a motion."""
        normal = (1.0, 1.0, 1.0) if isinstance(self.normal, str) else self.normal or ()
        return self.held_axes + "".join(a for a, c in zip("xyz", normal, strict=False) if c)


class Displacement(Section):
    """Given displacement along one or more axes; the others are free."""

    kind: Literal["displacement"] = "displacement"
    boundary: Name
    """Boundary of the geometry."""
    x: LengthField | None = None
    """Displacement along x; free if absent."""
    y: LengthField | None = None
    """Displacement along y; free if absent."""
    z: LengthField | None = None
    """Displacement along z; free if absent."""
    history: History = None
    """Multiplier at the end of each stage, linear in between, from 0; all ones by default."""
    stages: StageNames = None
    """Stages in which it holds; all by default."""

    @model_validator(mode="after")
    def _some(self) -> Displacement:
        if not self.held_axes:
            fail("prescribes nothing; expected at least one of x, y, z")
        return self

    @property
    def held_axes(self) -> str:
        """Axes along which the model cannot move freely."""
        return "".join(axis for axis in "xyz" if getattr(self, axis) is not None)


class Foundation(Section):
    """Springs to the ground spread over a boundary."""

    kind: Literal["foundation"] = "foundation"
    boundary: Name
    """Boundary of the geometry."""
    stiffness: Annotated[
        tuple[Stiffness, Stiffness, Stiffness],
        Triple("[100 MPa/mm, 100 MPa/mm, 0 MPa/mm]", scalar=True),
    ]
    """Traction per displacement along x, y, z; a single value is the same along all."""

    @model_validator(mode="after")
    def _some(self) -> Foundation:
        if not any(self.stiffness):
            fail("is zero along every axis", at=("stiffness",))
        return self

    @property
    def held_axes(self) -> str:
        """Axes along which the model cannot move freely."""
        return "".join(axis for axis, k in zip("xyz", self.stiffness, strict=True) if k > 0.0)


Support = Annotated[Fixed | Roller | Displacement | Foundation, Kinds()]


def _point(value: object, info: ValidationInfo) -> object:
    """The name of a point of the geometry as its coordinates."""
    value = spread_unit(value)
    if not isinstance(value, str):
        return value
    points: dict[str, tuple[float, float, float]] | None = (info.context or {}).get("points", {})
    if points is None:
        return ["0 mm"] * 3  # the geometry is wrong, and that is told already
    if value not in points:
        known = f" or one of {', '.join(points)}" if points else " (this geometry names no points)"
        fail(f"{show(value)} is not a point; expected [x, y, z] lengths{known}")
    return [f"{c!r} mm" for c in points[value]]


Point = Annotated[
    tuple[Length, Length, Length],
    Triple("[0 mm, 0 mm, 50 mm]"),
    BeforeValidator(_point),
]


class LoadSection(Extensible):
    """Base of the loads: a subclass with a `kind` is one more (`app/README.md`)."""

    # What a file calls it: a `Literal` of each subclass.
    kind: Any
    history: History = None
    """Multiplier at the end of each stage, linear in between, from 0; all ones by default."""

    @property
    def place(self) -> tuple[Any, ...]:
        """Its kind and what it acts on: loads that agree in this share their forms."""
        return self.kind, getattr(self, "boundary", None), getattr(self, "regions", None)

    @property
    def resultant(self) -> tuple[float, float, float] | None:
        """The resultant at full amplitude [N], if that is what it gives."""
        return None

    def traction(self, area: float) -> float:
        """Size of its traction on a boundary of an area [MPa]; 0 if it acts on none."""
        return 0.0


class Force(LoadSection):
    """A resultant force, as a traction over the boundary; with `at`, with its moment too."""

    kind: Literal["force"] = "force"
    boundary: Name
    """Boundary of the geometry."""
    force: ForceVector
    """Resultant."""
    at: Point | None = None
    """Point at which the resultant acts (mm); over the boundary evenly by default."""

    @property
    def resultant(self) -> tuple[float, float, float]:
        """The resultant at full amplitude [N]."""
        return self.force

    def traction(self, area: float) -> float:
        """Size of its mean traction on a boundary of an area [MPa]."""
        return math.hypot(*self.force) / area


class Pressure(LoadSection):
    """A pressure normal to the boundary; positive compresses."""

    kind: Literal["pressure"] = "pressure"
    boundary: Name
    """Boundary of the geometry."""
    pressure: Stress
    """Pressure."""

    def traction(self, area: float) -> float:
        """Its size [MPa]."""
        return abs(self.pressure)


class BodyForce(LoadSection):
    """A force per volume, such as weight."""

    kind: Literal["body_force"] = "body_force"
    regions: Annotated[tuple[Name, ...], ITEMS] | None = None
    """Regions it acts on; all by default."""
    density: Annotated[
        tuple[ForceDensityField, ForceDensityField, ForceDensityField],
        Triple("[0 N/mm^3, 0 N/mm^3, -1e-5 N/mm^3]"),
    ]
    """Force per volume along x, y, z; each may vary in space."""


Load = Annotated[LoadSection, Kinds()]
