"""A geometry and a modulus field of a user's module, without a change of the program."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from tests import support

# A square column whose height stands in a file; Young's modulus doubles from bottom to top.
COLUMN = '''
from pathlib import Path
from typing import ClassVar, Literal

from app.case.shapes import Shape, graded_cells
from app.laws.densities import ModulusField
from app.schema.paths import File
from app.schema.units import Modulus, PositiveLength
from meshes.data import exterior_facets, mesh_data_of, number
from meshes.gmsh_session import session, tetrahedra


class Column(Shape):
    """A square column on the plane z = 0."""

    mesher: ClassVar[str] = __name__
    tissues: ClassVar[dict[str, str]] = {"shaft": "other"}
    boundary_names: ClassVar[tuple[str, ...]] = ("bottom", "top")

    kind: Literal["column"] = "column"
    width: PositiveLength
    """Width of the column."""
    profile: File
    """Text file with the height [mm]."""

    @property
    def height(self):
        return float(self.profile.read_text())

    def estimate_cells(self, mesh):
        return graded_cells(0.0, self.width**2 * self.height, mesh)


class Rising(ModulusField):
    """Young's modulus that grows linearly with the height, to twice its value at the bottom."""

    foot: Modulus
    """Young's modulus at the bottom."""

    @property
    def largest(self):
        return 2.0 * self.foot

    def modulus_at(self, x, geometry):
        return self.foot * (1.0 + x[:, 2] / geometry.height)


def build(geometry, mesh):
    """Mesh of the column by gmsh."""
    with session("column") as gmsh:
        gmsh.model.occ.addBox(0, 0, 0, geometry.width, geometry.width, geometry.height, tag=1)
        gmsh.model.occ.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMax", mesh.size)
        points, cells, tags = tetrahedra(gmsh, bool(mesh.curved))
    facets, _ = exterior_facets(cells)
    z = points[facets[:, :3]].mean(axis=1)[:, 2]
    ends = {"bottom": z < 1e-6, "top": z > geometry.height - 1e-6}
    return mesh_data_of(points, cells, tags, number(geometry.region_names), {}, ends, facets)
'''
BASE = """\
geometry: {kind: column, width: 4 mm, profile: height.txt}
mesh: {size: 2 mm}
regions: {shaft: {youngs_modulus: {foot: 1 GPa}, poisson_ratio: 0}}
supports: {ground: {kind: fixed, boundary: bottom}}
output: {probes: {tip: [2 mm, 2 mm, 8 mm]}, report: false}
"""
CASE = """\
base: parts/column.yaml
loads: {push: {kind: pressure, boundary: top, pressure: 5 MPa}}
"""


def test_geometries_from_outside_with_a_modulus_field_is_solved(tmp_path: Path) -> None:
    """The modulus is E0 (1 + z/h) without Poisson's ratio, so u(h) = -p h ln 2 / E0.

    The file of the geometry is relative to the folder of the base.
    """
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "height.txt").write_text("8\n")
    (tmp_path / "parts" / "column.yaml").write_text(BASE)
    done = support.extended(tmp_path, COLUMN, CASE, "run", "case.yaml", "-o", "out")
    assert done.returncode == 0, done.stdout + done.stderr
    displacement = support.summary(tmp_path / "out")["probes"]["tip"]["displacement"]
    assert displacement[2] == pytest.approx(-5.0 * 8.0 * math.log(2.0) / 1000.0, rel=1e-3)
