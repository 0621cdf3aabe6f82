"""Reading of the numbers of a summary: each table of an owner, main numbers, one by its name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import reduce
from typing import Any

from app.case.quantities import PARTS, SECTIONS_WITHOUT_OWNER, TABLE, Quantity
from app.case.summary import Numbers


def numbers_of(
    summary: Mapping[str, Any], parts: bool = False
) -> Iterator[tuple[str, str, Numbers]]:
    """Yield section, owner and numbers of each table of a summary.

    With ``parts``, rims, tips, necks and surface zones are owners too, such as ``stem_cement_rim``.
    """
    for section in TABLE:
        section_numbers: Any = reduce(
            lambda part, key: part.get(key, {}), section.split("."), summary
        )
        numbers_by_owner: Numbers = (
            {section: section_numbers} if section in SECTIONS_WITHOUT_OWNER else section_numbers
        )
        for name, numbers in numbers_by_owner.items():
            if numbers:
                yield section, name, numbers
            listed_parts = [part for part in PARTS if parts and part in numbers]
            yield from ((section, f"{name}_{part}", numbers[part]) for part in listed_parts)
            zones = numbers.get("zones", {}) if parts and section == "interfaces" else {}
            yield from ((section, f"{name}_{zone}", part) for zone, part in zones.items())


def main_numbers(summary: Mapping[str, Any]) -> Iterator[tuple[str, Quantity, Any, float | None]]:
    """Yield full name, quantity, value and error of each headline of a summary.

    The error is None if it was not estimated.
    """
    for section, owner, numbers in numbers_of(summary):
        for key, q in TABLE[section].items():
            if q.headline and key in numbers:
                yield f"{owner}.{key}", q, numbers[key], numbers.get(f"{key}_error")


def maximum_with_parts(numbers: Numbers, key: str) -> float:
    """A maximum of an interface or a region with its parts; 0 if it is missing."""
    return max(part.get(key, 0.0) for part in (numbers, *(numbers.get(p, {}) for p in PARTS)))


def read(summary: Mapping[str, Any], name: str, suffix: str = "") -> float | None:
    """Number of ``summary.json`` in its unit by its name in `quantities`; None if missing."""
    owner, _, key = name.partition(".")
    key, _, axis = key.partition(".")
    for _, name_of_part, numbers in numbers_of(summary, parts=True):
        value = numbers.get(key + suffix) if name_of_part == owner else None
        if axis and isinstance(value, list):
            value = value["xyz".index(axis)]
        if isinstance(value, int | float):
            return float(value)
    return None
