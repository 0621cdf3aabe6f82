"""Reader of ``.vtu`` and ``.pvtu`` files of VTK and ParaView, with all encodings and pieces.

Of the 96 encodings of `tests/mesh_files/test_vtu.py` meshio 5.3.5 gets 74 wrong: appended
data, files of several pieces, of which it keeps the last, and LZ4.
"""

from __future__ import annotations

import base64
import lzma
import re
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from app.mesh_files.content import AGAIN, NOT_READ, ONLY, CellBlock, CellGrid

# Types of numbers in numpy's letters.
TYPES = {
    "Int8": "i1",
    "Int16": "i2",
    "Int32": "i4",
    "Int64": "i8",
    "UInt8": "u1",
    "UInt16": "u2",
    "UInt32": "u4",
    "UInt64": "u8",
    "Float32": "f4",
    "Float64": "f8",
}
# Types of VTK's cells of two and three dimensions, with their numbers of nodes.
TRIANGLES = {5: (3,), 22: (6,), 69: (3, 6)}
TETRAHEDRA = {10: (4,), 24: (10,), 71: (4, 10)}
SOLIDS = {*range(10, 17), 24, 25, 26, 27, 29, 32, 33, 42, *range(71, 75), *range(78, 82)}
# Names of the most frequent other volumes.
OTHER_VOLUMES = {11: "voxels", 12: "hexahedra", 13: "wedges", 14: "pyramids"}
OTHER_VOLUMES |= {25: "quadratic hexahedra", 26: "quadratic wedges", 27: "quadratic pyramids"}
# Bit of ``vtkGhostType`` for a cell that is a copy of another piece's cell.
DUPLICATE = 1
# LZ4: a length of 15 in a token continues in the next bytes; the first byte below 255 ends it.
LZ4_LONG = 15
LZ4_MORE = 255
# Length of the shortest copy [bytes].
LZ4_SHORTEST = 4


