"""Supports: prescribed displacements and elastic foundations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag, model_validator

from app.laws.values import LengthField, LoadHistory, Named, field
from app.schema.section import ITEMS, UNION_TAG, Kinds, Name, Triple, fail
from app.schema.units import Axis, Stiffness

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from app.foundation.arrays import Floats


StageNames = Annotated[tuple[Name, ...], ITEMS, Field(min_length=1)] | None
Normal = Annotated[
    Annotated[Axis, Tag(UNION_TAG + "axis")] | Annotated[Literal["face"], Tag("face")],
    Discriminator(
        lambda value: value if isinstance(value, str) else UNION_TAG + "axis",
        custom_error_type="form",
        custom_error_message="expected a direction as [1, 1, 0], or face",
    ),
]


class Support(Named):
    """Base of the supports that prescribe displacements."""

    if TYPE_CHECKING:
        history: LoadHistory
        # The only constrained direction, if any: a unit vector, or `face`.
        normal: tuple[float, float, float] | Literal["face"] | None

    # True for springs.
    is_spring: ClassVar[Literal[False]] = False
    # True if it holds all displacements at zero.
    clamps: ClassVar[bool] = False

    kind: Any
    boundary: Name
    """Boundary of the geometry."""
    stages: StageNames = None
    """Stages in which it acts; all by default."""

    @property
    def components(self) -> tuple[bool, bool, bool]:
        """True for each of x, y, z that it prescribes."""
        x, y, z = (axis in self.held_axes for axis in "xyz")
        return x, y, z

    @property
    def held_axes(self) -> str:
        """Axes along which it constrains the model."""
        return "xyz"

    @property
    def felt_axes(self) -> str:
        """Axes along which it resists motion, at least in part."""
        return self.held_axes

    @property
    def moves(self) -> bool:
        """True if it prescribes a displacement that is not zero."""
        return False

    def values(self, x: Floats) -> Floats:
        """Displacement at points at full amplitude (n, 3) [mm], zero along free axes."""
        return np.zeros_like(x)


class Fixed(Support):
    """No displacement at all."""

    clamps: ClassVar[bool] = True
    history: ClassVar[None] = None  # type: ignore[misc]
    normal: ClassVar[None] = None  # type: ignore[misc]

    kind: Literal["fixed"] = "fixed"


class Roller(Support):
    """No displacement along one direction: of `axis` and `normal` exactly one."""

    history: ClassVar[None] = None  # type: ignore[misc]

    kind: Literal["roller"] = "roller"
    axis: Literal["x", "y", "z"] | None = None
    """Direction without displacement: a coordinate axis."""
    normal: Normal | None = None
    """Direction without displacement: a vector of any length except zero. `face` takes the outward
    normal at each node, the mean of its facets."""

    @model_validator(mode="after")
    def _check_one_direction(self) -> Roller:
        either = "expected axis: x, y or z, or normal: [1, 1, 0] or face"
        if self.axis is not None and self.normal is not None:
            fail(f"cannot be combined with axis; {either}", at=("normal",))
        if self.axis is None and self.normal is None:
            fail(f"has no direction; {either}")
        return self

    @property
    def held_axes(self) -> str:
        """Axes along which it constrains the model."""
        return self.axis or ""

    @property
    def felt_axes(self) -> str:
        """Axes along which it resists motion, at least in part."""
        normal = (1.0, 1.0, 1.0) if isinstance(self.normal, str) else self.normal or ()
        return self.held_axes + "".join(a for a, c in zip("xyz", normal, strict=False) if c)


class Displacement(Support):
    """Prescribed displacement along one or more axes; the others are free."""

    normal: ClassVar[None] = None  # type: ignore[misc]

    kind: Literal["displacement"] = "displacement"
    x: LengthField | None = None
    """Displacement along x; free if absent."""
    y: LengthField | None = None
    """Displacement along y; free if absent."""
    z: LengthField | None = None
    """Displacement along z; free if absent."""
    history: LoadHistory = None
    """Multiplier at the end of each stage, linear in between, from 0; all ones by default."""

    @model_validator(mode="after")
    def _check_not_empty(self) -> Displacement:
        if not self.held_axes:
            fail("prescribes no displacement; expected at least one of x, y, z")
        return self

    @property
    def held_axes(self) -> str:
        """Axes along which it constrains the model."""
        return "".join(axis for axis in "xyz" if getattr(self, axis) is not None)

    @property
    def moves(self) -> bool:
        """True if one of x, y, z is not zero."""
        return any((self.x, self.y, self.z))

    def values(self, x: Floats) -> Floats:
        """Displacement at points at full amplitude (n, 3) [mm], zero along free axes."""
        given_components = {axis: getattr(self, axis) or 0.0 for axis in "xyz"}
        columns = [
            field(f"supports.{self.name}.{axis}", v)(x) for axis, v in given_components.items()
        ]
        return np.stack(columns, axis=1)


class Foundation(Named):
    """Elastic foundation: springs to the ground, distributed over a boundary."""

    is_spring: ClassVar[Literal[True]] = True
    clamps: ClassVar[bool] = False
    normal: ClassVar[None] = None
    moves: ClassVar[bool] = False
    # It acts in all stages.
    stages: ClassVar[None] = None

    kind: Literal["foundation"] = "foundation"
    boundary: Name
    """Boundary of the geometry."""
    stiffness: Annotated[
        tuple[Stiffness, Stiffness, Stiffness],
        Triple("[100 MPa/mm, 100 MPa/mm, 0 MPa/mm]", scalar=True),
    ]
    """Traction per displacement along x, y, z; a single value is the same along all."""

    @model_validator(mode="after")
    def _check_not_empty(self) -> Foundation:
        if not any(self.stiffness):
            fail(
                "is zero along every axis; expected a stiffness along at least one",
                at=("stiffness",),
            )
        return self

    @property
    def held_axes(self) -> str:
        """Axes along which it constrains the model."""
        return "".join(axis for axis, k in zip("xyz", self.stiffness, strict=True) if k > 0.0)

    @property
    def felt_axes(self) -> str:
        """Axes along which it resists motion."""
        return self.held_axes

    def energy(self, v: Expr, k: Expr) -> Expr:
        """Energy per area in a displacement v (3,) [N/mm]; the stiffness k is a UFL constant."""
        from forms import loads

        return loads.foundation_energy(k, v)


AnySupport = Annotated[Fixed | Roller | Displacement | Foundation, Kinds()]
