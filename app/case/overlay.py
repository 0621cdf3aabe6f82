"""Merge a case with its bases, entries of a library, and overrides.

Each value keeps its place: file, line and column, also of a base or a library. Places of removed
values may remain; they are never read.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import replace
from math import cos, hypot, sin
from os.path import expanduser, isfile
from pathlib import Path as FilePath
from typing import Any

from pydantic_core import PydanticCustomError

import configs
from app.case import library
from app.case.former_keys import new_name, of_this_version, present_name, with_present_names
from app.case.shapes import Shape
from app.foundation.errors import InputError
from app.laws.densities import ModulusField
from app.schema import yaml_file
from app.schema.section import VECTOR, Triple, did_you_mean, kinds_of, show
from app.schema.units import ANGLE, FORCE, WEIGHT
from app.schema.yaml_file import BadYaml, CaseFile, Fault, Path, Reader, key_parts, path_text

MOST_BASES = 10
# Keys that a region keeps when it gets another material.
OF_REGION = ("thermal", "tissue", "eigenstrains")
OF_THERMAL = ("initial_temperature", "reference_temperature", "cure")
# Keys of a region or a load that its status and source do not describe.
OF_USE = {*OF_REGION, *library.ORIGIN, "material", "kind", "boundary", "at", "history"}
# Key that names an entry of the library, by section.
NAMED = {
    "regions": "material",
    "interfaces": "finish",
    "loads": "library",
    "credibility": "library",
}
# Files that a case names relative to its folder, in addition to those that a geometry or a form of
# `youngs_modulus` declares; a cycle table without a suffix is the library's.
FILES = ["loads.cycle_table", "loads.*.cycle_table", "motions.*.rotation.cycle_table"]
# Keys among the loads that change all forces there, and what they are.
MEASURED = {"body_weight": WEIGHT, "sagittal_tilt": ANGLE}
# Keys among the loads that say how all forces there change in time, one or the other.
IN_TIME = ("history", "cycle_table")
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
    before = len(case.complaints)
    for file in reversed(chain):
        if file.data.get("library") is not None:
            case.libraries.append(library.read(_named_file(file, "library")))
            case.digests |= case.libraries[-1].digests
            case.notes += case.libraries[-1].notes
        for keys in _file_keys() if file is not chain[0] else ():
            _from(FilePath(file.name).parent, file.data, keys.split("."))
        below = None if file is chain[-1] else case.data
        upper = {k: v for k, v in file.data.items() if k not in ("base", "library")}
        case.data = _merged(case, below, upper, ())
        case.places |= file.places
        for key in IN_TIME:
            place = file.places.get(("loads", key))
            if place:
                _place_in_time(case, key, place, file.places)
    if len(case.complaints) > before:
        case.raise_all([])  # what they leave incomplete has other errors
    apply(case, overrides)
    if case.data.pop("study", None) is not None:
        case.complaints.append(Fault(("study",), SEPARATE_STUDY))
    return case


def _file_keys() -> list[str]:
    """Keys whose values are files; ``*`` is any name."""
    of_geometries = [f"geometry.{key}" for kind in kinds_of(Shape) for key in kind.file_keys]
    of_moduli = [
        f"regions.*.youngs_modulus.{key}"
        for kind in kinds_of(ModulusField)
        for key in kind.file_keys
    ]
    return [*dict.fromkeys(of_geometries), *of_moduli, *FILES]


def _from(folder: FilePath, part: object, keys: Sequence[str]) -> None:
    """Complete the path of a file at keys below a mapping; ``*`` is every key."""
    if isinstance(part, dict):
        for key in list(part) if keys[0] == "*" else keys[:1]:
            if keys[1:]:
                _from(folder, part.get(key), keys[1:])
                continue
            name = part.get(key)
            if isinstance(name, str) and (key != "cycle_table" or "." in name):
                part[key] = str((folder / expanduser(name)).absolute())


def base_file(folder: FilePath, base: str) -> FilePath:
    """Path of a base: a file relative to a folder, or a shipped case by its name alone."""
    shipped = configs.FOLDER / f"{base}.yaml"
    # `isfile` is False for a name that the system refuses.
    word = base.replace("_", "").isalnum()  # not a path
    return shipped if word and isfile(shipped) else folder / expanduser(base)


def _chain(path: FilePath) -> list[CaseFile]:
    """A case and its bases, the nearest first.

    Raises:
        InputError: A file cannot be read or is no case, or the bases make a circle.
    """
    chain = [yaml_file.read(path)]
    of_this_version(chain[0])
    for what, keys in (("sweep", AXES), ("study", {"study"}), ("fit", {"fit"})):
        if "base" in chain[0].data and keys & chain[0].data.keys():
            text = f"is a {what} file, not a case; use mantle {what} {path}"
            chain[0].raise_all([Fault(("base",), text)])
    while chain[-1].data.get("base") is not None:
        below = _named_file(chain[-1], "base")
        names = [file.name for file in chain]
        if len(chain) > MOST_BASES or below.resolve() in [FilePath(n).resolve() for n in names]:
            text = f"more than {MOST_BASES} bases, or a circle: {' -> '.join(names)} -> {below}"
            chain[-1].raise_all([Fault(("base",), text)])
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
        readable = path.is_file()
    except OSError as error:
        file.raise_all([Fault((key,), f"{show(name)} cannot be read: {error.strerror}")])
    if not readable:
        if key == "base":
            known = sorted(p.stem for p in configs.FOLDER.glob("*.yaml"))
            hint = did_you_mean(name, known) or f"; cases by name: {', '.join(known)}"
        file.raise_all([Fault((key,), f"no such file: {path}{hint}")])
    return path


# ---------------------------------------------------------------------------------- merging

# Turns what stands above at a path into plain values, and takes away what they replace below:
# (case, lower, upper, path) -> (lower, upper).
Rule = Callable[[CaseFile, object, object, Path], tuple[object, object]]


def _merged(case: CaseFile, lower: object, upper: object, path: Path) -> Any:
    """Merge one value over another; faults become complaints of the case.

    Mappings merge key by key, of another kind they replace; null removes an entry; all else
    replaces. `_rule` gives the words that are resolved at a path before that.
    """
    rule = _rule(path)
    if rule:
        lower, upper = rule(case, lower, upper, path)
    if not isinstance(upper, dict):
        return upper
    if isinstance(lower, dict) and "kind" in upper and _kind(lower, path) != _kind(upper, path):
        lower = None
    known = lower if isinstance(lower, dict) else {}
    result = {}
    for key, value in known.items():
        if key not in upper:
            result[key] = value
        elif upper[key] is not None:
            result[key] = _merged(case, value, upper[key], (*path, key))
    for key in upper:
        if key in known:
            continue
        if upper[key] is None and lower is not None:
            text = f"is not in the base, so null cannot remove it{did_you_mean(key, list(known))}"
            case.complaints.append(Fault((*path, key), text))
        else:
            result[key] = _merged(case, None, upper[key], (*path, key))
    return result


def _rule(path: Path) -> Rule | None:
    """Rule of a path of a case; most paths have none."""
    match path:
        case ("regions", _):
            return _region
        case ("interfaces", _):
            return _interface
        case ("credibility",):
            return _credibility
        case ("loads",):
            return _loads
        case ("loads", _):
            return _load
        case ("loads", _, "force"):
            return _force
        case ("loads", _, "cycle_table") | ("motions", _, "rotation", "cycle_table"):
            return _cycle_table
    return None


def _region(case: CaseFile, lower: object, upper: object, path: Path) -> tuple[object, object]:
    """Resolve ``material: NAME`` and ``kind: rigid``; drop the origin of changed constants."""
    if not isinstance(upper, dict):
        return lower, upper
    name = upper.get("material")
    if isinstance(name, str):
        upper = {k: v for k, v in upper.items() if k != "material"}
        entry = _entry(case, "materials", name, (*path, "material"), path)
        if entry:
            _check_kind(case, name, _kind(entry, path), ("conductor",), upper, path)
            case.tissues.pop(str(path[1]), None)
            tissue = entry.pop("tissue", None)
            if isinstance(tissue, str):
                case.tissues[str(path[1])] = tissue
            region = lower if isinstance(lower, dict) else {}
            lower = _material(region, entry, upper)
    if isinstance(lower, dict) and "kind" in upper and _kind(lower, path) != _kind(upper, path):
        lower = None
    if upper.get("kind") == "rigid":
        upper = {k: v for k, v in upper.items() if k != "kind"} | {"rigid": True}
    return _without_origin(lower, upper), upper


def _interface(case: CaseFile, lower: object, upper: object, path: Path) -> tuple[object, object]:
    """Resolve ``finish: NAME``."""
    if not isinstance(upper, dict) or not isinstance(upper.get("finish"), str):
        return lower, upper
    name = upper["finish"]
    upper = {k: v for k, v in upper.items() if k != "finish"}
    entry = _entry(case, "finishes", name, (*path, "finish"), path)
    if not entry:
        return lower, upper
    _check_kind(case, name, entry["kind"], (), upper, path)
    if isinstance(lower, dict) and lower.get("kind") == entry["kind"]:
        return lower | entry, upper
    return entry, upper


def _credibility(case: CaseFile, lower: object, upper: object, path: Path) -> tuple[object, object]:
    """Resolve ``library: NAME``, a context of use in place of that of the base."""
    if not isinstance(upper, dict) or not isinstance(upper.get("library"), str):
        return lower, upper
    entry = _entry(case, "contexts", upper["library"], (*path, "library"), path)
    return entry or lower, {k: v for k, v in upper.items() if k != "library"}


def _loads(case: CaseFile, lower: object, upper: object, path: Path) -> tuple[object, object]:
    """Resolve ``library: NAME``, a body weight, a tilt and a history of all loads."""
    if not isinstance(upper, dict):
        return lower, upper
    sets = upper.get("library")
    if sets is not None:
        upper = {k: v for k, v in upper.items() if k != "library"}
        if not isinstance(sets, str | dict):
            text = f"{show(sets)} is not the name of a set, nor names with histories"
            case.complaints.append(Fault((*path, "library"), f"{text}, e.g. {{gait: [1, 0]}}"))
            return lower, upper
        entry = _activities(case, sets, path) if isinstance(sets, dict) else _set(case, sets, path)
        lower = entry or lower
    loads = lower if isinstance(lower, dict) else {}
    if MEASURED.keys() & upper:
        lower = loads = _measured(case, loads, upper)
        upper = {k: v for k, v in upper.items() if k not in MEASURED}
    if upper.keys() >= {*IN_TIME}:
        text = f"the loads have a {IN_TIME[1]}, too; leave one of the two out"
        case.complaints.append(Fault((*path, IN_TIME[0]), text))
    for key in IN_TIME:
        if isinstance(upper.get(key), list) or (key == "cycle_table" and key in upper):
            lower = loads = _changing(case, loads, key, upper[key])
            upper = {k: v for k, v in upper.items() if k != key}
    return lower, upper


def _set(case: CaseFile, name: str, path: Path) -> dict[str, Any]:
    """Loads of a set of the library; notes the body weight for which they are."""
    loads = _entry(case, "loads", name, (*path, "library"), path)
    if loads:
        case.measured = {"sagittal_tilt": 0.0}
        if "body_weight" in loads:
            _measure(case, "body_weight", loads.pop("body_weight"))
    return loads


def _activities(case: CaseFile, sets: Mapping[str, object], path: Path) -> dict[str, Any]:
    """Loads of several sets, each with its history; those of `walking` are `walking_hip` and so on.

    Sets for another body weight than that of the first are scaled to it.
    """
    loads: dict[str, Any] = {}
    weight = None
    for name, history in sets.items():
        forces = _set(case, str(name), path)
        weight = weight or case.measured.get("body_weight")
        if forces and weight and "body_weight" in case.measured:
            forces = _measured(case, forces, {"body_weight": f"{weight!r} N"})
        for load, values in forces.items():
            loads[f"{name}_{load}"] = values | {"history": history}
    return loads


def _load(case: CaseFile, lower: object, upper: object, path: Path) -> tuple[object, object]:
    """Drop the origin of a load that is changed, as that is another's."""
    return _without_origin(lower, upper) if isinstance(upper, dict) else lower, upper


