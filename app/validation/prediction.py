"""Prediction of experiments from the results of their runs, and its record in the manual."""

from __future__ import annotations

import datetime as dt
import logging
import subprocess
from collections.abc import Mapping, Sequence

import configs
from app.campaigns import uncertainty
from app.campaigns.runs import Result
from app.case.case import PlannedRun
from app.foundation import layout
from app.foundation.errors import EnvironmentProblem, InputError
from app.results.reading import Results
from app.validation import records
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
from app.validation.records import ExperimentRecord, Prediction

log = logging.getLogger("mantle")

# Least number of samples that make a prediction.
FEWEST_SAMPLES = 8
# Folders of the program and its cases, in which a recorded prediction allows no uncommitted change.
COMMITTED = ("app", "forms", "meshes", "configs")


def record(
    experiments: Sequence[Experiment], results: Mapping[str, Sequence[Result]], commit: str
) -> None:
    """Predict experiments and write their predictions into the manual's folder.

    Args:
        experiments: The experiments.
        results: Results of all their runs, by name.
        commit: Commit of the sources, from `commit_of_sources`.

    Raises:
        InputError: Too few samples are complete.
    """
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


def commit_of_sources() -> str:
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
    nominal, coarser = (conditions_of_part(results, part) for part in (NOMINAL, COARSER_POINTS))
    complete: list[Conditions] = []
    inputs: list[dict[str, object]] = []
    for number in range(1, experiment.designs[0].samples + 1):
        conditions = conditions_of_part(results, SAMPLES, number)
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
        (key, p.unit, f"{p.value:.4g}", f"{p.discretization:.2g}", interval_text(p.band))
        for key, p in predicted.items()
    ]
    return layout.text_table((name, "unit", "predicted", "± mesh", "band"), rows)


def interval_text(interval: tuple[float, float]) -> str:
    """Format an interval: 0.3 to 0.4."""
    return f"{interval[0]:.3g} to {interval[1]:.3g}"


def conditions_of_part(results: Sequence[Result], part: str, sample: int = 0) -> Conditions:
    """Results by condition of a part, of one sample."""
    places_and_results = [(place_of_run(r.planned.name), r) for r in results]
    return {
        place_in_sweep.condition: Results(r.folder)
        for place_in_sweep, r in places_and_results
        if (place_in_sweep.part, place_in_sweep.sample) == (part, sample) and not r.exit_code
    }
