"""Meshes of other programs: Abaqus and CalculiX ``.inp``, FEBio ``.feb``, MED, VTU, XDMF.

Regions are sets of cells by their names; boundaries are surfaces, sets of triangles, and sets of
nodes that contain whole facets. VTU and XDMF name nothing: an array of integers NAME makes
NAME_1, NAME_2, or a and b if it is called a-b, as meshio writes sets. What is not read is told.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from app.arrays import Ints
from app.mesh_files import abaqus, vtu
from app.mesh_files.content import (
    ONLY,
    ORDER,
    ORDER_MED,
    Found,
    case_names,
    extend,
    left_out,
    rows_of,
    word,
)

__all__ = ["READERS", "Found", "case_names", "left_out", "read", "word"]

MOST = 255  # values of an array; one of more does not tell regions apart
# Names of arrays that are regions, and of those that number cells, their kinds or processes.
REGIONS = re.compile(
    "material|region|label|part(?!ition)|tissue|domain|physical|segment|tags?$|^mat(_?id)?$",
    re.IGNORECASE,
)
BOOKKEEPING = re.compile(
    "global|element_?(type|id)|cell_?(ids?|type|number)|ghost|process|^ids?$|partition|rank|original"
    "|geometrical",
    re.IGNORECASE,
)


@lru_cache(maxsize=1)
def read(path: Path, modified: int) -> Found:
    """Return the content of a file, as it was modified last; its sets of cells are the regions.

    Raises:
        ValueError: The file is damaged or of no use; what is wrong, in words.
    """
    try:
        found = READERS[path.suffix](path)
        found.points = np.asarray(found.points, dtype=float)
        bad = np.flatnonzero(~np.isfinite(found.points).all(axis=1))
        if len(bad):
            raise ValueError(f"node {bad[0] + 1}: its coordinates are no numbers")
        _divide(found)
        clean = case_names(found.sets)
        found.sets = {clean[name]: rows for name, rows in found.sets.items()}
        clean = case_names([*found.triangles, *found.nodes])
        found.triangles = {clean[name]: block for name, block in found.triangles.items()}
        found.nodes = {clean[name]: rows for name, rows in found.nodes.items()}
    except Exception as error:  # of a damaged file there is no telling which
        cause = f"damaged, or no {path.suffix} file ({type(error).__name__} {error})"
        raise ValueError(str(error) if type(error) is ValueError else cause) from error
    return found


def _divide(found: Found) -> None:
    """Keep the sets of cells that are regions: not those that smaller and later ones fill."""
    free, left = np.ones(len(found.cells), dtype=bool), []
    for name, rows in sorted(reversed(found.sets.items()), key=lambda item: len(item[1])):
        if not free[rows].any():
            left.append(name)
        elif not free[rows].all():
            raise ValueError(
                f"its set {name} shares some cells with smaller ones: keep those sets alone that "
                "are regions, or name them by *SOLID SECTION in an .inp file"
            )
        free[rows] = False
    found.notes += left_out("sets without cells of their own are no regions", left)
    if free.all():
        raise ValueError("names no region: it has no set of tetrahedra with a name")
    found.sets = {name: rows for name, rows in found.sets.items() if name not in left}


# ------------------------------------------------------------------------------------- the others


def _feb(path: Path) -> Found:
    """FEBio 2.5 to 4: blocks of elements, surfaces, sets of nodes."""
    found, root = Found(), ET.parse(path).getroot()
    mesh = [part for grid in root if grid.tag in ("Mesh", "Geometry") for part in grid]
    items = [node for part in mesh if part.tag == "Nodes" for node in part]
    found.points = _table("Nodes", [node.text or "" for node in items], 3, float)
    number = np.array([node.attrib["id"] for node in items], dtype=np.int64)
    other = []
    for part in mesh:
        name = part.get("name", f"{part.tag}{part.get('mat', '')}")
        kinds = {part.attrib["type"]} if part.tag == "Elements" else {e.tag for e in part}
        known = [re.fullmatch(r"(tet|tri)(3|4|6|10)(G\w+)?", k, re.IGNORECASE) for k in kinds]
        if part.tag in ("Elements", "Surface") and not all(known):
            raise ValueError(f"{name}: is of type {', '.join(sorted(kinds))}; {ONLY}")
        if part.tag == "Elements" and known[0]:
            table = _table(name, [e.text or "" for e in part], int(known[0][2]), int)
            extend(found.sets, [name], found.add(rows_of(number, table, "node")))
        elif part.tag == "Surface":
            corners = [",".join((e.text or "").split(",")[:3]) for e in part]
            table = _table(name, corners, 3, int)
            extend(found.triangles, [name], rows_of(number, table, "node"))
        elif part.tag == "NodeSet":
            words = (part.text or "").replace(",", " ").split() + [n.attrib["id"] for n in part]
            ranges = ([*map(int, word.split(":"))] for word in words)
            parts = [np.arange(r[0], (r[1:2] or r)[0] + 1, (r[2:] or [1])[0]) for r in ranges]
            extend(found.nodes, [name], rows_of(number, np.concatenate(parts), "node"))
        elif part.tag != "Nodes":
            other.append(f"{part.tag} {name}")
    found.notes += left_out("of the file's mesh are not read", other)
    return found


def _table(name: str, lines: list[str], width: int, kind: type) -> Any:
    """Numbers of lines, apart by commas or blanks (n, width)."""
    try:
        numbers: Any = np.array(" ".join(lines).replace(",", " ").split(), dtype=kind)
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    if len(numbers) % width:
        text = f"{name}: {len(numbers)} numbers are no rows of {width}: is it cut short?"
        raise ValueError(text)
    return numbers.reshape(-1, width)


def _vtu(path: Path) -> Found:
    """VTU, all of its pieces."""
    grid = vtu.read(path)
    found = Found(points=grid.points)
    found.notes += grid.notes
    solids = [block for block in grid.blocks if block.dim == 3]
    names = grid.blocks[0].arrays if grid.blocks else {}
    data = {n: np.concatenate([b.arrays[n] for b in solids]) for n in names if solids}
    key, label = _choice(data, found)
    for block in grid.blocks if key else ():
        values = block.arrays[key]
        solid = block.dim == 3
        members = found.add(block.data) if solid else block.data[:, :3]
        for value in np.unique(values):
            extend(found.sets if solid else found.triangles, label(value), members[values == value])
    return found


def _meshio(path: Path) -> Found:
    """MED and XDMF, as meshio reads them."""
    found, order = Found(), ORDER_MED if path.suffix == ".med" else ORDER
    for mesh in _grids(path):
        found.points = mesh.points
        key, label = _labels(mesh, found)
        for k, block in enumerate(mesh.cells):
            if block.dim == 3 and block.type not in ("tetra", "tetra10"):
                raise ValueError(f"the cells are of type {block.type}; {ONLY}")
            if block.dim < 2 or not key:
                continue
            solid, values = block.dim == 3, mesh.cell_data[key][k].ravel()
            sets = found.sets if solid else found.triangles
            members = found.add(block.data, order) if solid else block.data[:, :3]
            for value in np.unique(values):
                extend(sets, label(value), members[values == value])
        for family, names in getattr(mesh, "point_tags", {}).items():
            extend(found.nodes, names, np.flatnonzero(mesh.point_data["point_tags"] == family))
    return found


def _grids(path: Path) -> Iterator[Any]:
    """Meshes in a file: of XDMF its grids, which meshio reads alone, with the first's nodes."""
    import meshio

    if path.suffix != ".xdmf":
        yield meshio.med.read(path)
        return
    root = ET.parse(path).getroot()
    geometry, reader = root.findall(".//Geometry")[:1], meshio.xdmf.main.XdmfReader(path)
    own = {
        "".join(g.itertext()).strip()
        for g in root.iter("Geometry")
        if g.find("DataItem") is not None
    }
    spatial = [g for g in root.iter("Grid") if g.get("CollectionType", "").lower() == "spatial"]
    if spatial or len(own) > 1:
        raise ValueError("has several grids with nodes of their own; save them as one mesh")
    for grid in root.findall("Domain/Grid"):
        alone = ET.Element("Xdmf")
        only = ET.SubElement(ET.SubElement(alone, "Domain"), "Grid")
        only.extend([*geometry, *(p for p in grid if p.tag in ("Topology", "Attribute"))])
        try:
            yield reader.read_xdmf3(alone)
        except KeyError:
            text = "cells of several kinds in one grid, which meshio does not read; divide them"
            raise ValueError(text) from None


