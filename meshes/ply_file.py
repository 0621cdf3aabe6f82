"""Faces of PLY files, text or binary, with the elements and properties that the header lists.

The element ``vertex`` has x, y, z; ``face`` has the list ``vertex_indices`` or ``vertex_index``.
Other elements and properties are skipped by their declared size.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from app.foundation.arrays import Floats
from app.foundation.errors import GeometryError
from meshes.polygons import corners_of

# Letters of numpy for the names of types in a header.
TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
CORNERS = ("vertex_indices", "vertex_index")
AXES = ("x", "y", "z")
END = re.compile(rb"(?:^|[\r\n])end_header[ \t]*(\r\n|\n|\r)")


@dataclass(frozen=True)
class Property:
    """A property of an element: a number, or a list of numbers after their count."""

    name: str
    type: str
    count_type: str = ""


@dataclass(frozen=True)
class Element:
    """Rows of the same properties, such as all vertices."""

    name: str
    rows: int
    properties: tuple[Property, ...]

    @property
    def has_lists(self) -> bool:
        """True if rows may have different lengths."""
        return any(p.count_type for p in self.properties)


class _Damaged(Exception):
    """Header or data are damaged; the message says how."""


def read(path: Path) -> tuple[Floats, list[str]]:
    """Return corners of triangles (m, 3, 3) in the file's unit, and notes on what was read.

    Raises:
        GeometryError: The file is cut short or damaged, or has no faces.
    """
    data = path.read_bytes()
    try:
        order, elements, start = _header(data)
        read_element = _text(data, start) if not order else _binary(data, start, order)
        columns = {element.name: read_element(element) for element in elements}
        read_element(None)
        names = ", ".join(element.name for element in elements)
        if "tristrips" in columns and "face" not in columns:
            raise _Damaged("its triangles are strips (element tristrips); save it as faces")
        if "vertex" not in columns or "face" not in columns:
            raise _Damaged(f"has no faces; its elements are {names or 'none'}")
        vertex = columns["vertex"]
        missing = {"x", "y", "z"} - vertex.keys()
        if missing:
            raise _Damaged(f"its vertices have no {', '.join(sorted(missing))}")
        corners = next((columns["face"][name] for name in CORNERS if name in columns["face"]), None)
        if corners is None:
            kinds = ", ".join(columns["face"])
            raise _Damaged(f"its faces have no list {CORNERS[0]}; they have {kinds}")
    except _Damaged as error:
        raise GeometryError(f"{path}: {error}") from None
    with np.errstate(invalid="ignore"):  # of damaged numbers
        points = np.stack([np.asarray(vertex[axis], float) for axis in "xyz"], axis=1)
    found, notes = corners_of(path, points, corners, lambda k: f"face {k + 1:,}")
    kind = "text" if not order else "binary"
    left = [e.name for e in elements if e.name not in ("vertex", "face") and e.rows]
    if left:
        notes.append(f"elements that are not read: {', '.join(left)}")
    return found, [f"{len(corners):,} faces of a {kind} PLY file", *notes]


def _header(data: bytes) -> tuple[str, list[Element], int]:
    """Return the byte order (empty for text), the elements, and the byte at which rows begin."""
    end = END.search(data[:1_000_000])
    if not data.lstrip(b"\xef\xbb\xbf").startswith(b"ply") or not end:
        raise _Damaged("is no PLY file, or is cut short: it has no header up to `end_header`")
    order, elements = None, []

    def known(*types: str) -> bool:
        return TYPES.keys() >= {*types}

    for line in re.split(r"[\r\n]+", data[: end.start()].decode("latin-1")):
        match line.split():
            case ["format", name, *_] if name in ORDERS:
                order = ORDERS[name]
            case ["element", name, count] if count.isdecimal() and len(count) < 16:
                elements.append(Element(name, int(count), ()))
            case ["property", "list", count, kind, name] if elements and known(count, kind):
                if TYPES[count][0] == "f":
                    raise _Damaged(f"header: `{line.strip()[:60]}`: a list is counted in integers")
                if name in AXES:
                    raise _Damaged(f"header: `{line.strip()[:60]}`: a coordinate is one number")
                _add(elements, Property(name, TYPES[kind], TYPES[count]))
            case ["property", kind, name] if elements and known(kind):
                _add(elements, Property(name, TYPES[kind]))
            case [word, *_] if word in ("format", "element", "property"):
                raise _Damaged(f"header: `{line.strip()[:60]}` cannot be read")
    if order is None:
        raise _Damaged("header: it has no line `format`")
    names = [element.name for element in elements]
    if len(set(names)) < len(names):
        raise _Damaged("header: an element is there twice")
    return order, elements, end.end()


def _add(elements: list[Element], new: Property) -> None:
    """Append a property to the last element."""
    last = elements[-1]
    elements[-1] = Element(last.name, last.rows, (*last.properties, new))


Columns = dict[str, Any]
Reader = Callable[[Element | None], Columns]


def _short(element: Element, rows: int) -> _Damaged:
    """Return the error on an element with fewer rows than its header says."""
    text = f"element {element.name} has {element.rows:,} rows in the header"
    return _Damaged(f"is cut short or damaged: {text}, and {rows:,} are there")


def _text(data: bytes, start: int) -> Reader:
    """Return the reader of the next element of a text file; with None it expects the end."""
    words, at = data[start:].decode("latin-1").split(), 0

    def lists(element: Element) -> Columns:
        nonlocal at
        columns: Columns = {p.name: [] for p in element.properties}
        for row in range(element.rows):
            for p in element.properties:
                try:
                    count = int(words[at]) if p.count_type else 1
                    at += bool(p.count_type)
                    if count < 0 or at + count > len(words):
                        raise IndexError
                    values = words[at : at + count]
                    if p.name in CORNERS:
                        columns[p.name].append([int(value) for value in values])
                    elif p.name in AXES and not p.count_type:
                        columns[p.name].append(float(values[0]))
                    at += count
                except IndexError:
                    raise _short(element, row) from None
                except ValueError:
                    text = f"row {row + 1:,} of element {element.name}"
                    raise _Damaged(f"{text}: a corner or count is no whole number") from None
        return columns

    def numbers(element: Element) -> Columns:
        nonlocal at
        width = len(element.properties)
        there = (len(words) - at) // width if width else element.rows
        if there < element.rows:
            raise _short(element, there)
        here = words[at : at + width * element.rows]
        at += len(here)
        columns: Columns = {}
        for k, p in enumerate(element.properties):
            if p.name in AXES:
                try:
                    columns[p.name] = [float(word) for word in here[k::width]]
                except ValueError as error:
                    raise _Damaged(f"element {element.name}: {error}") from None
        return columns

    def next_element(element: Element | None) -> Columns:
        if element is None:
            if at < len(words):
                text = f"{len(words) - at:,} words follow the rows that its header counts"
                raise _Damaged(f"is damaged: {text}")
            return {}
        return lists(element) if element.has_lists else numbers(element)

    return next_element


def _binary(data: bytes, start: int, order: str) -> Reader:
    """Return the reader of the next element of a binary file; with None it expects the end."""
    at = start

    def fixed(element: Element, sizes: tuple[int, ...]) -> Columns | None:
        """Return the columns if all rows have lists of these lengths, else None."""
        nonlocal at
        fields: list[tuple[Any, ...]] = []
        for k, (p, size) in enumerate(zip(element.properties, sizes, strict=True)):
            if p.count_type:
                fields.append((f"count {k}", order + p.count_type))
            shape = ((size,),) if p.count_type else ()
            fields.append((f"value {k}", order + p.type, *shape))
        row = np.dtype(fields)
        there = (len(data) - at) // row.itemsize
        if there < element.rows:
            if element.has_lists:
                return None
            raise _short(element, there)
        rows = np.frombuffer(data, row, element.rows, at)
        for k, (p, size) in enumerate(zip(element.properties, sizes, strict=True)):
            if p.count_type and (rows[f"count {k}"] != size).any():
                return None
        at += row.itemsize * element.rows
        return {p.name: rows[f"value {k}"] for k, p in enumerate(element.properties)}

    def values(kind: str, count: int, place: int) -> Any:
        """Return the numbers at a byte; raise IndexError beyond the end."""
        step = int(kind[1:])
        if count < 0 or place + count * step > len(data):
            raise IndexError
        return np.frombuffer(data, order + kind, count, place)

    def lists(element: Element) -> Columns:
        nonlocal at
        columns: Columns = {p.name: [] for p in element.properties}
        for row in range(element.rows):
            try:
                for p in element.properties:
                    count = 1
                    if p.count_type:
                        count = int(values(p.count_type, 1, at)[0])
                        at += int(p.count_type[1:])
                    numbers = values(p.type, count, at)
                    at += numbers.nbytes
                    if p.name in CORNERS:
                        columns[p.name].append(numbers.tolist())
                    elif p.name in AXES and not p.count_type:
                        columns[p.name].append(float(numbers[0]))
            except IndexError:
                raise _short(element, row) from None
        return columns

    def first_sizes(element: Element) -> Iterator[int]:
        """Return the lengths of the lists of the first row, 1 for numbers."""
        place = at
        for p in element.properties:
            count = 1
            if p.count_type:
                count = int(values(p.count_type, 1, place)[0])
                place += int(p.count_type[1:])
            values(p.type, count, place)
            place += count * int(p.type[1:])
            yield count

    def next_element(element: Element | None) -> Columns:
        if element is None:
            rest = data[at:]
            if rest.strip(b"\0 \r\n"):
                text = f"{len(rest):,} bytes follow the rows that its header counts"
                raise _Damaged(f"is damaged: {text}")
            return {}
        if not element.rows or not element.properties:
            return {p.name: [] for p in element.properties}
        try:
            sizes = tuple(first_sizes(element))
        except IndexError:
            raise _short(element, 0) from None
        columns = fixed(element, sizes)
        return lists(element) if columns is None else columns

    return next_element
