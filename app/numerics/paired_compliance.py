r"""Condensed stiffness of bodies that follow each other, for any pairs of their surfaces.

Some points follow unknowns m of other bodies, :math:`w = Q m + q`. Q changes as surfaces slide.
If the points are released, the stiffness of w and m does not change. Let A be its inverse. Forces λ
on the jumps cause the jumps

.. math:: q = M λ, \qquad M = F A F^T, \quad F = (-Q, I), \qquad S = M^{-1}.

Bodies that nothing else holds get springs. The method removes the forces of the springs again.
All arrays are on one rank.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack
from scipy.sparse import csr_array

from app.foundation.arrays import Floats

# Part of the largest pivot below which nothing resists a motion.
LOOSE = 1e-9


class PairedCompliance:
    """Compliance of the unknowns m and of the points, all points released.

    Args:
        S: Stiffness of m and the jumps (n + p, n + p) [N/mm]; overwritten.
        Q: Displacement of the points by m in this stiffness (p, n).
    """

    def __init__(self, S: Floats, Q: csr_array) -> None:
        self._first, n = Q, Q.shape[1]
        S[:, :n] -= S[:, n:] @ Q
        S[:n] -= Q.T @ S[n:]
        spring = S.diagonal().max()
        _, pivots, rank, _ = lapack.dpstrf(S, tol=LOOSE * spring)
        self._loose = pivots[rank:] - 1
        S[self._loose, self._loose] += spring
        self._A = _inverse(S)
        held = self._A[np.ix_(self._loose, self._loose)]
        self._freed = np.eye(len(held)) / spring - held

    def constrain(self, Q: csr_array) -> Floats:
        """Return the stiffness S of the jumps for other pairs Q (p, p) [N/mm]."""
        self._Q, n, used = Q, Q.shape[1], np.unique(Q.indices)
        V = Q[:, used] @ self._A[np.ix_(used, used)]
        half = Q[:, used] @ V.T / 2 - Q @ self._A[:n, n:]
        S = _inverse(self._A[n:, n:] + half + half.T)
        N = self._apart(self._A[:, self._loose])
        self._Y = S @ N
        self._H = np.linalg.inv(self._freed + N.T @ self._Y)
        self._S = S - self._Y @ self._H @ self._Y.T
        return self._S

    def _apart(self, v: Floats) -> Floats:
        """Return F v: jumps of the points by motions v of the unknowns."""
        n = self._Q.shape[1]
        return np.asarray(v[n:] - self._Q @ v[:n])

    def solve(self, g: Floats, q: Floats) -> tuple[Floats, Floats]:
        """Return the forces that hold jumps q under forces g, and the motions of m and the jumps.

        Forces g and the motions of the jumps refer to the first pairs.
        """
        n, loose = self._Q.shape[1], self._loose
        free = self._A @ np.concatenate([g[:n] - self._first.T @ g[n:], g[n:]])
        left = q - self._apart(free)
        forces = self._S @ left - self._Y @ (self._H @ free[loose])
        m = free[:n] + self._A[:n] @ np.concatenate([-(self._Q.T @ forces), forces])
        m += self._A[:n, loose] @ (self._H @ (free[loose] + self._Y.T @ left))
        return forces, np.concatenate([m, q + self._Q @ m - self._first @ m])


def _inverse(S: Floats) -> Floats:
    """Inverse of a symmetric positive definite matrix.

    Raises:
        ArithmeticError: It is not positive definite.
    """
    L, bad = lapack.dpotrf(S)
    if bad:
        raise ArithmeticError("LAPACK: bodies have no stiffness")
    A, _ = lapack.dpotri(L, overwrite_c=True)
    return np.asarray(A + np.triu(A, 1).T)  # entries below the diagonal are zero
