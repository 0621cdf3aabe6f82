"""Geometry from gmsh scripts: names from the text, sizes of the case, usual meshes."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

import meshes
from app.case.case import load_case
from app.case.geometries import MeshFile
from app.case.mesh_names import ALLOWED, physical_names
from app.case.shapes import MeshOptions
from app.foundation import confined
from app.foundation.errors import GeometryError, InputError
from meshes import cache
from meshes.data import boundary_areas, facet_areas, interface_facets, region_volumes
from meshes.gmsh_session import session
from tests import support
from tests.cases.gmsh_scripts import CASE, LAYERS, script

# A pin of radius 2 and height 5 in a plate 10 x 10 x 5, by OpenCASCADE.
PIN = """\
SetFactory("OpenCASCADE");
DefineConstant[ size = 1 ];
Box(1) = {0, 0, 0, 10, 10, 5};
Cylinder(2) = {5, 5, 0, 0, 0, 5, 2};
BooleanFragments{ Volume{1}; Delete; }{ Volume{2}; Delete; }
Physical Volume("pin") = {2};
Physical Volume("plate") = {3};
Physical Surface("base") = Surface In BoundingBox{-1, -1, -0.1, 11, 11, 0.1};
MeshSize { PointsOf { Volume{:}; } } = size;
"""

HOLE = {"hole": (("pin",), ("plate",))}


@pytest.fixture(autouse=True)
def allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Allow scripts, like --allow-scripts."""
    monkeypatch.setenv(ALLOWED, "1")


def options(**values: object) -> MeshOptions:
    return MeshOptions.model_validate(values)


def test_imported_scripts_names_are_read_from_the_text(tmp_path: Path) -> None:
    """Names are in the order of the script, without those in comments."""
    path = script(tmp_path, LAYERS)
    assert physical_names(path, 3) == ("low", "high")
    assert physical_names(path, 2) == ("base", "top", "between")


def test_imported_scripts_are_meshed_with_the_sizes_of_the_case(tmp_path: Path) -> None:
    geometry = MeshFile(path=script(tmp_path, LAYERS), interfaces={"joint": (("low",), ("high",))})
    cells = {}
    for size, far in ((1.0, 1.0), (0.5, 0.5), (0.5, 1.0)):
        data = meshes.build(geometry, options(size=f"{size} mm", far_size=f"{far} mm"))
        cells[size, far] = len(data.cells)
        assert region_volumes(data) == pytest.approx({"low": 6.0, "high": 12.0})
        assert boundary_areas(data) == pytest.approx({"base": 6.0, "top": 6.0})
        joint = interface_facets(data, "joint")[0]
        assert facet_areas(data.points, joint).sum() == pytest.approx(6.0)
        assert np.allclose(data.points[joint][:, :, 2], 1.0)
        assert data.notes["interior_surfaces"] == ["between"]
    assert 4 * cells[1.0, 1.0] < cells[0.5, 0.5] < 16 * cells[1.0, 1.0]
    assert cells[1.0, 1.0] < cells[0.5, 1.0] < 0.8 * cells[0.5, 0.5]


def test_imported_scripts_get_sizes_in_their_unit(tmp_path: Path) -> None:
    """The same script in cm with ten times the size gives the same mesh, ten times as large."""
    path = script(tmp_path, PIN)
    millimetres, centimetres = (
        MeshFile(path=path, unit=unit, interfaces=HOLE) for unit in ("mm", "cm")
    )
    small = meshes.build(millimetres, options(size="1 mm"))
    large = meshes.build(centimetres, options(size="1 cm"))
    assert np.array_equal(small.cells, large.cells)
    assert np.allclose(10 * small.points, large.points)