def _cycle_table(case: CaseFile, lower: object, upper: object, path: Path) -> tuple[object, object]:
    """Resolve the name of a cycle table of the library; a file has a point in its name."""
    if isinstance(upper, str) and "." not in upper:
        return None, _entry(case, "cycle_tables", upper, path, path) or lower
    return lower, upper


def _without_origin(lower: object, upper: Mapping[str, object]) -> object:
    """A region or load without its status and source, unless what changes has none."""
    if not isinstance(lower, dict) or upper.keys() <= OF_USE:
        return lower
    return {key: value for key, value in lower.items() if key not in library.ORIGIN}


def _check_kind(
    case: CaseFile,
    name: str,
    kind: object,
    others: Sequence[str],
    upper: Mapping[str, object],
    path: Path,
) -> None:
    """Complain of a kind that is neither that of the entry of the library nor one of others."""
    if upper.get("kind", kind) not in (kind, *others):
        text = f"{name} is of kind {kind}; leave `kind` out"
        case.complaints.append(Fault((*path, "kind"), text))


def _force(case: CaseFile, lower: object, upper: object, path: Path) -> tuple[object, object]:
    """Resolve a magnitude, which keeps the direction of the force below."""
    magnitude = isinstance(upper, str | int | float) and not VECTOR.fullmatch(str(upper))
    vector = isinstance(lower, list) or (isinstance(lower, str) and VECTOR.fullmatch(lower))
    if not (magnitude and vector):
        return lower, upper
    try:
        parts = _vector(lower)
        size = FORCE.read(upper)
        length = hypot(*parts)
        if length > 0.0 and size >= 0.0:
            return None, [f"{part * size / length!r} N" for part in parts]
        why = (
            "a magnitude cannot be negative"
            if length
            else "a force of zero has no direction to scale"
        )
        text = f"{show(upper)}: {why}; expected a vector"
    except PydanticCustomError as error:
        text = (error.context or {})["text"]
    case.complaints.append(Fault(path, text))
    return None, lower


