"""Numbers and dimensional quantities as pydantic field types.

A dimensional value is text with a unit (``110 GPa``); after validation it is a float in the
internal system mm, N, MPa, s, K, tonne, rad. The conversion is done in rational arithmetic and
rounded once, so that ``0.11 TPa``, ``110 GPa`` and ``110000 MPa`` give the same float. Conversions
are pint's, kept on disk: pint with its registry takes 0.4 s to load, a tenth of a short run.

A field is declared by one of the aliases below, for example ``thickness: PositiveLength``.
"""

from __future__ import annotations

import json
import math
import operator
import re
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import lru_cache, partial
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, WithJsonSchema

from app.foundation.layout import alternatives
from app.schema.section import Scalar, Triple, did_you_mean, fail, show
from app.system import folders

NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*", re.DOTALL)
UNIT = re.compile(r"(1\s*/\s*)?[A-Za-zµμΩ°][\w*/^.()°· -]{0,40}")
# Powers of powers and huge exponents would be expensive.
TOWER = re.compile(r"\^[^A-Za-z]*\^|\d{3}")
KEPT = "conversions.json"
ANGLES = re.compile("radian|degree|arc|turn|grade")
# Longest number: huge exponents would be expensive.
LONGEST_NUMBER = 60
# Longest number with its unit; matching takes quadratic time.
LONGEST_VALUE = 200
# A value is unusual if it is so many times larger or smaller than the example of its key.
UNUSUAL_FACTOR = 1e3
# Usual moduli, from gel to diamond, and usual stresses [MPa].
MODULI = (5.0, 1.5e6)
STRESSES = (1e-2, 2e3)
# Usual lengths [mm].
LENGTHS = (1e-4, 2e3)
# Usual densities [tonne/mm^3], forces [N], angles [rad].
DENSITIES = (5e-11, 2.5e-8)
FORCES = (0.1, 1e5)
ANGLES_IN_USE = (1e-3, 6.3)
# Bounds above this only avoid overflow, and are left out of the manual.
HUGE = 1e9
# Largest number that is finite.
LARGEST = sys.float_info.max

# By attribute: what it asks of a value, in words, and in a JSON schema.
BOUNDS: dict[str, tuple[Callable[[float, float], bool], str, str]] = {
    "above": (operator.gt, "above", "exclusiveMinimum"),
    "at_least": (operator.ge, "at least", "minimum"),
    "at_most": (operator.le, "at most", "maximum"),
    "below": (operator.lt, "below", "exclusiveMaximum"),
}
SUGGESTIONS = (
    "GPa MPa kPa Pa mm um cm m nm N kN mN deg rad degC K s ms min hour N/mm N/mm^2 N/mm^3 MPa/mm "
    "kg tonne kg/m^3 W/m^2 W/m^3 J/m^3 J/mol 1/K 1/s"
).split()


def number_and_unit(value: object) -> tuple[float, str] | None:
    """Number and unit of a value such as ``4.0 mm`` or 0.3; None if it has no number."""
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        return None
    match = NUMBER.fullmatch(str(value))
    return (float(match[1]), match[2]) if match else None


@lru_cache(maxsize=1)
def registry() -> Any:
    """The unit registry of pint, in rational arithmetic."""
    import pint

    return pint.UnitRegistry(non_int_type=Fraction, autoconvert_offset_to_baseunit=True)


@lru_cache(maxsize=256)
def conversion(unit: str, internal: str) -> tuple[Fraction, Fraction]:
    """Slope and offset of the map from a unit to the internal unit of the same dimension.

    Raises:
        LookupError: The unit is unknown.
        ValueError: It has another dimension.
    """
    unit_text = unit.replace("**", "^").replace("·", "*").replace("μ", "µ")
    if not UNIT.fullmatch(unit_text) or TOWER.search(unit_text):
        raise LookupError(unit)
    key, kept_conversions = f"{unit_text} in {internal}", _kept()
    try:
        slope, offset = map(Fraction, kept_conversions[key])
    except (KeyError, TypeError, ValueError, ArithmeticError):
        slope, offset = _by_pint(unit, unit_text, internal)
        kept_conversions[key] = [str(slope), str(offset)]
        # Of concurrent additions one may be lost.
        folder = folders.cache("units")
        if folder is not None:
            with suppress(OSError):
                folders.write_json(folder / KEPT, kept_conversions)
    return slope, offset


