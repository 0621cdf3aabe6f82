"""Defects of mesh files: refused, or repaired with a note."""

from __future__ import annotations

import pickle
import re
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import meshes
from app.case.geometries import Block, Blocks, MeshFile, MeshOptions
from app.foundation.errors import GeometryError
from app.soundness import well_posedness
from meshes.data import MeshData, cell_volumes, region_volumes
from meshes.gmsh_session import session
from tests import support

CUBE = Blocks(blocks=(Block(name="cube", size=["10 mm", "10 mm", "10 mm"]),))
CASE = """
geometry: {{kind: file, path: {path}}}
mesh: {{size: 5 mm, order: 1}}
regions: {{cube: {{youngs_modulus: 1 GPa, poisson_ratio: 0.3, tissue: other}}}}
supports: {{floor: {{kind: fixed, boundary: bottom}}}}
loads: {{press: {{kind: pressure, boundary: top, pressure: 1 MPa}}}}
"""


def cube(curved: bool = False) -> MeshData:
    return meshes.build(CUBE, MeshOptions(size="5 mm", curved=curved))


def read(tmp_path: Path, data: MeshData) -> MeshData:
    """The mesh written to a file and read."""
    path = tmp_path / "a.msh"
    meshes.write_msh(data, path)
    return meshes.build(MeshFile(path=path), MeshOptions(size="1 mm"))


def inner(data: MeshData) -> int:
    """The node that is farthest from the surface of the cube."""
    return int(np.argmax(np.minimum(data.points, 10.0 - data.points).min(axis=1)))


@pytest.mark.parametrize("corner", range(8))
def test_imported_defects_with_inverted_cells_is_refused(corner: int, tmp_path: Path) -> None:
    """The node is moved almost to each corner of the cube.

    Cells invert, and their volumes exceed that of the cube.
    """
    data = cube()
    node, x = inner(data), data.points.copy()
    assert 0.0 < x[node].min() < x[node].max() < 10.0
    x[node] = [9.7 if corner >> k & 1 else 0.3 for k in range(3)]
    tangled = replace(data, points=x)
    volumes = cell_volumes(tangled.points, tangled.cells)
    over = np.flatnonzero(volumes < 0)
    assert len(over) and np.abs(volumes).sum() > 1000.1
    with pytest.raises(GeometryError, match=r"of .* cells overlap their neighbours") as caught:
        read(tmp_path, tangled)
    places = re.findall(r"cube at \((.+), (.+), (.+)\) mm", str(caught.value))
    # Cells that are named turned over or share a face with one that did.
    assert 1 <= len(places) <= 5
    faces = {tuple(sorted(f)) for c in tangled.cells[over] for f in _faces(c)}
    beside = [c for c in tangled.cells if faces & {tuple(sorted(f)) for f in _faces(c)}]
    centres = x[np.array(beside)].mean(axis=1)
    for place in places:
        assert np.abs(centres - np.array(place, dtype=float)).max(axis=1).min() < 0.006


def _faces(cell: np.ndarray) -> list[list[int]]:
    return [[int(v) for k, v in enumerate(cell) if k != out] for out in range(4)]


@pytest.mark.parametrize("version", [2.2, 4.1])
@pytest.mark.parametrize("word", ["nan", "1e999", "x"])
def test_imported_defects_with_nan_coordinate_is_refused(
    version: float, word: str, tmp_path: Path
) -> None:
    data, path = cube(), tmp_path / "a.msh"
    meshes.write_msh(data, path)
    with session("a") as gmsh:
        gmsh.merge(str(path))
        gmsh.option.setNumber("Mesh.Binary", 0)
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.write(str(path))
    lines = path.read_text().splitlines()
    k = next(k for k, line in enumerate(lines) if re.search(r"(^|^\d+ )10 10 10$", line))
    lines[k] = lines[k].replace("10 10 10", f"10 {word} 10")
    path.write_text("\n".join(lines))
    text = r"node \d+ has a coordinate that is not a number"
    if word == "x":
        text = r"is damaged or cut short; export it again \(gmsh: "
    with pytest.raises(GeometryError, match=text):
        meshes.build(MeshFile(path=path), MeshOptions(size="1 mm"))


