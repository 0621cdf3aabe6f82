"""What happens at interfaces and boundaries: contact laws, supports, loads."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, ValidationInfo, model_validator

from mantle.schema.expressions import Varying
from mantle.schema.fields import ITEMS, Kinds, Name, Section, Word, fail, show
from mantle.schema.materials import History
from mantle.schema.thermal_options import Conductance, FrictionHeating, PressureConductance
from mantle.schema.units import (
    Dimension,
    ForceVector,
    Length,
    NonNegativeNumber,
    PositiveStiffness,
    Stiffness,
    Stress,
    Triple,
    spread_unit,
)

LengthField = Annotated[float | str, Varying(Dimension("mm", "a length", "0.05 mm"))]
ForceDensityField = Annotated[
    float | str, Varying(Dimension("N/mm^3", "a force per volume", "1e-5 N/mm^3"))
]


def _some_stages(names: tuple[str, ...]) -> tuple[str, ...]:
    if not names:
        fail("is empty; expected names of stages")
    return names


StageNames = Annotated[tuple[Name, ...], ITEMS, AfterValidator(_some_stages)] | None


class Bonded(Section):
    """The two sides are one continuum."""

    kind: Literal["bonded"] = "bonded"
    conductance: Conductance = None
    """Power per area and temperature jump; perfect (no jump) by default."""

    @model_validator(mode="after")
    def _no_pressure(self) -> Bonded:
        if isinstance(self.conductance, PressureConductance):
            fail(
                "a bonded interface has no contact pressure; expected kind: contact or penalty",
                at=("conductance",),
            )
        return self


class Contact(Section):
    """Unilateral contact with Coulomb friction, exactly: augmented Lagrangian."""

    kind: Literal["contact"] = "contact"
    friction_coefficient: NonNegativeNumber
    """Coulomb's coefficient; 0 for none."""
    gap: LengthField = 0.0
    """Initial gap: positive open, negative an interference (press fit)."""
    gap_history: History = None
    """Multiplier of the gap at the end of each stage, from 0. By default a clearance is there from
    the start, and an interference grows through the first stage."""
    augmentation: PositiveStiffness | None = None
    """Augmentation parameter r, chosen by default; results do not depend on it."""
    conductance: Conductance = None
    """Power per area and temperature jump; perfect (no jump) by default."""
    friction_heating: FrictionHeating | None = None
    """Part of the heat of friction that goes into the first side; none is heated by default."""

    @model_validator(mode="after")
    def _rubs(self) -> Contact:
        _rubs(self)
        return self


class Penalty(Section):
    """Unilateral contact with Coulomb friction by penalty: it penetrates by pressure / penalty."""

    kind: Literal["penalty"] = "penalty"
    friction_coefficient: NonNegativeNumber
    """Coulomb's coefficient; 0 for none."""
    penalty: PositiveStiffness
    """Pressure per penetration."""
    gap: LengthField = 0.0
    """Initial gap: positive open, negative an interference (press fit)."""
    gap_history: History = None
    """Multiplier of the gap at the end of each stage, from 0. By default a clearance is there from
    the start, and an interference grows through the first stage."""
    conductance: Conductance = None
    """Power per area and temperature jump; perfect (no jump) by default."""
    friction_heating: FrictionHeating | None = None
    """Part of the heat of friction that goes into the first side; none is heated by default."""

    @model_validator(mode="after")
    def _rubs(self) -> Penalty:
        _rubs(self)
        return self


def _rubs(law: Contact | Penalty) -> None:
    """Refuse heat of friction without friction."""
    if law.friction_heating is not None and law.friction_coefficient == 0.0:
        fail("there is no friction", at=("friction_heating",))


Interface = Annotated[Bonded | Contact | Penalty, Kinds()]


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


class Roller(Section):
    """No displacement along one axis."""

    kind: Literal["roller"] = "roller"
    boundary: Name
    """Boundary of the geometry."""
    axis: Annotated[Literal["x", "y", "z"], Word()]
    """The axis."""
    stages: StageNames = None
    """Stages in which it holds; all by default."""

    @property
    def held_axes(self) -> str:
        """Axes along which the model cannot move freely."""
        return self.axis


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


class Force(Section):
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


class Pressure(Section):
    """A pressure normal to the boundary; positive compresses."""

    kind: Literal["pressure"] = "pressure"
    boundary: Name
    """Boundary of the geometry."""
    pressure: Stress
    """Pressure."""
    history: History = None
    """Multiplier at the end of each stage, linear in between, from 0; all ones by default."""


class BodyForce(Section):
    """A force per volume, such as weight."""

    kind: Literal["body_force"] = "body_force"
    regions: Annotated[tuple[Name, ...], ITEMS] | None = None
    """Regions it acts on; all by default."""
    density: Annotated[
        tuple[ForceDensityField, ForceDensityField, ForceDensityField],
        Triple("[0 N/mm^3, 0 N/mm^3, -1e-5 N/mm^3]"),
    ]
    """Force per volume along x, y, z; each may vary in space."""
    history: History = None
    """Multiplier at the end of each stage, linear in between, from 0; all ones by default."""


Load = Annotated[Force | Pressure | BodyForce, Kinds()]
