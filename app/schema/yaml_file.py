"""YAML files as data with the place of each value, and errors at their places.

YAML 1.2 by ruamel.yaml's parser. Nodes are converted here, so that all duplicate keys are found at
once and aliases cannot expand without bound.
"""

from __future__ import annotations

import hashlib
import io
import re
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path as FilePath
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.composer import Composer
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode
from ruamel.yaml.reader import ReaderError

from app.foundation.errors import GeometryError, InputError
from app.foundation.verdict import Reason, Severity, Verdict

Path = tuple[str | int, ...]
# Values by key, as a file has them: text, numbers, truth values, None, lists and mappings.
YamlMapping = dict[str, Any]
# Name of the file, line and column (from 1); or the key of an option.
Place = tuple[str, int, int] | str
# Largest file [bytes].
LARGEST = 4 << 20
# Largest number of values of a file.
MOST_NODES = 100_000
# Deepest nesting of values.
DEEPEST = 50
# Longest text of a value or a message [characters].
LONGEST_TEXT = 10_000
TOO_MANY = "too many or too deeply nested values (an alias inside itself?)"
# The only tags allowed on mappings and lists.
PLAIN_TAGS = frozenset({"tag:yaml.org,2002:map", "tag:yaml.org,2002:seq"})
# A message that begins with a key.
KEYED = re.compile(r"([A-Za-z_][\w-]*(?:\.[\w-]+|\[\d+\])*): (.*)", re.DOTALL)
# Faults of a syntax that beginners meet: part of the parser's message -> the text in its place.
FAULTS = {
    "\\t": "a tab; indent with spaces, two for each level",
    "mapping values are not allowed": "no key can stand here; keys of one section begin in one "
    "column, and text with a colon needs quotes",
    "<block end>": "this line is indented neither as the lines above nor as a section below them; "
    "keys of one section begin in one column",
}
# Sorting key of what has no place in a file.
LAST = (1 << 30, 0, 0)


# Place holder in a message for the section that contains the section of its key.
SECTION_ABOVE = "the section above"
# Beginning of messages on names that a geometry does not have.
NOT_IN_GEOMETRY = "the geometry ("
# Sections that cause no faults of others.
UNCHANGING = (("base",), ("title",), ("output",), ("mantle",))
# Largest number of keys that are named as a cause.
MOST_CAUSES = 4


@dataclass(frozen=True)
class Fault:
    """One defect of the input.

    Attributes:
        path: Keys from the top to the value.
        text: The defect; what is allowed.
        place: Place, if it differs from that of the path; "" if the text names it.
        remedy: Allowed values or the remedy, if the text does not say it.
        code: Reason, for programs.
        section: Section beside an unknown key in which the key is valid; empty if there is none.
    """

    path: Path
    text: str
    place: Place | None = None
    remedy: str = ""
    code: Reason | None = None
    section: str = ""


class BadYaml(Exception):
    """Invalid YAML, or data that is no case; with line and column."""

    def __init__(self, text: str, place: tuple[int, int] = (1, 1)) -> None:
        self.text, self.place = text, place
        super().__init__(text)


