"""Tissues of regions under any name: bone, cement, implant or other."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

from mpi4py import MPI

import pytest

import meshes
from app.case.case import dump, load_case, plain_data
from app.foundation.errors import InputError
from app.heat.heat_forms import HeatForms
from app.report.sweep_results import SweptCase
from app.results.error_estimate import companions
from app.results.hip import StemMotion
from app.results.thermal_record import ThermalRecord
from app.system.timing import Timing
from docs.paper.cases import bone_peak
from tests import support
from tests.cases.temperatures import BODIES, SIDES, Play, constant, two_blocks

CONFIGS = support.CONFIGS
# A nail on a cortex, neither of which is called what it is.
STACK = """
geometry: {kind: blocks, blocks: [{name: cortex, size: [4 mm, 4 mm, 2 mm]},
                                  {name: bone_cement, size: [4 mm, 4 mm, 2 mm]},
                                  {name: nail, size: [4 mm, 4 mm, 6 mm]}]}
mesh: {order: 1, size: 2 mm, far_size: 2 mm}
regions:
  cortex: {youngs_modulus: 100 MPa, poisson_ratio: 0, tissue: bone}
  bone_cement: {youngs_modulus: 100 MPa, poisson_ratio: 0, tissue: cement}
  nail: {youngs_modulus: 100 MPa, poisson_ratio: 0, tissue: implant}
