"""The loop over steps: steps that are cut back."""

from __future__ import annotations

import dataclasses

import pytest

from app.numerics.newton import NewtonResult, Solver
from app.numerics.remedies import solve
from app.stepping import load_steps
from tests import support


def test_advance_cut_back_steps_end_at_the_increment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Fields are written at the ends of the given increments, for any steps between them."""
    calls = 0

    def failing_twice(solver: Solver) -> NewtonResult:
        nonlocal calls
        calls += 1
        outcome = solve(solver)
        return dataclasses.replace(outcome, converged=outcome.converged and not 1 < calls < 4)

    monkeypatch.setattr(load_steps, "solve", failing_twice)
    steps = support.solve(support.STEM, "stages=[{name: push, increments: 3}]").steps
    assert [s.time for s in steps if s.ends_increment] == pytest.approx([1 / 3, 2 / 3, 1])
    assert len(steps) > 3
