r"""Regions that set: their stress is history, not a function of strain.

While cement cures its stiffness grows from nearly nothing, so that strains of the liquid leave no
stress. The law is a rate,

.. math:: \dot σ = g(α)\, C : (\dot ε - \dot e^* I),

with α the degree of cure, g the modulus over the final one and e* the free strain (expansion and
shrinkage) since gelation. Over a step g is the mean of its values at both ends, second order in
the step. For the step's equilibrium the region is a body of stiffness g C under the forces

.. math:: -\int σ : ε(v) + \int g\, C : (ε(u) + Δe^* I) : ε(v)

with σ, u of the last converged state. Degrees, moduli and free strains live at the vertices; stress
at quadrature points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem

from app.arrays import Floats, Ints
from app.errors import InputError
from app.laws.cure import Cure
from app.laws.materials import Elastic
from app.mechanics.body_forms import BodyForms, assembled_vector
from app.numerics.pointwise import Pointwise
from app.numerics.saved_state import LEFT_OUT
from app.scene.bodies import Bodies
from app.scene.scene import Scene
from app.system.timing import Timing
from forms import cure, elasticity, loads

# Rows and columns of the components of elasticity.symmetric.
ROWS, COLUMNS = np.array([0, 1, 2, 1, 0, 0]), np.array([0, 1, 2, 2, 2, 1])
# A modulus that changes by less than this part of the final one counts as unchanged.
SAME = 1e-12


class CuringStress:
    """Stress history of all curing regions; made collectively.

    Attributes:
        bodies: Bodies that hold such regions.
        points: Quadrature points in the reference cell (p, 3).
        weights: Their weights (p,).

    Raises:
        InputError: A curing region has eigenstrains, which have no rate.
    """

    saved = ("_stress",)

    def __init__(self, scene: Scene, mechanics: BodyForms, bodies: Bodies, timing: Timing) -> None:
        self._mechanics = mechanics
        regions = [c.region for c in scene.cures]
        self._body = {r: bodies.of_region[r] for r in regions}
        self.bodies = sorted(set(self._body.values()))
        self._elastic = {e.region: e for e in scene.elastic if e.region in regions}
        for e in self._elastic.values():
            if e.eigenstrains:
                raise InputError(
                    f"regions.{e.region}.eigenstrains: none in a region that sets; allowed: "
                    "shrinkage and thermal expansion"
                )
        quadrature = basix.make_quadrature(basix.CellType.tetrahedron, mechanics.varying_degree)
        points, weights = (np.asarray(a, dtype=np.float64) for a in quadrature)
        self.points, self.weights = points, weights
        element = basix.ufl.quadrature_element(
            "tetrahedron", value_shape=(6,), degree=mechanics.varying_degree
        )
        self._stress = fem.Function(fem.functionspace(mechanics.mesh, element))
        self._before = {b: fem.Function(mechanics.space) for b in self.bodies}
        self._step = {b: fem.Function(mechanics.space) for b in self.bodies}
        self._rise = {r: fem.Function(mechanics.scalars) for r in regions}
        # Growth and free strain of the last converged state, and those to come.
        nodes = len(self._rise[regions[0]].x.array)
        with timing.phase("compile", "cure"):
            self._growth = {c.region: _growth(mechanics.mesh.comm, c, nodes) for c in scene.cures}
        self._old = {
            c.region: (self._growth[c.region](a=np.full(nodes, c.initial))[0], np.zeros(nodes))
            for c in scene.cures
        }
        self._new = dict(self._old)
        self.stiffen()
        self._cells = {r: mechanics.region_cells(r) for r in regions}
        v = ufl.TestFunction(mechanics.space)
        self._measure = mechanics.cells()
        self._forces = {b: mechanics.form(self._prestress(b, v)) for b in self.bodies}
        with timing.phase("compile", "stress of cure"):
            self._increments = {
                r: fem.Expression(
                    self._stress_of(e, elasticity.strain(self._step[self._body[r]]), -1),
                    points,
                    comm=mechanics.mesh.comm,
                )
                for r, e in self._elastic.items()
            }

    def _stress_of(self, e: Elastic, ε: Any, sign: int) -> Any:
        """Stress of a strain, with the step's free strain added or subtracted."""
        g = self._mechanics.growth[e.region]
        ε = ε + sign * elasticity.swelling(self._rise[e.region])
        return g * elasticity.stress(lambda x: self._mechanics.energy_density(e, x), ε)

    def _regions(self, body: int) -> list[tuple[Elastic, Any]]:
        degree = self._mechanics.varying_degree
        return [
            (e, self._measure(self._mechanics.tagged.regions[r], degree=degree))
            for r, e in self._elastic.items()
            if self._body[r] == body
        ]

    def internal_work(self, body: int, v: Any) -> Any:
        """Work of the stress of a body in a displacement v [N mm]."""
        σ = elasticity.symmetric(list(self._stress))
        return sum(
            loads.mechanical_work(σ, elasticity.strain(v)) * dx for _, dx in self._regions(body)
        )

    def complementary_energy(self) -> Any:
        """Energy that the stress would have in elastic regions of the current moduli [N mm]."""
        mechanics, σ = self._mechanics, elasticity.symmetric(list(self._stress))
        return sum(
            ufl.inner(σ, σ)
            / (2 * mechanics.growth[e.region] * mechanics.constant(max(e.moduli)))
            * dx
            for b in self.bodies
            for e, dx in self._regions(b)
        )

    def _prestress(self, body: int, v: Any) -> Any:
        ε = elasticity.strain(self._before[body])
        held = sum(
            loads.mechanical_work(self._stress_of(e, ε, 1), elasticity.strain(v)) * dx
            for e, dx in self._regions(body)
        )
        return held - self.internal_work(body, v)

    def set(self, degrees: Mapping[str, fem.Function], strains: Mapping[str, fem.Function]) -> None:
        """Set degrees of cure and free strains at the end of the step, for the next `stiffen`.

        Args:
            degrees: Degree of cure at the vertices of each curing region [-].
            strains: Its free strain accumulated since gelation at the vertices [-].
        """
        self._new = {
            r: (growth(a=degrees[r].x.array)[0], strains[r].x.array.copy())
            for r, growth in self._growth.items()
        }

    def stiffen(self) -> bool:
        """Set the step's mean modulus and free strain; whether a modulus changed; collective."""
        change = 0.0
        for r, function in self._mechanics.growth.items():
            (g0, e0), (g1, e1) = self._old[r], self._new[r]
            mean = (g0 + g1) / 2
            change = max(change, float(np.abs(mean - function.x.array).max(initial=0.0)))
            function.x.array[:] = mean
            self._rise[r].x.array[:] = e1 - e0
        return bool(self._mechanics.mesh.comm.allreduce(change, MPI.MAX) > SAME)

    def forces(self) -> dict[int, PETSc.Vec]:
        """Nodal forces of the prestress on each body at the start of the step [N]; collective."""
        return {body: assembled_vector(form) for body, form in self._forces.items()}

    def stress(self, region: str) -> Floats:
        """Stress at the quadrature points of a region's own cells (cells, points, 3, 3) [MPa]."""
        dofs = self._stress.function_space.dofmap.list[self._cells[region]]
        σ = np.zeros((*dofs.shape, 3, 3))
        σ[..., ROWS, COLUMNS] = σ[..., COLUMNS, ROWS] = self._stress.x.array.reshape(-1, 6)[dofs]
        return σ

    @property
    def row_keys(self) -> Ints:
        """Keys of the quadrature points of own curing cells."""
        dofs = self._stress.function_space.dofmap.list
        number = self._mechanics.mesh.topology.original_cell_index
        keys = np.full(len(self._stress.x.array) // 6, LEFT_OUT, dtype=np.int64)
        for cells in self._cells.values():
            keys[dofs[cells]] = number[cells, None] * dofs.shape[1] + np.arange(dofs.shape[1])
        return keys

    def begin_at(self, displacements: Sequence[fem.Function]) -> None:
        """Continue from restored stresses, at displacements of the bodies and given cure."""
        for b in self.bodies:
            self._before[b].x.array[:] = displacements[b].x.array
        self._old = dict(self._new)

    def commit(self, displacements: Sequence[fem.Function]) -> None:
        """Commit stress and strain of a converged state.

        Args:
            displacements: Of each body, ghosts included.
        """
        for b in self.bodies:
            self._step[b].x.array[:] = displacements[b].x.array - self._before[b].x.array
            self._before[b].x.array[:] = displacements[b].x.array
        for region, expression in self._increments.items():
            cells = self._cells[region]
            if len(cells):
                values = expression.eval(self._mechanics.mesh, cells)
                values = values.reshape(len(cells), len(self.weights), 3, 3)
                dofs = self._stress.function_space.dofmap.list[cells]
                self._stress.x.array.reshape(-1, 6)[dofs] += values[..., ROWS, COLUMNS]
        self._old = dict(self._new)


def _growth(comm: MPI.Comm, terms: Cure, nodes: int) -> Pointwise:
    """Compiled modulus over the final one by degree of cure, at every vertex of this rank."""
    constants: dict[str, Any] = {"gel": terms.gel, "floor": terms.floor, "exponent": terms.exponent}
    law = Pointwise(
        comm,
        nodes,
        dict.fromkeys(("a", *constants), 1),
        lambda x: [cure.modulus_factor(*(x[k] for k in ("a", *constants)))],
    )
    law.set(**constants)
    return law
