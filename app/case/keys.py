"""The table of all keys of a file, from its JSON schema: for editors, `explain` and the manual."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from app.case.case import Case
from app.case.study import StudyFile
from app.case.sweep import Sweep
from app.schema.section import docstrings
from app.schema.units import bounds_in_words

Schema = dict[str, Any]
NUMBERS = {2: "two", 3: "three", 6: "six"}
TYPES = {"string": "text", "integer": "whole number", "number": "number"}
TYPES |= {"boolean": "`true`, `false`", "object": "mapping of keys to values"}
# Number of equal rows of two kinds that are written once.
SHARED = 8
CASE = """# Keys of a case file

A case is a YAML file. A value with a dimension is text with its unit: `110 GPa`, `4 mm`. Any unit
of the right dimension is accepted. The column *unit* names the unit in which mantle keeps and
reports the value. A list of values of one unit may be written once with the unit, in quotes:
`"[0, 0, -1800] N"`. Unknown keys are errors.

An *expression* is arithmetic in the coordinates x, y, z in mm, for example
`"-0.02 * (1 - z / 50)"`; its result is in the unit of the column. It may use `sqrt`, `sin`, `cos`,
`tan`, `exp`, `log`, `abs`, `min`, `max`, `atan2`, `hypot` and `pi`.

`<name>` stands for a name that you choose or that the geometry gives. A key without a default is
required; *none* means that it may be left out. `mantle explain --schema` prints the same as a JSON
schema, for completion in editors.
"""
CAMPAIGNS = """# Keys of sweep and study files

