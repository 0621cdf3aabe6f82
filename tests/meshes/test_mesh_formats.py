"""Mesh files as programs and people write them: a box of two regions in each spelling."""

from __future__ import annotations

import base64
import lzma
import random
import re
import struct
import time
import zlib
from itertools import permutations, product
from pathlib import Path

import meshio
import numpy as np
import pytest

import meshes
from app.case.case import load
from app.case.geometries import MeshFile, MeshOptions
from app.case.gmsh_header import content
from app.errors import MantleError
from app.mesh_files.lz4_block import decompress
from app.soundness.well_posedness import judge, look
from meshes.data import MeshData, boundary_areas, region_volumes
from meshes.gmsh_child import session

# The box is 3 x 3 x 2 H mm, of cubes of 3 x 3 x H mm: bone below z = H, cement above.
SIDE, H = 3.0, 5.0
AREA, VOLUME = SIDE * SIDE, SIDE * SIDE * H
# Corners of the faces S1 to S4 in the manual of Abaqus.
FACES = [(0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)]


def box() -> tuple[np.ndarray, np.ndarray]:
    """Points of 2 x 2 x 3 places, and six tetrahedra a cube, those of bone first."""
    points = np.array(
        [[SIDE * i, SIDE * j, H * k] for k, j, i in product(range(3), *[range(2)] * 2)]
    )
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


POINTS, CELLS = box()


def on(height: float) -> list[tuple[int, int]]:
    """Elements with a face at a height, and its label."""
    return [
        (e, s)
        for e, cell in enumerate(CELLS, 1)
        for s, face in enumerate(FACES, 1)
        if (POINTS[cell[list(face)], 2] == height).all()
    ]


def nodes(lines: list[str] | None = None, options: str = "") -> str:
    rows = lines or [f"{k}, {x}, {y}, {z}" for k, (x, y, z) in enumerate(POINTS.tolist(), 1)]
    return "\n".join([f"*NODE{options}", *rows, ""])


def elements(first: int, last: int, name: str) -> str:
    rows = [f"{k + 1}, " + ", ".join(map(str, CELLS[k] + 1)) for k in range(first, last)]
    return "\n".join([f"*ELEMENT, TYPE=C3D4, ELSET={name}", *rows, ""])


def deck(bone: str = "bone", cement: str = "cement", more: str = "", start: str = "") -> str:
    body = start or nodes()
    return body + elements(0, 6, bone) + elements(6, 12, cement) + more


def surface(name: str, height: float) -> str:
    return f"*SURFACE, NAME={name}\n" + "".join(f"{e}, S{s}\n" for e, s in on(height))


def build(path: Path, text: str | bytes) -> MeshData:
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return bonded(path)


def bonded(path: Path) -> MeshData:
    """The mesh of a file with an interface between its regions, if it has two."""
    names = MeshFile(path=path).region_names
    interfaces = {"between": tuple((name,) for name in names)} if len(names) == 2 else {}
    geometry = MeshFile(path=path, interfaces=interfaces)
    return meshes.build(geometry, MeshOptions(size="1 mm"))


def refused(path: Path, text: str) -> str:
    with pytest.raises(ValueError) as caught:
        build(path, text)
    return str(caught.value)


def whole(data: MeshData, bone: str = "bone", cement: str = "cement") -> dict[str, float]:
    assert region_volumes(data) == pytest.approx({bone: VOLUME, cement: VOLUME})
    return boundary_areas(data)


def test_inp_names_that_become_equal_are_refused(tmp_path: Path) -> None:
    for raw in ("utf-8", "latin-1"):
        (tmp_path / "a.inp").write_bytes(deck("Schraube_ä", "Schraube_ö").encode(raw))
        with pytest.raises(
            ValueError, match="Schraube_ä and Schraube_ö are both called Schraube__"
        ):
            MeshFile(path=tmp_path / "a.inp")


def test_inp_dots_are_characters_without_an_instance(tmp_path: Path) -> None:
    more = surface("load.top", 2 * H) + surface("fix.top", 0.0)
    areas = whole(
        build(tmp_path / "a.inp", deck("bone_v1.2", "cement_v1.2", more)),
        "bone_v1_2",
        "cement_v1_2",
    )
    assert areas == pytest.approx({"load_top": AREA, "fix_top": AREA})


