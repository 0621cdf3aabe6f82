"""Meshes of other programs: Abaqus and CalculiX ``.inp``, FEBio ``.feb``, MED, VTU, XDMF.

Regions are sets of cells by their names; boundaries are surfaces, sets of triangles, and sets of
nodes that contain whole facets. VTU and XDMF name nothing: an array of integers NAME makes
NAME_1, NAME_2, or a and b if it is called a-b, as meshio writes sets. What is not read is told.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from app.arrays import Floats, Ints

# These programs number the middles of edges alike, and that of 13 before that of 23, unlike gmsh.
ORDER = [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]
# The cells of MED are inside out, too.
ORDER_MED = [0, 2, 1, 3, 6, 5, 4, 7, 8, 9]
ONLY = "only straight tetrahedra, or only quadratic ones, can be used"
# Elements of .inp files: tetrahedra, triangles, and others that have a volume.
SOLID = re.compile(r"D?C3D(4|10)[A-Z]*")
FLAT = re.compile(r"(?:CPS|CPE|S|STRI|M3D|SFM3D|R3D|DS)(3|6|65)[A-Z]*")
OTHER = re.compile(r"\w*C3D\w*")
# Corners of the faces of a tetrahedron in an .inp file.
SIDES = {"S1": (0, 1, 2), "S2": (0, 3, 1), "S3": (1, 3, 2), "S4": (2, 3, 0)}
# Keywords of .inp files that make or move nodes and cells, or take them from elsewhere.
MOVING = {"INCLUDE", "SYSTEM", "NGEN", "NFILL", "NCOPY", "ELGEN", "ELCOPY"}
READ = {"NODE", "ELEMENT", "ELSET", "NSET", "SURFACE", "SOLIDSECTION", "HEADING", "PREPRINT"}
READ |= {"PART", "INSTANCE", "ASSEMBLY", "ENDPART", "ENDINSTANCE", "ENDASSEMBLY", "ENDSTEP"}
MOST = 255  # values of an array; one of more does not tell regions apart


@dataclass
class Found:
    """What a file holds: nodes (n, 3), cells (m, 4 or 10) in gmsh's order, and named sets.

    Sets of cells are rows of ``cells``; triangles (k, 3) and sets of nodes rows of ``points``.
    """

    points: Floats = field(default_factory=lambda: np.zeros((0, 3)))
    blocks: list[Ints] = field(default_factory=list)
    sets: dict[str, Ints] = field(default_factory=dict)
    triangles: dict[str, Ints] = field(default_factory=dict)
    nodes: dict[str, Ints] = field(default_factory=dict)
    told: list[str] = field(default_factory=list)

    @property
    def cells(self) -> Ints:
        """All cells."""
        if not self.blocks:
            raise ValueError("names no region: it has no set of tetrahedra with a name")
        if len({block.shape[1] for block in self.blocks}) > 1:
            raise ValueError(f"has straight and quadratic cells; {ONLY}")
        return np.concatenate(self.blocks).astype(np.int64)

    def add(self, cells: Ints, order: list[int] = ORDER) -> Ints:
        """Add cells; returns their rows."""
        self.blocks.append(cells[:, order[: cells.shape[1]]])
        return np.arange(len(cells)) + sum(map(len, self.blocks[:-1]))


def left_out(what: str, names: Iterable[str]) -> list[str]:
    """A line about what is left out, if anything is."""
    names = list(dict.fromkeys(names))
    more = f" and {len(names) - 10} more" if names[10:] else ""
    return [f"geometry: {what}: {', '.join(names[:10])}{more}"] if names else []


@lru_cache(maxsize=1)
def read(path: Path, modified: int) -> Found:
    """What a file, as it was modified last, holds; its sets of cells are the regions.

    Raises:
        ValueError: The file is damaged or of no use; what is wrong, in words.
    """
    try:
        found = READERS[path.suffix](path)
        found.points = np.asarray(found.points, dtype=float)
        if len(bad := np.flatnonzero(~np.isfinite(found.points).all(axis=1))):
            raise ValueError(f"node {bad[0] + 1}: its coordinates are no numbers")
        _divide(found)
    except Exception as error:  # of a damaged file there is no telling which
        cause = f"damaged, or no {path.suffix} file ({type(error).__name__} {error})"
        raise ValueError(str(error) if type(error) is ValueError else cause) from error
    for kind in ("sets", "triangles", "nodes"):
        setattr(found, kind, {_word(n): part for n, part in getattr(found, kind).items()})
    return found


def _word(name: str) -> str:
    """A name that a case can have."""
    word = re.sub(r"[^A-Za-z0-9_-]", "_", name)
    return word if re.match("[A-Za-z_]", word) else f"_{word}"


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
    found.told += left_out("sets without cells of their own are no regions", left)
    if free.all():
        raise ValueError("names no region: it has no set of tetrahedra with a name")
    found.sets = {name: rows for name, rows in found.sets.items() if name not in left}


def _rows(numbers: Ints, wanted: Ints, what: str) -> Ints:
    """Rows of the nodes or cells that have some numbers, in the shape of those."""
    by = np.argsort(numbers, kind="stable")
    if len(again := np.flatnonzero(np.diff(numbers[by]) == 0)):
        text = f"{what} {numbers[by][again[0]]} is there twice"
        raise ValueError(f"{text}; save a model of parts as one, without parts and instances")
    at = by[np.searchsorted(numbers, wanted, sorter=by).clip(max=len(by) - 1)]
    if (wrong := numbers[at] != wanted).any():
        raise ValueError(f"{what} {wanted[wrong][0]} is used, but is not in the file")
    return np.asarray(at)


# ------------------------------------------------------------------------- Abaqus and CalculiX


@dataclass(frozen=True)
class _Block:
    """A keyword of an ``.inp`` file without blanks, its options, and its lines of data."""

    at: str
    key: str
    options: Mapping[str, str]
    lines: list[str]

    def table(self, width: int, kind: type = float) -> Any:
        """Numbers, apart by commas or blanks (n, width)."""
        try:
            numbers: Any = np.array(" ".join(self.lines).replace(",", " ").split(), dtype=kind)
        except ValueError as error:
            raise ValueError(f"{self.at}: {error}") from None
        if len(numbers) % width:
            text = f"{self.at}: {len(numbers)} numbers are no rows of {width}: is it cut short?"
            raise ValueError(text)
        return numbers.reshape(-1, width)

    def members(self, known: Mapping[str, Ints]) -> Ints:
        """Numbers of a set: from, to, step; or each, and those of the sets that are named."""
        if "GENERATE" in self.options:
            ranges = ([*map(int, line.strip(" ,").split(","))] for line in self.lines)
            return np.concatenate([np.arange(r[0], r[1] + 1, (r[2:] or [1])[0]) for r in ranges])
        words = [w for line in self.lines for w in line.replace(",", " ").upper().split()]
        names = [w.rpartition(".")[2] for w in words if not w.isdigit()]
        if wrong := [name for name in names if name not in known]:
            raise ValueError(f"{self.at}: there is no set {wrong[0]} before it")
        numbers = np.array([w for w in words if w.isdigit()], dtype=np.int64)
        return np.concatenate([numbers, *(known[name] for name in names)])


def _inp(path: Path) -> Found:
    """Capitals do not matter: a name is written as it is first, without its instance."""
    found, blocks, spelled = Found(), [*_blocks(path)], dict[str, str]()
    sets: dict[str, dict[str, Ints]] = {"ELSET": {}, "NSET": {}, "SURFACE": {}}
    unread = (f"*{b.key}" for b in blocks if b.key not in READ)
    found.told += left_out("of the file are not read", unread)
    nodes = np.concatenate([np.zeros((0, 4)), *(b.table(4) for b in blocks if b.key == "NODE")])
    found.points, node = nodes[:, 1:], nodes[:, 0].astype(np.int64)
    element, flat = np.zeros(0, dtype=np.int64), np.zeros((0, 4), dtype=np.int64)

    def put(kind: str, name: str, part: Ints) -> None:
        if name := name.rpartition(".")[2]:
            spelled.setdefault(name.upper(), name)
            _extend(sets[kind], [name.upper()], part)

    for b in (b for b in blocks if b.key == "ELEMENT"):
        kind, name = b.options["TYPE"].upper(), b.options.get("ELSET", "")
        if known := SOLID.fullmatch(kind) or FLAT.fullmatch(kind):
            table = b.table(int(known[1].replace("65", "6")) + 1, int)
            put("ELSET", name, table[:, 0])
            if SOLID.fullmatch(kind):
                found.add(_rows(node, table[:, 1:], "node"))
                element = np.concatenate([element, table[:, 0]])
            else:
                flat = np.concatenate([flat, table[:, :4]])
        elif OTHER.fullmatch(kind):
            raise ValueError(f"{b.at}: the cells are of type {kind}; {ONLY}")
        else:
            found.told += left_out("elements that are not read", [kind])
    for b in blocks:
        if b.key == "NODE" and "NSET" in b.options:
            put("NSET", b.options["NSET"], b.table(4)[:, 0].astype(np.int64))
        elif b.key in ("ELSET", "NSET"):
            put(b.key, b.options[b.key], b.members(sets[b.key]))
        elif b.key == "SURFACE" and b.options.get("TYPE", "").upper() == "NODE":
            put("NSET", b.options["NAME"], b.members(sets["NSET"]))
        elif b.key == "SURFACE":
            sides = [line.replace(" ", "").upper().partition(",") for line in b.lines]
            parts = [replace(b, lines=[on]).members(sets["ELSET"]) for on, _, _ in sides]
            face = np.array([SIDES[f.strip(",")] for _, _, f in sides])
            at = _rows(element, np.concatenate(parts), "element")[:, None]
            corners = np.repeat(face, [*map(len, parts)], axis=0)
            put("SURFACE", b.options["NAME"], found.cells[at, corners])
    sections = {b.options["ELSET"].upper() for b in blocks if b.key == "SOLIDSECTION"}
    solids = {n: np.unique(e[np.isin(e, element)]) for n, e in sets["ELSET"].items()}
    regions = [n for n, e in solids.items() if len(e)]
    left = [spelled[n] for n in regions if sections & {*regions} and n not in sections]
    found.told += left_out("sets without *SOLID SECTION are no regions", left)
    for n in (n for n in regions if spelled[n] not in left):
        found.sets[spelled[n]] = _rows(element, solids[n], "element")
    for n, e in sets["ELSET"].items():
        if len(own := flat[np.isin(flat[:, 0], e), 1:]):
            found.triangles[spelled[n]] = _rows(node, own, "node")
    found.nodes = {spelled[n]: _rows(node, rows, "node") for n, rows in sets["NSET"].items()}
    found.triangles |= {spelled[n]: block for n, block in sets["SURFACE"].items()}
    return found


def _blocks(path: Path) -> Iterator[_Block]:
    lines = [text.strip() for text in path.read_text("utf-8", "replace").splitlines()]
    lines = ["" if text.startswith("**") else text for text in lines]
    heads = [k for k, text in enumerate(lines) if text.startswith("*")]
    if next((k for k, text in enumerate(lines) if text), -1) not in heads:
        raise ValueError("no .inp file of Abaqus or CalculiX: it does not begin with a keyword")
    for head, end in pairwise([*heads, len(lines)]):
        key, *options = lines[head][1:].split(",")
        pairs = (word.partition("=") for word in options)
        named = {a.strip().upper(): b.strip().strip('"') for a, _, b in pairs}
        at, rows = f"*{key} in line {head + 1}", [text for text in lines[head + 1 : end] if text]
        block = _Block(at, key.upper().replace(" ", ""), named, rows)
        if block.key in MOVING or (block.key == "INSTANCE" and rows):
            raise ValueError(f"{at}: makes or moves nodes; save the mesh as one file without it")
        yield block


# ------------------------------------------------------------------------------------- the others


def _feb(path: Path) -> Found:
    """FEBio 2.5 to 4: blocks of elements, surfaces, sets of nodes."""
    found, root = Found(), ET.parse(path).getroot()
    mesh = [part for grid in root if grid.tag in ("Mesh", "Geometry") for part in grid]
    items = [node for part in mesh if part.tag == "Nodes" for node in part]
    found.points = _Block("Nodes", "", {}, [node.text or "" for node in items]).table(3)
    number = np.array([node.attrib["id"] for node in items], dtype=np.int64)
    other = []
    for part in mesh:
        name = part.get("name", f"{part.tag}{part.get('mat', '')}")
        kinds = {part.attrib["type"]} if part.tag == "Elements" else {e.tag for e in part}
        known = [re.fullmatch(r"(tet|tri)(3|4|6|10)(G\w+)?", k, re.IGNORECASE) for k in kinds]
        if part.tag in ("Elements", "Surface") and not all(known):
            raise ValueError(f"{name}: is of type {', '.join(sorted(kinds))}; {ONLY}")
        if part.tag == "Elements" and known[0]:
            block = _Block(name, "", {}, [e.text or "" for e in part])
            cells = _rows(number, block.table(int(known[0][2]), int), "node")
            found.sets[name] = found.add(cells)
        elif part.tag == "Surface":
            corners = [",".join((e.text or "").split(",")[:3]) for e in part]
            table = _Block(name, "", {}, corners).table(3, int)
            found.triangles[name] = _rows(number, table, "node")
        elif part.tag == "NodeSet":
            words = (part.text or "").replace(",", " ").split() + [n.attrib["id"] for n in part]
            ranges = ([*map(int, word.split(":"))] for word in words)
            parts = [np.arange(r[0], (r[1:2] or r)[0] + 1, (r[2:] or [1])[0]) for r in ranges]
            found.nodes[name] = _rows(number, np.concatenate(parts), "node")
        elif part.tag != "Nodes":
            other.append(f"{part.tag} {name}")
    found.told += left_out("of the file's mesh are not read", other)
    return found


def _meshio(path: Path) -> Found:
    """MED, VTU and XDMF, as meshio reads them."""
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
                _extend(sets, label(value), members[values == value])
        for family, names in getattr(mesh, "point_tags", {}).items():
            _extend(found.nodes, names, np.flatnonzero(mesh.point_data["point_tags"] == family))
    return found


def _extend(sets: dict[str, Ints], names: Iterable[str], part: Ints) -> None:
    for name in names:
        sets[name] = np.concatenate([sets.get(name, part[:0]), part])


def _grids(path: Path) -> Iterator[Any]:
    """Meshes in a file: of XDMF its grids, which meshio reads alone, with the first's nodes."""
    import meshio

    if path.suffix != ".xdmf":
        yield (meshio.med if path.suffix == ".med" else meshio.vtu).read(path)
        return
    root = ET.parse(path).getroot()
    geometry, reader = root.findall(".//Geometry")[:1], meshio.xdmf.main.XdmfReader(path)
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
    data = {k: np.concatenate([b.ravel() for b in v]) for k, v in mesh.cell_data.items()}
    fit = [k for k, v in data.items() if v.dtype.kind in "iu" and len(np.unique(v)) <= MOST]
    unread = (k for k in data if k not in fit[:1])
    found.told += left_out("arrays of cells that are not read", unread)
    names = fit[0].split("-") if fit else []
    if fit and data[fit[0]].max() >= len(names):
        return fit[0], lambda v: [f"{fit[0]}_{v}"]
    return "".join(fit[:1]), lambda v: names[v : v + 1] if v >= 0 else []


READERS = {".inp": _inp, ".feb": _feb, ".med": _meshio, ".vtu": _meshio, ".xdmf": _meshio}
