"""Fixtures for all tests. Under MPI destructors of PETSc and dolfinx objects are collective."""

from __future__ import annotations

import gc
import logging
import sys
from collections.abc import Iterator

from mpi4py import MPI  # noqa: F401  (libraries of wheels find MPI by it)

import pytest
from hypothesis import settings

from app import extensions  # noqa: F401  (registers keys that cases have)

# How long an example takes is the machine's business.
settings.register_profile("mantle", deadline=None, max_examples=50)
settings.register_profile("thorough", deadline=None, max_examples=300)  # of `mantle test --all`
settings.load_profile("mantle")


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


@pytest.fixture(autouse=True)
def log_of_other_tests() -> Iterator[None]:
    """Restore the log of pytest after a test in which the command line set up its log."""
    logger = logging.getLogger("mantle")
    before = logger.propagate, logger.level, logger.handlers
    logger.propagate = True
    yield
    logger.propagate, logger.level, logger.handlers = before


@pytest.fixture
def two_blocks() -> str:
    """The smallest case: an elastic block below a rigid one, with lengths in four units."""
    return """\
geometry:
  kind: blocks
  blocks:
    - {name: lower, size: "[10, 20, 5] mm"}
    - {name: upper, size: [1 cm, 0.02 m, 5000 um]}
mesh: {order: 1, size: 2 mm}
regions:
  lower: {youngs_modulus: 2.2 GPa, poisson_ratio: 0.3}
  upper: {rigid: true}
supports:
  base: {kind: fixed, boundary: bottom}
"""