def test_inp_parts_without_an_instance_are_no_part_of_the_model(tmp_path: Path) -> None:
    unused = "*PART, NAME=unused\n*NODE\n901,0,0,0\n902,1,0,0\n903,0,1,0\n904,0,0,1\n"
    unused += "*ELEMENT, TYPE=C3D4, ELSET=spare\n901,901,902,903,904\n*END PART\n"
    text = f"{unused}*PART, NAME=P\n{deck(more=SECTIONS)}*END PART\n*ASSEMBLY, NAME=A\n"
    text += "*INSTANCE, NAME=I-1, PART=P\n*END INSTANCE\n*ELSET, ELSET=both, INSTANCE=I-1\n"
    text += "I-1.bone, cement\n*SURFACE, NAME=all\nboth\n*END ASSEMBLY\n"
    data = build(tmp_path / "a.inp", text)
    areas = whole(data)
    assert areas["all"] == pytest.approx(2 * AREA + 8 * SIDE * H)
    assert "parts without an instance: unused" in str(data.notes["told"])


@pytest.mark.parametrize("system", ["C"])
def test_inp_coordinates_in_other_systems(system: str, tmp_path: Path) -> None:
    lines = []
    for k, (x, y, z) in enumerate(POINTS.tolist(), 1):
        theta = np.degrees(np.arctan2(y, x))
        r = np.hypot(x, y)
        row = (
            (r, theta, z)
            if system == "C"
            else (np.hypot(r, z), theta, np.degrees(np.arctan2(z, r)))
        )
        lines.append(f"{k}, " + ", ".join(map(repr, map(float, row))))
    data = build(tmp_path / "a.inp", deck(start=nodes(lines, f", SYSTEM={system}")))
    whole(data)
    np.testing.assert_allclose(data.points, POINTS, atol=1e-12)


TOP_BY_SETS = "".join(
    f"*ELSET, ELSET=top{s}\n{', '.join(str(e) for e, t in on(2 * H) if t == s)}\n"
    for s in {s for _, s in on(2 * H)}
)
TOP = "*SURFACE, NAME=top\n" + "".join(f"top{s}, S{s}\n" for s in sorted({s for _, s in on(2 * H)}))
BLANK = re.sub(r"(?<!\d)0\.0", "", deck())
SECTIONS = "".join(f"*SOLID SECTION, ELSET={n}\n" for n in ("bone", "cement"))


SKIN = "*ELEMENT, TYPE=S3, ELSET=skin\n90,1,2,4\n91,1,4,3\n*SURFACE, NAME=s\nskin, "
COMBINED = """*SURFACE, NAME=u, COMBINE=UNION
a, b
*SURFACE, NAME=d, COMBINE=DIFFERENCE
u, a
*SURFACE, NAME=i, COMBINE=INTERSECTION
u, b
"""
NESTED = "*ELSET, ELSET=a\nb\n*ELSET, ELSET=b\nbone\n*SURFACE, NAME=s\na\n"
OF_ELEMENTS = "*NSET, NSET=n, ELSET=bone\n*SURFACE, TYPE=NODE, NAME=n2\nn, 1\n"
# The bottom and the four sides of bone.
FREE = AREA + 4 * SIDE * H
SPELLINGS = {
    "empty fields": (BLANK, {}),
    "later sets": (deck(more=TOP + TOP_BY_SETS + SECTIONS), {"top": AREA}),
    "sets of sets": (deck(more=NESTED + SECTIONS), {"s": FREE}),
    "Fortran": (deck().replace("3.0", "3.0D+00").replace("5.0", "0.5d1"), {}),
    "combined": (
        deck(more=surface("a", 0.0) + surface("b", 2 * H) + COMBINED),
        {"a": AREA, "b": AREA, "u": 2 * AREA, "d": AREA, "i": AREA},
    ),
    "combined before": (
        deck(more=COMBINED + surface("a", 0.0) + surface("b", 2 * H)),
        {"a": AREA, "b": AREA, "u": 2 * AREA, "d": AREA, "i": AREA},
    ),
    "continued": (deck().replace("C3D4, ELSET=bone", "C3D4,\n  ELSET=bone"), {}),
    "tabs": (deck().replace("*ELEMENT,", "*ELEMENT\t,\t"), {}),
    "mark": ("\ufeff" + deck(), {}),
    "lower case": (deck().lower().replace("\n", "\r\n"), {}),
    "SPOS": (deck(more=f"{SKIN}SPOS\n"), {"skin": AREA, "s": AREA}),
    "SNEG": (deck(more=f"{SKIN}SNEG\n"), {"skin": AREA, "s": AREA}),
    "nodes of elements": (deck(more=OF_ELEMENTS), {"n": FREE, "n2": FREE}),
}


