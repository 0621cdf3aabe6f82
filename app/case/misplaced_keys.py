"""Messages on keys in a wrong section: the section in which each of them belongs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import get_args, get_origin

from pydantic import BaseModel

from app.schema.section import UNKNOWN_KEY, Extensible, kinds_of
from app.schema.yaml_file import Fault

# Stands in a path for any name, or for any number of an entry of a list.
ANY = "NAME"
# What the entries of a section are, in words.
ENTRIES = {
    "regions": "a region",
    "interfaces": "an interface",
    "supports": "a support",
    "motions": "a motion",
    "loads": "a load",
    "heat": "a heat condition",
    "stages": "a stage",
}
NO_MAPPING = " is not a mapping; expected "
Place = tuple[str, ...]


def with_section(fault: Fault, case: type[BaseModel]) -> Fault:
    """A fault of a key that belongs elsewhere, with the section to which it belongs.

    Other faults are returned unchanged.

    Args:
        fault: The fault.
        case: Class of the whole file.
    """
    key = str(fault.path[-1]) if fault.path else ""
    is_unknown = fault.text.startswith(UNKNOWN_KEY)
    is_value_of_name = len(fault.path) == 2 and NO_MAPPING in fault.text
    if not (is_unknown or is_value_of_name or fault.section):
        return fault
    parent = tuple(ANY if isinstance(k, int) else str(k) for k in fault.path[:-1])
    places = sorted(_places(case, key, ()), key=len)
    if not places or any(_is_at(parent, place) for place in places):
        return fault
    place = places[0]
    if parent[:1] == place[:1] == ("geometry",):
        return fault  # another kind of geometry may have the key
    if fault.section:
        entry = ENTRIES.get(fault.section)
        if place != (fault.section, ANY) or entry is None:
            return fault
        text = f"unknown key here; indent it below the name of {entry}, in '{fault.section}'"
        return replace(fault, text=text, section=f"{fault.section}.{ANY}")
    belongs = _in_words(place, key)
    if is_unknown:
        return replace(fault, text=f"unknown key here; {belongs}")
    return replace(fault, text=f"{fault.text}. If '{key}' is meant as a key: {belongs}")


def _in_words(place: Place, key: str) -> str:
    """The place of a key, as the end of a message."""
    if not place:
        return "write it without indentation: it is a section of the whole file"
    if len(place) == 2 and place[1] == ANY and place[0] in ENTRIES:
        return f"write it below the name of {ENTRIES[place[0]]}: {'.'.join((*place, key))}"
    section = place[0] if ANY in place else place[-1]
    return f"write it below '{section}': {'.'.join((*place, key))}"


def _is_at(parent: Place, place: Place) -> bool:
    """Return True if a section of a file is at a place, in which names are `ANY`."""
    return len(parent) == len(place) and all(
        expected in (ANY, given) for given, expected in zip(parent, place, strict=True)
    )


def _places(model: type[BaseModel], key: str, path: Place) -> Iterator[Place]:
    """Places of the sections below a section that have a key, each with `ANY` for names."""
    fields = model.model_fields
    if key in fields:
        yield path
    for name, field in fields.items():
        for place, section in _sections(field.annotation, (*path, name)):
            yield from _places(section, key, place)


def _sections(annotation: object, path: Place) -> Iterator[tuple[Place, type[BaseModel]]]:
    """Sections that a value of a type may be or hold, with their places."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        kinds = kinds_of(annotation) if issubclass(annotation, Extensible) else ()
        for section in kinds or (annotation,):
            yield path, section
    holds_names = get_origin(annotation) in (dict, Mapping, list, tuple)
    for member in get_args(annotation):
        yield from _sections(member, (*path, ANY) if holds_names else path)
