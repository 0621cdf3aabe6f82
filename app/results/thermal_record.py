"""Temperatures, necrosis and cure over time: sections thermal and cure of the summary.

The records receive every accepted step: temperatures and degrees of cure at nodes, heat through the
interfaces and its entropy production. `over_time` reduces them to numbers. Temperatures are in K
inside and in degC in reports. Other units are those of ``UNITS``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from dolfinx import fem

from app.case.summary import TEMPERATURE_LEVELS, Numbers, ThermalNumbers
from app.foundation.arrays import Bools, Floats, Ints
from app.heat.heat_forms import HeatForms
from app.heat.nodes import InterfaceNodes, ProbePoint, Probes, Side, ThermalNodes, region_nodes
from app.heat.operators import HeatOperators
from app.numerics.saved_state import node_keys
from app.results.level_sets import RegionCells
from app.results.necrosis import CELSIUS, COUNTS_FROM, DOSES, death_levels
from app.results.over_time import (
    Integrals,
    Maximum,
    State,
    largest_of_ranks,
    maxima,
    peak_between,
    sagitta,
    sagitta_after_kink,
)
from forms import interface_heat
from meshes.distribute import TaggedMesh

# One N/(mm s) in W/m2; also one N/(mm s K) in W/(m2 K).
W_PER_M2 = 1e3
# For each interface, at this rank's points: heat flux from master to slave per area (n,) [N/(mm
# s)], and entropy production per area (n,) [N/(mm s K)].
Exchanges = Mapping[str, tuple[Floats, Floats]]


def heat_through_interfaces(
    operators: HeatOperators, x: Sequence[PETSc.Vec], temperatures: Sequence[fem.Function]
) -> Exchanges:
    """Return the heat through interfaces of finite conductance from temperatures of bodies [K]."""
    j = operators.jumps
    if j is None:
        return {}
    table = np.stack([t.x.array[j.dof] for t in temperatures])
    master, slave = (table[j.bodies[:, k], np.arange(len(j.dof))] for k in (0, 1))
    q = j.flux(x[1].array)[0]
    s = np.asarray(interface_heat.entropy_production(q, j.friction, j.share, master, slave))
    at_interface = {
        c.name: j.interface == i for i, c in enumerate(operators.scene.thermal_contacts)
    }
    return {name: (q[mask], s[mask]) for name, mask in at_interface.items()}


class RegionTemperatures:
    """Temperatures over time at this rank's nodes of a region (n,).

    Attributes:
        now: Temperatures of the last recorded state [K].
        peak: Highest temperatures so far [K].
        lowest: Lowest temperatures so far [K].
        doses: Heat doses so far, with the names of `necrosis.DOSES`.
        before: Up to three states before the last one, in order of time.
    """

    saved = ("now", "peak", "lowest", "doses", "before")

    def __init__(self, nodes: ThermalNodes, temperatures: Sequence[fem.Function]) -> None:
        self.nodes = nodes
        self.now = self.lowest = nodes.values(temperatures)
        self.peak = Maximum(self.now, 0.0)
        self.doses = Integrals(DOSES, len(self.now))
        self.before: list[State] = []

    @property
    def begin(self) -> Floats:
        """Return the temperatures (n,) [K] before the last recorded step."""
        return self.before[-1][1]

    @property
    def counts_for_doses(self) -> Bools:
        """Return the mask of nodes (n,) that are warm enough for doses at an end of this step."""
        return np.maximum(self.begin, self.now) > CELSIUS + COUNTS_FROM

    def record(self, start_time: float, temperatures: Sequence[fem.Function]) -> None:
        """Record the temperatures at the end of a step that began at ``start_time`` [s]."""
        self.before = [*self.before[-2:], (start_time, self.now)]
        self.now = self.nodes.values(temperatures)
        self.lowest = np.minimum(self.lowest, self.now)

    def sagitta(self, seconds: float, rates: Sequence[Floats]) -> Floats:
        """Deviation of temperature below a straight line in the middle of a step (n,) [K].

        Args:
            seconds: Time at the end of the step [s].
            rates: Rates of change at its end [K/s]; given if the step began with a kink.
        """
        previous = self.before[-1]
        current = (seconds, self.now)
        if rates:
            return sagitta_after_kink(rates[self.nodes.body][self.nodes.dof], previous, current)
        return sagitta(self.before[max(len(self.before) - 2, 0)], previous, current)

    def raise_peak(self, seconds: float, highest: float) -> None:
        """Raise the peaks to the temperatures at a time and just before, at most to ``highest``."""
        self.peak.update(self.now, seconds)
        states = [*self.before, (seconds, self.now)]
        if len(states) == 4 and all(a[0] < b[0] for a, b in pairwise(states)):
            peak, time = peak_between(*states)
            self.peak.update(np.minimum(peak, highest), time)

    # The summary

    def temperatures(self, comm: MPI.Comm, cells: RegionCells) -> Numbers:
        """Return extremes and mean [degC], and volumes above each level [mm3]; collective."""
        nodes = self.nodes
        heat = np.array([nodes.volume @ self.now, nodes.volume.sum()])
        comm.Allreduce(MPI.IN_PLACE, heat, MPI.SUM)
        peak, position, peak_time = largest_of_ranks(comm, self.peak.value, nodes.x, self.peak.time)
        end_extremes = maxima(comm, {"end": self.now, "minus lowest": -self.lowest})
        numbers: Numbers = {
            "temperature_max": peak - CELSIUS,
            "temperature_max_at": position,
            "temperature_max_time": peak_time,
            "temperature_min": -end_extremes["minus lowest"] - CELSIUS,
            "temperature_mean": float(heat[0] / heat[1]) - CELSIUS,
            "temperature_end_max": end_extremes["end"] - CELSIUS,
        }
        for level in TEMPERATURE_LEVELS:
            excess = self.peak.value - CELSIUS - level
            numbers[f"volume_over_{level}"] = cells.volume(nodes.dof, excess)
        return numbers

    def times(self, comm: MPI.Comm) -> dict[str, float]:
        """Return the longest time of a node above each level [s]; collective."""
        keys = [f"seconds_over_{level}" for level in TEMPERATURE_LEVELS]
        return maxima(comm, {key: self.doses.totals[key] for key in keys})

    def necrosis(self, comm: MPI.Comm, cells: RegionCells, surface: Floats) -> dict[str, float]:
        """Return the largest thermal doses, and dead volume and depth by criterion; collective.

        The depth is the distance from triangles of a surface (f, 3, 3) [mm].
        """
        doses = self.doses.totals
        numbers = maxima(comm, {f"{key}_max": doses[key] for key in ("cem43", "henriques_moritz")})
        for criterion, level in death_levels(doses).items():
            numbers[f"necrosis_{criterion}_volume"] = cells.volume(self.nodes.dof, level)
            if len(surface):
                depth = cells.depth(self.nodes.dof, level, surface)
                numbers[f"necrosis_{criterion}_depth"] = depth
        return numbers


Interfaces = Mapping[str, tuple[Sequence[str], Sequence[str]]]
SIDES_OF_INTERFACES = ("first", "second")

# Largest deviation of a straight piece of a step from the parabola [K].
_STRAIGHT = 0.01
# Largest number of such pieces in a step.
_MOST_PIECES = 8
TIMELESS = (
    "no times above a temperature, thermal doses or dead bone: a steady stage does not know how "
    "long its heat took; give it a duration"
)


class ThermalRecord:
    """Record of the reported temperatures of a run.

    Attributes:
        bone: Regions of bone.
        row: Columns of history.csv for the last recorded state.
        regions: Temperatures and doses of each region.

    Args:
        body_of_region: Thermal body of each region.
        interfaces: Regions on the first and second side of each interface, in the order of the
            case.
        faces: Nodes of both boundaries, for interfaces between separately meshed bodies.

    Raises:
        InputError: A probe is not in its region.
    """

    saved = ("seconds", "row", "extremes", "regions")

    def __init__(
        self,
        tagged: TaggedMesh,
        forms: HeatForms,
        body_of_region: Mapping[str, int],
        interfaces: Interfaces,
        bone: Sequence[str],
        probes: Mapping[str, ProbePoint],
        faces: Mapping[str, tuple[Ints, Ints]] | None = None,
    ) -> None:
        self._comm = forms.comm
        self._forms = forms
        self._nodes = region_nodes(forms, tuple(tagged.regions), body_of_region)
        self._interfaces = {
            n: InterfaceNodes(self._nodes, s, (faces or {}).get(n)) for n, s in interfaces.items()
        }
        self.bone = bone
        self._bone_sides: list[Side] = []
        for name, regions in interfaces.items():
            first_is_bone, second_is_bone = (not set(bone).isdisjoint(side) for side in regions)
            if first_is_bone != second_is_bone:
                self._bone_sides.append(self._interfaces[name].sides[0 if first_is_bone else 1])
        self._probes = Probes(tagged, forms.space, body_of_region, probes)
        # Largest numbers of each interface so far, over all ranks.
        self.extremes: dict[str, dict[str, float]] = {name: {} for name in interfaces}
        self.regions: dict[str, RegionTemperatures] = {}

    def start(self, temperatures: Sequence[fem.Function]) -> None:
        """Record the initial state, at 0 s; collective."""
        for name, nodes in self._nodes.items():
            self.regions[name] = RegionTemperatures(nodes, temperatures)
        self._record_row(0.0, temperatures)

    def update(
        self,
        seconds: float,
        temperatures: Sequence[fem.Function],
        exchanges: Exchanges | None = None,
        highest: float = np.inf,
        rates: Sequence[Floats] = (),
    ) -> None:
        """Record an accepted step; collective.

        The time until a steady state is unknown. Its temperatures count for maxima. Doses become
        unknown, unless all temperatures before and after are too low for doses.

        Args:
            seconds: Time at the end of the step [s].
            temperatures: Temperatures of the bodies at the end [K].
            exchanges: Heat through the interfaces of finite conductance at the end.
            highest: Upper bound of temperatures at and between steps [K].
            rates: Rates of change at the end, at rank-local nodes of the bodies [K/s]. They are
                given if the heat source has a kink at the start of the step, so that earlier states
                cannot be used.
        """
        step = seconds - self.seconds
        for r in self.regions.values():
            r.record(self.seconds, temperatures)
        if step > 0:
            self._expose(seconds, rates)
        elif self._comm.allreduce(
            any(r.counts_for_doses.any() for r in self.regions.values()), MPI.LOR
        ):
            for r in self.regions.values():
                r.doses.forget()
        for r in self.regions.values():
            r.raise_peak(seconds, highest)
        for name, (flux, entropy) in (exchanges or {}).items():
            exchange_sizes = {"flux": np.abs(flux), "entropy": entropy, "minus entropy": -entropy}
            self._update_maxima(name, maxima(self._comm, exchange_sizes))
        self._record_row(seconds, temperatures)

    def _expose(self, seconds: float, rates: Sequence[Floats]) -> None:
        """Add the doses of a step, divided into straight pieces according to its curvature."""
        sagittas = {name: r.sagitta(seconds, rates) for name, r in self.regions.items()}
        largest_sagittas = (
            np.abs(b[self.regions[n].counts_for_doses]).max(initial=0.0)
            for n, b in sagittas.items()
        )
        largest_sagitta = self._comm.allreduce(max(map(float, largest_sagittas)), MPI.MAX)
        piece_count = int(np.clip(np.ceil(np.sqrt(largest_sagitta / _STRAIGHT)), 1, _MOST_PIECES))
        for name, r in self.regions.items():
            r.doses.add_parabola(
                r.begin, r.now, sagittas[name], seconds - self.seconds, piece_count
            )

    def _update_maxima(self, interface: str, numbers: Mapping[str, float]) -> None:
        """Raise the extremes of an interface to larger numbers."""
        extremes = self.extremes[interface]
        for key, value in numbers.items():
            extremes[key] = max(extremes.get(key, -np.inf), value)

    def _record_row(self, seconds: float, temperatures: Sequence[fem.Function]) -> None:
        """Set the columns of history.csv."""
        local = {
            f"{name} temperature_max [degC]": r.now - CELSIUS for name, r in self.regions.items()
        }
        for name, nodes in self._interfaces.items():
            for side_name, side in zip(SIDES_OF_INTERFACES, nodes.sides, strict=True):
                T = self._on_side(side, lambda r: r.now)
                local[f"{name} temperature_max_{side_name} [degC]"] = T - CELSIUS
            if not nodes.apart:
                local[f"{name} temperature_jump_max [K]"] = np.abs(nodes.jump(temperatures))
        row = maxima(self._comm, local)
        for name in self.extremes:
            self._update_maxima(name, {"jump": row.get(f"{name} temperature_jump_max [K]", 0.0)})
        probed = self._probes.values(temperatures)[:, 0] - CELSIUS
        row |= {f"{p} [degC]": float(T) for p, T in zip(self._probes.names, probed, strict=True)}
        self.seconds, self.row = seconds, {"seconds [s]": seconds, **row}

    def _on_side(self, side: Side, values: Callable[[RegionTemperatures], Floats]) -> Floats:
        """Return values at the nodes of a side of an interface (n, ...)."""
        return np.concatenate([values(self.regions[name])[rows] for name, rows in side.items()])

    def moved_heat(self, capacities: Mapping[str, float]) -> float:
        """Return the heat that moved in the last step [N mm], from capacities [N/(mm2 K)]."""
        local = sum(
            capacities[name] * float(r.nodes.volume @ np.abs(r.now - r.begin))
            for name, r in self.regions.items()
        )
        return float(self._comm.allreduce(local, MPI.SUM))

    @property
    def row_keys(self) -> dict[str, dict[str, Ints]]:
        """Return the keys of the regions' nodes."""
        nodes = node_keys(self._forms.space)
        return {
            "regions": {
                region: nodes[region_nodes.dof] for region, region_nodes in self._nodes.items()
            }
        }

    # The summary

    def summary(self) -> ThermalNumbers:
        """Return the section ``thermal`` of the summary; collective."""
        comm = self._comm
        cells = {name: RegionCells(self._forms, name) for name in self._nodes}
        # Surface between bone and other regions, as triangles (f, 3, 3) [mm] on every rank.
        faces: list[Floats] = [np.zeros((0, 3, 3))]
        for side in self._bone_sides:
            for region, rows in side.items():
                faces.append(cells[region].faces(self._nodes[region].dof[rows]))
        surface = np.concatenate(faces)
        regions = {name: r.temperatures(comm, cells[name]) for name, r in self.regions.items()}
        thermal_numbers: ThermalNumbers = {
            "regions": regions,
            "interfaces": {name: self._interface(name) for name in self._interfaces},
        }
        local = any(r.doses.forgotten for r in self.regions.values())
        if comm.allreduce(local, MPI.LOR):
            thermal_numbers["note"] = TIMELESS
            return thermal_numbers
        for name, r in self.regions.items():
            regions[name] |= r.times(comm)
        for name in self.bone:
            regions[name] |= self.regions[name].necrosis(comm, cells[name], surface)
        return thermal_numbers

    def _interface(self, name: str) -> Numbers:
        numbers: Numbers = {}
        for side_name, side in zip(SIDES_OF_INTERFACES, self._interfaces[name].sides, strict=True):
            peak, position, peak_time = largest_of_ranks(
                self._comm,
                self._on_side(side, lambda r: r.peak.value),
                self._on_side(side, lambda r: r.nodes.x),
                self._on_side(side, lambda r: r.peak.time),
            )
            numbers[f"temperature_max_{side_name}"] = peak - CELSIUS
            numbers[f"temperature_max_{side_name}_at"] = position
            numbers[f"temperature_max_{side_name}_time"] = peak_time
        if self._interfaces[name].apart:
            return numbers
        extremes = self.extremes[name]
        numbers["temperature_jump_max"] = extremes["jump"]
        # Where both sides share one temperature the rest is unknown.
        if "flux" in extremes:
            numbers["heat_flux_max"] = W_PER_M2 * extremes["flux"]
            numbers["entropy_production_min"] = -W_PER_M2 * extremes["minus entropy"]
            numbers["entropy_production_max"] = W_PER_M2 * extremes["entropy"]
        return numbers


