"""A box of two regions as files of other programs: bone below, cement above."""

from __future__ import annotations

import base64
import lzma
import struct
import zlib
from collections.abc import Callable, Sequence
from itertools import permutations, product
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest

import meshes
from app.case.geometries import MeshFile, MeshOptions
from meshes.data import MeshData, boundary_areas, region_volumes

# The box is 3 x 4 x 7 mm, bone to z = 5 mm.
X = 3.0
Y = 4.0
BOTTOM = 0.0
JOINT = 5.0
TOP = 7.0
LEVELS = (BOTTOM, JOINT, TOP)
AREA = X * Y
VOLUMES = {"bone": AREA * JOINT, "cement": AREA * (TOP - JOINT)}
# The free faces of bone, and of both.
FREE = AREA + 2 * (X + Y) * JOINT
ALL_FREE = 2 * AREA + 2 * (X + Y) * TOP
# Corners of the faces S1 to S4 in the manual of Abaqus.
FACES = [(0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)]
TAGS = np.repeat([3, 8], 6)


def box() -> tuple[np.ndarray, np.ndarray]:
    """Points of 2 x 2 x 3 places, and six tetrahedra for each half, those of bone first."""
    points = np.array([[X * i, Y * j, z] for z, j, i in product(LEVELS, *[range(2)] * 2)])
    cells = []
    for k in range(2):
        for axes in permutations(range(3)):
            corner = np.array([0, 0, k])
            tet = [corner.copy()]
            for axis in axes:
                corner[axis] += 1
                tet.append(corner.copy())
            row = [c[0] + 2 * c[1] + 4 * c[2] for c in tet]
            volume = np.linalg.det(points[row[1:]] - points[row[0]])
            cells.append(row if volume > 0 else [row[1], row[0], *row[2:]])
    return points, np.array(cells)


POINTS = box()[0]
CELLS = box()[1]


def build(path: Path, text: str | bytes, **keys: object) -> MeshData:
    """Write a file and mesh it."""
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return bonded(path, **keys)


def bonded(path: Path, **keys: object) -> MeshData:
    """The mesh of a file. Two regions have an interface between them."""
    names = MeshFile.model_validate({"path": path, **keys}).region_names
    between = {"interfaces": {"between": names}} if len(names) == 2 else {}
    geometry = MeshFile.model_validate({"path": path, **between, **keys})
    return meshes.build(geometry, MeshOptions.model_validate({"size": "1 mm"}))


def whole(data: MeshData, bone: str = "bone", cement: str = "cement") -> dict[str, float]:
    """Areas of the boundaries if the regions are complete."""
    expected = {bone: VOLUMES["bone"], cement: VOLUMES["cement"]}
    assert region_volumes(data) == pytest.approx(expected)
    assert len(data.points) == len(POINTS)
    return boundary_areas(data)


def messages_of(data: MeshData) -> str:
    """Notes on the file."""
    return "\n".join(data.notes["messages"])


# ---------------------------------------------------------------------------------------- .inp


def on(height: float) -> list[tuple[int, int]]:
    """Elements with a face at a height, and the label of the face."""
    return [
        (e, s)
        for e, cell in enumerate(CELLS, 1)
        for s, face in enumerate(FACES, 1)
        if (POINTS[cell[list(face)], 2] == height).all()
    ]


def nodes(points: np.ndarray = POINTS, options: str = "") -> str:
    rows = [f"{k}, {x!r}, {y!r}, {z!r}" for k, (x, y, z) in enumerate(points.tolist(), 1)]
    return "\n".join([f"*NODE{options}", *rows, ""])


def elements(first: int, last: int, name: str = "") -> str:
    rows = [f"{k + 1}, " + ", ".join(map(str, CELLS[k] + 1)) for k in range(first, last)]
    return "\n".join([f"*ELEMENT, TYPE=C3D4{name and ', ELSET='}{name}", *rows, ""])


def deck(bone: str = "bone", cement: str = "cement", more: str = "", start: str = "") -> str:
    return (start or nodes()) + elements(0, 6, bone) + elements(6, 12, cement) + more


def surface(name: str, height: float) -> str:
    return f"*SURFACE, NAME={name}\n" + "".join(f"{e}, S{s}\n" for e, s in on(height))


# ---------------------------------------------------------------------------------------- .vtu


