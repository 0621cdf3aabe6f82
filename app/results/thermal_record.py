"""Peak temperatures with place and time, their duration, and necrosis: section thermal.

A record takes the temperatures of every accepted step (`region_temperatures`), the heat through the
interfaces then, and its entropy production. Temperatures are K inside and degC in reports; the
other units are those of ``UNITS``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from dolfinx import fem

from app.foundation.arrays import Floats, Ints
from app.heat.heat_forms import HeatForms
from app.heat.nodes import InterfaceNodes, Probe, Probes, Side, region_nodes
from app.heat.operators import HeatOperators
from app.numerics.saved_state import node_keys
from app.results.necrosis import CELSIUS
from app.results.region_temperatures import RegionCells, RegionTemperatures, largest
from forms import interface_heat
from meshes.distribute import TaggedMesh

W_PER_M2 = 1e3  # W/m2 in N/(mm s), W/(m2 K) in N/(mm s K)
# By interface, at this rank's points: heat flux from master to slave per area (n,) [N/(mm s)], and
# entropy production per area (n,) [N/(mm s K)].
Exchanges = Mapping[str, tuple[Floats, Floats]]


def exchange(
    operators: HeatOperators, x: Sequence[PETSc.Vec], temperatures: Sequence[fem.Function]
) -> Exchanges:
    """Heat through the interfaces of finite conductance, by temperatures of the bodies [K]."""
    if (j := operators.jumps) is None:
        return {}
    table = np.stack([t.x.array[j.dof] for t in temperatures])
    master, slave = (table[j.bodies[:, k], np.arange(len(j.dof))] for k in (0, 1))
    q = j.flux(x[1].array)[0]
    s = np.asarray(interface_heat.entropy_production(q, j.friction, j.share, master, slave))
    at = {c.name: j.interface == i for i, c in enumerate(operators.scene.thermal_contacts)}
    return {name: (q[here], s[here]) for name, here in at.items()}


@dataclass
class InterfaceExtremes:
    """Largest jump and flux, and entropy production of one interface, over all ranks."""

    jump: float = 0.0
    flux: float = 0.0
    entropy_min: float = np.inf
    entropy_max: float = -np.inf

    def take(self, comm: MPI.Comm, flux: Floats, entropy: Floats) -> None:
        """Update from own points: flux (n,) [N/(mm s)], entropy [N/(mm s K)]; collective."""
        ends = [np.abs(flux).max(initial=0.0), entropy.max(initial=-np.inf)]
        most = np.array([*ends, -entropy.min(initial=np.inf)])
        comm.Allreduce(MPI.IN_PLACE, most, MPI.MAX)
        self.flux = max(self.flux, float(most[0]))
        self.entropy_max = max(self.entropy_max, float(most[1]))
        self.entropy_min = min(self.entropy_min, -float(most[2]))

    def summary(self) -> dict[str, float]:
        """Their numbers in the summary."""
        result = {"temperature_jump_max": self.jump}
        # Where both sides share one temperature the rest is unknown.
        if self.entropy_min < np.inf:
            result["heat_flux_max"] = W_PER_M2 * self.flux
            result["entropy_production_min"] = W_PER_M2 * self.entropy_min
            result["entropy_production_max"] = W_PER_M2 * self.entropy_max
        return result


Interfaces = Mapping[str, tuple[Sequence[str], Sequence[str]]]
SIDES = ("first", "second")

# Largest deviation of a piece of a step from the parabola [K], unless that takes too many pieces.
_STRAIGHT = 0.01
_MOST_PIECES = 8
TIMELESS = (
    "no times above a temperature, thermal doses or dead bone: a steady stage does not know how "
    "long its heat took; give it a duration"
)


class ThermalRecord:
    """Temperatures of a run, as far as they are reported.

    Attributes:
        bone: Regions of bone.
        row: Columns of history.csv for the last recorded state.
        regions: Temperatures and doses of each region.

    Args:
        of_region: Thermal body of each region.
        interfaces: Regions on the first and second side of each interface, in the order of the
            case.
        faces: Nodes of the two boundaries of those between bodies meshed apart.

    Raises:
        InputError: A probe is not in its region.
    """

    saved = ("_seconds", "row", "_extremes", "regions")

    def __init__(
        self,
        tagged: TaggedMesh,
        forms: HeatForms,
        of_region: Mapping[str, int],
        interfaces: Interfaces,
        bone: Sequence[str],
        probes: Mapping[str, Probe],
        faces: Mapping[str, tuple[Ints, Ints]] | None = None,
    ) -> None:
        self._comm, self._forms = forms.comm, forms
        self._nodes = region_nodes(forms, tuple(tagged.regions), of_region)
        self._interfaces = {
            n: InterfaceNodes(self._nodes, s, (faces or {}).get(n)) for n, s in interfaces.items()
        }
        self.bone = bone
        self._bone_sides: list[Side] = []
        for name, regions in interfaces.items():
            first, second = (not set(bone).isdisjoint(side) for side in regions)
            if first != second:
                self._bone_sides.append(self._interfaces[name].sides[0 if first else 1])
        self._probes = Probes(tagged, forms.space, of_region, probes)
        self._extremes = {name: InterfaceExtremes() for name in interfaces}
        self.regions: dict[str, RegionTemperatures] = {}

    def start(self, temperatures: Sequence[fem.Function], seconds: float = 0.0) -> None:
        """Record the initial state; collective."""
        for name, nodes in self._nodes.items():
            self.regions[name] = RegionTemperatures(nodes, temperatures, seconds)
        self._take(seconds, temperatures)

    def update(
        self,
        seconds: float,
        temperatures: Sequence[fem.Function],
        exchanges: Exchanges | None = None,
        highest: float = np.inf,
        rates: Sequence[Floats] = (),
    ) -> None:
        """Record an accepted step; collective.

        The duration of the way to a steady state is unknown: it adds to peaks, and leaves doses
        without a value unless all is too cool for doses before it and after it.

        Args:
            seconds: Time at its end [s].
            temperatures: Of the bodies then [K].
            exchanges: Heat through the interfaces of finite conductance then, if there are any.
            highest: Upper bound of temperatures [K], between steps too.
            rates: Rates of change at its end, of own nodes of the bodies [K/s], if the heat source
                has a kink at its start, so that earlier states say nothing of it.
        """
        step = seconds - self._seconds
        for r in self.regions.values():
            r.take(self._seconds, temperatures)
        if step > 0:
            self._expose(seconds, rates)
        elif self._comm.allreduce(any(r.warm.any() for r in self.regions.values()), MPI.LOR):
            for r in self.regions.values():
                r.exposure.forget()
        for r in self.regions.values():
            r.raise_peak(seconds, highest)
        for name, passed in (exchanges or {}).items():
            self._extremes[name].take(self._comm, *passed)
        self._take(seconds, temperatures)

    def _expose(self, seconds: float, rates: Sequence[Floats]) -> None:
        """Add the doses of a step, in as many straight pieces as its curvature asks for."""
        bends = {name: r.bend(seconds, rates) for name, r in self.regions.items()}
        most = (np.abs(b[self.regions[n].warm]).max(initial=0.0) for n, b in bends.items())
        worst = self._comm.allreduce(max(map(float, most)), MPI.MAX)
        pieces = int(np.clip(np.ceil(np.sqrt(worst / _STRAIGHT)), 1, _MOST_PIECES))
        for name, r in self.regions.items():
            r.expose(bends[name], pieces, seconds - self._seconds)

    def _take(self, seconds: float, temperatures: Sequence[fem.Function]) -> None:
        """Keep the reported histories."""
        local = {
            f"{name} temperature_max [degC]": r.now.max(initial=-np.inf) - CELSIUS
            for name, r in self.regions.items()
        }
        for name, nodes in self._interfaces.items():
            for which, side in zip(SIDES, nodes.sides, strict=True):
                T = self._on(side, lambda r: r.now)
                local[f"{name} temperature_max_{which} [degC]"] = T.max(initial=-np.inf) - CELSIUS
            if not nodes.apart:
                jump = np.abs(nodes.jump(temperatures)).max(initial=0.0)
                local[f"{name} temperature_jump_max [K]"] = jump
        highest = np.array(list(local.values()), dtype=np.float64)
        self._comm.Allreduce(MPI.IN_PLACE, highest, MPI.MAX)
        row = dict(zip(local, map(float, highest), strict=True))
        for name, e in self._extremes.items():
            e.jump = max(e.jump, row.get(f"{name} temperature_jump_max [K]", 0.0))
        probed = self._probes.values(temperatures)[:, 0] - CELSIUS
        row |= {f"{p} [degC]": float(T) for p, T in zip(self._probes.names, probed, strict=True)}
        self._seconds, self.row = seconds, {"seconds [s]": seconds, **row}

    def _on(self, side: Side, values: Callable[[RegionTemperatures], Floats]) -> Floats:
        """Values of the nodes of a side of an interface (n, ...)."""
        return np.concatenate([values(self.regions[name])[rows] for name, rows in side.items()])

    def moved(self, capacities: Mapping[str, float]) -> float:
        """Heat that moved in the last step, by capacities of regions [N/(mm2 K)]; [N mm]."""
        local = sum(
            capacities[name] * float(r.nodes.volume @ np.abs(r.now - r.begin))
            for name, r in self.regions.items()
        )
        return float(self._comm.allreduce(local, MPI.SUM))

    @property
    def row_keys(self) -> dict[str, Any]:
        """Keys of the regions' nodes."""
        nodes = node_keys(self._forms.space)
        return {"regions": {n: nodes[own.dof] for n, own in self._nodes.items()}}

    # The summary

    def summary(self) -> dict[str, Any]:
        """Section ``thermal`` of the summary; collective."""
        comm, cells = self._comm, {name: RegionCells(self._forms, name) for name in self._nodes}
        # Surface of all bone towards other regions, as triangles (f, 3, 3) [mm]; on every rank.
        faces = [
            cells[region].faces(self._nodes[region].dof[rows])
            for side in self._bone_sides
            for region, rows in side.items()
        ]
        surface = np.concatenate([np.zeros((0, 3, 3)), *faces])
        regions = {name: r.temperatures(comm, cells[name]) for name, r in self.regions.items()}
        result: dict[str, Any] = {
            "regions": regions,
            "interfaces": {name: self._interface(name) for name in self._interfaces},
        }
        local = any(r.exposure.forgotten for r in self.regions.values())
        if comm.allreduce(local, MPI.LOR):
            return result | {"note": TIMELESS}
        for name, r in self.regions.items():
            regions[name] |= r.times(comm)
        for name in self.bone:
            regions[name] |= self.regions[name].dead(comm, cells[name], surface)
        return result

    def _interface(self, name: str) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for which, side in zip(SIDES, self._interfaces[name].sides, strict=True):
            peak, place, when = largest(
                self._comm,
                self._on(side, lambda r: r.peak),
                self._on(side, lambda r: r.nodes.x),
                self._on(side, lambda r: r.peak_time),
            )
            result[f"temperature_max_{which}"] = peak - CELSIUS
            result[f"temperature_max_{which}_at"] = place
            result[f"temperature_max_{which}_time"] = when
        return result if self._interfaces[name].apart else result | self._extremes[name].summary()
