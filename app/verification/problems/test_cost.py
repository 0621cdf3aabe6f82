"""Cost of frictional contact against its goals: `mantle bench`."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest

from app.results.reading import Run
from app.verification import cost_figures as figures
from app.verification.cost_figures import (
    BENCH_STEM,
    FEMUR,
    LONG_RUNG,
    RUNGS,
    STEM_RUNGS,
    femur_run,
    ratio,
)
from app.verification.problem import (
    Comparison,
    KnownProblem,
    ProblemRun,
    bench,
    long,
    quick,
    within,
)

GOAL = "goal of the project"


def goal(problem: KnownProblem, quantity: str, most: float) -> None:
    """State a goal."""
    problem.expects(quantity, tolerance=most, source=GOAL)


def rungs_of(problem: KnownProblem, rungs: Sequence[str]) -> list[str]:
    """The rungs that are solved in a tier."""
    return [rung for rung in rungs if rung != LONG_RUNG or within("long", problem.tier)]


# Goals

STEM_GOALS: dict[str, tuple[str, Callable[[Run], float], float]] = {
    "cpu": ("CPU time [s]", figures.cpu, 5.0),
    "memory": ("peak memory [MB]", figures.megabytes, 500.0),
    "penetration": ("penetration [mm]", figures.penetration, figures.ROUNDING_OF_PENETRATION),
}


@bench
@quick
@pytest.mark.parametrize("name", STEM_GOALS)
def test_stem(problem: KnownProblem, name: str) -> None:
    quantity, figure, limit = STEM_GOALS[name]
    goal(problem, quantity, limit)
    runs = problem.solve_all([ProblemRun(BENCH_STEM, times=figures.REPEATS)])
    if name == "penetration":
        problem.compare(Comparison(max(map(figure, runs))))
    else:
        problem.compare(figures.median_of(figure, runs))


@bench
@pytest.mark.parametrize(
    "rung",
    [
        pytest.param("20k", marks=quick),
        pytest.param("100k"),
        pytest.param("170k"),
        pytest.param("1m", marks=long),
    ],
)
def test_contact_over_bonded(problem: KnownProblem, rung: str) -> None:
    limit = 2.0 if rung in figures.SMALL else 1.25
    goal(problem, "CPU time of contact over that of bonded interfaces", limit)
    problem.compare(
        ratio(problem.solve_all([femur_run("contact", rung), femur_run("bonded", rung)]))
    )


@bench
@pytest.mark.parametrize("rung", STEM_RUNGS)
def test_moderate_over_bonded(problem: KnownProblem, rung: str) -> None:
    goal(problem, "the same of a stem pressed in, of which a quarter slips", 1.2)
    both_runs = [
        figures.cemented_stem(rung, figures.MODERATE),
        figures.cemented_stem(rung, figures.BONDED),
    ]
    problem.compare(ratio(problem.solve_all(both_runs)))


@bench
def test_growth_exponent(problem: KnownProblem) -> None:
    goal(problem, "of CPU time over unknowns", 1.12)
    rungs = rungs_of(problem, list(RUNGS))
    problem.compare(
        figures.growth(problem.solve_all([femur_run("contact", rung) for rung in rungs]))
    )


@bench
def test_newton_spread(problem: KnownProblem) -> None:
    goal(problem, "of iterations about their middle", 3.0)
    rungs = rungs_of(problem, list(RUNGS))
    problem.compare(
        figures.spread_of_iterations(
            problem.solve_all([femur_run("contact", rung) for rung in rungs])
        )
    )


@bench
def test_ranks_2_over_1(problem: KnownProblem) -> None:
    goal(problem, "wall time over one rank", 1 / 1.7)
    largest = femur_run("contact", "170k")
    on_two_ranks = ProblemRun(FEMUR, largest.overrides, ranks=2)
    problem.compare(ratio(problem.solve_all([on_two_ranks, largest]), figures.wall))


@bench
def test_variations_12(problem: KnownProblem) -> None:
    goal(problem, "CPU time over that of one", 2.5)
    first_run = femur_run("contact", "100k")
    problem.compare(
        figures.variations(problem.solve_all([first_run, *figures.runs_of_variations(first_run)]))
    )


@bench
def test_later_load_steps(problem: KnownProblem) -> None:
    goal(problem, "the longest over the first", 0.3)
    solved = problem.solve(FEMUR, *femur_run("contact", "100k").overrides, *figures.STEPS)
    problem.compare(figures.later_steps(solved))


# At second order, where the bodies are condensed


def second_order(rung: str, *overrides: str) -> ProblemRun:
    """The femur at second order."""
    return ProblemRun(
        FEMUR,
        (f"mesh.size={figures.CONDENSED[rung]}", *figures.STANCE, *overrides),
        times=figures.REPEATS,
    )


@bench
@pytest.mark.parametrize(
    ("rung", "most"), [pytest.param("20k", 0.6, id="20k"), pytest.param("100k", 1.0, id="100k")]
)
def test_condensed(problem: KnownProblem, rung: str, most: float) -> None:
    goal(problem, "over multigrid", most)
    both_runs = [second_order(rung), second_order(rung, "solver.linear=multigrid")]
    problem.compare(ratio(problem.solve_all(both_runs)))


@bench
@pytest.mark.parametrize("rung", figures.CONDENSED)
def test_later_2(problem: KnownProblem, rung: str) -> None:
    goal(problem, "over the first with its set-up", 0.1)
    solved = problem.solve(FEMUR, *second_order(rung).overrides, *figures.STEPS)
    problem.compare(figures.later_steps(solved, setup=True))


@bench
@pytest.mark.parametrize("rung", figures.CONDENSED)
def test_variations_2(problem: KnownProblem, rung: str) -> None:
    goal(problem, "over one", 2.5)
    first_run = second_order(rung)
    problem.compare(
        figures.variations(problem.solve_all([first_run, *figures.runs_of_variations(first_run)]))
    )


@bench
@pytest.mark.parametrize("rung", figures.CONDENSED)
def test_cycles_2(problem: KnownProblem, rung: str) -> None:
    goal(problem, "ten over the first load", 2.5)
    ten_cycles = ProblemRun(
        FEMUR, (f"mesh.size={figures.CONDENSED[rung]}", figures.STANCE[0], figures.TEN)
    )
    problem.compare(ratio(problem.solve_all([ten_cycles, second_order(rung)])))


@bench
@pytest.mark.parametrize("rung", figures.CONDENSED)
def test_bonded_2(problem: KnownProblem, rung: str) -> None:
    goal(problem, "over bonded", 2.6)
    problem.compare(
        ratio(problem.solve_all([second_order(rung), second_order(rung, *figures.BONDED)]))
    )


@bench
def test_order_2_over_1(problem: KnownProblem) -> None:
    goal(problem, "CPU time of second order over first at equal error of slip", 1.0)
    second = [
        ProblemRun(FEMUR, (f"mesh.size={h}", *figures.STANCE))
        for h in (figures.SECOND, figures.REFERENCE)
    ]
    first_order = [femur_run("contact", rung) for rung in RUNGS if rung != LONG_RUNG]
    problem.compare(figures.equal_error(problem.solve_all([*second, *first_order])))


@bench
def test_cure_over_conduction(problem: KnownProblem) -> None:
    goal(problem, "CPU time", 2.5)
    cure = ProblemRun("cure.yaml", (figures.HALF_AN_HOUR,), times=figures.REPEATS)
    conduction = ProblemRun(
        "cure.yaml", (figures.HALF_AN_HOUR, *figures.CONDUCTION), times=figures.REPEATS
    )
    problem.compare(ratio(problem.solve_all([cure, conduction])))


MILLION_GOALS: dict[str, tuple[str, Callable[[Run], float], float]] = {
    "memory": ("peak [MB]", figures.megabytes, 12e3),
    "minutes": ("start to finish", figures.minutes, 5.0),
}


@bench
@long
@pytest.mark.parametrize("name", MILLION_GOALS)
def test_million(problem: KnownProblem, name: str) -> None:
    quantity, figure, limit = MILLION_GOALS[name]
    goal(problem, quantity, limit)
    problem.compare(figures.median_of(figure, problem.solve_all([femur_run("contact", LONG_RUNG)])))
