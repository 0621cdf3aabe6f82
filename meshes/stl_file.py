"""Triangles of STL files, binary and text.

A binary file has 80 bytes of header, the number of triangles, and 50 bytes for each. A text file
has facets of three vertices within ``solid`` and ``endsolid``. Normals and colours are not read.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from app.foundation.arrays import Floats
from app.foundation.errors import GeometryError
from meshes.text_files import decoded, is_text, line_of

HEADER = 84  # bytes before the triangles of a binary file
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
BEGIN = re.compile(r"\s*solid\b(?:(?!\sfacet\s+normal\s+\S+\s+\S+\s+\S+\s+outer\s)[^\n])*", re.I)
END = re.compile(r"\s*end\s*solid\b[^\n]*", re.IGNORECASE)
FACET_END = re.compile(r"\bend\s*facet\b", re.IGNORECASE)


def read(path: Path) -> tuple[Floats, list[str]]:
    """Return corners of triangles (m, 3, 3) in the file's unit, and notes on what was read.

    Raises:
        GeometryError: The file is cut short, or its numbers or words are damaged.
    """
    data = path.read_bytes()
    if len(data) != size_of(data) and is_text(data):
        text, notes = decoded(data)
        if BEGIN.match(text):
            return _text(path, text, notes)
    return _binary(path, data)


def size_of(data: bytes) -> int | None:
    """Return the size of a binary file by its header [bytes]; None if it has no triangles."""
    if len(data) < HEADER or not _count(data):
        return None
    return HEADER + FACET_SIZE * _count(data)


def _count(data: bytes) -> int:
    """Number of triangles that a binary file's header gives."""
    return int.from_bytes(data[HEADER - 4 : HEADER], "little")


def _binary(path: Path, data: bytes) -> tuple[Floats, list[str]]:
    """Read the triangles of a binary file; their number has to agree with its length."""
    if len(data) < HEADER:
        raise GeometryError(f"{path}: is no STL file, of {len(data):,} bytes")
    count, notes = _count(data), []
    there, beyond = divmod(len(data) - HEADER, FACET_SIZE)
    if count in UNKNOWN and not beyond:
        notes.append(f"its header does not give their number, {there:,} by its length")
        count = there
    if count > there:
        raise GeometryError(
            f"{path}: is no STL file, or is cut short: as a binary one it has {there:,} of the"
            f" {count:,} triangles that its header gives"
        )
    rest = data[HEADER + FACET_SIZE * count :]
    second = size_of(rest)
    if second is not None and len(rest) >= second:
        text = f"a second STL file follows its {count:,} triangles"
        raise GeometryError(f"{path}: {text}; merge them into one, or keep the femur")
    if rest.strip(b"\0") and not beyond:
        text = f"its header gives {count:,} triangles, and there are {there:,}"
        raise GeometryError(f"{path}: {text}; write it anew")
    if rest:
        notes.append(f"{len(rest):,} bytes after its end are left out")
    rows = np.frombuffer(data, FACET_TYPE, count, HEADER)
    with np.errstate(invalid="ignore"):  # of damaged numbers
        corners = rows["normal and corners"][:, 1:].astype(float)
    return corners, [f"{count:,} triangles of a binary STL file", *notes]


def _text(path: Path, text: str, notes: list[str]) -> tuple[Floats, list[str]]:
    """Read the triangles of a text file; all facets have to be read, and all solids to end."""
    text = text.rstrip("\0\x1a \t\n")
    corners: list[tuple[str, ...]] = []
    at, solids = 0, 0
    while at < len(text):
        begin = BEGIN.match(text, at)
        if not begin:
            raise _unread(path, text, at, "`solid`")
        solids += 1
        first, at = begin.start() + 1, begin.end()
        facet = FACET.match(text, at)
        while facet:
            corners.append(facet.groups())
            at = facet.end()
            facet = FACET.match(text, at)
        end = END.match(text, at)
        if not end:
            rest = text[at:].lstrip()
            read = f"after {len(corners):,} facets"
            if not rest or BEGIN.match(rest):
                raise GeometryError(
                    f"{path}: its solid of line {line_of(text, first)} has no `endsolid`, {read}:"
                    " is it cut short? If not, add that line"
                )
            if FACET_END.search(rest):
                raise _unread(path, text, at, "a facet of three vertices, or `endsolid`")
            where = line_of(text, len(text) - len(rest))
            raise GeometryError(
                f"{path}: line {where}: ends or is damaged in a facet, {read}; is it cut short?"
            )
        at = end.end()
    facets = len(FACET_END.findall(text))
    if facets > len(corners):
        raise GeometryError(
            f"{path}: {facets:,} facets end in it, and {len(corners):,} could be read: names of"
            " solids must end with their line"
        )
    try:
        values = np.array([[float(word) for word in facet] for facet in corners])
    except ValueError:
        word = next(w for facet in corners for w in facet if not _is_number(w))
        where = line_of(text, text.index(word))
        raise GeometryError(f"{path}: line {where}: `{word[:40]}` is no number") from None
    several = f" in {solids} solids" if solids > 1 else ""
    return values.reshape(-1, 3, 3), [
        f"{len(corners):,} triangles of a text STL file{several}",
        *notes,
    ]


def _unread(path: Path, text: str, at: int, expected: str) -> GeometryError:
    """Return the error on text that an STL file does not have there."""
    rest = text[at:].lstrip()
    words = " ".join(rest.split()[:6])[:60]
    where = line_of(text, len(text) - len(rest))
    return GeometryError(f"{path}: line {where}: expected {expected}; it has `{words}`")


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
