r"""Thermal expansion: the forces of temperatures on the bodies.

A region swells by :math:`e = α (θ - θ_{ref})`, linear between the vertices. The elastic strain is
ε(u) - e I; the paper's energy, eq. 51, leaves the second term out. With constant moduli the forces
are G e, with a matrix G for each region that is assembled once.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from operator import add

from petsc4py import PETSc

import ufl
from dolfinx import fem

from app.laws.materials import Elastic
from app.mechanics.body_forms import BodyForms, assemble_form_matrix
from app.mechanics.contact import ContactInterfaces
from app.mechanics.stiffness import Stiffness


class ThermalStrain:
    """Thermal expansion of the elastic regions of a scene."""

    def __init__(self, body_forms: BodyForms) -> None:
        self._body_forms, scene = body_forms, body_forms.scene
        self._expansions = [x for x in scene.expansions if x.region in body_forms.free_strain]
        self.body = {x.region: body_forms.bodies.body_of_region[x.region] for x in self._expansions}
        self._elastic = {e.region: e for e in scene.elastic}
        self.assemble()

    def assemble(self) -> None:
        """Assemble the forces of unit strain at the present moduli; collective."""
        # In path-dependent regions free strain is a part of the stress history.
        self._force_matrices = {
            x.region: _force_matrix(self._body_forms, self._elastic[x.region])
            for x in self._expansions
            if x.region not in self._body_forms.path_dependent_regions
        }

    def set(self, temperatures: Mapping[str, fem.Function]) -> dict[int, PETSc.Vec]:
        """Set the thermal strain; return nodal forces on each body [N].

        Args:
            temperatures: Values at the vertices of each expanding region [K], ghosts included.
        """
        for x in self._expansions:
            e = self._body_forms.free_strain[x.region]
            e.x.array[:] = x.expansion * (temperatures[x.region].x.array - x.reference)
        return self.forces()

    def forces(self) -> dict[int, PETSc.Vec]:
        """Nodal forces of the present thermal strain on each body [N]."""
        forces_on_bodies: dict[int, PETSc.Vec] = {}
        for region, G in self._force_matrices.items():
            e, body = self._body_forms.free_strain[region], self.body[region]
            nodal = G.createVecRight()
            nodal.array[:] = e.x.array[: nodal.getLocalSize()]
            forces_on_bodies.setdefault(body, G.createVecLeft())
            G.multAdd(nodal, forces_on_bodies[body], forces_on_bodies[body])
        return forces_on_bodies

    def stiffness(
        self,
        jump_to_temperature: Mapping[str, PETSc.Mat],
        stiffness: Stiffness,
        contact: ContactInterfaces | None,
    ) -> list[list[PETSc.Mat | None]]:
        """Derivatives of the forces by temperature [N/K]; zero in supported rows; collective.

        ``jump_to_temperature`` are matrices from temperature jumps to nodal temperatures, by region
        moved.

        Returns:
            Rows of displacement and jumps, columns of temperatures and temperature jumps; None
            where the scene has no such unknowns.
        """
        expansions = [x for x in self._expansions if x.region in self._force_matrices]
        scaled = {x.region: self._force_matrices[x.region] * x.expansion for x in expansions}
        by_jumps = {
            r: G.matMult(jump_to_temperature[r])
            for r, G in scaled.items()
            if r in jump_to_temperature
        }
        columns = []
        for of_region in (scaled, by_jumps):
            matrices_of_bodies: dict[int, PETSc.Mat] = {}
            for region, matrix in of_region.items():
                body = self.body[region]
                matrices_of_bodies[body] = (
                    matrices_of_bodies[body] + matrix if body in matrices_of_bodies else matrix
                )
            by_body = contact.coupling.jump_to_displacement if contact else {}
            jump_forces = [
                B.transposeMatMult(matrices_of_bodies[b])
                for b, B in by_body.items()
                if b in matrices_of_bodies
            ]
            displacement_forces = (
                stiffness.constraints.rows(reduce(add, matrices_of_bodies.values()))
                if matrices_of_bodies
                else None
            )
            if displacement_forces is not None:
                displacement_forces.zeroRows(stiffness.rows, diag=0.0)
            columns.append((displacement_forces, reduce(add, jump_forces) if jump_forces else None))
        return [list(row) for row in zip(*columns, strict=True)]


def _force_matrix(body_forms: BodyForms, e: Elastic) -> PETSc.Mat:
    """Nodal forces of the bodies by the nodal thermal strain of a region, both of this rank."""
    v, free_strain = ufl.TestFunction(body_forms.space), ufl.TrialFunction(body_forms.scalars)
    # One constant for any region: all isotropic ones share a compiled form.
    cells = [(1, body_forms.region_cells(e.region))]
    dx = ufl.Measure("dx", domain=body_forms.mesh, subdomain_data=cells)
    strain = body_forms.elastic_strain(e, body_forms.u)
    energy = body_forms.energy_density(e, strain) * body_forms.over(e, dx, 1)
    forces = -ufl.derivative(energy, body_forms.u, v)
    form = ufl.derivative(forces, body_forms.free_strain[e.region], free_strain)
    return assemble_form_matrix(body_forms.form(form))
