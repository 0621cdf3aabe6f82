"""The mechanics of a model: problem, solver, stresses and what is kept from the models before."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.mechanics.predictors import WarmStart
from app.mechanics.problem import Problem
from app.numerics.newton import Solver
from app.results.balance import Balance
from app.results.stresses import Stresses
from app.scene.scene import Scene
from app.system.timing import Timing


class Mechanical:
    """Mechanics of a model, or of successive models that differ in loads and laws alone.

    Attributes:
        neighbours: States of earlier models, as warm starts.
    """

    saved = ("problem", "solver")

    def __init__(self, problem: Problem, solver: Solver, around_z: bool, timing: Timing) -> None:
        self.problem, self.solver = problem, solver
        self.stresses = Stresses(problem, timing, around_z)
        self.neighbours = WarmStart(problem, solver)
        self._balance: Balance | None = None

    def begin(self, build: Scene, augmentation_factor: float, tolerance: float) -> None:
        """Begin another model, at rest; collective."""
        self.problem.begin(build, augmentation_factor)
        self.solver.begin(tolerance)
        self.neighbours.begin()

    def restored(self) -> None:
        """Fill the unknowns with the restored displacement and jumps; collective."""
        self.problem.take_up(*self.solver.u_and_q())

    def balance(self, about: NDArray[np.float64]) -> Balance:
        """Balances of the model at rest, with moments about a fixed point (3,) [mm]; collective."""
        if self._balance is None:
            self._balance = Balance(self.problem, about)
        else:
            self._balance.begin()
        return self._balance
