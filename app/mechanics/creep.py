r"""Creep by strain hardening at quadrature points, exact where the stress is constant.

A point of the equivalent creep strain e_0 and the trial stress s_trial ends a step of N with

.. math:: s = s_{trial} - 3 G (e - e_0), \qquad e = A s^p (τ + N)^m, \qquad
          τ = (e_0 / (A s^p))^{1/m},

one equation, monotone in s: τ is when e_0 would be reached at the stress s. The flow is along the
trial deviator. No rate appears, which would be infinite at the start (m < 1).
"""

from __future__ import annotations

from collections.abc import Mapping

from mpi4py import MPI

import numpy as np

from app.foundation.arrays import Floats, Ints
from app.mechanics.body_forms import BodyForms, linear_shape_functions

# Equivalent creep strain (n,) [-], cycles or seconds so far, dissipated work [N mm].
CreepValues = tuple[Floats, float, float]

# Strain that counts as none.
NO_STRAIN = 1e-30
# Stress that counts as none [MPa].
NO_STRESS = 1e-12
# Least exponent m.
SMALLEST_M = 0.01
# Most Newton iterations.
MOST_NEWTON_ITERATIONS = 60
# Their tolerance in log s.
LOG_TOLERANCE = 1e-13
# The stress s is at most this far below the trial stress, in log s.
LOWEST_LOG_STRESS = 80.0
# Shear components count twice.
COMPONENT_WEIGHTS = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])


def von_mises(σ: Floats) -> Floats:
    """Equivalent stress (n,) of stresses by components (n, 6)."""
    return np.asarray(np.sqrt(1.5 * (deviator(σ) ** 2 @ COMPONENT_WEIGHTS)))


def deviator(σ: Floats) -> Floats:
    """Stress without its mean (n, 6)."""
    return np.asarray(σ - np.outer(σ[:, :3].mean(axis=1), [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]))


