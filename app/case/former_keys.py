"""Versions of the format of case files: former names of keys, and versions that are refused.

A case says its version by ``mantle: 1``. A new name of a key is a row of `FORMER_KEYS`, and needs
no new version. A key or a default that changes its meaning needs one: raise `VERSION`, and let
`of_this_version` rewrite files of the version before, so that they keep their meaning. Keep a file
of each version in ``tests/case/versions``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from app import __version__
from app.foundation.verdict import note
from app.schema.section import show
from app.schema.yaml_file import CaseFile, Fault, Path, path_text

# Newest version of the format that this program reads. Files without a version have the first.
VERSION = 1
# Key of the version in a file.
KEY = "mantle"

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


def of_this_version(file: CaseFile) -> None:
    """Rewrite a case file in the present version; its keys have their present names.

    Raises:
        InputError: The file is of a version that this program does not know.
    """
    check_version(file)
    file.data = with_present_names(file, file.data)


def check_version(file: CaseFile) -> None:
    """Refuse a case, sweep, study or library of a version that this program does not know.

    Raises:
        InputError: It says a newer version, or no version at all.
    """
    version = file.data.get(KEY, 1)
    if type(version) is not int or version < 1:
        text = f"{show(version)} is not a version of case files; expected {VERSION}"
        file.raise_all([Fault((KEY,), text)])
    if version > VERSION:
        text = (
            f"the file is of version {version}, and mantle {__version__} reads versions up to "
            f"{VERSION}; install a newer mantle, or run the file with the mantle that it was "
            "written for"
        )
        file.raise_all([Fault((KEY,), text)])


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