def _vector(force: object) -> list[float]:
    """Components [N] of a force as written.

    Raises:
        PydanticCustomError: It is none.
    """
    return [FORCE.read(value) for value in Triple("").spread(force)]  # type: ignore[attr-defined]


def _measured(
    case: CaseFile, loads: dict[str, object], keys: Mapping[str, object]
) -> dict[str, object]:
    """The loads with all forces scaled to a body weight and turned by a sagittal tilt."""
    old = dict(case.measured)
    for key in MEASURED.keys() & keys:
        if key in old and loads:
            _measure(case, key, keys[key])
        else:
            text = f"no forces here depend on {key}; expected `library: NAME` in the same section"
            case.complaints.append(Fault(("loads", key), text))
    new = case.measured
    factor = new["body_weight"] / old["body_weight"] if "body_weight" in old else 1.0
    turn = new["sagittal_tilt"] - old["sagittal_tilt"]
    c, s = factor * cos(turn), factor * sin(turn)
    result = dict(loads)
    for name, load in loads.items():
        if isinstance(load, dict) and "force" in load:
            with suppress(PydanticCustomError):  # reported where the load is read
                x, y, z = _vector(load["force"])
                turned = (factor * x, c * y + s * z, c * z - s * y)
                result[name] = load | {"force": [f"{part!r} N" for part in turned]}
    return result


