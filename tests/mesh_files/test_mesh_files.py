"""Meshes of other programs: equal meshes from all formats, and refused files."""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path
from xml.sax.saxutils import escape

from mpi4py import MPI

import meshio
import numpy as np
import pytest
from dolfinx import fem, io, mesh

import meshes
from app.case.case import load_case
from app.case.geometries import Cylinders, MeshFile, MeshOptions
from app.foundation.errors import InputError, MantleError
from app.soundness.well_posedness import check_on_mesh, mesh_parts
from meshes.data import MeshData, boundary_areas, region_volumes
from meshes.distribute import distribute
from meshes.gmsh_session import session
from meshes.pieces import touching_without_shared_nodes
from meshes.shape_functions import GMSH_TETRAHEDRON
from tests.mesh_files.spellings import (
    BOTTOM_SIDES,
    CELLS,
    GRIDS,
    MED_CELLS,
    ORIGIN,
    POINTS,
    TAGS,
    TOP,
    TWO,
    bonded,
    build,
    cut,
    deck,
    feb,
    med,
    one_piece,
    pvtu,
    surface,
    system,
    vtu,
    whole,
)

ROD = Cylinders(
    stem_radius="7 mm",
    cement_thickness="4 mm",
    bone_thickness="6 mm",
    length="12 mm",
    sector="quarter",
)
SIDES = {name: tuple(map(tuple, sides)) for name, sides in ROD.interface_sides.items()}
# The edges whose middles are nodes 5 to 10 in the manuals of Abaqus, FEBio, VTK, XDMF and MED.
LATER = [{0, 1}, {1, 2}, {0, 2}, {0, 3}, {1, 3}, {2, 3}]
# Corners of the faces S1 to S4 in the manual of Abaqus.
FACES = [(0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)]


def numbering(*corners: int) -> list[int]:
    """The order of a program in terms of gmsh's order, from that of the corners."""
    edges = [{corners[k] for k in edge} for edge in LATER]
    return [*corners, *(4 + [set(e) for e in GMSH_TETRAHEDRON].index(edge) for edge in edges)]


@pytest.fixture(scope="module", params=[False, True], ids=["straight", "curved"])
def rod(request: pytest.FixtureRequest) -> MeshData:
    return meshes.build(ROD, MeshOptions(size="4 mm", curved=request.param))


def parts(data: MeshData, order: list[int]) -> tuple[dict, dict]:
    """Cells of each region in a program's order, and facets of each boundary."""
    nodes = order[: data.cells.shape[1]]
    cells = {n: data.cells[data.cell_tags == tag][:, nodes] for n, tag in data.regions.items()}
    return cells, {
        n: data.facets[np.isin(data.facet_tags, tags)] for n, tags in data.boundaries.items()
    }


def rows(block: np.ndarray, first: int = 1) -> str:
    numbered = np.column_stack([np.arange(len(block)) + first, block + 1])
    return "\n".join(", ".join(map(str, row)) for row in numbered.tolist())


def inp(data: MeshData) -> str:
    """A deck with sections, a set of everything, listed cells, and surfaces by faces."""
    cells, facets = parts(data, numbering(0, 1, 2, 3))
    nodes = "\n".join(
        f"{k}, {x!r}, {y!r}, {z!r}" for k, (x, y, z) in enumerate(data.points.tolist(), 1)
    )
    text, first, side = f"*Heading\n** of a test\n*Node, nset=Nall\n{nodes}\n", 1, {}
    for name, block in cells.items():
        text += f"*ELEMENT, TYPE=C3D{block.shape[1]}, ELSET={name}\n{rows(block, first)}\n"
        text += f"*Solid Section, elset={name.upper()}, material=M\n"
        for k, cell in enumerate(block.tolist(), first):
            side |= {frozenset(cell[v] for v in f): (k, s) for s, f in enumerate(FACES, 1)}
        first += len(block)
    text += f"*ELSET, ELSET=Eall, GENERATE\n1, {first - 1}, 1\n"
    for name, block in facets.items():
        text += f"*SURFACE, NAME={name}\n"
        text += "".join("{}, S{}\n".format(*side[frozenset(f[:3])]) for f in block.tolist())
    return text + "*MATERIAL, NAME=M\n*ELASTIC\n1000., 0.3\n"


