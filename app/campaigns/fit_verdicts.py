"""Verdicts on the result of a fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from app.campaigns import identifiability
from app.campaigns.fit_results import FitRecord, FitRun, Outcome, at_bound, number_with_unit
from app.campaigns.identifiability import KNOWN_RANGE, Identifiability
from app.case.fit import FitProblem
from app.case.points import short_keys
from app.foundation.arrays import Floats
from app.foundation.errors import ConvergenceError, UnusableError, worst_error
from app.foundation.layout import two_digits
from app.foundation.verdict import Severity, Verdict, recorded, texts_of

# Deviation from its target that makes a number doubtful [standard uncertainties].
DOUBTFUL = 2.0
# Deviation above which a number has missed its target [standard uncertainties].
NOT_REACHED = 3.0
# Change of a number over the range of a key below which it is rounding, relative to the number.
ROUNDING_OF_CHANGES = 1e-6


def verdicts(
    problem: FitProblem,
    runs: Sequence[FitRun],
    outcome: Outcome,
    identifiability: Identifiability | None,
) -> list[Verdict]:
    """Return the verdicts on runs, keys and their uncertainty, and targets or constraints."""
    all_verdicts = [
        *_of_runs(problem, runs, outcome),
        *_of_keys(problem, outcome.best, identifiability),
    ]
    if problem.fit.targets:
        all_verdicts += _of_targets(problem, outcome.best)
    else:
        all_verdicts += _of_constraints(problem, outcome.best)
    if identifiability is not None:
        all_verdicts += _of_knowledge(problem, identifiability)
    elif outcome.derivatives is not None:
        all_verdicts += _of_influence(problem, outcome.derivatives, outcome.best)
    return all_verdicts


def _of_runs(problem: FitProblem, runs: Sequence[FitRun], outcome: Outcome) -> Iterator[Verdict]:
    """Verdicts on the number of runs and on failed runs."""
    if not outcome.converged:
        statement = f"the search stopped after {len(runs)} runs, before it converged"
        remedy = f"set fit.runs above {problem.fit.runs}; run the same command again to continue"
        yield Verdict(statement, "fit.runs", remedy)
    failed_runs = [run for run in runs if not run.done]
    if failed_runs:
        reasons = "; ".join(f"{run.name}: {run.message}" for run in failed_runs)
        statement = (
            f"{len(failed_runs)} of {len(runs)} runs failed and count as infeasible: {reasons}"
        )
        yield Verdict(statement, severity=Severity.WARNING)
    if outcome.derivatives is not None:
        for k, key in enumerate(problem.fit.keys):
            if np.isnan(outcome.derivatives[:, k]).any():
                statement = (
                    "runs on both sides of the result failed, so that its influence is unknown"
                )
                yield Verdict(statement, key, "choose other bounds", Severity.WARNING)


def _of_keys(
    problem: FitProblem, best_run: FitRun, identified: Identifiability | None
) -> Iterator[Verdict]:
    """Verdicts on keys at their bounds, without keys that the targets do not determine."""
    fit = problem.fit
    for k, (key, bounds) in enumerate(fit.keys.items()):
        bound = at_bound(float(best_run.fractions[k]))
        if not bound or (identified is not None and identified.uncertainties[k] >= KNOWN_RANGE):
            continue
        bound_name, end = ("lower", bounds.low) if bound == "low" else ("upper", bounds.high)
        statement = f"is at its {bound_name} bound, {end}"
        remedy = f"set another '{bound}' if values beyond it are possible"
        severity = Severity.WARNING if fit.targets else Severity.PLAIN
        yield Verdict(statement, key, remedy, severity)


def _of_targets(problem: FitProblem, best_run: FitRun) -> Iterator[Verdict]:
    """Verdicts on targets that the best run does not reach."""
    bounded = any(at_bound(float(fraction)) for fraction in best_run.fractions)
    remedy = "widen the bounds" if bounded else "check the target and its uncertainty"
    remedy = f"{remedy}, or add a key that changes this number"
    for name, value in zip(problem.fit.numbers, best_run.array, strict=True):
        target = problem.fit.number_targets[name]
        deviation = abs(value - target.value) / target.uncertainty
        if deviation > DOUBTFUL:
            statement = (
                f"is {number_with_unit(name, float(value))} at best and cannot reach"
                f" {number_with_unit(name, target.value)}: {deviation:.1f} uncertainties of"
                f" {number_with_unit(name, target.uncertainty)} remain"
            )
            severity = Severity.ERROR if deviation > NOT_REACHED else Severity.WARNING
            yield Verdict(statement, name, remedy, severity)


def _of_knowledge(problem: FitProblem, identified: Identifiability) -> Iterator[Verdict]:
    """Verdicts on keys that the targets do not determine, or only in combination."""
    fit = problem.fit
    short_names = [*short_keys(list(fit.keys)).values()]
    full_keys = [*fit.keys]
    for direction in identified.undetermined():
        if len(direction) == 1:
            (k,) = direction
            lower_bound, upper_bound = fit.keys[full_keys[k]].low, fit.keys[full_keys[k]].high
            statement = (
                f"the targets do not determine it: from one bound to the other ({lower_bound} to"
                f" {upper_bound}) the numbers change by {two_digits(identified.influence[k])} of"
                " their uncertainties"
            )
            yield Verdict(
                statement,
                full_keys[k],
                "leave this key out, or add a number that depends on it",
            )
            continue
        combination = identifiability.direction_in_words(direction, short_names)
        counts = ""
        if len(fit.targets) < len(fit.keys):
            counts = f"{len(fit.keys)} keys and {len(fit.targets)} targets: "
        statement = (
            f"{counts}the targets do not determine these keys one by one: the numbers hardly change"
            f" if {combination} change together"
        )
        remedy = "fix one of them, or add a number that depends on them in another way"
        yield Verdict(statement, ", ".join(full_keys[k] for k in direction), remedy)


def _of_influence(problem: FitProblem, derivatives: Floats, best_run: FitRun) -> Iterator[Verdict]:
    """Verdicts on keys without influence on any number."""
    largest_changes = np.abs(np.nan_to_num(derivatives))
    for k, key in enumerate(problem.fit.keys):
        if (
            key != problem.fit.objective
            and (largest_changes[:, k] <= ROUNDING_OF_CHANGES * abs(best_run.array)).all()
        ):
            statement = "has no influence on the numbers, so that its value is arbitrary"
            yield Verdict(statement, key, "leave this key out", Severity.WARNING)


def _of_constraints(problem: FitProblem, best_run: FitRun) -> Iterator[Verdict]:
    """Verdicts on the constraints of the best run."""
    fit = problem.fit
    for name, (lower_bound, upper_bound) in fit.limits.items():
        value = float(best_run.array[fit.numbers.index(name)])
        for limit, relation, excess in (
            (lower_bound, "at least", lower_bound - value),
            (upper_bound, "at most", value - upper_bound),
        ):
            if excess > 0:
                closest, bound = number_with_unit(name, value), number_with_unit(name, limit)
                statement = (
                    f"no run meets all constraints; in the closest one it is {closest}, and it must"
                    f" be {relation} {bound}"
                )
                yield Verdict(
                    statement, name, "widen the bounds of the keys, or relax this constraint"
                )


def raise_faults(fit_record: FitRecord) -> None:
    """Raise the errors among the verdicts of a fit.

    Raises:
        ConvergenceError: The search used all its runs.
        UnusableError: The result must not be used.
    """
    errors = texts_of(recorded(fit_record), Severity.ERROR)
    if errors:
        codes = (
            [UnusableError.exit_code] if fit_record["converged"] else [ConvergenceError.exit_code]
        )
        raise worst_error(codes, "\n".join(errors))
