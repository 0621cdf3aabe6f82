r"""Balance of heat: inflow, storage and outflow, by the integrator's and by trapezoidal sums.

The integrator's own sum of a step of length Δt with weights :math:`b_i` is exact for its discrete
solution, to the tolerance of its equations,

.. math:: E(t) - E(0) = \sum_{steps} Δt \sum_i b_i \sum_c Q_c(t_i),

with E the stored heat and :math:`Q_c` the flow into the model by condition c. The second sum takes
the flows at the ends of the steps by the trapezoidal rule: it does not use the stages, and its
defect is the error of that rule.
"""

from __future__ import annotations

from collections.abc import Mapping

Flows = Mapping[str, float]


class HeatBalance:
    """Sums of heat over the steps.

    Attributes:
        heat: Largest defect of the integrator's sum after any step, over the heat that had moved.
        quadrature: Defect of the trapezoidal sum.
        heats: Heat that came in by each condition so far, by the integrator's sum [N mm].

    Args:
        stored: Heat stored at the start [N mm].
        flows: Flow into the model by each condition at the start [N mm/s]; empty if it is not
            known (it is infinite where temperatures differ from given ones): the first step is
            then summed with the flows at its end.
    """

    saved = (
        *("_stored", "_now", "_last", "_stage_sum", "_end_sum", "_moved"),
        *("heat", "quadrature", "heats"),
    )

    def __init__(self, stored: float, flows: Flows) -> None:
        self._stored = self._now = stored
        self._last = dict(flows)
        self._stage_sum = self._end_sum = self._moved = 0.0
        self.heat = self.quadrature = 0.0
        self.heats: dict[str, float] = {}

    def update(
        self,
        step: float,
        heats: Flows,
        end: Flows,
        stored: float,
        moved: float,
        least: float = 0.0,
    ) -> None:
        """Add an accepted step.

        Args:
            step: Its length [s].
            heats: Heat that came in by each condition, as the integrator sums its stages [N mm].
            end: Flows at the end [N mm/s].
            stored: Heat stored then [N mm].
            moved: Heat that moved within the model in the step [N mm], the scale of the balances
                (`ThermalRecord.moved`).
            least: Heat moved so far below which only rounding would be compared [N mm].
        """
        for name, heat in heats.items():
            self.heats[name] = self.heats.get(name, 0.0) + heat
        self._stage_sum += sum(heats.values())
        begin = self._last or end
        self._end_sum += step * (sum(begin.values()) + sum(end.values())) / 2
        self._last = dict(end)
        self._moved += max(sum(map(abs, heats.values())), moved)
        self._now = stored
        if self._moved >= least:
            gained, scale = stored - self._stored, self._moved or 1.0
            self.heat = max(self.heat, abs(self._stage_sum - gained) / scale)
            self.quadrature = abs(self._end_sum - gained) / scale

    def event(self, flows: Flows) -> None:
        """Replace the flows where they jump, as at the end of a course [N mm/s]."""
        self._last = dict(flows)

    def steady(self, flows: Flows, stored: float, rounding: float) -> None:
        """Add a steady state, where inflow equals outflow and storage does not count.

        Args:
            flows: Flows into the model, by condition [N mm/s].
            stored: Heat stored [N mm].
            rounding: Rounding error of flows that cancel; smaller defects count as zero [N mm/s].
        """
        through = sum(abs(f) for f in flows.values())
        if through > rounding:
            self.heat = max(self.heat, abs(sum(flows.values())) / through)
        # The sums go on from here.
        self._end_sum += stored - self._now
        self._stage_sum += stored - self._now
        self._now, self._last = stored, dict(flows)
