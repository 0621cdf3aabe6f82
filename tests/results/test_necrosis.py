"""Heat doses against reference values and independent quadrature."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from app.results import necrosis
from app.results.over_time import Integrals

ZERO = 273.15
R = 8.314462618


def kelvin(*celsius: float) -> np.ndarray:
    return np.array(celsius) + ZERO


# Time at which the damage integral of a constant temperature is one.
DEADLY = {45.0: 4.10e4, 47.0: 9313.0, 50.0: 1042.0, 53.0: 121.0, 55.0: 29.6, 60.0: 0.935}


@pytest.mark.parametrize(("celsius", "seconds"), [*DEADLY.items(), (70.0, 1.26e-3)])
def test_necrosis_damage_at_constant_temperature(celsius: float, seconds: float) -> None:
    T = kelvin(celsius)
    assert necrosis.henriques_moritz(T, T, seconds) == pytest.approx(1.0, rel=6e-3)


def test_necrosis_damage_far_above_boiling_is_finite() -> None:
    hot = kelvin(100.0, 200.0, 1500.0)
    dose = necrosis.henriques_moritz(kelvin(37.0, 37.0, 37.0), hot, 3600.0)
    assert np.isfinite(dose).all() and (np.diff(dose) > 0).all()


def integral(rate, a: float, b: float, seconds: float, corners=()) -> float:
    at = sorted((c - a) / (b - a) * seconds for c in corners if min(a, b) < c < max(a, b))
    accuracy: Any = {"points": at or None, "epsrel": 1e-12, "epsabs": 0, "limit": 500}
    return quad(lambda t: rate(a + (b - a) * t / seconds), 0, seconds, **accuracy)[0]


RAMPS = [(37.0, 60.0, 300.0), (60.0, 37.0, 300.0), (48.0, 48.05, 20.0), (49.95, 50.06, 1.0)]


@pytest.mark.parametrize(("a", "b", "seconds"), [*RAMPS, (37.0, 100.0, 3600.0)])
def test_necrosis_damage_of_ramps(a: float, b: float, seconds: float) -> None:
    exact = integral(
        lambda T: np.exp(np.log(3.1e98) - 6.28e5 / (R * (T + ZERO))), a, b, seconds, [b - 1, b - 5]
    )
    got = necrosis.henriques_moritz(kelvin(a), kelvin(b), seconds)
    assert got == pytest.approx(exact, rel=1e-11)


def test_necrosis_cem43_at_constant_temperature() -> None:
    T = kelvin(47.0, 50.0, 43.0, 42.0, 38.9)
    assert necrosis.cem43(T, T, 60.0) == pytest.approx([16, 128, 1, 0.25, 0])
    assert necrosis.cem43(kelvin(50.0), kelvin(50.0), 30.0) == pytest.approx(64)


@pytest.mark.parametrize(("a", "b", "seconds"), [*RAMPS, (30.0, 41.0, 60.0), (30.0, 38.0, 60.0)])
def test_necrosis_cem43_of_ramps(a: float, b: float, seconds: float) -> None:
    def rate(T: float) -> float:
        return 0.0 if T < 39 else (0.5 if T >= 43 else 0.25) ** (43 - T)

    exact = integral(rate, a, b, seconds, [39.0, 43.0]) / 60
    got = necrosis.cem43(kelvin(a), kelvin(b), seconds)
    assert got == pytest.approx(exact, rel=1e-11, abs=1e-300)


def test_necrosis_time_above_a_level() -> None:
    start, end = kelvin(37.0, 57.0, 40.0, 50.0, 47.0), kelvin(57.0, 37.0, 46.0, 60.0, 47.0)
    assert necrosis.seconds_over(start, end, 10.0, 47.0) == pytest.approx([5, 5, 0, 10, 10])


def test_necrosis_doses_add_up_over_divided_steps() -> None:
    """One long line has the same dose as many short ones."""
    whole, parts = (Integrals(necrosis.DOSES, 2) for _ in range(2))
    start, end = kelvin(37.0, 70.0), kelvin(58.0, 44.0)
    whole.add(start, end, 90.0)
    for k in range(37):
        a, b = (start + (end - start) * (k + i) / 37 for i in (0, 1))
        parts.add(a, b, 90.0 / 37)
    for name, total in whole.totals.items():
        assert parts.totals[name] == pytest.approx(total, rel=1e-10)


def test_necrosis_criteria_disagree() -> None:
    e = Integrals(necrosis.DOSES, 3)
    T = kelvin(47.0, 50.0, 57.0)
    e.add(T, T, 59.0)
    assert (necrosis.death_levels(e.totals)["47C_1min"] < 0).all()
    e.add(T - 20, T - 20, 500.0)
    e.add(T, T, 1.001)  # the minute may have a pause
    dead = {
        name: [bool(v >= 0) for v in level]
        for name, level in necrosis.death_levels(e.totals).items()
    }
    assert dead == {
        "47C_1min": [True, True, True],
        "cem43_16": [True, True, True],
        "cem43_60": [False, True, True],
        "cem43_240": [False, False, True],
        "henriques_moritz": [False, False, True],
    }


def test_necrosis_levels_are_linear_in_temperature() -> None:
    e = Integrals(necrosis.DOSES, 3)
    T = kelvin(45.0, 47.0, 49.0)
    e.add(T, T, 60.0)
    level = necrosis.death_levels(e.totals)["cem43_16"]
    assert level == pytest.approx(np.log(2) * np.array([-2, 0, 2]), abs=1e-12)
