"""A problem with a known answer: the object that its test receives, and the row that it leaves.

Problems are the test functions in `app.verification.problems`. Each states what it expects, asks
once for its runs, and compares::

    @verify
    def test_incline(problem: KnownProblem) -> None:
        problem.expects("force over weight", tolerance=0.005, source="balance of forces")
        run = problem.solve("verification/incline.yaml")
        problem.compare(relative(force(run) / WEIGHT, push_up(0.1, 0.3)))

`mantle verify` calls each function twice. In the first call `problem.solve` only records the runs
and ends the function (`planned_runs`). All runs are then solved together, and pytest judges.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

import pytest

import configs
from app.campaigns.work_precision import fitted_order
from app.case.case import PlannedRun, load_case
from app.case.summary import Summary
from app.foundation.errors import (
    ConvergenceError,
    GeometryError,
    InputError,
    MantleError,
    UnusableError,
)
from app.foundation.verdict import Reason
from app.results.reading import Run
from app.system import form_cache, ranks
from app.verification.changed_meshes import change

CONFIGS = configs.FOLDER

# Suites.
verify = pytest.mark.verify
stress = pytest.mark.stress
bench = pytest.mark.bench
SUITES = ("verify", "stress", "bench")
# Problems of `mantle stress` whose first run is also solved by both exact linear solvers.
condensed = pytest.mark.condensed

# Tiers; each contains those before it. A problem without a mark is of the tier "default".
quick = pytest.mark.quick
long = pytest.mark.long
TIERS = ("quick", "default", "long")

# Outcomes.
PASSED = "passed"
REFUSED = "refused"
MISSED = "missed"
FAILED = "failed"
OUTCOMES = (PASSED, REFUSED, MISSED, FAILED)

# Exit codes of a refusal.
REFUSALS = (InputError.exit_code, GeometryError.exit_code, ConvergenceError.exit_code)
# Exit codes of runs that can be judged: whether numbers that are not to be used are right, too.
SOLVED = (0, UnusableError.exit_code)

# Largest difference between the fitted order of convergence and that of theory.
ORDER_TOLERANCE = 0.2

# Phases of a run outside set-up and solution.
APART = ("mesh", "compile", "output", "error", "total")

log = logging.getLogger("mantle")


@dataclass(frozen=True)
class ProblemRun:
    """A run that a problem needs.

    Attributes:
        case: The case file, below `CONFIGS`.
        overrides: As after ``--set``.
        mesh: Change of its mesh before the run, a name in `changed_meshes`, or "".
        ranks: Number of MPI ranks.
        times: Number of repetitions, where its time is measured.
        share: True if it may share a process with others of the problem.
    """

    case: str
    overrides: tuple[str, ...] = ()
    mesh: str = ""
    ranks: int = 1
    times: int = 1
    share: bool = False


def run(case: str, *overrides: str, mesh: str = "") -> ProblemRun:
    """A run of a case with some overrides, on a mesh that may be changed first."""
    return ProblemRun(case, overrides, mesh)


@dataclass(frozen=True)
class SolvedRun:
    """A run that ended: solved, refused or failed.

    Attributes:
        name: Shown to users.
        run: The run as the problem asked for it.
        folder: Run directory.
        exit_code: Exit code of ``mantle run``.
        message: Why it was refused or failed; else empty.
        seconds: Wall time.
        summary: ``summary.json``; empty unless the run is done.
    """

    name: str
    run: ProblemRun
    folder: Path
    exit_code: int = 0
    message: str = ""
    seconds: float = 0.0
    summary: Summary = field(default_factory=lambda: Summary())


@dataclass(frozen=True)
class Comparison:
    """A computed number and the exact one.

    Attributes:
        error: In the measure of the problem.
        computed: The computed number, where it is one.
        exact: The exact number.
        note: Remark for the report.
    """

    error: float
    computed: float | None = None
    exact: float | None = None
    note: str = ""


def relative(computed: float, exact: float) -> Comparison:
    """A number whose error is relative to the exact one."""
    return Comparison(abs(computed / exact - 1), computed, exact)


def worst(comparisons: Iterable[Comparison]) -> Comparison:
    """The comparison with the largest error; NaN is the worst."""
    return max(comparisons, key=lambda c: math.inf if math.isnan(c.error) else c.error)


@dataclass
class Row:
    """A row of the table of a suite: one problem.

    Attributes:
        name: Unique name of the problem: that of its test.
        group: Subject shared with other problems.
        tier: The first of `TIERS` with this problem.
        quantity: The number compared, with its unit, and the scale of its error.
        tolerance: Largest error, of the finest run where an order is fitted; None if there is no
            answer, and mantle has to refuse.
        source: Origin of the exact number.
        order: Order of convergence that theory gives; None where none is fitted.
        rung: Quantity that the runs make smaller where an order is fitted.
        refusal: Reason for which mantle may, or has to, refuse the first run.
        results: Results of the runs, in their order.
        comparison: The worst comparison.
        errors: Error of each run.
        sizes: Values of the `rung`, coarse to fine.
        fitted: Fitted order of convergence.
        outcome: One of `OUTCOMES`.
        message: Why it was refused or failed.
    """

    name: str
    group: str
    tier: str = "default"
    quantity: str = ""
    tolerance: float | None = None
    source: str = ""
    order: float | None = None
    rung: str = "mesh size (mm)"
    refusal: Reason | None = None
    results: Sequence[SolvedRun] = ()
    comparison: Comparison | None = None
    errors: Sequence[float] = ()
    sizes: Sequence[float] = ()
    fitted: float | None = None
    outcome: str = FAILED
    message: str = ""

    @property
    def seconds(self) -> float:
        """Wall time of the runs, shared ones included [s]."""
        return sum({r.folder: r.seconds for r in self.results}.values())

    @property
    def ratio(self) -> float:
        """Error over tolerance; 0 where a zero tolerance is met."""
        error = self.comparison.error if self.comparison else math.inf
        if math.isnan(error) or self.tolerance is None:
            return math.inf
        if self.tolerance:
            return error / self.tolerance
        return math.inf if error else 0.0

    @property
    def may_miss(self) -> bool:
        """Return True if a miss is a result, that of a goal for the cost."""
        return self.group == "bench"


def by_group(rows: Iterable[Row]) -> dict[str, list[Row]]:
    """The rows of each group."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row.group, []).append(row)
    return groups


