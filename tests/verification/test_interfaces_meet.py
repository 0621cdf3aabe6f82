r"""Interfaces that meet at lines and corners, and points that supports hold in one component.

In a smooth box under a pressure p all stresses are uniform, :math:`σ_{zz} = -p` and
:math:`σ_{xx} = σ_{yy} = -p ν / (1 - ν)`, whatever interfaces divide it.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import combinations, product
from pathlib import Path

import numpy as np
import pytest

from app.case.gmsh_header import ALLOWED
from app.scene.scene import build_scene
from tests import support

PRESSURE = 3.0
ν = 0.2
TOLERANCE = 1e-9
# Edges of the boxes along x, y, z [mm].
SIZES = ((4.0, 3.0), (5.0, 4.0), (3.0, 4.0))
COULOMB = "{kind: contact, friction_coefficient: 0.3}"
SMOOTH = "{kind: contact, friction_coefficient: 0}"
COHESIVE = (
    "{kind: cohesive, friction_coefficient: 0, stiffness: 2e4 MPa/mm, tensile_strength: 8 MPa,"
    " shear_strength: 8 MPa, tensile_energy: 0.3 N/mm, shear_energy: 0.3 N/mm}"
)
Box = tuple[tuple[float, float], ...]


def grid(nx: int, ny: int, nz: int) -> dict[str, Box]:
    """Boxes of a grid, by name."""
    ends = [
        np.concatenate([[0.0], np.cumsum(s[:n])]) for s, n in zip(SIZES, (nx, ny, nz), strict=True)
    ]
    return {
        f"b{i}{j}{k}": tuple(
            (float(e[m]), float(e[m + 1])) for e, m in zip(ends, (i, j, k), strict=True)
        )
        for i, j, k in product(range(nx), range(ny), range(nz))
    }


def three() -> dict[str, Box]:
    """Two boxes side by side and one on both."""
    return {
        "left": ((0, 4), (0, 6), (0, 3)),
        "right": ((4, 9), (0, 6), (0, 3)),
        "top": ((0, 9), (0, 6), (3, 8)),
    }


def touching(boxes: dict[str, Box]) -> list[tuple[str, str]]:
    """Pairs of boxes with a common face."""
    pairs = []
    for (a, x), (b, y) in combinations(boxes.items(), 2):
        overlap = [min(p[1], q[1]) - max(p[0], q[0]) for p, q in zip(x, y, strict=True)]
        if sum(o > 1e-9 for o in overlap) == 2 and min(overlap) > -1e-9:
            pairs.append((a, b))
    return pairs


def write(folder: Path, boxes: dict[str, Box]) -> None:
    """Write a gmsh script of the boxes with the six sides of all."""
    lines = ['SetFactory("OpenCASCADE");', "DefineConstant[ size = 2 ];"]
    for k, box in enumerate(boxes.values(), 1):
        low = ", ".join(str(c[0]) for c in box)
        edge = ", ".join(str(c[1] - c[0]) for c in box)
        lines.append(f"Box({k}) = {{{low}, {edge}}};")
    lines.append("Coherence;")
    e = 1e-3
    for name, box in boxes.items():
        low, high = ([c[s] + d for c in box] for s, d in ((0, -e), (1, e)))
        where = ", ".join(map(str, (*low, *high)))
        lines.append(f'Physical Volume("{name}") = Volume In BoundingBox{{{where}}};')
    ends = [
        (min(b[i][0] for b in boxes.values()), max(b[i][1] for b in boxes.values()))
        for i in range(3)
    ]
    for i, axis in enumerate("xyz"):
        for side, at in zip(("min", "max"), ends[i], strict=True):
            low = [c[0] - e for c in ends]
            high = [c[1] + e for c in ends]
            low[i], high[i] = at - e, at + e
            where = ", ".join(map(str, (*low, *high)))
            lines.append(f'Physical Surface("{axis}_{side}") = Surface In BoundingBox{{{where}}};')
    lines.append("MeshSize{:} = size;")
    (folder / "boxes.geo").write_text("\n".join(lines))


def smooth_box(
    folder: Path, boxes: dict[str, Box], laws: Sequence[str], order: int, size: float = 2.0
) -> support.Solved:
    """Solve a smooth box of boxes under a pressure; laws are taken in turn."""
    write(folder, boxes)
    pairs = touching(boxes)
    sides = ", ".join(f"{a}_{b}: [{a}, {b}]" for a, b in pairs)
    of = "".join(f"  {a}_{b}: {laws[k % len(laws)]}\n" for k, (a, b) in enumerate(pairs))
    material = f"{{youngs_modulus: 900 MPa, poisson_ratio: {ν}, tissue: other}}"
    text = f"""
