r"""Thermal expansion: the forces of temperatures on the bodies.

A region swells by :math:`e = α (θ - θ_{ref})`, linear between the vertices. Its elastic strain is
ε(u) - e I (the paper's energy, eq. 51, leaves the second term out), so that with constant moduli
the forces are G e with a matrix G for each region, assembled once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import reduce
from operator import add

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from app.laws.materials import Elastic
from app.laws.thermal import Thermal
from app.mechanics.body_forms import BodyForms, assembled_matrix
from app.mechanics.constraints import Constraints
from app.mechanics.contact import ContactInterfaces
from app.scene.bodies import Bodies
from app.scene.scene import Scene


@dataclass(frozen=True)
class ThermalStiffness:
    """Forces on displacement and jumps by temperatures and by temperature jumps [N/K].

    A matrix is None where the scene has no such unknowns.
    """

    u_θ: PETSc.Mat | None
    u_τ: PETSc.Mat | None
    q_θ: PETSc.Mat | None
    q_τ: PETSc.Mat | None


class ThermalStrain:
    """Thermal expansion of the elastic regions of a scene."""

    def __init__(self, scene: Scene, mechanics: BodyForms, bodies: Bodies) -> None:
        self._mechanics = mechanics
        self._terms = [x for x in scene.expansions if x.region in mechanics.swelling]
        self.body = {x.region: bodies.of_region[x.region] for x in self._terms}
        elastic = {e.region: e for e in scene.elastic}
        self._forces = {x.region: _forces(mechanics, elastic[x.region]) for x in self._terms}

    def set(self, temperatures: Mapping[str, fem.Function]) -> dict[int, PETSc.Vec]:
        """Set the thermal strain; return nodal forces on each body [N].

        Args:
            temperatures: Values at the vertices of each expanding region [K], ghosts included.
        """
        parts: dict[int, PETSc.Vec] = {}
        for x in self._terms:
            e = self._mechanics.swelling[x.region]
            e.x.array[:] = x.expansion * (temperatures[x.region].x.array - x.reference)
            G, body = self._forces[x.region], self.body[x.region]
            nodal = G.createVecRight()
            nodal.array[:] = e.x.array[: nodal.getLocalSize()]
            parts.setdefault(body, G.createVecLeft())
            G.multAdd(nodal, parts[body], parts[body])
        return parts

    def stiffness(
        self,
        moves: Mapping[str, PETSc.Mat],
        constraints: Constraints,
        contact: ContactInterfaces | None,
        supported: NDArray[np.int32],
    ) -> ThermalStiffness:
        """Derivatives of the forces by temperature.

        ``moves`` are matrices from temperature jumps to nodal temperatures, by region moved. Rows
        of the ``supported`` displacements are zeroed.
        """
        by_θ = _sums((self.body[x.region], self._scaled(x)) for x in self._terms)
        by_τ = _sums(
            (self.body[x.region], self._scaled(x).matMult(moves[x.region]))
            for x in self._terms
            if x.region in moves
        )

        def on_u(parts: dict[int, PETSc.Mat]) -> PETSc.Mat | None:
            if not parts:
                return None
            rows = constraints.rows(reduce(add, parts.values()))
            rows.zeroRows(supported, diag=0.0)
            return rows

        def on_q(parts: dict[int, PETSc.Mat]) -> PETSc.Mat | None:
            by_jump = contact.coupling.jump_to_displacement if contact else {}
            moved = [B.transposeMatMult(parts[b]) for b, B in by_jump.items() if b in parts]
            return reduce(add, moved) if moved else None

        # First the jumps: without rigid regions the rows of the displacement are the parts.
        q_θ, q_τ = on_q(by_θ), on_q(by_τ)
        return ThermalStiffness(u_θ=on_u(by_θ), u_τ=on_u(by_τ), q_θ=q_θ, q_τ=q_τ)

    def _scaled(self, x: Thermal) -> PETSc.Mat:
        forces = self._forces[x.region].copy()
        forces.scale(x.expansion)
        return forces


def _forces(mechanics: BodyForms, e: Elastic) -> PETSc.Mat:
    """Nodal forces of the bodies by the nodal thermal strain of a region, both of this rank."""
    v, free = ufl.TestFunction(mechanics.space), ufl.TrialFunction(mechanics.scalars)
    # One constant for any region: all isotropic ones share a compiled form.
    cells = [(1, mechanics.region_cells(e.region))]
    dx = ufl.Measure("dx", domain=mechanics.mesh, subdomain_data=cells)
    strain = mechanics.elastic_strain(e, mechanics.u)
    energy = mechanics.energy_density(e, strain) * mechanics.over(e, dx, 1)
    forces = -ufl.derivative(energy, mechanics.u, v)
    form = ufl.derivative(forces, mechanics.swelling[e.region], free)
    return assembled_matrix(mechanics.form(form))


def _sums(parts: Iterable[tuple[int, PETSc.Mat]]) -> dict[int, PETSc.Mat]:
    sums: dict[int, PETSc.Mat] = {}
    for body, part in parts:
        sums[body] = sums[body] + part if body in sums else part
    return sums
