"""Extent and rate of cure: section cure of the summary."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mpi4py import MPI

import numpy as np

from app.foundation.arrays import Floats, Ints

LEVELS = (0.5, 0.9)


class _CuringRegion:
    """Cure recorded at the nodes of one region (n,), and times of reaching the levels (n, k)."""

    saved = ("degree", "rate", "reached", "fastest")

    def __init__(self, degree: Floats, seconds: float) -> None:
        self.degree: Floats = degree.copy()
        self.rate: Floats = np.zeros(len(degree))
        self.reached = np.where(degree[:, None] >= np.array(LEVELS), seconds, np.inf)
        self.fastest: Floats = self.rate


class CureRecord:
    """Degrees of cure of a run, as far as they are reported.

    The time at which a node reaches a degree is interpolated within the step by a cubic of time
    over degree, from degrees and rates at both ends of the step.

    Args:
        degrees: Degree of cure at this rank's own nodes of each curing region (n,).
        keys: Keys of these nodes (n,).
    """

    saved = ("_regions", "_seconds")

    def __init__(
        self,
        comm: MPI.Comm,
        degrees: Mapping[str, Floats],
        keys: Mapping[str, Ints],
        seconds: float = 0.0,
    ) -> None:
        self._comm, self._seconds = comm, seconds
        self.row_keys = {"_regions": keys}
        self._regions = {name: _CuringRegion(d, seconds) for name, d in degrees.items()}

    def update(
        self, seconds: float, degrees: Mapping[str, Floats], rates: Mapping[str, Floats]
    ) -> None:
        """Record an accepted step: its end [s], the degrees then (n,) and their rates [1/s]."""
        step = seconds - self._seconds
        for name, r in self._regions.items():
            degree, rate = degrees[name], rates[name]
            for k, level in enumerate(LEVELS):
                now = np.flatnonzero((degree >= level) & np.isinf(r.reached[:, k]))
                share = _crossing(
                    level, r.degree[now], degree[now], step * r.rate[now], step * rate[now]
                )
                r.reached[now, k] = self._seconds + step * share
            r.fastest = np.maximum(r.fastest, rate)
            r.degree, r.rate = degree.copy(), rate.copy()
        self._seconds = seconds

    def row(self) -> dict[str, float]:
        """Columns of history.csv for the last recorded state; collective."""
        result: dict[str, float] = {}
        for name, r in self._regions.items():
            low, high = self._range(r)
            result |= {f"{name} degree_min [-]": low, f"{name} degree_max [-]": high}
        return result

    def summary(self) -> dict[str, Any]:
        """Section ``cure`` of the summary; collective. Times not reached are None."""
        result = {}
        for name, r in self._regions.items():
            low, high = self._range(r)
            times = r.reached.max(axis=0, initial=-np.inf)
            self._comm.Allreduce(MPI.IN_PLACE, times, MPI.MAX)
            known = [float(t) if np.isfinite(t) else None for t in times]
            result[name] = {
                "degree_min": low,
                "degree_max": high,
                **dict(zip(("time_50", "time_90"), known, strict=True)),
                "rate_max": self._comm.allreduce(r.fastest.max(initial=0.0), MPI.MAX),
            }
        return result

    def _range(self, r: _CuringRegion) -> tuple[float, float]:
        low, high = -r.degree.min(initial=np.inf), r.degree.max(initial=-np.inf)
        low, high = np.max(self._comm.allgather((low, high)), axis=0)
        return -float(low), float(high)


def _crossing(level: float, start: Floats, end: Floats, before: Floats, after: Floats) -> Floats:
    """Fraction of a step (n,) after which degrees from ``start`` to ``end`` (n,) reach a level.

    A cubic in the degree, by the rates at both ends times the step (n,); zero: not known.
    """
    change = end - start
    s = np.divide(level - start, change, out=np.ones_like(start), where=change > 0)
    # Slopes of time over degree; three times the chord at most leaves the cubic monotone.
    a, b = (
        np.minimum(np.divide(change, rate, out=np.ones_like(start), where=rate > 0), 3.0)
        for rate in (before, after)
    )
    return np.asarray(s**2 * (3 - 2 * s) + s * (1 - s) ** 2 * a - s**2 * (1 - s) * b)
