"""``mantle fit``: search for values of keys with which numbers reach targets or an extremum.

The folder is that of a batch (`app/campaigns/batch.py`) with these files in addition::

    folder/fit.json      keys with uncertainties, numbers, verdicts, and all runs in their order
    folder/fit.csv       a row for each run: keys, numbers, misfit

In this module keys are fractions of their ranges. The search is repeatable: after a kill the same
command needs the same runs, and finished runs are not repeated.

**Targets.** ``least_squares`` of scipy (dogbox: Gauss-Newton steps in a box, by dogleg) minimises
the sum over the targets of ((number - value) / uncertainty)^2. Derivatives are differences over
`FitSearch.step` of a range; their runs are one batch. The method was chosen by a measurement: 3
functions of 2 keys with 3 targets, 20 fits each, with noise of 0, 0.1 and 0.5 uncertainties in
every number. The table has the excess of the sum of squares over its minimum: the 90th percentile
over the fits, for the function where it is largest.

    method                  runs (median)   excess for noise 0   0.1    0.5
    dogbox, step 5 %        12 to 18                     0.003   0.08   1.4
    trf, step 5 %           15 to 21                     0.003   0.45   1.1
    trf, step 0.2 %         10 to 22                     0.000   470    1800
    COBYQA                  20 to 22                     0.03    0.42   26
    COBYLA                  17 to 21                     1.4     4.9    16
    Nelder-Mead             40 to 60                     0.02    0.23   8.7

With an optimum at a bound, trf took 21 runs with an excess of 0.3, 7 and 90. dogbox took 13 runs
with an excess of 0.02, 1.2 and 14.

**Minimum and maximum.** COBYQA of scipy needs no derivatives and keeps bounds. It was
measured on 3 functions of 2 keys with an active constraint, 10 fits each, with noise of 0, 0.2 and
1 %. COBYQA took 11 to 22 runs (median) and COBYLA 14 to 23. SLSQP with differences of 5 % took 14
to 42 runs, at times more than 60. All came equally close to the optimum. A failed run counts as
infeasible.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.optimize import NonlinearConstraint, least_squares, minimize

from app.campaigns import batch, fit_results, fit_verdicts
from app.campaigns.batch import Options
from app.campaigns.fit_results import FitRecord, FitRun, Outcome
from app.campaigns.identifiability import identify
from app.case import fit as fit_file
from app.case.fit import FitProblem
from app.case.points import short_keys
from app.foundation.arrays import Floats
from app.foundation.errors import worst_error
from app.foundation.verdict import Severity
from app.system.folders import write_json, write_text, writing

log = logging.getLogger("mantle")

# Decrease of the sum of squares at which the search ends: a step of 0.1 uncertainties.
SMALL_DECREASE = 0.01
# Step at which the search ends, as a fraction of the ranges.
SMALL_STEP = 1e-3
# First and last radius of the trust region of COBYQA, as fractions of the ranges.
FIRST_RADIUS = 0.2
LAST_RADIUS = 0.005
# Violation of a constraint that COBYQA accepts, relative to its limit.
FEASIBLE = 1e-3


class _RunsUsed(Exception):
    """The search needs more runs than it may make."""


class Evaluations:
    """Runs of a search by the values of the keys; no run is made twice.

    Attributes:
        runs: The runs in the order of the search.
    """

    def __init__(self, problem: FitProblem, options: Options) -> None:
        self.problem = problem
        self.runs: list[FitRun] = []
        self._options = options
        self._by_values: dict[tuple[object, ...], FitRun] = {}
        self._short = [*short_keys(list(problem.fit.keys)).values()]

    def step(self, fractions: Floats) -> FitRun:
        """Return the run with keys at fractions (keys,) of their ranges; make it if it is new."""
        # Names with a comma are those of runs for derivatives.
        steps = sum(run.name.startswith("step") and "," not in run.name for run in self.runs)
        (run,) = self({f"step {steps + 1}": np.clip(fractions, 0.0, 1.0)})
        return run

    @property
    def done(self) -> list[FitRun]:
        """Runs that have results."""
        return [run for run in self.runs if run.done]

    def __call__(self, requested: Mapping[str, Floats]) -> list[FitRun]:
        """Make runs with given names and keys (keys,) as fractions of their ranges; return them.

        Raises:
            _RunsUsed: There would be more than `FitSearch.runs`.
        """
        values = {name: self.problem.values(fractions) for name, fractions in requested.items()}
        points = {name: tuple(key_values.values()) for name, key_values in values.items()}
        new_names = {point: name for name, point in points.items() if point not in self._by_values}
        if len(self.runs) + len(new_names) > self.problem.fit.runs:
            raise _RunsUsed
        planned, refusals = [], {}
        for name in new_names.values():
            runs, faults = self.problem.plan(name, requested[name])
            planned += runs
            refusals[name] = "refused: " + "; ".join(fault.text for fault in faults)
        results = {}
        if planned:
            options = self._options
            batch_results = batch.run(planned, options.folder, options.cores, options.slurm)
            results = {result.planned.name: result for result in batch_results}
        for point, name in new_names.items():
            run = fit_results.fit_run(
                self.problem, name, requested[name], results.get(name), refusals[name]
            )
            self._by_values[point] = run
            self.runs.append(run)
            log.info("%s", fit_results.line_of_run(self.problem, run))
        return [self._by_values[point] for point in points.values()]

    def derivatives(self, run: FitRun) -> Floats:
        """Return the derivatives of the numbers by the keys at a run (numbers, keys).

        They are differences from runs with one changed key. If such a run fails, the key is changed
        in the other direction; nan if this run fails, too.
        """
        step = self.problem.fit.step
        steps = {}
        for k, fraction in enumerate(run.fractions):
            steps[k] = step if fraction + step <= 1.0 else -step
        changed_runs = self._changed_runs(run, steps)
        opposite_steps = {}
        for k, changed_run in changed_runs.items():
            opposite = run.fractions[k] - steps[k]
            if not changed_run.done and 0.0 <= opposite <= 1.0:
                opposite_steps[k] = -steps[k]
        changed_runs |= self._changed_runs(run, opposite_steps)
        columns = []
        for k, changed_run in changed_runs.items():
            difference = changed_run.array - run.array
            columns.append(difference / (changed_run.fractions[k] - run.fractions[k]))
        return np.array(columns).T

    def _changed_runs(self, run: FitRun, steps: Mapping[int, float]) -> dict[int, FitRun]:
        """Make a run for each step of a key, by number of the key; the other keys are unchanged."""
        requested = {}
        for k, step in steps.items():
            sign = "+" if step > 0 else "-"
            unit = np.eye(len(run.fractions))[k]
            requested[f"{run.name}, {sign}{self._short[k]}"] = run.fractions + step * unit
        return dict(zip(steps, self(requested), strict=True))


def run(path: Path, overrides: Sequence[str], options: Options) -> FitRecord | None:
    """Search for the values of the keys of a fit, and write its record; None with ``dry_run``.

    Raises:
        InputError: The file has errors (all are in one message, before anything runs), or a number
            of the fit is not in the results.
        MantleError: The first run failed; the error has its exit code.
        StoppedError: Interrupted; the same command continues the search.
    """
    problem = fit_file.read(path, overrides)
    fit = problem.fit
    start_fractions = np.array([key.start_fraction for key in fit.keys.values()])
    if options.dry_run:
        planned, _ = problem.plan("start", start_fractions)
        title = f"{problem.title}: the first of at most {fit.runs} runs"
        log.info("%s", batch.table_of_planned_runs(title, planned, options))
        return None
    log.info("%s: %d keys, at most %d runs", problem.title, len(fit.keys), fit.runs)
    evaluate = Evaluations(problem, options)
    (start,) = evaluate({"start": start_fractions})
    if not start.done:
        message = f"the first run failed: {start.message}; choose another start of the keys"
        raise worst_error([start.exit_code], message)
    search = _reach_targets if fit.targets else _find_extremum
    outcome = search(evaluate, start)
    identified = None
    if fit.targets and outcome.derivatives is not None:
        uncertainties = np.array([target.uncertainty for target in fit.number_targets.values()])
        identified = identify(np.nan_to_num(outcome.derivatives / uncertainties[:, None]))
    verdicts = fit_verdicts.verdicts(problem, evaluate.runs, outcome, identified)
    record = fit_results.record_of_fit(
        problem, options.folder, evaluate.runs, outcome, identified, verdicts
    )
    with writing(options.folder):
        write_json(options.folder / "fit.json", record)
        write_text(options.folder / "fit.csv", fit_results.csv_of_fit(record))
    log.info("\n%s", fit_results.text_of_fit(record))
    for verdict in verdicts:
        if verdict.severity is not Severity.ERROR:
            log.warning("note: %s", verdict.text)
    log.info("fit.json and fit.csv are written in %s", options.folder)
    return record


def _reach_targets(evaluate: Evaluations, start: FitRun) -> Outcome:
    """Fit the keys to the targets by least squares."""
    fit = evaluate.problem.fit
    values = np.array([target.value for target in fit.number_targets.values()])
    uncertainties = np.array([target.uncertainty for target in fit.number_targets.values()])
    derivatives: Floats | None = None

    def deviations(fractions: Floats) -> Floats:
        # The last entry is 1, so that the sum of squares never vanishes: `ftol`, which is relative,
        # then also ends a fit that is exact.
        return np.append((evaluate.step(fractions).array - values) / uncertainties, 1.0)

    def jacobian(fractions: Floats) -> Floats:
        nonlocal derivatives
        derivatives = evaluate.derivatives(evaluate.step(fractions))
        scaled = np.nan_to_num(derivatives / uncertainties[:, None])
        return np.vstack([scaled, np.zeros(len(fractions))])

    try:
        least_squares_result = least_squares(
            deviations,
            start.fractions,
            jacobian,
            bounds=(0.0, 1.0),
            method="dogbox",
            ftol=SMALL_DECREASE,
            xtol=SMALL_STEP,
            gtol=None,
            max_nfev=fit.runs,
        )
    except _RunsUsed:
        return Outcome(min(evaluate.done, key=lambda run: run.misfit), derivatives, False)
    return Outcome(
        evaluate.step(least_squares_result.x), derivatives, least_squares_result.status > 0
    )


def _cost(problem: FitProblem, run: FitRun) -> float:
    """Objective of a run, with opposite sign if it is maximised; nan if the run failed."""
    fit = problem.fit
    sign = 1.0 if fit.minimise else -1.0
    if fit.objective in fit.keys:
        fraction = float(run.fractions[[*fit.keys].index(fit.objective)])
        return sign * fraction if run.done else math.nan
    return sign * float(run.array[fit.numbers.index(fit.objective)])


def _violations(problem: FitProblem, run: FitRun) -> Floats:
    """Violation of each bound of a number, relative to the bound; negative if the bound is kept."""
    fit = problem.fit
    violations = []
    for name, (lower_bound, upper_bound) in fit.limits.items():
        value = float(run.array[fit.numbers.index(name)])
        if math.isfinite(lower_bound):
            violations.append((lower_bound - value) / (abs(lower_bound) or 1.0))
        if math.isfinite(upper_bound):
            violations.append((value - upper_bound) / (abs(upper_bound) or 1.0))
    return np.array(violations)


def _find_extremum(evaluate: Evaluations, start: FitRun) -> Outcome:
    """Search for the smallest or largest objective under the constraints."""
    problem = evaluate.problem
    scale = abs(_cost(problem, start)) or 1.0

    def cost(fractions: Floats) -> float:
        return _cost(problem, evaluate.step(fractions)) / scale

    def violations(fractions: Floats) -> Floats:
        return _violations(problem, evaluate.step(fractions))

    constraints = [NonlinearConstraint(violations, -np.inf, 0.0)] if problem.fit.limits else []
    options = {
        "initial_tr_radius": FIRST_RADIUS,
        "final_tr_radius": LAST_RADIUS,
        "feasibility_tol": FEASIBLE,
    }
    bounds = [(0.0, 1.0)] * len(start.fractions)
    converged = True
    derivatives = None
    try:
        minimize(
            cost,
            start.fractions,
            method="COBYQA",
            bounds=bounds,
            constraints=constraints,
            options=options,
        )
    except _RunsUsed:
        converged = False
    feasible = [run for run in evaluate.done if (_violations(problem, run) <= 0.0).all()]
    if feasible:
        best_run = min(feasible, key=lambda run: _cost(problem, run))
    else:
        best_run = min(evaluate.done, key=lambda run: float(_violations(problem, run).max()))
    try:
        derivatives = evaluate.derivatives(best_run)
    except _RunsUsed:
        converged = False
    return Outcome(best_run, derivatives, converged)
