"""``mantle validate``: run experiments, predict, compare with what was measured.

All runs go into one folder, that of a batch (`app/campaigns/batch.py`), and beside them::

    folder/validate.json    each quantity: committed prediction, number of today, measurement
    folder/validate.csv     the same as a table
    folder/validate.png     predicted against measured, all experiments
    folder/NAME.png         predictions and measurements of an experiment

A measurement is compared with the committed prediction, which was made before anybody compared.
The runs of today show if this version of the program still predicts the same.
"""

from __future__ import annotations

import datetime as dt
import logging
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import configs
from app.campaigns import batch, uncertainty
from app.campaigns.batch import Options
from app.campaigns.runs import Result
from app.case.case import PlannedRun
from app.foundation import layout
from app.foundation.errors import EnvironmentProblem, InputError, worst_error
from app.results.reading import Results
from app.system.folders import csv_text, remove, write_json, write_text, writing
from app.validation import metrics, picture, records
from app.validation.catalogue import EXPERIMENTS
from app.validation.experiment import (
    COARSER_POINTS,
    NOMINAL,
    SAMPLES,
    Conditions,
    Experiment,
    PredictedQuantity,
    place_of_run,
)
from app.validation.records import ExperimentRecord, MeasuredQuantity, Prediction, Predictions

log = logging.getLogger("mantle")

# Largest relative change of a value that counts as reproduced.
REPRODUCED = 1e-3
# Least number of samples that make a prediction.
FEWEST_SAMPLES = 8
# Folders of the program and its cases, in which a recorded prediction allows no uncommitted change.
COMMITTED = ("app", "forms", "meshes", "configs")


@dataclass(frozen=True)
class ComparedQuantity:
    """A quantity: its committed prediction, its value of today and its measurement.

    Attributes:
        today: Value of the nominal runs of today.
        prediction: The committed prediction.
        measured: The measurement, if there is one.
    """

    experiment: str
    quantity: str
    today: float
    prediction: Prediction
    measured: MeasuredQuantity | None

    @property
    def reproduced(self) -> bool:
        """Return True if the value of today is the predicted one."""
        change = abs(self.today - self.prediction.value)
        return change <= REPRODUCED * abs(self.prediction.value)


def run(options: Options, *, record: bool) -> bool:
    """Run experiments and compare them; with ``record`` write their predictions instead.

    Returns:
        True if every value of today is that of the committed prediction.

    Raises:
        InputError: No experiment has such a name; predictions or measurements are missing or
            malformed, or an experiment has changed since its prediction.
        MantleError: Runs of the conditions failed, or too many samples.
    """
    experiments = _chosen(options.pattern)
    predictions = {} if record else records.predictions()
    if not record:
        experiments = _predicted(experiments, predictions, named=bool(options.pattern))
    parts = (NOMINAL,) if options.tier == "quick" else ()
    planned = {e.name: e.plan(*parts) for e in experiments}
    all_runs = [run for runs in planned.values() for run in runs]
    if options.dry_run:
        heading = f"validate: {len(experiments)} experiments"
        log.info("%s", batch.table_of_planned_runs(heading, all_runs, options))
        return True
    if record:
        return _record(experiments, planned, options)
    measurements = records.measurements(predictions)
    results = _results(planned, options)
    comparisons = [
        ComparedQuantity(
            experiment.name,
            name,
            quantity.number(_conditions(results[experiment.name], NOMINAL)),
            predictions[experiment.name].quantities[name],
            measurements.get(experiment.name, {}).get(name),
        )
        for experiment in experiments
        for name, quantity in experiment.quantities.items()
    ]
    _write(comparisons, options)
    changed = [c for c in comparisons if not c.reproduced]
    if changed:
        changed_names = ", ".join(f"{c.experiment}.{c.quantity}" for c in changed)
        log.warning(
            "this version computes other values than the committed predictions: %s", changed_names
        )
    log.info("results in %s", options.folder)
    return not changed


def _chosen(pattern: str) -> list[Experiment]:
    """Experiments with a pattern in their names; InputError if there is none."""
    experiments = [e for name, e in EXPERIMENTS.items() if pattern in name]
    if not experiments:
        allowed_names = ", ".join(EXPERIMENTS)
        raise InputError(
            f"-k {pattern}: no experiment has this in its name; allowed: {allowed_names}"
        )
    return experiments


def _predicted(
    experiments: Sequence[Experiment], predictions: Predictions, *, named: bool
) -> list[Experiment]:
    """Return the experiments with a prediction of their present inputs.

    Those without any prediction are left out with a note, unless they are ``named``.

    Raises:
        InputError: One line for each prediction that is missing, incomplete or of other inputs.
    """
    if not named:
        missing = [e.name for e in experiments if e.name not in predictions]
        if missing:
            advice = "mantle validate -k NAME --record predicts one"
            log.warning("without a prediction: %s; %s", ", ".join(missing), advice)
        experiments = [e for e in experiments if e.name in predictions]
    lines = []
    for experiment in experiments:
        name = experiment.name
        advice = f"mantle validate -k {name} --record predicts it"
        if (
            name not in predictions
            or predictions[name].quantities.keys() != experiment.quantities.keys()
        ):
            lines.append(f"{records.PREDICTIONS}: no complete prediction of {name}; {advice}")
        elif predictions[name].inputs != records.hash_of_inputs(experiment):
            fault = f"the case or the ranges of {name} have changed since its prediction"
            lines.append(f"{records.PREDICTIONS}: {fault}; {advice} anew")
    if lines:
        raise InputError("\n".join(lines))
    return list(experiments)


