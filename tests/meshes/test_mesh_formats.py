"""Mesh files as programs and people write them: the same mesh, or a reason in words."""

from __future__ import annotations

import os
import random
import re
import time
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import meshes
from app.case.case import load
from app.case.geometries import MeshFile, MeshOptions
from app.case.gmsh_header import content
from app.foundation.errors import GeometryError, MantleError
from app.mesh_files import named
from app.mesh_files.vtu import lz4_decompress
from app.soundness.well_posedness import check_on_mesh, mesh_parts
from meshes.data import boundary_areas, region_volumes
from meshes.gmsh_session import session
from meshes.pieces import touching_without_shared_nodes
from tests.meshes.spellings import (
    ALL_FREE,
    AREA,
    BOTTOM,
    CELLS,
    FACES,
    FREE,
    PACKERS,
    POINTS,
    TAGS,
    TOP,
    VOLUMES,
    attribute,
    bonded,
    build,
    cut,
    deck,
    elements,
    feb,
    geometry,
    grid,
    include,
    messages_of,
    nodes,
    on,
    one_piece,
    pvtu,
    surface,
    topology,
    vtu,
    whole,
    xdmf,
)

MATERIALS = "material_3", "material_8"


def refused(path: Path, text: str | bytes = "", **keys: object) -> str:
    """Message on a file that is of no use."""
    with pytest.raises(ValueError) as caught:
        build(path, text, **keys) if text else bonded(path, **keys)
    return str(caught.value)


# ---------------------------------------------------------------------------------------- .inp


def test_inp_names_that_become_equal_are_refused(tmp_path: Path) -> None:
    for raw in ("utf-8", "latin-1"):
        (tmp_path / "a.inp").write_bytes(deck("Schraube_ä", "Schraube_ö").encode(raw))
        with pytest.raises(
            ValueError, match="Schraube_ä and Schraube_ö are both called Schraube__"
        ):
            MeshFile(path=tmp_path / "a.inp")


def test_inp_dots_are_characters_without_an_instance(tmp_path: Path) -> None:
    more = surface("load.top", TOP) + surface("fix.top", BOTTOM)
    areas = whole(
        build(tmp_path / "a.inp", deck("bone_v1.2", "cement_v1.2", more)),
        "bone_v1_2",
        "cement_v1_2",
    )
    assert areas == pytest.approx({"load_top": AREA, "fix_top": AREA})


SECTIONS = "".join(f"*SOLID SECTION, ELSET={n}\n" for n in ("bone", "cement"))


def test_inp_parts_without_an_instance_are_ignored(tmp_path: Path) -> None:
    unused = "*PART, NAME=unused\n*NODE\n901,0,0,0\n902,1,0,0\n903,0,1,0\n904,0,0,1\n"
    unused += "*ELEMENT, TYPE=C3D4, ELSET=spare\n901,901,902,903,904\n*END PART\n"
    text = f"{unused}*PART, NAME=P\n{deck(more=SECTIONS)}*END PART\n*ASSEMBLY, NAME=A\n"
    text += "*INSTANCE, NAME=I-1, PART=P\n*END INSTANCE\n*ELSET, ELSET=both, INSTANCE=I-1\n"
    text += "I-1.bone, cement\n*SURFACE, NAME=all\nboth\n*END ASSEMBLY\n"
    data = build(tmp_path / "a.inp", text)
    assert whole(data)["all"] == pytest.approx(ALL_FREE)
    assert "parts without an instance: unused" in messages_of(data)


def test_inp_dots_begin_with_an_instance_where_it_is_one(tmp_path: Path) -> None:
    text = f"*PART, NAME=hip\n{deck('bone_v1.2', 'cement_v1.2')}*END PART\n*ASSEMBLY, NAME=a\n"
    text += "*INSTANCE, NAME=hip-1, PART=hip\n*END INSTANCE\n"
    text += "*SURFACE, NAME=load.top\nhip-1.cement_v1.2\n*END ASSEMBLY\n"
    areas = whole(build(tmp_path / "a.inp", text), "bone_v1_2", "cement_v1_2")
    assert areas["load_top"] == pytest.approx(ALL_FREE - FREE)


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
    assert whole(data, "P-1_Set-1", "Q-1_Set-1")["s"] == pytest.approx(ALL_FREE - FREE)
    assert "before their name: P-1.Set-1, Q-1.Set-1" in messages_of(data)


def in_system(system: str, points: np.ndarray) -> np.ndarray:
    """Coordinates in a system of *NODE: cylindrical, spherical."""
    x, y, z = points.T
    theta = np.degrees(np.arctan2(y, x))
    if system == "C":
        return np.column_stack([np.hypot(x, y), theta, z])
    latitude = np.degrees(np.arctan2(z, np.hypot(x, y)))
    return np.column_stack([np.linalg.norm(points, axis=1), theta, latitude])


@pytest.mark.parametrize("option", ["R", "C", "S", "c", "Spherical"])
def test_inp_coordinates_in_other_systems(option: str, tmp_path: Path) -> None:
    system = option[0].upper()
    given = POINTS if system == "R" else in_system(system, POINTS)
    text = deck(start=nodes(given, f", SYSTEM={option}"))
    data = build(tmp_path / "a.inp", text)
    whole(data)
    np.testing.assert_allclose(data.points, POINTS, atol=1e-12)


def test_inp_spherical_angles_are_longitude_and_latitude(tmp_path: Path) -> None:
    """phi is 0 in the plane across the polar axis, theta in the plane of x and that axis."""
    rows = np.array([[2, 30, 60], [2, 0, 0], [2, 90, 0], [2, 45, 90]])
    text = nodes(rows, ", SYSTEM=S") + "*ELEMENT, TYPE=C3D4, ELSET=a\n1, 1, 2, 3, 4\n"
    data = build(tmp_path / "a.inp", text)
    expected = [[3**0.5 / 2, 0.5, 3**0.5], [2, 0, 0], [0, 2, 0], [0, 0, 2]]
    np.testing.assert_allclose(in_order(data.points), in_order(expected), atol=1e-12)