def febio(data: MeshData) -> str:
    cells, facets = parts(data, numbering(0, 1, 2, 3))

    def items(tag: str, block: np.ndarray) -> str:
        lines = (",".join(map(repr, row)) for row in block.tolist())
        return "".join(f'<{tag} id="{k}">{line}</{tag}>' for k, line in enumerate(lines, 1))

    text = f'<Nodes name="all">{items("node", data.points)}</Nodes>'
    for name, block in cells.items():
        text += f'<Elements type="tet{block.shape[1]}" name="{escape(name)}">'
        text += f"{items('elem', block + 1)}</Elements>"
    for name, block in facets.items():
        text += f'<Surface name="{name}">{items(f"tri{block.shape[1]}", block + 1)}</Surface>'
    text += '<NodeSet name="some">1,2:8:2</NodeSet><ElementSet name="e">1</ElementSet>'
    return f'<febio_spec version="4.0"><Mesh>{text}</Mesh></febio_spec>'


def by_meshio(data: MeshData, path: Path) -> None:
    """Write sets as values of an array, or as groups of MED."""
    med = path.suffix == ".med"
    cells, facets = parts(data, numbering(*([0, 2, 1, 3] if med else [0, 1, 2, 3])))
    blocks, names = [*cells.values(), *facets.values()], [*cells, *facets]
    kinds = {3: "triangle", 4: "tetra", 6: "triangle6", 10: "tetra10"}
    merged = {w: [k for k, b in enumerate(blocks) if b.shape[1] == w] for w in kinds}
    merged = {w: k for w, k in merged.items() if k}
    made = [(kinds[w], np.concatenate([blocks[k] for k in ks])) for w, ks in merged.items()]
    values = [np.repeat(ks, [len(blocks[k]) for k in ks]) for ks in merged.values()]
    out = meshio.Mesh(data.points, made, cell_data={"-".join(names): values})
    if med:
        out.cell_data = {"cell_tags": [-1 - v for v in values]}
        out.cell_tags = {-1 - k: [name] for k, name in enumerate(names)}
    out.write(path)


def edges(data: MeshData) -> set[tuple[int, int, int]]:
    """Ends and middle of each edge."""
    ends = np.sort(data.cells[:, np.array(GMSH_TETRAHEDRON)], axis=2).reshape(-1, 2)
    middles = data.cells[:, 4:].reshape(-1, 1) if data.curved else ends[:, :1]
    return {*map(tuple, np.hstack([ends, middles]).tolist())}


@pytest.mark.parametrize("suffix", ["inp", "feb", "med", "vtu", "xdmf"])
def test_mesh_files_of_each_format_has_the_same_mesh(
    suffix: str, rod: MeshData, tmp_path: Path
) -> None:
    """Volumes, areas, names and places of all nodes agree, in the unit of the file."""
    path, small = tmp_path / f"rod.{suffix}", replace(rod, points=rod.points / 10)
    if suffix in ("inp", "feb"):
        path.write_text({"inp": inp, "feb": febio}[suffix](small))
    else:
        by_meshio(small, path)
    geometry = MeshFile(path=path, unit="cm", interfaces=SIDES)
    back = meshes.build(geometry, MeshOptions(size="1 mm"))
    assert region_volumes(back) == pytest.approx(region_volumes(rod))
    areas = boundary_areas(back)
    assert {n: areas[n] for n in rod.boundaries} == pytest.approx(boundary_areas(rod))
    np.testing.assert_allclose(back.points, rod.points, atol=1e-12)
    assert edges(back) == edges(rod)
    assert set(geometry.boundary_names) == {
        *rod.boundaries,
        *{"inp": ["Nall"], "feb": ["some"]}.get(suffix, []),
    }
    assert geometry.estimate_cells(MeshOptions(size="1 mm")) == len(rod.cells)
    all_messages = " ".join(back.notes["messages"])
    for words in {"inp": ["Eall", "*MATERIAL, *ELASTIC"], "feb": ["ElementSet e", "some"]}.get(
        suffix, []
    ):
        assert words in all_messages


