"""Multigrid by degree: first order on the same mesh below a stiffness of second order."""

from __future__ import annotations

from types import SimpleNamespace

from petsc4py import PETSc

import numpy as np
import pytest

from app.numerics.preconditioners import (
    CHOLESKY,
    MULTIGRID,
    SERIAL_CHOLESKY,
    CoarseOrder,
    Inverse,
    stiffness_options,
)
from tests import support

BLOCK = """
geometry: {kind: blocks, blocks: [{name: block, size: [10 mm, 10 mm, 10 mm]}]}
mesh: {size: 3 mm, order: 2}
regions: {block: {youngs_modulus: 200 MPa, poisson_ratio: 0.3}}
supports: {floor: {kind: roller, boundary: bottom, axis: z}, side: {kind: fixed, boundary: x_min}}
loads: {push: {kind: pressure, boundary: top, pressure: 1 MPa}}
stages: [{name: push}]
"""


def problem(size: float = 3.0) -> SimpleNamespace:
    """The block: displacement space, stiffness, and unknowns that supports hold."""
    result = support.assemble(support.case(BLOCK, f"mesh.size={size} mm"))[0]
    K, constraints = result.stiffness.K, result.stiffness.constraints
    return SimpleNamespace(space=result.space, K=K, held=constraints.constrained)


def test_preconditioners_multigrid_by_degree_reproduces_linear_displacements() -> None:
    fine = problem()
    lower = CoarseOrder(fine.space, lambda: np.zeros_like(fine.held))
    P, below = lower.prolongation(), lower.space.tabulate_dof_coordinates()
    coarse, result = P.createVecs()
    x = fine.space.tabulate_dof_coordinates()
    slope = np.random.default_rng(1).normal(size=(3, 3))
    coarse.array[:] = (below @ slope).ravel()
    P.mult(coarse, result)
    np.testing.assert_allclose(result.array, (x @ slope).ravel(), atol=1e-12)


def test_preconditioners_multigrid_by_degree_separates_held_and_free_unknowns() -> None:
    fine = problem()
    lower = CoarseOrder(fine.space, lambda: fine.held)
    P = lower.prolongation()
    assert P.getSize() == (len(fine.held), lower.size)
    coarse, result = P.createVecs()
    # What moves free vertices leaves all that is held, and the other way round.
    at = lower.space.tabulate_dof_coordinates()
    side, _, floor = (at < at.min(axis=0) + 1e-9).T
    held = np.column_stack([side, side, side | floor]).ravel()
    for below, other in ((held, ~fine.held), (~held, fine.held)):
        coarse.array[:] = below
        P.mult(coarse, result)
        assert result.array.any() and np.abs(result.array[other]).max() < 1e-12


@pytest.mark.parametrize("factored_below", [True, False])
def test_preconditioners_multigrid_by_degree_iterations_are_independent_of_mesh(
    factored_below: bool,
) -> None:
    """Conjugate gradients converge to 1e-10; a factorization solves the same equations."""
    counts = []
    for size in (4.0, 2.0):
        fine = problem(size)
        lower = CoarseOrder(fine.space, lambda held=fine.held: held)
        if not factored_below:
            lower.size = 1_000_000
        options = stiffness_options("multigrid", fine.K, lower)
        assert options["pc_type"] == "mg"
        assert options["mg_coarse_pc_type"] == ("cholesky" if factored_below else "gamg")
        b, x = fine.K.createVecs()
        b.array[:] = np.where(fine.held, 0.0, np.random.default_rng(2).normal(size=len(fine.held)))
        counts.append(Inverse(fine.K, lambda: 0, options, lower).solve(b, x, 1e-10))
        direct = Inverse(fine.K, lambda: 0, stiffness_options("direct", fine.K, None))
        y = x.duplicate()
        direct.solve(b, y, 1e-12)
        assert np.abs(x.array - y.array).max() < 1e-7 * np.abs(y.array).max()
    assert counts[1] < 1.3 * counts[0] < 40, counts


def test_preconditioners_multigrid_by_degree_follows_a_changed_stiffness() -> None:
    fine, version = problem(), [0]
    lower = CoarseOrder(fine.space, lambda: fine.held)
    inverse = Inverse(
        fine.K, lambda: version[0], stiffness_options("multigrid", fine.K, lower), lower
    )
    b, x = fine.K.createVecs()
    b.set(1.0)
    first = inverse.solve(b, x, 1e-8)
    old = x.copy()
    fine.K.scale(1e3)
    version[0] = 1
    assert inverse.outdated
    x.set(0.0)
    assert abs(inverse.solve(b, x, 1e-8) - first) <= 1
    np.testing.assert_allclose(1e3 * x.array, old.array, atol=1e-6 * np.abs(old.array).max())
    # Where it fails the stiffness is factorized, once.
    assert inverse.fall_back() and not inverse.fall_back() and not inverse.outdated
    assert inverse.pc.getType() == "cholesky" and inverse.solve(b, old, 1e-8) == 1


def laplacian(n: int = 40) -> PETSc.Mat:
    """Second differences: symmetric positive definite."""
    A = PETSc.Mat().createAIJ((n, n), nnz=3)
    for i in range(n):
        for j, value in ((i - 1, -1.0), (i, 2.0), (i + 1, -1.0)):
            if 0 <= j < n:
                A[i, j] = value
    A.assemble()
    return A


@pytest.mark.parametrize("options", [CHOLESKY, SERIAL_CHOLESKY, MULTIGRID])
def test_preconditioners_inverse_solves_from_any_start(options: dict[str, str]) -> None:
    A = laplacian()
    inverse = Inverse(A, lambda: 0, options)
    wanted, b = A.createVecs()
    wanted.array[:] = np.sin(np.arange(40))
    A.mult(wanted, b)
    x = wanted.duplicate()
    x.set(3.0)
    assert inverse.solve(b, x, 1e-12) > 0
    np.testing.assert_allclose(x.array, wanted.array, atol=1e-9)
    # What is solved already takes nothing more.
    assert inverse.solve(b, x, 1e-6) == 0