def in_order(points: object) -> np.ndarray:
    """Points by their coordinates."""
    return np.array(sorted(np.round(points, 9).tolist()))


TURN = Rotation.from_euler("xyz", [25, -40, 70], degrees=True).as_matrix()
UPRIGHT = Rotation.from_euler("z", 115, degrees=True).as_matrix()
ORIGIN = np.array([4.0, -7.0, 2.5])


def system(*rows: np.ndarray) -> str:
    lines = (", ".join(map(repr, np.ravel(row).tolist())) for row in rows)
    return "*SYSTEM\n" + "".join(f"{line}\n" for line in lines)


# Lines of *SYSTEM, and the directions of its axes in columns.
SYSTEMS = {
    "moved": (system(ORIGIN), np.eye(3)),
    "upright": (system([ORIGIN, ORIGIN + 2 * UPRIGHT[:, 0] + [0, 0, 3]]), UPRIGHT),
    "turned": (
        system([ORIGIN, ORIGIN + 2 * TURN[:, 0]], ORIGIN + 0.3 * TURN[:, 0] + 1.7 * TURN[:, 1]),
        TURN,
    ),
}


@pytest.mark.parametrize("kind", ["R", "C", "S"])
@pytest.mark.parametrize("name", SYSTEMS)
def test_inp_nodes_in_axes_of_a_system(name: str, kind: str, tmp_path: Path) -> None:
    """The nodes from the fifth on are in the axes, the last four again in the global ones."""
    start, axes = SYSTEMS[name]
    local = (POINTS - ORIGIN) @ axes
    local = local if kind == "R" else in_system(kind, local)
    lines = nodes(local, f", SYSTEM={kind}").splitlines(keepends=True)
    plain = nodes().splitlines(keepends=True)
    text = "".join([*plain[:5], start, lines[0], *lines[5:9], "*SYSTEM\n", plain[0], *plain[9:]])
    data = build(tmp_path / "a.inp", deck(start=text))
    whole(data)
    np.testing.assert_allclose(data.points, POINTS, atol=1e-12)


def test_inp_axes_of_a_system_end_with_their_part(tmp_path: Path) -> None:
    other = "*PART, NAME=b\n*NODE\n31, 0, 0, 9\n32, 1, 0, 9\n33, 0, 1, 9\n34, 0, 0, 10\n"
    other += "*ELEMENT, TYPE=C3D4, ELSET=small\n91, 31, 32, 33, 34\n*END PART\n"
    first = f"*PART, NAME=a\n{deck(start=system(ORIGIN) + nodes(POINTS - ORIGIN))}*END PART\n"
    ends = "".join(f"*INSTANCE, NAME={p}-1, PART={p}\n*END INSTANCE\n" for p in "ab")
    text = f"{first}{other}*ASSEMBLY, NAME=A\n{ends}*END ASSEMBLY\n"
    data = build(tmp_path / "a.inp", text, interfaces={"between": ["bone", "cement"]})
    expected = np.concatenate([POINTS, [[0, 0, 9], [1, 0, 9], [0, 1, 9], [0, 0, 10]]])
    np.testing.assert_allclose(in_order(data.points), in_order(expected), atol=1e-12)


TOP_BY_SETS = "".join(
    f"*ELSET, ELSET=top{s}\n{', '.join(str(e) for e, t in on(TOP) if t == s)}\n"
    for s in {s for _, s in on(TOP)}
)
TOP_FIRST = "*SURFACE, NAME=top\n"
TOP_FIRST += "".join(f"top{s}, S{s}\n" for s in sorted({s for _, s in on(TOP)}))
BLANK = re.sub(r"(?<!\d)0\.0", "", deck())
SKIN = "*ELEMENT, TYPE=S3, ELSET=skin\n90,1,2,4\n91,1,4,3\n*SURFACE, NAME=s\nskin, "
COMBINED = """*SURFACE, NAME=u, COMBINE=UNION
a, b
*SURFACE, NAME=d, COMBINE=DIFFERENCE
u, a
*SURFACE, NAME=i, COMBINE=INTERSECTION
u, b
*SURFACE, NAME=none, COMBINE=INTERSECTION
a, b
*SURFACE, NAME=free
bone
cement
*SURFACE, NAME=rest, COMBINE=DIFFERENCE
free
u
"""
COMBINED_AREAS = {"a": AREA, "b": AREA, "u": 2 * AREA, "d": AREA, "i": AREA}
COMBINED_AREAS |= {"free": ALL_FREE, "rest": ALL_FREE - 2 * AREA}
NESTED = "*ELSET, ELSET=a\nb\n*ELSET, ELSET=b\nbone\n*SURFACE, NAME=s\na\n"
OF_ELEMENTS = "*NSET, NSET=n, ELSET=bone\n*SURFACE, TYPE=NODE, NAME=n2\nn, 1.0\n"
FIRST = "*SURFACE, NAME=free\nall\n*ELSET, ELSET=all\nbone, cement\n" + SECTIONS
# An end of each kind of spelling: text, areas of boundaries.
SPELLINGS = {
    "plain": (deck(), {}),
    "empty fields": (BLANK, {}),
    "later sets": (deck(more=TOP_FIRST + TOP_BY_SETS + SECTIONS), {"top": AREA}),
    "sets of sets": (deck(more=NESTED + SECTIONS), {"s": FREE}),
    "sets before all": (FIRST + deck(), {"free": ALL_FREE}),
    "Fortran": (deck().replace("3.0", "3.0D+00").replace("5.0", "0.5d1"), {}),
    "combined": (
        deck(more=surface("a", BOTTOM) + surface("b", TOP) + COMBINED),
        COMBINED_AREAS,
    ),
    "combined before": (
        deck(more=COMBINED + surface("a", BOTTOM) + surface("b", TOP)),
        COMBINED_AREAS,
    ),
    "continued": (deck().replace("C3D4, ELSET=bone", "C3D4,\n  ELSET=bone"), {}),
    "two lines": (deck().replace("ELSET=bone\n1, ", "ELSET=bone\n1,\n"), {}),
    "tabs": (deck().replace("*ELEMENT,", "*ELEMENT\t,\t").replace(", ", ",\t"), {}),
    "mark": ("\ufeff" + deck(), {}),
    "quotes": (deck('"bone"', '"cement"'), {}),
    "normals": (re.sub(r"(?m)(\.0)$", r"\1, 0., 0., 1.", deck()), {}),
    "lower case": (deck().lower().replace("\n", "\r\n"), {}),
    "comments": (deck().replace("*ELEMENT", "** of the mesh\n\n*Element"), {}),
    "SPOS": (deck(more=f"{SKIN}SPOS\n"), {"skin": AREA, "s": AREA}),
    "SNEG": (deck(more=f"{SKIN}SNEG\n"), {"skin": AREA, "s": AREA}),
    "SPOS of quotes": (
        deck(more=f"{SKIN}SPOS\n".replace("skin", '"skin of it"')),
        {"skin_of_it": AREA, "s": AREA},
    ),
    "nodes of elements": (deck(more=OF_ELEMENTS), {"n": FREE, "n2": FREE}),
}


