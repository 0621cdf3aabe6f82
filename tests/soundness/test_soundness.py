"""Errors and notes before a case is solved; cases without any."""

from __future__ import annotations

import logging
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

from mpi4py import MPI

import numpy as np
import pytest

import meshes
from app.case.case import Case, load
from app.cli import main
from app.foundation.errors import ConvergenceError, GeometryError, InputError
from app.numerics.newton import ActiveSet
from app.numerics.rigid_motions import describe, rigid_modes
from app.simulation.model import Model
from app.soundness import preview, result_notes, well_posedness
from app.soundness.bodies_on_mesh import BodiesOnMesh, gaps_of, groups_of
from app.soundness.loose_bodies import pulled_off
from app.system.timing import Timing
from meshes.data import MeshData
from meshes.pieces import coincident
from tests import support
from tests.support import CONFIGS, build

TWO = """
geometry: {kind: blocks, blocks: [{name: bone, size: [10 mm, 10 mm, 5 mm]},
                                  {name: metal, size: [10 mm, 10 mm, 5 mm]}]}
mesh: {size: 3 mm, order: 1}
regions:
  bone: {youngs_modulus: 17 GPa, poisson_ratio: 0.3}
  metal: {youngs_modulus: 110 GPa, poisson_ratio: 0.3}
interfaces:
  bone_metal: {kind: contact, friction_coefficient: 0.4}
supports:
  floor: {kind: fixed, boundary: bottom}
loads:
  press: {kind: pressure, boundary: top, pressure: 2 MPa}
"""
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


MOTION = """
motions:
  turn:
    {region: metal, boundary: top, about: [5 mm, 5 mm, 5 mm], translation: held,
     rotation: {axes: xyz, cycle_table: ["time [s], rotation z [deg]", "0, 0", "1, 0.4"]}}
"""


def judge(case: Case, data: MeshData) -> list[str]:
    """Notes on a case on a mesh."""
    return [
        v.text for v in well_posedness.check_on_mesh(case, well_posedness.mesh_parts(case, data))
    ]


def judged(text: str, *overrides: str) -> list[str]:
    """Notes on a case on its mesh."""
    case = support.case(text, *overrides)
    return judge(case, build(case))


def torn(data: MeshData, case: Case, name: str, share: float = 1.1) -> MeshData:
    """The mesh with its first facets of an interface in z, by x, cut open."""
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
    case = load(CONFIGS / f"{name}.yaml").config
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
    loose = "supports={base: {kind: fixed, boundary: bone_bottom}}"
    (note,) = [n for n in judged(PIN, chosen, loose, "geometry.taper=1.5 deg") if "holds" in n]
    assert (
        "'stem': it is free to move along z and to rotate about z: contact on 'stem_cement'" in note
    )
    (note,) = [n for n in judged(PIN, chosen, loose, "geometry.taper=6 deg") if "holds" in n]
    assert "'stem': it is free to rotate about z:" in note  # the cone is steep enough


def test_well_posedness_refuses_a_loose_body(monkeypatch: pytest.MonkeyPatch) -> None:
    """A block that a crack parts from the one below, though its interface is bonded.

    A run refuses it in the same words, before it factorizes a singular matrix.
    """
    case = support.case(TWO, "interfaces={}")
    parts = well_posedness.mesh_parts(case, build(case))
    assert len(groups_of(case, parts)) == 1
    data = torn(build(case), case, "bone_metal")
    cracked = well_posedness.mesh_parts(case, data)
    assert len(groups_of(case, cracked)) == 2
    with pytest.raises(InputError) as caught:
        well_posedness.check_on_mesh(case, cracked)
    apart, crack = caught.value.messages
    assert apart.startswith("interfaces.bone_metal: no facet between bone and metal; ")
    error = BodiesOnMesh(case, cracked).unheld()[0].text
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


def test_well_posedness_names_a_loose_piece() -> None:
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
    """In a part of it, as a note; along all of it there is no interface."""
    case = support.case(TWO)
    data = build(case)
    (note,) = judge(case, torn(data, case, "bone_metal", 0.4))
    assert "regions 'bone' and 'metal'" in note and "crack" in note
    with pytest.raises(GeometryError, match=r"no facet between bone and metal.*merge them"):
        meshes._check_parts(torn(data, case, "bone_metal"), ())


def test_well_posedness_notes_a_dependent_interface(tmp_path: Path) -> None:
    """Three bodies around a line, each in contact with both others."""
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


def test_pieces_coincident_nodes_in_any_order() -> None:
    rng = np.random.default_rng(3)
    x = rng.random((500, 3))
    again = rng.choice(500, 40, replace=False)
    both = np.vstack([x, x[again] + 1e-10])
    assert sorted(map(tuple, coincident(both).tolist())) == sorted(
        (int(k), 500 + i) for i, k in enumerate(again)
    )