@pytest.mark.parametrize("name", SPELLINGS)
def test_inp_spellings(name: str, tmp_path: Path) -> None:
    text, areas = SPELLINGS[name]
    assert whole(build(tmp_path / "a.inp", text)) == pytest.approx(areas)


def test_inp_blanks_in_quotes_count(tmp_path: Path) -> None:
    more = '*SURFACE, NAME="its skin"\n"upper one"\n'
    data = build(tmp_path / "a.inp", deck('"upper one"', "cement", more))
    assert whole(data, "upper_one") == pytest.approx({"its_skin": FREE})


def test_inp_utf16_is_read(tmp_path: Path) -> None:
    whole(build(tmp_path / "a.inp", deck().encode("utf-16")))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (deck().replace("TYPE=C3D4, ELSET=bone", "ELSET=bone"), "line 14: has no option TYPE"),
        (
            deck().replace("ELSET=bone", "ELSE=bone"),
            "line 14: has no option ELSE; did you mean ELSET",
        ),
        (deck(more="*ELSET, NAME=x\n1\n"), "line 28: has no option ELSET"),
        (deck(more="*SURFACE, NAME=x\nbone, S7\n"), "line 29: S7 is no face of a tetrahedron"),
        (deck(more="*SURFACE, NAME=x\nbone, SPOS\n"), "line 29: SPOS is no face of a tetrahedron"),
        (deck(more="*ELSET, ELSET=x\ny\n*ELSET, ELSET=y\nx\n"), "contains itself"),
        (deck(more="*ELSET, ELSET=x\nbonn\n"), "there is no set bonn"),
        (deck().replace("*NODE", "*NODE, INPUT=b.txt"), "takes numbers from elsewhere"),
        (deck().replace("3.0", "3.x"), "line 3: '3.x' is no number"),
    ],
)
def test_inp_faults_name_the_line(text: str, words: str, tmp_path: Path) -> None:
    assert words in refused(tmp_path / "a.inp", text)


TAGS = np.repeat([3, 8], 6)


def array(
    name: str,
    values: np.ndarray,
    way: str,
    appended: list[bytes],
    order: str = "<",
    header: str = "I",
    packer: object = None,
) -> str:
    """A DataArray as VTK writes it: header and data in one, or compressed in blocks."""
    kind = {"f8": "Float64", "f4": "Float32", "i8": "Int64", "u1": "UInt8", "i4": "Int32"}[
        values.dtype.str[1:]
    ]
    width = values.shape[1] if values.ndim > 1 else 1
    start = f'<DataArray Name="{name}" type="{kind}" NumberOfComponents="{width}"'
    if way == "ascii":
        return f'{start} format="ascii">{" ".join(map(str, values.ravel().tolist()))}</DataArray>'
    data = values.astype(values.dtype.newbyteorder(order)).tobytes()
    raw = way == "raw"
    code = (lambda b: b) if raw else base64.b64encode
    if packer is None:
        text = code(struct.pack(order + header, len(data)) + data)
    else:
        size = 64
        blocks = [data[k : k + size] for k in range(0, len(data), size)]
        packed = [packer(b) for b in blocks]  # type: ignore[operator]
        last = len(data) % size
        numbers = [len(blocks), size, last, *map(len, packed)]
        text = code(struct.pack(f"{order}{len(numbers)}{header}", *numbers)) + code(
            b"".join(packed)
        )
    if way == "binary":
        return f'{start} format="binary">\n{text.decode()}\n</DataArray>'
    offset = sum(map(len, appended))
    appended.append(text)
    return f'{start} format="appended" offset="{offset}"/>'


