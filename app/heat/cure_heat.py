r"""Heat of cure: heat that the nodes of curing regions release within an implicit step.

The degree of cure follows from the temperature at the end of the step, a(T) = a* + h f(a, T), node
by node (`heat.curing`). A node that stands for the volume V releases Q V (a(T) - a*)/h: whatever
the step, the heat released is that of the change of a.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.arrays import Floats, Ints
from app.heat.curing import Curing, Degrees
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
    """

    region: str
    body: int
    dof: Ints
    heat: Floats
    adiabatic_rise: float


class CureHeat:
    """Degrees of cure and their heat in an implicit step.

    Attributes:
        nodes: Nodes of each curing region.
        curing: Their kinetics.
    """

    def __init__(self, scene: Scene, bodies: Bodies, forms: HeatForms) -> None:
        self._forms = forms
        capacity = {c.region: c.capacity for c in scene.conductors}
        self.nodes: list[CuringNodes] = []
        for c in scene.cures:
            volume = forms.volumes(c.region)
            dof = np.flatnonzero(volume > 0)
            self.nodes.append(
                CuringNodes(
                    c.region,
                    bodies.of_region[c.region],
                    dof,
                    c.heat * volume[dof],
                    c.heat / capacity[c.region],
                )
            )
        with forms.compiling():
            self.curing = Curing(forms.comm, scene.cures, [len(n.dof) for n in self.nodes])
        self._start = self.curing.initial()
        self._h: float = np.inf
        self._seconds = 0.0
        self._last: tuple[list[Floats], list[Degrees]] | None = None

    def begin(self, start: Sequence[Floats], h: float, seconds: float) -> bool:
        """Prepare a step; False if it starts from inadmissible degrees; collective."""
        self._start = [a.copy() for a in start]
        self._h, self._seconds, self._last = h, seconds, None
        return self.curing.admissible(start)

    def at(self, T: Sequence[Floats]) -> list[Degrees]:
        """Degrees of cure for temperatures of own nodes of each body [K].

        A steady state keeps its initial degrees: all heat of cure is already released.
        """
        here = [T[n.body][n.dof] for n in self.nodes]
        if self._last is None or not all(map(np.array_equal, here, self._last[0])):
            if np.isinf(self._h):
                found = [Degrees(a, np.zeros_like(a)) for a in self._start]
            else:
                found = self.curing.update(self._start, here, self._h, self._seconds)
            self._last = here, found
        return self._last[1]

    def released(self, T: Sequence[Floats]) -> list[Floats]:
        """Heat that nodes of each region release (n,) [N mm/s]."""
        rate = 1 / self._h
        return [
            rate * n.heat * (d.degree - a)
            for n, d, a in zip(self.nodes, self.at(T), self._start, strict=True)
        ]

    def heats(self, T: Sequence[Floats]) -> list[Floats]:
        """Heat released at own nodes of each body [N mm/s]."""
        return self._spread(self.released(T))

    def growth(self, T: Sequence[Floats]) -> dict[int, Floats]:
        """Derivative of released heat by temperature at own nodes of curing bodies [N mm/(s K)]."""
        rate = 1 / self._h
        slopes = [
            rate * n.heat * d.by_temperature for n, d in zip(self.nodes, self.at(T), strict=True)
        ]
        every = self._spread(slopes)
        return {b: every[b] for b in sorted({n.body for n in self.nodes})}

    def _spread(self, values: Sequence[Floats]) -> list[Floats]:
        total = self._forms.zeros()
        for n, v in zip(self.nodes, values, strict=True):
            total[n.body][n.dof] += v
        return total
