"""How hot it gets, where and when, for how long, and what that kills: sections thermal and cure.

A record takes the temperatures of every accepted step. Peaks are those of the nodes; between
steps the peak in time is that of a parabola, where the steps before and after leave room for it.
Heat doses follow the parabola through the step and the one before it in straight pieces, bent no
further than leaves it between the ends of the step; after a kink in what heats, the parabola that
ends with the right slope.

Temperatures are K inside and degC in what is reported; the other units are those of ``UNITS``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from mantle.arrays import Floats
from mantle.forms import interface_heat
from mantle.heat import curves_in_time
from mantle.heat.assembly import HeatForms
from mantle.heat.curves_in_time import bend, bend_after_kink, peak_between, raise_to
from mantle.heat.nodes import (
    ProbedPoint,
    Probes,
    Side,
    ThermalNodes,
    pairs_of,
    region_nodes,
    sides_of,
)
from mantle.heat.temperature_jumps import TemperatureJumps
from mantle.meshes.distribute import TaggedMesh
from mantle.numerics.state import Rows, State, keyed, node_keys
from mantle.results.level_sets import RegionCells
from mantle.results.necrosis import CELSIUS, COUNTS_FROM, LEVELS, Exposure

Interfaces = Mapping[str, tuple[Sequence[str], Sequence[str]]]

W_PER_M2 = 1e3  # W/m2 in N/(mm s), W/(m2 K) in N/(mm s K)
# A piece of a step departs from the parabola by this [K] at most, unless it takes too many.
_STRAIGHT = 0.01
_MOST_PIECES = 8
TIMELESS = (
    "no times above a temperature, thermal doses or dead bone: a steady stage does not know how "
    "long its heat took; give it a duration"
)


@dataclass
class _Region:
    """Values recorded at the nodes of one region (n,)."""

    nodes: ThermalNodes
    now: Floats
    peak: Floats
    peak_time: Floats
    lowest: float
    exposure: Exposure
    # The states before, newest last.
    before: list[curves_in_time.State] = field(default_factory=list)

    @property
    def begin(self) -> Floats:
        """Temperatures before the step last taken in."""
        return self.before[-1][1]


@dataclass
class _Extremes:
    """Largest jump and flux, entropy production of one interface on this rank."""

    jump: float = 0.0
    flux: float = 0.0
    entropy_min: float = np.inf
    entropy_max: float = -np.inf


@dataclass(frozen=True)
class HeatPassed:
    """Heat flux and entropy production at this rank's points of conducting interfaces (n,).

    Attributes:
        names: Names of the interfaces.
        interface: Which of them each point belongs to.
        flux: Heat from master to slave per area [N/(mm s)].
        entropy: Entropy production per area [N/(mm s K)].
    """

    names: tuple[str, ...]
    interface: NDArray[np.int64]
    flux: Floats
    entropy: Floats


def exchange(
    names: Sequence[str],
    jumps: TemperatureJumps,
    temperatures: Sequence[fem.Function],
    τ: Floats,
    friction: Floats,
    share: Floats,
) -> HeatPassed:
    """Flux and entropy production at the points of finite conductance.

    Args:
        names: Names of the interfaces.
        jumps: Their points.
        temperatures: Of the bodies [K].
        τ: Jumps at own points (n,) [K].
        friction: Friction heat per area there (n,) [N/(mm s)].
        share: The part of it that goes into the slave (n,).
    """
    table = np.stack([t.x.array[jumps.dof] for t in temperatures])
    master, slave = (table[jumps.bodies[:, k], np.arange(len(jumps.dof))] for k in (0, 1))
    q = jumps.flux(τ)[0]
    s = np.asarray(interface_heat.entropy_production(q, friction, share, master, slave))
    return HeatPassed(tuple(names), jumps.interface, q, s)


class ThermalRecord:
    """Temperatures of a run, as far as they are reported.

    Attributes:
        bone: Regions of bone.
        seconds: Times of the states taken in, the initial one first [s].
        rows: What `row` gave at each of them.
        hottest: Temperatures of the bodies (nodes of this rank, ghosts too) [K] when the bone side
            of the interfaces, or without bone the whole model after the start, was hottest.
        hottest_time: When that was [s].
        hottest_at: Where it was hottest then (3,) [mm].
    """

    def __init__(
        self,
        tagged: TaggedMesh,
        forms: HeatForms,
        of_region: Mapping[str, int],
        interfaces: Interfaces,
        bone: Sequence[str],
        probes: Sequence[ProbedPoint],
    ) -> None:
        """Find nodes, sides and probes; collective. `start` comes next.

        Args:
            tagged: The mesh.
            forms: The forms of heat on it.
            of_region: Thermal body of each region.
            interfaces: Regions on the first and second side of each interface, in the order of the
                case.
            bone: Regions of bone.
            probes: Named points.

        Raises:
            InputError: A probe is not in its region.
        """
        self._comm, self._forms = forms.comm, forms
        self._nodes = region_nodes(forms, tuple(tagged.regions), of_region)
        self._interfaces = interfaces
        self._sides = {name: sides_of(self._nodes, sides) for name, sides in interfaces.items()}
        self._pairs = {name: pairs_of(self._nodes, sides) for name, sides in interfaces.items()}
        self.bone = bone
        self._bone_sides = _bone_sides(interfaces, self._sides, bone)
        self._probes = Probes(tagged, forms.space, of_region, probes)
        self._extremes = {name: _Extremes() for name in interfaces}
        self._regions: dict[str, _Region] = {}
        self.seconds: list[float] = []
        self.rows: list[dict[str, float]] = []

    def start(self, temperatures: Sequence[fem.Function], seconds: float = 0.0) -> None:
        """Take in the initial state; collective."""
        for name, nodes in self._nodes.items():
            T = nodes.values(temperatures)
            self._regions[name] = _Region(
                nodes,
                T,
                T.copy(),
                np.full(len(T), seconds),
                float(T.min(initial=np.inf)),
                Exposure.of(len(T)),
            )
        self._watched = -np.inf
        self._take(seconds, temperatures)

    def update(
        self,
        seconds: float,
        temperatures: Sequence[fem.Function],
        exchanges: Sequence[HeatPassed] = (),
        highest: float = np.inf,
        rates: Sequence[Floats] = (),
    ) -> None:
        """Take in an accepted step; collective.

        How long the way to a steady state takes is not known: it adds to peaks, and leaves doses
        without a value unless nothing is as warm as what counts, before it and after it.

        Args:
            seconds: Time at its end [s].
            temperatures: Of the bodies then [K].
            exchanges: What passes the interfaces of finite conductance then, if there are any.
            highest: Where temperatures have to stay below [K], between steps too.
            rates: If what heats has a kink where the step began, so that the states before say
                nothing of it: rates of change at its end, of own nodes of the bodies [K/s].
        """
        step = seconds - self.seconds[-1]
        for r in self._regions.values():
            r.before = [*r.before[-2:], (self.seconds[-1], r.now)]
            r.now = r.nodes.values(temperatures)
            r.lowest = min(r.lowest, float(r.now.min(initial=np.inf)))
        if step > 0:
            self._expose(seconds, rates)
        elif self._warm():
            for r in self._regions.values():
                r.exposure.forget()
        for r in self._regions.values():
            raise_to(r.peak, r.peak_time, r.now, np.full(len(r.now), seconds))
            states = [*r.before, (seconds, r.now)]
            if len(states) == 4 and all(a[0] < b[0] for a, b in pairwise(states)):
                peak, time = peak_between(*states)
                raise_to(r.peak, r.peak_time, np.minimum(peak, highest), time)
        for e in exchanges:
            for i, name in enumerate(e.names):
                self._extremes_of(name, e.flux[e.interface == i], e.entropy[e.interface == i])
        self._take(seconds, temperatures)

    def _expose(self, seconds: float, rates: Sequence[Floats]) -> None:
        """Count the doses of a step, in as many straight pieces as its curvature asks for."""
        bends = {}
        for name, r in self._regions.items():
            last, now = r.before[-1], (seconds, r.now)
            bends[name] = (
                bend_after_kink(last, now, rates[r.nodes.body][r.nodes.dof])
                if rates
                else bend(r.before[max(len(r.before) - 2, 0)], last, now)
            )
        warm = {
            name: np.maximum(r.begin, r.now) > CELSIUS + COUNTS_FROM
            for name, r in self._regions.items()
        }
        local = max(float(np.abs(b[warm[n]]).max(initial=0.0)) for n, b in bends.items())
        worst = self._comm.allreduce(local, MPI.MAX)
        pieces = int(np.clip(np.ceil(np.sqrt(worst / _STRAIGHT)), 1, _MOST_PIECES))
        at = np.linspace(0.0, 1.0, pieces + 1)
        step = seconds - self.seconds[-1]
        for name, r in self._regions.items():
            curve = [r.begin + s * (r.now - r.begin) - 4 * s * (1 - s) * bends[name] for s in at]
            for begin, end in pairwise(curve):
                r.exposure.add(begin, end, step / pieces)

    def _warm(self) -> bool:
        """Whether anything is warm enough for doses at either end of a step; collective."""
        local = (np.maximum(r.begin, r.now).max(initial=0.0) for r in self._regions.values())
        hottest = self._comm.allreduce(max(map(float, local)), MPI.MAX)
        return bool(hottest > CELSIUS + COUNTS_FROM)

    def _extremes_of(self, name: str, flux: Floats, entropy: Floats) -> None:
        x = self._extremes[name]
        x.flux = max(x.flux, float(np.abs(flux).max(initial=0.0)))
        x.entropy_min = min(x.entropy_min, float(entropy.min(initial=np.inf)))
        x.entropy_max = max(x.entropy_max, float(entropy.max(initial=-np.inf)))

    def _take(self, seconds: float, temperatures: Sequence[fem.Function]) -> None:
        """Keep what is shown over time, and the hottest state."""
        now = {name: r.now for name, r in self._regions.items()}
        names, values = [], []
        for name, T in now.items():
            names.append(f"{name} temperature_max [degC]")
            values.append(T.max(initial=-np.inf) - CELSIUS)
        for name, sides in self._sides.items():
            for which, side in zip(("first", "second"), sides, strict=True):
                names.append(f"{name} temperature_max_{which} [degC]")
                values.append(side.gather(now).max(initial=-np.inf) - CELSIUS)
            jump = np.abs(self._pairs[name].jump(temperatures)).max(initial=0.0)
            names.append(f"{name} temperature_jump_max [K]")
            values.append(jump)
            self._extremes[name].jump = max(self._extremes[name].jump, float(jump))
        over_all = np.array(values, dtype=np.float64)
        self._comm.Allreduce(MPI.IN_PLACE, over_all, MPI.MAX)
        row = dict(zip(names, map(float, over_all), strict=True))
        probed = self._probes.values(temperatures) - CELSIUS
        row |= {f"{p} [degC]": float(T) for p, T in zip(self._probes.names, probed, strict=True)}
        self.seconds.append(seconds)
        self.rows.append(row)
        self._watch(seconds, temperatures)

    def _watch(self, seconds: float, temperatures: Sequence[fem.Function]) -> None:
        """Keep the state if it is the hottest where it matters."""
        every = [Side({name: np.arange(len(n.dof)) for name, n in self._nodes.items()})]
        sides = self._bone_sides or every
        now = {name: r.now for name, r in self._regions.items()}
        places = {name: n.x for name, n in self._nodes.items()}
        T, x = (np.concatenate([side.gather(f) for side in sides]) for f in (now, places))
        hot, place, _ = _largest(self._comm, T, x, T)
        initial = not self._bone_sides and len(self.seconds) == 2
        if hot > self._watched or initial:
            self._watched, self.hottest_time, self.hottest_at = hot, seconds, place
            self.hottest = [t.x.array.copy() for t in temperatures]

    def row(self) -> dict[str, float]:
        """Columns of history.csv for the state last taken in."""
        return {"seconds [s]": self.seconds[-1], **self.rows[-1]}

    def curves(self) -> dict[str, Floats]:
        """Temperatures over time by what they are of [degC]: hottest nodes, and probes."""
        labels = {}
        for name, sides in self._interfaces.items():
            for which, regions in zip(("first", "second"), sides, strict=True):
                column = f"{name} temperature_max_{which} [degC]"
                labels[column] = f"{name}, {' + '.join(regions)} side"
        labels |= {f"{name} temperature_max [degC]": f"{name}, hottest" for name in self._nodes}
        labels |= {f"{p} [degC]": f"probe {p}" for p in self._probes.names}
        return {
            label: np.array([row[column] for row in self.rows]) for column, label in labels.items()
        }

    def moved(self, capacities: Mapping[str, float]) -> float:
        """Heat that has moved since the state before the last step, however it went [N mm].

        Args:
            capacities: Heat capacity of each region [N/(mm2 K)].
        """
        local = sum(
            capacities[name] * float(r.nodes.volume @ np.abs(r.now - r.begin))
            for name, r in self._regions.items()
        )
        return float(self._comm.allreduce(local, MPI.SUM))

    def exposure(self, region: str) -> tuple[ThermalNodes, Exposure]:
        """Nodes of a region and what they have been exposed to so far."""
        return self._nodes[region], self._regions[region].exposure

    # What a run remembers

    def state(self) -> State:
        """All that is history; collective."""
        comm, nodes = self._comm, node_keys(self._forms.space)
        extremes = {}
        for name, e in self._extremes.items():
            highest = np.array([e.jump, e.flux, -e.entropy_min, e.entropy_max])
            comm.Allreduce(MPI.IN_PLACE, highest, MPI.MAX)
            extremes[name] = highest.tolist()
        regions = {}
        for name, r in self._regions.items():
            x, keys = r.exposure, nodes[r.nodes.dof]
            columns = [r.now, r.peak, r.peak_time, x.cem43, x.damage, *x.over]
            regions[name] = {
                "nodes": Rows(keys, np.column_stack(columns)),
                "lowest": comm.allreduce(r.lowest, MPI.MIN),
                "before": [[t, keyed(keys, T)] for t, T in r.before],
            }
        return {
            "seconds": list(self.seconds),
            "rows": list(self.rows),
            "watched": self._watched,
            "hottest": [keyed(nodes, T[: self._forms.owned]) for T in self.hottest],
            "hottest_time": self.hottest_time,
            "hottest_at": self.hottest_at,
            "extremes": extremes,
            "regions": regions,
        }

    def resume(self, state: State) -> None:
        """Restore times, rows, temperatures, extremes and exposures; collective."""
        nodes, function = node_keys(self._forms.space), fem.Function(self._forms.space)
        self.seconds, self.rows = list(state["seconds"]), list(state["rows"])
        self._watched = state["watched"]
        self.hottest_time, self.hottest_at = state["hottest_time"], state["hottest_at"]
        self.hottest = []
        for found in state["hottest"]:
            function.x.array[: self._forms.owned] = found.of(nodes)
            function.x.scatter_forward()
            self.hottest.append(function.x.array.copy())
        for name, (jump, flux, low, high) in state["extremes"].items():
            self._extremes[name] = _Extremes(jump, flux, -low, high)
        for name, found in state["regions"].items():
            r = self._regions[name]
            keys = nodes[r.nodes.dof]
            r.now, r.peak, r.peak_time, cem43, damage, *over = (
                column.copy() for column in found["nodes"].of(keys).T
            )
            r.exposure = Exposure(np.array(over), cem43, damage)
            r.lowest = found["lowest"]
            r.before = [(t, T.of(keys)) for t, T in found["before"]]

    # The summary

    def summary(self) -> dict[str, Any]:
        """Section ``thermal`` of the summary; collective."""
        cells = {name: RegionCells(self._forms, name) for name in self._nodes}
        surface = self._bone_surface(cells)
        regions = {name: self._region(r, cells[name]) for name, r in self._regions.items()}
        result: dict[str, Any] = {
            "regions": regions,
            "interfaces": {name: self._interface(name) for name in self._sides},
        }
        local = any(r.exposure.forgotten for r in self._regions.values())
        if self._comm.allreduce(local, MPI.LOR):
            return result | {"note": TIMELESS}
        for name, r in self._regions.items():
            regions[name] |= self._times(r)
        for name in self.bone:
            regions[name] |= self._dead(self._regions[name], cells[name], surface)
        return result

    def _region(self, r: _Region, cells: RegionCells) -> dict[str, Any]:
        comm, volume = self._comm, r.nodes.volume

        def total(values: Floats) -> float:
            return float(comm.allreduce(float(values.sum()), MPI.SUM))

        peak, place, when = _largest(comm, r.peak, r.nodes.x, r.peak_time)
        result: dict[str, Any] = {
            "temperature_max": peak - CELSIUS,
            "temperature_max_at": place,
            "temperature_max_time": when,
            "temperature_min": comm.allreduce(r.lowest, MPI.MIN) - CELSIUS,
            "temperature_mean": total(volume * r.now) / total(volume) - CELSIUS,
            "temperature_end_max": comm.allreduce(r.now.max(initial=-np.inf), MPI.MAX) - CELSIUS,
        }
        for level in LEVELS:
            result[f"volume_over_{level:g}"] = cells.volume(r.nodes.dof, r.peak - CELSIUS - level)
        return result

    def _longest(self, dose: Floats) -> float:
        """Largest dose of a region; collective."""
        return float(self._comm.allreduce(float(dose.max(initial=0.0)), MPI.MAX))

    def _times(self, r: _Region) -> dict[str, float]:
        """Longest time of a node of a region above each level [s]."""
        over = r.exposure.over
        return {f"seconds_over_{x:g}": self._longest(over[k]) for k, x in enumerate(LEVELS)}

    def _dead(self, r: _Region, cells: RegionCells, surface: Floats) -> dict[str, float]:
        """Largest thermal doses of a region of bone, and dead volume and depth by criterion."""
        result = {
            f"{name}_max": self._longest(dose)
            for name, dose in (("cem43", r.exposure.cem43), ("henriques_moritz", r.exposure.damage))
        }
        for criterion, level in r.exposure.levels().items():
            result[f"necrosis_{criterion}_volume"] = cells.volume(r.nodes.dof, level)
            if len(surface):
                depth = cells.depth(r.nodes.dof, level, surface)
                result[f"necrosis_{criterion}_depth"] = depth
        return result

    def _bone_surface(self, cells: Mapping[str, RegionCells]) -> Floats:
        """Where bone meets what is not bone, as triangles (f, 3, 3) [mm]; on every rank."""
        found: list[Floats] = [np.zeros((0, 3, 3))]
        for side in self._bone_sides:
            for region, rows in side.rows.items():
                found.append(cells[region].faces(self._nodes[region].dof[rows]))
        return np.concatenate(found)

    def _interface(self, name: str) -> dict[str, Any]:
        comm, e = self._comm, self._extremes[name]
        result: dict[str, Any] = {}
        columns = [
            {n: values(r) for n, r in self._regions.items()}
            for values in (lambda r: r.peak, lambda r: r.nodes.x, lambda r: r.peak_time)
        ]
        for which, side in zip(("first", "second"), self._sides[name], strict=True):
            peak, place, when = _largest(comm, *(side.gather(c) for c in columns))
            result[f"temperature_max_{which}"] = peak - CELSIUS
            result[f"temperature_max_{which}_at"] = place
            result[f"temperature_max_{which}_time"] = when
        result["temperature_jump_max"] = float(comm.allreduce(e.jump, MPI.MAX))
        low = float(comm.allreduce(e.entropy_min, MPI.MIN))
        if low < np.inf:
            # Where both sides have one temperature nothing of this is known.
            result["heat_flux_max"] = W_PER_M2 * float(comm.allreduce(e.flux, MPI.MAX))
            result["entropy_production_min"] = W_PER_M2 * low
            high = float(comm.allreduce(e.entropy_max, MPI.MAX))
            result["entropy_production_max"] = W_PER_M2 * high
        return result


def _bone_sides(
    interfaces: Interfaces, sides: Mapping[str, tuple[Side, Side]], bones: Sequence[str]
) -> list[Side]:
    """The bone side of each interface between bone and something else."""
    found = []
    for name, regions in interfaces.items():
        bone = [not set(bones).isdisjoint(side) for side in regions]
        found += [sides[name][k] for k in (0, 1) if bone[k] and not bone[1 - k]]
    return found


def _largest(
    comm: MPI.Comm, values: Floats, x: Floats, times: Floats
) -> tuple[float, list[float], float]:
    """Largest value of all ranks with place and time; of equal ones the first place."""
    best = (-np.inf, [0.0, 0.0, 0.0], 0.0)
    if len(values):
        equal = np.flatnonzero(values == values.max())
        k = equal[np.lexsort(x[equal].T[::-1])[0]]
        best = (float(values[k]), [float(c) for c in x[k]], float(times[k]))
    return min(comm.allgather(best), key=lambda b: (-b[0], b[1]))
