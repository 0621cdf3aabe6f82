"""Cycle tables: angles of a motion, or force of a load, against time through a cycle."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import cached_property
from typing import Annotated, Any, NoReturn

import numpy as np
from pydantic import ConfigDict, ValidationInfo, model_validator
from pydantic_core import PydanticCustomError

from app.laws.values import Source, Status
from app.schema.paths import file
from app.schema.section import ITEMS, Section, Text, fail, show, text_of_defect
from app.schema.units import ANGLE, FORCE, Dimension, Part

CSV: Any = file(".csv", check=lambda path, _: path.read_text(encoding="utf-8-sig"))
# Name and unit of a column: `rotation x [deg]`.
HEADER = re.compile(r"\s*(.*?)\s*\[([^\[\]]*)\]\s*")
ROTATIONS = tuple(f"rotation {axis}" for axis in "xyz")
FORCES = tuple(f"force {axis}" for axis in "xyz")
# Column of the part of a load that acts.
FACTOR = "factor"
COLUMNS = {"time": Dimension("s", "a time", "0.02 s")} | dict.fromkeys(ROTATIONS, ANGLE)
COLUMNS |= dict.fromkeys(("force", *FORCES), FORCE)
COLUMNS[FACTOR] = Part("%", "a part of the force", "80 %", at_least=None, at_most=None)


class CycleTable(Section):
    """Angles or a force through a cycle, linear between rows: a CSV file, or its lines in a list.

    Columns by name with their units, in any order: `time [s]`, `rotation x [deg]`, `rotation y`,
    `rotation z`, and `force [N]`, or `force x`, `force y`, `force z`, or `factor [%]`. One table
    serves motions and loads, which use their columns.
    """

    model_config = ConfigDict(json_schema_extra={"type": ["object", "array", "string"]})

    rows: Annotated[tuple[Text, ...], ITEMS]
    """Lines of the table; the first names its columns. These lines alone may replace the section,
    and so may the name of a CSV file or of a table of the library (`mantle explain
    cycle_tables`)."""
    status: Status = None
    """Origin of the values: measured, assumed, or unverified if their source was not read."""
    source: Source = None
    """Source of the values."""

    @model_validator(mode="before")
    @classmethod
    def _of_rows(cls, value: object, info: ValidationInfo) -> object:
        if isinstance(value, CycleTable):
            return value
        section, name = value if isinstance(value, dict) else {"rows": value}, ""
        rows = section.get("rows", ())
        if isinstance(rows, str):
            path = CSV.func(rows, info)
            rows, name = path.read_text(encoding="utf-8-sig").splitlines(), f"{path}: "
        if not isinstance(rows, list | tuple):
            fail(f"{show(rows)} is not a cycle table; expected a CSV file or a list of its lines")
        lines = [", ".join(map(str, r)) if isinstance(r, list) else str(r) for r in rows]
        _read_columns(lines, name)
        return section | {"rows": [line for line in lines if line.strip()]}

    @cached_property
    def columns(self) -> dict[str, tuple[float, ...]]:
        """Values of the rows [s, rad, N, -] by the name of their column."""
        return _read_columns(self.rows)

    @property
    def description(self) -> str:
        """Rows and columns, for `mantle check`."""
        return f"{len(self.rows) - 1} rows of {', '.join(self.columns)}"

    @property
    def times(self) -> tuple[float, ...]:
        """Times of the rows, growing [s]."""
        return self.columns["time"]

    def values_at(self, names: Sequence[str], s: float) -> list[float]:
        """Values of columns at a part of a cycle from 0 to 1 [rad, N, -]; 0 of a missing one."""
        time = self.times[0] + s * (self.times[-1] - self.times[0])
        columns = (self.columns.get(name) for name in names)
        return [float(np.interp(time, self.times, values)) if values else 0.0 for values in columns]


def _read_columns(rows: Sequence[str], name: str = "") -> dict[str, tuple[float, ...]]:
    """The columns of the lines of a list, or of a file, which stands before messages."""

    def fail_at_line(i: int, message: str) -> NoReturn:
        fail(f"{name}line {i + 1}: {message}" if name else message, () if name else (i,))

    lines = [(i, row.split(",")) for i, row in enumerate(rows) if row.strip()]
    if len(lines) < 3:
        fail(f"{name}has too few rows; expected at least two below the header")
    header_row, header_cells = lines[0]
    named = [m for m in map(HEADER.fullmatch, header_cells) if m and m[1] in COLUMNS]
    units = {m[1]: m[2] for m in named}
    if len(units) < len(header_cells) or "time" not in units:
        valid_heads = {m[0] for m in named}
        message = ", ".join(
            f"'{h.strip()}' is no column" for h in header_cells if h not in valid_heads
        )
        allowed_columns = (
            f"{k} [{'deg' if k in ROTATIONS else column_kind.unit}]"
            for k, column_kind in COLUMNS.items()
        )
        fail_at_line(
            header_row,
            f"{message or 'has no time, or a column twice'}; expected {', '.join(allowed_columns)}",
        )
    table: list[dict[str, float]] = []
    for i, row in lines[1:]:
        if len(row) != len(units):
            fail_at_line(i, f"has {len(row)} values; expected {len(units)}: {', '.join(units)}")
        try:
            row_values = {
                column: COLUMNS[column].read(f"{cell.strip()} {unit}")
                for (column, unit), cell in zip(units.items(), row, strict=True)
            }
        except PydanticCustomError as error:
            fail_at_line(i, text_of_defect(error))
        for column, value_before in table[-1].items() if table else ():
            angle = math.degrees(abs(row_values[column] - value_before))
            if column == "time" and row_values[column] <= value_before:
                fail_at_line(i, f"its time is not above {value_before:g} s, that of the row before")
            if column in ROTATIONS and angle > 180 * (1 + 1e-9):
                fail_at_line(
                    i, f"{column} changes by {angle:.4g} degrees in a row; expected at most 180"
                )
        table.append(row_values)
    return {column: tuple(row[column] for row in table) for column in units}
