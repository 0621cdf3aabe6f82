"""The table of all keys of a file, from its JSON schema; what `mantle explain` tells of them."""

from __future__ import annotations

import difflib
import re
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

import configs
from app.case import library, quantities
from app.case.case import Case
from app.case.overlay import MEASURED
from app.foundation.errors import InputError
from app.schema.section import TAG, docstrings
from app.schema.units import bounds_in_words

Schema = dict[str, Any]
NUMBERS = {2: "two", 3: "three", 6: "six"}
TYPES = {"string": "text", "integer": "whole number", "number": "number"}
TYPES |= {"boolean": "`true`, `false`", "object": "mapping of keys to values"}

WIDTH = 96
# Words explained by the text of another.
WITHIN = {"loads.library": "loads", "E": "youngs_modulus"}
WITHIN |= {key: "loads" for name in MEASURED for key in (name, f"loads.{name}")}
WITHIN |= {"nu": "poisson_ratio", "mu": "friction_coefficient", "micromotion": "motion"}
GLOSSARY = configs.FOLDER.parent / "docs" / "glossary.md"


class _Generator(GenerateJsonSchema):
    """Shows defaults with their units."""

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        inner: Any = schema["schema"]
        choices = inner["choices"] if inner["type"] == "tagged-union" else {}
        writer = choices.get(f"{TAG}uniform", inner).get("serialization", {})
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
        path: The whole key, ``interfaces.<name>.history``.
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
        places[name] = Keys(path, _kind(schema), prose(schema.get("description", "")), [])
        for key, field in schema["properties"].items():
            for place, other in _sections(field, f"{path}.{key}".removeprefix(".")):
                if other not in places:
                    visit(place, other)

    visit("", "")
    for name, section in places.items():
        for key, field in schemas[name]["properties"].items():
            value, unit = _value(field, places)
            own = "Says that it is of this kind."
            meaning = own if key == "kind" else prose(field.get("description", ""))
            default = "" if key in schemas[name].get("required", ()) else _default(key, field)
            inner = tuple(
                (_kind(schemas[n]), tuple(k for k in schemas[n]["properties"] if k != "kind"))
                for _, n in _sections(field, "")
            )
            path = f"{section.path}.{key}".removeprefix(".")
            section.keys.append(Key(path, section.kind, key, value, unit, default, meaning, inner))
    return list(places.values())


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


# ------------------------------------------------------------------------------ explanations


def explained(key: str = "") -> str:
    """Meaning, value, unit, default and an example of a key; or an entry of the library.

    Args:
        key: As after ``--set``, without names or with the last word alone. Else a name of the
            library, ``materials`` or ``loads`` for all of them, or a part of names of keys and
            results or a word of the glossary, which are listed. Without it, the sections.

    Raises:
        InputError: There is no such key.
    """
    every = _every()
    asked = key.strip().strip(".").replace(" ", "_")
    asked = WITHIN.get(asked, asked)
    if asked in ("unit", "units"):
        return _units()
    if not asked:
        return "\n".join([*map(_line, table()[0].keys), "", *map(library.listed, library.KINDS)])
    found = [k for k in every if _matches(k, asked)] or [k for k in every if k.name == asked]
    listed = library.listed(asked).replace("`", "") if asked in library.KINDS else ""
    entries = library.described()
    if not found and (listed or key in entries):
        return listed or entries[key]
    if not found:
        mentions = _mentions(asked) or _mentions(key.split()[-1])
        if mentions:
            return mentions
        names = [*entries, *(re.sub(r"\.<name>|\[\]", "", k.path) for k in every)]
        words = {w: name for name in reversed(names) for w in (name, name.rpartition(".")[2])}
        close = (difflib.get_close_matches(w, words, 3) for w in (asked, asked.rpartition(".")[2]))
        near = dict.fromkeys(words[w] for found in close for w in found)
        nearest = ", ".join(near) or ", ".join(Case.model_fields)
        raise InputError(f"{key}: no key of a case; nearest: {nearest}")
    heads: dict[str, list[str]] = {}
    for k in found:
        own = k.path if k.name == "kind" or not k.kind else f"{k.path}  (kind {k.kind})"
        heads.setdefault(_kinds(k.path) if k.name == "kind" else _body(k), []).append(own)
    parts = ["\n".join([*dict.fromkeys(own), body]) for body, own in heads.items()]
    return "\n\n".join(filter(None, [*parts, listed, _results(asked)]))


