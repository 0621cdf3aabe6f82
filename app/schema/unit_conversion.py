"""Conversions between units by pint, in rational arithmetic, cached on disk.

pint takes 0.2 s to load, a tenth of a short run: it is loaded for new units only.
"""

from __future__ import annotations

import json
import re
from contextlib import suppress
from fractions import Fraction
from functools import lru_cache
from typing import Any

from app.system import folders

UNIT = re.compile(r"(1\s*/\s*)?[A-Za-zµμΩ°][\w*/^.()°· -]{0,40}")
# Powers of powers and huge exponents would be expensive.
TOWER = re.compile(r"\^[^A-Za-z]*\^|\d{3}")
KEPT = "conversions.json"
ANGLES = re.compile("radian|degree|arc|turn|grade")


@lru_cache(maxsize=1)
def registry() -> Any:
    """The unit registry: pint's own units, in rational arithmetic."""
    import pint

    return pint.UnitRegistry(non_int_type=Fraction, autoconvert_offset_to_baseunit=True)


@lru_cache(maxsize=256)
def conversion(unit: str, internal: str) -> tuple[Fraction, Fraction]:
    """Slope and offset of the map from a unit to the internal unit of the same dimension.

    Raises:
        LookupError: The unit is unknown.
        ValueError: It has another dimension.
    """
    text = unit.replace("**", "^").replace("·", "*").replace("μ", "µ")
    if not UNIT.fullmatch(text) or TOWER.search(text):
        raise LookupError(unit)
    key, kept = f"{text} in {internal}", _kept()
    try:
        slope, offset = map(Fraction, kept[key])
    except (KeyError, TypeError, ValueError, ArithmeticError):
        slope, offset = _by_pint(unit, text, internal)
        kept[key] = [str(slope), str(offset)]
        # Of concurrent additions one may be lost.
        with suppress(OSError):
            if folder := folders.cache("units"):
                folders.write_json(folder / KEPT, kept)
    return slope, offset


@lru_cache(maxsize=1)
def _kept() -> dict[str, list[str]]:
    """Conversions in the cache on disk."""
    with suppress(OSError, ValueError, RecursionError):
        if folder := folders.cache("units"):
            found = json.loads((folder / KEPT).read_text())
            return found if isinstance(found, dict) else {}
    return {}


def _by_pint(unit: str, text: str, internal: str) -> tuple[Fraction, Fraction]:
    ureg = registry()
    try:
        source = ureg.parse_units(text)
    except Exception as error:  # pint raises a different class for each way of being malformed
        raise LookupError(unit) from error
    target = ureg.parse_units(internal)
    # Angles and plain numbers have the same dimension for pint, but "5 %" is not an angle.
    # `_units`, because pint cannot print rational powers (Python 3.13).
    plain = source.dimensionless and not ANGLES.search(" ".join(source._units))
    if source.dimensionality != target.dimensionality or (plain and "radian" in target._units):
        raise ValueError(unit)
    offset = Fraction(ureg.Quantity(Fraction(0), source).to(target).magnitude)
    return Fraction(ureg.Quantity(Fraction(1), source).to(target).magnitude) - offset, offset
