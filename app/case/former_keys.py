"""Versions of the format of case files: former names of keys, and versions that are refused.

A case says its version by ``mantle: 1``. A new name of a key is a row of `FORMER_KEYS`, and needs
no new version. A key or a default that changes its meaning needs one: raise `VERSION`, and let
`of_this_version` rewrite files of the version before, so that they keep their meaning. Keep a file
of each version in ``tests/case/versions``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from app import __version__
from app.foundation.verdict import Verdict, note
from app.schema.section import show
from app.schema.yaml_file import CaseFile, Fault, Path, key_parts, path_text

# Newest version of the format that this program reads. Files without a version have the first.
VERSION = 1
# Key of the version in a file.
KEY = "mantle"

# Paths that end with a former name; `*` is any name. With each the present name.
FORMER_KEYS: dict[tuple[str, ...], str] = {
    ("loads", "*", "course"): "cycle_table",
    ("motions", "*", "rotation", "course"): "cycle_table",
    ("heat", "*", "course"): "time_course",
    ("interfaces", "*", "compliance"): "elastic_layer",
    ("geometry", "resection_height"): "resection.height",
    ("geometry", "resection_angle"): "resection.angle",
    ("question",): "credibility.question",
    ("context_of_use",): "credibility.context_of_use",
}
# The same in libraries, where loads are in sets.
FORMER_KEYS_OF_LIBRARIES: dict[tuple[str, ...], str] = {
    ("courses",): "cycle_tables",
    ("loads", "*", "*", "course"): "cycle_table",
}
# The same in the geometry of a parametric femur. Levels of the model have become lengths from the
# shoulder of the stem, so that `case.femurs` converts the values, too.
FORMER_KEYS_OF_FEMURS: dict[str, str] = {
    "stem_tip_z": "tip_z",
    "stem_length": "stem.length",
    "stem_half_width": "stem.half_width",
    "stem_half_depth": "stem.half_depth",
    "stem_corner_radius": "stem.corner_radius",
    "stem_tip_half_width": "stem.tip_half_width",
    "stem_tip_half_depth": "stem.tip_half_depth",
    "stem_tip_corner_radius": "stem.tip_corner_radius",
    "tip_rounding": "stem.tip_rounding",
    "neck_diameter": "stem.neck_diameter",
    "neck_fillet": "stem.neck_fillet",
    "trunnion_diameter": "stem.trunnion_diameter",
    "head_offset": "stem.head_offset",
    "neck_angle": "stem.neck_angle",
    "stem_section_z": "stem.section_depth",
    "head_height": "stem.head_height",
}


def new_name(former: str, present: str) -> Verdict:
    """Note on a former key: the whole key, and its present name in the same section."""
    last_part = key_parts(former)[-1]
    return note(f"the key '{last_part}' has a new name", former, f"use {present}")


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
        InputError: The version is a newer one, or no number of a version.
    """
    version = file.data.get(KEY, 1)
    if type(version) is not int or version < 1:
        message = f"{show(version)} is not a version of case files; expected {VERSION}"
        file.raise_all([Fault((KEY,), message)])
    if version > VERSION:
        message = (
            f"the file is of version {version}, and mantle {__version__} reads versions up to "
            f"{VERSION}; install a newer mantle, or run the file with the mantle that it was "
            "written for"
        )
        file.raise_all([Fault((KEY,), message)])


def present_name(path: Path, former: Mapping[tuple[str, ...], str] = FORMER_KEYS) -> str:
    """Present name of the last key of a path; ``resection.height`` is in a section there."""
    for pattern, name in former.items():
        if len(pattern) == len(path) and all(
            part in ("*", key) for part, key in zip(pattern, path, strict=True)
        ):
            return name
    return str(path[-1])


def present_parts(file: CaseFile, parts: Sequence[str]) -> list[str]:
    """Replace former names in the parts of a key, also before its last one; add notes to the file.

    The names that are not former ones stay.
    """
    present: list[str] = []
    for part in parts:
        former_path = (*present, part)
        name = present_name(former_path)
        if name != part:
            verdict = new_name(".".join(former_path), name)
            file.notes += [verdict] if verdict not in file.notes else []
        present += name.split(".")
    return present


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
    present_data: dict[str, Any] = {}
    former_names: dict[str, str] = {}
    for key, inner in value.items():
        key_path = (*path, key)
        name = present_name(key_path, former)
        if name == key:
            present_data[key] = with_present_names(file, inner, key_path, former)
        else:
            former_names[key] = name
    for key, name in former_names.items():
        key_path = (*path, key)
        file.notes.append(new_name(path_text(key_path), name))
        section, _, last_part = name.rpartition(".")
        new_path = (*path, section, last_part) if section else (*path, last_part)
        holder = present_data.setdefault(section, {}) if section else present_data
        if not isinstance(holder, dict) or last_part in holder:
            file.complaints.append(Fault(key_path, f"is the former name of {name}; keep one"))
            continue
        move_places(file, key_path, new_path)
        holder[last_part] = with_present_names(file, value[key], new_path, former)
    return present_data


def move_places(file: CaseFile, old: Path, new: Path) -> None:
    """Move the places of a path, and of all paths below it, to another path."""
    for place in [p for p in file.places if p[: len(old)] == old]:
        file.places[new + place[len(old) :]] = file.places.pop(place)
