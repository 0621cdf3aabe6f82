r"""Steps of given fracture energy: the load is an unknown, so that brittle interfaces do not jump.

While an interface breaks, the load may have to fall, and the displacement too (snap-back). The
dissipated energy always grows. With residual R, state x and fraction s of the path of loads a step
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
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

from petsc4py import PETSc

import numpy as np

from app.foundation.arrays import Floats
from app.mechanics.problem import Problem
from app.numerics.lifetime import python_mat
from app.numerics.newton import NewtonResult, Solver
from app.numerics.system import MatrixFree, Measure

# Largest number of Newton iterations of a step.
MOST_NEWTON_ITERATIONS = 25
# Relative tolerance of the energy of a step.
ENERGY_TOLERANCE = 1e-6
# Change of the fraction of the path in the difference quotient by the load [-].
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
    if contact is None or q is None or not contact.laws.internal_variables:
        return 0.0, np.zeros(0)
    outputs = problem.trial(u, q).forces.outputs
    weight = np.where(contact.laws.dissipates, contact.local.weight, 0.0)
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
        path: Fractions of the path of loads at the beginning and the end of the load step.
        set_load: Sets the problem to a fraction of the path.

    Returns:
        Fraction of the path at that state, or None if no damage is possible or the frozen problem
        does not converge; collective.
    """
    contact, start = problem.contact, solver.x.copy()
    if contact is None:
        return None
    with contact.remedies.freezing() as has_variables:
        if not has_variables:
            return None
        set_load(path[1])
        solver.run()
    if not solver.converged:
        return None
    end = solver.x.copy()

    def move_to(fraction: float) -> float:
        """Set the solver to a point of the line; return the energy dissipated there."""
        end.copy(solver.x)
        solver.x.axpby(1.0 - fraction, fraction, start)
        solver.system.impose(solver.blocks())
        return dissipated_energy(problem, *solver.u_and_q())[0]

    elastic, damaged = 0.0, 1.0
    damaged_energy = move_to(damaged)
    if damaged_energy == 0.0:
        return None
    for _ in range(BISECTIONS):
        if damaged_energy <= energy:
            break
        middle = (elastic + damaged) / 2
        middle_energy = move_to(middle)
        if middle_energy == 0.0:
            elastic = middle
        else:
            damaged, damaged_energy = middle, middle_energy
    move_to(damaged)
    return path[0] + damaged * (path[1] - path[0])


