"""The mechanics of a model: problem, solver, stresses and what is kept from the models before."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.mechanics.problem import Problem
from app.mechanics.warm_start import WarmStart
from app.numerics.newton import Solver
from app.results.balance import Balance
from app.results.bond_strength import Bond, bonds
from app.results.stresses import Stresses
from app.scene.scene import Scene
from app.system.timing import Timing


class Mechanical:
    """The mechanics of a model, or of one after another that differ in loads and laws alone.

    Attributes:
        problem: What is solved.
        solver: By what.
        stresses: Its stresses.
        bonds: Bonded interfaces.
        neighbours: States of the models before.
    """

    saved = ("problem", "solver")

    def __init__(self, problem: Problem, solver: Solver, around_z: bool, timing: Timing) -> None:
        """Compile what is evaluated; collective."""
        self.problem, self.solver = problem, solver
        self.stresses = Stresses(problem, timing, around_z)
        self.bonds: tuple[Bond, ...] = bonds(problem, self.stresses)
        self.neighbours = WarmStart(problem, solver)
        self._balance: list[Balance] = []

    def begin(self, build: Scene, augmentation_factor: float, tolerance: float) -> None:
        """Begin another model, at rest; collective."""
        self.problem.begin(build, augmentation_factor)
        self.solver.begin(tolerance)
        self.neighbours.begin()

    def restored(self) -> None:
        """Fill the unknowns with the restored displacement and jumps; collective."""
        self.problem.take_up(*self.solver.u_and_q())

    def balance(self, about: NDArray[np.float64]) -> Balance:
        """Balances of the model at rest; collective.

        Args:
            about: Point that moments are taken about (3,) [mm], always the same.
        """
        if self._balance:
            self._balance[0].begin()
        else:
            self._balance.append(Balance(self.problem, about))
        return self._balance[0]
