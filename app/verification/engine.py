"""Engine of ``mantle verify``, ``stress`` and ``bench``: runs checks, judges and reports.

Writes ``SUITE.json``, ``SUITE.csv`` (the cost of each run) and ``SUITE.png`` beside the runs, of a
selection ``SUITE-TIER-NAME.json`` and so on. Finished runs are not done again.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from app.campaigns import batch
from app.campaigns.batch import Options
from app.campaigns.runs import Result
from app.campaigns.work_precision import fitted_order
from app.case.case import PlannedRun
from app.foundation.errors import ConvergenceError, GeometryError, InputError, UnusableError
from app.foundation.verdict import Reason
from app.results.reading import Run
from app.system import layout
from app.system.folders import csv_text, remove, write_json, write_text
from app.verification import picture
from app.verification.benchmarks import benchmarks, solution
from app.verification.changed_meshes import change
from app.verification.check import (
    CONFIGS,
    FAILED,
    MISSED,
    OUTCOMES,
    PASSED,
    REFUSED,
    Check,
    CheckResult,
    by_group,
    within,
)
from app.verification.closed_forms_creep import creep_rows
from app.verification.extreme_cases import extremes
from app.verification.extreme_cohesion import breaking
from app.verification.heat_problems import heat_problems
from app.verification.invariance_cases import condensed, invariants
from app.verification.problems import problems
from app.verification.remodelling_problems import densities
from app.verification.validation import GROUP

log = logging.getLogger("mantle")

# Exit codes of a refusal.
REFUSALS = tuple(e.exit_code for e in (InputError, GeometryError, ConvergenceError))
ORDER_TOLERANCE = 0.2
MOST_NAMES = 100  # in a message


def stress_rows() -> list[Check]:
    """Checks of ``mantle stress``, with the stiff problems of ``mantle verify``."""
    stiff = [p for p in heat_problems() if p.group == "stiff"]
    heat = [replace(p, name=p.name.replace("stiff", "heat", 1), group="heat") for p in stiff]
    rows = [*extremes(), *breaking(), *invariants()]
    return [*rows, *creep_rows(), *densities(), *heat, *condensed(rows)]


# The checks of each command.
SUITES: dict[str, Callable[[], list[Check]]] = {
    "verify": problems,
    "stress": stress_rows,
    "bench": benchmarks,
}


def run(suite: str, options: Options) -> bool:
    """Run the checks of a suite, one of `SUITES`, and judge them, or log the plan of it.

    Returns:
        Whether all passed; of a benchmark, whether all could be measured.

    Raises:
        InputError: No check has such a name, or the folder cannot be written.
    """
    checks = _chosen(suite, options)
    planned = {c.name: list(_planned(c, options.folder)) for c in checks}
    if options.dry_run:
        jobs = [job for runs in planned.values() for job, _, _ in runs if job]
        log.info("%s", batch.plan(f"{suite}: {len(checks)} checks", jobs, options))
        return True
    found = _run(checks, planned, options)
    outcomes = []
    for check in checks:
        results: list[Result] = []
        for job, times, _ in planned[check.name]:
            if job:
                results += [found[_same(job), k] for k in range(times)]
        reasons = [why for _, _, why in planned[check.name]]
        outcomes.append(_refused(check, reasons) if any(reasons) else judge(check, results))
    log.info("%s", table(outcomes))
    _write(suite, options, outcomes)
    log.info("%s\nresults in %s", verdict(outcomes), options.folder)
    # A goal or an experiment that is missed is a result; an error in what is known is not.
    goals = [suite == "bench" or o.check.group == GROUP for o in outcomes]
    return all(
        o.outcome in (PASSED, REFUSED) or (o.outcome == MISSED and goal)
        for o, goal in zip(outcomes, goals, strict=True)
    )


def _chosen(suite: str, options: Options) -> list[Check]:
    everything = [c for c in SUITES[suite]() if within(c.tier, options.tier)]
    chosen = [c.up_to(options.tier) for c in everything if options.pattern in c.name]
    if not chosen:
        names = [c.name for c in everything]
        few = names if len(names) <= MOST_NAMES else dict.fromkeys(c.group for c in everything)
        text = f"-k {options.pattern}: no check of this tier has this in its name; allowed: "
        raise InputError(text + ", ".join(few))
    return chosen


Planned = tuple[PlannedRun | None, int, str]
# A run without its name.
Same = tuple[Path, tuple[str, ...], int, bool, bool]


def _planned(check: Check, folder: Path) -> Iterator[Planned]:
    """Each run as planned and how often; None with the reason if it is refused before it begins."""
    for k, run in enumerate(check.runs, start=1):
        name = f"{check.name}_{k}" if len(check.runs) > 1 else check.name
        options = run.ranks, check.timed, run.share
        try:
            planned = PlannedRun.load(name, CONFIGS / run.case, run.overrides, *options)
            if run.mesh:
                mesh = change(planned.case, run.mesh, folder / "meshes")
                overrides = (*mesh, *run.overrides)
                planned = PlannedRun.load(name, planned.file, overrides, *options)
        except InputError as error:
            yield None, run.times, str(error)
        else:
            yield planned, run.times, ""


def _refused(check: Check, reasons: Sequence[str]) -> CheckResult:
    """Judge a check by the reasons why its runs were refused before they began, or ""."""
    if reasons[0] and check.refusal in Reason.within(reasons[0]):
        return CheckResult(check, REFUSED, reasons[0])
    return CheckResult(check, FAILED, "\n".join(filter(None, reasons)))


def _run(
    checks: Sequence[Check], planned: Mapping[str, list[Planned]], options: Options
) -> dict[tuple[Same, int], Result]:
    """Results by `_same` job and number of earlier runs of it; failed jobs are not repeated.

    Timed checks go one after the other, their runs in turn, so that disturbances on the machine
    affect them all.
    """
    found: dict[tuple[Same, int], Result] = {}
    together = [[c for c in checks if not c.timed], *([c] for c in checks if c.timed)]
    for some in together:
        wanted = [(job, times) for c in some for job, times, _ in planned[c.name] if job]
        for k in range(max((times for _, times in wanted), default=0)):
            folder = options.folder / f"again-{k}" if k else options.folder
            asked = {_same(job): job for job, times in wanted if times > k}
            jobs = {key: job for key, job in asked.items() if (key, k) not in found}
            if jobs:
                results = batch.run(list(jobs.values()), folder, options.cores, options.slurm)
                found |= {(key, k): r for key, r in zip(jobs, results, strict=True)}
    return found


def _same(job: PlannedRun) -> Same:
    return job.file, job.overrides, job.ranks, job.alone, job.share


def judge(check: Check, results: Sequence[Result]) -> CheckResult:
    """Judge a check by the results of its runs, in their order."""
    # Whether numbers are right is judged here, also those that are not to be used.
    failed = [r for r in results if r.exit_code not in (0, UnusableError.exit_code)]
    if failed:
        first = failed[0]
        explained = first is results[0] and first.exit_code in REFUSALS
        if explained and check.refusal in Reason.within(first.message):
            return CheckResult(check, REFUSED, first.message, results)
        why = "\n".join(f"{r.planned.name}: exit code {r.exit_code}: {r.message}" for r in failed)
        return CheckResult(check, FAILED, why, results)
    if check.judge is None:
        return CheckResult(check, MISSED, "converged, though there is no answer", results)
    try:
        sample = check.judge([Run(r.folder) for r in results])
        sizes = [run.size for run in check.runs]
        order = None if check.order is None else fitted_order(sizes, sample.errors)
    except Exception as error:  # of any kind: the other checks are still to be reported
        log.debug("%s", check.name, exc_info=True)
        return CheckResult(check, FAILED, f"cannot be judged: {error!r}", results)
    right = sample.error <= check.tolerance
    right &= order is None or abs(order - (check.order or 0.0)) <= ORDER_TOLERANCE
    return CheckResult(check, PASSED if right else MISSED, "", results, sample, order)


def table(outcomes: Sequence[CheckResult]) -> str:
    """A line for each check, one for each group if there are several, and the failures."""
    head = ("check", "error", "tolerance", "order", "expected", "seconds", "outcome", "")
    text = [layout.table(head, map(_line, outcomes))]
    groups = by_group(outcomes)
    if len(groups) > 1:
        titles = ("group", "checks", *OUTCOMES, "seconds", "worst", "of", "")
        text.append(layout.table(titles, (_summed(name, own) for name, own in groups.items())))
    for o in outcomes:
        if o.outcome in (MISSED, FAILED) and o.message:
            text.append(f"{o.check.name} {o.outcome}: {o.message}".replace("\n", "\n  "))
    return "\n\n".join(text)


def _line(o: CheckResult) -> Sequence[object]:
    c, s = o.check, o.sample
    orders = [f"{value:.2f}" if value is not None else "" for value in (o.order, c.order)]
    error = f"{s.error:.2e}" if s else "-"
    tolerance = f"{c.tolerance:.1e}" if c.judge else "-"
    note = s.note if s else ""
    return (c.name, error, tolerance, *orders, f"{o.seconds:.1f}", o.outcome, note)


def _summed(name: str, own: Sequence[CheckResult]) -> Sequence[object]:
    counts = Counter(o.outcome for o in own)
    judged = [o for o in own if o.sample]
    worst = max(judged, key=lambda o: o.ratio, default=None)
    last: Sequence[object] = ("", "", "")
    if worst is not None and worst.sample:
        c = worst.check
        last = (f"{worst.sample.error:.1e}", f"{c.tolerance:.1e}", c.name)
    seconds = f"{sum(o.seconds for o in own):.1f}"
    return (name, len(own), *(counts[x] or "" for x in OUTCOMES), seconds, *last)


def verdict(outcomes: Sequence[CheckResult]) -> str:
    """Number of checks passed, and names of the others."""
    names = {x: [o.check.name for o in outcomes if o.outcome == x] for x in OUTCOMES}
    said = ", ".join(f"{len(own)} {x}" for x, own in names.items() if own)
    off = ", ".join(names[MISSED] + names[FAILED])
    plural = "s" if len(outcomes) > 1 else ""
    return f"{len(outcomes)} check{plural}: {said}" + (f": {off}" if off else "")


def _write(suite: str, options: Options, outcomes: Sequence[CheckResult]) -> None:
    tier = options.tier if options.tier != "default" else ""
    name = "-".join(filter(None, (suite, tier, options.pattern)))
    options.folder.mkdir(parents=True, exist_ok=True)
    drawing = options.folder / f"{name}.png"
    remove([drawing])  # should the new one fail, the old one is not beside new numbers
    write_json(options.folder / f"{name}.json", [o.as_json() for o in outcomes])
    write_text(options.folder / f"{name}.csv", csv_text(list(costs(outcomes))))
    picture.draw(outcomes, drawing)


def costs(outcomes: Iterable[CheckResult]) -> Iterator[dict[str, Any]]:
    """Cost of each finished run, a row for each."""
    done = {r.folder: r for o in outcomes for r in o.results if r.summary}
    for r in done.values():
        solver, timing = r.summary.get("solver", {}), r.summary.get("timing", {})
        yield {
            "run": r.planned.name,
            "ranks": r.planned.ranks,
            "unknowns": solver.get("dofs"),
            "newton": solver.get("newton_iterations"),
            "krylov": solver.get("linear_iterations"),
            "solution [CPU s]": round(solution(r.summary.get("cpu", {})), 3),
            "wall [s]": round(r.seconds, 3),
            "mesh [s]": timing.get("mesh"),
            "memory [MB]": r.summary.get("memory", {}).get("peak"),
        }
