"""References of the thermal verification, against other formulas and their equations.

Fields are differentiated numerically. Rates are integrated by other methods than in the references.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import quad

from app.verification import closed_forms_heat as exact
from app.verification.closed_forms import Layers, lame_pressure
from tests.verification.differences import slope

# Conductivity [mW/(mm K)] and heat capacity [mJ/(mm3 K)].
CEMENT = (0.2, 1.74)
CORTICAL = (0.58, 2.331)
PMMA = exact.ExactKinetics(2.6397e8, 62866.0, 0.98, 1.064)
RISE = 89.0805


def test_closed_forms_heat_bars_and_rings_with_a_resistance() -> None:
    """Physics reference 5.8 and 5.9 give the values; 1 W/m2 is 1e-3 N/(mm s)."""
    q, hot, cold = exact.two_bars(100, 37, (5 / 0.2, 5 / 0.58), 0.3)
    assert (q, hot, cold) == pytest.approx((1.704821, 57.3795, 51.6967), rel=1e-6)
    Q, hot, cold = exact.two_rings(100, 37, (10, 14, 18), (0.2, 0.58), 0.5)
    assert (Q, hot, cold) == pytest.approx((175.2656, 53.07157, 49.08666), rel=1e-7)


def test_closed_forms_heat_perfused_slab() -> None:
    slab = exact.Slab(10.0, 0.5, 0.02, 37.0, 0.1, 0.6, 0.05, 20.0)

    def T(x: float) -> float:
        return float(slab.temperature(np.array([x]))[0])

    for x in (1.0, 5.0, 9.0):
        bend = slope(lambda s: slope(T, s), x)
        assert 0.5 * bend - 0.02 * (T(x) - 37) + 0.1 == pytest.approx(0, abs=1e-6)
    assert -0.5 * slope(T, 0.0) == pytest.approx(0.6, rel=1e-8)
    assert -0.5 * slope(T, 10.0) == pytest.approx(0.05 * (T(10.0) - 20), rel=1e-8)


def test_closed_forms_heat_cooling_cylinder() -> None:
    """Physics reference 5.10 gives the values.

    The heat equation and the condition at the wall hold.
    """
    centre = [
        exact.cooling_cylinder(np.zeros(1), t, 10, CEMENT, 100, 37)[0] for t in (60, 100, 300)
    ]
    assert centre == pytest.approx([96.83093, 86.90558, 50.73622], rel=1e-7)

    def T(r: float, t: float) -> float:
        return float(exact.cooling_cylinder(np.array([r]), t, 10, CEMENT, 100, 37)[0])

    flow = slope(lambda r: r * slope(lambda s: T(s, 60), r), 4.0) / 4.0
    assert 0.2 * flow == pytest.approx(1.74 * slope(lambda t: T(4.0, t), 60.0), rel=1e-4)
    assert T(10.0, 60) == pytest.approx(37)


@pytest.mark.parametrize(
    ("other", "temperature"),
    [((0.58, 2.331), 58.2), ((6.7, 2.331), 45.2), ((14.8, 3.735), 41.6), ((0.29, 2.503), 62.8)],
)
def test_closed_forms_heat_contact_temperature(
    other: tuple[float, float], temperature: float
) -> None:
    """Physics reference E13 has cement at 100 degC on cortical bone, Ti, CoCr, cancellous bone."""
    spaces = exact.HalfSpaces(CEMENT, other, (100, 37))
    assert spaces.contact == pytest.approx(temperature, abs=0.05)
    assert spaces.temperature(np.zeros(1), 3.0, False)[0] == pytest.approx(spaces.contact)


def half_spaces(h: float) -> Callable[[float, float, bool], float]:
    """Temperature at a place, at a time, in a body. The formulas hold beyond their bodies too."""
    spaces = exact.HalfSpaces(CEMENT, CORTICAL, (100, 37), h)
    return lambda x, t, first: float(spaces.temperature(np.array([x]), t, first)[0])


@pytest.mark.parametrize("h", [math.inf, 0.3])
@pytest.mark.parametrize("first", [True, False])
def test_closed_forms_heat_half_spaces(h: float, first: bool) -> None:
    T = half_spaces(h)
    x, (k, c) = (-1.0, CEMENT) if first else (1.0, CORTICAL)
    bend = slope(lambda s: slope(lambda y: T(y, 5.0, first), s), x)
    assert k * bend == pytest.approx(c * slope(lambda t: T(x, t, first), 5.0), rel=1e-4)


@pytest.mark.parametrize("h", [math.inf, 0.3])
def test_closed_forms_heat_interface_of_half_spaces(h: float) -> None:
    T = half_spaces(h)
    # One-sided slopes at the interface, by extrapolation from inside.
    near = -np.array([1e-3, 2e-3])
    into = 0.2 * np.diff([T(x, 5.0, True) for x in near])[0] / 1e-3
    out = 0.58 * np.diff([T(-x, 5.0, False) for x in near])[0] / 1e-3 * -1
    assert into == pytest.approx(out, rel=2e-3)
    jump = T(0.0, 5.0, True) - T(0.0, 5.0, False)
    assert jump == pytest.approx(0 if math.isinf(h) else into / h, rel=3e-3, abs=1e-9)


def test_closed_forms_heat_frictional_heating() -> None:
    """Physics reference 5.12 has 75 kW/m2 for 10 s between cement and cortical bone.

    Shares by effusivity e give both half-spaces the same surface temperature. Their stored heat is
    the heat that has entered.
    """
    e, f = exact.effusivity(CEMENT), exact.effusivity(CORTICAL)
    assert e / (e + f) == pytest.approx(0.34, abs=0.005)
    for material in (CEMENT, CORTICAL):
        flux = 75.0 * exact.effusivity(material) / (e + f)
        x = np.linspace(0, 20, 20001)
        rise = exact.heated_half_space(x, 10.0, flux, material)
        assert rise[0] == pytest.approx(152.66, rel=3e-4)
        assert np.trapezoid(material[1] * rise, x) == pytest.approx(flux * 10.0, rel=1e-6)
        assert -material[0] * (rise[1] - rise[0]) / 1e-3 == pytest.approx(flux, rel=1e-3)


def test_closed_forms_heat_adiabatic_cure() -> None:
    """Physics reference 3.1 (its gas constant has fewer digits)."""
    degrees = {
        100: 0.00217920,
        300: 0.01032774,
        500: 0.05708639,
        600: 0.22178809,
        620: 0.43721954,
        625: 0.63703883,
        630: 0.98433362,
    }
    for t, a in degrees.items():
        assert PMMA.degree(t, 310.15, 1e-3, RISE) == pytest.approx(a, rel=1e-5)
    assert PMMA.time(0.5, 310.15, 1e-3, RISE) == pytest.approx(622.12888, rel=3e-6)
    assert PMMA.time(0.99, 310.15, 1e-3, RISE) == pytest.approx(630.40663, rel=3e-6)
    assert PMMA.time(0.5, 296.15, 1e-3, RISE) == pytest.approx(1923.72256, rel=3e-6)
    assert PMMA.time(0.5, 296.15, 1e-3, 0) == pytest.approx(3009.468, rel=3e-6)
    seeds = [PMMA.time(0.5, 310.15, seed, RISE) for seed in (1e-4, 1e-3, 1e-2)]
    assert seeds == pytest.approx([905, 622, 347], abs=1)


def test_closed_forms_heat_isothermal_cure() -> None:
    """The course at a held temperature is logistic (physics reference 3.1)."""
    law = exact.ExactKinetics(2.6397e8, 62866.0, 1, 1)
    k = 4 * law.rate(0.5, 310.15)
    assert k == pytest.approx(6.82396e-3, rel=1e-6)
    t50 = law.time(0.5, 310.15, 1e-3, 0)
    assert t50 == pytest.approx(1012.133, rel=1e-6)
    assert 1 / (1 + (1 / 1e-3 - 1) * math.exp(-k * t50)) == pytest.approx(0.5, rel=1e-9)


# Young's modulus [MPa] and Poisson's ratio.
STEM = (200e3, 0.3)
MANTLE = (2200.0, 0.3)
BONE = (17e3, 0.3)


def cooled(joined: tuple[bool, bool]) -> Layers:
    """Cement that shrinks by 40 K times 80e-6 (physics reference 3.2)."""
    return Layers((6, 10, 15), (STEM, MANTLE, BONE), (0, -80e-6 * 40, 0), joined)


def test_closed_forms_heat_bonded_cylinders_cooled() -> None:
    layers = cooled((True, True))
    inner, outer = layers.state_at(1, 6), layers.state_at(1, 10)
    assert (inner[1], outer[1], inner[2]) == pytest.approx((5.696, 7.884, 12.534), abs=6e-4)
    assert (layers.state_at(0, 6)[1], layers.state_at(2, 10)[1]) == pytest.approx(
        (inner[1], outer[1])
    )
    assert layers.state_at(2, 15)[1] == pytest.approx(0, abs=1e-10)
    assert (layers.gap(0), layers.gap(1)) == pytest.approx((0, 0), abs=1e-15)


def test_closed_forms_heat_unilateral_cylinders_cooled() -> None:
    layers = cooled((True, False))
    _, radial, hoop = layers.state_at(1, 6)
    assert (radial, layers.gap(1), hoop) == pytest.approx((-3.929, 0.02332, 8.349), rel=2e-4)
    assert layers.state_at(1, 10)[1] == pytest.approx(0, abs=1e-10)


def test_closed_forms_heat_swelling_core_is_a_press_fit() -> None:
    """Lamé's interference δ is a free strain of the core of δ / ((1 + ν) b)."""
    layers = Layers((7, 10), (STEM, MANTLE), (0.01 / 1.3 / 7, 0), (True,))
    pressure = lame_pressure(0.01, 7, 10, STEM, MANTLE)
    assert -layers.state_at(0, 7)[1] == pytest.approx(pressure, rel=1e-12)