@lru_cache(maxsize=1)
def _kept() -> dict[str, list[str]]:
    """Conversions in the cache on disk."""
    folder = folders.cache("units")
    if folder is None:
        return {}
    try:
        conversions = json.loads((folder / KEPT).read_text())
    except (OSError, ValueError, RecursionError):
        return {}
    return conversions if isinstance(conversions, dict) else {}


def _by_pint(unit: str, text: str, internal: str) -> tuple[Fraction, Fraction]:
    ureg = registry()
    try:
        source = ureg.parse_units(text)
    except Exception as error:  # pint raises a different class for each way of being malformed
        raise LookupError(unit) from error
    target = ureg.parse_units(internal)
    # Angles and plain numbers have the same dimension for pint, but "5 %" is not an angle.
    # `_units`, because pint cannot print rational powers (Python 3.13).
    is_plain = source.dimensionless and not ANGLES.search(" ".join(source._units))
    if source.dimensionality != target.dimensionality or (is_plain and "radian" in target._units):
        raise ValueError(unit)
    offset = Fraction(ureg.Quantity(Fraction(0), source).to(target).magnitude)
    return Fraction(ureg.Quantity(Fraction(1), source).to(target).magnitude) - offset, offset


def bounds_in_words(schema: dict[str, Any]) -> str:
    """Bounds of a JSON schema; those that only avoid overflow are left out."""
    bound_texts = [
        f"{w} {schema[n]:g}" for _, w, n in BOUNDS.values() if schema.get(n, HUGE) < HUGE
    ]
    return f", {' and '.join(bound_texts)}" if bound_texts else ""


@dataclass(frozen=True, kw_only=True)
class _Bounded(Scalar):
    """Marks a number by its bounds, and by a sentence on a number beyond them."""

    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    below: float | None = None
    beyond: str = ""

    @property
    def bounds(self) -> dict[str, float]:
        """Bounds by their name in a JSON schema."""
        bounds = {name: getattr(self, key) for key, (_, _, name) in BOUNDS.items()}
        return {name: bound for name, bound in bounds.items() if bound is not None}

    def check(self, value: float, shown: str, unit: str = "") -> None:
        """Refuse a value beyond a bound.

        Raises:
            PydanticCustomError: It is beyond one.
        """
        for key, (holds, relation, _) in BOUNDS.items():
            bound = getattr(self, key)
            if bound is not None and not holds(value, bound):
                signs = {"above": "must be positive", "at_least": "must not be negative"}
                message = f"must be {relation} {bound:g} {unit}".rstrip()
                remark = f"; {self.beyond}" if self.beyond else ""
                fail(f"{shown} {message if bound else signs.get(key, message)}{remark}")