@dataclass
class CaseFile:
    """The content of a YAML file, or of a case with its bases and overrides (`case.overlay`).

    Attributes:
        name: The file as named by the user.
        data: Mappings, lists and scalars.
        places: Place of each path.
        complaints: Errors of reading, merging and overriding.
        incomplete: Paths of sections that complaints leave incomplete: more errors may be false.
        notes: Notes on what was read, such as former names of keys.
        given: Values of overrides as given, by key.
        digests: SHA-256 of the file, its bases and libraries, by name.
        libraries: Files of materials and loads by name, the newest last.
        tissues: Tissue of the library's material of each region that has one.
        common: Path of the key of all loads that gave a load its value, by the path of the value.
        measured: Body weight [N], if it is known, and sagittal tilt [rad] of the loads, by key.
        option: Text before the key of an override in messages.
    """

    name: str
    data: YamlMapping = field(default_factory=dict)
    places: dict[Path, Place] = field(default_factory=dict)
    complaints: list[Fault] = field(default_factory=list)
    incomplete: set[Path] = field(default_factory=set)
    notes: list[Verdict] = field(default_factory=list)
    given: dict[str, object] = field(default_factory=dict)
    digests: dict[str, str] = field(default_factory=dict)
    libraries: list[CaseFile] = field(default_factory=list)
    tissues: dict[str, str] = field(default_factory=dict)
    common: dict[Path, Path] = field(default_factory=dict)
    measured: dict[str, float] = field(default_factory=lambda: {"sagittal_tilt": 0.0})
    option: str = "--set "

    def raise_all(self, problems: Sequence[Fault]) -> None:
        """Raise one error for all problems, in the order of the file.

        Raises:
            InputError: There is at least one problem, given or a complaint of reading.
        """
        located = map(self._locate, (*self.complaints, *problems))
        verdicts = sorted(located, key=lambda pair: (pair[0], pair[1].text))
        if verdicts:
            raise InputError(list(dict.fromkeys(verdict for _, verdict in verdicts)))

    @contextmanager
    def placing(self) -> Iterator[None]:
        """Prefix errors that begin with a key with its place in the file.

        Raises:
            InputError: One was raised within.
            GeometryError: The same.
        """
        try:
            yield
        except (GeometryError, InputError) as error:
            raise type(error)([self._placed(v) for v in error.verdicts]) from error

    def _placed(self, verdict: Verdict) -> Verdict:
        """An error with its place in the file, if it begins with a key."""
        full_text = f"{verdict.where}: {verdict.what}" if verdict.where else verdict.what
        keyed = KEYED.fullmatch(full_text)
        if not keyed or verdict.severity is Severity.NOTE:
            return verdict
        path = tuple(int(i) if i.isdigit() else i for i in key_parts(keyed[1]))
        if path[0] not in self.data:
            return verdict
        fault = Fault(path, keyed[2], remedy=verdict.remedy, code=verdict.code)
        return self._locate(fault)[1]

    def _locate(self, fault: Fault) -> tuple[tuple[int, int, int], Verdict]:
        """Sorting key and verdict of a fault, at its key or the nearest one above."""
        fault = replace(fault, text=fault.text.replace(SECTION_ABOVE, path_text(fault.path[:-2])))
        verdict = Verdict(printable(fault.text), remedy=fault.remedy, code=fault.code)
        if fault.place == "":
            return LAST, verdict
        path = self._given_path(fault.path)
        text, place = self._explained(fault, path)
        key = path_text(path)
        of_key = f": {key}" if key and key != place else ""
        if isinstance(place, str):
            if fault.section:
                # There are no lines to indent.
                full_key = path_text((*path[:-1], fault.section, path[-1]))
                text = f"unknown key; expected {full_key}"
            where = printable(f"{self.option}{path_text((place,))}{of_key}")
            return LAST, replace(verdict, what=printable(text), where=where)
        file, line, column = place
        where = printable(f"{file}:{line}:{column}{of_key}")
        order = [self.name, *self.digests].index(file)
        return (order, line, column), replace(verdict, what=printable(text), where=where)

    def _explained(self, fault: Fault, path: Path) -> tuple[str, Place]:
        """Text of a fault with its likely cause, and its place: in a file, or key of an option."""
        place = fault.place or self._nearest_place(path)
        if isinstance(place, str):
            return fault.text, place
        kinds = [self.places.get((*p, "kind")) for p in (path[:-1], path)]
        option = next((kind for kind in kinds if isinstance(kind, str)), None)
        if option:
            # An option changed the kind of a section of the file, whose other keys stay.
            section = option.rpartition(".")[0]
            change = f"{self.option}'{section}={{kind: ...}}' replaces the whole section"
            return f"{fault.text}; {change}", option
        if fault.place:
            return fault.text, place
        is_in_base = place[0] != self.name
        options = self._overrides_beside(path)
        changes = [f"{self.option}{key}" for key in options]
        if is_in_base:
            changes += self._changes_of_base(path)
        if changes and path in self.places:
            return fault.text + _question(changes), place
        if options:
            # No file gives the value, but an option gave another one that does not fit.
            return fault.text, options[-1]
        text = fault.text
        if is_in_base:
            if fault.path == path and len(path) == 2 and text.startswith(NOT_IN_GEOMETRY):
                text += f"; remove it by `{path[0]}: {{{path[1]}: null}}`"
            text += _question(self._causes(text))
        return text, place

    def _nearest_place(self, path: Path) -> Place:
        """Place of a value, else of the nearest section above it, else the start of the file."""
        above = (path[:n] for n in range(len(path), -1, -1))
        return next((self.places[p] for p in above if p in self.places), (self.name, 1, 1))

    def _overrides_beside(self, path: Path) -> list[str]:
        """Keys of the overrides of the section that has a path."""
        section = _section(path)
        if not section:
            return []
        parts = [str(key) for key in section]
        return [key for key in self.given if key_parts(key)[: len(parts)] == parts]

    def _changes_of_base(self, path: Path) -> list[str]:
        """Values of the file in the section that has a path of its base, with their places."""
        section = _section(path)
        if not section:
            return []
        sections_above = {key[:-1] for key in self.places}
        changes = list[str]()
        for key, place in self.places.items():
            is_value = key[: len(section)] == section and key not in sections_above
            if is_value and place[0] == self.name and not isinstance(place, str):
                _, line, column = place
                changes.append(f"{path_text(key)} ({self.name}:{line}:{column})")
        return changes

    def _causes(self, text: str) -> list[str]:
        """Keys of the file, with their places, that may cause a fault of its base.

        They are those that the text of the fault names, else all if they are few, else none.
        """
        own = [key for key, place in self.places.items() if place[0] == self.name]
        sections_above = {key[:-1] for key in own}
        paths = [
            key[: next((n for n, part in enumerate(key) if isinstance(part, int)), len(key))]
            for key in own
            if key not in sections_above and key[:1] not in UNCHANGING
        ]
        words = re.findall(r"\w+", re.sub(r"`[^`]*`", "", text))
        named_depths = {path: _named_depth(path, words) for path in paths}
        named_paths = [path[:depth] for path, depth in named_depths.items() if depth]
        if not named_paths:
            # Several keys of one section are named by their section.
            counts = Counter(path[:-1] for path in dict.fromkeys(paths))
            paths = [path[:-1] if counts[path[:-1]] > 1 else path for path in paths]
        changed_paths = list(dict.fromkeys(named_paths or paths))
        if len(changed_paths) > MOST_CAUSES:
            return []
        causes = list[str]()
        for path in changed_paths:
            place = self.places[path]
            if not isinstance(place, str):
                causes.append(f"{path_text(path)} ({self.name}:{place[1]}:{place[2]})")
        return causes

    def _given_path(self, path: Path) -> Path:
        """Path at which the file gives a value: that of the common key, if one gave it."""
        for n in range(1, len(path) + 1):
            if path[:n] in self.common:
                return (*self.common[path[:n]], *path[n:])
        return path


