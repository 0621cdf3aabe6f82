"""``mantle study``: error against run time of a case."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path

from app import __version__
from app.campaigns import batch, study_picture, study_results
from app.campaigns import work_precision as wp
from app.campaigns.batch import Options
from app.campaigns.runs import Result
from app.campaigns.study_results import Measured, Report, StudyRun
from app.case import quantities, summary_numbers
from app.case import study as study_file
from app.case.case import Case, PlannedRun
from app.case.study import Study
from app.foundation.errors import InputError, worst_error
from app.foundation.layout import duration, percent
from app.schema.yaml_file import key_parts
from app.system import folders

log = logging.getLogger("mantle")

# Number of runs of each line in a quick study.
QUICK_POINTS = 2
# Beginning of the text in place of advice if there is none.
NO_ADVICE = "no advice on"
# Fractions of the target whose cost is reported.
TARGET_PARTS = (1.0, 0.4, 0.2)


def run(path: Path, overrides: Sequence[str], options: Options) -> None:
    """Run all points of a study one at a time, so that times can be compared, and report them.

    Options ``--set`` apply to all points; an option with a key that varies is refused.

    Raises:
        InputError: The file or its points have errors (all are in one message, before anything
            runs).
        MantleError: All runs failed; the error has the highest exit code.
        StoppedError: Interrupted; the same command continues.
    """
    study, planned, common = study_file.read(path, overrides)
    chosen_runs = _selected_runs(planned, options)
    if options.dry_run:
        log.info(
            "%s",
            batch.table_of_planned_runs(f"{path}: {len(chosen_runs)} runs", chosen_runs, options),
        )
        return
    results = batch.run(chosen_runs, options.folder, options.cores, options.slurm)
    report = report_of_runs(study, [_study_run(result) for result in results])
    with folders.writing(options.folder):
        # An old picture would not match the new numbers.
        folders.remove(options.folder / name for name in study_picture.PICTURE_FILES)
        description = {
            "mantle": __version__,
            "study": str(path),
            "case": str(planned[0].file),
            "overrides": common,
            "cores": options.cores,
        }
        written_files = study_results.write(report, description, options.folder)
        written_files += study_picture.draw(report, options.folder)
    log.info("%s", study_results.table_of_study(report))
    log.info("%s: written in %s", ", ".join(written_files), options.folder)
    if all(r.exit_code for r in results):
        message = f"every run of the study failed:\n{results[0].message}"
        raise worst_error([r.exit_code for r in results], message)


def _selected_runs(planned: Sequence[PlannedRun], options: Options) -> list[PlannedRun]:
    """Select lines by name, and always the reference; a quick study has two runs of each.

    Raises:
        InputError: No line matches.
    """
    lines: dict[str, list[PlannedRun]] = {}
    for r in planned:
        lines.setdefault(study_file.name_of_line(r), []).append(r)
    if not any(name and options.pattern in name for name in lines):
        line_names = ", ".join(filter(None, lines))
        raise InputError(
            f"-k {options.pattern}: no line has this in its name; allowed: {line_names}"
        )
    most_points = QUICK_POINTS if options.tier == "quick" else None
    selected = [runs for name, runs in lines.items() if not name or options.pattern in name]
    return list(chain.from_iterable(runs[:most_points] for runs in selected))


def _study_run(result: Result) -> StudyRun:
    planned = result.planned
    point = planned.point
    listed_keys = [key for key in point.varied if isinstance(point.places[key][-1], int)]
    key = next((k for k in listed_keys if k == "mesh.size"), listed_keys[0] if listed_keys else "")
    value = point.changes.get(key, "")
    number = int(point.places[key][-1]) + 1 if key else 0
    label = f"#{number}" if isinstance(value, dict | list) else str(value)
    timing = result.summary.get("timing")
    cached = ("mesh", "compile", "error")
    time = timing["total"] - sum(timing.get(k, 0.0) for k in cached) if timing else None
    x, unit = _number(planned.case, key, planned.ranks)
    return StudyRun(study_file.name_of_line(planned), result, key, label, x, unit, time)


def _number(case: Case, key: str, ranks: int) -> tuple[float | None, str]:
    """Return the value of a key and its internal unit; None if it is not a positive number."""
    value: object = {**case.model_dump(mode="json"), "ranks": ranks}
    for key_part in key_parts(key):
        if isinstance(value, list | tuple):
            value = {str(k): inner_value for k, inner_value in enumerate(value)}
        inner_values = value if isinstance(value, Mapping) else {}
        value = (
            next(iter(inner_values.values()), None)
            if key_part == "*"
            else inner_values.get(key_part)
        )
    number, _, unit = str(value).partition(" ")
    try:
        x = float(number)
    except ValueError:
        return None, ""
    return (x, unit) if 0 < x < math.inf else (None, "")


def report_of_runs(study: Study, runs: Sequence[StudyRun]) -> Report:
    """Compute errors, orders, Pareto fronts and advice from the runs of a study."""
    curve = [r for r in runs if r.line]
    ladder = [r for r in runs if not r.line]
    measured_quantities = [_measure(study, name, curve, ladder) for name in study.quantities]
    compared = [m for m in measured_quantities if m.compared]
    advice = {m.name: _costs(study.target, m.name, curve, [m]) for m in compared}
    resolved = [m for m in compared if not advice[m.name].startswith(NO_ADVICE)]
    if len(compared) > 1 and resolved:
        left_out = [m.name for m in compared if m not in resolved]
        title = f"every number but {', '.join(left_out)}" if left_out else "every number"
        advice[""] = _costs(study.target, title, curve, resolved)
    return Report(study.target, curve, ladder, measured_quantities, advice)


def _measure(
    study: Study, name: str, curve: Sequence[StudyRun], ladder: Sequence[StudyRun]
) -> Measured:
    compared = study.compares(name)
    reference = _reference(study, name, ladder) if compared else None
    points = []
    for r in curve:
        value, estimate = (summary_numbers.read(r.result.summary, name, s) for s in ("", "_error"))
        point = wp.ErrorPoint(value, estimate, r.result.planned.case.solver.tolerance)
        points.append(wp.compare(point, reference))
    exponents = {}
    for line in dict.fromkeys(r.line for r in curve):
        on_line = [i for i, r in enumerate(curve) if r.line == line]
        exponents[line] = wp.exponent([curve[i].x for i in on_line], [points[i] for i in on_line])
    front = wp.pareto([r.time for r in curve], [p.bound for p in points])
    return Measured(
        name, quantities.quantity_or_fail(name), compared, reference, points, exponents, front
    )


def _reference(study: Study, name: str, ladder: Sequence[StudyRun]) -> wp.ReferenceValue | None:
    """Return the given or extrapolated value of a quantity; None if the reference runs failed."""
    values = study.reference.values
    if values is not None:
        return wp.ReferenceValue(quantities.known_value(name, values[name]), 0.0, None, "given")
    values_of_runs = [(r, summary_numbers.read(r.result.summary, name)) for r in ladder]
    known_values = [(r, value) for r, value in values_of_runs if value is not None]
    if known_values and len(ladder) == 1:
        return wp.ReferenceValue(known_values[0][1], 0.0, None, "of one run")
    if len(known_values) < 2:
        return None
    x = [r.x for r, _ in known_values if r.x is not None]
    if x and x[0] < x[-1]:
        x = [1.0 / size for size in x]  # the number grows with refinement
    finest_run = known_values[-1][0]
    return wp.extrapolate(
        x if len(x) == len(known_values) else [],
        [value for _, value in known_values],
        finest_run.highest_order,
        finest_run.result.planned.case.solver.tolerance,
    )


def _costs(
    target: float, title: str, curve: Sequence[StudyRun], measured_quantities: Sequence[Measured]
) -> str:
    """Return the cost of an error below the target, and below fractions of it, in words.

    The error is the largest one of the given quantities. A run may be close to the reference by
    chance, so its error is at least that of the runs after it in its line.
    """
    if any(m.reference and m.reference.method == wp.NOT_CONVERGING for m in measured_quantities):
        return (
            f"{NO_ADVICE} {title}: its reference is {wp.NOT_CONVERGING}; refine study.reference.run"
        )
    largest_errors: dict[str, float] = {}
    errors: list[float | None] = []
    for errors_of_run in zip(*(m.errors for m in measured_quantities), strict=True):
        known_errors = [error for error in errors_of_run if error is not None]
        is_complete = len(known_errors) == len(errors_of_run)
        errors.append(max(known_errors) if is_complete else None)
    for i, r in reversed([*enumerate(curve)]):
        error = errors[i]
        if error is not None:
            errors[i] = largest_errors[r.line] = max(error, largest_errors.get(r.line, 0.0))
    costs: list[str] = []
    for part in TARGET_PARTS:
        level = part * target
        best_row = wp.index_of_best([r.time for r in curve], errors, level)
        if best_row is None:
            return f"{NO_ADVICE} {title}: no run has a known error"
        r = curve[best_row]
        time = duration(r.time or 0.0)
        error = errors[best_row] or 0.0
        point = r.label if r.key == "mesh.size" else f"{r.key} = {r.label}"
        place = f"{r.line} at {point}"
        if error <= level:
            costs.append(f"{percent(level)} costs {time} ({place})")
            continue
        uncertainty = max(m.uncertainty for m in measured_quantities)
        reason = f"is reached by no run (closest {percent(error)} in {time}, {place})"
        if uncertainty > level:
            reason = f"is below the uncertainty of the reference, {percent(uncertainty)}"
        costs.append(f"{percent(level)} {reason}")
        break
    return f"{title} within {', '.join(costs)}"
