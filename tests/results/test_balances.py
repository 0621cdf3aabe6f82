"""Balances: of forces where nothing acts at the end; of heat for what was integrated, or not."""

from __future__ import annotations

import numpy as np
import pytest

from app.results.balance import HeatBalance
from app.results.closing_lines import BALANCES
from tests import support

# A stem pressed in and let go: friction holds it, and reactions vanish.
LET_GO = (
    "stages=[{name: push}, {name: release}]",
    "loads.hip.history=[1, 0]",
)
# A rod pressed against a wall and drawn off it: nothing is strained at the end.
ROD = """
geometry: {kind: blocks, blocks: [{name: wall, size: [3 mm, 3 mm, 3 mm]},
                                  {name: rod, size: [3 mm, 3 mm, 6 mm]}]}
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
    """Relative to the largest forces that there were."""
    solved = support.solve(text, *changes, balances=True)
    loaded, gone = solved.balances[[0, -1]]
    for name, then, now in zip(("force", "moment", "energy"), loaded, gone, strict=True):
        assert then < BALANCES[name], name
        assert now < BALANCES[name], name


# One lump that cools by c T' = -k T, by the implicit trapezoidal rule and by backward Euler.
C, K, STEP = 3.0, 0.7, 0.4


def cool(theta: float, steps: int, leak: float = 0.0) -> HeatBalance:
    T = 10.0
    balance = HeatBalance(C * T, {"air": -K * T})
    for _ in range(steps):
        new = T * (C - (1 - theta) * K * STEP) / (C + theta * K * STEP)
        heats = {"air": -STEP * K * ((1 - theta) * T + theta * new * (1 - leak))}
        balance.update(STEP, heats, {"air": -K * new}, C * new, C * abs(T - new))
        T = new
    return balance


def test_the_integrators_sum_is_exact() -> None:
    """The other sum is that of the trapezoidal rule; a leak shows."""
    balance = cool(1.0, 12)
    assert balance.heat < 1e-14
    # Backward Euler's flow is not the trapezoidal one: off by half a step's decay.
    assert balance.quadrature == pytest.approx(K * STEP / C / 2, rel=1e-12)
    balance = cool(0.5, 12)
    assert balance.heat < 1e-14 and balance.quadrature < 1e-14
    assert cool(1.0, 5, leak=1e-3).heat == pytest.approx(1e-3, rel=1e-9)


def test_flows_are_summed_by_condition() -> None:
    balance = HeatBalance(0.0, {})
    for stored in (1.0, 2.0):
        flows = {"cure": 5.0, "air": -3.0}
        heats = {name: 0.5 * flow for name, flow in flows.items()}
        balance.update(0.5, heats, flows, stored, 0.0)
    assert balance.heats == pytest.approx({"cure": 5.0, "air": -3.0})
    assert balance.heat < 1e-14 and balance.quadrature < 1e-14


def test_heat_that_only_moves_within_is_a_scale() -> None:
    balance = HeatBalance(100.0, {})
    balance.update(1.0, {}, {}, 100.0 + 1e-9, 50.0)
    assert balance.heat == pytest.approx(2e-11, rel=1e-3)


def test_a_jump_of_the_flows_is_not_smeared_over_a_step() -> None:
    balance = HeatBalance(0.0, {"source": 4.0})
    balance.update(1.0, {"source": 4.0}, {"source": 4.0}, 4.0, 0.0)
    balance.event({"source": 0.0})
    balance.update(1.0, {"source": 0.0}, {"source": 0.0}, 4.0, 0.0)
    assert balance.quadrature == 0


def test_steady_states_are_balanced_by_their_flows() -> None:
    balance = HeatBalance(10.0, {})
    balance.update(1.0, {"in": 1.0}, {"in": 1.0}, 11.0, 0.0)
    balance.steady({"in": 2.0, "out": -2.0 + 4e-7}, 500.0, 1e-12)
    assert balance.heat == pytest.approx(1e-7, rel=1e-3)
    after = balance.heat
    balance.update(1.0, {"in": 1.0}, {"in": 1.0}, 501.0, 0.0)
    assert balance.heat == after
    balance.update(1.0, {"in": 1.0}, {"in": 1.0}, 502.5, 0.0)
    assert balance.heat == pytest.approx(0.5 / 3)
    assert np.isfinite(balance.quadrature)


def test_rounding_is_not_compared_with_rounding() -> None:
    """A model that waits for its first heat; once that is there all of it counts."""
    balance = HeatBalance(0.0, {})
    balance.update(1.0, {"friction": 2e-22}, {"friction": 0.0}, 1e-16, 2e-16, 1e-12)
    assert balance.heat == 0
    balance.update(1.0, {"friction": 1.0}, {"friction": 1.0}, 1.0 - 1e-5, 0.0, 1e-12)
    assert balance.heat == pytest.approx(1e-5, rel=1e-6)
