"""Mesh files as programs and people write them: the same mesh, or a reason in words."""

from __future__ import annotations

import base64
import lzma
import random
import struct
import time
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import meshes
from app.case import gmsh_header
from app.case.geometries import Block, Blocks, MeshFile, MeshOptions
from app.errors import GeometryError
from app.soundness import well_posedness
from meshes.data import MeshData, boundary_areas, region_volumes
from meshes.gmsh_child import session
from meshes.pieces import lying
from tests import support

STACK = Blocks(
    blocks=(
        Block(name="bone", size=["3 mm", "5 mm", "4 mm"]),
        Block(name="cement", size=["3 mm", "5 mm", "2 mm"]),
    )
)
VOLUMES = {"bone": 60.0, "cement": 30.0}
SIDES = [(0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)]


@pytest.fixture(scope="module")
def stack() -> MeshData:
    return meshes.build(STACK, MeshOptions(size="2 mm"))


def built(path: Path, one: str = "bone", two: str = "cement") -> MeshData:
    return meshes.build(
        MeshFile(path=path, interfaces={"i": ((one,), (two,))}), MeshOptions(size="1 mm")
    )


def said(data: MeshData) -> str:
    return "\n".join(data.notes["told"])


# ---------------------------------------------------------------------------------------- .inp


def elements(data: MeshData, name: str, first: int = 1) -> str:
    rows = np.flatnonzero(data.cell_tags == data.regions[name])
    return "".join(
        f"{k + first}, {', '.join(map(str, data.cells[k, :4] + 1))}\n" for k in rows.tolist()
    )


def deck(data: MeshData, bone: str = "bone", cement: str = "cement", nodes: str = "") -> str:
    rows = enumerate(data.points.tolist(), 1)
    text = nodes or "*NODE\n" + "".join(f"{n}, {x!r}, {y!r}, {z!r}\n" for n, (x, y, z) in rows)
    text += f"*ELEMENT, TYPE=C3D4, ELSET={bone}\n{elements(data, 'bone')}"
    return text + f"*ELEMENT, TYPE=C3D4, ELSET={cement}\n{elements(data, 'cement')}"


def faces(data: MeshData, z: float) -> str:
    """Lines of a surface: the faces of cells at one height."""
    lines = []
    for k, cell in enumerate(data.cells.tolist(), 1):
        for s, side in enumerate(SIDES, 1):
            if np.allclose(data.points[[cell[v] for v in side], 2], z):
                lines.append(f"{k}, S{s}\n")
    return "".join(lines)


def surfaces(data: MeshData) -> str:
    return f"*SURFACE, NAME=low\n{faces(data, 0.0)}*SURFACE, NAME=high\n{faces(data, 6.0)}"


def other_coordinates(data: MeshData) -> str:
    """Nodes in cylindrical coordinates: radius, angle in degrees, height."""
    x, y, z = data.points.T
    rows = np.column_stack([np.hypot(x, y), np.degrees(np.arctan2(y, x)), z])
    lines = (f"{n}, {r!r}, {t!r}, {h!r}\n" for n, (r, t, h) in enumerate(rows.tolist(), 1))
    return "*NODE, SYSTEM=C\n" + "".join(lines)


def blank_zeros(text: str) -> str:
    return text.replace(", 0.0,", ", ,").replace(", 0.0\n", "\n")


def section_first(data: MeshData) -> str:
    """Surfaces before the sets that they name, and a set of sets that come later."""
    text = "*SURFACE, NAME=free\nall\n*ELSET, ELSET=all\nbone, cement\n"
    text += "*SOLID SECTION, ELSET=bone, MATERIAL=m\n*SOLID SECTION, ELSET=cement, MATERIAL=m\n"
    return text + deck(data)


