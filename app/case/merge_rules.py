"""Rules of merging: words of a case that stand for values of a library or of other keys.

`material`, `finish` and `library` name an entry of a library. `body_weight`, `sagittal_tilt`, a
common `history` or `cycle_table`, and the magnitude of a `force` change values below them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from math import cos, hypot, sin
from typing import Any

from pydantic_core import PydanticCustomError

from app.case import library
from app.foundation.errors import InputError
from app.foundation.verdict import Verdict, note
from app.laws.loads import DIRECTION, NO_FORCE
from app.schema import yaml_file
from app.schema.section import VECTOR, Triple, did_you_mean, show, text_of_defect
from app.schema.units import ANGLE, FORCE, WEIGHT
from app.schema.yaml_file import CaseFile, Fault, Path

# Keys that a region keeps when it gets another material.
KEPT_REGION_KEYS = ("thermal", "tissue", "eigenstrains")
KEPT_THERMAL_KEYS = ("initial_temperature", "reference_temperature", "cure")
# Keys of a region or a load that its status and source do not describe.
KEYS_OF_USE = {*KEPT_REGION_KEYS, *library.ORIGIN, "material", "kind", "boundary", "at", "history"}
# Keys among the loads that change all forces there, and what they are.
MEASURED = {"body_weight": WEIGHT, "sagittal_tilt": ANGLE}
GRAVITY = 9.81  # m/s^2
# Body weights of adults [N]; others have a note.
USUAL_WEIGHTS = (300.0, 1500.0)
# Keys among the loads that say how all forces there change in time, one or the other.
TIME_KEYS = ("history", "cycle_table")
# The fault of a common cycle table with columns of a force.
FORCES_IN_COMMON_TABLE = (
    "has a force, but all loads here take this table, and each has a force; expected a column"
    " `factor [%]`, the part of the forces that acts. A table with a force is for one load:"
    " `hip: {force: null, cycle_table: hip.csv}`, with columns force x, force y, force z"
)

# Turns the upper value at a path into plain values, and removes what they replace in the lower one:
# (case, lower, upper, path) -> (lower, upper).
Rule = Callable[[CaseFile, object, object, Path], tuple[object, object]]


def rule_at(path: Path) -> Rule | None:
    """Rule of a path of a case; most paths have none."""
    match path:
        case ("geometry", "stem"):
            return _stem
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


def _without_keys(values: Mapping[str, object], *keys: str) -> dict[str, object]:
    """Values of the other keys."""
    return {key: value for key, value in values.items() if key not in keys}


def _stem(case: CaseFile, lower: object, upper: object, path: Path) -> tuple[object, object]:
    """Drop the dimensions of a stem that a file replaces; its collar stays."""
    if isinstance(lower, dict) and isinstance(upper, dict) and "step" in upper.keys() - lower:
        lower = {key: value for key, value in lower.items() if key == "collar"}
    return lower, upper


def _region(case: CaseFile, lower: object, upper: object, path: Path) -> tuple[object, object]:
    """Resolve ``material: NAME`` and ``kind: rigid``; drop the origin of changed constants."""
    if not isinstance(upper, dict):
        return lower, upper
    name = upper.get("material")
    if isinstance(name, str):
        upper = _without_keys(upper, "material")
        material = _entry(case, "materials", name, (*path, "material"), path)
        if material:
            _check_kind(case, name, kind_of(material, path), ("conductor",), upper, path)
            case.tissues.pop(str(path[1]), None)
            tissue = material.pop("tissue", None)
            if isinstance(tissue, str):
                case.tissues[str(path[1])] = tissue
            region = lower if isinstance(lower, dict) else {}
            lower = _material(region, material, upper)
    if isinstance(lower, dict) and "kind" in upper and kind_of(lower, path) != kind_of(upper, path):
        lower = None
    if upper.get("kind") == "rigid":
        upper = _without_keys(upper, "kind") | {"rigid": True}
    return _without_origin(lower, upper), upper


def _interface(case: CaseFile, lower: object, upper: object, path: Path) -> tuple[object, object]:
    """Resolve ``finish: NAME``."""
    if not isinstance(upper, dict) or not isinstance(upper.get("finish"), str):
        return lower, upper
    name = upper["finish"]
    upper = _without_keys(upper, "finish")
    finish = _entry(case, "finishes", name, (*path, "finish"), path)
    if not finish:
        return lower, upper
    _check_kind(case, name, finish["kind"], (), upper, path)
    if isinstance(lower, dict) and lower.get("kind") == finish["kind"]:
        return lower | finish, upper
    return finish, upper


def _credibility(case: CaseFile, lower: object, upper: object, path: Path) -> tuple[object, object]:
    """Resolve ``library: NAME``, a context of use in place of that of the base."""
    if not isinstance(upper, dict) or not isinstance(upper.get("library"), str):
        return lower, upper
    context = _entry(case, "contexts", upper["library"], (*path, "library"), path)
    return context or lower, _without_keys(upper, "library")


def _loads(case: CaseFile, lower: object, upper: object, path: Path) -> tuple[object, object]:
    """Resolve ``library: NAME``, a body weight, a tilt and a history of all loads."""
    if not isinstance(upper, dict):
        return lower, upper
    set_names = upper.get("library")
    if set_names is not None:
        upper = _without_keys(upper, "library")
        if not isinstance(set_names, str | dict):
            message = f"{show(set_names)} is neither the name of a set nor names with histories"
            case.complaints.append(Fault((*path, "library"), f"{message}, e.g. {{gait: [1, 0]}}"))
            return lower, upper
        loads_of_sets = (
            _activities(case, set_names, path)
            if isinstance(set_names, dict)
            else _set(case, set_names, path)
        )
        if not loads_of_sets:
            return lower, _without_keys(upper, *MEASURED, *TIME_KEYS)
        lower = loads_of_sets
    loads = lower if isinstance(lower, dict) else {}
    if MEASURED.keys() & upper:
        lower = loads = _scaled_loads(case, loads, upper)
        upper = _without_keys(upper, *MEASURED)
    if upper.keys() >= {*TIME_KEYS}:
        message = f"the loads have a {TIME_KEYS[1]}, too; leave one of the two out"
        case.complaints.append(Fault((*path, TIME_KEYS[0]), message))
    elif isinstance(set_names, dict):
        message = "each set of `library` has a history; leave one of the two out"
        faults = [Fault((*path, key), message) for key in TIME_KEYS if _is_common(upper, key)]
        case.complaints.extend(faults)
    for key in TIME_KEYS:
        if _is_common(upper, key):
            lower = loads = _loads_with_history(case, loads, key, upper[key])
            upper = _without_keys(upper, key)
    return lower, upper


def _is_common(loads: Mapping[str, object], key: str) -> bool:
    """Return True for a history of all loads; a mapping with the name `history` is a load."""
    return key in loads and not (key == "history" and isinstance(loads[key], dict | None))


def _set(case: CaseFile, name: str, path: Path) -> dict[str, Any]:
    """Loads of a set of the library; notes the body weight for which they are."""
    loads = _entry(case, "loads", name, (*path, "library"), path)
    if loads:
        case.measured = {"sagittal_tilt": 0.0}
        if "body_weight" in loads:
            _measure(case, "body_weight", loads.pop("body_weight"))
    return loads


def _activities(case: CaseFile, history_of_set: Mapping[str, object], path: Path) -> dict[str, Any]:
    """Loads of several sets, each with its history; those of `walking` are `walking_hip` and so on.

    Sets for another body weight than that of the first are scaled to it.
    """
    loads: dict[str, Any] = {}
    weight = None
    for name, history in history_of_set.items():
        forces = _set(case, str(name), path)
        weight = weight or case.measured.get("body_weight")
        if forces and weight and "body_weight" in case.measured:
            forces = _scaled_loads(case, forces, {"body_weight": f"{weight!r} N"})
        for load, values in forces.items():
            loads[f"{name}_{load}"] = values | {"history": history}
            case.common["loads", f"{name}_{load}", "history"] = (*path, "library", name)
    return loads


def _load(case: CaseFile, lower: object, upper: object, path: Path) -> tuple[object, object]:
    """Drop the origin of a changed load: it described the former values."""
    return _without_origin(lower, upper) if isinstance(upper, dict) else lower, upper


def _cycle_table(case: CaseFile, lower: object, upper: object, path: Path) -> tuple[object, object]:
    """Resolve the name of a cycle table of the library; a file has a point in its name."""
    if isinstance(upper, str) and "." not in upper:
        return None, _entry(case, "cycle_tables", upper, path, path) or lower
    return lower, upper


def _without_origin(lower: object, upper: Mapping[str, object]) -> object:
    """Return a region or load without status and source, unless its changes need none."""
    if not isinstance(lower, dict) or upper.keys() <= KEYS_OF_USE:
        return lower
    return _without_keys(lower, *library.ORIGIN)


def _check_kind(
    case: CaseFile,
    name: str,
    kind: object,
    other_kinds: Sequence[str],
    upper: Mapping[str, object],
    path: Path,
) -> None:
    """Report a kind that is neither the library entry's nor an allowed one."""
    if upper.get("kind", kind) not in (kind, *other_kinds):
        message = f"{name} is of kind {kind}; leave `kind` out"
        case.complaints.append(Fault((*path, "kind"), message))


