"""Fixtures and hooks of pytest for the problems.

`mantle verify` (`app.verification.suite`) runs these files, and so do the tests of the program. The
tests solve the runs of a problem in the process of pytest. All but the quick problems count as
slow.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import pytest

from app import extensions  # noqa: F401  (registers keys that problems have)
from app.verification.measures import difference_between
from app.verification.problem import (
    SUITES,
    KnownProblem,
    judging,
    long,
    name_of_problem,
    planned_runs,
    row_of,
    solve_here,
    stress,
    tier_of,
    within,
)
from app.verification.suite import SUITE


def pytest_configure(config: pytest.Config) -> None:
    """Declare the markers."""
    for suite in SUITES:
        config.addinivalue_line("markers", f"{suite}(group): a problem of `mantle {suite}`")
    config.addinivalue_line("markers", "quick: of the tier quick; takes some seconds")
    config.addinivalue_line("markers", "long: of the tier long alone")
    config.addinivalue_line(
        "markers", "condensed: solved with solver.linear condensed and direct, too"
    )
    config.addinivalue_line("markers", "slow: takes more than some seconds")


@pytest.fixture
def problem(request: pytest.FixtureRequest) -> KnownProblem:
    """The problem of a test, with its runs from the suite, or solved in this process."""
    item = request.node
    suite = request.config.stash.get(SUITE, None)
    if suite:
        return suite.problem(item)
    marked = next(name for name in SUITES if item.get_closest_marker(name))
    row = row_of(item, marked)
    runner = solve_here(row.name, request.getfixturevalue("tmp_path"))
    return KnownProblem(row, runner, row.tier)


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> Generator[None, object, object]:
    """Note the outcome of a problem in its row."""
    problem = pyfuncitem.funcargs["problem"]
    assert isinstance(problem, KnownProblem)
    with judging(problem.row):
        return (yield)
    return True  # `judging` swallowed an expected refusal: the test counts as run


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Add the problems that compare linear solvers to a suite; choose those that are tests."""
    problems = [i for i in items if isinstance(i, pytest.Function) and "problem" in i.fixturenames]
    if SUITE in config.stash:
        for item in problems:
            if item.get_closest_marker("condensed") and within(tier_of(item), "default"):
                items += _condensed(item)
        return
    # Problems that take long, or measure time, are for the suites alone.
    suites_alone = [i for i in problems if i.get_closest_marker("bench") or tier_of(i) == "long"]
    items[:] = [item for item in items if item not in suites_alone]
    for item in problems:
        if tier_of(item) != "quick":
            item.add_marker("slow")


def _condensed(item: pytest.Function) -> list[pytest.Function]:
    """First run of a problem with ``solver.linear`` `condensed`, compared with `direct`."""
    row = row_of(item, "stress")
    first_run = planned_runs(item, row, "default")[0]
    if row.tolerance is None:
        return []

    @stress
    @long
    def solvers(problem: KnownProblem) -> None:
        problem.expects(
            "every field, condensed and direct, over its largest value",
            tolerance=1e-7,
            source="the other solver",
            or_refusal=row.refusal,
        )
        both_ways = [
            replace(first_run, overrides=(*first_run.overrides, f"solver.linear={linear_solver}"))
            for linear_solver in ("condensed", "direct")
        ]
        problem.compare(difference_between(*problem.solve_all(both_ways)))

    name = f"test_condensed[{name_of_problem(item)}]"
    return [pytest.Function.from_parent(item.parent, name=name, callobj=solvers)]
