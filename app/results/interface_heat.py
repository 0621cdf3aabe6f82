"""Heat through interfaces of finite conductance, its entropy production, and their extremes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from app.arrays import Floats
from app.heat.temperature_jumps import TemperatureJumps
from forms import interface_heat

W_PER_M2 = 1e3  # W/m2 in N/(mm s), W/(m2 K) in N/(mm s K)


@dataclass(frozen=True)
class HeatPassed:
    """Heat flux and entropy production at this rank's points of conducting interfaces (n,).

    Attributes:
        interface: Index into `names` of each point.
        flux: Heat from master to slave per area [N/(mm s)].
        entropy: Entropy production per area [N/(mm s K)].
    """

    names: tuple[str, ...]
    interface: NDArray[np.int64]
    flux: Floats
    entropy: Floats


def exchange(
    names: Sequence[str],
    jumps: TemperatureJumps,
    temperatures: Sequence[fem.Function],
    τ: Floats,
    friction: Floats,
    share: Floats,
) -> HeatPassed:
    """Flux and entropy production at the points of finite conductance.

    Args:
        names: Names of the interfaces.
        jumps: Their points.
        temperatures: Of the bodies [K].
        τ: Jumps at own points (n,) [K].
        friction: Friction heat per area there (n,) [N/(mm s)].
        share: Fraction of it that enters the slave (n,).
    """
    table = np.stack([t.x.array[jumps.dof] for t in temperatures])
    master, slave = (table[jumps.bodies[:, k], np.arange(len(jumps.dof))] for k in (0, 1))
    q = jumps.flux(τ)[0]
    s = np.asarray(interface_heat.entropy_production(q, friction, share, master, slave))
    return HeatPassed(tuple(names), jumps.interface, q, s)


@dataclass
class InterfaceExtremes:
    """Largest jump and flux, and entropy production of one interface, over all ranks."""

    jump: float = 0.0
    flux: float = 0.0
    entropy_min: float = np.inf
    entropy_max: float = -np.inf

    def take(self, comm: MPI.Comm, flux: Floats, entropy: Floats) -> None:
        """Update from own points: flux (n,) [N/(mm s)], entropy [N/(mm s K)]; collective."""
        highest = np.array([np.abs(flux).max(initial=0.0), -entropy.min(initial=np.inf)])
        highest = np.append(highest, entropy.max(initial=-np.inf))
        comm.Allreduce(MPI.IN_PLACE, highest, MPI.MAX)
        flux_max, low, high = map(float, highest)
        self.flux = max(self.flux, flux_max)
        self.entropy_min = min(self.entropy_min, -low)
        self.entropy_max = max(self.entropy_max, high)

    def summary(self) -> dict[str, float]:
        """Their numbers in the summary."""
        result = {"temperature_jump_max": self.jump}
        # Where both sides share one temperature the rest is unknown.
        if self.entropy_min < np.inf:
            result["heat_flux_max"] = W_PER_M2 * self.flux
            result["entropy_production_min"] = W_PER_M2 * self.entropy_min
            result["entropy_production_max"] = W_PER_M2 * self.entropy_max
        return result