@pytest.mark.parametrize("name", SPELLINGS)
def test_inp_spellings(name: str, tmp_path: Path) -> None:
    text, areas = SPELLINGS[name]
    data = build(tmp_path / "a.inp", text)
    assert whole(data) == pytest.approx(areas)
    assert ("coordinates of nodes are empty" in messages_of(data)) == (name == "empty fields")


def test_inp_blanks_in_quotes_count(tmp_path: Path) -> None:
    more = '*SURFACE, NAME="its skin"\n"upper one"\n'
    data = build(tmp_path / "a.inp", deck('"upper one"', "cement", more))
    assert whole(data, "upper_one") == pytest.approx({"its_skin": FREE})


def test_mesh_files_suffixes_have_no_case(tmp_path: Path) -> None:
    whole(build(tmp_path / "JOB.INP", deck()))
    data = bonded(tmp_path / "JOB.INP")
    meshes.write_msh(data, tmp_path / "a.msh")
    whole(build(tmp_path / "A.MSH", (tmp_path / "a.msh").read_bytes()))


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1"])
def test_inp_encodings(encoding: str, tmp_path: Path) -> None:
    whole(build(tmp_path / "a.inp", deck("Knochen_ä").encode(encoding)), "Knochen__")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            deck().replace("TYPE=C3D4, ELSET=bone", "ELSET=bone"),
            "*ELEMENT in line 14: has no option TYPE=; its options: ELSET",
        ),
        (deck().replace("=bone", "="), "*ELEMENT in line 14: has no option ELSET="),
        (
            deck().replace("ELSET=bone", "ELSE=bone"),
            "line 14: has no option ELSE; did you mean ELSET",
        ),
        (deck(more="*ELSET, NAME=x\n1\n"), "line 28: has no option ELSET"),
        (deck(more="*SURFACE, NAME=x\nbone, S7\n"), "line 29: S7 is not a face of a tetrahedron"),
        (
            deck(more="*SURFACE, NAME=x\nbone, SPOS\n"),
            "line 29: SPOS is not a face of a tetrahedron",
        ),
        (deck(more="*ELSET, ELSET=x\ny\n*ELSET, ELSET=y\nx\n"), "contains itself"),
        (deck(more="*ELSET, ELSET=x\nbonn\n"), "the file has no set bonn"),
        (
            deck(more="*ELSET, ELSET=x, GENERATE\n4, 1\n*SOLID SECTION, ELSET=x\n1.0\n"),
            "line 29: the range ends below its first number 4",
        ),
        (deck().replace("*NODE", "*NODE, INPUT=b.txt"), "takes numbers from another file"),
        (deck().replace("*NODE", "*NODE, SYSTEM=P"), "SYSTEM=P is not read; expected R, C or S"),
        (f"*SYSTEM\n0, 0, 0, 1, x\n{deck()}", "*SYSTEM in line 1: line 2: 'x' is not a number"),
        (
            f"*SYSTEM\n0, 0, 0, 1, 0, 0\n2, 0, 0\n{deck()}",
            "line 1: its points are on a straight line",
        ),
        (f"*SYSTEM\n0, 0, 0, 0, 0, 1\n{deck()}", "line 1: its points are on a straight line"),
        (f"*SYSTEM\n0, 0, 0, 1, 0, 0, 0, 1, 0\n{deck()}", "line 2: 9 numbers; expected at most 6"),
        (f"*SYSTEM\n0, 0, 0\n0, 1, 0\n1, 0, 0\n{deck()}", "line 1: has more than two lines"),
        (re.sub(r"(?<=\d)\.(?=\d)", ",", deck()), "line 2: 7 numbers for a node and three"),
        (deck().replace("3.0", "3.x"), "line 3: '3.x' is not a number"),
        (deck(more="*SOLID SECTION, ELSET=bon\n1.0\n"), "the file has no set bon"),
    ],
)
def test_inp_faults_name_the_line(text: str, words: str, tmp_path: Path) -> None:
    assert words in refused(tmp_path / "a.inp", text)


