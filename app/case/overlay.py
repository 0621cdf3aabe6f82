"""Merge a case with its bases, entries of a library, and overrides.

Each value keeps its place: file, line and column, also of a base or a library.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from os.path import expanduser, isfile
from pathlib import Path as FilePath
from typing import Any

import configs
from app.case import library
from app.case.former_keys import of_this_version, present_parts, with_present_names
from app.case.merge_rules import (
    KEYS_OF_USE,
    MEASURED,
    TIME_KEYS,
    kind_of,
    rule_at,
    weight_notes,
)
from app.foundation.verdict import Verdict, note
from app.schema import yaml_file
from app.schema.paths import BaseText
from app.schema.section import did_you_mean, show
from app.schema.yaml_file import BadYaml, CaseFile, Fault, Path, Place, Reader, key_parts, path_text

MOST_BASES = 10
# Key that names an entry of the library, by section.
NAMED = {
    "regions": "material",
    "interfaces": "finish",
    "loads": "library",
    "credibility": "library",
}
# Keys of section `loads` that are no loads.
KEYS_OF_ALL_LOADS = (*MEASURED, *TIME_KEYS, "library")
# Keys of a region that stay if it becomes rigid.
KEYS_OF_RIGID = {"tissue", "thermal"}
SEPARATE_STUDY = (
    "a case has no section study; write a file with base: CASE and this section (mantle study)"
)
# Keys of a sweep alone.
AXES = frozenset({"grid", "lists", "table", "latin_hypercube", "sobol", "parts"})


def read(path: FilePath, overrides: Sequence[str] = (), option: str = "--set ") -> CaseFile:
    """Merge a case file with its bases and apply overrides ``a.b.c=value``, unchecked.

    ``option`` is what stands before their keys in messages.

    Raises:
        InputError: The file, a base or a library cannot be read or used.
    """
    chain = _chain(path)
    case = CaseFile(chain[0].name, option=option)
    for file in chain:
        case.digests |= file.digests
        case.complaints += file.complaints
        case.notes += file.notes
    complaints_before = len(case.complaints)
    for file in reversed(chain):
        if file.data.get("library") is not None:
            case.libraries.append(library.read(_named_file(file, "library")))
            case.digests |= case.libraries[-1].digests
            case.notes += case.libraries[-1].notes
        below = None if file is chain[-1] else case.data
        upper = {k: v for k, v in file.data.items() if k not in ("base", "library")}
        if file is not chain[0]:
            folder = FilePath(file.name).parent.absolute()
            upper = {k: BaseText.of(v, folder) for k, v in upper.items()}
        case.data = _merged(case, below, upper, ())
        case.places |= file.places
        _place_in_time(case, file.places)
    case.incomplete = {fault.path[:1] for fault in case.complaints[complaints_before:]}
    if case.incomplete and overrides:
        case.raise_all([])  # overrides of what is missing would have false errors
    apply(case, overrides)
    if case.data.pop("study", None) is not None:
        case.complaints.append(Fault(("study",), SEPARATE_STUDY))
    return case


def file_kind(data: Mapping[str, object]) -> str:
    """Return the kind of a file by its keys: case, study, fit or sweep; empty if none decides."""
    keys_of_kind = {"case": {"geometry"}, "study": {"study"}, "fit": {"fit"}, "sweep": AXES}
    return next((kind for kind, keys in keys_of_kind.items() if keys & data.keys()), "")


def shipped_cases() -> list[str]:
    """Names of the shipped cases."""
    return sorted(path.stem for path in configs.FOLDER.glob("*.yaml"))


def base_file(folder: FilePath, base: str) -> FilePath:
    """Path of a base: a file relative to a folder, or a shipped case by its name alone."""
    shipped = configs.FOLDER / f"{base}.yaml"
    # `isfile` is False for a name that the system refuses.
    is_word = base.replace("_", "").isalnum()  # not a path
    return shipped if is_word and isfile(shipped) else folder / expanduser(base)


def _chain(path: FilePath) -> list[CaseFile]:
    """A case and its bases, the nearest first.

    Raises:
        InputError: A file cannot be read or is no case, or the bases make a circle.
    """
    chain = [yaml_file.read(path)]
    of_this_version(chain[0])
    kind = file_kind(chain[0].data)
    if "base" in chain[0].data and kind not in ("", "case"):
        message = f"is a {kind} file, not a case; use mantle {kind} {path}"
        chain[0].raise_all([Fault(("base",), message)])
    while chain[-1].data.get("base") is not None:
        below = _named_file(chain[-1], "base")
        file_names = [file.name for file in chain]
        if len(chain) > MOST_BASES or below.resolve() in [
            FilePath(n).resolve() for n in file_names
        ]:
            message = (
                f"a circle of bases, or more than {MOST_BASES}: {' -> '.join(file_names)} ->"
                f" {below}"
            )
            chain[-1].raise_all([Fault(("base",), message)])
        chain.append(yaml_file.read(below))
        of_this_version(chain[-1])
    return chain


def _named_file(file: CaseFile, key: str) -> FilePath:
    """The file that a key of another names.

    Raises:
        InputError: It does not exist.
    """
    name, hint = file.data[key], ""
    if not isinstance(name, str):
        file.raise_all([Fault((key,), f"{show(name)} is not text; expected a file")])
    path = base_file(FilePath(file.name).parent, name)
    try:
        is_readable = path.is_file()
    except OSError as error:
        file.raise_all([Fault((key,), f"{show(name)} cannot be read: {error.strerror}")])
    if not is_readable:
        if key == "base":
            known_cases = shipped_cases()
            hint = did_you_mean(name, known_cases) or f"; cases by name: {', '.join(known_cases)}"
        file.raise_all([Fault((key,), f"no such file: {path}{hint}")])
    return path


# ---------------------------------------------------------------------------------- merging


def _merged(case: CaseFile, lower: object, upper: object, path: Path) -> Any:
    """Merge one value over another; faults become complaints of the case.

    Mappings merge key by key; a mapping of another kind replaces. Null removes an entry, any other
    value replaces it. Before merging, `merge_rules.rule_at` resolves words such as names of the
    library.
    """
    rule = rule_at(path)
    if rule:
        lower, upper = rule(case, lower, upper, path)
    if not isinstance(upper, dict):
        return upper
    if isinstance(lower, dict) and "kind" in upper and kind_of(lower, path) != kind_of(upper, path):
        lower = None
        if rule is None:
            _forget_places_below(case, path)
    lower_values = lower if isinstance(lower, dict) else {}
    merged_values = {}
    for key, value in lower_values.items():
        if key not in upper:
            merged_values[key] = value
        elif upper[key] is not None:
            merged_values[key] = _merged(case, value, upper[key], (*path, key))
    for key in upper:
        if key in lower_values:
            continue
        if upper[key] is None and lower is not None:
            message = (
                "is not in the base, so null cannot remove"
                f" it{did_you_mean(key, list(lower_values))}"
            )
            case.complaints.append(Fault((*path, key), message))
        else:
            merged_values[key] = _merged(case, None, upper[key], (*path, key))
    return merged_values


def _forget_places_below(case: CaseFile, path: Path) -> None:
    """Remove the places of the values below a path, which another value replaces."""
    for place in [p for p in case.places if p[: len(path)] == path and p != path]:
        del case.places[place]


def _place_in_time(case: CaseFile, given_places: Mapping[Path, Place]) -> None:
    """Record the loads that use the common history or cycle table, for messages.

    The key of each of these loads gets the place of the common key.
    """
    loads = case.data.get("loads")
    if not isinstance(loads, dict):  # absent or wrong
        return
    given_values = {path[:3] for path in given_places}
    for key in TIME_KEYS:
        common = ("loads", key)
        for name in loads:
            path = ("loads", name, key)
            if path in given_values:
                case.common.pop(path, None)
            elif common in given_places:
                case.places[path] = given_places[common]
                case.common[path] = common


# -------------------------------------------------------------------------------- overrides


def changed(case: CaseFile, overrides: Sequence[str]) -> CaseFile:
    """A copy with more overrides, without reading the file again."""
    changed_case = replace(
        case,
        data=deepcopy(case.data),
        places=dict(case.places),
        given=dict(case.given),
        common=dict(case.common),
        measured=dict(case.measured),
        tissues=dict(case.tissues),
        notes=list(case.notes),
        complaints=[],
    )
    apply(changed_case, overrides)
    return changed_case


def apply(case: CaseFile, overrides: Iterable[str]) -> None:
    """Apply overrides to a case; errors become complaints."""
    for override in overrides:
        key = override.partition("=")[0].strip()
        try:
            _override(case, key, override)
        except BadYaml as error:
            case.complaints.append(Fault((), error.text, key or "''"))
    # An override may have changed the weight of the file.
    other_notes = [kept for kept in case.notes if kept.where != "loads.body_weight"]
    case.notes = [*other_notes, *weight_notes(case)]


def _override(case: CaseFile, key: str, override: str) -> None:
    """Apply ``a.b[0].c=value``.

    Raises:
        BadYaml: Malformed, or it goes through something that is not a mapping or list.
    """
    _, equals, value_text = override.partition("=")
    path_parts = present_parts(case, key_parts(key))
    if not equals or not all(path_parts):
        raise BadYaml("expected KEY=VALUE, e.g. interfaces.stem_cement.friction_coefficient=0.3")
    if len(path_parts) > yaml_file.DEEPEST:
        raise BadYaml(f"{len(path_parts)} nested keys; at most {yaml_file.DEEPEST}")
    if path_parts[0] in ("base", "library"):
        raise BadYaml("--set cannot change it; change it in the file")
    if path_parts[0] == "loads" and len(path_parts) > 2 and path_parts[1] in KEYS_OF_ALL_LOADS:
        whole_key = ".".join(path_parts[:2])
        raise BadYaml(f"{whole_key} is for all loads: set it as a whole, {whole_key}=VALUE")
    target: Any = case.data
    path: Path = ()
    for n, path_part in enumerate(path_parts):
        step: str | int = path_part
        if isinstance(target, list):
            if not re.fullmatch("[0-9]{1,6}", path_part) or int(path_part) >= len(target):
                raise BadYaml(
                    f"{path_text(path)} has entries 0 to {len(target) - 1}, not '{path_part}'"
                )
            step = int(path_part)
        elif not isinstance(target, dict):
            raise BadYaml(f"{path_text(path)} is a single value: it has no '{path_part}'")
        elif not re.fullmatch(r"[\w-]+", path_part):
            allowed = f"; expected one of {', '.join(target)}" if target else ""
            raise BadYaml(f"'{path_part}' is not a name{allowed}")
        path = (*path, step)
        if n < len(path_parts) - 1:
            if isinstance(target, dict) and target.get(path_part) is None:
                target[path_part] = [{}] if path_parts[n + 1] == "0" else {}
                case.places[path] = key
            target = target[step]
    _forget_places_below(case, path)
    case.places[path] = key
    value: object = value_text
    try:
        node = yaml_file.compose(value_text)
        if node is None:  # KEY= without a value is not the null that removes an entry
            case.given[key] = target[step] = None
            return
        value = with_present_names(case, Reader(case, key).value(node, path), path)
    except BadYaml:
        # "[0, 0, -1] N" is no YAML without the quotes, which the shell has removed.
        if not re.fullmatch(r"\s*\[[^\[\]]*\]\s*[^\s\[\]{}].*", value_text):
            raise
    case.given[key] = value
    _put(case, target, path, value)


def _put(case: CaseFile, holder: Any, path: Path, value: object) -> None:
    """Merge the value of an override into the case; null removes the old value.

    Args:
        case: The case.
        holder: Mapping or list of the case with the last key of the path.
        path: Path of the value.
        value: The value.
    """
    section, key = path[0], path[-1]
    if section == "regions" and (key, value) in (("kind", "rigid"), ("rigid", True)):
        key, value = "rigid", True
        for other_key in holder.keys() - KEYS_OF_RIGID:
            del holder[other_key]
    old_value = holder.get(key) if isinstance(holder, dict) else None
    if value is None and old_value is not None:
        del holder[key]
        return
    if section in ("regions", "loads") and not KEYS_OF_USE.issuperset(path[2:3]):
        # It is no longer the entry of the library.
        for origin in library.ORIGIN:
            case.data[str(section)][path[1]].pop(origin, None)
    is_of_all_loads = path == ("loads", key)
    if is_of_all_loads and key in TIME_KEYS:
        case.notes += _replaced_in_time(str(key), holder)
    given_here = {p: place for p, place in case.places.items() if p[: len(path)] == path}
    complaints_before = len(case.complaints)
    is_name_of_entry = key == NAMED.get(str(section)) and isinstance(value, str)
    if is_name_of_entry or (is_of_all_loads and (key in MEASURED or key in TIME_KEYS)):
        # The key stands for other values of its holder.
        new_values = _merged(case, holder, {key: value}, path[:-1])
    else:
        # A magnitude keeps the direction of the old force; other values replace the old one.
        old_force = old_value if key == "force" else None
        new_values = {key: _merged(case, old_force, value, path)}
    case.places |= given_here  # over those of the entry
    if len(case.complaints) > complaints_before:
        return
    if key in new_values:
        holder[key] = new_values[key]
    else:
        holder.clear()
        holder.update(new_values)
    _place_in_time(case, given_here)


def _replaced_in_time(key: str, loads: Mapping[str, Any]) -> Iterable[Verdict]:
    """Note on loads whose history a common cycle table replaces, or the reverse."""
    (other_key,) = (k for k in TIME_KEYS if k != key)
    replaced = {n: v[other_key] for n, v in loads.items() if isinstance(v, dict) and other_key in v}
    if replaced:
        histories = {str(value) for value in replaced.values()} if other_key == "history" else set()
        history = f" {histories.pop()}" if len(histories) == 1 else ""
        message = f"replaces {other_key}{history} of {', '.join(replaced)}"
        yield note(message, f"loads.{key}")