supports: {base: {kind: fixed, boundary: bottom}}
loads: {press: {kind: pressure, boundary: top, pressure: 1 MPa}}
"""


@pytest.mark.parametrize(
    ("name", "bones"),
    [("stance", ["cortical_bone", "cancellous_bone"]), ("cylinders", ["bone"])],
)
def test_geometries_tissues_of_shipped_geometries(name: str, bones: list[str]) -> None:
    """A key of the case replaces the tissue. Blocks are neither bone nor implant by default."""
    case = load_case(CONFIGS / f"{name}.yaml", [f"regions.{bones[0]}.tissue=other"]).config
    tissues = dict.fromkeys(bones, "bone") | {"stem": "implant", "cement": "cement"}
    assert {n: r.tissue for n, r in case.regions.items()} == tissues | {bones[0]: "other"}
    stack = support.case(STACK.replace(", tissue: bone", ""))
    assert [r.tissue for r in stack.regions.values()] == ["other", "cement", "implant"]
    assert stack.of_tissue("implant") == ("nail",) and stack.of_tissue("bone") == ()


def test_geometries_tissues_of_a_mesh_file_are_required(tmp_path: Path) -> None:
    stack = support.case(STACK)
    meshes.write_msh(meshes.build(stack.geometry, stack.mesh), tmp_path / "a.msh")
    path = tmp_path / "case.yaml"
    sides = "interfaces: {one: [cortex, bone_cement], two: [bone_cement, nail]}"
    text = f"geometry: {{kind: file, path: a.msh, {sides}}}\n" + STACK[STACK.index("mesh:") :]
    path.write_text(text.replace(", tissue: bone}", "}").replace("implant", "implnt"))
    with pytest.raises(InputError) as caught:
        load_case(path)
    assert caught.value.messages == [
        f"{path}:4:3: regions.cortex: 'tissue' is missing; expected bone, cement, implant or other",
        f"{path}:6:53: regions.nail.tissue: 'implnt' is not one of bone, cement, implant, other; "
        "did you mean 'implant'?",
    ]


def test_geometries_tissues_come_from_library_materials(tmp_path: Path) -> None:
    """A material of the library has a tissue. The tissue of the region comes before it."""
    stack = support.case(STACK)
    meshes.write_msh(meshes.build(stack.geometry, stack.mesh), tmp_path / "a.msh")
    text = STACK[STACK.index("regions:") :].replace(", tissue: bone}", ", tissue: other}")
    for name, material in (("bone_cement", "PMMA"), ("nail", "CoCrMo")):
        text = re.sub(rf"{name}: {{.*}}", f"{name}: {{material: {material}}}", text)
    path = tmp_path / "case.yaml"
    sides = "{one: [cortex, bone_cement], two: [bone_cement, nail]}"
    file = f"{{kind: file, path: a.msh, interfaces: {sides}}}"
    path.write_text(f"geometry: {file}\noutput: {{error: true}}\n{text}")
    case = load_case(path).config
    assert {n: r.tissue for n, r in case.regions.items()} == {
        "cortex": "other",
        "bone_cement": "cement",
        "nail": "implant",
    }
    assert load_case(path, ["regions.cortex.material=cancellous_bone"]).config.of_tissue("other")
    changed = ["regions.nail.material=cortical_bone", "regions.cortex.tissue=null"]
    changed += ["regions.cortex.material=cancellous_bone"]
    assert load_case(path, changed).config.of_tissue("bone") == ("cortex", "nail")
    friction = "interfaces.one={kind: contact, friction_coefficient: 0.3}"
    (companion,) = companions(load_case(path, [friction]).config)
    assert str(companion).startswith("mesh of the file")
    path.write_text(dump(case))
    assert load_case(path).config == case and "size" not in plain_data(case)["mesh"]
    assert len(meshes.build(case.geometry, case.mesh).cells) > 100


@pytest.mark.parametrize("mesh", ["", "mesh: {}", "mesh: {order: 1}"])
@pytest.mark.parametrize("name", ["blocks.yaml", "sliding_block.yaml"])
def test_geometries_tissues_mesh_size_is_required(name: str, mesh: str, tmp_path: Path) -> None:
    """A script of gmsh needs a mesh size too."""
    text = re.sub(r"^mesh:.*\n(  .*\n)*", f"{mesh}\n", (CONFIGS / name).read_text(), flags=re.M)
    path = tmp_path / "case.yaml"
    path.write_text(text.replace("sliding_block.geo", str(CONFIGS / "sliding_block.geo")))
    with pytest.raises(InputError) as caught:
        load_case(path)
    (message,) = caught.value.messages
    assert message.endswith(
        "mesh: 'size' is missing; expected the edge length at the interfaces, e.g. 4 mm"
    )


def test_geometries_tissues_implant_moves_relative_to_bone() -> None:
    """A strain of 1 % under 1 MPa changes the 2 mm between nail and cortex by 0.02 mm."""
    solved = support.solve(STACK)
    motion = StemMotion(solved.problem, solved.case)(solved.case.side)
    assert motion["subsidence"] == pytest.approx(0.02, rel=1e-9)
    assert motion["tip_displacement"] == pytest.approx([0, 0, -0.04], abs=1e-12)
    assert motion["top_displacement"] == pytest.approx([0, 0, -0.1], abs=1e-12)
    boneless = support.case(STACK.replace("tissue: bone", "tissue: other"))
    assert StemMotion(solved.problem, boneless)(boneless.side) == {}


def test_geometries_tissues_necrosis_counts_bone_alone() -> None:
    """The upper block is bone at 80 degC for two minutes, and dead.

    The lower one is cement, which cannot die.
    """
    tagged = two_blocks(MPI.COMM_SELF)
    forms = HeatForms(tagged, BODIES, Timing())
    play = Play(tagged, constant(60.0), constant(80.0))
    play.record = ThermalRecord(tagged, forms, BODIES.body_of_region, SIDES, ("cement",), {})
    play.record.start(play.at(0.0))
    regions = play.through(60.0, 120.0)["regions"]
    assert regions["cement"]["necrosis_47C_1min_volume"] == pytest.approx(4 * 4 * 2)
    assert not any(key.startswith("necrosis") for key in regions["bone"])


def test_geometries_tissues_reports_find_bone_by_tissue(tmp_path: Path) -> None:
    (tmp_path / "case.yaml").write_text(STACK)
    (tmp_path / "history.csv").write_text(
        "seconds [s],cortex temperature_max [degC],bone_cement temperature_max [degC]\n3,45,90\n"
    )
    case = SweptCase("a", tmp_path, "converged")
    assert case.bones == ["cortex"]
    peak = bone_peak(case)
    assert peak is not None and dataclasses.astuple(peak)[0] == 45.0
