"""Former names of keys, which this version still reads, with a note for each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from app.foundation.verdict import note
from app.schema.yaml_file import CaseFile, Fault, Path, path_text

# Paths that end with a former name; `*` is any name. With each the present name.
FORMER_KEYS: dict[tuple[str, ...], str] = {
    ("loads", "*", "course"): "cycle_table",
    ("motions", "*", "rotation", "course"): "cycle_table",
    ("heat", "*", "course"): "time_course",
}
# The same in libraries, where loads are in sets.
FORMER_KEYS_OF_LIBRARIES: dict[tuple[str, ...], str] = {
    ("courses",): "cycle_tables",
    ("loads", "*", "*", "course"): "cycle_table",
}


def present_name(path: Path, former: Mapping[tuple[str, ...], str] = FORMER_KEYS) -> str:
    """Present name of the last key of a path."""
    for pattern, name in former.items():
        if len(pattern) == len(path) and all(
            part in ("*", key) for part, key in zip(pattern, path, strict=True)
        ):
            return name
    return str(path[-1])


def with_present_names(
    file: CaseFile,
    value: Any,
    path: Path = (),
    former: Mapping[tuple[str, ...], str] = FORMER_KEYS,
) -> Any:
    """Replace former names of keys below a path; add notes to the file, and move the places.

    Both names in one section are a complaint.
    """
    if not isinstance(value, dict):
        return value
    result: dict[str, object] = {}
    for key, part in value.items():
        here = (*path, key)
        name = present_name(here, former)
        if name != key:
            file.notes.append(
                note(f"the key '{key}' has a new name", path_text(here), f"use {name}")
            )
            if name in value:
                file.complaints.append(Fault(here, f"is the former name of {name}; keep one"))
                continue
            move_places(file, here, (*path, name))
        result[name] = with_present_names(file, part, (*path, name), former)
    return result


def move_places(file: CaseFile, old: Path, new: Path) -> None:
    """Give the places of a path and of all below it to another path."""
    for place in [p for p in file.places if p[: len(old)] == old]:
        file.places[new + place[len(old) :]] = file.places.pop(place)
