"""The JSON schema of a case file, as editors use it for completion."""

from __future__ import annotations

import ast
import inspect
import textwrap
from itertools import pairwise
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema


class _Generator(GenerateJsonSchema):
    """Shows defaults with their units, and asks for `kind` where it is needed."""

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        """Write a default like a value."""
        writer: Any = schema["schema"].get("serialization", {})
        default = schema.get("default")
        if default is not None and writer.get("type") == "function-plain":
            schema = {**schema, "default": writer["function"](default)}
        return super().default_schema(schema)

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        """Describe the keys; require the `kind` of every class but one that may leave it out."""
        result = super().model_schema(schema)
        for name, text in docstrings(schema["cls"]).items():
            if name in result.get("properties", {}):
                result["properties"][name]["description"] = text
        kind = result.get("properties", {}).get("kind")
        if kind and kind.get("const") != "isotropic":
            result["required"] = ["kind", *result.get("required", [])]
        if "material" in result.get("properties", {}) and "rigid" not in result["properties"]:
            # What has a material by name needs no constants beside it.
            always = [key for key in result.get("required", []) if key == "kind"]
            either = [{"required": ["material"]}, {"required": result.pop("required", [])}]
            result |= {"anyOf": either, "required": always}
        elif "initial_temperature" in result.get("required", []):
            result["required"] = ["initial_temperature"]
        return result


def docstrings(model: type) -> dict[str, str]:
    """Texts below the fields of a class and of those it is made from.

    Pydantic's own ``use_attribute_docstrings`` reads the source at every start.
    """
    found: dict[str, str] = {}
    for base in reversed(model.__mro__):
        if base is BaseModel or not issubclass(base, BaseModel):
            continue
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(base))).body
        assert isinstance(tree, ast.ClassDef)
        for field, text in pairwise(tree.body):
            match field, text:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(ast.Constant(str(doc))):
                    found[name] = inspect.cleandoc(doc)
    return found


def over_a_base(schema: dict[str, Any], name: str) -> dict[str, Any]:
    """The schema of a case that may have a base: nothing is required then, and null removes.

    Args:
        schema: That of a case without a base.
        name: What it is called.
    """
    whole = dict(schema)
    definitions = whole.pop("$defs")
    head = {"$schema": whole.pop("$schema")}
    names = {"type": "string", "description": "Name of loads in the library"}
    whole["properties"]["loads"]["properties"] = {"library": names}
    definitions = {**definitions, name: whole}
    partial = {f"{key}OverBase": _partial(value) for key, value in definitions.items()}
    return {
        **head,
        "title": name,
        "if": {"required": ["base"]},
        "then": {"$ref": f"#/$defs/{name}OverBase"},
        "else": {"$ref": f"#/$defs/{name}"},
        "$defs": definitions | partial,
    }


def _partial(schema: Any) -> Any:
    """A schema of which nothing is required, with null for any key."""
    match schema:
        case {"$ref": str(target), **more}:
            return _partial(more) | {"$ref": f"{target}OverBase"}
        case list():
            return [_partial(entry) for entry in schema]
        case dict():
            left_out = ("required", "discriminator")
            found = {k: _partial(v) for k, v in schema.items() if k not in left_out}
            if "oneOf" in found:
                found["anyOf"] = found.pop("oneOf")
            if all(entry == {} for entry in found.get("anyOf", [1])):
                found.pop("anyOf", None)
            if isinstance(keys := schema.get("properties"), dict) and "type" in schema:
                found["properties"] = {k: _or_null(_partial(v)) for k, v in keys.items()}
            if isinstance(schema.get("additionalProperties"), dict):
                found["additionalProperties"] = _or_null(found["additionalProperties"])
            return found
    return schema


def _or_null(schema: dict[str, Any]) -> dict[str, Any]:
    """A schema, or null."""
    return {"anyOf": [schema, {"type": "null"}]}


def json_schema(model: type[BaseModel]) -> dict[str, Any]:
    """The schema of a model's YAML form."""
    generated = model.model_json_schema(schema_generator=_Generator)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **generated}
