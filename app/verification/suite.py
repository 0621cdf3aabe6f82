"""`mantle verify`, `stress` and `bench`: pytest runs the problems of a suite by their markers.

The runs of all problems are solved together by `app.campaigns`; finished runs are not done again.
Written are ``SUITE.json``, ``SUITE.csv`` (the cost of each run) and ``SUITE.png`` next to the runs,
of a selection ``SUITE-TIER-NAME.json`` and so on.
"""

from __future__ import annotations

import logging
import math
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from unittest import mock

import pytest

from app.campaigns import batch
from app.campaigns.batch import Options
from app.campaigns.runs import Result
from app.case.case import PlannedRun
from app.foundation import layout
from app.foundation.errors import InputError
from app.system.folders import csv_text, remove, write_json, write_text
from app.verification import picture
from app.verification.problem import (
    CONFIGS,
    FAILED,
    MISSED,
    OUTCOMES,
    PASSED,
    REFUSED,
    KnownProblem,
    ProblemRun,
    Row,
    SolvedRun,
    by_group,
    planned_run,
    planned_runs,
    row_of,
    solution,
    within,
)

log = logging.getLogger("mantle")

PROBLEMS = Path(__file__).with_name("problems")
# Most names of problems in a message.
MOST_NAMES = 100
# Plugins of pytest that have nothing to do here: no output and no folders but those of the suite.
UNUSED = ("terminal", "cacheprovider", "capture", "logging", "faulthandler", "warnings")


@dataclass
class PlannedProblem:
    """A problem of a suite with the runs that it asks for.

    Attributes:
        planned: Each run as it is planned, or refused because its case is wrong.
        results: Results of the runs, each as often as it is repeated.
    """

    row: Row
    runs: Sequence[ProblemRun]
    planned: list[PlannedRun | SolvedRun] = field(default_factory=list)
    results: Sequence[SolvedRun] = ()