def literal_lz4(block: bytes) -> bytes:
    """A block of LZ4 that consists of literals."""
    rest, long = len(block) - 15, b""
    if rest >= 0:
        long = b"\xff" * (rest // 255) + bytes([rest % 255])
    return bytes([min(len(block), 15) << 4]) + long + block


PACKERS: dict[str, Callable[[bytes], bytes] | None] = {
    "": None,
    "vtkZLibDataCompressor": zlib.compress,
    "vtkLZMADataCompressor": lzma.compress,
    "vtkLZ4DataCompressor": literal_lz4,
}
KINDS = {"f8": "Float64", "f4": "Float32", "i8": "Int64", "u1": "UInt8", "i4": "Int32"}
Piece = tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]


def one_piece(**arrays: np.ndarray) -> list[Piece]:
    return [(POINTS, CELLS, arrays or {"material": TAGS})]


def cut(parts: int) -> list[Piece]:
    """The box in pieces of mixed cells, each with separate nodes."""
    made = []
    for rows in np.array_split(np.random.default_rng(1).permutation(12), parts):
        used, cells = np.unique(CELLS[rows], return_inverse=True)
        made.append((POINTS[used], cells.reshape(-1, 4), {"material": TAGS[rows]}))
    return made


def encoded(values: np.ndarray, word: str, packer: str, raw: bool) -> bytes:
    """Data encoded like VTK: header and data together, or compressed in blocks."""
    data, pack = values.tobytes(), PACKERS[packer]
    encode: Callable[[bytes], bytes] = bytes if raw else base64.b64encode
    if pack is None:
        return encode(struct.pack(word, len(data)) + data)
    size = 64
    blocks = [data[k : k + size] for k in range(0, len(data), size)]
    packed = [pack(block) for block in blocks]
    numbers = [len(blocks), size, len(data) % size, *map(len, packed)]
    return encode(struct.pack(f"{word[0]}{len(numbers)}{word[1]}", *numbers)) + encode(
        b"".join(packed)
    )


def vtu(
    pieces: Sequence[Piece],
    way: str = "ascii",
    header: str = "UInt32",
    order: str = "<",
    packer: str = "",
) -> bytes:
    """A file of tetrahedra, ``ascii``, ``binary``, ``appended`` (in base64) or ``raw``."""
    appended = text = b""

    def array(name: str, values: np.ndarray) -> bytes:
        nonlocal appended
        width = values.shape[1] if values.ndim > 1 else 1
        head = f'<DataArray type="{KINDS[values.dtype.str[1:]]}" Name="{name}"'
        head += f' NumberOfComponents="{width}" format='
        if way == "ascii":
            return (
                f'{head}"ascii">{" ".join(map(str, values.ravel().tolist()))}</DataArray>'.encode()
            )
        ordered = values.astype(values.dtype.newbyteorder(order))
        block = encoded(
            ordered, order + {"UInt32": "I", "UInt64": "Q"}[header], packer, way == "raw"
        )
        if way == "binary":
            return f'{head}"binary">\n'.encode() + block + b"\n</DataArray>"
        head += f'"appended" offset="{len(appended)}"/>'
        appended += block
        return head.encode()

    for points, cells, arrays in pieces:
        text += f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(cells)}">'.encode()
        text += b"<Points>" + array("Points", points) + b"</Points><Cells>"
        text += array("connectivity", cells.ravel().astype(np.int64))
        text += array("offsets", 4 * np.arange(1, len(cells) + 1))
        text += array("types", np.full(len(cells), 10, dtype=np.uint8)) + b"</Cells><CellData>"
        text += b"".join(array(*a) for a in arrays.items()) + b"</CellData></Piece>"
    end = "Big" if order == ">" else "Little"
    head = f'<VTKFile type="UnstructuredGrid" version="1.0" byte_order="{end}Endian" '
    head += f'header_type="{header}"' + (f' compressor="{packer}">' if packer else ">")
    tail = b""
    if appended:
        coded = "raw" if way == "raw" else "base64"
        tail = f'<AppendedData encoding="{coded}">\n_'.encode() + appended + b"\n</AppendedData>"
    body = b"<UnstructuredGrid>" + text + b"</UnstructuredGrid>"
    return b'<?xml version="1.0"?>\n' + head.encode() + body + tail + b"</VTKFile>"