How to use them: [Many runs](../howto/many-runs.md). Keys of overrides are written as after
`--set`: `interfaces.stem_cement.friction_coefficient`. The key `ranks` sets the number of MPI
ranks of a run.
"""


class _Generator(GenerateJsonSchema):
    """Shows defaults with their units."""

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        writer: Any = schema["schema"].get("serialization", {})
        default = schema.get("default")
        if default is not None and writer.get("type") == "function-plain":
            schema = {**schema, "default": writer["function"](default)}
        return super().default_schema(schema)

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        result = super().model_schema(schema)
        for name, text in docstrings(schema["cls"]).items():
            if name in result.get("properties", {}):
                result["properties"][name]["description"] = text
        return result

    def tagged_union_schema(self, schema: core_schema.TaggedUnionSchema) -> JsonSchemaValue:
        """Allow any of the kinds: without required keys a section may match several."""
        return {"anyOf": super().tagged_union_schema(schema)["oneOf"]}


def json_schema(model: type[BaseModel] = Case) -> Schema:
    """JSON schema of a file for editors; no key is required, as a base may have it."""
    found = model.model_json_schema(schema_generator=_Generator)
    for section in (found, *found["$defs"].values()):
        section.pop("required", None)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **found}


@dataclass(frozen=True)
class Key:
    """A key of a file, with texts in Markdown.

    Attributes:
        section: Path of its section, ``interfaces.<name>``; empty at the top.
        kind: Kind of the section, or "".
        value: Type and bounds.
        unit: Internal unit, or "".
        default: "" if it is required.
        inner: Kinds of sections that its value may be, with their keys.
    """

    section: str
    kind: str
    name: str
    value: str
    unit: str
    default: str
    meaning: str
    inner: tuple[tuple[str, tuple[str, ...]], ...]

    @property
    def path(self) -> str:
        """The whole key."""
        return f"{self.section}.{self.name}" if self.section else self.name

    @property
    def row(self) -> str:
        """Its row in the manual."""
        cells = (f"`{self.name}`", self.value, self.unit, self.default, self.meaning)
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


@dataclass(frozen=True)
class Keys:
    """The keys of a section; `path` is its first place, ``supports.<name>``."""

    path: str
    kind: str
    meaning: str
    keys: list[Key]

    @property
    def heading(self) -> str:
        """Heading in the manual."""
        return f"`{self.path}`" + (f" of kind `{self.kind}`" if self.kind else "")


@cache
def table(root: type[BaseModel] = Case) -> list[Keys]:
    """All sections of a `Case`, `StudyFile` or `Sweep` with their keys, in the order of the file.

    Kinds added from outside the program are among them.
    """
    whole = root.model_json_schema(schema_generator=_Generator)
    schemas: Schema = {"": whole} | whole["$defs"]
    places: dict[str, Keys] = {}

    def visit(path: str, name: str) -> None:
        schema = schemas[name]
        meaning = prose(schema.get("description", "")) if name else ""
        places[name] = Keys(path, _kind(schema) if name else "", meaning, [])
        for key, field in schema["properties"].items():
            for place, other in _sections(field, f"{path}.{key}" if path else key):
                if other not in places:
                    visit(place, other)

    visit("", "")
    for name, section in places.items():
        for key, field in schemas[name]["properties"].items():
            value, unit = _value(field, places)
            meaning = prose(field.get("description", ""))
            if key == "kind":
                meaning = "Says that it is of this kind."
            default = "" if key in schemas[name].get("required", ()) else _default(key, field)
            inner = tuple(
                (_kind(schemas[n]), tuple(k for k in schemas[n]["properties"] if k != "kind"))
                for _, n in _sections(field, "")
            )
            made = Key(section.path, section.kind, key, value, unit, default, meaning, inner)
            section.keys.append(made)
    return list(places.values())


def case_page() -> str:
    """Every key of a case file, in Markdown."""
    return "\n".join([CASE, *_page(Case, "Sections of a case")])


def campaigns_page() -> str:
    """Every key of sweep and study files, in Markdown."""
    sweep = _page(Sweep, "Sections of a sweep file")
    study = _page(StudyFile, "Sections of a study file")
    return "\n".join([CAMPAIGNS, *sweep, *study])


def _page(root: type[BaseModel], title: str) -> Iterator[str]:
    written: dict[str, tuple[str, list[str]]] = {}
    for section in table(root):
        yield f"## {section.heading if section.path else title}\n"
        if section.path:
            yield f"{section.meaning}\n"
        rows = [key.row for key in section.keys]
        kind, others = written.get(section.path, ("", []))
        own = [row for row in rows if row not in others]
        if len(rows) - len(own) > SHARED:
            rows = own
            yield f"All keys of kind `{kind}`, and:\n"
        else:
            written[section.path] = section.kind, rows
        yield "| key | value | unit | default | meaning |\n|---|---|---|---|---|"
        yield from rows
        yield ""


def _kind(schema: Schema) -> str:
    """Kind of a section as written in a file; empty if it has none."""
    rigid = "rigid" if "rigid" in schema["properties"] else ""
    return str(schema["properties"].get("kind", {}).get("const", rigid))


def prose(text: str) -> str:
    """A docstring as Markdown of one paragraph or more."""
    text = re.sub(r"``([^`]*)``", r"`\1`", text)
    return "\n\n".join(" ".join(part.split()) for part in text.split("\n\n"))


def _sections(schema: Schema, path: str) -> Iterator[tuple[str, str]]:
    """Places and names of the sections that a value may have."""
    if "$ref" in schema:
        yield path, schema["$ref"].rpartition("/")[2]
    for inner in schema.get("anyOf", ()):
        yield from _sections(inner, path)
    for key, end in (("items", "[]"), ("additionalProperties", ".<name>")):
        if isinstance(inner := schema.get(key), dict):
            yield from _sections(inner, path + end)


def _value(schema: Schema, places: dict[str, Keys]) -> tuple[str, str]:
    """Type of a value, in words, and the unit in which it is kept."""
    match schema:
        case {"x-value": str(text)}:
            return text, schema.get("x-unit", "")
        case {"$ref": str(ref)}:
            section = places[ref.rpartition("/")[2]]
            # Anchor of a heading, as GitHub and MyST make it.
            link = re.sub(r"[^\w\- ]", "", section.heading.lower()).replace(" ", "-")
            kind = section.kind
            return f"kind [`{kind}`](#{link})" if kind else f"[section](#{link})", ""
        case {"anyOf": list(parts)}:
            return _union([_value(p, places) for p in parts if p != {"type": "null"}])
        case {"const": value}:
            return f"`{_yaml(value)}`", ""
        case {"enum": list(values)}:
            return ", ".join(f"`{_yaml(value)}`" for value in values), ""
        case {"additionalProperties": dict(inner)}:
            text, unit = _value(inner, places)
            return f"by name: {text}", unit
        case {"prefixItems": list(items)}:
            found = [_value(item, places) for item in items]
            if len(set(found)) == 1:
                return f"list of {NUMBERS[len(found)]}: {found[0][0]}", found[0][1]
            units = ", ".join(dict.fromkeys(unit for _, unit in found if unit))
            return f"pair of {' and '.join(text for text, _ in found)}", units
        case {"items": dict(inner)}:
            text, unit = _value(inner, places)
            return f"list of: {text}", unit
    if schema.get("format") == "path":
        return "path", ""
    bounds = bounds_in_words({k: v for k, v in schema.items() if k != "type"})
    return f"{TYPES.get(schema.get('type', ''), 'any value')}{bounds}", ""


def _union(found: list[tuple[str, str]]) -> tuple[str, str]:
    kinds = [text.removeprefix("kind ") for text, _ in found if text.startswith("kind ")]
    others = list(dict.fromkeys(text for text, _ in found if not text.startswith("kind ")))
    if {"text", "whole number", "number"} <= set(others):
        others = ["number, text" + (", `true`, `false`" if len(others) > 3 else "")]
    parts = [*filter(None, others), *([f"kind {', '.join(kinds)}"] if kinds else [])]
    return " or ".join(parts), next((unit for _, unit in found if unit), "")


def _default(key: str, field: Schema) -> str:
    """Default of a key that is not required, in Markdown."""
    if key == "kind" and field["const"] != "isotropic":
        return ""
    match field.get("default", {}):
        case None:
            return "none"
        case "" | [] | {} as value if not value:
            return "empty"
        case dict():
            return "its defaults"
        case [{"name": str(name)}]:
            return f"`[{{name: {name}}}]`"
        case list(values):
            return "`[" + ", ".join(f"{value:g}" for value in values) + "]`"
        case value:
            return f"`{_yaml(value)}`"


def _yaml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else f"{value:g}"