@dataclass(frozen=True)
class Dimension(_Bounded):
    """Marks a float field as dimensional: read from text with a unit, kept in the internal unit.

    Attributes:
        unit: Internal unit.
        what: Dimension in words, with its article.
        example: Value as written in a file.
        offset: True if a unit may have another zero: degC of a temperature, not of a difference.
        usual: Smallest and largest usual size of a value, in the internal unit; by default 1/1000
            and 1000 of the example.
        other_units: Units that a number without a unit may have, if not that of the example.
    """

    unit: str
    what: str
    example: str
    offset: bool = True
    usual: tuple[float, float] | None = field(default=None, kw_only=True)
    other_units: tuple[str, ...] = field(default=(), kw_only=True)

    def read(self, value: object) -> float:
        """The value in the internal unit.

        Raises:
            PydanticCustomError: Not a number with a unit of this dimension, not finite, out of
                bounds.
        """
        shown_value, expected_text = show(value), f"{self.what} such as '{self.example}'"
        value_text = value if isinstance(value, str) else shown_value
        match = NUMBER.fullmatch(value_text) if len(value_text) <= LONGEST_VALUE else None
        if match is None:
            fail(f"{shown_value} is not {expected_text}")
        if re.match(r"\s*[+-]?\d+,\d", value_text):
            fail(
                f"{shown_value} has a comma; write decimals with a point, as '6.5 mm', "
                "and thousands without a separator"
            )
        number, unit = match.groups()
        if not unit:
            fail(f"{shown_value} needs a unit, e.g. {self._with_a_unit(number)}")
        try:
            slope, offset = conversion(unit, self.unit)
        except LookupError:
            hint = did_you_mean(unit, SUGGESTIONS)
            fail(f"{shown_value}: '{unit}' is not a unit; expected {expected_text}{hint}")
        except ValueError:
            fail(f"{shown_value} is not {expected_text}")
        if offset and not self.offset:
            fail(
                f"{shown_value} is a temperature; expected {self.what} such as '{number}"
                f" {self.unit}'"
            )
        if len(number) > LONGEST_NUMBER or not math.isfinite(float(number)):
            fail(f"{shown_value} is not finite; expected {expected_text}")
        # A number that underflows is zero; as a fraction it could take gigabytes.
        exact = Fraction(number) if float(number) != 0.0 else Fraction(0)
        try:
            result = float(exact * slope + offset)
        except OverflowError:
            fail(f"{shown_value} is not finite in {self.unit}")
        self.check(result, shown_value, self.unit)
        return result

    def _with_a_unit(self, number: str) -> str:
        """Return a number with each unit in which its size is usual; without any, the example."""
        example_number, unit_of_example = self.example.split(maxsplit=1)
        if float(number) == 0.0:
            return f"'{number} {unit_of_example}'"
        size = abs(self._internal(example_number, unit_of_example))
        lowest, highest = self.usual or (size / UNUSUAL_FACTOR, size * UNUSUAL_FACTOR)
        choices = [
            f"'{number} {unit}'"
            for unit in (unit_of_example, *self.other_units)
            if lowest <= abs(self._internal(number, unit)) <= highest
        ]
        return alternatives(choices or [f"'{self.example}'"])

    def _internal(self, number: str, unit: str) -> float:
        """Return a number with a unit in the internal unit; sizes alone, without bounds."""
        slope, offset = conversion(unit, self.unit)
        return float(number) * float(slope) + float(offset)

    def write(self, value: float) -> str:
        """The value as text that reads back to the same float."""
        if self.unit == "rad":
            degrees = f"{round(math.degrees(value), 9)!r} deg"
            if self.read(degrees) == value:
                return degrees
        return f"{value!r} {self.unit}"

    def __get_pydantic_json_schema__(self, *_: object) -> dict[str, object]:
        """Text that starts with a number and ends with a unit."""
        return {
            "type": "string",
            "pattern": r"^\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*(1\s*/\s*)?[A-Za-zµμ°].*$",
            "description": f"{self.what} with a unit (kept in {self.unit})",
            "examples": [self.example],
            "x-value": self.in_words,
            "x-unit": self.unit,
        }

    @property
    def in_words(self) -> str:
        """The values that it allows, in Markdown."""
        what = self.what.removeprefix("a ").removeprefix("an ")
        return f"{what}{bounds_in_words(self.bounds)}, e.g. `{self.example}`"


@dataclass(frozen=True)
class AbsoluteTemperature(Dimension):
    """Marks a temperature: degC and K have different zeros."""

    unit: str = "K"
    what: str = "a temperature"
    example: str = "37 degC"
    # From dry ice to the oven [K].
    usual: tuple[float, float] | None = field(default=(194.0, 500.0), kw_only=True)
    other_units: tuple[str, ...] = field(default=("K",), kw_only=True)

    def read(self, value: object) -> float:
        """The value in K.

        Raises:
            PydanticCustomError: As `Dimension.read`; a difference of temperatures; below 0 K.
        """
        if isinstance(value, str) and "delta" in value:
            message = "is a difference of temperatures; expected a temperature such as 37 degC"
            fail(f"{show(value)} {message}")
        temperature = super().read(value)
        if temperature <= 0.0:
            fail(f"{show(value)} is not above absolute zero, -273.15 degC or 0 K")
        return temperature

    def write(self, value: float) -> str:
        """The value in degC where that reads back to the same float, else in K."""
        celsius = f"{round(value - 273.15, 9)!r} degC"
        return celsius if self.read(celsius) == value else super().write(value)