def pvtu(folder: Path, parts: int, below: str = "") -> Path:
    """A file that names pieces, and the pieces, in the form of ParaView."""
    names = [f"{below}box_{k}.vtu" for k in range(parts)]
    (folder / below).mkdir(exist_ok=True)
    for name, piece in zip(names, cut(parts), strict=True):
        (folder / name).write_bytes(vtu([piece], "raw", "UInt64", packer="vtkZLibDataCompressor"))
    text = '<PPoints><PDataArray type="Float64" Name="Points" NumberOfComponents="3"/></PPoints>'
    text += '<PCellData><PDataArray type="Int64" Name="material"/></PCellData>'
    text += "".join(f'<Piece Source="{name}"/>' for name in names)
    text = f'<PUnstructuredGrid GhostLevel="0">{text}</PUnstructuredGrid>'
    path = folder / "box.pvtu"
    path.write_text(f'<VTKFile type="PUnstructuredGrid" version="0.1">{text}</VTKFile>')
    return path


# --------------------------------------------------------------------------------------- .xdmf


def item(values: np.ndarray, more: str = "") -> str:
    kind = "Float" if values.dtype.kind == "f" else "Int"
    shape = " ".join(map(str, values.shape))
    numbers = " ".join(map(repr, values.ravel().tolist()))
    head = f'<DataItem Format="XML" NumberType="{kind}" Precision="8" Dimensions="{shape}"{more}>'
    return f"{head}{numbers}</DataItem>"


def geometry(points: np.ndarray = POINTS) -> str:
    return f'<Geometry GeometryType="XYZ">{item(points)}</Geometry>'


def topology(cells: np.ndarray = CELLS, kind: str = "Tetrahedron", more: str = "") -> str:
    head = f'<Topology TopologyType="{kind}" NumberOfElements="{len(cells)}"{more}>'
    return f"{head}{item(cells)}</Topology>"


def attribute(values: np.ndarray, name: str = "material", center: str = "Cell") -> str:
    return f'<Attribute Name="{name}" Center="{center}">{item(values)}</Attribute>'


def grid(*parts: str, name: str = "g", kind: str = "Uniform") -> str:
    collection = f' CollectionType="{kind}"' if kind in ("Spatial", "Temporal") else ""
    kind = "Collection" if collection else kind
    return f'<Grid Name="{name}" GridType="{kind}"{collection}>{"".join(parts)}</Grid>'


def include(address: str) -> str:
    return f'<xi:include xpointer="{address}"/>'


def xdmf(*grids: str) -> str:
    head = '<Xdmf Version="3.0" xmlns:xi="https://www.w3.org/2001/XInclude">'
    return f'<?xml version="1.0"?>{head}<Domain>{"".join(grids)}</Domain></Xdmf>'


# ---------------------------------------------------------------------------------------- .feb


def feb(first: str = "bone", second: str = "cement") -> str:
    rows = "".join(f'<node id="{k}">{x},{y},{z}</node>' for k, (x, y, z) in enumerate(POINTS, 1))
    text = f"<Nodes>{rows}</Nodes>"
    for name, part in ((first, range(6)), (second, range(6, 12))):
        text += f'<Elements type="tet4" name="{name}">'
        for k in part:
            text += f'<elem id="{k + 1}">{",".join(map(str, CELLS[k] + 1))}</elem>'
        text += "</Elements>"
    return f'<febio_spec version="4.0"><Mesh>{text}</Mesh></febio_spec>'


def refused(path: Path, text: str | bytes = "", **keys: object) -> str:
    """Error of a file that cannot be used."""
    with pytest.raises(ValueError) as caught:
        build(path, text, **keys) if text else bonded(path, **keys)
    return str(caught.value)


ORIGIN = np.array([4.0, -7.0, 2.5])


def system(*rows: np.ndarray) -> str:
    lines = (", ".join(map(repr, np.ravel(row).tolist())) for row in rows)
    return "*SYSTEM\n" + "".join(f"{line}\n" for line in lines)


ODD = (np.arange(12) % 2).astype("i4")

MATERIALS = "material_3", "material_8"


# --------------------------------------------------------------------------------------- .xdmf


def own_nodes(parts: int) -> list[str]:
    """Grids of pieces, each with separate nodes."""
    return [
        grid(geometry(points), topology(cells), attribute(arrays["material"]), name=f"piece {k}")
        for k, (points, cells, arrays) in enumerate(cut(parts))
    ]


