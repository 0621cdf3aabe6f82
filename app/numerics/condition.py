"""Estimate of the condition number of a matrix."""

from __future__ import annotations

import math

from petsc4py import PETSc

from app.numerics.preconditioners import INTERFACE, configure

CONDITION_ITERATIONS = 20


def condition_number(A: PETSc.Mat) -> float:
    """Condition number of a Jacobian: largest over smallest singular value; collective.

    Estimated to some per cent by power iteration with A^T A, and with its inverse by factors of A.
    The matrix has displacements and jumps, unlike that of a displacement method.

    Raises:
        MemoryError: The factors do not fit into memory.
    """
    A = A.convert("aij", PETSc.Mat())
    factors = PETSc.PC().create(A.comm)
    factors.setOperators(A)
    configure(factors, INTERFACE)
    if factors.getFailedReason() == PETSc.PC.FailedReason.FACTOR_OUTMEMORY:
        raise MemoryError(f"factorization of a matrix of {A.getSize()[0]:,} unknowns")
    x, y = A.createVecs()
    sizes = []
    for apply, back in ((A.mult, A.multTranspose), (factors.apply, factors.applyTranspose)):
        x.setRandom()
        for _ in range(CONDITION_ITERATIONS):
            x.normalize()
            apply(x, y)
            back(y, x)
        sizes.append(math.sqrt(x.norm()))
    return sizes[0] * sizes[1]