class Planned(Exception):
    """The runs that a problem asks for, raised by `solve` when they are only noted."""

    def __init__(self, runs: Sequence[ProblemRun]) -> None:
        self.runs = runs
        super().__init__()


class Refused(Exception):
    """Mantle refused the problem for the reason that was expected."""


class Unsolved(Exception):
    """A run failed."""


class Missed(AssertionError):
    """The error exceeds the tolerance."""


# Results of the runs of a problem, each as often as it is repeated.
Runner = Callable[[Sequence[ProblemRun]], Sequence[SolvedRun]]


def planning(runs: Sequence[ProblemRun]) -> NoReturn:
    """A `Runner` that solves nothing."""
    raise Planned(runs)


@dataclass
class KnownProblem:
    """The argument ``problem`` of a test: it states, solves and compares.

    Attributes:
        row: Row of the problem in the table of its suite.
        runner: Function that solves the runs.
        tier: The chosen tier, one of `TIERS`.
    """

    row: Row
    runner: Runner
    tier: str = "default"
    _asked: bool = field(default=False, init=False)

    def expects(
        self,
        quantity: str,
        *,
        tolerance: float,
        source: str,
        order: float | None = None,
        rung: str = "mesh size (mm)",
        or_refusal: Reason | None = None,
    ) -> None:
        """State the number that is compared; the arguments are attributes of `Row`."""
        self.row.quantity = quantity
        self.row.tolerance = tolerance
        self.row.source = source
        self.row.order = order
        self.row.rung = rung
        self.row.refusal = or_refusal

    def expects_refusal(self, quantity: str, reason: Reason) -> None:
        """State that there is no answer, and that mantle has to say so."""
        self.row.quantity = quantity
        self.row.source = "no equilibrium exists"
        self.row.refusal = reason

    def rungs(self, sizes: Sequence[float], finest: str = "long") -> Sequence[float]:
        """Sizes from coarse to fine for a fitted order; the last from a tier on alone."""
        self.row.sizes = sizes if within(finest, self.tier) else sizes[:-1]
        return self.row.sizes

    def solve(self, case: str, *overrides: str, mesh: str = "") -> Run:
        """Solve one case."""
        return self.solve_all([run(case, *overrides, mesh=mesh)])[0]

    def solve_each(self, case: str, changes: Iterable[Sequence[str]]) -> list[Run]:
        """Solve a case several times with different overrides."""
        return self.solve_all([run(case, *overrides) for overrides in changes])

    def solve_all(self, runs: Sequence[ProblemRun]) -> list[Run]:
        """Solve all runs of the problem; called once, so that runs can be planned.

        Raises:
            Refused: The first run was refused for the reason that was expected.
            Unsolved: A run failed.
        """
        assert not self._asked, "a problem asks for its runs once"
        self._asked = True
        results = self.runner(runs)
        self.row.results = results
        failed_runs = [r for r in results if r.exit_code not in SOLVED]
        if failed_runs:
            first_failed = failed_runs[0]
            is_refusal = first_failed is results[0] and first_failed.exit_code in REFUSALS
            if is_refusal and self.row.refusal in Reason.within(first_failed.message):
                raise Refused(first_failed.message)
            lines = [f"{r.name}: exit code {r.exit_code}: {r.message}" for r in failed_runs]
            raise Unsolved("\n".join(lines))
        if self.row.tolerance is None:
            raise Missed("converged, though there is no answer")
        return [Run(r.folder) for r in results]

    def compare(self, *comparisons: Comparison) -> None:
        """Compare numbers with the exact ones; the worst counts.

        Raises:
            Missed: Its error exceeds the tolerance.
        """
        self.row.comparison = worst(comparisons)
        self.row.errors = [c.error for c in comparisons]
        self._judge()

    def converges(self, comparisons: Sequence[Comparison]) -> None:
        """Compare the finest run with the exact number, and the fitted order with theory's.

        Raises:
            Missed: The error exceeds the tolerance, or the orders differ.
        """
        self.row.comparison = comparisons[-1]
        self.row.errors = [c.error for c in comparisons]
        self.row.fitted = fitted_order(self.row.sizes, self.row.errors)
        self._judge()

    def _judge(self) -> None:
        row = self.row
        assert row.comparison is not None
        assert row.tolerance is not None
        error = row.comparison.error
        message = (
            f"{row.name}: error {error:.3g}, tolerance {row.tolerance:g}; {row.comparison.note}"
        )
        passes = error <= row.tolerance  # False for NaN
        if row.order is not None:
            message += f"; order {row.fitted}, expected {row.order:g}"
            passes &= row.fitted is not None and abs(row.fitted - row.order) <= ORDER_TOLERANCE
        if not passes:
            raise Missed(message)


