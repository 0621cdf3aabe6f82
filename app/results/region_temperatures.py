"""Temperatures of one region over time: its peaks, its heat doses, and their numbers.

Peaks are those of the nodes; between steps the peak in time is that of a parabola, where the steps
before and after allow one. Heat doses follow the parabola through the step and the one before it in
straight pieces, bent no further than leaves it between the ends of the step; after a kink in the
heat source, the parabola that ends with the right slope.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem

from app.arrays import Bools, Floats
from app.heat import curves_in_time
from app.heat.curves_in_time import bend, bend_after_kink, peak_between, raise_to
from app.heat.nodes import ThermalNodes
from app.results.level_sets import RegionCells
from app.results.necrosis import CELSIUS, COUNTS_FROM, LEVELS, Exposure


class RegionTemperatures:
    """Values recorded at this rank's nodes of one region (n,), from an initial state on.

    Attributes:
        now: Temperatures of the last state [K].
        peak: Highest temperatures so far [K].
        peak_time: When they were [s].
        lowest: Lowest temperatures so far [K].
        exposure: Heat doses so far.
        before: Up to three states before the last one, newest last.
    """

    saved = ("now", "peak", "peak_time", "lowest", "exposure", "before")

    def __init__(
        self, nodes: ThermalNodes, temperatures: Sequence[fem.Function], seconds: float
    ) -> None:
        self.nodes = nodes
        self.now = self.lowest = nodes.values(temperatures)
        self.peak, self.peak_time = self.now.copy(), np.full(len(self.now), seconds)
        self.exposure = Exposure(len(self.now))
        self.before: list[curves_in_time.State] = []

    @property
    def begin(self) -> Floats:
        """Temperatures before the last recorded step."""
        return self.before[-1][1]

    @property
    def warm(self) -> Bools:
        """Nodes warm enough for doses at either end of that step."""
        return np.maximum(self.begin, self.now) > CELSIUS + COUNTS_FROM

    def take(self, last: float, temperatures: Sequence[fem.Function]) -> None:
        """Record the temperatures at the end of a step that began at time ``last``."""
        self.before = [*self.before[-2:], (last, self.now)]
        self.now = self.nodes.values(temperatures)
        self.lowest = np.minimum(self.lowest, self.now)

    def bend(self, seconds: float, rates: Sequence[Floats]) -> Floats:
        """Deviation of the middle of a step from a straight line [K].

        Args:
            seconds: Time at its end [s].
            rates: Rates of change then, of own nodes of the bodies, if it began with a kink [K/s].
        """
        last, now = self.before[-1], (seconds, self.now)
        if rates:
            return bend_after_kink(last, now, rates[self.nodes.body][self.nodes.dof])
        return bend(self.before[max(len(self.before) - 2, 0)], last, now)

    def expose(self, bends: Floats, pieces: int, step: float) -> None:
        """Add the doses of a step of some seconds, in straight pieces."""
        at, begin = np.linspace(0.0, 1.0, pieces + 1), self.begin
        curve = [begin + s * (self.now - begin) - 4 * s * (1 - s) * bends for s in at]
        for first, then in pairwise(curve):
            self.exposure.add(first, then, step / pieces)

    def raise_peak(self, seconds: float, highest: float) -> None:
        """Raise the peaks to those at and before a time, at most to ``highest``."""
        raise_to(self.peak, self.peak_time, self.now, np.full(len(self.now), seconds))
        states = [*self.before, (seconds, self.now)]
        if len(states) == 4 and all(a[0] < b[0] for a, b in pairwise(states)):
            peak, time = peak_between(*states)
            raise_to(self.peak, self.peak_time, np.minimum(peak, highest), time)

    # The summary

    def temperatures(self, comm: MPI.Comm, cells: RegionCells) -> dict[str, Any]:
        """Extremes and mean [degC], and volumes warmer than each level; collective."""
        volume = self.nodes.volume

        def total(values: Floats) -> float:
            return float(comm.allreduce(float(values.sum()), MPI.SUM))

        peak, place, when = largest(comm, self.peak, self.nodes.x, self.peak_time)
        end = comm.allreduce(self.now.max(initial=-np.inf), MPI.MAX)
        lowest = comm.allreduce(self.lowest.min(initial=np.inf), MPI.MIN)
        result: dict[str, Any] = {
            "temperature_max": peak - CELSIUS,
            "temperature_max_at": place,
            "temperature_max_time": when,
            "temperature_min": lowest - CELSIUS,
            "temperature_mean": total(volume * self.now) / total(volume) - CELSIUS,
            "temperature_end_max": end - CELSIUS,
        }
        for level in LEVELS:
            over = self.peak - CELSIUS - level
            result[f"volume_over_{level:g}"] = cells.volume(self.nodes.dof, over)
        return result

    def times(self, comm: MPI.Comm) -> dict[str, float]:
        """Longest time of a node above each level [s]; collective."""
        over = self.exposure.over.T
        return {f"seconds_over_{x:g}": _longest(comm, over[k]) for k, x in enumerate(LEVELS)}

    def dead(self, comm: MPI.Comm, cells: RegionCells, surface: Floats) -> dict[str, float]:
        """Largest thermal doses, and dead volume and depth by criterion; collective.

        Depth is measured from triangles of a surface (f, 3, 3) [mm].
        """
        x, dof = self.exposure, self.nodes.dof
        result = {
            "cem43_max": _longest(comm, x.cem43),
            "henriques_moritz_max": _longest(comm, x.damage),
        }
        for criterion, level in x.levels().items():
            result[f"necrosis_{criterion}_volume"] = cells.volume(dof, level)
            if len(surface):
                result[f"necrosis_{criterion}_depth"] = cells.depth(dof, level, surface)
        return result


def _longest(comm: MPI.Comm, dose: Floats) -> float:
    return float(comm.allreduce(float(dose.max(initial=0.0)), MPI.MAX))


def largest(
    comm: MPI.Comm, values: Floats, x: Floats, times: Floats
) -> tuple[float, list[float], float]:
    """Largest value of all ranks with place and time; of equal values the first place."""
    best = (-np.inf, [0.0, 0.0, 0.0], 0.0)
    if len(values):
        equal = np.flatnonzero(values == values.max())
        k = equal[np.lexsort(x[equal].T[::-1])[0]]
        best = (float(values[k]), [float(c) for c in x[k]], float(times[k]))
    return min(comm.allgather(best), key=lambda b: (-b[0], b[1]))