@dataclass(frozen=True)
class Part(Dimension):
    """Marks a share: a bare number from 0 to 1, or per cent."""

    unit: str = "-"
    what: str = "a share"
    example: str = "7.7 %"
    at_least: float | None = field(default=0.0, kw_only=True)
    at_most: float | None = field(default=1.0, kw_only=True)

    def read(self, value: object) -> float:
        """The share.

        Raises:
            PydanticCustomError: Not a number, or not from 0 to 1.
        """
        fraction = _part(value)
        match = NUMBER.fullmatch(fraction) if isinstance(fraction, str) else None
        if isinstance(fraction, bool) or not (isinstance(fraction, int | float) or match):
            fail(f"{show(value)} is not {self.what} such as '{self.example}'")
        if match and match[2]:
            fail(f"{show(value)}: a share has no unit except %")
        number = float(match[1]) if match else float(fraction)  # type: ignore[arg-type]
        self.check(number, show(value))
        return number

    def write(self, value: float) -> str:
        """The share as a bare number."""
        return repr(value)


@dataclass(frozen=True)
class Plain(_Bounded):
    """Marks a float or int field without a unit in the file: a finite number; not text, not a bool.

    Attributes:
        integer: True for whole numbers.
        unit: Unit that the number has without being written, as in the axes of another file.
    """

    integer: bool = False
    unit: str = ""

    def read(self, value: object) -> float | int:
        """The value unchanged (as a float unless `integer`).

        Raises:
            PydanticCustomError: Not a plain finite number, or out of bounds.
        """
        kind = "whole number" if self.integer else "number"
        if isinstance(value, bool) or not isinstance(value, int | float):
            match = NUMBER.fullmatch(value) if isinstance(value, str) else None
            extra = " without quotes or unit"
            if self.unit:
                extra = f" in {self.unit}, without quotes or unit"
            elif match and match[2]:
                extra = " (this value is dimensionless: no unit)"
            fail(f"{show(value)} is not a {kind}; expected a plain {kind}{extra}")
        if not abs(value) <= LARGEST:
            fail(f"{show(value)} is not finite; expected a {kind}")
        if self.integer and value != int(value):
            fail(f"{value} is not a {kind}")
        self.check(value, str(value))
        return int(value) if self.integer else float(value)

    def __get_pydantic_json_schema__(self, *_: object) -> dict[str, object]:
        """A number with its bounds."""
        kind: dict[str, object] = {"type": "integer" if self.integer else "number"}
        return kind | self.bounds


_EITHER = WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string"}]})  # 0.05 or 5 %


def _part(value: object) -> object:
    match = NUMBER.fullmatch(value) if isinstance(value, str) else None
    return float(Fraction(match[1]) / 100) if match and match[2] == "%" else value


_length = partial(Dimension, "mm", "a length", "4 mm", usual=LENGTHS)
_difference = partial(Dimension, "K", "a difference of temperatures", "5 K", offset=False)
_time = partial(Dimension, "s", "a time", "600 s")
_stiffness = partial(Dimension, "MPa/mm", "a stiffness per area", "100 MPa/mm")
# Each internal unit of heat equals one in mm, N, s, K, tonne: 1 W/(m K) = 1 N/(s K).
_conductance = partial(Dimension, "mW/(mm^2*K)", "a conductance per area", "300 W/(m^2 K)")
_specific_heat = Dimension("mJ/(tonne*K)", "a specific heat", "1460 J/(kg K)", above=0.0)
_expansion = Dimension("1/K", "an expansion per temperature", "80e-6 1/K")
_heat = Dimension("J/cm^3", "an energy per volume", "1.55e8 J/m^3", at_least=0.0)
_per_pressure = partial(Dimension, "mW/(mm^2*K*MPa)", "a conductance per area and pressure")
_per_amount = partial(Dimension, "J/mol", "an energy per amount of substance", "62866 J/mol")
_force = partial(Dimension, "N", "a force", usual=FORCES)
_stress = partial(Dimension, "MPa", "a stress", usual=STRESSES, other_units=("Pa",))
_modulus = partial(Dimension, "MPa", "a stress", usual=MODULI, other_units=("MPa", "Pa"))
FORCE = _force("1800 N")
WEIGHT = _force("750 N", above=0.0)
ANGLE = Dimension("rad", "an angle", "1.5 deg", usual=ANGLES_IN_USE)