def test_imported_defects_binary_with_nan_coordinate_is_refused(tmp_path: Path) -> None:
    data = cube()
    data.points[0, 0] = np.nan
    with pytest.raises(GeometryError, match="node 1 has a coordinate that is not a number"):
        read(tmp_path, data)


@pytest.mark.parametrize("curved", [False, True])
@pytest.mark.parametrize("share", [1.0, 0.3])
def test_imported_defects_cells_listed_inside_out_are_reoriented_with_note(
    curved: bool, share: float, tmp_path: Path
) -> None:
    """The order of nodes in a cell depends on the program; places of nodes do not."""
    data = cube(curved)
    mirror = [1, 0, 2, 3, 4, 6, 5, 9, 8, 7] if curved else [1, 0, 2, 3]
    turned = np.arange(len(data.cells)) < round(share * len(data.cells))
    cells = np.where(turned[:, None], data.cells[:, mirror], data.cells)
    back = read(tmp_path, replace(data, cells=cells))
    assert region_volumes(back) == pytest.approx({"cube": 1000.0})
    case = support.case(CASE.format(path=tmp_path / "a.msh"))
    (note,) = well_posedness.check_on_mesh(case, well_posedness.mesh_parts(case, back))
    words = f"{turned.sum()} of {len(cells)} cells of the file list their nodes inside out"
    assert words in note.text
    assert read(tmp_path, data).notes["messages"] == []


def test_imported_defects_with_unshared_middle_nodes_is_refused(tmp_path: Path) -> None:
    data = cube(curved=True)
    cells, x = data.cells.copy(), data.points
    # An edge inside: one of its cells gets a separate middle node, away from that of the others.
    edge = next(n for n in cells[:, 4] if (x[n] > 1e-6).all() and (x[n] < 10 - 1e-6).all())
    cells[np.argmax(cells[:, 4] == edge), 4] = len(x)
    points = np.vstack([x, x[edge] + [0.2, 0.0, 0.0]])
    with pytest.raises(GeometryError, match="cells overlap their neighbours"):
        read(tmp_path, replace(data, cells=cells, points=points))


def test_imported_defects_volume_without_cells_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "a.msh"
    meshes.write_msh(cube(), path)
    head, names, rest = path.read_bytes().partition(b"$PhysicalNames\n")
    count, _, rest = rest.partition(b"\n")
    path.write_bytes(head + names + b'%d\n3 99 "void"\n' % (int(count) + 1) + rest)
    case = support.case(CASE.format(path=path), "regions.void={rigid: true, tissue: other}")
    assert sorted(case.geometry.region_names) == ["cube", "void"]
    with pytest.raises(GeometryError, match="the volumes void have no cells"):
        meshes.build(case.geometry, case.mesh)


def tetrahedron(path: Path, last: int) -> MeshData:
    """A file of one cell with a given number of its last node."""
    path.write_text(
        f"""$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
1
3 1 "cube"
$EndPhysicalNames
$Nodes
4
1 0 0 0
2 1 0 0
3 0 1 0
{last} 0 0 1
$EndNodes
$Elements
1
1 4 2 1 1 1 2 3 {last}
$EndElements
"""
    )
    return meshes.build(MeshFile(path=path), MeshOptions(size="1 mm"))


def test_imported_defects_node_numbers_may_be_large(tmp_path: Path) -> None:
    """No array has the length of the largest number, here 16 GB."""
    tracemalloc.start()
    try:
        data = tetrahedron(tmp_path / "far.msh", 2_000_000_000)
        assert tracemalloc.get_traced_memory()[1] < 1e8
    finally:
        tracemalloc.stop()
    assert len(data.points) == 4 and cell_volumes(data.points, data.cells) == pytest.approx(1 / 6)


def test_imported_defects_child_process_returns_no_pickle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A script inside a mesh file is not executed."""
    monkeypatch.setattr(pickle, "loads", lambda _: pytest.fail("a pickle was read"))
    assert len(read(tmp_path, cube()).points) == len(cube().points)
