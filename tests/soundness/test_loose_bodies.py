"""Free rigid motions: held bodies are never called loose, free ones always are."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

import pytest

from app.errors import MantleError, Reason
from tests import support

# A block on another, which is fixed; what holds the upper one is drawn.
BLOCKS = """
geometry:
  kind: blocks
  tilt: {tilt} deg
  blocks:
    - {{name: low, size: [{length} mm, {width} mm, 3 mm]}}
    - {{name: high, size: [{length} mm, {width} mm, {height} mm]}}
mesh: {{order: 1, size: {size} mm, far_size: {size} mm}}
regions:
  low: {{youngs_modulus: 6 GPa, poisson_ratio: 0.3, tissue: other}}
  high: {{youngs_modulus: {modulus} MPa, poisson_ratio: 0.3, tissue: other}}
interfaces:
  low_high: {{kind: contact, friction_coefficient: {friction}, gap: "{gap}"}}
supports:
  floor: {{kind: fixed, boundary: bottom}}
{supports}
loads:
  press: {{kind: force, boundary: top, force: "{press} N"}}
solver: {{linear: {linear}}}
"""


@dataclass(frozen=True)
class Drawn:
    """A drawn case, and whether something holds each body."""

    text: str
    held: bool

    def __str__(self) -> str:
        return f"{'held' if self.held else 'free'}\n{self.text}"


def draw(seed: int) -> Drawn:
    """A slender, soft-sprung, tilted or wedged block, held or with one free direction."""
    dice = random.Random(seed)
    length, width = dice.uniform(6, 20), dice.uniform(2, 4)
    height, force = dice.uniform(2, 6), 10 ** dice.uniform(0, 2)
    friction = dice.uniform(0.2, 0.6)
    values = {
        "length": f"{length:.3f}",
        "width": f"{width:.3f}",
        "height": f"{height:.3f}",
        "size": f"{dice.uniform(1.5, 2.5):.2f}",
        "modulus": f"{10 ** dice.uniform(3, 5):.4g}",
        "friction": f"{friction:.3f}",
        "linear": support.SOLVERS[seed % 3],
        "tilt": 0,
        "gap": "0 mm",
        "supports": "",
        "press": f"[0, 0, {-force:.4g}]",
    }
    springs = "  springs: {{kind: foundation, boundary: top, stiffness: '{} MPa/mm'}}"
    stiffness = 10 ** dice.uniform(-5, 0)
    held = seed % 2 == 0
    steepest = math.degrees(math.atan(0.9 * min(3.0, height) / length))
    kind = (seed // 2) % 4
    if held and kind == 0:  # a wedge-shaped gap, which touches along an edge
        values["gap"] = f"{10 ** dice.uniform(-5, -3.5):.3g} * x"
    elif held and kind == 1:  # a gap and soft springs
        values["gap"] = f"{10 ** dice.uniform(-3, -1):.3g} mm"
        soft = f"[{stiffness:.3g}, {stiffness:.3g}, {stiffness:.3g}]"
        values["supports"] = springs.format(soft)
        values["friction"] = dice.choice(["0", "0.3"])
    elif held and kind == 2:  # a slope that friction holds
        tilt = min(dice.uniform(2, 9), steepest)
        values["tilt"], values["friction"] = f"{tilt:.2f}", f"{dice.uniform(0.3, 0.7):.3f}"
    elif held:  # lifted against soft springs
        values["supports"] = springs.format([round(stiffness, 9)] * 3)
        values["press"] = f"[0, 0, {force:.4g}]"
    elif kind == 0:  # springs along x alone, pushed along y
        values["supports"] = springs.format(f"[{stiffness:.3g}, 0, 0]")
        values["friction"] = "0"
        values["press"] = f"[0, {0.2 * force:.4g}, {-force:.4g}]"
    elif kind == 1:  # pushed beyond friction
        values["press"] = f"[{1.2 * friction * force:.4g}, 0, {-force:.4g}]"
    elif kind == 2:  # a smooth slope
        values["tilt"], values["friction"] = f"{min(dice.uniform(4, 20), steepest):.2f}", "0"
    else:  # lifted, with supports along x alone
        values["supports"] = "  guide: {kind: roller, boundary: high_x_max, axis: x}"
        values["press"] = f"[0, 0, {force:.4g}]"
    return Drawn(BLOCKS.format(**values), held)


def judge(seed: int) -> None:
    """Solve a drawn case and compare the reason of its refusal."""
    drawn = draw(seed)
    try:
        support.solve(drawn.text)
        reasons = set()
    except MantleError as error:
        text = str(error)
        reasons = Reason.within(text)
        if drawn.held:
            assert error.exit_code == 4 and Reason.LARGE_DISPLACEMENT in reasons, f"{text}\n{drawn}"
    loose = Reason.LOOSE_BODY in reasons
    assert loose != drawn.held, f"{reasons}\n{drawn}"


@pytest.mark.parametrize("seed", range(12))
def test_loose_bodies_are_free_ones_and_no_others(seed: int) -> None:
    judge(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 200))
def test_loose_bodies_are_free_ones_and_no_others_drawn(seed: int) -> None:
    judge(seed)
