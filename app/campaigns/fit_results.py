"""Results of a fit: its runs, keys with uncertainties, and tables."""

from __future__ import annotations

import math
import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NotRequired, TypedDict

import numpy as np

from app.campaigns.identifiability import KNOWN_RANGE, Identifiability
from app.campaigns.runs import Result, reason
from app.case import number_text, points, quantities, summary_numbers
from app.case.fit import FitProblem
from app.case.points import short_keys
from app.foundation import layout
from app.foundation.arrays import Floats
from app.foundation.errors import InputError
from app.foundation.verdict import Verdict
from app.schema.yaml_file import Fault
from app.system import identity
from app.system.folders import csv_text

# Half width of a 95 % interval [standard uncertainties].
INTERVAL = 1.96
# Distance to a bound at which a key has reached it, as a fraction of its range.
AT_BOUND = 2e-3


@dataclass(frozen=True)
class FitRun:
    """A run of a fit.

    Attributes:
        name: ``start``, ``step 3``, or ``step 3, +friction_coefficient`` for a derivative.
        fractions: Keys as fractions of their ranges, after rounding in the case (keys,).
        values: Values of the keys.
        array: Numbers of the fit in units of ``summary.json`` (numbers,); nan if the run failed.
        misfit: Sum over the targets of the squares of (number - value) / uncertainty; nan without
            targets.
        exit_code: 0 if it is done.
        message: Reason of a failure; empty if it is done.
        seconds: Wall time [s].
        folder: Run directory; None if the case was refused.
    """

    name: str
    fractions: Floats
    values: dict[str, object]
    array: Floats
    misfit: float
    exit_code: int
    message: str
    seconds: float
    folder: Path | None

    @property
    def done(self) -> bool:
        """Return True if the run has numbers."""
        return self.exit_code == 0


@dataclass(frozen=True)
class Outcome:
    """Result of a search.

    Attributes:
        best: The run with the fitted values; if no run meets the constraints, the closest one.
        derivatives: Derivatives of the numbers by the keys as fractions of their ranges
            (numbers, keys); nan where runs failed. None if there were too few runs.
        converged: False if the search ended because it had used its number of runs.
    """

    best: FitRun
    derivatives: Floats | None
    converged: bool


class KeyRow(TypedDict):
    """A key in ``fit.json``.

    Attributes:
        value: Value with its unit, as in a case.
        number: Value without unit.
        unit: Its unit.
        low: Lower bound.
        high: Upper bound.
        scale: Scale of its range.
        uncertainty: Standard uncertainty by the targets; None if they do not determine it.
        interval: Ends of its 95 % interval, within the bounds; empty without uncertainty.
        at: ``low`` or ``high`` if the key is at a bound; otherwise empty.
    """

    value: object
    number: float
    unit: str
    low: float
    high: float
    scale: Literal["linear", "logarithmic"]
    uncertainty: float | None
    interval: list[float]
    at: str


class NumberRow(TypedDict):
    """A number in ``fit.json``, in the unit of ``summary.json``.

    Attributes:
        value: Value in the best run.
        unit: Its unit.
        derivatives: Change over the range of each key, by the derivatives at the best run.
        target: Target value.
        uncertainty: Its standard uncertainty.
        deviation: (value - target) / uncertainty [-].
        at_least: Lower bound.
        at_most: Upper bound.
    """

    value: float
    unit: str
    derivatives: dict[str, float | None]
    target: NotRequired[float]
    uncertainty: NotRequired[float]
    deviation: NotRequired[float]
    at_least: NotRequired[float]
    at_most: NotRequired[float]


class FitRow(TypedDict):
    """A run in ``fit.json``."""

    name: str
    values: dict[str, object]
    shares: list[float]
    numbers: dict[str, float]
    misfit: float | None
    exit_code: int
    message: str
    seconds: float
    folder: str


