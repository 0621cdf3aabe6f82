"""Sparse factors by MUMPS, with a Schur complement.

PETSc has these, but petsc4py does not: ctypes calls PETSc with the handles of petsc4py's objects.
"""

from __future__ import annotations

import ctypes
import weakref
from functools import cache
from typing import Any

from petsc4py import PETSc

import numpy as np
from scipy.sparse import csr_array, vstack

from app.foundation.arrays import Floats
from app.numerics.dense import mirror_upper

# Numbers of MUMPS' controls, and the values that they get.
ORDERING_CONTROL = 7  # of elimination
METIS = 5  # nested dissection by METIS
SPACE_CONTROL = 14  # working space beyond the estimate [%]
EXTRA_SPACE = 50
SYSTEM_CONTROL = 26  # system that is solved
WITHOUT_SCHUR = 0  # A alone
# Numbers of its results.
ENTRIES = 20  # of the factors; in millions if negative
ERROR_RESULT = 1
NEGATIVE_PIVOTS = 12  # number of negative pivots
FACTOR_CHOLESKY = 2  # of PETSc's MatFactorType


@cache
def _petsc() -> ctypes.CDLL:
    return ctypes.CDLL(PETSc.__file__)


def _call(name: str, *arguments: Any) -> None:
    error = getattr(_petsc(), name)(*arguments)
    if error:
        raise ArithmeticError(f"{name} of PETSc: error {error}")


def _pointer(handle: int) -> ctypes.c_void_p:
    return ctypes.c_void_p(handle)


def _destroy(F: ctypes.c_void_p) -> None:
    if not PETSc.Sys.isFinalized():
        _call("MatDestroy", ctypes.byref(F))


class Mumps:
    """Factors by MUMPS, on one rank: see `app.numerics.factor.Factor`."""

    def __init__(self, rows: csr_array) -> None:
        self._eliminated, self._kept = rows.shape[0], rows.shape[1] - rows.shape[0]
        self.entries = 0.0
        if not self._eliminated:  # MUMPS refuses this
            return
        A = self._matrix(rows)
        F = self._F = ctypes.c_void_p()
        _call("MatGetFactor", _pointer(A.handle), b"mumps", FACTOR_CHOLESKY, ctypes.byref(F))
        weakref.finalize(self, _destroy, F)
        kept_rows = PETSc.IS().createStride(self._kept, self._eliminated, 1, A.comm)
        _call("MatFactorSetSchurIS", F, _pointer(kept_rows.handle))
        for control, value in ((ORDERING_CONTROL, METIS), (SPACE_CONTROL, EXTRA_SPACE)):
            _call("MatMumpsSetIcntl", F, control, value)
        self._info = (ctypes.c_double * 32)()  # longer than PETSc's MatFactorInfo
        _call("MatFactorInfoInitialize", self._info)
        _call("MatCholeskyFactorSymbolic", F, _pointer(A.handle), None, self._info)
        self._check()
        entries = self._result(ENTRIES)
        self.entries = float(entries if entries >= 0 else -1_000_000 * entries)

    def _matrix(self, rows: csr_array) -> PETSc.Mat:
        """The whole matrix, its upper triangle right."""
        n, m = self._eliminated, self._kept
        diagonal = csr_array((np.zeros(m), np.arange(n, n + m), np.arange(m + 1)), shape=(m, n + m))
        whole_matrix = vstack([rows, diagonal], format="csr")
        whole_matrix.sort_indices()
        row_starts, columns = (
            v.astype(PETSc.IntType) for v in (whole_matrix.indptr, whole_matrix.indices)
        )
        arrays = row_starts, columns, whole_matrix.data
        A = PETSc.Mat().createAIJ(whole_matrix.shape, csr=arrays, comm=PETSc.COMM_SELF)
        A.setOption(PETSc.Mat.Option.SPD, True)
        return A

    def _result(self, number: int) -> int:
        value = ctypes.c_int()
        _call("MatMumpsGetInfog", self._F, number, ctypes.byref(value))
        return value.value

    def _check(self) -> None:
        error = self._result(ERROR_RESULT)
        if error:
            raise ArithmeticError(f"MUMPS: error {error}")
        negative = self._result(NEGATIVE_PIVOTS)
        if negative:
            raise ArithmeticError(f"MUMPS: {negative} negative pivots")

    def factorize(self, rows: csr_array) -> Floats:
        """Factor a matrix of the pattern that was analysed: see `Factor`."""
        self._coupling = rows[:, self._eliminated :]
        if not self._eliminated:
            return np.zeros((self._kept, self._kept))
        A = self._matrix(rows)
        _call("MatCholeskyFactorNumeric", self._F, _pointer(A.handle), self._info)
        self._check()
        _call("MatMumpsSetIcntl", self._F, SYSTEM_CONTROL, WITHOUT_SCHUR)
        if not self._kept:  # PETSc has no complement then
            return np.zeros((0, 0))
        S, status = ctypes.c_void_p(), ctypes.c_int()
        _call("MatFactorGetSchurComplement", self._F, ctypes.byref(S), ctypes.byref(status))
        values = ctypes.POINTER(ctypes.c_double)()
        _call("MatDenseGetArrayRead", S, ctypes.byref(values))
        complement = np.ctypeslib.as_array(values, shape=(self._kept, self._kept)).copy()
        _call("MatDenseRestoreArrayRead", S, ctypes.byref(values))
        _call("MatFactorRestoreSchurComplement", self._F, ctypes.byref(S), status)
        return mirror_upper(complement)

    def reduce(self, b: Floats) -> Floats:
        """Forces on the last unknowns that b causes: see `Factor`."""
        self._first_unknowns = self._solve(b)
        return np.asarray(-(self._coupling.T @ self._first_unknowns))

    def expand(self, x: Floats) -> Floats:
        """The first unknowns, with b as last reduced: see `Factor`."""
        return self._first_unknowns - self._solve(self._coupling @ x)

    def _solve(self, b: Floats) -> Floats:
        """Solution of A x = b."""
        if not self._eliminated:
            return b
        right_side = np.concatenate([b, np.zeros(self._kept)])
        x, y = (
            PETSc.Vec().createWithArray(v, comm=PETSc.COMM_SELF)
            for v in (right_side, right_side * 0)
        )
        _call("MatSolve", self._F, _pointer(x.handle), _pointer(y.handle))
        return np.array(y.array_r[: self._eliminated])
