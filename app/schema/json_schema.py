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


def json_schema(model: type[BaseModel]) -> dict[str, Any]:
    """The schema of a model's YAML form."""
    generated = model.model_json_schema(schema_generator=_Generator)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **generated}