def _changing(case: CaseFile, loads: dict[str, Any], key: str, value: object) -> dict[str, Any]:
    """Return the loads of a base or a library, all with the same history or cycle table."""
    if not loads:
        text = f"this section has no loads of a library or a base; set the {key} of each load"
        case.complaints.append(Fault(("loads", key), text))
    if key == "cycle_table":
        _, value = _cycle_table(case, None, value, ("loads", key))
    others = [other for other in IN_TIME if other != key]
    return {
        name: {k: v for k, v in load.items() if k not in others} | {key: deepcopy(value)}
        if isinstance(load, dict)
        else load
        for name, load in loads.items()
    }


def _place_in_time(case: CaseFile, key: str, place: Any, given: Mapping[Path, object]) -> None:
    """Give the history or cycle table of each load the place in the file of the common one."""
    for name in case.data.get("loads") or {}:
        path = ("loads", name, key)
        if path not in given:
            case.places[path] = place


def _measure(case: CaseFile, key: str, value: object) -> None:
    """Note body weight or tilt of the loads; a fault becomes a complaint."""
    try:
        case.measured[key] = MEASURED[key].read(value)
    except PydanticCustomError as error:
        case.complaints.append(Fault(("loads", key), (error.context or {})["text"]))


def _entry(case: CaseFile, kind: str, name: str, path: Path, below: Path) -> dict[str, object]:
    """Entry of the newest library that has it; empty, with a complaint, if none has.

    ``path`` is that of its name in the case, ``below`` gets the places of the values.

    Raises:
        InputError: Too many values were taken.
    """
    if all(file.name != str(library.SHIPPED) for file in case.libraries):
        case.libraries.insert(0, library.read())
        case.digests |= case.libraries[0].digests
    for file in reversed(case.libraries):
        entry = file.data.get(kind, {}).get(name)
        if entry is not None:
            for p, place in file.places.items():
                if p[:2] == (kind, name) and len(p) > 2:
                    case.places[*below, *p[2:]] = place
            if len(case.places) > yaml_file.MOST_NODES:
                raise InputError(f"{case.name}: {yaml_file.TOO_MANY}")
            values = {k: deepcopy(v) for k, v in entry.items() if k not in library.FOR_PEOPLE}
            if kind != "loads":
                return values
            origin = {k: values.pop(k) for k in library.ORIGIN if k in values}
            return {k: origin | v if isinstance(v, dict) else v for k, v in values.items()}
    known = [n for file in case.libraries for n in file.data.get(kind, {})]
    text = f"{show(name)} is not in the library; {kind}: {', '.join(known)}"
    case.complaints.append(Fault(path, text + did_you_mean(name, known)))
    return {}


