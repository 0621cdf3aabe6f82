"""The forms of heat on the mesh: conduction, exchange with surroundings, lumped volumes and areas.

Temperature is piecewise linear, on curved cells too. All but conduction is lumped: a node has the
integral of its shape function over a region or over a body's part of a boundary, and laws hold at
nodes. Capacity and exchange then have no off-diagonal entries, which would let temperatures
overshoot in short steps; densities and fluxes that vary in space are evaluated at nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Any

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import default_scalar_type, fem
from dolfinx.fem import IntegralType, compute_integration_domains
from dolfinx.fem.petsc import assemble_matrix, assemble_vector
from numpy.typing import NDArray

from app.arrays import Field, Floats, Ints
from app.errors import everywhere
from app.laws.heat_conditions import Convection, FixedTemperature, Perfusion
from app.laws.thermal import Thermal
from app.numerics.sparse import from_rows, matrix_sum
from app.scene.bodies import Bodies, boundary_facets, cell_tags
from app.system.timing import Timing
from forms import heat
from meshes.distribute import TaggedMesh

# Degree of quadrature where fibres turn: UFL would choose 20, with the same fluxes to 0.01 %.
TURNING_DEGREE = 2


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
        self.space = fem.functionspace(tagged.mesh, ("Lagrange", 1))
        self.owned: int = self.space.dofmap.index_map.size_local
        self._tags = cell_tags(tagged)
        self._volumes: dict[str, Floats] = {}
        self._areas: dict[str, dict[int, Floats]] = {}

    def zeros(self) -> list[Floats]:
        """Zeros at own nodes of each body."""
        return [np.zeros(self.owned) for _ in self._bodies.names]

    # Where

    def cells(self, region: str) -> NDArray[np.int32]:
        """Cells of a region that this rank owns."""
        owned = self._mesh.topology.index_map(3).size_local
        here = self._tags[:owned] == self._tagged.regions[region]
        return np.flatnonzero(here).astype(np.int32)

    def facets(self, boundary: str) -> dict[int, NDArray[np.int32]]:
        """Own facets of a boundary by body, the same bodies on all ranks; collective."""
        f = boundary_facets(self._tagged, boundary)
        body = self._bodies.of_tag[self._tags[f.cells]]
        present = set().union(*self.comm.allgather({int(b) for b in np.unique(body)}))
        return {b: f.facets[body == b].astype(np.int32) for b in sorted(present)}

    def held_nodes(self, condition: FixedTemperature) -> dict[int, Ints]:
        """Own nodes with a given temperature, by body; collective."""
        found: dict[int, list[NDArray[np.int32]]] = {}
        if condition.boundary:
            for b, facets in self.facets(condition.boundary).items():
                found.setdefault(b, []).append(fem.locate_dofs_topological(self.space, 2, facets))
        for region in condition.regions or ():
            nodes = np.flatnonzero(self.volumes(region) > 0).astype(np.int32)
            found.setdefault(self._bodies.of_region[region], []).append(nodes)
        joined = {b: np.unique(np.concatenate(nodes)) for b, nodes in found.items()}
        return {b: nodes[nodes < self.owned].astype(np.int64) for b, nodes in joined.items()}

    def values(self, field: Field, nodes: Ints) -> Floats:
        """A field at some own nodes, zero at the others (owned,); collective.

        Raises:
            InputError: The field cannot be evaluated there.
        """
        x = self.space.tabulate_dof_coordinates()[nodes]
        values = np.zeros(self.owned)
        values[nodes] = everywhere(self.comm, lambda: np.asarray(field(x), dtype=float).reshape(-1))
        return values

    # Lumped volumes and areas

    def volumes(self, region: str) -> Floats:
        """Volume of a region at each own node [mm3]."""
        if region not in self._volumes:
            v = ufl.TestFunction(self.space)
            power = heat.heating_power(self._constant(1.0), v) * self._dx(region)
            self._volumes[region] = self._nodal(power)
        return self._volumes[region]

    def areas(self, boundary: str) -> dict[int, Floats]:
        """Area of a boundary at each own node, by body [mm2]."""
        if boundary not in self._areas:
            v = ufl.TestFunction(self.space)
            self._areas[boundary] = {
                b: self._nodal(heat.heating_power(self._constant(1.0), v) * ds)
                for b, ds in self._ds(boundary).items()
            }
        return self._areas[boundary]

    def capacities(self, conductors: Sequence[Thermal]) -> list[Floats]:
        """Heat capacity of own nodes in each body [N mm/K]."""
        total = self.zeros()
        for c in conductors:
            total[self._bodies.of_region[c.region]] += c.capacity * self.volumes(c.region)
        return total

    # Forms

    def conduction_by_body(self, conductors: Sequence[Thermal]) -> list[PETSc.Mat]:
        """Conduction matrix of each body, its whole diagonal in the pattern [N mm/(s K)]."""
        parts: dict[int, list[PETSc.Mat]] = {}
        for c in conductors:
            parts.setdefault(self._bodies.of_region[c.region], []).append(self.conduction(c))
        return [_with_diagonal(matrix_sum(parts[b])) for b in range(len(self._bodies.names))]

    def conduction(self, conductor: Thermal) -> PETSc.Mat:
        """Conduction matrix of a region [N mm/(s K)]."""
        θ = fem.Function(self.space)
        k = [self._constant(value) for value in conductor.conductivities]
        m = conductor.fibre.direction(self._mesh, self._constant) if conductor.fibre else None
        potential = conductor.potential(ufl.grad(θ), k, m)
        dx = self._dx(conductor.region)
        if conductor.fibre and conductor.fibre.turns:
            dx = dx(degree=TURNING_DEGREE)
        matrix = assemble_matrix(self._form(self._hessian(potential * dx, θ)))
        matrix.assemble()
        return matrix

    def exchange(self, condition: Convection | Perfusion) -> dict[int, Floats]:
        """Heat per kelvin that own nodes exchange with surroundings, by body [N mm/(s K)]."""
        θ, one = fem.Function(self.space), fem.Function(self.space)
        one.x.array[:] = 1
        potential = heat.exchange(θ, self._constant(condition.coefficient), self._constant(0.0))
        parts: dict[int, Floats] = {}
        for b, measure in self._places(condition):
            # Lumped: the sums of the rows.
            rows = self._nodal(ufl.action(self._hessian(potential * measure, θ), one))
            parts[b] = parts.get(b, 0.0) + rows
        return parts

    def _places(self, condition: Convection | Perfusion) -> list[tuple[int, ufl.Measure]]:
        if isinstance(condition, Convection):
            return list(self._ds(condition.boundary).items())
        return [(self._bodies.of_region[r], self._dx(r)) for r in condition.regions]

    def _hessian(self, potential: Any, θ: fem.Function) -> Any:
        v, w = ufl.TestFunction(self.space), ufl.TrialFunction(self.space)
        return ufl.derivative(ufl.derivative(potential, θ, v), θ, w)

    # One subdomain number for all measures: forms on different subdomains are compiled once.

    def _dx(self, region: str) -> ufl.Measure:
        return ufl.Measure("dx", domain=self._mesh, subdomain_data=[(1, self.cells(region))])(1)

    def _ds(self, boundary: str) -> dict[int, ufl.Measure]:
        topology, exterior = self._mesh.topology, IntegralType.exterior_facet
        return {
            b: ufl.Measure(
                "ds",
                domain=self._mesh,
                subdomain_data=[(1, compute_integration_domains(exterior, topology, facets, 2))],
            )(1)
            for b, facets in self.facets(boundary).items()
        }

    def _constant(self, value: Any) -> fem.Constant:
        return fem.Constant(self._mesh, np.asarray(value, dtype=default_scalar_type))

    def compiling(self) -> AbstractContextManager[None]:
        """Count the time of a block as compilation."""
        return self._timing.phase("compile", "heat")

    def _form(self, form: Any) -> fem.Form:
        with self.compiling():
            return fem.form(form)

    def _nodal(self, form: Any) -> Floats:
        vector = assemble_vector(self._form(form))
        vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        values: Floats = vector.array[: self.owned].copy()
        return values


def _with_diagonal(A: PETSc.Mat) -> PETSc.Mat:
    start, end = A.getOwnershipRange()
    n = end - start
    zero = from_rows(
        A.comm.tompi4py(), (n, n), np.arange(n + 1), np.arange(start, end), np.zeros(n)
    )
    return matrix_sum((zero, A))
