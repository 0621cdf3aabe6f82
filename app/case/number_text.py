"""Numbers of results as text: their units as printed, and their errors."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import reduce

from app.foundation.layout import two_digits

# Dimension of each unit in summary.json, with its article.
UNITS = {
    "mm": "a length",
    "mm^2": "an area",
    "mm^3": "a volume",
    "N": "a force",
    "MPa": "a stress",
    "N mm": "an energy",
    "deg": "an angle",
    "s": "a time",
    "degC": "a temperature",
    "K": "a temperature difference",
    "W": "a power",
    "W/m^2": "a heat flux",
    "W/(m^2 K)": "an entropy production",
    "min": "a thermal dose",
    "1/year": "an annual rate",
    "1/s": "a rate",
    "-": "a number",
}
# Units of tables in terms of those of summary.json, and as printed.
FACTOR_OF_UNIT = {"um": 1e3, "%": 100.0, "um/m": 1e6}
PRINTED = {"um": "µm", "degC": "°C", "deg": "°", "^2": "²", "^3": "³"}
# Mark of a number whose error exceeds it.
NOT_RESOLVED = " (not resolved)"


def printed(unit: str) -> str:
    """A unit as printed: µm, °C, mm²; empty for a plain number."""
    signs = PRINTED.items()
    return reduce(lambda text, sign: text.replace(*sign), signs, unit.removesuffix("-"))


def in_print(text: str) -> str:
    """Text with the units behind its numbers, or in brackets, as printed."""
    return re.sub(r"(?:(?<=\d )|(?<=\())(um|degC|deg|mm\^[23])\b", lambda m: printed(m[0]), text)


def with_brackets(label: str, unit: str) -> str:
    """A label with its printed unit in brackets; a plain number has none."""
    return f"{label} ({unit})" if unit else label


@dataclass(frozen=True)
class Number:
    """A number with its estimated error by mesh and steps.

    Attributes:
        value: The number.
        error: Its error in the same unit; None if it was not estimated.
    """

    value: float
    error: float | None = None

    def __str__(self) -> str:
        """Format to the second digit of the error; without error, to four digits."""
        if self.error is None or self.error <= 0:
            return f"{self.value:.4g}"
        if self.error >= abs(self.value):
            return f"{two_digits(self.value)} ± {two_digits(self.error)}"
        places = max(0, 1 - math.floor(math.log10(self.error)))
        if places > 5:
            return f"{self.value:.6g} ± {self.error:.1g}"
        return f"{self.value:.{places}f} ± {self.error:.{places}f}"

    def text(self, rounding: float) -> str:
        """The number; 0 if it is far below a difference that counts as rounding."""
        return "0" if abs(self.value) < 0.01 * rounding else str(self)

    @property
    def marked(self) -> str:
        """The number, with a mark if its error exceeds it, as tables have it."""
        is_lost = self.error is not None and self.error > abs(self.value)
        return f"{self}{NOT_RESOLVED if is_lost else ''}"