def _kind(data: Mapping[str, object], path: Path) -> object:
    """Kind of a mapping; regions have a default."""
    if len(path) != 2 or path[0] != "regions":
        return data.get("kind")
    return "rigid" if "rigid" in data else data.get("kind", "isotropic")


def _material(
    region: dict[str, object], entry: dict[str, object], rest: dict[str, object]
) -> dict[str, object]:
    """Give a region the constants of a material, those of heat only where there is heat.

    ``rest`` are the other keys of the region above.
    """
    new = {k: v for k, v in region.items() if k in OF_REGION}
    new |= {k: v for k, v in entry.items() if k in library.ORIGIN}
    conductor = "conductor" in (region.get("kind"), rest.get("kind"))
    solid = not conductor and not rest.get("rigid")
    if conductor:
        new["kind"] = "conductor"
    if solid:
        new |= {k: v for k, v in entry.items() if k != "thermal"}
    if "thermal" in entry and ("thermal" in region or "thermal" in rest):
        old, of_material = region.get("thermal"), entry["thermal"]
        thermal: dict[str, object] = {}
        if isinstance(of_material, dict):
            thermal = {k: v for k, v in of_material.items() if solid or k != "thermal_expansion"}
        if isinstance(old, dict):
            thermal |= {k: v for k, v in old.items() if k in OF_THERMAL}
        new["thermal"] = thermal
    return new


# -------------------------------------------------------------------------------- overrides


def changed(case: CaseFile, overrides: Sequence[str]) -> CaseFile:
    """A copy with more overrides, without reading the file again."""
    copy = replace(
        case,
        data=deepcopy(case.data),
        places=dict(case.places),
        given=dict(case.given),
        measured=dict(case.measured),
        tissues=dict(case.tissues),
        notes=list(case.notes),
        complaints=[],
    )
    apply(copy, overrides)
    return copy


