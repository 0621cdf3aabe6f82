"""Reader of ``.xdmf`` files: all grids, with arrays in the file, in HDF5 or in binary files.

Of 16 files with one mesh in `tests/mesh_files/test_xdmf.py` meshio 5.3.5 gets 14 wrong:
several grids, references between them, tags beside the cells, binary files.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from app.foundation.arrays import Ints
from app.mesh_files.content import AGAIN, NOT_READ, ONLY, CellBlock, CellGrid

# Dimension and number of nodes of the kinds of cells that are read.
SIMPLICES = {
    "triangle": (2, 3),
    "triangle_6": (2, 6),
    "tri_6": (2, 6),
    "tetrahedron": (3, 4),
    "tetrahedron_10": (3, 10),
    "tet_10": (3, 10),
}
SOLIDS = re.compile("hex|wedge|pyramid|polyhedron|3d", re.IGNORECASE)
# Cells of a mixed topology by their codes: name and number of nodes, 0 if the file has the number.
MIXED = {1: ("polyvertex", 0), 2: ("polyline", 0), 3: ("polygon", 0), 4: ("triangle", 3)}
MIXED |= {5: ("quadrilateral", 4), 6: ("tetrahedron", 4), 7: ("pyramid", 5), 8: ("wedge", 6)}
MIXED |= {9: ("hexahedron", 8), 34: ("edge_3", 3), 35: ("quadrilateral_9", 9)}
MIXED |= {36: ("triangle_6", 6), 37: ("quadrilateral_8", 8), 38: ("tetrahedron_10", 10)}
MIXED |= {39: ("pyramid_13", 13), 40: ("wedge_15", 15), 41: ("wedge_18", 18)}
MIXED |= {48: ("hexahedron_20", 20), 49: ("hexahedron_24", 24), 50: ("hexahedron_27", 27)}
RUN = 4096  # most cells of one kind that are read at once
KINDS_OF_NUMBERS = {"float": "f", "int": "i", "uint": "u", "char": "i", "uchar": "u"}
ORDERS = {"big": ">", "little": "<", "native": "="}
# References within the file, by names or positions; the last part of one to several parts.
POINTER = re.compile(r"(xpointer|element)\((.*)\)")
EITHER = re.compile(r"\*\[(self::\w+(?:\s+or\s+self::\w+)*)\]$")


def read(path: Path) -> CellGrid:
    """Return all grids of a file as one, of a series over time those of the first step.

    Raises:
        ValueError: The file is damaged or of no use.
    """
    file = _File(path)
    grid = CellGrid(np.zeros((0, 3)), [], [])
    nodes: dict[str, tuple[int, np.ndarray]] = {}
    unread: Counter[str] = Counter()
    for element in file.grids(grid.notes):
        name = element.get("Name", "without a name")
        elements_by_tag: dict[str, list[ET.Element]] = {}
        for part in file.parts(element):
            elements_by_tag.setdefault(part.tag, []).append(part)
        missing_tags = [tag for tag in ("Topology", "Geometry") if tag not in elements_by_tag]
        if missing_tags:
            raise ValueError(f"its grid {name} has no {missing_tags[0]}; {AGAIN}")
        geometry = elements_by_tag["Geometry"][0]
        place = "".join(geometry.itertext()).strip()
        if place not in nodes:
            nodes[place] = sum(len(x) for _, x in nodes.values()), file.points(geometry)
        shift, x = nodes[place]
        arrays = {
            part.get("Name", "array"): file.array(_item(part))
            for part in elements_by_tag.get("Attribute", ())
            if part.get("Center", "Node") == "Cell"
        }
        for block in file.blocks(elements_by_tag["Topology"][0], arrays, unread):
            if block.data.min() < 0 or block.data.max() >= len(x):
                raise ValueError(
                    f"its grid {name}: a cell has a node that is not in the file; {AGAIN}"
                )
            grid.blocks.append(replace(block, data=block.data + shift))
    if len(nodes) > 1:
        message = f"its grids have {len(nodes)} sets of nodes, which are read as one mesh"
        grid.notes.append(f"geometry: {message}")
    if unread:
        kinds = ", ".join(f"{n} {kind}" for kind, n in sorted(unread.items()))
        grid.notes.append(f"{NOT_READ}: {kinds}")
    if nodes:
        grid.points = np.concatenate([x for _, x in nodes.values()])
    return grid


def _item(part: ET.Element) -> ET.Element:
    """Return the only array of a part."""
    data_items = part.findall("DataItem")
    if len(data_items) != 1:
        raise ValueError(f"its {part.tag} has {len(data_items)} arrays; expected one")
    return data_items[0]


def _kind(part: ET.Element) -> str:
    """Return the type of a part, which has one of two attributes."""
    return part.get(f"{part.tag}Type") or part.get("Type") or ""


class _File:
    """XML tree of a file, with access to its arrays."""

    def __init__(self, path: Path) -> None:
        self.folder = path.parent
        self.root = ET.fromstring(path.read_bytes())

    def grids(self, notes: list[str]) -> Iterator[ET.Element]:
        """Return the grids with cells of all collections, of a series over time the first step's.

        A note is added if it has more steps.
        """
        waiting = self.root.findall("Domain/Grid")
        while waiting:
            grid = waiting.pop(0)
            inner = grid.findall("Grid")
            if grid.get("CollectionType", "").lower() == "temporal" and len(inner) > 1:
                name = grid.get("Name", "without a name")
                message = f"of the {len(inner)} time steps of the grid {name} the first is read"
                notes.append(f"geometry: {message}")
            if grid.get("CollectionType", "").lower() == "temporal":
                waiting = [*inner[:1], *waiting]
            elif inner or grid.get("GridType", "Uniform").lower() in ("collection", "tree"):
                waiting = [*inner, *waiting]
            else:
                yield grid

    def parts(self, grid: ET.Element) -> Iterator[ET.Element]:
        """Return the parts of a grid, and parts of other grids to which it refers."""
        for part in grid:
            reference = part.get("Reference")
            if part.tag.endswith("}include"):
                pointer = POINTER.fullmatch(part.get("xpointer", "").strip())
                if part.get("href") or not pointer:
                    raise ValueError("includes parts of other files; save it as one file")
                yield from self.elements_at(pointer[2], by_positions=pointer[1] == "element")
            elif reference:
                yield self.elements_at((part.text or "") if reference == "XML" else reference)[0]
            else:
                yield part

    def elements_at(self, address: str, by_positions: bool = False) -> list[ET.Element]:
        """Return the elements at an address in the file, of names or of positions."""
        address = address.strip()
        try:
            if by_positions:
                elements = [self.root]
                for position in address.strip("/").split("/")[1:]:
                    elements = [elements[0][int(position) - 1]]
                return elements
            either = EITHER.search(address)
            outer = (address[: either.start()] if either else address).rstrip("/")
            root = f"/{self.root.tag}"
            elements = self.root.findall(f".{outer.removeprefix(root)}")
            if either:
                tags = re.findall(r"self::(\w+)", either[1])
                elements = [
                    part for element in elements[:1] for part in element if part.tag in tags
                ]
            if elements:
                return elements
        except (SyntaxError, KeyError, ValueError, IndexError):
            pass
        raise ValueError(
            f"refers to {address}, which is not in the file or cannot be read; {AGAIN}"
        )

    def points(self, geometry: ET.Element) -> np.ndarray:
        """Return nodes (n, 3)."""
        kind = _kind(geometry) or "XYZ"
        if kind != "XYZ":
            raise ValueError(f"its nodes are of type {kind}; expected XYZ")
        x = self.array(_item(geometry))
        if x.size % 3:
            raise ValueError(f"its coordinates do not make rows of three; {AGAIN}")
        return x.reshape(-1, 3).astype(float)

    def array(self, item: ET.Element) -> np.ndarray:
        """Return the values of an item in its dimensions; (n, 1) becomes (n,)."""
        reference = item.get("Reference")
        if reference:
            item = self.elements_at((item.text or "") if reference == "XML" else reference)[0]
        name, item_text = item.get("Name", ""), (item.text or "").strip()
        called = f"its array {name}" if name else "an array"
        if item.get("ItemType", "Uniform") != "Uniform":
            raise ValueError(
                f"{called} is a {item.get('ItemType')}, which is not read; save it as a "
                "Uniform array"
            )
        form = item.get("Format", "XML")
        kind = KINDS_OF_NUMBERS.get(
            (item.get("NumberType") or item.get("DataType") or "Float").lower()
        )
        if kind is None:
            raise ValueError(
                f"{called} has the type {item.get('NumberType')}; expected one of "
                f"{', '.join(KINDS_OF_NUMBERS)}"
            )
        if form == "XML":
            values = np.array(item_text.split(), dtype=float if kind == "f" else np.int64)
        elif form == "HDF":
            values = self._hdf(item_text, called)
        elif form == "Binary":
            order = ORDERS.get(item.get("Endian", "Native").lower(), "=")
            dtype = np.dtype(f"{order}{kind}{item.get('Precision', '4')}")
            count = int(np.prod([int(n) for n in item.get("Dimensions", "0").split()]))
            values = np.fromfile(
                self._file(item_text), dtype, count, offset=int(item.get("Seek", 0))
            )
            values = values.astype(dtype.newbyteorder("="))
        else:
            raise ValueError(f"{called} has the format {form}; expected XML, HDF or Binary")
        shape = [int(n) for n in item.get("Dimensions", str(values.size)).split()]
        if int(np.prod(shape)) != values.size:
            raise ValueError(f"{called} has {values.size} values for {' x '.join(map(str, shape))}")
        values = values.reshape(shape)
        return values[:, 0] if values.ndim == 2 and values.shape[1] == 1 else values

    def _file(self, name: str) -> Path:
        """Return the path of a file to which this one refers.

        Raises:
            ValueError: It is missing, or not in the folder or below.
        """
        folder = self.folder.resolve()
        if not (folder / name).resolve().is_relative_to(folder):
            raise ValueError(f"its file {name} is not in its folder or below; move it there")
        if not (self.folder / name).is_file():
            raise ValueError(f"its file {name} is missing; put it next to the .xdmf file")
        return self.folder / name

    def _hdf(self, text: str, called: str) -> np.ndarray:
        """Return an array of an HDF5 file by its address ``FILE:PATH``."""
        import h5py

        name, colon, inside = text.rpartition(":")
        if not colon:
            raise ValueError(f"{called} does not name an array as FILE:PATH: {text[:80]}")
        with h5py.File(self._file(name), "r", locking=False) as file:
            if inside not in file:
                raise ValueError(f"{called}: {inside} is not in {name}; {AGAIN}")
            return np.asarray(file[inside])

    def blocks(
        self, topology: ET.Element, arrays: dict[str, np.ndarray], unread: Counter[str]
    ) -> Iterator[CellBlock]:
        """Return triangles and tetrahedra with their arrays; count other cells in ``unread``."""
        kind = _kind(topology).lower()
        if SOLIDS.search(kind):
            raise ValueError(f"the cells are of type {_kind(topology)}; {ONLY}")
        if kind != "mixed" and kind not in SIMPLICES:
            unread[kind] += int(topology.get("NumberOfElements", "1").split()[0])
            return
        base = int(topology.get("BaseOffset", 0))
        data = self.array(_item(topology)).astype(np.int64)
        if kind == "mixed":
            blocks = _mixed(data.ravel())
        else:
            only_block: Ints = data.reshape(-1, SIMPLICES[kind][1])
            blocks = {kind: (np.arange(len(only_block)), only_block)}
        count = sum(len(rows) for rows, _ in blocks.values())
        wrong_arrays = [name for name, values in arrays.items() if len(values) != count]
        if wrong_arrays:
            raise ValueError(
                f"its array {wrong_arrays[0]} does not have one value for each of {count} cells"
            )
        for name, (rows, nodes) in blocks.items():
            if SOLIDS.search(name):
                raise ValueError(f"the cells are of type {name}; {ONLY}")
            if name not in SIMPLICES:
                unread[name] += len(rows)
            elif len(rows):
                of_cells = {array: values[rows] for array, values in arrays.items()}
                yield CellBlock(SIMPLICES[name][0], nodes - base, of_cells)


def _mixed(data: Ints) -> dict[str, tuple[Ints, Ints]]:
    """Return the cells of each kind: their positions among all cells (n,), and nodes (n, k)."""
    rows_and_starts: dict[str, list[tuple[Ints, Ints]]] = {}
    position = count = 0
    while position < len(data):
        code = int(data[position])
        if code not in MIXED:
            raise ValueError(f"has a cell of type {code}, which is not a type of XDMF; {AGAIN}")
        name, width = MIXED[code]
        run, first_node = 1, position + 1
        if width:
            codes = data[position : position + RUN * (width + 1) : width + 1]
            run = len(codes) if (codes == code).all() else int(np.argmax(codes != code))
        else:
            width, first_node = (
                max(0, int(data[first_node])) if first_node < len(data) else 0,
                position + 2,
            )
        cells = np.arange(run)
        rows_and_starts.setdefault(name, []).append(
            (count + cells, first_node + cells * (width + 1))
        )
        position = first_node + run * (width + 1) - 1
        count += run
    if position > len(data):
        raise ValueError(f"its mixed cells are cut short; {AGAIN}")
    blocks: dict[str, tuple[Ints, Ints]] = {}
    for name, rows_and_starts_of_kind in rows_and_starts.items():
        rows, first_nodes = (
            np.concatenate(parts) for parts in zip(*rows_and_starts_of_kind, strict=True)
        )
        width = SIMPLICES[name][1] if name in SIMPLICES else 0
        blocks[name] = rows, data[first_nodes[:, None] + np.arange(width)]
    return blocks
