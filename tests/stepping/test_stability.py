"""Steady states that nothing stays in: found by Newton's method, and told."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from app.cli import main
from app.verification.heat_measures import WALLS
from tests.support import CONFIGS


@pytest.mark.parametrize(("start", "state"), [(37, 0), (50, 1), (60, 2)])
def test_the_middle_one_of_three_states_is_told(start: float, state: int, tmp_path: Path) -> None:
    """Heated walls (Barber, Dundurs and Comninou, 1980): open, closed, and one between them."""
    changes = (
        "stages=[{name: gap}, {name: rest, steady: true}]",
        f"regions.cement.thermal.initial_temperature={start} degC",
    )
    case = str(CONFIGS / "verification/heated_walls.yaml")
    options = [word for change in changes for word in ("--set", change)]
    assert main(["run", case, "-o", str(tmp_path / "out"), *options]) == 0
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    pressure = summary["interfaces"]["metal_cement"]["pressure_mean"]
    assert pressure == pytest.approx(WALLS.states()[state].pressure, rel=1e-6, abs=1e-9)
    notes = [n for n in summary["notes"] if "stage 'rest' is not stable" in n]
    assert len(notes) == (state == 1)
