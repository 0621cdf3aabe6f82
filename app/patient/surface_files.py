"""Triangles of surface files: STL, PLY and OBJ, in all dialects that programs write.

The readers are written here because libraries get too much wrong, often without an error. Of the
45 dialects of one box in `tests/patient/test_surface_files.py`, trimesh 5.2 reads 32 as the box. It
misses: STL with `end solid`, decimal commas, keywords in a solid's name, a count of 0 or -1, bytes
after the end; OBJ with comments after faces, tabs, decimal commas, and negative numbers of vertices
that are counted from the last one so far; PLY with triangles and quads together, and with empty
lists in faces. Of the 38 damaged files it reads 19, among them half of an STL file that is cut
short. meshio misses most OBJ and PLY files of Blender and MeshLab.

`read` recognizes the format by suffix and content. Normals, colours and texture are not read.
"""

from __future__ import annotations

import codecs
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from app.foundation.arrays import Floats
from app.foundation.errors import GeometryError
from app.patient.welding import Polygon, divided

SUFFIXES = (".stl", ".ply", ".obj")
# Files of other formats, by their first bytes.
OTHERS = {
    b"version https://git-lfs": "is a pointer of Git LFS, not the file: `git lfs pull` brings it",
    b"PK\x03\x04": "is a ZIP archive: unpack it",
    b"\x1f\x8b": "is compressed by gzip: unpack it",
    b"7z\xbc\xaf": "is a 7z archive: unpack it",
    b"<!DOCTYPE": "is a page of HTML, not the file",
    b"<html": "is a page of HTML, not the file",
    b"<?xml": "is XML, as VTK and 3MF write it",
    b"<VTKFile": "is XML of VTK",
    b"# vtk": "is a file of VTK",
    b"OFF": "is an OFF file",
    b"COFF": "is an OFF file",
    b"\x89HDF": "is an HDF5 file",
    b"ISO-10303": "is a STEP file",
    bytes(128) + b"DICM": "is an image of DICOM: give it as `image`, with a `label`",
}


def read(path: Path) -> tuple[Floats, list[str]]:
    """Return corners of triangles (m, 3, 3) in the file's unit, and notes on what was read.

    Raises:
        GeometryError: The file has another format, or is cut short or damaged.
    """
    suffix = path.suffix.lower()
    expected = ", ".join(SUFFIXES)
    if suffix not in SUFFIXES:
        raise GeometryError(f"{path}: has the ending `{path.suffix}`; expected one of {expected}")
    with path.open("rb") as file:
        start = file.read(100_000)
    if not start:
        raise GeometryError(f"{path}: is empty")
    size = path.stat().st_size
    # The header of a binary STL may begin with any words.
    for content, words in OTHERS.items() if size != _stl_size(start) else ():
        if start[: len(content)].lower() == content.lower():
            raise GeometryError(f"{path}: {words}; expected one of {expected}")
    kind = _format_of(start, size)
    if kind and kind != suffix:
        name = {".stl": "an STL", ".obj": "an OBJ", ".ply": "a PLY"}[kind]
        raise GeometryError(f"{path}: is {name} file by its content; rename it to *{kind}")
    match suffix:
        case ".stl":
            return _read_stl(path)
        case ".ply":
            return _read_ply(path)
    return _read_obj(path)


def _format_of(start: bytes, size: int) -> str | None:
    """Return the suffix of the format of a file by its first bytes and size, None if unknown."""
    if size == _stl_size(start):
        return ".stl"
    if not _is_text(start) and not start.startswith(b"ply"):
        return None
    words = [line.split() for line in _decoded(start)[0].split("\n")]
    kinds = [line[0].lower() for line in words if line]
    match kinds[:1]:
        case ["ply"]:
            return ".ply"
        case ["solid"]:
            return ".stl"
    return ".obj" if "v" in kinds else None


# -------------------------------------------------------------------------------------------- Text

