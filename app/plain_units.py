"""Units that cases are commonly written in, converted without pint, whose registry takes a second.

A unit is a product of known symbols with whole powers: ``W/(m^2 K)``, ``kg/m^3``, ``1/K``. What is
not understood here is left to pint (`app.units`); what is, means exactly what pint says.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

# Digits of pi that pint has.
PI = Fraction("3.1415926535897932384626433832795028841971693993751")


@dataclass(frozen=True)
class Unit:
    """A unit in terms of mm, tonne, s, K, mol and rad.

    Attributes:
        factor: How many of those it is.
        dimensions: Exponents of length, mass, time, temperature, amount and angle.
    """

    factor: Fraction
    dimensions: tuple[int, ...]

    def times(self, other: Unit, power: int) -> Unit:
        """The product with a power of another unit."""
        exponents = zip(self.dimensions, other.dimensions, strict=True)
        return Unit(self.factor * other.factor**power, tuple(a + power * b for a, b in exponents))


def _unit(factor: str | Fraction, *dimensions: int) -> Unit:
    return Unit(Fraction(factor), (*dimensions, *[0] * (6 - len(dimensions))))


ONE = _unit("1")
SYMBOLS = {
    **{f"{p}m": _unit(f, 1) for p, f in (("", "1e3"), ("c", "10"), ("m", "1"), ("n", "1e-6"))},
    **{f"{p}m": _unit("1e-3", 1) for p in ("u", "µ")},
    **{"g": _unit("1e-6", 0, 1), "kg": _unit("1e-3", 0, 1), "tonne": _unit("1", 0, 1)},
    **{f"{p}s": _unit(f, 0, 0, 1) for p, f in (("", "1"), ("m", "1e-3"))},
    **{name: _unit("60", 0, 0, 1) for name in ("min", "minute", "minutes")},
    **{name: _unit("3600", 0, 0, 1) for name in ("h", "hour", "hours")},
    **{f"{p}N": _unit(f, 1, 1, -2) for p, f in (("", "1"), ("k", "1e3"), ("m", "1e-3"))},
    **{
        f"{p}Pa": _unit(f, -1, 1, -2)
        for p, f in (("", "1e-6"), ("k", "1e-3"), ("M", "1"), ("G", "1e3"))
    },
    **{f"{p}J": _unit(f, 2, 1, -2) for p, f in (("", "1e3"), ("k", "1e6"), ("m", "1"))},
    **{f"{p}W": _unit(f, 2, 1, -3) for p, f in (("", "1e3"), ("k", "1e6"), ("m", "1"))},
    **{"K": _unit("1", 0, 0, 0, 1), "mol": _unit("1", 0, 0, 0, 0, 1)},
    **{"rad": _unit("1", 0, 0, 0, 0, 0, 1), "deg": _unit(PI / 180, 0, 0, 0, 0, 0, 1)},
}
FACTOR = re.compile(r"([A-Za-zµ]+|1)(?:\^(-?[1-9]))?")


def convert(unit: str, internal: str) -> tuple[Fraction, Fraction] | None:
    """Slope and offset of the map from a unit to another, as `app.units.conversion`.

    Returns:
        None where the unit is not understood or measures something else.
    """
    if (unit, internal) == ("degC", "K"):
        return Fraction(1), Fraction("273.15")
    source, target = parse(unit), parse(internal)
    if source is None or target is None or source.dimensions != target.dimensions:
        return None
    return source.factor / target.factor, Fraction(0)


@lru_cache(maxsize=256)
def parse(text: str) -> Unit | None:
    """A unit from factors between ``*``, ``/`` or spaces; the last ``/`` may have parentheses."""
    head, slash, tail = text.partition("/(")
    if slash:
        above, below = _product(head), _product(tail[:-1])
        if above is None or below is None or not tail.endswith(")") or "/" in tail:
            return None
        return above.times(below, -1)
    return _product(text)


def _product(text: str) -> Unit | None:
    product = ONE
    words = re.split(r"\s*([*/])\s*|\s+", text.strip())
    for operator, word in zip(["*", *words[1::2]], words[::2], strict=True):
        match = FACTOR.fullmatch(word)
        if match is None or match[1] not in {*SYMBOLS, "1"}:
            return None
        power = int(match[2] or 1)
        product = product.times(SYMBOLS.get(match[1], ONE), -power if operator == "/" else power)
    return product