def test_regions_of_cells_without_a_region_are_counted(tmp_path: Path) -> None:
    more = "*SOLID SECTION, ELSET=bone\n1.0\n"
    data = build(tmp_path / "a.inp", deck(more=more))
    assert "6 of 12 cells of the file belong to no region" in messages_of(data)
    text = nodes() + elements(0, 6, "bone") + elements(6, 9, "cement") + elements(9, 12)
    data = build(tmp_path / "b.inp", text)
    assert "3 of 12 cells of the file belong to no region" in messages_of(data)


# ---------------------------------------------------------------------------------------- .vtu


@pytest.mark.parametrize("pieces", [1, 3])
@pytest.mark.parametrize("packer", PACKERS)
@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("header", ["UInt32", "UInt64"])
@pytest.mark.parametrize("way", ["raw", "appended", "binary"])
def test_vtu_encodings_are_read(
    way: str, header: str, order: str, packer: str, pieces: int, tmp_path: Path
) -> None:
    data = build(tmp_path / "a.vtu", vtu(cut(pieces), way, header, order, packer))
    whole(data, *MATERIALS)
    assert len(data.cells) == len(CELLS)
    assert ("has 3 pieces, which are read as one mesh" in messages_of(data)) == (pieces == 3)


def test_vtu_in_text_and_in_two_pieces(tmp_path: Path) -> None:
    data = build(tmp_path / "a.vtu", vtu(cut(2)))
    whole(data, *MATERIALS)
    assert "has 2 pieces" in messages_of(data)


def test_vtu_ghost_and_doubled_cells_are_counted_once(tmp_path: Path) -> None:
    data = build(tmp_path / "twice.vtu", vtu(one_piece() * 2))
    whole(data, *MATERIALS)
    assert "12 cells stand twice" in messages_of(data)
    owned = one_piece(material=TAGS, vtkGhostType=np.zeros(12, "u1"))
    ghosts = [(POINTS, CELLS[:5], {"material": TAGS[:5], "vtkGhostType": np.ones(5, "u1")})]
    data = build(tmp_path / "ghost.vtu", vtu(owned + ghosts))
    whole(data, *MATERIALS)
    assert "5 ghost cells" in messages_of(data)


@pytest.mark.parametrize("below", ["", "box/"])
@pytest.mark.parametrize("parts", [1, 2, 3])
def test_pvtu_pieces_of_all_files_are_joined(parts: int, below: str, tmp_path: Path) -> None:
    path = pvtu(tmp_path, parts, below)
    data = bonded(path)
    whole(data, *MATERIALS)
    assert len(data.cells) == len(CELLS)
    assert (f"{parts} pieces, which are read as one mesh" in messages_of(data)) == (parts > 1)
    if parts > 1:
        doubled = sum(len(piece[0]) for piece in cut(parts)) - len(POINTS)
        assert f"{doubled} nodes are merged" in messages_of(data)


def test_pvtu_pieces_that_are_missing_are_named(tmp_path: Path) -> None:
    path = pvtu(tmp_path, 3)
    for k in (0, 2):
        (tmp_path / f"box_{k}.vtu").unlink()
    assert "2 of its 3 pieces are not there: box_0.vtu, box_2.vtu" in refused(path)


def test_pvtu_pieces_that_are_damaged_or_elsewhere_are_named(tmp_path: Path) -> None:
    path = pvtu(tmp_path, 2)
    text = path.read_text()
    piece = tmp_path / "box_1.vtu"
    raw = piece.read_bytes()
    piece.write_bytes(raw[:400])
    assert "its piece box_1.vtu: " in refused(path)
    piece.write_bytes(vtu([(*cut(2)[1][:2], {"other": cut(2)[1][2]["material"]})]))
    assert "its pieces have different arrays of cells" in refused(path)
    piece.write_bytes(raw)
    path.write_text(text.replace("box_1", "../box_1"))
    assert "its pieces ../box_1.vtu are not in its folder or below" in refused(path)
    path.write_text(text.replace("PUnstructured", "PPoly"))
    assert "is PPolyGrid; expected PUnstructuredGrid" in refused(path)


def later(path: Path, raw: bytes) -> None:
    """Write a file as one that is modified after all others."""
    path.write_bytes(raw)
    stamp = path.stat().st_mtime + 10
    os.utime(path, (stamp, stamp))


def test_named_files_are_part_of_the_content(tmp_path: Path) -> None:
    """A change of a piece is another mesh, for a process that has read the former one, too."""
    path = pvtu(tmp_path, 2)
    before, first = content(path), MeshFile(path=path)
    assert first.region_names == MATERIALS
    points, cells, arrays = cut(2)[1]
    changed = {"material": np.where(arrays["material"] == 8, 4, 3)}
    later(tmp_path / "box_1.vtu", vtu([(points, cells, changed)]))
    assert content(path) != before
    assert {*MeshFile(path=path).region_names} == {*MATERIALS, "material_4"}
    assert MeshFile(path=path).modified > path.stat().st_mtime + 5


@pytest.mark.parametrize(
    ("data", "name"),
    [
        ({"material": TAGS.astype(np.float32)}, "material"),
        ({"constant": np.full(12, 10), "x": TAGS}, "x"),
        ({"flag": np.arange(12) % 2, "region": TAGS}, "region"),
        *(
            ({before: values, name: TAGS.astype(kind)}, name)
            for kind in ("f8", "f4", "i8")
            for before, values, name in (
                ("GlobalCellIds", np.arange(12), "material"),
                ("ElementType", np.full(12, 10), "label"),
                ("temperature", np.arange(12) / 7, "material"),
            )
        ),
    ],
)
def test_regions_are_named_by_an_array(data: dict, name: str, tmp_path: Path) -> None:
    blocks = {k: [v] for k, v in data.items()}
    (tmp_path / "a.vtu").write_bytes(vtu(one_piece(**data)))
    meshio.Mesh(POINTS, [("tetra", CELLS)], cell_data=blocks).write(tmp_path / "a.xdmf")
    for suffix in ("vtu", "xdmf"):
        mesh = bonded(tmp_path / f"a.{suffix}")
        whole(mesh, f"{name}_3", f"{name}_8")
        assert f"values of the array {name}" in messages_of(mesh)
        others = ", ".join(k for k in data if k != name)
        assert f"arrays of cells that are not read: {others}" in messages_of(mesh) or not others


