"""Reduction of nodal values over time: maxima, times above a level, other integrals.

A reduction has one number for each owned node of a region. It is updated at every accepted step.
`maxima` and `largest_of_ranks` reduce the nodes of all ranks to the reported numbers.

Between steps values follow parabolas. A maximum between two steps is the vertex of a parabola
through one of them and its neighbours (`peak_between`). An integral over a step uses a parabola
through the ends of the step and the step before, divided into straight pieces. The depth of this
parabola below its chord is its `sagitta`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise

from mpi4py import MPI

import numpy as np

from app.foundation.arrays import Floats

# A time [s] and the values at this time (n,).
State = tuple[float, Floats]
# Integral over an interval of time of a function of the value, at each node. Arguments: values at
# the start and at the end (n,), linear in between, and the duration [s].
Measure = Callable[[Floats, Floats, float], Floats]


class Maximum:
    """Largest value of each node so far (n,), and its time [s] (n,)."""

    saved = ("value", "time")

    def __init__(self, value: Floats, seconds: float) -> None:
        self.value = value.copy()
        self.time = np.full(len(value), seconds)

    def update(self, value: Floats, seconds: Floats | float) -> None:
        """Update with values (n,) at one time [s], or at a time for each node (n,) [s]."""
        higher = value > self.value
        self.value[higher] = value[higher]
        self.time[higher] = np.broadcast_to(seconds, value.shape)[higher]


class Integrals:
    """Integrals over time of some functions of a value, at n nodes.

    Attributes:
        totals: Integral at each node (n,), by the name of its function; NaN if unknown.
    """

    saved = ("totals",)

    def __init__(self, measures: Mapping[str, Measure], n: int) -> None:
        self._measures = measures
        self.totals: dict[str, Floats] = {name: np.zeros(n) for name in measures}

    def add(self, start: Floats, end: Floats, seconds: float) -> None:
        """Add an interval in which the value changes linearly from start to end (n,)."""
        for name, measure in self._measures.items():
            self.totals[name] += measure(start, end, seconds)

    def add_parabola(
        self, start: Floats, end: Floats, sagittas: Floats, step: float, pieces: int
    ) -> None:
        """Add a step as straight pieces of parabolas with ``sagittas`` (n,)."""
        curve = [
            start + s * (end - start) - 4 * s * (1 - s) * sagittas
            for s in np.linspace(0.0, 1.0, pieces + 1)
        ]
        for piece_start, piece_end in pairwise(curve):
            self.add(piece_start, piece_end, step / pieces)

    def forget(self) -> None:
        """Make all integrals unknown from now on."""
        for total in self.totals.values():
            total[:] = np.nan

    @property
    def forgotten(self) -> bool:
        """Return True if integrals of a node are unknown."""
        return any(bool(np.isnan(total).any()) for total in self.totals.values())


# Over all ranks


def maxima(comm: MPI.Comm, values: Mapping[str, Floats]) -> dict[str, float]:
    """Return the maximum of each array over all ranks; minus infinity if empty; collective."""
    local = [of_name.max(initial=-np.inf) for of_name in values.values()]
    local_maxima = np.array(local, dtype=np.float64)
    comm.Allreduce(MPI.IN_PLACE, local_maxima, MPI.MAX)
    return dict(zip(values, map(float, local_maxima), strict=True))


def largest_of_ranks(
    comm: MPI.Comm, values: Floats, x: Floats, times: Floats
) -> tuple[float, list[float], float]:
    """Return the largest value of all ranks with its place and time; collective.

    Of equal values it is the one with the first place.
    """
    largest_place = (-np.inf, [0.0, 0.0, 0.0], 0.0)
    if len(values):
        equal = np.flatnonzero(values == values.max())
        k = equal[np.lexsort(x[equal].T[::-1])[0]]
        largest_place = (float(values[k]), [float(c) for c in x[k]], float(times[k]))
    return min(comm.allgather(largest_place), key=lambda b: (-b[0], b[1]))


# Between steps


def peak_between(s0: State, s1: State, s2: State, s3: State) -> tuple[Floats, Floats]:
    """Return the peaks between the second and the third of four states, at increasing times.

    A peak is the vertex of the parabola through the higher one of the two states and its
    neighbours. It is limited by the lines through the first two and through the last two states, so
    that heating that is switched off causes no peak.

    Returns:
        Values (n,), minus infinity without a peak, and times (n,).
    """
    (t0, a), (t1, b), (t2, c), (t3, d) = s0, s1, s2, s3
    slope_before = (b - a) / (t1 - t0)
    slope_between = (c - b) / (t2 - t1)
    slope_after = (d - c) / (t3 - t2)
    peaks_early = b >= c
    curvature = np.where(
        peaks_early,
        (slope_between - slope_before) / (t2 - t0),
        (slope_after - slope_between) / (t3 - t1),
    )
    inside = (slope_before > 0) & (slope_after < 0) & (curvature < 0)
    curvature = np.where(inside, curvature, -1.0)
    # Slope at the second state.
    slope = slope_between - curvature * (t2 - t1)
    when = t1 - slope / (2 * curvature)
    inside &= (when > t1) & (when < t2)
    # Time from the second state to the intersection of the two lines.
    meeting_time = np.divide(
        c - b - slope_after * (t2 - t1),
        slope_before - slope_after,
        out=np.zeros_like(b),
        where=inside,
    )
    bound = np.minimum(b + slope_before * meeting_time, c - slope_after * (t2 - t1 - meeting_time))
    bound = np.maximum(bound, np.maximum(b, c))
    value = np.minimum(b - slope**2 / (4 * curvature), bound)
    return np.where(inside, value, -np.inf), np.where(inside, when, t1)


def sagitta(previous: State, start: State, end: State) -> Floats:
    """Return the sagitta (n,): the depth of a parabola below its chord in the middle of a step.

    The parabola passes through the ends of the step and the state before. Its depth is limited so
    that its values stay between the values at the ends.
    """
    (t0, a), (t1, b), (t2, c) = previous, start, end
    if not t0 < t1 < t2:
        return np.zeros_like(c)
    h = t2 - t1
    curvature = ((c - b) / h - (b - a) / (t1 - t0)) / (t2 - t0)
    return limited_sagitta(curvature * h**2 / 4, b, c)


def sagitta_after_kink(rate: Floats, start: State, end: State) -> Floats:
    """Return the sagitta (n,) from the rate of change (n,) at the end of the step."""
    (t1, b), (t2, c) = start, end
    return limited_sagitta((rate * (t2 - t1) - (c - b)) / 4, b, c)


def limited_sagitta(sagittas: Floats, start: Floats, end: Floats) -> Floats:
    """Limit sagittas (n,) so that parabolas stay between the values at their ends (n,)."""
    largest_sagitta = np.abs(end - start) / 4
    return np.asarray(np.clip(sagittas, -largest_sagitta, largest_sagitta))
