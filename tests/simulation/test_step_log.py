"""Lines of the log for steps: a header for each stage, states of the area, times."""

from __future__ import annotations

import logging
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from app.numerics.newton import NewtonResult
from app.scene.scene import Stage
from app.simulation.step_log import StepLog, area_fraction
from app.stepping.load_steps import LoadStep
from forms.contact import OPEN, SLIP, STICK


def samples() -> Any:
    """Three points of 1, 2 and 5 mm2 that are open, slip and stick; one overlap of 2 nm."""
    return SimpleNamespace(
        weight=np.array([1.0, 2.0, 5.0]),
        status=np.array([OPEN, SLIP, STICK]),
        step_numbers={"first": {"penetration_max": 2e-6}, "second": {"penetration_max": 1e-9}},
    )


def step(number: int, time: float) -> LoadStep:
    outcome = NewtonResult(
        converged=True,
        iterations=7,
        linear_iterations=41,
        residuals=(1.0, 3.2e-9),
        changes=(0, 0),
        linear_failed=False,
        augmentation=1.0,
        tried=(),
        period=0,
    )
    return LoadStep(number, "load", time, outcome, 1.0, ends_increment=True)


def test_step_log_area_fractions_are_of_the_whole_contact_area() -> None:
    assert [area_fraction(samples(), state) for state in (OPEN, SLIP, STICK)] == [
        1 / 8,
        2 / 8,
        5 / 8,
    ]
    assert area_fraction(None, OPEN) == 0.0


def test_step_log_line_has_states_and_times(caplog: pytest.LogCaptureFixture) -> None:
    """After 0.5 of 2 stages in 12 s of solving, 36 s of solving are left."""
    log = StepLog(2)
    log.begin_stage(Stage(name="load"))
    with caplog.at_level(logging.INFO, "mantle"):
        log.log_step(step(3, 0.5), samples(), wall=20.0, solve_seconds=12.0)
    header, line = caplog.messages
    assert header.split() == [
        *("step", "time", "newton", "krylov", "residual"),
        *("open", "slip", "penetration", "elapsed", "left"),
    ]
    assert line.split() == [
        *("3", "0.5", "7", "41", "3.2e-09", "12.5%", "25.0%"),
        *("2.0e-06", "mm", "20.0", "s", "36.0", "s"),
    ]


def test_step_log_has_one_header_for_each_stage(caplog: pytest.LogCaptureFixture) -> None:
    log = StepLog(2)
    with caplog.at_level(logging.INFO, "mantle"):
        for name, times in (("first", (0.5, 1.0)), ("second", (1.5, 2.0))):
            log.begin_stage(Stage(name=name))
            for time in times:
                log.log_step(step(1, time), None, wall=0.0, solve_seconds=0.0)
    is_header = ["newton" in message for message in caplog.messages]
    assert is_header == [True, False, False, True, False, False]


def test_step_log_line_of_heat_has_the_hottest_region(caplog: pytest.LogCaptureFixture) -> None:
    accepted: Any = SimpleNamespace(seconds=90.0, dt=1.5, outcome=step(1, 1.0).outcome)
    row = {
        "bone temperature_max [degC]": 41.26,
        "cement temperature_max [degC]": 83.04,
        "cement temperature_mean [degC]": 99.0,
        "heat balance [-]": 2e-12,
    }
    log = StepLog(1)
    log.begin_stage(Stage.model_validate({"name": "cure", "duration": "600 s"}))
    with caplog.at_level(logging.INFO, "mantle"):
        log.log_heat_step(12, accepted, row, wall=3.0)
    header, line = caplog.messages
    assert "hottest" in header and "penetration" not in header
    assert line.split() == [
        *("12", "90", "s", "1.5", "s", "7", "41", "83.0", "degC", "2.0e-12", "3.0", "s"),
    ]
