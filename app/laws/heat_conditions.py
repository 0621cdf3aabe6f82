"""Heat conditions: prescribed temperatures, fluxes, convection, sources, perfusion.

The `role` of a condition says how it enters the heat balance: it fixes temperatures, adds heat, or
exchanges heat with surroundings. It acts on a boundary or in regions; the other key is None.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from pydantic import model_validator

from app.foundation.errors import InputError
from app.laws.values import Named, OverTime, field
from app.schema import units
from app.schema.expressions import Varying
from app.schema.section import ITEMS, Kinds, Name, Pair, fail

if TYPE_CHECKING:
    from app.foundation.arrays import Floats

TemperatureField = Annotated[float | str, Varying(units.AbsoluteTemperature())]
FluxField = Annotated[
    float | str, Varying(units.Dimension("mW/mm^2", "a power per area", "200 W/m^2"))
]
SourceField = Annotated[
    float | str, Varying(units.Dimension("mW/mm^3", "a power per volume", "1e6 W/m^3"))
]
TimeCourse = OverTime[Annotated[tuple[units.NonNegativeTime, units.Number], Pair("[10 s, 0]")]]
TemperatureCourse = OverTime[
    Annotated[tuple[units.NonNegativeTime, units.Temperature], Pair("[10 s, 37 degC]")]
]


class FixedTemperature(Named):
    """A prescribed temperature on a boundary or in regions."""

    role: ClassVar[Literal["fixes"]] = "fixes"

    kind: Literal["temperature"] = "temperature"
    boundary: Name | None = None
    """Boundary with this temperature; or give regions."""
    regions: Annotated[tuple[Name, ...], ITEMS] | None = None
    """Regions with this temperature; or give a boundary."""
    temperature: TemperatureField | None = None
    """The temperature; an expression gives it in K. Or give a time course."""
    time_course: TemperatureCourse | None = None
    """Pairs of time since the start and temperature, linear in between; or give a temperature."""

    @model_validator(mode="after")
    def _one_of_each(self) -> FixedTemperature:
        for a, b in (("boundary", "regions"), ("temperature", "time_course")):
            if (getattr(self, a) is None) == (getattr(self, b) is None):
                fail(f"expected either {a} or {b}")
        return self

    def values(self, x: Floats) -> Floats:
        """Prescribed temperature at points (n,) [K]; 1 if it follows a time course."""
        if self.temperature is None:
            return np.ones(len(x))
        key = f"heat.{self.name}.temperature"
        values = field(key, self.temperature)(x)
        if np.any(values <= 0.0):
            raise InputError(
                f"{key}: {self.temperature!r} is not above 0 K everywhere; "
                "an expression gives kelvins"
            )
        return values


class HeatFlux(Named):
    """Prescribed heat flux into a boundary."""

    role: ClassVar[Literal["heats"]] = "heats"
    regions: ClassVar[None] = None

    kind: Literal["flux"] = "flux"
    boundary: Name
    """Boundary of the geometry."""
    flux: FluxField
    """Power per area; an expression gives it in mW/mm^2."""
    time_course: TimeCourse | None = None
    """Pairs of time since the start and multiplier, linear in between; always 1 by default."""

    def values(self, x: Floats) -> Floats:
        """Heat flux at points (n,) [N/(mm s)]."""
        return field(f"heat.{self.name}.flux", self.flux)(x)


class Convection(Named):
    """Heat exchange between a boundary and its surroundings."""

    role: ClassVar[Literal["exchanges"]] = "exchanges"
    regions: ClassVar[None] = None
    time_course: ClassVar[None] = None

    kind: Literal["convection"] = "convection"
    boundary: Name
    """Boundary of the geometry."""
    coefficient: units.FilmCoefficient
    """Power per area and temperature difference."""
    ambient: units.Temperature
    """Temperature of the surroundings."""

    @property
    def outside(self) -> float:
        """Temperature of the surroundings or of the blood [K]."""
        return self.ambient


class HeatSource(Named):
    """Heat released in regions."""

    role: ClassVar[Literal["heats"]] = "heats"
    boundary: ClassVar[None] = None

    kind: Literal["source"] = "source"
    regions: Annotated[tuple[Name, ...], ITEMS]
    """Regions that release the heat."""
    density: SourceField
    """Power per volume; an expression gives it in mW/mm^3."""
    time_course: TimeCourse | None = None
    """Pairs of time since the start and multiplier, linear in between; always 1 by default."""

    def values(self, x: Floats) -> Floats:
        """Heat source density at points (n,) [N/(mm2 s)]."""
        return field(f"heat.{self.name}.density", self.density)(x)


class Perfusion(Named):
    """Perfusion by blood, which brings regions to the temperature of the blood (Pennes)."""

    role: ClassVar[Literal["exchanges"]] = "exchanges"
    boundary: ClassVar[None] = None
    time_course: ClassVar[None] = None

    kind: Literal["perfusion"] = "perfusion"
    regions: Annotated[tuple[Name, ...], ITEMS]
    """Regions with blood flow."""
    rate: units.PositiveRate
    """Volume of blood per volume of tissue and time."""
    blood_density: units.Density
    """Mass per volume of blood."""
    blood_specific_heat: units.SpecificHeat
    """Heat per mass and temperature of blood."""
    temperature: units.Temperature
    """Temperature of the blood."""

    @property
    def outside(self) -> float:
        """Temperature of the surroundings or of the blood [K]."""
        return self.temperature

    @property
    def coefficient(self) -> float:
        """Heat per volume, time and temperature difference [N/(mm2 s K)]."""
        return self.rate * (self.blood_density * self.blood_specific_heat)


HeatCondition = Annotated[
    FixedTemperature | HeatFlux | Convection | HeatSource | Perfusion, Kinds()
]
