"""Meshes of blocks, cylinders and files: names, sizes, quality, cache, order, pictures."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from scipy.spatial import ConvexHull

import meshes
from app.campaigns.work_precision import fitted_order
from app.case.geometries import Block, Blocks, Cylinders, MeshFile, MeshOptions
from app.foundation.errors import GeometryError
from app.plots.sections import cut
from meshes import cache, cylinders, quality
from meshes.data import (
    MeshData,
    assemble,
    boundary_areas,
    cell_volumes,
    components,
    exterior_facets,
    facet_areas,
    interface_facets,
    region_volumes,
)
from meshes.gmsh_session import MILLIMETRES, session
from meshes.pieces import pieces_of_mesh
from tests import support
from tests.robustness.faulty import DAMAGES, damage
from tests.support import digest

STACK = Blocks(
    blocks=(
        Block(name="low", size=["10 mm", "8 mm", "5 mm"]),
        Block(name="mid", size=["10 mm", "8 mm", "4 mm"]),
        Block(name="high", size=["10 mm", "8 mm", "3 mm"]),
    ),
    tilt="5 deg",
)
ROD = Cylinders(
    stem_radius="7 mm",
    cement_thickness="4 mm",
    bone_thickness="6 mm",
    length="20 mm",
    taper="1 deg",
)


def options(size: float, **more: Any) -> MeshOptions:
    return MeshOptions(size=f"{size} mm", **more)


def mesh(geometry: Any, size: float, **more: Any) -> MeshData:
    return meshes.build(geometry, options(size, **more))


@pytest.fixture(scope="module")
def rod() -> MeshData:
    return mesh(ROD, 2.0)


def test_meshes_import_without_gmsh_and_dolfinx() -> None:
    heavy = {"gmsh", "dolfinx", "mpi4py"}
    support.python("-c", f"import sys; import meshes; assert not {heavy} & set(sys.modules)")


@pytest.mark.parametrize("curved", [False, True])
def test_blocks_have_exact_volumes_areas_and_names(curved: bool) -> None:
    data = mesh(STACK, 2.0, curved=curved)
    assert data.cells.shape[1] == (10 if curved else 4)
    assert region_volumes(data) == pytest.approx({"low": 400.0, "mid": 320.0, "high": 240.0})
    areas = boundary_areas(data)
    assert set(areas) == set(STACK.boundary_names)
    assert areas["x_min"] == pytest.approx(96.0)
    assert areas["bottom"] == pytest.approx(80.0)
    assert areas["low_x_min"] == pytest.approx(8.0 * (5.0 - 5.0 * math.tan(STACK.tilt)))
    assert areas["mid_y_max"] == pytest.approx(40.0)
    for name in STACK.interface_sides:
        facets, inner, outer = interface_facets(data, name)
        area = facet_areas(data.points, facets).sum()
        assert area == pytest.approx(80.0 / math.cos(STACK.tilt)), name
        normal = np.cross(*(data.points[facets[:, k]] - data.points[facets[:, 0]] for k in (1, 2)))
        assert np.all(normal[:, 2] > 0)  # from the first side to the second
        assert set(data.cell_tags[inner]) == {data.regions[name.split("_")[0]]}
        assert set(data.cell_tags[outer]) == {data.regions[name.split("_")[1]]}


def test_blocks_of_one_have_no_interface_and_a_uniform_mesh() -> None:
    data = mesh(Blocks(blocks=(Block(name="only", size=["4 mm"] * 3),)), 1.0)
    assert dict(data.interfaces) == {}
    assert np.cbrt(8.5 * cell_volumes(data.points, data.cells)).max() < 2.0


@pytest.mark.parametrize(("sector", "part"), [("full", 1.0), ("half", 0.5), ("quarter", 0.25)])
def test_cylinders_are_concentric_conforming_and_named(sector: str, part: float) -> None:
    geometry = ROD.model_copy(update={"sector": sector})
    data = mesh(geometry, 1.5)
    assert data.notes["quality"]["sicn_min"] >= 0.25
    areas = boundary_areas(data)
    assert set(areas) == set(geometry.boundary_names)
    assert areas["top"] == pytest.approx(sum(areas[f"{r}_top"] for r in data.regions))
    assert areas["bone_surface"] == pytest.approx(part * 2 * math.pi * 17 * 20, rel=0.02)
    for plane in ("symmetry_x", "symmetry_y"):
        if plane in areas:
            sides = 2 if sector == "half" else 1  # the plane y = 0 on either side of the axis
            assert areas[plane] == pytest.approx(sides * 17 * 20)
    rise = 10 * math.tan(ROD.taper)
    for name, tag in (("stem_bottom", 7.0 - rise), ("stem_top", 7.0 + rise)):
        assert areas[name] == pytest.approx(part * math.pi * tag**2, rel=0.02)


@pytest.mark.parametrize("curved", [False, True])
def test_cylinders_volume_converges(curved: bool) -> None:
    """Straight facets lose volume as h^2, quadratic ones as h^4."""
    sizes = [4.0, 2.0]
    straight = ROD.model_copy(update={"taper": 0.0, "length": 8.0})
    exact = math.pi * 49.0 * 8.0
    errors = [
        region_volumes(mesh(straight, h, far_size=f"{h} mm", curved=curved))["stem"] / exact - 1
        for h in sizes
    ]
    assert fitted_order(sizes, errors) > (3.0 if curved else 1.6)


@pytest.mark.parametrize("curved", [False, True])
def test_cylinders_normals_point_outwards(curved: bool) -> None:
    data = mesh(ROD, 3.0, curved=curved)
    normals = pieces_of_mesh(data, with_normals=["bone_surface"]).normals["bone_surface"]
    on = np.unique(data.facets[np.isin(data.facet_tags, data.boundaries["bone_surface"])])
    radial = data.points[on] * [1, 1, 0]
    radial /= np.linalg.norm(radial, axis=1)[:, None]
    assert (normals[on] * radial).sum(axis=1).min() > (1 - 1e-6 if curved else 0.99)


def test_meshes_are_equal_in_another_process(rod: MeshData) -> None:
    program = "from tests.meshes.test_meshes import *; print(digest(mesh(ROD, 2.0)))"
    assert support.python("-c", program).stdout.strip() == digest(rod)


def test_meshes_have_canonical_order_without_unused_nodes(rod: MeshData) -> None:
    assert np.array_equal(np.unique(rod.cells), np.arange(len(rod.points)))
    assert np.array_equal(np.lexsort(rod.points.round(9).T), np.arange(len(rod.points)))
    assert np.all(np.diff(rod.cell_tags) >= 0)
    assert np.all(cell_volumes(rod.points, rod.cells) > 0)


@pytest.mark.parametrize("curved", [False, True])
def test_quality_equals_that_of_gmsh(tmp_path: Path, curved: bool) -> None:
    data = mesh(ROD, 3.0, curved=curved)
    meshes.write_msh(data, tmp_path / "a.msh")
    with session("theirs") as gmsh:
        gmsh.open(str(tmp_path / "a.msh"))
        _, tags, _ = gmsh.model.mesh.getElements(3)
        theirs = gmsh.model.mesh.getElementQualities(np.concatenate(tags), "minSICN")
    ours = quality.sicn(data.points, data.cells)
    assert np.sort(ours) == pytest.approx(np.sort(theirs), abs=1e-10)


def test_quality_check_names_region_place_and_value(rod: MeshData) -> None:
    points = rod.points.copy()
    # Flatten one cell of the cement: its last vertex into the plane of the others.
    cell = rod.cells[np.flatnonzero(rod.cell_tags == rod.regions["cement"])[100]]
    points[cell[3]] = points[cell[:3]].mean(axis=0)
    with pytest.raises(GeometryError, match=r"cement at \(-?\d+\.\d\d, .*\) mm: -?0\.\d{4}"):
        quality.check(points, rod.cells, rod.cell_tags, rod.regions)
    quality.check(rod.points, rod.cells, rod.cell_tags, rod.regions)


def test_quality_relaxation_moves_only_free_nodes_of_poor_cells() -> None:
    """A node among the corners of a cube is put far outside of it, and comes back."""
    corners = np.array(list(product((0.0, 1.0), repeat=3)))
    faces = ConvexHull(corners).simplices
    outward = np.cross(
        corners[faces[:, 1]] - corners[faces[:, 0]], corners[faces[:, 2]] - corners[faces[:, 0]]
    )
    inward = (outward * (corners[faces].mean(axis=1) - 0.5)).sum(axis=1) > 0
    faces[inward] = faces[inward][:, [1, 0, 2]]
    cells = np.column_stack([faces, np.full(len(faces), 8)])
    assert quality.sicn(np.vstack([corners, [[0.5, 0.5, 0.5]]]), cells).min() > 0.5
    x = np.vstack([corners, [[1.7, 0.4, 0.6]]])
    assert quality.sicn(x, cells).min() < -0.1
    free = np.arange(9) == 8
    moved = quality.relaxed(x, cells, free, 6)
    assert quality.sicn(moved, cells).min() >= quality.POOR
    assert (moved[:8] == corners).all() and ((moved[8] > 0) & (moved[8] < 1)).all()
    assert (quality.relaxed(moved, cells, free, 6) == moved).all()
    assert (quality.relaxed(x, cells, np.zeros(9, dtype=bool), 6) == x).all()


@pytest.mark.parametrize(
    ("works", "remedy"),
    [
        (
            lambda rod, mesh: mesh.size < 4.7,
            "Set mesh.size: 4.5 mm; with it all elements are good.",
        ),
        (
            lambda rod, mesh: rod.cement_thickness > 5.0,
            "Set geometry.cement_thickness: 5.4 mm; with it all elements are good.",
        ),
        (
            lambda rod, mesh: False,
            "Change geometry: elements are also inverted or nearly flat with mesh.size from 4.5 to"
            " 6 mm and geometry.cement_thickness from 3.6 to 6.4 mm.",
        ),
    ],
)
def test_quality_poor_cells_are_refused_with_a_size_that_meshes(
    works: Callable[[Any, Any], bool], remedy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One near the given one, within the far size; where none does, all that were tried."""

    def checked(mesher: Any, geometry: Any, mesh: Any) -> None:
        if not works(geometry, mesh):
            raise quality.PoorCellsError("1 of 9 elements are inverted")

    monkeypatch.setattr(meshes, "_checked", checked)
    assert meshes._remedy(None, ROD, options(5.0, far_size="6 mm")) == remedy


