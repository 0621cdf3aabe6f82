"""Scenes whose temperatures and degrees of cure are given by hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest
from dolfinx import fem

from app.foundation.arrays import Floats
from app.laws.cure import Cure, Prescribed
from app.mechanics.problem import Problem
from app.numerics.newton import Solver
from app.numerics.remedies import solve
from app.results.balance import Balance
from app.results.interface_numbers import ContactSamples
from app.results.stresses import Stresses
from app.scene.scene import Scene, build_scene
from app.stepping.stages import SolverSettings, assemble
from tests import support
from tests.cases import laws

Field = Callable[[Floats], Floats]
# A bar of two materials, each with its direction of fibres; rollers on three faces, so that it
# is free to grow.
BAR = """
geometry: {kind: blocks, blocks: [{name: one, size: [4 mm, 3 mm, 5 mm]},
                                  {name: two, size: [4 mm, 3 mm, 4 mm]}]}
mesh: {size: 2 mm, far_size: 2 mm}
regions:
  one: {youngs_modulus: 2200 MPa, poisson_ratio: 0.3}
  two: {kind: transversely_isotropic, axial_youngs_modulus: 17 GPa,
    transverse_youngs_modulus: 11.5 GPa, axial_poisson_ratio: 0.31,
    transverse_poisson_ratio: 0.51, axial_shear_modulus: 3.28 GPa, fibre: [0, 1, 1]}
supports:
  floor: {kind: roller, boundary: bottom, axis: z}
  left: {kind: roller, boundary: x_min, axis: x}
  front: {kind: roller, boundary: y_min, axis: y}
"""

CLAMPS = "supports.ceiling={kind: roller, boundary: top, axis: z}"

ORDERS = pytest.mark.parametrize("order", [1, 2])

# Stem, cement and bone of physics.md 3.2: cooled by 40 K, the cement alone shrinks; plane strain.
CYLINDERS = """
geometry: {kind: cylinders, stem_radius: 6 mm, cement_thickness: 4 mm, bone_thickness: 5 mm,
           length: 0.5 mm, sector: quarter}
mesh: {size: 1 mm, far_size: 1 mm, order: 2, curved: true}
regions:
  stem: {youngs_modulus: 200 GPa, poisson_ratio: 0.3}
  cement: {youngs_modulus: 2200 MPa, poisson_ratio: 0.3}
  bone: {youngs_modulus: 17 GPa, poisson_ratio: 0.3}
supports:
  symmetry_x: {kind: roller, boundary: symmetry_x, axis: x}
  symmetry_y: {kind: roller, boundary: symmetry_y, axis: y}
  bottom: {kind: roller, boundary: bottom, axis: z}
  top: {kind: roller, boundary: top, axis: z}
"""

UNILATERAL = (
    "interfaces.stem_cement={kind: contact, friction_coefficient: 0}",
    "interfaces.cement_bone={kind: contact, friction_coefficient: 0}",
)


@dataclass(frozen=True)
class Heated:
    """A scene whose temperatures are given by hand."""

    problem: Problem
    solver: Solver
    stresses: Stresses
    balance: Balance

    @classmethod
    def make(cls, text: str, change: Callable[[Scene], Scene], *overrides: str) -> Heated:
        """A case, and a change of its scene."""
        case = support.case(text, *overrides)
        settings = SolverSettings(1e-12, 50, "direct", augmentation_factor=1.0)
        analysis = assemble(change(build_scene(case)), support.mesh(case), settings)
        problem, solver = analysis.problem, analysis.solver
        assert problem is not None and solver is not None
        return cls(problem, solver, Stresses(problem), Balance(problem, np.zeros(3)))

    def scalar(self, field: float | Field) -> fem.Function:
        """A field at the vertices."""
        T = fem.Function(self.problem.body_forms.scalars)
        T.interpolate(lambda x: field(x) if callable(field) else np.full(x.shape[1], field))
        return T

    def solve(
        self, fields: Mapping[str, float | Field], time: float = 1.0
    ) -> ContactSamples | None:
        """One step to given temperatures of the regions."""
        self.problem.set_time(time)
        self.problem.set_temperature({r: self.scalar(f) for r, f in fields.items()})
        return self.step()

    def set(self, degree: float | Field, strain: float | Field, *regions: str) -> None:
        """Set the degree of cure and the free strain of regions."""
        scalars = (self.scalar(degree), self.scalar(strain))
        self.problem.stress_history.set(*({r: f for r in regions} for f in scalars))

    def step(self) -> ContactSamples | None:
        """Solve, commit, and compute the balances."""
        self.problem.update_stiffness()
        outcome = solve(self.solver)
        assert outcome.converged, outcome.residuals
        u, q = self.solver.u_and_q()
        trial = self.problem.trial(u, q) if q is not None else None
        self.problem.update_displacements(u, q)
        self.problem.commit(trial)
        self.balance.update(u, trial)
        return ContactSamples(self.problem, trial) if trial is not None else None

    def stress(self, region: str) -> Floats:
        """Stress at the points of a region (n, 3, 3) [MPa]."""
        return self.stresses.evaluate(region).reshape(-1, 3, 3)


def expanding(**coefficients: float) -> Callable[[Scene], Scene]:
    """Add expansion from 300 K to regions."""

    def change(old: Scene) -> Scene:
        terms = tuple(laws.expansion(r, a, 300.0) for r, a in coefficients.items())
        return replace(old, expansions=terms)

    return change


def cure(region: str, initial: float = 1e-3, **more: float) -> Cure:
    return laws.cure(region, Prescribed.model_construct(rate=()), initial, **more)


def setting(*cures: Cure, **coefficients: float) -> Callable[[Scene], Scene]:
    """Let regions expand from 300 K, and set."""

    def change(old: Scene) -> Scene:
        return replace(expanding(**coefficients)(old), cures=cures)

    return change
