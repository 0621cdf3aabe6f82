"""Heat through interfaces of finite conductance, its entropy production, and their extremes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
from dolfinx import fem

from app.arrays import Floats
from app.heat.temperature_jumps import TemperatureJumps
from forms import interface_heat

W_PER_M2 = 1e3  # W/m2 in N/(mm s), W/(m2 K) in N/(mm s K)
# By interface, at this rank's points: heat flux from master to slave per area (n,) [N/(mm s)], and
# entropy production per area (n,) [N/(mm s K)].
Exchanges = Mapping[str, tuple[Floats, Floats]]


def exchange(
    names: Sequence[str],
    jumps: TemperatureJumps,
    temperatures: Sequence[fem.Function],
    τ: Floats,
) -> Exchanges:
    """Heat through the interfaces of finite conductance.

    Args:
        names: Names of the interfaces.
        jumps: Their points.
        temperatures: Of the bodies [K].
        τ: Jumps at own points (n,) [K].
    """
    table = np.stack([t.x.array[jumps.dof] for t in temperatures])
    master, slave = (table[jumps.bodies[:, k], np.arange(len(jumps.dof))] for k in (0, 1))
    q = jumps.flux(τ)[0]
    s = interface_heat.entropy_production(q, jumps.friction, jumps.share, master, slave)
    at = [jumps.interface == i for i in range(len(names))]
    return {name: (q[here], np.asarray(s)[here]) for name, here in zip(names, at, strict=True)}


@dataclass
class InterfaceExtremes:
    """Largest jump and flux, and entropy production of one interface, over all ranks."""

    jump: float = 0.0
    flux: float = 0.0
    entropy_min: float = np.inf
    entropy_max: float = -np.inf

    def take(self, comm: MPI.Comm, flux: Floats, entropy: Floats) -> None:
        """Update from own points: flux (n,) [N/(mm s)], entropy [N/(mm s K)]; collective."""
        ends = [np.abs(flux).max(initial=0.0), entropy.max(initial=-np.inf)]
        most = np.array([*ends, -entropy.min(initial=np.inf)])
        comm.Allreduce(MPI.IN_PLACE, most, MPI.MAX)
        self.flux = max(self.flux, float(most[0]))
        self.entropy_max = max(self.entropy_max, float(most[1]))
        self.entropy_min = min(self.entropy_min, -float(most[2]))

    def summary(self) -> dict[str, float]:
        """Their numbers in the summary."""
        result = {"temperature_jump_max": self.jump}
        # Where both sides share one temperature the rest is unknown.
        if self.entropy_min < np.inf:
            result["heat_flux_max"] = W_PER_M2 * self.flux
            result["entropy_production_min"] = W_PER_M2 * self.entropy_min
            result["entropy_production_max"] = W_PER_M2 * self.entropy_max
        return result