@contextmanager
def judging(row: Row) -> Iterator[None]:
    """Note the outcome of a test in its row; end quietly if a refusal was expected.

    Raises:
        Missed: The error exceeds the tolerance.
        Exception: The problem could not be solved or judged.
    """
    try:
        yield
        row.outcome = PASSED
    except Refused as refusal:
        row.outcome = REFUSED
        row.message = str(refusal)
    except Missed as missed:
        row.outcome = MISSED
        if row.comparison is None:
            row.message = str(missed)
        if row.may_miss:
            pytest.xfail(str(missed))
        raise
    except Exception as error:
        log.debug("%s", row.name, exc_info=True)
        row.message = str(error) if isinstance(error, Unsolved) else f"cannot be judged: {error!r}"
        raise


# Test functions


def name_of_problem(item: pytest.Function) -> str:
    """Name of a problem: that of its test, with the parameters after it."""
    name = item.name.removeprefix("test_").removesuffix("]")
    return name.replace("[", "_").replace("/", "_").replace(" ", "_")


def tier_of(item: pytest.Function) -> str:
    """The first tier with a problem."""
    marked_tiers = [tier for tier in ("quick", "long") if item.get_closest_marker(tier)]
    return marked_tiers[0] if marked_tiers else "default"


def within(tier: str, chosen_tier: str) -> bool:
    """Return True if the chosen tier includes a tier."""
    return TIERS.index(tier) <= TIERS.index(chosen_tier)