def _force(case: CaseFile, lower: object, upper: object, path: Path) -> tuple[object, object]:
    """Resolve a magnitude, which keeps the direction of the force below."""
    magnitude = isinstance(upper, str | int | float) and not VECTOR.fullmatch(str(upper))
    vector = isinstance(lower, list) or (isinstance(lower, str) and VECTOR.fullmatch(lower))
    if not (magnitude and vector):
        return lower, upper
    try:
        components = _vector(lower)
        size = FORCE.read(upper)
        length = hypot(*components)
        if length > 0.0 and size >= 0.0:
            return None, [f"{component * size / length!r} N" for component in components]
        reason = (
            "a magnitude cannot be negative"
            if length
            else "a force of zero has no direction to scale"
        )
        message = f"{show(upper)}: {reason}; expected a vector"
    except PydanticCustomError as error:
        message = text_of_defect(error)
    case.complaints.append(Fault(path, message))
    return None, lower


def _vector(force: object) -> list[float]:
    """Components [N] of a force as written.

    Raises:
        PydanticCustomError: It is none.
    """
    return [FORCE.read(value) for value in Triple("").entries(force)]  # type: ignore[attr-defined]


def _scaled_loads(
    case: CaseFile, loads: dict[str, object], keys: Mapping[str, object]
) -> dict[str, object]:
    """The loads with all forces scaled to a body weight and turned by a sagittal tilt."""
    measured_before = dict(case.measured)
    for key in MEASURED.keys() & keys:
        if key in measured_before and loads:
            _measure(case, key, keys[key])
        else:
            message = (
                f"no forces here depend on {key}; expected `library: NAME` in the same section"
            )
            case.complaints.append(Fault(("loads", key), message))
    measured_now = case.measured
    factor = (
        measured_now["body_weight"] / measured_before["body_weight"]
        if "body_weight" in measured_before
        else 1.0
    )
    rotation = measured_now["sagittal_tilt"] - measured_before["sagittal_tilt"]
    c, s = factor * cos(rotation), factor * sin(rotation)
    scaled_loads = dict(loads)
    for name, load in loads.items():
        if isinstance(load, dict) and "force" in load:
            with suppress(PydanticCustomError):  # reported where the load is read
                x, y, z = _vector(load["force"])
                rotated = (factor * x, c * y + s * z, c * z - s * y)
                scaled_loads[name] = load | {"force": [f"{component!r} N" for component in rotated]}
    return scaled_loads