ODD = (np.arange(12) % 2).astype("i4")


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"a": TAGS, "b": ODD}, "a, b give different regions; set `geometry.array`"),
        ({"GlobalCellIds": np.arange(12)}, r"no array of its cells (GlobalCellIds) has"),
        ({"strain": np.linspace(0, 1, 12)}, r"no array of its cells (strain) has"),
    ],
)
def test_regions_by_disagreeing_arrays_are_refused(
    arrays: dict, words: str, tmp_path: Path
) -> None:
    assert words in refused(tmp_path / "a.vtu", vtu(one_piece(**arrays)))


@pytest.mark.parametrize("suffix", ["vtu", "xdmf"])
def test_regions_array_can_be_given(suffix: str, tmp_path: Path) -> None:
    """It may be one of several, or have a name that is not that of regions."""
    path = tmp_path / f"a.{suffix}"
    arrays = {"material": ODD, "global_part": TAGS, "strain": np.linspace(0, 1, 12)}
    path.write_bytes(vtu(one_piece(**arrays)))
    if suffix == "xdmf":
        parts = [attribute(values, name) for name, values in arrays.items()]
        path.write_text(xdmf(grid(geometry(), topology(), *parts)))
    data = bonded(path, array="global_part")
    whole(data, "global_part_3", "global_part_8")
    assert "arrays of cells that are not read: material, strain" in messages_of(data)
    assert "has no array part of its cells; its arrays: material, global_part" in refused(
        path, array="part"
    )
    assert "its array strain does not number regions" in refused(path, array="strain")


def test_regions_parts_can_be_given(tmp_path: Path) -> None:
    path = tmp_path / "a.inp"
    path.write_text(deck())
    assert "`array` applies only to .vtu, .pvtu, .xdmf, .xmf" in refused(path, array="x")
    assert "`meshes` applies only to .med" in refused(path, meshes=["x"])


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


@pytest.mark.parametrize("name", GRIDS)
def test_xdmf_grids_are_one_mesh(name: str, tmp_path: Path) -> None:
    text, sets, note = GRIDS[name]
    data = build(tmp_path / "a.xdmf", text)
    areas = whole(data, *MATERIALS)
    assert len(data.cells) == len(CELLS)
    assert "belong to no region" not in messages_of(data) and note in messages_of(data)
    assert (f"its grids have {sets} sets of nodes" in messages_of(data)) == (sets > 1)
    assert areas == pytest.approx({"material_5": AREA} if name == "mixed" else {})


def test_xdmf_cells_of_a_grid_without_an_array_are_counted(tmp_path: Path) -> None:
    bone = grid(geometry(), topology(CELLS[:6]), attribute(np.full(6, 4)))
    rest = grid(NODES_OF_MESH.replace("[@Name='mesh']", ""), topology(CELLS[6:]))
    data = build(tmp_path / "a.xmf", xdmf(bone, rest))
    assert region_volumes(data) == pytest.approx({"material_4": VOLUMES["bone"]})
    assert "6 of 12 cells of the file belong to no region" in messages_of(data)


def test_xdmf_arrays_of_several_grids_on_the_same_cells(tmp_path: Path) -> None:
    """An array called material goes before others; of equals one has to be given."""
    path = tmp_path / "a.xdmf"

    def tagged(first: str, second: str) -> str:
        tags = [
            grid(NODES_OF_MESH, topology(), attribute(values, name))
            for name, values in ((first, ODD), (second, TAGS))
        ]
        return xdmf(MESH, *tags)

    whole(build(path, tagged("a", "material")), *MATERIALS)
    text = tagged("a", "b")
    assert "its arrays a, b give different regions" in refused(path, text)
    data = build(path, text, array="b")
    whole(data, "b_3", "b_8")
    assert "arrays of cells that are not read: a" in messages_of(data)


def test_xdmf_arrays_of_triangles_are_all_boundaries(tmp_path: Path) -> None:
    triangles = topology(BOTTOM_SIDES, "Triangle")
    walls = grid(
        NODES_OF_MESH,
        triangles,
        attribute(np.array([1, 1]), "wall"),
        attribute(np.array([1, 2]), "half"),
        attribute(np.array([0.1, 0.2]), "pressure"),
    )
    tags = grid(NODES_OF_MESH, topology(), attribute(TAGS))
    data = build(tmp_path / "a.xdmf", xdmf(MESH, tags, walls))
    expected = {"wall_1": AREA, "half_1": AREA / 2, "half_2": AREA / 2}
    assert whole(data, *MATERIALS) == pytest.approx(expected)
    assert "boundaries are the values of the array wall" in messages_of(data)
    assert "arrays of cells that are not read: pressure" in messages_of(data)


