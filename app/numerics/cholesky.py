"""Sparse Cholesky factors by CHOLMOD whose last block is at hand.

PETSc takes no ordering of ours and shows no block of a factor. cffi compiles the calls at first
use, in the cache of compiled forms.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import tempfile
from functools import cache, partial
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Any

import cffi
import numpy as np
from dolfinx import jit
from scipy.linalg import blas, lapack
from scipy.sparse import csc_array

from app.arrays import Floats, Ints
from app.captured import captured

# What is used of CHOLMOD; cffi finds what the dots stand for in its header.
CALLS = """
struct cholmod_method_struct { int ordering; ...; };
typedef struct { int supernodal, nmethods, status; double fl, lnz;
                 struct cholmod_method_struct method[...]; ...; } cholmod_common;
typedef struct { size_t nrow, ncol, nzmax; void *p, *i, *x; int stype, itype, xtype, dtype, sorted,
                 packed; ...; } cholmod_sparse;
typedef struct { size_t nrow, ncol, nzmax, d; void *x; int xtype, dtype; ...; } cholmod_dense;
typedef struct { size_t nsuper; void *Perm, *super, *pi, *px, *x; ...; } cholmod_factor;
int cholmod_l_start(cholmod_common *);
int cholmod_l_finish(cholmod_common *);
int cholmod_l_metis(cholmod_sparse *, int64_t *, size_t, int, int64_t *, cholmod_common *);
cholmod_factor *cholmod_l_analyze_p(cholmod_sparse *, int64_t *, int64_t *, size_t,
                                    cholmod_common *);
