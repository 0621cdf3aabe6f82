"""A check: runs of cases, and a judge of their error.

`verify`, `stress` and `bench` are lists of them; `engine` runs and judges all.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import configs
from app.campaigns.runs import Result
from app.foundation.verdict import Reason
from app.results.reading import Run

CONFIGS = configs.FOLDER
# Each tier contains those before it.
TIERS = ("quick", "default", "long")


@dataclass(frozen=True)
class CheckRun:
    """A run that a check needs.

    Attributes:
        case: The case file, below `CONFIGS`.
        overrides: As after ``--set``.
        mesh: Change of its mesh before the run, a name in `changed_meshes`, or "".
        size: Mesh size or time step where the runs are a ladder, else 0.
        tier: The first tier with this run.
        ranks: Number of MPI ranks.
        times: Number of repetitions, where its time is measured.
        share: Whether it shares a process with others of the check.
    """

    case: str
    overrides: tuple[str, ...] = ()
    mesh: str = ""
    size: float = 0.0
    tier: str = "quick"
    ranks: int = 1
    times: int = 1
    share: bool = False


@dataclass(frozen=True)
class Sample:
    """Error of an answer.

    Attributes:
        error: In the check's own measure.
        value: The answer, where it is one number.
        reference: The right answer.
        note: Remark for the report.
        errors: Of each run, where several are judged one by one.
    """

    error: float
    value: float | None = None
    reference: float | None = None
    note: str = ""
    errors: tuple[float, ...] = ()


Measure = Callable[[Run], Sample]
Judge = Callable[[Sequence[Run]], Sample]


@dataclass(frozen=True)
class Check:
    """Runs and the conditions they must satisfy.

    Attributes:
        name: Unique in its suite.
        what: Quantity compared, with its unit, and the scale of its error.
        runs: The run in question first, then those that it is compared with; a ladder goes from
            coarse to fine. Empty where the judge needs none.
        judge: Computes the error; None if there is no answer, and mantle has to say so.
        tolerance: Largest error; of the last run if they are a ladder.
        order: Order that theory gives; None where the runs are no ladder.
        refusal: Why mantle may, or has to, refuse it; None where it may not.
        tier: The first of `TIERS` with this check.
        group: Subject shared with other checks; the first word of its name by default.
        rung: Quantity that a ladder makes smaller, with its unit.
        timed: Whether nothing else runs beside its runs, and they are run in turn.
    """

    name: str
    what: str
    runs: tuple[CheckRun, ...]
    judge: Judge | None
    tolerance: float = 0.0
    order: float | None = None
    refusal: Reason | None = None
    tier: str = "default"
    group: str = ""
    rung: str = "mesh size (mm)"
    timed: bool = False

    def __post_init__(self) -> None:
        """Set the default group: the first word of the name."""
        object.__setattr__(self, "group", self.group or self.name.partition("_")[0])

    def up_to(self, tier: str) -> Check:
        """The check with the runs of a tier."""
        return replace(self, runs=tuple(r for r in self.runs if within(r.tier, tier)))


def within(tier: str, wanted: str) -> bool:
    """Whether the wanted tier includes a tier."""
    return TIERS.index(tier) <= TIERS.index(wanted)


def problem(
    name: str,
    what: str,
    case: str,
    measures: Measure | Sequence[Measure],
    tolerance: float,
    runs: Iterable[Sequence[str]] = ((),),
) -> Check:
    """A check of ``mantle verify``: the worst of the runs of a case with some overrides each.

    ``measures`` is one for all runs or one for each.
    """
    judge = each(measures) if callable(measures) else each(*measures)
    wanted = tuple(CheckRun(f"verification/{case}.yaml", tuple(o)) for o in runs)
    return Check(name, what, wanted, judge, tolerance)


def ladder(
    name: str,
    what: str,
    case: str,
    measure: Measure,
    tolerance: float,
    overrides: Sequence[str],
    sizes: Sequence[float],
    order: float = 2.0,
    rung: str = "mesh size (mm)",
) -> Check:
    """A check of ``mantle verify`` whose error falls with the mesh size, or a step, by an order.

    Sizes go from coarse to fine, the last for the tier "long"; ``{}`` in an override stands for
    the size, ``{n}`` for its inverse.
    """
    runs = tuple(
        CheckRun(
            f"verification/{case}.yaml",
            tuple(o.format(h, n=round(1 / h)) for o in overrides),
            size=h,
            tier="long" if h == sizes[-1] else "quick",
        )
        for h in sizes
    )
    return Check(name, what, runs, each(measure, last=True), tolerance, order, rung=rung)


def run(case: str, *overrides: str, mesh: str = "") -> CheckRun:
    """A run of a case with some overrides, on a mesh that may be changed first."""
    return CheckRun(case, overrides, mesh)


def row(
    name: str,
    runs: CheckRun | tuple[CheckRun, ...],
    judge: Judge | None,
    tolerance: float = 0.0,
    refusal: Reason | None = None,
    tier: str = "default",
) -> Check:
    """A row of ``mantle stress``, ``varied/what else is set/value``; the first is its group."""
    group, own = name.partition("/")[0], name.replace("/", "_").replace(" ", "_")
    runs = (runs,) if isinstance(runs, CheckRun) else runs
    return Check(own, "", runs, judge, tolerance, None, refusal, tier, group)


def each(*measures: Measure, last: bool = False) -> Judge:
    """Worst sample of all runs, or the last of a ladder; a measure for each run or one for all."""

    def judge(runs: Sequence[Run]) -> Sample:
        by_run = measures * len(runs) if len(measures) == 1 else measures
        samples = [measure(run) for measure, run in zip(by_run, runs, strict=True)]
        sample = samples[-1] if last else worst(samples)
        return replace(sample, errors=tuple(s.error for s in samples))

    return judge


def worst(samples: Sequence[Sample]) -> Sample:
    """The sample with the largest error; NaN is the worst."""
    return max(samples, key=lambda s: math.inf if math.isnan(s.error) else s.error)


PASSED, REFUSED, MISSED, FAILED = OUTCOMES = ("passed", "refused", "missed", "failed")


@dataclass(frozen=True)
class CheckResult:
    """Outcome of a check, one of `OUTCOMES`, with its reason; the fitted order of a ladder."""

    check: Check
    outcome: str
    message: str
    results: Sequence[Result] = ()
    sample: Sample | None = None
    order: float | None = None

    @property
    def seconds(self) -> float:
        """Wall time of its runs, shared ones included [s]."""
        return sum({r.folder: r.seconds for r in self.results}.values())

    @property
    def ratio(self) -> float:
        """Error over tolerance; 0 where a zero tolerance is met."""
        error = self.sample.error if self.sample else math.inf
        if math.isnan(error):
            return math.inf
        return error / self.check.tolerance if self.check.tolerance else error and math.inf

    def as_json(self) -> dict[str, Any]:
        """The entry of the JSON file."""
        c, s = self.check, self.sample or Sample(math.nan)
        return {
            "name": c.name,
            "group": c.group,
            "tier": c.tier,
            "outcome": self.outcome,
            "error": _number(s.error),
            "tolerance": c.tolerance if c.judge else None,
            "order": _number(self.order),
            "expected_order": c.order,
            "quantity": c.what,
            "value": _number(s.value),
            "reference": _number(s.reference),
            "rung": c.rung,
            "sizes": [r.size for r in c.runs] if c.order else [],
            "errors": [_number(e) for e in s.errors],
            "note": s.note,
            "message": self.message,
            "seconds": round(self.seconds, 2),
            "runs": [
                {
                    "folder": str(r.folder),
                    "case": str(r.planned.file),
                    "overrides": r.planned.overrides,
                }
                for r in self.results
            ],
        }


def by_group(outcomes: Sequence[CheckResult]) -> dict[str, list[CheckResult]]:
    """The results of each group of checks."""
    groups: dict[str, list[CheckResult]] = {}
    for o in outcomes:
        groups.setdefault(o.check.group, []).append(o)
    return groups


def _number(value: float | None) -> float | None:
    """The value if it is finite, else None: JSON has no other."""
    return None if value is None or not math.isfinite(value) else float(value)