class CreepState:
    """State of all points of this rank that creep.

    Attributes:
        rows: Number of each among all quadrature points (n,).
        points_of_region: Slice of the points of each region.
        strain: Equivalent creep strain (n,).
        elapsed: Cycles or seconds so far.
        measure, unit: Of what elapses: cycles or time.
        dissipated: Work that creep has lost so far, on all ranks [N mm].
        relaxed_stress: Stress that creep takes in the current step (n, 6) [MPa].
        length: Cycles or seconds of the current step.
        row_keys: Keys of the points (n,).

    Args:
        rows: Numbers of the points by region (cells, points).
        points: The points in the reference cell (points, 3), of some weights (points,).
    """

    saved = ("strain", "elapsed", "dissipated")
    row_keys: Ints

    def __init__(
        self, body_forms: BodyForms, rows: Mapping[str, Ints], points: Floats, weights: Floats
    ) -> None:
        self._body_forms, self._comm = body_forms, body_forms.mesh.comm
        laws, elastic = body_forms.scene.creeps, {e.region: e for e in body_forms.scene.elastic}
        self.measure, self.unit = ("cycles", "-") if laws[0].per is None else ("time", "s")
        self.rows = np.concatenate([rows[c.region].ravel() for c in laws])
        sizes = [rows[c.region].size for c in laws]
        row_ends = np.cumsum([0, *sizes])
        self.points_of_region = {c.region: slice(*row_ends[k : k + 2]) for k, c in enumerate(laws)}
        volumes = [
            body_forms.points_and_volumes(c.region, points, weights)[1].ravel() for c in laws
        ]
        self._volumes = np.concatenate(volumes)
        self._shape_functions = linear_shape_functions(points)
        values = {k: [getattr(c, k) for c in laws] for k in ("A", "p", "m0", "m1")}
        values["unit"] = [c.per or 1.0 for c in laws]
        self._law_values: dict[str, Floats] = {k: np.repeat(v, sizes) for k, v in values.items()}
        self._modulus = np.repeat([elastic[c.region].moduli[0] for c in laws], sizes)
        self._final_three_G = np.repeat(
            [1.5 * elastic[c.region].coefficients[1] for c in laws], sizes
        )
        self.strain: Floats = np.zeros(row_ends[-1])
        self.relaxed_stress: Floats = np.zeros((row_ends[-1], 6))
        self.elapsed = self.dissipated = self.length = 0.0

    def elastic_strain(self, stress: Floats) -> float:
        """Largest equivalent stress over Young's modulus; collective."""
        strain = (von_mises(stress) / self._modulus).max(initial=0.0)
        return float(self._comm.allreduce(max(strain, NO_STRAIN), MPI.MAX))

    def equivalent_strain(self, relaxed_stress: Floats) -> Floats:
        """Equivalent creep strain (n,) that relaxes a stress (n, 6) [MPa]."""
        return von_mises(relaxed_stress) / self.three_G

    def numbers(self, region: str) -> dict[str, float]:
        """Published creep strain of a region that creeps; collective."""
        points = self.points_of_region.get(region)
        if points is None:
            return {}
        strain, volumes = self.strain[points], self._volumes[points]
        total, volume = self._comm.allreduce(np.array([strain @ volumes, volumes.sum()]))
        largest = self._comm.allreduce(strain.max(initial=0.0), MPI.MAX)
        return {"creep_strain_max": float(largest), "creep_strain_mean": float(total / volume)}

    @property
    def three_G(self) -> Floats:
        """Three times the shear modulus at the current cure (n,) [MPa]."""
        modulus = self._final_three_G.copy()
        for region, points in self.points_of_region.items():
            growth = self._body_forms.modulus_ratio.get(region)
            if growth is not None:
                cells = self._body_forms.region_cells(region)
                vertices = growth.function_space.dofmap.list[cells]
                modulus[points] *= (growth.x.array[vertices] @ self._shape_functions.T).ravel()
        return modulus

    def stress_relaxation(self, trial: Floats, length: float) -> Floats:
        """Stress relaxed by creep in a step, from the trial stress (n, 6) [MPa]."""
        s, G3 = np.maximum(von_mises(trial), NO_STRESS), self.three_G
        Δe = self._strain_increment(s, np.asarray(length / self._law_values["unit"]), G3)
        return (G3 * Δe / s)[:, None] * deviator(trial)

    def _hardening_time(self, y: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return m, dm/dy, log τ of the strain so far and -m d(log τ)/dy at y = log s (n,)."""
        law = self._law_values
        slope = law["m1"] / np.log(10)
        m = law["m0"] + slope * y
        slope = np.where((m > SMALLEST_M) & (m < 1), slope, 0.0)
        m = np.clip(m, SMALLEST_M, 1.0)
        e = np.log(np.maximum(self.strain, NO_STRAIN))
        τ = (e - np.log(law["A"]) - law["p"] * y) / m
        return m, slope, τ, law["p"] + slope * τ

    def _strain_increment(self, trial: Floats, N: Floats, G3: Floats) -> Floats:
        """Creep strain of a step (n,): the root of log(s + 3 G Δe(s)) = log s_trial in y = log s.

        In these terms the equation is nearly linear: Newton within bounds, halved where it leaves.
        """
        e = np.maximum(self.strain, NO_STRAIN)
        log_trial, N = np.log(trial), np.log(N)
        y, lower, upper = log_trial, log_trial - LOWEST_LOG_STRESS, log_trial
        for _ in range(MOST_NEWTON_ITERATIONS):
            m, slope, τ, by_log_stress = self._hardening_time(y)
            w = N - τ
            g = np.logaddexp(0.0, w)
            Δe = e * np.expm1(m * g)
            total = np.exp(y) + G3 * Δe
            f = np.log(total) - log_trial
            lower, upper = np.where(f < 0, y, lower), np.where(f < 0, upper, y)
            elapsed_share = np.exp(-np.logaddexp(0.0, -w))
            by_y = np.exp(y) + G3 * e * np.exp(m * g) * (slope * g + elapsed_share * by_log_stress)
            next_y = y - f * total / by_y
            next_y = np.where((next_y > lower) & (next_y < upper), next_y, (lower + upper) / 2)
            next_y = np.where(np.abs(f) < LOG_TOLERANCE, y, next_y)
            if np.array_equal(next_y, y):
                break
            y = next_y
        return Δe

    def first_step(self, stress: Floats, part: float) -> float:
        """Time [s or cycles] at which creep is `part` times the elastic strain; collective."""
        s = np.maximum(von_mises(stress), NO_STRESS)
        m, _, τ, _ = self._hardening_time(np.log(s))
        e = np.maximum(self.strain, NO_STRAIN)
        N = (
            np.exp(τ)
            * np.expm1(np.log1p(part * s / self._modulus / e) / m)
            * self._law_values["unit"]
        )
        return float(self._comm.allreduce(N.min(initial=np.inf), MPI.MIN))

    def commit(self, stress_before: Floats, stress_after: Floats) -> None:
        """Commit the current step, between two stresses (n, 6) [MPa]; collective."""
        self.strain = self.strain + self.equivalent_strain(self.relaxed_stress)
        strain = 1.5 * self.relaxed_stress / self.three_G[:, None]
        work = self._volumes * ((stress_before + stress_after) / 2 * strain @ COMPONENT_WEIGHTS)
        self.dissipated += float(self._comm.allreduce(work.sum()))
        self.elapsed += self.length

    def state(self) -> CreepValues:
        """The committed values, for `return_to`."""
        return self.strain, self.elapsed, self.dissipated

    def return_to(self, state: CreepValues) -> None:
        """Return to an earlier state."""
        self.strain, self.elapsed, self.dissipated = state