class FitRecord(TypedDict):
    """Content of ``fit.json``.

    Attributes:
        title: Title of the fit.
        file: Its file.
        overrides: Options ``--set``.
        program: Version and hash of the program.
        aim: ``targets``, ``minimise`` or ``maximise``.
        objective: Number or key of the aim; empty with targets.
        converged: False if the search used all its runs.
        best: Name of the run with the fitted values.
        command: Command that repeats this run.
        misfit: Its sum of squares; None without targets.
        keys: Fitted keys.
        numbers: Numbers of the aim and of the constraints.
        correlation: Correlation of the keys; None if undetermined. Empty without targets.
        covariance: Covariance of the keys as fractions of their ranges, without the directions that
            the targets do not determine. Empty without targets.
        singular_values: Singular values of the derivatives (`app/campaigns/identifiability.py`).
            Empty without targets.
        verdicts: Verdicts on the result.
        runs: All runs in their order.
    """

    title: str
    file: str
    overrides: list[str]
    program: str
    aim: str
    objective: str
    converged: bool
    best: str
    command: str
    misfit: float | None
    keys: dict[str, KeyRow]
    numbers: dict[str, NumberRow]
    correlation: list[list[float | None]]
    covariance: list[list[float]]
    singular_values: list[float]
    verdicts: list[dict[str, str]]
    runs: list[FitRow]


def fit_run(
    problem: FitProblem, name: str, fractions: Floats, result: Result | None, refusal: str
) -> FitRun:
    """Return a run of a fit, from its result or the reason of its refusal.

    Raises:
        InputError: The results do not contain a number of the fit.
    """
    number_names = problem.fit.numbers
    values = problem.values(fractions)
    array: Floats = np.full(len(number_names), np.nan)
    if result is None:
        code, message = InputError.exit_code, refusal
        return FitRun(name, fractions, values, array, math.nan, code, message, 0.0, None)
    if result.exit_code == 0:
        numbers = {n: summary_numbers.read(result.summary, n) for n in number_names}
        text = "is not in summary.json of this case; mantle explain lists the results"
        faults = [Fault(problem.path_of(n), text) for n, v in numbers.items() if v is None]
        problem.file.raise_all(faults)
        array = np.array([v for v in numbers.values() if v is not None])
    misfit = math.nan
    targets = problem.fit.number_targets
    if targets:
        pairs = zip(array, targets.values(), strict=True)
        misfit = float(sum(((v - t.value) / t.uncertainty) ** 2 for v, t in pairs))
    return FitRun(
        name,
        fractions,
        values,
        array,
        misfit,
        result.exit_code,
        reason(result.message),
        result.seconds,
        result.folder,
    )


def record_of_fit(
    problem: FitProblem,
    folder: Path,
    runs: Sequence[FitRun],
    outcome: Outcome,
    identifiability: Identifiability | None,
    verdicts: Sequence[Verdict],
) -> FitRecord:
    """Content of ``fit.json``.

    Args:
        problem: The fit.
        folder: Its folder.
        runs: All runs in their order.
        outcome: Result of the search.
        identifiability: Uncertainties of the keys from the targets; None without targets or
            derivatives.
        verdicts: Verdicts on the result.
    """
    fit, best_run = problem.fit, outcome.best
    overrides = [*points.as_overrides(problem.changes(best_run.values)), *problem.overrides]
    override_options = " ".join(f"--set {shlex.quote(override)}" for override in overrides)
    if fit.targets:
        aim = "targets"
    else:
        aim = "minimise" if fit.minimise else "maximise"
    return {
        "title": problem.title,
        "file": str(problem.path),
        "overrides": list(problem.overrides),
        "program": identity.program(),
        "aim": aim,
        "objective": fit.objective,
        "converged": outcome.converged,
        "best": best_run.name,
        "command": f"mantle run {shlex.quote(str(problem.base))} {override_options}",
        "misfit": best_run.misfit if fit.targets else None,
        "keys": _key_rows(problem, best_run, identifiability),
        "numbers": _number_rows(problem, best_run, outcome.derivatives),
        "correlation": [_plain(row) for row in identifiability.correlation]
        if identifiability
        else [],
        "covariance": [_floats(row) for row in identifiability.covariance]
        if identifiability
        else [],
        "singular_values": _floats(identifiability.singular_values) if identifiability else [],
        "verdicts": [verdict.record() for verdict in verdicts],
        "runs": [_run_row(problem, run, folder) for run in runs],
    }


def _floats(values: Floats) -> list[float]:
    """Return numbers for JSON."""
    return [float(v) for v in values]


def _plain(values: Floats) -> list[float | None]:
    """Return numbers for JSON, with None for nan."""
    return [float(v) if math.isfinite(v) else None for v in values]


