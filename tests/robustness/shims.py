"""A BLAS that is wrong, to go before others (LD_PRELOAD)."""

from __future__ import annotations

import subprocess
from pathlib import Path

# Calls of a routine, from the AFTERth on, give what is said instead.
BLAS = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <math.h>
#include <stdlib.h>
static long calls;
static int wrong(void) {
  const char *after = getenv("AFTER");
  return calls++ >= (after ? atol(after) : 0);
}
static void *right_one(const char *name) {  /* others load it for themselves */
  static void *blas;
  if (!blas) blas = dlopen("libblas.so.3", RTLD_LAZY | RTLD_LOCAL);
  return dlsym(blas, name);
}
static double bad(void) { return getenv("NOT_A_NUMBER") ? NAN : 0.0; }
#ifdef DGEMM
void dgemm_(char *ta, char *tb, int *m, int *n, int *k, double *alpha, double *a, int *lda,
            double *b, int *ldb, double *beta, double *c, int *ldc) {
  void (*right)() = right_one("dgemm_");
  right(ta, tb, m, n, k, alpha, a, lda, b, ldb, beta, c, ldc);
  if (wrong() && *m > 0 && *n > 0) c[0] = bad();
}
#endif
#ifdef DGEMV
void dgemv_(char *t, int *m, int *n, double *alpha, double *a, int *lda, double *x, int *incx,
            double *beta, double *y, int *incy) {
  void (*right)() = right_one("dgemv_");
  right(t, m, n, alpha, a, lda, x, incx, beta, y, incy);
  if (wrong() && *m > 0) y[0] = bad();
}
#endif
#ifdef DDOT
double ddot_(int *n, double *x, int *incx, double *y, int *incy) {
  double (*right)() = (double (*)())right_one("ddot_");
  return wrong() ? bad() : right(n, x, incx, y, incy);
}
#endif
#ifdef DNRM2
double dnrm2_(int *n, double *x, int *incx) {
  double (*right)() = (double (*)())right_one("dnrm2_");
  return wrong() ? bad() : right(n, x, incx);
}
#endif
#ifdef DAXPY
void daxpy_(int *n, double *a, double *x, int *incx, double *y, int *incy) {
  void (*right)() = right_one("daxpy_");
  if (!wrong()) right(n, a, x, incx, y, incy);
}
#endif
"""
ROUTINES = ("DGEMM", "DGEMV", "DDOT", "DNRM2", "DAXPY")


def library(folder: Path, source: str, *defined: str) -> Path:
    """A library to go before others."""
    path = folder / f"shim{'-'.join(('', *defined))}.so"
    command = ["cc", "-shared", "-fPIC", "-O1", "-w", "-std=gnu17", "-x", "c", "-", "-ldl"]
    command += ["-lm", "-o", str(path), *(f"-D{name}" for name in defined)]
    subprocess.run(command, input=source, text=True, check=True)
    return path
