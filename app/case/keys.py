"""Table of all keys of a file, from its JSON schema."""

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
from app.schema.section import UNION_TAG, docstrings
from app.schema.units import bounds_in_words

Schema = dict[str, Any]
NUMBERS = {2: "two", 3: "three", 6: "six"}
TYPES = {"string": "text", "integer": "whole number", "number": "number"}
TYPES |= {"boolean": "`true`, `false`", "object": "mapping of keys to values"}


class _Generator(GenerateJsonSchema):
    """Shows defaults with their units."""

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        inner: Any = schema["schema"]
        choices = inner["choices"] if inner["type"] == "tagged-union" else {}
        writer = choices.get(f"{UNION_TAG}uniform", inner).get("serialization", {})
        default = schema.get("default")
        if default is not None and writer.get("type") == "function-plain":
            schema = {**schema, "default": writer["function"](default)}
        return super().default_schema(schema)

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        schema_of_model = super().model_schema(schema)
        for name, docstring in docstrings(schema["cls"]).items():
            if name in schema_of_model.get("properties", {}):
                schema_of_model["properties"][name]["description"] = docstring
        return schema_of_model

    def tagged_union_schema(self, schema: core_schema.TaggedUnionSchema) -> JsonSchemaValue:
        """Allow any of the kinds: without required keys a section may match several."""
        return {"anyOf": super().tagged_union_schema(schema)["oneOf"]}


def json_schema(model: type[BaseModel] = Case) -> Schema:
    """JSON schema of a file for editors; no key is required, as a base may have it."""
    schema = model.model_json_schema(schema_generator=_Generator)
    for section in (schema, *schema["$defs"].values()):
        section.pop("required", None)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


@dataclass(frozen=True)
class Key:
    """A key of a file, with texts in Markdown.

    Attributes:
        path: The whole key, ``loads.<name>.history``.
        kind: Kind of its section, or "".
        value: Type and bounds.
        unit: Internal unit, or "".
        default: "" if it is required.
        inner: Kinds of sections that its value may be, with their keys.
    """

    path: str
    kind: str
    name: str
    value: str
    unit: str
    default: str
    meaning: str
    inner: tuple[tuple[str, tuple[str, ...]], ...]


@dataclass(frozen=True)
class KeySection:
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
def key_sections(root: type[BaseModel] = Case) -> list[KeySection]:
    """All sections of a case, sweep, study or fit with their keys, in the order of the file.

    Kinds added from outside the program are among them.
    """
    root_schema = root.model_json_schema(schema_generator=_Generator)
    schemas: Schema = {"": root_schema} | root_schema["$defs"]
    keys_of_section: dict[str, KeySection] = {}

    def visit(path: str, name: str) -> None:
        schema = schemas[name]
        keys_of_section[name] = KeySection(
            path, _kind(schema), prose(schema.get("description", "")), []
        )
        for key, field in schema["properties"].items():
            for place, nested in _sections(field, f"{path}.{key}".removeprefix(".")):
                if nested not in keys_of_section:
                    visit(place, nested)

    visit("", "")
    for name, section in keys_of_section.items():
        for key, field in schemas[name]["properties"].items():
            value, unit = _value(field, keys_of_section)
            meaning = prose(field.get("description", ""))
            if key == "kind":
                meaning = "Selects this kind."
            default = "" if key in schemas[name].get("required", ()) else _default(key, field)
            inner = tuple(
                (_kind(schemas[n]), tuple(k for k in schemas[n]["properties"] if k != "kind"))
                for _, n in _sections(field, "")
            )
            path = f"{section.path}.{key}".removeprefix(".")
            section.keys.append(Key(path, section.kind, key, value, unit, default, meaning, inner))
    return list(keys_of_section.values())


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
        inner = schema.get(key)
        if isinstance(inner, dict):
            yield from _sections(inner, path + end)


def _value(schema: Schema, keys_of_section: dict[str, KeySection]) -> tuple[str, str]:
    """Type of a value, in words, and the unit in which it is kept."""
    match schema:
        case {"x-value": str(text)}:
            return text, schema.get("x-unit", "")
        case {"$ref": str(ref)}:
            return _link(keys_of_section[ref.rpartition("/")[2]]), ""
        case {"anyOf": list(parts)}:
            return _union([_value(p, keys_of_section) for p in parts if p != {"type": "null"}])
        case {"const": value}:
            return f"`{_yaml(value)}`", ""
        case {"enum": list(values)}:
            return ", ".join(f"`{_yaml(value)}`" for value in values), ""
        case {"additionalProperties": dict(inner)}:
            text, unit = _value(inner, keys_of_section)
            return f"by name: {text}", unit
        case {"prefixItems": list(items)}:
            return _row([_value(item, keys_of_section) for item in items])
        case {"items": dict(inner)}:
            text, unit = _value(inner, keys_of_section)
            if text.startswith(("pair [", "row [")):
                return f"list of {text.replace(' ', 's ', 1)}", unit
            return f"list of: {text}", unit
    if schema.get("format") == "path":
        return "path", ""
    bounds = bounds_in_words({k: v for k, v in schema.items() if k != "type"})
    return f"{TYPES.get(schema.get('type', ''), 'any value')}{bounds}", ""


def _link(section: KeySection) -> str:
    """Link to a section of the manual, by its kind if it has one."""
    # Anchor of a heading, as GitHub and MyST make it.
    link = re.sub(r"[^\w\- ]", "", section.heading.lower()).replace(" ", "-")
    return f"kind [`{section.kind}`](#{link})" if section.kind else f"[section](#{link})"


def _row(values: list[tuple[str, str]]) -> tuple[str, str]:
    """Types of the items of a list of fixed length, in words, and their units."""
    if len(set(values)) == 1:
        text, unit = values[0]
        return f"list of {NUMBERS[len(values)]}: {text}", unit
    units = ", ".join(dict.fromkeys(unit for _, unit in values if unit))
    value_types = [text.partition(", e.g.")[0].replace(", ", " ") for text, _ in values]
    kind = "pair" if len(value_types) == 2 else "row"
    return f"{kind} [{', '.join(value_types)}]", units


def _union(values: list[tuple[str, str]]) -> tuple[str, str]:
    """Types of a value that may have several, in words, and the first unit among them."""
    kinds = [text.removeprefix("kind ") for text, _ in values if text.startswith("kind ")]
    other_types = list(dict.fromkeys(text for text, _ in values if not text.startswith("kind ")))
    if {"text", "whole number", "number"} <= set(other_types):
        other_types = ["number, text" + (", `true`, `false`" if len(other_types) > 3 else "")]
    all_types = [*filter(None, other_types), *([f"kind {', '.join(kinds)}"] if kinds else [])]
    separator = "; or " if any("," in part for part in all_types) else " or "
    return separator.join(all_types), next((unit for _, unit in values if unit), "")


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


def all_keys() -> list[Key]:
    """All keys of a case, in the order of the file."""
    return [key for section in key_sections() for key in section.keys]


def matches(key: Key, path: str) -> bool:
    """Return True if a path names a key; names and numbers in it may be any or be left out."""
    pattern = re.escape(key.path)
    pattern = pattern.replace(r"\.<name>", r"(\.[^.]+)?")
    pattern = pattern.replace(r"\[\]", r"(\[\d*\]|\.\d+)?")
    return re.fullmatch(pattern, path) is not None


@cache
def internal_unit(path: str) -> str:
    """Internal unit of a key as after ``--set``; empty if it has none or is unknown."""
    units = {key.unit for key in all_keys() if matches(key, path)} - {""}
    return units.pop() if len(units) == 1 else ""
