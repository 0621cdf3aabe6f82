"""Sparse factors of a block of a symmetric matrix, with the Schur complement of the rest.

`Factor` is the interface of the libraries, `factor_class` chooses one of them.
"""

from __future__ import annotations

from functools import cache
from typing import Protocol

from petsc4py import PETSc

from scipy.sparse import csr_array

from app.foundation.arrays import Floats


class Factor(Protocol):
    r"""Factors of A in :math:`\begin{pmatrix} A & E \\ E^T & 0 \end{pmatrix}`.

    Made from A and E side by side (n, n + m), A symmetric positive definite. Each three unknowns
    are a node.

    Attributes:
        entries: Entries of the factors.
    """

    entries: float

    def __init__(self, rows: csr_array) -> None: ...

    def factorize(self, rows: csr_array) -> Floats:
        """Factor a matrix of the pattern that was analysed.

        Returns:
            The Schur complement of the last unknowns, :math:`-E^T A^{-1} E` (m, m).

        Raises:
            ArithmeticError: A is not positive definite, or memory does not suffice.
        """

    def reduce(self, b: Floats) -> Floats:
        """Forces on the last unknowns that b (n,) causes, :math:`-E^T A^{-1} b` (m,)."""

    def expand(self, x: Floats) -> Floats:
        """The first unknowns :math:`A^{-1} (b - E x)` (n,), with b as last reduced."""


@cache
def factor_class() -> type[Factor] | None:
    """CHOLMOD where it can be compiled against, else MUMPS where PETSc has it, else None."""
    from app.numerics import cholesky, mumps  # compiles the calls of CHOLMOD

    if cholesky.library() is not None:
        return cholesky.Cholesky
    return mumps.Mumps if PETSc.Sys.hasExternalPackage("mumps") else None
