"""Lists of two or three values as pydantic field types, also as text: ``"[1, 2, 3] N"``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, ClassVar

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import core_schema

from app.schema.section import fail, show

VECTOR = re.compile(r"\s*\[([^\[\]]*)\](.*)", re.DOTALL)


def spread_unit(value: object) -> object:
    """``"[0, 0, -1800] N"`` as ``["0 N", "0 N", "-1800 N"]``; anything else unchanged."""
    if isinstance(value, str) and (match := VECTOR.fullmatch(value)):
        return [f"{entry.strip()} {match[2].strip()}".strip() for entry in _entries(match[1])]
    return value


def _entries(text: str) -> list[str]:
    """Split at commas outside parentheses."""
    parts, depth = [""], 0
    for character in text:
        depth += (character == "(") - (character == ")")
        if character == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    return parts


@dataclass(frozen=True)
class Pair:
    """Marks a field as a list of exactly two.

    Attributes:
        example: Value as written in a file.
    """

    example: str
    number: ClassVar[int] = 2

    def spread(self, value: object) -> object:
        """The entries, before they are read.

        Raises:
            PydanticCustomError: Not a list, or not of this number of entries.
        """
        words = {2: "two", 3: "three"}[self.number]
        if not isinstance(value, list | tuple):
            fail(f"{show(value)} is not a list of {words} values; expected e.g. {self.example}")
        if len(value) != self.number:
            fail(f"has {len(value)} values; expected {words}, e.g. {self.example}")
        return value

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Spread before the entries are read."""
        return core_schema.no_info_before_validator_function(self.spread, handler(source))


@dataclass(frozen=True)
class Triple(Pair):
    """Marks a field as a vector: a list of exactly three, or ``"[a, b, c] unit"``.

    Attributes:
        scalar: Whether a single value stands for three equal ones.
    """

    scalar: bool = False
    number: ClassVar[int] = 3

    def spread(self, value: object) -> object:
        """The three entries, before they are read."""
        value = spread_unit(value)
        if self.scalar and value is not None and not isinstance(value, list | tuple | dict):
            return (value, value, value)
        return super().spread(value)

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """A list, or text where the entries are text."""
        result = handler(schema)
        if result.get("prefixItems", [{}])[0].get("type") != "string":
            return result
        return {"anyOf": [result, {"type": "string", "examples": [self.example], "x-value": ""}]}