def _loads_with_history(
    case: CaseFile, loads: dict[str, Any], key: str, value: object
) -> dict[str, Any]:
    """Return the loads of a base or a library, all with the same history or cycle table."""
    if not loads:
        message = f"this section has no loads of a library or a base; set the {key} of each load"
        case.complaints.append(Fault(("loads", key), message))
    if key == "cycle_table":
        _, value = _cycle_table(case, None, value, ("loads", key))
    other_keys = [other_key for other_key in TIME_KEYS if other_key != key]
    return {
        name: _without_keys(load, *other_keys) | {key: deepcopy(value)}
        if isinstance(load, dict)
        else load
        for name, load in loads.items()
    }


def at_common_table(fault: Fault, common: Mapping[Path, Path]) -> Fault:
    """Return a fault; if a common cycle table does not fit a force, at the key of the table.

    The same fault of several loads is then reported once.
    """
    match fault.path:
        case ("loads", name, "force") if fault.text.endswith((DIRECTION, NO_FORCE)):
            table = common.get(("loads", name, "cycle_table"))
            return fault if table is None else Fault(table, FORCES_IN_COMMON_TABLE)
    return fault


def _measure(case: CaseFile, key: str, value: object) -> None:
    """Note body weight or tilt of the loads; a fault becomes a complaint."""
    try:
        case.measured[key] = MEASURED[key].read(value)
    except PydanticCustomError as error:
        case.complaints.append(Fault(("loads", key), text_of_defect(error)))