class Suite:
    """The problems of a suite that were chosen; the plugin of pytest that solves them.

    Attributes:
        problems: The chosen problems, by node of pytest, in their order.
        allowed: Rows of all problems of the tier.
        error: The first error outside the problems.
    """

    def __init__(self, name: str, options: Options, *, solve: bool) -> None:
        self.name = name
        self.options = options
        self.solve = solve
        self.problems: dict[str, PlannedProblem] = {}
        self.allowed: list[Row] = []
        self.error: Exception | None = None

    @property
    def rows(self) -> list[Row]:
        """Rows of the chosen problems."""
        return [planned.row for planned in self.problems.values()]

    def problem(self, item: pytest.Function) -> KnownProblem:
        """The object that the test of a problem receives, with the results of its runs."""
        planned = self.problems[item.nodeid]
        return KnownProblem(planned.row, lambda runs: planned.results, self.options.tier)

    def pytest_configure(self, config: pytest.Config) -> None:
        """Let the fixtures find the suite."""
        config.stash[SUITE] = self

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Keep an error in a module of problems."""
        if report.failed:
            self.error = RuntimeError(report.longreprtext)

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Function]) -> None:
        """Choose the problems by their tier and a part of their name, and plan their runs."""
        chosen_items = []
        for item in items:
            row = row_of(item, self.name)
            if not within(row.tier, self.options.tier):
                continue
            self.allowed.append(row)
            if self.options.pattern in row.name:
                runs = planned_runs(item, row, self.options.tier)
                self.problems[item.nodeid] = PlannedProblem(row, runs)
                chosen_items.append(item)
        items[:] = chosen_items

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self) -> bool | None:
        """Solve the runs of all problems, after which pytest judges."""
        if not self.solve or not self.problems or self.error:
            return True
        try:
            solve_problems(self.problems.values(), self.options, timed=self.name == "bench")
        except Exception as error:  # pytest would print it and go on
            self.error = error
            return True
        return None


SUITE = pytest.StashKey[Suite]()


def _pytest(suite: Suite) -> Suite:
    """Let pytest run, or only collect, the problems of a suite.

    Raises:
        InputError: No problem has such a name.
        MantleError: The runs cannot be done.
    """
    arguments = [str(PROBLEMS), "-m", suite.name]
    # Settings of a project around are not ours.
    arguments += ["-c", os.devnull, "--rootdir", str(PROBLEMS), "--import-mode", "importlib"]
    for plugin in UNUSED:
        arguments += ["-p", f"no:{plugin}"]
    pytest_settings = {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_ADDOPTS": ""}
    with mock.patch.dict(os.environ, pytest_settings):
        pytest.main(arguments, plugins=[suite])
    if suite.error:
        raise suite.error
    if not suite.problems:
        allowed_names = [row.name for row in suite.allowed]
        shown_names = (
            allowed_names
            if len(allowed_names) <= MOST_NAMES
            else dict.fromkeys(r.group for r in suite.allowed)
        )
        message = (
            f"-k {suite.options.pattern}: no problem of this tier has this in its name; allowed"
        )
        raise InputError(f"{message}: {', '.join(shown_names)}")
    return suite


def planned(name: str, tier: str = "default") -> list[PlannedProblem]:
    """The problems of a suite and their runs; solves nothing."""
    suite = Suite(name, Options(Path(), 1, tier=tier), solve=False)
    return list(_pytest(suite).problems.values())


def run(name: str, options: Options) -> bool:
    """Run the problems of a suite, or log the plan of it.

    Returns:
        True if all passed, were refused as expected, or missed what may be missed.

    Raises:
        InputError: No problem has such a name, or the folder cannot be written.
    """
    suite = _pytest(Suite(name, options, solve=not options.dry_run))
    if options.dry_run:
        problems = suite.problems.values()
        plan_runs(problems, options.folder, timed=name == "bench")
        runs = [run for p in problems for run in p.planned if isinstance(run, PlannedRun)]
        log.info(
            "%s",
            batch.table_of_planned_runs(f"{name}: {len(suite.problems)} problems", runs, options),
        )
        return True
    log.info("%s", table_of_rows(suite.rows))
    write(name, options, suite.rows)
    log.info("%s\nresults in %s", summary_line(suite.rows), options.folder)
    return all(
        row.outcome in (PASSED, REFUSED) or (row.outcome == MISSED and row.may_miss)
        for row in suite.rows
    )


# Runs


def plan_runs(problems: Iterable[PlannedProblem], folder: Path, *, timed: bool) -> None:
    """Plan all runs; a wrong case counts as a run that failed with this error.

    Args:
        problems: The problems.
        folder: Folder for changed meshes.
        timed: True if times are measured, so that no other run may be active at the same time.
    """
    for problem in problems:
        problem.planned = []
        for k, problem_run in enumerate(problem.runs, start=1):
            name = problem.row.name
            if len(problem.runs) > 1:
                name = f"{name}_{k}"
            try:
                problem.planned.append(planned_run(name, problem_run, folder, timed=timed))
            except InputError as error:
                refused_run = SolvedRun(name, problem_run, folder, error.exit_code, str(error))
                problem.planned.append(refused_run)


def solve_problems(problems: Iterable[PlannedProblem], options: Options, *, timed: bool) -> None:
    """Solve the runs of all problems; failed runs are not repeated.

    If times are measured (``timed``), problems are solved one after the other and their runs in
    turn. Disturbances of the machine then affect all runs alike.
    """
    problems = list(problems)
    plan_runs(problems, options.folder, timed=timed)
    solved_together = [[problem] for problem in problems] if timed else [problems]
    results: dict[tuple[object, int], Result] = {}
    for group in solved_together:
        runs_and_times = [
            (planned, run.times)
            for problem in group
            for planned, run in zip(problem.planned, problem.runs, strict=True)
            if isinstance(planned, PlannedRun)
        ]
        for k in range(max((times for _, times in runs_and_times), default=0)):
            folder = options.folder / f"again-{k}" if k else options.folder
            due_runs = {
                _content(planned): planned
                for planned, times in runs_and_times
                if times > k and (_content(planned), k) not in results
            }
            if due_runs:
                new_results = batch.run(
                    list(due_runs.values()), folder, options.cores, options.slurm
                )
                results |= {
                    (key, k): result for key, result in zip(due_runs, new_results, strict=True)
                }
    for problem in problems:
        problem.results = [
            planned if isinstance(planned, SolvedRun) else _solved(results, planned, run, k)
            for planned, run in zip(problem.planned, problem.runs, strict=True)
            for k in range(run.times)
        ]


def _content(planned: PlannedRun) -> object:
    """Everything that two runs of the same content share."""
    return planned.file, planned.overrides, planned.ranks, planned.needs_idle_machine, planned.share


def _solved(
    results: Mapping[tuple[object, int], Result], planned: PlannedRun, run: ProblemRun, k: int
) -> SolvedRun:
    """The result of a run, the k-th time that it was made."""
    result = results[_content(planned), k]
    return SolvedRun(
        result.planned.name,
        run,
        result.folder,
        result.exit_code,
        result.message,
        result.seconds,
        result.summary,
    )


# Reports


def table_of_rows(rows: Sequence[Row]) -> str:
    """A line for each problem, one for each group if there are several, and the failures."""
    titles_of_rows = (
        *("problem", "computed", "exact", "error", "tolerance", "order", "expected", "seconds"),
        *("outcome", "number", "source", ""),
    )
    tables = [layout.text_table(titles_of_rows, map(_line, rows))]
    groups = by_group(rows)
    if len(groups) > 1:
        titles = ("group", "problems", *OUTCOMES, "seconds", "worst", "of", "")
        tables.append(
            layout.text_table(titles, (_summed(name, members) for name, members in groups.items()))
        )
    for row in rows:
        if row.outcome in (MISSED, FAILED) and row.message:
            tables.append(f"{row.name} {row.outcome}: {row.message}".replace("\n", "\n  "))
    return "\n\n".join(tables)


def _line(row: Row) -> Sequence[object]:
    def shown(value: float | None, form: str, none: str = "") -> str:
        return none if value is None else format(value, form)

    c = row.comparison
    return (
        row.name,
        shown(c.computed if c else None, ".6g"),
        shown(c.exact if c else None, ".6g"),
        shown(c.error if c else None, ".2e", "-"),
        shown(row.tolerance, ".1e", "-"),
        shown(row.fitted, ".2f"),
        shown(row.order, ".2f"),
        f"{row.seconds:.1f}",
        row.outcome,
        row.quantity,
        row.source,
        c.note if c else "",
    )


def _summed(name: str, rows: Sequence[Row]) -> Sequence[object]:
    counts = Counter(row.outcome for row in rows)
    judged = [row for row in rows if row.comparison]
    worst_columns: Sequence[object] = ("", "", "")
    if judged:
        worst_row = max(judged, key=lambda row: row.ratio)
        assert worst_row.comparison
        worst_columns = (
            f"{worst_row.comparison.error:.1e}",
            f"{worst_row.tolerance:.1e}",
            worst_row.name,
        )
    seconds = f"{sum(row.seconds for row in rows):.1f}"
    return (name, len(rows), *(counts[x] or "" for x in OUTCOMES), seconds, *worst_columns)


def summary_line(rows: Sequence[Row]) -> str:
    """Number of problems passed, and names of the others."""
    names_by_outcome = {x: [row.name for row in rows if row.outcome == x] for x in OUTCOMES}
    counts = ", ".join(f"{len(rows_of)} {x}" for x, rows_of in names_by_outcome.items() if rows_of)
    plural = "s" if len(rows) > 1 else ""
    sentence = f"{len(rows)} problem{plural}: {counts}"
    not_passed = names_by_outcome[MISSED] + names_by_outcome[FAILED]
    return f"{sentence}: {', '.join(not_passed)}" if not_passed else sentence


def json_of_row(row: Row) -> dict[str, object]:
    """The entry of the JSON file."""
    c = row.comparison
    return {
        "name": row.name,
        "group": row.group,
        "tier": row.tier,
        "outcome": row.outcome,
        "error": _number(c.error if c else None),
        "tolerance": row.tolerance,
        "order": _number(row.fitted),
        "expected_order": row.order,
        "quantity": row.quantity,
        "source": row.source,
        "value": _number(c.computed if c else None),
        "reference": _number(c.exact if c else None),
        "rung": row.rung,
        "sizes": list(row.sizes) if row.order else [],
        "errors": [_number(e) for e in row.errors],
        "note": c.note if c else "",
        "message": row.message,
        "seconds": round(row.seconds, 2),
        "runs": [
            {
                "folder": str(r.folder),
                "case": str(CONFIGS / r.run.case),
                "overrides": r.run.overrides,
            }
            for r in row.results
        ],
    }


def _number(value: float | None) -> float | None:
    """The value if it is finite, else None: JSON has no other."""
    return None if value is None or not math.isfinite(value) else float(value)


def write(name: str, options: Options, rows: Sequence[Row]) -> None:
    """Write the rows, the costs of the runs, and the picture."""
    tier = options.tier if options.tier != "default" else ""
    stem = "-".join(filter(None, (name, tier, options.pattern)))
    options.folder.mkdir(parents=True, exist_ok=True)
    drawing = options.folder / f"{stem}.png"
    remove([drawing])  # should the new one fail, the old one does not stay next to new numbers
    write_json(options.folder / f"{stem}.json", [json_of_row(row) for row in rows])
    write_text(options.folder / f"{stem}.csv", csv_text(list(costs(rows))))
    picture.draw(rows, drawing)


def costs(rows: Iterable[Row]) -> Iterator[dict[str, object]]:
    """Cost of each finished run, a row for each."""
    results_of_folder = {r.folder: r for row in rows for r in row.results if r.summary}
    for r in results_of_folder.values():
        solver = r.summary.get("solver", {})
        yield {
            "run": r.name,
            "ranks": r.run.ranks,
            "unknowns": solver.get("dofs"),
            "newton": solver.get("newton_iterations"),
            "krylov": solver.get("linear_iterations"),
            "solution [CPU s]": round(solution(r.summary.get("cpu", {})), 3),
            "wall [s]": round(r.seconds, 3),
            "mesh [s]": r.summary.get("timing", {}).get("mesh"),
            "memory [MB]": r.summary.get("memory", {}).get("peak"),
        }
