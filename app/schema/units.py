"""Numbers and dimensional quantities as pydantic field types.

A dimensional value is text with a unit (``110 GPa``); after validation it is a float in the
internal system mm, N, MPa, s, K, tonne, rad. The conversion is done in rational arithmetic and
rounded once, so that ``0.11 TPa``, ``110 GPa`` and ``110000 MPa`` give the same float.

A field is declared by one of the aliases below, for example ``thickness: PositiveLength``.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated, Any

from pydantic import AfterValidator, GetJsonSchemaHandler
from pydantic_core import core_schema

from app.schema.section import Scalar, did_you_mean, fail, show
from app.schema.unit_conversion import conversion
from app.schema.vectors import Triple

NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*", re.DOTALL)
NOT_FINITE = re.compile(r"\s*[+-]?\.?(inf(inity)?|nan)\b", re.IGNORECASE)
# Longest number: huge exponents would be expensive.
LONGEST = 60
# Longest number with its unit; matching takes quadratic time.
LONGEST_VALUE = 200

SUGGESTIONS = (
    "GPa MPa kPa Pa mm um cm m nm N kN mN deg rad degC K s ms min hour N/mm N/mm^2 N/mm^3 MPa/mm "
    "kg tonne kg/m^3 W/m^2 W/m^3 J/m^3 J/mol 1/K 1/s"
).split()


def finite(value: int | float) -> bool:
    """Whether a number is finite as a float; a large integer is not."""
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False


@dataclass(frozen=True, kw_only=True)
class _Bounded(Scalar):
    """Marks a number.

    Attributes:
        above: Exclusive lower bound.
        at_least: Inclusive lower bound.
        at_most: Inclusive upper bound.
        below: Exclusive upper bound.
    """

    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    below: float | None = None

    def violated(self, value: float, unit: str = "") -> str:
        """Message of the bound that a value violates, or ""."""
        behind = f" {unit}".rstrip()
        if self.below is not None and not value < self.below:
            return f"must be below {self.below:g}{behind}"
        if self.above is not None and not value > self.above:
            return f"must be above {self.above:g}{behind}" if self.above else "must be positive"
        if self.at_least is not None and value < self.at_least:
            least = f"must be at least {self.at_least:g}{behind}"
            return least if self.at_least else "must not be negative"
        if self.at_most is not None and value > self.at_most:
            return f"must be at most {self.at_most:g}{behind}"
        return ""


@dataclass(frozen=True)
class Dimension(_Bounded):
    """Marks a float field as dimensional: read from text with a unit, kept in the internal unit.

    Attributes:
        unit: Internal unit.
        what: Dimension in words, with its article.
        example: Value as written in a file.
    """

    unit: str
    what: str
    example: str

    def read(self, value: object) -> float:
        """The value in the internal unit.

        Raises:
            PydanticCustomError: Not a number with a unit of this dimension, not finite, out of
                bounds.
        """
        expected = f"expected {self.what} such as '{self.example}'"
        text = value if isinstance(value, str) else ""
        match = NUMBER.fullmatch(text) if len(text) <= LONGEST_VALUE else None
        number, unit = match.groups() if match else ("", "")
        if isinstance(value, int | float) and not isinstance(value, bool) and finite(value):
            number = str(value)
        elif match is None:
            endless = isinstance(value, int | float) and not isinstance(value, bool)
            endless = endless or NOT_FINITE.match(text) is not None
            wrong = "is not finite" if endless else f"is not {self.what}"
            fail(f"{show(value)} {wrong}; {expected}")
        if not unit:
            shown = show(value) if text else number
            fail(f"{shown} needs a unit, e.g. '{number} {self.example.split(maxsplit=1)[1]}'")
        try:
            slope, offset = conversion(unit, self.unit)
        except LookupError:
            hint = did_you_mean(unit, SUGGESTIONS)
            fail(f"{show(value)}: '{unit}' is not a unit; {expected}{hint}")
        except ValueError as error:
            fail(f"{show(value)} is {error}; {expected}")
        if len(number) > LONGEST or not math.isfinite(float(number)):
            fail(f"{show(value)} is not finite; {expected}")
        # A number that underflows is zero; as a fraction it could take gigabytes.
        exact = Fraction(number) if float(number) != 0.0 else Fraction(0)
        try:
            result = float(exact * slope + offset)
        except OverflowError:
            fail(f"{show(value)} is not finite in {self.unit}")
        if bound := self.violated(result, self.unit):
            fail(f"{show(value)} {bound}")
        return result

    def write(self, value: float) -> str:
        """The value as text that reads back to the same float."""
        if self.unit == "rad":
            degrees = f"{round(math.degrees(value), 9)!r} deg"
            if self.read(degrees) == value:
                return degrees
        return f"{value!r} {self.unit}"

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Text that starts with a number and ends with a unit."""
        return {
            "type": "string",
            "pattern": r"^\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*(1\s*/\s*)?[A-Za-zµμ°].*$",
            "description": f"{self.what} with a unit (kept in {self.unit})",
            "examples": [self.example],
        }


