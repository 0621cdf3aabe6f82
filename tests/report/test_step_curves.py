"""Panels of a run over time."""

from __future__ import annotations

import numpy as np
import pytest

from app.plots import curves
from app.report import step_curves
from tests import support

GAIT = """\
base: stance
loads: {library: gait, body_weight: 750 N, cycle_table: walking_cycle}
stages: [{name: rise}, {name: gait, cycles: 2, increments: 20}]
"""


def test_step_curves_draw_forces_against_seconds_of_the_cycle() -> None:
    """Two strides of 1.1 s are drawn from peak to peak.

    The peak is 247 % of 750 N, the swing has 14 % of it.
    """
    times = np.array([0.5, 1.0, *np.linspace(1, 2, 41)[1:]])
    (panel,) = step_curves.forces(support.case(GAIT), {step_curves.TIME: times})
    hip = panel.lines[0]
    assert (panel.x, panel.y) == ("time in the stage gait (s)", "N")
    assert (hip.x[0], hip.x[-1]) == pytest.approx((0.0, 2.2))
    peak = 2.4648 * 750
    assert (hip.y[0], hip.y[20], hip.y[-1]) == pytest.approx((peak,) * 3, rel=1e-4)
    # At 0.77 s the table has 13.2 % at 0.759 s and 15.0 % at 0.803 s.
    lowest = 0.132 + 0.018 * (0.770 - 0.759) / (0.803 - 0.759)
    assert min(hip.y) == pytest.approx(lowest * peak, rel=1e-4)
    assert len(panel.lines) == 5


def test_step_curves_draw_forces_over_stages_that_change_them() -> None:
    text = "base: stance\nloads: {library: gait, history: [1, 0.5]}\n"
    text += "stages: [{name: walk}, {name: rest}]\n"
    (panel,) = step_curves.forces(support.case(text), {step_curves.TIME: np.array([1.0, 2.0])})
    assert panel.lines[0].x == [0.0, 1.0, 2.0]
    assert np.array(panel.lines[0].y) == pytest.approx(
        2.4648 * 600 * np.array([0, 1, 0.5]), rel=1e-4
    )
    alone = support.case("base: stance\n")
    assert step_curves.forces(alone, {step_curves.TIME: np.array([0.5, 1.0])}) == []


def test_step_curves_of_rounding_are_not_drawn() -> None:
    """4e-12 mm of slip are rounding; a nanometre is not."""
    columns = {
        "time [-]": np.array([0.5, 1.0]),
        "a slip_p99 [mm]": np.array([1e-12, 4e-12]),
        "a gap_p99 [mm]": np.array([1e-7, 1e-6]),
    }
    (panel,) = step_curves.over_time(columns, at_rest=True)
    assert panel.title.startswith("gap")


def test_step_curves_begin_at_rest() -> None:
    """Lengths vanish without loads. Fractions and histories in seconds have no such point."""
    titles = ("time [-]", "a slip_p99 [mm]", "a open_fraction [-]", "seconds [s]")
    columns = {title: np.array([0.5, 1.0]) for title in titles[:3]}
    panels = step_curves.over_time(columns, at_rest=True)
    assert [panel.lines[0].x for panel in panels] == [[0.0, 0.5, 1.0], [0.5, 1.0]]
    assert panels[0].lines[0].y == [0.0, 500.0, 1000.0]
    assert curves.drawing(panels[1]).across[0] == (0.0, "0")
    columns["seconds [s]"] = np.array([2.0, 3.0])
    assert step_curves.over_time(columns, at_rest=True)[0].lines[0].x == [2.0, 3.0]
