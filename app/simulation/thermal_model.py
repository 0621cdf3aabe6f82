"""The heat of a model and its records: temperatures, cure, heat balance."""

from __future__ import annotations

from dolfinx import fem

from app.case.case import Case
from app.case.probes import Probe
from app.heat.operators import InitialContactTemperature
from app.results.balance import HeatBalance
from app.results.thermal_record import CureRecord, ThermalRecord, heat_through_interfaces
from app.scene.bodies import nodes_on
from app.stepping.heat_state import HeatState, HeatStep

# Heat below this multiple of its rounding error in a step counts as zero.
LEAST_HEAT_OVER_ROUNDING = 1e7


class ThermalModel:
    """The heat of a model and its records.

    Attributes:
        record: Reported temperatures.
        cure: Reported degrees of cure, if anything cures.
        flows: Heat per time at the end of the last step [mW]: into the model by condition, and
            through interfaces of finite conductance from the first side to the second.
    """

    saved = ("heating", "record", "settled", "cure", "balance", "flows")

    def __init__(self, case: Case, heating: HeatState) -> None:
        operators = heating.operators
        self.operators, self.heating = operators, heating
        self._capacities = {c.region: c.capacity for c in operators.scene.conductors}
        tagged, space = operators.tagged, operators.forms.space
        self.record = ThermalRecord(
            tagged,
            operators.forms,
            operators.bodies.body_of_region,
            case.geometry.interface_sides,
            case.of_tissue("bone"),
            {n: (p.at, p.region) for n, p in case.output.probes.items() if isinstance(p, Probe)},
            {
                name: (nodes_on(tagged, space, first), nodes_on(tagged, space, second))
                for name, (first, second) in case.sliding_boundaries.items()
            },
        )
        self._first_contact = InitialContactTemperature(operators)
        # True after a steady state: first instants are not checked any more.
        self.settled = False
        self.record.start(self._reported(0.0))
        self.cure: CureRecord | None = None
        if operators.cure:
            nodes = operators.row_keys
            keys = {n.region: nodes[n.dof] for n in operators.cure.nodes}
            self.cure = CureRecord(operators.comm, heating.degrees(), keys)
        self.balance = HeatBalance(operators.stored(heating.vectors()), {})
        self.flows: dict[str, dict[str, float]] = {}
        self._keep()

    def restored(self) -> None:
        """Keep the restored state as that of the last step."""
        self._keep()

    def _keep(self) -> None:
        """Keep the state of the heat and the contact pressures that its fluxes depend on."""
        jumps = self.operators.jumps
        self._kept = self.heating.state, jumps.pressure if jumps else None

    def return_to_last_step(self) -> None:
        """Return to the heat of the last recorded step.

        A heat step is accepted before the mechanics follow, and recorded after them.
        """
        self.heating.state, pressure = self._kept
        self.heating.set_solver_state(self.heating.state)
        if self.operators.jumps and pressure is not None:
            self.operators.jumps.pressure = pressure

    def _reported(self, seconds: float) -> list[fem.Function]:
        """Reported temperatures of the bodies at a time [s]; collective."""
        temperatures = self.operators.temperatures(self.heating.vectors())
        if not self.settled:
            self._first_contact.set_reported(temperatures, seconds)
        return temperatures

    def update(self, heat_step: HeatStep) -> None:
        """Record an accepted step; collective."""
        self._keep()
        heating, operators = self.heating, self.operators
        x = heating.vectors()
        temperatures = operators.temperatures(x)
        exchanges = heat_through_interfaces(operators, x, temperatures)
        self.settled = self.settled or heat_step.dt == 0.0
        temperatures = self._reported(heat_step.seconds)
        highest = operators.principle.high
        rates = [*heating.temperature_rates()] if heating.begins_at_event(heat_step) else ()
        self.record.update(heat_step.seconds, temperatures, exchanges, highest, rates)
        if self.cure:
            self.cure.update(heat_step.seconds, heating.degrees(), heating.cure_rates())
        self.flows = {
            "into": dict(heat_step.flows),
            "through": heating.system.heat_through_interfaces(x),
        }
        heat = operators.stored(x)
        rounding = heating.system.measure(x, heating.system.vectors())[0].rounding
        if heat_step.dt == 0.0:
            # Where the temperature is uniform, all flows are below this rounding.
            self.balance.steady(heat_step.flows, heat, 1e2 * rounding)
            return
        moved_heat = self.record.moved_heat(self._capacities)
        # Before the first heat, for example of friction, all heats are below it.
        smallest_heat = LEAST_HEAT_OVER_ROUNDING * rounding * heat_step.dt
        self.balance.update(
            heat_step.dt, heat_step.heats, heat_step.flows, heat, moved_heat, smallest_heat
        )

    def row(self) -> dict[str, float]:
        """Columns of history.csv."""
        cure = self.cure.row() if self.cure else {}
        return {**self.record.row, **cure, "heat balance [-]": self.balance.heat}
