"""Heat in regions and across interfaces: conduction, expansion, conductance, friction heat."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import AfterValidator, BaseModel, Discriminator, Tag, model_validator

from app.laws.cure import Cure
from app.laws.fibres import FibreDirection
from app.laws.values import OfRegion
from app.schema import units
from app.schema.section import UNION_TAG, Section, fail

if TYPE_CHECKING:
    from ufl.core.expr import Expr


class Thermal(OfRegion):
    """Heat conduction, thermal expansion and cure of a region."""

    conductivity: units.Conductivity | None = None
    """Isotropic conductivity; or give axial_conductivity and transverse_conductivity."""
    axial_conductivity: units.Conductivity | None = None
    """Conductivity along the fibre."""
    transverse_conductivity: units.Conductivity | None = None
    """Conductivity across the fibre."""
    fibre: FibreDirection | None = None
    """Fibre direction, if the material of the region has none; z by default."""
    density: units.Density
    """Mass per volume."""
    specific_heat: units.SpecificHeat
    """Heat per mass and temperature."""
    initial_temperature: units.Temperature
    """Temperature at the start."""
    thermal_expansion: units.ExpansionCoefficient | None = None
    """Strain per temperature; none by default."""
    reference_temperature: units.Temperature | None = None
    """Temperature at which thermal strain is zero; the initial temperature by default."""
    cure: Cure | None = None
    """Cure of the region; none by default."""

    @model_validator(mode="after")
    def _check_keys(self) -> Thermal:
        pair = "axial_conductivity", "transverse_conductivity"
        given_keys = [key for key in pair if getattr(self, key) is not None]
        either = "expected conductivity, or axial_conductivity and transverse_conductivity"
        if self.conductivity is not None and given_keys:
            fail(
                f"{given_keys[0]} cannot be combined with conductivity; {either}",
                at=(given_keys[0],),
            )
        if self.conductivity is None and len(given_keys) < 2:
            missing_key = (
                next(key for key in pair if key not in given_keys) if given_keys else "conductivity"
            )
            fail(f"'{missing_key}' is missing; {either}")
        if self.fibre is not None and self.conductivity is not None:
            fail("the conductivity is isotropic; leave the fibre out", at=("fibre",))
        if self.reference_temperature is not None:
            if not self.thermal_expansion:
                fail("needs thermal_expansion in the same section", at=("reference_temperature",))
            if self.cure is not None:
                message = "strains of a region that cures count from where it sets: no reference"
                fail(message, at=("reference_temperature",))
        return self

    @property
    def reference(self) -> float:
        """Temperature without thermal strain [K]."""
        return self.reference_temperature or self.initial_temperature

    @property
    def expansion(self) -> float:
        """Coefficient of thermal expansion, 0 if absent [1/K]."""
        return self.thermal_expansion or 0.0

    @property
    def capacity(self) -> float:
        """Heat per volume and temperature [N/(mm2 K)]."""
        return self.density * self.specific_heat

    @property
    def conductivities(self) -> tuple[float, ...]:
        """Conductivity along and across the fibre, or one if isotropic [N/(s K)]."""
        along_and_across = self.axial_conductivity, self.transverse_conductivity
        return tuple(k for k in (self.conductivity, *along_and_across) if k is not None)

    @property
    def effusivity(self) -> float:
        """sqrt(k c), with the geometric mean of the three conductivities [N/(mm K s^1/2)]."""
        k = self.conductivities
        mean = (k[0] * k[1] ** 2) ** (1 / 3) if len(k) > 1 else k[0]
        return math.sqrt(mean * self.capacity)

    def potential(self, g: Expr, conductivities: Sequence[Expr], fibre: Expr | None) -> Expr:
        """Potential of conduction for a temperature gradient g (3,) [K/mm]; see `forms.heat`."""
        from forms import heat

        if fibre is None:
            return heat.isotropic_conduction(g, *conductivities)
        return heat.fibre_conduction(g, fibre, *conductivities)


class PressureConductance(Section):
    """Conductance that grows with the contact pressure p: open + per_pressure * p, at most cap."""

    kind: Literal["pressure"] = "pressure"
    open: units.ConductancePerArea
    """Conductance without pressure."""
    per_pressure: units.ConductancePerPressure
    """Increase of the conductance per pressure."""
    cap: units.FilmCoefficient | None = None
    """Largest conductance; no limit by default."""

    @model_validator(mode="after")
    def _check_cap(self) -> PressureConductance:
        if self.cap is not None and self.cap < self.open:
            fail("is below `open`", at=("cap",))
        return self


def _form(value: object) -> str | None:
    """Form of a conductance: a word, a quantity or a section."""
    if isinstance(value, dict | BaseModel):
        return UNION_TAG + "pressure"
    if isinstance(value, str) and not units.NUMBER.fullmatch(value):
        return UNION_TAG + "perfect" if value == "perfect" else None
    return UNION_TAG + "constant"


if TYPE_CHECKING:
    Conductance = float | PressureConductance
else:
    # `perfect` is kept as None.
    Conductance = Annotated[
        Annotated[Literal["perfect"], AfterValidator(lambda _: None), Tag(UNION_TAG + "perfect")]
        | Annotated[units.ConductancePerArea, Tag(UNION_TAG + "constant")]
        | Annotated[PressureConductance, Tag(UNION_TAG + "pressure")],
        Discriminator(
            _form,
            custom_error_type="form",
            custom_error_message="expected perfect, a value as '300 W/(m^2 K)' or kind: pressure",
        ),
    ]

# The fraction of friction heat that enters the first side, or to compute it from the materials.
FrictionHeating = Annotated[
    Annotated[Literal["effusivity"], Tag("effusivity")]
    | Annotated[float, units.Plain(at_least=0.0, at_most=1.0), Tag(UNION_TAG + "part")],
    Discriminator(
        lambda value: value if isinstance(value, str) else UNION_TAG + "part",
        custom_error_type="form",
        custom_error_message="expected effusivity or a number from 0 to 1",
    ),
]