DIALECTS: dict[str, Callable[[MeshData], str]] = {
    "plain": deck,
    "cylindrical": lambda d: deck(d, nodes=other_coordinates(d)),
    "empty fields": lambda d: blank_zeros(deck(d)),
    "order": section_first,
    "exponents": lambda d: deck(d).replace(".0,", ".0D+00,"),
    "continued": lambda d: deck(d).replace("TYPE=C3D4, ", "TYPE=C3D4,\n "),
    "tabs": lambda d: deck(d).replace("*ELEMENT,", "*ELEMENT\t,").replace(", ", ",\t"),
    "mark": lambda d: "\ufeff" + deck(d),
    "quotes": lambda d: deck(d, '"bone"', '"cement"'),
    "case": lambda d: (
        deck(d).replace("*NODE", "*Node").replace("*ELEMENT, TYPE=C3D4", "*element,type=c3d4")
    ),
    "comments": lambda d: (
        deck(d).replace("*ELEMENT", "** of the mesh\n\n*ELEMENT").replace("\n", "\r\n")
    ),
    "two lines": lambda d: deck(d).replace("C3D4, ELSET=bone\n1, ", "C3D4, ELSET=bone\n1,\n"),
}


@pytest.mark.parametrize("dialect", DIALECTS)
def test_inp_dialects_are_the_same_mesh(dialect: str, stack: MeshData, tmp_path: Path) -> None:
    path = tmp_path / "a.inp"
    path.write_text(DIALECTS[dialect](stack), encoding="utf-8")
    back = built(path)
    assert region_volumes(back) == pytest.approx(VOLUMES)
    if dialect == "empty fields":
        assert "coordinates of nodes are empty" in said(back)
    if dialect == "order":
        # All free faces: of 3 x 5 x 6 mm.
        assert boundary_areas(back)["free"] == pytest.approx(2 * (15 + 18 + 30))


def test_inp_in_utf_16_and_latin_1_is_read(stack: MeshData, tmp_path: Path) -> None:
    for encoding in ("utf-16", "latin-1"):
        path = tmp_path / f"{encoding}.inp"
        path.write_text(deck(stack, "Knochen_ä"), encoding=encoding)
        assert region_volumes(built(path, "Knochen__"))["Knochen__"] == pytest.approx(60.0)


def test_inp_surfaces_are_combined_and_shells_have_two_sides(
    stack: MeshData, tmp_path: Path
) -> None:
    top = np.isclose(stack.points[stack.facets[:, :3], 2], 6.0).all(axis=1)
    corners = {tuple(sorted(f)) for f in stack.facets[top, :3].tolist()}
    shells = "".join(
        f"{9000 + k}, {a + 1}, {b + 1}, {c + 1}\n" for k, (a, b, c) in enumerate(corners)
    )
    text = deck(stack) + surfaces(stack) + f'*ELEMENT, TYPE=S3, ELSET="skin of it"\n{shells}'
    text += "*SURFACE, NAME=ends, COMBINE=UNION\nlow, high\n"
    text += "*SURFACE, NAME=none, COMBINE=INTERSECTION\nlow, high\n"
    text += "*SURFACE, NAME=all\nbone\ncement\n*SURFACE, NAME=rest, COMBINE=DIFFERENCE\nall\nends\n"
    text += '*SURFACE, NAME=shell\n"skin of it", SPOS\n*SURFACE, TYPE=NODE, NAME=n\nkept, 1.0\n'
    text += "*NSET, NSET=kept, ELSET=cement\n"
    path = tmp_path / "a.inp"
    path.write_text(text)
    areas = boundary_areas(built(path))
    expected = {"ends": 30.0, "rest": 96.0, "shell": 15.0, "n": 15.0 + 2 * 2 * (3 + 5)}
    assert {name: areas[name] for name in expected} == pytest.approx(expected)
    assert "none" not in areas