def literal_lz4(block: bytes) -> bytes:
    """A block of LZ4 of literals alone."""
    rest, long = len(block) - 15, b""
    if rest >= 0:
        long = b"\xff" * (rest // 255) + bytes([rest % 255])
    return bytes([min(len(block), 15) << 4]) + long + block


PACKERS = {
    "": None,
    "vtkZLibDataCompressor": zlib.compress,
    "vtkLZMADataCompressor": lzma.compress,
    "vtkLZ4DataCompressor": literal_lz4,
}


def vtu(
    way: str = "ascii",
    order: str = "<",
    header: str = "I",
    compressor: str = "",
    pieces: int = 1,
    data: dict[str, np.ndarray] | None = None,
) -> bytes:
    appended: list[bytes] = []
    arrays = data or {"material": TAGS}
    body = ""

    def write(name: str, values: np.ndarray) -> str:
        return array(name, values, way, appended, order, header, PACKERS[compressor])

    for rows in np.array_split(
        np.random.default_rng(1).permutation(12) if pieces > 1 else np.arange(12), pieces
    ):
        used, cells = np.unique(CELLS[rows], return_inverse=True)
        body += f'<Piece NumberOfPoints="{len(used)}" NumberOfCells="{len(rows)}"><Points>'
        body += write("Points", POINTS[used]) + "</Points><Cells>"
        body += write("connectivity", cells.ravel().astype(np.int64))
        body += write("offsets", 4 * np.arange(1, len(rows) + 1))
        body += write("types", np.full(len(rows), 10, dtype=np.uint8)) + "</Cells><CellData>"
        body += "".join(write(n, v[rows]) for n, v in arrays.items()) + "</CellData></Piece>"
    size = {"I": "UInt32", "Q": "UInt64"}[header]
    end = "Big" if order == ">" else "Little"
    pack = f' compressor="{compressor}"' if compressor else ""
    text = f'<VTKFile type="UnstructuredGrid" version="1.0" byte_order="{end}Endian" '
    text += f'header_type="{size}"{pack}>'
    text += f"<UnstructuredGrid>{body}</UnstructuredGrid>"
    coded = "raw" if way == "raw" else "base64"
    tail = b""
    if appended:
        tail = (
            f'<AppendedData encoding="{coded}">\n_'.encode()
            + b"".join(appended)
            + b"\n</AppendedData>"
        )
    return text.encode() + tail + b"</VTKFile>"


@pytest.mark.parametrize("compressor", PACKERS)
@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("header", "IQ")
@pytest.mark.parametrize("way", ["raw", "base64", "binary"])
def test_vtu_encodings(way: str, header: str, order: str, compressor: str, tmp_path: Path) -> None:
    whole(
        build(tmp_path / "a.vtu", vtu(way, order, header, compressor)), "material_3", "material_8"
    )


@pytest.mark.parametrize("pieces", [1, 2, 3])
def test_vtu_pieces_are_joined(pieces: int, tmp_path: Path) -> None:
    data = build(tmp_path / "a.vtu", vtu(pieces=pieces))
    whole(data, "material_3", "material_8")
    assert len(data.points) == len(POINTS)
    assert (f"{pieces} pieces, which are read" in str(data.notes["told"])) == (pieces > 1)


@pytest.mark.parametrize(
    ("data", "name"),
    [
        ({"material": TAGS.astype(float)}, "material"),
        ({"material": TAGS.astype(np.float32)}, "material"),
        ({"GlobalCellIds": np.arange(12), "material": TAGS}, "material"),
        ({"ElementType": np.full(12, 10), "label": TAGS.astype(float)}, "label"),
        ({"constant": np.full(12, 10), "x": TAGS}, "x"),
        ({"flag": np.arange(12) % 2, "region": TAGS}, "region"),
    ],
)
def test_the_array_that_names_regions(data: dict, name: str, tmp_path: Path) -> None:
    mesh = build(tmp_path / "a.vtu", vtu(data=data))
    whole(mesh, f"{name}_3", f"{name}_8")
    assert f"values of the array {name}" in str(mesh.notes["told"])
    blocks = {k: [v] for k, v in data.items()}
    meshio.Mesh(POINTS, [("tetra", CELLS)], cell_data=blocks).write(tmp_path / "a.xdmf")
    whole(bonded(tmp_path / "a.xdmf"), f"{name}_3", f"{name}_8")


def test_arrays_that_name_no_regions_are_named(tmp_path: Path) -> None:
    (tmp_path / "a.vtu").write_bytes(vtu(data={"strain": np.linspace(0, 1, 12)}))
    with pytest.raises(ValueError, match=r"none of its arrays of cells \(strain\)"):
        MeshFile(path=tmp_path / "a.vtu")


def test_xdmf_with_numbers_in_the_file_is_hashed_in_linear_time(tmp_path: Path) -> None:
    numbers = " ".join(map(repr, np.random.default_rng(3).random(100_000).tolist()))
    path = tmp_path / "a.xdmf"
    path.write_text(f'<Xdmf><DataItem Format="XML">{numbers}</DataItem><D>my data.h5:/x</D></Xdmf>')
    start = time.process_time()
    before = content(path)
    assert time.process_time() - start < 1.0
    (tmp_path / "my data.h5").write_bytes(b"1")
    assert content(path) != before


def test_cells_without_a_region_are_counted(tmp_path: Path) -> None:
    more = "*SOLID SECTION, ELSET=bone\n1.0\n"
    data = build(tmp_path / "a.inp", deck(more=more))
    assert "6 of 12 cells of the file belong to no region" in str(data.notes["told"])


CASE = """
geometry: {kind: file, path: a.msh}
mesh: {size: 1 mm, order: 1}
regions:
  lower: &C
    kind: conductor
    tissue: other
    thermal:
      conductivity: 1 W/(m K)
      density: 1000 kg/m^3
      specific_heat: 1000 J/(kg K)
      initial_temperature: 0 degC
  upper: *C
heat:
  cold: {kind: temperature, boundary: bottom, temperature: 0 degC}
  hot: {kind: temperature, boundary: top, temperature: 1 degC}
stages:
  - {name: conduct, steady: true}
"""


@pytest.mark.parametrize(("lift", "noted"), [(0.0, True), (0.02, False)])
def test_bodies_that_lie_on_each_other_are_noted(lift: float, noted: bool, tmp_path: Path) -> None:
    with session("boxes") as gmsh:
        lower = gmsh.model.occ.addBox(0, 0, 0, 2, 2, 2)
        upper = gmsh.model.occ.addBox(0.33, 0.41, 2 + lift, 1.13, 1.07, 1.5)
        gmsh.model.occ.synchronize()
        for name, tag in (("lower", lower), ("upper", upper)):
            gmsh.model.addPhysicalGroup(3, [tag], name=name)
        for name, z in (("bottom", 0.0), ("top", 3.5 + lift)):
            found = gmsh.model.getEntitiesInBoundingBox(-1, -1, z - 0.01, 3, 3, z + 0.01, 2)
            gmsh.model.addPhysicalGroup(2, [tag for _, tag in found], name=name)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.6)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(tmp_path / "a.msh"))
    data = meshes.build(MeshFile(path=tmp_path / "a.msh"), MeshOptions(size="1 mm"))
    (tmp_path / "case.yaml").write_text(CASE)
    case = load(tmp_path / "case.yaml").config
    notes = " ".join(judge(case, look(case, data)))
    assert ("share no node" in notes) == noted, notes