def _results(
    planned: Mapping[str, Sequence[PlannedRun]], options: Options
) -> dict[str, list[Result]]:
    """Results of the runs of each experiment.

    Raises:
        MantleError: Runs outside of the samples failed, with the highest exit code.
    """
    all_runs = [run for runs in planned.values() for run in runs]
    results = iter(batch.run(all_runs, options.folder, options.cores, options.slurm))
    by_name = {name: [next(results) for _ in runs] for name, runs in planned.items()}
    failed = [
        (name, r)
        for name, ended in by_name.items()
        for r in ended
        if r.exit_code and place_of_run(r.planned.name).part != SAMPLES
    ]
    if failed:
        lines = [f"{name}: {r.planned.name}: {r.message}" for name, r in failed]
        raise worst_error([r.exit_code for _, r in failed], "\n".join(lines))
    return by_name


def _conditions(results: Sequence[Result], part: str, sample: int = 0) -> Conditions:
    """Results by condition of a part, of one sample."""
    places_and_results = [(place_of_run(r.planned.name), r) for r in results]
    return {
        place_in_sweep.condition: Results(r.folder)
        for place_in_sweep, r in places_and_results
        if (place_in_sweep.part, place_in_sweep.sample) == (part, sample) and not r.exit_code
    }


# Predictions


def _record(
    experiments: Sequence[Experiment], planned: Mapping[str, Sequence[PlannedRun]], options: Options
) -> bool:
    """Predict experiments and write their predictions into the manual's folder.

    Raises:
        InputError: The tier has no samples.
        EnvironmentProblem: The sources are not those of a commit.
    """
    if options.tier == "quick":
        raise InputError("--record: a prediction needs all samples; leave out --tier quick")
    commit = _commit()
    results = _results(planned, options)
    predictions = records.predictions() if records.PREDICTIONS.exists() else {}
    for experiment in experiments:
        ended = results[experiment.name]
        predicted = predict(experiment, ended)
        predictions[experiment.name] = ExperimentRecord(
            title=experiment.title,
            blind=experiment.blind,
            commit=commit,
            date=dt.date.today().isoformat(),
            inputs=records.hash_of_inputs(experiment),
            seed=experiment.designs[0].seed,
            runs=len(ended),
            quantities=predicted,
        )
        log.info("%s", _predicted_table(experiment.name, predicted))
    records.write({name: predictions[name] for name in EXPERIMENTS if name in predictions})
    log.info("the predictions are written in %s", records.PREDICTIONS)
    return True


def _commit() -> str:
    """Commit of the sources.

    Raises:
        EnvironmentProblem: They are in no repository, or changed since the commit.
    """
    git = ["git", "-C", str(configs.FOLDER.parent)]
    try:
        changes, head = (
            subprocess.run([*git, *command], capture_output=True, text=True, check=True).stdout
            for command in (
                ["status", "--porcelain", "--", *COMMITTED],
                ["rev-parse", "--short=12", "HEAD"],
            )
        )
    except (OSError, subprocess.CalledProcessError) as error:
        message = (
            "--record: the commit of the sources is unknown; it needs git and their repository"
        )
        raise EnvironmentProblem(message) from error
    if changes.strip():
        raise EnvironmentProblem(
            "--record: the sources have changes that are not committed; commit them first:\n"
            + changes.rstrip()
        )
    return head.strip()


def predict(experiment: Experiment, results: Sequence[Result]) -> dict[str, Prediction]:
    """Predictions of an experiment from the results of all its runs.

    Samples with a run that failed are left out.

    Raises:
        InputError: Fewer than `FEWEST_SAMPLES` samples are complete.
    """
    nominal, coarser = (_conditions(results, part) for part in (NOMINAL, COARSER_POINTS))
    complete: list[Conditions] = []
    inputs: list[dict[str, object]] = []
    for number in range(1, experiment.designs[0].samples + 1):
        conditions = _conditions(results, SAMPLES, number)
        if conditions.keys() != nominal.keys():
            log.warning("%s: sample %d failed and is left out", experiment.name, number)
            continue
        complete.append(conditions)
        runs = [r.planned for r in results if place_of_run(r.planned.name).sample == number]
        inputs.append(_inputs(experiment, runs))
    if len(complete) < FEWEST_SAMPLES:
        message = f"only {len(complete)} samples are complete; a prediction needs {FEWEST_SAMPLES}"
        raise InputError(f"{experiment.sweep}: {message}")
    by_key = {key: [of_sample[key] for of_sample in inputs] for key in inputs[0]}
    return {
        name: _prediction(quantity, nominal, coarser, complete, by_key)
        for name, quantity in experiment.quantities.items()
    }


