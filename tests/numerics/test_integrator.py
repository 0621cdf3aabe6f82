"""Integration in time: orders and damping of the methods, choice of steps."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.campaigns.work_precision import fitted_order
from app.foundation.arrays import Floats
from app.numerics import integrator
from app.numerics.integrator import METHODS, Controller, Method, State, start_rate, step

SDIRK4 = METHODS["sdirk4"]
BOTH = pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)


@BOTH
def test_integrator_methods_are_l_stable(method: Method) -> None:
    """The stability function is at most one on the imaginary axis and tends to zero."""
    size = len(method.a)

    def growth(z: complex) -> float:
        rates = np.linalg.solve(np.eye(size) - z * method.a, np.ones(size))
        return abs(1 + z * method.a[-1] @ rates)

    assert METHODS.keys() == {"sdirk4", "backward_euler"}
    assert np.allclose(np.diag(method.a), method.a[0, 0])
    assert np.array_equal(np.triu(method.a, 1), np.zeros((size, size)))
    axis = [1j * y for y in 10 ** np.linspace(-3, 6, 300)]
    assert max(map(growth, axis)) <= 1 + 1e-12
    assert growth(-1e6) < 1e-5


def rotating(start: State, h: float, seconds: float, guess: State) -> State:
    """y' = cos(t) y, y' = -y^2 / 2: solutions exp(sin t) and 1 / (1 + t / 2)."""
    a, b = start
    return [a / (1 - h * np.cos(seconds)), 2 * b / (1 + np.sqrt(1 + 2 * h * b))]


def exact(t: float) -> Floats:
    return np.array([math.exp(math.sin(t)), 1 / (1 + t / 2)])


def rate_at(t: float) -> State:
    y = exact(t)
    return [np.array([math.cos(t) * y[0]]), np.array([-(y[1] ** 2) / 2])]


@BOTH
def test_integrator_error_falls_with_the_order(method: Method) -> None:
    steps, errors = [], []
    for n in (10, 20, 40, 80):
        dt, rate = 2 / n, rate_at(0.0)
        y = [np.array([v]) for v in exact(0.0)]
        for k in range(n):
            done = step(method, y, rate, dt, k * dt, rotating)
            assert done is not None
            y, rate = done.state, done.rate
        steps.append(dt)
        errors.append(float(np.abs(np.concatenate(y) - exact(2.0)).max()))
    assert fitted_order(steps, errors) == pytest.approx(method.order, abs=0.25)
    # The rate at the end is that of the equations there.
    assert np.concatenate(rate) == pytest.approx(np.concatenate(rate_at(2.0)), abs=2 * errors[-1])


@BOTH
def test_integrator_estimate_bounds_step_error_with_its_order(method: Method) -> None:
    steps, true, estimated = [], [], []
    for dt in (0.2, 0.1, 0.05):
        rate, y = rate_at(1.0 - dt), [np.array([v]) for v in exact(1.0)]
        if len(method.embedded):
            rate = rate_at(1.0)
        done = step(method, y, rate, dt, 1.0, rotating)
        assert done is not None
        steps.append(dt)
        true.append(np.abs(np.concatenate(done.state) - exact(1.0 + dt)).max())
        estimated.append(np.abs(np.concatenate(done.error)).max())
    assert fitted_order(steps, estimated) == pytest.approx(method.estimate_order, abs=0.25)
    assert all(t < 1.5 * e for t, e in zip(true, estimated, strict=True))


def test_integrator_start_rate_and_first_step() -> None:
    y = [np.array([v]) for v in exact(0.3)]
    rate = start_rate(y, 0.3, 1e-6, rotating)
    assert rate is not None
    assert np.concatenate(rate) == pytest.approx(np.concatenate(rate_at(0.3)), rel=1e-5)

    def norm(state: State) -> float:
        return float(np.abs(np.concatenate(state)).max()) / 1e-3

    dt = integrator.first_step(rate, norm, 100.0)
    assert norm([dt * k for k in rate]) == pytest.approx(100)
    assert integrator.first_step([np.zeros(2)], norm, 7.0) == 7.0


@BOTH
def test_integrator_failed_stage_fails_the_step(method: Method) -> None:
    assert step(method, [np.ones(1)], [np.zeros(1)], 1.0, 0.0, lambda *_: None) is None
    assert start_rate([np.ones(1)], 0.0, 1e-3, lambda *_: None) is None


def test_integrator_state_parts_are_neither_missing_nor_shared() -> None:
    """Parts may be empty on a rank. The given state is not changed."""
    y = [np.ones(2), np.zeros(0)]
    done = step(SDIRK4, y, [np.zeros(2), np.zeros(0)], 0.1, 0.0, lambda s, *_: [v / 2 for v in s])
    assert done is not None
    assert [len(v) for v in done.state] == [2, 0]
    assert [len(v) for v in done.error] == [2, 0]
    assert np.array_equal(y[0], np.ones(2))


# Steps


def controlled(method: Method, events: list[float], first: float) -> Controller:
    control = Controller(method)
    control.events = sorted(events)
    control.begin(first)
    return control


@BOTH
def test_integrator_steps_follow_the_error(method: Method) -> None:
    """Steps bring an error that is a power of the step to just below the tolerance."""
    control = controlled(method, [], 1.0)
    for _ in range(30):
        dt = control.propose(0.0)
        ratio = (dt / 40) ** method.estimate_order
        assert control.judge(dt, ratio) == (ratio <= 1)
    assert 0.5 < ratio <= 1


def test_integrator_steps_shrink_before_an_ignition() -> None:
    """Errors are of order four in the step over the time until a blow-up.

    Steps by the last error alone are rejected nearly every time.
    """
    control, seconds, accepted, rejected = controlled(SDIRK4, [], 1e-3), 0.0, 0, 0
    while 1 - seconds > 1e-6:
        dt = control.propose(seconds)
        if control.judge(dt, 100 * (dt / (1 - seconds)) ** 4):
            seconds, accepted = seconds + dt, accepted + 1
        else:
            rejected += 1
    assert accepted < 60 and rejected < 4


def test_integrator_shortens_rejected_and_failed_steps() -> None:
    control = controlled(SDIRK4, [], 1.0)
    assert not control.judge(1.0, 1e9)
    assert control.propose(0.0) == pytest.approx(0.2)
    assert not control.judge(0.2, 1.01)
    assert 0.2 * 0.8 < control.propose(0.0) < 0.2
    for senseless in (math.nan, math.inf):
        assert not control.judge(0.2, senseless)
        assert control.propose(0.0) == pytest.approx(0.04)
    control.failed(0.1)
    assert control.propose(0.0) == pytest.approx(0.05)
    assert control.judge(0.05, 0.0)
    assert control.propose(0.0) == pytest.approx(0.15)


@given(
    events=st.lists(st.floats(1e-3, 1e4), min_size=1, max_size=8),
    first=st.floats(1e-4, 1e5),
    ratios=st.lists(st.floats(0, 3), min_size=1, max_size=20),
)
def test_integrator_meets_events_without_crossing(
    events: list[float], first: float, ratios: list[float]
) -> None:
    control, seconds, met, k = controlled(SDIRK4, events, first), 0.0, [0.0], 0
    while seconds < max(events) * (1 - 1e-9) and k < 5000:
        dt = control.propose(seconds)
        assert dt > 0
        ratio = ratios[k % len(ratios)] if k < 60 else 0.5
        k += 1
        if control.judge(dt, ratio):
            seconds += dt
            met.append(seconds)
    for event in events:
        assert min(abs(event - t) for t in met) <= 2e-9 * event
    for a, b in pairwise(met):
        assert not any(a + 1e-8 * e < e < b - 1e-8 * e for e in events)


def test_integrator_leaves_no_short_step_before_an_event() -> None:
    control = controlled(SDIRK4, [10.0], 9.99)
    dt = control.propose(0.0)
    assert dt == 5.0
    assert control.judge(dt, 0.5)
    assert control.propose(5.0) == 5.0
    # A step cut short by an event does not make the next one short.
    assert control.judge(5.0, 0.5)
    assert control.propose(10.0) >= 9.99
