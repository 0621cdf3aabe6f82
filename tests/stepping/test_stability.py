"""Steady states that nothing stays in: found by Newton's method, and told."""

from __future__ import annotations

from pathlib import Path

import pytest

import mantle
from app.case.case import load
from app.verification.heat_measures import WALLS
from tests.support import CONFIGS


@pytest.mark.parametrize(("start", "state"), [(37, 0), (50, 1), (60, 2)])
def test_the_middle_one_of_three_states_is_told(start: float, state: int, tmp_path: Path) -> None:
    """Heated walls (Barber, Dundurs and Comninou, 1980): open, closed, and one between them."""
    changes = (
        "stages=[{name: gap}, {name: rest, steady: true}]",
        f"regions.cement.thermal.initial_temperature={start} degC",
    )
    summary = mantle.run(
        load(CONFIGS / "verification" / "heated_walls.yaml", changes), tmp_path
    ).summary
    pressure = summary["interfaces"]["metal_cement"]["pressure_mean"]
    assert pressure == pytest.approx(WALLS.states()[state].pressure, rel=1e-6, abs=1e-9)
    notes = [n for n in summary["notes"] if "stage 'rest' is not stable" in n]
    assert len(notes) == (state == 1)
