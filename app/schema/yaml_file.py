"""The content of a case file: data, the place of each key, overrides, errors at their places."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field, replace
from pathlib import Path as FilePath
from typing import Any

from ruamel.yaml.nodes import MappingNode

from app.errors import GeometryError, InputError
from app.schema import yaml_text
from app.schema.yaml_text import DEEPEST, LONGEST, BadYaml

Path = yaml_text.Path
# Number of the file (from 0), line and column (from 1); or the key of an option.
Place = tuple[int, int, int] | str
# A message that begins with a key, and a step of the key.
KEYED = re.compile(r"([A-Za-z_][\w-]*(?:\.[\w-]+|\[\d+\])*): (.*)", re.DOTALL)
STEP = re.compile(r"[\w-]+")
TWICE = "this key stands here twice; keep one"
# Sorting key of what has no place in the file.
LAST = (1 << 30, 0, 0)


@dataclass(frozen=True)
class Fault:
    """One defect of the input.

    Attributes:
        path: Keys from the top to the value.
        text: The defect; what is allowed.
    """

    path: Path
    text: str


@dataclass
class CaseFile:
    """The content of a case file with the overrides applied.

    Attributes:
        name: The file as named by the user.
        data: Mappings, lists and scalars.
        places: Place of each path.
        complaints: Errors found while reading: sorting key and message.
        others: Its bases and libraries (`case.overlay`), in the order of their numbers.
        given: Values of overrides as given, by key.
        digests: SHA-256 of the parsed bytes, by file name.
    """

    name: str
    data: dict[str, Any] = field(default_factory=dict)
    places: dict[Path, Place] = field(default_factory=dict)
    complaints: list[tuple[tuple[int, int, int], str]] = field(default_factory=list)
    others: list[str] = field(default_factory=list)
    given: dict[str, Any] = field(default_factory=dict)
    digests: dict[str, str] = field(default_factory=dict)

    def put(self, holder: Any, path: Path, value: Any) -> None:
        """Put a value into the data.

        Args:
            holder: Mapping or list that gets the value.
            path: Path of the value.
            value: Mappings, lists and scalars; their places are known already.

        Raises:
            BadYaml: The value is not allowed there.
        """
        holder[path[-1]] = value

    def raise_all(self, problems: Sequence[Fault]) -> None:
        """Raise one error for all problems, in the order of the file.

        Raises:
            InputError: There is at least one problem, given or found while reading.
        """
        lines = [*self.complaints, *(self._locate(p) for p in problems)]
        if lines:
            raise InputError(list(dict.fromkeys(printable(text) for _, text in sorted(lines))))

    @contextmanager
    def placing(self) -> Iterator[None]:
        """Prefix errors that begin with a key with its place in the file.

        Raises:
            InputError: One was raised within.
            GeometryError: The same.
        """
        try:
            yield
        except GeometryError as error:
            raise GeometryError(self._placed(str(error))) from error
        except InputError as error:
            raise InputError([self._placed(m) for m in error.messages]) from error

    def _placed(self, message: str) -> str:
        """A message with its place, if it begins with a key."""
        found = KEYED.fullmatch(message)
        path = tuple(int(i) if i.isdigit() else i for i in STEP.findall(found[1])) if found else ()
        if found is None or path[0] not in self.data:
            return message
        return self._locate(Fault(path, found[2]))[1]

    def _locate(self, problem: Fault) -> tuple[tuple[int, int, int], str]:
        """Sorting key and message of a problem, at its key or the nearest one above."""
        for n in range(len(problem.path), -1, -1):
            if (place := self.places.get(problem.path[:n])) is not None:
                break
        else:
            place = (0, 1, 1)
        key = path_text(problem.path)
        if isinstance(place, str):
            inner = "" if key == place else f"{key}: "
            return LAST, f"--set {place}: {inner}{problem.text}"
        file, line, column = place
        start = f"{[self.name, *self.others][file]}:{line}:{column}: "
        return place, start + (f"{key}: {problem.text}" if key else problem.text)


def printable(text: str) -> str:
    """Escape control characters of a message and bound its length."""
    shown = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
    return shown if len(shown) <= LONGEST else f"{shown[:LONGEST]} ..."


def path_text(path: Path) -> str:
    """``("stages", 0, "name")`` as ``stages[0].name``."""
    text = ""
    for item in path:
        word = str(item) if len(str(item)) <= 100 else f"{str(item)[:96]}..."
        text += f"[{word}]" if isinstance(item, int) else f".{word}" if text else word
    return text


def at_override(message: str, places: Mapping[str, Path]) -> Fault | None:
    """Locate a message about an override in the file; None if it is about something else.

    Args:
        message: A message about the case.
        places: Path of each override in the file, by key.
    """
    for key, place in places.items():
        if message.startswith(start := f"--set {key}: "):
            return Fault(place, message.removeprefix(start))
    return None


def clashes(overrides: Iterable[str], varied: Iterable[tuple[Path, str]]) -> list[Fault]:
    """Errors for ``--set`` keys that the file varies too.

    Args:
        overrides: ``--set`` options.
        varied: Varied keys, each with the path of its list, or of a value in it.
    """
    places = {(p[:-1] if isinstance(p[-1], int) else p, key): None for p, key in varied}
    return [
        Fault(place, f"varies, but --set {given} holds for every case; leave one of them out")
        for given in dict.fromkeys(o.partition("=")[0].strip() for o in overrides)
        for place, key in places
        if all(a == b for a, b in zip(key_parts(given), key_parts(key), strict=False))
    ]


def key_parts(key: str) -> list[str]:
    """Split an override key: ``a.b[0].c`` into a, b, 0, c."""
    return re.sub(r"\[([0-9]+)\]", r".\1", key).split(".")


def read(path: FilePath, overrides: Sequence[str] = ()) -> CaseFile:
    """Read a case file and apply overrides.

    Args:
        path: The file.
        overrides: ``a.b.c=value`` each, the value in YAML.

    Raises:
        InputError: The file cannot be read or is not YAML.
    """
    case = CaseFile(str(path))
    raw = yaml_text.read_bytes(path)
    case.digests[str(path)] = hashlib.sha256(raw).hexdigest()
    reader = yaml_text.Reader()
    try:
        node = yaml_text.compose(yaml_text.decoded(raw))
        if node is None:
            raise BadYaml("the file is empty; expected a mapping with geometry, mesh, regions")
        if not isinstance(node, MappingNode):
            text = "expected a mapping with geometry, mesh, regions"
            raise BadYaml(text, yaml_text.place(node))
        case.data = reader.value(node)
    except BadYaml as error:
        line, column = error.place
        raise InputError(printable(f"{path}:{line}:{column}: {error.text}")) from error
    case.places = {key: (0, *place) for key, place in reader.places.items()}
    for key, (line, column) in reader.twice:
        text = f"{path}:{line}:{column}: {path_text(key)}: {TWICE}"
        case.complaints.append(((0, line, column), text))
    apply(case, overrides)
    return case


def changed(case: CaseFile, overrides: Sequence[str]) -> CaseFile:
    """A copy with more overrides, without reading the file again."""
    copy = replace(
        case,
        data=deepcopy(case.data),
        places=dict(case.places),
        complaints=[],
        given=dict(case.given),
    )
    apply(copy, overrides)
    return copy


def apply(case: CaseFile, overrides: Sequence[str]) -> None:
    """Apply overrides to a case; errors become complaints."""
    for override in overrides:
        try:
            _override(case, override)
        except BadYaml as error:
            place = f"--set {override.partition('=')[0]}"
            case.complaints.append((LAST, f"{path_text((place,))}: {error.text}"))


def _override(case: CaseFile, override: str) -> None:
    """Apply ``a.b[0].c=value``.

    Raises:
        BadYaml: Malformed, or it goes through something that is not a mapping or list.
    """
    key, equals, text = override.partition("=")
    key = key.strip()
    items = key_parts(key)
    if not equals or not all(items):
        raise BadYaml("expected KEY=VALUE, e.g. interfaces.stem_cement.friction_coefficient=0.3")
    if len(items) > DEEPEST:
        raise BadYaml(f"{len(items)} keys in each other; at most {DEEPEST}")
    target: Any = case.data
    path: Path = ()
    for n, item in enumerate(items):
        last = n == len(items) - 1
        step: str | int = item
        if isinstance(target, list):
            if not re.fullmatch("[0-9]{1,6}", item) or int(item) >= len(target):
                raise BadYaml(f"{path_text(path)} has entries 0 to {len(target) - 1}, not '{item}'")
            step = int(item)
        elif not isinstance(target, dict):
            raise BadYaml(f"{path_text(path)} is a single value: it has no '{item}'")
        path = (*path, step)
        if not last:
            if isinstance(target, dict) and target.get(item) is None:
                target[item] = [{}] if items[n + 1] == "0" else {}
                case.places[path] = key
            target = target[step]
    for old in [p for p in case.places if p[: len(path)] == path]:
        del case.places[old]
    case.places[path] = key
    try:
        node = yaml_text.compose(text)
    except BadYaml:
        # "[0, 0, -1] N" is no YAML without the quotes, which the shell has removed.
        if not re.fullmatch(r"\s*\[[^\[\]]*\]\s*[^\s\[\]{}].*", text):
            raise
        value: Any = text
    else:
        if node is None:  # KEY= without a value is not the null that removes an entry
            case.given[key] = target[step] = None
            return
        reader = yaml_text.Reader()
        value = reader.value(node)
        for inner, _ in reader.twice:
            raise BadYaml(f"{path_text((*path, *inner))}: {TWICE}")
        case.places |= dict.fromkeys(((*path, *inner) for inner in reader.places), key)
    case.given[key] = value
    case.put(target, path, value)