ENCODINGS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
# Vertices of STL or OBJ files with a comma, or with a point, between digits.
COMMA = re.compile(r"^\s*v(?:ertex)?\s[^\n]*\d,\d", re.IGNORECASE | re.MULTILINE)
POINT = re.compile(r"^\s*v(?:ertex)?\s[^\n]*\d\.\d", re.IGNORECASE | re.MULTILINE)


def _decoded(data: bytes) -> tuple[str, list[str]]:
    """Return the text of a file with line feeds only, and notes on it.

    Names may be in any encoding. Decimal commas become points if no vertex has a point.
    """
    mark = next((mark for mark in ENCODINGS if data.startswith(mark)), None)
    text = data.decode(ENCODINGS[mark] if mark else "latin-1", errors="replace")
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    if not COMMA.search(text) or POINT.search(text):
        return text, []
    return re.sub(r"(?<=\d),(?=\d)", ".", text), ["decimal commas are read as points"]


def _is_text(data: bytes) -> bool:
    """Return True if the first bytes of a file are text."""
    return data.startswith(tuple(ENCODINGS)) or b"\0" not in data[:2000]


def _line_of(text: str, position: int) -> int:
    """Return the number of the line at a position, from 1."""
    return text.count("\n", 0, position) + 1


# --------------------------------------------------------------------------------------------- STL

STL_HEADER = 84  # bytes before the triangles of a binary file
FACET_SIZE = 50  # bytes of each of them
UNKNOWN = (0, 2**32 - 1)  # counts in headers that were written before the triangles
FACET_TYPE = np.dtype([("normal and corners", "<f4", (4, 3)), ("attribute", "<u2")])

# Words of a text file. They are case-insensitive; the name of a solid ends with its line.
VERTEX = r"\s+vertex\s+(\S+)\s+(\S+)\s+(\S+)"
NORMAL = r"(?:\s+normal(?:\s+(?!outer\s)\S+){0,3})?"
FACET = re.compile(
    rf"\s*facet{NORMAL}\s+outer\s+loop{VERTEX}{VERTEX}{VERTEX}\s+end\s*loop\s+end\s*facet\b",
    re.IGNORECASE,
)
SOLID_BEGIN = re.compile(
    r"\s*solid\b(?:(?!\sfacet\s+normal\s+\S+\s+\S+\s+\S+\s+outer\s)[^\n])*", re.I
)
SOLID_END = re.compile(r"\s*end\s*solid\b[^\n]*", re.IGNORECASE)
FACET_END = re.compile(r"\bend\s*facet\b", re.IGNORECASE)


def _read_stl(path: Path) -> tuple[Floats, list[str]]:
    """Return corners of triangles (m, 3, 3) in the file's unit, and notes on what was read.

    Raises:
        GeometryError: The file is cut short, or its numbers or words are damaged.
    """
    data = path.read_bytes()
    if len(data) != _stl_size(data) and _is_text(data):
        text, notes = _decoded(data)
        if SOLID_BEGIN.match(text):
            return _text_stl(path, text, notes)
    return _binary_stl(path, data)


def _stl_size(data: bytes) -> int | None:
    """Return the size of a binary file by its header [bytes]; None if it has no triangles."""
    if len(data) < STL_HEADER or not _count(data):
        return None
    return STL_HEADER + FACET_SIZE * _count(data)


def _count(data: bytes) -> int:
    """Number of triangles that a binary file's header gives."""
    return int.from_bytes(data[STL_HEADER - 4 : STL_HEADER], "little")


