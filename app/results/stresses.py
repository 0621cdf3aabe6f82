"""Stress of the regions: at quadrature points, its mean in cells, and published numbers."""

from __future__ import annotations

from collections.abc import Collection
from itertools import combinations

import basix
import numpy as np
from dolfinx import fem
from ufl import as_vector
from ufl.core.expr import Expr

from app.case.quantities import TENSION_LEVELS, computed
from app.case.summary import Numbers
from app.foundation.arrays import Field, Floats
from app.laws.materials import Elastic
from app.mechanics.problem import Problem
from app.results.percentiles import percentile
from forms import elasticity

# Components of a symmetric tensor, in the order of `elasticity.symmetric`.
UFL_COMPONENTS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
# Cache of the stiffness of laws: UFL takes 20 ms, and companions and variations share it.
_MODULI: dict[tuple[type[Elastic], str], Floats] = {}
# Degree of a quadrature with positive weights for integrals of powers of stress. (The rule of
# degree 7 has a negative weight.)
FINE_DEGREE = 9


class Stresses:
    """Stress at quadrature points of all elastic regions, with forms that are compiled once.

    Attributes:
        cells: Owned cells of each region.
        points_of_region: Quadrature points of each region in the reference cell (points, 3).
        volume_fractions: Fraction of the volume of a cell at each of these points (points,).

    Args:
        around_z: True if the z axis is the axis of a stem, so that hoop stress is defined.
        depth: Function that returns the distance of points (n, 3) below the neck cut [mm]; the
            stem above it is the neck. None without a neck cut.
        fine: The only regions whose stress is computed, with the quadrature of degree
            `FINE_DEGREE`. Without them all elastic regions have the usual degree.
    """

    def __init__(
        self,
        problem: Problem,
        around_z: bool = False,
        depth: Field | None = None,
        fine: Collection[str] = (),
    ) -> None:
        self._problem, self._around_z, self._depth = problem, around_z, depth
        # Cells are coarse near edges, so percentiles need several points per cell: degree 4 at
        # second order, where the energy needs 2.
        usual_degree = 4 * (problem.scene.order - 1)
        quadrature = basix.make_quadrature(
            basix.CellType.tetrahedron, FINE_DEGREE if fine else usual_degree
        )
        self._default_points, weights = (np.asarray(a) for a in quadrature)
        elastic = [
            elastic_region
            for elastic_region in problem.scene.elastic
            if elastic_region.region in fine or not fine
        ]
        body_forms = problem.body_forms
        self.cells = {
            elastic_region.region: body_forms.region_cells(elastic_region.region)
            for elastic_region in elastic
        }
        self.points_of_region: dict[str, Floats] = dict.fromkeys(self.cells, self._default_points)
        self.volume_fractions: dict[str, Floats] = dict.fromkeys(
            self.cells, weights / weights.sum()
        )
        # Stress of path-dependent regions is known at the points of their stress history.
        self._stress_histories = {
            r: problem.stress_history
            for r in body_forms.path_dependent_regions
            if problem.stress_history
        }
        if not fine:
            for region, stress_history in self._stress_histories.items():
                weights = stress_history.weights
                self.points_of_region[region] = stress_history.points
                self.volume_fractions[region] = weights / weights.sum()
        # Varying stiffness at the points, relative to its largest value.
        self._relative: dict[str, Floats] = {}
        self.follow_density(all_regions=True)
        self._positions: dict[str, tuple[Floats, Floats]] = {}
        # Forms of the elastic strain of regions with free strain. The others share one form.
        self._with_free_strain: dict[str, fem.Expression] = {}
        self._moved = fem.Function(problem.space)
        self._strain = self._expression(elasticity.strain(self._moved))
        for elastic_region in elastic:
            if elastic_region.region not in body_forms.path_dependent_regions and (
                elastic_region.eigenstrains or elastic_region.region in body_forms.free_strain
            ):
                displacement = problem.displacements()[
                    problem.bodies.body_of_region[elastic_region.region]
                ]
                elastic_strain = body_forms.elastic_strain(elastic_region, displacement)
                self._with_free_strain[elastic_region.region] = self._expression(elastic_strain)

    def follow_density(self, all_regions: bool = False) -> None:
        """Update stiffness that follows a density; with ``all_regions`` all varying stiffness."""
        for region, points in self.points_of_region.items():
            elastic_region = self._elastic_region(region)
            if elastic_region.varies and (all_regions or elastic_region.changing_density):
                self._relative[region] = self._problem.body_forms.relative_stiffness(
                    elastic_region, points
                )

    def _expression(self, ε: Expr) -> fem.Expression:
        with self._problem.body_forms.timing.phase("compile", "stress"):
            return fem.Expression(ε, self._default_points, comm=self._problem.comm)

    def _elastic_region(self, region: str) -> Elastic:
        return next(e for e in self._problem.scene.elastic if e.region == region)

    def _elastic_strain(self, region: str) -> Floats:
        """Strain of a region that causes stress, without thermal and other free strain [-]."""
        problem, cells = self._problem, self.cells[region]
        expression = self._with_free_strain.get(region)
        if expression is None:
            displacement = problem.displacements()[problem.bodies.body_of_region[region]]
            expression, self._moved.x.array[:] = self._strain, displacement.x.array
        if not len(cells):
            return np.zeros((0, len(self._default_points), 3, 3))
        return expression.eval(problem.tagged.mesh, cells).reshape(len(cells), -1, 3, 3)

    def evaluate(self, region: str) -> Floats:
        """Return stress at the points of a region's owned cells (cells, points, 3, 3) [MPa]."""
        stress_history = self._stress_histories.get(region)
        if stress_history:
            σ, cell_points = stress_history.stress(region), self.points_of_region[region]
            if cell_points is stress_history.points:
                return σ
            rows = σ.reshape(*σ.shape[:2], 9)
            return extrapolated(rows, stress_history.points, cell_points).reshape(len(σ), -1, 3, 3)
        return self._stress(region, self._elastic_strain(region))

    def _stress(self, region: str, ε: Floats) -> Floats:
        """Return the stress of elastic strain at a region's points (cells, points, 3, 3) [MPa]."""
        elastic_region = self._elastic_region(region)
        rotating_fibre = (
            elastic_region.fibre
            if elastic_region.fibre is not None and elastic_region.fibre.curved is True
            else None
        )
        if rotating_fibre:  # in axes that rotate with the fibre
            Q = rotating_fibre.frames(self.points_and_volumes(region)[0]).reshape(ε.shape)
            ε = Q.swapaxes(2, 3) @ ε @ Q
        σ = (ε.reshape(-1, 9) @ _moduli(elastic_region)).reshape(ε.shape)
        if rotating_fibre:
            σ = Q @ σ @ Q.swapaxes(2, 3)
        return σ * self._relative[region][..., None, None] if region in self._relative else σ

    def varying_moduli(self) -> dict[str, Floats]:
        """Mean Young's modulus of owned cells (cells,) [MPa] of regions where it varies."""
        modulus_of_region = {
            elastic_region.region: elastic_region.moduli[0]
            for elastic_region in self._problem.scene.elastic
        }
        return {
            region: modulus_of_region[region] * (relative * self.volume_fractions[region]).sum(1)
            for region, relative in self._relative.items()
        }

    def mean(self, region: str) -> Floats:
        """Return the mean stress of a region's owned cells (cells, 3, 3) [MPa]."""
        return np.einsum("q,cqij->cij", self.volume_fractions[region], self.evaluate(region))

    def points_and_volumes(self, region: str) -> tuple[Floats, Floats]:
        """Positions (cells * points, 3) [mm] and volumes (cells, points) [mm3] of the points."""
        if region not in self._positions:  # cached, because all states and variations share them
            body_forms = self._problem.body_forms
            x, volumes = body_forms.points_and_volumes(
                region, self.points_of_region[region], self.volume_fractions[region]
            )
            self._positions[region] = x.reshape(-1, 3), volumes
        return self._positions[region]

    def hoop_strain(self, region: str) -> Floats:
        """Return the elastic hoop strain about the z axis (cells, points) [-]."""
        ε, (x, _) = self._elastic_strain(region), self.points_and_volumes(region)
        return _hoop(ε.reshape(-1, 3, 3), x).reshape(ε.shape[:2])

    def compressive_strain(self, region: str) -> Floats:
        """Return the largest elastic compression, positive as a length lost (cells, points) [-]."""
        ε = self._elastic_strain(region)
        return np.asarray(-np.linalg.eigvalsh(ε.reshape(*ε.shape[:2], 3, 3))[..., 0])

    def energy_density(self, region: str) -> Floats:
        r"""Return the elastic energy density :math:`ψ = \tfrac12 σ : ε` (cells, points) [MPa]."""
        ε = self._elastic_strain(region)
        return np.asarray(np.einsum("cqij,cqij->cq", self._stress(region, ε), ε) / 2)

    def numbers_of_region(self, region: str) -> Numbers:
        """Published numbers on stress of a region, of a stem without its neck; collective."""
        σ = self.evaluate(region).reshape(-1, 3, 3)
        x, volumes = self.points_and_volumes(region)
        mean = np.trace(σ, axis1=1, axis2=2) / 3
        mises, principal = mises_and_principal(σ)
        local = np.stack([mises, _hoop(σ, x), *principal[:, [2, 0]].T, mean, volumes.ravel()])
        values = self.gather(local)
        extra_numbers: Numbers = computed("regions", self, region)
        if region == "stem" and self._depth:
            x = self.gather(x.T).T
            is_neck = self._depth(x) < 0
            neck_values, places = values[:, is_neck], x[is_neck]
            extra_numbers["neck"] = self._statistics(neck_values) | {
                f"{key}_max_at": places[neck_values[k].argmax()].tolist()
                for key, k in (("von_mises", 0), ("principal", 2))
            }
            values = values[:, ~is_neck]
        s = self._stress_histories.get(region)
        if s and s.creep:
            extra_numbers |= s.creep.numbers(region)
        if self._elastic_region(region).tissue == "cement":
            _, _, tension, _, _, volume = values
            for level in TENSION_LEVELS:
                extra_numbers[f"volume_over_{level}_MPa"] = float(volume[tension > level].sum())
        return self._statistics(values) | extra_numbers

    def gather(self, rows: Floats) -> Floats:
        """Return values at the points of all ranks (k, n)."""
        return np.concatenate(self._problem.comm.allgather(rows), axis=1)

    def _statistics(self, values: Floats) -> Numbers:
        """Numbers on stresses and volumes at points, which are the rows of ``values`` (6, n)."""
        mises, hoop, principal, smallest_principal, mean, volume = values
        numbers = {
            "von_mises_max": float(mises.max()),
            "von_mises_p99": percentile(mises, volume),
            "principal_max": float(principal.max()),
            "principal_p99": percentile(principal, volume),
            "principal_min": float(smallest_principal.min()),
            "mean_stress_min": float(mean.min()),
            "mean_stress_max": float(mean.max()),
            "volume": float(volume.sum()),
        }
        if self._around_z:
            numbers["hoop_p99"] = percentile(hoop, volume)
        return numbers


