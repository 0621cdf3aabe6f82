"""Load steps: halved on failure, longer after easy ones, counted, and continued."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from app.foundation.errors import ConvergenceError
from app.mechanics.contact import TrialState
from app.numerics import remedies
from app.numerics.newton import NewtonResult, Solver
from app.stepping import load_steps
from app.stepping.load_steps import Effort, LoadProgress, LoadStep
from tests import support

# A bar of 4 mm, 1 GPa, under 2 MPa: it stretches by 0.008 mm.
BAR = """
geometry: {kind: blocks, blocks: [{name: bar, size: [4 mm, 4 mm, 4 mm]}]}
mesh: {order: 1, size: 4 mm}
regions: {bar: {youngs_modulus: 1 GPa, poisson_ratio: 0, tissue: other}}
supports: {base: {kind: fixed, boundary: bottom}}
loads: {pull: {kind: pressure, boundary: top, pressure: -2 MPa}}
"""
STRETCH = 2 / 1000 * 4

# Decides, from the number of the attempt (from 1) and its time, whether the attempt fails.
Fails = Callable[[int, float], bool]


class Bar:
    """Load steps of the bar, with attempts that fail on demand.

    Attributes:
        tried: Times of all attempts.
        steps: Committed steps.
        stretches: Displacement of the top after each of them [mm].
        troubles: Reported remedies.
    """

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, stage: str, fails: Fails, iterations: int = 1
    ) -> None:
        analysis = support.analysis(support.case(BAR, f"stages=[{{name: pull, {stage}}}]"))
        assert analysis.problem is not None
        self.problem, self._iterations, self._fails = analysis.problem, iterations, fails
        self.stage = analysis.scene.stages[0]
        self.tried: list[float] = []
        self.steps: list[LoadStep] = []
        self.stretches: list[float] = []
        self.troubles: list[str] = []
        stepper = analysis.load_stepper(self._record, self.troubles.append)
        assert stepper is not None
        self.stepper = stepper
        monkeypatch.setattr(load_steps, "solve", self._solve)

    def run(self) -> None:
        self.stepper.run_stage(0, self.stage, lambda: None)

    @property
    def times(self) -> list[float]:
        return [step.time for step in self.steps]

    def _solve(self, solver: Solver) -> NewtonResult:
        self.tried.append(self.problem.time)
        outcome = remedies.solve(solver)
        has_failed = self._fails(len(self.tried), self.problem.time)
        if has_failed:
            solver.x.copy(solver.failed_state)
        return replace(outcome, converged=not has_failed, iterations=self._iterations)

    def _record(self, step: LoadStep, trial: TrialState | None) -> None:
        assert trial is None  # no contact
        self.steps.append(step)
        self.stretches.append(float(self.problem.u.x.array.reshape(-1, 3)[:, 2].max()))


def never(attempt: int, time: float) -> bool:
    return False


def test_load_steps_are_the_increments_of_the_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each step has the stretch of its part of the load."""
    bar = Bar(monkeypatch, "increments: 4", never)
    bar.run()
    assert bar.times == [0.25, 0.5, 0.75, 1.0]
    assert [step.number for step in bar.steps] == [1, 2, 3, 4]
    assert all(step.ends_increment and step.stage == "pull" for step in bar.steps)
    np.testing.assert_allclose(bar.stretches, STRETCH * np.array(bar.times), rtol=1e-9)
    total = bar.stepper.total
    assert (total.steps, total.newton_iterations, total.rejected) == (4, 4, 0)


