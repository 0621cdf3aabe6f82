"""Stability of a steady state of heat and mechanics.

Newton's method also finds unstable states: conductance that grows with pressure and expansion that
makes the pressure can feed each other. Near a steady state M dx/dt = -A x, with the capacity M in
the rows of the heat and zero in those of the mechanics. A step of backward Euler of length h
multiplies a mode of rate λ by 1 / (1 + h λ): decaying modes (λ > 0) by less than one, growing ones
by more than one while h |λ| < 2. The largest factor, found by power iteration, decides.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from petsc4py import PETSc

import numpy as np

from app.numerics.system import System

# Lengths of the steps, in times of the slowest mode; iterations of each.
STEPS, ITERATIONS = (0.7, 0.15, 0.03), 60
# Least factor beyond one that is not rounding.
GROWS = 1.0 + 1e-6


def grows(system: System, x: list[PETSc.Vec], begin: Callable[[float], object]) -> bool:
    """Whether a small change of a steady state grows; collective.

    Args:
        system: Heat and mechanics.
        x: The blocks of the state.
        begin: Sets the system to a step of a length [s], infinite for the steady state.
    """

    def matrix(h: float) -> PETSc.Mat:
        begin(h)
        system.residual(x, f)
        system.jacobian(x)
        nest = PETSc.Mat().createNest(system.matrices(), comm=system.comm)
        nest.assemble()
        return nest.convert("aij", PETSc.Mat())

    f = [v.duplicate() for v in x]
    M = matrix(1.0)
    A = matrix(math.inf)
    M -= A
    slowest = _factor(A, M, ITERATIONS // 3)
    if not slowest:
        return False
    for part in STEPS:
        h = part * slowest
        if _factor(A + (1 / h) * M, M, ITERATIONS) / h > GROWS:
            return True
    return False


def _factor(A: PETSc.Mat, M: PETSc.Mat, iterations: int) -> float:
    """Largest factor by which repeated solves A y = M x change M x."""
    solver = PETSc.KSP().create(A.comm)
    solver.setOperators(A)
    solver.setType("preonly")
    solver.getPC().setType("lu")
    solver.getPC().setFactorSolverType("mumps")
    y, b = A.createVecs()
    start, end = y.getOwnershipRange()
    y.array[:] = np.random.default_rng(0).standard_normal(y.getSize())[start:end]
    factor = 0.0
    for _ in range(iterations):
        M.mult(y, b)
        before = b.norm()
        if not before:
            return 0.0
        b.scale(1 / before)
        solver.solve(b, y)
        M.mult(y, b)
        factor = b.norm()
        if not math.isfinite(factor):
            return math.inf
    return factor
