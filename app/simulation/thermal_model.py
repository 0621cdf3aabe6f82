"""The heat of a model, and what is kept of it: temperatures, cure, heat balance."""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from app.case.case import Case
from app.heat.flows import stored, through
from app.heat.initial_jump import InitialJump
from app.heat.nodes import ProbedPoint
from app.results.cure_record import CureRecord
from app.results.heat_balance import HeatBalance
from app.results.interface_heat import exchange
from app.results.thermal_record import ThermalRecord
from app.stepping.heat_steps import HeatState, HeatStep

# Heat below so many times what rounding leaves of it in a step is none.
NOTHING = 1e7


class ThermalModel:
    """The heat of a model, and what is kept of it.

    Attributes:
        conduction: The operators.
        heating: Its state.
        record: Temperatures as far as they are reported.
        cure: Degrees of cure, if anything sets.
        balance: What came in, is stored and left.
        flows: Heat per time at the end of the last step: into the model by condition, and through
            interfaces of finite conductance from the first side to the second [mW].
    """

    saved = ("heating", "record", "_settled", "cure", "balance", "flows")

    def __init__(self, case: Case, heating: HeatState) -> None:
        """Begin with the initial state; collective."""
        conduction = heating.conduction
        self.conduction, self.heating = conduction, heating
        self._capacities = {c.region: c.capacity for c in conduction.scene.conductors}
        self._names = [c.name for c in conduction.scene.thermal_contacts]
        shares = {f.name: f.slave_share for f in conduction.scene.friction_heat}
        self._shares = np.array([shares.get(name, 0.0) for name in self._names])
        self.record = ThermalRecord(
            conduction.tagged,
            conduction.forms,
            conduction.bodies.of_region,
            case.geometry.interface_sides,
            case.of_tissue("bone"),
            [ProbedPoint(name, p.at, p.region or "") for name, p in case.output.probes.items()],
        )
        self._first_contact = InitialJump(conduction)
        # Once a steady state has been reached the first instants are over.
        self._settled = False
        self.record.start(self._reported(0.0))
        self.cure: tuple[CureRecord, ...] = tuple(
            CureRecord(conduction.comm, heating.degrees(), self._keys()) for _ in conduction.cures
        )
        self.balance = HeatBalance(stored(conduction, heating.vectors()), {})
        self.flows: dict[str, dict[str, float]] = {}

    def _keys(self) -> dict[str, NDArray[np.int64]]:
        """Keys of the nodes of each region that sets."""
        nodes = self.conduction.row_keys
        return {n.region: nodes[n.dof] for c in self.conduction.cures for n in c.nodes}

    def _reported(self, seconds: float) -> list[fem.Function]:
        """Temperatures of the bodies, as they are reported at a time; collective."""
        temperatures = self.conduction.temperatures(self.heating.vectors())
        if not self._settled:
            self._first_contact.put(temperatures, seconds)
        return temperatures

    def update(self, accepted: HeatStep) -> None:
        """Take in a step; collective."""
        heating, conduction = self.heating, self.conduction
        x = heating.vectors()
        temperatures = conduction.temperatures(x)
        exchanges = [
            exchange(self._names, j, temperatures, τ.array, j.friction, self._shares[j.interface])
            for j, τ in zip(conduction.jumps, x[1:], strict=True)
        ]
        self._settled = self._settled or accepted.dt == 0.0
        temperatures = self._reported(accepted.seconds)
        highest = conduction.bounds(x).high
        rates = heating.slopes() if heating.begins_at_event(accepted) else ()
        self.record.update(accepted.seconds, temperatures, exchanges, highest, rates)
        for cure in self.cure:
            cure.update(accepted.seconds, heating.degrees(), heating.rates())
        self.flows = {"into": dict(accepted.flows), "through": through(conduction, x)}
        heat = stored(conduction, x)
        rounding = conduction.measure(x, conduction.vectors()).rounding
        if accepted.dt == 0.0:
            # A model of one temperature lets nothing through but rounding.
            self.balance.steady(accepted.flows, heat, 1e2 * rounding)
            return
        moved = self.record.moved(self._capacities)
        # Nor does one that waits for its first heat, such as that of friction.
        least = NOTHING * rounding * accepted.dt
        self.balance.update(accepted.dt, accepted.heats, accepted.flows, heat, moved, least)

    def row(self) -> dict[str, float]:
        """Columns of history.csv."""
        row = self.record.row()
        for cure in self.cure:
            row |= cure.row()
        return row | {"heat balance [-]": self.balance.heat}
