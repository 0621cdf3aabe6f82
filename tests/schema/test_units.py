"""Units: conversion, and arbitrary texts."""

from __future__ import annotations

import math
from fractions import Fraction
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from app.schema import units
from app.schema.units import Angle, Length, Stiffness, Temperature

finite = st.floats(allow_nan=False, allow_infinity=False, width=64)
FACTORS = {"mm": 1, "um": Fraction(1, 1000), "m": 1000, "inch": Fraction("25.4")}
units_at_random = st.from_regex(r"-?[0-9]{1,3} [a-zµ°*/^() 0-9.-]{0,15}", fullmatch=True)
kelvin = st.floats(1e-3, 1e4).map(lambda v: f"{v!r} K")
celsius = st.floats(-273.0, 1e4).map(lambda v: f"{v!r} degC")
angles = st.floats(-math.pi, math.pi).map(lambda v: f"{v!r} rad")


@given(finite, st.sampled_from(sorted(FACTORS)), st.sampled_from(["", " ", "\t"]))
def test_units_conversion_is_rounded_once(value: float, unit: str, space: str) -> None:
    """The result is the float nearest to the exact product of the written number."""
    text = f"{value!r}{space}{unit}"
    exact = Fraction(repr(value)) * FACTORS[unit]
    try:
        expected = float(exact)
    except OverflowError:
        with pytest.raises(ValidationError, match="not finite"):
            TypeAdapter(Length).validate_python(text)
        return
    adapter = TypeAdapter(Length)
    assert adapter.validate_python(text) == expected
    assert adapter.validate_python(adapter.dump_python(expected, mode="json")) == expected


@given(st.integers(1, 10**6), st.integers(-9, 9))
def test_units_do_not_change_the_value(number: int, power: int) -> None:
    read = TypeAdapter(Stiffness).validate_python
    results = {
        read(f"{number}e{power} MPa/mm"),
        read(f"{number}e{power + 6} Pa/mm"),
        read(f"{number}e{power - 3} GPa/mm"),
        read(f"{number}e{power} N/mm^3"),
        read(f"{number}e{power} N/mm**2/mm"),
        read(f"{number}e{power + 9} N m^-3"),
    }
    assert len(results) == 1


@pytest.mark.parametrize(
    ("kind", "number", "hint"),
    [
        (units.Modulus, "110000", "'110000 MPa'"),
        (units.Modulus, "110", "'110 GPa' or '110 MPa'"),
        (units.Modulus, "2.2", "'2.2 GPa'"),
        (units.Modulus, "1.1e11", "'1.1e11 Pa'"),
        (units.Modulus, "1e-4", "'110 GPa'"),
        (units.PositiveStress, "2e6", "'2e6 Pa'"),
        (units.Density, "4.43", "'4.43 g/cm^3'"),
        (units.Density, "1190", "'1190 kg/m^3'"),
        (Temperature, "310", "'310 K'"),
        (Temperature, "37", "'37 degC'"),
        (units.ExpansionCoefficient, "80", "'80e-6 1/K'"),
        (units.PositiveDifference, "0", "'0 K'"),
        (Length, "147", "'147 mm'"),
    ],
)
def test_units_hint_gives_a_unit_in_which_the_number_is_usual(
    kind: object, number: str, hint: str
) -> None:
    with pytest.raises(ValidationError) as refused:
        TypeAdapter(kind).validate_python(number)
    (error,) = refused.value.errors()
    assert error["msg"] == f"'{number}' needs a unit, e.g. {hint}"


@given(st.text(max_size=30) | units_at_random)
def test_units_any_text_is_a_length_or_an_error(text: str) -> None:
    try:
        assert math.isfinite(TypeAdapter(Length).validate_python(text))
    except ValidationError as error:
        assert [e["type"] for e in error.errors()] == ["mantle"]


@given(kelvin | celsius | angles)
def test_units_temperatures_and_angles_survive_writing(text: str) -> None:
    adapter: TypeAdapter[float] = TypeAdapter(Angle if text.endswith("rad") else Temperature)
    try:
        value = adapter.validate_python(text)
    except ValidationError:
        assert float(text.split()[0]) + 273.15 * text.endswith("degC") <= 1e-12
        return
    assert adapter.validate_python(adapter.dump_python(value, mode="json")) == value


def test_units_conversion_is_cached(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def forget() -> None:
        units.conversion.cache_clear()
        units._kept.cache_clear()

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    forget()
    name = "kN/inch^2"
    factors = units.conversion(name, "MPa")
    assert factors[0] == Fraction(1000) / Fraction("25.4") ** 2
    forget()
    with monkeypatch.context() as without:
        without.setattr(units, "registry", lambda: pytest.fail("asked again"))
        assert units.conversion(name, "MPa") == factors
    kept = tmp_path / "mantle/units/conversions.json"
    for text in ("{broken", "[]", "\0", *(f'{{"{name} in MPa": {v}}}' for v in (1, '["x"]'))):
        kept.write_text(text)
        forget()
        assert units.conversion(name, "MPa") == factors
    forget()
