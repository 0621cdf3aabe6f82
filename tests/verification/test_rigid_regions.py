"""Rigid regions are the limit of stiff ones; their motions, supports and friction."""

from __future__ import annotations

import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest

from app.foundation.errors import InputError
from app.mechanics.constraints import _constrained_motions
from app.numerics.rigid_motions import rigid_modes
from tests import support

CYLINDERS = (
    support.STEM.replace("length: 20 mm", "length: 30 mm")
    .replace("size: 5 mm", "size: 4 mm")
    .replace("[300 N, 0 N, -900 N]", "[150 N, -80 N, -900 N]")
)


def test_rigid_regions_is_the_limit_of_a_stiff_one() -> None:
    """Gap, slip and pressure approach those of a rigid stem in proportion to 1/E."""

    def fields(stem: str) -> list[np.ndarray]:
        tilting = "loads.hip.force=[900 N, -480 N, -900 N]"  # some points open
        last = support.solve(CYLINDERS, f"regions.stem={stem}", tilting).last
        assert last.gap.max() > 1e-3
        return [last.gap, last.slip, last.pressure]

    rigid = fields("{rigid: true}")
    errors = []
    for modulus in ("1e7 MPa", "1e8 MPa"):
        stiff = fields(f"{{youngs_modulus: {modulus}, poisson_ratio: 0.3}}")
        errors.append(
            [np.abs(a - b).max() / np.abs(b).max() for a, b in zip(stiff, rigid, strict=True)]
        )
    assert max(errors[1]) < 1e-3
    np.testing.assert_allclose(np.array(errors[0]) / np.array(errors[1]), 10, rtol=0.1)


PUSHED = "x: 0 mm, y: 0 mm, z: -0.05 mm"
TURNED = "x: 0 mm, y: '-1e-3 * z', z: '0.02 + 1e-3 * y'"


@pytest.mark.parametrize(
    ("ends", "given", "turn", "shift"),
    [(["top"], PUSHED, 0.0, -0.05), (["top", "bottom"], TURNED, 1e-3, 0.02)],
    ids=["pushed by its top", "turned about x and lifted by both ends"],
)
def test_rigid_regions_has_the_prescribed_motion(
    ends: list[str], given: str, turn: float, shift: float
) -> None:
    """The region moves by exactly this motion. Its force is that of the supports."""
    holds = [
        f"supports.{end}={{kind: displacement, boundary: stem_{end}, {given}}}" for end in ends
    ]
    stem = ("regions.stem={rigid: true}", "loads={}")
    solved = support.solve(CYLINDERS, *stem, *holds, balances=True)
    x, u = solved.displacement("stem")
    exact = np.stack([0 * x[:, 0], -turn * x[:, 2], shift + turn * x[:, 1]], axis=1)
    np.testing.assert_allclose(u, exact, atol=1e-12)
    assert solved.balances.max() < 1e-8


def test_rigid_regions_impossible_motion_is_refused() -> None:
    """The two ends cannot be pulled apart, and one end cannot bend."""
    stem = (CYLINDERS, "regions.stem={rigid: true}", "loads={}")
    up = "supports.up={kind: displacement, boundary: stem_top, z: 0.05 mm}"
    with pytest.raises(InputError, match=r"supports\.up, down: .*rigid motion"):
        support.solve(
            *stem, up, "supports.down={kind: displacement, boundary: stem_bottom, z: -0.05 mm}"
        )
    with pytest.raises(InputError, match=r"supports\.up: .*rigid motion"):
        support.solve(*stem, up.replace("0.05 mm", "1e-3 * x**2"))


# A rigid punch above a block, on rollers that hold both where they touch: confined compression.
PUNCH = """
geometry: {kind: blocks, blocks: [{name: block, size: [4 mm, 4 mm, 3 mm]},
                                  {name: punch, size: [4 mm, 4 mm, 2 mm]}]}
mesh: {order: 1, size: 2 mm}
regions:
  block: {youngs_modulus: 2200 MPa, poisson_ratio: 0.3}
  punch: {rigid: true}
interfaces:
  block_punch: {kind: contact, friction_coefficient: 0}
supports:
  floor: {kind: roller, boundary: bottom, axis: z}
  x0: {kind: roller, boundary: x_min, axis: x}
  x1: {kind: roller, boundary: x_max, axis: x}
  y0: {kind: roller, boundary: y_min, axis: y}
  y1: {kind: roller, boundary: y_max, axis: y}
loads:
  push: {kind: force, boundary: top, force: [0 N, 0 N, -32 N]}
"""


