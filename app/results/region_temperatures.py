"""Temperatures of one region over time: its peaks, its heat doses, and their numbers.

Peaks are those of the nodes; between steps the peak in time is that of a parabola, where the steps
before and after allow one. Heat doses follow the parabola through the step and the one before it in
straight pieces, bent no further than leaves it between the ends of the step; after a kink in the
heat source, the parabola that ends with the right slope.

Hot or dead volume and its depth are where a level, linear in cells, is positive. Counting nodes
would move in steps of the mesh, which has few cells across the dead zone.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from app.foundation.arrays import Bools, Floats, Ints
from app.heat.heat_forms import HeatForms
from app.heat.nodes import ThermalNodes
from app.results.necrosis import CELSIUS, COUNTS_FROM, LEVELS, Exposure

_EDGES = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])
_FACES = np.array([(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)])


class RegionCells:
    """Cells of a region that this rank owns."""

    def __init__(self, forms: HeatForms, region: str) -> None:
        self._comm = forms.comm
        self._dofs = forms.space.dofmap.list[forms.cells(region)].astype(np.int64)
        self._x = forms.space.tabulate_dof_coordinates()[self._dofs]
        volume = np.abs(np.linalg.det(self._x[:, 1:] - self._x[:, :1])) / 6
        flat, true = self._comm.allreduce(
            np.array([volume.sum(), forms.volumes(region).sum()]), MPI.SUM
        )
        # Curved cells have a little more than their corners span.
        self._volume = volume * (true / flat)
        self._spread = fem.Function(forms.space)

    def _at_corners(self, dof: Ints, values: Floats, away: float) -> Floats:
        """Values of own nodes at the corners of cells (m, 4), ``away`` elsewhere; collective."""
        self._spread.x.array[:] = away
        self._spread.x.array[dof] = values
        self._spread.x.scatter_forward()
        return np.asarray(self._spread.x.array[self._dofs])

    def faces(self, dof: Ints) -> Floats:
        """Faces with all corners among own nodes (f, 3, 3) [mm], on every rank; collective."""
        on = self._at_corners(dof, np.ones(len(dof)), 0.0)[:, _FACES].all(axis=2)
        return np.concatenate(self._comm.allgather(self._x[:, _FACES][on]))

    def volume(self, dof: Ints, level: Floats) -> float:
        """Volume where a level, known at own nodes (n,), is not negative [mm3]; collective."""
        share = positive_share(self._at_corners(dof, level, -1.0))
        return float(self._comm.allreduce(float(self._volume @ share), MPI.SUM))

    def depth(self, dof: Ints, level: Floats, surface: Floats) -> float:
        """Depth to which a level, known at own nodes (n,), is not negative [mm]; collective.

        It is measured from the triangles of a surface (f, 3, 3) [mm], at least one.
        """
        from meshes.mantle import distance  # imported late: scipy takes its time

        f = self._at_corners(dof, level, -1.0)
        depth = 0.0
        ends, x = f[:, _EDGES], self._x[:, _EDGES]
        # Where edges leave the volume.
        cut = (ends.max(axis=2) >= 0) & (ends.min(axis=2) < 0)
        (a, b), (first, second) = ends[cut].T, x[cut].swapaxes(0, 1)
        points = first + (a / (a - b))[:, None] * (second - first)
        points = np.concatenate([points, self._x[f >= 0]])
        if len(points):
            depth = float(distance(np.unique(points, axis=0), surface).max())
        return float(self._comm.allreduce(depth, MPI.MAX))


def positive_share(f: Floats) -> Floats:
    """Fraction of each tetrahedron where f, linear between corners (m, 4), is not negative (m,)."""
    f = -np.sort(-f, axis=1)
    a, b, c, d = f.T
    count = (f >= 0).sum(axis=1)

    def cut(high: Floats, low: Floats, here: NDArray[np.bool_]) -> Floats:
        """Position along an edge at which it crosses zero, from its higher end."""
        return np.divide(high, high - low, out=np.zeros_like(high), where=here & (high > low))

    share = np.where(count == 4, 1.0, 0.0)
    one, two, three = (count == n for n in (1, 2, 3))
    share += np.where(one, cut(a, b, one) * cut(a, c, one) * cut(a, d, one), 0.0)
    ac, ad, bc, bd = cut(a, c, two), cut(a, d, two), cut(b, c, two), cut(b, d, two)
    share += np.where(two, ac * ad + ac * (1 - ad) * bd + (1 - ac) * bc * bd, 0.0)
    rest = (1 - cut(a, d, three)) * (1 - cut(b, d, three)) * (1 - cut(c, d, three))
    return np.asarray(share + np.where(three, 1 - rest, 0.0))


# A time [s] and the temperatures at it (n,) [K].
State = tuple[float, Floats]


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
        self.before: list[State] = []

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

        It ends at some seconds with rates of change [K/s], which are given if it began with a kink.
        """
        last, now = self.before[-1], (seconds, self.now)
        if rates:  # the state before is of no use
            rise = rates[self.nodes.body][self.nodes.dof] * (seconds - last[0])
            return _between((rise - (self.now - last[1])) / 4, last[1], self.now)
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


def _between(bend: Floats, start: Floats, end: Floats) -> Floats:
    limit = np.abs(end - start) / 4
    return np.asarray(np.clip(bend, -limit, limit))