MESH = grid(geometry(), topology(), name="mesh")
NODES_OF_MESH = include("xpointer(/Xdmf/Domain/Grid[@Name='mesh']/Geometry)")
BOTH = "/*[self::Topology or self::Geometry])"
MIXED_CELLS = np.concatenate([np.insert(row, 0, 6) for row in CELLS])
BOTTOM_SIDES = np.array([[0, 1, 3], [0, 3, 2]])
MIXED = np.concatenate([[2, 2, 0, 1, 4], BOTTOM_SIDES[0], MIXED_CELLS, [4], BOTTOM_SIDES[1]])
MIXED_TAGS = np.concatenate([[7, 5], TAGS, [5]])
STEPS = [
    grid(
        include(f'xpointer(//Grid[@Name="mesh"]{BOTH}'.replace('"', "&quot;")),
        f'<Time Value="{k}"/>',
        attribute(np.roll(TAGS, k)),
    )
    for k in range(3)
]
# Text of the file, the number of sets of nodes in it, and words of a note.
GRIDS: dict[str, tuple[str, int, str]] = {
    "one": (xdmf(grid(geometry(), topology(), attribute(TAGS))), 1, ""),
    "two": (xdmf(*own_nodes(2)), 2, ""),
    "spatial": (xdmf(grid(*own_nodes(3), kind="Spatial")), 3, ""),
    "tree": (xdmf(grid(grid(*own_nodes(2), kind="Spatial"), kind="Tree")), 2, ""),
    "tags": (
        xdmf(MESH, grid(NODES_OF_MESH, topology(), attribute(TAGS[:, None]))),
        1,
        "regions are the values of the array material",
    ),
    "tags with nodes": (
        xdmf(MESH, grid(geometry(POINTS + 0.0), topology(), attribute(TAGS))),
        1,
        "",
    ),
    "tags in another order": (
        xdmf(
            MESH,
            grid(geometry(POINTS[::-1]), topology(11 - CELLS[::-1]), attribute(TAGS[::-1].copy())),
        ),
        2,
        "12 nodes are merged",
    ),
    "nodes by positions": (
        xdmf(MESH, grid(include("element(/1/1/1/1)"), topology(), attribute(TAGS))),
        1,
        "",
    ),
    "nodes by reference": (
        xdmf(
            MESH,
            grid(
                '<Geometry Reference="XML">/Xdmf/Domain/Grid[1]/Geometry</Geometry>',
                topology(),
                attribute(TAGS),
            ),
        ),
        1,
        "",
    ),
    "steps": (
        xdmf(MESH, grid(*STEPS, name="u", kind="Temporal")),
        1,
        "of the 3 time steps of the grid u the first is read",
    ),
    "mixed": (
        xdmf(grid(geometry(), topology(MIXED, "Mixed"), attribute(MIXED_TAGS))),
        1,
        "tetrahedra or triangles are not read: 1 polyline",
    ),
    "from one": (
        xdmf(grid(geometry(), topology(CELLS + 1, more=' BaseOffset="1"'), attribute(TAGS))),
        1,
        "",
    ),
    "short names": (
        xdmf(grid(geometry(), topology(), attribute(TAGS))).replace("TopologyType", "Type"),
        1,
        "",
    ),
}


# ---------------------------------------------------------------------------------------- .med


def med(path: Path, **meshes_of: tuple[np.ndarray, np.ndarray, list[list[str]]]) -> Path:
    """A file of several meshes: nodes, cells, and groups of the first and second half of them."""
    with h5py.File(path, "w") as file:
        for name, (points, cells, groups) in meshes_of.items():
            kind = {3: "triangle", 4: "tetra"}[cells.shape[1]]
            tags = np.where(np.arange(len(cells)) < len(cells) / 2, -1, -2)
            data = meshio.Mesh(points, [(kind, cells)], cell_data={"cell_tags": [tags]})
            data.cell_tags = {-1: groups[0], -2: groups[1]}
            data.write(path.with_suffix(".one.med"))
            with h5py.File(path.with_suffix(".one.med")) as one:
                for part in ("ENS_MAA", "FAS"):
                    one.copy(one[part]["mesh"], file.require_group(part), name)
    return path


MED_CELLS = CELLS[:, [0, 2, 1, 3]]
TWO = [["bone"], ["cement"]]
