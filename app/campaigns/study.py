"""``mantle study``: error against run time of a case, by its ``study`` section."""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from app.campaigns import batch, many, study_report
from app.campaigns import work_precision as wp
from app.campaigns.many import Options
from app.campaigns.runs import Job, Result
from app.campaigns.study_model import Measured, PlannedRun, Report, StudyRun, percent
from app.case import quantities, study_file, study_options
from app.case.case import Case, load
from app.case.study_file import Source
from app.case.study_options import Study
from app.errors import InputError, gravest
from app.schema import yaml_file
from app.schema.yaml_file import CaseFile, Fault
from app.system.layout import duration

log = logging.getLogger("mantle")

QUICK = 2  # points of each line


def run(case: Path, overrides: list[str], options: Options) -> None:
    """Run all points of a study and report them.

    Args:
        case: The case file, with a study section, or a study of another case.
        overrides: ``--set`` options; they hold for every point, so not for what varies.
        options: Where everything goes, how it is run, which lines. Runs go one at a time, so that
            their times can be compared.

    Raises:
        InputError: The case or any point is wrong: everything at once, before anything runs.
        MantleError: Every run failed, of which it has the gravest exit code.
        StoppedError: Interrupted; the same command goes on from there.
    """
    folder = options.folder
    source = _chosen(study_file.read(case, overrides), options)
    points = plan(source.study)
    cases = _resolve(points, source)
    jobs = [_job(p, source) for p in points]
    results = batch.run(jobs, folder, options.cores, options.slurm)
    runs = [_run(*each) for each in zip(points, cases, results, strict=True)]
    report = evaluate(source.study, runs)
    written = study_report.write(report, source, options.cores, folder)
    log.info("%s", study_report.table(report))
    log.info("written in %s: %s", folder, ", ".join(written))
    if all(r.exit_code for r in results):
        text = f"every run of the study failed:\n{results[0].message}"
        raise gravest([r.exit_code for r in results], text)


def dry_run(case: Path, overrides: list[str], options: Options) -> str:
    """List the runs that `run` would start, as a table.

    Raises:
        InputError: As `run`.
    """
    source = _chosen(study_file.read(case, overrides), options)
    points = plan(source.study)
    _resolve(points, source)
    jobs = [_job(p, source) for p in points]
    return many.plan(f"{source.file.name}: {len(jobs)} runs", jobs, options)


def _chosen(source: Source, options: Options) -> Source:
    """A study with the lines that are wanted; a quick one has the first points of each.

    Raises:
        InputError: No line has such a name.
    """
    study = source.study
    lines = {name: line for name, line in study.lines.items() if options.pattern in name}
    if not lines:
        names = ", ".join(study.lines)
        raise InputError(f"-k {options.pattern}: no line has this in its name; allowed: {names}")
    reference = study.reference
    if options.tier == "quick":
        lines = {name: _first(line) for name, line in lines.items()}
        if reference.run is not None:
            reference = reference.model_copy(update={"run": _first(reference.run)})
    chosen = study.model_copy(update={"lines": lines, "reference": reference})
    return replace(source, study=chosen)


def _first(line: dict[str, Any]) -> dict[str, Any]:
    return {k: v[:QUICK] if isinstance(v, list) else v for k, v in line.items()}


def plan(study: Study) -> list[PlannedRun]:
    """Every point of a study, in the order of the file; the reference's come last."""
    lines = [(("study", "lines", name), name, line) for name, line in study.lines.items()]
    if study.reference.run is not None:
        lines.append((("study", "reference", "run"), "", study.reference.run))
    return [
        PlannedRun(path, name, i, changes, (*study_options.varying(line), "")[0])
        for path, name, line in lines
        for i, changes in enumerate(study_options.steps(line))
    ]


def _overrides(point: PlannedRun, common: Sequence[str]) -> list[str]:
    """The options that make a case the point's."""
    own = {key: value for key, value in point.changes.items() if key != "ranks"}
    return [*common, *study_options.options(own), *study_file.ALONE]


def _job(point: PlannedRun, source: Source) -> Job:
    name = "-".join(filter(None, (point.line or "reference", point.label)))
    return Job(
        name=name.replace(" ", ""),
        case=source.case,
        overrides=tuple(_overrides(point, source.overrides)),
        ranks=point.changes.get("ranks", source.ranks),
        alone=True,
    )


def _resolve(points: Sequence[PlannedRun], source: Source) -> list[Case]:
    """The configuration of each point.

    Raises:
        InputError: All that is wrong with any of them, each located at its value in the study.
    """
    cases: list[Case] = []
    problems: list[Fault] = []
    for point in points:
        try:
            cases.append(load(source.case, _overrides(point, source.overrides)).config)
        except InputError as error:
            problems += [_located(point, message, source.file) for message in error.messages]
    condition = "solver.condition"
    if condition in source.study.quantities and not all(c.output.condition for c in cases):
        at = ("study", "quantities", source.study.quantities.index(condition))
        problems.append(Fault(at, "needs output.condition: true"))
    source.file.raise_all(problems)
    return cases


def _located(point: PlannedRun, message: str, file: CaseFile) -> Fault:
    """A defect of a point, where its cause stands in the study."""
    if found := yaml_file.at_override(message, {k: (*point.path, k) for k in point.changes}):
        item = (*found.path, point.index)
        return Fault(item, found.text) if item in file.places else found
    at = f"with {point.key} = {point.label}: " if point.key else ""
    return Fault(point.path, at + message)


