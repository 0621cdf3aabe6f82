"""Files of the manual's folder ``docs/validation``: predictions, and measurements.

``predictions.json`` is written by ``mantle validate --record``. ``measured.json`` is written by
hand, after the predictions have been committed::

    {"rods": {"polished": {"value": 0.3, "unit": "MPa", "range": [0.2, 0.4], "source": "..."}}}

A measured quantity has a ``value``, a ``range`` or both, and may have a standard ``uncertainty``.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import Field, TypeAdapter, ValidationError, model_validator

import configs
from app.case import overlay
from app.foundation.errors import InputError
from app.schema import section, yaml_file
from app.schema.section import Section, fail
from app.system.folders import write_json
from app.validation.experiment import Experiment

# Folder of the sheets, the predictions and the measurements.
FOLDER = configs.FOLDER.parent / "docs" / "validation"
PREDICTIONS = FOLDER / "predictions.json"
MEASURED = FOLDER / "measured.json"

# Digits of a hash of inputs.
DIGITS_OF_HASH = 16

Interval = tuple[float, float]
Content = TypeVar("Content")


class Prediction(Section):
    """A predicted quantity."""

    text: str
    """The quantity in words."""
    unit: str
    """Unit of all its numbers."""
    value: float
    """Value with the middle of each range."""
    discretization: Annotated[float, Field(ge=0)]
    """Difference from the value on a coarser mesh."""
    band: Interval
    """5th and 95th percentile of the samples."""
    failure: str
    """Statement of what would count as a failure."""
    follows: dict[str, float]
    """Rank correlation with each uncertain input, by key."""
    samples: Annotated[list[float], Field(min_length=2)]
    """Value of each sample."""


class ExperimentRecord(Section):
    """Predictions of an experiment."""

    title: str
    """The experiment in a few words."""
    blind: bool
    """True if it was predicted before anybody compared."""
    commit: str
    """Commit of the program that made it."""
    date: str
    """Day on which it was made."""
    inputs: str
    """Hash of the case, its conditions and its ranges."""
    seed: int
    """Seed of the samples."""
    runs: int
    """Number of runs."""
    quantities: dict[str, Prediction]
    """Predictions by quantity."""


class MeasuredQuantity(Section):
    """A measured quantity."""

    value: float | None = None
    """Mean or median."""
    uncertainty: Annotated[float, Field(gt=0)] | None = None
    """Standard uncertainty of the value."""
    range: Interval | None = None
    """Least and largest value."""
    unit: str
    """Unit, that of the prediction."""
    source: str
    """Where it was read."""

    @model_validator(mode="after")
    def _complete(self) -> MeasuredQuantity:
        if self.value is None and self.range is None:
            fail("has neither a value nor a range; expected one of them")
        if self.range is not None and not self.range[0] < self.range[1]:
            fail("does not increase; expected the smallest and the largest value", at=("range",))
        return self

    @property
    def middle(self) -> float:
        """The value; without one the middle of the range."""
        if self.value is not None:
            return self.value
        assert self.range is not None
        return (self.range[0] + self.range[1]) / 2


Predictions = dict[str, ExperimentRecord]
Measurements = dict[str, dict[str, MeasuredQuantity]]


def predictions() -> Predictions:
    """The committed predictions, by experiment.

    Raises:
        InputError: The file is missing or malformed.
    """
    return _read(PREDICTIONS, TypeAdapter(Predictions))


def measurements(known: Predictions) -> Measurements:
    """The measurements, by experiment and quantity; none without the file.

    Raises:
        InputError: The file is malformed, or measures what is not predicted, or in another unit.
    """
    if not MEASURED.exists():
        return {}
    measurements = _read(MEASURED, TypeAdapter(Measurements))
    faults = list(_faults(measurements, known))
    if faults:
        raise InputError("\n".join(f"{MEASURED}: {fault}" for fault in faults))
    return measurements


def _faults(measurements: Measurements, predictions: Predictions) -> Iterator[str]:
    for name, quantities in measurements.items():
        if name not in predictions:
            yield f"{name}: there is no prediction of this experiment"
            continue
        predicted = predictions[name].quantities
        for key, quantity in quantities.items():
            if key not in predicted:
                yield f"{name}.{key}: there is no prediction of this quantity"
                continue
            unit = predicted[key].unit
            if quantity.unit != unit:
                yield f"{name}.{key}: is in {quantity.unit}, the prediction in {unit}"


def _read(path: Path, adapter: TypeAdapter[Content]) -> Content:
    """Read and check a JSON file.

    Raises:
        InputError: The file is missing or malformed; one line for each fault.
    """
    try:
        return adapter.validate_python(json.loads(path.read_text(encoding="utf-8")))
    except FileNotFoundError:
        message = "does not exist; mantle validate needs the manual's folder of the sources"
        raise InputError(f"{path}: {message}") from None
    except ValueError as error:
        if isinstance(error, ValidationError):
            lines = [
                f"{path}: {'.'.join(map(str, fault.path))}: {fault.text}"
                for fault in section.faults(error)
            ]
            raise InputError("\n".join(lines)) from error
        raise InputError(f"{path}: not valid JSON: {error}") from error


def write(records: Mapping[str, ExperimentRecord]) -> None:
    """Write the predictions."""
    write_json(PREDICTIONS, {name: r.model_dump(mode="json") for name, r in records.items()})


def hash_of_inputs(experiment: Experiment) -> str:
    """Hash of everything that an experiment takes from files: sweep, cases, materials, scripts.

    Comments and the layout of YAML files do not count.
    """
    sweep = yaml_file.read(experiment.sweep).data
    bases = {sweep["base"], *(part.get("base", sweep["base"]) for part in sweep["parts"].values())}
    cases = [overlay.base_file(experiment.sweep.parent, base) for base in sorted(bases)]
    contents = [sweep, *(overlay.read(path).data for path in cases)]
    inputs_json = json.dumps(contents, sort_keys=True, default=str).replace(
        f"{configs.FOLDER}/", ""
    )
    digest = hashlib.sha256(inputs_json.encode())
    for script in sorted(set(re.findall(r'([^"/]+\.geo)"', inputs_json))):
        digest.update((cases[0].parent / script).read_bytes())
    return digest.hexdigest()[:DIGITS_OF_HASH]