def _binary_stl(path: Path, data: bytes) -> tuple[Floats, list[str]]:
    """Read the triangles of a binary file; their number has to agree with its length."""
    if len(data) < STL_HEADER:
        raise GeometryError(f"{path}: is not an STL file: it has only {len(data):,} bytes")
    count, notes = _count(data), []
    there, beyond = divmod(len(data) - STL_HEADER, FACET_SIZE)
    if count in UNKNOWN and not beyond:
        notes.append("their number follows from the length of the file, not from its header")
        count = there
    swapped = int.from_bytes(data[STL_HEADER - 4 : STL_HEADER], "big")
    if there and not beyond and swapped == there:
        text = f"its {there:,} triangles are in big-endian order; STL files are little-endian"
        raise GeometryError(f"{path}: {text}. Write it again")
    if count > there:
        raise GeometryError(
            f"{path}: is not an STL file, or is cut short: read as binary STL, it has {there:,} of"
            f" the {count:,} triangles in its header"
        )
    rest = data[STL_HEADER + FACET_SIZE * count :]
    second = _stl_size(rest)
    if second is not None and len(rest) >= second:
        text = f"a second STL file follows its {count:,} triangles"
        raise GeometryError(f"{path}: {text}; merge both into one, or keep the femur alone")
    if rest.strip(b"\0") and not beyond:
        text = f"its header gives {count:,} triangles, but it contains {there:,}"
        raise GeometryError(f"{path}: {text}; write it again")
    if rest:
        notes.append(f"{len(rest):,} bytes after its end are left out")
    rows = np.frombuffer(data, FACET_TYPE, count, STL_HEADER)
    with np.errstate(invalid="ignore"):  # of damaged numbers
        corners = rows["normal and corners"][:, 1:].astype(float)
    return corners, [f"{count:,} triangles of a binary STL file", *notes]


def _text_stl(path: Path, text: str, notes: list[str]) -> tuple[Floats, list[str]]:
    """Read the triangles of a text file; all facets have to be read, and all solids to end."""
    text = text.rstrip("\0\x1a \t\n")
    corners: list[tuple[str, ...]] = []
    at, solids = 0, 0
    while at < len(text):
        begin = SOLID_BEGIN.match(text, at)
        if not begin:
            raise _unread(path, text, at, "`solid`")
        solids += 1
        first, at = begin.start() + 1, begin.end()
        facet = FACET.match(text, at)
        while facet:
            corners.append(facet.groups())
            at = facet.end()
            facet = FACET.match(text, at)
        end = SOLID_END.match(text, at)
        if not end:
            rest = text[at:].lstrip()
            read = f"after {len(corners):,} facets"
            if not rest or SOLID_BEGIN.match(rest):
                raise GeometryError(
                    f"{path}: the solid that begins in line {_line_of(text, first)} has no"
                    f" `endsolid` {read}; is the file cut short? If not, add that line"
                )
            if FACET_END.search(rest):
                raise _unread(path, text, at, "a facet of three vertices, or `endsolid`")
            where = _line_of(text, len(text) - len(rest))
            raise GeometryError(
                f"{path}: line {where}: the file is cut short or damaged in a facet, {read}"
            )
        at = end.end()
    facets = len(FACET_END.findall(text))
    if facets > len(corners):
        raise GeometryError(
            f"{path}: only {len(corners):,} of its {facets:,} facets could be read; the name of a"
            " solid must end with its line"
        )
    try:
        values = np.array([[float(word) for word in facet] for facet in corners])
    except ValueError:
        word = next(w for facet in corners for w in facet if not _is_number(w))
        where = _line_of(text, text.index(word))
        raise GeometryError(f"{path}: line {where}: `{word[:40]}` is not a number") from None
    several = f" in {solids} solids" if solids > 1 else ""
    return values.reshape(-1, 3, 3), [
        f"{len(corners):,} triangles of a text STL file{several}",
        *notes,
    ]


def _unread(path: Path, text: str, at: int, expected: str) -> GeometryError:
    """Return the error on text that an STL file does not have there."""
    rest = text[at:].lstrip()
    words = " ".join(rest.split()[:6])[:60]
    where = _line_of(text, len(text) - len(rest))
    return GeometryError(f"{path}: line {where}: expected {expected}, but it has `{words}`")


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


# --------------------------------------------------------------------------------------------- OBJ

# Statements that do not change the shape of flat faces.
SHAPELESS = frozenset(
    "vn vt vp g o s mg usemtl mtllib usemap maplib lod bevel c_interp d_interp shadow_obj"
    " trace_obj".split()
)