@pytest.mark.parametrize("form", ["HDF", "Binary", "Binary big"])
def test_xdmf_arrays_in_other_files(form: str, tmp_path: Path) -> None:
    """They are read from any folder, and are part of the content."""
    arrays = {"x y": POINTS, "cells": CELLS.astype("i8"), "tags": TAGS.astype("i8")}
    order = ">" if "big" in form else "<"
    endian = ' Endian="Big"' if "big" in form else ' Endian="Little"'
    with h5py.File(tmp_path / "me & my data.h5", "w") as file:
        for name, values in arrays.items():
            file[f"mesh/{name}"] = values
            raw = values.astype(values.dtype.newbyteorder(order)).tobytes()
            (tmp_path / f"{name}.bin").write_bytes(b"skip" + raw)
    text = xdmf(grid(geometry(), topology(), attribute(TAGS)))
    for name, item in zip(arrays, re.findall(r"<DataItem.*?<", text), strict=True):
        place = f"me &amp; my data.h5:/mesh/{name}" if form == "HDF" else f"{name}.bin"
        head = item[: item.index(">")].replace("XML", form.split()[0])
        head += "" if form == "HDF" else f'{endian} Seek="4"'
        text = text.replace(item, f"{head}> {place} <")
    path = tmp_path / "a.xdmf"
    whole(build(path, text), *MATERIALS)
    files = {*named.names(path)}
    other = {"me & my data.h5"} if form == "HDF" else {f"{name}.bin" for name in arrays}
    assert files == {"a.xdmf", *other}
    outside = text.replace("> ", "> ../", 1)
    assert "is not in its folder or below" in refused(tmp_path / "b.xdmf", outside)
    (tmp_path / min(other)).unlink()
    assert f"its file {min(other)} is missing" in refused(path)


CUBE = np.arange(8)[None]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (xdmf(grid(topology(), attribute(TAGS), name="x")), "its grid x has no Geometry"),
        (xdmf(grid(geometry(), name="x")), "its grid x has no Topology"),
        (
            xdmf(grid(geometry().replace("XYZ", "XY"), topology(), attribute(TAGS))),
            "its nodes are of type XY; expected XYZ",
        ),
        (
            xdmf(grid(geometry(), topology(CUBE, "Hexahedron"))),
            "the cells are of type Hexahedron; only straight tetrahedra",
        ),
        (
            xdmf(grid(geometry(), topology(np.insert(CUBE, 0, 9), "Mixed"))),
            "the cells are of type hexahedron; only straight tetrahedra",
        ),
        (
            xdmf(grid(geometry(), topology(np.insert(CUBE, 0, 99), "Mixed"))),
            "has a cell of type 99",
        ),
        (xdmf(grid(geometry(), topology(MIXED[:-2], "Mixed"))), "mixed cells are cut short"),
        (xdmf(grid(geometry(), topology(np.array([2, -2, 0]), "Mixed"))), "a cell of type 0"),
        (
            xdmf(grid(geometry(), topology(CELLS + 1), attribute(TAGS), name="x")),
            "its grid x: a cell has a node that is not in the file",
        ),
        (
            xdmf(grid(geometry(), topology(), attribute(TAGS[:5]))),
            "its array material does not have one value for each of 12 cells",
        ),
        (
            xdmf(grid(include("xpointer(/Xdmf/Domain/Grid/Nodes)"), topology())),
            "refers to /Xdmf/Domain/Grid/Nodes, which is not in the file",
        ),
        (
            xdmf(grid('<xi:include href="b.xmf"/>', geometry(), topology())),
            "includes parts of other files; save it as one file",
        ),
        (
            xdmf(grid(geometry(), topology(), attribute(TAGS))).replace(
                "<DataItem", '<DataItem ItemType="HyperSlab"'
            ),
            "an array is a HyperSlab, which is not read",
        ),
        (
            xdmf(grid(geometry(), topology(), attribute(TAGS))).replace('"12 3"', '"13 3"'),
            "an array has 36 values for 13 x 3",
        ),
    ],
)
def test_xdmf_useless_file_is_refused_with_reason(text: str, words: str, tmp_path: Path) -> None:
    assert words in refused(tmp_path / "a.xdmf", text)


def test_xdmf_grids_that_overlap_are_refused(tmp_path: Path) -> None:
    """The second grid has cells on the faces of those of the first, at new nodes."""
    (a, b, c, d), n = CELLS[0], len(POINTS)
    apart = np.vstack([POINTS, POINTS[d] + 0.1, POINTS[d] + 0.2])
    cells, tags = np.vstack([CELLS, [[a, b, c, n], [a, b, c, n + 1]]]), np.append(TAGS, [1, 1])
    text = xdmf(grid(geometry(apart), topology(cells), attribute(tags)))
    with pytest.raises(GeometryError, match="a face belongs to more than two cells"):
        build(tmp_path / "a.xdmf", text)


def test_xdmf_with_numbers_in_the_file_is_hashed_in_linear_time(tmp_path: Path) -> None:
    numbers = " ".join(map(repr, np.random.default_rng(3).random(100_000).tolist()))
    path = tmp_path / "a.xdmf"
    path.write_text(
        f'<Xdmf><DataItem Format="XML">{numbers}</DataItem><D> my data.h5:/x</D></Xdmf>'
    )
    start = time.process_time()
    before = content(path)
    assert time.process_time() - start < 1.0
    (tmp_path / "my data.h5").write_bytes(b"1")
    assert content(path) != before
    assert named.names(path) == ["a.xdmf", "my data.h5"]


# ---------------------------------------------------------------------------------------- .med


def med(path: Path, **meshes_of: tuple[np.ndarray, np.ndarray, list[list[str]]]) -> Path:
    """A file of several meshes: nodes, cells, and groups of the first and second half of these."""
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


def test_med_mesh_of_tetrahedra_is_chosen(tmp_path: Path) -> None:
    skin = (POINTS, BOTTOM_SIDES, [["s"], ["t"]])
    data = bonded(med(tmp_path / "a.med", Hull=skin, Solid=(POINTS, MED_CELLS, TWO)))
    whole(data)
    assert "meshes that are not read: Hull" in messages_of(data)