def _run(point: PlannedRun, case: Case, result: Result) -> StudyRun:
    """Run of a point of the study, with its result and time."""
    timing = result.summary.get("timing")
    cached = ("mesh", "compile", "error")
    time = timing["total"] - sum(timing.get(k, 0.0) for k in cached) if timing else None
    x, unit = _number(case, point)
    tolerance = case.solver.tolerance
    return StudyRun(**vars(point), x=x, unit=unit, time=time, tolerance=tolerance, result=result)


def _number(case: Case, point: PlannedRun) -> tuple[float | None, str]:
    """The value of the point's key as a positive number, if it is one, and its internal unit."""
    value: Any = point.changes if point.key == "ranks" else case.model_dump(mode="json")
    for item in re.sub(r"\[(\d+)\]", r".\1", point.key).split("."):
        if isinstance(value, list):
            value = value[int(item)]
        else:
            value = value.get(item) if isinstance(value, dict) else None
    number, _, unit = str(value).partition(" ")
    try:
        x = float(number)
    except ValueError:
        return None, ""
    return (x, unit) if 0 < x < math.inf else (None, "")


def evaluate(study: Study, runs: Sequence[StudyRun]) -> Report:
    """Errors, orders, fronts and advice from the runs of a study."""
    curve = [r for r in runs if r.line]
    ladder = [r for r in runs if not r.line]
    measured = [_measure(study, name, curve, ladder) for name in study.quantities]
    pairs = [(m.name, p) for m in measured for p in m.points]
    return Report(
        target=study.target,
        runs=curve,
        ladder=ladder,
        quantities=measured,
        advice=_advice_on_all(study.target, curve, measured),
        effectivity=wp.effectivity(pairs),
    )


def _measure(study: Study, name: str, curve: list[StudyRun], ladder: list[StudyRun]) -> Measured:
    """One quantity over all runs."""
    compared = study.compares(name)
    reference = _reference(study, name, ladder) if compared else None
    points = []
    for r in curve:
        summary = r.result.summary
        value, estimate = (quantities.read(summary, name, s) for s in ("", "_error"))
        point = wp.Point(r.line, r.label, r.x, r.time, value, estimate, r.tolerance)
        points.append(wp.compare(point, reference))
    errors = [p.bound for p in points]
    times = [p.time for p in points]
    lines = dict.fromkeys(r.line for r in curve)
    return Measured(
        name=name,
        quantity=quantities.find(name),
        compared=compared,
        reference=reference,
        points=points,
        exponents={n: wp.exponent([p for p in points if p.line == n]) for n in lines},
        front=wp.pareto(times, errors),
        errors=errors,
        advice=_advice(study.target, name, curve, errors, reference) if compared else "",
    )


def _reference(study: Study, name: str, ladder: list[StudyRun]) -> wp.ReferenceValue | None:
    """Reference value of a quantity; None if the ladder failed."""
    values = study.reference.values
    if values is not None:
        return wp.ReferenceValue(study_options.known_value(name, values[name]), 0.0, None, "given")
    found = [(r, v) for r in ladder if (v := quantities.read(r.result.summary, name)) is not None]
    if found and len(ladder) == 1:
        return wp.ReferenceValue(found[0][1], 0.0, None, "of one run")
    if len(found) < 2:
        return None
    x = [r.x for r, _ in found if r.x is not None]
    if x and x[0] < x[-1]:
        x = [1.0 / each for each in x]  # a number that grows as the run gets finer
    return wp.extrapolate(x if len(x) == len(found) else [], [v for _, v in found])


def _advice(
    target: float,
    name: str,
    curve: list[StudyRun],
    errors: list[float | None],
    reference: wp.ReferenceValue | None,
) -> str:
    """Advice on mesh and order for one quantity."""
    if reference is None or reference.value == 0.0:
        return f"no advice on {name}: it has no reference" + ("" if reference is None else " but 0")
    own = reference.uncertainty / abs(reference.value)
    if own > target:
        return (
            f"no advice on {name}: its reference is known to {percent(own)} only; "
            "refine study.reference.run"
        )
    return _sentence(target, name, curve, errors)


def _advice_on_all(target: float, curve: list[StudyRun], measured: list[Measured]) -> str:
    """Advice for all quantities together that have a reference good enough."""
    compared = [m for m in measured if m.compared]
    good = [
        m
        for m in compared
        if m.reference and 0 <= m.reference.uncertainty <= target * abs(m.reference.value)
    ]
    if len(compared) == 1 or not good:
        return ""
    left_out = [m.name for m in compared if m not in good]
    what = f"all but {', '.join(left_out)}" if left_out else f"all {len(good)} quantities"
    worst: list[float | None] = []
    for errors in zip(*(m.errors for m in good), strict=True):
        known = [e for e in errors if e is not None]
        worst.append(max(known) if len(known) == len(errors) else None)
    return _sentence(target, what, curve, worst)


def _sentence(
    target: float, what: str, curve: list[StudyRun], errors: Sequence[float | None]
) -> str:
    wanted = percent(target)
    i, reached = wp.best([r.time for r in curve], errors, target)
    if i is None:
        return f"no advice on {what}: no run has a known error"
    r, time = curve[i], duration(curve[i].time or 0.0)
    at = r.label if r.key == "mesh.size" else f"{r.key} = {r.label}"
    if reached:
        return f"for {wanted} in {what} use {r.line} at {at}: {time}"
    error = percent(errors[i] or 0.0)
    return f"nothing reaches {wanted} in {what}; closest is {r.line} at {at}: {error} in {time}"