def test_inp_parts_without_instance_are_left_out_and_dots_are_characters(
    stack: MeshData, tmp_path: Path
) -> None:
    part = f"*PART, NAME=hip\n{deck(stack, 'bone_v1.2', 'cement_v1.2')}*END PART\n"
    part += (
        "*PART, NAME=spare\n*NODE\n1, 0, 0, 0\n*ELEMENT, TYPE=C3D4, ELSET=other\n1, 1, 1, 1, 1\n"
    )
    part += "*END PART\n*ASSEMBLY, NAME=a\n*INSTANCE, NAME=hip-1, PART=hip\n*END INSTANCE\n"
    part += "*SURFACE, NAME=load.top\nhip-1.cement_v1.2\n*END ASSEMBLY\n"
    path = tmp_path / "a.inp"
    path.write_text(part)
    back = built(path, "bone_v1_2", "cement_v1_2")
    assert region_volumes(back) == pytest.approx({"bone_v1_2": 60.0, "cement_v1_2": 30.0})
    assert boundary_areas(back)["load_top"] == pytest.approx(15.0 + 2 * 2 * (3 + 5))
    assert "parts without an instance: spare" in said(back)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("TYPE=C3D4, ", "", r"\*ELEMENT in line \d+: has no option TYPE="),
        ("ELSET=bone\n", "ELSET=\n", r"\*ELEMENT in line \d+: has no option ELSET="),
        ("*NODE", "*NODE, SYSTEM=S", "SYSTEM=S is not read"),
        ("*NODE", "*NODE, INPUT=a.txt", "takes numbers from elsewhere"),
        ("ELSET=cement", "ELSET=böne", "both called b_ne"),
    ],
)
def test_inp_faults_name_line_and_option(
    old: str, new: str, words: str, stack: MeshData, tmp_path: Path
) -> None:
    text = deck(stack).replace(old, new)
    if "böne" in new:
        text = text.replace("ELSET=bone", "ELSET=bäne")
    (tmp_path / "a.inp").write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=words):
        MeshFile(path=tmp_path / "a.inp")


def test_cells_without_region_are_noted_by_every_command(stack: MeshData, tmp_path: Path) -> None:
    rows = elements(stack, "cement").splitlines(keepends=True)
    text = deck(stack).replace("".join(rows), "".join(rows[3:]))
    (tmp_path / "a.inp").write_text(text + f"*ELEMENT, TYPE=C3D4\n{''.join(rows[:3])}")
    assert f"3 of {len(stack.cells)} cells of the file belong to no region" in said(
        built(tmp_path / "a.inp")
    )


# ---------------------------------------------------------------------------------------- .vtu


def binary(values: np.ndarray, header: str, order: str, pack: Callable | None, raw: bool) -> bytes:
    """Data as VTK writes them: headers and contents are padded alone in base64."""
    content = values.astype(values.dtype.newbyteorder(order)).tobytes()
    word = {"UInt32": "I", "UInt64": "Q"}[header]
    encode = bytes if raw else base64.b64encode
    if pack is None:
        return encode(struct.pack(order + word, len(content)) + content)
    size = 64
    blocks = [content[k : k + size] for k in range(0, len(content), size)]
    packed = [pack(block) for block in blocks]
    last = len(blocks[-1]) % size if blocks else 0
    head = struct.pack(
        f"{order}{3 + len(blocks)}{word}", len(blocks), size, last, *map(len, packed)
    )
    return encode(head) + encode(b"".join(packed))


