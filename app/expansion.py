r"""Thermal expansion: what temperatures do to the bodies, as forces.

A region swells by :math:`e = α (θ - θ_{ref})`, linear between the vertices. Its elastic strain is
ε(u) - e I (the paper's energy, eq. 51, leaves the second term out), so that with constant moduli
the forces are G e with a matrix G for each region, assembled once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from petsc4py import PETSc

from dolfinx import fem

from app.bodies import Bodies
from app.mechanics import Mechanics
from app.terms import Expansion, Scene


@dataclass(frozen=True)
class ThermalStiffness:
    """Forces on displacement and jumps by temperatures and by temperature jumps [N/K].

    A matrix is None where the scene has no such unknowns.
    """

    u_θ: PETSc.Mat | None
    u_τ: PETSc.Mat | None
    q_θ: PETSc.Mat | None
    q_τ: PETSc.Mat | None


class Expansions:
    """Thermal expansion of the elastic regions of a scene."""

    def __init__(self, scene: Scene, mechanics: Mechanics, bodies: Bodies) -> None:
        """Assemble the forces of each region; collective."""
        self._mechanics = mechanics
        self._terms = [x for x in scene.expansions if x.region in mechanics.swelling]
        self.body = {x.region: bodies.of_region[x.region] for x in self._terms}
        elastic = {e.region: e for e in scene.elastic}
        self._forces = {x.region: mechanics.swelling_forces(elastic[x.region]) for x in self._terms}

    def set(self, temperatures: Mapping[str, fem.Function]) -> dict[int, PETSc.Vec]:
        """Swell to temperatures.

        Args:
            temperatures: For each region that expands, values at the vertices [K], ghosts included.

        Returns:
            Nodal forces on each body [N].
        """
        parts: dict[int, PETSc.Vec] = {}
        for x in self._terms:
            e = self._mechanics.swelling[x.region]
            e.x.array[:] = x.coefficient * (temperatures[x.region].x.array - x.reference)
            G, body = self._forces[x.region], self.body[x.region]
            nodal = G.createVecRight()
            nodal.array[:] = e.x.array[: nodal.getLocalSize()]
            parts.setdefault(body, G.createVecLeft())
            G.multAdd(nodal, parts[body], parts[body])
        return parts

    def by_temperature(self) -> dict[int, PETSc.Mat]:
        """Nodal forces on each body by the nodal temperatures [N/K]."""
        return _sums((self.body[x.region], self._scaled(x)) for x in self._terms)

    def by_jump(self, moves: Mapping[str, PETSc.Mat]) -> dict[int, PETSc.Mat]:
        """Nodal forces on each body by temperature jumps [N/K].

        Args:
            moves: For each region whose temperatures jumps move, what they add to those.
        """
        return _sums(
            (self.body[x.region], self._scaled(x).matMult(moves[x.region]))
            for x in self._terms
            if x.region in moves
        )

    def _scaled(self, x: Expansion) -> PETSc.Mat:
        forces = self._forces[x.region].copy()
        forces.scale(x.coefficient)
        return forces


def _sums(parts: Iterable[tuple[int, PETSc.Mat]]) -> dict[int, PETSc.Mat]:
    """Sum of the matrices of each body."""
    sums: dict[int, PETSc.Mat] = {}
    for body, part in parts:
        sums[body] = sums[body] + part if body in sums else part
    return sums
