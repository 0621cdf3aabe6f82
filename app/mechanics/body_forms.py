"""The forms of a scene on its mesh: energies of bodies, work of loads, assembled pieces.

All forms are linear in the displacement:

- the stiffness of all bodies with a continuous displacement u,
- the stiffness of the cells that touch the jumps of one body (the strip),
- one vector per load.

`mechanics.problem` combines them with the contact law.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cached_property
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import default_scalar_type, fem, jit, la
from dolfinx.fem import IntegralType
from dolfinx.fem.forms import CompiledForm
from dolfinx.fem.petsc import assemble_matrix, assemble_vector
from numpy.typing import ArrayLike, NDArray
from ufl.algorithms import expand_derivatives
from ufl.core.expr import Expr

from app.foundation.arrays import Field, Floats, Ints
from app.foundation.collective import everywhere
from app.foundation.dolfinx_features import exterior_facet_entities
from app.foundation.errors import InputError
from app.laws.densities import density, modulus_of_density
from app.laws.loads import Patch
from app.laws.materials import Elastic
from app.numerics.lifetime import function_space
from app.scene.bodies import Bodies, boundary_facets, cell_tags, facet_coordinates, facets_by_body
from app.scene.scene import Scene
from app.system.timing import Timing
from forms import elasticity
from meshes.distribute import TaggedMesh
from meshes.facets import facet_shape_functions, normals_and_areas

# Cells, or facets as pairs of a cell and a local number, by number of the subdomain.
Domains = list[tuple[int, NDArray[np.int32]]]

# Degree of quadrature of moments on curved facets; the second is exact on flat ones.
MOMENT_DEGREE = 8
# The same of moduli from images, whose 14 weights are positive; of degree 3 one is negative.
IMAGE_DEGREE = 4
# The compiler may reorder sums and so use vector instructions: 1.06 instead of 1.55 s for the
# stiffness of 35,000 cells of second order.
REORDERED_SUMS = ("-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math")


class SurfaceMeasure:
    """Measures of boundaries by body; collective.

    Attributes:
        facets: Number of each subdomain, with its rank-local facets as cells and local numbers.
    """

    def __init__(self, tagged: TaggedMesh, bodies: Bodies, boundaries: Collection[str]) -> None:
        self.facets: Domains = []
        self._number: dict[tuple[str, int], int] = {}
        for name in sorted(boundaries):
            for b, facets in facets_by_body(tagged, bodies, name).items():
                self._number[name, b] = len(self.facets) + 1
                entities = exterior_facet_entities(tagged.mesh.topology, facets)
                self.facets.append((len(self.facets) + 1, entities))
        self._measure = ufl.Measure("ds", domain=tagged.mesh, subdomain_data=self.facets)

    def has(self, boundaries: Collection[str]) -> bool:
        """Return True if there are boundaries and all of them are measured."""
        return bool(boundaries) and {b for b, _ in self._number}.issuperset(boundaries)

    def on(self, boundary: str, body: int) -> ufl.Measure | None:
        """Return the measure of the facets of a boundary that belong to a body, None if none do."""
        number = self._number.get((boundary, body))
        return None if number is None else self._measure(number)

    def facets_on(self, body: int) -> Domains:
        """Return all subdomains; subdomains of other bodies have no facets."""
        of_body = {number for (_, b), number in self._number.items() if b == body}
        return [(k, f if k in of_body else f[:0]) for k, f in self.facets]


class OnBody:
    """One body of the mechanics as loads see it: position x and outward normal n, in UFL."""

    def __init__(self, body_forms: BodyForms, body: int) -> None:
        self._body_forms, self._body = body_forms, body
        self.x = ufl.SpatialCoordinate(body_forms.mesh)
        self.n = ufl.FacetNormal(body_forms.mesh)
        self.constant, self.patch = body_forms.constant, body_forms.patch

    def ds(self, boundary: str) -> ufl.Measure | None:
        """Measure of the facets of a boundary that belong to the body, if any."""
        return self._body_forms.ds(boundary, self._body)

    def spread(
        self, density: Field, regions: Sequence[str] | None
    ) -> list[tuple[Expr, ufl.Measure]]:
        """Field (3,) and measure of each of the body's regions, all by default.

        The field is a function of points, not a UFL expression: densities share one compiled form.
        The quadrature is exact for constants on curved cells, and keeps the third order of
        quadratic displacements where the density varies.
        """
        body_forms = self._body_forms
        if regions is None:
            regions = [e.region for e in body_forms.scene.elastic]
        of_body = [r for r in regions if body_forms.bodies.body_of_region[r] == self._body]
        if not of_body:
            return []
        degree = 2 * body_forms.scene.order + 2
        element = basix.ufl.quadrature_element("tetrahedron", value_shape=(3,), degree=degree)
        b = fem.Function(fem.functionspace(body_forms.mesh, element))
        cells = np.sort(np.concatenate([body_forms.region_cells(r) for r in of_body]))
        everywhere(
            body_forms.mesh.comm, lambda: b.interpolate(lambda x: density(x.T).T, cells0=cells)
        )
        dx = body_forms.cells()
        return [(b, dx(body_forms.tagged.regions[r], degree=degree)) for r in of_body]


class BodyForms:
    """Energies and loads of a scene in UFL, and their assembled vectors and matrices.

    Attributes:
        bodies: Regions by body.
        timing: Where the time that compiling takes is noted.
        varying_degree: Degree of quadrature where stress is path-dependent, fibres are curved or
            the modulus varies: a constant stiffness needs one less.
        space: Displacement space.
        u: The continuous displacement.
        springs: Stiffness of each elastic foundation.
        free_strain: Thermal strain of each expanding elastic region, at the vertices [-].
        modulus_ratio: Modulus of each curing region over its final one, at the vertices [-].
        density_regions: Regions whose stiffness follows a density that changes.
        density, density_at_start: That density at all vertices of this rank, ghosts too
            (n, r) [g/cm3].
        path_dependent_regions: Regions that cure or creep: their stress depends on the path of
            strain.
        path_dependent_degree: Degree of their quadrature. Creep needs positive weights and no more
            points than stresses that a cell can have: more would lock, as its volume stays the
            same.

    Raises:
        InputError: A load acts on nothing.
    """

    saved = ("modulus_ratio", "density")

    def __init__(self, scene: Scene, tagged: TaggedMesh, bodies: Bodies, timing: Timing) -> None:
        self.scene, self.tagged, self.bodies = scene, tagged, bodies
        self.timing = timing
        self.varying_degree = 2 * scene.order - 1
        self.path_dependent_degree = (
            max(1, 2 * scene.order - 2) if scene.creeps else self.varying_degree
        )
        self.mesh = tagged.mesh
        self.space = function_space(self.mesh, ("Lagrange", scene.order, (3,)))
        self.u = fem.Function(self.space, name="displacement")
        self._tags = cell_tags(tagged)
        self._surface = SurfaceMeasure(tagged, bodies, scene.loaded_boundaries)
        self._constants = {e.region: self._region_constants(e) for e in scene.elastic}
        changing = [e for e in scene.elastic if e.changing_density]
        self.density_regions = tuple(e.region for e in changing)
        # None without such regions.
        self.density_at_start: Any = None
        self.density: Any = None
        if changing:
            self.density_at_start = np.array([self._density(e) for e in changing]).T
            self.density = self.density_at_start.copy()
        self._relative_stiffness_fields = {
            e.region: self._relative_stiffness(e) for e in scene.elastic if e.varies
        }
        self.springs = [self.constant(f.stiffness) for f in scene.foundations]
        self._eigenstrain_amplitudes = {
            (e.region, k): self.constant(0.0)
            for e in scene.elastic
            for k in range(len(e.eigenstrains))
        }
        self.modulus_ratio = {c.region: fem.Function(self.scalars) for c in scene.cures}
        self.path_dependent_regions = {c.region for c in (*scene.cures, *scene.creeps)}
        self.free_strain = {
            x.region: fem.Function(self.scalars)
            for x in scene.expansions
            if x.region not in self.modulus_ratio
        }

    @cached_property
    def scalars(self) -> fem.FunctionSpace:
        """Space of vertex data: temperatures, degrees of cure."""
        return function_space(self.mesh, ("Lagrange", 1))

    # Measures

    def cells(self) -> ufl.Measure:
        """Volume measure by region tag, over all owned cells."""
        return ufl.Measure("dx", domain=self.mesh, subdomain_data=self._domains())

    def _domains(self, is_picked: NDArray[np.bool_] | None = None) -> Domains:
        """Owned cells of each region tag, all or those picked."""
        owned = self.mesh.topology.index_map(3).size_local
        mask = np.ones(owned, dtype=bool) if is_picked is None else is_picked[:owned]
        return [
            (tag, np.flatnonzero(mask & (self._tags[:owned] == tag)).astype(np.int32))
            for tag in sorted(self.tagged.regions.values())
        ]

    def region_cells(self, region: str) -> NDArray[np.int32]:
        """Cells of a region that this rank owns."""
        owned = self.mesh.topology.index_map(3).size_local
        return np.flatnonzero(self._tags[:owned] == self.tagged.regions[region]).astype(np.int32)

    def ds(self, boundary: str, body: int) -> ufl.Measure | None:
        """Measure of the facets of a boundary that belong to a body, if any."""
        return self._surface.on(boundary, body)

    def constant(self, value: ArrayLike) -> fem.Constant:
        """A constant, in UFL."""
        return fem.Constant(self.mesh, np.asarray(value, dtype=default_scalar_type))

    def _region_constants(self, e: Elastic) -> tuple[Sequence[fem.Constant], Expr | None]:
        coefficients = [self.constant(c) for c in e.coefficients]
        return coefficients, e.fibre.direction(self.mesh, self.constant) if e.fibre else None

    def points_and_volumes(
        self, region: str, points: Floats, weights: Floats
    ) -> tuple[Floats, Floats]:
        """Positions (cells, points, 3) [mm] and volumes of points of a region's owned cells."""
        element = self.mesh.ufl_domain().ufl_coordinate_element().sub_elements[0]
        N, *dN = element.tabulate(1, points)
        x = self.mesh.geometry.x[self.mesh.geometry.dofmap[self.region_cells(region)]]
        # Products by BLAS.
        tangents = np.einsum("cni,jqn->cqij", x, np.array(dN), optimize=True)
        measure = np.abs(np.linalg.det(tangents)) / 6
        places = np.einsum("qn,cni->cqi", N, x, optimize=True)
        return places, np.asarray(measure * weights / weights.sum())

    def relative_stiffness(self, e: Elastic, points: Floats) -> Floats:
        """Stiffness over its largest at points of owned cells of a region (c, p); collective.

        At the first order, where strains are constant in a cell, its mean over the cell (cells, 1).
        """
        mean = self.scene.order == 1 or (e.modulus_field and e.modulus_field.per_cell)
        rule = basix.make_quadrature(basix.CellType.tetrahedron, IMAGE_DEGREE)
        points_of_rule, weights = (
            (np.asarray(a) for a in rule) if mean else (points, np.ones(len(points)))
        )
        x, volumes = self.points_and_volumes(e.region, points_of_rule, weights)
        changing_density = e.changing_density
        if changing_density:
            values = (
                modulus_of_density(
                    changing_density.law, self.density_at(e.region, points_of_rule, self.density)
                )
                / e.moduli[0]
            )
        else:
            values = everywhere(self.mesh.comm, lambda: e.relative_stiffness(x.reshape(-1, 3)))
        values = values.reshape(volumes.shape)
        if mean:
            values = np.average(values, axis=1, weights=volumes, keepdims=True)
        return np.asarray(values, dtype=np.float64)

    def _density(self, e: Elastic) -> Floats:
        """Density of a region's modulus in the case at all vertices, within its bounds (n,)."""
        changing = e.changing_density
        assert changing is not None
        x = self.scalars.tabulate_dof_coordinates()
        E = e.moduli[0] * everywhere(self.mesh.comm, lambda: e.relative_stiffness(x))
        return np.asarray(np.clip(density(changing.law, E), *changing.bounds))

    def vertices(self, region: str) -> NDArray[np.int32]:
        """Vertices of a region's owned cells (cells, 4), as numbered in `scalars`."""
        return self.scalars.dofmap.list[self.region_cells(region)]

    def vertex_sums(self, vertices: NDArray[np.int32], values: Floats | float) -> Floats:
        """Sum vertex values over all ranks; return local ones with ghosts (n,); collective."""
        total = la.vector(self.scalars.dofmap.index_map)
        np.add.at(total.array, vertices, values)
        total.scatter_reverse(la.InsertMode.add)
        total.scatter_forward()
        return np.array(total.array)

    def density_at(self, region: str, points: Floats, density: Floats) -> Floats:
        """A density at the vertices (n, r) at points of a region's owned cells (cells, points)."""
        nodal = density[:, self.density_regions.index(region)]
        return np.asarray(nodal[self.vertices(region)] @ linear_shape_functions(points).T)

    def follow_density(self) -> None:
        """Update the moduli that follow densities; collective."""
        for e in self.scene.elastic:
            if e.changing_density:
                self._relative_stiffness(e, self._relative_stiffness_fields[e.region])

    def _relative_stiffness(self, e: Elastic, g: fem.Function | None = None) -> fem.Function:
        """Stiffness over its largest at the points of the quadrature."""
        element = basix.ufl.quadrature_element("tetrahedron", degree=self._quadrature_degree(e))
        g = g or fem.Function(fem.functionspace(self.mesh, element))
        points, _ = basix.make_quadrature(basix.CellType.tetrahedron, self._quadrature_degree(e))
        rows = g.function_space.dofmap.list[self.region_cells(e.region)]
        g.x.array[rows] = self.relative_stiffness(e, np.asarray(points))
        return g

    # Energies

    def energy_density(self, e: Elastic, ε: Expr) -> Expr:
        """Strain energy density of a region for an elastic strain [MPa]."""
        return self._relative_stiffness_fields.get(e.region, 1) * e.energy(
            ε, *self._constants[e.region]
        )

    def over(self, e: Elastic, dx: ufl.Measure, tag: int | None = None) -> ufl.Measure:
        """Integration measure of a region, by its tag or another one.

        Curved fibres and varying moduli have a fixed quadrature degree, because UFL estimates more
        than 20 for curved fibres, with the same errors.
        """
        measure = dx(self.tagged.regions[e.region] if tag is None else tag)
        varies = e.varies or (e.fibre and e.fibre.curved)
        return measure(degree=self._quadrature_degree(e)) if varies else measure

    def _quadrature_degree(self, e: Elastic) -> int:
        by_density = e.modulus_field or e.changing_density
        return IMAGE_DEGREE if by_density and self.scene.order > 1 else self.varying_degree

    def elastic_strain(self, e: Elastic, v: Expr) -> Expr:
        """Strain of a displacement minus the region's eigenstrains and thermal strain."""
        ε = elasticity.strain(v)
        for k, s in enumerate(e.eigenstrains):
            ε = ε - self._eigenstrain_amplitudes[e.region, k] * elasticity.symmetric(s.strain)
        if e.region in self.free_strain:
            ε = ε - elasticity.isotropic_strain(self.free_strain[e.region])
        return ε

    def body_energy(self, body: int, v: Expr, dx: ufl.Measure) -> ufl.Form:
        """Energy of a body (strain, foundations) in its displacement v [N mm].

        Path-dependent regions are left out.
        """
        total = 0
        for e in self.scene.elastic:
            if (
                self.bodies.body_of_region[e.region] == body
                and e.region not in self.path_dependent_regions
            ):
                total += self.energy_density(e, self.elastic_strain(e, v)) * self.over(e, dx)
        for f, k in zip(self.scene.foundations, self.springs, strict=True):
            ds = self.ds(f.boundary, body)
            if ds is not None:
                total += f.energy(v, k) * ds
        return total

    def tangent_energy(self, body: int, v: Expr, dx: ufl.Measure) -> ufl.Form:
        """Energy of a body whose second derivative is its stiffness at the current cure."""
        total = self.body_energy(body, v, dx)
        for e in self.scene.elastic:
            if (
                self.bodies.body_of_region[e.region] == body
                and e.region in self.path_dependent_regions
            ):
                ψ = self.energy_density(e, elasticity.strain(v))
                dx_e = dx(self.tagged.regions[e.region], degree=self.path_dependent_degree)
                total += self.modulus_ratio.get(e.region, 1) * ψ * dx_e
        return total

    def set_amplitudes(self, value: dict[tuple[str, int], float]) -> None:
        """Set the amplitudes of the eigenstrains by (region, number); the others are zero."""
        for key, constant in self._eigenstrain_amplitudes.items():
            constant.value = value.get(key, 0.0)

    # Loads

    def patch(self, boundary: str) -> Patch:
        """Area, centroid and second moments of a boundary, as meshed; collective.

        Raises:
            InputError: The boundary has no facets.
        """
        x, _ = facet_coordinates(self.tagged, boundary_facets(self.tagged, boundary))
        rule = basix.make_quadrature(basix.CellType.triangle, MOMENT_DEGREE)
        points, weights = (np.asarray(a) for a in rule)
        L = linear_shape_functions(points)
        _, size = normals_and_areas(x, L)
        positions = np.einsum("qn,fni->fqi", facet_shape_functions(L, x.shape[1]), x)

        def integral(values: Floats) -> Floats:
            local = np.einsum("q,fq,fq...->...", weights, size, values)
            return np.asarray(self.mesh.comm.allreduce(local, MPI.SUM))

        area = float(integral(np.ones(size.shape)))
        if area <= 0:
            raise InputError(f"boundary '{boundary}' has no facets on this mesh")
        centroid = np.asarray(integral(positions) / area, dtype=np.float64)
        arm = positions - centroid
        second = integral(np.einsum("fqi,fqj->fqij", arm, arm))
        return Patch(area, centroid, np.trace(second) * np.eye(3) - second)

    # Assembly

    @cached_property
    def _stiffness(self) -> CompiledForm:
        """Second derivative of the energies of all bodies moving with u, on any of their cells."""
        dx, v, w = self.cells(), ufl.TestFunction(self.space), ufl.TrialFunction(self.space)
        energy = sum(self.tangent_energy(b, self.u, dx) for b in range(len(self.bodies.names)))
        # Expanded, so that terms that drop out do not count among its coefficients.
        form = expand_derivatives(ufl.derivative(ufl.derivative(energy, self.u, v), self.u, w))
        with self.timing.phase("compile", "stiffness"):
            usual = jit.get_options()["cffi_extra_compile_args"]
            options = {"cffi_extra_compile_args": [*usual, *REORDERED_SUMS]}
            return fem.compile_form(self.mesh.comm, form, jit_options=options)

    def stiffness(self) -> fem.Form:
        """Stiffness of all bodies moving with u, supports not yet applied."""
        return self._stiffness_on(self._domains(), self._surface.facets)

    def strip_stiffness(self, body: int, dofs: NDArray[np.bool_]) -> fem.Form:
        """Stiffness of one body restricted to its cells that hold any of the marked dofs."""
        holds_dofs = dofs[self.space.dofmap.list].any(axis=1)
        holds_dofs &= self.bodies.body_of_tag[self._tags] == body
        return self._stiffness_on(self._domains(holds_dofs), self._surface.facets_on(body))

    def _stiffness_on(self, cells: Domains, facets: Domains) -> fem.Form:
        """Stiffness of some cells and of the foundations on some facets (cell, local facet)."""
        form = self._stiffness.ufl_form
        return fem.create_form(
            self._stiffness,
            [self.space, self.space],
            self.mesh,
            {IntegralType.cell: cells, IntegralType.exterior_facet: facets},
            {f: f for f in form.coefficients()},
            {c: c for c in form.constants()},
        )

    def form(self, form: ufl.Form) -> fem.Form:
        """Compile a form, counting the time."""
        with self.timing.phase("compile", "forces"):
            return fem.form(form)


