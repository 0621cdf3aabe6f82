"""Files of formats that a reader cannot use, recognized by their first bytes.

A table of such formats has for each beginning of a file its format and the remedy. The remedy is
empty if only a conversion helps.
"""

from __future__ import annotations

from collections.abc import Mapping

ForeignFormats = Mapping[bytes, tuple[str, str]]

# Archives and pointers, from which the actual file must be taken first.
WRAPPED: ForeignFormats = {
    b"PK\x03\x04": ("is a ZIP archive", "unpack it"),
    b"version https://git-lfs": (
        "is a pointer of Git LFS, not the file",
        "`git lfs pull` brings it",
    ),
}


def vtk_formats(remedy: str = "") -> ForeignFormats:
    """Formats of VTK, with a remedy."""
    return {
        b"# vtk": ("is a file of VTK", remedy),
        b"<VTKFile": ("is XML of VTK", remedy),
        b"<?xml": ("is XML, as VTK and 3MF write it", remedy),
    }


def foreign_format(first_bytes: bytes, formats: ForeignFormats, expected: str) -> str:
    """Return the format of a file and the remedy in words; empty if it is in no table.

    Args:
        first_bytes: The beginning of the file.
        formats: Formats by the beginnings of their files, in any case.
        expected: Formats that can be read, which are named if there is no remedy.
    """
    for known_bytes, (description, remedy) in formats.items():
        if first_bytes[: len(known_bytes)].lower() == known_bytes.lower():
            return f"{description}: {remedy}" if remedy else f"{description}; expected {expected}"
    return ""