def vtu(
    pieces: list[tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]],
    form: str = "ascii",
    header: str = "UInt32",
    order: str = "<",
    pack: Callable | None = None,
    raw: bool = False,
) -> bytes:
    """A file of tetrahedra; triangles are those of three nodes, which -1 fills up."""
    kinds = {"f8": "Float64", "f4": "Float32", "i8": "Int64", "u1": "UInt8", "i4": "Int32"}
    appended = b""
    text = b""

    def array(name: str, values: np.ndarray) -> bytes:
        nonlocal appended
        width = values.shape[1] if values.ndim > 1 else 1
        head = f'<DataArray type="{kinds[values.dtype.str[1:]]}" Name="{name}"'
        head += f' NumberOfComponents="{width}" format="{form}"'
        if form == "ascii":
            return f"{head}>{' '.join(map(repr, values.ravel().tolist()))}</DataArray>".encode()
        block = binary(values.ravel(), header, order, pack, raw)
        if form == "binary":
            return head.encode() + b">" + block + b"</DataArray>"
        head += f' offset="{len(appended)}"/>'
        appended += block
        return head.encode()

    for points, cells, arrays in pieces:
        width = np.where(cells[:, 3] < 0, 3, 4)
        text += f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(cells)}">'.encode()
        text += b"<CellData>" + b"".join(array(*a) for a in arrays.items()) + b"</CellData>"
        text += b"<Points>" + array("Points", points) + b"</Points><Cells>"
        text += array("connectivity", cells[cells >= 0])
        text += array("offsets", np.cumsum(width))
        text += array("types", np.where(width == 3, 5, 10).astype("u1")) + b"</Cells></Piece>"
    name = {zlib.compress: "vtkZLibDataCompressor", lzma.compress: "vtkLZMADataCompressor"}.get(
        pack
    )
    head = f'<VTKFile type="UnstructuredGrid" version="1.0" header_type="{header}"'
    head += f' byte_order="{"Little" if order == "<" else "Big"}Endian"'
    head += f' compressor="{name}">' if name else ">"
    end = b""
    if form == "appended":
        end = f'<AppendedData encoding="{"raw" if raw else "base64"}">_'.encode() + appended
        end += b"</AppendedData>"
    body = b"<UnstructuredGrid>" + text + b"</UnstructuredGrid>" + end + b"</VTKFile>"
    return b'<?xml version="1.0"?>' + head.encode() + body


def cut(data: MeshData, parts: int) -> list[tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]]:
    """The mesh in pieces, each with nodes of its own."""
    cells = data.cells[:, :4].astype(np.int64)
    middle = data.points[cells].mean(axis=1)[:, 0]
    piece = np.argsort(np.argsort(middle)) * parts // len(cells)
    made = []
    for k in range(parts):
        used, local = np.unique(cells[piece == k], return_inverse=True)
        arrays = {"material": data.cell_tags[piece == k].astype("i4")}
        made.append((data.points[used], local.reshape(-1, 4), arrays))
    return made


@pytest.mark.parametrize("pack", [None, zlib.compress, lzma.compress])
@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("header", ["UInt32", "UInt64"])
@pytest.mark.parametrize("form", ["binary", "appended", "raw"])
@pytest.mark.parametrize("parts", [1, 3])
def test_vtu_forms_are_the_same_mesh(
    form: str,
    header: str,
    order: str,
    pack: Callable | None,
    parts: int,
    stack: MeshData,
    tmp_path: Path,
) -> None:
    form, raw = ("appended", True) if form == "raw" else (form, False)
    path = tmp_path / "a.vtu"
    path.write_bytes(vtu(cut(stack, parts), form, header, order, pack, raw))
    back = built(path, "material_1", "material_2")
    assert [*region_volumes(back).values()] == pytest.approx([60.0, 30.0])
    assert len(back.cells) == len(stack.cells) and len(back.points) == len(stack.points)
    assert ("has 3 pieces" in said(back)) == (parts == 3)


def test_vtu_ghost_and_doubled_cells_are_counted_once(stack: MeshData, tmp_path: Path) -> None:
    whole = cut(stack, 1)
    (tmp_path / "twice.vtu").write_bytes(vtu(whole * 2))
    back = built(tmp_path / "twice.vtu", "material_1", "material_2")
    assert [*region_volumes(back).values()] == pytest.approx([60.0, 30.0])
    assert f"{len(stack.cells)} cells stand twice" in said(back)
    points, cells, arrays = whole[0]
    count = len(cells)
    own = (points, cells, arrays | {"vtkGhostType": np.zeros(count, "u1")})
    ghost = (
        points,
        cells[:5],
        {"material": arrays["material"][:5], "vtkGhostType": np.ones(5, "u1")},
    )
    (tmp_path / "ghost.vtu").write_bytes(vtu([own, ghost]))
    assert "5 ghost cells" in said(built(tmp_path / "ghost.vtu", "material_1", "material_2"))