def test_imported_scripts_get_parameters_of_the_case(tmp_path: Path) -> None:
    """A constant of the script changes the mesh. Unknown constants and sizes are refused."""
    declared = PIN.replace("[ size = 1 ]", "[ size = 1, radius = 2 /* mm */ ]")
    path = script(tmp_path, declared.replace("5, 2}", "5, radius}"))

    def volume(**parameters: float) -> float:
        geometry = MeshFile(path=path, interfaces=HOLE, parameters=parameters)
        return region_volumes(meshes.build(geometry, options(size="1 mm")))["pin"]

    assert volume() == pytest.approx(20 * np.pi, rel=0.05)
    assert volume(radius=3.0) == pytest.approx(45 * np.pi, rel=0.05)
    with pytest.raises(ValidationError, match="'radios' is not one of"):
        MeshFile(path=path, interfaces=HOLE, parameters={"radios": 1.0})
    with pytest.raises(ValidationError, match="is set by the mesh section"):
        MeshFile(path=path, interfaces=HOLE, parameters={"size": 1.0})


@pytest.mark.parametrize(("text", "curved"), [(PIN, True), (LAYERS, False)], ids=["pin", "layers"])
def test_imported_scripts_of_second_order_have_curved_cells(
    text: str, curved: bool, tmp_path: Path
) -> None:
    """Cells are curved by default. The pin's volume is known, and flat faces stay flat."""
    script(tmp_path, text)
    (tmp_path / "case.yaml").write_text(
        re.sub("low|high", lambda m: {"low": "pin", "high": "plate"}[m[0]], CASE)
        .replace("boundary: top", "boundary: base")
        .replace("order: 1", "order: 2")
        if text == PIN
        else CASE.replace("order: 1", "order: 2")
    )
    case = load_case(tmp_path / "case.yaml").config
    data = meshes.build(case.geometry, case.mesh)
    assert data.curved == curved
    expected = {"pin": np.pi * 2**2 * 5} if curved else {"low": 6.0, "high": 12.0}
    volumes = {name: region_volumes(data)[name] for name in expected}
    assert volumes == pytest.approx(expected, rel=2e-3 if curved else 1e-12)


def test_imported_scripts_are_cached_by_their_content(tmp_path: Path) -> None:
    """The content includes scripts that a script names in quotes, if they are in its folder."""
    folder = tmp_path / "own"
    folder.mkdir()
    path = script(folder, PIN + 'Merge "parts/pin.geo"; Merge "../foreign.step";\n')
    coarse = options(size="1 mm")

    def key(mesh: MeshOptions = coarse) -> str:
        return cache.mesh_hash(MeshFile(path=path), mesh)

    keys = [key(), key(options(size="2 mm")), key(options(size="1 mm", curved=True))]
    for name, text in (
        ("parts/pin.geo", "Merge 'more.step';"),
        ("parts/more.step", "a"),
        ("parts/more.step", "b"),
        ("a.geo", PIN),
    ):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
        keys.append(key())
    assert len({*keys}) == 7
    assert len(keys) == 7
    path.write_text(PIN + 'Merge "../foreign.step";\n')
    before = key()
    (tmp_path / "foreign.step").write_text("x")
    (folder / "link.step").symlink_to(tmp_path / "foreign.step")
    assert key() == before
    assert key(options(size="1 mm", order=2)) == before


