r"""Steps of given fracture energy: the load is an unknown, so that brittle interfaces do not jump.

While an interface breaks, the load may have to fall, and the displacement too (snap-back). The
dissipated energy always grows. With residual R, state x and part s of the path of loads a step
solves

.. math:: R(x, s) = 0, \qquad \sum_p W_p w_p(x) = E

with w the energy per area that damage dissipates in the step at a point of area W. The second
equation is one more row of the system. The loop of `numerics.newton` solves both. With the Jacobian
J of R, the exact inverse takes two solutions by the linear solver of J (bordering),

.. math:: J a = r, \quad J b = \partial R/\partial s, \qquad δs = (g·a - r_E)/(g·b), \quad
          δx = a - δs\, b, \quad g = W \partial w/\partial x.

A step begins where points are about to break further: otherwise g is zero and J elastic. The first
step begins at an elastic state just beyond the onset of damage (`start_beyond_onset`).
"""

from __future__ import annotations

import math
from collections.abc import Callable

from petsc4py import PETSc

import numpy as np

from app.foundation.arrays import Floats
from app.mechanics.problem import Problem
from app.numerics.lifetime import python_mat
from app.numerics.newton import NewtonResult, Solver
from app.numerics.preconditioners import Options
from app.numerics.system import MatrixFree, Measure

# Newton iterations of a step.
ITERATIONS = 25
# Relative tolerance of the energy of a step.
ENERGY_TOLERANCE = 1e-6
# Difference in the part of the path for the derivative by the load.
PATH_STEP = 1e-4
# Relative tolerance of the linear solver.
LINEAR_TOLERANCE = 1e-9
# Largest number of halvings of a failed step.
HALVINGS = 6
# Largest number of bisections for the start of a step.
BISECTIONS = 40


def dissipated_energy(problem: Problem, u: PETSc.Vec, q: PETSc.Vec | None) -> tuple[float, Floats]:
    """Energy that damage dissipates from the committed state to a state; collective.

    Returns:
        The energy [N mm], and its derivative with respect to owned jumps (3 n,) [N].
    """
    contact = problem.contact
    if contact is None or q is None or not contact.law.internal_variables:
        return 0.0, np.zeros(0)
    outputs = problem.trial(u, q).law.outputs
    weight = np.where(contact.law.dissipates, contact.local.weight, 0.0)
    local = float(weight @ outputs["dissipated"])
    return problem.comm.allreduce(local), (weight[:, None] * outputs["dissipated_by_jump"]).ravel()


def start_beyond_onset(
    problem: Problem,
    solver: Solver,
    energy: float,
    path: tuple[float, float],
    set_load: Callable[[float], None],
) -> float | None:
    """Set the solver to a state just beyond the onset of damage, for a step of given energy.

    The state is on the line from the last converged state to that of a step with frozen damage.

    Args:
        problem: The mechanical problem.
        solver: Solver of the problem, at the last converged state.
        energy: Energy of the step [N mm].
        path: Parts of the path of loads at the beginning and the end of the load step.
        set_load: Sets the problem to a part of the path.

    Returns:
        Part of the path of that state, or None if no damage is possible; collective.
    """
    contact, start = problem.contact, solver.x.copy()
    if contact is None or not contact.law.freeze(True):
        return None
    set_load(path[1])
    solver.run()
    contact.law.freeze(False)
    end = solver.x.copy()

    def spent_at(part: float) -> float:
        end.copy(solver.x)
        solver.x.axpby(1.0 - part, part, start)
        solver.system.impose(solver.blocks())
        return dissipated_energy(problem, *solver.u_and_q())[0]

    elastic, damaged = 0.0, 1.0
    damaged_energy = spent_at(damaged)
    if damaged_energy == 0.0:
        return None
    for _ in range(BISECTIONS):
        if damaged_energy <= energy:
            break
        middle = (elastic + damaged) / 2
        middle_energy = spent_at(middle)
        if middle_energy == 0.0:
            elastic = middle
        else:
            damaged, damaged_energy = middle, middle_energy
    spent_at(damaged)
    return path[0] + damaged * (path[1] - path[0])


