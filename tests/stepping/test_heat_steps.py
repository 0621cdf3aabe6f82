"""Time steps of heat through a stage: equal, by their error, or one to a steady state."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import mantle
from app.case.case import load_case
from app.case.run_options import Stage
from app.foundation.errors import ConvergenceError
from app.numerics.integrator import METHODS
from app.numerics.newton import NewtonResult
from app.results.verdicts import notes_of
from app.stepping.heat_steps import HeatStepper
from app.stepping.load_steps import Effort, LoadStep
from app.verification.closed_forms_heat import WALLS
from tests import support
from tests.cases import coupled

SOLVED = NewtonResult(True, 1, 0, (1e-9,), (0,), linear_failed=False)


@dataclass
class StandIn:
    """Heat with a step error of (length / largest)² over its tolerance, or without a solution.

    Attributes:
        largest: Step whose error is the tolerance [s].
        events: Times that no step may cross [s].
        unsolved: Steps above this length are not solved [s].
        first: Step that it proposes first [s].
    """

    largest: float = 1.0
    events: tuple[float, ...] = ()
    unsolved: float = float("inf")
    first: float = 0.1
    method: Any = METHODS["backward_euler"]
    seconds: float = 0.0
    total: Effort = field(default_factory=Effort)
    outcome: NewtonResult = SOLVED
    lengths: list[float] = field(default_factory=list)

    def start(self, increment: float) -> float:
        """Length of the first step [s]."""
        return min(self.first, increment)

    def attempt(self, length: float, fixed: bool) -> tuple[Any] | None:
        """A solution with its error."""
        if length > self.unsolved:
            return None
        return (SimpleNamespace(error=(length / self.largest) ** 2),)

    def norm(self, error: float) -> float:
        """Error over the tolerance."""
        return error

    def accept(self, solution: Any, length: float) -> Any:
        """Commit a step."""
        self.seconds += length
        self.lengths.append(length)
        self.total.steps += 1
        return SimpleNamespace(outcome=SOLVED, error=solution.error)

    def solve_steady(self) -> Any:
        """A steady state without a solution."""
        return None


@dataclass
class Followers:
    """Mechanics that only record the times at which they follow."""

    ends: list[tuple[float, bool]] = field(default_factory=list)

    def begin(self, k: int, stage: Stage, is_new: bool) -> None:
        """Begin a stage."""

    def after_heat_step(self, time: float, ends_increment: bool) -> None:
        """Record the time."""
        self.ends.append((time, ends_increment))


def run(heat: StandIn, stage: Stage, followers: Followers | None = None) -> list[LoadStep]:
    """Committed steps of a stage."""
    steps: list[LoadStep] = []
    stepper = HeatStepper(heat, followers, lambda step, _: steps.append(step))  # type: ignore[arg-type]
    stepper.run_stage(0, stage, lambda: None)
    return steps


def test_heat_steps_of_equal_length_are_divided_at_events() -> None:
    heat, followers = StandIn(events=(3.7, 20.0)), Followers()
    steps = run(
        heat, Stage(name="setting", duration="10 s", increments=4, adaptive=False), followers
    )
    assert heat.lengths == pytest.approx([2.5, 1.2, 1.3, 2.5, 2.5])
    assert [s.time for s in steps] == pytest.approx([0.25, 0.37, 0.5, 0.75, 1.0])
    assert [s.ends_increment for s in steps] == [True, False, True, True, True]
    assert followers.ends == [(s.time, s.ends_increment) for s in steps]


@given(
    st.floats(0.02, 50.0),
    st.integers(1, 5),
    st.lists(st.floats(0.05, 9.95), max_size=3, unique=True),
)
def test_heat_steps_by_error_meet_increments_and_events(
    largest: float, increments: int, events: list[float]
) -> None:
    """No step crosses an event or the end of an increment, and none exceeds the tolerance."""
    heat = StandIn(largest=largest, events=tuple(sorted(events)))
    run(heat, Stage(name="setting", duration="10 s", increments=increments))
    assert heat.seconds == pytest.approx(10.0, rel=1e-12)
    ends = [sum(heat.lengths[: n + 1]) for n in range(len(heat.lengths))]
    for met in [*events, *(10.0 * (n + 1) / increments for n in range(increments))]:
        assert min(abs(end - met) for end in ends) < 1e-7
    assert max(heat.lengths) <= largest * (1 + 1e-12)


def test_heat_steps_that_are_not_solved_are_halved_and_counted() -> None:
    heat = StandIn(largest=100.0, unsolved=0.3, first=0.5)
    run(heat, Stage(name="setting", duration="2 s"))
    assert heat.lengths[0] == 0.25 and max(heat.lengths) <= 0.3
    assert heat.total.rejected >= 1 and heat.seconds == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("stage", "words"),
    [
        (Stage(name="slow", duration="10 s", increments=2, adaptive=False), "use more increments"),
        (Stage(name="fast", duration="10 s"), "use a larger time.tolerance"),
        (Stage(name="rest", steady=True), "no steady state in stage 'rest'"),
    ],
)
def test_heat_steps_that_fail_say_where_and_what_to_do(stage: Stage, words: str) -> None:
    with pytest.raises(ConvergenceError, match=words) as caught:
        run(StandIn(unsolved=0.0), stage)
    assert stage.steady or f"in stage '{stage.name}' at 0 % of it" in str(caught.value)


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
    """A prescribed rate jumps between the ends of 60 s steps.

    It releases all its heat, and no more.
    """
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
    """Heated walls (Barber, Dundurs and Comninou, 1980) are open, closed, or between."""
    changes = (
        "stages=[{name: gap}, {name: rest, steady: true}]",
        f"regions.cement.thermal.initial_temperature={start} degC",
    )
    case = load_case(support.CONFIGS / "verification" / "heated_walls.yaml", changes)
    summary = mantle.run(case, tmp_path).summary
    pressure = summary["interfaces"]["metal_cement"]["pressure_mean"]
    assert pressure == pytest.approx(WALLS.states()[state].pressure, rel=1e-6, abs=1e-9)
    assert "several steady states may exist, some of them unstable" in "; ".join(notes_of(summary))
