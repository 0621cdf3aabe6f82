"""Conversions between units: by pint, in rational arithmetic, and kept for the next start."""

from __future__ import annotations

import fcntl
import json
import re
from contextlib import suppress
from fractions import Fraction
from functools import lru_cache
from typing import Any

from app import files
from app.errors import MantleError
from app.system import folders

UNIT = re.compile(r"(1\s*/\s*)?[A-Za-zµμΩ°][\w*/^.()°· -]{0,40}")
# Powers of powers would cost more than they can mean.
TOWER = re.compile(r"\^[^A-Za-z]*\^|\d{3}")
# File of conversions.
KEPT = "conversions.json"

# Exponents of length, mass, time, temperature.
DIMENSIONS = {
    (1, 0, 0, 0): "a length",
    (2, 0, 0, 0): "an area",
    (3, 0, 0, 0): "a volume",
    (0, 1, 0, 0): "a mass",
    (0, 0, 1, 0): "a time",
    (0, 0, 0, 1): "a temperature",
    (1, 1, -2, 0): "a force",
    (0, 1, -2, 0): "a force per length",
    (-1, 1, -2, 0): "a stress",
    (-2, 1, -2, 0): "a stiffness per area",
    (2, 1, -2, 0): "a moment or an energy",
    (-3, 1, 0, 0): "a mass per volume",
    (0, 0, -1, 0): "a rate",
    (0, 0, 0, -1): "an expansion per temperature",
    (1, 1, -3, -1): "a conductivity",
    (2, 0, -2, -1): "a specific heat",
    (2, 0, -2, 0): "an energy per mass",
    (2, 1, -3, 0): "a power",
    (0, 1, -3, 0): "a power per area",
    (-1, 1, -3, 0): "a power per volume",
    (0, 1, -3, -1): "a conductance per area",
    (1, 0, -1, -1): "a conductance per area and pressure",
}


@lru_cache(maxsize=1)
def registry() -> Any:
    """The unit registry: pint's own units, in rational arithmetic."""
    import pint  # a second with the registry: only for a unit that was never met before

    return pint.UnitRegistry(non_int_type=Fraction, autoconvert_offset_to_baseunit=True)


@lru_cache(maxsize=256)
def conversion(unit: str, internal: str) -> tuple[Fraction, Fraction]:
    """Slope and offset of the map from a unit to the internal unit of the same dimension.

    Raises:
        LookupError: The unit is unknown.
        ValueError: It measures something else; the argument names what.
    """
    text = unit.replace("**", "^").replace("·", "*").replace("μ", "µ")
    if not UNIT.fullmatch(text) or TOWER.search(text):
        raise LookupError(unit)
    key = f"{text} in {internal}"
    if (known := _known(_kept().get(key))) is None:
        _keep(key, known := _by_pint(unit, text, internal))
    return known


def _known(entry: object) -> tuple[Fraction, Fraction] | None:
    """A conversion as the cache has it; None if it has none, or something else."""
    try:
        slope, offset = map(Fraction, entry)  # type: ignore[call-overload]
    except (TypeError, ValueError, ArithmeticError):
        return None
    return slope, offset


@lru_cache(maxsize=1)
def _kept() -> dict[str, list[str]]:
    """Conversions that pint has made before, in the cache."""
    found: dict[str, list[str]] = {}
    with suppress(OSError, ValueError, TypeError, RecursionError):
        if folder := folders.cache("units"):
            found |= json.loads((folder / KEPT).read_text())
    return found


def _keep(key: str, conversion: tuple[Fraction, Fraction]) -> None:
    """Add a conversion to those that are in the cache by now, if there is one."""
    with suppress(OSError, MantleError):
        if folder := folders.cache("units"):
            with open(files.lock_file(folder / "lock"), "w") as lock:
                fcntl.flock(lock, fcntl.LOCK_EX)
                files.clear(folder)
                _kept.cache_clear()
                _kept()[key] = [str(number) for number in conversion]
                folders.write_json(folder / KEPT, _kept())


def _by_pint(unit: str, text: str, internal: str) -> tuple[Fraction, Fraction]:
    """Slope and offset as pint finds them."""
    ureg = registry()
    try:
        source = ureg.parse_units(text)
    except Exception as error:  # pint raises a different class for each way of being malformed
        raise LookupError(unit) from error
    target = ureg.parse_units(internal)
    # Angles and plain numbers have the same dimension for pint, but "5 %" is not an angle.
    angles = "radian|degree|arc|turn|grade"
    angle = "radian" in _names(target) and not re.search(angles, _names(source))
    if source.dimensionality != target.dimensionality or angle:
        raise ValueError(_dimension(source))
    offset = Fraction(ureg.Quantity(Fraction(0), source).to(target).magnitude)
    return Fraction(ureg.Quantity(Fraction(1), source).to(target).magnitude) - offset, offset


def _names(unit: Any) -> str:
    """The names in a unit; pint cannot print powers in rational arithmetic (Python 3.13)."""
    return " ".join(unit._units)


def _dimension(unit: Any) -> str:
    """Physical quantity of a unit, in words."""
    if unit.dimensionless:
        return "an angle" if re.search("radian|degree|arc|turn", _names(unit)) else "a plain number"
    exponents = dict(unit.dimensionality)
    base = ("[length]", "[mass]", "[time]", "[temperature]")
    known = DIMENSIONS.get(tuple(exponents.pop(name, 0) for name in base))
    if known and exponents == {"[substance]": -1}:
        return f"{known} per amount of substance"
    return known if known and not exponents else "something else"