def feb(first: str = "bone", second: str = "cement") -> str:
    rows = "".join(f'<node id="{k}">{x},{y},{z}</node>' for k, (x, y, z) in enumerate(POINTS, 1))
    text = f"<Nodes>{rows}</Nodes>"
    for name, part in ((first, range(6)), (second, range(6, 12))):
        text += f'<Elements type="tet4" name="{name}">'
        for k in part:
            text += f'<elem id="{k + 1}">{",".join(map(str, CELLS[k] + 1))}</elem>'
        text += "</Elements>"
    return f'<febio_spec version="4.0"><Mesh>{text}</Mesh></febio_spec>'


def test_names_that_become_equal_are_refused_in_all_formats(tmp_path: Path) -> None:
    data = meshio.Mesh(POINTS, [("tetra", CELLS)], cell_data={"cell_tags": [-TAGS]})
    data.cell_tags = {-3: ["a b"], -8: ["a.b"]}
    data.write(tmp_path / "a.med")
    (tmp_path / "a.feb").write_text(feb("a b", "a.b"))
    (tmp_path / "a.vtu").write_bytes(vtu(data={"a b-a.b": (TAGS > 5).astype(np.int64)}))
    for suffix in ("med", "feb", "vtu"):
        with pytest.raises(ValueError, match=r"its sets a.b and a.b are both called a_b here"):
            MeshFile(path=tmp_path / f"a.{suffix}")