geometry: {{kind: file, path: {folder / "boxes.geo"}, interfaces: {{{sides}}}}}
mesh: {{size: {size} mm, order: {order}}}
regions: {{{", ".join(f"{name}: {material}" for name in boxes)}}}
interfaces:
{of}supports:
  bottom: {{kind: roller, boundary: z_min, axis: z}}
  x0: {{kind: roller, boundary: x_min, axis: x}}
  x1: {{kind: roller, boundary: x_max, axis: x}}
  y0: {{kind: roller, boundary: y_min, axis: y}}
  y1: {{kind: roller, boundary: y_max, axis: y}}
loads: {{press: {{kind: pressure, boundary: z_max, pressure: {PRESSURE} MPa}}}}
solver: {{tolerance: 1.0e-13}}
"""
    return support.solve(text, balances=True)


def check(solved: support.Solved, boxes: dict[str, Box]) -> None:
    """Uniform stress and pressure, all areas, no slip, and forces in balance."""
    side = PRESSURE * ν / (1 - ν)
    for name in boxes:
        exact = -np.diag([side, side, PRESSURE])
        assert np.abs(solved.stress(name) - exact).max(initial=0.0) < TOLERANCE * PRESSURE, name
    for a, b in touching(boxes):
        overlap = [
            min(p[1], q[1]) - max(p[0], q[0]) for p, q in zip(boxes[a], boxes[b], strict=True)
        ]
        axis = int(np.argmin(overlap))
        area = float(np.prod(np.delete(overlap, axis)))
        p = PRESSURE if axis == 2 else side
        q = solved.interfaces[f"{a}_{b}"]
        assert q["area"] == pytest.approx(area, rel=1e-12)
        assert q["pressure_mean"] == pytest.approx(p, rel=TOLERANCE)
        assert q["pressure_max"] == pytest.approx(p, rel=TOLERANCE)
        assert np.linalg.norm(q["force"]) == pytest.approx(p * area, rel=TOLERANCE)
        assert q["slip_max"] < 1e-9
        assert q["penetration_sampled"] < 1e-9
    assert solved.balances.max() < 1e-8


@pytest.fixture(autouse=True)
def _scripts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(ALLOWED, "1")


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("laws", [(COULOMB,), (SMOOTH,), (COULOMB, SMOOTH)])
def test_three_bodies_on_a_line(laws: Sequence[str], order: int, tmp_path: Path) -> None:
    check(smooth_box(tmp_path, three(), laws, order), three())


@pytest.mark.parametrize("laws", [(COULOMB,), (SMOOTH,), (COULOMB, SMOOTH, SMOOTH)])
def test_four_bodies_on_a_line(laws: Sequence[str], tmp_path: Path) -> None:
    boxes = grid(2, 1, 2)
    check(smooth_box(tmp_path, boxes, laws, 1), boxes)


@pytest.mark.parametrize("size", [pytest.param(2.0, marks=pytest.mark.slow), 6.0])
def test_twelve_interfaces_in_a_point(size: float, tmp_path: Path) -> None:
    """Eight boxes; of the larger size each has one cell along its edges."""
    boxes = grid(2, 2, 2)
    check(smooth_box(tmp_path, boxes, (COULOMB,), 1, size), boxes)


def test_dependent_interfaces_do_not_follow_the_order_of_the_file(tmp_path: Path) -> None:
    """The stem of a T is dependent, whatever the order of the interfaces."""
    write(tmp_path, three())
    pairs = touching(three())
    found = []
    for some in (pairs, pairs[::-1]):
        sides = ", ".join(f"{a}_{b}: [{a}, {b}]" for a, b in some)
        case = support.case(
            f"""
geometry: {{kind: file, path: {tmp_path / "boxes.geo"}, interfaces: {{{sides}}}}}
mesh: {{size: 2 mm, order: 1}}
regions:
  left: &m {{youngs_modulus: 900 MPa, poisson_ratio: 0.2, tissue: other}}
  right: *m
  top: *m
interfaces: {{{", ".join(f"{a}_{b}: {COULOMB}" for a, b in some)}}}
supports: {{floor: {{kind: fixed, boundary: z_min}}}}
"""
        )
        names = [c.name for c in build_scene(case).contacts]
        points = support.assemble(case)[0].contact.points
        n = len(points.vertex)
        found.append(
            {
                (names[i], int(v))
                for i, v in zip(
                    points.surface.interface[n:], points.surface.vertex[n:], strict=True
                )
            }
        )
    assert found[0] == found[1]
    assert {name for name, _ in found[0]} == {"left_right"}


def test_fracture_energy_of_two_interfaces_is_that_of_their_area(tmp_path: Path) -> None:
    """Two bonded boxes are pulled off a third: area times energy, over a shared edge."""
    boxes = three()
    write(tmp_path, boxes)
    sides = ", ".join(f"{a}_{b}: [{a}, {b}]" for a, b in touching(boxes))
    solved = support.solve(
        f"""
