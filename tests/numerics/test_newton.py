"""Newton's method: convergence, tolerances of linear solves, line search, failures."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest

from app.foundation.errors import ConvergenceError
from app.mechanics.predictors import use_if_better
from app.numerics.remedies import solve
from app.numerics.system import Measure
from meshes.distribute import TaggedMesh
from tests import support
from tests.numerics.blocks import BLOCK


@pytest.mark.parametrize("more", [(), ("solver.petsc.snes_stol=1e-8",)])
def test_newton_step_of_zero_length_is_not_converged(
    more: tuple[str, ...], tagged: TaggedMesh
) -> None:
    """The result is the same with PETSc's tolerance for short steps (`snes_stol`)."""
    with pytest.raises(ConvergenceError):
        support.solve(BLOCK, "solver.petsc.ksp_atol=1e9", *more, tagged=tagged)


def test_newton_linear_tolerances_follow_changes_of_state(tagged: TaggedMesh) -> None:
    """The tolerance is rough while many points change, and finer if few do.

    It follows the next residual.
    """
    problem, solver = support.assemble(support.case(BLOCK, "solver.tolerance=1e-10"), tagged)
    n = len(problem.contact.points.weight)
    solver.active.add(np.zeros(n, dtype=np.int64))

    def tolerance(last: float, now: float, changed: int) -> float:
        solver.residuals, solver.changes = [last, now], [n, changed]
        return solver._linear_tolerance(1, [Measure(now, 1.0, 0.0)])

    assert n > 20
    assert solver._linear_tolerance(0, []) == 0.1
    assert tolerance(1.0, 1e-3, n) == 0.1
    power = (1 + 5**0.5) / 2
    assert tolerance(1.0, 0.9, 0) == 0.01
    # The next residual is a hundred times the square of 1e-6 at best, and may be 1e-10.
    assert tolerance(1e-4, 1e-5, 0) == pytest.approx(1e-3)
    assert tolerance(1e-4, 1e-7, 0) == pytest.approx((1e-3) ** power)
    assert tolerance(1e-6, 1e-7, 0) == pytest.approx(0.2e-3)


@pytest.mark.parametrize(
    ("residuals", "changes", "stalled"),
    [
        ([1.0, 0.9, 0.8, 0.7, 0.6], [0, 9, 9, 9, 9], True),
        ([1.0, 0.9, 0.8, 0.7, 0.4], [0, 9, 9, 9, 9], False),
        # No point changes its state, and the residual stays.
        ([1.0, 1.0, 1.0, 1.0, 1.0], [0, 0, 0, 0, 0], True),
        # The border between states moves on; then it stays, too.
        ([9.0, 1.0, 0.9, 0.8, 0.7, 0.6], [0, 1094, 540, 454, 387, 338], False),
        ([9.0, 1.0, 0.9, 0.8, 0.7, 0.6], [0, 400, 400, 400, 400, 338], True),
    ],
)
def test_newton_has_stalled_if_neither_residual_nor_changes_of_state_fall(
    residuals: list[float], changes: list[int], stalled: bool, tagged: TaggedMesh
) -> None:
    _, solver = support.assemble(support.case(BLOCK), tagged)
    solver.residuals, solver.changes = residuals, changes
    assert solver._has_stalled(len(residuals) - 1) == stalled


def test_newton_keeps_a_given_linear_tolerance(tagged: TaggedMesh) -> None:
    _, solver = support.assemble(support.case(BLOCK, "solver.petsc.ksp_rtol=0.003"), tagged)
    assert solve(solver).converged
    assert solver.snes.getKSP().getTolerances()[0] == 0.003


def test_newton_line_search_ends_without_descent(tagged: TaggedMesh) -> None:
    """After ten halvings of a step uphill PETSc reports that the line search has failed."""
    problem, solver = support.assemble(support.case(BLOCK), tagged)
    problem.set_time(1.0)
    solver.residual(solver.x)

    def uphill(x: PETSc.Vec, y: PETSc.Vec) -> bool:
        y.scale(-1.0)
        return True

    solver.snes.setLineSearchPreCheck(uphill)
    solver.snes.solve(None, solver.x)
    assert solver.snes.getConvergedReason() == PETSc.SNES.ConvergedReason.DIVERGED_LINE_SEARCH
    assert solver.snes.getIterationNumber() == 0
    assert solver.snes.getFunctionEvaluations() <= 12


def test_newton_starts_anew_if_the_reduced_system_has_no_finite_residual(
    tagged: TaggedMesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The whole system is then solved from the state before, not from NaN."""
    problem, solver = support.assemble(support.case(BLOCK, "solver.linear=condensed"), tagged)
    problem.set_time(1.0)
    reduced = solver.reduced
    assert reduced is not None
    solver.system.impose(solver.blocks())

    def run_to_nan() -> tuple[int, int]:
        reduced.x.set(np.nan)
        reduced.residuals, reduced.changes = [1.0, np.nan], [0, 0]
        return 1, 0

    monkeypatch.setattr(reduced, "run", run_to_nan)
    iterations, _ = solver.run()
    assert solver.converged and iterations > 1
    assert np.isfinite(solver.x.norm())


def test_newton_residual_that_is_not_finite_is_a_failure(tagged: TaggedMesh) -> None:
    """A start with an infinite residual is not used.

    A residual that overflows is a failure with a reason.
    """
    problem, solver = support.assemble(support.case(BLOCK), tagged)
    problem.set_time(1.0)
    x = solver.vector()
    x.set(np.nan)
    assert not use_if_better(solver, x)
    assert solver.x.norm() == 0.0
    with pytest.raises(ConvergenceError, match="no convergence in stage 'press'"):
        support.solve(BLOCK, "supports.end.z=-1e300 mm", tagged=tagged)
