"""Courses: tables of time with the angles of a motion, or the force of a load, through a cycle."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NoReturn

from pydantic import (
    ConfigDict,
    PlainSerializer,
    PlainValidator,
    ValidationInfo,
    WithJsonSchema,
    model_validator,
)
from pydantic_core import PydanticCustomError

from app.laws.values import Source, Status
from app.schema.paths import file
from app.schema.section import Section, fail, not_one_of, show
from app.schema.units import ANGLE, FORCE, Dimension

# Name and unit of a column: `rotation x [deg]`.
HEADER = re.compile(r"\s*(.*?)\s*\[([^\[\]]*)\]\s*")
ROTATIONS = tuple(f"rotation {axis}" for axis in "xyz")
FORCES = tuple(f"force {axis}" for axis in "xyz")
COLUMNS = {
    "time": Dimension("s", "a time", "0.02 s"),
    **dict.fromkeys(ROTATIONS, ANGLE),
    **dict.fromkeys(("force", *FORCES), FORCE),
}
MOST_ROWS = 10_000
KNOWN = "a CSV file, its lines in a list, or a name of the library (`mantle explain courses`)"


class Columns(dict[str, tuple[float, ...]]):
    """Values of the rows [s, rad, N] by the name of their column."""

    def lines(self) -> list[str]:
        """The lines of a CSV file that reads back to the same values."""
        heads = (f"{name} [{COLUMNS[name].unit}]" for name in self)
        rows = zip(*self.values(), strict=True)
        return [", ".join(heads), *(", ".join(map(repr, row)) for row in rows)]


def _read(value: object, info: ValidationInfo) -> Columns:
    """The columns of a CSV file, or of its lines in a list."""
    if isinstance(value, Columns):
        return value
    if isinstance(value, list | tuple) and value:
        return _columns(list(enumerate(value)))
    if not isinstance(value, str | Path):
        fail(f"{show(value)} is not a course; expected {KNOWN}")
    find: Any = file(".csv").func
    path: Path = find(value, info)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        fail(f"{path} cannot be read: {error}")
    return _columns([(i, line) for i, line in enumerate(lines, 1) if line.strip()], f"{path}, ")


def _columns(lines: list[tuple[int, object]], name: str = "") -> Columns:
    """The columns of numbered lines, the first of which names them; of a file, or of a list."""

    def wrong(i: int, text: str) -> NoReturn:
        fail(f"{name}row {i}: {text}" if name else text, at=() if name else (i,))

    def cells(line: object) -> list[object]:
        return [*line] if isinstance(line, list | tuple) else [*str(line).split(",")]

    if not 3 <= len(lines) <= MOST_ROWS + 1:
        fail(f"{name}has {max(len(lines) - 1, 0)} rows; expected 2 to {MOST_ROWS} below the header")
    top, units = lines[0][0], dict[str, str]()
    for head in cells(lines[0][1]):
        found = HEADER.fullmatch(str(head))
        if not found or found[1] not in COLUMNS or found[1] in units:
            of = found[1] if found else str(head).strip()
            why = "stands there twice" if of in units else not_one_of(of, tuple(COLUMNS))
            wrong(top, f"column {why}, each with its unit: rotation x [deg]")
        units[found[1]] = found[2]
    if "time" not in units or len(units) < 2:
        wrong(top, "expected a column time [s], and at least one of rotation or force")
    rows: list[list[float]] = []
    for i, line in lines[1:]:
        if len(row := cells(line)) != len(units):
            wrong(i, f"has {len(row)} values; expected {len(units)}: {', '.join(units)}")
        try:
            new = [
                COLUMNS[column].read(f"{str(cell).strip()} {unit}")
                for (column, unit), cell in zip(units.items(), row, strict=True)
            ]
        except PydanticCustomError as error:
            wrong(i, (error.context or {})["text"])
        for k, column in enumerate(units if rows else ()):
            before, here = rows[-1][k], new[k]
            if column == "time" and here <= before:
                wrong(i, f"the time {here:g} s is not above that of the row before, {before:g} s")
            if column in ROTATIONS and abs(here - before) > math.pi * (1 + 1e-9):
                turn = math.degrees(abs(here - before))
                wrong(i, f"{column} changes by {turn:.4g} degrees in a row; expected at most 180")
        rows.append(new)
    return Columns(zip(units, zip(*rows, strict=True), strict=True))


_SCHEMA = {"anyOf": [{"type": "string"}, {"type": "array"}], "x-value": KNOWN}


class Course(Section):
    """Angles or a force through a cycle, linear between rows: a CSV file, or its lines in a list.

    Columns by name with their units, in any order: `time [s]`, `rotation x [deg]`, `rotation y`,
    `rotation z`, and `force [N]` or `force x`, `force y`, `force z`. One course serves motions and
    loads, which take what is theirs.
    """

    model_config = ConfigDict(json_schema_extra={"type": ["object", "array", "string"]})

    rows: Annotated[
        Columns,
        PlainValidator(_read),
        PlainSerializer(Columns.lines, return_type=list[str]),
        WithJsonSchema(_SCHEMA),
    ]
    """The table; alone it stands for the section."""
    status: Status = None
    """How sure its values are; unverified are those of a source that was not read."""
    source: Source = None
    """Where its values are from."""

    @model_validator(mode="before")
    @classmethod
    def _of_rows(cls, value: object, info: ValidationInfo) -> object:
        return value if isinstance(value, dict | Course) else {"rows": _read(value, info)}

    @property
    def times(self) -> tuple[float, ...]:
        """Times of the rows, growing [s]."""
        return self.rows["time"]

    def has(self, *columns: str) -> bool:
        """Whether it has any of some columns."""
        return any(name in self.rows for name in columns)

    def column(self, name: str) -> tuple[float, ...]:
        """Values of the rows [rad, N]; zeros of a column that it lacks."""
        return self.rows.get(name) or (0.0,) * len(self.times)

    def at(self, names: Sequence[str], s: float) -> list[float]:
        """Values of columns at a part of a cycle from 0 to 1 [rad, N]."""
        return [value_at(self.times, self.column(name), s) for name in names]


def value_at(times: Sequence[float], values: Sequence[float], s: float) -> float:
    """Value at a part of a cycle from 0 to 1, the first row at 0 and the last at 1."""
    import numpy as np

    return float(np.interp(times[0] + s * (times[-1] - times[0]), times, values))
