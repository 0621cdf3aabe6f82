r"""One implicit solve of temperature and temperature jumps, as a system for Newton's method.

A stage of a time step asks for the state at the end of an interval h that started at T*. Unknowns
are the continuous temperature θ and, with interfaces of finite conductance, the jumps τ of their
points. With the temperature T_b = θ + B_b τ of each body (`HeatOperators.nodal`) and its residual
heat (`evaluate` sums the terms)

.. math:: r_b = \tfrac1h M_b (T_b - T_b^*) + K_b (T_b - T_0) + R_b (T_b - T_a)
                - f_b - a_b(T_b) - d_b + E_b(T),

`residual` is

.. math:: \sum_b r_b = 0, \qquad \sum_b B_b^T r_b - W q(τ, p) = 0,

with

- M, 1/h: `HeatOperators.capacity`, `begin`; in a steady solve 1/h is zero.
- K: conduction, corrected where necessary (`MaximumPrinciple.matrices`); T_0 the `reference`.
- R (T - T_a): exchange with surroundings (`HeatLoads.exchanged`); f: fluxes and sources
  (`HeatLoads.heat_into_nodes`).
- a: heat of cure (`CureHeat.heat_into_nodes`); d: heat of friction (`FrictionHeating.nodal`), from
the
  mechanics.
- E: exchange of surfaces with finite sliding (`MeanExchange.heat_into_nodes`).
- q: heat flux from jump and contact pressure p (`TemperatureJumps.flux`); W: areas of the points.

Given temperatures replace their rows (`impose`). `jacobian` is the derivative; `heat.operators`
assembles the matrices.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

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

# Rounding of a row in units of eps |diagonal| |temperature|: about the root of its entries.
ROUNDING = 2.0
# Heat has this part of the solver's tolerance: errors of hundreds of solves add up in its balance,
# and temperatures are kept between their bounds to 1e-9 of the range.
RELATIVE_TOLERANCE = 1e-2
KEPT_FACTORS: Options = {"pc_type": "python", "pc_python_type": "app.heat.matrices.KeptFactors"}


@dataclass(frozen=True)
class HeatEvaluation:
    """Nodal values of one state, shared by its residual, Jacobian and reports.

    Attributes:
        given: The state, and pressures and heat of friction, which are set from outside.
        T: Temperature of owned nodes of each body (b, n) [K].
        residual_heat: Residual heat, without interfaces (b, n) [N mm/s].
        parts: Terms of that residual but conduction, by body [N mm/s].
        flux: Heat flux at owned points, and its derivatives (`TemperatureJumps.flux`).
    """

    given: list[Floats]
    T: Floats
    residual_heat: Floats
    parts: list[Floats]
    flux: tuple[Floats, Floats, Floats] | None


class ImplicitStep(System):
    """The solve prepared by ``begin``.

    Attributes:
        operators: The operators of heat.
        seconds: Time at the end of the solve last begun [s].
        vectors: Makes new vectors: temperature of owned nodes, with jumps also of owned points.
    """

    prefix = "mantle_heat_"
    # Nearly linear: two iterations suffice if the first is solved well.
    newton: Options = {"ksp_rtol": 1e-5}  # noqa: RUF012
    saved = ("operators",)

    def __init__(self, operators: HeatOperators) -> None:
        self.operators, self.comm = operators, operators.comm
        self.seconds = 0.0
        self._is_held = operators.fixed.base >= 0
        self._blocks = HeatMatrices(operators.principle.matrices, operators.jumps, self._is_held)
        self.vectors = self._blocks.vectors
        self._inverse_length = 1.0
        self._start_temperatures, self._source_heat = (
            operators.forms.zeros(),
            operators.forms.zeros(),
        )
        self._given_values: list[Floats] = []
        self._last_evaluation: HeatEvaluation | None = None
        self._work = self._blocks.matrix[0][0].createVecs()
        self._fill()

    @property
    def version(self) -> int:
        """Number of changes of the matrices from one time step to the next."""
        return self._blocks.version

    def blocks(self) -> dict[str, PETSc.Vec]:
        """Temperature, and with finite conductance its jumps."""
        # Without such an interface there is no second block.
        return dict(zip(("temperature", "temperature_jump"), self.vectors(), strict=False))

    def matrices(self) -> list[list[PETSc.Mat | None]]:
        """Capacity, conduction and exchange; conductance."""
        return [list(row) for row in self._blocks.matrix]

    def options(self, linear: str) -> dict[str, Options]:
        """Both blocks at once if direct; multigrid for the temperature, direct for the jumps."""
        if is_direct(linear, self._blocks.matrix[0][0].getSize()[0]):
            # Low conductance couples the jumps strongly: block Gauss-Seidel takes many iterations.
            return {"": KEPT_FACTORS}
        every: dict[str, Options] = {"temperature": MULTIGRID, "temperature_jump": INTERFACE}
        return {name: every[name] for name in self.blocks()}

    def initial(self) -> list[PETSc.Vec]:
        """The state at the start."""
        operators, x = self.operators, self.vectors()
        T = operators.initial()
        jumps = operators.jumps
        if jumps is not None:
            x[1].array[:] = T[jumps.bodies[:, 1], jumps.dof] - T[jumps.bodies[:, 0], jumps.dof]
        capacity = operators.capacity
        continuous = capacity * (T - operators.temperature_by_jumps(x[-1]))
        x[0].array[:] = continuous.sum(axis=0) / capacity.sum(axis=0)
        self._set_given(0.0)
        self.impose(x)
        return x

    def begin(
        self, start: Sequence[Floats], degrees: Sequence[Floats], h: float, seconds: float
    ) -> bool:
        """Prepare a solve; False if it starts from inadmissible degrees of cure; collective.

        Args:
            start: Temperatures of owned nodes, with jumps also of owned points, at the start [K].
            degrees: Degrees of cure at its start, of owned nodes of each curing region.
            h: Length of the interval [s]; infinite for a steady state.
            seconds: Time at its end, since the start of the run.

        Raises:
            InputError: A steady state does not exist: nothing sets the temperature of a body.
        """
        operators, x = self.operators, self.vectors()
        for vector, values in zip(x, start, strict=True):
            vector.array[:] = values
        self._start_temperatures = operators.nodal(x)
        self.seconds, self._last_evaluation = seconds, None
        self._source_heat = operators.loads.heat_into_nodes(seconds)
        self._set_given(seconds)
        if math.isinf(h):
            self._refuse_cut_off()
        self._inverse_length = 1 / h
        if self._filled_for != (self._inverse_length, operators.principle.version):
            self._fill()
        return operators.cure is None or operators.cure.begin(degrees, h, seconds)

    def _refuse_cut_off(self) -> None:
        """Refuse bodies that no heat path connects to a temperature set from outside."""
        operators = self.operators
        has_temperature = (operators.loads.per_kelvin > 0) | (operators.fixed.of_body >= 0)
        is_set = np.any(self.comm.allgather(has_temperature.any(axis=1)), axis=0)
        group = np.arange(len(is_set))
        for i, c in enumerate(operators.scene.thermal_contacts):
            if operators.jumps and max(c.law.conductances[:2]) > 0:
                points = operators.jumps.points
                for first, second in np.unique(points.bodies[points.interface == i], axis=0):
                    group[group == group[second]] = group[first]
        for c in operators.scene.sliding_heat:
            first, second = (operators.bodies.of_region[side[0]] for side in (c.master, c.slave))
            group[group == group[second]] = group[first]
        unset_bodies = np.flatnonzero(~np.isin(group, group[is_set]))
        if len(unset_bodies):
            raise InputError(
                f"stages: there is no steady state: nothing sets the temperature of "
                f"'{operators.bodies.names[unset_bodies[0]]}'; "
                "allowed: a given temperature, convection or "
                "perfusion on it, or an interface that conducts"
            )

    def set_exchange(self, exchange: MeanExchange) -> None:
        """Set the exchange of surfaces with finite sliding; collective."""
        self.operators.exchange = exchange
        self._blocks.set_exchange(exchange.matrix)
        self._fill()

    def _fill(self) -> None:
        self._last_evaluation, operators = None, self.operators
        self._filled_for = self._inverse_length, operators.principle.version
        self._blocks.fill(
            operators.principle.matrices,
            operators.capacity * self._inverse_length + operators.loads.per_kelvin,
        )

    def _set_given(self, seconds: float) -> None:
        fixed = self.operators.fixed
        values = fixed.values(seconds)
        self._given_values = fixed.blocks(values, self.operators.jumps)
        given = fixed.by_body(values)[fixed.of_body >= 0]
        self.operators.principle.include_data(given, self._source_heat)

    def impose(self, x: Sequence[PETSc.Vec]) -> None:
        """Set given temperatures and jumps in a state."""
        x[0].array[self._is_held] = self._given_values[0][self._is_held]
        jumps = self.operators.jumps
        if jumps is not None:
            x[1].array[jumps.prescribed] = self._given_values[1][jumps.prescribed]

    def evaluate(self, x: Sequence[PETSc.Vec]) -> HeatEvaluation:
        """Evaluate a state, unless it is the last one evaluated; collective."""
        operators = self.operators
        inputs = [v.array_r for v in x]
        inputs += [operators.jumps.pressure] if operators.jumps else []
        inputs += [operators.friction.nodal] if operators.friction else []
        if self._last_evaluation is not None:
            # Compared on all ranks, as the rest is collective: one may see a change, another none.
            is_same = all(map(np.array_equal, inputs, self._last_evaluation.given))
            if self.comm.allreduce(is_same, MPI.LAND):
                return self._last_evaluation
        T = operators.nodal(x)
        stored = self._inverse_length * operators.capacity * (T - self._start_temperatures)
        terms = [operators.loads.exchanged(T), stored, -self._source_heat]
        terms += [-operators.cure.heat_into_nodes(T)] if operators.cure else []
        terms += [-operators.friction.nodal] if operators.friction else []
        terms += (
            [operators.exchange.heat_into_nodes(T - operators.reference)]
            if operators.exchange
            else []
        )
        residual_heat = np.empty_like(T)
        temperature_rise, heat_flow = self._work
        for b, K in enumerate(operators.principle.matrices):
            temperature_rise.array[:] = T[b] - operators.reference
            K.mult(temperature_rise, heat_flow)
            residual_heat[b] = heat_flow.array_r
        for term in terms:
            residual_heat += term
        parts = [of_body for term in terms for of_body in term]
        flux = operators.jumps.flux(inputs[1]) if operators.jumps else None
        if operators.jumps and flux:
            parts.append(operators.jumps.weight * flux[0])
        self._last_evaluation = HeatEvaluation(
            [a.copy() for a in inputs], T, residual_heat, parts, flux
        )
        return self._last_evaluation

    def residual(self, x: Sequence[PETSc.Vec], f: Sequence[PETSc.Vec]) -> None:
        """Residual heat, zero where temperatures are given [N mm/s]."""
        evaluation, jumps = self.evaluate(x), self.operators.jumps
        f[0].array[:] = np.where(self._is_held, 0.0, evaluation.residual_heat.sum(axis=0))
        if jumps is not None and evaluation.flux:
            total = -jumps.weight * evaluation.flux[0]
            for b, B in jumps.moves.items():
                self._work[1].array[:] = evaluation.residual_heat[b]
                to_jumps = f[1].duplicate()
                B.multTranspose(self._work[1], to_jumps)
                total += to_jumps.array
            f[1].array[:] = np.where(jumps.prescribed, 0.0, total)

    def jacobian(self, x: Sequence[PETSc.Vec]) -> None:
        """Set the blocks of the Jacobian to a state."""
        evaluation, jumps, cure = self.evaluate(x), self.operators.jumps, self.operators.cure
        by_jump = -jumps.weight * evaluation.flux[1] if jumps and evaluation.flux else None
        self._blocks.set(by_jump, cure.heat_by_temperature(evaluation.T) if cure else {})

    def degrees(self, x: Sequence[PETSc.Vec]) -> list[Floats]:
        """Degrees of cure in a state, of owned nodes of each curing region."""
        cure = self.operators.cure
        return [d.degree for d in cure.degrees_at(self.operators.nodal(x))] if cure else []

    def measure(self, x: Sequence[PETSc.Vec], f: Sequence[PETSc.Vec]) -> list[Measure]:
        """Size of a residual f of a state x [N mm/s]; collective.

        The scale is the heat stored, supplied and transferred. Conduction alone is no scale: it is
        large and cancels in a state that hardly changes.
        """
        evaluation = self.evaluate(x)
        parts = [
            np.where(self._is_held, evaluation.residual_heat.sum(axis=0), 0.0),
            *evaluation.parts,
        ]
        diagonal_terms = [d * v.array_r for d, v in zip(self._blocks.diagonal(), x, strict=True)]
        local = np.array([float(a @ a) for a in (*parts, *diagonal_terms)])
        norms = np.sqrt(np.array(self.comm.allreduce(local, MPI.SUM)))
        scale = float(norms[: len(parts)].sum())
        rounding = ROUNDING * float(np.finfo(float).eps) * float(norms[len(parts) :].sum())
        return [Measure(block_norm(list(f)), RELATIVE_TOLERANCE * scale, rounding, lasting=False)]

    def flows(self, x: Sequence[PETSc.Vec]) -> dict[str, float]:
        """Heat that enters the model per time in a state, by condition [N mm/s]; collective.

        Their sum is the rate at which heat is stored in the interval last begun, to the tolerance
        of the solver.
        """
        evaluation, operators = self.evaluate(x), self.operators
        heats: dict[str, float] = {}
        for c, nodal in operators.loads.heating:
            heats[c.name] = multiplier(c.time_course, self.seconds) * float(nodal.sum())
        for e in operators.loads.exchange:
            heats[e.name] = float((e.per_kelvin * (e.outside - evaluation.T)).sum())
        if operators.cure:
            for n, heat in zip(
                operators.cure.nodes, operators.cure.released(evaluation.T), strict=True
            ):
                heats[f"cure {n.region}"] = float(heat.sum())
        residual_heat = evaluation.residual_heat.copy()
        jumps = operators.jumps
        if jumps and evaluation.flux:
            flow_through_points = jumps.weight * evaluation.flux[0]
            np.add.at(residual_heat, (jumps.bodies[:, 0], jumps.dof), flow_through_points)
            np.add.at(residual_heat, (jumps.bodies[:, 1], jumps.dof), -flow_through_points)
        for s, condition in enumerate(operators.fixed.conditions):
            heats[condition.name] = float(residual_heat[operators.fixed.of_body == s].sum())
        sums = self.comm.allreduce(np.array(list(heats.values())))
        total_heat = dict(zip(heats, map(float, sums), strict=True))
        return total_heat | (operators.friction.flows if operators.friction else {})

    def heat_through_interfaces(self, x: Sequence[PETSc.Vec]) -> dict[str, float]:
        """Heat per time from the first side to the second [N mm/s]; collective.

        By interface of finite conductance, without friction heat.
        """
        evaluation, operators = self.evaluate(x), self.operators
        into_slave: dict[str, float] = {}
        jumps = operators.jumps
        if jumps and evaluation.flux:
            for i, c in enumerate(operators.scene.thermal_contacts):
                at_interface = jumps.interface == i
                into_slave[c.name] = float(
                    jumps.weight[at_interface] @ evaluation.flux[0][at_interface]
                )
        if operators.exchange:
            heat_out = operators.exchange.heat_into_nodes(evaluation.T - operators.reference).sum(
                axis=0
            )
            into_slave |= {
                n: -float(heat_out[rows].sum()) for n, rows in operators.exchange.slaves.items()
            }
        swapped = {
            c.name
            for c in (*operators.scene.thermal_contacts, *operators.scene.sliding_heat)
            if c.swapped
        }
        oriented_heat = [-heat if n in swapped else heat for n, heat in into_slave.items()]
        total = self.comm.allreduce(np.array(oriented_heat))
        return dict(zip(into_slave, map(float, total), strict=True))
