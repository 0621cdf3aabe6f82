"""The systems of mechanics: displacement alone, or displacement and jumps."""

from __future__ import annotations

from dataclasses import replace

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from app.arrays import Floats
from app.mechanics.coarse_space import SlidingMotions
from app.mechanics.problem import Problem, TrialState
from app.numerics.active_set import ActiveSet
from app.numerics.preconditioners import SWEEP, Options, stiffness_options
from app.numerics.sparse import block_diagonal, fill
from app.numerics.system import Measure, System, size


def mechanical(problem: Problem) -> BondedSystem | ContactSystem:
    """The system of a mechanical problem."""
    return ContactSystem(problem) if problem.contact else BondedSystem(problem)


def _stiffness(linear: str, problem: Problem) -> Options:
    """Direct or multigrid."""
    return stiffness_options(linear, problem.K, problem.scene.order, problem.inverse.lower)


class BondedSystem(System):
    """Displacement alone: no interface can move."""

    prefix = "mantle_"
    # The equations are linear: one linear solve, to the solver's own limit.
    newton: Options = {"ksp_rtol": 1e-14}  # noqa: RUF012

    def __init__(self, problem: Problem) -> None:
        """Take the stiffness as it is."""
        self._problem, self.comm = problem, problem.comm
        self.inverses = {"displacement": problem.inverse}
        self.active = ActiveSet(self.comm)

    @property
    def version(self) -> int:
        """Changes of the stiffness."""
        return self._problem.version

    def blocks(self) -> dict[str, PETSc.Vec]:
        """The displacement."""
        return {"displacement": self._problem.K.createVecLeft()}

    def matrices(self) -> list[list[PETSc.Mat | None]]:
        """The stiffness."""
        return [[self._problem.K]]

    def options(self, linear: str) -> dict[str, Options]:
        """Direct or multigrid."""
        return {"displacement": _stiffness(linear, self._problem)}

    def impose(self, x: list[PETSc.Vec]) -> None:
        """Put given displacements into a state."""
        self._problem.impose(x[0])

    def residual(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> None:
        """K u - f."""
        self._problem.residual_u(x[0], None, f[0])

    def measure(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> list[Measure]:
        """Forces out of balance, beside those there are [N]."""
        problem, u = self._problem, x[0]
        return [Measure(size(f), problem.force_scale(u, None), problem.rounding(u))]


class ContactSystem(System):
    """Displacement and jumps.

    Attributes:
        trial: The jump block at the state whose residual or Jacobian was asked for last.
    """

    trial: TrialState

    prefix = "mantle_"

    def __init__(self, problem: Problem) -> None:
        """Set up the blocks of the Jacobian."""
        self._problem, self.comm = problem, problem.comm
        self.inverses = {"displacement": problem.inverse}
        assert problem.contact is not None
        contact = self._contact = problem.contact
        self._C = contact.C.copy()
        self._C.zeroRows(problem.supports.rows, diag=0.0)
        self._coupled = self.version
        self._rows = block_diagonal(contact.comm, len(contact.mine))
        self._A_qu = self._rows.matMult(contact.Ct)
        self._A_qq = self._rows.matMult(contact.D)
        self._added = block_diagonal(contact.comm, len(contact.mine))
        self._coarse_version = -1
        self._forces: Floats | None = None
        self.active = ActiveSet(self.comm)

    @property
    def version(self) -> int:
        """Changes of the stiffness."""
        return self._problem.version

    def blocks(self) -> dict[str, PETSc.Vec]:
        """Displacement and jumps."""
        return {
            "displacement": self._problem.K.createVecLeft(),
            "jump": self._contact.D.createVecLeft(),
        }

    def matrices(self) -> list[list[PETSc.Mat | None]]:
        """The stiffness, the coupling, and the rows of the jumps."""
        return [[self._problem.K, self._C], [self._A_qu, self._A_qq]]

    def options(self, linear: str) -> dict[str, Options]:
        """Direct or multigrid for the displacement, a sweep for the jumps."""
        return {"displacement": _stiffness(linear, self._problem), "jump": SWEEP}

    def impose(self, x: list[PETSc.Vec]) -> None:
        """Put given displacements and jumps into a state."""
        u, q = x
        self._problem.impose(u)
        contact = self._contact
        q.array[:] = (contact.let(q.array_r.reshape(-1, 3)) + contact.given).ravel()

    def residual(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> None:
        """Equilibrium of the bodies, and of the contact points with their law."""
        self._problem.residual_u(x[0], x[1], f[0])
        trial = self.trial = self._trial(x)
        f[1].array[:] = self._contact.residual(trial.equilibrium, trial.jump, trial.law).ravel()

    def jacobian(self, x: list[PETSc.Vec]) -> None:
        """The generalized Jacobian of the contact points."""
        self._couple()
        self.trial = self._trial(x)
        self._set_rows(*self._contact.row_factors(self.trial.law))

    def linearize_at(self, forces: Floats | None) -> None:
        """Take the laws as linear about these interface forces, or as they are."""
        self._forces = forces

    def _trial(self, x: list[PETSc.Vec]) -> TrialState:
        """The jump block at a state: the laws at the forces of equilibrium, or linear about others.

        With F_0 given, the law F = P(F + r d) in displacement, jumps and forces is linearized at
        (d, F_0): P(F_0 + r d) + P' (F - F_0) stands for the force, F that of equilibrium.
        """
        trial = self._problem.trial(*x)
        if self._forces is None:
            return trial
        contact, known = self._contact, self._forces
        law = contact.law(-contact.weight[:, None] * known, trial.jump)
        change = contact.share[:, None] * (contact.forces(trial.equilibrium) - contact.let(known))
        force = law.force + np.einsum("pij,pj->pi", law.jacobian, change)
        return replace(trial, law=replace(law, force=force))

    def _couple(self) -> None:
        """Take in the coupling, if it has changed."""
        if self._coupled != self.version:
            self._coupled = self.version
            self._contact.C.copy(self._C)
            self._C.zeroRows(self._problem.supports.rows, diag=0.0)

    def _set_rows(self, times: NDArray[np.float64], added: NDArray[np.float64]) -> None:
        """Set the rows of the jumps."""
        fill(self._rows, times)
        fill(self._added, added)
        self._rows.matMult(self._contact.Ct, result=self._A_qu)
        self._rows.matMult(self._contact.D, result=self._A_qq)
        self._A_qq.axpy(1.0, self._added, structure=PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)

    def coarse_space(self) -> SlidingMotions:
        """Motions of bodies that slide, lift off or bend away."""
        if self._coarse_version != self.version:
            self._coarse, self._coarse_version = SlidingMotions(self._problem), self.version
        self._coarse.follow(self.trial.law.jacobian)
        return self._coarse

    @property
    def rows(self) -> PETSc.Mat:
        """Factor of equilibrium in the rows of the jumps, 1 - P' as last set."""
        return self._rows

    def record_active_set(self) -> None:
        """Add the contact points' states to the active set, of the residual asked for last."""
        self.active.add(self.trial.law.status)

    def measure(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> list[Measure]:
        """Forces out of balance, beside those there are [N]."""
        problem = self._problem
        return [Measure(size(f), problem.force_scale(*x), problem.rounding(x[0]))]

    def scale_augmentation(self, factor: float) -> bool:
        """Solve with this multiple of the default augmentation."""
        self._contact.scale_augmentation(factor)
        return True

    def augmentation(self) -> dict[str, float]:
        """Augmentation in force on each interface [MPa/mm]; collective."""
        return self._problem.augmentation(trial=True)

    def usual_augmentation(self) -> float:
        """Multiple of the augmentation asked for that would be chosen; collective."""
        return self._contact.usual_augmentation()

    def tie(self, on: bool) -> bool:
        """Solve with interfaces tied that were open everywhere so far, if there are any."""
        return self._contact.tie(on)