def row_of(item: pytest.Function, suite: str) -> Row:
    """The row of a problem in a suite, before it is judged."""
    name = name_of_problem(item)
    marker = item.get_closest_marker(suite)
    group = suite if suite == "bench" else name.partition("_")[0]
    if marker and marker.kwargs:
        group = marker.kwargs["group"]
    return Row(name, group, tier_of(item))


def planned_runs(item: pytest.Function, row: Row, tier: str) -> Sequence[ProblemRun]:
    """The runs that a problem asks for in a tier; its row gets what is expected."""
    problem = KnownProblem(row, planning, tier)
    parameters = item.callspec.params if hasattr(item, "callspec") else {}
    try:
        with suppress(Missed):  # of a problem without runs
            item.obj(problem=problem, **parameters)
    except Planned as planned:
        return planned.runs
    return ()


# Runs


def planned_run(
    name: str, problem_run: ProblemRun, folder: Path, *, timed: bool = False
) -> PlannedRun:
    """A run as the campaigns plan it; a changed mesh is written below a folder.

    Raises:
        InputError: The case is wrong.
    """
    file = CONFIGS / problem_run.case
    options = (problem_run.ranks, timed, problem_run.share)
    planned = PlannedRun.load(name, file, problem_run.overrides, *options)
    if problem_run.mesh:
        mesh = change(planned.case, problem_run.mesh, folder / "meshes")
        planned = PlannedRun.load(name, file, (*mesh, *problem_run.overrides), *options)
    return planned


def solve_here(name: str, folder: Path) -> Runner:
    """A `Runner` that solves in this process, one run after another, each once.

    The log of each run is kept next to its folder, as campaigns do.
    """
    # Not at the top: the process of `mantle verify` starts ranks and must not initialize MPI.
    from app.simulation import finished_runs, session

    form_cache.patch_ffcx()  # other tests compile at the same time

    def solved(problem_run: ProblemRun, folder: Path) -> SolvedRun:
        message = ""
        code = 0
        log_handler = logging.FileHandler(folder.with_name(f"{folder.name}.log"), encoding="utf-8")
        log.addHandler(log_handler)
        try:
            planned = planned_run(name, problem_run, folder.parent)
            case = load_case(planned.file, planned.overrides)
            finished_runs.prepare(case, folder)
            with ranks.mpi_settings():
                session.run(case, folder, signals=False)
        except MantleError as error:
            message = str(error)
            code = error.exit_code
        finally:
            log.removeHandler(log_handler)
            log_handler.close()
        return SolvedRun(name, problem_run, folder, code, message)

    return lambda runs: [solved(problem_run, folder / str(k)) for k, problem_run in enumerate(runs)]


def solution(seconds: Mapping[str, float], apart: Sequence[str] = APART) -> float:
    """Seconds of assembly, set-up and solution, coarse problems included, or of other phases."""
    return sum(value for phase, value in seconds.items() if phase not in apart)
