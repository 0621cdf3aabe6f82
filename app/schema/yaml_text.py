"""Text of a YAML file to its nodes, with bounds on what it may cost."""

from __future__ import annotations

import hashlib
import io
import re
import warnings
from pathlib import Path as FilePath

from ruamel.yaml import YAML
from ruamel.yaml.composer import Composer
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import Node
from ruamel.yaml.reader import ReaderError

from app.errors import InputError

MOST_NODES = 100_000
TOO_MANY = "too many or too deeply nested values (an alias inside itself?)"
LARGEST = 4 << 20
# The longest value that means anything is an expression (app/schema/expressions.py).
LONGEST = 10_000


def printable(text: str) -> str:
    """A message on one line, without what would steer a terminal, and not endless."""
    shown = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
    return shown if len(shown) <= LONGEST else f"{shown[:LONGEST]} ..."


class BadYaml(Exception):
    """A syntax error and its place."""

    def __init__(self, text: str, place: tuple[int, int] = (1, 1)) -> None:
        """Note what is wrong, and where: line and column."""
        self.text, self.place = text, place
        super().__init__(text)


def read_text(path: FilePath) -> tuple[str, str]:
    """The text of a file, and the SHA-256 digest of its bytes.

    Raises:
        InputError: Missing, a folder, unreadable, too large or not UTF-8.
    """
    try:
        with path.open("rb") as file:
            raw = file.read(LARGEST + 1)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder; expected a YAML file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:  # a null character in the name
        raise InputError(printable(f"{path}: cannot be read: {error}")) from error
    if len(raw) > LARGEST:
        raise InputError(f"{path}: is larger than {LARGEST >> 20} MB; no case is")
    try:
        return raw.decode("utf-8-sig"), hashlib.sha256(raw).hexdigest()
    except UnicodeDecodeError as error:
        before = raw[: error.start]
        line, column = before.count(b"\n") + 1, error.start - before.rfind(b"\n")
        raise InputError(
            f"{path}:{line}:{column}: not UTF-8 text (byte 0x{raw[error.start]:02x})"
        ) from error


def compose(text: str) -> Node | None:
    """The node tree of a YAML text.

    Raises:
        BadYaml: A syntax error.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an anchor may be set again
            # Without `pure` ruamel would use libyaml, which knows YAML 1.1 only.
            yaml = YAML(typ="safe", pure=True)
            yaml.Composer = _Counting
            return yaml.compose(io.StringIO(text))
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = (mark.line + 1, mark.column + 1) if mark else (1, 1)
        problem = " ".join(str(error.problem or error.context).split())
        line = text.splitlines()[place[0] - 1 : place[0]] if mark else []
        hint = ""
        if line and re.search(r":\s*\[[^\]]*\]\s*[A-Za-z]", line[0]):
            hint = '; a list with one unit needs quotes: "[0, 0, -1800] N"'
        elif "\\t" in problem:
            hint = "; indent with spaces"
        raise BadYaml(f"not valid YAML: {problem}{hint}", place) from error
    except ReaderError as error:
        before = text[: error.position]
        line_number, column = before.count("\n") + 1, error.position - before.rfind("\n")
        raise BadYaml(
            "not valid YAML: a control character is not allowed", (line_number, column)
        ) from error
    except (YAMLError, RecursionError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else "nested too deeply"
        raise BadYaml(f"not valid YAML: {reason}") from error


class _Counting(Composer):
    """Stops at a text that is too long to be a case: reading on takes seconds per megabyte."""

    nodes = 0

    def compose_node(self, parent: Node | None, index: int) -> Node | None:
        """The next node.

        Raises:
            BadYaml: There are too many.
        """
        self.nodes += 1
        if self.nodes > MOST_NODES:
            mark = self.parser.peek_event().start_mark
            raise BadYaml(TOO_MANY, (mark.line + 1, mark.column + 1))
        found: Node | None = super().compose_node(parent, index)
        return found


def mark(node: Node) -> tuple[int, int]:
    """Line and column of a node, from 1."""
    return node.start_mark.line + 1, node.start_mark.column + 1