MORE = "supports.more={kind: displacement, boundary: "
BOTH_SIDES = [
    f"supports.{a}_{b}={{kind: fixed, boundary: {a}_{b}}}" for a in "xy" for b in ("min", "max")
]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("interfaces.bone_metal.gap=-1 mm", "interference of 1 mm in bodies 10 mm thick"),
        ("interfaces.bone_metal.gap=2 mm", "2 mm apart everywhere"),
        ("loads.press.pressure=20 GPa", "loads.press: 2e+04 MPa on boundary 'top'"),
        ("loads.press={kind: force, boundary: top, force: [0 N, 0 N, -2 MN]}", ": 2e+04 MPa"),
        (f"{MORE}metal_x_min, x: 10 mm}}", "moves a model of 17.3 mm by 10 mm"),
        (f"{MORE}bone_x_min, x: 0.01 mm}}", "a different displacement along x than supports.floor"),
        ("\n".join(BOTH_SIDES), "hold both sides of interface 'bone_metal' at"),
        ("mesh.size=5 mm\ngeometry.blocks[1].size=[10 mm, 10 mm, 1 mm]", "'metal' is 1 mm"),
    ],
)
def test_preview_notes_disproportionate_values(change: str, words: str) -> None:
    assert any(words in note for note in judged(TWO, *change.splitlines()))


def test_well_posedness_refuses_impossible_cases() -> None:
    with pytest.raises(InputError, match=r"bone_metal\.gap: .* strains are not small; use"):
        judged(TWO, "interfaces.bone_metal.gap=-4 mm")
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
    """By what they are at its nodes, not by what they are written as."""
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


@pytest.mark.parametrize("change", ["bone.youngs_modulus=17 MPa", "bone.youngs_modulus=17 TPa"])
def test_preview_notes_moduli_wrong_by_a_thousand(change: str) -> None:
    note = preview.input_notes(support.case(TWO, f"regions.{change}"))[0].text
    assert note.startswith("regions.bone.youngs_modulus is ")
    assert note.endswith("is the unit wrong?")


@pytest.mark.parametrize("force", ["1.8 N", "1800 kN"])
def test_preview_notes_forces_wrong_by_a_thousand(force: str) -> None:
    path = CONFIGS / "stance.yaml"
    changes = [f"loads.{n}.history=[0]" for n in load(path).config.loads if n != "hip"]
    change = f'loads.hip.force="[0, 0, -{force.replace(" ", "] ", 1)}"'
    note = preview.input_notes(load(path, [*changes, change]).config)[0].text
    assert "N; is the unit wrong?" in note


def test_preview_notes_a_mesh_in_metres(tmp_path: Path) -> None:
    data = build(support.case(TWO))
    meshes.write_msh(replace(data, points=data.points * 1e-3), tmp_path / "a.msh")
    sides = "interfaces: {bone_metal: [bone, metal]}"
    tissues = "regions.bone.tissue=bone", "regions.metal.tissue=implant"
    geometry = f"geometry={{kind: file, path: {tmp_path}/a.msh, {sides}}}"
    notes = judged(TWO, geometry, *tissues)
    assert any("0.0173 mm from corner to corner: is its unit really mm?" in n for n in notes)


def test_doubts_on_large_strains() -> None:
    case = support.case(TWO)
    numbers = {"bone": {"von_mises_p99": 1200.0}, "metal": {"von_mises_p99": 1200.0}}
    note = result_notes.of_results(case, {"regions": numbers})[0].text
    assert note.startswith("region 'bone': is strained by 7.1 %")


def test_rigid_motions_free_ones_are_named() -> None:
    """One body along an axis, two bodies together, and about an axis that has no name."""
    centres, names = np.array([[1.0, 2, 3], [4.0, 0, -1]]), ["'a'", "'b'"]
    origin, size = np.array([0.5, 0.5, 0.5]), 10.0

    def motion(body: int, axis: np.ndarray, about: np.ndarray) -> np.ndarray:
        v = np.zeros((2, 6))
        v[body, 3:], v[body, :3] = axis, np.cross(axis, (origin - about) / size)
        return v.ravel()

    turn, oblique = (
        motion(b, np.array(a), centres[b]) for b, a in ((0, [0, 0, 1]), (1, [0.6, 0, 0.8]))
    )
    for v, motion_text in (
        (turn, "body 'a': it is free to rotate about z"),
        (np.tile([1.0, 0, 0, 0, 0, 0], 2), "bodies 'a' and 'b': they are free to move along x tog"),
        (oblique, "body 'b': it is free to rotate about an axis along (0.60, 0.00, 0.80)"),
    ):
        (text,) = describe(v[:, None], names, centres, origin, size)
        assert text.startswith(f"nothing holds {motion_text}")
    assert rigid_modes(np.zeros((1, 3)))[0, :, 3:].any() is np.False_


