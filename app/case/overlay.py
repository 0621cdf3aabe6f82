"""Merge a case with its bases, entries of a library, and overrides.

Each value keeps its place: file, line and column, also of a base or a library.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import hypot
from os.path import expanduser
from pathlib import Path as FilePath
from typing import Any

from pydantic_core import PydanticCustomError

import configs
from app.case import library
from app.errors import InputError
from app.schema import yaml_file
from app.schema.section import did_you_mean, show
from app.schema.units import FORCE
from app.schema.vectors import VECTOR, Triple
from app.schema.yaml_file import CaseFile, Fault, Path, Place
from app.schema.yaml_text import MOST_NODES, TOO_MANY, BadYaml

MOST_BASES = 10
# Keys that a region keeps when it gets another material.
OF_REGION = ("thermal", "tissue", "eigenstrains")
OF_THERMAL = ("initial_temperature", "reference_temperature", "cure")
Places = Mapping[Path, Place]
# Keys of a case alone; `AXES` are of a sweep alone.
SECTIONS = frozenset(
    "library title geometry side mesh regions interfaces supports loads heat stages time solver "
    "output variations".split()
)
STUDY_APART = "a study stands in a file of its own: base: CASE and this section; see mantle study"
AXES = frozenset({"grid", "lists", "table", "latin_hypercube", "parts"})


def read(path: FilePath, overrides: Sequence[str] = ()) -> CaseFile:
    """Merge a case file with its bases and apply overrides; the content is not checked.

    Args:
        path: The file.
        overrides: ``a.b.c=value`` each, the value in YAML.

    Raises:
        InputError: The file, a base or a library cannot be read or used.
    """
    chain = _chain(path)
    case = LayeredCase(chain[0][0].name, others=[file.name for file, _ in chain[1:]])
    for file, _ in chain:
        case.digests |= file.digests
    faults: list[Fault] = []
    for number, (file, place) in reversed(list(enumerate(chain))):
        file.data.pop("base", None)
        if (name := file.data.pop("library", None)) is not None:
            case.add(_library(file, place.parent, name), len(case.libraries))
        if number:
            _anchor(file.data, place.parent)
        above: dict[Path, Place] = {k: (number, *p[1:]) for k, p in file.places.items()}  # type: ignore[misc]
        case.complaints += [((number, *key[1:]), text) for key, text in file.complaints]  # type: ignore[misc]
        laying = _Laying(case)
        below = case.data if number < len(chain) - 1 else None
        case.data = laying.over(below, file.data, (), case.places, above)
        case.places = laying.places
        faults += laying.faults
    if faults:
        case.raise_all(faults)
    yaml_file.apply(case, overrides)
    if case.data.pop("study", None) is not None:
        case.complaints.append(case._locate(Fault(("study",), STUDY_APART)))
    return case


def is_study(data: Mapping[str, Any]) -> bool:
    """Whether a file holds a study of a case (`case.study`) instead of a case."""
    return "base" in data and bool({"set", "study"} & data.keys()) and not SECTIONS & data.keys()


def found(folder: FilePath, base: str) -> FilePath:
    """Path of a base: a file relative to a folder, or a shipped case by its name alone."""
    shipped = configs.FOLDER / f"{base}.yaml"
    word = base.replace("_", "").isalnum()  # not a path
    return shipped if word and shipped.is_file() else folder / expanduser(base)


def _chain(path: FilePath) -> list[tuple[CaseFile, FilePath]]:
    """A case and its bases, the nearest first.

    Raises:
        InputError: A file cannot be read or is no case, or the bases make a circle.
    """
    own = yaml_file.read(path)
    for what, holds in (("sweep", bool(AXES & own.data.keys())), ("study", is_study(own.data))):
        if "base" in own.data and holds:
            text = f"this is a {what} of another case, not a case; use mantle {what} {path}"
            own.raise_all([Fault(("base",), text)])
    chain = [(own, path)]
    while (base := chain[-1][0].data.get("base")) is not None:
        file, place = chain[-1]
        at = ("base",)
        if not isinstance(base, str):
            file.raise_all([Fault(at, f"{show(base)} is not text; expected a case file")])
        try:
            below = found(place.parent, base)
            seen = [p.resolve() for _, p in chain]
            if below.resolve() in seen:
                names = " -> ".join([str(p) for _, p in chain] + [base])
                file.raise_all([Fault(at, f"the bases make a circle: {names}")])
            if len(chain) > MOST_BASES:
                file.raise_all([Fault(at, f"more than {MOST_BASES} bases")])
            readable = below.is_file()
        except (OSError, RuntimeError, ValueError) as error:
            file.raise_all([Fault(at, f"{show(base)} cannot be read: {error}")])
        if not readable:
            known = sorted(p.stem for p in configs.FOLDER.glob("*.yaml"))
            hint = did_you_mean(base, known) or f"; cases by name: {', '.join(known)}"
            file.raise_all([Fault(at, f"no such file: {below}{hint}")])
        chain.append((yaml_file.read(below), below))
    return chain


def _anchor(data: Any, folder: FilePath) -> None:
    """Make paths of a base absolute, which are relative to its file."""

    def absolute(value: Any) -> Any:
        if isinstance(value, list):
            return [absolute(v) for v in value]
        return str((folder / expanduser(value)).absolute()) if isinstance(value, str) else value

    if isinstance(data, dict):
        for key, value in data.items():
            if key == "geometry" and isinstance(value, dict) and "path" in value:
                value["path"] = absolute(value["path"])
            elif key == "geometry.path":
                data[key] = absolute(value)
            _anchor(value, folder)


def _library(file: CaseFile, folder: FilePath, name: Any) -> CaseFile:
    """Read the library named by a case.

    Raises:
        InputError: It does not exist or is no library.
    """
    if not isinstance(name, str):
        file.raise_all([Fault(("library",), f"{show(name)} is not text; expected a file")])
    path = folder / expanduser(name)
    if not path.is_file():
        file.raise_all([Fault(("library",), f"no such file: {path}")])
    return library.read(path)


@dataclass
class LayeredCase(CaseFile):
    """A case merged with its bases; overrides are merged in the same way.

    Attributes:
        libraries: Files of materials and loads by name, the newest last.
        places_of: Places of the values of each library entry, by library, kind and name.
        taken: Number of values taken from libraries.
    """

    libraries: list[CaseFile] = field(default_factory=list)
    places_of: dict[Path, list[tuple[Path, Place]]] = field(default_factory=dict)
    taken: int = 0

    def add(self, file: CaseFile, at: int) -> None:
        """Insert a library among the others."""
        self.others.append(file.name)
        self.digests |= file.digests
        self.libraries.insert(at, file)
        for path, place in file.places.items():
            found = self.places_of.setdefault((file.name, *path[:2]), [])
            found.append((path[2:], (len(self.others), *place[1:])))  # type: ignore[arg-type]

    def entry(self, kind: str, name: str, path: Path) -> tuple[dict[str, Any], dict[Path, Place]]:
        """Entry of the newest library that has it, and the places of its values.

        Args:
            kind: ``materials`` or ``loads``.
            name: Its name.
            path: Its path in the case.

        Raises:
            BadYaml: No library has it.
            InputError: Too many values were taken.
        """
        if all(file.name != str(library.SHIPPED) for file in self.libraries):
            self.add(library.read(), 0)
        for file in reversed(self.libraries):
            if name in (entries := file.data.get(kind, {})):
                places = self.places_of[file.name, kind, name]
                self.taken += len(places)
                if self.taken > MOST_NODES:
                    raise InputError(f"{self.name}: {TOO_MANY}")
                values = {
                    k: v
                    for k, v in entries[name].items()
                    if k not in (library.ABOUT, library.SOURCE)
                }
                return values, {(*path, *inner): place for inner, place in places}
        known = [n for file in self.libraries for n in file.data.get(kind, {})]
        hint = did_you_mean(name, known)
        raise BadYaml(f"{show(name)} is not in the library; {kind}: {', '.join(known)}{hint}")

    def put(self, holder: Any, path: Path, value: Any) -> None:
        """Merge a value into the data; null removes the old value.

        Args:
            holder: Mapping or list that gets the value.
            path: Path of the value.
            value: Mappings, lists and scalars.

        Raises:
            BadYaml: The value is not allowed there.
        """
        step, laying = path[-1], _Laying(self)
        old = holder.get(step) if isinstance(holder, dict) else None
        match path:
            case ("base" | "library", *_):
                raise BadYaml("stands in the file alone; --set cannot change it")
            case _ if value is None and old is not None:
                del holder[step]
                return
            case _ if not isinstance(holder, dict):
                holder[step] = value
                return
            case ("regions", _, "material") | ("loads", "library") if isinstance(value, str):
                new = laying.over(holder, {step: value}, path[:-1], self.places, self.places)
            case ("loads", _, "force"):
                new = {step: laying.over(old, value, path, self.places, self.places)}
            case ("regions" | "loads",) | ("regions", _):
                new = {step: laying.over(None, value, path, {}, self.places)}
            case _:
                holder[step] = value
                return
        if laying.faults:
            raise BadYaml(laying.faults[0].text)
        if step not in new:
            holder.clear()
        holder.update(new)
        self.places |= laying.places


class _Laying:
    """Merges the content of a file over that of its bases."""

    def __init__(self, case: LayeredCase) -> None:
        self._case = case
        self.places: dict[Path, Place] = {}
        self.faults: list[Fault] = []

    def over(self, lower: Any, upper: Any, path: Path, below: Places, above: Places) -> Any:
        """Merge one value over another.

        Args:
            lower: Value of the bases; None if there is none.
            upper: Value over it.
            path: Path of both.
            below: Places of the paths of `lower`.
            above: Places of the paths of `upper`.
        """
        if (place := above.get(path)) is not None:
            self.places[path] = place
        match path:
            case ("loads", _, "force"):
                return self._force(lower, upper, path, above)
            case ("regions", _) | ("loads",) if isinstance(upper, dict):
                lower, upper, below = self._named(lower, upper, path, below, above)
        if not isinstance(upper, dict):
            return self._kept(upper, path, above)
        if isinstance(lower, dict) and _kind(lower, path) != _kind(upper, path) and "kind" in upper:
            lower = None
        known = lower if isinstance(lower, dict) else {}
        result = {}
        for key, value in known.items():
            inner = (*path, key)
            if key not in upper:
                result[key] = self._kept(value, inner, below)
            elif upper[key] is not None:
                result[key] = self.over(value, upper[key], inner, below, above)
        for key in upper.keys() - known.keys():
            inner = (*path, key)
            if upper[key] is None and lower is not None:
                hint = did_you_mean(key, list(known))
                self._wrong(inner, f"there is nothing to remove{hint}", above)
        for key, value in upper.items():
            if key not in known and (value is not None or lower is None):
                result[key] = self.over(None, value, (*path, key), below, above)
        return result

    def _kept(self, value: Any, path: Path, places: Places) -> Any:
        """Return a value unchanged and keep its places."""
        if (place := places.get(path)) is not None:
            self.places[path] = place
        if isinstance(value, dict):
            return {k: self._kept(v, (*path, k), places) for k, v in value.items()}
        if isinstance(value, list):
            return [self._kept(v, (*path, i), places) for i, v in enumerate(value)]
        return value

    def _wrong(self, path: Path, text: str, places: Places) -> None:
        """Add a fault, and its place even if the result does not have the path."""
        self.faults.append(Fault(path, text))
        if (place := places.get(path)) is not None:
            self.places[path] = place

    def _force(self, lower: Any, upper: Any, path: Path, above: Places) -> Any:
        """The upper force; a magnitude alone keeps the direction of the lower one."""
        magnitude = isinstance(upper, str | int | float) and not VECTOR.fullmatch(str(upper))
        vector = isinstance(lower, list) or (isinstance(lower, str) and VECTOR.fullmatch(lower))
        if magnitude and vector:
            try:
                parts = [FORCE.read(value) for value in Triple("").spread(lower)]  # type: ignore[attr-defined]
                size, length = FORCE.read(upper), hypot(*parts)
            except PydanticCustomError as error:
                self._wrong(path, (error.context or {})["text"], above)
            else:
                if length > 0.0 and size >= 0.0:
                    return [f"{part * size / length!r} N" for part in parts]
                why = (
                    "a magnitude is not negative" if length else "a force of zero has no direction"
                )
                self._wrong(path, f"{show(upper)}: {why}; expected a vector", above)
        return self._kept(upper, path, above)

    def _named(
        self, lower: Any, upper: dict[str, Any], path: Path, below: Places, above: Places
    ) -> tuple[Any, dict[str, Any], Places]:
        """Replace the lower value by the library entry that `upper` names."""
        key, kind = ("library", "loads") if len(path) == 1 else ("material", "materials")
        name, inner = upper.get(key), (*path, key)
        if not isinstance(name, str):
            return lower, upper, below
        rest = {k: v for k, v in upper.items() if k != key}
        try:
            entry, places = self._case.entry(kind, name, path)
        except BadYaml as error:
            self._wrong(inner, error.text, above)
            return lower, rest, below
        if kind == "materials":
            kind = rest.get("kind", "conductor")
            if kind not in ("conductor", own := _kind(entry, path)):
                self._wrong((*path, "kind"), f"{name} is of kind {own}; leave kind out", above)
            entry = _material(lower if isinstance(lower, dict) else {}, entry, rest)
        return entry, rest, ChainMap(places, below)  # type: ignore[arg-type]


def _kind(data: Mapping[str, Any], path: Path) -> Any:
    """Kind of a mapping; regions have a default."""
    if len(path) != 2 or path[0] != "regions":
        return data.get("kind")
    return "rigid" if "rigid" in data else data.get("kind", "isotropic")


def _material(
    region: dict[str, Any], entry: dict[str, Any], rest: dict[str, Any]
) -> dict[str, Any]:
    """Give a region the constants of a material, those of heat only where there is heat.

    Args:
        region: The region below.
        entry: The material.
        rest: Other keys of the region above.
    """
    new = {k: v for k, v in region.items() if k in OF_REGION}
    conductor = "conductor" in (region.get("kind"), rest.get("kind"))
    solid = not conductor and not rest.get("rigid")
    if conductor:
        new["kind"] = "conductor"
    if solid:
        new |= {k: v for k, v in entry.items() if k != "thermal"}
    if "thermal" in entry and ("thermal" in region or "thermal" in rest):
        old = region.get("thermal")
        own = {k: v for k, v in old.items() if k in OF_THERMAL} if isinstance(old, dict) else {}
        data = {k: v for k, v in entry["thermal"].items() if solid or k != "thermal_expansion"}
        new["thermal"] = data | own
    return new
