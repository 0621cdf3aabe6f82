"""Factors of CHOLMOD and MUMPS with a Schur complement, against dense matrices."""

from __future__ import annotations

import weakref

import numpy as np
import pytest
from scipy.sparse import csr_array, diags_array, eye_array, hstack, kron, random_array

from app.numerics.cholesky import Cholesky
from app.numerics.factor import Factor, factor_class
from app.numerics.mumps import Mumps

WITHOUT = pytest.mark.skipif(factor_class() is not Cholesky, reason="no CHOLMOD")
BOTH = [pytest.param(Cholesky, marks=WITHOUT), Mumps]
# Nodes along the edge of a grid, and last unknowns; a rank may have no interior, or meet nothing.
SIZES = [(0, 6), (2, 0), (1, 3), (2, 3), (2, 60), (6, 3), (6, 48), (6, 51), (6, 600)]


def spring_grid(n: int) -> csr_array:
    """Three unknowns at each node of a grid, positive definite."""
    if not n:
        return csr_array((0, 0))
    line = diags_array([-np.ones(n - 1), 2.1 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1])
    one = eye_array(n)
    grid = kron(kron(line, one), one) + kron(kron(one, line), one) + kron(kron(one, one), line)
    B = np.random.default_rng(0).normal(size=(3, 3))
    return csr_array(kron(grid, B @ B.T + 3 * np.eye(3)))


def joined(A: csr_array, m: int, density: float) -> tuple[csr_array, csr_array]:
    """A and E side by side, and E, some columns of which are empty."""
    E = csr_array(random_array((A.shape[0], m), density=density, rng=1))
    return csr_array(hstack([A, E], format="csr")), E


@pytest.mark.parametrize("kind", BOTH)
@pytest.mark.parametrize(("n", "m"), SIZES)
@pytest.mark.parametrize("density", [0.004, 0.2])
def test_factor_schur_complement_equals_dense(
    kind: type[Factor], n: int, m: int, density: float
) -> None:
    """- E^T A^-1 E is right for any number and place of last unknowns."""
    A = spring_grid(n)
    rows, E = joined(A, m, density)
    f = kind(rows)
    inverse, dense = np.linalg.inv(A.toarray()), E.toarray()
    for factor in (1.0, 2.0):
        S = f.factorize(factor * rows)
        np.testing.assert_allclose(S, -factor * dense.T @ inverse @ dense, atol=1e-11)
    b, x = (np.random.default_rng(k).normal(size=s) for k, s in enumerate((A.shape[0], m)))
    np.testing.assert_allclose(f.reduce(b), -dense.T @ inverse @ b, atol=1e-11)
    np.testing.assert_allclose(f.expand(x), inverse @ (b / 2 - dense @ x), atol=1e-11)
    np.testing.assert_allclose(f.expand(0 * x), inverse @ b / 2, atol=1e-11)
    assert f.entries >= A.shape[0]


@pytest.mark.parametrize("kind", BOTH)
def test_factor_refuses_indefinite_matrix(kind: type[Factor]) -> None:
    rows, _ = joined(spring_grid(4), 30, 0.1)
    f = kind(rows)
    wrong = rows.copy()
    wrong.data[wrong.indices == 100] *= -1
    with pytest.raises(ArithmeticError):
        f.factorize(wrong)


@pytest.mark.parametrize("kind", BOTH)
def test_factor_memory_is_freed_with_the_factors(kind: type[Factor]) -> None:
    """Each step of a motion makes new factors."""
    f = kind(joined(spring_grid(3), 30, 0.1)[0])
    gone = weakref.ref(f)
    del f
    assert gone() is None
