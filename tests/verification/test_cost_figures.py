"""`mantle bench`: figures from made-up runs, and its cases."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from app.case.case import dump, load_case
from app.laws.contact_laws import Contact
from app.laws.interface_laws import Bonded
from app.verification import suite
from app.verification.cost_figures import INTERFACES, RUNGS
from app.verification.suite import PlannedProblem
from tests.support import CONFIGS
from tests.verification.made_runs import judged


def made(
    solution: float = 1.0,
    unknowns: int = 1000,
    newton: int = 8,
    slip: tuple[float, float] = (1.0, 1.0),
    **more: Any,
) -> Any:
    """A run with this cost."""
    summary = {
        "solver": {"dofs": unknowns, "newton_iterations": newton, "linear_iterations": 10 * newton},
        "cpu": {"assemble": 0.2 * solution, "solve": 0.8 * solution, "mesh": 7.0, "output": 3.0},
        "timing": {"solve": 2 * solution, "mesh": 5.0, "compile": 50.0, "total": 99.0},
        "memory": {"peak": 700.0},
        "interfaces": {
            name: {"slip_p99": s, "penetration_max": 1e-3 * s}
            for name, s in zip(INTERFACES, slip, strict=True)
        },
    }
    return SimpleNamespace(**{"summary": summary, "step_record": {}} | more)


STEPPED = made(step_record={"step [s]": [8.0, 2.0, 3.0, 1.0]})
# Times t ~ n^1.1 of n unknowns, of which one in three is disturbed.
LADDER = [
    made(t, n) for n in (50_000, 100_000, 200_000, 1_000_000) for t in [3e-6 * n**1.1] * 2 + [1e3]
]
# The machine slows down threefold, and something disturbs one contact run and one bonded one: the
# ratio of the medians would be 8 / 3.
DISTURBED = [made(t) for t in (2.0, 90.0, 8.0, 1.0, 3.0, 40.0)]
# First order: error 0.4, 0.2, 0.1 in 1, 4, 16 s (~ t^-1/2, so 0.15 in 64/9 s); the worse interface
# counts.
ONES = [
    made(t, n, slip=(1 - e, 1 + e / 2))
    for n, (t, e) in enumerate(((1.0, 0.4), (4.0, 0.2), (16.0, 0.1)))
]


@pytest.mark.parametrize(
    ("name", "runs", "expected"),
    [
        ("stem_cpu", [made(4.0), made(6.0), made(9.0)], 6.0),
        ("stem_memory", [made()], 700.0),
        ("million_minutes", [made()], 44 / 60),
        ("stem_penetration", [made(slip=(1.0, 2.0))], 2e-3),
        ("growth_exponent", LADDER, 1.1),
        ("newton_spread", [made(newton=n) for n in (7, 9, 13)], 3.0),
        ("ranks_2_over_1", [made(5.0), made(9.0)], 1 / 1.8),  # on the wall
        ("contact_over_bonded_20k", DISTURBED, 2.0),
        ("later_load_steps", [STEPPED], 3 / 8),
        ("variations_12", [made(2.0)] * 3 + [made(1.0)] * 12, 48 / 5),  # all but mesh and forms
        ("order_2_over_1", [made(2.0, slip=(1.01, 0.85)), made(), *ONES], 2 / (64 / 9)),
        # Beyond the runs, against the nearest.
        ("order_2_over_1", [made(2.0, slip=(0.99, 1.0)), made(), *ONES], 2 / 16),
        ("order_2_over_1", [made(2.0, slip=(0.5, 1.0)), made(), *ONES], 2 / 1),
    ],
)
def test_cost_figures_of_made_runs(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, name: str, runs: list[Any], expected: float
) -> None:
    row = judged(monkeypatch, "bench", name, runs, tmp_path)
    assert row.comparison is not None
    assert row.comparison.error == pytest.approx(expected)


@pytest.fixture(scope="module")
def goals() -> dict[str, PlannedProblem]:
    """Goals of the tier "long", by name."""
    return {planned.row.name: planned for planned in suite.planned("bench", "long")}


def test_cost_figures_repeat_cheap_runs(goals: dict[str, PlannedProblem]) -> None:
    assert [run.times for run in goals["contact_over_bonded_20k"].runs] == [3, 3]
    assert [run.times for run in goals["contact_over_bonded_170k"].runs] == [1, 1]


def test_cost_figures_goals_run_valid_cases(goals: dict[str, PlannedProblem]) -> None:
    """Each case can be read, and is of the kind of its goal."""
    for name, planned in goals.items():
        assert planned.runs
        for run in planned.runs:
            case = load_case(CONFIGS / run.case, run.overrides).config
            second = "_2_" in name.removeprefix("ranks_2") or "condensed" in name
            first = any(o == "mesh.order=1" for o in run.overrides) or "stem" in run.case
            assert case.mesh.order == (1 if first or not second else 2), name
            if "bonded" in name:
                bonded = any("kind: bonded" in o for o in run.overrides)
                kinds = {type(i) for i in case.interfaces.values()}
                assert kinds == {Bonded if bonded else Contact}, name
            if run.case == "stance.yaml":
                assert not case.output.error
    twelve = goals["variations_12"].runs[1:]
    assert len(twelve) == 12
    assert all(run.share for run in twelve)
    assert len({dump(load_case(CONFIGS / r.case, r.overrides).config) for r in twelve}) == 12
    (steps,) = goals["later_load_steps"].runs
    stages = load_case(CONFIGS / steps.case, steps.overrides).config.stages
    assert [stage.increments for stage in stages] == [1, 3]


def test_cost_figures_million_unknowns_in_the_long_tier() -> None:
    default = {planned.row.name: planned for planned in suite.planned("bench")}
    assert len(default) == 25
    assert not [name for name in default if "1m" in name or "million" in name]
    assert len(default["growth_exponent"].runs) == len(RUNGS) - 1
    finest = f"mesh.size={RUNGS['1m']}"
    assert not any(finest in run.overrides for p in default.values() for run in p.runs)
