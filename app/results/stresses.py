"""Stress of the regions: at quadrature points, in cells, and published numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import basix
import numpy as np
from dolfinx import fem
from ufl import as_vector

from app.arrays import Floats
from app.case.quantities import computed
from app.laws.fibres import Circumferential, Vector
from app.laws.materials import Elastic
from app.mechanics.problem import Problem
from app.results.percentiles import percentile
from app.system.timing import Timing
from forms import elasticity

# Components of a symmetric tensor, in the order of `elasticity.symmetric`.
COMPONENTS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
STRESS_LEVELS = (5.0, 8.0, 10.0)  # MPa: PMMA endurance is 8 to 10


@dataclass(frozen=True)
class _Law:
    """A compiled stress, and the functions it depends on."""

    expression: fem.Expression
    displacement: fem.Function
    coefficients: list[fem.Constant]
    fibre: list[fem.Constant]

    def of(self, e: Elastic, displacement: fem.Function) -> fem.Expression:
        """The stress of a region in a displacement."""
        self.displacement.x.array[:] = displacement.x.array
        for constant, value in zip(self.coefficients, e.coefficients, strict=True):
            constant.value = value
        if e.fibre:
            # A straight fibre has no point.
            for constant, vector in zip(self.fibre, (e.fibre.axis, e.fibre.through), strict=False):
                constant.value = vector
        return self.expression


class Stresses:
    """Stress at quadrature points of every elastic region, compiled once.

    Args:
        around_z: Whether the z axis is that of a stem, so that there is a hoop stress.
    """

    def __init__(self, problem: Problem, timing: Timing, around_z: bool = False) -> None:
        self._problem, self._timing, self._around_z = problem, timing, around_z
        # Percentiles need the distribution within a cell, which is coarse beside a boundary layer.
        degree = 4 * (problem.scene.order - 1)
        quadrature = basix.make_quadrature(basix.CellType.tetrahedron, degree)
        self._points, self._weights = (np.asarray(a) for a in quadrature)
        elastic, setting = problem.scene.elastic, problem.mechanics.growth
        self.cells = {e.region: problem.mechanics.region_cells(e.region) for e in elastic}
        plain = [
            e for e in elastic if not e.eigenstrains and e.region not in problem.mechanics.swelling
        ]
        self._plain = {e.region: e for e in plain if e.region not in setting}
        kinds = {_lay(e): e for e in self._plain.values()}
        self._laws = {kind: self._law(e) for kind, e in kinds.items()}
        self._expressions = {
            e.region: self._expression(e)
            for e in elastic
            if e.region not in setting and e.region not in self._plain
        }
        # Stress that is history is known at the points where it was summed.
        self._history = {r: problem.setting for r in setting if problem.setting}

    def _law(self, e: Elastic) -> _Law:
        """Stress of any region without free strain that has the same law as this one."""
        mesh, v = self._problem.tagged.mesh, fem.Function(self._problem.space)
        coefficients = [fem.Constant(mesh, np.array(c)) for c in e.coefficients]
        fibre: list[fem.Constant] = []

        def constant(value: Vector) -> fem.Constant:
            fibre.append(fem.Constant(mesh, np.array(value)))
            return fibre[-1]

        direction = e.fibre.direction(mesh, constant) if e.fibre else None
        σ = elasticity.stress(
            lambda strain: e.energy(strain, coefficients, direction), elasticity.strain(v)
        )
        with self._timing.phase("compile", "stress"):
            expression = fem.Expression(σ, self._points, comm=self._problem.comm)
        return _Law(expression, v, coefficients, fibre)

    def _expression(self, e: Elastic) -> fem.Expression:
        problem, mechanics = self._problem, self._problem.mechanics
        v = problem.displacements()[problem.bodies.of_region[e.region]]
        ε = mechanics.elastic_strain(e, v)
        σ = elasticity.stress(lambda strain: mechanics.energy_density(e, strain), ε)
        with self._timing.phase("compile", "stress"):
            return fem.Expression(σ, self._points, comm=problem.comm)

    def evaluate(self, region: str) -> Floats:
        """Stress at the quadrature points of a region's own cells (cells, points, 3, 3) [MPa]."""
        if region in self._history:
            return self._history[region].stress(region)
        cells = self.cells[region]
        if not len(cells):
            return np.zeros((0, len(self._points), 3, 3))
        if region in self._plain:
            e, body = self._plain[region], self._problem.bodies.of_region[region]
            expression = self._laws[_lay(e)].of(e, self._problem.displacements()[body])
        else:
            expression = self._expressions[region]
        values = expression.eval(self._problem.tagged.mesh, cells)
        return values.reshape(len(cells), len(self._points), 3, 3)

    def at(self, region: str) -> Floats:
        """Points of a region's cells, in the reference cell (points, 3)."""
        history = self._history.get(region)
        return self._points if history is None else history.points

    def shares(self, region: str) -> Floats:
        """Fraction of a cell's volume at each of its points (points,)."""
        history = self._history.get(region)
        weights = self._weights if history is None else history.weights
        return np.asarray(weights / weights.sum(), dtype=np.float64)

    def mean(self, region: str) -> Floats:
        """Mean stress of a region's own cells (cells, 3, 3) [MPa]."""
        share = self.shares(region)
        return np.asarray(np.einsum("q,cqij->cij", share, self.evaluate(region)))

    def places(self, region: str) -> tuple[Floats, Floats]:
        """Positions (cells * points, 3) [mm] of the points, and their volumes (cells, points)."""
        mesh = self._problem.tagged.mesh
        element = mesh.ufl_domain().ufl_coordinate_element().sub_elements[0]
        N, *dN = element.tabulate(1, self.at(region))
        x = mesh.geometry.x[mesh.geometry.dofmap[self.cells[region]]]
        measure = np.abs(np.linalg.det(np.einsum("cni,jqn->cqij", x, np.array(dN)))) / 6
        return np.einsum("qn,cni->cqi", N, x).reshape(-1, 3), measure * self.shares(region)

    def energy_density(self, region: str) -> Floats:
        r"""Energy of the elastic strain, :math:`ψ = \tfrac12 σ : ε` (cells, points) [MPa].

        The strain is that of the region's law for the stress, without thermal or other free strain.
        """
        σ = self.evaluate(region)
        e = next(e for e in self._problem.scene.elastic if e.region == region)
        if isinstance(e.fibre, Circumferential):
            # In axes that turn with it.
            Q = e.fibre.frames(self.places(region)[0]).reshape(σ.shape)
            σ = np.einsum("cqki,cqkl,cqlj->cqij", Q, σ, Q)
        a = np.stack([σ[..., i, j] for i, j in COMPONENTS], axis=-1)
        # Each of the last three stands for two entries of the tensors.
        twice = np.diag([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
        S = twice @ np.linalg.inv(_stiffness(e))
        return np.asarray(np.einsum("cqi,ij,cqj->cq", a, S, a)) / 2

    def region(self, region: str) -> dict[str, Any]:
        """Published stresses of a region; collective."""
        σ = self.evaluate(region).reshape(-1, 3, 3)
        x, volumes = self.places(region)
        mean = np.trace(σ, axis1=1, axis2=2) / 3
        deviator = σ - mean[:, None, None] * np.eye(3)
        eigen = np.linalg.eigvalsh(σ)
        local = np.column_stack(
            [
                np.sqrt(1.5 * np.einsum("pij,pij->p", deviator, deviator)),
                _hoop(σ, x),
                eigen[:, 2],
                eigen[:, 0],
                mean,
                volumes.ravel(),
            ]
        )
        pieces = self._problem.comm.gather(local)
        result: dict[str, Any] = {}
        if pieces is not None:
            mises, hoop, principal, least, mean, volume = np.concatenate(pieces).T
            result = {
                "von_mises_max": float(mises.max()),
                "von_mises_p99": percentile(mises, volume),
                "principal_max": float(principal.max()),
                "principal_p99": percentile(principal, volume),
                "principal_min": float(least.min()),
                "mean_stress_min": float(mean.min()),
                "mean_stress_max": float(mean.max()),
                "volume": float(volume.sum()),
                "volume_over_5_8_10_MPa": [
                    float(volume[principal > level].sum()) for level in STRESS_LEVELS
                ],
            }
            if self._around_z:
                result["hoop_p99"] = percentile(hoop, volume)
        return self._problem.comm.bcast(result) | computed("regions", self, region)


def _lay(e: Elastic) -> str:
    """Kind of the fibre: regions of one kind share the form of their stress."""
    return e.fibre.kind if e.fibre else ""


def _stiffness(e: Elastic) -> Floats:
    """Stress components (6, 6) of unit strains, in the order of `COMPONENTS` [MPa].

    For a fibre that turns, in axes that turn with it, of which it is the third.
    """
    fibre = e.fibre.axis if e.fibre and not e.fibre.turns else (0.0, 0.0, 1.0)

    def energy(strain: Floats) -> float:
        ε = elasticity.symmetric([float(c) for c in strain])
        return float(e.energy(ε, e.coefficients, as_vector(fibre))(()))

    # Of a quadratic form, ψ(a + b) - ψ(a) - ψ(b) = a : σ(b).
    units: list[Floats] = list(np.eye(6))
    own = [energy(a) for a in units]
    work = [
        [energy(a + b) - ψ_a - ψ_b for b, ψ_b in zip(units, own, strict=True)]
        for a, ψ_a in zip(units, own, strict=True)
    ]
    # A shear of a stands for two entries of the tensor.
    return np.array(work) / np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])[:, None]


def extrapolated(σ: Floats, points: Floats, X: Floats) -> Floats:
    """Stress (f, p, 3, 3) at points (p, 3) of each cell, linearly extrapolated to X (f, q, 3)."""

    def basis(x: Floats) -> Floats:
        # One point gives no slope.
        one = np.ones((*x.shape[:-1], 1))
        return np.concatenate([one, x], axis=-1) if len(points) > 1 else one

    continued = basis(X) @ np.linalg.pinv(basis(points))
    return np.asarray(np.einsum("fqp,fpij->fqij", continued, σ))


def _hoop(σ: Floats, x: Floats) -> Floats:
    """Stress around the z axis (n,) [MPa]."""
    r = np.hypot(x[:, 0], x[:, 1])
    r = np.where(r > 0, r, 1.0)
    t = np.column_stack([-x[:, 1] / r, x[:, 0] / r, np.zeros(len(x))])
    return np.einsum("pi,pij,pj->p", t, σ, t)