@dataclass(frozen=True)
class AbsoluteTemperature(Dimension):
    """Marks a temperature: degC and K have different zeros."""

    unit: str = "K"
    what: str = "a temperature"
    example: str = "37 degC"

    def read(self, value: object) -> float:
        """The value in K.

        Raises:
            PydanticCustomError: As `Dimension.read`; a difference of temperatures; below 0 K.
        """
        match = NUMBER.fullmatch(value) if isinstance(value, str) else None
        if match and match[2] in ("C", "F"):
            fail(f"{show(value)} is not {self.what}; did you mean '{match[1]} deg{match[2]}'?")
        if match and "delta" in match[2]:
            fail(f"{show(value)} is a difference of temperatures; expected one such as 37 degC")
        result = super().read(value)
        if result <= 0.0:
            fail(f"{show(value)} is not above absolute zero, -273.15 degC or 0 K")
        return result

    def write(self, value: float) -> str:
        """The value in degC where that reads back to the same float, else in K."""
        celsius = f"{round(value - 273.15, 9)!r} degC"
        return celsius if self.read(celsius) == value else super().write(value)


@dataclass(frozen=True)
class TemperatureDifference(Dimension):
    """Marks a difference of temperatures: 5 K, which is not 5 degC."""

    unit: str = "K"
    what: str = "a difference of temperatures"
    example: str = "5 K"

    def read(self, value: object) -> float:
        """The value in K.

        Raises:
            PydanticCustomError: As `Dimension.read`; a temperature.
        """
        result = super().read(value)
        match = NUMBER.fullmatch(str(value))
        if match and conversion(match[2], self.unit)[1] != 0:
            fail(f"{show(value)} is a temperature; expected {self.what} such as '{match[1]} K'")
        return result


@dataclass(frozen=True)
class Plain(_Bounded):
    """Marks a float or int field as dimensionless: a bare, finite number; not text, not a bool.

    Attributes:
        integer: Whether only whole numbers are allowed.
    """

    integer: bool = False

    def read(self, value: object) -> float | int:
        """The value unchanged (as a float unless `integer`).

        Raises:
            PydanticCustomError: Not a plain finite number, or out of bounds.
        """
        kind = "whole number" if self.integer else "number"
        if isinstance(value, bool) or not isinstance(value, int | float):
            unit = isinstance(value, str) and (m := NUMBER.fullmatch(value)) and m.group(2)
            extra = " (this value is dimensionless: no unit)" if unit else " without quotes or unit"
            fail(f"{show(value)} is not a {kind}; expected a plain {kind}{extra}")
        if not finite(value):
            fail(f"{show(value)} is not finite; expected a {kind}")
        if self.integer and value != int(value):
            fail(f"{value} is not a {kind}")
        if bound := self.violated(value):
            fail(f"{value} {bound}")
        return int(value) if self.integer else float(value)

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """A number with its bounds."""
        bounds = {
            "exclusiveMinimum": self.above,
            "minimum": self.at_least,
            "maximum": self.at_most,
            "exclusiveMaximum": self.below,
        }
        kind = {"type": "integer" if self.integer else "number"}
        return kind | {k: v for k, v in bounds.items() if v is not None}


