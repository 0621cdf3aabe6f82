"""Temperature between the time steps, interpolated from neighbouring steps."""

from __future__ import annotations

import numpy as np

from app.arrays import Floats

# A time [s] and the temperatures at it (n,) [K].
State = tuple[float, Floats]


def raise_to(peak: Floats, time: Floats, value: Floats, when: Floats) -> None:
    """Update peaks and their times in place where a value is higher (n,)."""
    higher = value > peak
    peak[higher], time[higher] = value[higher], when[higher]


def peak_between(s0: State, s1: State, s2: State, s3: State) -> tuple[Floats, Floats]:
    """Peaks between the middle ones of four states, at rising times.

    The vertex of the parabola through three of them, the hottest in the middle, but no higher than
    straight lines through the two states before and through the two after: heating that is switched
    off leaves no peak.

    Returns:
        Temperatures (n,), minus infinity without a peak, and times (n,).
    """
    (t0, a), (t1, b), (t2, c), (t3, d) = s0, s1, s2, s3
    before, across, after = (b - a) / (t1 - t0), (c - b) / (t2 - t1), (d - c) / (t3 - t2)
    early = b >= c
    curvature = np.where(early, (across - before) / (t2 - t0), (after - across) / (t3 - t1))
    inside = (before > 0) & (after < 0) & (curvature < 0)
    curvature = np.where(inside, curvature, -1.0)
    # Slope at the first of the two.
    slope = across - curvature * (t2 - t1)
    when = t1 - slope / (2 * curvature)
    inside &= (when > t1) & (when < t2)
    meet = np.divide(c - b - after * (t2 - t1), before - after, out=np.zeros_like(b), where=inside)
    bound = np.minimum(b + before * meet, c - after * (t2 - t1 - meet))
    bound = np.maximum(bound, np.maximum(b, c))
    value = np.minimum(b - slope**2 / (4 * curvature), bound)
    return np.where(inside, value, -np.inf), np.where(inside, when, t1)


def bend(before: State, start: State, end: State) -> Floats:
    """Depth of a parabola below its chord in the middle of the last step (n,) [K].

    It passes through the ends of the step and the state before; its bend is limited so that it
    stays between the ends.
    """
    (t0, a), (t1, b), (t2, c) = before, start, end
    if not t0 < t1 < t2:
        return np.zeros_like(c)
    h = t2 - t1
    curvature = ((c - b) / h - (b - a) / (t1 - t0)) / (t2 - t0)
    return _between(curvature * h**2 / 4, b, c)


def bend_after_kink(start: State, end: State, rate: Floats) -> Floats:
    """As `bend` where the state before is of no use, by the rate of change at the end [K/s]."""
    (t1, b), (t2, c) = start, end
    return _between((rate * (t2 - t1) - (c - b)) / 4, b, c)


def _between(bend: Floats, start: Floats, end: Floats) -> Floats:
    limit = np.abs(end - start) / 4
    return np.asarray(np.clip(bend, -limit, limit))