def test_load_steps_are_halved_until_they_are_solved(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps longer than 0.2 fail. Each failure is first repeated without extrapolation."""
    bar: Bar

    def fails(attempt: int, time: float) -> bool:
        last = bar.times[-1] if bar.times else time
        return time - last > 0.2

    bar = Bar(monkeypatch, "increments: 2", fails)
    bar.run()
    assert bar.times == [0.5, 0.625, 0.75, 0.875, 1.0]
    assert [step.ends_increment for step in bar.steps] == [True, False, False, False, True]
    # From 0.5 with extrapolation, without, halved twice. Then the step grows, and fails again.
    assert bar.tried[:7] == [0.5, 1.0, 1.0, 0.75, 0.625, 0.875, 0.875]
    words = [text.partition("; ")[2] for text in bar.troubles[:3]]
    assert words == [
        "repeating without extrapolation",
        "step halved to 0.25 of stage 'pull'",
        "step halved to 0.125 of stage 'pull'",
    ]
    np.testing.assert_allclose(bar.stretches, STRETCH * np.array(bar.times), rtol=1e-9)
    assert bar.stepper.total.rejected == len(bar.tried) - len(bar.steps) == len(bar.troubles)
    assert bar.stepper.total.newton_iterations == len(bar.tried)


@pytest.mark.parametrize(
    ("iterations", "times"),
    [(8, [0.5, 0.625, 0.875, 1.0]), (9, [0.5, 0.625, 0.75, 0.875, 1.0])],
    ids=["easy", "hard"],
)
def test_load_steps_grow_only_after_easy_ones(
    iterations: int, times: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second to fourth attempts fail, which leaves steps of 0.125."""
    bar = Bar(monkeypatch, "increments: 2", lambda attempt, _: 1 < attempt < 5, iterations)
    bar.run()
    assert bar.times == times


def test_load_steps_end_after_the_allowed_halvings(monkeypatch: pytest.MonkeyPatch) -> None:
    """The solver returns to the last converged state."""
    bar = Bar(monkeypatch, "increments: 2, max_cut_backs: 2", lambda _, time: time > 0.5)
    with pytest.raises(ConvergenceError) as failure:
        bar.run()
    assert bar.tried == [0.5, 1.0, 1.0, 0.75, 0.625]
    assert "stage 'pull'" in str(failure.value)
    assert "steps halved down to 0.125 of the stage" in str(failure.value)
    assert bar.times == [0.5] and bar.stepper.total.rejected == 4
    u, _ = bar.stepper.solver.u_and_q()
    assert u.max()[1] == pytest.approx(0.5 * STRETCH, rel=1e-9)


def test_load_steps_of_given_length_are_not_halved(monkeypatch: pytest.MonkeyPatch) -> None:
    bar = Bar(monkeypatch, "increments: 2, adaptive: false", lambda _, time: time > 0.5)
    with pytest.raises(ConvergenceError):
        bar.run()
    assert bar.tried == [0.5, 1.0, 1.0]
    assert len(bar.troubles) == 1 and "without extrapolation" in bar.troubles[0]


def test_load_steps_from_rest_are_not_halved_if_all_scales_with_the_load(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A linear bar at rest fails alike under any part of its load."""
    bar = Bar(monkeypatch, "increments: 2", lambda attempt, time: True)
    with pytest.raises(ConvergenceError):
        bar.run()
    assert bar.tried == [0.5] and bar.troubles == []


def test_load_steps_continue_from_saved_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run was saved after three fifths, with steps of a tenth. The next steps are longer."""
    bar = Bar(monkeypatch, "increments: 5", never)
    bar.stepper.progress = LoadProgress(step=0.1, done=0.6)
    bar.run()
    np.testing.assert_allclose(bar.times, [0.7, 0.8, 1.0], rtol=1e-12)
    assert [step.ends_increment for step in bar.steps] == [False, True, True]
    np.testing.assert_allclose(bar.stretches, STRETCH * np.array(bar.times), rtol=1e-9)
    assert bar.stepper.progress == LoadProgress()


def test_load_steps_of_a_path_have_its_times(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a path from 0.25 to 0.75 loads get fractions of it, and steps get times of the run."""
    bar = Bar(monkeypatch, "increments: 2", never)
    fractions: list[float] = []

    def set_load(fraction: float) -> None:
        fractions.append(fraction)
        bar.problem.set_time(fraction)

    saved: list[float] = []
    bar.stepper.run_path(
        bar.stage,
        0.5,
        set_load,
        begin=0.25,
        end=0.75,
        checkpoint_point=lambda: saved.append(bar.times[-1]),
    )
    assert (fractions, bar.times) == ([0.5, 1.0], [0.5, 0.75])
    assert saved == bar.times


def test_load_steps_efforts_are_added() -> None:
    """Counts are summed; the augmentation is the smallest."""
    effort = Effort(steps=2, newton_iterations=9, linear_iterations=70, rejected=1)
    effort.add(Effort(3, 5, 20, 2, augmentation=0.1))
    assert effort == Effort(5, 14, 90, 3, augmentation=0.1)
    outcome = NewtonResult(True, 4, 33, (1.0,), (0,), False)
    effort.count(outcome)
    assert effort == Effort(5, 18, 123, 3, augmentation=0.1)
