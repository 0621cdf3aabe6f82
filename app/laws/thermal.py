"""Heat in regions and across interfaces: conduction, expansion, conductance, heat of friction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, GetCoreSchemaHandler, GetJsonSchemaHandler, model_validator
from pydantic_core import core_schema

from app.laws.cure import Cure
from app.laws.fibres import FibreDirection
from app.laws.values import Named
from app.schema import units
from app.schema.section import TAG, Scalar, Section, fail, show

if TYPE_CHECKING:
    from ufl.core.expr import Expr


class Thermal(Named):
    """Conduction of heat in a region, and what temperature does to it."""

    conductivity: units.Conductivity | None = None
    """Conductivity in all directions; or give axial_conductivity and transverse_conductivity."""
    axial_conductivity: units.Conductivity | None = None
    """Conductivity along the fibre."""
    transverse_conductivity: units.Conductivity | None = None
    """Conductivity across the fibre."""
    fibre: FibreDirection | None = None
    """Fibre direction where the region has none of its own; z by default."""
    density: units.Density
    """Mass per volume."""
    specific_heat: units.SpecificHeat
    """Heat per mass and temperature."""
    initial_temperature: units.Temperature
    """Temperature at the start."""
    thermal_expansion: units.ExpansionCoefficient | None = None
    """Strain per temperature; none by default."""
    reference_temperature: units.Temperature | None = None
    """Temperature without thermal strain; the initial temperature by default."""
    cure: Cure | None = None
    """How the region sets; by default it does not."""

    @model_validator(mode="after")
    def _complete(self) -> Thermal:
        pair = {
            "axial_conductivity": self.axial_conductivity,
            "transverse_conductivity": self.transverse_conductivity,
        }
        given = [key for key, value in pair.items() if value is not None]
        either = "expected conductivity, or axial_conductivity and transverse_conductivity"
        if self.conductivity is not None and given:
            fail(f"{given[0]} beside conductivity; {either}", at=(given[0],))
        if self.conductivity is None and len(given) < 2:
            missing = next(key for key in pair if key not in given) if given else "conductivity"
            fail(f"'{missing}' is missing; {either}")
        if self.fibre is not None and self.conductivity is not None:
            fail("the conductivity is the same in all directions: no fibre", at=("fibre",))
        if self.reference_temperature is not None:
            if not self.thermal_expansion:
                fail("nothing expands; expected thermal_expansion", at=("reference_temperature",))
            if self.cure is not None:
                fail(
                    "strains of a region that cures count from where it sets: no reference",
                    at=("reference_temperature",),
                )
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
        both = self.axial_conductivity, self.transverse_conductivity
        return tuple(k for k in (self.conductivity, *both) if k is not None)

    @property
    def effusivity(self) -> float:
        """sqrt(k c), with the geometric mean of the three conductivities [N/(mm K s^1/2)]."""
        k = self.conductivities
        mean = (k[0] * k[1] ** 2) ** (1 / 3) if len(k) > 1 else k[0]
        return math.sqrt(mean * self.capacity)

    def potential(self, g: Expr, conductivities: Sequence[Any], fibre: Any) -> Expr:
        """Potential of conduction for a temperature gradient; constants are UFL expressions."""
        from forms import heat

        if fibre is None:
            return heat.isotropic_conduction(g, *conductivities)
        return heat.fibre_conduction(g, fibre, *conductivities)


class PressureConductance(Section):
    """Conductance that grows with contact pressure: open + per_pressure * p, at most cap."""

    kind: Literal["pressure"] = "pressure"
    open: units.ConductancePerArea
    """Conductance where there is no pressure."""
    per_pressure: units.ConductancePerPressure
    """Increase of the conductance per pressure."""
    cap: units.FilmCoefficient | None = None
    """Largest conductance; no limit by default."""

    @model_validator(mode="after")
    def _in_order(self) -> PressureConductance:
        if self.cap is not None and self.cap < self.open:
            fail("is below `open`", at=("cap",))
        return self


class _Conductance:
    """Marks a field as `perfect` (kept as None), a conductance, or one that depends on pressure."""

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Choose by the form of the value."""

        def check(value: object) -> object:
            if value == "perfect":
                return None
            expected = "expected perfect, a value such as '300 W/(m^2 K)', or kind: pressure"
            if isinstance(value, str) and not units.NUMBER.fullmatch(value):
                fail(f"{show(value)} is not a conductance; {expected}")
            if isinstance(value, dict) and value.get("kind") != "pressure":
                wrong = (
                    f"{show(value['kind'])} is not pressure" if "kind" in value else "is missing"
                )
                fail(f"{wrong}; {expected}", at=("kind",))
            return value

        def tag(value: object) -> str:
            by_pressure = isinstance(value, dict | BaseModel)
            return TAG + (PressureConductance.__name__ if by_pressure else "constant")

        choices = {
            TAG + PressureConductance.__name__: handler.generate_schema(PressureConductance),
            TAG + "constant": handler.generate_schema(units.ConductancePerArea),
        }
        union = core_schema.nullable_schema(core_schema.tagged_union_schema(choices, tag))
        return core_schema.no_info_before_validator_function(check, union)

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, object]:
        """Add the word ``perfect``."""
        return {"anyOf": [{"const": "perfect"}, handler(schema)]}


Conductance = Annotated[float | PressureConductance | None, _Conductance()]


@dataclass(frozen=True)
class _Heating(Scalar):
    """Marks the fraction of friction heat that enters the first side."""

    def read(self, value: object) -> float | str:
        """The fraction, or ``effusivity`` to compute it from the materials.

        Raises:
            PydanticCustomError: Neither.
        """
        if isinstance(value, str):
            if value != "effusivity":
                fail(f"{show(value)} is not effusivity or a number from 0 to 1")
            return value
        return float(units.Plain(at_least=0.0, at_most=1.0).read(value))

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, object]:
        """A word or a number."""
        part = {"type": "number", "minimum": 0, "maximum": 1}
        return {"anyOf": [{"const": "effusivity"}, part]}


FrictionHeating = Annotated[float | str, _Heating()]
