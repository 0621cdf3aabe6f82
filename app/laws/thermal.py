"""Options of heat: conduction and cure of regions, and conditions that heat or cool."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    model_validator,
)
from pydantic_core import core_schema

from app.laws.fibres import FibreDirection
from app.schema.expressions import Varying
from app.schema.section import ITEMS, TAG, Kinds, Name, Scalar, Section, Word, fail, show
from app.schema.units import (
    NUMBER,
    AbsoluteTemperature,
    ActivationEnergy,
    ConductancePerArea,
    ConductancePerPressure,
    Conductivity,
    Density,
    Dimension,
    ExpansionCoefficient,
    FilmCoefficient,
    HeatDensity,
    NonNegativeNumber,
    NonNegativeTime,
    Number,
    Plain,
    PositiveDifference,
    PositiveNumber,
    PositiveRate,
    PositiveTime,
    SpecificHeat,
    Temperature,
)
from app.schema.vectors import Pair

Table = tuple[tuple[float, float], ...]


def _rising(what: str) -> Callable[[Table], Table]:
    """Refuse a table without entries, or whose first column does not increase."""

    def check(table: Table) -> Table:
        if not table:
            fail("is empty; expected at least one pair")
        for i, ((before, _), (value, _)) in enumerate(pairwise(table)):
            if value <= before:
                fail(f"its {what} is not above that of the pair before", at=(i + 1,))
        return table

    return check


TemperatureField = Annotated[float | str, Varying(AbsoluteTemperature())]
FluxField = Annotated[float | str, Varying(Dimension("mW/mm^2", "a power per area", "200 W/m^2"))]
SourceField = Annotated[
    float | str, Varying(Dimension("mW/mm^3", "a power per volume", "1e6 W/m^3"))
]
Course = Annotated[
    tuple[Annotated[tuple[NonNegativeTime, Number], Pair("[10 s, 0]")], ...],
    ITEMS,
    AfterValidator(_rising("time")),
]
TemperatureCourse = Annotated[
    tuple[Annotated[tuple[NonNegativeTime, Temperature], Pair("[10 s, 37 degC]")], ...],
    ITEMS,
    AfterValidator(_rising("time")),
]
RateCourse = Annotated[
    tuple[Annotated[tuple[NonNegativeTime, NonNegativeNumber], Pair("[300 s, 1]")], ...],
    ITEMS,
    AfterValidator(_rising("time")),
]
Conversion = Annotated[float, Plain(above=0.0, at_most=1.0)]
Limit = Annotated[
    tuple[Annotated[tuple[Temperature, Conversion], Pair("[20 degC, 0.8]")], ...],
    ITEMS,
    AfterValidator(_rising("temperature")),
]
# A degree of cure from which something is left to happen.
Degree = Annotated[float, Plain(at_least=0.0, below=1.0)]


# ------------------------------------------------------------------------------------- cure


class Autocatalytic(Section):
    """Rate of cure k0 exp(-Ea/RT) a^m (a_max - a)^n, with temperature T in K."""

    kind: Literal["autocatalytic"] = "autocatalytic"
    rate_constant: PositiveRate
    """k0, the rate constant of the reaction."""
    activation_energy: ActivationEnergy
    """Ea, the activation energy of the reaction."""
    m: NonNegativeNumber
    """Exponent of the degree of cure a."""
    n: NonNegativeNumber
    """Exponent of what is left to cure, a_max - a."""
    limit: Limit | None = None
    """Pairs of temperature and largest degree a_max there, linear in between; 1 by default."""


class Prescribed(Section):
    """Cure that follows a clock, whatever the temperature."""

    kind: Literal["prescribed"] = "prescribed"
    rate: RateCourse
    """Pairs of time and rate in any measure, linear in between, zero before and after them; scaled
    so that it ends with complete cure."""

    @model_validator(mode="after")
    def _happens(self) -> Prescribed:
        if len(self.rate) < 2 or not any(rate for _, rate in self.rate):
            fail("nothing happens; expected at least two pairs, one not 0", at=("rate",))
        return self


class Cure(Section):
    """How a region sets, and what comes of it."""

    kinetics: Annotated[Autocatalytic | Prescribed, Kinds()]
    """Rate of cure."""
    heat: HeatDensity
    """Heat released per volume from degree of cure 0 to 1."""
    initial: Degree = 1e-3
    """Degree of cure at the start; autocatalysis needs some."""
    gel: Degree = 0.85
    """Degree of cure of the gel: from there strain counts and stiffness grows."""
    floor: Annotated[float, Plain(above=0.0, at_most=1.0)] = 0.01
    """Stiffness before the gel, as a part of the final one."""
    exponent: PositiveNumber = 1.0
    """Exponent p of the stiffness, floor + (1 - floor) ((a - gel) / (1 - gel))^p of the final."""
    shrinkage: Degree = 0.0
    """Loss of volume from the gel to full cure, as a part of the volume."""

    @model_validator(mode="after")
    def _starts_and_sets(self) -> Cure:
        kinetics = self.kinetics
        if isinstance(kinetics, Autocatalytic):
            if self.initial == 0.0 and kinetics.m > 0.0:
                fail("never starts from 0 where m > 0; expected e.g. 1e-3", at=("initial",))
            largest = max((a for _, a in kinetics.limit or ()), default=1.0)
            for key in ("initial", "gel"):
                if getattr(self, key) > largest:
                    fail(f"is above the largest limit of the kinetics, {largest:g}", at=(key,))
        return self


# ---------------------------------------------------------------------------------- regions


class Thermal(Section):
    """Conduction of heat in a region, and what temperature does to it."""

    conductivity: Conductivity | None = None
    """Conductivity in all directions; or give axial_conductivity and transverse_conductivity."""
    axial_conductivity: Conductivity | None = None
    """Conductivity along the fibre."""
    transverse_conductivity: Conductivity | None = None
    """Conductivity across the fibre."""
    fibre: FibreDirection | None = None
    """Fibre direction where the region has none of its own; z by default."""
    density: Density
    """Mass per volume."""
    specific_heat: SpecificHeat
    """Heat per mass and temperature."""
    initial_temperature: Temperature
    """Temperature at the start."""
    thermal_expansion: ExpansionCoefficient | None = None
    """Strain per temperature; none by default."""
    reference_temperature: Temperature | None = None
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


# ------------------------------------------------------------------------------- interfaces


class PressureConductance(Section):
    """Conductance that grows with contact pressure: open + per_pressure * p, at most cap."""

    kind: Literal["pressure"] = "pressure"
    open: ConductancePerArea
    """Conductance where there is no pressure."""
    per_pressure: ConductancePerPressure
    """Increase of the conductance per pressure."""
    cap: FilmCoefficient | None = None
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
        """A choice by the form of the value."""

        def check(value: object) -> object:
            if value == "perfect":
                return None
            expected = "expected perfect, a value such as '300 W/(m^2 K)', or kind: pressure"
            if isinstance(value, str) and not NUMBER.fullmatch(value):
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
            TAG + "constant": handler.generate_schema(ConductancePerArea),
        }
        union = core_schema.nullable_schema(core_schema.tagged_union_schema(choices, tag))
        return core_schema.no_info_before_validator_function(check, union)

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, object]:
        """The choice, with the word."""
        return {"anyOf": [{"const": "perfect"}, handler(schema)]}


Conductance = Annotated[float | PressureConductance | None, _Conductance()]


@dataclass(frozen=True)
class _Heating(Scalar):
    """Marks the part of frictional heat that goes into the first side."""

    def read(self, value: object) -> float | str:
        """The part, or the word that asks for it to be found from the materials.

        Raises:
            PydanticCustomError: Neither.
        """
        if isinstance(value, str):
            if value != "effusivity":
                fail(f"{show(value)} is not effusivity or a number from 0 to 1")
            return value
        return float(Plain(at_least=0.0, at_most=1.0).read(value))

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, object]:
        """A word or a number."""
        part = {"type": "number", "minimum": 0, "maximum": 1}
        return {"anyOf": [{"const": "effusivity"}, part]}


FrictionHeating = Annotated[float | str, _Heating()]


# ------------------------------------------------------------------------------- conditions


class FixedTemperature(Section):
    """A given temperature on a boundary or throughout regions."""

    kind: Literal["temperature"] = "temperature"
    boundary: Name | None = None
    """Boundary that has the temperature; or give regions."""
    regions: Annotated[tuple[Name, ...], ITEMS] | None = None
    """Regions held at the temperature; or give a boundary."""
    temperature: TemperatureField | None = None
    """The temperature; an expression gives it in K. Or give a course."""
    course: TemperatureCourse | None = None
    """Pairs of time since the start and temperature, linear in between; or give a temperature."""

    @model_validator(mode="after")
    def _one_of_each(self) -> FixedTemperature:
        for a, b in (("boundary", "regions"), ("temperature", "course")):
            if (getattr(self, a) is None) == (getattr(self, b) is None):
                fail(f"expected either {a} or {b}")
        return self


class HeatFlux(Section):
    """Heat that enters through a boundary."""

    kind: Literal["flux"] = "flux"
    boundary: Name
    """Boundary of the geometry."""
    flux: FluxField
    """Power per area; an expression gives it in mW/mm^2."""
    course: Course | None = None
    """Pairs of time since the start and multiplier, linear in between; always 1 by default."""


class Convection(Section):
    """Exchange of heat with the surroundings of a boundary."""

    kind: Literal["convection"] = "convection"
    boundary: Name
    """Boundary of the geometry."""
    coefficient: FilmCoefficient
    """Power per area and difference of temperatures."""
    ambient: Temperature
    """Temperature of the surroundings."""


class HeatSource(Section):
    """Heat released in regions."""

    kind: Literal["source"] = "source"
    regions: Annotated[tuple[Name, ...], ITEMS]
    """Regions that release the heat."""
    density: SourceField
    """Power per volume; an expression gives it in mW/mm^3."""
    course: Course | None = None
    """Pairs of time since the start and multiplier, linear in between; always 1 by default."""


class Perfusion(Section):
    """Blood that brings regions to its own temperature (Pennes)."""

    kind: Literal["perfusion"] = "perfusion"
    regions: Annotated[tuple[Name, ...], ITEMS]
    """Regions that blood flows through."""
    rate: PositiveRate
    """Volume of blood per volume of tissue and time."""
    blood_density: Density
    """Mass per volume of blood."""
    blood_specific_heat: SpecificHeat
    """Heat per mass and temperature of blood."""
    temperature: Temperature
    """Temperature of the blood."""


HeatCondition = Annotated[
    FixedTemperature | HeatFlux | Convection | HeatSource | Perfusion, Kinds()
]


class TimeOptions(Section):
    """How stages that take time are divided into steps."""

    method: Annotated[Literal["sdirk4", "backward_euler"], Word()] = "sdirk4"
    """Time integrator; both are L-stable, of order 4 and 1."""
    tolerance: PositiveDifference = 1e-3
    """Largest error of the temperature in a time step."""
    first_step: PositiveTime | None = None
    """First time step of a stage; chosen by mantle by default."""
    mechanical_step: PositiveDifference = 5.0
    """Change of temperature after which the mechanics are solved again; cure counts as the
    temperature that it releases."""
