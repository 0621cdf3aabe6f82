"""VTK's ``.vtu`` files: all pieces, with data as text, inline or appended, compressed or not.

meshio 5.3.5 decodes all appended text at once, which Python 3.13 refuses, and keeps the last piece
of several. Here each array is cut to its length before it is decoded.
"""

from __future__ import annotations

import base64
import binascii
import lzma
import math
import re
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree as ET

import numpy as np

from app.arrays import Floats, Ints
from app.mesh_files.content import left_out
from app.mesh_files.grids import FileGrid

# Cells by VTK's number: name and dimension; Lagrange cells of these sizes are numbered alike.
TYPES = {
    (5, 3): "triangle",
    (22, 6): "triangle6",
    (69, 3): "triangle",
    (69, 6): "triangle6",
    (10, 4): "tetra",
    (24, 10): "tetra10",
    (71, 4): "tetra",
    (71, 10): "tetra10",
}
# Other cells that have a volume.
VOLUMES = {11: "voxel", 12: "hexahedron", 13: "wedge", 14: "pyramid", 15: "pentagonal prism"}
VOLUMES |= {16: "hexagonal prism", 25: "hexahedron20", 26: "wedge15", 27: "pyramid13"}
VOLUMES |= {29: "hexahedron27", 31: "wedge12", 32: "wedge18", 33: "hexahedron24", 37: "pyramid19"}
VOLUMES |= {42: "polyhedron", 71: "tetra of higher order", 72: "hexahedron of higher order"}
VOLUMES |= {73: "wedge of higher order", 74: "pyramid of higher order"}
# Triangles of an order that is not read, quadrilaterals and polygons.
PLANE = {6, 7, 8, 9, 23, 28, 30, 34, 36, 69, 70}
# Cells of another process, in the array vtkGhostType.
DUPLICATE = 1
APPENDED = re.compile(rb"<AppendedData([^>]*)>\s*_")
NUMBERS = re.compile(r"(U?Int|Float)(8|16|32|64)")