def _labels(mesh: Any, found: Found) -> tuple[str, Callable[[int], list[str]]]:
    """The data of cells that tell sets apart, if any, and the names of sets by its values."""
    if hasattr(mesh, "cell_tags"):  # groups of MED
        return "cell_tags" * ("cell_tags" in mesh.cell_data), lambda v: mesh.cell_tags.get(v, [])
    solid = [k for k, block in enumerate(mesh.cells) if block.dim == 3] or range(len(mesh.cells))
    data = {}
    for name, blocks in mesh.cell_data.items():
        data[name] = np.concatenate([blocks[k].reshape(len(blocks[k]), -1) for k in solid])
        data[name] = data[name][:, 0] if data[name].shape[1] == 1 else data[name]
    return _choice(data, found)


def _choice(data: dict[str, Any], found: Found) -> tuple[str, Callable[[float], list[str]]]:
    """Array of cells that makes regions, and the names of sets by its values.

    It has few whole numbers, of integers or floats. Arrays whose names say that they are regions
    go before others, and arrays that differ between cells before constant ones. Numbers and kinds
    of cells and processes are no regions.

    Raises:
        ValueError: Several arrays divide the cells, each in another manner.
    """
    whole = {}
    for name, values in data.items():
        finite = values.ndim == 1 and values.dtype.kind in "iuf" and bool(np.isfinite(values).all())
        if finite and len(values) and (values == np.round(values)).all():
            if abs(values).max() < 2**53 and len(np.unique(values)) <= MOST:
                whole[name] = values.astype(np.int64)
    fit = [n for n in whole if not BOOKKEEPING.search(n)]
    named = [n for n in fit if REGIONS.search(n) or "-" in n]
    pool = named or fit
    differing = [n for n in pool if len(np.unique(whole[n])) > 1]
    if named and not differing:
        others = [n for n in fit if len(np.unique(whole[n])) > 1]
        differing = [*named[:1], *others] if others else []
    pool = differing or pool
    integers = [n for n in pool if data[n].dtype.kind in "iu"]
    pool = integers or pool
    if len(pool) > 1 and any(_divides(whole[n]) != _divides(whole[pool[0]]) for n in pool):
        raise ValueError(
            f"its arrays {', '.join(pool)} divide the cells, each in another manner: keep the one "
            "that makes the regions, or name it material"
        )
    if not pool:
        if data:
            listed = ", ".join(data)
            raise ValueError(
                f"names no region: none of its arrays of cells ({listed}) has whole numbers of "
                f"regions, at most {MOST} different ones; add one called material"
            )
        return "", lambda _: []
    key = pool[0]
    found.notes += [f"geometry: regions are the values of the array {key}"]
    found.notes += left_out("arrays of cells that are not read", (n for n in data if n != key))
    names = key.split("-")
    if whole[key].max() >= len(names):
        return key, lambda v: [f"{key}_{int(v)}"]
    return key, lambda v: names[int(v) : int(v) + 1] if v >= 0 else []


def _divides(values: Ints) -> list[int]:
    """The first cell of the part of each cell: the same for arrays that divide cells alike."""
    _, first, inverse = np.unique(values, return_index=True, return_inverse=True)
    return list(map(int, first[inverse]))


READERS = {".inp": abaqus.read, ".feb": _feb, ".med": _meshio, ".vtu": _vtu, ".xdmf": _meshio}
