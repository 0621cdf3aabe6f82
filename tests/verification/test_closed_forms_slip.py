"""The references of large slip, computed by another method."""

from __future__ import annotations

import pytest

from app.verification.closed_forms import CUP
from tests.reference import axisymmetric

# Ball of 14 mm, outside of the cup 22 mm, by clearance [mm]: sink [um], mean pressure within 20
# degrees [MPa] and edge of contact [degrees], by a separate program with linear gaps.
KNOWN = {
    0.05: (35.4, 8.27, 50.8),
    0.1: (45.0, 10.30, 42.9),
    0.2: (58.7, 13.13, 35.8),
    0.5: (84.4, 18.29, 27.6),
}


@pytest.mark.parametrize("clearance", KNOWN)
def test_closed_forms_slip_of_a_ball_in_cup(clearance: float) -> None:
    sink, pressure, edge = axisymmetric.pressed(14, 14 + clearance, 22, 54)
    assert (1e3 * sink, pressure) == pytest.approx(KNOWN[clearance][:2], rel=5e-3)
    assert edge == pytest.approx(KNOWN[clearance][2], abs=0.5)
    assert (1e3 * sink, pressure) == pytest.approx(CUP[clearance], rel=1e-3)
    coarse = axisymmetric.pressed(14, 14 + clearance, 22, 36)
    assert (sink, pressure) == pytest.approx(coarse[:2], rel=3e-3)
