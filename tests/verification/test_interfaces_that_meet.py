"""Interfaces that meet on lines and in points: patches, sums, any order in the file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import meshes
from app.foundation.arrays import Floats, Ints
from app.foundation.errors import InputError
from app.results.bond_forces import BondForces
from app.results.stresses import Stresses
from app.scene.scene import build_scene
from meshes import write_msh
from meshes.data import MeshData, interface_facets
from tests import support
from tests.cases.blocks import box
from tests.cases.meeting_blocks import (
    CORNER,
    CROSS,
    EDGE,
    EIGHT,
    LYING_T,
    MODULUS,
    POISSON,
    PRESSURE,
    STRONG,
    THREE_UNDER_ONE,
    T,
    contact,
    press_on_all_sides,
    scene,
)


def check_uniform(solved: support.Solved, data: MeshData) -> None:
    """Each point has the pressure of uniaxial strain, and each interface its whole area."""
    s = solved.last
    assert solved.problem.contact is not None
    surface = solved.problem.contact.points.surface
    normal = surface.normals[:, 0]
    across = np.abs(normal[:, 2]) > 0.5
    sideways = POISSON / (1 - POISSON) * PRESSURE
    # At edges where supports hold both sides nothing is left to the law.
    counts = surface.faces > 0
    np.testing.assert_allclose(s.pressure[across & counts], PRESSURE, rtol=1e-7)
    np.testing.assert_allclose(s.pressure[~across & counts], sideways, rtol=1e-7)
    assert np.abs(s.slip).max() < 1e-9
    assert np.abs(s.motion).max() < 1e-9
    area = sum(n["area"] for n in s.numbers.values())
    facets = np.concatenate([interface_facets(data, name)[0] for name in data.interfaces])
    a, b, c = data.points[facets].transpose(1, 0, 2)
    assert area == pytest.approx(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)
    for numbers in s.numbers.values():
        wanted = min((PRESSURE, sideways), key=lambda p: abs(p - numbers["pressure_mean"]))
        assert numbers["pressure_mean"] == pytest.approx(wanted, rel=1e-7)
        assert np.linalg.norm(numbers["force"]) == pytest.approx(wanted * numbers["area"], rel=1e-7)
    M = MODULUS * (1 - POISSON) / ((1 + POISSON) * (1 - 2 * POISSON))
    for region in data.regions:
        x, u = solved.displacement(region)
        np.testing.assert_allclose(u[:, 2], -PRESSURE / M * x[:, 2], atol=1e-9)


# A row of blocks of one cell each between two plates: all points of its interfaces are on lines.
ROW = {
    "bottom": lambda x: x[:, 2] < 1,
    **{
        f"row{i}": lambda x, i=i: (x[:, 2] > 1) & (x[:, 2] < 2) & (np.floor(x[:, 0]) == i)
        for i in range(4)
    },
    "top": lambda x: x[:, 2] > 2,
}

LAYOUTS = {
    "row": (ROW, (4, 2, 4)),
    "T": (T, (4, 3, 4)),
    "lying T": (LYING_T, (4, 3, 4)),
    "cross": (CROSS, (4, 2, 4)),
    "three under one": (THREE_UNDER_ONE, (4, 2, 4)),
    "eight": (EIGHT, (4, 4, 4)),
    "eight of one cell": (EIGHT, (2, 2, 2)),
    "strip": (THREE_UNDER_ONE, (4, 1, 2)),
}


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("friction", [0.0, 0.35])
def test_interfaces_that_meet_transmit_uniform_pressure(
    layout: str, friction: float, tmp_path: Path
) -> None:
    blocks, cells = LAYOUTS[layout]
    if layout == "strip":  # the middle block has no point but on lines
        blocks = blocks | {"two": lambda x: (x[:, 2] < 2) & (x[:, 0] > 1) & (x[:, 0] < 2)}
        blocks["three"] = lambda x: (x[:, 2] < 2) & (x[:, 0] > 2)
    text = scene(tmp_path, blocks, contact(friction), cells=cells)
    case = support.case(text)
    data = meshes.build(case.geometry, case.mesh)
    check_uniform(support.solve(case), data)


@pytest.mark.parametrize(
    ("order", "linear"), [(1, "condensed"), (1, "direct"), (1, "multigrid"), (2, "condensed")]
)
@pytest.mark.parametrize("skewed", [False, True])
@pytest.mark.parametrize("layout", ["edge", "corner"])
@pytest.mark.parametrize("cells", [(4, 3, 2), (8, 6, 4), (2, 3, 8)])
def test_interfaces_that_meet_transmit_a_pressure_on_each_face(
    cells: Sequence[int], layout: str, skewed: bool, order: int, linear: str, tmp_path: Path
) -> None:
    """Faces of an edge have different pressures at a right angle, otherwise equal ones."""
    blocks = EDGE if layout == "edge" else CORNER
    text = scene(tmp_path, blocks, contact(0.0), cells=cells, order=order)
    data = box(blocks, (4.0, 3.0, 4.0), cells)
    sideways = POISSON / (1 - POISSON) * PRESSURE
    if skewed:
        x, y, z = data.points.T
        y = y + 0.2 * np.interp(y, [0, 1, 2, 3], [0, 1, 0, 0]) * (z - 2)
        data = replace(data, points=np.column_stack([x, y, z]))
        write_msh(data, tmp_path / "blocks.msh")
        press_on_all_sides(text)
        sideways = PRESSURE
    text["solver"] = {"linear": linear}
    s = support.solve(support.case(text)).last
    for i, interface in enumerate(s.interfaces):
        surface, mean = s.surfaces[i], s.tractions[i]["pressure"].mean
        normals = s.all_corners.normals
        wanted = np.where(np.abs(normals[:, :, 2]) > 0.5, PRESSURE, sideways)
        # On the floor a support carries the part of the pressure that is along its axis.
        has_area = (surface._face_area > 0) & (s.x[:, 2] > 0)[:, None]
        assert has_area.any()
        np.testing.assert_allclose(mean[has_area], wanted[has_area], rtol=1e-7)
        numbers = s.numbers[interface.name]
        assert numbers["motion_max"] < 1e-9
        if not skewed:
            assert numbers["pressure_max"] <= PRESSURE * (1 + 1e-7)


BONDED = {"kind": "bonded"}


def blocks_at_random(seed: int) -> tuple[dict[str, Any], tuple[int, int, int]]:
    """Blocks whose cells of 1 mm are nearest to one of 2 to 5 cells, and the numbers of cells."""
    rng = np.random.default_rng(seed)
    nx, ny, nz = rng.integers(2, 4, size=3).tolist()
    seeds = np.unique(rng.integers(0, [nx, ny, nz], size=(rng.integers(2, 6), 3)), axis=0)

    def nearest(x: Floats) -> Ints:
        distances = np.abs(np.floor(x)[:, None] - seeds).sum(axis=2)
        return np.asarray(distances.argmin(axis=1))

    blocks = {f"b{k}": lambda x, k=k: nearest(x) == k for k in range(len(seeds))}
    return blocks, (nx, ny, nz)


@pytest.mark.parametrize("linear", ["condensed", "direct", "multigrid"])
@pytest.mark.parametrize("seed", range(16))
def test_interfaces_that_meet_blocks_at_random_have_uniform_pressure_or_are_refused(
    seed: int, linear: str, tmp_path: Path
) -> None:
    """Blocks of few cells have the same pressure on all sides. Odd seeds have friction."""
    blocks, cells = blocks_at_random(seed)
    if len(blocks) == 1:
        pytest.skip("one block has no interface")
    friction = 0.6 * (seed % 2)
    text = scene(tmp_path, blocks, contact(friction), cells=cells, size=[float(n) for n in cells])
    press_on_all_sides(text)
    text["solver"] = {"linear": linear}
    case = support.case(text)
    try:
        support.assemble(case)
    except InputError as refused:
        assert "use a finer mesh" in str(refused)
        return
    for numbers in support.solve(case).last.numbers.values():
        assert numbers["pressure_mean"] == pytest.approx(PRESSURE, rel=1e-6)
        assert numbers["pressure_max"] == pytest.approx(PRESSURE, rel=1e-6)
        assert numbers["motion_max"] < 1e-8
        if friction:
            assert numbers["shear_max"] < 1e-6 * PRESSURE


@pytest.mark.parametrize("layout", ["T", "cross"])
@pytest.mark.parametrize(
    "laws",
    [
        (contact(0.35), contact(0.0)),
        (contact(0.0), contact(0.0), contact(0.35)),
    ],
)
def test_interfaces_that_meet_transmit_uniform_pressure_with_different_laws(
    layout: str, laws: Sequence[dict[str, Any]], tmp_path: Path
) -> None:
    blocks, cells = LAYOUTS[layout]
    case = support.case(scene(tmp_path, blocks, *laws, cells=cells, order=2))
    check_uniform(support.solve(case), meshes.build(case.geometry, case.mesh))


@pytest.mark.parametrize("order", [1, 2])
def test_interfaces_that_meet_transmit_uniform_pressure_with_cohesive_ones(
    order: int, tmp_path: Path
) -> None:
    """Cohesive layers under the bars of a T close equally; its stem has contact."""
    text = scene(tmp_path, T, STRONG, order=order)
    text["interfaces"]["left_right"] = contact(0.35)
    numbers = support.solve(support.case(text)).last.numbers
    sideways = POISSON / (1 - POISSON) * PRESSURE
    for name, p in (("left_top", PRESSURE), ("right_top", PRESSURE), ("left_right", sideways)):
        assert numbers[name]["area"] == pytest.approx(6.0)
        assert numbers[name]["pressure_mean"] == pytest.approx(p, rel=1e-9)
        assert numbers[name]["pressure_max"] == pytest.approx(p, rel=1e-9)
        assert numbers[name]["shear_max"] < 1e-9


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("bonded", ["left_right", "left_top", "all"])
def test_interfaces_that_meet_bonded_tractions_next_to_contact(
    bonded: str, order: int, tmp_path: Path
) -> None:
    """The bond of a T with contact has the tractions of uniaxial strain, also at the line."""
    text = scene(tmp_path, T, contact(0.35), order=order)
    for name in text["interfaces"] if bonded == "all" else [bonded]:
        text["interfaces"][name] = BONDED
    solved = support.solve(support.case(text))
    sideways = POISSON / (1 - POISSON) * PRESSURE
    bonds = BondForces(solved.problem, Stresses(solved.problem), None).numbers()
    assert {*bonds, *solved.interfaces} == {"left_right", "left_top", "right_top"}
    for name, numbers in bonds.items():
        p = PRESSURE if name.endswith("_top") else sideways
        assert numbers["area"] == pytest.approx(6.0)
        for key in ("normal_mean", "normal_max"):
            assert numbers[key] == pytest.approx(-p, rel=1e-9)
        assert numbers["shear_max"] < 1e-9
    for name, numbers in solved.interfaces.items():
        p = PRESSURE if name.endswith("_top") else sideways
        assert numbers["pressure_mean"] == pytest.approx(p, rel=1e-9)
        assert numbers["pressure_max"] == pytest.approx(p, rel=1e-9)


@pytest.mark.parametrize("springs", [False, True])
def test_interfaces_that_meet_bonded_tractions_at_a_loaded_surface(
    springs: bool, tmp_path: Path
) -> None:
    """Two bonded blocks are between a load and a support or springs. There is no shear."""
    text = scene(tmp_path, {"left": lambda x: x[:, 0] < 2, "right": lambda x: x[:, 0] > 2}, BONDED)
    if springs:
        text["supports"]["z0"] = {
            "kind": "foundation",
            "boundary": "z0",
            "stiffness": "80 MPa/mm",
        }
    solved = support.solve(support.case(text))
    numbers = BondForces(solved.problem, Stresses(solved.problem), None).numbers()["left_right"]
    p = POISSON / (1 - POISSON) * PRESSURE
    assert numbers["normal_max"] == pytest.approx(-p, rel=1e-9)
    assert numbers["normal_mean"] == pytest.approx(-p, rel=1e-9)
    assert numbers["shear_max"] < 1e-9


def test_interfaces_that_meet_stem_of_a_t_depends_on_its_bars(tmp_path: Path) -> None:
    """The jump of the stem follows from those of the bars, for any order in the file."""
    dependent = []
    for turn in range(3):
        case = support.case(scene(tmp_path, T, contact(0.3), turn=turn))
        names = [c.name for c in build_scene(case).parting_interfaces]
        contact_ = support.assemble(case)[0].contact
        assert contact_ is not None
        surface, n = contact_.points.surface, len(contact_.points.vertex)
        dependent.append({names[i] for i in surface.interface[n:]})
    assert dependent == [{"left_right"}] * 3


def test_interfaces_that_meet_are_independent_of_their_order(tmp_path: Path) -> None:
    """A block is pulled off its neighbours, which part.

    Any order and naming gives the same state.
    """
    tables = []
    for turn in range(3):
        text = scene(tmp_path, LYING_T, contact(0.2), cells=(4, 2, 4), turn=turn)
        text["supports"]["x0"] = {"kind": "displacement", "boundary": "x0", "x": "0.01 mm"}
        text["loads"] = {"press": {"kind": "force", "boundary": "z1", "force": "[9 N, 0 N, -40 N]"}}
        solved = support.solve(text, balances=True)
        assert solved.balances.max() < 1e-7
        numbers = solved.last.numbers
        tables.append([numbers[name] for name in sorted(numbers)])
    for other in tables[1:]:
        for one, two in zip(tables[0], other, strict=True):
            assert one["area"] == pytest.approx(two["area"])
            np.testing.assert_allclose(one["force"], two["force"], rtol=1e-6, atol=1e-7)
            assert one["pressure_mean"] == pytest.approx(two["pressure_mean"], rel=1e-6, abs=1e-8)


def test_interfaces_that_meet_break_on_their_whole_area(tmp_path: Path) -> None:
    """Bonded blocks are below one that is pulled off. The energy is that of both interfaces."""
    bond = {
        "kind": "cohesive",
        "friction_coefficient": 0,
        "stiffness": "5000 MPa/mm",
        "tensile_strength": "8 MPa",
        "shear_strength": "8 MPa",
        "tensile_energy": "0.3 N/mm",
        "shear_energy": "0.3 N/mm",
    }
    text = scene(tmp_path, T, bond)
    text["interfaces"]["left_right"] = {"kind": "bonded"}
    text["supports"] = {
        "floor": {"kind": "fixed", "boundary": "z0"},
        "pull": {"kind": "displacement", "boundary": "z1"}
        | {"x": "0 mm", "y": "0 mm", "z": "0.2 mm"},
    }
    text["loads"] = {}
    text["stages"] = [{"name": "pull", "increments": 20}]
    solved = support.solve(text)
    numbers = solved.last.numbers
    for name in ("left_top", "right_top"):
        assert numbers[name]["area"] == pytest.approx(6.0)
        assert numbers[name]["area_broken"] == pytest.approx(6.0)
        assert numbers[name]["dissipation"] == pytest.approx(6.0 * 0.3, rel=1e-6)


HELD_AND_PUSHED = """
geometry: {kind: blocks, blocks: [{name: low, size: [6 mm, 6 mm, 3 mm]},
                                  {name: high, size: [6 mm, 6 mm, 3 mm]}]}