int cholmod_l_factorize(cholmod_sparse *, cholmod_factor *, cholmod_common *);
cholmod_dense *cholmod_l_solve(int, cholmod_factor *, cholmod_dense *, cholmod_common *);
int cholmod_l_free_dense(cholmod_dense **, cholmod_common *);
int cholmod_l_free_factor(cholmod_factor **, cholmod_common *);
#define CHOLMOD_GIVEN ...
#define CHOLMOD_SUPERNODAL ...
#define CHOLMOD_REAL ...
#define CHOLMOD_PATTERN ...
#define CHOLMOD_LONG ...
#define CHOLMOD_L ...
#define CHOLMOD_Lt ...
"""
HEADER = "suitesparse/cholmod.h"


@cache
def library() -> Any:
    """CHOLMOD; None where it cannot be compiled against."""
    folder = Path(jit.get_options()["cache_dir"])
    try:
        header = (Path("/usr/include") / HEADER).read_text()
        name = f"mantle_cholmod_{hashlib.sha256((CALLS + header).encode()).hexdigest()[:12]}"
        path = folder / (name + EXTENSION_SUFFIXES[0])
        if not path.exists():
            folder.mkdir(parents=True, exist_ok=True)
            ffi = cffi.FFI()
            ffi.cdef(CALLS)
            ffi.set_source(name, f"#include <{HEADER}>", libraries=["cholmod"])
            with tempfile.TemporaryDirectory(dir=folder) as own, captured("cffi"):
                os.replace(ffi.compile(tmpdir=own), path)
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec and spec.loader
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    except (OSError, ImportError, cffi.VerificationError):
        return None
    return module


def _free(ffi: Any, lib: Any, common: Any, L: Any) -> None:
    lib.cholmod_l_free_factor(ffi.new("cholmod_factor **", L), common)
    lib.cholmod_l_finish(common)


class Cholesky:
    """Factors L L^T of a symmetric matrix, ordered by nodes of three unknowns, some nodes last.

    Attributes:
        flops, entries: Floating-point operations of the factorization, entries of L.

    Args:
        A: The matrix. Each of its last unknowns has entries in the columns of the first three of
            these: they are one block.
        last: Number of unknowns, the last ones of A, that stay last.
    """

    def __init__(self, A: csc_array, last: int) -> None:
        module = library()
        self._ffi, self._lib = module.ffi, module.lib
        self._common = self._ffi.new("cholmod_common *")
        self._lib.cholmod_l_start(self._common)
        self._n, self._last = A.shape[0], last
        self._pattern = A.indptr, A.indices
        order = self._ordering(A)
        common = self._common
        common.nmethods, common.supernodal = 1, self._lib.CHOLMOD_SUPERNODAL
        common.method[0].ordering = self._lib.CHOLMOD_GIVEN
        matrix, kept = self._sparse(A)
        none = self._ffi.NULL
        L = self._lib.cholmod_l_analyze_p(matrix, self._ints(order), none, 0, common)
        # Nothing that refers to this object: in a circle the factors would never be freed.
        self._L = self._ffi.gc(L, partial(_free, self._ffi, self._lib, common))
        del kept
        self.flops, self.entries = float(common.fl), float(common.lnz)

    def _ints(self, values: Ints) -> Any:
        return self._ffi.cast("int64_t *", values.ctypes.data)

    def _sparse(self, A: csc_array, pattern: bool = False) -> tuple[Any, Any]:
        """The upper triangle for CHOLMOD, and arrays that have to live as long."""
        p, i = A.indptr.astype(np.int64), A.indices.astype(np.int64)
        ffi, lib = self._ffi, self._lib
        found = ffi.new("cholmod_sparse *")
        (found.nrow, found.ncol), found.nzmax = A.shape, A.nnz
        found.p, found.i = (ffi.cast("void *", v.ctypes.data) for v in (p, i))
        found.x = ffi.NULL if pattern else ffi.cast("void *", A.data.ctypes.data)
        found.stype, found.itype = 1, lib.CHOLMOD_LONG
        found.xtype = lib.CHOLMOD_PATTERN if pattern else lib.CHOLMOD_REAL
        found.packed, found.sorted = 1, int(A.has_sorted_indices)
        return found, (p, i, A)

    def _ordering(self, A: csc_array) -> Ints:
        """Nested dissection of the graph of nodes, the last ones taken out and appended."""
        nodes, free = self._n // 3, (self._n - self._last) // 3
        rows = A.indices // 3
        columns = np.repeat(np.arange(self._n) // 3, np.diff(A.indptr))
        graph = csc_array((np.ones(len(rows), dtype=np.int8), (rows, columns)), (nodes, nodes))
        graph.sum_duplicates()
        order = np.empty(nodes, dtype=np.int64)
        matrix, kept = self._sparse(graph, pattern=True)
        self._lib.cholmod_l_metis(matrix, self._ffi.NULL, 0, 1, self._ints(order), self._common)
        del kept
        order = np.concatenate([order[order < free], np.arange(free, nodes)])
        return np.ascontiguousarray((3 * order[:, None] + np.arange(3)).ravel())

    def fits(self, A: csc_array) -> bool:
        """Whether a matrix has the pattern that was analysed."""
        return all(map(np.array_equal, self._pattern, (A.indptr, A.indices)))

    def factorize(self, A: csc_array) -> None:
        """Compute the factors of a matrix that fits.

        Raises:
            ArithmeticError: It is not positive definite, or memory does not suffice.
        """
        matrix, kept = self._sparse(A)
        self._lib.cholmod_l_factorize(matrix, self._L, self._common)
        del kept
        if self._common.status:
            raise ArithmeticError(f"CHOLMOD: status {self._common.status}")
        self._order = self._array("int64_t", self._L.Perm, self._n)
        self._tail = self._order[self._n - self._last :] - (self._n - self._last)
        if self._tail.min() < 0:
            raise ArithmeticError("CHOLMOD: the last unknowns were moved")

    def _array(self, kind: str, pointer: Any, size: int) -> Any:
        dtype = np.int64 if kind == "int64_t" else np.float64
        return np.frombuffer(
            self._ffi.buffer(self._ffi.cast(f"{kind} *", pointer), 8 * size), dtype
        )

    def _triangle(self) -> Floats:
        """The last supernode of L (m, m), a view in Fortran's order; its upper triangle is void."""
        L = self._L
        heads, widths, starts = (
            self._array("int64_t", pointer, L.nsuper + 1) for pointer in (L.super, L.pi, L.px)
        )
        m = int(widths[-1] - widths[-2])
        if m != heads[-1] - heads[-2] or m < self._last:
            raise ArithmeticError("CHOLMOD: the last unknowns are in several supernodes")
        block = self._array("double", L.x, int(starts[-1]))[starts[-2] :]
        return block.reshape(m, m).T

    def schur(self) -> Floats:
        """The Schur complement of the last unknowns, in the order of the matrix (m, m)."""
        # L L^T is U U^T of the lower triangle read from its other end.
        U = np.asfortranarray(self._triangle()[: -self._last - 1 : -1, : -self._last - 1 : -1])
        S, _ = lapack.dlauum(U, lower=0, overwrite_c=1)
        S = np.triu(S)
        S += np.triu(S, 1).T
        back = np.argsort(self._tail[::-1])
        return np.ascontiguousarray(S[np.ix_(back, back)])

    def down(self, b: Floats) -> Floats:
        """Solution of L y = b, in the order of L (n,)."""
        return self._solve(self._lib.CHOLMOD_L, b[self._order])

    def up(self, y: Floats) -> Floats:
        """Solution of L^T x = y, in the order of the matrix (n,)."""
        x = np.empty(self._n)
        x[self._order] = self._solve(self._lib.CHOLMOD_Lt, y)
        return x

    def last(self, y: Floats, transposed: bool = False) -> Floats:
        """Last block of L times y: from the order of L to that of the matrix, or transposed."""
        triangle = self._triangle()
        full = np.zeros(len(triangle))
        full[-self._last :] = y[self._tail] if transposed else y
        found = blas.dtrmv(triangle, full, lower=1, trans=int(transposed))[-self._last :]
        return np.asarray(found if transposed else found[np.argsort(self._tail)])

    def _solve(self, which: int, b: Floats) -> Floats:
        ffi, lib = self._ffi, self._lib
        right, b = ffi.new("cholmod_dense *"), np.ascontiguousarray(b)
        right.nrow = right.nzmax = right.d = self._n
        right.ncol, right.xtype = 1, lib.CHOLMOD_REAL
        right.x = ffi.cast("void *", b.ctypes.data)
        found = lib.cholmod_l_solve(which, self._L, right, self._common)
        x = self._array("double", found.x, self._n).copy()
        lib.cholmod_l_free_dense(ffi.new("cholmod_dense **", found), self._common)
        return np.asarray(x)
