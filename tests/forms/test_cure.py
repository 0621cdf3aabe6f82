"""Cure: rates, the implicit local step, closed forms and reference times, strains, energy.

Reference times come from the adiabatic and isothermal equations, integrated to 1e-11 by a Radau
method. With dt = da / f(a, T(a)) they come from quadrature, or from closed forms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

from mpi4py import MPI

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import CubicHermiteSpline

from app.foundation.arrays import Floats
from app.heat.curing import (
    UNREACTED,
    Kinetics,
    are_admissible,
    error_as_temperature,
    free_strain,
    kinetics_of,
)
from app.laws.cure import Autocatalytic, Prescribed
from app.numerics.integrator import (
    METHODS,
    Controller,
    Method,
    State,
    first_step,
    start_rate,
    step,
)
from app.numerics.pointwise import Pointwise
from forms import cure as forms
from tests.cases.laws import BALIGA, altered, cure

R = 8.314462618
# Adiabatic rise of full cure [K].
RISE = 89.0805
CEMENT = cure("cement", BALIGA, 1e-3, shrinkage=0.02)
TOLERANCE = 1e-3
# What is all but cured may waver by less than the tolerance, in degrees of cure.
WAVERS = 1e-5


def setting(kinetics: Autocatalytic | Prescribed = BALIGA, nodes: int = 1) -> Kinetics:
    return kinetics_of(MPI.COMM_SELF, altered(CEMENT, kinetics=kinetics), nodes)


def rate(k: Autocatalytic, a: Floats, T: Floats) -> Floats:
    limit = np.interp(T, *np.array(k.limit).T) if k.limit else 1.0
    left = np.maximum(limit - a, 0)
    return k.rate_constant * np.exp(-k.activation_energy / (R * T)) * a**k.m * left**k.n


def doubled(T: float = 330.0) -> Autocatalytic:
    """Twice the activation energy, with the same rate at one temperature."""
    faster = BALIGA.rate_constant * np.exp(BALIGA.activation_energy / (R * T))
    return altered(BALIGA, activation_energy=2 * BALIGA.activation_energy, rate_constant=faster)


LIMITED = altered(BALIGA, limit=((293.15, 0.7), (353.15, 0.9), (373.15, 1.0)))
KINETICS = {
    "bone cement": BALIGA,
    "activation energy doubled": doubled(),
    "limited": LIMITED,
    "first order": altered(BALIGA, m=0.0, n=1.0),
    "no order": altered(BALIGA, m=0.0, n=0.0),
    "half order": altered(BALIGA, m=0.5, n=0.5),
    "third order": altered(BALIGA, m=1.0, n=2.0),
}
ALL = pytest.mark.parametrize("kinetics", KINETICS.values(), ids=KINETICS)


# Forms


def evaluate(function: object, **values: Floats) -> Floats:
    n = len(next(iter(values.values())))
    law = Pointwise(
        MPI.COMM_SELF,
        n,
        dict.fromkeys(values, 1),
        lambda x: [function(*(x[k] for k in values))],  # type: ignore[operator]
    )
    return law(**values)[0]


def test_cure_limit_is_linear_between_its_pairs() -> None:
    T = np.linspace(250, 400, 31)
    for pairs in (LIMITED.limit, LIMITED.limit[:1]):
        table = np.array(pairs).T
        result = evaluate(lambda x, t=table: forms.piecewise_linear(x, *t), T=T)  # type: ignore[misc]
        assert result == pytest.approx(np.interp(T, *table), abs=1e-14)


def test_cure_modulus_grows_after_gelation() -> None:
    a = np.array([0.0, 0.5, 0.85, 0.9, 1.0])
    result = evaluate(lambda x: forms.modulus_factor(x, 0.85, 0.01, 2.0), a=a)
    assert result == pytest.approx([0.01, 0.01, 0.01, 0.01 + 0.99 / 9, 1.0], abs=1e-14)


# The local step


@ALL
@pytest.mark.parametrize("h", [1e-3, 1.0, 60.0, 3600.0])
def test_cure_step_solves_its_equation(kinetics: Autocatalytic, h: float) -> None:
    """The step solves a = a* + h f(a, T) up to the unreacted part, and gives da/dT."""
    rng = np.random.default_rng(2)
    n = 300
    start = np.concatenate([10 ** rng.uniform(-6, 0, n), 1 - 10 ** rng.uniform(-8, 0, n)])
    T = rng.uniform(270, 420, 2 * n)
    curing = setting(kinetics, 2 * n)
    result = curing.update(start, T, h, 0.0)
    a, limit = result.degree, np.interp(T, *np.array(kinetics.limit or ((300, 1.0),)).T)
    assert (a >= start).all() and (a <= np.maximum(limit, start)).all()

    free = (a < limit - 2 * UNREACTED) & (start < limit)
    missing = a - start - h * rate(kinetics, a, T)
    stiffness = 1 + h * kinetics.n * rate(kinetics, a, T) / np.maximum(limit - a, UNREACTED)
    assert np.abs(missing / stiffness)[free].max() < 1e-13
    # Where the reaction has ended, it would have gone further.
    ended = ~free & (start < limit - 2 * UNREACTED)
    assert (missing[ended] <= UNREACTED * (1 + h * 1e-6)).all()

    ΔT = 1e-3
    up, down = (curing.update(start, T + d, h, 0.0).degree for d in (ΔT, -ΔT))
    slope = (up - down) / (2 * ΔT)
    smooth = free & (up < limit - 2 * UNREACTED)
    for knot, _ in kinetics.limit or ():
        smooth &= np.abs(T - knot) > 1
    assert np.abs(result.by_temperature - slope)[smooth].max() < 1e-5 * max(slope.max(), 1e-3)


@given(
    start=st.floats(0, 1),
    T=st.floats(250, 500),
    h=st.floats(-3, 3.6).map(lambda x: 10.0**x),
    which=st.sampled_from(sorted(KINETICS)),
)
def test_cure_degree_stays_within_bounds_and_rises(
    start: float, T: float, h: float, which: str
) -> None:
    curing = compiled(which)
    a = np.full(3, start)
    result = curing.update(a, np.array([T, T + 5, T + 50]), h, 0.0)
    degree = result.degree
    assert (degree >= start).all() and (degree <= 1).all()
    assert (np.diff(degree) >= -1e-12).all()
    assert (result.by_temperature >= 0).all()
    assert (curing.update(a, np.full(3, T), 2 * h, 0.0).degree[0] >= degree[0] - 1e-12).all()


@cache
def compiled(which: str) -> Kinetics:
    return setting(KINETICS[which], 3)


@ALL
def test_cure_steps_are_finite_where_rates_underflow(kinetics: Autocatalytic) -> None:
    """At rates that underflow the degree of cure stays 0; the next step is usual."""
    hot, cold, warm = (np.full(3, T) for T in (1e4, 1.0, 350.0))
    start = np.array([5e-324, 1e-200, 0.3])
    curing, fresh = setting(kinetics, 3), setting(kinetics, 3)
    with np.errstate(invalid="raise"):
        for before in (hot, warm):
            curing.update(start, before, 1e-2, 0.0)
            for none in (cold, np.full(3, np.nan), np.full(3, -np.inf)):
                result = curing.update(start, none, 1e-2, 0.0)
                assert result.degree == pytest.approx(start, abs=1e-20)
                assert result.by_temperature == pytest.approx(0.0, abs=1e-20)
                assert np.isfinite(curing._mean_rate).all()
        curing.update(start, np.full(3, np.inf), 1e-2, 0.0)
        assert np.isfinite(curing._mean_rate).all()
        result = curing.update(start, warm, 60.0, 0.0)
    expected = fresh.update(start, warm, 60.0, 0.0)
    assert result.degree == pytest.approx(expected.degree, abs=1e-7)
    assert result.by_temperature == pytest.approx(expected.by_temperature, abs=1e-7)


def test_cure_near_zero_degree_depends_little_on_temperature() -> None:
    """At m = 1 the step gives a = a* / (1 - h k) for a* -> 0, down to the smallest numbers."""
    kinetics = KINETICS["third order"]
    curing, T = setting(kinetics, 1), np.array([300.0])
    h = 0.3 / float(rate(kinetics, np.array([1e-9]), T)[0] / 1e-9)
    start = np.array([1e-200])
    with np.errstate(invalid="raise"):
        curing.update(np.array([1e-3]), T, h, 0.0)
        for _ in range(2):
            result = curing.update(start, T, h, 0.0)
            assert result.degree == pytest.approx(0.0, abs=1e-20)
            assert result.by_temperature == pytest.approx(0.0, abs=1e-20)
            assert np.isfinite(curing._mean_rate).all()


def test_cure_refuses_degrees_beyond_bounds() -> None:
    rounded = np.array([-1e-15, 1 + 1e-15])
    assert (
        are_admissible(np.array([0.0, 1.0]))
        and are_admissible(rounded)
        and are_admissible(np.zeros(0))
    )
    for kinetics in (BALIGA, Prescribed.model_construct(rate=COURSE)):
        result = setting(kinetics, 2).update(rounded, np.full(2, 310.0), 1.0, 350.0)
        assert (result.degree >= 0).all() and (result.degree <= 1).all()
    for outside in (-1e-6, 1 + 1e-6, np.nan):
        assert not are_admissible(np.array([0.5, outside]))


def test_cure_on_a_rank_without_nodes() -> None:
    result = setting(nodes=0).update(np.zeros(0), np.zeros(0), 1.0, 0.0)
    assert len(result.degree) == 0
    assert len(result.by_temperature) == 0


# Time


@dataclass
class Run:
    """A point of cement in time: times, temperatures, degrees and rates, and failed steps."""

    times: Floats
    temperature: Floats
    degree: Floats
    rates: Floats
    rejected: int
    solves: int

    @property
    def spline(self) -> CubicHermiteSpline:
        """The cubic through degrees and rates."""
        return CubicHermiteSpline(self.times, self.degree, self.rates)

    def reaches(self, level: float) -> float:
        """Time at which the degree reaches a level."""
        return float(self.spline.solve(level, extrapolate=False)[0])


@dataclass
class Point:
    """Adiabatic cement (gain is the rise of full cure [K]), or at constant temperature (0)."""

    curing: Kinetics
    gain: float
    start: State
    solves: int = 0

    def solve(self, start: State, h: float, seconds: float, guess: State) -> State | None:
        """Newton's method from below.

        It finds the first root, which continues that of short steps.
        """
        self.solves += 1
        T_start, a_start = start
        if not are_admissible(a_start):
            return None
        T = T_start
        for _ in range(50):
            result = self.curing.update(a_start, T, h, seconds)
            slope = 1 - self.gain * result.by_temperature
            if slope[0] <= 0:
                return None
            step = (T_start + self.gain * (result.degree - a_start) - T) / slope
            T = T + step
            if abs(step[0]) < 1e-11 * T[0]:
                # What is released is what warms, to the last bit.
                return [T_start + self.gain * (result.degree - a_start), result.degree]
        return None


def point(
    kinetics: Autocatalytic | Prescribed = BALIGA,
    T: float = 310.15,
    initial: float = 1e-3,
    gain: float = RISE,
) -> Point:
    cure = altered(CEMENT, kinetics=kinetics, initial=initial)
    curing = kinetics_of(MPI.COMM_SELF, cure, 1)
    return Point(curing, gain, [np.array([T]), np.array([initial])])


def integrate(p: Point, end: float, method: str = "sdirk4", tolerance: float = TOLERANCE) -> Run:
    """Steps have the lengths that a run would choose."""
    table, y, seconds, rejected = METHODS[method], p.start, 0.0, 0
    slope = start_rate(y, 0.0, 1e-6 * end, p.solve)
    assert slope is not None

    def norm(errors: State) -> float:
        cure = error_as_temperature(y[1], errors[1], max(p.gain, RISE))
        return float(max(np.abs(errors[0]).max(), np.abs(cure).max())) / tolerance

    control = Controller(table)
    control.events = sorted([*p.curing.events, end])
    control.begin(first_step(slope, norm, end))
    rows = [(seconds, y[0][0], y[1][0], slope[1][0])]
    while seconds < end * (1 - 1e-9):
        dt = control.propose(seconds)
        done = step(table, y, slope, dt, seconds, p.solve)
        if done is None or not are_admissible(done.state[1]):
            control.failed(dt)
            rejected += 1
        elif control.judge(dt, norm(done.error)):
            y, slope, seconds = done.state, done.rate, seconds + dt
            rows.append((seconds, y[0][0], y[1][0], slope[1][0]))
        else:
            rejected += 1
        assert rejected < 500
    return Run(*np.array(rows).T, rejected, p.solves)


@pytest.mark.parametrize(
    ("T", "gain", "t50"),
    [(310.15, RISE, 622.12888), (296.15, RISE, 1923.72256), (296.15, 0.0, 3009.468)],
    ids=["adiabatic 37 degC", "adiabatic 23 degC", "isothermal 23 degC"],
)
def test_cure_reference_times(T: float, gain: float, t50: float) -> None:
    run = integrate(point(T=T, gain=gain), 2 * t50)
    assert run.reaches(0.5) == pytest.approx(t50, rel=1e-4)
    assert len(run.times) < 80 and run.rejected < 8 and run.solves < 450
    assert (np.diff(run.degree) > -WAVERS).all() and run.degree[-1] <= 1


def test_cure_reference_degrees_and_temperatures() -> None:
    """Degrees and temperatures at given times, adiabatic from 37 degC."""
    run = integrate(point(), 620.0)
    for t, a in ((100, 0.00217920), (300, 0.01032774), (500, 0.05708639), (600, 0.22178809)):
        # The shift in time that is allowed, times the rate.
        assert run.spline(t) == pytest.approx(a, rel=5e-3)
    exact = integrate(point(), 600.0, tolerance=1e-6)
    assert exact.degree[-1] == pytest.approx(0.22178809, abs=2e-6)
    assert exact.temperature[-1] - 273.15 == pytest.approx(56.66790, abs=1e-4)


def test_cure_equals_closed_forms() -> None:
    k = 6.82396e-3
    logistic = integrate(point(altered(BALIGA, m=1.0, n=1.0), gain=0.0), 1500.0)
    assert logistic.reaches(0.5) == pytest.approx(1012.133, rel=1e-4)
    first = integrate(point(altered(BALIGA, m=0.0, n=1.0), gain=0.0, initial=0.0), 300.0)
    assert first.degree[-1] == pytest.approx(1 - np.exp(-300 * k), rel=1e-4)
    for rise, t in ((10, 11.46931286), (40, 21.07563528)):
        warm = integrate(point(altered(BALIGA, m=0.0, n=0.0), initial=0.0), t)
        assert warm.temperature[-1] - 310.15 == pytest.approx(rise, rel=5e-4)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("kinetics", "initial", "gain", "t50"),
    [
        (BALIGA, 1e-6, RISE, 1440.613),
        (doubled(), 1e-3, RISE, 2230.54),
        (BALIGA, 1e-3, 2 * RISE, 518.3122),
    ],
    ids=["initial cure 1e-6", "activation energy doubled", "heat doubled"],
)
def test_cure_of_a_stiff_exotherm_in_few_steps(
    method: str, kinetics: Autocatalytic, initial: float, gain: float, t50: float
) -> None:
    """An exotherm takes seconds within an hour. Bounds and energy hold with few steps."""
    tolerance = TOLERANCE if method == "sdirk4" else 0.1
    run = integrate(point(kinetics, initial=initial, gain=gain), 3600.0, method, tolerance)
    a, T = run.degree, run.temperature
    assert (a >= initial).all() and (a <= 1).all() and (np.diff(a) > -WAVERS).all()
    assert a[-1] > 0.999
    released = gain * (a - initial)
    assert np.abs(T - T[0] - released).max() < 1e-9 * gain
    assert run.reaches(0.5) == pytest.approx(t50, rel=1e-4 if method == "sdirk4" else 0.3)
    assert len(run.times) < 150 and run.rejected < 10


# Prescribed cure

COURSE = ((300.0, 0.0), (400.0, 2.0), (600.0, 0.0))


def test_cure_prescribed_rate_is_integrated_at_any_scale() -> None:
    """The degree is initial + (1 - initial) F.

    F is the part of the course's integral that has passed.
    """
    p = point(Prescribed.model_construct(rate=COURSE))
    assert p.curing.events == (300.0, 400.0, 600.0)
    run = integrate(p, 1800.0)
    times = run.times
    passed = np.interp(times, [300, 400, 600], [0, 1 / 3, 1])
    for low, high, part in (
        (300, 400, lambda t: (t - 300) ** 2 / 30000),
        (400, 600, lambda t: 1 - (600 - t) ** 2 / 60000),
    ):
        inside = (times >= low) & (times <= high)
        passed[inside] = part(times[inside])
    assert run.degree == pytest.approx(1e-3 + 0.999 * passed, abs=1e-12)
    assert run.degree.max() <= 1 and run.rejected < 3
    assert {300.0, 400.0, 600.0} <= {round(t, 6) for t in run.times}


def test_cure_prescribed_rate_stops_at_full_cure() -> None:
    """Long backward Euler steps see the rate at their ends only. The degree is at most one."""
    curing = setting(Prescribed.model_construct(rate=((0.0, 1.0), (100.0, 1.0))))
    y = np.array([1e-3])
    for k in range(1, 8):
        result = curing.update(y, np.full(1, 310.0), 30.0, 30.0 * k)
        assert y <= result.degree <= 1
        assert result.by_temperature == 0
        y = result.degree
    assert y == pytest.approx(1e-3 + 0.999 * 0.9)


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
@pytest.mark.parametrize("begin", [0.0, 120.0])
@pytest.mark.parametrize("dt", [60.0, 0.1])
def test_cure_prescribed_rate_that_jumps_in_equal_steps(
    method: Method, begin: float, dt: float
) -> None:
    """The rate jumps at ends of steps, whose times are rounded."""
    p = point(Prescribed.model_construct(rate=((begin, 1.0), (begin + 5 * dt, 1.0))))
    y, slope, seconds = p.start, [np.zeros(1), np.zeros(1)], begin - 2 * dt
    for k in range(-2, 7):
        done = step(method, y, slope, dt, seconds, p.solve)
        assert done is not None
        y, slope, seconds = done.state, done.rate, seconds + dt
        passed = np.clip((k + 1) / 5, 0, 1)
        assert y[1][0] == pytest.approx(1e-3 + 0.999 * passed, abs=1e-12)
        assert y[0][0] == pytest.approx(310.15 + RISE * 0.999 * passed, abs=1e-9)


# Strains


def strain_along(states: Sequence[tuple[float, float]]) -> float:
    """Strain of a path of (degree, temperature)."""
    law = free_strain(MPI.COMM_SELF, CEMENT, 80e-6, 1)
    total = 0.0
    for (a0, T0), (a1, T1) in pairwise(states):
        total += law(a_old=a0, T_old=T0, a=a1, T=T1)[0][0]
    return total


def test_cure_strain_counts_from_gelation() -> None:
    assert strain_along([(0.1, 310.0), (0.85, 390.0)]) == 0
    # Cured: what cooling makes; half shrunk: half the shrinkage.
    assert strain_along([(1.0, 390.0), (1.0, 310.0)]) == pytest.approx(-80 * 80e-6)
    assert strain_along([(0.85, 350.0), (0.925, 350.0)]) == pytest.approx(-0.02 / 3 / 2)
    # A third of this step lies past gelation.
    assert strain_along([(0.55, 310.0), (1.0, 355.0)]) == pytest.approx(80e-6 * 15 - 0.02 / 3)


def test_cure_strain_is_independent_of_steps_on_a_straight_path() -> None:
    whole = [(0.2, 315.0), (1.0, 375.0)]
    for parts in (2, 7, 50):
        path = list(
            zip(np.linspace(0.2, 1, parts + 1), np.linspace(315, 375, parts + 1), strict=True)
        )
        assert strain_along(path) == pytest.approx(strain_along(whole), rel=1e-12)


def test_cure_errors_are_weighted_by_heat() -> None:
    result = error_as_temperature(np.array([0.5, 1e-3, 0.0]), np.full(3, -1e-6), RISE)
    assert result[:2] == pytest.approx([-1e-6 * RISE, -1e-5 * RISE])
    assert np.isfinite(result[2])