_length = ("mm", "a length", "4 mm")
_stiffness = ("MPa/mm", "a stiffness per area", "100 MPa/mm")

Length = Annotated[float, Dimension(*_length)]
# Bound of lengths in a geometry, so that volumes do not overflow.
_longest = 1e10
PositiveLength = Annotated[float, Dimension(*_length, above=0.0, at_most=_longest)]
Angle = Annotated[float, Dimension("rad", "an angle", "1.5 deg")]
Stress = Annotated[float, Dimension("MPa", "a pressure", "2 MPa")]
Modulus = Annotated[float, Dimension("MPa", "a stress", "110 GPa", above=0.0)]
Stiffness = Annotated[float, Dimension(*_stiffness, at_least=0.0)]
PositiveStiffness = Annotated[float, Dimension(*_stiffness, above=0.0)]
FORCE = Dimension("N", "a force", "1800 N")
Newton = Annotated[float, FORCE]
_time = ("s", "a time", "600 s")
NonNegativeTime = Annotated[float, Dimension(*_time, at_least=0.0)]
PositiveTime = Annotated[float, Dimension(*_time, above=0.0)]

Temperature = Annotated[float, AbsoluteTemperature()]
PositiveDifference = Annotated[float, TemperatureDifference(above=0.0)]
# Each internal unit equals one in mm, N, s, K, tonne: 1 W/(m K) = 1 N/(s K).
Conductivity = Annotated[float, Dimension("W/(m*K)", "a conductivity", "0.2 W/(m K)", above=0.0)]
Density = Annotated[float, Dimension("tonne/mm^3", "a density", "1100 kg/m^3", above=0.0)]
SpecificHeat = Annotated[
    float, Dimension("mJ/(tonne*K)", "a specific heat", "1460 J/(kg K)", above=0.0)
]
ExpansionCoefficient = Annotated[
    float, Dimension("1/K", "an expansion per temperature", "80e-6 1/K")
]
HeatDensity = Annotated[
    float, Dimension("J/cm^3", "an energy per volume", "1.55e8 J/m^3", at_least=0.0)
]
_conductance = ("mW/(mm^2*K)", "a conductance per area", "300 W/(m^2 K)")
ConductancePerArea = Annotated[float, Dimension(*_conductance, at_least=0.0)]
FilmCoefficient = Annotated[float, Dimension(*_conductance, above=0.0)]
ConductancePerPressure = Annotated[
    float,
    Dimension(
        "mW/(mm^2*K*MPa)",
        "a conductance per area and pressure",
        "100 W/(m^2 K MPa)",
        above=0.0,
    ),
]
PositiveRate = Annotated[float, Dimension("1/s", "a rate", "0.002 1/s", above=0.0)]
ActivationEnergy = Annotated[
    float,
    Dimension("J/mol", "an energy per amount of substance", "62866 J/mol", at_least=0.0),
]

Number = Annotated[float, Plain()]
PositiveNumber = Annotated[float, Plain(above=0.0)]
NonNegativeNumber = Annotated[float, Plain(at_least=0.0)]
PositiveInteger = Annotated[int, Plain(integer=True, at_least=1)]
NonNegativeInteger = Annotated[int, Plain(integer=True, at_least=0)]

ForceVector = Annotated[tuple[Newton, Newton, Newton], Triple("[0 N, 0 N, -1800 N]")]
SizeVector = Annotated[
    tuple[PositiveLength, PositiveLength, PositiveLength], Triple("[10 mm, 10 mm, 5 mm]")
]


def _normalise(axis: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(axis):
        fail("is the zero vector; expected a direction")
    # Scaled first, so that neither huge nor tiny entries overflow.
    largest = max(abs(c) for c in axis)
    scaled = [c / largest for c in axis]
    length = math.hypot(*scaled)
    # A unit vector is kept as it is, so that a saved case reads back unchanged.
    if abs(largest * length - 1.0) < 1e-12:
        return axis
    x, y, z = (c / length for c in scaled)
    return x, y, z


Axis = Annotated[tuple[Number, Number, Number], Triple("[0, 0, 1]"), AfterValidator(_normalise)]