def test_mesh_files_deck_of_gmsh(rod: MeshData, tmp_path: Path) -> None:
    """Gmsh writes surfaces as plane elements, and sets of nodes on request."""
    meshes.write_msh(rod, tmp_path / "rod.msh")
    with session("rod") as gmsh:
        gmsh.merge(str(tmp_path / "rod.msh"))
        gmsh.option.setNumber("Mesh.SaveGroupsOfNodes", -100)
        gmsh.write(str(tmp_path / "rod.inp"))
    back = meshes.build(
        MeshFile(path=tmp_path / "rod.inp", interfaces=SIDES), MeshOptions(size="1 mm")
    )
    assert region_volumes(back) == pytest.approx(region_volumes(rod))
    areas = boundary_areas(back)
    assert {n: areas[n] for n in rod.boundaries} == pytest.approx(boundary_areas(rod))
    assert edges(back) == edges(rod)


SLIDES = """
geometry: {kind: file, path: rod.inp, interfaces: {inner: [stem, cement], outer: [cement, bone]}}
mesh: {size: 1 mm}
regions: {stem: &E {youngs_modulus: 2 GPa, poisson_ratio: 0.3, tissue: other}, cement: *E, bone: *E}
interfaces:
  inner: {kind: contact, friction_coefficient: 0.3, sliding: finite, between: [stem, cement]}
supports: {low: {kind: fixed, boundary: bone}}
"""


def test_mesh_files_coincident_nodes_are_merged_unless_finite_sliding(
    rod: MeshData, tmp_path: Path
) -> None:
    """A deck with contact doubles the nodes of its interfaces.

    Sets may have a start, an end and a step.
    """
    tags = rod.cell_tags.astype(np.int64)[:, None]
    used, cells = np.unique(rod.cells + len(rod.points) * tags, return_inverse=True)
    points = rod.points[used % len(rod.points)]
    apart = replace(rod, points=points, cells=cells.reshape(rod.cells.shape), boundaries={})
    low = ",\n".join(map(str, np.flatnonzero(points[:, 2] == 0.0) + 1))
    top = np.flatnonzero(points[:, 2] == 12.0) + 1
    text = f"{inp(apart)}*NSET, NSET=Low\n{low}\n*NSET, NSET=Top, GENERATE\n"
    text += "".join(f"{k}, {k}\n" for k in top)
    for name, tag in rod.regions.items():
        nodes = np.unique(apart.cells[apart.cell_tags == tag])
        text += f"*NSET, NSET={name}\n" + "".join(f"{k + 1},\n" for k in nodes)
    path = tmp_path / "rod.inp"
    path.write_text(text)
    back = meshes.build(MeshFile(path=path, interfaces=SIDES), MeshOptions(size="1 mm"))
    assert len(back.points) == len(rod.points) < len(points)
    areas, whole = boundary_areas(back), boundary_areas(rod)
    assert areas["Low"] == pytest.approx(whole["bottom"])
    assert areas["Top"] == pytest.approx(whole["top"])
    assert f"{len(points) - len(rod.points)} nodes are merged" in " ".join(back.notes["messages"])
    (tmp_path / "case.yaml").write_text(SLIDES)
    case = load_case(tmp_path / "case.yaml").config
    back = meshes.build(case.geometry, case.mesh)
    one, two = (rod.cells[rod.cell_tags == rod.regions[name]] for name in ("stem", "cement"))
    assert len(back.points) == len(rod.points) + len(np.intersect1d(one, two))


def test_mesh_files_tags_of_dolfinx(rod: MeshData, tmp_path: Path) -> None:
    """XDMF of dolfinx has cells, tags of cells and tags of facets in separate grids."""
    tagged, path = distribute(rod, MPI.COMM_SELF), tmp_path / "rod.xdmf"
    tagged.cell_tags.name, tagged.facet_tags.name = "Cell tags", "wall"
    with io.XDMFFile(MPI.COMM_SELF, path, "w") as file:
        file.write_mesh(tagged.mesh)
        for tags in (tagged.cell_tags, tagged.facet_tags):
            file.write_meshtags(tags, tagged.mesh.geometry)
    names = {name: f"Cell_tags_{tag}" for name, tag in rod.regions.items()}
    sides = {i: tuple((names[s[0]],) for s in both) for i, both in SIDES.items()}
    back = meshes.build(MeshFile(path=path, interfaces=sides), MeshOptions(size="1 mm"))
    volumes, areas = region_volumes(back), boundary_areas(back)
    assert {n: volumes[names[n]] for n in names} == pytest.approx(region_volumes(rod))
    for name, tags in rod.boundaries.items():
        assert sum(areas[f"wall_{t}"] for t in tags) == pytest.approx(boundary_areas(rod)[name])
    assert edges(back) == edges(rod)


