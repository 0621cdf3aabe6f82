"""STL files, binary and text."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from app.foundation.arrays import Floats
from app.foundation.errors import GeometryError
from app.patient.file_text import decoded, is_text, line_number

# Bytes before the triangles of a binary file.
HEADER_SIZE = 84
# Bytes of each of them.
FACET_SIZE = 50
# Counts in headers that were written before the triangles.
UNKNOWN_COUNTS = (0, 2**32 - 1)
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


def read(path: Path) -> tuple[Floats, list[str]]:
    """Return corners of triangles (m, 3, 3) in the file's unit, and notes on what was read.

    Raises:
        GeometryError: The file is cut short, or its numbers or words are damaged.
    """
    data = path.read_bytes()
    if len(data) != size(data) and is_text(data):
        text, notes = decoded(data)
        if SOLID_BEGIN.match(text):
            return _text(path, text, notes)
    return _binary(path, data)


def size(data: bytes) -> int | None:
    """Return the size of a binary file by its header [bytes]; None if it has no triangles."""
    if len(data) < HEADER_SIZE or not _header_count(data):
        return None
    return HEADER_SIZE + FACET_SIZE * _header_count(data)


def _header_count(data: bytes) -> int:
    """Number of triangles that a binary file's header gives."""
    return int.from_bytes(data[HEADER_SIZE - 4 : HEADER_SIZE], "little")


def _binary(path: Path, data: bytes) -> tuple[Floats, list[str]]:
    """Read the triangles of a binary file; their number has to agree with its length."""
    if len(data) < HEADER_SIZE:
        raise GeometryError(f"{path}: is not an STL file: it has only {len(data):,} bytes")
    count, notes = _header_count(data), []
    stored_count, extra_bytes = divmod(len(data) - HEADER_SIZE, FACET_SIZE)
    if count in UNKNOWN_COUNTS and not extra_bytes:
        notes.append("their number follows from the length of the file, not from its header")
        count = stored_count
    swapped = int.from_bytes(data[HEADER_SIZE - 4 : HEADER_SIZE], "big")
    if stored_count and not extra_bytes and swapped == stored_count:
        fault = (
            f"its {stored_count:,} triangles are in big-endian order; STL files are little-endian"
        )
        raise GeometryError(f"{path}: {fault}. Write it again")
    if count > stored_count:
        raise GeometryError(
            f"{path}: is not an STL file, or is cut short: read as binary STL, it"
            f" has {stored_count:,} of"
            f" the {count:,} triangles in its header"
        )
    remaining_bytes = data[HEADER_SIZE + FACET_SIZE * count :]
    second_size = size(remaining_bytes)
    if second_size is not None and len(remaining_bytes) >= second_size:
        fault = f"a second STL file follows its {count:,} triangles"
        raise GeometryError(f"{path}: {fault}; merge both into one, or keep the femur alone")
    if remaining_bytes.strip(b"\0") and not extra_bytes:
        fault = f"its header gives {count:,} triangles, but it contains {stored_count:,}"
        raise GeometryError(f"{path}: {fault}; write it again")
    if remaining_bytes:
        notes.append(f"{len(remaining_bytes):,} bytes after its end are left out")
    rows = np.frombuffer(data, FACET_TYPE, count, HEADER_SIZE)
    with np.errstate(invalid="ignore"):  # of damaged numbers
        corners = rows["normal and corners"][:, 1:].astype(float)
    return corners, [f"{count:,} triangles of a binary STL file", *notes]


def _text(path: Path, text: str, notes: list[str]) -> tuple[Floats, list[str]]:
    """Read the triangles of a text file; all facets have to be read, and all solids to end."""
    text = text.rstrip("\0\x1a \t\n")
    corners: list[tuple[str, ...]] = []
    position, solids = 0, 0
    while position < len(text):
        solid_begin = SOLID_BEGIN.match(text, position)
        if not solid_begin:
            raise _unexpected_text(path, text, position, "`solid`")
        solids += 1
        begin_position, position = solid_begin.start() + 1, solid_begin.end()
        facet = FACET.match(text, position)
        while facet:
            corners.append(facet.groups())
            position = facet.end()
            facet = FACET.match(text, position)
        solid_end = SOLID_END.match(text, position)
        if not solid_end:
            remaining_text = text[position:].lstrip()
            progress = f"after {len(corners):,} facets"
            if not remaining_text or SOLID_BEGIN.match(remaining_text):
                raise GeometryError(
                    f"{path}: the solid that begins in line {line_number(text, begin_position)} has"
                    f" no `endsolid` {progress}; is the file cut short? If not, add that line"
                )
            if FACET_END.search(remaining_text):
                raise _unexpected_text(
                    path, text, position, "a facet of three vertices, or `endsolid`"
                )
            line = line_number(text, len(text) - len(remaining_text))
            raise GeometryError(
                f"{path}: line {line}: the file is cut short or damaged in a facet, {progress}"
            )
        position = solid_end.end()
    facets = len(FACET_END.findall(text))
    if facets > len(corners):
        raise GeometryError(
            f"{path}: only {len(corners):,} of its {facets:,} facets could be read; the name of a"
            " solid must end with its line"
        )
    try:
        values = np.array([[float(word) for word in facet] for facet in corners])
    except ValueError:
        wrong_word = next(w for facet in corners for w in facet if not _is_number(w))
        line = line_number(text, text.index(wrong_word))
        raise GeometryError(f"{path}: line {line}: `{wrong_word[:40]}` is not a number") from None
    several = f" in {solids} solids" if solids > 1 else ""
    return values.reshape(-1, 3, 3), [
        f"{len(corners):,} triangles of a text STL file{several}",
        *notes,
    ]


def _unexpected_text(path: Path, text: str, position: int, expected: str) -> GeometryError:
    """Return the error on unexpected text at a position."""
    remaining_text = text[position:].lstrip()
    unexpected_words = " ".join(remaining_text.split()[:6])[:60]
    line = line_number(text, len(text) - len(remaining_text))
    return GeometryError(
        f"{path}: line {line}: expected {expected}, but it has `{unexpected_words}`"
    )


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