def _question(causes: Sequence[str]) -> str:
    """Question at the end of a message whether a value fits its likely causes."""
    return f"; does it fit {', '.join(causes)}?" if causes else ""


def _named_depth(path: Path, words: Sequence[str]) -> int:
    """Number of the keys of a path up to the last one that words of a text name; 0: none."""
    depth = 0
    for n, part in enumerate(path[1:], 2):
        names = {str(part), *(word for word in words if word.startswith(f"{part}_"))}
        if names.intersection(words):
            depth = n
    return depth


def _section(path: Path) -> Path:
    """The geometry, or the named section, that has a path; empty if the path is above it."""
    depth = 1 if path[:1] == ("geometry",) else 2
    return path[:depth] if len(path) >= depth else ()


def printable(text: str) -> str:
    """Escape control characters of a message and bound its length."""
    printable_text = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
    return (
        printable_text
        if len(printable_text) <= LONGEST_TEXT
        else f"{printable_text[:LONGEST_TEXT]} ..."
    )


def path_text(path: Path) -> str:
    """``("stages", 0, "name")`` as ``stages[0].name``."""
    joined_text = ""
    for path_part in path:
        part_text = str(path_part) if len(str(path_part)) <= 100 else f"{str(path_part)[:96]}..."
        joined_text += (
            f"[{part_text}]"
            if isinstance(path_part, int)
            else f".{part_text}"
            if joined_text
            else part_text
        )
    return joined_text