def damaged(raw: bytes, dice: random.Random) -> bytes:
    """A file cut, with bytes changed, or with lines left out."""
    way, at = dice.randrange(4), dice.randrange(len(raw))
    if way == 0:
        return raw[:at]
    if way == 1:
        return raw[:at] + bytes([dice.randrange(256)]) + raw[at + 1 :]
    if way == 2:
        return raw[:at] + raw[at + dice.randrange(1, 40) :]
    lines = raw.split(b"\n")
    dice.shuffle(lines)
    return b"\n".join(lines)


def test_damaged_files_are_input_errors(tmp_path: Path) -> None:
    """A hundred damaged files are read, or refused in words."""
    dice = random.Random(7)
    mesh = meshio.Mesh(POINTS, [("tetra", CELLS)], cell_data={"a": [TAGS]})
    mesh.write(tmp_path / "x.xdmf", data_format="XML")
    data = meshio.Mesh(POINTS, [("tetra", CELLS)], cell_data={"cell_tags": [-TAGS]})
    data.cell_tags = {-3: ["bone"], -8: ["cement"]}
    data.write(tmp_path / "x.med")
    meshes.write_msh(build(tmp_path / "y.inp", deck()), tmp_path / "x.msh")
    more = surface("top", 2 * H) + "*NSET, NSET=n, GENERATE\n1, 4\n"
    originals = {
        ".inp": deck(more=more).encode(),
        ".vtu": vtu("raw", compressor="vtkZLibDataCompressor"),
        ".feb": feb().encode(),
        ".xdmf": (tmp_path / "x.xdmf").read_bytes(),
        ".med": (tmp_path / "x.med").read_bytes(),
        ".msh": (tmp_path / "x.msh").read_bytes(),
    }
    for suffix, raw in originals.items():
        (tmp_path / f"whole{suffix}").write_bytes(raw)
        assert len(bonded(tmp_path / f"whole{suffix}").cells) == len(CELLS), suffix
    refusals = 0
    for k in range(100):
        suffix = [*originals][k % len(originals)]
        path = tmp_path / f"d{k}{suffix}"
        path.write_bytes(damaged(originals[suffix], dice))
        try:
            bonded(path)
        except (ValueError, MantleError):
            refusals += 1
    assert refusals > 30


def test_inp_sets_of_one_name_in_two_instances_are_kept_apart(tmp_path: Path) -> None:
    text = ""
    for part, first, cells in (("P", 0, range(6)), ("Q", 100, range(6, 12))):
        used = np.unique(CELLS[list(cells)])
        text += f"*PART, NAME={part}\n*NODE\n"
        text += "".join(f"{k + 1 + first}, {', '.join(map(str, POINTS[k]))}\n" for k in used)
        text += "*ELEMENT, TYPE=C3D4, ELSET=Set-1\n"
        for k in cells:
            text += f"{k + 1}, " + ", ".join(str(v + 1 + first) for v in CELLS[k]) + "\n"
        text += "*SOLID SECTION, ELSET=Set-1\n*END PART\n"
    text += "*ASSEMBLY, NAME=A\n"
    for part in "PQ":
        text += f"*INSTANCE, NAME={part}-1, PART={part}\n*END INSTANCE\n"
    data = build(tmp_path / "a.inp", f"{text}*SURFACE, NAME=s\nQ-1.Set-1\n*END ASSEMBLY\n")
    assert whole(data, "P-1_Set-1", "Q-1_Set-1")["s"] == pytest.approx(FREE)
    assert "before their name: P-1.Set-1, Q-1.Set-1" in str(data.notes["told"])


def test_lz4_blocks_with_copies() -> None:
    """Three letters, six more from three before (they overlap), and a last letter."""
    assert decompress(b"\x32abc\x03\x00\x10x") == b"abcabcabcx"
