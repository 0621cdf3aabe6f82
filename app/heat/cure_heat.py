r"""Heat of cure: heat that the nodes of curing regions release within an implicit step.

The degree of cure follows from the temperature at the end of the step, a(T) = a* + h f(a, T), node
by node (`heat.curing`). A node that stands for the volume V releases Q V (a(T) - a*)/h: whatever
the step, the heat released is that of the change of a.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np

from app.arrays import Floats, Ints
from app.heat.curing import Degrees, Kinetics, admissible, kinetics_of
from app.heat.heat_forms import HeatForms
from app.scene.bodies import Bodies
from app.scene.scene import Scene


@dataclass(frozen=True)
class CuringNodes:
    """Own nodes of a curing region.

    Attributes:
        region: Its name.
        body: Thermal body whose temperature they have.
        dof: Own nodes, rising (n,).
        heat: Heat that each releases from degree 0 to 1 (n,) [N mm].
        adiabatic_rise: Adiabatic temperature rise of the region by that heat [K].
        kinetics: How they cure.
    """

    region: str
    body: int
    dof: Ints
    heat: Floats
    adiabatic_rise: float
    kinetics: Kinetics


class CureHeat:
    """Degrees of cure and their heat in an implicit step.

    Attributes:
        nodes: Nodes of each curing region.
        events: Times [s] that no time step should cross.
    """

    def __init__(self, scene: Scene, bodies: Bodies, forms: HeatForms) -> None:
        self._forms = forms
        capacity = {c.region: c.capacity for c in scene.conductors}
        self.nodes: list[CuringNodes] = []
        for c in scene.cures:
            volume = forms.volumes(c.region)
            dof = np.flatnonzero(volume > 0)
            with forms.compiling():
                kinetics = kinetics_of(forms.comm, c, len(dof))
            body, rise = bodies.of_region[c.region], c.heat / capacity[c.region]
            heat = c.heat * volume[dof]
            self.nodes.append(CuringNodes(c.region, body, dof, heat, rise, kinetics))
        self.events = {t for n in self.nodes for t in n.kinetics.events}
        initial = {c.region: c.initial for c in scene.cures}
        self._start: list[Floats] = [np.full(len(n.dof), initial[n.region]) for n in self.nodes]
        self._h: float = np.inf
        self._seconds = 0.0
        self._last: tuple[list[Floats], list[Degrees]] | None = None

    def begin(self, start: Sequence[Floats], h: float, seconds: float) -> bool:
        """Prepare a step; False if it starts from inadmissible degrees; collective."""
        self._start = [a.copy() for a in start]
        self._h, self._seconds, self._last = h, seconds, None
        return bool(self._forms.comm.allreduce(all(map(admissible, start)), op=MPI.LAND))

    def at(self, T: Floats) -> list[Degrees]:
        """Degrees of cure for temperatures of own nodes of each body (b, n) [K].

        A steady state keeps its initial degrees: all heat of cure is already released.
        """
        here = [T[n.body, n.dof] for n in self.nodes]
        if self._last is None or not all(map(np.array_equal, here, self._last[0])):
            if np.isinf(self._h):
                found = [Degrees(a, np.zeros_like(a)) for a in self._start]
            else:
                found = [
                    n.kinetics.update(a, own, self._h, self._seconds)
                    for n, a, own in zip(self.nodes, self._start, here, strict=True)
                ]
            self._last = here, found
        return self._last[1]

    def released(self, T: Floats) -> list[Floats]:
        """Heat that nodes of each region release (n,) [N mm/s]."""
        rate = 1 / self._h
        return [
            rate * n.heat * (d.degree - a)
            for n, d, a in zip(self.nodes, self.at(T), self._start, strict=True)
        ]

    def heats(self, T: Floats) -> Floats:
        """Heat released at own nodes of each body (b, n) [N mm/s]."""
        total = self._forms.zeros()
        for n, heat in zip(self.nodes, self.released(T), strict=True):
            total[n.body, n.dof] += heat
        return total

    def growth(self, T: Floats) -> dict[int, Floats]:
        """Derivative of released heat by temperature at own nodes of curing bodies [N mm/(s K)]."""
        total = self._forms.zeros()
        for n, d in zip(self.nodes, self.at(T), strict=True):
            total[n.body, n.dof] += 1 / self._h * n.heat * d.by_temperature
        return {b: total[b] for b in sorted({n.body for n in self.nodes})}
