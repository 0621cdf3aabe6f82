"""Sparse Cholesky factors by CHOLMOD that stop before the last unknowns.

PETSc accepts no ordering from outside and shows no block of a factor. The module therefore calls
CHOLMOD directly.

CHOLMOD has no call for a Schur complement, but computes one: before it factors the last supernode,
the block of this supernode holds :math:`-E^T A^{-1} E`. The first pivot of the block is set to -1,
so that LAPACK stops there at once. CHOLMOD then calls its error handler, which copies the block.
"""

from __future__ import annotations

from functools import cache, partial
from pathlib import Path
from typing import Any

import cffi
import numpy as np
from scipy.sparse import csc_array, csr_array

from app.foundation.arrays import Floats, Ints
from app.numerics.compiled import compiled
from app.numerics.dense import mirror_upper

# What is used of CHOLMOD; cffi finds what the dots stand for in its header.
C_DECLARATIONS = """
struct cholmod_method_struct { int ordering; ...; };
typedef struct { int supernodal, nmethods, status, postorder; double fl, lnz; double zrelax[3];
                 struct cholmod_method_struct method[...]; ...; } cholmod_common;
typedef struct { size_t nrow, ncol, nzmax; void *p, *i, *x; int stype, itype, xtype, dtype, sorted,
                 packed; ...; } cholmod_sparse;
typedef struct { size_t nrow, ncol, nzmax, d; void *x; int xtype, dtype; ...; } cholmod_dense;
typedef struct { size_t n, nsuper; void *super, *pi, *px, *x; ...; } cholmod_factor;
int cholmod_l_start(cholmod_common *);
int cholmod_l_finish(cholmod_common *);
int cholmod_l_metis(cholmod_sparse *, int64_t *, size_t, int, int64_t *, cholmod_common *);
int cholmod_l_etree(cholmod_sparse *, int64_t *, cholmod_common *);
int64_t cholmod_l_postorder(int64_t *, size_t, int64_t *, int64_t *, cholmod_common *);
cholmod_factor *cholmod_l_analyze_p(cholmod_sparse *, int64_t *, int64_t *, size_t,
                                    cholmod_common *);
cholmod_dense *cholmod_l_solve(int, cholmod_factor *, cholmod_dense *, cholmod_common *);
int cholmod_l_free_dense(cholmod_dense **, cholmod_common *);
int cholmod_l_free_factor(cholmod_factor **, cholmod_common *);
size_t factorize_but_last(cholmod_sparse *, cholmod_factor *, double *, size_t, size_t,
                          cholmod_common *);
#define CHOLMOD_GIVEN ...
#define CHOLMOD_SUPERNODAL ...
#define CHOLMOD_REAL ...
#define CHOLMOD_PATTERN ...
#define CHOLMOD_LONG ...
#define CHOLMOD_L ...
#define CHOLMOD_Lt ...
"""
HEADER = "suitesparse/cholmod.h"
# The handler of CHOLMOD's errors has no user argument: the place that it copies is static.
C_SOURCE = """
#include <string.h>
static struct { cholmod_factor *L; double *to; size_t start, count; } last;
static void copy_last(int status, const char *file, int line, const char *message)
{
    if (status == CHOLMOD_NOT_POSDEF && last.L->x)
        memcpy(last.to, (double *) last.L->x + last.start, last.count * sizeof(double));
}
/* Factor all but the last supernode of size columns, the block of which is copied and becomes the
   identity. Returns the column at which CHOLMOD stopped, or n + 1 after another error. */
static size_t factorize_but_last(cholmod_sparse *A, cholmod_factor *L, double *to, size_t start,
                                 size_t size, cholmod_common *common)
{
    int print = common->print;
    size_t stopped, k;
    last.L = L; last.to = to; last.start = start; last.count = size * size;
    common->print = 0;
    common->error_handler = copy_last;
    cholmod_l_factorize(A, L, common);
    common->error_handler = NULL;
    common->print = print;
    if (common->status != CHOLMOD_NOT_POSDEF || !L->x) return L->n + 1;
    stopped = L->minor;
    L->minor = L->n;
    common->status = CHOLMOD_OK;
    for (k = 0; k < size; k++) ((double *) L->x)[start + k * (size + 1)] = 1.0;
    return stopped;
}
"""
# Columns of the last supernode that CHOLMOD never joins with others (its nrelax[2] is 48).
SEPARATE_COLUMNS = 49


@cache
def library() -> Any:
    """CHOLMOD; None where it cannot be compiled against."""
    try:
        return compiled(
            "cholmod",
            C_DECLARATIONS,
            f"#include <{HEADER}>\n{C_SOURCE}",
            version=(Path("/usr/include") / HEADER).read_text(),
            libraries=["cholmod"],
        )
    except (OSError, ImportError, cffi.VerificationError):
        return None


