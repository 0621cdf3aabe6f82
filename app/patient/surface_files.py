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

from pathlib import Path

from app.foundation.arrays import Floats
from app.foundation.errors import GeometryError
from app.patient import obj, ply, stl
from app.patient.file_text import decoded, is_text
from app.patient.foreign_formats import WRAPPED, ForeignFormats, foreign_format, vtk_formats

SUFFIXES = (".stl", ".ply", ".obj")
# Files of other formats, with their remedies.
OTHER_FORMATS: ForeignFormats = {
    **WRAPPED,
    **vtk_formats(),
    b"\x1f\x8b": ("is compressed by gzip", "unpack it"),
    b"7z\xbc\xaf": ("is a 7z archive", "unpack it"),
    b"<!DOCTYPE": ("is a page of HTML, not the file", ""),
    b"<html": ("is a page of HTML, not the file", ""),
    b"OFF": ("is an OFF file", ""),
    b"COFF": ("is an OFF file", ""),
    b"\x89HDF": ("is an HDF5 file", ""),
    b"ISO-10303": ("is a STEP file", ""),
    bytes(128) + b"DICM": ("is an image of DICOM", "give it as `image`, with a `label`"),
}


def read(path: Path) -> tuple[Floats, list[str]]:
    """Return corners of triangles (m, 3, 3) in the file's unit, and notes on what was read.

    Raises:
        GeometryError: The file has another format, or is cut short or damaged.
    """
    suffix = path.suffix.lower()
    expected_suffixes = ", ".join(SUFFIXES)
    if suffix not in SUFFIXES:
        raise GeometryError(
            f"{path}: has the ending `{path.suffix}`; expected one of {expected_suffixes}"
        )
    with path.open("rb") as file:
        first_bytes = file.read(100_000)
    if not first_bytes:
        raise GeometryError(f"{path}: is empty")
    size = path.stat().st_size
    foreign = foreign_format(first_bytes, OTHER_FORMATS, f"one of {expected_suffixes}")
    # The header of a binary STL may begin with any words.
    if foreign and size != stl.size(first_bytes):
        raise GeometryError(f"{path}: {foreign}")
    file_suffix = _format_of(first_bytes, size)
    if file_suffix and file_suffix != suffix:
        suffix_words = {".stl": "an STL", ".obj": "an OBJ", ".ply": "a PLY"}[file_suffix]
        raise GeometryError(
            f"{path}: is {suffix_words} file by its content; rename it to *{file_suffix}"
        )
    match suffix:
        case ".stl":
            return stl.read(path)
        case ".ply":
            return ply.read(path)
    return obj.read(path)


def _format_of(first_bytes: bytes, size: int) -> str | None:
    """Return the suffix of the format of a file by its first bytes and size, None if unknown."""
    if size == stl.size(first_bytes):
        return ".stl"
    if not is_text(first_bytes) and not first_bytes.startswith(b"ply"):
        return None
    word_lists = [line.split() for line in decoded(first_bytes)[0].split("\n")]
    first_words = [line[0].lower() for line in word_lists if line]
    match first_words[:1]:
        case ["ply"]:
            return ".ply"
        case ["solid"]:
            return ".stl"
    return ".obj" if "v" in first_words else None