geometry: {{kind: file, path: {tmp_path / "boxes.geo"}, interfaces: {{{sides}}}}}
mesh: {{size: 2 mm, order: 1}}
regions:
  left: &m {{youngs_modulus: 900 MPa, poisson_ratio: 0.2, tissue: other}}
  right: *m
  top: *m
interfaces:
  left_right: {{kind: bonded}}
  left_top: {COHESIVE}
  right_top: {COHESIVE}
supports:
  floor: {{kind: fixed, boundary: z_min}}
  lid: {{kind: displacement, boundary: z_max, x: 0 mm, y: 0 mm, z: 0.12 mm}}
stages: [{{name: pull, increments: 20}}]
""",
        balances=True,
    )
    for name, area in (("left_top", 24.0), ("right_top", 30.0)):
        q = solved.interfaces[name]
        assert q["area"] == pytest.approx(area, rel=1e-12)
        assert q["dissipation"] == pytest.approx(0.3 * area, rel=1e-9)
        assert q["area_broken"] == pytest.approx(area, rel=1e-12)
    assert solved.balances.max() < 1e-8


HELD = """
geometry:
  kind: blocks
  blocks: [{{name: lower, size: [8 mm, 6 mm, 4 mm]}}, {{name: upper, size: [8 mm, 6 mm, 4 mm]}}]
mesh: {{size: 2 mm, order: {order}}}
regions:
  lower: {{youngs_modulus: 900 MPa, poisson_ratio: 0, tissue: other}}
  upper: {{youngs_modulus: 900 MPa, poisson_ratio: 0, tissue: other}}
interfaces: {{lower_upper: {{kind: contact, friction_coefficient: {friction}}}}}
supports:
  floor: {{kind: fixed, boundary: bottom}}
  held: {{kind: roller, boundary: lower_x_min, axis: x}}
  push: {{kind: displacement, boundary: upper_x_min, x: 0.08 mm, history: {history}}}
loads: {{press: {{kind: pressure, boundary: top, pressure: 1.5 MPa}}}}
stages: {stages}
"""


@pytest.mark.parametrize(
    ("order", "friction", "history"),
    [(1, 0.25, [0, 1]), (2, 0.25, [0, 1]), (1, 0.6, [0, 1]), (1, 0.25, [0, 1, -1])],
)
def test_points_held_in_one_component_rub_in_it(
    order: int, friction: float, history: Sequence[int]
) -> None:
    """The upper block slides as a whole: friction is that of all of its weight, there and back."""
    stages = ", ".join(f"{{name: s{k}, increments: 2}}" for k in range(len(history)))
    text = HELD.format(order=order, friction=friction, history=list(history), stages=f"[{stages}]")
    solved = support.solve(text, balances=True)
    q = solved.interfaces["lower_upper"]
    # Points beside the held ones slide a little along y.
    assert q["force"][0] == pytest.approx(-np.sign(history[-1]) * friction * 72.0, rel=1e-5)
    assert q["stick_fraction"] == 0
    assert q["slip_fraction"] == 1
    assert solved.balances.max() < 1e-8


@pytest.mark.parametrize("order", [1, 2])
def test_block_on_a_rigid_floor_with_a_plane_of_symmetry(order: int) -> None:
    """The floor is held elsewhere: its vertices are held, too, and the block bears the pressure."""
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


ON_RANKS = """
import json, os, sys
from pathlib import Path
from mpi4py import MPI
sys.path.insert(0, {root!r})
os.environ["MANTLE_ALLOW_SCRIPTS"] = "1"
from tests.verification.test_interfaces_meet import COULOMB, check, smooth_box, three
solved = smooth_box(Path({folder!r}), three(), (COULOMB,), 2)
check(solved, three())
numbers = {{k: [q["area"], q["pressure_mean"], *q["force"]] for k, q in solved.interfaces.items()}}
if MPI.COMM_WORLD.rank == 0:
    Path({folder!r}, "numbers.json").write_text(json.dumps(numbers))
"""


@pytest.mark.parallel
@pytest.mark.parametrize("ranks", [2, 3])
def test_three_bodies_on_ranks(ranks: int, tmp_path: Path) -> None:
    """The same uniform state at second order, whoever has which cells."""
    program = tmp_path / "program.py"
    program.write_text(ON_RANKS.format(root=str(support.ROOT), folder=str(tmp_path)))
    support.on_ranks(ranks, program)
    assert len(json.loads((tmp_path / "numbers.json").read_text())) == 3