@pytest.mark.parametrize("kind", ["f8", "f4", "i8"])
@pytest.mark.parametrize("before", ["GlobalCellIds", "ElementType", "temperature"])
def test_vtu_regions_are_taken_from_the_array_that_divides_cells(
    kind: str, before: str, stack: MeshData, tmp_path: Path
) -> None:
    ((points, cells, arrays),) = cut(stack, 1)
    n = len(cells)
    other = {
        "GlobalCellIds": np.arange(n),
        "ElementType": np.full(n, 10),
        "temperature": np.arange(n) / 7,
    }
    data = {before: other[before], "material": arrays["material"].astype(kind)}
    (tmp_path / "a.vtu").write_bytes(vtu([(points, cells, data)]))
    back = built(tmp_path / "a.vtu", "material_1", "material_2")
    assert [*region_volumes(back).values()] == pytest.approx([60.0, 30.0])
    assert "regions are the values of the array material" in said(back)
    assert f"arrays of cells that are not read: {before}" in said(back)


def test_vtu_arrays_that_disagree_or_tell_nothing_are_refused(
    stack: MeshData, tmp_path: Path
) -> None:
    ((points, cells, arrays),) = cut(stack, 1)
    odd = np.arange(len(cells)) % 2
    for name, data, words in (
        ("two", {"a": arrays["material"], "b": odd.astype("i4")}, "a, b divide the cells"),
        ("none", {"GlobalCellIds": np.arange(len(cells))}, "none of its arrays of cells"),
    ):
        (tmp_path / f"{name}.vtu").write_bytes(vtu([(points, cells, data)]))
        with pytest.raises(ValueError, match=words):
            MeshFile(path=tmp_path / f"{name}.vtu")


# -------------------------------------------------------------------------------------- others


def test_xdmf_with_numbers_in_the_file_is_looked_through_in_linear_time(tmp_path: Path) -> None:
    numbers = " ".join(map(str, np.linspace(0, 1, 60_000).tolist()))
    path = tmp_path / "a.xdmf"
    path.write_text(f"<Xdmf><DataItem>{numbers}</DataItem><DataItem> b.h5:/x</DataItem></Xdmf>")
    (tmp_path / "b.h5").write_bytes(b"x")
    start = time.process_time()
    names = gmsh_header._files(path)
    assert time.process_time() - start < 1.0
    assert names == ["a.xdmf", "b.h5"]


def test_xdmf_grids_with_nodes_of_their_own_are_refused(tmp_path: Path) -> None:
    item = '<DataItem Dimensions="1 3" Format="XML">{} 0 0</DataItem>'
    grid = f"<Grid><Geometry>{item}</Geometry></Grid>"
    path = tmp_path / "a.xdmf"
    path.write_text(f"<Xdmf><Domain>{grid.format(0)}{grid.format(1)}</Domain></Xdmf>")
    with pytest.raises(ValueError, match="several grids with nodes of their own"):
        MeshFile(path=path)


def test_feb_blocks_of_one_name_are_one_region(tmp_path: Path) -> None:
    nodes = "".join(
        f'<node id="{k}">{x}</node>'
        for k, x in enumerate(("0,0,0", "3,0,0", "0,3,0", "0,0,3", "3,3,3"), 1)
    )
    cells = "".join(
        f'<Elements type="tet4" name="cup"><elem id="{k}">{c}</elem></Elements>'
        for k, c in enumerate(("1,2,3,4", "2,3,4,5"), 1)
    )
    path = tmp_path / "a.feb"
    path.write_text(f"<febio_spec><Mesh><Nodes>{nodes}</Nodes>{cells}</Mesh></febio_spec>")
    back = meshes.build(MeshFile(path=path), MeshOptions(size="1 mm"))
    assert region_volumes(back)["cup"] == pytest.approx(4.5 + 9.0)