mesh: {order: 1, size: 3 mm}
regions:
  low: {youngs_modulus: 900 MPa, poisson_ratio: 0, tissue: other}
  high: {youngs_modulus: 900 MPa, poisson_ratio: 0, tissue: other}
interfaces: {low_high: {kind: contact, friction_coefficient: 0.25}}
supports:
  floor: {kind: fixed, boundary: bottom}
  held: {kind: roller, boundary: low_x_min, axis: x}
  push: {kind: displacement, boundary: high_x_min, x: 0.09 mm, history: [0, 1, -1]}
loads: {press: {kind: pressure, boundary: top, pressure: 4 MPa}}
stages: [{name: press}, {name: push, increments: 2}, {name: back, increments: 2}]
"""


def test_interfaces_that_meet_have_friction_where_slip_is_prescribed() -> None:
    """All points slide forward and back.

    Friction acts on the whole area, and energy is in balance.
    """
    solved = support.solve(HELD_AND_PUSHED, balances=True)
    whole = 0.25 * 4 * 36
    for step, sign in ((2, -1.0), (4, 1.0)):
        numbers = solved.samples[step].numbers["low_high"]
        np.testing.assert_allclose(numbers["force"], [sign * whole, 0, 144], rtol=1e-6, atol=1e-4)
        assert numbers["slip_fraction"] == 1.0
    assert solved.balances.max() < 1e-9


def test_interfaces_that_meet_friction_with_two_prescribed_components() -> None:
    """Both sides push along the diagonal. The sum has the size of friction."""
    other = "{kind: displacement, boundary: high_y_min, y: 0.09 mm, history: [0, 1, -1]}"
    solved = support.solve(
        HELD_AND_PUSHED,
        "supports.beside={kind: roller, boundary: low_y_min, axis: y}",
        f"supports.other={other}",
        balances=True,
    )
    numbers = solved.samples[2].numbers["low_high"]
    assert np.linalg.norm(numbers["force"][:2]) == pytest.approx(36.0, rel=1e-3)
    assert numbers["force"][0] == pytest.approx(numbers["force"][1], rel=0.05)
    assert solved.balances.max() < 1e-9


@pytest.mark.parametrize("layout", ["T", "three under one"])
def test_interfaces_that_meet_block_slides_on_several_blocks(layout: str, tmp_path: Path) -> None:
    blocks, cells = LAYOUTS[layout]
    text = scene(tmp_path, blocks, contact(0.3), cells=cells, turn=1)
    top = text["supports"].pop("x1")
    text["supports"]["x0"] = top | {"boundary": "low_x0"}
    text["supports"]["x1"] = top | {"boundary": "low_x1"}
    text["supports"]["push"] = {
        "kind": "displacement",
        "boundary": "top_x0",
        "x": "0.06 mm",
        "history": [0, 1],
    }
    text["stages"] = [{"name": "press"}, {"name": "push", "increments": 3}]
    solved = support.solve(text, balances=True)
    forces = {name: n["force"] for name, n in solved.last.numbers.items() if name.endswith("_top")}
    total = np.sum(list(forces.values()), axis=0)
    assert abs(total[0]) == pytest.approx(0.3 * PRESSURE * 12, rel=1e-5)
    assert abs(total[2]) == pytest.approx(PRESSURE * 12, rel=1e-9)
    assert solved.balances.max() < 1e-8


def test_interfaces_that_meet_body_is_free_next_to_held_bodies(tmp_path: Path) -> None:
    """A block slides along two blocks with held ends.

    Contact is frictionless, so the line does not hold it.
    """
    text = scene(tmp_path, T, contact(0.0))
    del text["supports"]["y0"], text["supports"]["y1"]
    text["supports"]["ends"] = {"kind": "roller", "boundary": "low_y0", "axis": "y"}
    text["supports"]["draw"] = {"kind": "displacement", "boundary": "top_y1", "y": "0.05 mm"}
    solved = support.solve(text, balances=True)
    numbers = solved.last.numbers
    for name in ("left_top", "right_top"):
        np.testing.assert_allclose(numbers[name]["pressure_max"], PRESSURE, rtol=1e-7)
        np.testing.assert_allclose(numbers[name]["pressure_mean"], PRESSURE, rtol=1e-7)
        assert abs(numbers[name]["force"][1]) < 1e-8
    assert numbers["left_right"]["pressure_max"] == pytest.approx(POISSON * PRESSURE)
    x, u = solved.displacement("top")
    widening = POISSON * (1 + POISSON) * PRESSURE / MODULUS
    np.testing.assert_allclose(u[:, 1], 0.05 + widening * (x[:, 1] - 3), atol=1e-9)
    assert solved.balances.max() < 1e-8


@pytest.mark.parametrize("order", [1, 2])
def test_interfaces_that_meet_block_on_rigid_floor_with_symmetry(order: int) -> None:
    """A support of the floor holds its vertices, too, and the block bears the pressure."""
    text = f"""