def test_failure_states_that_repeat_are_a_cycle() -> None:
    """Two points that change in turn, one that settled, and one that never moved."""
    active = ActiveSet(MPI.COMM_SELF)
    for k in range(7):
        active.add(np.array([k % 2, 1 + (k + 1) % 2, int(k > 1), 1]))
    assert active.changes() == 2 and active.period() == 2
    assert active.oscillating() == [(0, 6, 6, (0, 1)), (1, 6, 6, (1, 2))]
    active.add(np.array([2, 2, 1, 1]))
    assert active.period() == 0
    active.forget()
    assert active.changes() == active.period() == 0 and active.oscillating() == []


def test_failure_message_names_places_states_and_remedies(caplog: pytest.LogCaptureFixture) -> None:
    """Two iterations at a time do not do: the message has places, states, remedies, residuals."""
    caplog.set_level(logging.INFO, "mantle")
    case = (CONFIGS / "stress" / "stem.yaml").read_text()
    with pytest.raises(ConvergenceError) as caught:
        support.solve(case, "solver.max_iterations=2", "mesh.size=5 mm", "mesh.far_size=5 mm")
    text = str(caught.value)
    place = r"\(-?[\d.]+, -?[\d.]+, -?[\d.]+\) mm"
    assert re.search(
        rf"largest residual: .* N on interface '\w+' at {place}, (open|stick|slip)", text
    )
    changing = rf"changing: \w+ <-> .* on interface '\w+' at {place}, in \d+ of the last \d+ iter"
    assert len(re.findall(changing, text)) == 3
    (tried,) = [line for line in text.splitlines() if line.startswith("  tried: ")]
    logged = [m.partition("): ")[2] for m in caplog.messages if "not converging" in m]
    # As many as the log lists, and the best of them.
    assert len(logged) > 5
    best = re.search(
        r"tried: (\d+) remedies, of which the best \((.+)\) left a residual of [\d.]+e[-+]\d\d",
        tried,
    )
    assert best and int(best[1]) == len(logged) and best[2] in logged
    assert any(re.fullmatch(r"augmentation 0\.1 r \(up to [\d.e+]+ MPa/mm\)", m) for m in logged)
    assert "what to do: " in text


def test_failure_names_a_lifted_body() -> None:
    pull = "loads={pull: {kind: force, boundary: top, force: [0 N, 0 N, 500 N]}}"
    with pytest.raises(ConvergenceError, match="nothing holds body 'metal'"):
        support.solve(TWO, pull)


def test_failure_names_a_stem_off_its_taper() -> None:
    """From rest and without gaps half the load fails too."""
    finer = "mesh.size=4 mm", "mesh.order=2"
    named = "100 % of it: nothing holds body 'stem': it is free to move along z, and the loads act"
    with pytest.raises(ConvergenceError, match=named) as caught:
        support.solve(support.STEM, *finer, "loads.hip.force=[0 N, 0 N, 2 N]")
    assert "steps of" not in str(caught.value)


@pytest.mark.parametrize(("push", "held"), [(70, True), (90, False)])
def test_failure_body_held_by_friction_is_not_lifted(push: float, held: bool) -> None:
    """200 N press a block on another, with a friction of 0.4."""
    aside = f"loads.aside={{kind: force, boundary: top, force: [{push} N, 0 N, 0 N]}}"
    problem, _ = support.assemble(support.case(TWO, aside))
    problem.set_time(1.0)
    assert problem.contact
    reasons = pulled_off(problem, problem.contact)
    assert held == (not reasons) and all(
        "'metal': it is free to move along x," in f for f in reasons
    )


def test_bodies_on_mesh_only_bonded_interfaces_join_bodies() -> None:
    """A law of a kind yet to come that can open is no bond; one that cannot is."""
    case = support.case(TWO)
    parts = well_posedness.mesh_parts(case, build(case))
    law = SimpleNamespace(can_open=True, gap_field=lambda *_: lambda x: np.full(len(x), 0.1))
    opens = case.model_copy(update={"interfaces": {"bone_metal": law}})
    assert len(groups_of(opens, parts)) == 2
    assert np.allclose(gaps_of(opens, parts)["bone_metal"], 0.1)
    holds = case.model_copy(update={"interfaces": {"bone_metal": SimpleNamespace(can_open=False)}})
    assert len(groups_of(holds, parts)) == 1


def test_checks_supports_of_a_region_with_a_motion() -> None:
    notes = [v.text for v in preview.input_notes(support.case(TWO + MOTION))]
    text = (
        "motions.turn.rotation.cycle_table: all angles are below 0.5 degrees; are they in radians?"
    )
    assert notes == [text]
    (note,) = judged(TWO + MOTION)
    assert (
        note
        == "motions.turn.translation: metal does not move under press: its motion is prescribed"
    )
    with pytest.raises(InputError) as caught:
        judged(TWO + MOTION.replace("metal, boundary: top", "bone, boundary: bottom"))
    assert caught.value.messages[0].startswith(
        "motions.turn.region: bone rotates, but supports hold it (floor)"
    )


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