def test_med_families_may_be_left_out(tmp_path: Path) -> None:
    """Nodes and triangles without a group need none."""
    data = meshio.Mesh(POINTS, [("tetra", MED_CELLS), ("triangle", BOTTOM_SIDES)])
    data.cell_data = {"cell_tags": [-TAGS, np.zeros(2, dtype=int)]}
    data.cell_tags, data.point_tags = {-3: ["bone"], -8: ["cement"]}, {1: ["foot"]}
    data.point_data["point_tags"] = np.zeros(len(POINTS), dtype=int)
    path = tmp_path / "a.med"
    data.write(path)
    with h5py.File(path, "r+") as file:
        (step,) = file["ENS_MAA/mesh"].values()
        del step["MAI/TR3/FAM"], step["NOE/FAM"]
    assert whole(bonded(path)) == {}


def test_med_meshes_are_picked(tmp_path: Path) -> None:
    """One of two alternatives, or the parts of a model in separate meshes."""
    fine = (POINTS * 2, MED_CELLS, TWO)
    path = med(tmp_path / "a.med", Coarse=(POINTS, MED_CELLS, TWO), Fine=fine)
    message = refused(path)
    assert "has the meshes Coarse (12 tetrahedra), Fine (12 tetrahedra)" in message
    assert "set `geometry.meshes` to those of the model" in message
    data = bonded(path, meshes=["Coarse"])
    whole(data)
    assert "meshes that are not read: Fine" in messages_of(data)
    assert region_volumes(bonded(path, meshes=["Fine"]))["bone"] == pytest.approx(
        8 * VOLUMES["bone"]
    )
    assert "has no mesh Mesh_1; it has the meshes Coarse (12" in refused(path, meshes=["Mesh_1"])


def test_med_meshes_of_parts_are_joined(tmp_path: Path) -> None:
    parts = {}
    for name, rows in (("Bone", slice(0, 6)), ("Cement", slice(6, 12))):
        used, cells = np.unique(MED_CELLS[rows], return_inverse=True)
        parts[name] = (POINTS[used], cells.reshape(-1, 4), [["all"], ["all"]])
    path = med(tmp_path / "a.med", **parts)
    data = bonded(path, meshes=["Bone", "Cement"])
    whole(data, "Bone_all", "Cement_all")
    assert "4 nodes are merged" in messages_of(data)
    assert "several meshes have the mesh before their name: all" in messages_of(data)


# -------------------------------------------------------------------------------------- others


def of_febio(*parts: str) -> str:
    """A file of FEBio with two cells, `cup`, and further parts."""
    rows = "".join(
        f'<node id="{k}">{x}</node>'
        for k, x in enumerate(("0,0,0", "3,0,0", "0,3,0", "0,0,3", "3,3,3"), 1)
    )
    cells = "".join(
        f'<Elements type="tet4" name="cup"><elem id="{k}">{c}</elem></Elements>'
        for k, c in enumerate(("1,2,3,4", "2,3,4,5"), 1)
    )
    return f"<febio_spec><Mesh><Nodes>{rows}</Nodes>{cells}{''.join(parts)}</Mesh></febio_spec>"


def test_feb_blocks_of_one_name_are_one_region(tmp_path: Path) -> None:
    volumes = region_volumes(build(tmp_path / "a.feb", of_febio()))
    assert volumes["cup"] == pytest.approx(4.5 + 9.0)


@pytest.mark.parametrize(("kind", "nodes"), [("tri3", "1,2,3"), ("tri6", "1,2,3,1,2,3")])
def test_feb_shells_are_boundaries(kind: str, nodes: str, tmp_path: Path) -> None:
    shells = f'<Elements type="{kind}" name="skin"><elem id="9">{nodes}</elem></Elements>'
    data = build(tmp_path / "a.feb", of_febio(shells))
    assert region_volumes(data) == pytest.approx({"cup": 4.5 + 9.0})
    assert boundary_areas(data) == pytest.approx({"skin": 4.5})


@pytest.mark.parametrize(("nodes", "hidden"), [("1,2,3", False), ("1,2,4", True), ("4,5", False)])
def test_mesh_files_surface_and_set_of_nodes_of_one_name(
    nodes: str, hidden: bool, tmp_path: Path
) -> None:
    """The surface is taken; a set of nodes that contains other facets is not lost silently."""
    surface = '<Surface name="end"><tri3 id="1">1,2,3</tri3></Surface>'
    text = of_febio(surface, f'<NodeSet name="end">{nodes}</NodeSet>')
    data = build(tmp_path / "a.feb", text)
    assert boundary_areas(data) == pytest.approx({"end": 4.5})
    note = "geometry: sets of nodes that are not read, since surfaces have their names: end"
    assert (note in data.notes["messages"]) == hidden


@pytest.mark.parametrize("height", [BOTTOM, TOP])
def test_inp_surface_and_shells_of_one_name(height: float, tmp_path: Path) -> None:
    facets = [CELLS[e - 1][list(FACES[side - 1])] + 1 for e, side in on(height)]
    shells = [", ".join(map(str, [900 + k, *facet])) for k, facet in enumerate(facets)]
    rows = "\n".join(["*ELEMENT, TYPE=S3, ELSET=load", *shells, ""])
    data = build(tmp_path / "a.inp", deck(more=surface("load", TOP) + rows))
    assert whole(data)["load"] == pytest.approx(AREA)
    note = "geometry: sets of shells that are not read, since surfaces have their names: load"
    assert (note in data.notes["messages"]) == (height != TOP)


def test_mesh_files_names_that_become_equal_are_refused(tmp_path: Path) -> None:
    data = meshio.Mesh(POINTS, [("tetra", CELLS)], cell_data={"cell_tags": [-TAGS]})
    data.cell_tags = {-3: ["a b"], -8: ["a.b"]}
    data.write(tmp_path / "a.med")
    (tmp_path / "a.feb").write_text(feb("a b", "a.b"))
    arrays = {"a b-a.b": (TAGS > 5).astype(np.int64)}
    (tmp_path / "a.vtu").write_bytes(vtu(one_piece(**arrays)))
    for suffix in ("med", "feb", "vtu"):
        with pytest.raises(ValueError, match=r"its sets a.b and a.b are both called a_b in a case"):
            MeshFile(path=tmp_path / f"a.{suffix}")


