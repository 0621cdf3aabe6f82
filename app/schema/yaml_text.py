"""YAML text as plain data with the line and column of each value, at bounded cost.

YAML 1.2 by ruamel.yaml's parser. Nodes are converted here, so that all duplicate keys are found at
once and aliases cannot expand without bound.
"""

from __future__ import annotations

import io
import re
import warnings
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.composer import Composer
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode
from ruamel.yaml.reader import ReaderError

from app.errors import InputError

Path = tuple[str | int, ...]
# Bounds: bytes of a file, number of values, nesting, length of a text.
LARGEST, MOST_NODES, DEEPEST, LONGEST = 4 << 20, 100_000, 50, 10_000
TOO_MANY = "too many or too deeply nested values (an alias inside itself?)"
# The only tags allowed on mappings and lists.
PLAIN_TAGS = frozenset({"tag:yaml.org,2002:map", "tag:yaml.org,2002:seq"})


class BadYaml(Exception):
    """Invalid YAML, or data that is no case; with line and column."""

    def __init__(self, text: str, place: tuple[int, int] = (1, 1)) -> None:
        self.text, self.place = text, place
        super().__init__(text)


def read_bytes(path: FilePath) -> bytes:
    """The content of a file.

    Raises:
        InputError: Missing, a folder, unreadable or too large.
    """
    try:
        with path.open("rb") as file:
            raw = file.read(LARGEST + 1)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; expected a YAML file") from None
    except (OSError, ValueError) as error:  # a null character in the name
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read: {reason}") from error
    if len(raw) > LARGEST:
        raise InputError(f"{path}: is larger than {LARGEST >> 20} MB; no case is")
    return raw


def decoded(raw: bytes) -> str:
    """Bytes as text.

    Raises:
        BadYaml: Not UTF-8.
    """
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = raw[: error.start]
        place = before.count(b"\n") + 1, error.start - before.rfind(b"\n")
        raise BadYaml(f"not UTF-8 text (byte 0x{raw[error.start]:02x})", place) from error


def compose(text: str) -> Node | None:
    """The nodes of a YAML text.

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
        hint = "; indent with spaces" if "\\t" in problem else ""
        line = "".join(text.splitlines()[place[0] - 1 : place[0]])
        if re.search(r":\s*\[[^\]]*\]\s*[A-Za-z]", line):
            hint = '; a list with one unit needs quotes: "[0, 0, -1800] N"'
        raise BadYaml(f"not valid YAML: {problem}{hint}", place) from error
    except ReaderError as error:
        before = text[: error.position]
        place = before.count("\n") + 1, error.position - before.rfind("\n")
        raise BadYaml("not valid YAML: a control character is not allowed", place) from error
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
        found: Node | None = super().compose_node(parent, index)
        return found


def place(node: Node) -> tuple[int, int]:
    """Line and column of a node, from 1."""
    return node.start_mark.line + 1, node.start_mark.column + 1


@dataclass
class Reader:
    """Converts nodes to data.

    Attributes:
        places: Line and column of each value, or of its key.
        twice: Duplicate keys, and the place of the duplicate.
    """

    places: dict[Path, tuple[int, int]] = field(default_factory=dict)
    twice: list[tuple[Path, tuple[int, int]]] = field(default_factory=list)
    _count: int = 0

    def value(self, node: Node, path: Path = (), depth: int = 0) -> Any:
        """Convert a node to data.

        Raises:
            BadYaml: Too large, nested too deeply or of an unsupported type.
        """
        here = place(node)
        self._count += 1
        if self._count > MOST_NODES or depth > DEEPEST:
            raise BadYaml(TOO_MANY, here)
        self.places.setdefault(path, here)
        if isinstance(node, ScalarNode):
            return _scalar(node)
        if str(node.tag) not in PLAIN_TAGS:
            raise BadYaml(f"the tag {node.tag} has no meaning here", here)
        if isinstance(node, SequenceNode):
            return [self.value(v, (*path, i), depth + 1) for i, v in enumerate(node.value)]
        data: dict[str, Any] = {}
        merged: list[Node] = []
        for key_node, value_node in node.value:
            if not isinstance(key_node, ScalarNode):
                raise BadYaml("a key must be a plain word", place(key_node))
            key = _text(key_node)
            if str(key_node.tag).endswith(":merge") or (key == "<<" and key_node.style is None):
                merged += value_node.value if isinstance(value_node, SequenceNode) else [value_node]
            elif key in data:
                self.twice.append(((*path, key), place(key_node)))
            else:
                self.places.setdefault((*path, key), place(key_node))
                data[key] = self.value(value_node, (*path, key), depth + 1)
        for other in merged:
            if not isinstance(other, MappingNode):
                raise BadYaml("<< needs a mapping", place(other))
            data = self.value(other, path, depth + 1) | data
        return data


def _scalar(node: ScalarNode) -> Any:
    kind = str(node.tag).rpartition(":")[2]
    if kind in ("str", "timestamp", "value"):
        return _text(node)
    if kind not in ("null", "bool", "int", "float"):
        raise BadYaml(f"the tag {node.tag} has no meaning here", place(node))
    try:
        return _SCALARS.construct_object(node)
    # A tag can mark any text as a number or a truth value.
    except (ValueError, LookupError, YAMLError) as error:
        what = "true or false" if kind == "bool" else "a number"
        raise BadYaml(f"'{_text(node)[:60]}' is not {what}", place(node)) from error


_SCALARS = YAML(typ="safe", pure=True).constructor


def _text(node: ScalarNode) -> str:
    """Text of a scalar, of bounded length and without surrogates."""
    text = str(node.value)
    if len(text) > LONGEST:
        raise BadYaml(f"a text of {len(text)} characters; at most {LONGEST}", place(node))
    if any("\ud800" <= c <= "\udfff" for c in text):
        raise BadYaml("a surrogate is no character", place(node))
    return text


def to_yaml(data: dict[str, Any]) -> str:
    """Mappings, lists and scalars as YAML that reads back to the same."""
    yaml: Any = YAML(typ="safe")
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False
    yaml.width = 1 << 20
    stream = io.StringIO()
    yaml.dump(data, stream)
    return stream.getvalue()