def _read_obj(path: Path) -> tuple[Floats, list[str]]:
    """Return corners of triangles (m, 3, 3) in the file's unit, and notes on what was read.

    Raises:
        GeometryError: A vertex or a face is damaged, or there are none.
    """
    text, notes = _decoded(path.read_bytes())
    points: list[tuple[float, ...]] = []
    faces: list[list[int]] = []
    lines: list[int] = []  # of the faces
    unread: Counter[str] = Counter()
    for number, (word, *rest) in _statements(text):
        try:
            if word == "v":
                x, y, z, *_ = rest  # a weight or a colour may follow
                points.append((float(x), float(y), float(z)))
            elif word in ("f", "fo"):
                numbers = [int(corner.partition("/")[0]) for corner in rest]
                faces.append([i - 1 if i > 0 else _from_end(i, len(points)) for i in numbers])
                lines.append(number)
            elif word not in SHAPELESS:
                unread[word] += 1
        except ValueError:
            what = "a vertex has three numbers" if word == "v" else "corners are whole numbers"
            shown = " ".join([word, *rest])[:60]
            raise GeometryError(f"{path}: line {number}: `{shown}`: {what}") from None
    if not faces:
        kinds = ", ".join(word[:20] for word in sorted(unread)[:5])
        text = f"; it has lines of {kinds}, which are not read" if kinds else ""
        raise GeometryError(f"{path}: has no faces (lines that begin with f){text}")
    corners, divided = _corners_of(
        path, np.array(points).reshape(-1, 3), faces, lambda k: f"line {lines[k]}: the face"
    )
    if unread:
        named = ", ".join(f"{n:,} of {word[:20]}" for word, n in sorted(unread.items())[:5])
        notes.append(f"lines that are not read: {named}")
    return corners, [f"{len(faces):,} faces of an OBJ file", *divided, *notes]


def _from_end(index: int, vertices: int) -> int:
    """Return the number of a vertex that is counted back from the last one; -1 if there is none."""
    return vertices + index if 0 < -index <= vertices else -1


def _statements(text: str) -> Iterator[tuple[int, list[str]]]:
    """Return the number and words of each line with words; a backslash continues a line."""
    before = ""
    for number, line in enumerate(text.split("\n"), 1):
        line = before + line.partition("#")[0]
        if line.rstrip().endswith("\\"):
            before = line.rstrip()[:-1] + " "
            continue
        before = ""
        words = line.split()
        if words:
            yield number, [words[0].lower(), *words[1:]]
    words = before.split()
    if words:
        yield number, [words[0].lower(), *words[1:]]


# --------------------------------------------------------------------------------------------- PLY

# Letters of numpy for the names of types in a header.
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


def _read_ply(path: Path) -> tuple[Floats, list[str]]:
    """Return corners of triangles (m, 3, 3) in the file's unit, and notes on what was read.

    Raises:
        GeometryError: The file is cut short or damaged, or has no faces.
    """
    data = path.read_bytes()
    try:
        order, elements, start = _header(data)
        read_element = _text_ply(data, start) if not order else _binary_ply(data, start, order)
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
        corners = next(
            (columns["face"][name] for name in CORNER_LISTS if name in columns["face"]), None
        )
        if corners is None:
            kinds = ", ".join(columns["face"])
            raise _Damaged(f"its faces have no list {CORNER_LISTS[0]}; they have {kinds}")
    except _Damaged as error:
        raise GeometryError(f"{path}: {error}") from None
    with np.errstate(invalid="ignore"):  # of damaged numbers
        points = np.stack([np.asarray(vertex[axis], float) for axis in "xyz"], axis=1)
    triangles, notes = _corners_of(path, points, corners, lambda k: f"face {k + 1:,}")
    kind = "text" if not order else "binary"
    left = [e.name for e in elements if e.name not in ("vertex", "face") and e.rows]
    if left:
        notes.append(f"elements that are not read: {', '.join(left)}")
    return triangles, [f"{len(corners):,} faces of a {kind} PLY file", *notes]