HEATED = """
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
HELD = """
geometry: {kind: file, path: a.msh}
mesh: {size: 1 mm, order: 1}
regions:
  lower: &E {youngs_modulus: 1 GPa, poisson_ratio: 0.3, tissue: other}
  upper: *E
supports: {floor: {kind: fixed, boundary: bottom}, lid: {kind: fixed, boundary: top}}
"""


@pytest.mark.parametrize("text", [HEATED, HELD], ids=["heated", "held"])
@pytest.mark.parametrize(("lift", "noted"), [(0.0, True), (0.02, False), (0.05, False)])
def test_mesh_files_coincident_bodies_without_common_nodes_have_a_note(
    lift: float, noted: bool, text: str, tmp_path: Path
) -> None:
    with session("boxes") as gmsh:
        lower = gmsh.model.occ.addBox(0, 0, 0, 2, 2, 2)
        upper = gmsh.model.occ.addBox(0.33, 0.41, 2 + lift, 1.13, 1.07, 1.5)
        gmsh.model.occ.synchronize()
        for name, tag in (("lower", lower), ("upper", upper)):
            gmsh.model.addPhysicalGroup(3, [tag], name=name)
        for name, z in (("bottom", 0.0), ("top", 3.5 + lift)):
            surfaces = gmsh.model.getEntitiesInBoundingBox(-1, -1, z - 0.01, 3, 3, z + 0.01, 2)
            gmsh.model.addPhysicalGroup(2, [tag for _, tag in surfaces], name=name)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.6)
        gmsh.model.mesh.generate(3)
        gmsh.write(str(tmp_path / "a.msh"))
    data = meshes.build(MeshFile(path=tmp_path / "a.msh"), MeshOptions(size="1 mm"))
    (tmp_path / "case.yaml").write_text(text)
    case = load(tmp_path / "case.yaml").config
    texts = [v.text for v in check_on_mesh(case, mesh_parts(case, data))]
    notes = [text for text in texts if "touch over" in text]
    assert len(notes) == noted
    if noted:
        assert "share no node" in notes[0] and "neither force nor heat" in notes[0]
        assert "regions 'upper' and 'lower'" in notes[0] or "'lower' and 'upper'" in notes[0]
        (pair,) = touching_without_shared_nodes(data)
        area, place = touching_without_shared_nodes(data)[pair]
        assert {*pair} == {"lower", "upper"}
        assert area == pytest.approx(1.13 * 1.07, rel=0.05)
        assert place[2] == pytest.approx(2.0)


def damaged(raw: bytes, dice: random.Random) -> bytes:
    """A file cut, with some bytes changed or left out, or with lines lost or moved."""
    way, at = dice.randrange(5), dice.randrange(len(raw))
    lines = raw.split(b"\n")
    if way == 0:
        return raw[:at]
    if way == 1:
        changed = bytearray(raw)
        for _ in range(dice.choice((1, 5, 50))):
            changed[dice.randrange(len(raw))] = dice.randrange(256)
        return bytes(changed)
    if way == 2:
        return raw[:at] + raw[at + dice.randrange(1, 40) :]
    if way == 3:
        del lines[dice.randrange(len(lines))]
    else:
        dice.shuffle(lines)
    return b"\n".join(lines)


def test_mesh_files_damaged_are_read_or_refused(tmp_path: Path) -> None:
    """Three hundred damaged files are read, or refused in words."""
    dice = random.Random(7)
    mesh = meshio.Mesh(POINTS, [("tetra", CELLS)], cell_data={"a": [TAGS]})
    mesh.write(tmp_path / "x.xdmf", data_format="XML")
    med(tmp_path / "x.med", Solid=(POINTS, MED_CELLS, TWO), Hull=(POINTS, BOTTOM_SIDES, TWO))
    meshes.write_msh(build(tmp_path / "y.inp", deck()), tmp_path / "x.msh")
    pvtu(tmp_path, 2)
    more = surface("top", TOP) + "*NSET, NSET=n, GENERATE\n1, 4\n"
    zlib, lzma = "vtkZLibDataCompressor", "vtkLZMADataCompressor"
    originals = [
        (".inp", deck(more=more).encode()),
        (".inp", (system(ORIGIN) + deck()).encode()),
        (".vtu", vtu(cut(2))),
        (".vtu", vtu(cut(2), "appended", "UInt64", packer=zlib)),
        (".vtu", vtu(cut(1), "raw", packer=lzma)),
        (".pvtu", (tmp_path / "box.pvtu").read_bytes()),
        (".feb", feb().encode()),
        (".xdmf", (tmp_path / "x.xdmf").read_bytes()),
        (".xdmf", GRIDS["mixed"][0].encode()),
        (".xdmf", GRIDS["steps"][0].replace("<Grid", "\n<Grid").encode()),
        (".med", (tmp_path / "x.med").read_bytes()),
        (".msh", (tmp_path / "x.msh").read_bytes()),
    ]
    for suffix, raw in originals:
        (tmp_path / f"whole{suffix}").write_bytes(raw)
        assert len(bonded(tmp_path / f"whole{suffix}").cells) == len(CELLS), suffix
    refusals = 0
    for k in range(300):
        suffix, raw = originals[k % len(originals)]
        path = tmp_path / f"d{k}{suffix}"
        path.write_bytes(damaged(raw, dice))
        try:
            bonded(path)
        except (ValueError, MantleError) as error:
            assert len(str(error)) > 10
            refusals += 1
    assert refusals > 150


def test_vtu_lz4_blocks_with_copies() -> None:
    """Three letters, six more from three before (they overlap), and a last letter."""
    assert lz4_decompress(b"\x32abc\x03\x00\x10x") == b"abcabcabcx"
