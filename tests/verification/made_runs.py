"""Problems of the suites judged on made-up runs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import pytest

from app.campaigns.batch import Options
from app.verification import problem, suite
from app.verification.problem import Row, SolvedRun, run


def judged(
    monkeypatch: pytest.MonkeyPatch, name: str, pattern: str, runs: Sequence[Any], folder: Path
) -> Row:
    """The row of the one problem of a suite with a pattern in its name, for these runs."""

    def solved(problems: Iterable[suite.PlannedProblem], *_: object, **__: object) -> None:
        for planned in problems:
            planned.results = [
                SolvedRun(str(k), run("blocks.yaml"), Path(str(k))) for k in range(len(runs))
            ]

    rows: list[Row] = []
    monkeypatch.setattr(suite, "solve_problems", solved)
    monkeypatch.setattr(suite, "write", lambda name, options, of_problem: rows.extend(of_problem))
    monkeypatch.setattr(problem, "Run", lambda path: runs[int(path.name)])
    suite.run(name, Options(folder, 1, pattern, "long"))
    (row,) = [row for row in rows if row.name == pattern]
    return row
