"""Maxima and integrals over time against formulas."""

from __future__ import annotations

import numpy as np
import pytest

from app.results.over_time import Integrals, Maximum, peak_between, sagitta


def test_over_time_maximum_keeps_value_and_time() -> None:
    maximum = Maximum(np.array([1.0, 5.0]), 0.0)
    maximum.update(np.array([2.0, 4.0]), 10.0)
    maximum.update(np.array([2.0, 6.0]), np.array([20.0, 17.0]))
    assert maximum.value.tolist() == [2.0, 6.0]
    assert maximum.time.tolist() == [10.0, 17.0]


def test_over_time_integrals_along_a_parabola() -> None:
    """The parabola 4 t (1 - t) is 1 above its chord, 0.

    With n chords its integral 2/3 loses 2 / (3 n^2).
    """
    integrals = Integrals({"mean": lambda a, b, seconds: (a + b) / 2 * seconds}, 1)
    zero = np.zeros(1)
    integrals.add_parabola(zero, zero, np.array([-1.0]), 1.0, 4)
    assert integrals.totals["mean"] == pytest.approx(2 / 3 - 2 / 3 / 4**2)
    integrals.forget()
    assert integrals.forgotten


def test_over_time_peak_between_steps_is_a_vertex() -> None:
    states = [(t, np.array([3.0 - (t - 1.4) ** 2])) for t in (0.0, 1.0, 2.0, 3.0)]
    value, time = peak_between(*states)
    assert value == pytest.approx(3.0)
    assert time == pytest.approx(1.4)


def test_over_time_bend_is_limited() -> None:
    """The parabola t^2 is h^2 / 4 below its chord.

    The sagitta is at most a quarter of the change.
    """
    before, start, end = ((t, np.array([t**2])) for t in (1.0, 2.0, 3.0))
    assert sagitta(before, start, end) == pytest.approx(0.25)
    flat = (3.0, np.array([4.4]))
    assert sagitta(before, start, flat) == pytest.approx(-0.1)
