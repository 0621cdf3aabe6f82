"""The quick tier of ``mantle verify``: problems with known answers, each some seconds.

All of them, with their finest rungs: ``mantle verify`` and `tests/verification/test_mutations.py`.
"""

from __future__ import annotations

from pathlib import Path

import pytest

import mantle
from app.campaigns.runs import Job, Result
from app.case.case import load
from app.verification import engine
from app.verification.check import CONFIGS
from app.verification.problems import QUICK, problems

QUICK_PROBLEMS = {p.name: p.up_to("quick") for p in problems() if p.tier == "quick"}


def test_the_tier_is_what_it_names() -> None:
    assert QUICK_PROBLEMS.keys() == QUICK


@pytest.mark.parametrize("name", QUICK_PROBLEMS)
def test_the_answer_is_the_known_one(name: str, tmp_path: Path) -> None:
    problem = QUICK_PROBLEMS[name]
    results = []
    for k, run in enumerate(problem.runs):
        path, folder = CONFIGS / run.case, tmp_path / str(k)
        mantle.run(load(path, run.overrides), folder)
        results.append(Result(Job(name, path), folder, 0, 0.0, {}, ""))
    result = engine.judge(problem, results)
    assert result.outcome == "passed", result.as_json()
