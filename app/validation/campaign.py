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

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from app.campaigns import batch
from app.campaigns.batch import Options
from app.campaigns.runs import Result
from app.case.case import PlannedRun
from app.foundation import layout
from app.foundation.errors import InputError, worst_error
from app.system.folders import csv_text, remove, write_json, write_text, writing
from app.validation import metrics, picture, prediction, records
from app.validation.catalogue import EXPERIMENTS
from app.validation.experiment import NOMINAL, SAMPLES, Experiment, place_of_run
from app.validation.prediction import conditions_of_part, interval_text
from app.validation.records import MeasuredQuantity, Prediction, Predictions

log = logging.getLogger("mantle")

# Largest relative change of a value that counts as reproduced.
REPRODUCED = 1e-3


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
            malformed; an experiment has changed since its prediction; a tier has no samples to
            record.
        EnvironmentProblem: The sources to record are not those of a commit.
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
        if options.tier == "quick":
            raise InputError("--record: a prediction needs all samples; leave out --tier quick")
        commit = prediction.commit_of_sources()
        prediction.record(experiments, _results(planned, options), commit)
        return True
    measurements = records.measurements(predictions)
    results = _results(planned, options)
    comparisons = [
        ComparedQuantity(
            experiment.name,
            name,
            quantity.number(conditions_of_part(results[experiment.name], NOMINAL)),
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


# Comparison


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
        "band": interval_text(p.band),
        "today": f"{c.today:.4g}",
        "measured": "",
        "": "",
        "E_n": "",
        "area": "",
    }
    if m is not None:
        is_spread = m.range is not None or m.uncertainty is not None
        row["measured"] = (
            interval_text(metrics.measured_range(m)) if is_spread else f"{m.middle:.4g}"
        )
        row[""] = "inside" if metrics.inside(p, m) else "outside"
        row["E_n"] = f"{metrics.normalised_error(p, m):.2f}"
        row["area"] = f"{metrics.area_metric(p, m):.3g}"
    return row


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
