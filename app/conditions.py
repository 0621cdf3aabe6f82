"""What happens at interfaces and boundaries: contact laws, supports, loads."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ValidationInfo, model_validator

from app import expressions
from app.fields import ITEMS, Kinds, Model, Name, Word, fail, show
from app.materials import History
from app.units import (
    NUMBER,
    Dimension,
    ForceDensityVector,
    ForceVector,
    Length,
    NonNegativeNumber,
    PositiveStiffness,
    Stiffness,
    Stress,
    Triple,
    spread_unit,
)

GAP = Dimension("mm", "a length", "0.05 mm")


def _gap(value: object) -> float | str:
    """A length, or an expression in the coordinates (checked, kept as text)."""
    if isinstance(value, str):
        # "0.02 mm" is a length and "0.02" one without its unit; "0.02 * x" is an expression.
        if (match := NUMBER.fullmatch(value)) and (not match[2] or match[2][0].isalpha()):
            return GAP.read(value)
        try:
            expressions.parse(value)
        except ValueError as error:
            fail(f"{error}; expected a length such as '0.05 mm' or an expression in x, y, z in mm")
        return value
    return GAP.read(value)


def _gap_as_text(value: float | str) -> str:
    return value if isinstance(value, str) else GAP.write(value)


class GapType:
    """Pydantic's view of a gap: `float` (mm) or an expression in x, y, z that gives mm."""

    @classmethod
    def __get_pydantic_core_schema__(cls, source: object, handler: Any) -> Any:
        """Read by `_gap`, write so that it reads back."""
        from pydantic_core import core_schema

        return core_schema.no_info_plain_validator_function(
            _gap, serialization=core_schema.plain_serializer_function_ser_schema(_gap_as_text)
        )

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: object, handler: object) -> dict[str, Any]:
        """Text."""
        return {
            "type": "string",
            "description": "length with a unit, or an expression in x, y, z (mm)",
            "examples": ["0.05 mm", "-0.02 * (1 - z / 50)"],
        }


Gap = Annotated[float | str, GapType]


class Bonded(Model):
    """The two sides are one continuum."""

    kind: Literal["bonded"] = "bonded"


class Contact(Model):
    """Unilateral contact with Coulomb friction, exactly: augmented Lagrangian."""

    kind: Literal["contact"] = "contact"
    friction_coefficient: NonNegativeNumber
    """Coulomb's coefficient; 0 for none."""
    gap: Gap = 0.0
    """Initial gap: positive open, negative an interference (press fit)."""
    gap_history: History = None
    """Multiplier of the gap at the end of each stage, from 0; all ones by default."""
    augmentation: PositiveStiffness | None = None
    """Augmentation parameter r, chosen by default; results do not depend on it."""


class Penalty(Model):
    """Unilateral contact with Coulomb friction by penalty: it penetrates by pressure / penalty."""

    kind: Literal["penalty"] = "penalty"
    friction_coefficient: NonNegativeNumber
    """Coulomb's coefficient; 0 for none."""
    penalty: PositiveStiffness
    """Pressure per penetration."""
    gap: Gap = 0.0
    """Initial gap: positive open, negative an interference (press fit)."""
    gap_history: History = None
    """Multiplier of the gap at the end of each stage, from 0; all ones by default."""


Interface = Annotated[Bonded | Contact | Penalty, Kinds()]


class Fixed(Model):
    """No displacement at all."""

    kind: Literal["fixed"] = "fixed"
    boundary: Name
    """Boundary of the geometry."""

    @property
    def held_axes(self) -> str:
        """Axes along which the model cannot move freely."""
        return "xyz"


class Roller(Model):
    """No displacement along one axis."""

    kind: Literal["roller"] = "roller"
    boundary: Name
    """Boundary of the geometry."""
    axis: Annotated[Literal["x", "y", "z"], Word()]
    """The axis."""

    @property
    def held_axes(self) -> str:
        """Axes along which the model cannot move freely."""
        return self.axis


class Displacement(Model):
    """Given displacement along one or more axes; the others are free."""

    kind: Literal["displacement"] = "displacement"
    boundary: Name
    """Boundary of the geometry."""
    x: Length | None = None
    """Displacement along x; free if absent."""
    y: Length | None = None
    """Displacement along y; free if absent."""
    z: Length | None = None
    """Displacement along z; free if absent."""
    history: History = None
    """Multiplier at the end of each stage, linear in between, from 0; all ones by default."""

    @model_validator(mode="after")
    def _some(self) -> Displacement:
        if not self.held_axes:
            fail("prescribes nothing; expected at least one of x, y, z")
        return self

    @property
    def held_axes(self) -> str:
        """Axes along which the model cannot move freely."""
        return "".join(axis for axis in "xyz" if getattr(self, axis) is not None)


class Foundation(Model):
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
    points: dict[str, tuple[float, float, float]] = (info.context or {}).get("points", {})
    if value not in points:
        known = f" or one of {', '.join(points)}" if points else " (this geometry names no points)"
        fail(f"{show(value)} is not a point; expected [x, y, z] lengths{known}")
    return [f"{c!r} mm" for c in points[value]]


Point = Annotated[
    tuple[Length, Length, Length],
    Triple("[0 mm, 0 mm, 50 mm]"),
    BeforeValidator(_point),
]


class Force(Model):
    """A resultant force, as a traction over the boundary; with `at`, with its moment too."""

    kind: Literal["force"] = "force"
    boundary: Name
    """Boundary of the geometry."""
    force: ForceVector
    """Resultant."""
    at: Point | None = None
    """Point at which the resultant acts (mm); over the boundary evenly by default."""
    history: History = None
    """Multiplier at the end of each stage, linear in between, from 0; all ones by default."""


class Pressure(Model):
    """A pressure normal to the boundary; positive compresses."""

    kind: Literal["pressure"] = "pressure"
    boundary: Name
    """Boundary of the geometry."""
    pressure: Stress
    """Pressure."""
    history: History = None
    """Multiplier at the end of each stage, linear in between, from 0; all ones by default."""


class BodyForce(Model):
    """A force per volume, such as weight."""

    kind: Literal["body_force"] = "body_force"
    regions: Annotated[tuple[Name, ...], ITEMS] | None = None
    """Regions it acts on; all by default."""
    density: ForceDensityVector
    """Force per volume."""
    history: History = None
    """Multiplier at the end of each stage, linear in between, from 0; all ones by default."""


Load = Annotated[Force | Pressure | BodyForce, Kinds()]
