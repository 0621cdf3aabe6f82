"""OBJ files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from app.foundation.arrays import Floats
from app.foundation.errors import GeometryError
from app.patient.file_text import decoded
from app.patient.polygons import corners_of

# Statements that do not change the shape of flat faces.
IGNORED_STATEMENTS = frozenset(
    "vn vt vp g o s mg usemtl mtllib usemap maplib lod bevel c_interp d_interp shadow_obj"
    " trace_obj".split()
)


def read(path: Path) -> tuple[Floats, list[str]]:
    """Return corners of triangles (m, 3, 3) in the file's unit, and notes on what was read.

    Raises:
        GeometryError: A vertex or a face is damaged, or there are none.
    """
    file_text, notes = decoded(path.read_bytes())
    points: list[tuple[float, ...]] = []
    faces: list[list[int]] = []
    face_lines: list[int] = []  # of the faces
    unread: Counter[str] = Counter()
    for number, (word, *arguments) in _statements(file_text):
        try:
            if word == "v":
                x, y, z, *_ = arguments  # a weight or a colour may follow
                points.append((float(x), float(y), float(z)))
            elif word in ("f", "fo"):
                numbers = [int(corner.partition("/")[0]) for corner in arguments]
                faces.append(
                    [i - 1 if i > 0 else _vertex_from_end(i, len(points)) for i in numbers]
                )
                face_lines.append(number)
            elif word not in IGNORED_STATEMENTS:
                unread[word] += 1
        except ValueError:
            rule = "a vertex has three numbers" if word == "v" else "corners are whole numbers"
            shown_line = " ".join([word, *arguments])[:60]
            raise GeometryError(f"{path}: line {number}: `{shown_line}`: {rule}") from None
    if not faces:
        kinds = ", ".join(word[:20] for word in sorted(unread)[:5])
        unread_text = f"; it has lines of {kinds}, which are not read" if kinds else ""
        raise GeometryError(f"{path}: has no faces (lines that begin with f){unread_text}")
    corners, divided = corners_of(
        path, np.array(points).reshape(-1, 3), faces, lambda k: f"line {face_lines[k]}: the face"
    )
    if unread:
        named = ", ".join(f"{n:,} of {word[:20]}" for word, n in sorted(unread.items())[:5])
        notes.append(f"lines that are not read: {named}")
    return corners, [f"{len(faces):,} faces of an OBJ file", *divided, *notes]


def _vertex_from_end(index: int, vertices: int) -> int:
    """Return the number of a vertex that is counted back from the last one; -1 if there is none."""
    return vertices + index if 0 < -index <= vertices else -1


def _statements(text: str) -> Iterator[tuple[int, list[str]]]:
    """Return the number and words of each line with words; a backslash continues a line."""
    continued = ""
    for number, line in enumerate(text.split("\n"), 1):
        line = continued + line.partition("#")[0]
        if line.rstrip().endswith("\\"):
            continued = line.rstrip()[:-1] + " "
            continue
        continued = ""
        statement_words = line.split()
        if statement_words:
            yield number, [statement_words[0].lower(), *statement_words[1:]]
    statement_words = continued.split()
    if statement_words:
        yield number, [statement_words[0].lower(), *statement_words[1:]]