def mises_and_principal(σ: Floats) -> tuple[Floats, Floats]:
    """Von Mises stress (n,) and principal stresses (n, 3), rising, of stresses (n, 3, 3)."""
    principal: Floats = np.linalg.eigvalsh(σ).astype(np.float64)
    differences = principal - np.roll(principal, 1, axis=1)
    return np.sqrt((differences**2).sum(axis=1) / 2), principal


def _moduli(e: Elastic) -> Floats:
    """Return the matrix (9, 9) from strain to stress, both as rows of nine components [MPa].

    If the fibre direction varies, the matrix is in axes of which the third is the fibre.
    """
    law = type(e), e.model_dump_json()
    if law not in _MODULI:
        _MODULI[law] = _moduli_by_energy(e)
    return _MODULI[law]


def _moduli_by_energy(e: Elastic) -> Floats:
    fibre = e.fibre.axis if e.fibre and not e.fibre.curved else (0.0, 0.0, 1.0)

    def energy(strain: Floats) -> float:
        ε = elasticity.symmetric([float(c) for c in strain])
        return float(e.energy(ε, e.coefficients, as_vector(fibre))(()))

    # A quadratic form has ψ(a + b) - ψ(a) - ψ(b) = a : σ(b) and ψ(2 a) = 4 ψ(a).
    unit_strains = np.eye(6)
    unit_energies = np.array([energy(a) for a in unit_strains])
    work = np.diag(2 * unit_energies)
    for i, j in combinations(range(6), 2):
        work[i, j] = work[j, i] = (
            energy(unit_strains[i] + unit_strains[j]) - unit_energies[i] - unit_energies[j]
        )
    # Each of the last three stands for two entries of the tensors.
    component_tensors = np.zeros((6, 3, 3))
    for k, (i, j) in enumerate(UFL_COMPONENTS):
        component_tensors[k, i, j] = component_tensors[k, j, i] = 1.0 if i == j else 0.5
    matrix = component_tensors.reshape(6, 9)
    return np.asarray(matrix.T @ work @ matrix)


def extrapolated(σ: Floats, points: Floats, X: Floats) -> Floats:
    """Extrapolate values (f, p, k) at points (p, 3) of each cell linearly to points X (q, 3)."""

    def basis(x: Floats) -> Floats:
        # With a single point the field is constant.
        constant = np.ones((len(x), 1))
        return np.concatenate([constant, x], axis=1) if len(points) > 1 else constant

    return np.asarray(basis(X) @ np.linalg.pinv(basis(points)) @ σ)


def _hoop(σ: Floats, x: Floats) -> Floats:
    """Return the hoop component about the z axis (n,) of tensors (n, 3, 3) at points x (n, 3)."""
    r = np.hypot(x[:, 0], x[:, 1])
    r = np.where(r > 0, r, 1.0)
    t = np.column_stack([-x[:, 1] / r, x[:, 0] / r, np.zeros(len(x))])
    return np.einsum("pi,pij,pj->p", t, σ, t)
