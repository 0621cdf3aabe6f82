"""The inverse of the stiffness that all share, and motions that are solved for apart."""

from __future__ import annotations

import logging

from petsc4py import PETSc

import numpy as np
import pytest

from app.deflation import Deflated, free_directions
from app.linear import DIRECT, MULTIGRID, Inverse
from tests import support

BLOCK = """
geometry: {kind: blocks, blocks: [{name: lower, size: [10 mm, 10 mm, 10 mm]}]}
mesh: {size: 3 mm, order: 1}
regions: {lower: {youngs_modulus: 200 MPa, poisson_ratio: 0.3}}
supports: {floor: {kind: fixed, boundary: bottom}}
loads: {push: {kind: pressure, boundary: top, pressure: 1 MPa}}
stages: [{name: push}]
"""


def laplacian(n: int = 40) -> PETSc.Mat:
    """Second differences: symmetric positive definite."""
    A = PETSc.Mat().createAIJ((n, n), nnz=3)
    for i in range(n):
        for j, value in ((i - 1, -1.0), (i, 2.0), (i + 1, -1.0)):
            if 0 <= j < n:
                A[i, j] = value
    A.assemble()
    return A


@pytest.mark.parametrize("options", [DIRECT, MULTIGRID])
def test_inverse_solves_from_any_start(options: dict[str, str]) -> None:
    A = laplacian()
    inverse = Inverse(A, lambda: 0)
    inverse.use(options)
    wanted, b = A.createVecs()
    wanted.array[:] = np.sin(np.arange(40))
    A.mult(wanted, b)
    x = wanted.duplicate()
    x.set(3.0)
    assert inverse.solve(b, x, 1e-12) > 0
    np.testing.assert_allclose(x.array, wanted.array, atol=1e-9)
    # What is solved already takes nothing more.
    assert inverse.solve(b, x, 1e-6) == 0


def test_inverse_follows_its_matrix_and_falls_back_once() -> None:
    A, version = laplacian(), [0]
    inverse = Inverse(A, lambda: version[0])
    inverse.use(MULTIGRID)
    inverse.make()
    assert not inverse.outdated
    A.scale(5.0)
    version[0] = 1
    assert inverse.outdated
    x, b = A.createVecs()
    b.set(1.0)
    inverse.solve(b, x, 1e-12)
    assert not inverse.outdated
    assert inverse.fall_back() and not inverse.fall_back()
    assert inverse.pc.getType() == "cholesky"
    y = x.duplicate()
    assert inverse.solve(b, y, 1e-12) == 1
    np.testing.assert_allclose(y.array, x.array, rtol=1e-9)


def test_free_directions_are_those_without_resistance() -> None:
    """Open, sticking, and slipping along x on a face normal to z with friction 0.4."""
    slip = np.array([[0.0, 0.0, 0.4], [0.0, 0.9, 0.0], [0.0, 0.0, 1.0]])
    found = free_directions(np.array([np.zeros((3, 3)), np.eye(3), slip]))
    np.testing.assert_allclose(found[0], np.eye(3), atol=1e-14)
    np.testing.assert_allclose(found[1], 0.0, atol=1e-14)
    np.testing.assert_allclose(found[2], np.diag([1.0, 0.0, 0.0]), atol=1e-14)


def test_deflation_solves_exactly_for_its_motions() -> None:
    """Whatever the other preconditioner does, A Z comes back as Z."""
    A, D = laplacian(6), laplacian(4)
    nest = PETSc.Mat().createNest([[A, None], [None, D]])
    nest.assemble()
    Z = [np.random.default_rng(1).normal(size=(n, 3)) for n in (6, 4)]
    inner = PETSc.PC().create()
    inner.setType("none")
    pc = PETSc.PC().createPython(Deflated(inner, lambda: Z))
    pc.setOperators(nest)
    pc.setUp()
    vectors = [m.createVecLeft() for m in (A, D)]
    for v, z in zip(vectors, Z, strict=True):
        v.array[:] = z @ [1.0, -2.0, 0.5]
    wanted = PETSc.Vec().createNest(vectors)
    r, found = wanted.duplicate(), wanted.duplicate()
    nest.mult(wanted, r)
    pc.apply(r, found)
    found.axpy(-1.0, wanted)
    assert found.norm() < 1e-12 * wanted.norm()


def test_log_says_what_is_used(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, logger="mantle"):
        support.solve(BLOCK)
    (line,) = [m for m in caplog.messages if m.startswith("linear: ")]
    assert line.startswith("linear: conjugate gradients, displacement (")
    assert line.endswith("unknowns) factored")
