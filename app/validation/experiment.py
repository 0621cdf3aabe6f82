"""An experiment: its files, the quantities that are predicted, and the runs that they need.

The file ``configs/experiments/NAME.yaml`` is a sweep with three parts::

    nominal    the conditions of the experiment with the middle of each range
    coarser    the same on a coarser mesh
    samples    the same conditions, with inputs drawn from their ranges by a Latin hypercube

A condition is an entry of the axis ``table``, such as the finish of a rod. Conditions whose inputs
have other ranges are separate parts, ``samples_polished``; with the same seed and number of
inputs they draw the same fractions of all ranges. Every part has the same conditions. The case
that the sweep varies is ``configs/validation/NAME.yaml``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Self

import configs
from app.case import sweep as sweep_file
from app.case.case import PlannedRun
from app.case.points import LatinHypercube
from app.case.sweep import Sweep
from app.results.reading import Results
from app.schema import yaml_file

# Names of the parts of the sweep of an experiment.
NOMINAL = "nominal"
COARSER_POINTS = "coarser"
SAMPLES = "samples"
# Name of a sample at the end of the name of a point, before its number.
SAMPLE = "sample"

# Results of a run for each condition, by its name; the name is empty if there is only one.
Conditions = Mapping[str, Results]
# A number of a run.
Measure = Callable[[Results], float]


@dataclass(frozen=True)
class PredictedQuantity:
    """A quantity of an experiment.

    Attributes:
        text: The quantity in words.
        unit: Its unit; "-" if it has none.
        number: Its value in this unit, from the results of all conditions.
        failure: The meaning of a measured value outside of the predicted band.
    """

    text: str
    unit: str
    number: Callable[[Conditions], float]
    failure: str

    @classmethod
    def of_run(cls, text: str, unit: str, measure: Measure, run: str, failure: str) -> Self:
        """Quantity that is measured on one run, by the name of its condition."""
        return cls(text, unit, lambda runs: measure(runs[run]), failure)

    @classmethod
    def difference(
        cls, text: str, unit: str, measure: Measure, first: str, second: str, failure: str
    ) -> Self:
        """Quantity of one run minus that of another."""
        return cls(text, unit, lambda runs: measure(runs[first]) - measure(runs[second]), failure)

    @classmethod
    def ratio(cls, text: str, measure: Measure, over: str, under: str, failure: str) -> Self:
        """Quantity of one run over that of another."""
        return cls(text, "-", lambda runs: measure(runs[over]) / measure(runs[under]), failure)


@dataclass(frozen=True)
class Experiment:
    """A published experiment.

    Attributes:
        name: Name of its files.
        title: The experiment in a few words.
        blind: True if the prediction was made before anybody compared.
        quantities: The quantities that are predicted, by name.
    """

    name: str
    title: str
    blind: bool
    quantities: Mapping[str, PredictedQuantity]

    @property
    def sweep(self) -> Path:
        """The file of its conditions, ranges and meshes."""
        return configs.FOLDER / "experiments" / f"{self.name}.yaml"

    @cached_property
    def content(self) -> Sweep:
        """Content of the sweep; its cases are not checked."""
        return sweep_file.checked_content(yaml_file.read(self.sweep), Sweep)

    def plan(self, *parts: str) -> list[PlannedRun]:
        """Runs of some parts of the sweep, of all by default, in its order.

        Raises:
            InputError: The sweep or one of its cases is wrong.
        """
        points = [
            point
            for point in self.content.points()
            if not parts or place_of_run(point.name).part in parts
        ]
        file = yaml_file.read(self.sweep)
        runs, faults = sweep_file.runs_and_faults(file, self.sweep.parent, points, ())
        file.raise_all(faults)
        return [replace(run, share=True) for run in runs]

    @cached_property
    def designs(self) -> list[LatinHypercube]:
        """Ranges of the uncertain inputs of each part of samples, equal in number and seed."""
        parts = self.content.parts.values()
        return [part.latin_hypercube for part in parts if part.latin_hypercube is not None]


@dataclass(frozen=True)
class Place:
    """Place of a run in an experiment.

    Attributes:
        part: Part of the sweep.
        condition: Name of the condition; empty if there is only one.
        sample: Number of the sample, from 1; 0 outside of the samples.
    """

    part: str
    condition: str
    sample: int


def place_of_run(name: str) -> Place:
    """Place of a run, from its name such as ``samples_polished/short_sample07``."""
    of_part, _, label = name.partition("/")
    part, _, condition_start = of_part.partition("_")
    number = "0"
    if part == SAMPLES:
        label, _, number = label.rpartition(SAMPLE)
    condition_parts = (condition_start, label.removesuffix("_"))
    return Place(part, "_".join(filter(None, condition_parts)), int(number))
