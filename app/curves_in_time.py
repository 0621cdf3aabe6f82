"""What happens between and within the steps of a temperature: parabolas through three states."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# The most that three equal steps can hide of a peak, over what its flanks fall.
_HIDDEN = 1 / 8
# Steps that differ by more than this do not tell what is between them.
_UNEQUAL = 4.0


def raise_to(peak: Floats, time: Floats, value: Floats, when: Floats) -> None:
    """Keep what is higher and when it was, in place (n,)."""
    higher = value > peak
    peak[higher], time[higher] = value[higher], when[higher]


def comparable(step: float, other: float) -> bool:
    """Whether two steps tell what is between them."""
    return 0 < max(step, other) < _UNEQUAL * min(step, other)


def vertex(*states: tuple[float, Floats]) -> tuple[Floats, Floats]:
    """Height and time of the vertex of a parabola, where the middle of three states is the hottest.

    Args:
        states: Three times [s] and temperatures then (n,) [K].

    Returns:
        Temperatures (n,), minus infinity where the middle is not the hottest, and times (n,).
    """
    (t0, a), (t1, b), (t2, c) = states
    top = (b >= a) & (b >= c) & (2 * b > a + c)
    back, ahead = (b - a) / (t1 - t0), (c - b) / (t2 - t1)
    curvature = np.where(top, (ahead - back) / (t2 - t0), -1.0)
    slope = back + curvature * (t1 - t0)
    rise = np.minimum(-(slope**2) / (4 * curvature), _HIDDEN * (b - np.minimum(a, c)))
    when = np.clip(t1 - slope / (2 * curvature), t0, t2)
    return np.where(top, b + rise, -np.inf), np.where(top, when, t1)


def bend(before: list[tuple[float, Floats]], seconds: float, now: Floats) -> Floats:
    """How far below its chord the parabola through three states is in the middle of the last step.

    Not further than leaves it between the ends of the step.

    Args:
        before: At most two states: times [s] and temperatures (n,) [K].
        seconds: Time of the last [s].
        now: Its temperatures (n,) [K].
    """
    if len(before) < 2 or before[0][0] == before[1][0]:
        return np.zeros_like(now)
    (t0, a), (t1, b) = before
    h = seconds - t1
    curvature = ((now - b) / h - (b - a) / (t1 - t0)) / (seconds - t0)
    limit = np.abs(now - b) / 4
    return np.asarray(np.clip(curvature * h**2 / 4, -limit, limit))
