"""Errors and notes on a case on its mesh; cases without any."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest

import meshes
from app.case.case import Case, load_case
from app.cli import main
from app.foundation.errors import GeometryError, InputError
from app.simulation.model import Model
from app.soundness import preview, well_posedness
from app.soundness.bodies_on_mesh import GroupsOnMesh, pieces_of_groups
from app.system.timing import Timing
from meshes.data import MeshData
from tests import support
from tests.soundness.judged import TWO, judge, judged
from tests.support import CONFIGS, build

PIN = f"""
geometry:
  {{kind: cylinders, stem_radius: 7 mm, cement_thickness: 4 mm, bone_thickness: 6 mm,
   length: 20 mm, sector: full}}
mesh: {{size: 4 mm, far_size: 6 mm, order: 2}}
{support.TISSUES.replace("0.4", "0")}supports:
  base: {{kind: fixed, boundary: bone_bottom}}
  step: {{kind: roller, boundary: stem_bottom, axis: z}}
loads:
  press: {{kind: force, boundary: stem_top, force: [0 N, 0 N, -100 N]}}
"""


def torn(data: MeshData, case: Case, name: str, share: float = 1.1) -> MeshData:
    """The mesh, cut open at its first facets of an interface in z, by x."""
    upper = case.geometry.interface_sides[name][1]
    nodes = np.unique(meshes.interface_facets(data, name)[0])
    x = data.points[nodes, 0]
    inside = nodes[x <= x.min() + share * np.ptp(x)]
    number = np.arange(len(data.points))
    number[inside] = len(data.points) + np.arange(len(inside))
    cells, of = data.cells.copy(), np.isin(data.cell_tags, [data.regions[r] for r in upper])
    cells[of] = number[cells[of]]
    above = data.points[data.facets[:, :3], 2].mean(axis=1) > data.points[nodes, 2].max() - 1e-9
    facets = np.where(above[:, None], number[data.facets], data.facets)
    points = np.vstack([data.points, data.points[inside]])
    return replace(data, points=points, cells=cells, facets=facets)


# Of first order, to be fast or because theirs is what the case is about.
LINEAR = (
    *("bench/stem", "residual", "stress/stem", "thermal_100C", "variations"),
    *(
        f"verification/{name}"
        for name in ("foundation_bar", "lame_free_ends", "stiff_contact", "wall")
    ),
)
STAYS = "conductance does not change"
EXPECTED = {
    **{name: {"linear cells of"} for name in LINEAR},
    **{name: {"linear cells of", STAYS} for name in ("residual", "thermal_100C")},
    **{name: {STAYS} for name in ("history", "verification/hot_fit")},
    "verification/heated_walls": {"vary the initial temperatures"},
    "verification/stiff_contact": {"vary the initial temperatures", "linear cells of"},
    "verification/wavy_contact": {"vary the initial temperatures"},
    "verification/columns": {"lazy_zone is 0"},
    "verification/pressed_rod": {"is the unit wrong?"},
    "verification/plate": {"strains are not small"},
    **{key: {"from memory: check"} for key in ("day", "fatigue", "creep_taper")},
    **{key: {"from memory: check"} for key in ("composite_intact", "composite_stem")},
    "life": {"from memory: check", STAYS},
    "verification/creep_taper": {"slopes by 1.5 degrees"},
    "verification/layer": {"1e+09 MPa; is the unit wrong?"},
    "verification/socket": {"1e+09 MPa; is the unit wrong?", "friction_coefficient is 10"},
    "verification/rubbing": {"200000 MPa; is the unit wrong?", STAYS},  # metal by another name
}
SHIPPED = sorted(
    str(p.relative_to(CONFIGS).with_suffix(""))
    for folder in (".", "stress", "verification", "bench")
    for p in (CONFIGS / folder).glob("*.yaml")
)


@pytest.mark.parametrize("name", SHIPPED)
def test_well_posedness_shipped_cases_have_only_expected_notes(name: str) -> None:
    case = load_case(CONFIGS / f"{name}.yaml").config
    # Meshes of these are made where they are run, in tests/command_line/test_run.py.
    large = case.geometry.kind in ("femur", "intact_femur") or name == "bench/stem"
    notes = [v.text for v in preview.input_notes(case)]
    notes += [] if large else judge(case, build(case))
    for note in notes:
        assert any(words in note for words in EXPECTED.get(name, ())), note
    if not large:
        for words in EXPECTED.get(name, ()):
            assert any(words in note for note in notes)


def test_well_posedness_sound_case_has_no_note() -> None:
    assert judged(TWO) == []


@pytest.mark.parametrize(
    ("change", "free"),
    [
        (
            "friction_coefficient=0",
            "x, y and to rotate about z: contact on 'bone_metal' has no fric",
        ),
        ("gap=0.01 mm", "x, y, z and to rotate about x, y, z until 'bone_metal' closes"),
    ],
)
def test_well_posedness_notes_bodies_held_by_contact_alone(change: str, free: str) -> None:
    change = f"interfaces.bone_metal.{change}"
    (note,) = judged(TWO, change)
    assert f"body 'metal': it is free to move along {free}" in note
    held = "supports.top={kind: fixed, boundary: metal_x_min}"
    assert not any("holds body" in n for n in judged(TWO, change, held))


@pytest.mark.parametrize("order", [1, 2])
def test_well_posedness_frictionless_pin_and_taper(order: int) -> None:
    chosen = f"mesh.order={order}"
    turning = [n for n in judged(PIN, chosen) if "holds body" in n]
    assert len(turning) == 1 and "body 'stem': it is free to rotate about z:" in turning[0]
    rough = "interfaces.stem_cement.friction_coefficient=0.1"
    assert not [n for n in judged(PIN, chosen, rough) if "holds body" in n]
    barely = "supports={base: {kind: fixed, boundary: bone_bottom}}"
    (note,) = [n for n in judged(PIN, chosen, barely, "geometry.taper=1.5 deg") if "holds" in n]
    assert (
        "'stem': it is free to move along z and to rotate about z: contact on 'stem_cement'" in note
    )
    (note,) = [n for n in judged(PIN, chosen, barely, "geometry.taper=6 deg") if "holds" in n]
    assert "'stem': it is free to rotate about z:" in note  # the cone is steep enough


def test_well_posedness_refuses_a_floating_body(monkeypatch: pytest.MonkeyPatch) -> None:
    """A crack parts a block from the one below, though its interface is bonded.

    A run refuses the case in the same words, before it factorizes a singular matrix.
    """
    case = support.case(TWO, "interfaces={}")
    parts = well_posedness.mesh_parts(case, build(case))
    assert len(pieces_of_groups(case, parts)) == 1
    data = torn(build(case), case, "bone_metal")
    cracked = well_posedness.mesh_parts(case, data)
    assert len(pieces_of_groups(case, cracked)) == 2
    with pytest.raises(InputError) as caught:
        well_posedness.check_on_mesh(case, cracked)
    apart, crack = caught.value.messages
    assert apart.startswith("interfaces.bone_metal: no facet between bone and metal; ")
    error = GroupsOnMesh(case, cracked).errors_of_floating()[0].text
    assert error.startswith(
        "supports: nothing holds body 'metal': it is free to move along x, y, z and to rotate "
        "about x, y, z, by a support"
    )
    assert "regions 'bone' and 'metal'" in crack and "nodes coincide" in crack
    monkeypatch.setattr(meshes, "build", lambda *_: data)
    with pytest.raises(InputError) as run:
        Model(case, MPI.COMM_WORLD, {}, Timing(), str)
    assert run.value.messages == caught.value.messages


def test_well_posedness_refuses_a_free_rotation() -> None:
    """Nodes on one edge hold all axes and leave a rotation about the edge."""
    case = support.case(TWO, "interfaces={}")
    parts = well_posedness.mesh_parts(case, build(case))
    ((piece, nodes),) = parts.boundaries["bottom"].items()
    edge = {piece: nodes[parts.x[nodes, 1] < 1e-9]}
    held = replace(parts, boundaries={**parts.boundaries, "bottom": edge})
    with pytest.raises(
        InputError, match="it is free to rotate about an axis along x, by a support"
    ):
        well_posedness.check_on_mesh(case, held)


def test_well_posedness_names_a_floating_piece() -> None:
    case = support.case(TWO)
    data = build(case)
    far = replace(
        data,
        points=np.vstack([data.points, data.points[data.cells[0, :4]] + [40.0, 0, 0]]),
        cells=np.vstack([data.cells, len(data.points) + np.arange(4)]),
        cell_tags=np.append(data.cell_tags, data.regions["metal"]).astype(np.int32),
    )
    with pytest.raises(InputError, match=r"body 'metal' \(the piece of 1 cells at \(4"):
        judge(case, far)


def test_well_posedness_notes_cracks_in_an_interface() -> None:
    """A crack in a part of the interface has a note. Along all of it there is no interface."""
    case = support.case(TWO)
    data = build(case)
    (note,) = judge(case, torn(data, case, "bone_metal", 0.4))
    assert "regions 'bone' and 'metal'" in note and "crack" in note
    with pytest.raises(GeometryError, match=r"no facet between bone and metal.*merge them"):
        meshes._check_parts(torn(data, case, "bone_metal"), ())


def test_well_posedness_notes_a_dependent_interface(tmp_path: Path) -> None:
    """Three bodies surround a line. Each is in contact with both others."""
    case = support.case(TWO)
    data = build(case)
    left = data.points[data.cells[:, :4]].mean(axis=1)[:, 0] < 5
    tags = np.where(left & (data.cell_tags == data.regions["metal"]), 9, data.cell_tags)
    regions, sides = data.regions | {"third": 9}, data.boundaries.keys() - {"bottom", "top"}
    held = {name: tags for name, tags in data.boundaries.items() if name not in sides}
    pairs = (("bone", "metal"), ("bone", "third"), ("metal", "third"))
    meshes.write_msh(
        replace(data, cell_tags=tags, regions=regions, boundaries=held, interfaces={}),
        tmp_path / "three.msh",
    )
    between = ", ".join(f"{a}_{b}: [[{a}], [{b}]]" for a, b in pairs)
    laws = ", ".join(f"{a}_{b}: {{kind: contact, friction_coefficient: 0.4}}" for a, b in pairs)
    material = "{youngs_modulus: 17 GPa, poisson_ratio: 0.3, tissue: other}"
    notes = judged(
        TWO,
        f"geometry={{kind: file, path: {tmp_path}/three.msh, interfaces: {{{between}}}}}",
        "regions={" + ", ".join(f"{r}: {material}" for r in regions) + "}",
        f"interfaces={{{laws}}}",
    )
    (note,) = [n for n in notes if "meet at" in n]
    assert note.startswith("interfaces bone_metal, bone_third, metal_third meet at")
    assert note.endswith("holds only as a mean over the neighbouring points")
    assert not [n for n in judged(TWO) if "meet at" in n]


MORE = "supports.more={kind: displacement, boundary: "


def test_well_posedness_refuses_impossible_cases() -> None:
    with pytest.raises(InputError, match=r"bone_metal\.gap: .* strains are not small; use"):
        thin = [f"geometry.blocks.{k}.size=[10 mm, 10 mm, 0.5 mm]" for k in (0, 1)]
        judged(TWO, *thin, "interfaces.bone_metal.gap=0 * x - 0.9")
    # A boundary that is the whole of another one, by another name.
    again = "supports.again={kind: displacement, boundary: bone_y_min, z: 0.2 mm}"
    with pytest.raises(InputError, match=r"supports\.again: .* along z than supports\.more "):
        judged(TWO, f"{MORE}y_min, z: 0.1 mm}}", again)


@pytest.mark.parametrize(
    ("more", "wrong"),
    [
        ("bottom, z: 0.1 mm", True),
        ("bottom, z: 0.1 mm, history: [0]", False),
        ("top, z: 0.1 mm", False),
        # The same field in other words, and one that is zero where the boundary is.
        ("bottom, x: 0 * y, y: 0 * z, z: x - x", False),
        ('bottom, z: "0.1 * z"', False),
        ('bottom, z: "0.1 + 0.1 * x"', True),
    ],
)
def test_well_posedness_refuses_contradictory_displacements(more: str, wrong: bool) -> None:
    """Values at nodes are compared, not texts."""
    more = f"supports.more={{kind: displacement, boundary: {more}}}"
    if not wrong:
        assert not any("supports.more" in note for note in judged(TWO, more))
        return
    with pytest.raises(InputError, match=r"supports\.more: .*a different displacement.* \d+ nodes"):
        judged(TWO, more)


def test_well_posedness_errors_have_a_place_in_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "case.yaml"
    more = "more: {kind: displacement, boundary: bottom, z: 0.1 mm}"
    path.write_text(TWO.replace("loads:", f"  {more}\nloads:"))
    assert main(["check", str(path), "--mesh"]) == 2
    assert f"{path}:12:3: supports.more: " in capsys.readouterr().err
    path.write_text(TWO.replace("coefficient: 0.4", "coefficient: 0.4, gap: 0.001 / (x - x)"))
    assert main(["check", str(path), "--mesh"]) == 2
    key = "interfaces.bone_metal.gap"
    start = f"{path}:9:58: {key}: expression '0.001 / (x - x)' is not finite at ("
    assert start in capsys.readouterr().err
    change = f"{key}=log(x - 99)"
    assert main(["check", str(path), "--mesh", "--set", change]) == 2
    start = f"--set {key}: expression 'log(x - 99)' is not finite at ("
    assert start in capsys.readouterr().err


BESIDE = """
geometry: {kind: blocks, blocks: [{name: low, size: [6 mm, 6 mm, 2 mm]},
                                  {name: high, size: [6 mm, 6 mm, 2 mm]}]}
mesh: {order: 1, size: 2 mm}
regions:
  low: {youngs_modulus: 900 MPa, poisson_ratio: 0, tissue: other}
  high: {youngs_modulus: 900 MPa, poisson_ratio: 0, tissue: other}
interfaces: {low_high: {kind: contact, friction_coefficient: 0.25}}
supports:
  floor: {kind: fixed, boundary: bottom}
  held: {kind: roller, boundary: low_x_min, axis: x}
  push: {kind: displacement, boundary: high_x_min, x: 0.03 mm, history: [0, 1]}
loads: {press: {kind: pressure, boundary: top, pressure: 4 MPa}}
stages: [{name: press}, {name: push, increments: 2}]
"""


def test_well_posedness_supports_of_separate_bodies() -> None:
    """Supports of two bodies at the nodes of their interface do not contradict each other."""
    assert not [n for n in judged(BESIDE) if "prescribes another" in n]
    bonded = judged(BESIDE, "interfaces.low_high={kind: bonded}")
    (note,) = [n for n in bonded if "prescribes a different displacement along x" in n]
    assert "at 4 nodes" in note