def test_mesh_files_with_two_meshes_of_dolfinx(tmp_path: Path) -> None:
    """The file has two meshes with separate nodes.

    One has a function over time, the other has tags.
    """
    path = tmp_path / "two.xdmf"
    lower, upper = (
        mesh.create_box(MPI.COMM_SELF, [[0, 0, z], [2, 3, z + 1 + z]], [1, 1, 1]) for z in (0, 1)
    )
    lower.name, upper.name = "lower", "upper"
    part = fem.Function(fem.functionspace(lower, ("DG", 0)), name="material")
    part.x.array[:] = 4
    count = upper.topology.index_map(3).size_local
    tags = mesh.meshtags(upper, 3, np.arange(count), np.full(count, 7, dtype=np.int32))
    tags.name = "material"
    with io.XDMFFile(MPI.COMM_SELF, path, "w") as file:
        file.write_mesh(lower)
        for time in (0.0, 1.0):
            file.write_function(part, time)
        file.write_mesh(upper)
        file.write_meshtags(tags, upper.geometry, "/Xdmf/Domain/Grid[@Name='upper']/Geometry")
    geometry = MeshFile(path=path, interfaces={"i": (("material_4",), ("material_7",))})
    back = meshes.build(geometry, MeshOptions(size="1 mm"))
    assert region_volumes(back) == pytest.approx({"material_4": 6.0, "material_7": 12.0})
    assert len(back.points) == 12
    text = " ".join(back.notes["messages"])
    assert "2 sets of nodes" in text and "of the 2 time steps of the grid material" in text