def lz4_decompress(block: bytes) -> bytes:
    """Return the bytes of an LZ4 block: literals, each followed by a copy of earlier bytes.

    Raises:
        ValueError: The block is damaged.
    """
    content = bytearray()
    position = 0
    try:
        while position < len(block):
            token = block[position]
            count, position = _lz4_length(block, position + 1, token >> 4)
            if position + count > len(block):
                raise ValueError(f"an array compressed by LZ4 is cut short; {AGAIN}")
            content += block[position : position + count]
            position += count
            if position == len(block):
                break
            distance_back = block[position] | block[position + 1] << 8
            count, position = _lz4_length(block, position + 2, token & LZ4_LONG)
            if not 0 < distance_back <= len(content):
                raise ValueError(f"an array compressed by LZ4 is damaged; {AGAIN}")
            count += LZ4_SHORTEST
            earlier = bytes(content[-distance_back:])
            # A copy may be longer than what it repeats.
            content += (earlier * (count // distance_back + 1))[:count]
    except IndexError:
        raise ValueError(f"an array compressed by LZ4 is cut short; {AGAIN}") from None
    return bytes(content)


def _lz4_length(block: bytes, position: int, start: int) -> tuple[int, int]:
    """Return a length that begins in a token, and the position after its bytes."""
    if start < LZ4_LONG:
        return start, position
    while block[position] == LZ4_MORE:
        start += LZ4_MORE
        position += 1
    return start + block[position], position + 1


DECOMPRESS: dict[str, Callable[[bytes], bytes]] = {
    "vtkZLibDataCompressor": zlib.decompress,
    "vtkLZMADataCompressor": lzma.decompress,
    "vtkLZ4DataCompressor": lz4_decompress,
}


class _Source:
    """XML tree of a file, and its appended bytes, which XML parsers may not accept."""

    def __init__(self, path: Path) -> None:
        file_bytes = path.read_bytes()
        self.appended = b""
        opening = re.search(rb"<AppendedData[^>]*>", file_bytes)
        end = file_bytes.rfind(b"</AppendedData>")
        if opening and end < opening.end():
            raise ValueError(f"its appended data have no end: the file is cut short; {AGAIN}")
        self.raw = False
        if opening:
            self.raw = b"raw" in opening[0]
            blob = file_bytes[opening.end() : end]
            data_start = blob.find(b"_")
            if data_start < 0:
                raise ValueError(
                    f"its appended data do not begin with _: the file is damaged; {AGAIN}"
                )
            self.appended = blob[data_start + 1 :]
            file_bytes = file_bytes[: opening.end()] + file_bytes[end:]
        self.root = ET.fromstring(file_bytes)
        order = self.root.get("byte_order", "LittleEndian")
        self.order = ">" if order == "BigEndian" else "<"
        self.header = np.dtype(self.order + TYPES[self.root.get("header_type", "UInt32")])
        self.compressor = self.root.get("compressor", "")
        if self.compressor and self.compressor not in DECOMPRESS:
            raise ValueError(
                f"its data are compressed by {self.compressor}, which is not read; save it with "
                "ZLib or without compression"
            )

    def array(self, item: ET.Element) -> np.ndarray:
        """Return the values of a ``DataArray`` (n,) or (n, components)."""
        name, kind = item.get("Name", "(unnamed)"), item.get("type", "")
        if kind not in TYPES:
            raise ValueError(
                f"its array {name} has the type {kind or '(none)'}; expected one of "
                f"{', '.join(TYPES)}"
            )
        dtype = np.dtype(self.order + TYPES[kind])
        form = item.get("format", "ascii")
        if form == "ascii":
            number_words = (item.text or "").split()
            values = np.array(number_words, dtype=float if dtype.kind == "f" else np.int64)
        elif form in ("binary", "appended"):
            values = self._binary(item, form, dtype, name)
        else:
            raise ValueError(
                f"its array {name} has the format {form}; expected ascii, binary or appended"
            )
        values = values.astype(dtype.newbyteorder("="))
        width = int(item.get("NumberOfComponents", 1) or 1)
        if width > 1 and len(values) % width:
            raise ValueError(f"its array {name}: {len(values)} values do not make rows of {width}")
        return values.reshape(-1, width) if width > 1 else values

    def _binary(self, item: ET.Element, form: str, dtype: np.dtype, name: str) -> np.ndarray:
        if form == "binary":
            encoded, is_raw = "".join((item.text or "").split()).encode(), False
        else:
            offset = int(item.get("offset", 0))
            encoded, is_raw = self.appended[offset:], self.raw
        size = self.header.itemsize

        def take(position: int, count: int) -> bytes:
            """Return bytes from a position; base64 characters count, and are padded by part."""
            if is_raw:
                part = encoded[position : position + count]
            else:
                part = base64.b64decode(encoded[position : position + 4 * -(-count // 3)])[:count]
            if len(part) < count:
                raise ValueError(f"its array {name} is cut short; {AGAIN}")
            return part

        def numbers(position: int, count: int) -> list[int]:
            return [int(n) for n in np.frombuffer(take(position, count * size), self.header)]

        def length(count: int) -> int:
            return count if is_raw else 4 * -(-count // 3)

        (header_length,) = numbers(0, 1)
        if header_length > len(encoded):
            raise ValueError(f"its array {name} is cut short; {AGAIN}")
        if not self.compressor:
            # The header is padded alone, or together with the data.
            together = (
                take(0, size + header_length) if is_raw or not self._padded(encoded, size) else b""
            )
            content = together[size:] or take(length(size), header_length)
        else:
            sizes = numbers(0, 3 + header_length)[3:]
            position = length((3 + header_length) * size)
            block = take(position, sum(sizes))
            block_ends = np.cumsum([0, *sizes])
            blocks = [block[a:b] for a, b in pairwise(block_ends)]
            unpack = DECOMPRESS[self.compressor]
            content = b"".join(unpack(part) for part in blocks)
        if len(content) % dtype.itemsize:
            raise ValueError(f"its array {name} is cut short; {AGAIN}")
        return np.frombuffer(content, dtype)

    @staticmethod
    def _padded(text: bytes, size: int) -> bool:
        """Return True if base64 padding follows the header: it is encoded apart from the data."""
        return text[: 4 * -(-size // 3)].endswith(b"=")


@dataclass
class _Piece:
    """Nodes and cells of a piece, the names of its arrays, and counts of what is not read."""

    points: np.ndarray
    blocks: list[CellBlock]
    names: set[str]
    ghosts: int
    unread: dict[int, int]


def read(path: Path) -> CellGrid:
    """Return all pieces of a file as one grid.

    Raises:
        ValueError: The file is damaged or of no use.
    """
    return _joined(_pieces(path))


def read_parallel(path: Path) -> CellGrid:
    """Return all pieces of the files that a ``.pvtu`` file names, as one grid.

    Raises:
        ValueError: A file is not there, outside of the folder, damaged or of no use.
    """
    root = ET.fromstring(path.read_bytes())
    grid = root.find("PUnstructuredGrid")
    if grid is None:
        raise ValueError(_not_a("PUnstructuredGrid", root))
    source_names = [piece.get("Source", "") for piece in grid.findall("Piece")]
    folder = path.parent.resolve()
    outside = [n for n in source_names if not (folder / n).resolve().is_relative_to(folder)]
    if outside:
        raise ValueError(
            f"its pieces {', '.join(outside)} are not in its folder or below; move them there"
        )
    missing_sources = [n or "(no Source)" for n in source_names if not (folder / n).is_file()]
    if missing_sources:
        count = f"{len(missing_sources)} of its {len(source_names)} pieces are not there"
        raise ValueError(f"{count}: {', '.join(missing_sources)}; put them into its folder")
    pieces = []
    for name in source_names:
        try:
            pieces += _pieces(folder / name)
        except Exception as error:  # damaged files let readers fail in any way
            raise ValueError(f"its piece {name}: {error}") from error
    return _joined(pieces)


def _not_a(expected: str, root: ET.Element) -> str:
    """Return the message for a file of another type than the expected one."""
    kind = root.get("type", "of an unknown type")
    return f"is {kind}; expected {expected}: save it as an unstructured grid of tetrahedra"


def _pieces(path: Path) -> list[_Piece]:
    """Return the pieces of a file that have cells."""
    source = _Source(path)
    grid = source.root.find("UnstructuredGrid")
    if grid is None:
        raise ValueError(_not_a("UnstructuredGrid", source.root))
    filled_pieces = (piece for piece in grid.findall("Piece") if int(piece.get("NumberOfCells", 0)))
    return [_piece(source, piece) for piece in filled_pieces]


def _piece(source: _Source, piece: ET.Element) -> _Piece:
    """Read a piece; cells that are copies of other pieces' cells are left out."""
    x = source.array(_required(piece, "Points/DataArray"))
    if x.ndim != 2 or x.shape[1] != 3 or len(x) != int(piece.get("NumberOfPoints", -1)):
        raise ValueError(f"its points do not match NumberOfPoints in rows of three; {AGAIN}")
    arrays = {a.get("Name", ""): source.array(a) for a in piece.findall("CellData/DataArray")}
    cells = {a.get("Name", ""): source.array(a) for a in piece.findall("Cells/DataArray")}
    count = int(piece.get("NumberOfCells", 0))
    wrong_arrays = [name for name, values in arrays.items() if len(values) != count]
    if {*cells} < {"connectivity", "offsets", "types"} or len(cells["types"]) != count:
        raise ValueError(f"its cells do not match NumberOfCells; {AGAIN}")
    if wrong_arrays or len(cells["offsets"]) != count:
        raise ValueError(
            f"its array {(wrong_arrays or ['offsets'])[0]} does not have one value per cell;"
            f" {AGAIN}"
        )
    array_names = {*arrays}
    flag = arrays.pop("vtkGhostType", None)
    level = arrays.pop("vtkGhostLevels", None)
    is_kept = np.ones(count, dtype=bool)
    if flag is not None:
        is_kept = (flag.astype(np.int64) & DUPLICATE) == 0
    elif level is not None:
        is_kept = level == 0
    unread: dict[int, int] = {}
    blocks = [*_blocks(cells, arrays, is_kept, unread)]
    if any(block.data.min() < 0 or block.data.max() >= len(x) for block in blocks):
        raise ValueError(f"a cell has a node that is not in the file; {AGAIN}")
    return _Piece(x, blocks, array_names, int((~is_kept).sum()), unread)


def _joined(pieces: Sequence[_Piece]) -> CellGrid:
    """Return nodes and cells of pieces as one grid. Nodes at the same place are not merged."""
    if not pieces:
        raise ValueError("has no cells")
    if any(piece.names != pieces[0].names for piece in pieces):
        raise ValueError(
            "its pieces have different arrays of cells; merge them (in ParaView: Merge Blocks)"
        )
    blocks = []
    shift = 0
    for piece in pieces:
        blocks += [replace(block, data=block.data + shift) for block in piece.blocks]
        shift += len(piece.points)
    notes = []
    if len(pieces) > 1:
        notes.append(f"geometry: the file has {len(pieces)} pieces, which are read as one mesh")
    ghosts = sum(piece.ghosts for piece in pieces)
    if ghosts:
        notes.append(f"geometry: {ghosts} ghost cells, copies of other pieces' cells, are left out")
    unread = sum((Counter(piece.unread) for piece in pieces), Counter())
    if unread:
        kinds = ", ".join(f"{n} of VTK type {kind}" for kind, n in sorted(unread.items()))
        notes.append(f"{NOT_READ}: {kinds}")
    return CellGrid(np.concatenate([piece.points for piece in pieces]), blocks, notes)


def _required(piece: ET.Element, path: str) -> ET.Element:
    """Return the element at a path in a piece."""
    element = piece.find(path)
    if element is None:
        raise ValueError(f"has no {path}: the file is damaged; {AGAIN}")
    return element


def _blocks(
    cells: dict[str, np.ndarray],
    arrays: dict[str, np.ndarray],
    keep: np.ndarray,
    unread: dict[int, int],
) -> Iterator[CellBlock]:
    """Return the triangles and tetrahedra to keep by kind; count other cells in ``unread``."""
    offsets = cells["offsets"].astype(np.int64)
    width = np.diff(offsets, prepend=0)
    if (width < 0).any() or (len(offsets) and offsets[-1] > len(cells["connectivity"])):
        raise ValueError(f"its offsets of cells are damaged; {AGAIN}")
    kinds = cells["types"].astype(np.int64)
    for kind in np.unique(kinds).tolist():
        for w in np.unique(width[kinds == kind]).tolist():
            rows = np.flatnonzero((kinds == kind) & (width == w) & keep)
            if not len(rows):
                continue
            if w in TETRAHEDRA.get(kind, ()) or w in TRIANGLES.get(kind, ()):
                positions = (offsets[rows] - w)[:, None] + np.arange(w)
                data = cells["connectivity"].astype(np.int64)[positions]
                dim = 3 if kind in TETRAHEDRA else 2
                yield CellBlock(dim, data, {n: v[rows] for n, v in arrays.items()})
            elif kind in SOLIDS:
                raise ValueError(
                    f"has {OTHER_VOLUMES.get(kind, 'other volumes')} (VTK type {kind}); {ONLY}"
                )
            else:
                unread[kind] = unread.get(kind, 0) + len(rows)
