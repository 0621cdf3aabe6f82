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

BALL = """
geometry:
  {kind: head_cup, head_diameter: 28 mm, radial_clearance: 0 mm, liner_thickness: 8 mm}
mesh: {size: 5 mm, order: 2}
regions:
  head: {rigid: true}
  liner: {youngs_modulus: 1 GPa, poisson_ratio: 0.4}
interfaces:
  bearing: {kind: contact, friction_coefficient: 0.06, sliding: finite}
supports:
  outside: {kind: fixed, boundary: liner_outer}
motions:
  ball: {region: head, about: head_centre}
"""
TURN = """motions={ball: {region: head, about: head_centre, rotation: {axes: yxz, cycle_table:
["time [s], rotation y [deg]", "0, 0", "1, 25"]}}}"""
BLOCK = f"""
geometry:
  {{kind: file, path: {support.CONFIGS / "sliding_block.geo"}, interfaces: {{b: [plate, block]}}}}
mesh: {{size: 5 mm, far_size: 10 mm, order: 1}}
regions:
  plate: {{rigid: true, tissue: other}}
  block: {{youngs_modulus: 1 GPa, poisson_ratio: 0.4, tissue: other}}
interfaces:
  b: {{kind: contact, friction_coefficient: 0.3, sliding: finite,
       between: [plate_bottom, block_top]}}
supports:
  floor: {{kind: fixed, boundary: block_bottom}}
motions:
  plate: {{region: plate, about: [0 mm, 0 mm, 0 mm]}}
"""
SHELL = (
    BALL.replace("ness: 8 mm", "ness: 8 mm, shell_thickness: 3 mm")
    .replace("0.4}", "0.4}\n  shell: {youngs_modulus: 110 GPa, poisson_ratio: 0.3}")
    .replace("liner_outer", "shell_outer")
)
FINITE = """.liner_shell={kind: contact, friction_coefficient: 0.1, sliding: finite,
between: [liner_rim, shell_outer]}"""
BOTH = BLOCK.replace("{b: [plate, block]}", "{b: [plate, block], d: [block, plate]}")
UNDER = """interfaces.d={kind: contact, friction_coefficient: 0, sliding: finite,
  between: [block_bottom, plate_top]}"""
# Pressed to the plate, then drawn along it.
DRAWN = BLOCK.partition("motions:")[0].replace(
    "kind: fixed,", "kind: displacement, x: 30 mm, y: 0 mm, history: [0, 1],"
)
DRAWN += """\
  table: {kind: fixed, boundary: plate_top}
loads: {up: {kind: force, boundary: block_bottom, force: [0 N, 0 N, 500 N], history: [1, 1]}}
stages: [{name: press}, {name: draw, increments: 4}]
"""
SMOOTH = "interfaces.bearing.friction_coefficient=0"


def judged(text: str, *overrides: str) -> list[str]:
    case = support.case(text, *overrides)
    parts = well_posedness.mesh_parts(case, build(case.geometry, case.mesh))
    assert parts.doubled or case.geometry.kind == "file"  # the poles of both spheres
    return [v.text for v in well_posedness.check_on_mesh(case, parts)]


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
    assert judged(BALL, SMOOTH, TURN) == []


@pytest.mark.parametrize(
    ("text", "change", "error"),
    [
        (BALL, "={}", "bearing: no facet between head and liner; .*`sliding: finite`"),
        (BLOCK, ".b={kind: bonded}", "b: no facet between plate and block"),
        (BLOCK, ".b.between=[plate_bottom, plate_top]", "b.between: .* plate; .* block only"),
        (SHELL, FINITE, "liner_shell.sliding: liner and shell share [0-9]+ facets"),
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
    case = support.case(BOTH, UNDER)
    data = build(case.geometry, case.mesh)
    tags = data.boundaries["block_bottom"] + data.boundaries["block_top"]
    joined = replace(data, boundaries={**data.boundaries, "block_bottom": tags})
    with pytest.raises(InputError, match=r"interfaces.d: .* nodes of block_top,.* interfaces.b;"):
        well_posedness.check_on_mesh(case, well_posedness.mesh_parts(case, joined))


def drawn(*overrides: str, plate: float = 0.0, step: float = 0.0) -> support.Solved:
    """Draw the block, whose top is lower at both ends, with the plate moved along z [mm]."""
    case = support.case(DRAWN, *overrides)
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
