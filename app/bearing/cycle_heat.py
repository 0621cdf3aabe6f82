r"""Heat of finite sliding: friction and exchange, averaged over a cycle of the tables.

Temperature takes minutes and a cycle seconds. Heat is therefore computed from the means of a cycle,
on each surface in the axes of its body. D is the friction power per cycle, β the part of it that
enters the slave and h the conductance. With Π of the current pairs (`mechanics.pairs`),

.. math:: Q_s = β \overline{D}, \quad Q_m = (1 - β) \overline{Π^T D}, \quad
          X = \overline{E^T h W E}, \quad E = (1, -Π),

and X T is the heat out of the nodes of both surfaces. `bearing.friction_cycles` estimates the
amplitude of temperature within a cycle.
"""

from __future__ import annotations

import math

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.heat.heat_loads import MeanExchange
from app.heat.implicit_step import ImplicitStep
from app.mechanics.contact import TrialState
from app.mechanics.pairs import mortar
from app.mechanics.problem import Problem
from app.mechanics.sides import Side
from app.numerics.sparse import from_triplets
from app.results.records import OnStage, Record
from app.scene.scene import Interface, Stage
from app.stepping.load_steps import LoadStep, OnStep
from forms.interface_heat import friction_heat


class CycleHeat(Record):
    """Positions, pressures and friction of the steps of a cycle, and their mean heat.

    Before a cycle it is the exchange of the last state, without friction.
    """

    # Steps of this cycle, and of the last one, at points of this rank (n, 6): part of the cycle,
    # position in the axes of the master (3), pressure, and dissipation [N mm].
    saved = ("steps", "cycle", "time", "dissipated")

    def __init__(self, problem: Problem, step: ImplicitStep) -> None:
        self._problem, self._step, self._scene = problem, step, problem.scene
        assert problem.contact is not None and problem.contact.finite_sliding is not None
        self._contact, self._finite_sliding = problem.contact, problem.contact.finite_sliding
        self.time, self.dissipated = 0.0, np.zeros_like(self._contact.local.weight)
        self.steps: list[Floats] = []
        self.cycle = [self._state(1.0, 0.0, self.dissipated, self.dissipated)]
        self._changed = True

    @property
    def row_keys(self) -> Ints:
        """Keys of the contact points of this rank."""
        return self._contact.row_keys

    def _state(
        self, cycle_part: float, time: float, pressure: Floats, dissipation: Floats
    ) -> Floats:
        state = np.zeros((len(dissipation), 6))
        state[self._finite_sliding.rows, 1:4] = self._finite_sliding.touching(time)
        state[:, 0], state[:, 4], state[:, 5] = cycle_part, pressure, dissipation
        return state

    def before(self, on_step: OnStep) -> OnStep:
        """Return a hook that records each step of the mechanics, then calls ``on_step``."""

        def record_step(step: LoadStep, trial: TrialState | None) -> None:
            stage = self._scene.stages[math.ceil(step.time) - 1]
            if trial is not None and not stage.takes_time:
                self._take(stage, step, trial)
            self.time = step.time
            on_step(step, trial)

        return record_step

    def _take(self, stage: Stage, step: LoadStep, trial: TrialState) -> None:
        pressure, dissipation = trial.forces.pressures[:, 0], self._contact.state.dissipation
        self._changed = True
        if stage.repeats:
            start = max(self.time, math.ceil(step.time) - 1)
            cycle_part, mid_time = stage.cycles * (step.time - start), (step.time + start) / 2
            self.steps.append(
                self._state(cycle_part, mid_time, pressure, dissipation - self.dissipated)
            )
            if step.ends_increment and stage.reversal(step.time):
                self.cycle, self.steps = self.steps, []
        else:
            self.cycle = [self._state(1.0, step.time, pressure, 0.0 * dissipation)]
        self.dissipated = dissipation.copy()

    def before_stage(self, on_stage: OnStage) -> OnStage:
        """Return a hook that sets the mean heat before a stage in which heat flows."""

        def begin(stage: Stage) -> None:
            if stage.takes_time and self._changed:
                self._set()
                self._changed = False
            on_stage(stage)

        return begin

    def _set(self) -> None:
        """Set friction and exchange of the heat; collective."""
        operators, comm = self._step.operators, self._problem.comm
        forms, body_of_region = operators.forms, operators.bodies.body_of_region
        start, end = forms.space.dofmap.index_map.local_range
        body: Ints = np.zeros(forms.owned, dtype=np.int64)
        exchanges, slaves = [], {}
        for c in self._scene.sliding_heat:
            assert c.between is not None
            sides = [Side.of(operators.tagged, forms.space, name) for name in c.between]
            heat, exchange = self._means(c, *sides)
            for side, region in zip(sides, (c.master[0], c.slave[0]), strict=True):
                own_rows = side.dofs[(side.dofs >= start) & (side.dofs < end)] - start
                body[own_rows], slaves[c.name] = body_of_region[region], own_rows
            dofs = np.concatenate([side.dofs for side in sides])
            owned, rows = (dofs >= start) & (dofs < end), dofs - start
            friction = operators.friction
            if friction and f"friction {c.name}" in friction.flows:
                friction.nodal[body[rows[owned]], rows[owned]] = heat[owned]
                friction.flows[f"friction {c.name}"] = float(heat.sum())
            i, j, value = exchange
            exchanges.append((rows[i[owned[i]]], dofs[j[owned[i]]], value[owned[i]]))
        triplets = (np.concatenate(part) for part in zip(*exchanges, strict=True))
        matrix = from_triplets(comm, forms.owned, forms.owned, *triplets)
        self._step.set_exchange(MeanExchange(matrix, body, slaves))

    def _means(
        self, c: Interface, master: Side, slave: Side
    ) -> tuple[Floats, tuple[Ints, Ints, Floats]]:
        """Heat of friction into the nodes of master and slave, and triplets of X; collective."""
        from scipy import sparse  # imported late: few runs need it

        names = [interface.name for interface in self._scene.parting_interfaces]
        points, i = self._contact.points, names.index(c.name)
        of_interface = points.interface == i  # in the order of the vertices
        weight = points.weight[of_interface]
        surface = self._finite_sliding.followers.sides[i][0].smooth
        master_count, slave_count = len(master.dofs), len(slave.dofs)
        open_conductance, per_pressure, largest = c.law.conductances
        node_count = master_count + slave_count
        heat, X = np.zeros(node_count), sparse.csr_array((node_count, node_count))
        for state in self.cycle:
            cycle_part, *place, pressure, dissipation = self._contact.gather(state)[of_interface].T
            pairs = mortar(np.column_stack(place), slave.triangles, surface)
            Π = sparse.csr_array(
                (pairs.values, (pairs.rows, pairs.columns)), shape=(slave_count, master_count)
            )
            E = sparse.hstack([-Π, sparse.eye_array(slave_count)], format="csr")
            conductance = open_conductance + per_pressure * np.maximum(pressure, 0.0)
            h = np.minimum(conductance, largest) * pairs.covered
            X += E.T @ sparse.diags_array(cycle_part * h * weight) @ E
            into_master, into_slave = friction_heat(
                dissipation / (self._scene.period or 1.0), c.slave_share
            )
            heat += np.concatenate([Π.T @ into_master, into_slave])
        X = X.tocoo()
        return heat, (*X.coords, X.data)
