"""What every test under MPI needs: destructors of PETSc and dolfinx objects are collective."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True)
def collect_together() -> Iterator[None]:
    """Collect garbage on all ranks at the same time, after each test."""
    yield
    mpi = sys.modules.get("mpi4py.MPI")
    if mpi is None or not mpi.Is_initialized() or mpi.Is_finalized():
        return
    if mpi.COMM_WORLD.size > 1:  # alone, a full collection after each of 1700 tests is only time
        gc.collect()
        mpi.COMM_WORLD.barrier()
