"""``mantle verify``: problems with known answers, solved and compared.

Writes ``verify.json`` and ``verify.png`` beside the runs, of a selection ``verify-NAME.json`` and
``verify-NAME.png``. Finished runs are not done again.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mantle.campaigns import batch
from mantle.campaigns.work_precision import fitted_order
from mantle.errors import InputError
from mantle.results.reading import Run
from mantle.system.folders import remove, write_json
from mantle.verification.measures import Sample
from mantle.verification.problem import CASES, Check
from mantle.verification.problems import problems
from mantle.verification.verify_picture import picture

log = logging.getLogger("mantle")

ORDER_TOLERANCE = 0.2


@dataclass(frozen=True)
class CheckResult:
    """Result of a problem.

    Attributes:
        problem: The problem.
        samples: What its runs gave, in their order; empty if one failed.
        seconds: Wall time of its runs, those it shares with others included.
        runs: Their folders.
        message: Why it could not be measured; empty if it could.
    """

    problem: Check
    samples: tuple[Sample, ...]
    seconds: float
    runs: tuple[str, ...] = ()
    message: str = ""

    @property
    def sizes(self) -> tuple[float, ...]:
        """Mesh sizes [mm] or time steps [s] of a ladder; empty if the runs are none."""
        return tuple(p.size for p in self.problem.points) if self.problem.order else ()

    @property
    def decisive(self) -> Sample | None:
        """The last sample of a ladder, the worst of other runs; None if a run failed."""
        if not self.samples:
            return None
        return self.samples[-1] if self.sizes else max(self.samples, key=_badness)

    @property
    def order(self) -> float | None:
        """Fitted order of a ladder."""
        if not self.samples or not self.sizes:
            return None
        return fitted_order(self.sizes, [s.error for s in self.samples])

    @property
    def passed(self) -> bool:
        """Whether error and order are as tolerated."""
        sample, order = self.decisive, self.order
        if sample is None or not sample.error <= self.problem.tolerance:
            return False
        return order is None or abs(order - (self.problem.order or 0.0)) <= ORDER_TOLERANCE

    def as_json(self) -> dict[str, Any]:
        """The entry of verify.json."""
        p, sample = self.problem, self.decisive
        return {
            "name": p.name,
            "error": _number(sample.error) if sample else None,
            "tolerance": p.tolerance,
            "order": self.order,
            "expected_order": p.order,
            "seconds": round(self.seconds, 2),
            "passed": self.passed,
            "quantity": p.quantity,
            "value": _number(sample.value) if sample else None,
            "reference": _number(sample.reference) if sample else None,
            "note": sample.note if sample else "",
            "sizes": list(self.sizes),
            "rung": p.rung,
            "errors": [_number(s.error) for s in self.samples],
            "runs": list(self.runs),
            "message": self.message,
        }


def run(pattern: str, folder: Path, fine: bool, cores: int) -> bool:
    """Solve the problems and compare.

    Args:
        pattern: Part of the names of the problems wanted; empty for all.
        folder: Where runs and results go.
        fine: Whether ladders have their finest rungs too.
        cores: How many cores to use at most.

    Returns:
        Whether all pass.

    Raises:
        InputError: No problem has such a name, or the folder cannot be written.
    """
    everything = problems(fine)
    chosen = [p for p in everything if pattern in p.name]
    if not chosen:
        names = ", ".join(p.name for p in everything)
        raise InputError(f"-k {pattern}: no problem has this in its name; allowed: {names}")
    jobs = [job for p in chosen for job in _jobs(p)]
    results = batch.run(jobs, folder, cores) if jobs else []
    outcomes = []
    for p in chosen:
        own, results = results[: len(p.points)], results[len(p.points) :]
        outcomes.append(measure(p, own))
    log.info("%s", table(outcomes))
    folder.mkdir(parents=True, exist_ok=True)
    entries = [outcome.as_json() for outcome in outcomes]
    name = "-".join(filter(None, ("verify", pattern)))
    drawing = folder / f"{name}.png"
    remove([drawing])  # should the new one fail, the old one is not beside new numbers
    write_json(folder / f"{name}.json", entries)
    picture(entries, drawing)
    log.info("%s\nresults in %s", verdict(outcomes), folder)
    return all(outcome.passed for outcome in outcomes)


def _jobs(p: Check) -> list[batch.Job]:
    """The runs of a problem."""
    numbered = len(p.points) > 1
    return [
        batch.Job(f"{p.name}_{k}" if numbered else p.name, CASES / p.case, point.overrides)
        for k, point in enumerate(p.points, start=1)
    ]


def measure(p: Check, results: Sequence[batch.Result]) -> CheckResult:
    """Compare the runs of a problem with what they should have given."""
    seconds = sum(r.seconds for r in results)
    runs = tuple(str(r.folder) for r in results)
    failed = [f"{r.job.name}: {r.message}" for r in results if r.exit_code]
    if failed:
        return CheckResult(p, (), seconds, runs, "\n".join(failed))
    try:
        samples = [point.measure(Run(r.folder)) for point, r in zip(p.points, results, strict=True)]
        samples += [p.direct()] if p.direct else []
    except Exception as error:  # of any kind: the other problems are still to be reported
        log.debug("%s", p.name, exc_info=True)
        return CheckResult(p, (), seconds, runs, f"cannot be measured: {error!r}")
    return CheckResult(p, tuple(samples), seconds, runs)


def table(outcomes: Sequence[CheckResult]) -> str:
    """The columns of verify.json, with a verdict, and what went wrong."""
    width = max(len(o.problem.name) for o in outcomes)
    lines = [
        f"{'problem':<{width}} {'error':>9} {'tolerance':>9} {'order':>6} {'expected':>8} "
        f"{'seconds':>8}  verdict"
    ]
    for o in outcomes:
        sample, order, p = o.decisive, o.order, o.problem
        error = f"{sample.error:.2e}" if sample else "-"
        orders = [f"{value:.2f}" if value is not None else "" for value in (order, p.order)]
        lines.append(
            f"{p.name:<{width}} {error:>9} {p.tolerance:>9.1e} {orders[0]:>6} {orders[1]:>8} "
            f"{o.seconds:>8.1f}  {'pass' if o.passed else 'FAIL'}"
            f"{f'  {sample.note}' if sample and sample.note else ''}"
        )
    for o in outcomes:
        if o.message:
            lines.append(f"{o.problem.name}: {o.message}".replace("\n", "\n  "))
    return "\n".join(lines)


def verdict(outcomes: Sequence[CheckResult]) -> str:
    """One sentence."""
    failing = [o.problem.name for o in outcomes if not o.passed]
    if not failing:
        return f"all {len(outcomes)} pass" if len(outcomes) > 1 else "it passes"
    return f"{len(failing)} of {len(outcomes)} fail: {', '.join(failing)}"


def _badness(sample: Sample) -> float:
    """The error, where none is worse than one that is no number."""
    return np.inf if np.isnan(sample.error) else sample.error


def _number(value: float) -> float | None:
    """A number that JSON has."""
    return float(value) if np.isfinite(value) else None
