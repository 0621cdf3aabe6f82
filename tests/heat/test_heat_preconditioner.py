"""Factors of the matrix of heat: kept while they are good, made again when they are not."""

from __future__ import annotations

import numpy as np
import pytest

from app.heat.preconditioner import WORTH, KeptFactors
from tests.heat import test_conduction as heat

BOTH = pytest.mark.parametrize("h", [300.0, heat.PERFECT], ids=["jumps", "one block"])


def heated(h: float) -> tuple[heat.Solved, KeptFactors]:
    cold = [heat.fixed("cold", "top", 20.0)]
    terms = heat.scene([heat.CEMENT, heat.BONE], cold, heat.contact(h))
    s = heat.Solved(terms, heat.stack(1.0, *heat.CEMENT_ON_BONE))
    return s, s.solver.snes.getKSP().getPC().getPythonContext()


@BOTH
def test_equal_steps_are_factored_once_and_another_step_anew(h: float) -> None:
    s, factors = heated(h)
    s.advance(1.0, 1.0)
    made = factors.made
    for k in range(2, 6):
        s.advance(1.0, float(k))
    assert factors.made == made
    s.advance(2.0, 7.0)
    assert factors.made == made + 1


@BOTH
def test_old_factors_find_the_same_until_they_have_cost_as_much_as_new_ones(h: float) -> None:
    """Steps a little longer each: less than asks for new factors at once."""
    s, factors = heated(h)
    other, fresh = heated(h)
    seconds, made, solves = 0.0, 0, 0
    for k in range(12):
        dt = 1.0 + 0.005 * k
        seconds += dt
        s.advance(dt, seconds)
        fresh._size = 0.0  # any change is large
        other.advance(dt, seconds)
        assert np.concatenate(s.state) == pytest.approx(np.concatenate(other.state), abs=1e-8)
        made, solves = factors.made, solves + 5
    assert 1 < made < fresh.made
    assert made <= 2 + solves // WORTH * 2
