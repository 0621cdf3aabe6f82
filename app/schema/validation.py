"""Errors of pydantic as faults of the file, in its own words."""

from __future__ import annotations

from typing import Any, get_args, get_origin

from pydantic import BaseModel, ValidationError

from app.schema.section import (
    TAG,
    Extensible,
    did_you_mean,
    docstrings,
    kinds_of,
    show,
)
from app.schema.yaml_file import Fault


def problems(error: ValidationError, model: type[BaseModel]) -> list[Fault]:
    """Pydantic's errors in the words of the file, which holds a `model`."""
    found = []
    for entry in error.errors(include_url=False):
        location = entry["loc"]
        path = tuple(
            i for i in location if not (isinstance(i, str) and (i.startswith(TAG) or i == "[key]"))
        )
        key = str(path[-1]) if path else ""
        match entry["type"]:
            case "mantle":
                path += tuple(entry["ctx"]["at"])
                text = entry["ctx"]["text"]
            case "missing":
                path, text = path[:-1], f"'{key}' is missing; {_expected(model, location)}"
            case "extra_forbidden":
                allowed = tuple(_model_at(model, location).model_fields)
                text = f"unknown key; allowed: {', '.join(allowed)}{did_you_mean(key, allowed)}"
            case "model_type" | "model_attributes_type":
                keys = ", ".join(_model_at(model, (*location, "")).model_fields)
                text = f"{show(entry['input'])} is not a mapping; expected keys {keys}"
            case "literal_error":
                text = f"{show(entry['input'])} is not {entry['ctx']['expected']}"
            case _:
                text = f"{show(entry['input'])}: {entry['msg'][0].lower()}{entry['msg'][1:]}"
        found.append(Fault(path, text))
    return found


def _expected(model: type[BaseModel], location: tuple[str | int, ...]) -> str:
    """Documentation of a missing key."""
    text = docstrings(_model_at(model, location)).get(str(location[-1]), "")
    return f"expected: {text[:1].lower()}{text[1:].rstrip('.')}" if text else "expected"


def _model_at(model: type[BaseModel], location: tuple[str | int, ...]) -> type[BaseModel]:
    """The model whose key the last entry of a pydantic location is."""
    current: Any = model
    for item in location[:-1]:
        if isinstance(item, str) and item.startswith(TAG):
            # A tag may also tell apart what is no model: a list and a mapping.
            current = next((m for m in _kinds(current) if TAG + m.__name__ == item), current)
        elif get_origin(current) in (dict, tuple):
            current = get_args(current)[1 if get_origin(current) is dict else 0]
        elif (owner := next(_models(current), None)) is not None:
            current = owner.model_fields[str(item)].annotation
    return next(_models(current), model)


def _kinds(annotation: Any) -> Any:
    """The models within an annotation, and the kinds of those that have some."""
    for model in _models(annotation):
        yield model
        if issubclass(model, Extensible):
            yield from kinds_of(model)


def _models(annotation: Any) -> Any:
    """The models within an annotation, in order."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models(argument)
