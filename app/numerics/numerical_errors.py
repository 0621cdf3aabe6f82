"""Errors of linear algebra as errors of a solve."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from petsc4py import PETSc

from app.foundation.errors import ConvergenceError


@contextmanager
def as_convergence_errors() -> Iterator[None]:
    """Turn errors of factors, of memory and of PETSc into a ConvergenceError.

    It is for auxiliary solves, without which a run goes on.
    """
    try:
        yield
    except (ArithmeticError, MemoryError, PETSc.Error) as error:
        raise ConvergenceError(str(error) or type(error).__name__) from error