def test_closed_forms_heat_hot_fit_uses_mean_temperature() -> None:
    """The mean is a quadrature of the logarithmic profile."""
    b, c, k, h = 7.0, 10.0, 0.4, 0.3
    core, ring = (STEM, 14e-6), (MANTLE, 27.5e-6)
    value = exact.hot_fit_pressure((b, c), core, ring, k, h, (80, 37, 37))
    Q, _, inner = exact.two_rings(80, 37, (1e-9 * b, b, c), (1e12, k), h)

    def heat(r: float) -> float:
        return 2 * math.pi * r * (37 + Q * math.log(c / r) / (2 * math.pi * k))

    assert inner == pytest.approx(37 + Q * math.log(c / b) / (2 * math.pi * k))
    mean = quad(heat, b, c)[0] / (math.pi * (c * c - b * b))
    strains = (14e-6 * 43, 27.5e-6 * (mean - 37))
    even = Layers((b, c), (STEM, MANTLE), strains, (True,))
    assert value == pytest.approx(-even.state_at(0, b)[1], rel=1e-9)


def test_closed_forms_heat_heated_walls_have_one_or_three_states() -> None:
    """Every state balances heat and length. A cold bar that expands more makes several states."""
    unique = exact.HeatedWalls(
        (5, 5), (2200, 17000), (80e-6, 27.5e-6), (0.2, 0.58), 0.1, 0.1, 0.0, (60, 37, 37)
    )
    several = exact.HeatedWalls(
        (5, 5), (110e3, 2200), (9e-6, 80e-6), (6.7, 0.2), 0.01, 0.3, 0.005, (80, 37, 37)
    )
    (only,) = unique.states()
    assert only.pressure == pytest.approx(2.50151, rel=1e-5)
    open_, middle, closed = several.states()
    assert open_.pressure == 0 and several.excess(0) < 0
    # More pressure needs less length where the state is stable, the middle one is not.
    assert several.excess(middle.pressure * 1.01) > 0 > several.excess(closed.pressure * 1.01)
    for walls, state in ((unique, only), (several, middle), (several, closed)):
        assert walls.excess(state.pressure) == pytest.approx(0, abs=1e-12)
        h = walls.h0 + walls.h1 * state.pressure
        assert state.flux == pytest.approx(h * (state.first - state.second))
        hot = walls.temperatures[0] - state.flux * walls.lengths[0] / walls.conductivities[0]
        assert state.first == pytest.approx(hot)
