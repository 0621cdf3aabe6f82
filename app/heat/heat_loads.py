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
    """Exchange of heat with surroundings.

    Attributes:
        name: Name of the condition.
        outside: Temperature of the surroundings [K].
        per_kelvin: Heat per kelvin that owned nodes of each body exchange (b, n) [N mm/(s K)].
    """

    name: str
    outside: float
    per_kelvin: Floats


@dataclass
class FrictionHeating:
    """Heat of friction, set by the mechanics.

    Attributes:
        nodal: Heat into owned nodes of each body (b, n) [N mm/s].
        flows: Heat of each interface, by its name in the balance, over all ranks [N mm/s].
    """

    nodal: Floats
    flows: dict[str, float]


@dataclass(frozen=True)
class MeanExchange:
    """Exchange of heat between surfaces that share no nodes, set by another package.

    Attributes:
        matrix: Heat out of nodes from their temperatures (n, n) [N mm/(s K)].
        body: Thermal body of each owned node on such surfaces, 0 for all other nodes (n,).
        slaves: Owned nodes of the slave side, by the name of the interface.
    """

    matrix: PETSc.Mat
    body: Ints
    slaves: dict[str, Ints]

    def heat_out_of_nodes(self, T: Floats) -> Floats:
        """Heat out of owned nodes of each body (b, n) [N mm/s] at temperatures (b, n) [K]."""
        temperature, heat_out = self.matrix.createVecs()
        body_and_node = self.body, np.arange(len(self.body))
        temperature.array[:] = T[body_and_node]
        self.matrix.mult(temperature, heat_out)
        heat_by_body = np.zeros_like(T)
        heat_by_body[body_and_node] = heat_out.array
        return heat_by_body


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
        for condition in scene.heat:
            if condition.role == "heats":
                nodal_size = forms.sizes(condition)
                heated_nodes = np.flatnonzero((nodal_size > 0).any(axis=0))
                density = forms.values(condition.values, heated_nodes)
                self.heating.append((condition, nodal_size * density))
            elif condition.role == "exchanges":
                per_kelvin = forms.exchange(condition)
                self.exchange.append(SurfaceExchange(condition.name, condition.outside, per_kelvin))
        self.per_kelvin = sum((e.per_kelvin for e in self.exchange), self._zeros)

    def heat_into_nodes(self, seconds: float) -> Floats:
        """Heat into owned nodes of each body at a time (b, n) [N mm/s]."""
        return sum(
            (
                multiplier(condition.time_course, seconds) * nodal
                for condition, nodal in self.heating
            ),
            self._zeros,
        )

    def exchanged(self, T: Floats) -> Floats:
        """Heat that owned nodes at temperatures [K] give to surroundings (b, n) [N mm/s]."""
        return sum((e.per_kelvin * (T - e.outside) for e in self.exchange), self._zeros)


class FixedTemperatures:
    """Prescribed temperatures at owned nodes.

    If several bodies have prescribed temperatures at a node, the body of lowest number is the base
    (`app.interfaces.contact_points`). The continuous temperature is then the temperature of this
    body. If two conditions apply to one body, the later one in the case counts.

    Attributes:
        conditions: The conditions.
        condition_of_body: Index of the condition at owned nodes of each body, or -1 (b, n).
        base_condition: Index of the condition of the continuous temperature, or -1 (n,).

    Raises:
        InputError: A boundary does not exist, or a field cannot be evaluated.
    """

    def __init__(self, scene: Scene, forms: HeatForms) -> None:
        self.conditions = [c for c in scene.heat if c.role == "fixes"]
        self._nodes = np.arange(forms.owned)
        self.condition_of_body: Ints = np.full(forms.zeros().shape, -1, dtype=np.int64)
        # The last row is for nodes without a condition, whose index is -1.
        self._values = np.zeros((len(self.conditions) + 1, forms.owned))
        for index, condition in enumerate(self.conditions):
            is_prescribed = forms.prescribed_nodes(condition)
            self.condition_of_body[is_prescribed] = index
            nodes = np.flatnonzero(is_prescribed.any(axis=0))
            self._values[index] = forms.values(condition.values, nodes)
        base = (self.condition_of_body >= 0).argmax(axis=0)
        self.base_condition: Ints = self.condition_of_body[base, self._nodes]

    def join(self, jumps: TemperatureJumps) -> None:
        """Extend the conditions to bodies whose temperature follows from a prescribed jump.

        Such a jump is relative to a body of prescribed temperature.
        """
        for p in np.flatnonzero(jumps.prescribed):
            node = jumps.dof[p]
            for b, condition in zip(jumps.bodies[p], jumps.prescribing_condition[p], strict=True):
                if self.condition_of_body[b, node] < 0:
                    self.condition_of_body[b, node] = condition

    def values(self, seconds: float) -> Floats:
        """Prescribed temperatures at owned nodes, by condition (c + 1, n) [K].

        The last row is zero.
        """
        factors = [multiplier(c.time_course, seconds) for c in self.conditions]
        return np.array([*factors, 0.0])[:, None] * self._values

    def by_body(self, values: Floats) -> Floats:
        """Prescribed temperatures of each body (b, n) [K], zero elsewhere.

        ``values`` are those by condition.
        """
        return np.asarray(values[self.condition_of_body, self._nodes])

    def blocks(self, values: Floats, jumps: TemperatureJumps | None) -> list[Floats]:
        """Prescribed continuous temperature (n,) and jumps [K], zero elsewhere.

        ``values`` are the prescribed temperatures by condition.
        """
        blocks = [values[self.base_condition, self._nodes]]
        if jumps is not None:
            master = values[jumps.prescribing_condition[:, 0], jumps.dof]
            slave = values[jumps.prescribing_condition[:, 1], jumps.dof]
            blocks.append(slave - master)
        return blocks