geometry:
  kind: blocks
  blocks: [{{name: floor, size: [6 mm, 8 mm, 3 mm]}}, {{name: block, size: [6 mm, 8 mm, 4 mm]}}]
mesh: {{size: 2 mm, order: {order}}}
regions:
  floor: {{rigid: true}}
  block: {{youngs_modulus: 700 MPa, poisson_ratio: 0.35, tissue: other}}
interfaces: {{floor_block: {{kind: contact, friction_coefficient: 0}}}}
supports:
  floor: {{kind: displacement, boundary: bottom, x: 0.01 mm, y: 0 mm, z: 0 mm}}
  sym: {{kind: roller, boundary: block_x_min, axis: x}}
  mid: {{kind: roller, boundary: block_y_min, axis: y}}
loads: {{press: {{kind: pressure, boundary: top, pressure: 1.7 MPa}}}}
"""
    solved = support.solve(text, balances=True)
    assert np.abs(solved.last.pressure - 1.7).max() < 1e-9
    assert np.abs(solved.stress("block") - np.diag([0, 0, -1.7])).max() < 1e-9
    _, u = solved.displacement("floor")
    np.testing.assert_allclose(u, np.broadcast_to([0.01, 0, 0], u.shape), atol=1e-14)
    x, u = solved.displacement("block")
    exact = 1.7 / 700 * x * [0.35, 0.35, -1] + [0, 0, 1.7 / 700 * 3]
    np.testing.assert_allclose(u, exact, atol=1e-12)
    assert solved.balances.max() < 1e-8


def test_interfaces_that_meet_refuse_two_free_rigid_regions_at_a_line(tmp_path: Path) -> None:
    """Opposite blocks of a cross are rigid. Only one rigid region can be the base of the others."""
    text = scene(tmp_path, CROSS, contact(0.3), cells=(4, 2, 4))
    text["regions"]["a"] = text["regions"]["d"] = {"rigid": True, "tissue": "other"}
    with pytest.raises(InputError, match=r"two rigid regions .* meet a third body at \(2, "):
        support.solve(support.case(text))
    text["regions"]["d"] = dict(text["regions"]["b"])
    assert support.solve(support.case(text)).last.pressure.max() > 0


ON_RANKS = """
import json, sys
from pathlib import Path
from mpi4py import MPI
sys.path.insert(0, {root!r})
from tests import support
from tests.cases.blocks import Blocks, box
from tests.verification.test_interfaces_that_meet import BONDED, T, contact, scene
folder = Path({folder!r})
text = scene(folder, T, contact(0.2), contact(0.35), order=2) if MPI.COMM_WORLD.rank == 0 else None
solved = support.solve(support.case(MPI.COMM_WORLD.bcast(text)), balances=True)
keys = ("area", "pressure_mean", "pressure_max")
numbers = {{name: [q[k] for k in keys] for name, q in solved.last.numbers.items()}}
if MPI.COMM_WORLD.rank == 0:
    (folder / "numbers.json").write_text(json.dumps(numbers))
"""


@pytest.mark.parallel
@pytest.mark.parametrize("ranks", [2, 3])
def test_interfaces_that_meet_transmit_uniform_pressure_on_ranks(
    ranks: int, tmp_path: Path
) -> None:
    program = tmp_path / "program.py"
    program.write_text(ON_RANKS.format(root=str(support.ROOT), folder=str(tmp_path)))
    support.on_ranks(ranks, program)
    numbers = json.loads((tmp_path / "numbers.json").read_text())
    sideways = POISSON / (1 - POISSON) * PRESSURE
    for name, p in (("left_top", PRESSURE), ("right_top", PRESSURE), ("left_right", sideways)):
        assert numbers[name] == pytest.approx([6.0, p, p], rel=1e-9)