def test_rigid_regions_supports_may_hold_both_sides() -> None:
    """The order of the regions does not matter. Here the rigid one is last."""
    solved = support.solve(PUNCH, balances=True)
    np.testing.assert_allclose(solved.last.pressure, 2.0, rtol=1e-9)
    _, u = solved.displacement("punch")
    confined = 2200 * 0.7 / (1.3 * 0.4)
    exact = np.broadcast_to([0, 0, -2.0 / confined * 3], u.shape)
    np.testing.assert_allclose(u, exact, atol=1e-12)
    assert solved.balances.max() < 1e-8


def test_rigid_regions_refuses_support_of_the_elastic_side_alone() -> None:
    words = (
        r"^supports\.x0: holds along x a body that touches the rigid region 'punch' at \(0, .* 3\)"
    )
    with pytest.raises(InputError, match=words):
        support.solve(
            PUNCH,
            "supports.x0.boundary=block_x_min",
            "supports.x1.boundary=block_x_max",
        )
    # Held elsewhere, the region is held where the block touches it.
    solved = support.solve(
        PUNCH,
        "supports.x0.boundary=block_x_min",
        "supports.pin={kind: roller, boundary: top, axis: x}",
    )
    np.testing.assert_allclose(solved.last.pressure, 2.0, rtol=1e-9)


FLOOR = """
geometry: {kind: blocks, blocks: [{name: floor, size: [6 mm, 6 mm, 2 mm]},
                                  {name: block, size: [6 mm, 6 mm, 4 mm]}]}
mesh: {order: 1, size: 2 mm}
regions:
  floor: {rigid: true}
  block: {youngs_modulus: 800 MPa, poisson_ratio: 0.25, tissue: other}
interfaces:
  floor_block: {kind: contact, friction_coefficient: 0}
supports:
  floor: {kind: fixed, boundary: bottom}
  sym: {kind: roller, boundary: block_x_min, axis: x}
  back: {kind: roller, boundary: block_y_min, axis: y}
loads:
  press: {kind: pressure, boundary: top, pressure: 3 MPa}
"""


def test_rigid_regions_floor_below_a_symmetric_block() -> None:
    """Stress is uniaxial, on a floor at rest and on a moving one."""
    moves = "supports.floor={kind: displacement, boundary: bottom, x: 0 mm, y: 0 mm, z: 0.02 mm}"
    for lift, change in ((0.0, "mesh.order=1"), (0.02, moves), (0.02, "mesh.order=2")):
        changes = {change, moves} if lift else {change}
        solved = support.solve(FLOOR, *changes, balances=True)
        np.testing.assert_allclose(solved.last.pressure, 3.0, rtol=1e-9)
        assert solved.balances.max() < 1e-8
        x, u = solved.displacement("block")
        exact = 3.0 / 800 * (x - [0, 0, 2]) * [0.25, 0.25, -1] + [0, 0, lift]
        np.testing.assert_allclose(u, exact, atol=1e-11)


def test_rigid_regions_friction_equals_that_of_a_stiff_one() -> None:
    """Friction acts against the widening of the block. Then the block is pushed over the floor."""
    push = (
        "interfaces.floor_block.friction_coefficient=0.3",
        "supports.sym={kind: displacement, boundary: block_x_min, x: 0.03 mm, history: [0, 1]}",
        "stages=[{name: press}, {name: push, increments: 2}]",
    )
    stiff = "regions.floor={youngs_modulus: 1e10 MPa, poisson_ratio: 0.25, tissue: other}"
    one, two = support.solve(FLOOR, *push), support.solve(FLOOR, *push, stiff)
    for a, b in zip(one.samples, two.samples, strict=True):
        np.testing.assert_allclose(a.pressure, b.pressure, rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(a.slip, b.slip, rtol=1e-4, atol=1e-6)


def test_rigid_regions_many_held_nodes_take_little_memory() -> None:
    """Six motions are compatible with 3 000 held components.

    No matrix has 3 000 by 3 000 entries.
    """
    random = np.random.default_rng(2)
    nodes = random.normal(size=(1000, 3))
    rows = rigid_modes(nodes).reshape(-1, 6)
    motion = random.normal(size=6)
    scene = SimpleNamespace(supports=[SimpleNamespace(history=(1.0,), name="held")])
    tracemalloc.start()
    basis, rank, (amounts,) = _constrained_motions(scene, "region", rows, [rows @ motion])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert rank == 6
    np.testing.assert_allclose(basis @ amounts, motion, rtol=1e-9)
    assert peak < 20 * rows.nbytes
    # A roller on one node leaves five motions, and the basis says which.
    basis, rank, _ = _constrained_motions(scene, "region", rows[:1], [np.zeros(1)])
    assert rank == 1 and np.abs(rows[:1] @ basis[:, 1:]).max() < 1e-12