def test_imported_scripts_use_files_of_their_folder(tmp_path: Path) -> None:
    """A script uses scripts and other files. Each path is relative to the file that names it."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "pin.geo").write_text('SetFactory("OpenCASCADE"); Merge "pin.brep";\n')
    with session("pin") as gmsh:
        gmsh.model.occ.addCylinder(0, 0, 0, 0, 0, 5, 2)
        gmsh.model.occ.synchronize()
        gmsh.write(str(tmp_path / "parts" / "pin.brep"))
    path = script(
        tmp_path,
        "DefineConstant[ size = 1 ]; Merge 'parts/pin.geo'; Physical Volume(\"pin\") = {1};\n"
        "MeshSize { PointsOf { Volume{:}; } } = size;\n",
    )
    data = meshes.build(MeshFile(path=path), options(size="0.7 mm", curved=True))
    assert region_volumes(data)["pin"] == pytest.approx(np.pi * 2**2 * 5, rel=2e-3)


def test_imported_scripts_with_changed_files_are_refused(tmp_path: Path) -> None:
    """The mesh must be that of the files that cache and provenance name."""
    geometry = MeshFile(path=script(tmp_path, PIN), interfaces=HOLE)
    assert geometry.content
    script(tmp_path, PIN.replace("5, 2}", "5, 3}"))
    with pytest.raises(GeometryError, match="has changed since the case was read"):
        meshes.build(geometry, options(size="1 mm"))


def test_imported_scripts_layers_are_solved(tmp_path: Path) -> None:
    """Uniform pressure without Poisson's effect gives u_z = -p z / E, across the joint too."""
    script(tmp_path, LAYERS)
    case = load_case(tmp_path / "case.yaml").config
    solved = support.solve(case)
    for name in ("low", "high"):
        x, u = solved.displacement(name)
        assert np.abs(u[:, 2] + x[:, 2] / 100).max() < 1e-10
    with pytest.raises(InputError, match="'between' is not part of the surface"):
        support.solve(load_case(tmp_path / "case.yaml", ["supports.base.boundary=between"]).config)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (LAYERS.replace("size", "h"), "no parameter 'size'; expected DefineConstant"),
        (LAYERS.replace("Physical", "//"), "names no region"),
    ],
    ids=["no size", "no names"],
)
def test_imported_scripts_refused_unread(text: str, expected: str, tmp_path: Path) -> None:
    script(tmp_path, text)
    with pytest.raises(InputError, match=rf"case\.yaml:1:24: geometry\.path: .*{expected}"):
        load_case(tmp_path / "case.yaml")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (LAYERS + "Point(5) = {0, 0, nowhere};\n", "line 15: Unknown variable 'nowhere'"),
        (LAYERS + "Physical Volume('x') = ;\n", "line 15: syntax error"),
        (LAYERS.replace("{high[1]}", "{44}"), "the volumes high have no cells"),
    ],
    ids=["unknown variable", "syntax", "no such volume"],
)
def test_imported_scripts_that_fail_are_reported(text: str, expected: str, tmp_path: Path) -> None:
    """Each script runs in a separate process, because gmsh misreads scripts after a failed one."""
    script(tmp_path, text)
    command = ["-m", "mantle", "mesh", tmp_path / "case.yaml", "-o", tmp_path / "out"]
    done = support.python(*command, code=3, XDG_CACHE_HOME=str(tmp_path))
    assert expected in done.stderr
    assert "Traceback" not in done.stderr


def test_imported_scripts_unknown_content_is_reported_by_check(tmp_path: Path) -> None:
    script(tmp_path, LAYERS)
    done = support.python("-m", "mantle", "check", tmp_path / "case.yaml")
    assert "joint (low | high): contact" in done.stdout
    assert "not known before meshing" in done.stdout


@pytest.mark.parametrize("grows", [False, True], ids=["time", "memory"])
def test_imported_scripts_that_never_end_are_stopped(
    grows: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = ""
    if not grows:
        monkeypatch.setattr(confined, "SECONDS", 2)
    else:  # of a machine with 1 GiB
        few = "import os; os.sysconf = lambda name: 1 << 15; "
    monkeypatch.setattr(confined, "_SERVE", few + confined._SERVE)
    step = "a() = {a(), a()};" if grows else "a() = {i};"
    loop = f"a() = {{1}};\nFor i In {{1:1000000000}}\n{step}\nEndFor\n"
    with pytest.raises(GeometryError, match=r"file is damaged or too large|Out of memory"):
        meshes.build(MeshFile(path=script(tmp_path, loop + LAYERS)), options(size="1 mm"))


def test_imported_scripts_write_nothing_to_their_folder(tmp_path: Path) -> None:
    write = 'Printf("x") > "written";\nSave "saved.msh";\n'
    path, sides = script(tmp_path, LAYERS + write), {"joint": (("low",), ("high",))}
    meshes.build(MeshFile(path=path, interfaces=sides), options(size="1 mm"))
    assert {path.name for path in tmp_path.iterdir()} == {"a.geo", "case.yaml"}
