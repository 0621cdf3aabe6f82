"""Laws of interfaces: section ``interfaces`` of a case."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import model_validator

from app.laws.materials import History
from app.laws.thermal import Conductance, FrictionHeating, PressureConductance
from app.schema.expressions import Varying
from app.schema.section import Extensible, Kinds, fail
from app.schema.units import Dimension, NonNegativeNumber, PositiveStiffness

LengthField = Annotated[float | str, Varying(Dimension("mm", "a length", "0.05 mm"))]


class InterfaceSection(Extensible):
    """Base of the laws: a subclass with a `kind` is one more (`app/README.md`)."""

    # What a file calls it: a `Literal` of each subclass.
    kind: Any
    # Whether the sides can move apart at all: then the interface has unknown jumps.
    can_part: ClassVar[bool] = True
    # Whether they can part without resistance.
    can_open: ClassVar[bool] = False

    conductance: Conductance = None
    """Power per area and temperature jump; perfect (no jump) by default."""

    @property
    def friction(self) -> float:
        """Coulomb's coefficient; 0 for none."""
        return 0.0

    @property
    def heated_by_friction(self) -> FrictionHeating | None:
        """How the heat of friction is shared; None if there is none."""
        return None

    @property
    def initial_gap(self) -> tuple[float | str, tuple[float, ...] | None]:
        """The initial gap [mm], and its history."""
        return 0.0, None


class Bonded(InterfaceSection):
    """The two sides are one continuum."""

    can_part: ClassVar[bool] = False

    kind: Literal["bonded"] = "bonded"

    @model_validator(mode="after")
    def _no_pressure(self) -> Bonded:
        if isinstance(self.conductance, PressureConductance):
            fail(
                "a bonded interface has no contact pressure; expected kind: contact or penalty",
                at=("conductance",),
            )
        return self


class Unilateral(InterfaceSection):
    """Unilateral contact with Coulomb friction, however it is enforced."""

    can_open: ClassVar[bool] = True

    friction_coefficient: NonNegativeNumber
    """Coulomb's coefficient; 0 for none."""
    gap: LengthField = 0.0
    """Initial gap: positive open, negative an interference (press fit)."""
    gap_history: History = None
    """Multiplier of the gap at the end of each stage, from 0. By default a clearance is there from
    the start, and an interference grows through the first stage."""
    friction_heating: FrictionHeating | None = None
    """Part of the heat of friction that goes into the first side; none is heated by default."""

    @property
    def friction(self) -> float:
        """Coulomb's coefficient; 0 for none."""
        return self.friction_coefficient

    @property
    def heated_by_friction(self) -> FrictionHeating | None:
        """How the heat of friction is shared; None if there is none."""
        return self.friction_heating

    @property
    def initial_gap(self) -> tuple[float | str, tuple[float, ...] | None]:
        """The initial gap [mm], and its history."""
        return self.gap, self.gap_history

    @model_validator(mode="after")
    def _rubs(self) -> Unilateral:
        if self.friction_heating is not None and self.friction_coefficient == 0.0:
            fail("there is no friction", at=("friction_heating",))
        return self


class Contact(Unilateral):
    """Unilateral contact with Coulomb friction, exactly: augmented Lagrangian."""

    kind: Literal["contact"] = "contact"
    augmentation: PositiveStiffness | None = None
    """Augmentation parameter r, chosen by default; results do not depend on it."""


class Penalty(Unilateral):
    """Unilateral contact with Coulomb friction by penalty: it penetrates by pressure / penalty."""

    kind: Literal["penalty"] = "penalty"
    penalty: PositiveStiffness
    """Pressure per penetration."""


Interface = Annotated[InterfaceSection, Kinds()]
