"""Products with a symmetric matrix in single precision, for smoothers.

A smoother reads the matrix some ten times for each Krylov iteration, and its result is corrected by
the next iteration. Blocks of three of the upper triangle in single precision have a quarter of the
bytes of the whole matrix. A product takes 0.4 of the time of PETSc's one (153 000 unknowns).
"""

from __future__ import annotations

from functools import cache
from typing import Any

from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray

from app.foundation.arrays import Ints
from app.numerics.compiled import compiled
from app.numerics.lifetime import python_mat
from app.numerics.sparse import owned_rows

C_DECLARATIONS = """
void multiply(int64_t n, int64_t ghosts, const int64_t *start, const int64_t *upper,
              const int32_t *columns, const float *blocks, const double *x,
              const double *x_ghosts, double *y, float *x4, float *y4);
"""
# Nodes have four components, the last of which is never read: compilers use vector instructions.
C_SOURCE = """
#include <stdint.h>
#include <string.h>
typedef float four __attribute__((vector_size(16)));
typedef float three __attribute__((vector_size(16), aligned(4)));  /* and one that is not used */
static void pad(int64_t n, const double *x, float *x4)
{
    for (int64_t i = 0; i < n; i++) {
        for (int c = 0; c < 3; c++) x4[4 * i + c] = (float) x[3 * i + c];
        x4[4 * i + 3] = 0;
    }
}
/* y = A x. Row i has blocks without their transposes from start[i] on: the diagonal block and those
   of ghosts; and blocks of the upper triangle from upper[i] on, which stand for both triangles. */
static void multiply(int64_t n, int64_t ghosts, const int64_t *start, const int64_t *upper,
                     const int32_t *columns, const float *blocks, const double *x,
                     const double *x_ghosts, double *y, float *x4, float *y4)
{
    four *X = (four *) x4, *Y = (four *) y4;
    pad(n, x, x4);
    pad(ghosts, x_ghosts, x4 + 4 * n);
    memset(y4, 0, 16 * n);
    for (int64_t i = 0; i < n; i++) {
        four s0 = {0}, s1 = {0}, s2 = {0}, Xi = X[i];
        int64_t k = start[i];
        for (; k < upper[i]; k++) {
            const float *b = blocks + 9 * k;
            four Xj = X[columns[k]];
            s0 += *(const three *) b * Xj;
            s1 += *(const three *) (b + 3) * Xj;
            s2 += *(const three *) (b + 6) * Xj;
        }
        for (; k < start[i + 1]; k++) {
            const float *b = blocks + 9 * k;
            int32_t j = columns[k];
            four Xj = X[j];
            four b0 = *(const three *) b;
            four b1 = *(const three *) (b + 3);
            four b2 = *(const three *) (b + 6);
            s0 += b0 * Xj;
            s1 += b1 * Xj;
            s2 += b2 * Xj;
            Y[j] += b0 * Xi[0] + b1 * Xi[1] + b2 * Xi[2];
        }
        y[3 * i] = y4[4 * i] + s0[0] + s0[1] + s0[2];
        y[3 * i + 1] = y4[4 * i + 1] + s1[0] + s1[1] + s1[2];
        y[3 * i + 2] = y4[4 * i + 2] + s2[0] + s2[1] + s2[2];
    }
}
"""
# Nodes whose rows are converted at a time; all at once would need several times the memory.
NODES_AT_A_TIME = 50_000


@cache
def _library() -> Any:
    return compiled("single_precision", C_DECLARATIONS, C_SOURCE, flags=["-O2"])


class SinglePrecision:
    """A symmetric matrix of blocks of three in single precision, as it is when this is made.

    Attributes:
        matrix: The matrix for PETSc, which works while this object lives.

    Args:
        A: The matrix in double precision; collective.
    """

    def __init__(self, A: PETSc.Mat) -> None:
        library = _library()
        self._ffi, self._multiply = library.ffi, library.lib.multiply
        begin, end = (row // 3 for row in A.getOwnershipRange())
        n = end - begin
        rows, columns, blocks = _blocks_to_store(A)
        is_owned = (columns >= begin) & (columns < end)
        ghosts = np.unique(columns[~is_owned])
        columns = np.where(is_owned, columns - begin, n + np.searchsorted(ghosts, columns))
        is_upper = is_owned & (columns > rows)
        order = np.lexsort((is_upper, rows))
        self._start = np.append(0, np.cumsum(np.bincount(rows, minlength=n)))
        self._upper = self._start[:-1] + np.bincount(rows[~is_upper], minlength=n)
        self._columns = columns[order].astype(np.int32)
        # The vector of the last row of a block ends with one number that is not used.
        self._blocks = np.append(blocks[order].ravel(), np.float32(0.0))
        self._ghosts = PETSc.Vec().createSeq(3 * len(ghosts), comm=PETSc.COMM_SELF)
        places = PETSc.IS().createBlock(3, ghosts.astype(PETSc.IntType), comm=A.comm)
        self._scatter = PETSc.Scatter().create(A.createVecRight(), places, self._ghosts, None)
        self._x4, self._y4 = (np.empty(4 * size, np.float32) for size in (n + len(ghosts), n))
        self._sizes = n, len(ghosts)
        self.matrix = python_mat(self, (3 * n, A.getSize()[0]), A.comm)

    def mult(self, A: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Apply to x, into y; collective."""
        self._scatter.scatter(x, self._ghosts, mode=PETSc.ScatterMode.FORWARD)
        self._multiply(
            *self._sizes,
            self._pointer("int64_t", self._start),
            self._pointer("int64_t", self._upper),
            self._pointer("int32_t", self._columns),
            self._pointer("float", self._blocks),
            self._pointer("double", x.array_r),
            self._pointer("double", self._ghosts.array_r),
            self._pointer("double", y.array_w),
            self._pointer("float", self._x4),
            self._pointer("float", self._y4),
        )

    def _pointer(self, kind: str, values: NDArray) -> Any:
        return self._ffi.cast(f"{kind} *", values.ctypes.data)


def _blocks_to_store(A: PETSc.Mat) -> tuple[Ints, Ints, NDArray[np.float32]]:
    """Local row, global column and values (n, 3, 3) of blocks; no lower triangle of owned nodes."""
    begin, end = (row // 3 for row in A.getOwnershipRange())
    scalar_rows = owned_rows(A)
    parts = []
    # At least once: a rank without nodes has empty arrays.
    for first in range(0, max(end - begin, 1), NODES_AT_A_TIME):
        last = min(first + NODES_AT_A_TIME, end - begin)
        rows = scalar_rows[3 * first : 3 * last].tobsr((3, 3))
        row = first + np.repeat(np.arange(last - first), np.diff(rows.indptr))
        is_stored = (rows.indices < begin) | (rows.indices >= begin + row)
        parts.append(
            (row[is_stored], rows.indices[is_stored], rows.data[is_stored].astype(np.float32))
        )
    rows_of_parts, columns_of_parts, blocks_of_parts = zip(*parts, strict=True)
    return (
        np.concatenate(rows_of_parts),
        np.concatenate(columns_of_parts),
        np.concatenate(blocks_of_parts),
    )
