"""Predictors: proportional loads in one solve, wrong extrapolations rejected."""

from __future__ import annotations

import pytest

from tests import support
from tests.cases.coarse_start_stem import go

# Between load steps


@pytest.mark.parametrize(
    "overrides",
    [
        ("stages.0.increments=4",),
        ("loads.push.history=[1, 1.5]", "stages=[{name: one}, {name: two}]"),
    ],
)
def test_predictors_proportional_loads_are_solved_once(overrides: tuple[str, ...]) -> None:
    """Contact with friction is homogeneous, so later steps need only a correction of rounding."""
    first, *later = (s.outcome.iterations for s in go(*overrides)[1])
    assert first > 3
    assert later and max(later) <= 1


def test_predictors_reject_a_wrong_extrapolation() -> None:
    """After the load reverses, the step starts from the state before it, not from the line."""
    turn = ("loads.push.history=[1, 0.9]", "stages=[{name: up}, {name: back}]")
    straight, _ = go("stages.0.increments=1")
    turned, steps = go(*turn)
    assert len(steps) == 2
    jump, expected = (m.mechanics.problem.contact.state.jump for m in (turned, straight))
    assert 0 < support.difference(jump, expected) < 0.2