def linear_shape_functions(points: Floats) -> Floats:
    """Linear functions of the vertices at points of the reference simplex (p, vertices)."""
    return np.column_stack([1 - points.sum(axis=1), points])


def shape_functions_in_cells(
    space: fem.FunctionSpace, cells: Ints, reference: Floats
) -> tuple[Floats, Floats]:
    """Shape functions (n, k) and their gradients (n, 3, k) [1/mm] at one point in each cell.

    Args:
        space: Space of the displacement, with k nodes in a cell.
        cells: Cells of the points (n,).
        reference: Coordinates of the points in the reference cell (n, 3).
    """
    of_x, of_u = (
        # Basix tabulates at one point at least, and a rank may have none.
        element.sub_elements[0].tabulate(1, np.vstack([reference, np.zeros(3)]))[:, :-1]
        for element in (space.mesh.ufl_domain().ufl_coordinate_element(), space.ufl_element())
    )
    geometry = space.mesh.geometry
    x = geometry.x[geometry.dofmap[cells]].astype(np.float64)
    jacobian = np.einsum("jnk,nki->nji", of_x[1:], x)
    return of_u[0], np.linalg.solve(jacobian, of_u[1:].transpose(1, 0, 2))


def assemble_form_vector(form: fem.Form) -> PETSc.Vec:
    """Assemble a compiled linear form; collective."""
    vector = assemble_vector(form)
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    return vector


def assemble_form_matrix(form: fem.Form) -> PETSc.Mat:
    """Assemble a compiled bilinear form; collective."""
    matrix = assemble_matrix(form)
    matrix.assemble()
    return matrix
