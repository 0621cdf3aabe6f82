"""Scenes whose temperatures and degrees of cure are given by hand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from dolfinx import fem

from app.foundation.arrays import Floats
from app.mechanics.problem import Problem
from app.mechanics.systems import mechanical
from app.numerics.newton import Solver
from app.numerics.remedies import solve
from app.results.balance import Balance
from app.results.interface_numbers import ContactSamples
from app.results.stresses import Stresses
from app.scene.scene import Scene, build_scene
from app.system.timing import Timing
from tests import laws, support

Field = Callable[[Floats], Floats]


@dataclass(frozen=True)
class Heated:
    """A scene whose temperatures are given by hand."""

    problem: Problem
    solver: Solver
    stresses: Stresses
    balance: Balance

    @classmethod
    def make(cls, text: str, change: Callable[[Scene], Scene], *overrides: str) -> Heated:
        """A case, its scene changed."""
        case = support.case(text, *overrides)
        timing = Timing()
        problem = Problem(change(build_scene(case)), support.mesh(case), 1.0, timing)
        solver = Solver(mechanical(problem), 1e-12, 50, "direct", {}, timing)
        return cls(problem, solver, Stresses(problem), Balance(problem, np.zeros(3)))

    def scalar(self, field: float | Field) -> fem.Function:
        """A field at the vertices."""
        T = fem.Function(self.problem.mechanics.scalars)
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
        """Say how far regions have set, and what free strain they have."""
        scalars = (self.scalar(degree), self.scalar(strain))
        self.problem.history.set(*({r: f for r in regions} for f in scalars))

    def step(self) -> ContactSamples | None:
        """Solve, commit, balance."""
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