Length = Annotated[float, _length()]
# The bound keeps volumes from overflow.
PositiveLength = Annotated[float, _length(above=0.0, at_most=1e10)]
Angle = Annotated[float, ANGLE]
PositiveAngle = Annotated[float, replace(ANGLE, example="5 deg", above=0.0)]
Stress = Annotated[float, replace(_stress("2 MPa"), what="a pressure")]
PositiveStress = Annotated[float, _stress("2 MPa", above=0.0)]
Modulus = Annotated[float, _modulus("110 GPa", above=0.0)]
Stiffness = Annotated[float, _stiffness(at_least=0.0)]
PositiveStiffness = Annotated[float, _stiffness(above=0.0)]
Newton = Annotated[float, FORCE]
NonNegativeTime = Annotated[float, _time(at_least=0.0)]
PositiveTime = Annotated[float, _time(above=0.0)]

Temperature = Annotated[float, AbsoluteTemperature()]
PositiveDifference = Annotated[float, _difference(above=0.0)]
Conductivity = Annotated[float, Dimension("W/(m*K)", "a conductivity", "0.2 W/(m K)", above=0.0)]
_density = partial(Dimension, usual=DENSITIES, other_units=("g/cm^3",))
Density = Annotated[float, _density("tonne/mm^3", "a density", "1100 kg/m^3", above=0.0)]
SpecificHeat = Annotated[float, _specific_heat]
ExpansionCoefficient = Annotated[float, _expansion]
HeatDensity = Annotated[float, _heat]
FractureEnergy = Annotated[float, Dimension("N*mm", "an energy", "0.5 N mm", above=0.0)]
ConductancePerArea = Annotated[float, _conductance(at_least=0.0)]
FilmCoefficient = Annotated[float, _conductance(above=0.0)]
ConductancePerPressure = Annotated[float, _per_pressure("100 W/(m^2 K MPa)", above=0.0)]
PositiveRate = Annotated[float, Dimension("1/s", "a rate", "0.002 1/s", above=0.0)]
ActivationEnergy = Annotated[float, _per_amount(at_least=0.0)]

Number = Annotated[float, Plain()]
PositiveNumber = Annotated[float, Plain(above=0.0)]
NonNegativeNumber = Annotated[float, Plain(at_least=0.0)]
MixingExponent = Annotated[float, Plain(at_least=1.0)]
Share = Annotated[float, Plain(at_least=0.0, at_most=1.0)]
PositivePart = Annotated[float, Plain(above=0.0, at_most=1.0), BeforeValidator(_part), _EITHER]
PositiveInteger = Annotated[int, Plain(integer=True, at_least=1)]
NonNegativeInteger = Annotated[int, Plain(integer=True, at_least=0)]

ForceVector = Annotated[tuple[Newton, Newton, Newton], Triple("[0 N, 0 N, -1800 N]")]
SizeVector = Annotated[
    tuple[PositiveLength, PositiveLength, PositiveLength], Triple("[10 mm, 10 mm, 5 mm]")
]


def _normalise(axis: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(axis):
        fail("is the zero vector; expected a direction")
    # A unit vector is kept as it is, so that a saved case reads back unchanged.
    if abs(math.hypot(*axis) - 1.0) < 1e-12:
        return axis
    # Scaled first, so that neither huge nor tiny entries overflow.
    x, y, z = (c / max(map(abs, axis)) for c in axis)
    length = math.hypot(x, y, z)
    return x / length, y / length, z / length


Axis = Annotated[tuple[Number, Number, Number], Triple("[0, 0, 1]"), AfterValidator(_normalise)]