def key_parts(key: str) -> list[str]:
    """Split an override key: ``a.b[0].c`` into a, b, 0, c."""
    return re.sub(r"\[([0-9]+)\]", r".\1", key).split(".")


# ---------------------------------------------------------------------------------- reading


def read(path: FilePath) -> CaseFile:
    """Read a file.

    Raises:
        InputError: The file cannot be read or is not YAML.
    """
    try:
        with path.open("rb") as file:
            file_bytes = file.read(LARGEST + 1)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; expected a YAML file") from None
    except (OSError, ValueError) as error:  # a null character in the name
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read: {reason}") from error
    if len(file_bytes) > LARGEST:
        raise InputError(f"{path}: is larger than {LARGEST >> 20} MB, too large for a case file")
    case = CaseFile(str(path), digests={str(path): hashlib.sha256(file_bytes).hexdigest()})
    try:
        node = compose(file_bytes.decode("utf-8-sig", errors="surrogateescape"))
        if not isinstance(node, MappingNode):
            empty = "" if node else "the file is empty; "
            message = f"{empty}expected a mapping with geometry, mesh, regions"
            raise BadYaml(message, _start(node) if node else (1, 1))
        case.data = Reader(case).value(node)
    except BadYaml as error:
        case.complaints.clear()  # duplicates before it
        case.raise_all([Fault((), error.text, (case.name, *error.place))])
    return case