def _key_rows(
    problem: FitProblem, best_run: FitRun, identified: Identifiability | None
) -> dict[str, KeyRow]:
    rows: dict[str, KeyRow] = {}
    for k, (key, bounds) in enumerate(problem.fit.keys.items()):
        fraction = float(best_run.fractions[k])
        deviation = float(identified.uncertainties[k]) if identified else math.inf
        determined = deviation < KNOWN_RANGE
        interval_ends = (
            max(0.0, fraction - INTERVAL * deviation),
            min(1.0, fraction + INTERVAL * deviation),
        )
        # Half of the interval of one deviation, which also holds on a logarithmic scale.
        interval = bounds.number(fraction + deviation) - bounds.number(fraction - deviation)
        rows[key] = {
            "value": best_run.values[key],
            "number": bounds.number(fraction),
            "unit": bounds.unit,
            "low": bounds.number(0.0),
            "high": bounds.number(1.0),
            "scale": bounds.scale,
            "uncertainty": 0.5 * interval if determined else None,
            "interval": [bounds.number(end) for end in interval_ends] if determined else [],
            "at": at_bound(fraction),
        }
    return rows


def at_bound(fraction: float) -> str:
    """Return ``low`` or ``high`` if a key has reached this bound; otherwise an empty text."""
    if fraction < AT_BOUND:
        return "low"
    return "high" if fraction > 1.0 - AT_BOUND else ""


def _number_rows(
    problem: FitProblem, best_run: FitRun, derivatives: Floats | None
) -> dict[str, NumberRow]:
    fit = problem.fit
    rows: dict[str, NumberRow] = {}
    for i, name in enumerate(fit.numbers):
        value = float(best_run.array[i])
        derivatives_of_number = {} if derivatives is None else _plain(derivatives[i])
        row: NumberRow = {
            "value": value,
            "unit": quantities.quantity_or_fail(name).unit,
            "derivatives": dict(zip(fit.keys, derivatives_of_number, strict=False)),
        }
        if name in fit.number_targets:
            target = fit.number_targets[name]
            row["target"] = target.value
            row["uncertainty"] = target.uncertainty
            row["deviation"] = (value - target.value) / target.uncertainty
        lower_bound, upper_bound = fit.limits.get(name, (-math.inf, math.inf))
        if math.isfinite(lower_bound):
            row["at_least"] = lower_bound
        if math.isfinite(upper_bound):
            row["at_most"] = upper_bound
        rows[name] = row
    return rows


def _run_row(problem: FitProblem, run: FitRun, folder: Path) -> FitRow:
    number_names = problem.fit.numbers
    return {
        "name": run.name,
        "values": run.values,
        "shares": _floats(run.fractions),
        "numbers": {n: float(v) for n, v in zip(number_names, run.array, strict=True) if run.done},
        "misfit": run.misfit if math.isfinite(run.misfit) else None,
        "exit_code": run.exit_code,
        "message": run.message,
        "seconds": round(run.seconds, 3),
        "folder": os.path.relpath(run.folder, folder) if run.folder else "",
    }


# Tables


def number_with_unit(name: str, value: float) -> str:
    """Format a number with its unit as printed."""
    q = quantities.quantity_or_fail(name)
    return f"{q.factor * value:.4g} {number_text.printed(q.shown)}".strip()


def line_of_run(problem: FitProblem, run: FitRun) -> str:
    """Format keys, numbers and misfit of a run in one line."""
    short_names = short_keys(list(problem.fit.keys))
    keys = ", ".join(f"{short_names[key]} {value}" for key, value in run.values.items())
    if not run.done:
        return f"{run.name}: {keys}: {run.message}"
    pairs = zip(problem.fit.numbers, run.array, strict=True)
    numbers = ", ".join(f"{name} {number_with_unit(name, float(value))}" for name, value in pairs)
    misfit = f", misfit {run.misfit:.3g}" if problem.fit.targets else ""
    return f"{run.name}: {keys}: {numbers}{misfit}"


