"""Meshes from files: names, interfaces, formats of gmsh."""

from __future__ import annotations

import math
import re
from pathlib import Path

import meshio
import numpy as np
import pytest

import meshes
from app.case.geometries import MeshFile
from app.foundation.errors import GeometryError
from meshes.data import (
    boundary_areas,
    connected_components,
    exterior_facets,
    mesh_data_of,
    region_volumes,
)
from meshes.gmsh_session import MILLIMETRES, session
from tests.meshes.simple import ROD, STACK, mesh, options


def test_imported_names_may_overlap_but_patches_may_not() -> None:
    points = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)], dtype=float)
    cells = np.array([(0, 1, 2, 3), (1, 2, 3, 4)])
    facets, _ = exterior_facets(cells)
    low = points[facets].mean(axis=1)[:, 2] < 0.3
    data = mesh_data_of(
        points,
        cells,
        np.array([1, 1], dtype=np.int32),
        {"a": 1},
        {},
        {"all": np.ones(6, bool), "low": low, "none": np.zeros(6, bool)},
        facets,
    )
    assert set(data.boundaries["low"]) < set(data.boundaries["all"])
    assert data.boundaries["none"] == ()
    assert len(data.facet_tags) == 6
    assert connected_components(data.neighbours, data.cell_tags).tolist() == [0, 0]
    assert connected_components(data.neighbours, np.array([1, 2], dtype=np.int32)).tolist() == [
        0,
        1,
    ]


@pytest.mark.parametrize("unit", ["mm", "cm"])
@pytest.mark.parametrize("curved", [False, True])
def test_imported_files_equal_written_ones(tmp_path: Path, unit: str, curved: bool) -> None:
    data = mesh(ROD, 3.0, curved=curved)
    path = tmp_path / "rod.msh"
    meshes.write_msh(data, path)
    sides = {name: tuple(map(tuple, sides)) for name, sides in data.interfaces.items()}
    back = meshes.build(MeshFile(path=path, unit=unit, interfaces=sides), options(1.0))
    scale = MILLIMETRES[unit]
    assert len(back.cells) == len(data.cells)
    for name, volume in region_volumes(data).items():
        assert region_volumes(back)[name] == pytest.approx(scale**3 * volume)
    for name, area in boundary_areas(data).items():
        assert boundary_areas(back)[name] == pytest.approx(scale**2 * area), name
    assert back.notes["cells_without_region"] == 0


def test_imported_files_of_format_2_2(tmp_path: Path) -> None:
    data, path = mesh(STACK, 3.0), tmp_path / "old.msh"
    meshes.write_msh(data, tmp_path / "new.msh")
    with session("old") as gmsh:
        gmsh.open(str(tmp_path / "new.msh"))
        gmsh.option.setNumber("Mesh.MshFileVersion", 2.2)
        gmsh.write(str(path))
    back = meshes.build(MeshFile(path=path, interfaces=STACK.interface_sides), options(1.0))
    assert region_volumes(back) == pytest.approx(region_volumes(data))
    # Interfaces are written with their names, too.
    assert back.notes["interior_surfaces"] == sorted(STACK.interface_sides)
    assert not set(back.boundaries) & set(STACK.interface_sides)


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("tags", ["the same", "none", "distinct"])
def test_imported_files_of_format_2_2_have_groups_of_elements(
    binary: bool, tags: str, tmp_path: Path
) -> None:
    """Other programs give elements of several groups the same entity, or none."""
    data = mesh(STACK, 3.0)
    tetrahedra = data.cells[:, :4]
    rows = {name: np.isin(data.facet_tags, data.boundaries[name]) for name in ("bottom", "top")}
    facets = {name: data.facets[there, :3] for name, there in rows.items()}
    groups = [data.cell_tags, *(np.full(len(f), k) for k, f in enumerate(facets.values(), 11))]
    entities = {"the same": [np.full(len(g), 7) for g in groups], "distinct": groups}
    file = meshio.Mesh(
        data.points,
        [("tetra", tetrahedra), *(("triangle", block) for block in facets.values())],
        cell_data={"gmsh:physical": groups},
        field_data={name: np.array([tag, 3]) for name, tag in data.regions.items()}
        | {name: np.array([k, 2]) for k, name in enumerate(facets, 11)},
    )
    if tags != "none":
        file.cell_data["gmsh:geometrical"] = entities[tags]
    path = tmp_path / "a.msh"
    meshio.write(path, file, file_format="gmsh22", binary=binary)
    back = meshes.build(MeshFile(path=path, interfaces=STACK.interface_sides), options(1.0))
    assert region_volumes(back) == pytest.approx(region_volumes(data))
    areas = boundary_areas(data)
    assert boundary_areas(back) == pytest.approx({name: areas[name] for name in facets})
    assert back.notes["cells_without_region"] == 0


def test_imported_files_with_names_in_another_encoding_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.msh"
    meshes.write_msh(mesh(STACK, 3.0), path)
    path.write_bytes(path.read_bytes().replace(b'"low"', '"l\xf6w"'.encode("latin-1")))
    with pytest.raises(ValueError, match="a name in it is not text in UTF-8"):
        MeshFile(path=path, interfaces={})


def test_imported_files_without_names_are_refused(tmp_path: Path) -> None:
    data = mesh(STACK, 3.0)
    path = tmp_path / "a.msh"
    meshes.write_msh(data, path)
    text = path.read_bytes()
    start, end = text.index(b"$PhysicalNames"), text.index(b"$EndPhysicalNames\n")
    path.write_bytes(text[:start] + text[end + len(b"$EndPhysicalNames\n") :])
    with pytest.raises(GeometryError, match=r"physical volumes: \(unnamed\)"):
        meshes.build(MeshFile.model_construct(path=path, interfaces={}), options(1.0))
    path.write_text("$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\nnonsense\n")
    with pytest.raises(GeometryError):
        meshes.build(MeshFile.model_construct(path=path, interfaces={}), options(1.0))


def test_imported_bodies_that_meet_without_interface_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.msh"
    meshes.write_msh(mesh(STACK, 3.0), path)
    some = {"low_mid": STACK.interface_sides["low_mid"]}
    with pytest.raises(GeometryError) as caught:
        meshes.build(MeshFile(path=path, interfaces=some), options(1.0))
    match = re.search(r"on ([\d.]+) mm2 about \((.+), (.+), (.+)\) mm", str(caught.value))
    assert match and "high meets mid where no interface is declared" in str(caught.value)
    assert "low" not in str(caught.value)
    area, *place = map(float, match.groups())
    assert area == pytest.approx(80.0 / math.cos(STACK.tilt), rel=5e-3)
    # On the plane between them, less than a cell from its middle.
    x, y, z = place
    assert z == pytest.approx(9.0 - (x - 5.0) * math.tan(STACK.tilt), abs=0.1)
    assert math.hypot(x - 5.0, y - 4.0) < 3.0
    with pytest.raises(GeometryError, match=r"high meets mid .*; low meets mid "):
        meshes.build(MeshFile(path=path), options(1.0))


def test_imported_regions_on_one_side_are_one_body(tmp_path: Path) -> None:
    path = tmp_path / "a.msh"
    meshes.write_msh(mesh(STACK, 3.0), path)
    sides = {"joint": (("low",), ("mid", "high"))}
    back = meshes.build(MeshFile(path=path, interfaces=sides), options(1.0))
    assert set(back.regions) == {"low", "mid", "high"}