class EnergyControl(MatrixFree):
    """System of displacement, jumps and, as last unknown, the part of the path of loads.

    Its inverse is that of the given system, bordered by one row and one column.

    Args:
        problem: The mechanical problem.
        solver: Solver of the problem.
        set_load: Sets the problem to a part of the path.
    """

    prefix = "mantle_energy_"
    # Where damage begins, a line search by the residual may cut steps to nothing.
    newton: Options = {"snes_linesearch_type": "basic"}  # noqa: RUF012

    def __init__(self, problem: Problem, solver: Solver, set_load: Callable[[float], None]) -> None:
        self.comm = problem.comm
        self._problem, self._solver_of_system, self._set_load = problem, solver, set_load
        self._energy = 1.0
        self._load_template = PETSc.Vec().createMPI((int(self.comm.rank == 0), 1), comm=self.comm)
        blocks = self.blocks().values()
        local_size, global_size = (
            sum(sizes) for sizes in zip(*(v.getSizes() for v in blocks), strict=True)
        )
        self.operator = python_mat(self, (local_size, global_size), self.comm)
        # State of the last residual, with supports at its load. Derivatives in that state: of the
        # residual by the load, of the energy by the jumps. Solution for the residual by the load.
        self._state = solver.vector()
        self._residual_by_load = solver.vector()
        self._energy_by_jump: Floats = np.zeros(0)
        self._state_by_load = solver.vector()
        limits = solver.tolerance, ITERATIONS
        self._solver = Solver(self, *limits, "", {}, solver.timing, solver.stop)

    def solve(self, energy: float, part: float) -> tuple[NewtonResult, float]:
        """Solve for the state that dissipates an energy from the last state; collective.

        Without convergence the given solver keeps its state.

        Args:
            energy: Energy of the step [N mm].
            part: Part of the path of loads at the state of the given solver.

        Returns:
            The outcome, and the part of the path at the end of the step.
        """
        solver_of_system, solver = self._solver_of_system, self._solver
        self._energy = energy
        solver.tolerance = solver_of_system.tolerance
        solver.residuals, solver.changes = [], []
        solver.scales = [*solver_of_system.scales, 0.0] if solver_of_system.scales else []
        if solver_of_system.system.contact:
            solver_of_system.system.contact.law.scale_augmentation(solver_of_system.augmentation)
        *x, load = solver.blocks()
        for values, start in zip(x, solver_of_system.blocks(), strict=True):
            start.copy(values)
        load.set(part)
        newton, krylov = solver.run()
        part = self._part_of_path(load)
        if solver.converged:
            self._set_load(min(part, 1.0))
            for values, end in zip(x, solver_of_system.blocks(), strict=True):
                values.copy(end)
            solver_of_system.system.impose(solver_of_system.blocks())
            measures = solver.measure(solver.x, solver.snes.getFunction()[0])
            solver_of_system.scales = [p.scale for p in measures[:-1]]
        residuals = tuple(solver.residuals)
        return NewtonResult(solver.converged, newton, krylov, residuals, (), False), part

    def _part_of_path(self, load: PETSc.Vec) -> float:
        """Part of the path; collective."""
        return float(self.comm.bcast(load.array_r[0] if self.comm.rank == 0 else None))

    # As a system

    @property
    def version(self) -> int:
        """Number of changes of the matrices."""
        return self._solver_of_system.system.version

    def blocks(self) -> dict[str, PETSc.Vec]:
        """The blocks of the given system, and the part of the path."""
        return self._solver_of_system.system.blocks() | {"load": self._load_template.duplicate()}

    def impose(self, x: list[PETSc.Vec]) -> None:
        """Leave the supports to `residual`: their values depend on the load."""

    def residual(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> None:
        """Residual of a state at its load, and its energy less the given one.

        Beyond the end of the path the residual is linear in the load.
        """
        solver_of_system = self._solver_of_system
        part = self._part_of_path(x[-1])
        if not math.isfinite(part):  # see `apply`
            for of_block in f:
                of_block.set(math.nan)
            return
        on_path = min(part, 1.0)
        h = PATH_STEP if on_path < 0.5 else -PATH_STEP
        for values, imposed in zip(x[:-1], solver_of_system.blocks(self._state), strict=True):
            values.copy(imposed)
        self._set_load(on_path + h)
        by_load = solver_of_system.residual(self._state.copy())
        self._set_load(on_path)
        r = solver_of_system.residual(self._state)
        by_load.axpby(-1 / h, 1 / h, r)
        r.axpy(part - on_path, by_load)
        by_load.copy(self._residual_by_load)
        for values, of_block in zip(solver_of_system.blocks(r), f[:-1], strict=True):
            values.copy(of_block)
        energy, self._energy_by_jump = dissipated_energy(
            self._problem, *solver_of_system.u_and_q(self._state)
        )
        f[-1].set(energy - self._energy)

    def measure(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> list[Measure]:
        """Sizes of the residuals of the given system, and of the energy [N mm]."""
        solver_of_system = self._solver_of_system
        measures = solver_of_system.system.measure(solver_of_system.blocks(self._state), f[:-1])
        # The energy has converged at `ENERGY_TOLERANCE`, for any tolerance of forces.
        scale = self._energy * ENERGY_TOLERANCE / solver_of_system.tolerance
        return [*measures, Measure(float(f[-1].norm()), scale, 0.0, lasting=False)]

    # As operator and inverse of PETSc

    def mult(self, A: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply the Jacobian to x, into y."""
        *change, load = x.getNestSubVecs()
        *forces, energy = y.getNestSubVecs()
        solver_of_system = self._solver_of_system
        a = self._solver_of_system.vector()
        r = self._solver_of_system.vector()
        for values, of_block in zip(change, solver_of_system.blocks(a), strict=True):
            values.copy(of_block)
        solver_of_system.linear.matrix.mult(a, r)
        r.axpy(self._part_of_path(load), self._residual_by_load)
        for values, of_block in zip(solver_of_system.blocks(r), forces, strict=True):
            values.copy(of_block)
        energy.set(self._energy_change(a))

    def renew(self) -> None:
        """Do nothing: the solver of the given system renews its inverse."""

    def setUp(self, pc: PETSc.PC) -> None:
        """Set the Jacobian at the state of the last residual; solve for a unit of the load."""
        solver_of_system = self._solver_of_system
        solver_of_system.linear.update(solver_of_system.blocks(self._state))
        ksp = solver_of_system.snes.getKSP()
        ksp.setOperators(solver_of_system.linear.matrix)
        ksp.setTolerances(rtol=LINEAR_TOLERANCE, atol=0.0)
        ksp.solve(self._residual_by_load, self._state_by_load)

    def apply(self, pc: PETSc.PC, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """Apply the inverse of the Jacobian to r, into z.

        If no energy is dissipated, there is no such step: the result is NaN, and the loop ends.
        """
        *forces, energy = r.getNestSubVecs()
        *change, load = z.getNestSubVecs()
        solver_of_system = self._solver_of_system
        residual = self._solver_of_system.vector()
        a = self._solver_of_system.vector()
        for values, of_block in zip(forces, solver_of_system.blocks(residual), strict=True):
            values.copy(of_block)
        solver_of_system.snes.getKSP().solve(residual, a)
        by_load = self._energy_change(self._state_by_load)
        energy_deficit = self._energy_change(a) - self._part_of_path(energy)
        step = energy_deficit / by_load if by_load else math.nan
        a.axpy(-step, self._state_by_load)
        for values, of_block in zip(solver_of_system.blocks(a), change, strict=True):
            values.copy(of_block)
        load.set(step)

    def _energy_change(self, x: PETSc.Vec) -> float:
        """Change of the energy by a change of the state; collective."""
        jump = self._solver_of_system.blocks_by_name(x)["jump"].array_r
        return float(self.comm.allreduce(float(self._energy_by_jump @ jump)))