def apply(case: CaseFile, overrides: Iterable[str]) -> None:
    """Apply overrides to a case; errors become complaints."""
    for override in overrides:
        key = override.partition("=")[0].strip()
        try:
            _override(case, key, override)
        except BadYaml as error:
            case.complaints.append(Fault((), error.text, key or "''"))


def _override(case: CaseFile, key: str, override: str) -> None:
    """Apply ``a.b[0].c=value``.

    Raises:
        BadYaml: Malformed, or it goes through something that is not a mapping or list.
    """
    _, equals, text = override.partition("=")
    items = key_parts(key)
    present = present_name(tuple(items))
    if present != items[-1]:
        case.notes.append(new_name(key, present))
        items[-1:] = present.split(".")
    if not equals or not all(items):
        raise BadYaml("expected KEY=VALUE, e.g. interfaces.stem_cement.friction_coefficient=0.3")
    if len(items) > yaml_file.DEEPEST:
        raise BadYaml(f"{len(items)} nested keys; at most {yaml_file.DEEPEST}")
    if items[0] in ("base", "library"):
        raise BadYaml("--set cannot change it; change it in the file")
    target: Any = case.data
    path: Path = ()
    for n, item in enumerate(items):
        step: str | int = item
        if isinstance(target, list):
            if not re.fullmatch("[0-9]{1,6}", item) or int(item) >= len(target):
                raise BadYaml(f"{path_text(path)} has entries 0 to {len(target) - 1}, not '{item}'")
            step = int(item)
        elif not isinstance(target, dict):
            raise BadYaml(f"{path_text(path)} is a single value: it has no '{item}'")
        elif not re.fullmatch(r"[\w-]+", item):
            known = f"; expected one of {', '.join(target)}" if target else ""
            raise BadYaml(f"'{item}' is not a name{known}")
        path = (*path, step)
        if n < len(items) - 1:
            if isinstance(target, dict) and target.get(item) is None:
                target[item] = [{}] if items[n + 1] == "0" else {}
                case.places[path] = key
            target = target[step]
    for old in [p for p in case.places if p[: len(path)] == path]:
        del case.places[old]
    case.places[path] = key
    value: object = text
    try:
        node = yaml_file.compose(text)
        if node is None:  # KEY= without a value is not the null that removes an entry
            case.given[key] = target[step] = None
            return
        value = with_present_names(case, Reader(case, key).value(node, path), path)
    except BadYaml:
        # "[0, 0, -1] N" is no YAML without the quotes, which the shell has removed.
        if not re.fullmatch(r"\s*\[[^\[\]]*\]\s*[^\s\[\]{}].*", text):
            raise
    case.given[key] = value
    _put(case, target, path, value)


def _put(case: CaseFile, holder: Any, path: Path, value: object) -> None:
    """Merge the value of an override into its mapping or list; null removes the old value."""
    step, complaints = path[-1], len(case.complaints)
    if path[0] == "regions" and (step, value) in (("kind", "rigid"), ("rigid", True)):
        for key in holder.keys() - {"tissue", "thermal"}:
            del holder[key]
        step, value = "rigid", True
    old = holder.get(step) if isinstance(holder, dict) else None
    if value is None and old is not None:
        del holder[step]
        return
    if path[0] in ("regions", "loads") and not OF_USE.issuperset(path[2:3]):
        for key in library.ORIGIN:
            case.data[str(path[0])][path[1]].pop(key, None)
    given_here = {p: place for p, place in case.places.items() if p[: len(path)] == path}
    of_entry = step == NAMED.get(str(path[0]))
    if (of_entry and isinstance(value, str)) or (
        path == ("loads", step) and (step in MEASURED or step in IN_TIME)
    ):
        new = _merged(case, holder, {step: value}, path[:-1])
    else:
        new = {step: _merged(case, old if step == "force" else None, value, path)}
    case.places |= given_here  # over those of the entry
    if len(case.complaints) > complaints:
        return
    if step in new:
        holder[step] = new[step]
    else:
        holder.clear()
        holder.update(new)
