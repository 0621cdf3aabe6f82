"""Heat sources and prescribed temperatures of a scene at its nodes, by body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.arrays import Bools, Field, Floats, Ints
from app.heat.heat_forms import HeatForms
from app.heat.temperature_jumps import TemperatureJumps
from app.laws.heat_conditions import Convection, FixedTemperature, HeatFlux, HeatSource, Perfusion
from app.laws.values import Course, multiplier
from app.scene.bodies import Bodies
from app.scene.scene import Scene


@dataclass(frozen=True)
class HeatInput:
    """Heat input whatever the temperature: into own nodes of bodies [N mm/s]."""

    name: str
    course: Course | None
    nodal: dict[int, Floats]


@dataclass(frozen=True)
class SurfaceExchange:
    """Exchange with surroundings at a temperature [K]: of own nodes of bodies [N mm/(s K)]."""

    name: str
    outside: float
    per_kelvin: dict[int, Floats]


@dataclass
class FrictionHeating:
    """Heat of friction, set from outside.

    Attributes:
        nodal: Heat into own nodes of each body [N mm/s].
        flows: Heat of each interface, by its name in the balance, over all ranks [N mm/s].
    """

    nodal: list[Floats]
    flows: dict[str, float]


class HeatLoads:
    """Fluxes, sources, convection and perfusion of a scene.

    Attributes:
        heating: Fluxes and sources.
        exchange: Convection and perfusion.

    Raises:
        InputError: A boundary does not exist, or a field cannot be evaluated.
    """

    def __init__(self, scene: Scene, bodies: Bodies, forms: HeatForms) -> None:
        self._forms = forms
        self.heating: list[HeatInput] = []
        self.exchange: list[SurfaceExchange] = []
        for c in scene.heat:
            match c:
                case HeatFlux():
                    self._heat(c.name, c.course, c.values, list(forms.areas(c.boundary).items()))
                case HeatSource():
                    parts = [(bodies.of_region[r], forms.volumes(r)) for r in c.regions]
                    self._heat(c.name, c.course, c.values, parts)
                case Convection():
                    self.exchange.append(SurfaceExchange(c.name, c.ambient, forms.exchange(c)))
                case Perfusion():
                    self.exchange.append(SurfaceExchange(c.name, c.temperature, forms.exchange(c)))

    def _heat(
        self, name: str, course: Course | None, density: Field, shares: list[tuple[int, Floats]]
    ) -> None:
        nodal: dict[int, Floats] = {}
        for b, share in shares:
            heat = share * self._forms.values(density, np.flatnonzero(share > 0))
            nodal[b] = nodal.get(b, 0.0) + heat
        self.heating.append(HeatInput(name, course, nodal))

    def heats(self, seconds: float) -> list[Floats]:
        """Heat into own nodes of each body at a time [N mm/s]."""
        total = self._forms.zeros()
        for h in self.heating:
            for b, nodal in h.nodal.items():
                total[b] += multiplier(h.course, seconds) * nodal
        return total

    def per_kelvin(self) -> list[Floats]:
        """Heat per kelvin that own nodes of each body exchange with surroundings [N mm/(s K)]."""
        total = self._forms.zeros()
        for e in self.exchange:
            for b, nodal in e.per_kelvin.items():
                total[b] += nodal
        return total

    def exchanged(self, T: Sequence[Floats]) -> list[Floats]:
        """Heat that own nodes of each body, at temperatures [K], give to surroundings [N mm/s]."""
        total = self._forms.zeros()
        for e in self.exchange:
            for b, nodal in e.per_kelvin.items():
                total[b] += nodal * (T[b] - e.outside)
        return total


class FixedTemperatures:
    """Given temperatures at own nodes.

    Where several bodies have given temperatures at a node, the body of lowest number is the base:
    the continuous temperature is its own (`meshes.contact_points`). Of two on one body the later
    one in the case applies.

    Attributes:
        conditions: The conditions.
        of_body: Number of the condition at each own node or -1, by body with any.
        base: The same for the continuous temperature.
        held: Own nodes whose continuous temperature is given.

    Raises:
        InputError: A boundary does not exist, or a field cannot be evaluated.
    """

    def __init__(self, scene: Scene, forms: HeatForms) -> None:
        self.conditions = [c for c in scene.heat if isinstance(c, FixedTemperature)]
        self.of_body: dict[int, Ints] = {}
        self._values: list[Floats] = []
        for s, c in enumerate(self.conditions):
            held = np.zeros(forms.owned, dtype=bool)
            for b, nodes in forms.held_nodes(c).items():
                condition = self.of_body.setdefault(b, np.full(forms.owned, -1, dtype=np.int64))
                condition[nodes] = s
                held[nodes] = True
            self._values.append(forms.values(c.values, np.flatnonzero(held)))
        self.base: Ints = np.full(forms.owned, -1, dtype=np.int64)
        for b in sorted(self.of_body, reverse=True):
            self.base = np.where(self.of_body[b] >= 0, self.of_body[b], self.base)
        self.held: Bools = self.base >= 0

    def join(self, jumps: TemperatureJumps) -> None:
        """Add bodies without conditions whose jumps to bodies with given temperatures are given."""
        for p in np.flatnonzero(jumps.held):
            for k in (0, 1):
                none = np.full(len(self.base), -1, dtype=np.int64)
                condition = self.of_body.setdefault(int(jumps.bodies[p, k]), none)
                if condition[jumps.dof[p]] < 0:
                    condition[jumps.dof[p]] = jumps.given[p, k]

    def values(self, seconds: float) -> list[Floats]:
        """Given temperature of each condition at own nodes at a time [K], zero elsewhere."""
        return [
            multiplier(c.course, seconds) * v
            for c, v in zip(self.conditions, self._values, strict=True)
        ]

    def extremes(self, values: list[Floats]) -> tuple[float, float]:
        """Least and largest given temperature at own nodes [K]."""
        given = [
            values[s][condition == s]
            for condition in self.of_body.values()
            for s in range(len(values))
        ]
        every = np.concatenate([np.zeros(0), *given])
        return float(every.min(initial=np.inf)), float(every.max(initial=-np.inf))

    def continuous(self, values: list[Floats]) -> Floats:
        """The continuous temperature where it is given (owned,) [K], else zero."""
        return _pick(self.base, values)

    @staticmethod
    def jumps(values: list[Floats], jumps: TemperatureJumps) -> Floats:
        """Jumps that are given (n,) [K], else zero."""
        at = [value[jumps.dof] for value in values]
        return _pick(jumps.given[:, 1], at) - _pick(jumps.given[:, 0], at)


def _pick(condition: Ints, values: list[Floats]) -> Floats:
    """Value of each row's condition (n,); 0 where it has none."""
    found: Floats = np.zeros(len(condition))
    for s, value in enumerate(values):
        found = np.where(condition == s, value, found)
    return found
