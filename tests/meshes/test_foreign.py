"""Meshes of other programs: what is read of them, and what is refused in words."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from xml.sax.saxutils import escape

from mpi4py import MPI

import meshio
import numpy as np
import pytest
from dolfinx import fem, io, mesh

import meshes
from app.case.case import load
from app.case.geometries import Cylinders, MeshFile, MeshOptions
from app.foundation.errors import InputError
from meshes.data import EDGES, MeshData, boundary_areas, region_volumes
from meshes.distribute import distribute
from meshes.gmsh_session import session

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
    """The order of a program by gmsh's, from that of the corners."""
    edges = [{corners[k] for k in edge} for edge in LATER]
    return [*corners, *(4 + [set(e) for e in EDGES].index(edge) for edge in edges)]


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
    """A deck with sections, a set of everything, surfaces by faces, of cells that are listed."""
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


def feb(data: MeshData) -> str:
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
    """Sets as values of an array, or as groups of MED."""
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
    ends = np.sort(data.cells[:, np.array(EDGES)], axis=2).reshape(-1, 2)
    middles = data.cells[:, 4:].reshape(-1, 1) if data.curved else ends[:, :1]
    return {*map(tuple, np.hstack([ends, middles]).tolist())}


@pytest.mark.parametrize("suffix", ["inp", "feb", "med", "vtu", "xdmf"])
def test_mesh_file_of_each_format_has_the_same_mesh(
    suffix: str, rod: MeshData, tmp_path: Path
) -> None:
    """Volumes, areas, names and the places of all nodes, in the unit of the file."""
    path, small = tmp_path / f"rod.{suffix}", replace(rod, points=rod.points / 10)
    if suffix in ("inp", "feb"):
        path.write_text({"inp": inp, "feb": feb}[suffix](small))
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


def test_mesh_file_deck_of_gmsh(rod: MeshData, tmp_path: Path) -> None:
    """It writes surfaces as plane elements, and sets of nodes on demand."""
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


def test_mesh_file_coincident_nodes_are_merged_unless_finite_sliding(
    rod: MeshData, tmp_path: Path
) -> None:
    """A deck with contact doubles the nodes of its interfaces; sets may go from, to, by steps."""
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
    case = load(tmp_path / "case.yaml").config
    back = meshes.build(case.geometry, case.mesh)
    one, two = (rod.cells[rod.cell_tags == rod.regions[name]] for name in ("stem", "cement"))
    assert len(back.points) == len(rod.points) + len(np.intersect1d(one, two))


def test_mesh_file_tags_of_dolfinx(rod: MeshData, tmp_path: Path) -> None:
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


def test_mesh_file_with_two_meshes_of_dolfinx(tmp_path: Path) -> None:
    """Two meshes with separate nodes, a function over time on one and tags on the other."""
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
def test_mesh_file_damaged_or_useless_is_refused(
    name: str, content: str, words: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_text(content)
    case = tmp_path / "case.yaml"
    case.write_text(
        f"geometry:\n  kind: file\n  path: {name}\nmesh: {{size: 1 mm}}\nregions: {{}}\n"
    )
    with pytest.raises(InputError) as caught:
        load(case)
    (message,) = (m for m in caught.value.messages if "geometry.path" in m)
    assert message.startswith(f"{case}:3:3: geometry.path: '{name}': {words}"), message


def test_mesh_file_with_truncated_arrays_is_refused(rod: MeshData, tmp_path: Path) -> None:
    for suffix in ("vtu", "xdmf", "med"):
        path = tmp_path / f"rod.{suffix}"
        by_meshio(rod, path)
        broken = path.with_suffix(".h5") if suffix == "xdmf" else path
        broken.write_bytes(broken.read_bytes()[: broken.stat().st_size // 2])
        with pytest.raises(ValueError, match=f"is not a .{suffix} file|cut short"):
            MeshFile(path=path)
