"""The JSON schema of a case file, which editors use to complete keys and values."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from app.schema.section import docstrings


class _Generator(GenerateJsonSchema):
    """Shows defaults with their units; no key is required, as a base may have it."""

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        writer: Any = schema["schema"].get("serialization", {})
        default = schema.get("default")
        if default is not None and writer.get("type") == "function-plain":
            schema = {**schema, "default": writer["function"](default)}
        return super().default_schema(schema)

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        result = super().model_schema(schema)
        result.pop("required", None)
        for name, text in docstrings(schema["cls"]).items():
            if name in result.get("properties", {}):
                result["properties"][name]["description"] = text
        return result

    def tagged_union_schema(self, schema: core_schema.TaggedUnionSchema) -> JsonSchemaValue:
        """Allow any of the kinds: without required keys a section may match several."""
        return {"anyOf": super().tagged_union_schema(schema)["oneOf"]}


def json_schema(model: type[BaseModel]) -> dict[str, Any]:
    """JSON schema of a model as written in YAML."""
    generated = model.model_json_schema(schema_generator=_Generator)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **generated}
