"""Text for people: tables, durations, counts, values of a case."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence

# One or several, with errors and with a unit of a few letters, if any.
NUMBER = re.compile(r"([-+<]?\s*[\d.][\d.,e+\-±/ ]*( ?[^\d\s]{1,3})?|[-/. ]*)")
# Fraction of the largest component of a vector below which another one is printed as zero.
ROUNDING_OF_COMPONENTS = 1e-12


def text_table(
    head: Sequence[str], rows: Iterable[Sequence[object]], units: Sequence[str] = ()
) -> str:
    """Text table with columns as wide as their widest cell, numbers aligned to the right.

    A cell that is None is empty; units, if any, stand below the titles.
    """
    body = [["" if cell is None else str(cell) for cell in row] for row in rows]
    numbers = [all(map(NUMBER.fullmatch, c)) and any(c) for c in zip(*body, strict=True)]
    lines = [list(head), *([list(units)] if units else []), *body]
    wide = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        "  ".join(
            f"{cell:>{w}}" if is_right_aligned else f"{cell:<{w}}"
            for cell, w, is_right_aligned in zip(
                line, wide, numbers or [False] * len(wide), strict=True
            )
        ).rstrip()
        for line in lines
    )


def duration(seconds: float) -> str:
    """Duration as text: 12.3 s, 40 s, 5 min, 1.5 h."""
    if seconds < 20:
        return f"{seconds:.1f} s"
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def percent(value: float) -> str:
    """Format a relative number: 0.41 %, 12 %, 148 %."""
    return f"{100 * value:.0f} %" if value >= 1 else f"{two_digits(100 * value)} %"


def fixed(number: float, digits: int = 1, sign: str = "") -> str:
    """Number with so many decimals, without a negative zero; with ``+``, always with its sign."""
    return f"{number:{sign}z.{digits}f}"


def two_digits(number: float) -> str:
    """Number with two significant digits, without an exponent up to a million: 0.012, 4.1, 120."""
    return f"{float(f'{number:.2g}'):g}"


def count(number: float) -> str:
    """Count with commas between thousands."""
    return f"{round(number):,}"


def rounded_count(number: float) -> str:
    """Count with two significant digits: 120,000."""
    return count(float(f"{number:.2g}"))


def alternatives(choices: Sequence[str]) -> str:
    """List of things of which one is enough: a, b or c."""
    *others, last = choices
    return f"{', '.join(others)} or {last}" if others else last


def several(number: int, noun: str) -> str:
    """Number with its noun, in the plural unless it is one: 1 rank, 2 ranks."""
    return f"{count(number)} {noun}{'' if number == 1 else 's'}"


def product_text(values: Iterable[float], digits: int = 6) -> str:
    """Numbers as a product: 512 x 512, 1 x 1 x 2.5."""
    return " x ".join(f"{value:.{digits}g}" for value in values)


def shortened_list(names: Iterable[str], most: int) -> str:
    """First names of a list, and the number of the others: a, b, c and 2 more."""
    all_names = list(names)
    remainder = f" and {len(all_names) - most} more" if len(all_names) > most else ""
    return ", ".join(all_names[:most]) + remainder


def point_text(x: Iterable[float]) -> str:
    """Coordinates of a point as text [mm]."""
    return "({:.4g}, {:.4g}, {:.4g}) mm".format(*(round(float(v), 4) + 0.0 for v in x))


def leaves(data: object, key: str = "") -> Iterator[tuple[str, object]]:
    """Values of nested data, each with its full key: ``stages.0.increments``.

    A list that holds neither mappings nor lists is one value.
    """
    if isinstance(data, list) and any(isinstance(entry, dict | list) for entry in data):
        data = dict(enumerate(data))
    if isinstance(data, dict) and data:
        for name, value in data.items():
            yield from leaves(value, f"{key}.{name}" if key else name)
    else:
        yield key, data


def noted(cases: Iterable[tuple[str, Iterable[str]]]) -> list[str]:
    """Notes of several cases, each once, with the names of its cases."""
    all_cases = list(cases)
    cases_of: dict[str, list[str]] = {}
    for name, notes in all_cases:
        for note in notes:
            cases_of.setdefault(note, []).append(name)
    return [
        f"{note} ({'all cases' if len(case_names) == len(all_cases) else ', '.join(case_names)})"
        for note, case_names in cases_of.items()
    ]


def plain_text(value: object) -> str:
    """A value on one line, floats rounded for reading."""
    if isinstance(value, dict):
        return ", ".join(f"{k} {plain_text(v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        item_texts = [plain_text(v) for v in _without_rounding(value)]
        units = [value_text.partition(" ")[2] for value_text in item_texts]
        unit = units[0] if units else ""
        if len(item_texts) > 1 and set(units) == {unit} and unit[:1].isalpha():
            return (
                f"[{', '.join(value_text.partition(' ')[0] for value_text in item_texts)}] {unit}"
            )
        return f"[{', '.join(item_texts)}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.6g}"
    value_text = str(value)
    number, space, unit = value_text.partition(" ")
    try:
        return f"{float(number):.6g}{space}{unit}"
    except ValueError:
        return value_text


def _without_rounding(values: Sequence[object]) -> Sequence[object]:
    """Values of a vector, with zero for those that are rounding errors of the others.

    They are numbers, or numbers with the same unit.
    """
    split_values = [str(v).partition(" ") for v in values if isinstance(v, float | str)]
    try:
        sizes = [abs(float(number)) for number, _, _ in split_values]
    except ValueError:
        return values
    if len(split_values) < len(values) or len({unit for _, _, unit in split_values}) > 1:
        return values
    small = ROUNDING_OF_COMPONENTS * max(sizes, default=0.0)
    return [
        f"0{space}{unit}" if size < small else value
        for value, size, (_, space, unit) in zip(values, sizes, split_values, strict=True)
    ]
