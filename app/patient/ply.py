"""PLY files, binary and text."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from app.foundation.arrays import Floats
from app.foundation.errors import GeometryError
from app.patient.polygons import corners_of

# Type codes of numpy by the names of types in a header.
PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
PLY_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
CORNER_LISTS = ("vertex_indices", "vertex_index")
AXES = ("x", "y", "z")
HEADER_END = re.compile(rb"(?:^|[\r\n])end_header[ \t]*(\r\n|\n|\r)")


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
    file_bytes = path.read_bytes()
    try:
        order, elements, rows_start = _header(file_bytes)
        rows = (
            _BinaryRows(file_bytes, rows_start, order)
            if order
            else _TextRows(file_bytes, rows_start)
        )
        columns = {element.name: _columns(rows, element) for element in elements}
        rows.check_end()
        names = ", ".join(element.name for element in elements)
        if "tristrips" in columns and "face" not in columns:
            raise _Damaged("its triangles are strips (element tristrips); save it as faces")
        if "vertex" not in columns or "face" not in columns:
            raise _Damaged(f"has no faces; its elements: {names or 'none'}")
        vertex = columns["vertex"]
        missing_axes = {"x", "y", "z"} - vertex.keys()
        if missing_axes:
            raise _Damaged(f"its vertices have no {', '.join(sorted(missing_axes))}")
        face = next(element for element in elements if element.name == "face")
        list_names = {p.name for p in face.properties if p.count_type}
        corners = next((columns["face"][name] for name in CORNER_LISTS if name in list_names), None)
        if corners is None:
            kinds = ", ".join(p.name for p in face.properties)
            raise _Damaged(f"its faces have no list {CORNER_LISTS[0]}; they have {kinds}")
    except _Damaged as error:
        raise GeometryError(f"{path}: {error}") from None
    with np.errstate(invalid="ignore"):  # of damaged numbers
        points = np.stack([np.asarray(vertex[axis], float) for axis in "xyz"], axis=1)
    triangles, notes = corners_of(path, points, corners, lambda k: f"face {k + 1:,}")
    kind = "text" if not order else "binary"
    unread = [e.name for e in elements if e.name not in ("vertex", "face") and e.rows]
    if unread:
        notes.append(f"elements that are not read: {', '.join(unread)}")
    return triangles, [f"{len(corners):,} faces of a {kind} PLY file", *notes]


def _header(data: bytes) -> tuple[str, list[Element], int]:
    """Return the byte order (empty for text), the elements, and the byte at which rows begin."""
    header_end = HEADER_END.search(data[:1_000_000])
    if not data.lstrip(b"\xef\xbb\xbf").startswith(b"ply") or not header_end:
        raise _Damaged("is not a PLY file, or is cut short: it has no line `end_header`")
    order, elements = None, []

    def are_known(*types: str) -> bool:
        return PLY_TYPES.keys() >= {*types}

    for line in re.split(r"[\r\n]+", data[: header_end.start()].decode("latin-1")):
        match line.split():
            case ["format", name, *_] if name in PLY_ORDERS:
                order = PLY_ORDERS[name]
            case ["element", name, count] if count.isdecimal() and len(count) < 16:
                elements.append(Element(name, int(count), ()))
            case ["property", "list", count, kind, name] if elements and are_known(count, kind):
                if PLY_TYPES[count][0] == "f":
                    raise _Damaged(f"header: `{line.strip()[:60]}`: lengths of lists are integers")
                if name in AXES:
                    raise _Damaged(f"header: `{line.strip()[:60]}`: a coordinate is not a list")
                _append_property(elements, Property(name, PLY_TYPES[kind], PLY_TYPES[count]))
            case ["property", kind, name] if elements and are_known(kind):
                _append_property(elements, Property(name, PLY_TYPES[kind]))
            case [word, *_] if word in ("format", "element", "property"):
                raise _Damaged(f"header: `{line.strip()[:60]}` cannot be read")
    if order is None:
        raise _Damaged("header: it has no line `format`")
    names = [element.name for element in elements]
    if len(set(names)) < len(names):
        raise _Damaged("header: an element is declared twice")
    return order, elements, header_end.end()


def _append_property(elements: list[Element], added_property: Property) -> None:
    """Append a property to the last element."""
    last_element = elements[-1]
    elements[-1] = Element(
        last_element.name, last_element.rows, (*last_element.properties, added_property)
    )


# Values of an element by the names of its properties.
Columns = dict[str, Any]


class _Rows(Protocol):
    """Rows of a file, read from the front."""

    def take(self, kind: str, count: int) -> Sequence[str] | np.ndarray:
        """Return the next values of a type; raise IndexError beyond the end."""

    def table(self, element: Element) -> Columns | None:
        """Return all rows of an element at once; None if their lengths may differ.

        Raises:
            _Damaged: There are fewer rows.
        """

    def check_end(self) -> None:
        """Refuse what follows the last row."""


def _columns(rows: _Rows, element: Element) -> Columns:
    """Columns of the next element: corners and coordinates as numbers."""
    if not element.rows or not element.properties:
        return {p.name: [] for p in element.properties}
    columns = rows.table(element)
    if columns is not None:
        return columns
    columns = {p.name: [] for p in element.properties}
    for row in range(element.rows):
        try:
            for p in element.properties:
                count = int(rows.take(p.count_type, 1)[0]) if p.count_type else 1
                values = rows.take(p.type, count)
                if p.name in CORNER_LISTS:
                    columns[p.name].append([int(value) for value in values])
                elif p.name in AXES:
                    columns[p.name].append(float(values[0]))
        except IndexError:
            raise _too_few_rows(element, row) from None
        except ValueError:
            row_text = f"row {row + 1:,} of element {element.name}"
            raise _Damaged(f"{row_text}: a corner or count is not a whole number") from None
    return columns


def _too_few_rows(element: Element, rows: int) -> _Damaged:
    """Return the error on an element with fewer rows than its header says."""
    expected_rows = f"element {element.name} has {element.rows:,} rows in the header"
    return _Damaged(f"is cut short or damaged: {expected_rows}, but only {rows:,} in the file")


class _TextRows:
    """Rows of a text file."""

    def __init__(self, data: bytes, start: int) -> None:
        self._words = data[start:].decode("latin-1").split()
        self._position = 0

    def take(self, kind: str, count: int) -> list[str]:
        """Return the next words; raise IndexError beyond the end."""
        if count < 0 or self._position + count > len(self._words):
            raise IndexError
        self._position += count
        return self._words[self._position - count : self._position]

    def table(self, element: Element) -> Columns | None:
        """Return the coordinates of all rows; None if rows have lists."""
        if element.has_lists:
            return None
        width = len(element.properties)
        available = (len(self._words) - self._position) // width
        if available < element.rows:
            raise _too_few_rows(element, available)
        words = self.take("", width * element.rows)
        columns: Columns = {}
        for k, p in enumerate(element.properties):
            if p.name in AXES:
                try:
                    columns[p.name] = [float(word) for word in words[k::width]]
                except ValueError as error:
                    raise _Damaged(f"element {element.name}: {error}") from None
        return columns

    def check_end(self) -> None:
        """Refuse words after the last row."""
        extra = len(self._words) - self._position
        if extra:
            raise _Damaged(f"is damaged: {extra:,} words follow the rows that its header counts")


class _BinaryRows:
    """Rows of a binary file with a byte order."""

    def __init__(self, data: bytes, start: int, order: str) -> None:
        self._data = data
        self._position = start
        self._order = order

    def take(self, kind: str, count: int) -> np.ndarray:
        """Return the next numbers; raise IndexError beyond the end."""
        start_position = self._position
        end_position = start_position + count * int(kind[1:])
        if count < 0 or end_position > len(self._data):
            raise IndexError
        self._position = end_position
        return np.frombuffer(self._data, self._order + kind, count, start_position)

    def table(self, element: Element) -> Columns | None:
        """Return all rows if their lists are as long as those of the first one, else None."""
        sizes = self._first_sizes(element)
        fields: list[tuple[Any, ...]] = []
        for k, (p, size) in enumerate(zip(element.properties, sizes, strict=True)):
            if p.count_type:
                fields.append((f"count {k}", self._order + p.count_type))
            shape = ((size,),) if p.count_type else ()
            fields.append((f"value {k}", self._order + p.type, *shape))
        row = np.dtype(fields)
        available = (len(self._data) - self._position) // row.itemsize
        if available < element.rows:
            if element.has_lists:
                return None
            raise _too_few_rows(element, available)
        rows = np.frombuffer(self._data, row, element.rows, self._position)
        for k, (p, size) in enumerate(zip(element.properties, sizes, strict=True)):
            if p.count_type and (rows[f"count {k}"] != size).any():
                return None
        self._position += row.itemsize * element.rows
        return {p.name: rows[f"value {k}"] for k, p in enumerate(element.properties)}

    def _first_sizes(self, element: Element) -> list[int]:
        """Lengths of the lists of the next row, 1 for numbers."""
        start_position = self._position
        sizes = []
        try:
            for p in element.properties:
                count = int(self.take(p.count_type, 1)[0]) if p.count_type else 1
                self.take(p.type, count)
                sizes.append(count)
        except IndexError:
            raise _too_few_rows(element, 0) from None
        self._position = start_position
        return sizes

    def check_end(self) -> None:
        """Refuse bytes after the last row that are not blank."""
        remaining_bytes = self._data[self._position :]
        if remaining_bytes.strip(b"\0 \r\n"):
            fault = f"{len(remaining_bytes):,} bytes follow the rows that its header counts"
            raise _Damaged(f"is damaged: {fault}")
