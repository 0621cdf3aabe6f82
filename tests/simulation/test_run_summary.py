"""Sections of the summary that describe the work of a run, and numbers of a state."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from app.simulation import run_summary
from app.stepping.load_steps import Effort
from app.system.timing import Timing


def two_ranks(other: dict[str, float], other_memory: float = 0.0) -> Any:
    """A communicator with another rank of given CPU times and memory."""
    return SimpleNamespace(
        size=2,
        allgather=lambda cpu: [cpu, other],
        allreduce=lambda peak: peak + other_memory,
    )


def test_run_summary_cpu_is_the_sum_of_all_ranks() -> None:
    """Rank 0 alone meshes. A phase of another rank alone is none of the run."""
    timing = Timing(cpu={"mesh": 2.0, "solve": 10.0004})
    cpu = run_summary.cpu_seconds(two_ranks({"solve": 11.0}), timing)
    assert cpu == {"mesh": 2.0, "solve": 21.0}


def test_run_summary_memory_is_that_of_all_ranks(monkeypatch: pytest.MonkeyPatch) -> None:
    """100 MB and 150 MB for 2000 unknowns are 125 kB per unknown."""
    monkeypatch.setattr(run_summary, "peak_memory", lambda: 100.0)
    memory = run_summary.memory(two_ranks({}, 150.0), 2000)
    assert memory == {"peak": 250.0, "per_unknown": 125.0}


def test_run_summary_balances_are_those_that_the_model_has() -> None:
    balance: Any = SimpleNamespace(force=1e-10, moment=2e-10, energy=3e-10)
    thermal: Any = SimpleNamespace(balance=SimpleNamespace(heat=4e-10, quadrature=5e-10))
    mechanics = {"force": 1e-10, "moment": 2e-10, "energy": 3e-10}
    heat = {"heat": 4e-10, "heat_quadrature": 5e-10}
    assert run_summary.balances(balance, None) == mechanics
    assert run_summary.balances(None, thermal) == heat
    assert run_summary.balances(balance, thermal) == mechanics | heat


@pytest.mark.parametrize("rejected", [None, 3])
def test_run_summary_solver_counts_unknowns_and_iterations(rejected: int | None) -> None:
    model: Any = SimpleNamespace(
        mechanics=None,
        sizes=lambda: {"temperature": 40, "displacement": 120},
        tagged=SimpleNamespace(mesh=SimpleNamespace(comm=two_ranks({}))),
    )
    effort = Effort(steps=9, newton_iterations=30, linear_iterations=200, rejected=5)
    assert run_summary.solver_numbers(model, 7, effort, rejected) == {
        "dofs": 160,
        "blocks": {"temperature": 40, "displacement": 120},
        "steps": 7,
        "newton_iterations": 30,
        "linear_iterations": 200,
        "rejected_steps": rejected,
        "augmentation": {},
        "ranks": 2,
    }


def test_run_summary_adds_critical_friction_to_interfaces_with_numbers() -> None:
    """Bonded interfaces have no numbers of contact. A case without a femur has no section loads."""
    model: Any = SimpleNamespace(
        numbers=lambda samples: {"interfaces": {"stem_cement": {"slip_max": 0.1}}},
        scene=SimpleNamespace(load_time=lambda time: time),
    )
    case: Any = SimpleNamespace()
    cycles: Any = SimpleNamespace(summary=dict)
    critical = {"stem_cement": 1.4, "bonded": 2.0}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_summary, "section_loads", lambda case, time: [])
        numbers = run_summary.numbers_of_state(case, model, None, cycles, critical, 1.0)
    assert numbers == {"interfaces": {"stem_cement": {"slip_max": 0.1, "critical_friction": 1.4}}}
