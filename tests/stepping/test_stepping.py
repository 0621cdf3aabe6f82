"""Steps that are cut back or end at kinks of a time course; steady states that nothing stays in."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

import mantle
from app.case.case import load
from app.numerics.newton import NewtonResult, Solver
from app.numerics.remedies import solve
from app.results.verdicts import notes_of
from app.stepping import load_steps
from app.verification.closed_forms_heat import WALLS
from tests import support
from tests.cases import coupled


def test_advance_cut_back_steps_end_at_the_increment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Fields are written at the ends of the increments asked for, however they are reached."""
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


CLOCK = """
geometry: {kind: blocks, blocks: [{name: cube, size: [2 mm, 2 mm, 2 mm]}]}
mesh: {order: 1, size: 2 mm}
regions:
  cube:
    kind: conductor
    thermal:
      conductivity: 0.2 W/(m K)
      density: 1200 kg/m^3
      specific_heat: 1450 J/(kg K)
      initial_temperature: 37 degC
      cure:
        kinetics: {kind: prescribed, rate: [[70 s, 2], [250 s, 1], [370 s, 1]]}
        heat: 1.55e8 J/m^3
        initial: 0
stages:
  - {name: set, duration: 420 s, increments: 7, adaptive: false}
"""


@pytest.mark.parametrize("method", ["sdirk4", "backward_euler"])
def test_heat_steps_of_equal_length_do_not_cross_kinks(
    monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    """A clock that jumps between the ends of 60 s steps: it releases all its heat, and no more."""
    run = coupled.solve(monkeypatch, f"time.method={method}", text=CLOCK)
    assert [s.seconds for s in run.steps] == [60, 70, 120, 180, 240, 250, 300, 360, 370, 420]
    released = sum(s.heats["cure cube"] for s in run.steps)
    whole = 8.0 * 155.0  # N mm
    # The rate is linear between the kinks: a rule of order 4 is exact, that of order 1 is not.
    if method == "sdirk4":
        assert released == pytest.approx(whole, rel=1e-12)
    (degree,) = run.model.thermal.heating.degrees().values()
    assert degree == pytest.approx(released / whole, rel=1e-12)


@pytest.mark.parametrize(("start", "state"), [(37, 0), (50, 1), (60, 2)])
def test_heat_steps_note_unstable_steady_states(start: float, state: int, tmp_path: Path) -> None:
    """Heated walls (Barber, Dundurs and Comninou, 1980): open, closed, and one between them."""
    changes = (
        "stages=[{name: gap}, {name: rest, steady: true}]",
        f"regions.cement.thermal.initial_temperature={start} degC",
    )
    case = load(support.CONFIGS / "verification" / "heated_walls.yaml", changes)
    summary = mantle.run(case, tmp_path).summary
    pressure = summary["interfaces"]["metal_cement"]["pressure_mean"]
    assert pressure == pytest.approx(WALLS.states()[state].pressure, rel=1e-6, abs=1e-9)
    assert "several steady states may exist, some of them unstable" in "; ".join(notes_of(summary))