ONE = "*NODE\n1,0,0,0\n2,1,0,0\n3,0,1,0\n4,0,0,1\n*ELEMENT, TYPE=C3D4, ELSET=a\n1,1,2,3,4\n"
FEB = (
    '<febio_spec version="4.0"><Mesh><Nodes><node id="1">0,0,0</node></Nodes>'
    '<Elements type="hex8" name="cube"><elem id="1">1</elem></Elements></Mesh></febio_spec>'
)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.inp", "", "is not an .inp file of Abaqus or CalculiX"),
        ("a.inp", "# AVS UCD\n8 6 0 0 0\n", "is not an .inp file of Abaqus or CalculiX"),
        ("a.inp", ONE[:31], "*NODE in line 1: line 5: expected a node number and coordinates"),
        ("a.inp", ONE[:-4], "*ELEMENT in line 6: line 7: 3 numbers instead of 5"),
        ("a.inp", ONE.replace("0,1,0", "0,x,0"), "*NODE in line 1: line 4: 'x' is not a number"),
        ("a.inp", ONE.replace("0,1,0", "0,1,5,0"), "*NODE in line 1: line 4: 5 numbers for a node"),
        ("a.inp", ONE.replace("0,1,0", "0,nan,0"), "node 3 has a coordinate that is not a number"),
        ("a.inp", ONE.replace("2,3,4", "2,3,5"), "node 5 is used, but the file does not define it"),
        ("a.inp", ONE + ONE, "node 1 is defined twice; export the model flat"),
        (
            "a.inp",
            ONE.replace("C3D4", "C3D8R"),
            "*ELEMENT in line 6: the cells are of type C3D8R; only",
        ),
        ("a.inp", ONE.replace(", ELSET=a", ""), "names no region"),
        (
            "a.inp",
            ONE + "*INCLUDE, INPUT=b.inp\n",
            "*INCLUDE in line 8: makes, moves or includes nodes",
        ),
        ("a.inp", ONE + "*SURFACE, NAME=s\nb, S1\n", "*SURFACE in line 8: the file has no set b"),
        (
            "a.inp",
            ONE + "2,1,2,4,3\n3,2,1,3,4\n*ELSET, ELSET=p\n1,2\n*ELSET, ELSET=q\n2,3\n",
            "its set p shares some of its cells with smaller sets",
        ),
        ("a.feb", FEB, "cube: is of type hex8; only straight tetrahedra"),
        ("a.feb", FEB[:90], "is not a .feb file, or it is damaged: export it again"),
        ("a.feb", "<mesh/>", "names no region"),
        ("a.vtu", "<VTKFile", "is not a .vtu file, or it is damaged: export it again"),
        ("a.xdmf", "<Xdmf><Domain/></Xdmf>", "names no region"),
        ("a.med", "HDF", "is not a .med file, or it is damaged: export it again"),
    ],
)
def test_mesh_files_damaged_or_useless_is_refused(
    name: str, content: str, words: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_text(content)
    case = tmp_path / "case.yaml"
    case.write_text(
        f"geometry:\n  kind: file\n  path: {name}\nmesh: {{size: 1 mm}}\nregions: {{}}\n"
    )
    with pytest.raises(InputError) as caught:
        load_case(case)
    (message,) = (m for m in caught.value.messages if "geometry.path" in m)
    assert message.startswith(f"{case}:3:3: geometry.path: '{name}': {words}"), message


def test_mesh_files_with_truncated_arrays_is_refused(rod: MeshData, tmp_path: Path) -> None:
    for suffix in ("vtu", "xdmf", "med"):
        path = tmp_path / f"rod.{suffix}"
        by_meshio(rod, path)
        broken = path.with_suffix(".h5") if suffix == "xdmf" else path
        broken.write_bytes(broken.read_bytes()[: broken.stat().st_size // 2])
        with pytest.raises(ValueError, match=f"is not a .{suffix} file|cut short"):
            MeshFile(path=path)


def test_mesh_files_suffixes_have_no_case(tmp_path: Path) -> None:
    whole(build(tmp_path / "JOB.INP", deck()))
    data = bonded(tmp_path / "JOB.INP")
    meshes.write_msh(data, tmp_path / "a.msh")
    whole(build(tmp_path / "A.MSH", (tmp_path / "a.msh").read_bytes()))


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


def test_mesh_files_feb_blocks_of_one_name_are_one_region(tmp_path: Path) -> None:
    volumes = region_volumes(build(tmp_path / "a.feb", of_febio()))
    assert volumes["cup"] == pytest.approx(4.5 + 9.0)


@pytest.mark.parametrize(("kind", "nodes"), [("tri3", "1,2,3"), ("tri6", "1,2,3,1,2,3")])
def test_mesh_files_feb_shells_are_boundaries(kind: str, nodes: str, tmp_path: Path) -> None:
    shells = f'<Elements type="{kind}" name="skin"><elem id="9">{nodes}</elem></Elements>'
    data = build(tmp_path / "a.feb", of_febio(shells))
    assert region_volumes(data) == pytest.approx({"cup": 4.5 + 9.0})
    assert boundary_areas(data) == pytest.approx({"skin": 4.5})


@pytest.mark.parametrize(("nodes", "hidden"), [("1,2,3", False), ("1,2,4", True), ("4,5", False)])
def test_mesh_files_surface_and_set_of_nodes_of_one_name(
    nodes: str, hidden: bool, tmp_path: Path
) -> None:
    """The surface is used. A set of nodes that contains other facets causes an error."""
    surface = '<Surface name="end"><tri3 id="1">1,2,3</tri3></Surface>'
    text = of_febio(surface, f'<NodeSet name="end">{nodes}</NodeSet>')
    data = build(tmp_path / "a.feb", text)
    assert boundary_areas(data) == pytest.approx({"end": 4.5})
    note = "geometry: sets of nodes that are not read, since surfaces have their names: end"
    assert (note in data.notes["messages"]) == hidden


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
    case = load_case(tmp_path / "case.yaml").config
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
    """A file that is cut, or has bytes changed or left out, or lines lost or moved."""
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
    """Three hundred damaged files are read, or refused with a reason."""
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