def key_rows(fit_record: FitRecord) -> tuple[list[str], list[list[str]]]:
    """Head and rows of the table of keys."""
    head = ["key", "value", "unit", "±", "95 % interval", "bounds"]
    if fit_record["aim"] != "targets":
        head = [title for title in head if title not in ("±", "95 % interval")]
    rows = []
    for key, row in fit_record["keys"].items():
        cells = [key, f"{row['number']:.4g}", row["unit"]]
        if fit_record["aim"] == "targets":
            uncertainty = row["uncertainty"]
            cells.append(
                "not determined" if uncertainty is None else layout.two_digits(uncertainty)
            )
            cells.append(" to ".join(f"{end:.4g}" for end in row["interval"]) or "-")
        rows.append([*cells, f"{row['low']:.4g} to {row['high']:.4g}"])
    return head, rows


def number_rows(fit_record: FitRecord) -> tuple[list[str], list[list[str]]]:
    """Head and rows of the table of numbers."""
    if fit_record["aim"] == "targets":
        head = ["number", "unit", "target", "±", "reached", "deviation / ±"]
    else:
        head = ["number", "unit", "at least", "at most", "reached"]
    rows = []
    for name, row in fit_record["numbers"].items():
        q = quantities.quantity_or_fail(name)

        def text(value: float | None, digits: int = 4, factor: float = q.factor) -> str:
            return "" if value is None else f"{factor * value:.{digits}g}"

        cells = [name, number_text.printed(q.shown)]
        if fit_record["aim"] == "targets":
            cells += [text(row["target"]), text(row["uncertainty"], 2), text(row["value"])]
            cells.append(f"{row['deviation']:+.1f}")
        else:
            cells += [text(row.get("at_least")), text(row.get("at_most")), text(row["value"])]
        rows.append(cells)
    return head, rows


def run_rows(fit_record: FitRecord) -> tuple[list[str], list[list[str]]]:
    """Head and rows of the table of runs."""
    short_names = short_keys(list(fit_record["keys"]))
    numbers = [*fit_record["numbers"]]
    targets = fit_record["aim"] == "targets"
    head = ["run", *short_names.values(), *map(quantities.label_with_unit, numbers)]
    head += ["misfit", "time"] if targets else ["time"]
    rows = []
    for run in fit_record["runs"]:
        cells = [run["name"], *(str(value) for value in run["values"].values())]
        for name in numbers:
            value = run["numbers"].get(name)
            cells.append(
                "-" if value is None else f"{quantities.quantity_or_fail(name).factor * value:.4g}"
            )
        if targets:
            cells.append("failed" if run["misfit"] is None else f"{run['misfit']:.3g}")
        rows.append([*cells, layout.duration(run["seconds"])])
    return head, rows


def correlation_rows(fit_record: FitRecord) -> tuple[list[str], list[list[str]]]:
    """Head and rows of the table of correlations; no rows for a single key."""
    short_names = [*short_keys(list(fit_record["keys"])).values()]
    head = ["correlation", *short_names]
    if len(short_names) == 1:
        return head, []
    rows = []
    for name, values in zip(short_names, fit_record["correlation"], strict=False):
        cells = ["-" if value is None else f"{value:+.2f}" for value in values]
        rows.append([name, *cells])
    return head, rows


def text_of_fit(fit_record: FitRecord) -> str:
    """Tables and verdicts of a fit."""
    tables = [layout.text_table(*run_rows(fit_record)), layout.text_table(*key_rows(fit_record))]
    head, correlations = correlation_rows(fit_record)
    if correlations:
        tables.append(layout.text_table(head, correlations))
    tables.append(layout.text_table(*number_rows(fit_record)))
    tables.append(f"{fit_record['best']} has these values; to repeat it: {fit_record['command']}")
    return "\n\n".join(tables)


def csv_of_fit(fit_record: FitRecord) -> str:
    """Table of the runs as CSV, in units of ``summary.json``."""
    rows = []
    for run in fit_record["runs"]:
        numbers = {
            f"{n} [{fit_record['numbers'][n]['unit']}]": v for n, v in run["numbers"].items()
        }
        row = {"run": run["name"], **run["values"], **numbers}
        if fit_record["aim"] == "targets":
            row["misfit [-]"] = run["misfit"]
        row |= {"exit code": run["exit_code"], "wall [s]": run["seconds"]}
        rows.append(row | {"message": run["message"], "folder": run["folder"]})
    return csv_text(rows)
