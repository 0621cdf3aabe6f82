r"""Stress history of path-dependent regions: those that cure, creep, or both.

While cement cures its stiffness grows from nearly nothing, so that strains of the liquid leave no
stress. Set cement creeps. The law is a rate,

.. math:: \dot σ = g(α)\, C : (\dot ε - \dot e^* I - \dot e_c),

with α the degree of cure and g the modulus over the final one. e* is the free strain (expansion and
shrinkage) since gelation, e_c the creep strain of `mechanics.creep`. Over a step g is the mean of
its values at both ends, second order in the step. For the step's equilibrium the region is a body
of stiffness g C under the forces

.. math:: -\int (σ - R) : ε(v) + \int g\, C : (ε(u) + Δe^* I) : ε(v)

with σ, u of the last converged state and R = g C : Δe_c the stress that creep takes in the step.
Degrees, moduli and free strains live at the vertices; stress at quadrature points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from mpi4py import MPI
from petsc4py import PETSc

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from app.foundation.arrays import Floats, Ints
from app.foundation.errors import InputError
from app.laws.cure import Cure
from app.laws.materials import Elastic
from app.mechanics.body_forms import BodyForms, assemble_form_vector
from app.mechanics.creep import CreepState, CreepValues
from app.numerics.pointwise import Pointwise
from app.numerics.saved_state import NOT_SAVED
from forms import cure, elasticity, loads

# Rows of the components of elasticity.symmetric.
ROWS = np.array([0, 1, 2, 1, 0, 0])
# Their columns.
COLUMNS = np.array([0, 1, 2, 2, 2, 1])
# A modulus that changes by less than this fraction of the final one counts as unchanged.
MODULUS_TOLERANCE = 1e-12


class StressHistory:
    """Stress history of all regions that set or creep; made collectively.

    Attributes:
        bodies: Bodies that hold such regions.
        points: Quadrature points in the reference cell (p, 3).
        weights: Their weights (p,).
        creep: State of the regions that creep, if any.
        stress_at_points: Stress of the last converged state at the points [MPa].

    Raises:
        InputError: Such a region has eigenstrains, which have no rate.
    """

    saved = ("stress_at_points", "creep")

    def __init__(self, body_forms: BodyForms) -> None:
        self._body_forms, scene = body_forms, body_forms.scene
        regions = sorted(body_forms.path_dependent_regions)
        self._body_of_region = {r: body_forms.bodies.body_of_region[r] for r in regions}
        self.bodies = sorted(set(self._body_of_region.values()))
        self._elastic = {e.region: e for e in scene.elastic if e.region in regions}
        for e in self._elastic.values():
            if e.eigenstrains:
                raise InputError(
                    f"regions.{e.region}.eigenstrains: a region that cures or creeps cannot have "
                    "them; use shrinkage or thermal expansion"
                )
        degree = body_forms.path_dependent_degree
        quadrature = basix.make_quadrature(basix.CellType.tetrahedron, degree)
        points, weights = (np.asarray(a, dtype=np.float64) for a in quadrature)
        self.points, self.weights = points, weights
        element = basix.ufl.quadrature_element("tetrahedron", value_shape=(6,), degree=degree)
        space = fem.functionspace(body_forms.mesh, element)
        self.stress_at_points = fem.Function(space)
        # The stress that the step begins with: less, by what creep takes in it.
        self._initial_stress = fem.Function(space) if scene.creeps else self.stress_at_points
        self._committed_displacements = {b: fem.Function(body_forms.space) for b in self.bodies}
        self._displacement_steps = {b: fem.Function(body_forms.space) for b in self.bodies}
        with_free_strain = {*body_forms.modulus_ratio, *body_forms.free_strain}
        self._free_strain_step = {
            r: fem.Function(body_forms.scalars) for r in regions if r in with_free_strain
        }
        self._set_up_cure()
        self._cells = {r: body_forms.region_cells(r) for r in regions}
        rows = {r: space.dofmap.list[cells] for r, cells in self._cells.items()}
        self.creep = CreepState(body_forms, rows, points, weights) if scene.creeps else None
        if self.creep:
            self.creep.row_keys = self.row_keys[self.creep.rows]
        v = ufl.TestFunction(body_forms.space)
        self._measure = body_forms.cells()
        self._forces = {b: body_forms.form(self._prestress(b, v)) for b in self.bodies}
        with body_forms.timing.phase("compile", "stress of cure"):
            self._increments = {r: self._increment_of(e) for r, e in self._elastic.items()}
        self._state_at_rest = self.state()

    def _set_up_cure(self) -> None:
        """Set the moduli over the final ones and the free strain of the uncured state; collective.

        Both are at the vertices [-]: of the last converged state, and at the end of the step.
        """
        body_forms, cures = self._body_forms, self._body_forms.scene.cures
        functions = list(self._free_strain_step.values())
        nodes = len(functions[0].x.array) if functions else 0
        with body_forms.timing.phase("compile", "cure"):
            self._modulus_laws = {
                c.region: _modulus_law(body_forms.mesh.comm, c, nodes) for c in cures
            }
        self._committed_cure: dict[str, tuple[Floats, Floats]] = {
            r: (np.ones(nodes), np.zeros(nodes)) for r in self._free_strain_step
        }
        for c in cures:
            modulus_ratio = self._modulus_laws[c.region](a=np.full(nodes, c.initial))[0]
            self._committed_cure[c.region] = modulus_ratio, np.zeros(nodes)
        self._next_cure = dict(self._committed_cure)
        self.update_moduli()

    def _increment_of(self, e: Elastic) -> fem.Expression:
        """Compile the stress that a step adds in a region, at the quadrature points [MPa]."""
        u = self._displacement_steps[self._body_of_region[e.region]]
        stress = self._stress_of(e, elasticity.strain(u), -1)
        return fem.Expression(stress, self.points, comm=self._body_forms.mesh.comm)

    def _stress_of(self, e: Elastic, ε: Expr, sign: int) -> Expr:
        """Stress of a strain, with the step's free strain added or subtracted."""
        if e.region in self._free_strain_step:
            ε = ε + sign * elasticity.isotropic_strain(self._free_strain_step[e.region])
        return self._body_forms.modulus_ratio.get(e.region, 1) * elasticity.stress(
            lambda x: self._body_forms.energy_density(e, x), ε
        )

    def _regions_of_body(self, body: int) -> list[tuple[Elastic, ufl.Measure]]:
        degree = self._body_forms.path_dependent_degree
        return [
            (e, self._measure(self._body_forms.tagged.regions[r], degree=degree))
            for r, e in self._elastic.items()
            if self._body_of_region[r] == body
        ]

    def internal_work(self, body: int, v: Expr, stress: fem.Function | None = None) -> ufl.Form:
        """Work of the stress of a body, or another stress there, in a displacement v [N mm]."""
        σ = elasticity.symmetric(list(self.stress_at_points if stress is None else stress))
        return sum(
            loads.mechanical_work(σ, elasticity.strain(v)) * dx
            for _, dx in self._regions_of_body(body)
        )

    def complementary_energy(self) -> ufl.Form:
        """Energy that the stress would have in elastic regions of the current moduli [N mm]."""
        body_forms, σ = self._body_forms, elasticity.symmetric(list(self.stress_at_points))
        return sum(
            ufl.inner(σ, σ)
            / (2 * body_forms.modulus_ratio.get(e.region, 1) * body_forms.constant(max(e.moduli)))
            * dx
            for b in self.bodies
            for e, dx in self._regions_of_body(b)
        )

    def _prestress(self, body: int, v: Expr) -> ufl.Form:
        ε = elasticity.strain(self._committed_displacements[body])
        internal_work = sum(
            loads.mechanical_work(self._stress_of(e, ε, 1), elasticity.strain(v)) * dx
            for e, dx in self._regions_of_body(body)
        )
        return internal_work - self.internal_work(body, v, self._initial_stress)

    def set(self, degrees: Mapping[str, fem.Function], strains: Mapping[str, fem.Function]) -> None:
        """Set degrees of cure and free strains at the end of the step, for `update_moduli`.

        Args:
            degrees: Degree of cure at the vertices of each curing region [-].
            strains: Free strain since gelation at the vertices of each curing region [-].
        """
        self._next_cure |= {
            r: (law(a=degrees[r].x.array)[0], strains[r].x.array.copy())
            for r, law in self._modulus_laws.items()
        }

    def set_free_strain(self, strains: Mapping[str, fem.Function]) -> None:
        """Set the free strains of regions that do not set, at the vertices [-]."""
        for r, strain in strains.items():
            if r in self._free_strain_step:
                self._next_cure[r] = self._committed_cure[r][0], strain.x.array.copy()

    def update_moduli(self) -> bool:
        """Set the step's mean modulus and free strain; whether a modulus changed; collective."""
        change = 0.0
        for r, strain in self._free_strain_step.items():
            (g0, e0), (g1, e1) = self._committed_cure[r], self._next_cure[r]
            strain.x.array[:] = e1 - e0
            function = self._body_forms.modulus_ratio.get(r)
            if function is not None:
                mean = (g0 + g1) / 2
                change = max(change, float(np.abs(mean - function.x.array).max(initial=0.0)))
                function.x.array[:] = mean
        return bool(self._body_forms.mesh.comm.allreduce(change, MPI.MAX) > MODULUS_TOLERANCE)

    def forces(self) -> dict[int, PETSc.Vec]:
        """Nodal forces of the prestress on each body at the start of the step [N]; collective."""
        return {body: assemble_form_vector(form) for body, form in self._forces.items()}

    def stress(self, region: str) -> Floats:
        """Stress at the quadrature points of a region's owned cells (cells, points, 3, 3) [MPa]."""
        dofs = self.stress_at_points.function_space.dofmap.list[self._cells[region]]
        σ = np.zeros((*dofs.shape, 3, 3))
        components = self.stress_at_points.x.array.reshape(-1, 6)[dofs]
        σ[..., ROWS, COLUMNS] = σ[..., COLUMNS, ROWS] = components
        return σ

    @property
    def row_keys(self) -> Ints:
        """Keys of the quadrature points of owned cells."""
        dofs = self.stress_at_points.function_space.dofmap.list
        number = self._body_forms.mesh.topology.original_cell_index
        keys = np.full(len(self.stress_at_points.x.array) // 6, NOT_SAVED, dtype=np.int64)
        for cells in self._cells.values():
            keys[dofs[cells]] = number[cells, None] * dofs.shape[1] + np.arange(dofs.shape[1])
        return keys

    def begin_at(self, displacements: Sequence[fem.Function]) -> None:
        """Continue from restored stresses, at displacements of the bodies and given cure."""
        for b in self.bodies:
            self._committed_displacements[b].x.array[:] = displacements[b].x.array
        self._committed_cure = dict(self._next_cure)
        creep = self.creep
        if creep:
            # The next step begins with the restored stress.
            self.relax(np.zeros((len(creep.rows), 6)), 0.0)

    def commit(self, displacements: Sequence[fem.Function]) -> None:
        """Commit stress and strain of a converged state.

        Args:
            displacements: Of each body, ghosts included.
        """
        increment = self._stress_increment(displacements)
        σ = self.stress_at_points.x.array.reshape(-1, 6)
        for b in self.bodies:
            self._committed_displacements[b].x.array[:] = displacements[b].x.array
        creep = self.creep
        if creep:
            stress_before = σ[creep.rows]
            σ[:] = self._initial_stress.x.array.reshape(-1, 6) + increment
            creep.commit(stress_before, σ[creep.rows])
            self.relax(np.zeros_like(stress_before), 0.0)
        else:
            σ += increment
        self._committed_cure = dict(self._next_cure)

    def _stress_increment(self, displacements: Sequence[fem.Function]) -> Floats:
        """Stress that the step adds by strain and free strain at all points (n, 6) [MPa]."""
        for b in self.bodies:
            self._displacement_steps[b].x.array[:] = (
                displacements[b].x.array - self._committed_displacements[b].x.array
            )
        increment = np.zeros((len(self.stress_at_points.x.array) // 6, 6))
        for region, expression in self._increments.items():
            cells = self._cells[region]
            if len(cells):
                values = expression.eval(self._body_forms.mesh, cells)
                values = values.reshape(len(cells), len(self.weights), 3, 3)
                dofs = self.stress_at_points.function_space.dofmap.list[cells]
                increment[dofs] = values[..., ROWS, COLUMNS]
        return increment

    # Creep

    def trial(self, displacements: Sequence[fem.Function]) -> Floats:
        """Stress at the points that creep, as if nothing crept in the step (n, 6) [MPa]."""
        assert self.creep is not None
        σ = self.stress_at_points.x.array.reshape(-1, 6) + self._stress_increment(displacements)
        return np.asarray(σ[self.creep.rows])

    def relax(self, relaxed_stress: Floats, length: float) -> None:
        """Set the stress (n, 6) [MPa] that creep relaxes in a step, and the step's length."""
        assert self.creep is not None
        self.creep.relaxed_stress, self.creep.length = relaxed_stress, length
        self._initial_stress.x.array[:] = self.stress_at_points.x.array
        self._initial_stress.x.array.reshape(-1, 6)[self.creep.rows] -= relaxed_stress

    def begin(self) -> None:
        """Reset to the unloaded state without free strain.

        Moduli stay: a model that cures is not used for another run.
        """
        self._committed_cure = {
            r: (g, np.zeros_like(e)) for r, (g, e) in self._committed_cure.items()
        }
        self._next_cure = dict(self._committed_cure)
        self.return_to(self._state_at_rest)
        creep = self.creep
        if creep:
            self.relax(np.zeros_like(creep.relaxed_stress), 0.0)

    def state(self) -> tuple[list[Floats], CreepValues | None]:
        """The committed state, for `return_to`."""
        functions = self.stress_at_points, *self._committed_displacements.values()
        return [f.x.array.copy() for f in functions], self.creep.state() if self.creep else None

    def return_to(self, state: tuple[list[Floats], CreepValues | None]) -> None:
        """Return to an earlier state, with the same cure."""
        functions = self.stress_at_points, *self._committed_displacements.values()
        for f, values in zip(functions, state[0], strict=True):
            f.x.array[:] = values
        if self.creep and state[1] is not None:
            self.creep.return_to(state[1])


def _modulus_law(comm: MPI.Comm, terms: Cure, nodes: int) -> Pointwise:
    """Compiled modulus over the final one by degree of cure, at every vertex of this rank."""
    constants = {"gel": terms.gel, "floor": terms.floor, "exponent": terms.exponent}
    law = Pointwise(
        comm,
        nodes,
        dict.fromkeys(("a", *constants), 1),
        lambda x: [cure.modulus_factor(*(x[k] for k in ("a", *constants)))],
    )
    law.set(**constants)
    return law
