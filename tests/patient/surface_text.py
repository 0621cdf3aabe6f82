"""Surfaces written as text and bytes, in the dialects of programs: STL, OBJ and PLY."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from app.patient import bone_surface, landmarks
from app.patient.bone_surface import BoneSurface
from tests.patient.bones import write

Faces = Sequence[Sequence[int]]


def stl_text(corners: Any, name: str = "femur") -> str:
    """Facets (m, 3, 3) as a solid of a text STL file."""
    facets = (
        "facet normal 0 0 0\n outer loop\n"
        + "".join("  vertex {:.9g} {:.9g} {:.9g}\n".format(*x) for x in facet)
        + " endloop\nendfacet\n"
        for facet in corners
    )
    return f"solid {name}\n{''.join(facets)}endsolid {name}\n"


def obj_vertices(points: Any, more: Callable[[int], str] = lambda k: "") -> str:
    """Vertices of an OBJ file, each followed by more values."""
    lines = ("v {:.9g} {:.9g} {:.9g}".format(*x) + more(k) for k, x in enumerate(points))
    return "".join(f"{line}\n" for line in lines)


def obj_faces(faces: Faces, corner: Callable[[int], str] = str) -> str:
    """Faces of an OBJ file; a corner is written by its number from 1."""
    return "".join("f " + " ".join(corner(i + 1) for i in face) + "\n" for face in faces)


def ply_header(kind: str, elements: Iterable[tuple[str, int, Sequence[str]]]) -> str:
    """Header of a PLY file by its elements: name, rows, properties."""
    lines = [f"ply\nformat {kind} 1.0\ncomment made by a test"]
    for name, rows, properties in elements:
        lines += [f"element {name} {rows}", *(f"property {p}" for p in properties)]
    return "\n".join([*lines, "end_header", ""])


PLACE = ("float x", "float y", "float z")
CORNERS = ("list uchar int vertex_indices",)


def ply_text(
    surface: BoneSurface,
    faces: Faces | None = None,
    properties: Sequence[str] = CORNERS,
    before: str = "",
    after: str = "",
) -> str:
    """A text PLY file. Other properties are before and after the corners of each face."""
    faces = surface.triangles.tolist() if faces is None else faces
    rows = [("vertex", len(surface.points), PLACE), ("face", len(faces), properties)]
    points = "".join("{:.9g} {:.9g} {:.9g}\n".format(*x) for x in surface.points)
    body = (f"{before}{len(f)} {' '.join(map(str, f))}{after}\n" for f in faces)
    return ply_header("ascii", rows) + points + "".join(body)


def ply_binary(
    surface: BoneSurface,
    faces: Faces | None = None,
    properties: Sequence[str] = CORNERS,
    before: bytes = b"",
    after: bytes = b"",
    order: str = "<",
) -> bytes:
    """The same file in binary."""
    faces = surface.triangles.tolist() if faces is None else faces
    kind = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    rows = [("vertex", len(surface.points), PLACE), ("face", len(faces), properties)]
    points = surface.points.astype(f"{order}f4").tobytes()
    body = (before + struct.pack(f"{order}B{len(f)}i", len(f), *f) + after for f in faces)
    return ply_header(kind, rows).encode() + points + b"".join(body)


def quads(surface: BoneSurface, above: float) -> tuple[Any, list[list[int]]]:
    """Points and faces. Triangles above a level are three quads each, about their middles.

    The edges at the level are divided on their upper side alone.
    """
    points, faces = surface.points.tolist(), []
    middles: dict[tuple[int, int], int] = {}

    def middle(a: int, b: int) -> int:
        key = (min(a, b), max(a, b))
        if key not in middles:
            middles[key] = len(points)
            points.append(((surface.points[a] + surface.points[b]) / 2).tolist())
        return middles[key]

    for a, b, c in surface.triangles.tolist():
        if surface.points[[a, b, c], 2].min() < above:
            faces.append([a, b, c])
            continue
        centre = len(points)
        points.append(surface.points[[a, b, c]].mean(axis=0).tolist())
        ab, bc, ca = middle(a, b), middle(b, c), middle(c, a)
        faces += [[a, ab, centre, ca], [b, bc, centre, ab], [c, ca, centre, bc]]
    return np.array(points), faces


def put(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def volume(corners: Any) -> float:
    a, b, c = np.moveaxis(corners, 1, 0)
    return float((np.cross(a, b) * c).sum() / 6)


def damaged(rng: random.Random, content: bytes) -> bytes:
    """A file that is cut, or has other bytes in it."""
    for _ in range(rng.choice((1, 1, 2, 6))):
        at = rng.randrange(len(content) + 1)
        start = rng.randrange(min(400, len(content)) + 1)
        match rng.randrange(6):
            case 0:
                content = content[:at]
            case 1:
                content = content[:at] + rng.randbytes(rng.randint(1, 20)) + content[at:]
            case 2:
                content = content[:at] + rng.randbytes(4) + content[at + 4 :]
            case 3:
                content = content[:start] + rng.randbytes(1) + content[start + 1 :]
            case 4:
                content = content[:start] + content[start + rng.randint(1, 30) :]
            case 5:
                word = rng.choice((b"-1 ", b"nan ", b"1e308 ", b"99999999999 ", b"\0\0\xff\x7f"))
                content = content[:at] + word + content[at + len(word) :]
    return content


def judged(path: Path) -> tuple[BoneSurface, landmarks.Frame]:
    surface = bone_surface.read(path)
    return surface, landmarks.find_landmarks(surface)


def stl(folder: Path, corners: Any) -> Path:
    points = corners.reshape(-1, 3)
    return write(folder / "bone.stl", BoneSurface(points, np.arange(len(points)).reshape(-1, 3)))
