"""Keys of a sweep: those that vary, their names in words, and their levels."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from fractions import Fraction
from itertools import chain

from app.case import keys, number_text
from app.report.sweep_results import SweptCase, by_part, named
from app.schema.units import conversion, number_and_unit

# Abscissa in place of keys of the geometry: mean thickness of the cement mantle they result in.
ACHIEVED = "geometry.achieved_mean_thickness"
# Key of the thickness of the mantle.
THICKNESS = "geometry.cement_thickness"


def key_in_words(key: str) -> str:
    """Return a key in words.

    For example ``interfaces.cement_bone.friction_coefficient`` gives ``friction coefficient,
    cement-bone``.
    """
    without_index = re.sub(r"force\[([012])\]$", lambda m: f"force along {'xyz'[int(m[1])]}", key)
    *path, last_word = without_index.replace("_", " ").split(".")
    if not path or path[0] in ("geometry", "stages", "solver", "output"):
        return last_word
    if path[0] == "interfaces":
        return f"{last_word}, {named(key.split('.')[1])}"
    return f"{' '.join(path[1:]) or path[0]} {last_word}"


def level_text(level: object) -> str:
    """Return the value of a key as text; a section has its kind."""
    if isinstance(level, dict):
        return str(level.get("kind") or ", ".join(map(str, level.values())))
    return str(level)


def varied_keys(cases: Sequence[SweptCase]) -> list[str]:
    """Keys whose values differ within a part of a sweep; all changed keys of a single case."""
    changed_keys = dict.fromkeys(chain.from_iterable(c.overrides for c in cases))
    if len(cases) == 1:
        return list(changed_keys)
    differing: dict[str, None] = {}
    for part_cases in by_part(cases).values():
        for key in changed_keys:
            if len({str(c.overrides.get(key)) for c in part_cases}) > 1:
                differing[key] = None
    return [key for key in changed_keys if key in differing]


def levels_of(cases: Sequence[SweptCase], key: str) -> tuple[str, list[float | None]]:
    """Return the printed unit of a key, and its value in this unit for each case.

    A value is None if it is not numeric. The unit is the one written in the sweep. If the sweep has
    several units or none, it is the unit of the schema.
    """
    if key == ACHIEVED:
        return "mm", [mantle_thickness(c).get("mean") for c in cases]
    levels = [number_and_unit(c.overrides.get(key)) for c in cases]
    numbers = [level[0] if level else None for level in levels]
    written_units = {level[1] for level in levels if level}
    unit = written_units.pop() if len(written_units) == 1 else None
    if unit:
        return number_text.printed(unit), numbers
    schema_unit = keys.internal_unit(key)
    for k, level in enumerate(levels):
        if level and level[1]:
            numbers[k] = None
            with suppress(LookupError, ValueError):  # the key has no unit
                slope, offset = conversion(level[1], schema_unit)
                numbers[k] = float(Fraction(str(level[0])) * slope + offset)
    return number_text.printed(schema_unit), numbers


def mantle_thickness(case: SweptCase) -> dict[str, float]:
    """Thickness of a case's mantle [mm]; empty if it has none."""
    thickness: dict[str, float] = (case.summary.get("mantle") or {}).get("thickness", {})
    return thickness
