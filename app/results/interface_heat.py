"""Heat through interfaces of finite conductance, its entropy production, and their extremes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from dolfinx import fem

from app.arrays import Floats
from app.heat.operators import HeatOperators
from forms import interface_heat

W_PER_M2 = 1e3  # W/m2 in N/(mm s), W/(m2 K) in N/(mm s K)
# By interface, at this rank's points: heat flux from master to slave per area (n,) [N/(mm s)], and
# entropy production per area (n,) [N/(mm s K)].
Exchanges = Mapping[str, tuple[Floats, Floats]]


def exchange(
    operators: HeatOperators, x: Sequence[PETSc.Vec], temperatures: Sequence[fem.Function]
) -> Exchanges:
    """Heat through the interfaces of finite conductance, if there are any.

    Args:
        operators: The heat on the mesh.
        x: Its unknowns.
        temperatures: Of the bodies [K].
    """
    if (j := operators.jumps) is None:
        return {}
    table = np.stack([t.x.array[j.dof] for t in temperatures])
    master, slave = (table[j.bodies[:, k], np.arange(len(j.dof))] for k in (0, 1))
    q = j.flux(x[1].array)[0]
    s = np.asarray(interface_heat.entropy_production(q, j.friction, j.share, master, slave))
    at = {c.name: j.interface == i for i, c in enumerate(operators.scene.thermal_contacts)}
    return {name: (q[here], s[here]) for name, here in at.items()}


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
