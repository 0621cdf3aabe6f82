"""The forms of heat on the mesh: conduction, exchange with surroundings, lumped volumes and areas.

Temperature is piecewise linear, on curved cells too. All terms but conduction are lumped: a node
has the integral of its shape function over a region, or over a body's part of a boundary. Capacity
and exchange then have no off-diagonal entries, which would let temperatures overshoot in short
steps. Densities and fluxes that vary in space are evaluated at nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.fem.petsc import assemble_matrix, assemble_vector
from numpy.typing import ArrayLike, NDArray
from ufl.core.expr import Expr

from app.foundation.arrays import Bools, Field, Floats, Ints
from app.foundation.collective import everywhere
from app.foundation.dolfinx_features import exterior_facet_entities
from app.laws.heat_conditions import Convection, FixedTemperature, HeatFlux, HeatSource, Perfusion
from app.laws.thermal import Thermal
from app.numerics.lifetime import function_space
from app.numerics.sparse import diagonal, matrix_sum
from app.scene.bodies import Bodies, facets_by_body
from app.system.timing import Timing
from forms import heat
from meshes.distribute import TaggedMesh

Condition = HeatFlux | HeatSource | Convection | Perfusion

# Degree of quadrature where fibres are curved: UFL would choose 20, with the same fluxes to 0.01 %.
CURVED_FIBRE_DEGREE = 2


class HeatForms:
    """Assembled pieces of heat conduction, by region and by body.

    Attributes:
        space: Temperature space.
        owned: Number of nodes of this rank.

    Args:
        bodies: Thermal bodies, which interfaces of finite conductance separate.
    """

    def __init__(self, tagged: TaggedMesh, bodies: Bodies, timing: Timing) -> None:
        self._tagged, self._bodies, self._timing = tagged, bodies, timing
        self._mesh = tagged.mesh
        self.comm = tagged.mesh.comm
        self.space = function_space(tagged.mesh, ("Lagrange", 1))
        self.owned: int = self.space.dofmap.index_map.size_local
        self._volumes: dict[str, Floats] = {}

    def zeros(self) -> Floats:
        """Zeros at owned nodes of each body (b, n)."""
        return np.zeros((len(self._bodies.names), self.owned))

    # Where

    def cells(self, region: str) -> NDArray[np.int32]:
        """Cells of a region that this rank owns."""
        cells = self._tagged.cell_tags.find(self._tagged.regions[region])
        return np.asarray(cells[cells < self._mesh.topology.index_map(3).size_local])

    def prescribed_nodes(self, condition: FixedTemperature) -> Bools:
        """Mask of owned nodes of each body with prescribed temperature (b, n); collective."""
        is_prescribed = self.zeros() > 0
        if condition.boundary:
            by_body = facets_by_body(self._tagged, self._bodies, condition.boundary)
            for b, facets in by_body.items():
                nodes = fem.locate_dofs_topological(self.space, 2, facets)
                is_prescribed[b, nodes[nodes < self.owned]] = True
        for region in condition.regions or ():
            is_prescribed[self._bodies.body_of_region[region]] |= self.volumes(region) > 0
        return is_prescribed

    def values(self, field: Field, nodes: Ints) -> Floats:
        """Values of a field at owned nodes, zero at all other nodes (owned,); collective.

        Raises:
            InputError: The field cannot be evaluated there.
        """
        x = self.space.tabulate_dof_coordinates()[nodes]
        values = np.zeros(self.owned)
        values[nodes] = everywhere(self.comm, lambda: np.asarray(field(x), dtype=float).reshape(-1))
        return values

    # Lumped, by body

    def volumes(self, region: str) -> Floats:
        """Volume of a region at each owned node [mm3]."""
        if region not in self._volumes:
            self._volumes[region] = self._assemble_nodal(self._unit_power() * self._dx(region))
        return self._volumes[region]

    def sizes(self, condition: HeatFlux | HeatSource) -> Floats:
        """Area [mm2] or volume [mm3] of a condition at owned nodes of each body (b, n)."""
        power = self._unit_power()
        return self._lump_by_body(condition, lambda measure: power * measure)

    def exchange(self, condition: Convection | Perfusion) -> Floats:
        """Heat per kelvin exchanged with surroundings at owned nodes (b, n) [N mm/(s K)]."""
        # The derivative of the potential at a temperature of 1 K: the sums of rows.
        θ = fem.Function(self.space)
        θ.x.array[:] = 1
        potential = heat.exchange(θ, self._constant(condition.coefficient), self._constant(0.0))
        return self._lump_by_body(condition, lambda measure: ufl.derivative(potential * measure, θ))

    def _unit_power(self) -> Expr:
        return heat.heating_power(self._constant(1.0), ufl.TestFunction(self.space))

    def _lump_by_body(
        self, condition: Condition, form: Callable[[ufl.Measure], ufl.Form]
    ) -> Floats:
        total = self.zeros()
        if condition.boundary is not None:
            measures = list(self._ds(condition.boundary).items())
        else:
            measures = [(self._bodies.body_of_region[r], self._dx(r)) for r in condition.regions]
        for b, measure in measures:
            total[b] += self._assemble_nodal(form(measure))
        return total

    # Conduction

    def conduction_by_body(self, conductors: Sequence[Thermal]) -> list[PETSc.Mat]:
        """Conduction matrix of each body, its whole diagonal in the pattern [N mm/(s K)]."""
        matrices_of_bodies: dict[int, list[PETSc.Mat]] = {}
        for c in conductors:
            matrices_of_bodies.setdefault(self._bodies.body_of_region[c.region], []).append(
                self._conduction(c)
            )
        zero = diagonal(self.comm, np.zeros(self.owned))
        return [matrix_sum((zero, *matrices_of_bodies[b])) for b in range(len(self._bodies.names))]

    def _conduction(self, conductor: Thermal) -> PETSc.Mat:
        θ, v = fem.Function(self.space), ufl.TestFunction(self.space)
        k = [self._constant(value) for value in conductor.conductivities]
        m = conductor.fibre.direction(self._mesh, self._constant) if conductor.fibre else None
        dx = self._dx(conductor.region)
        if conductor.fibre and conductor.fibre.curved:
            dx = dx(degree=CURVED_FIBRE_DEGREE)
        potential = conductor.potential(ufl.grad(θ), k, m) * dx
        hessian = ufl.derivative(ufl.derivative(potential, θ, v), θ, ufl.TrialFunction(self.space))
        matrix = assemble_matrix(self._form(hessian))
        matrix.assemble()
        return matrix

    # One subdomain number for all measures: forms on different subdomains are compiled once.

    def _dx(self, region: str) -> ufl.Measure:
        return ufl.Measure("dx", domain=self._mesh, subdomain_data=[(1, self.cells(region))])(1)

    def _ds(self, boundary: str) -> dict[int, ufl.Measure]:
        return {
            b: ufl.Measure(
                "ds",
                domain=self._mesh,
                subdomain_data=[(1, exterior_facet_entities(self._mesh.topology, facets))],
            )(1)
            for b, facets in facets_by_body(self._tagged, self._bodies, boundary).items()
        }

    def _constant(self, value: ArrayLike) -> fem.Constant:
        return fem.Constant(self._mesh, np.asarray(value, dtype=default_scalar_type))

    def compiling(self) -> AbstractContextManager[None]:
        """Count the time of a block as compilation."""
        return self._timing.phase("compile", "heat")

    def _form(self, form: ufl.Form) -> fem.Form:
        with self.compiling():
            return fem.form(form)

    def _assemble_nodal(self, form: ufl.Form) -> Floats:
        vector = assemble_vector(self._form(form))
        vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        values: Floats = vector.array[: self.owned].copy()
        return values