def test_cache_returns_the_same_mesh_and_survives_damage(tmp_path: Path, rod: MeshData) -> None:
    first = meshes.build(ROD, options(2.0), tmp_path)
    (file,) = tmp_path.glob("*.npz")
    second = meshes.build(ROD, options(2.0, order=2), tmp_path)  # the order is not the mesh's
    assert list(tmp_path.glob("*.npz")) == [file]
    for data in (first, second):
        for name in ("points", "cells", "cell_tags", "facets", "facet_tags"):
            assert np.array_equal(getattr(data, name), getattr(rod, name)), name
        assert data.boundaries == rod.boundaries
        assert data.interfaces == rod.interfaces
        assert data.notes == rod.notes
    good = file.read_bytes()
    for how in DAMAGES:
        damage(file, how)
        assert cache.load(file) is None
        third = meshes.build(ROD, options(2.0), tmp_path)
        assert np.array_equal(third.cells, rod.cells)
        assert file.stat().st_size == len(good) and not list(tmp_path.glob("*.part"))


def test_cache_that_cannot_be_written_is_skipped(caplog: pytest.LogCaptureFixture) -> None:
    one = Blocks(blocks=(Block(name="a", size=["4 mm"] * 3),))
    assert len(meshes.build(one, options(4.0), Path("/proc/nowhere")).cells)
    assert "the mesh cannot be kept in /proc/nowhere" in caplog.text