def weight_notes(case: CaseFile) -> list[Verdict]:
    """Notes on a body weight that is rare, as one in kg is."""
    weight = case.measured.get("body_weight")
    least, largest = USUAL_WEIGHTS
    if weight is None or least <= weight <= largest:
        return []
    doubt = f"{weight:g} N is the weight of {weight / GRAVITY:.0f} kg; expected {least:g} to"
    return [note(f"{doubt} {largest:g} N", "loads.body_weight", "give newtons: 750 N for 76 kg")]


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
    known_names = [n for file in case.libraries for n in file.data.get(kind, {})]
    message = f"{show(name)} is not in the library; {kind}: {', '.join(known_names)}"
    case.complaints.append(Fault(path, message + did_you_mean(name, known_names)))
    return {}


def kind_of(data: Mapping[str, object], path: Path) -> object:
    """Kind of a mapping; regions have a default."""
    if len(path) != 2 or path[0] != "regions":
        return data.get("kind")
    return "rigid" if "rigid" in data else data.get("kind", "isotropic")


def _material(
    region: dict[str, object], entry: dict[str, object], upper_keys: dict[str, object]
) -> dict[str, object]:
    """Give a region the constants of a material; thermal ones only where there is heat.

    ``upper_keys`` are the other keys of the region above.
    """
    new_region = {k: v for k, v in region.items() if k in KEPT_REGION_KEYS}
    new_region |= {k: v for k, v in entry.items() if k in library.ORIGIN}
    conductor = "conductor" in (region.get("kind"), upper_keys.get("kind"))
    solid = not conductor and not upper_keys.get("rigid")
    if conductor:
        new_region["kind"] = "conductor"
    if solid:
        new_region |= _without_keys(entry, "thermal")
    if "thermal" in entry and ("thermal" in region or "thermal" in upper_keys):
        thermal_before, of_material = region.get("thermal"), entry["thermal"]
        thermal: dict[str, object] = {}
        if isinstance(of_material, dict):
            thermal = {k: v for k, v in of_material.items() if solid or k != "thermal_expansion"}
        if isinstance(thermal_before, dict):
            thermal |= {k: v for k, v in thermal_before.items() if k in KEPT_THERMAL_KEYS}
        new_region["thermal"] = thermal
    return new_region
