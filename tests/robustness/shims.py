"""Libraries in C that go before others (LD_PRELOAD): a BLAS that is wrong, a clock that jumps."""

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
#ifdef DTRSM
void dtrsm_(char *s, char *u, char *t, char *d, int *m, int *n, double *alpha, double *a, int *lda,
            double *b, int *ldb) {
  void (*right)() = right_one("dtrsm_");
  right(s, u, t, d, m, n, alpha, a, lda, b, ldb);
  if (wrong() && *m > 0 && *n > 0) b[0] = bad();
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

# The clock of the wall is set back and forward by JUMP seconds at every second call.
CLOCK = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <sys/time.h>
#include <time.h>
static long jump(void) {
  static long calls;
  const char *by = getenv("JUMP");
  return calls++ % 2 ? (by ? atol(by) : 0) : 0;
}
int clock_gettime(clockid_t id, struct timespec *t) {
  int (*right)(clockid_t, struct timespec *) =
      (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
  int code = right(id, t);
  if (id == CLOCK_REALTIME) t->tv_sec += jump();
  return code;
}
int gettimeofday(struct timeval *t, void *zone) {
  int (*right)(struct timeval *, void *) =
      (int (*)(struct timeval *, void *))dlsym(RTLD_NEXT, "gettimeofday");
  int code = right(t, zone);
  t->tv_sec += jump();
  return code;
}
time_t time(time_t *t) {
  time_t (*right)(time_t *) = (time_t(*)(time_t *))dlsym(RTLD_NEXT, "time");
  time_t now = right(0) + jump();
  if (t) *t = now;
  return now;
}
"""


def library(folder: Path, source: str, *defined: str) -> Path:
    """A library to go before others."""
    path = folder / f"shim{'-'.join(('', *defined))}.so"
    command = ["cc", "-shared", "-fPIC", "-O1", "-w", "-std=gnu17", "-x", "c", "-", "-ldl"]
    command += ["-lm", "-o", str(path), *(f"-D{name}" for name in defined)]
    subprocess.run(command, input=source, text=True, check=True)
    return path
