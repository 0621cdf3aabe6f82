"""Meshes of other programs: Abaqus and CalculiX ``.inp``, FEBio ``.feb``, MED, VTU and XDMF.

Regions are sets of cells by their names. Boundaries are surfaces, sets of triangles, and sets of
nodes that contain whole facets. VTU and XDMF have no names: the values of an array NAME make the
regions NAME_1, NAME_2. An array that is called a-b, as meshio writes sets, makes a and b. Notes
list what is not read.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import TypeVar
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from app.mesh_files import abaqus, med, named, regions, vtu, xdmf
from app.mesh_files.content import (
    AGAIN,
    NO_REGION,
    ONLY,
    CellGrid,
    FileContent,
    Pick,
    case_names,
    extend,
    left_out,
    numbers_in,
    rows_of,
    same_facets,
    word,
)

__all__ = [
    "READERS",
    "FileContent",
    "Pick",
    "case_names",
    "check",
    "left_out",
    "read",
    "same_facets",
    "word",
]

EVERYTHING = Pick()
Number = TypeVar("Number", np.float64, np.int64)


def read(path: Path, pick: Pick = EVERYTHING) -> FileContent:
    """Return the content of a file; its sets of cells are the regions.

    Raises:
        ValueError: The file is damaged or has no mesh that can be used.
    """
    return _read(path, pick, named.stamps(path))


def check(path: Path, pick: Pick) -> None:
    """Raise ValueError if parts are picked that files of this kind do not have."""
    for key, suffixes in PICKED.items():
        if getattr(pick, key) and path.suffix.lower() not in suffixes:
            raise ValueError(f"`{key}` applies only to {', '.join(suffixes)}; leave it out")


@lru_cache(maxsize=1)
def _read(path: Path, pick: Pick, _stamps: tuple[tuple[str, int], ...]) -> FileContent:
    try:
        content = READERS[path.suffix.lower()](path, pick)
        content.points = np.asarray(content.points, dtype=float)
        bad_nodes = np.flatnonzero(~np.isfinite(content.points).all(axis=1))
        if len(bad_nodes):
            raise ValueError(
                f"node {bad_nodes[0] + 1} has a coordinate that is not a number; {AGAIN}"
            )
        _divide(content)
        new_names = case_names(content.sets)
        content.sets = {new_names[name]: rows for name, rows in content.sets.items()}
        new_names = case_names([*content.triangles, *content.nodes])
        content.triangles = {new_names[name]: block for name, block in content.triangles.items()}
        content.nodes = {new_names[name]: rows for name, rows in content.nodes.items()}
    except Exception as error:  # damaged files let readers fail in any way
        cause = f"is not a {path.suffix} file, or it is damaged: {AGAIN}"
        cause += f" (reading ended with {type(error).__name__}: {error})"
        raise ValueError(str(error) if type(error) is ValueError else cause) from error
    return content


def _divide(content: FileContent) -> None:
    """Drop sets of cells that smaller or later sets fill: they are not regions."""
    is_free, dropped = np.ones(len(content.cells), dtype=bool), []
    for name, rows in sorted(reversed(content.sets.items()), key=lambda item: len(item[1])):
        if not is_free[rows].any():
            dropped.append(name)
        elif not is_free[rows].all():
            raise ValueError(
                f"its set {name} shares some of its cells with smaller sets, so these cells would "
                "be in two regions: keep only the sets that are regions, or name the regions by "
                "*SOLID SECTION in an .inp file"
            )
        is_free[rows] = False
    message = "sets whose cells are all in smaller sets, which are not regions"
    content.notes += left_out(message, dropped)
    if is_free.all():
        raise ValueError(NO_REGION)
    content.sets = {name: rows for name, rows in content.sets.items() if name not in dropped}


def _feb(path: Path, _pick: Pick) -> FileContent:
    """Read a file of FEBio 2.5 to 4: blocks of elements, surfaces, sets of nodes.

    Triangles among the elements (shells) are a surface.
    """
    content, root = FileContent(), ET.parse(path).getroot()
    mesh = [part for grid in root if grid.tag in ("Mesh", "Geometry") for part in grid]
    items = [node for part in mesh if part.tag == "Nodes" for node in part]
    content.points = _table("Nodes", [node.text or "" for node in items], 3, np.float64)
    number = np.array([node.attrib["id"] for node in items], dtype=np.int64)
    unread = []
    for part in mesh:
        name = part.get("name", f"{part.tag}{part.get('mat', '')}")
        kinds = {part.attrib["type"]} if part.tag == "Elements" else {e.tag for e in part}
        matches = [re.fullmatch(r"(tet|tri)(3|4|6|10)(G\w+)?", k, re.IGNORECASE) for k in kinds]
        if part.tag in ("Elements", "Surface") and not all(matches):
            raise ValueError(f"{name}: is of type {', '.join(sorted(kinds))}; {ONLY}")
        if part.tag == "Elements" and matches[0]:
            table = _table(name, [e.text or "" for e in part], int(matches[0][2]), np.int64)
            rows = rows_of(number, table, "node")
            if matches[0][1].lower() == "tri":
                extend(content.triangles, [name], rows[:, :3])
            else:
                extend(content.sets, [name], content.add(rows))
        elif part.tag == "Surface":
            corners = [",".join((e.text or "").split(",")[:3]) for e in part]
            table = _table(name, corners, 3, np.int64)
            extend(content.triangles, [name], rows_of(number, table, "node"))
        elif part.tag == "NodeSet":
            node_words = (part.text or "").replace(",", " ").split() + [
                n.attrib["id"] for n in part
            ]
            node_ranges = [numbers_in(*map(int, word.split(":"))) for word in node_words]
            extend(content.nodes, [name], rows_of(number, np.concatenate(node_ranges), "node"))
        elif part.tag != "Nodes":
            unread.append(f"{part.tag} {name}")
    content.notes += left_out("parts of the file's mesh that are not read", unread)
    return content


def _table(name: str, lines: list[str], width: int, kind: type[Number]) -> NDArray[Number]:
    """Numbers of lines, separated by commas or blanks (n, width)."""
    try:
        numbers = np.array(" ".join(lines).replace(",", " ").split(), dtype=kind)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    if len(numbers) % width:
        message = f"{name}: {len(numbers)} numbers do not make rows of {width}: {AGAIN}"
        raise ValueError(message)
    return numbers.reshape(-1, width)


def _arrays(read: Callable[[Path], CellGrid]) -> Callable[[Path, Pick], FileContent]:
    """Return a reader of files whose regions are values of arrays of cells."""

    def reader(path: Path, pick: Pick) -> FileContent:
        content = FileContent()
        regions.fill_regions(content, read(path), pick.array)
        return content

    return reader


# Suffixes of files in which each kind of part can be picked.
PICKED = {"array": (".vtu", ".pvtu", ".xdmf", ".xmf"), "meshes": (".med",)}
READERS: dict[str, Callable[[Path, Pick], FileContent]] = {
    ".inp": lambda path, pick: abaqus.read(path),
    ".feb": _feb,
    ".med": med.read,
    ".vtu": _arrays(vtu.read),
    ".pvtu": _arrays(vtu.read_parallel),
    ".xdmf": _arrays(xdmf.read),
    ".xmf": _arrays(xdmf.read),
}
