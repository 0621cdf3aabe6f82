"""Bodies with separate meshes: a ball in its cup, a block that slides along a plate."""

from __future__ import annotations

from tests import support


def ball_in_cup(shell: bool = False) -> str:
    """A rigid ball in a liner, optionally in a shell around the liner."""
    thickness = "liner_thickness: 8 mm, shell_thickness: 3 mm" if shell else "liner_thickness: 8 mm"
    region = "  shell: {youngs_modulus: 110 GPa, poisson_ratio: 0.3}\n" if shell else ""
    return f"""
geometry:
  {{kind: head_cup, head_diameter: 28 mm, radial_clearance: 0 mm, {thickness}}}
mesh: {{size: 5 mm, order: 2}}
regions:
  head: {{rigid: true}}
  liner: {{youngs_modulus: 1 GPa, poisson_ratio: 0.4}}
{region}interfaces:
  bearing: {{kind: contact, friction_coefficient: 0.06, sliding: finite}}
supports:
  outside: {{kind: fixed, boundary: {"shell_outer" if shell else "liner_outer"}}}
motions:
  ball: {{region: head, about: head_centre}}
"""


def block_under_plate(
    interfaces: str = "b: [plate, block]",
    floor: str = "kind: fixed",
    plate: str = "motions: {plate: {region: plate, about: [0 mm, 0 mm, 0 mm]}}",
) -> str:
    """An elastic block on a floor below a rigid plate.

    Args:
        interfaces: Interfaces of the geometry. The case has a law for ``b``.
        floor: Keys of the support below the block.
        plate: Section that holds or moves the plate, and sections after it.
    """
    return f"""
geometry:
  {{kind: file, path: {support.CONFIGS / "sliding_block.geo"}, interfaces: {{{interfaces}}}}}
mesh: {{size: 5 mm, far_size: 10 mm, order: 1}}
regions:
  plate: {{rigid: true, tissue: other}}
  block: {{youngs_modulus: 1 GPa, poisson_ratio: 0.4, tissue: other}}
interfaces:
  b: {{kind: contact, friction_coefficient: 0.3, sliding: finite,
       between: [plate_bottom, block_top]}}
supports:
  floor: {{{floor}, boundary: block_bottom}}
{plate}
"""


def drawn_block() -> str:
    """The block is pressed to the plate, then drawn along it."""
    return block_under_plate(
        floor="kind: displacement, x: 30 mm, y: 0 mm, history: [0, 1]",
        plate="""\
  table: {kind: fixed, boundary: plate_top}
loads: {up: {kind: force, boundary: block_bottom, force: [0 N, 0 N, 500 N], history: [1, 1]}}
stages: [{name: press}, {name: draw, increments: 4}]""",
    )