def _inputs(experiment: Experiment, runs: Sequence[PlannedRun]) -> dict[str, object]:
    """Values of the uncertain inputs of a sample; with its condition where they differ."""
    keys = dict.fromkeys(key for design in experiment.designs for key in design.inputs)
    values: dict[str, object] = {}
    for key in keys:
        of_runs = {
            place_of_run(r.name).condition: r.point.changes[key]
            for r in runs
            if key in r.point.changes
        }
        if len(set(map(str, of_runs.values()))) == 1:
            values[key] = next(iter(of_runs.values()))
        else:
            values |= {f"{key} ({condition})": value for condition, value in of_runs.items()}
    return values


def _prediction(
    quantity: PredictedQuantity,
    nominal: Conditions,
    coarser: Conditions,
    samples: Sequence[Conditions],
    inputs: Mapping[str, Sequence[object]],
) -> Prediction:
    value = quantity.number(nominal)
    numbers = [quantity.number(conditions) for conditions in samples]
    spread = uncertainty.of_number(numbers, inputs)
    return Prediction(
        text=quantity.text,
        unit=quantity.unit,
        value=_rounded(value),
        discretization=_rounded(abs(quantity.number(coarser) - value)),
        band=(_rounded(spread["p5"]), _rounded(spread["p95"])),
        failure=quantity.failure,
        follows={key: round(r, 2) for key, r in spread["correlation"].items()},
        samples=[_rounded(number) for number in numbers],
    )


def _rounded(number: float) -> float:
    """A number with five digits."""
    return float(f"{number:.5g}")


def _predicted_table(name: str, predicted: Mapping[str, Prediction]) -> str:
    rows = [
        (key, p.unit, f"{p.value:.4g}", f"{p.discretization:.2g}", _interval(p.band))
        for key, p in predicted.items()
    ]
    return layout.text_table((name, "unit", "predicted", "± mesh", "band"), rows)


# ComparedQuantity


def _write(comparisons: Sequence[ComparedQuantity], options: Options) -> None:
    """Log the table; write the numbers and the pictures."""
    table = [_row(c) for c in comparisons]
    log.info("%s", layout.text_table(list(table[0]), [list(row.values()) for row in table]))
    folder = options.folder
    experiment_names = dict.fromkeys(c.experiment for c in comparisons)
    pictures = {name: folder / f"{name}.png" for name in ("validate", *experiment_names)}
    remove(pictures.values())
    with writing(folder):
        write_json(folder / "validate.json", [json_of_comparison(c) for c in comparisons])
        write_text(folder / "validate.csv", csv_text(table))
        pairs = [(f"{c.experiment}: {c.quantity}", c.prediction, c.measured) for c in comparisons]
        picture.draw_all(pairs, pictures["validate"])
        for name in experiment_names:
            of_one = [
                (c.quantity, c.prediction, c.measured) for c in comparisons if c.experiment == name
            ]
            picture.draw_one(name, of_one, pictures[name])


def _row(c: ComparedQuantity) -> dict[str, object]:
    """A row of the table."""
    p, m = c.prediction, c.measured
    row: dict[str, object] = {
        "experiment": c.experiment,
        "quantity": c.quantity,
        "unit": p.unit,
        "predicted": f"{p.value:.4g}",
        "± mesh": f"{p.discretization:.2g}",
        "band": _interval(p.band),
        "today": f"{c.today:.4g}",
        "measured": "",
        "": "",
        "E_n": "",
        "area": "",
    }
    if m is not None:
        is_spread = m.range is not None or m.uncertainty is not None
        row["measured"] = _interval(metrics.measured_range(m)) if is_spread else f"{m.middle:.4g}"
        row[""] = "inside" if metrics.inside(p, m) else "outside"
        row["E_n"] = f"{metrics.normalised_error(p, m):.2f}"
        row["area"] = f"{metrics.area_metric(p, m):.3g}"
    return row


def _interval(interval: tuple[float, float]) -> str:
    return f"{interval[0]:.3g} to {interval[1]:.3g}"


def json_of_comparison(c: ComparedQuantity) -> dict[str, object]:
    """The entry of ``validate.json``."""
    p, m = c.prediction, c.measured
    outcome = "predicted"
    if m is not None:
        outcome = "passed" if metrics.inside(p, m) else "missed"
    return {
        "name": f"{c.experiment}.{c.quantity}",
        "group": "validation",
        "outcome": outcome,
        "value": p.value,
        "reference": m.middle if m else None,
        "note": f"{p.text}; {m.source}" if m else p.text,
        "experiment": c.experiment,
        "quantity": c.quantity,
        "blind": EXPERIMENTS[c.experiment].blind,
        "today": c.today,
        "prediction": p.model_dump(mode="json"),
        "measured": m.model_dump(mode="json") if m else None,
        "normalised_error": metrics.normalised_error(p, m) if m else None,
        "area_metric": metrics.area_metric(p, m) if m else None,
    }
