r"""Implicit integration in time with steps chosen by their error.

The methods are diagonally implicit Runge-Kutta methods, L-stable and stiffly accurate. Every stage
is a backward Euler step of length h = γ Δt that the caller solves. The last stage is the new state.
The methods damp modes faster than the step, unlike the trapezoidal rule (Crank-Nicolson), which is
not offered. A state is a list of arrays, the parts that this rank owns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from app.foundation.arrays import Floats

State = list[Floats]
# Solves y = start + h f(seconds, y) from (start, h, seconds, guess of y); None: did not converge.
Solve = Callable[[State, float, float, State], State | None]
# Largest error of a state over its tolerance; collective, the same on every rank.
Norm = Callable[[State], float]

# Share of the tolerance that steps aim at, and limits of their growth and shrinkage.
_AIM = 0.9
_MAX_GROWTH = 3.0
_MIN_GROWTH = 0.2
# Relative difference up to which times count as equal.
SAME_TIME = 1e-9
# Relative difference up to which steps count as equal.
_SAME_STEP = 1e-6


@dataclass(frozen=True)
class Method:
    """A diagonally implicit Runge-Kutta method.

    Attributes:
        name: Name in the case file.
        a: Weights of the rates in each stage (s, s), lower triangular, one value on the diagonal;
            the last row gives the new state.
        embedded: Weights (s,) of a method of lower order, whose difference estimates the error;
            empty if the change of the rate since the last step does.
        order: Order of the method.
    """

    name: str
    a: Floats
    embedded: Floats
    order: int

    @property
    def c(self) -> Floats:
        """Times of the stages as fractions of the step (s,)."""
        # The last stage ends the step: a rounded sum might lie beyond the end.
        return np.append(self.a[:-1].sum(axis=1), 1.0)

    @property
    def estimate_order(self) -> int:
        """Exponent of the step size in the estimated error."""
        return self.order if len(self.embedded) else self.order + 1


# Hairer and Wanner, Solving Ordinary Differential Equations II, 2nd ed., table IV.6.5.
_SDIRK4 = Method(
    "sdirk4",
    np.array(
        [
            [1 / 4, 0, 0, 0, 0],
            [1 / 2, 1 / 4, 0, 0, 0],
            [17 / 50, -1 / 25, 1 / 4, 0, 0],
            [371 / 1360, -137 / 2720, 15 / 544, 1 / 4, 0],
            [25 / 24, -49 / 48, 125 / 16, -85 / 12, 1 / 4],
        ]
    ),
    np.array([59 / 48, -17 / 96, 225 / 32, -85 / 12, 0]),
    4,
)
_BACKWARD_EULER = Method("backward_euler", np.array([[1.0]]), np.array([]), 1)
METHODS = {m.name: m for m in (_SDIRK4, _BACKWARD_EULER)}


@dataclass(frozen=True)
class SolvedTimeStep:
    """Outcome of a time step: state and rate of change at its end, and its estimated error."""

    state: State
    error: State
    rate: State


def step(
    method: Method, y: State, rate: State, dt: float, seconds: float, solve: Solve
) -> SolvedTimeStep | None:
    """Advance a state by one step dt [s]; None if a stage could not be solved; collective.

    ``y``, ``rate`` and ``seconds`` are state, rate of change and time [s] at the start.
    """
    previous_rate, rates, end = rate, list[State](), y
    rates_at = [(0.0, rate)]
    for i, time_fraction in enumerate(method.c):
        weights = dt * method.a[i]
        h = float(weights[i])
        start = _add(y, weights[:i], rates)
        solution = solve(
            start,
            h,
            seconds + time_fraction * dt,
            _add(start, *_interpolated_rates(rates_at, time_fraction, h)),
        )
        if solution is None:
            return None
        end = solution
        rate = _rate(start, end, h)
        rates.append(rate)
        rates_at.append((time_fraction, rate))
    zero = [np.zeros_like(part) for part in y]
    if len(method.embedded):
        error = _add(zero, dt * (method.a[-1] - method.embedded), rates)
    else:
        error = _add(zero, np.array([dt / 2, -dt / 2]), [rate, previous_rate])
    return SolvedTimeStep(end, error, rate)


def start_rate(y: State, seconds: float, shortest: float, solve: Solve) -> State | None:
    """Rate of change of a state, from an implicit step much shorter than all time scales [s]."""
    solution = solve(y, shortest, seconds + shortest, y)
    if solution is None:
        return None
    return _rate(y, solution, shortest)


def first_step(rate: State, norm: Norm, longest: float) -> float:
    """First step to try [s], in which the state changes by some hundred tolerances."""
    return 100 / max(norm(rate), 100 / longest)


class Controller:
    """Choose steps so that their error stays below the tolerance, and stop at events.

    A step follows from the error of the last one and its growth since the one before
    (Gustafsson's predictive controller; Hairer and Wanner II, IV.8), which foresees an ignition.

    Attributes:
        events: Times that no step may cross, rising [s].

    Args:
        method: Runge-Kutta method.
    """

    saved = ("next_step", "last_step")
    events: Sequence[float] = ()

    def __init__(self, method: Method) -> None:
        self._power = 1 / method.estimate_order
        self.begin(0.0)

    def begin(self, first: float) -> None:
        """Begin a stage with a first step to try [s]."""
        self.next_step = first
        self.last_step: tuple[float, float] | None = None

    def propose(self, seconds: float) -> float:
        """Step to try at a time [s]: it ends at the next event or well before it."""
        dt = self.next_step
        until_events = [e - seconds for e in self.events if e - seconds > SAME_TIME * e]
        if not until_events or dt < until_events[0] / 2:
            return dt
        return until_events[0] if dt >= until_events[0] * (1 - _SAME_STEP) else until_events[0] / 2

    def judge(self, dt: float, ratio: float) -> bool:
        """Return True if a step is accepted, by its error over the tolerance; choose the next."""
        ratio = max(ratio, 1e-10)
        factor = _AIM * ratio**-self._power
        if not ratio <= 1:
            self.next_step = dt * max(_MIN_GROWTH, factor)
            return False
        if self.last_step is not None:
            last_dt, last_ratio = self.last_step
            factor = min(factor, factor * dt / last_dt * (last_ratio / ratio) ** self._power)
        self.last_step = dt, max(ratio, 1e-2)
        grown = dt * min(_MAX_GROWTH, max(_MIN_GROWTH, factor))
        # A step shortened by an event says little about a longer one.
        self.next_step = max(grown, self.next_step) if dt < self.next_step else grown
        return True

    def failed(self, dt: float) -> None:
        """Try half of a step that could not be solved."""
        self.next_step = dt / 2


def _interpolated_rates(
    rates_at: Sequence[tuple[float, State]], time_fraction: float, h: float
) -> tuple[Floats, Sequence[State]]:
    """Weights of rates in a step of length h [s] at c: on the line through the two nearest.

    ``rates_at`` are times, as fractions of the step, and the rates there.
    """
    nearest = sorted(rates_at, key=lambda k: abs(k[0] - time_fraction))[:2]
    rates = [rate for _, rate in nearest]
    if len(nearest) < 2:
        return np.array([h]), rates
    (a, _), (b, _) = nearest
    weights: Floats = np.array([time_fraction - b, a - time_fraction], dtype=np.float64) * (
        h / (a - b)
    )
    return weights, rates


def _rate(start: State, end: State, h: float) -> State:
    return [np.divide(b - a, h) for a, b in zip(start, end, strict=True)]


def _add(y: State, weights: Floats, rates: Sequence[State]) -> State:
    sums = [part.copy() for part in y]
    for w, k in zip(weights, rates, strict=True):
        for total, part in zip(sums, k, strict=True):
            total += w * part
    return sums
