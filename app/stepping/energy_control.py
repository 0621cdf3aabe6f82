r"""Steps of given fracture energy: the load is an unknown, so that brittle interfaces do not jump.

While an interface breaks, the load may have to fall, and the motion too (snap-back). What always
grows is the energy spent. With residual R, state x and part s of the path of loads, a step solves

.. math:: R(x, s) = 0, \qquad \sum_p W_p w_p(x) = E

with w the energy that damage spends in the step at a point of area W. A Newton iteration takes
two solutions with the same Jacobian J,

.. math:: J a = R, \quad J b = \partial R/\partial s, \qquad δx = -a - δs\, b, \quad
          δs = (\sum W w - E - g·a)/(g·b), \quad g = W \partial w/\partial x.

A step begins where points are about to break further: else g is zero and J elastic. The first
begins at an elastic state a little beyond the onset of damage (`overshoot`).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from app.foundation.arrays import Floats
from app.mechanics.problem import Problem
from app.numerics.newton import NewtonResult, Solver

# Newton iterations of a step; part of the energy at which it counts as spent; step of the part of
# the path for the derivative.
MOST, ENOUGH, SMALL = 25, 1e-6, 1e-4
# Relative tolerance of the linear solver, how often a failed step is halved, and bisections.
LINEAR, HALVINGS, BISECTIONS = 1e-9, 6, 40


def spent(problem: Problem, solver: Solver) -> tuple[float, Floats]:
    """Energy that damage spends in a step to the solver's state [N mm]; collective.

    And its derivative by own jumps (3 n,) [N].
    """
    u, q = solver.u_and_q()
    contact = problem.contact
    if contact is None or q is None or not contact.law.history:
        return 0.0, np.zeros(0)
    outputs = problem.trial(u, q).law.outputs
    weight = np.where(contact.law.dissipates, contact.own.weight, 0.0)
    local = float(weight @ outputs["dissipated"])
    return problem.comm.allreduce(local), (weight[:, None] * outputs["dissipated_by_jump"]).ravel()


def overshoot(
    problem: Problem,
    solver: Solver,
    energy: float,
    path: tuple[float, float],
    set_load: Callable[[float], None],
) -> float | None:
    """Start for a step of given energy: set the solver to a state beyond the onset of damage.

    It is on the line from the last converged state to that of a load step with frozen damage.

    Args:
        problem: The mechanical problem.
        solver: Its solver, at the last converged state.
        energy: Energy of the step [N mm].
        path: Parts of the path of loads at the beginning and the end of the load step.
        set_load: Sets the problem to a part of the path.

    Returns:
        Part of the path of that state, or None if there is no more damage; collective.
    """
    contact, start = problem.contact, solver.x.copy()
    if contact is None or not contact.freeze(True):
        return None
    set_load(path[1])
    solver.run()
    contact.freeze(False)
    end = solver.x.copy()

    def at(part: float) -> float:
        end.copy(solver.x)
        solver.x.axpby(1.0 - part, part, start)
        solver.system.impose(solver.blocks())
        return spent(problem, solver)[0]

    low, high = 0.0, 1.0
    if (found := at(high)) == 0.0:
        return None
    for _ in range(BISECTIONS):
        if found <= energy:
            break
        middle = (low + high) / 2
        if (more := at(middle)) == 0.0:
            low = middle
        else:
            high, found = middle, more
    at(high)
    return path[0] + high * (path[1] - path[0])


def by_energy(
    problem: Problem, solver: Solver, energy: float, s: float, set_load: Callable[[float], None]
) -> tuple[NewtonResult, float]:
    """Solve for the state that has spent an energy [N mm] since the last one; collective.

    Args:
        problem: The mechanical problem.
        solver: Its solver, at the last converged state or beyond.
        energy: Energy of the step.
        s: Part of the path of loads there.
        set_load: Sets the problem to a part of the path.

    Returns:
        The outcome, and the part of the path found.
    """
    contact, comm = problem.contact, problem.comm
    assert contact is not None
    x, a, b = solver.x, solver.vector(), solver.vector()
    residuals: list[float] = []
    ksp, converged, krylov = solver.snes.getKSP(), False, 0
    contact.scale_augmentation(solver.augmentation)
    for _ in range(MOST):
        # Loads are linear in the way to the end of the path, and taken as such beyond.
        at = min(s, 1.0)
        h = SMALL if at < 0.5 else -SMALL
        set_load(at + h)
        by_load = solver.residual(x.copy())
        set_load(at)
        f = solver.residual(x)
        by_load.axpby(-1 / h, 1 / h, f)
        f.axpy(s - at, by_load)
        found, gradient = spent(problem, solver)
        missing = found - energy
        parts = solver.measure(x, f)
        residuals.append(max(p.norm / p.scale if p.scale else p.norm for p in parts))
        if not math.isfinite(residuals[-1]):
            break
        converged = all(p.norm <= p.limit(solver.tolerance) for p in parts)
        if converged := converged and abs(missing) <= ENOUGH * energy:
            solver.scales = [p.scale for p in parts]
            break
        solver.linear.update(solver.blocks())
        ksp.setOperators(solver.linear.matrix)
        ksp.setTolerances(rtol=LINEAR, atol=0.0)
        ksp.solve(f, a)
        krylov += int(ksp.getIterationNumber())
        ksp.solve(by_load, b)
        jumps = [solver.blocks_by_name(v)["jump"].array_r for v in (a, b)]
        by_a, by_b = comm.allreduce(np.array([gradient @ q for q in jumps]))
        if by_b == 0.0:
            break
        ds = (missing - by_a) / by_b
        x.axpy(-1.0, a)
        x.axpy(-ds, b)
        s += ds
    newton = len(residuals) - 1
    return NewtonResult(converged, newton, krylov, tuple(residuals), (), False), s
