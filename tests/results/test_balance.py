"""Balances where nothing acts at the end: relative to the largest forces that there were."""

from __future__ import annotations

import pytest

from app.results.closing_lines import BALANCES
from tests import support

# A stem pressed in and let go: friction holds it, and reactions vanish.
LET_GO = (
    "stages=[{name: push}, {name: release}]",
    "loads.hip.history=[1, 0]",
)
# A rod pressed against a wall and drawn off it: nothing is strained at the end.
ROD = """
geometry:
  kind: blocks
  blocks: [{name: wall, size: [3 mm, 3 mm, 3 mm]}, {name: rod, size: [3 mm, 3 mm, 6 mm]}]
mesh: {order: 1, size: 1.5 mm, far_size: 1.5 mm}
regions:
  wall: {youngs_modulus: 1 GPa, poisson_ratio: 0.3}
  rod: {youngs_modulus: 1 GPa, poisson_ratio: 0.3}
interfaces: {wall_rod: {kind: contact, friction_coefficient: 0.3}}
supports:
  floor: {kind: fixed, boundary: bottom}
  grip: {kind: displacement, boundary: top, x: 0 mm, y: 0 mm, z: -0.01 mm, history: [1, -1]}
stages: [{name: press}, {name: draw}]
"""


@pytest.mark.parametrize(
    ("text", "changes"), [(support.STEM, LET_GO), (ROD, ())], ids=["stem", "rod"]
)
def test_forces_that_have_gone_are_balanced(text: str, changes: tuple[str, ...]) -> None:
    solved = support.solve(text, *changes, balances=True)
    loaded, gone = solved.balances[[0, -1]]
    for name, then, now in zip(("force", "moment", "energy"), loaded, gone, strict=True):
        assert then < BALANCES[name], name
        assert now < BALANCES[name], name
