r"""Bodies that follow each other, condensed once whatever pairs they are in; on one rank.

Some points follow unknowns m of other bodies by :math:`w = Q m + q`, Q changing as surfaces slide.
Their places w and m themselves, the ties cut, have a stiffness that does not change. With its
inverse A the jumps that forces λ on them cause are

.. math:: q = M λ, \qquad M = F A F^T, \quad F = (-Q, I), \qquad S = M^{-1}.

Bodies that nothing else holds get springs, of which forces a at their places E free them again.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack
from scipy.sparse import csr_array

from app.foundation.arrays import Floats

# Part of the largest pivot below which nothing resists a motion.
LOOSE = 1e-9


class Untied:
    """Flexibility of unknowns m and points, all ties cut.

    Args:
        S: Stiffness of m and the jumps; overwritten.
        Q: Displacement of the points by m, as of that stiffness.
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

    def tie(self, Q: csr_array) -> Floats:
        """Stiffness S of the jumps in pairs Q."""
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
        """F v: how points move over what they follow."""
        n = self._Q.shape[1]
        return np.asarray(v[n:] - self._Q @ v[:n])

    def solve(self, g: Floats, q: Floats) -> tuple[Floats, Floats]:
        """Forces that hold jumps q while forces g act, and how m and the jumps move.

        Forces g and motions of jumps are those in the first pairs.
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
    return np.asarray(A + np.triu(A, 1).T)  # what is below the diagonal is zero
