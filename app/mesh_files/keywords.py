"""Keywords of ``.inp`` files of Abaqus and CalculiX, with their options and data."""

from __future__ import annotations

import codecs
import csv
import difflib
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from app.foundation.arrays import Floats, Ints

# Keywords that make or move nodes and cells, or take them from another file.
MOVING = {"INCLUDE", "NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "IMPORT"}
MOVING |= {"IMPERFECTION", "ADJUST", "SYMMETRICMODELGENERATION"}
READ = {"NODE", "ELEMENT", "ELSET", "NSET", "SURFACE", "SOLIDSECTION", "HEADING", "PREPRINT"}
READ |= {"PART", "INSTANCE", "ASSEMBLY", "ENDPART", "ENDINSTANCE", "ENDASSEMBLY", "ENDSTEP"}
READ |= {"SYSTEM"}
# Options without a value, which may stand alone in the second line of a keyword.
FLAGS = {"GENERATE", "INTERNAL", "UNSORTED", "NOPRINT"}
# Options that name or place something. Another option with a similar name is a misspelt one.
KNOWN = {"ELSET", "NSET", "TYPE", "NAME", "SYSTEM", "COMBINE", "GENERATE", "INSTANCE", "PART"}
KNOWN |= {"MATERIAL", "ORIENTATION", "INTERNAL", "UNSORTED", "LIBRARY", "CONTROLS", "COMPOSITE"}
# Least similarity of such names, as `difflib` measures it.
SIMILAR = 0.75
# Exponents as Fortran writes them.
EXPONENT = re.compile(r"(?<=[\d.])(?:[dD]|(?=[+-]))(?=[+-]?\d)")
# Values in the line of a node: number and three coordinates; the same with a normal.
LEAST_OF_NODE = 4
MOST_OF_NODE = 7

T = TypeVar("T", int, float)


@dataclass(frozen=True)
class Keyword:
    """A keyword with its options and data.

    Attributes:
        place: Its place in the file, for messages.
        key: The keyword in capitals, without blanks.
        options: Its options by name.
        lines: Its lines of data with their numbers.
        scope: The part or instance that contains it, "" if none does.
    """

    place: str
    key: str
    options: dict[str, str]
    lines: list[tuple[int, str]]
    scope: str

    def option(self, name: str) -> str:
        """Return the value of a required option.

        Raises:
            ValueError: It is missing.
        """
        if self.options.get(name):
            return self.options[name]
        present_options = ", ".join(self.options) or "none"
        raise ValueError(f"{self.place}: has no option {name}=; its options: {present_options}")

    def fields(self, line: str) -> list[str]:
        """Return the fields of a line, separated by commas, or by blanks if it has no comma."""
        if "," not in line:
            return line.split() if '"' not in line else [line.strip().strip('"')]
        if '"' in line:
            (row,) = csv.reader([line], skipinitialspace=True)
            return [cell_text.strip() for cell_text in row]
        return [cell_text.strip() for cell_text in line.split(",")]

    def number(self, line_number: int, text: str, kind: Callable[[str], T]) -> T:
        """Return the number in a field of a line, 0 if the field is empty."""
        try:
            return kind(EXPONENT.sub("e", text) if kind is float else text) if text else kind("0")
        except ValueError:
            kind_name = "number" if kind is float else "whole number"
            raise ValueError(
                f"{self.place}: line {line_number}: {text!r} is not a {kind_name}"
            ) from None

    def coordinates(self) -> tuple[Floats, int]:
        """Return the number and coordinates of each node (n, 4), and the count of empty fields."""
        rows, empty = [], 0
        for line_number, line in self.lines:
            cell_texts = [*self.fields(line), "", "", ""][:4]
            if len(self.fields(line)) < 2 or not cell_texts[0]:
                raise ValueError(
                    f"{self.place}: line {line_number}: expected a node number and"
                    " coordinates; is the "
                    "file cut short?"
                )
            self._check_commas(line_number, line)
            empty += cell_texts.count("")
            rows.append([self.number(line_number, w, float) for w in cell_texts])
        return np.array(rows, dtype=float).reshape(-1, 4), empty

    def _check_commas(self, line_number: int, line: str) -> None:
        """Refuse commas in place of decimal points.

        A node may have its normal after its coordinates. Abaqus writes these with points.
        """
        cell_texts = [cell_text for cell_text in self.fields(line) if cell_text]
        are_integers = all(cell_text.lstrip("+-").isdigit() for cell_text in cell_texts)
        if len(cell_texts) > MOST_OF_NODE or (len(cell_texts) > LEAST_OF_NODE and are_integers):
            message = (
                f"line {line_number}: {len(cell_texts)} numbers for a node and three coordinates"
            )
            raise ValueError(f"{self.place}: {message}; write decimal points, not commas")

    def table(self, width: int) -> Ints:
        """Return the whole numbers of records, each on one line or several (n, width)."""
        rows: list[list[int]] = []
        record: list[int] = []
        line_number = 0
        for line_number, line in self.lines:
            cell_texts = self.fields(line.rstrip(", \t"))
            if "" in cell_texts:
                raise ValueError(f"{self.place}: line {line_number}: a node is missing")
            record += [self.number(line_number, w, int) for w in cell_texts]
            if len(record) > width:
                raise ValueError(
                    f"{self.place}: line {line_number}: {len(record)} numbers instead of {width}"
                )
            if len(record) == width:
                rows.append(record)
                record = []
        if record:
            message = f"{len(record)} numbers instead of {width}; is the file cut short?"
            raise ValueError(f"{self.place}: line {line_number}: {message}")
        return np.array(rows, dtype=np.int64).reshape(-1, width)


def text_of(path: Path) -> str:
    """Return the text of a file in UTF-8, UTF-16 with a byte-order mark, or Latin-1."""
    file_bytes = path.read_bytes()
    if file_bytes.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return file_bytes.decode("utf-16")
    try:
        return file_bytes.decode("utf-8-sig")
    except UnicodeDecodeError:
        return file_bytes.decode("latin-1")


def _options(place: str, words: list[str]) -> dict[str, str]:
    pairs = (word.partition("=") for word in words if word.strip())
    named = {a.strip().upper(): b.strip().strip('"').strip() for a, _, b in pairs}
    if "INPUT" in named or "OFFSET" in named:
        raise ValueError(
            f"{place}: takes numbers from another file or with an offset; export"
            " the mesh as one file"
        )
    for name in named.keys() - KNOWN:
        close = difflib.get_close_matches(name, KNOWN - named.keys(), 1, SIMILAR)
        if close:
            raise ValueError(f"{place}: has no option {name}; did you mean {close[0]}?")
    return named


def _has_options(line: str) -> bool:
    """Return True if a line that follows a keyword has more of its options."""
    first_cell = line.split(",")[0]
    return "=" in first_cell or first_cell.strip().upper() in FLAGS


def keywords(path: Path) -> Iterator[Keyword]:
    """Return the keywords of a file in their order.

    Raises:
        ValueError: It is no such file, or a keyword makes or moves nodes.
    """
    rows = enumerate(text_of(path).splitlines(), 1)
    lines = [(n, text.strip()) for n, text in rows if text.strip() and text.strip()[:2] != "**"]
    if not lines or lines[0][1][0] != "*":
        raise ValueError(
            "is not an .inp file of Abaqus or CalculiX: it does not begin with a keyword (*)"
        )
    heads = [k for k, (_, text) in enumerate(lines) if text[0] == "*"]
    scope = ""
    for head_line, next_head in zip(heads, [*heads[1:], len(lines)], strict=True):
        number, text = lines[head_line]
        first_line = head_line + 1
        while text.endswith(",") and first_line < next_head and _has_options(lines[first_line][1]):
            text += lines[first_line][1]
            first_line += 1
        (words,) = (
            csv.reader([text[1:]], quoting=csv.QUOTE_NONE)
            if '"' not in text
            else [re.findall(r'(?:[^,"]|"[^"]*")+', text[1:])]
        )
        name = " ".join(words[0].split()) if words else ""
        place, key = f"*{name} in line {number}", name.upper().replace(" ", "")
        block = Keyword(place, key, {}, lines[first_line:next_head], scope)
        if key in READ:
            block = Keyword(
                place, key, _options(place, words[1:]), lines[first_line:next_head], scope
            )
        if key in MOVING or (key == "INSTANCE" and (block.lines or "LIBRARY" in block.options)):
            raise ValueError(
                f"{place}: makes, moves or includes nodes; export the model flat, in one file "
                "without this keyword"
            )
        if key in ("PART", "INSTANCE"):
            scope = block.option("NAME").upper()
        elif key in ("ENDPART", "ENDINSTANCE"):
            scope = ""
        yield block
