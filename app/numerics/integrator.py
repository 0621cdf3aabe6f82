r"""Implicit integration in time with steps chosen by their error.

Diagonally implicit Runge-Kutta methods, L-stable and stiffly accurate: every stage is a backward
Euler step of length h = γ Δt from a start of its own, solved by the caller, and the last stage is
the new state. Both damp what is faster than the step; the trapezoidal rule (Crank-Nicolson) does
not and is not offered. A state is a list of arrays, the parts that this rank owns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from app.arrays import Floats

State = list[Floats]
# Solves y = start + h f(seconds, y) from (start, h, seconds, guess of y); None: did not converge.
Solve = Callable[[State, float, float, State], State | None]
# Largest error of a state over its tolerance; collective, the same on every rank.
Norm = Callable[[State], float]

# Steps aim at this share of the tolerance, grow and shrink at most by these factors.
_SAFETY = 0.9
_GROWTH = 3.0
_CUT = 0.2
# Times are equal up to this part of them, steps up to that part of them.
_SAME, _NEAR = 1e-9, 1e-6


@dataclass(frozen=True)
class Method:
    """A diagonally implicit Runge-Kutta method.

    Attributes:
        name: Name in the case file.
        a: Weights of the slopes in each stage (s, s), lower triangular, one value on the diagonal;
            the last row gives the new state.
        embedded: Weights (s,) of a method of lower order, whose difference estimates the error;
            empty if the change of the slope since the last step does.
        order: Order of the method.
    """

    name: str
    a: Floats
    embedded: Floats
    order: int

    @property
    def c(self) -> Floats:
        """Times of the stages as parts of the step (s,)."""
        # The last stage ends the step: rounding of its sum would put it behind the end.
        return np.append(self.a[:-1].sum(axis=1), 1.0)

    @property
    def estimate_order(self) -> int:
        """Power of the step that the estimated error goes with."""
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
class StageStep:
    """A time step that was solved.

    Attributes:
        state: State at its end.
        error: Estimate of its error, per step.
        slope: Rate of change at its end.
    """

    state: State
    error: State
    slope: State


def step(
    method: Method, y: State, slope: State, dt: float, seconds: float, solve: Solve
) -> StageStep | None:
    """Advance a state by one step, or say that a stage could not be solved.

    Args:
        method: Which method.
        y: State at the start.
        slope: Its rate of change there.
        dt: Length of the step [s].
        seconds: Time at the start.
        solve: Solver of a stage; collective.
    """
    before, slopes, end = slope, list[State](), y
    known = [(0.0, slope)]
    for i, c in enumerate(method.c):
        weights = dt * method.a[i]
        h = float(weights[i])
        start = _add(y, weights[:i], slopes)
        found = solve(start, h, seconds + c * dt, _add(start, *_along(known, c, h)))
        if found is None:
            return None
        end = found
        slope = _slope(start, end, h)
        slopes.append(slope)
        known.append((c, slope))
    zero = [np.zeros_like(part) for part in y]
    if len(method.embedded):
        error = _add(zero, dt * (method.a[-1] - method.embedded), slopes)
    else:
        error = _add(zero, np.array([dt / 2, -dt / 2]), [slope, before])
    return StageStep(end, error, slope)


def start_slope(y: State, seconds: float, shortest: float, solve: Solve) -> State | None:
    """Rate of change of a state, from an implicit step that is short beside everything [s]."""
    found = solve(y, shortest, seconds + shortest, y)
    if found is None:
        return None
    return _slope(y, found, shortest)


def first_step(slope: State, norm: Norm, longest: float) -> float:
    """A first step to try [s]: one in which the state changes by some hundred tolerances."""
    return 100 / max(norm(slope), 100 / longest)


class Controller:
    """Chooses steps so that their error stays below the tolerance, and stops at events.

    A step follows from the error of the last one and from how much it grew since the one before
    (Gustafsson's predictive controller; Hairer and Wanner II, IV.8), which foresees an ignition.

    Args:
        method: Which method.
        events: Times that no step may cross [s], in any order.
        first: First step to try [s].
    """

    saved = ("_next", "_last")

    def __init__(self, method: Method, events: Sequence[float] = (), first: float = 0.0) -> None:
        self._power = 1 / method.estimate_order
        self.events = sorted(events)
        self.begin(first)

    def begin(self, first: float) -> None:
        """Begin a stage with a first step to try [s]."""
        self._next = first
        self._last: tuple[float, float] | None = None

    def propose(self, seconds: float) -> float:
        """Step to try at a time [s]: it ends at the next event or well before it."""
        dt = self._next
        ahead = [e - seconds for e in self.events if e - seconds > _SAME * e]
        if not ahead or dt < ahead[0] / 2:
            return dt
        return ahead[0] if dt >= ahead[0] * (1 - _NEAR) else ahead[0] / 2

    def judge(self, dt: float, ratio: float) -> bool:
        """Whether a step is accepted, given its error over the tolerance; chooses the next one.

        Args:
            dt: Step that was solved [s].
            ratio: Error over tolerance, the same on every rank.
        """
        ratio = max(ratio, 1e-10)
        factor = _SAFETY * ratio**-self._power
        if not ratio <= 1:
            self._next = dt * max(_CUT, factor)
            return False
        if self._last is not None:
            last_dt, last_ratio = self._last
            factor = min(factor, factor * dt / last_dt * (last_ratio / ratio) ** self._power)
        self._last = dt, max(ratio, 1e-2)
        grown = dt * min(_GROWTH, max(_CUT, factor))
        # A step that was short because of an event says little against a longer one.
        self._next = max(grown, self._next) if dt < self._next else grown
        return True

    def failed(self, dt: float) -> None:
        """A step could not be solved: try one of half its length."""
        self._next = dt / 2


def _along(
    known: Sequence[tuple[float, State]], c: float, h: float
) -> tuple[Floats, Sequence[State]]:
    """Weights of slopes in a step of length h at c: on the line through the two that are nearest.

    Args:
        known: Times, as parts of the step, and slopes there.
        c: Where the slope is wanted.
        h: Length of the step [s].
    """
    nearest = sorted(known, key=lambda k: abs(k[0] - c))[:2]
    slopes = [slope for _, slope in nearest]
    if len(nearest) < 2:
        return np.array([h]), slopes
    (a, _), (b, _) = nearest
    weights: Floats = np.array([c - b, a - c], dtype=np.float64) * (h / (a - b))
    return weights, slopes


def _slope(start: State, end: State, h: float) -> State:
    return [np.divide(b - a, h) for a, b in zip(start, end, strict=True)]


def _add(y: State, weights: Floats, slopes: Sequence[State]) -> State:
    new = [part.copy() for part in y]
    for w, k in zip(weights, slopes, strict=True):
        for total, part in zip(new, k, strict=True):
            total += w * part
    return new