def _lz4(data: bytes, size: int) -> bytes:
    """One block of LZ4: literals and copies of earlier bytes."""
    out = bytearray()
    at = 0

    def length(start: int) -> int:
        nonlocal at
        while start >= 15:
            byte = data[at]
            at += 1
            start += byte
            if byte < 255:
                break
        return start

    while at < len(data):
        token = data[at]
        at += 1
        literals = length(token >> 4)
        out += data[at : at + literals]
        at += literals
        if at >= len(data):
            break
        back = data[at] | data[at + 1] << 8
        at += 2
        if not 0 < back <= len(out):
            raise ValueError("an array compressed by LZ4 is damaged")
        count = length(token & 15) + 4
        if len(out) + count > size:
            raise ValueError("an array compressed by LZ4 is damaged")
        copy = bytes(out[-back:])
        out += (copy * (count // back + 1))[:count]
    return bytes(out)


COMPRESSORS: dict[str, Callable[[bytes, int], bytes]] = {
    "vtkZLibDataCompressor": lambda data, _: zlib.decompress(data),
    "vtkLZMADataCompressor": lambda data, _: lzma.decompress(data),
    "vtkLZ4DataCompressor": _lz4,
}


class _Raw:
    """Bytes as they are, from a place on."""

    def __init__(self, data: bytes) -> None:
        self.data = data

    def take(self, count: int) -> bytes:
        """Return the next bytes.

        Raises:
            ValueError: There are fewer.
        """
        taken, self.data = self.data[:count], self.data[count:]
        if len(taken) < count:
            raise ValueError(f"an array ends after {len(taken)} of {count} bytes: is it cut short?")
        return taken

    def part(self) -> None:
        """Begin a new part: nothing divides bytes."""


class _Base64(_Raw):
    """Bytes as text of base64, each part padded to its end."""

    def __init__(self, data: bytes) -> None:
        super().__init__(data)
        self.rest = b""

    def take(self, count: int) -> bytes:
        """Return the next decoded bytes; after a padding a new part begins."""
        missing = count - len(self.rest)
        if missing > 0:
            text = super().take(0) + self._text(4 * math.ceil(missing / 3))
            self.rest += base64.b64decode(text, validate=True)
        if len(self.rest) < count:
            raise ValueError(
                f"an array ends after {len(self.rest)} of {count} bytes: is it cut short?"
            )
        taken, self.rest = self.rest[:count], self.rest[count:]
        return taken

    def _text(self, count: int) -> bytes:
        text, self.data = self.data[:count], self.data[count:]
        return text

    def part(self) -> None:
        """Begin a new part: its text begins with a new group of four."""
        self.rest = b""


@dataclass(frozen=True)
class _File:
    """Encoding of the arrays of a file."""

    order: Literal["<", ">"]
    header: np.dtype
    compressor: Callable[[bytes, int], bytes] | None
    appended: bytes
    raw: bool

    def numbers(self, item: ET.Element) -> np.ndarray:
        """Numbers of a ``<DataArray>`` (n,), or (n, k) of several components.

        Raises:
            ValueError: The array is damaged, or not as long as it says.
        """
        name = item.get("Name", "Points")
        match = NUMBERS.fullmatch(item.get("type", ""))
        if not match:
            raise ValueError(f"array {name}: its type '{item.get('type')}' is not of numbers")
        kind = np.dtype(
            f"{ {'Int': 'i', 'UInt': 'u', 'Float': 'f'}[match[1]] }{int(match[2]) // 8}"
        )
        form = item.get("format", "ascii")
        if form == "ascii":
            values = np.array((item.text or "").split(), dtype=kind)
        else:
            try:
                data = self._bytes(item, form)
            except (zlib.error, lzma.LZMAError, IndexError, binascii.Error) as error:
                raise ValueError(f"array {name} is damaged ({error})") from None
            if len(data) % kind.itemsize:
                raise ValueError(f"array {name} has {len(data)} bytes, which are no {kind}")
            values = np.frombuffer(data, kind.newbyteorder(self.order)).astype(kind)
        width = int(item.get("NumberOfComponents", "1") or 1)
        if width > 1:
            if len(values) % width:
                raise ValueError(f"array {name}: {len(values)} numbers are no rows of {width}")
            values = values.reshape(-1, width)
        return values

    def _bytes(self, item: ET.Element, form: str) -> bytes:
        if form == "appended":
            data = self.appended[int(item.attrib["offset"]) :]
            stream = _Raw(data) if self.raw else _Base64(data)
        elif form == "binary":
            stream = _Base64("".join((item.text or "").split()).encode("ascii", "replace"))
        else:
            raise ValueError(f"format '{form}' is not one of ascii, binary, appended")
        size = self.header.itemsize
        (first,) = np.frombuffer(stream.take(size), self.header)
        if self.compressor is None:
            return stream.take(int(first))
        count = int(first)
        if count > len(self.appended) + len(stream.data):
            raise ValueError("an array has more blocks than bytes: is header_type right?")
        sizes = np.frombuffer(stream.take((2 + count) * size), self.header).astype(int)
        block, last, packed = sizes[0], sizes[1], sizes[2:]
        stream.part()
        data = stream.take(int(packed.sum()))
        wanted = [block] * count
        if count and last:
            wanted[-1] = last
        parts = []
        at = 0
        for length, expected in zip(packed, wanted, strict=True):
            parts.append(self.compressor(data[at : at + length], int(expected)))
            if len(parts[-1]) != expected:
                raise ValueError(f"a block has {len(parts[-1])} bytes, not {expected}")
            at += length
        return b"".join(parts)


def read(path: Path) -> tuple[FileGrid, list[str]]:
    """All pieces of a file as one grid, with notes; nodes at the same place are still several.

    Raises:
        ValueError: The file is damaged, of another kind, or has cells that cannot be used.
    """
    root, file = _open(path)
    pieces = [piece for grid in root.iter("UnstructuredGrid") for piece in grid.iter("Piece")]
    if not pieces:
        raise ValueError("has no piece with cells")
    parts = [_piece(piece, file) for piece in pieces]
    told: list[str] = []
    ghosts = sum(part.ghosts for part in parts)
    if ghosts:
        told.append(f"geometry: {ghosts} cells of other processes (vtkGhostType) are left out")
    plane = sum(part.plane for part in parts)
    if plane:
        told.append(f"geometry: {plane} plane cells that are no triangles are left out")
    full = [part for part in parts if len(part.points)]
    if len(full) > 1:
        told.append(f"geometry: {len(full)} pieces are joined at nodes in the same place")
    common = [n for n in full[0].data if all(n in part.data for part in full)] if full else []
    some = {n for part in full for n in part.data if n not in common}
    told += left_out("arrays of cells that not all pieces have are not read", sorted(some))
    return _joined(full, common), told


@dataclass(frozen=True)
class _Piece:
    """A piece: cells by their names with the rows of ``data``; arrays of points by name."""

    points: Floats
    cells: dict[str, tuple[Ints, Ints]]
    data: dict[str, np.ndarray]
    of_points: list[str]
    ghosts: int
    plane: int


def _joined(parts: list[_Piece], names: list[str]) -> FileGrid:
    grid = FileGrid(np.concatenate([np.zeros((0, 3)), *(part.points for part in parts)]))
    first = 0
    for part in parts:
        for kind, (cells, rows) in part.cells.items():
            grid.cells.append((kind, cells + first))
            for name in names:
                grid.data.setdefault(name, []).append(part.data[name][rows])
        first += len(part.points)
    grid.of_points = list(dict.fromkeys(n for part in parts for n in part.of_points))
    return grid


def _open(path: Path) -> tuple[ET.Element, _File]:
    """Root of the file without its appended data, and how its arrays are encoded."""
    raw = path.read_bytes()
    appended, is_raw = b"", False
    match = APPENDED.search(raw)
    if match:
        end = raw.rfind(b"</AppendedData>")
        if end < match.end():
            raise ValueError("its appended data have no end: is it cut short?")
        appended = raw[match.end() : end]
        is_raw = b"raw" in match[1]
        if not is_raw:
            appended = appended.rstrip()
        raw = raw[: match.start()] + b"</VTKFile>"
    root = ET.fromstring(raw)
    kind = root.get("type", "")
    if root.tag != "VTKFile" or kind != "UnstructuredGrid":
        raise ValueError(f"is of type {kind or root.tag}; expected UnstructuredGrid")
    name = root.get("compressor", "")
    if name and name not in COMPRESSORS:
        raise ValueError(f"its compressor {name} is not one of {', '.join(COMPRESSORS)}")
    order: Literal["<", ">"] = ">" if root.get("byte_order", "LittleEndian") == "BigEndian" else "<"
    header = root.get("header_type", "UInt32")
    if header not in ("UInt32", "UInt64"):
        raise ValueError(f"its header_type {header} is not one of UInt32, UInt64")
    bytes_of_header = np.dtype(f"{order}u{int(header[4:]) // 8}")
    return root, _File(order, bytes_of_header, COMPRESSORS.get(name), appended, is_raw)


def _arrays(piece: ET.Element, part: str) -> Iterator[ET.Element]:
    found = piece.find(part)
    return iter(()) if found is None else iter(found.findall("DataArray"))


def _piece(piece: ET.Element, file: _File) -> _Piece:
    points = [file.numbers(item) for item in _arrays(piece, "Points")]
    count = int(piece.get("NumberOfCells", "0"))
    named = {item.get("Name", ""): item for item in _arrays(piece, "Cells")}
    absent = {"connectivity", "offsets", "types"} - named.keys()
    if not points or points[0].ndim != 2 or points[0].shape[1] != 3 or (count and absent):
        raise ValueError("a piece lacks points of three coordinates, or cells")
    if not count:
        return _Piece(points[0][:0], {}, {}, [], 0, 0)
    connectivity, ends, types = (
        file.numbers(named[name]).astype(np.int64) for name in ("connectivity", "offsets", "types")
    )
    sizes = np.diff(ends, prepend=0)
    wrong = len(ends) != count or len(types) != count or (sizes < 0).any()
    if wrong or ends[-1] != len(connectivity):
        raise ValueError(
            f"a piece of {count} cells has {len(types)} types, {len(ends)} ends and "
            f"{len(connectivity)} nodes of cells"
        )
    if len(connectivity) and not 0 <= connectivity.min() <= connectivity.max() < len(points[0]):
        raise ValueError(f"cells use node {connectivity.max()} of {len(points[0])}, from 0")
    data = {}
    for item in _arrays(piece, "CellData"):
        if NUMBERS.fullmatch(item.get("type", "")):
            values = file.numbers(item)
            if len(values) != count:
                text = f"has {len(values)} values for {count} cells"
                raise ValueError(f"array {item.get('Name')} {text}")
            data[item.get("Name", "")] = values
    ghost = (data.pop("vtkGhostType", np.zeros(count, dtype=int)).astype(int) & DUPLICATE) > 0
    cells: dict[str, tuple[Ints, Ints]] = {}
    known = np.zeros(count, dtype=bool)
    for (number, size), kind in TYPES.items():
        rows = np.flatnonzero((types == number) & (sizes == size) & ~ghost)
        known |= (types == number) & (sizes == size)
        if len(rows):
            of_kind = connectivity[(ends[rows] - size)[:, None] + np.arange(size)]
            before = cells.get(kind, (of_kind[:0], rows[:0]))
            cells[kind] = (
                np.concatenate([before[0], of_kind]),
                np.concatenate([before[1], rows]),
            )
    for number in np.unique(types[~known]):
        if number in VOLUMES:
            cells[VOLUMES[number]] = (np.zeros((0, 0), dtype=np.int64), np.zeros(0, dtype=int))
    names = [item.get("Name", "") for item in _arrays(piece, "PointData")]
    plane = int(np.isin(types[~known], [*PLANE]).sum())
    return _Piece(points[0], cells, data, names, int(ghost.sum()), plane)