def boxes(path: Path, inset: float, lift: float = 0.0) -> None:
    """Two boxes on each other, meshed apart."""
    with session("boxes") as gmsh:
        gmsh.model.occ.addBox(0, 0, 0, 2, 2, 1)
        gmsh.model.occ.addBox(inset, inset, 1 + lift, 2 - 2.5 * inset, 2 - 3 * inset, 1)
        gmsh.model.occ.synchronize()
        for tag, name in ((1, "low"), (2, "high")):
            gmsh.model.addPhysicalGroup(3, [tag], name=name)
        for z, name in ((0, "bottom"), (2 + lift, "top")):
            box = (-1, -1, z - 0.01, 3, 3, z + 0.01)
            tags = [tag for _, tag in gmsh.model.getEntitiesInBoundingBox(*box, 2)]
            gmsh.model.addPhysicalGroup(2, tags, name=name)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(path))


APART = """
geometry: {{kind: file, path: {path}}}
mesh: {{size: 1 mm, order: 1}}
regions:
  low: &E {{youngs_modulus: 1 GPa, poisson_ratio: 0.3, tissue: other}}
  high: *E
supports: {{floor: {{kind: fixed, boundary: bottom}}, lid: {{kind: fixed, boundary: top}}}}
"""


@pytest.mark.parametrize(("inset", "lift", "noted"), [(0.17, 0.0, True), (0.17, 0.05, False)])
def test_bodies_on_each_other_without_a_common_node_are_noted(
    inset: float, lift: float, noted: bool, tmp_path: Path
) -> None:
    path = tmp_path / "a.msh"
    boxes(path, inset, lift)
    case = support.case(APART.format(path=path))
    data = meshes.build(case.geometry, case.mesh)
    notes = [
        note
        for note in well_posedness.judge(case, well_posedness.look(case, data))
        if "lie on each other" in note
    ]
    assert len(notes) == noted
    if noted:
        assert "regions 'high' and 'low'" in notes[0] and "neither force nor heat" in notes[0]
        area, place = lying(data)["high", "low"]
        assert area == pytest.approx((2 - 2.5 * inset) * (2 - 3 * inset), rel=0.05)
        assert place[2] == pytest.approx(1.0)


def test_damaged_files_are_refused_in_words(stack: MeshData, tmp_path: Path) -> None:
    """Files cut short, with bytes changed, with lines lost: never another kind of error."""
    rng = random.Random(5)
    forms = {
        "inp": [(deck(stack) + surfaces(stack)).encode()],
        "vtu": [
            vtu(cut(stack, 2)),
            vtu(cut(stack, 2), "appended", "UInt64", "<", zlib.compress),
            vtu(cut(stack, 1), "appended", raw=True),
        ],
    }
    refused = 0
    for trial in range(200):
        suffix = rng.choice([*forms])
        raw = bytearray(rng.choice(forms[suffix]))
        match rng.randrange(3):
            case 0:
                del raw[rng.randrange(len(raw)) :]
            case 1:
                for _ in range(rng.choice((1, 5, 50))):
                    raw[rng.randrange(len(raw))] = rng.randrange(256)
            case _:
                lines = bytes(raw).split(b"\n")
                del lines[rng.randrange(len(lines))]
                raw = bytearray(b"\n".join(lines))
        path = tmp_path / f"{trial}.{suffix}"
        path.write_bytes(raw)
        try:
            meshes.build(MeshFile(path=path), MeshOptions(size="1 mm"))
        except (ValueError, GeometryError) as error:
            assert len(str(error)) > 10
            refused += 1
    assert refused > 100
