"""Heat sources and prescribed temperatures of a scene at its nodes, by body."""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.heat.heat_forms import HeatForms
from app.heat.temperature_jumps import TemperatureJumps
from app.laws.heat_conditions import HeatFlux, HeatSource
from app.laws.values import multiplier
from app.scene.scene import Scene


@dataclass(frozen=True)
class SurfaceExchange:
    """Exchange with surroundings at a temperature [K]: of owned nodes (b, n) [N mm/(s K)]."""

    name: str
    outside: float
    per_kelvin: Floats


@dataclass
class FrictionHeating:
    """Heat of friction, set from outside.

    Attributes:
        nodal: Heat into owned nodes of each body (b, n) [N mm/s].
        flows: Heat of each interface, by its name in the balance, over all ranks [N mm/s].
    """

    nodal: Floats
    flows: dict[str, float]


@dataclass(frozen=True)
class MeanExchange:
    """Exchange of heat between surfaces that share no nodes, set from outside.

    Attributes:
        matrix: Heat out of nodes by their temperatures (n, n) [N mm/(s K)].
        body: Thermal body of owned nodes on such surfaces, else 0 (n,).
        slaves: Owned nodes of the slave side of each interface.
    """

    matrix: PETSc.Mat
    body: Ints
    slaves: dict[str, Ints]

    def heat_into_nodes(self, T: Floats) -> Floats:
        """Heat out of owned nodes of each body at temperatures [K], both (b, n) [N mm/s]."""
        x, y = self.matrix.createVecs()
        body_and_node = self.body, np.arange(len(self.body))
        x.array[:] = T[body_and_node]
        self.matrix.mult(x, y)
        heat = np.zeros_like(T)
        heat[body_and_node] = y.array
        return heat


class HeatLoads:
    """Fluxes, sources, convection and perfusion of a scene.

    Attributes:
        heating: Fluxes and sources, with their heat into owned nodes of bodies (b, n) [N mm/s].
        exchange: Convection and perfusion.
        per_kelvin: Heat exchanged with all surroundings at owned nodes (b, n) [N mm/(s K)].

    Raises:
        InputError: A boundary does not exist, or a field cannot be evaluated.
    """

    def __init__(self, scene: Scene, forms: HeatForms) -> None:
        self._zeros = forms.zeros()
        self.heating: list[tuple[HeatFlux | HeatSource, Floats]] = []
        self.exchange: list[SurfaceExchange] = []
        for c in scene.heat:
            if c.role == "heats":
                nodal_size = forms.sizes(c)
                density = forms.values(c.values, np.flatnonzero((nodal_size > 0).any(axis=0)))
                self.heating.append((c, nodal_size * density))
            elif c.role == "exchanges":
                self.exchange.append(SurfaceExchange(c.name, c.outside, forms.exchange(c)))
        self.per_kelvin = sum((e.per_kelvin for e in self.exchange), self._zeros)

    def heat_into_nodes(self, seconds: float) -> Floats:
        """Heat into owned nodes of each body at a time (b, n) [N mm/s]."""
        return sum(
            (multiplier(c.time_course, seconds) * nodal for c, nodal in self.heating), self._zeros
        )

    def exchanged(self, T: Floats) -> Floats:
        """Heat that owned nodes at temperatures [K] give to surroundings (b, n) [N mm/s]."""
        return sum((e.per_kelvin * (T - e.outside) for e in self.exchange), self._zeros)


class FixedTemperatures:
    """Given temperatures at owned nodes.

    Where several bodies have given temperatures at a node, the body of lowest number is the base
    (`app.interfaces.contact_points`). The continuous temperature is then the temperature of this
    body. If two conditions apply to one body, the later one in the case counts.

    Attributes:
        conditions: The conditions.
        of_body: Number of the condition at owned nodes of each body, or -1 (b, n).
        base: The same for the continuous temperature (n,).

    Raises:
        InputError: A boundary does not exist, or a field cannot be evaluated.
    """

    def __init__(self, scene: Scene, forms: HeatForms) -> None:
        self.conditions = [c for c in scene.heat if c.role == "fixes"]
        self._nodes = np.arange(forms.owned)
        self.of_body: Ints = np.full(forms.zeros().shape, -1, dtype=np.int64)
        # The last row is for nodes without a condition, whose number is -1.
        self._values = np.zeros((len(self.conditions) + 1, forms.owned))
        for s, c in enumerate(self.conditions):
            prescribed = forms.held_nodes(c)
            self.of_body[prescribed] = s
            self._values[s] = forms.values(c.values, np.flatnonzero(prescribed.any(axis=0)))
        self.base: Ints = self.of_body[(self.of_body >= 0).argmax(axis=0), self._nodes]

    def join(self, jumps: TemperatureJumps) -> None:
        """Add bodies whose temperature follows from a prescribed jump.

        The jump is to a body of prescribed temperature.
        """
        for p in np.flatnonzero(jumps.prescribed):
            for b, condition in zip(jumps.bodies[p], jumps.prescribing_condition[p], strict=True):
                if self.of_body[b, jumps.dof[p]] < 0:
                    self.of_body[b, jumps.dof[p]] = condition

    def values(self, seconds: float) -> Floats:
        """Given temperatures by condition at owned nodes (s + 1, n) [K]; the last row is zero."""
        factors = [multiplier(c.time_course, seconds) for c in self.conditions]
        return np.array([*factors, 0.0])[:, None] * self._values

    def by_body(self, values: Floats) -> Floats:
        """Given temperatures of each body (b, n) [K], zero elsewhere, by condition."""
        return np.asarray(values[self.of_body, self._nodes])

    def blocks(self, values: Floats, jumps: TemperatureJumps | None) -> list[Floats]:
        """Given continuous temperature (n,) and jumps [K], zero elsewhere."""
        given = [values[self.base, self._nodes]]
        if jumps is not None:
            master, slave = (values[jumps.prescribing_condition[:, k], jumps.dof] for k in (0, 1))
            given.append(slave - master)
        return given