class EnergyControl(MatrixFree):
    """System of displacement, jumps and, as last unknown, the fraction of the path of loads.

    It borders the system of the given solver, at a fixed load, by one row and one column.

    Args:
        problem: The mechanical problem.
        solver: Solver of the problem under given loads.
        set_load: Sets the problem to a fraction of the path.
    """

    prefix = "mantle_energy_"
    # Where damage begins, a line search by the residual may cut steps to nothing.
    newton: Mapping[str, str | float] = MappingProxyType({"snes_linesearch_type": "basic"})

    def __init__(self, problem: Problem, solver: Solver, set_load: Callable[[float], None]) -> None:
        self.comm = problem.comm
        self._problem, self._load_solver, self._set_load = problem, solver, set_load
        self._energy = 1.0
        self._load_template = PETSc.Vec().createMPI((int(self.comm.rank == 0), 1), comm=self.comm)
        blocks = self.blocks().values()
        local_size, global_size = (
            sum(sizes) for sizes in zip(*(v.getSizes() for v in blocks), strict=True)
        )
        self.operator = python_mat(self, (local_size, global_size), self.comm)
        # State of the last residual, with the supports at its load.
        self._state = solver.vector()
        # Derivatives in that state: b is the solution of J b = dR/ds.
        self._residual_by_load = solver.vector()
        self._energy_by_jump: Floats = np.zeros(0)
        self._b = solver.vector()
        limits = solver.tolerance, MOST_NEWTON_ITERATIONS
        self._solver = Solver(self, *limits, "", {}, solver.timing, solver.stop)

    def solve(self, energy: float, fraction: float) -> tuple[NewtonResult, float]:
        """Solve for the state that dissipates an energy from the last state; collective.

        Without convergence the given solver keeps its state.

        Args:
            energy: Energy of the step [N mm].
            fraction: Fraction of the path of loads at the state of the given solver.

        Returns:
            The outcome, and the fraction of the path at the end of the step.
        """
        load_solver, solver = self._load_solver, self._solver
        self._energy = energy
        solver.tolerance = load_solver.tolerance
        solver.residuals, solver.changes = [], []
        solver.scales = [*load_solver.scales, 0.0] if load_solver.scales else []
        if load_solver.system.contact:
            load_solver.system.contact.laws.scale_augmentation(load_solver.augmentation)
        *x, load = solver.blocks()
        _copy(load_solver.blocks(), x)
        load.set(fraction)
        ksp = load_solver.snes.getKSP()
        rtol, atol, *_ = ksp.getTolerances()
        try:
            newton, krylov = solver.run()
        finally:
            ksp.setTolerances(rtol=rtol, atol=atol)  # `setUp` has set others
        fraction = self._value(load)
        if solver.converged:
            self._set_load(min(fraction, 1.0))
            _copy(x, load_solver.blocks())
            load_solver.system.impose(load_solver.blocks())
            measures = solver.measure(solver.x, solver.snes.getFunction()[0])
            load_solver.scales = [measure.scale for measure in measures[:-1]]
        residuals = tuple(solver.residuals)
        return NewtonResult(solver.converged, newton, krylov, residuals, (), False), fraction

    def _value(self, block: PETSc.Vec) -> float:
        """Value of a block with one entry, on all ranks; collective."""
        return float(self.comm.bcast(block.array_r[0] if self.comm.rank == 0 else None))

    # As a system

    @property
    def version(self) -> int:
        """Number of changes of the matrices."""
        return self._load_solver.system.version

    def blocks(self) -> dict[str, PETSc.Vec]:
        """The blocks of the given system, and the fraction of the path."""
        return self._load_solver.system.blocks() | {"load": self._load_template.duplicate()}

    def impose(self, x: list[PETSc.Vec]) -> None:
        """Leave the supports to `residual`: their values depend on the load."""

    def residual(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> None:
        """Residual of a state at its load, and its energy less the given one.

        Beyond the end of the path the residual is linear in the load.
        """
        load_solver = self._load_solver
        fraction = self._value(x[-1])
        if not math.isfinite(fraction):  # see `apply`
            for block in f:
                block.set(math.nan)
            return
        on_path = min(fraction, 1.0)
        h = PATH_STEP if on_path < 0.5 else -PATH_STEP
        _copy(x[:-1], load_solver.blocks(self._state))
        self._set_load(on_path + h)
        by_load = load_solver.residual(self._state.copy())
        self._set_load(on_path)
        r = load_solver.residual(self._state)
        by_load.axpby(-1 / h, 1 / h, r)
        r.axpy(fraction - on_path, by_load)
        by_load.copy(self._residual_by_load)
        _copy(load_solver.blocks(r), f[:-1])
        energy, self._energy_by_jump = dissipated_energy(
            self._problem, *load_solver.u_and_q(self._state)
        )
        f[-1].set(energy - self._energy)

    def measure(self, x: list[PETSc.Vec], f: list[PETSc.Vec]) -> list[Measure]:
        """Sizes of the residuals of the given system, and of the energy [N mm]."""
        load_solver = self._load_solver
        measures = load_solver.system.measure(load_solver.blocks(self._state), f[:-1])
        # The energy has converged at `ENERGY_TOLERANCE`, for any tolerance of forces.
        scale = self._energy * ENERGY_TOLERANCE / load_solver.tolerance
        return [*measures, Measure(float(f[-1].norm()), scale, 0.0, lasting=False)]

    # As operator and inverse of PETSc

    def mult(self, A: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply the Jacobian to x, into y."""
        *change, load = x.getNestSubVecs()
        *forces, energy = y.getNestSubVecs()
        load_solver = self._load_solver
        a, r = load_solver.vector(), load_solver.vector()
        _copy(change, load_solver.blocks(a))
        load_solver.linear.matrix.mult(a, r)
        r.axpy(self._value(load), self._residual_by_load)
        _copy(load_solver.blocks(r), forces)
        energy.set(self._energy_change(a))

    def renew(self) -> None:
        """Do nothing: the solver of the given system renews its inverse."""

    def setUp(self, pc: PETSc.PC) -> None:
        """Set the Jacobian at the state of the last residual; solve J b = dR/ds."""
        load_solver = self._load_solver
        load_solver.linear.update(load_solver.blocks(self._state))
        ksp = load_solver.snes.getKSP()
        ksp.setOperators(load_solver.linear.matrix)
        ksp.setTolerances(rtol=LINEAR_TOLERANCE, atol=0.0)
        ksp.solve(self._residual_by_load, self._b)

    def apply(self, pc: PETSc.PC, r: PETSc.Vec, z: PETSc.Vec) -> None:
        """Apply the inverse of the Jacobian to r, into z.

        If no energy is dissipated, there is no such step: the result is NaN, and the loop ends.
        """
        *forces, energy = r.getNestSubVecs()
        *change, load = z.getNestSubVecs()
        load_solver = self._load_solver
        residual, a = load_solver.vector(), load_solver.vector()
        _copy(forces, load_solver.blocks(residual))
        load_solver.snes.getKSP().solve(residual, a)
        by_load = self._energy_change(self._b)
        energy_deficit = self._energy_change(a) - self._value(energy)
        step = energy_deficit / by_load if by_load else math.nan
        a.axpy(-step, self._b)
        _copy(load_solver.blocks(a), change)
        load.set(step)

    def _energy_change(self, x: PETSc.Vec) -> float:
        """Change of the energy by a change of the state; collective."""
        jump = self._load_solver.blocks_by_name(x)["jump"].array_r
        return float(self.comm.allreduce(float(self._energy_by_jump @ jump)))


def _copy(source: Sequence[PETSc.Vec], target: Sequence[PETSc.Vec]) -> None:
    """Copy blocks into others."""
    for block, target_block in zip(source, target, strict=True):
        block.copy(target_block)
