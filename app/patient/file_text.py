"""Text of surface files: its encoding, ends of lines, decimal commas."""

from __future__ import annotations

import codecs
import re

# Encodings by their byte-order marks.
ENCODINGS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
# Vertices of STL or OBJ files with a comma, or with a point, between digits.
COMMA = re.compile(r"^\s*v(?:ertex)?\s[^\n]*\d,\d", re.IGNORECASE | re.MULTILINE)
POINT = re.compile(r"^\s*v(?:ertex)?\s[^\n]*\d\.\d", re.IGNORECASE | re.MULTILINE)


def decoded(data: bytes) -> tuple[str, list[str]]:
    """Return the text of a file with line feeds only, and notes on it.

    Names may be in any encoding. Decimal commas become points if no vertex has a point.
    """
    byte_order_mark = next(
        (byte_order_mark for byte_order_mark in ENCODINGS if data.startswith(byte_order_mark)), None
    )
    text = data.decode(
        ENCODINGS[byte_order_mark] if byte_order_mark else "latin-1", errors="replace"
    )
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    if not COMMA.search(text) or POINT.search(text):
        return text, []
    return re.sub(r"(?<=\d),(?=\d)", ".", text), ["decimal commas are read as points"]


def is_text(data: bytes) -> bool:
    """Return True if the first bytes of a file are text."""
    return data.startswith(tuple(ENCODINGS)) or b"\0" not in data[:2000]


def line_number(text: str, position: int) -> int:
    """Return the number of the line at a position, from 1."""
    return text.count("\n", 0, position) + 1