def _header(data: bytes) -> tuple[str, list[Element], int]:
    """Return the byte order (empty for text), the elements, and the byte at which rows begin."""
    end = HEADER_END.search(data[:1_000_000])
    if not data.lstrip(b"\xef\xbb\xbf").startswith(b"ply") or not end:
        raise _Damaged("is not a PLY file, or is cut short: it has no line `end_header`")
    order, elements = None, []

    def known(*types: str) -> bool:
        return PLY_TYPES.keys() >= {*types}

    for line in re.split(r"[\r\n]+", data[: end.start()].decode("latin-1")):
        match line.split():
            case ["format", name, *_] if name in PLY_ORDERS:
                order = PLY_ORDERS[name]
            case ["element", name, count] if count.isdecimal() and len(count) < 16:
                elements.append(Element(name, int(count), ()))
            case ["property", "list", count, kind, name] if elements and known(count, kind):
                if PLY_TYPES[count][0] == "f":
                    raise _Damaged(f"header: `{line.strip()[:60]}`: lengths of lists are integers")
                if name in AXES:
                    raise _Damaged(f"header: `{line.strip()[:60]}`: a coordinate is not a list")
                _add(elements, Property(name, PLY_TYPES[kind], PLY_TYPES[count]))
            case ["property", kind, name] if elements and known(kind):
                _add(elements, Property(name, PLY_TYPES[kind]))
            case [word, *_] if word in ("format", "element", "property"):
                raise _Damaged(f"header: `{line.strip()[:60]}` cannot be read")
    if order is None:
        raise _Damaged("header: it has no line `format`")
    names = [element.name for element in elements]
    if len(set(names)) < len(names):
        raise _Damaged("header: an element is declared twice")
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
    return _Damaged(f"is cut short or damaged: {text}, but only {rows:,} in the file")


def _text_ply(data: bytes, start: int) -> Reader:
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
                    if p.name in CORNER_LISTS:
                        columns[p.name].append([int(value) for value in values])
                    elif p.name in AXES and not p.count_type:
                        columns[p.name].append(float(values[0]))
                    at += count
                except IndexError:
                    raise _short(element, row) from None
                except ValueError:
                    text = f"row {row + 1:,} of element {element.name}"
                    raise _Damaged(f"{text}: a corner or count is not a whole number") from None
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


def _binary_ply(data: bytes, start: int, order: str) -> Reader:
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
                    if p.name in CORNER_LISTS:
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


# ---------------------------------------------------------------------------- Faces of OBJ and PLY


def _corners_of(
    path: Path, points: Floats, polygons: Sequence[Polygon], place: Callable[[int], str]
) -> tuple[Floats, list[str]]:
    """Return corners (m, 3, 3) of the triangles of all faces of a file, and notes on them.

    Args:
        path: The file.
        points: Its vertices (n, 3).
        polygons: Vertices of each face, from 0.
        place: Name of a face by its number, for messages.

    Raises:
        GeometryError: A face has fewer than three corners, or a corner that is no vertex of the
            file or has coordinates that are no numbers.
    """
    sizes = np.array([len(polygon) for polygon in polygons], dtype=np.int64)
    if not len(sizes):
        raise GeometryError(f"{path}: has no faces")
    small = sizes < 3
    if small.any():
        k = int(small.argmax())
        raise GeometryError(f"{path}: {place(k)} has {sizes[k]} corners; expected at least three")
    flat = np.fromiter((i for polygon in polygons for i in polygon), np.int64, sizes.sum())
    outside = (flat < 0) | (flat >= len(points))
    if outside.any():
        k = int(np.repeat(np.arange(len(sizes)), sizes)[outside][0])
        text = f"has a corner that is none of the {len(points):,} vertices"
        raise GeometryError(f"{path}: {place(k)} {text}")
    used = np.unique(flat)
    lost = ~np.isfinite(points[used]).all(axis=1)
    if lost.any():
        number = int(used[lost][0]) + 1
        text = f"{int(lost.sum()):,} of its vertices are not numbers"
        text += f"; the first is vertex {number:,}"
        raise GeometryError(f"{path}: {text}")
    notes = []
    more = int((sizes > 3).sum())
    if more:
        notes.append(f"{more:,} faces with more than three corners divided")
    unused = len(points) - len(used)
    if unused:
        notes.append(f"{unused:,} vertices without a face left out")
    return points[divided(points, polygons)], notes
