"""Bodies that share no facet: what joins and holds them, and interfaces that do not fit them."""

from __future__ import annotations

import pytest

from app.errors import InputError
from app.soundness import cost, well_posedness
from meshes import build
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
TURN = """motions={ball: {region: head, about: head_centre, rotation: {axes: yxz, course:
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
SMOOTH = "interfaces.bearing.friction_coefficient=0"


def judged(text: str, *overrides: str) -> list[str]:
    case = support.case(text, *overrides)
    found = well_posedness.look(case, build(case.geometry, case.mesh))
    assert found.doubled or case.geometry.kind == "file"  # the poles of both spheres
    return well_posedness.judge(case, found)


def test_sliding_contact_holds_a_body_and_coincident_nodes_are_no_crack() -> None:
    assert judged(BALL) == judged(BLOCK) == []


def test_somebody_says_how_a_rigid_body_turns_that_slides_far() -> None:
    with pytest.raises(InputError, match=r"^interfaces\.b: nothing says how the rigid plate turns"):
        judged(BLOCK, "motions={}")
    held = "supports.top={kind: fixed, boundary: plate_top}"
    assert judged(BLOCK, "motions={}", held) == judged(BALL, SMOOTH, TURN) == []


@pytest.mark.parametrize(
    ("text", "change", "error"),
    [
        (BALL, "={}", "bearing: no facet between head and liner; .*`sliding: finite`"),
        (BLOCK, ".b={kind: bonded}", "b: no facet between plate and block"),
        (BLOCK, ".b.between=[plate_bottom, plate_top]", "b.between: .* plate; .* block alone"),
        (SHELL, FINITE, "liner_shell.sliding: liner and shell share [0-9]+ facets"),
    ],
)
def test_interfaces_that_do_not_fit_are_refused(text: str, change: str, error: str) -> None:
    with pytest.raises(InputError, match=rf"^interfaces\.{error}"):
        judged(text, f"interfaces{change}")


def test_the_nodes_of_the_second_side_count_as_those_of_the_interface() -> None:
    case = support.case(BLOCK)
    said = cost.exact_size(case, build(case.geometry, case.mesh))
    assert " interface nodes with a jump" in said and " 0 interface nodes" not in said
