"""Known results of the BLAS and LAPACK operations that the solvers use, in a few milliseconds.

A wrong kernel (there are some for single models of processors) or a broken installation may go
unnoticed otherwise: it may make residuals small.
"""

from __future__ import annotations

from collections.abc import Iterator

from petsc4py import PETSc

import numpy as np

from app.foundation.arrays import Floats, Ints

# Larger than the blocks of usual kernels, and no multiple of them.
SIZE = 131
# Largest relative error of a right result.
ROUNDING_OF_BLAS = 1e-10


def wrong_results() -> list[str]:
    """Names of the operations that give wrong results on this machine."""
    return [name for name, error in _errors() if not error <= ROUNDING_OF_BLAS]


def _errors() -> Iterator[tuple[str, float]]:
    """Name and relative error of each BLAS and LAPACK operation that the solvers use."""
    n = SIZE
    # Small whole numbers, of which every sum is exact; numpy multiplies them without BLAS.
    i = np.arange(n * n, dtype=np.int64).reshape(n, n) * 7919 % 11 - 5
    a, b = i[0], i[1]
    x, y = (PETSc.Vec().createWithArray(v.astype(float), comm=PETSc.COMM_SELF) for v in (a, b))
    yield "scalar product (ddot)", abs(x.dot(y) - a @ b)
    yield "norm of a vector", abs(x.norm() - np.sqrt(float(a @ a)))
    y.axpy(3.0, x)
    yield "sum of vectors (daxpy)", _most(y.array - (b + 3 * a))
    y.scale(-2.0)
    yield "multiple of a vector (dscal)", _most(y.array + 2 * (b + 3 * a))
    A = PETSc.Mat().createDense((n, n), array=i.astype(float), comm=PETSc.COMM_SELF)
    A.assemble()
    A.mult(x, y)
    yield "matrix times vector (dgemv)", _most(y.array - i @ a)
    product = A.matMult(A)
    yield "matrix times matrix (dgemm)", _most(product.getDenseArray() - i @ i)
    f = i.astype(float)
    yield "matrix times matrix of numpy", _most(f @ f - i @ i)
    yield "factors of a matrix (dpotrf)", _factored(i.T @ i + n * np.eye(n, dtype=np.int64), a)
    yield "eigenvalues of LAPACK (dnrm2)", _eigenvalues(i[:20, :20])


def _eigenvalues(A: Ints) -> float:
    """Error of the sums of eigenvalues and of their squares, relative to the largest."""
    try:
        λ = np.linalg.eigvals(A.astype(float))
    except np.linalg.LinAlgError:
        return np.inf
    sums = np.array([λ.sum() - np.trace(A), (λ**2).sum() - np.trace(A @ A)])
    return _most(sums / np.array([_most(λ), _most(λ) ** 2]))


def _factored(definite: Ints, b: Ints) -> float:
    """Residual of a system solved by factors, summed without BLAS, over its largest entry."""
    n = len(b)
    K = PETSc.Mat().createDense((n, n), array=definite.astype(float), comm=PETSc.COMM_SELF)
    K.assemble()
    pc = PETSc.PC().create(PETSc.COMM_SELF)
    pc.setType("cholesky")
    pc.setOperators(K)
    x, y = (PETSc.Vec().createWithArray(v.astype(float), comm=PETSc.COMM_SELF) for v in (b, 0 * b))
    try:
        pc.setUp()
        pc.apply(x, y)
    except PETSc.Error:  # it is definite
        return np.inf
    return _most((definite * y.array).sum(axis=1) - b) / _most(definite)


def _most(values: Floats | Ints) -> float:
    return float(np.abs(values).max())