@lru_cache(maxsize=64)
def compose(text: str) -> Node | None:
    """The nodes of a YAML text; bytes that are not UTF-8 are surrogates.

    The cases of a sweep take a base and a library again and again. Parsing these once makes the
    check of 24 cases five times faster.

    Raises:
        BadYaml: A syntax error.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # anchors may be redefined
            # Without `pure` ruamel would use libyaml, which knows YAML 1.1 only.
            yaml = YAML(typ="safe", pure=True)
            yaml.Composer = _Counting
            return yaml.compose(io.StringIO(text))
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = (mark.line + 1, mark.column + 1) if mark else (1, 1)
        problem = " ".join(str(error.problem or error.context).split())
        problem = next((text for part, text in FAULTS.items() if part in problem), problem)
        line = "".join(text.splitlines()[place[0] - 1 : place[0]])
        if re.search(r":\s*\[[^\]]*\]\s*[A-Za-z]", line):
            problem = 'a list with one unit needs quotes: "[0, 0, -1800] N"'
        raise BadYaml(f"not valid YAML: {problem}", place) from error
    except ReaderError as error:
        text_before, code = text[: error.position], ord(text[error.position])
        reason = "not valid YAML: a control character is not allowed"
        if 0xDC80 <= code <= 0xDCFF:
            reason = f"not UTF-8 text (byte 0x{code - 0xDC00:02x})"
        place = text_before.count("\n") + 1, error.position - text_before.rfind("\n")
        raise BadYaml(reason, place) from error
    except (YAMLError, RecursionError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else "nested too deeply"
        raise BadYaml(f"not valid YAML: {reason}") from error


class _Counting(Composer):
    """Stops at too many nodes: parsing takes seconds per megabyte."""

    nodes = 0

    def compose_node(self, parent: Node | None, index: int) -> Node | None:
        self.nodes += 1
        if self.nodes > MOST_NODES:
            mark = self.parser.peek_event().start_mark
            raise BadYaml(TOO_MANY, (mark.line + 1, mark.column + 1))
        node: Node | None = super().compose_node(parent, index)
        return node


def _start(node: Node) -> tuple[int, int]:
    """Line and column of a node, from 1."""
    return node.start_mark.line + 1, node.start_mark.column + 1


@dataclass
class Reader:
    """Converter of YAML nodes to data, which records in a file where each value stands.

    A value stands at a line and column of the file, or in the option that gave it.

    Attributes:
        option: Key of this option; empty for a file.
    """

    file: CaseFile
    option: str = ""
    _count: int = 0

    def value(self, node: Node, path: Path = (), depth: int = 0) -> Any:
        """Convert a node to data.

        Raises:
            BadYaml: Too large, nested too deeply or of an unsupported type.
        """
        self._count += 1
        if self._count > MOST_NODES or depth > DEEPEST:
            raise BadYaml(TOO_MANY, _start(node))
        self.file.places.setdefault(path, self._place(node))
        if isinstance(node, ScalarNode):
            return _scalar(node)
        if str(node.tag) not in PLAIN_TAGS:
            raise BadYaml(f"the YAML tag {node.tag} is not supported; leave it out", _start(node))
        if isinstance(node, SequenceNode):
            return [self.value(v, (*path, i), depth + 1) for i, v in enumerate(node.value)]
        data: YamlMapping = {}
        merged: list[Node] = []
        for key_node, value_node in node.value:
            if not isinstance(key_node, ScalarNode):
                raise BadYaml("a key must be a plain word", _start(key_node))
            key, place = _text(key_node), self._place(key_node)
            inner = (*path, key)
            if str(key_node.tag).endswith(":merge") or (key == "<<" and key_node.style is None):
                merged += value_node.value if isinstance(value_node, SequenceNode) else [value_node]
            elif key in data:
                twice = "this key is given twice; keep one"
                self.file.complaints.append(Fault(inner, twice, place))
            else:
                self.file.places.setdefault(inner, place)
                data[key] = self.value(value_node, inner, depth + 1)
        for merged_mapping in merged:
            if not isinstance(merged_mapping, MappingNode):
                raise BadYaml("<< needs a mapping", _start(merged_mapping))
            data = self.value(merged_mapping, path, depth + 1) | data
        return data

    def _place(self, node: Node) -> Place:
        return self.option or (self.file.name, *_start(node))


def _scalar(node: ScalarNode) -> object:
    kind = str(node.tag).rpartition(":")[2]
    if kind in ("str", "timestamp", "value"):
        return _text(node)
    if kind not in ("null", "bool", "int", "float"):
        raise BadYaml(f"the YAML tag {node.tag} is not supported; leave it out", _start(node))
    try:
        return _SCALARS.construct_object(node)
    # A tag can mark any text as a number or a truth value.
    except (ValueError, LookupError, YAMLError) as error:
        expected_value = "true or false" if kind == "bool" else "a number"
        raise BadYaml(f"'{_text(node)[:60]}' is not {expected_value}", _start(node)) from error


_SCALARS = YAML(typ="safe", pure=True).constructor


def _text(node: ScalarNode) -> str:
    """Text of a scalar, of bounded length and without surrogates."""
    text = str(node.value)
    if len(text) > LONGEST_TEXT:
        raise BadYaml(
            f"the text has {len(text)} characters; at most {LONGEST_TEXT} are allowed", _start(node)
        )
    if any("\ud800" <= c <= "\udfff" for c in text):
        raise BadYaml(
            "the text contains half a character (a surrogate); save the file as UTF-8",
            _start(node),
        )
    return text


def to_yaml(data: dict[str, object], *, short: bool = False) -> str:
    """Mappings, lists and scalars as YAML that reads back to the same.

    Args:
        data: Keys and values.
        short: Write lists and mappings of scalars on one line.
    """
    yaml: Any = YAML(typ="safe")
    yaml.default_flow_style = None if short else False
    yaml.sort_base_mapping_type_on_output = False
    yaml.width = 1 << 20
    stream = io.StringIO()
    yaml.dump(data, stream)
    return stream.getvalue()
