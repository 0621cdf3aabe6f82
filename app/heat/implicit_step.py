r"""One implicit solve of temperature and temperature jumps, as a system for Newton's method.

An implicit stage of a time step computes the state at the end of an interval of length h from the
temperature T* at its start. Unknowns are the continuous temperature θ and, with interfaces of
finite conductance, the jumps τ of their points. With the temperature T_b = θ + B_b τ of each body
(`HeatOperators.nodal`) and its residual heat (`evaluate` sums the terms)

.. math:: r_b = \tfrac1h M_b (T_b - T_b^*) + K_b (T_b - T_0) + R_b (T_b - T_a)
                - f_b - a_b(T_b) - d_b + E_b(T),

`residual` is

.. math:: \sum_b r_b = 0, \qquad \sum_b B_b^T r_b - W q(τ, p) = 0,

with

- M, 1/h: `HeatOperators.capacity`, `begin`; in a steady solve 1/h is zero.
- K: conduction, corrected where necessary (`MaximumPrinciple.matrices`); T_0 the `reference`.
- R (T - T_a): exchange with surroundings (`HeatLoads.exchanged`); f: fluxes and sources
  (`HeatLoads.heat_into_nodes`).
- a: heat of cure (`CureHeat.heat_into_nodes`); d: heat of friction (`FrictionHeating.nodal`), which
  the mechanics set.
- E: exchange of surfaces with finite sliding (`MeanExchange.heat_out_of_nodes`).
- q: heat flux from jump and contact pressure p (`TemperatureJumps.flux`); W: areas of the points.

Rows of prescribed temperatures and jumps have a zero residual; `impose` sets their values.
`jacobian` is the derivative; `heat.operators` assembles the matrices.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from app.foundation.arrays import Floats
from app.foundation.errors import InputError
from app.heat.heat_loads import MeanExchange
from app.heat.matrices import HeatMatrices
from app.heat.operators import HeatOperators
from app.laws.values import multiplier
from app.numerics.preconditioners import INTERFACE, MULTIGRID, Options, is_direct
from app.numerics.system import Measure, System, block_norm
from meshes.data import connected

# Rounding error of a row in units of eps |diagonal| |temperature|: about the square root of its
# number of entries.
ROUNDING_OF_HEAT_ROWS = 2.0
# Tolerance of heat over the solver's tolerance. Errors of hundreds of solves add up in the balance
# of heat, and temperatures stay between their bounds to 1e-9 of the range.
RELATIVE_TOLERANCE = 1e-2
KEPT_FACTORS: Options = {"pc_type": "python", "pc_python_type": "app.heat.matrices.KeptFactors"}


@dataclass(frozen=True)
class HeatEvaluation:
    """Nodal values of one state, shared by its residual, Jacobian and reports.

    Attributes:
        inputs: The state, then contact pressures and heat of friction if there are any.
        T: Temperature of owned nodes of each body (b, n) [K].
        residual_heat: Residual heat, without interfaces (b, n) [N mm/s].
        terms: Terms of the residual except conduction, one array for each term and body [N mm/s].
        flux: Heat flux at owned points, and its derivatives (`TemperatureJumps.flux`).
    """

    inputs: list[Floats]
    T: Floats
    residual_heat: Floats
    terms: list[Floats]
    flux: tuple[Floats, Floats, Floats] | None


class ImplicitStep(System):
    """System of one implicit solve, which ``begin`` prepares.

    Attributes:
        operators: The operators of heat.
        seconds: Time at the end of the solve last begun [s].
        vectors: Makes new vectors: temperatures of owned nodes, then jumps of owned points if
            there are any.
    """

    prefix = "mantle_heat_"
    # Nearly linear: two iterations suffice if the first is solved well.
    newton: Mapping[str, str | float] = MappingProxyType({"ksp_rtol": 1e-5})
    saved = ("operators",)

    def __init__(self, operators: HeatOperators) -> None:
        self.operators, self.comm = operators, operators.comm
        self.seconds = 0.0
        self._is_prescribed = operators.fixed.base_condition >= 0
        self._blocks = HeatMatrices(
            operators.principle.matrices, operators.jumps, self._is_prescribed
        )
        self.vectors = self._blocks.vectors
        self._inverse_length = 1.0
        self._start_temperatures = operators.forms.zeros()
        self._source_heat = operators.forms.zeros()
        self._prescribed_values: list[Floats] = []
        self._last_evaluation: HeatEvaluation | None = None
        self._scratch = self._blocks.matrix[0][0].createVecs()
        self._fill()

    @property
    def version(self) -> int:
        """Number of times that the linear parts of the matrices were filled."""
        return self._blocks.version

    def blocks(self) -> dict[str, PETSc.Vec]:
        """Continuous temperature and, if an interface has a finite conductance, its jumps."""
        # Without such an interface there is no second block.
        return dict(zip(("temperature", "temperature_jump"), self.vectors(), strict=False))

    def matrices(self) -> list[list[PETSc.Mat | None]]:
        """Blocks of the Jacobian by rows and columns of `blocks`."""
        return [list(row) for row in self._blocks.matrix]

    def options(self, linear: str) -> dict[str, Options]:
        """Options by block: one direct solver for both blocks, or one preconditioner for each."""
        if is_direct(linear, self._blocks.matrix[0][0].getSize()[0]):
            # Low conductance couples the jumps strongly: block Gauss-Seidel takes many iterations.
            return {"": KEPT_FACTORS}
        by_block: dict[str, Options] = {"temperature": MULTIGRID, "temperature_jump": INTERFACE}
        return {name: by_block[name] for name in self.blocks()}

    def initial(self) -> list[PETSc.Vec]:
        """The state at the start."""
        operators, x = self.operators, self.vectors()
        T = operators.initial()
        jumps = operators.jumps
        if jumps is not None:
            master, slave = jumps.bodies.T
            x[1].array[:] = T[slave, jumps.dof] - T[master, jumps.dof]
        capacity = operators.capacity
        continuous = capacity * (T - operators.temperature_by_jumps(x[-1]))
        x[0].array[:] = continuous.sum(axis=0) / capacity.sum(axis=0)
        self._prescribe(0.0)
        self.impose(x)
        return x

    def begin(
        self, start: Sequence[Floats], degrees: Sequence[Floats], h: float, seconds: float
    ) -> bool:
        """Prepare a solve; collective.

        Args:
            start: State at the start of the interval, one array for each block [K].
            degrees: Degrees of cure at the start, of owned nodes of each curing region.
            h: Length of the interval [s]; infinite for a steady state.
            seconds: Time at the end of the interval, since the start of the run [s].

        Returns:
            False if the interval starts from inadmissible degrees of cure.

        Raises:
            InputError: A steady state does not exist: nothing sets the temperature of a body.
        """
        operators, x = self.operators, self.vectors()
        for vector, values in zip(x, start, strict=True):
            vector.array[:] = values
        self._start_temperatures = operators.nodal(x)
        self.seconds = seconds
        self._last_evaluation = None
        self._source_heat = operators.loads.heat_into_nodes(seconds)
        self._prescribe(seconds)
        if math.isinf(h):
            self._refuse_isolated_bodies()
        self._inverse_length = 1 / h
        if self._filled_for != (self._inverse_length, operators.principle.version):
            self._fill()
        return operators.cure is None or operators.cure.begin(degrees, h, seconds)

    def _refuse_isolated_bodies(self) -> None:
        """Refuse bodies that no heat path connects to a prescribed or surrounding temperature."""
        operators = self.operators
        has_condition_at_node = operators.loads.per_kelvin > 0
        has_condition_at_node |= operators.fixed.condition_of_body >= 0
        has_condition = np.any(self.comm.allgather(has_condition_at_node.any(axis=1)), axis=0)
        # Bodies that exchange heat have the same group.
        pairs = np.array(self._conducting_pairs(), dtype=np.int64).reshape(-1, 2)
        group = connected(len(has_condition), pairs[:, 0], pairs[:, 1])
        isolated = np.flatnonzero(~np.isin(group, group[has_condition]))
        if len(isolated):
            raise InputError(
                f"stages: there is no steady state: nothing sets the temperature of "
                f"'{operators.bodies.names[isolated[0]]}'; allowed: a given temperature, "
                "convection or perfusion on it, or an interface that conducts"
            )

    def _conducting_pairs(self) -> list[tuple[int, int]]:
        """Pairs of bodies, by number, between which an interface conducts."""
        operators = self.operators
        pairs: list[tuple[int, int]] = []
        for index, interface in enumerate(operators.scene.thermal_contacts):
            if operators.jumps and max(interface.law.conductances[:2]) > 0:
                points = operators.jumps.points
                sides = points.bodies[points.interface == index]
                pairs += [(int(a), int(b)) for a, b in np.unique(sides, axis=0)]
        body_of_region = operators.bodies.body_of_region
        for interface in operators.scene.sliding_heat:
            pairs.append((body_of_region[interface.master[0]], body_of_region[interface.slave[0]]))
        return pairs

    def set_exchange(self, exchange: MeanExchange) -> None:
        """Set the exchange of surfaces with finite sliding; collective."""
        self.operators.exchange = exchange
        self._blocks.set_exchange(exchange.matrix)
        self._fill()

    def _fill(self) -> None:
        """Fill the linear parts of the blocks for the current step and conduction; collective."""
        operators = self.operators
        self._last_evaluation = None
        self._filled_for = self._inverse_length, operators.principle.version
        self._blocks.fill(
            operators.principle.matrices,
            operators.capacity * self._inverse_length + operators.loads.per_kelvin,
        )

    def _prescribe(self, seconds: float) -> None:
        """Evaluate the prescribed temperatures and jumps at a time [s]; collective."""
        fixed = self.operators.fixed
        values = fixed.values(seconds)
        self._prescribed_values = fixed.blocks(values, self.operators.jumps)
        temperatures = fixed.by_body(values)[fixed.condition_of_body >= 0]
        self.operators.principle.include_data(temperatures, self._source_heat)

    def impose(self, x: Sequence[PETSc.Vec]) -> None:
        """Set prescribed temperatures and jumps in a state."""
        x[0].array[self._is_prescribed] = self._prescribed_values[0][self._is_prescribed]
        jumps = self.operators.jumps
        if jumps is not None:
            x[1].array[jumps.prescribed] = self._prescribed_values[1][jumps.prescribed]

    def evaluate(self, x: Sequence[PETSc.Vec]) -> HeatEvaluation:
        """Evaluate a state, unless it is the last one evaluated; collective."""
        operators, jumps = self.operators, self.operators.jumps
        inputs = [vector.array_r for vector in x]
        if jumps is not None:
            inputs.append(jumps.pressure)
        if operators.friction:
            inputs.append(operators.friction.nodal)
        if self._last_evaluation is not None:
            # The rest is collective, and inputs may change on some ranks only: all ranks agree.
            is_same = all(map(np.array_equal, inputs, self._last_evaluation.inputs))
            if self.comm.allreduce(is_same, MPI.LAND):
                return self._last_evaluation
        T = operators.nodal(x)
        residual_heat = self._conducted(T)
        terms: list[Floats] = []
        for term in self._terms_without_conduction(T):
            residual_heat += term
            terms += list(term)
        flux = None
        if jumps is not None:
            flux = jumps.flux(x[1].array_r)
            terms.append(jumps.weight * flux[0])
        input_copies = [values.copy() for values in inputs]
        self._last_evaluation = HeatEvaluation(input_copies, T, residual_heat, terms, flux)
        return self._last_evaluation

    def _conducted(self, T: Floats) -> Floats:
        """Heat that conduction takes from the nodes of each body, K (T - T_0) (b, n) [N mm/s]."""
        heat = np.empty_like(T)
        temperature_rise, heat_flow = self._scratch
        for b, K in enumerate(self.operators.principle.matrices):
            temperature_rise.array[:] = T[b] - self.operators.reference
            K.mult(temperature_rise, heat_flow)
            heat[b] = heat_flow.array_r
        return heat

    def _terms_without_conduction(self, T: Floats) -> list[Floats]:
        """All other terms of the residual heat r_b, each (b, n) [N mm/s]."""
        operators = self.operators
        stored = self._inverse_length * operators.capacity * (T - self._start_temperatures)
        terms = [operators.loads.exchanged(T), stored, -self._source_heat]
        if operators.cure:
            terms.append(-operators.cure.heat_into_nodes(T))
        if operators.friction:
            terms.append(-operators.friction.nodal)
        if operators.exchange:
            terms.append(operators.exchange.heat_out_of_nodes(T - operators.reference))
        return terms

    def residual(self, x: Sequence[PETSc.Vec], f: Sequence[PETSc.Vec]) -> None:
        """Residual heat, zero at prescribed temperatures and jumps [N mm/s]."""
        evaluation, jumps = self.evaluate(x), self.operators.jumps
        f[0].array[:] = np.where(self._is_prescribed, 0.0, evaluation.residual_heat.sum(axis=0))
        if jumps is not None and evaluation.flux:
            total = -jumps.weight * evaluation.flux[0]
            for b, B in jumps.jump_to_temperature.items():
                self._scratch[1].array[:] = evaluation.residual_heat[b]
                to_jumps = f[1].duplicate()
                B.multTranspose(self._scratch[1], to_jumps)
                total += to_jumps.array
            f[1].array[:] = np.where(jumps.prescribed, 0.0, total)

    def jacobian(self, x: Sequence[PETSc.Vec]) -> None:
        """Set the blocks of the Jacobian at a state."""
        evaluation = self.evaluate(x)
        jumps, cure = self.operators.jumps, self.operators.cure
        by_jump = -jumps.weight * evaluation.flux[1] if jumps and evaluation.flux else None
        heat_by_temperature = cure.heat_by_temperature(evaluation.T) if cure else {}
        self._blocks.set(by_jump, heat_by_temperature)

    def degrees(self, x: Sequence[PETSc.Vec]) -> list[Floats]:
        """Degrees of cure in a state, of owned nodes of each curing region."""
        cure = self.operators.cure
        if cure is None:
            return []
        return [region.degree for region in cure.degrees_at(self.operators.nodal(x))]

    def measure(self, x: Sequence[PETSc.Vec], f: Sequence[PETSc.Vec]) -> list[Measure]:
        """Size of a residual f of a state x [N mm/s]; collective.

        The scale is the heat stored, supplied and transferred. Conduction alone is no scale: it is
        large and cancels in a state that hardly changes.
        """
        evaluation = self.evaluate(x)
        supplied_by_conditions = np.where(
            self._is_prescribed, evaluation.residual_heat.sum(axis=0), 0.0
        )
        terms = [supplied_by_conditions, *evaluation.terms]
        diagonal_terms = [
            diagonal * vector.array_r
            for diagonal, vector in zip(self._blocks.diagonal(), x, strict=True)
        ]
        local_squares = np.array([float(a @ a) for a in (*terms, *diagonal_terms)])
        norms = np.sqrt(np.array(self.comm.allreduce(local_squares, MPI.SUM)))
        scale = float(norms[: len(terms)].sum())
        rounding = (
            ROUNDING_OF_HEAT_ROWS * float(np.finfo(float).eps) * float(norms[len(terms) :].sum())
        )
        return [Measure(block_norm(list(f)), RELATIVE_TOLERANCE * scale, rounding, lasting=False)]

    def flows(self, x: Sequence[PETSc.Vec]) -> dict[str, float]:
        """Heat that enters the model per time in a state, by condition [N mm/s]; collective.

        The sum of all flows is the rate at which heat is stored in the interval last begun, to the
        tolerance of the solver.
        """
        evaluation, operators = self.evaluate(x), self.operators
        heats: dict[str, float] = {}
        for condition, nodal in operators.loads.heating:
            factor = multiplier(condition.time_course, self.seconds)
            heats[condition.name] = factor * float(nodal.sum())
        for exchange in operators.loads.exchange:
            temperature_difference = exchange.outside - evaluation.T
            heats[exchange.name] = float((exchange.per_kelvin * temperature_difference).sum())
        cure = operators.cure
        if cure:
            for nodes, heat in zip(cure.nodes, cure.released(evaluation.T), strict=True):
                heats[f"cure {nodes.region}"] = float(heat.sum())
        # At prescribed temperatures the residual heat is the heat that their conditions supply.
        residual_heat = evaluation.residual_heat.copy()
        jumps = operators.jumps
        if jumps and evaluation.flux:
            flow_through_points = jumps.weight * evaluation.flux[0]
            np.add.at(residual_heat, (jumps.bodies[:, 0], jumps.dof), flow_through_points)
            np.add.at(residual_heat, (jumps.bodies[:, 1], jumps.dof), -flow_through_points)
        for index, fixed in enumerate(operators.fixed.conditions):
            is_fixed = operators.fixed.condition_of_body == index
            heats[fixed.name] = float(residual_heat[is_fixed].sum())
        sums = self.comm.allreduce(np.array(list(heats.values())))
        total_heat = dict(zip(heats, map(float, sums), strict=True))
        return total_heat | (operators.friction.flows if operators.friction else {})

    def heat_through_interfaces(self, x: Sequence[PETSc.Vec]) -> dict[str, float]:
        """Heat per time from the first side to the second, by interface [N mm/s]; collective.

        The interfaces are those of finite conductance. Friction heat is excluded.
        """
        evaluation, operators = self.evaluate(x), self.operators
        into_slave: dict[str, float] = {}
        jumps = operators.jumps
        if jumps and evaluation.flux:
            for index, interface in enumerate(operators.scene.thermal_contacts):
                rows = jumps.interface == index
                heat = jumps.weight[rows] @ evaluation.flux[0][rows]
                into_slave[interface.name] = float(heat)
        if operators.exchange:
            heat_by_body = operators.exchange.heat_out_of_nodes(evaluation.T - operators.reference)
            heat_out = heat_by_body.sum(axis=0)
            for name, nodes in operators.exchange.slaves.items():
                into_slave[name] = -float(heat_out[nodes].sum())
        # Fluxes are from master to slave; the master may be the second side of the case.
        for interface in (*operators.scene.thermal_contacts, *operators.scene.sliding_heat):
            if interface.swapped and interface.name in into_slave:
                into_slave[interface.name] *= -1.0
        total = self.comm.allreduce(np.array(list(into_slave.values())))
        return dict(zip(into_slave, map(float, total), strict=True))
