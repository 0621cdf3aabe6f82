"""MED, VTU and XDMF files: regions by groups, or by the values of an array of cells."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from app.arrays import Ints
from app.mesh_files import vtu
from app.mesh_files.content import ONLY, ORDER, Found, extend, left_out
from app.mesh_files.grids import FileGrid

# The cells of MED are inside out, too.
ORDER_MED = [0, 2, 1, 3, 6, 5, 4, 7, 8, 9]
SOLID = ("tetra", "tetra10")
FLAT = ("triangle", "triangle6")
# Cells without area or volume: left out.
LINES = re.compile(r"vertex|line\d*|poly_?(vertex|line)|VTK_LAGRANGE_CURVE")
PLANE = re.compile(r"(triangle|quad|polygon|pixel)\d*|VTK_LAGRANGE_(TRIANGLE|QUADRILATERAL)")
# Values of an array: one of more does not tell regions apart.
MOST = 255
# Distance of a value from a whole number.
WHOLE = 1e-6
# Arrays that number cells, processes or kinds of cells (lower case, letters alone).
NUMBERING = re.compile(
    r"(vtk|paraview)?(global|original|local|source|parent)?(cell|element|elem|point|node)?s?"
    r"(ids?|index|indices|numbers?)|(element|cell|vtkcell)types?|vtkghost\w*|ghost\w*|"
    r"(vtk)?(process|proc|processor|rank|partition|block)(ids?)?"
)
# Arrays that name regions.
REGIONS = re.compile(
    r"mat(erial)?|region|label|domain|part|tissue|segment|physical|entity|group|bod(y|ies)|zone|"
    r"tag|bone|cement|implant|stem",
    re.IGNORECASE,
)


def read(path: Path) -> Found:
    """Nodes, cells and sets of a file.

    Raises:
        ValueError: The file is damaged, its cells cannot be used, or nothing names regions.
    """
    found = Found()
    order = ORDER_MED if path.suffix == ".med" else ORDER
    without: list[Ints] = []
    arrays: list[str] = []
    of_points: list[str] = []
    grids = _vtu(path, found) if path.suffix == ".vtu" else _by_meshio(path, found)
    for grid, first in grids:
        found.points = np.concatenate([found.points[:first], grid.points])
        wrong = [
            kind
            for kind, _ in grid.cells
            if not (kind in (*SOLID, *FLAT) or LINES.fullmatch(kind) or PLANE.fullmatch(kind))
        ]
        if wrong:
            raise ValueError(f"the cells are of type {wrong[0]}; {ONLY}")
        plane = sum(
            len(cells) for kind, cells in grid.cells if PLANE.fullmatch(kind) and kind not in FLAT
        )
        if plane:
            found.told.append(f"geometry: {plane} plane cells that are no triangles are left out")
        key, label = _labels(grid, found)
        arrays += grid.data
        of_points += grid.of_points
        for k, (kind, cells) in enumerate(grid.cells):
            solid = kind in SOLID
            if not solid and kind not in FLAT:
                continue
            if not key:
                if solid:
                    without.append(cells + first)
                continue
            values = np.round(grid.data[key][k].ravel()).astype(np.int64)
            members = found.add(cells + first, order) if solid else cells[:, :3] + first
            sets = found.sets if solid else found.triangles
            for value in np.unique(values):
                for name in label(int(value)):
                    extend(sets, name, members[values == value])
        for name, rows in grid.nodes.items():
            extend(found.nodes, name, rows + first)
    if without and not found.sets:
        raise ValueError(_nameless(arrays, of_points))
    _add_unnamed(found, without, order)
    return found


def _nameless(arrays: list[str], of_points: list[str]) -> str:
    """The reason why no array names regions."""
    text = "names no region: it has no array of cells"
    if arrays:
        text = (
            f"names no region: none of its arrays of cells ({', '.join(dict.fromkeys(arrays))}) "
            f"has up to {MOST} different whole numbers that are regions"
        )
    if of_points:
        text += f"; arrays of points ({', '.join(dict.fromkeys(of_points))}) do not count"
    return f"{text}; write one, e.g. 'material', with a whole number for each cell"


def _add_unnamed(found: Found, without: list[Ints], order: list[int]) -> None:
    """Add cells of grids without regions that no grid with regions has (DOLFINx writes both)."""
    if not without:
        return
    named = np.sort(found.cells[:, :4], axis=1)
    for cells in without:
        corners = np.concatenate([named, np.sort(cells[:, :4], axis=1)])
        _, label = np.unique(corners, axis=0, return_inverse=True)
        first, second = np.split(label.ravel(), [len(named)])
        new = ~np.isin(second, first)
        if new.any():
            found.add(cells[new], order)


def _vtu(path: Path, found: Found) -> Iterator[tuple[FileGrid, int]]:
    grid, told = vtu.read(path)
    found.told += told
    yield grid, 0


def _by_meshio(path: Path, found: Found) -> Iterator[tuple[FileGrid, int]]:
    """Grids of a MED or XDMF file, each with the row of its first node."""
    import meshio

    if path.suffix == ".med":
        mesh = meshio.med.read(path)
        grid = _grid(mesh)
        grid.groups = getattr(mesh, "cell_tags", {})
        tags = mesh.point_data.get("point_tags")
        for family, names in getattr(mesh, "point_tags", {}).items():
            for name in names if tags is not None else ():
                extend(grid.nodes, name, np.flatnonzero(tags == family))
        yield grid, 0
        return
    root = ET.parse(path).getroot()
    reader = meshio.xdmf.main.XdmfReader(path)
    geometries: list[tuple[str, ET.Element, int]] = []
    count = 0
    for item in _xdmf_grids(root, found):
        geometry = item.find("Geometry")
        text = "" if geometry is None else ET.tostring(geometry, "unicode").strip()
        known = [(g, n) for other, g, n in geometries if other == text]
        if geometry is None:
            known = [(g, n) for _, g, n in geometries[:1]]
        first = known[0][1] if known else count
        if geometry is not None and not known:
            geometries.append((text, geometry, count))
        source = known[0][0] if known else geometry
        alone = ET.Element("Xdmf")
        only = ET.SubElement(ET.SubElement(alone, "Domain"), "Grid")
        only.extend([source] if source is not None else [])
        only.extend(part for part in item if part.tag in ("Topology", "Attribute"))
        try:
            grid = _grid(reader.read_xdmf3(alone))
        except KeyError:
            text = "cells of several kinds in one grid, which meshio does not read; divide them"
            raise ValueError(text) from None
        count = max(count, first + len(grid.points))
        if known:
            grid.points = np.concatenate([grid.points, found.points[first + len(grid.points) :]])
        yield grid, first


def _xdmf_grids(root: ET.Element, found: Found) -> Iterator[ET.Element]:
    """Grids with cells; of those at several times the first."""
    later, empty = [], []

    def walk(parent: ET.Element) -> Iterator[ET.Element]:
        temporal = parent.get("CollectionType") == "Temporal"
        children = parent.findall("Grid")
        for k, child in enumerate(children):
            name = child.get("Name", "Grid")
            if temporal and k:
                later.append(name)
            elif child.find("Topology") is not None:
                yield child
            elif child.find("Grid") is not None:
                yield from walk(child)
            else:
                empty.append(name)

    for domain in root.findall("Domain"):
        yield from walk(domain)
    found.told += left_out("grids at later times are not read", later)
    found.told += left_out("grids without cells in them are not read", empty)


def _grid(mesh: Any) -> FileGrid:
    """A mesh of meshio with three coordinates."""
    points = np.asarray(mesh.points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError("its points have no three coordinates")
    return FileGrid(
        points,
        [(block.type, np.asarray(block.data)) for block in mesh.cells],
        {name: [np.asarray(b) for b in blocks] for name, blocks in mesh.cell_data.items()},
        list(mesh.point_data),
    )


def _labels(grid: FileGrid, found: Found) -> tuple[str, Callable[[int], list[str]]]:
    """Array of cells that names regions, if any, and the names of sets by its values."""
    groups = grid.groups
    if groups is not None:
        key = "cell_tags" if "cell_tags" in grid.data else ""
        return key, lambda value: groups.get(value, [])
    name = _best(grid)
    found.told += left_out(
        "arrays of cells that are not read", (other for other in grid.data if other != name)
    )
    if not name:
        return "", lambda _: []
    of_meshio = _names_by_meshio(name, _values(grid, name, (*SOLID, *FLAT)))
    if of_meshio:
        return name, lambda value: of_meshio[value : value + 1] if value >= 0 else []
    found.told += left_out("regions and boundaries are the values of the array", [name])
    return name, lambda value: [f"{name}_{value}"]


def _names_by_meshio(name: str, values: np.ndarray) -> list[str]:
    """Names of sets that meshio joins to that of an array, if its values number them."""
    names = name.split("-")
    return names if len(values) and values.max() < len(names) else []


def _values(grid: FileGrid, name: str, kinds: tuple[str, ...]) -> np.ndarray:
    blocks = [b for (kind, _), b in zip(grid.cells, grid.data[name], strict=True) if kind in kinds]
    return np.concatenate([np.asarray(b).reshape(len(b), -1) for b in blocks] or [np.zeros((0, 1))])


def _best(grid: FileGrid) -> str:
    """The array that names regions, or nothing.

    It holds up to `MOST` whole numbers and does not number cells. Of several, one that differs
    between cells comes first, then one that is called like regions, one of integers, the first.
    """
    ranked = []
    for place, name in enumerate(grid.data):
        values = _values(grid, name, (*SOLID, *FLAT))
        if values.shape[1] != 1 or not len(values) or values.dtype.kind not in "iuf":
            continue
        if not np.isfinite(values).all() or (np.abs(values - np.round(values)) > WHOLE).any():
            continue
        solid = _values(grid, name, SOLID)
        # A grid of triangles alone names boundaries.
        several = len(np.unique(np.round(solid if len(solid) else values)))
        if len(np.unique(np.round(values))) > MOST:
            continue
        plain = re.sub(r"[^a-z]", "", name.lower())
        if NUMBERING.fullmatch(plain):
            continue
        named = bool(REGIONS.search(name)) or bool(_names_by_meshio(name, values) and "-" in name)
        numbers_cells = several == len(solid) > 8
        if numbers_cells and not named:
            continue
        floats = values.dtype.kind == "f"
        ranked.append((several < 2, not named, floats, place, name))
    return min(ranked)[-1] if ranked else ""
