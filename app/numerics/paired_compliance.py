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

# Fraction of the largest pivot below which nothing resists a motion.
LOOSE_PIVOT = 1e-9


class PairedCompliance:
    """Compliance of the unknowns m and of the points, all points released.

    Args:
        S: Stiffness of m and the jumps (n + p, n + p) [N/mm]; overwritten.
        Q: Displacement of the points by m in this stiffness (p, n).
    """

    def __init__(self, S: Floats, Q: csr_array) -> None:
        self._first_pairs, n = Q, Q.shape[1]
        S[:, :n] -= S[:, n:] @ Q
        S[:n] -= Q.T @ S[n:]
        spring = S.diagonal().max()
        _, pivots, rank, _ = lapack.dpstrf(S, tol=LOOSE_PIVOT * spring)
        self._spring_rows = pivots[rank:] - 1
        S[self._spring_rows, self._spring_rows] += spring
        self._compliance = _inverse(S)
        spring_compliance = self._compliance[np.ix_(self._spring_rows, self._spring_rows)]
        self._spring_removal = np.eye(len(spring_compliance)) / spring - spring_compliance

    def constrain(self, Q: csr_array) -> Floats:
        """Return the stiffness S of the jumps for other pairs Q (p, p) [N/mm]."""
        self._Q, n, followed_unknowns = Q, Q.shape[1], np.unique(Q.indices)
        V = Q[:, followed_unknowns] @ self._compliance[np.ix_(followed_unknowns, followed_unknowns)]
        half_term = Q[:, followed_unknowns] @ V.T / 2 - Q @ self._compliance[:n, n:]
        S = _inverse(self._compliance[n:, n:] + half_term + half_term.T)
        N = self._jumps_by_motions(self._compliance[:, self._spring_rows])
        self._Y = S @ N
        self._H = np.linalg.inv(self._spring_removal + N.T @ self._Y)
        self._S = S - self._Y @ self._H @ self._Y.T
        return self._S

    def _jumps_by_motions(self, v: Floats) -> Floats:
        """Return F v: jumps of the points by motions v of the unknowns."""
        n = self._Q.shape[1]
        return np.asarray(v[n:] - self._Q @ v[:n])

    def solve(self, g: Floats, q: Floats) -> tuple[Floats, Floats]:
        """Return the forces that hold jumps q under forces g, and the motions of m and the jumps.

        Forces g and the motions of the jumps refer to the first pairs.
        """
        n, spring_rows = self._Q.shape[1], self._spring_rows
        motion_by_forces = self._compliance @ np.concatenate(
            [g[:n] - self._first_pairs.T @ g[n:], g[n:]]
        )
        remaining_jumps = q - self._jumps_by_motions(motion_by_forces)
        forces = self._S @ remaining_jumps - self._Y @ (self._H @ motion_by_forces[spring_rows])
        m = motion_by_forces[:n] + self._compliance[:n] @ np.concatenate(
            [-(self._Q.T @ forces), forces]
        )
        m += self._compliance[:n, spring_rows] @ (
            self._H @ (motion_by_forces[spring_rows] + self._Y.T @ remaining_jumps)
        )
        return forces, np.concatenate([m, q + self._Q @ m - self._first_pairs @ m])


def _inverse(S: Floats) -> Floats:
    """Inverse of a symmetric positive definite matrix.

    Raises:
        ArithmeticError: It is not positive definite.
    """
    L, failed_pivot = lapack.dpotrf(S)
    if failed_pivot:
        raise ArithmeticError("LAPACK: bodies have no stiffness")
    A, _ = lapack.dpotri(L, overwrite_c=True)
    return np.asarray(A + np.triu(A, 1).T)  # entries below the diagonal are zero