def _free_factors(ffi: Any, lib: Any, common: Any, L: Any) -> None:
    lib.cholmod_l_free_factor(ffi.new("cholmod_factor **", L), common)
    lib.cholmod_l_finish(common)


class Cholesky:
    r"""Factors of A in :math:`\begin{pmatrix} A & E \\ E^T & 0 \end{pmatrix}`, by CHOLMOD.

    The last supernode has the columns of E behind some empty ones, the first of which has entries
    in all its rows. A does not meet the empty ones, so that CHOLMOD joins this supernode with no
    other.

    Attributes:
        entries: Entries of the factors.

    Args:
        rows: A and E side by side (n, n + m), A symmetric positive definite, n and m multiples of
            three; each three unknowns are a node.
    """

    def __init__(self, rows: csr_array) -> None:
        module = library()
        self._ffi, self._lib = module.ffi, module.lib
        common = self._common = self._ffi.new("cholmod_common *")
        self._lib.cholmod_l_start(common)
        self._eliminated, self._kept = rows.shape[0], rows.shape[1] - rows.shape[0]
        self._empty_columns = max(1, SEPARATE_COLUMNS - self._kept)
        self._pattern = rows.indptr, rows.indices
        self._elimination_order = self._ordering(rows)
        common.nmethods, common.supernodal = 1, self._lib.CHOLMOD_SUPERNODAL
        common.method[0].ordering = self._lib.CHOLMOD_GIVEN
        common.postorder, common.zrelax[2] = 0, 0.0
        matrix, referenced = self._sparse(self._with_empty_columns(rows))
        null = self._ffi.NULL
        L = self._lib.cholmod_l_analyze_p(
            matrix, self._int_pointer(self._elimination_order), null, 0, common
        )
        # Nothing that refers to this object: in a circle the factors would never be freed.
        self._L = self._ffi.gc(L, partial(_free_factors, self._ffi, self._lib, common))
        del referenced
        self.entries = float(common.lnz)
        last_starts = (self._array("int64_t", p, L.nsuper + 1) for p in (L.super, L.px))
        (last_supernode, block_start) = (int(v[-2]) for v in last_starts)
        if last_supernode != self._eliminated:
            raise ArithmeticError(
                f"CHOLMOD: the last supernode begins at {last_supernode}, not {self._eliminated}"
            )
        self._last_block_start = block_start

    def _int_pointer(self, values: Ints) -> Any:
        return self._ffi.cast("int64_t *", values.ctypes.data)

    def _array(self, kind: str, pointer: Any, size: int) -> Any:
        dtype = np.int64 if kind == "int64_t" else np.float64
        return np.frombuffer(
            self._ffi.buffer(self._ffi.cast(f"{kind} *", pointer), 8 * size), dtype
        )

    def _with_empty_columns(self, rows: csr_array) -> csc_array:
        """The whole matrix, with the empty columns; entries below its diagonal are not read."""
        n, last_size = self._eliminated, self._empty_columns + self._kept
        E = rows[:, n:]
        # Row n has entries in all columns from n on.
        data = np.concatenate([E.data, [-1.0], np.zeros(last_size - 1)])
        columns = np.concatenate([E.indices + self._empty_columns, np.arange(last_size)])
        row_ends = np.append(E.indptr, E.nnz + last_size)
        E = csr_array((data, columns, row_ends), shape=(n + 1, last_size)).tocsc()
        # Rows of a symmetric matrix are its columns.
        data = np.concatenate([rows.data, E.data])
        indices = np.concatenate([rows.indices, E.indices])
        row_ends = np.concatenate([rows.indptr, rows.nnz + E.indptr[1:]])
        return csc_array((data, indices, row_ends), shape=(n + last_size, n + last_size))

    def _sparse(self, A: csc_array, pattern: bool = False) -> tuple[Any, Any]:
        """The upper triangle for CHOLMOD, and arrays that have to live as long."""
        p, i = A.indptr.astype(np.int64), A.indices.astype(np.int64)
        ffi, lib = self._ffi, self._lib
        matrix = ffi.new("cholmod_sparse *")
        (matrix.nrow, matrix.ncol), matrix.nzmax = A.shape, A.nnz
        matrix.p, matrix.i = (ffi.cast("void *", v.ctypes.data) for v in (p, i))
        matrix.x = ffi.NULL if pattern else ffi.cast("void *", A.data.ctypes.data)
        matrix.stype, matrix.itype = 1, lib.CHOLMOD_LONG
        matrix.xtype = lib.CHOLMOD_PATTERN if pattern else lib.CHOLMOD_REAL
        matrix.packed, matrix.sorted = 1, 0
        return matrix, (p, i, A)

    def _ordering(self, rows: csr_array) -> Ints:
        """Nested dissection of the graph of nodes of A, in postorder; the other columns stay last.

        CHOLMOD's postorder of the whole matrix would move these.
        """
        n, nodes = self._eliminated, self._eliminated // 3
        row = np.repeat(np.arange(n) // 3, np.diff(rows.indptr))
        inside = rows.indices < n
        node_pairs = row[inside], rows.indices[inside] // 3
        graph = csc_array(
            (np.ones(len(node_pairs[0]), dtype=np.int8), node_pairs), shape=(nodes, nodes)
        )
        graph.sum_duplicates()
        order, parent, postorder = np.empty((3, nodes), dtype=np.int64)
        null = self._ffi.NULL
        matrix, referenced = self._sparse(graph, pattern=True)
        self._lib.cholmod_l_metis(matrix, null, 0, 1, self._int_pointer(order), self._common)
        matrix, referenced = self._sparse(graph[:, order][order], pattern=True)
        self._lib.cholmod_l_etree(matrix, self._int_pointer(parent), self._common)
        self._lib.cholmod_l_postorder(
            self._int_pointer(parent), nodes, null, self._int_pointer(postorder), self._common
        )
        del referenced
        unknowns = (3 * order[postorder][:, None] + np.arange(3)).ravel()
        return np.append(unknowns, np.arange(n, n + self._empty_columns + self._kept))

    def fits(self, rows: csr_array) -> bool:
        """Return True if a matrix has the pattern that was analysed."""
        return all(map(np.array_equal, self._pattern, (rows.indptr, rows.indices)))

    def factorize(self, rows: csr_array) -> Floats:
        """Factor a matrix that fits.

        Returns:
            The Schur complement of the last unknowns, :math:`-E^T A^{-1} E` (m, m).

        Raises:
            ArithmeticError: A is not positive definite, or memory does not suffice.
        """
        matrix, referenced = self._sparse(self._with_empty_columns(rows))
        size = self._empty_columns + self._kept
        block = np.empty((size, size))
        target = self._ffi.cast("double *", block.ctypes.data)
        arguments = matrix, self._L, target, self._last_block_start, size, self._common
        stopped = self._lib.factorize_but_last(*arguments)
        del referenced
        if stopped != self._eliminated:
            reason = (
                f"status {self._common.status}"
                if stopped > self._eliminated
                else f"pivot {stopped}"
            )
            raise ArithmeticError(f"CHOLMOD: {reason} of {self._eliminated:,} unknowns")
        # LAPACK's lower triangle, by columns, is the upper one by rows.
        S = np.ascontiguousarray(block[self._empty_columns :, self._empty_columns :])
        return mirror_upper(S)

    def reduce(self, b: Floats) -> Floats:
        """Forces on the last unknowns that b (n,) causes, :math:`-E^T A^{-1} b` (m,)."""
        self._forward_solution = np.concatenate([b, np.zeros(self._empty_columns + self._kept)])[
            self._elimination_order
        ]
        if b.any():  # between the cycles of a load there are no such forces
            self._forward_solution = self._solve(self._lib.CHOLMOD_L, self._forward_solution)
        return self._forward_solution[self._eliminated + self._empty_columns :].copy()

    def expand(self, x: Floats) -> Floats:
        """The first unknowns :math:`A^{-1} (b - E x)` (n,), with b as last reduced."""
        self._forward_solution[self._eliminated : self._eliminated + self._empty_columns] = 0.0
        self._forward_solution[self._eliminated + self._empty_columns :] = x
        unknowns = np.empty(self._eliminated)
        unknowns[self._elimination_order[: self._eliminated]] = self._solve(
            self._lib.CHOLMOD_Lt, self._forward_solution
        )[: self._eliminated]
        return unknowns

    def _solve(self, factor: int, b: Floats) -> Floats:
        """Solution of L x = b or L^T x = b, in the order of the factors."""
        ffi, lib = self._ffi, self._lib
        right_side = ffi.new("cholmod_dense *")
        right_side.nrow = right_side.nzmax = right_side.d = len(b)
        right_side.ncol, right_side.xtype = 1, lib.CHOLMOD_REAL
        right_side.x = ffi.cast("void *", b.ctypes.data)
        solution = lib.cholmod_l_solve(factor, self._L, right_side, self._common)
        x = self._array("double", solution.x, len(b)).copy()
        lib.cholmod_l_free_dense(ffi.new("cholmod_dense **", solution), self._common)
        return np.asarray(x)