def _units() -> str:
    """Internal units, each with the keys that have it; then how values are written."""
    keys: dict[str, list[str]] = {}
    for key in _every():
        if key.unit:
            keys.setdefault(key.unit, []).append(key.name)
    head = "Values have units in the file, such as 4 mm or 110 GPa; results are in these:"
    rows = [
        f"  {unit:<14} {textwrap.shorten(', '.join(dict.fromkeys(names)), WIDTH - 20)}"
        for unit, names in sorted(keys.items())
    ]
    return "\n".join([head, *rows])


def _mentions(word: str) -> str:
    """Keys, results and words of the glossary with a word in their names; empty without any."""
    lines = [_line(k) for k in _every() if word.lower() in k.name.lower()]
    return "\n".join(filter(None, [*dict.fromkeys(lines), _results(word)]))


def _results(word: str) -> str:
    """Entries of the library, results and words of the glossary with a word; empty if none has."""
    part = word.lower()
    entries = [text for kind in library.KINDS for text in library.listed(kind).splitlines()[1:]]
    lines = [text for text in entries if part in text.lower().replace(" ", "_")]
    lines += [
        f"  {f'{section}.{q.key}':<44} {q.label} ({q.unit}), a result"
        for section, own in quantities.TABLE.items()
        for q in own.values()
        if part in q.key.lower()
    ]
    text = GLOSSARY.read_text(encoding="utf-8") if GLOSSARY.exists() else ""
    for words, meaning in re.findall(r"^\| ([^|]+) \| ([^|]+) \|$", text, re.MULTILINE):
        if part in words.lower().replace(" ", "_"):
            plain = re.sub("[*$`]", "", f"  {words}: {meaning}")
            lines.append(textwrap.fill(plain, WIDTH, subsequent_indent="    "))
    return "\n".join(lines)


def _line(key: Key) -> str:
    """A key and its meaning in one line."""
    meaning = key.meaning.replace("`", "").partition("\n")[0]
    return f"  {key.path:<44} {textwrap.shorten(meaning, WIDTH - 20, placeholder=' ...')}"


def _kinds(path: str) -> str:
    """The kinds of a section, each as an example with its required keys."""
    lines = []
    for section in (s for s in table() if f"{s.path}.kind" == path and s.kind):
        required = [k for k in section.keys if not k.default and k.name not in ("kind", "rigid")]
        keys = [f"kind: {section.kind}", *(_example(k) or f"{k.name}: ..." for k in required)]
        about = re.split(r"[.] |\n", section.meaning.replace("`", ""))[0]
        for text in (f"{{{', '.join(keys)}}}", f"  {about}"):
            lines.append(textwrap.indent(textwrap.fill(text, WIDTH, subsequent_indent="  "), "  "))
    return "\n".join(lines)


@cache
def unit(key: str) -> str:
    """Internal unit of a key as after ``--set``; empty if it has none or is unknown."""
    units = {k.unit for k in _every() if _matches(k, key)} - {""}
    return units.pop() if len(units) == 1 else ""


def _every() -> list[Key]:
    return [key for section in table() for key in section.keys]


def _matches(key: Key, asked: str) -> bool:
    """Return True if a key matches; names and numbers may be any or be left out."""
    pattern = re.escape(key.path)
    pattern = pattern.replace(r"\.<name>", r"(\.[^.]+)?")
    pattern = pattern.replace(r"\[\]", r"(\[\d*\]|\.\d+)?")
    return re.fullmatch(pattern, asked) is not None


def _example(key: Key) -> str:
    """A key with a value that it may have; empty if none is known."""
    said = f"{key.value} such as {key.default} such as {key.value} {key.meaning}"
    example = re.search(r"(?:e\.g\.|such as) `([^`]*)`", said)
    found = example[1] if example else "0.3" if key.value.startswith("number") else ""
    return f"{key.name}: {found}" if found else ""


def _body(key: Key) -> str:
    """Text of an explanation below its heading."""
    rows = {
        "": key.meaning,
        "value": key.value,
        "unit": key.unit,
        "default": key.default or "none: it is required",
        "keys": "; ".join(f"{k}: {', '.join(n)}".removeprefix(": ") for k, n in key.inner),
        "example": _example(key),
    }
    lines = []
    for name, text in rows.items():
        plain = re.sub(r"\[([^\]]*)\]\(#[^)]*\)", r"\1", text).replace("`", "")
        first = f"  {name:<9}" if name else "  "
        further = " " * len(first)
        lines += textwrap.wrap(
            plain, WIDTH, initial_indent=first, subsequent_indent=further, break_on_hyphens=False
        )
    return "\n".join(lines)
