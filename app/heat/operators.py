r"""Heat matrices of a scene on its mesh.

They are constant, except the conduction matrices, which the maximum principle may correct.

The temperature of body b is T_b = θ + B_b τ (see `heat.temperature_jumps`). `heat.implicit_step`
has the equation of an interval of time, solves it, and says which operator has which term.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from dolfinx import fem

from app.foundation.arrays import Floats, Ints
from app.heat.curing import CureHeat
from app.heat.heat_forms import HeatForms
from app.heat.heat_loads import FixedTemperatures, FrictionHeating, HeatLoads, MeanExchange
from app.heat.maximum_principle import MaximumPrinciple
from app.heat.temperature_jumps import TemperatureJumps
from app.numerics.saved_state import node_keys
from app.scene.bodies import Bodies, bodies_of
from app.scene.scene import Scene
from app.system.timing import Timing
from meshes.distribute import TaggedMesh

# Ratios of capacity and conduction until a node is close. Measured, as fractions of the difference
# of the temperatures: 1.1 % after 3, 0.4 % after 6, 0.1 % after 10, for any size of the cells.
RELAXATION_TIMES = 10.0


class HeatOperators:
    """Operators of heat.

    Attributes:
        bodies: Thermal bodies: regions joined by all but interfaces of finite conductance.
        loads: Heat sources and exchange with surroundings.
        fixed: Prescribed temperatures.
        jumps: The temperature jumps, if an interface has a finite conductance.
        capacity: Heat capacity of owned nodes in each body (b, n) [N mm/K].
        reference: Temperature at which heat is zero [K].
        cure: Heat of cure, if anything cures.
        friction: Heat of friction, if an interface has any.
        exchange: Exchange of surfaces with finite sliding, once it is set.
        principle: The conduction matrices of the bodies, with the corrections that the maximum
            principle needs.

    Raises:
        InputError: The scene does not fit the mesh.
    """

    saved = ("principle", "jumps")

    def __init__(self, scene: Scene, tagged: TaggedMesh, timing: Timing) -> None:
        self.scene, self.tagged = scene, tagged
        self.comm: MPI.Comm = tagged.mesh.comm
        self.bodies: Bodies = bodies_of(tagged, scene.thermal_contacts, ())
        forms = self.forms = HeatForms(tagged, self.bodies, timing)
        self.loads = HeatLoads(scene, forms)
        self.fixed = FixedTemperatures(scene, forms)
        self.jumps: TemperatureJumps | None = None
        if scene.thermal_contacts:
            self.jumps = TemperatureJumps(
                scene, tagged, self.bodies, forms, self.fixed.condition_of_body
            )
            self.fixed.join(self.jumps)
        self.capacity = forms.zeros()
        for c in scene.conductors:
            self.capacity[self.bodies.body_of_region[c.region]] += c.capacity * forms.volumes(
                c.region
            )
        # A reference near all temperatures: less of the heat is lost to rounding.
        self.reference = float(np.mean([c.initial_temperature for c in scene.conductors]))
        self.cure = CureHeat(scene, self.bodies, forms) if scene.cures else None
        friction_flows = {f"friction {f.name}": 0.0 for f in scene.friction_heat}
        self.friction = FrictionHeating(forms.zeros(), friction_flows) if friction_flows else None
        self.exchange: MeanExchange | None = None
        K = forms.conduction_by_body(scene.conductors)
        data = [c.initial_temperature for c in scene.conductors]
        data += [e.outside for e in self.loads.exchange]
        heated = bool(scene.cures or scene.friction_heat)
        self.principle = MaximumPrinciple(K, self.capacity, data, heated)
        self._work: PETSc.Vec = K[0].createVecLeft()
        self._continuous = fem.Function(forms.space, name="temperature")
        self._by_body = {
            b: fem.Function(forms.space, name=f"temperature {self.bodies.names[b]}")
            for b in (self.jumps.jump_to_temperature if self.jumps else ())
        }

    @cached_property
    def row_keys(self) -> Ints:
        """Keys of owned nodes."""
        return node_keys(self.forms.space)[: self.forms.owned]

    def block_keys(self) -> list[Ints]:
        """Keys of the saved rows of temperatures, and of jumps and degrees of cure if any."""
        jumps = [self.jumps.owned_rows] if self.jumps else []
        curing = [self.row_keys[n.dof] for n in self.cure.nodes] if self.cure else []
        return [self.row_keys, *jumps, *curing]

    def initial(self) -> Floats:
        """Temperature of owned nodes of each body at the start (b, n) [K].

        Regions of different temperature in perfect contact get the mean by capacity at shared
        nodes, which conserves heat. Prescribed temperatures apply from the start.
        """
        heat = self.forms.zeros()
        for c in self.scene.conductors:
            nodal = c.capacity * self.forms.volumes(c.region)
            above = c.initial_temperature - self.reference
            heat[self.bodies.body_of_region[c.region]] += nodal * above
        T = self.reference + heat / np.where(self.capacity > 0, self.capacity, 1.0)
        fixed = self.fixed
        return np.where(fixed.condition_of_body >= 0, fixed.by_body(fixed.values(0.0)), T)

    def temperature_by_jumps(self, τ: PETSc.Vec | None) -> Floats:
        """Temperature of owned nodes of each body due to jumps (b, n) [K]."""
        added_temperatures = self.forms.zeros()
        if self.jumps is not None:
            for b, B in self.jumps.jump_to_temperature.items():
                B.mult(τ, self._work)
                added_temperatures[b] = self._work.array
        return added_temperatures

    def nodal(self, x: Sequence[PETSc.Vec]) -> Floats:
        """Temperature of owned nodes of each body (b, n) [K], meaningless outside the body.

        Args:
            x: Temperature of owned nodes, with jumps also of owned points.
        """
        return x[0].array_r + self.temperature_by_jumps(x[-1])

    def stored(self, x: Sequence[PETSc.Vec]) -> float:
        """Stored heat above an arbitrary but fixed temperature [N mm]; collective."""
        local = (self.capacity * (self.nodal(x) - self.reference)).sum()
        return float(self.comm.allreduce(float(local)))

    def temperatures(self, x: Sequence[PETSc.Vec]) -> list[fem.Function]:
        """Temperature of each body as a function, overwritten by the next call."""
        T = self.nodal(x)
        by_body = [(f, T[b]) for b, f in self._by_body.items()]
        for function, nodal in ((self._continuous, x[0].array_r), *by_body):
            function.x.array[: self.forms.owned] = nodal
            function.x.scatter_forward()
        return [self._by_body.get(b, self._continuous) for b in range(len(T))]

    def of_region(self, region: str) -> fem.Function:
        """Temperature of a region as last set by ``temperatures``."""
        return self._by_body.get(self.bodies.body_of_region[region], self._continuous)


class InitialContactTemperature:
    r"""Nodes at which regions of different initial temperature meet in perfect contact.

    Their interface immediately takes the mean of both temperatures, weighted by the effusivities
    :math:`e = \sqrt{k c}` (two half-spaces, Carslaw & Jaeger, section 2.15). Nodes there begin at
    the mean by capacity instead, which conserves heat. They approach the mean by effusivity within
    some multiples of a node's capacity over its conduction. Until then their temperature is an
    artefact of the mesh, and the temperature of half-spaces is reported.
    """

    def __init__(self, operators: HeatOperators) -> None:
        forms, principle = operators.forms, operators.principle
        effusivity, sums = forms.zeros(), forms.zeros()
        lowest, highest = forms.zeros() + np.inf, forms.zeros() - np.inf
        for c in operators.scene.conductors:
            body_nodes = operators.bodies.body_of_region[c.region], forms.volumes(c.region) > 0
            effusivity[body_nodes] += c.effusivity
            sums[body_nodes] += c.effusivity * c.initial_temperature
            lowest[body_nodes] = np.minimum(lowest[body_nodes], c.initial_temperature)
            highest[body_nodes] = np.maximum(highest[body_nodes], c.initial_temperature)
        is_initial_contact = (lowest < highest) & (operators.fixed.condition_of_body < 0)
        diagonal = np.array([k.getDiagonal().array for k in principle.matrices])
        self._contact_temperature = np.divide(
            sums, effusivity, out=forms.zeros(), where=is_initial_contact
        )
        # Zero at all other nodes.
        self._settled_at = np.divide(
            RELAXATION_TIMES * operators.capacity,
            diagonal,
            out=forms.zeros(),
            where=is_initial_contact,
        )
        self._all_settled_at = forms.comm.allreduce(
            float(self._settled_at.max(initial=0.0)), MPI.MAX
        )

    def set_reported(self, temperatures: Sequence[fem.Function], seconds: float) -> None:
        """Set the reported values in the temperatures of the bodies at a time; collective."""
        if seconds >= self._all_settled_at:
            return
        for T, contact, settled_at in zip(
            temperatures, self._contact_temperature, self._settled_at, strict=True
        ):
            unsettled = np.flatnonzero(seconds < settled_at)
            T.x.array[unsettled] = contact[unsettled]
            T.x.scatter_forward()