# Cure

# Degrees of cure, by the names of the times at which a whole region has reached them.
SET = {"time_50": 0.5, "time_90": 0.9}


class _CuringRegion:
    """Cure recorded at the nodes of one region (n,).

    Attributes:
        reached: Time at which each degree of `SET` is reached, by its name (n,) [s].
        fastest: Largest rate so far [1/s].
    """

    saved = ("degree", "rate", "reached", "fastest")

    def __init__(self, degree: Floats) -> None:
        self.degree: Floats = degree.copy()
        self.rate: Floats = np.zeros(len(degree))
        self.fastest = Maximum(self.rate, 0.0)
        self.reached: dict[str, Floats] = {
            name: np.where(degree >= level, 0.0, np.inf) for name, level in SET.items()
        }


class CureRecord:
    """Record of the reported degrees of cure of a run.

    The time at which a node reaches a degree is interpolated within the step. The interpolant is a
    cubic of time over degree, from degrees and rates at both ends.

    Args:
        degrees: Degree of cure at the owned nodes of each curing region (n,).
        keys: Keys of these nodes (n,).
    """

    saved = ("regions", "seconds")

    def __init__(
        self, comm: MPI.Comm, degrees: Mapping[str, Floats], keys: Mapping[str, Ints]
    ) -> None:
        self._comm, self.seconds = comm, 0.0
        self.row_keys = {"regions": keys}
        self.regions = {name: _CuringRegion(d) for name, d in degrees.items()}

    def update(
        self, seconds: float, degrees: Mapping[str, Floats], rates: Mapping[str, Floats]
    ) -> None:
        """Record an accepted step: time [s], degrees (n,) and rates (n,) [1/s] at its end."""
        step = seconds - self.seconds
        for name, r in self.regions.items():
            degree = degrees[name]
            rate = rates[name]
            for key, level in SET.items():
                newly_reached = np.flatnonzero((degree >= level) & np.isinf(r.reached[key]))
                fraction = _crossing(
                    level,
                    r.degree[newly_reached],
                    degree[newly_reached],
                    step * r.rate[newly_reached],
                    step * rate[newly_reached],
                )
                r.reached[key][newly_reached] = self.seconds + step * fraction
            r.fastest.update(rate, seconds)
            r.degree = degree.copy()
            r.rate = rate.copy()
        self.seconds = seconds

    def row(self) -> dict[str, float]:
        """Return the columns of history.csv for the last recorded state; collective."""
        columns: dict[str, float] = {}
        for name, r in self.regions.items():
            lowest, highest = self._range(r)
            columns |= {f"{name} degree_min [-]": lowest, f"{name} degree_max [-]": highest}
        return columns

    def summary(self) -> dict[str, Numbers]:
        """Return the section ``cure`` of the summary; collective. Times not reached are None."""
        numbers: dict[str, Numbers] = {}
        for name, r in self.regions.items():
            lowest, highest = self._range(r)
            latest = maxima(self._comm, {**r.reached, "rate_max": r.fastest.value})
            numbers[name] = {"degree_min": lowest, "degree_max": highest}
            for key, value in latest.items():
                numbers[name][key] = value if np.isfinite(value) else None
        return numbers

    def _range(self, r: _CuringRegion) -> tuple[float, float]:
        ends = maxima(self._comm, {"minus lowest": -r.degree, "highest": r.degree})
        return -ends["minus lowest"], ends["highest"]


def _crossing(
    level: float, start: Floats, end: Floats, slope_before: Floats, slope_after: Floats
) -> Floats:
    """Fraction of a step (n,) at which degrees from ``start`` to ``end`` (n,) reach a level.

    The fraction is a cubic of the degree. Its slopes follow from the rates at both ends times the
    step (n,); zero if they are unknown.
    """
    change = end - start
    s = np.divide(level - start, change, out=np.ones_like(start), where=change > 0)
    # Slopes of time over degree. A cubic is monotone if they are at most three times the chord.
    a, b = (
        np.minimum(np.divide(change, rate, out=np.ones_like(start), where=rate > 0), 3.0)
        for rate in (slope_before, slope_after)
    )
    return np.asarray(s**2 * (3 - 2 * s) + s * (1 - s) ** 2 * a - s**2 * (1 - s) * b)