def test_cache_distinguishes_cases() -> None:
    keys = {
        cache.mesh_hash(geometry, o)
        for geometry in (ROD, ROD.model_copy(update={"length": 21.0}), STACK)
        for o in (options(2.0), options(2.0, far_size="3 mm"), options(2.0, curved=True))
    }
    assert len(keys) == 9


def test_imported_names_may_overlap_but_patches_may_not() -> None:
    points = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)], dtype=float)
    cells = np.array([(0, 1, 2, 3), (1, 2, 3, 4)])
    facets, _ = exterior_facets(cells)
    low = points[facets].mean(axis=1)[:, 2] < 0.3
    data = assemble(
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
    assert components(data.neighbours, data.cell_tags).tolist() == [0, 0]
    assert components(data.neighbours, np.array([1, 2], dtype=np.int32)).tolist() == [0, 1]


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


def test_meshes_stem_that_meets_bone_through_cement_is_refused(
    rod: MeshData, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of any geometry: a stem that meets bone through its cement, here near the top."""
    centres = rod.points[rod.cells[:, :4]].mean(axis=1)
    cement = rod.cell_tags == rod.regions["cement"]
    hole = cement & (centres[:, 2] > 15) & (centres[:, 0] > 0)
    tags = np.where(hole, rod.regions["bone"], rod.cell_tags).astype(np.int32)
    monkeypatch.setattr(cylinders, "build", lambda *_: replace(rod, cell_tags=tags))
    with pytest.raises(GeometryError, match=r"^stem meets bone where .* about \(\d") as caught:
        mesh(ROD, 2.0)
    assert "cement" not in str(caught.value)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_sections_of_a_block_have_exact_areas(axis: int) -> None:
    data = mesh(STACK, 2.0)
    size = np.array([10.0, 8.0, 12.0])
    at = float(size[axis]) * 0.3
    area = 0.0
    for corners, _ in cut(data.points, data.cells, axis, at):
        fan = corners[:, 1:] - corners[:, :1]
        area += 0.5 * np.linalg.norm(np.cross(fan[:, :-1], fan[:, 1:]), axis=2).sum()
        assert np.allclose(corners[..., axis], at)
    assert area == pytest.approx(size.prod() / size[axis])


@pytest.mark.parametrize("mask", [0o022, 0o002, 0o077])
def test_cache_is_private_to_its_user(tmp_path: Path, mask: int) -> None:
    before = os.umask(mask)
    try:
        meshes.build(Blocks(blocks=(Block(name="a", size=["4 mm"] * 3),)), options(4.0), tmp_path)
    finally:
        os.umask(before)
    (path,) = tmp_path.glob("*.npz")
    assert path.stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("sector", ["full", "half", "quarter"])
def test_cylinders_slices_one_cell_thick_mesh(sector: str) -> None:
    """At any thickness: 4.2 mm of cement did, 4.199999999999999 mm left a sliver."""
    rng = np.random.default_rng(7)
    for number in range(5):
        size = float(rng.uniform(2.0, 4.0))
        thickness = 4.199999999999999 if number == 0 else float(rng.uniform(1.0, 8.0))
        rings = Cylinders(
            stem_radius=f"{rng.uniform(4.0, 9.0)!r} mm",
            cement_thickness=f"{thickness!r} mm",
            bone_thickness=f"{rng.uniform(3.0, 8.0)!r} mm",
            length=f"{size * rng.uniform(0.5, 1.5)!r} mm",
            sector=sector,
        )
        data = meshes.build(rings, MeshOptions(size=f"{size!r} mm", curved=number % 2 == 1))
        assert data.notes["quality"]["sicn_min"] > 0.1
        inner, outer = rings.stem_radius, rings.stem_radius + thickness
        exact = np.pi * (outer**2 - inner**2) * rings.length * rings.fraction
        # Straight chords of length h lose (h / R)^2 / 6 of a circle's area.
        lost = (size / inner) ** 2 / 6
        volume = data.notes["volumes_mm3"]["cement"]
        assert volume == pytest.approx(exact, rel=0.01 if data.curved else 0.01 + 4 * lost)
