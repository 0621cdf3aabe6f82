"""Bodies that share no facet: accepted, refused and noted; friction of a drawn block."""

from __future__ import annotations

import math
from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest

from app.foundation.errors import ConvergenceError, InputError
from app.soundness import well_posedness
from meshes import build
from meshes.distribute import distribute
from tests import support
from tests.cases.separate_bodies import ball_in_cup, block_under_plate, drawn_block

BALL = ball_in_cup()
BLOCK = block_under_plate()
BALL_TURNS = """motions={ball: {region: head, about: head_centre, rotation: {axes: yxz, cycle_table:
["time [s], rotation y [deg]", "0, 0", "1, 25"]}}}"""
BALL_WITHOUT_FRICTION = "interfaces.bearing.friction_coefficient=0"
LINER_SLIDES_IN_SHELL = """.liner_shell={kind: contact, friction_coefficient: 0.1, sliding: finite,
between: [liner_rim, shell_outer]}"""
BLOCK_SLIDES_ON_PLATE_BELOW = """interfaces.d={kind: contact, friction_coefficient: 0,
  sliding: finite, between: [block_bottom, plate_top]}"""


def judged(text: str, *overrides: str) -> list[str]:
    """Notes on a case on its mesh."""
    case = support.case(text, *overrides)
    parts = well_posedness.mesh_parts(case, build(case.geometry, case.mesh))
    return [v.text for v in well_posedness.check_on_mesh(case, parts)]


def test_well_posedness_sliding_ball_and_cup_have_nodes_at_one_place() -> None:
    """The poles of both spheres coincide, because the clearance is zero."""
    case = support.case(BALL)
    assert well_posedness.mesh_parts(case, build(case.geometry, case.mesh)).doubled


def test_well_posedness_sliding_holds_a_body_with_coincident_nodes() -> None:
    assert judged(BALL) == []
    assert judged(BLOCK) == []


def test_well_posedness_sliding_rigid_body_needs_a_motion() -> None:
    with pytest.raises(
        InputError, match=r"^interfaces\.b: the rotation of the rigid plate is not given"
    ):
        judged(BLOCK, "motions={}")
    held = "supports.top={kind: fixed, boundary: plate_top}"
    assert judged(BLOCK, "motions={}", held) == []
    assert judged(BALL, BALL_WITHOUT_FRICTION, BALL_TURNS) == []


@pytest.mark.parametrize(
    ("text", "change", "error"),
    [
        (BALL, "={}", "bearing: no facet between head and liner; .*`sliding: finite`"),
        (BLOCK, ".b={kind: bonded}", "b: no facet between plate and block"),
        (BLOCK, ".b.between=[plate_bottom, plate_top]", "b.between: .* plate; .* block only"),
        (
            ball_in_cup(shell=True),
            LINER_SLIDES_IN_SHELL,
            "liner_shell.sliding: liner and shell share [0-9]+ facets",
        ),
    ],
)
def test_well_posedness_sliding_refuses_interfaces_that_do_not_fit(
    text: str, change: str, error: str
) -> None:
    with pytest.raises(InputError, match=rf"^interfaces\.{error}"):
        judged(text, f"interfaces{change}")


def test_well_posedness_sliding_refuses_supports_on_its_nodes() -> None:
    """A support is at the rim of a liner, or two boundaries have the same nodes."""
    rim = r"^supports.rim: 36 nodes of liner_inner, .* mm, are constrained twice: here and by the "
    rim += "finite sliding of interfaces.bearing;"
    with pytest.raises(InputError, match=rim):
        judged(BALL, "supports.rim={kind: fixed, boundary: liner_rim}")
    both = block_under_plate("b: [plate, block], d: [block, plate]")
    case = support.case(both, BLOCK_SLIDES_ON_PLATE_BELOW)
    data = build(case.geometry, case.mesh)
    tags = data.boundaries["block_bottom"] + data.boundaries["block_top"]
    joined = replace(data, boundaries={**data.boundaries, "block_bottom": tags})
    with pytest.raises(InputError, match=r"interfaces.d: .* nodes of block_top,.* interfaces.b;"):
        well_posedness.check_on_mesh(case, well_posedness.mesh_parts(case, joined))


def drawn(*overrides: str, plate: float = 0.0, step: float = 0.0) -> support.Solved:
    """Draw the block, whose top is lower at both ends, with the plate moved along z [mm]."""
    case = support.case(drawn_block(), *overrides)
    data = build(case.geometry, case.mesh)
    x, nodes = data.points.copy(), np.unique(data.cells[data.cell_tags == data.regions["plate"]])
    block = np.setdiff1d(np.arange(len(x)), nodes)
    x[block, 2] -= step * (1 + x[block, 2] / 10) * (np.abs(x[block, 0]) > 5)
    x[nodes, 2] += plate
    return support.solve(case, tagged=distribute(replace(data, points=x), MPI.COMM_SELF))


@pytest.mark.parametrize(("plate", "step"), [(0, 0), (-1, 0), (1, 0), (0, 5)])
def test_well_posedness_sliding_of_a_block(plate: float, step: float) -> None:
    """Friction is mu N on the whole path, from an overlap or a gap, and at edges of the block."""
    solved = drawn(plate=plate, step=step)
    force = solved.last.weight @ solved.last.force
    assert force[2] == pytest.approx(-500)
    assert np.linalg.norm(force[:2]) == pytest.approx(150, rel=1e-7)


def test_well_posedness_sliding_refuses_a_block_off_its_plate() -> None:
    left = r"at 100 %.* \(10, .* of 'block_top' has slid off 'plate_bottom', (6|5.99) mm beyond"
    with pytest.raises(ConvergenceError, match=left):
        drawn("supports.floor.x=40 mm")
    with pytest.raises(InputError, match=r"^interfaces.b: its bodies overlap by 6 mm at .* more"):
        drawn(plate=-6.0)


def test_well_posedness_sliding_notes_on_tipping_elastic_bodies() -> None:
    """A block that is drawn up a slope θ needs F tan(θ + arctan μ), but surfaces do not turn."""
    stiff = "regions.plate={youngs_modulus: 210 GPa, poisson_ratio: 0.3, tissue: other}"
    table = "kind: displacement, boundary: plate_top, x: 0 mm, y: 0 mm, history: [1, 1]"
    last = drawn(stiff, f"supports.table={{{table}, z: 0.009 * x}}").last
    error = 500 * math.tan(0.009 + math.atan(0.3)) - np.linalg.norm(last.weight @ last.force[:, :2])
    assert 0.009 * 500 < error < 0.01 * 500
    with pytest.raises(ConvergenceError, match=r"(block|plate)' has tipped by 0.6[0-9]* degrees"):
        drawn(stiff, f"supports.table={{{table}, z: 0.011 * x}}")
