"""Fit files: keys within bounds, and the numbers that they are to reach, minimise or maximise."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from app.case import checks, overlay, points, quantities, sweep
from app.case.case import PlannedRun
from app.case.points import Changes, Point, Range
from app.foundation.arrays import Floats
from app.schema import yaml_file
from app.schema.section import MAPPING, Section, Text, defects_at, fail, show
from app.schema.units import PositiveNumber, number_and_unit
from app.schema.yaml_file import CaseFile, Fault

# Paths of the parts of a fit file.
KEYS = ("fit", "keys")
TARGETS = ("fit", "targets")
CONSTRAINTS = ("fit", "constraints")
# Largest difference step, as a fraction of a range: both sides of its middle have room for it.
LARGEST_STEP = 0.4


class FitKey(Range):
    """Bounds of a fitted key."""

    start: str | int | float | None = None
    """First value; by default the middle of the range on its scale."""

    @model_validator(mode="after")
    def _start_within(self) -> FitKey:
        if self.start is None:
            return self
        parts = number_and_unit(self.start)
        if parts is None or parts[1] != self.unit:
            unit = f"the unit {self.unit}" if self.unit else "no unit"
            fail(f"{show(self.start)} is not a number with {unit} of the bounds", at=("start",))
        if not self.number(0.0) <= parts[0] <= self.number(1.0):
            message = f"{show(self.start)} is not within the bounds, {self.low} to {self.high}"
            fail(message, at=("start",))
        return self

    @property
    def start_fraction(self) -> float:
        """First value as a fraction of the range."""
        parts = number_and_unit(self.start)
        return self.fraction(parts[0]) if parts else 0.5


class Target(Section):
    """Measured value of a number."""

    value: str | int | float
    """The value that the number is to reach."""
    uncertainty: str | int | float
    """Standard uncertainty of the value, in a unit of the same dimension."""


class Limit(Section):
    """Bounds of a number."""

    at_least: str | int | float | None = None
    """Smallest allowed value."""
    at_most: str | int | float | None = None
    """Largest allowed value."""

    @model_validator(mode="after")
    def _bounded(self) -> Limit:
        if self.at_least is None and self.at_most is None:
            fail("has no bound; expected at_least, at_most or both")
        return self


@dataclass(frozen=True)
class NumberTarget:
    """A target in the unit of its number."""

    value: float
    uncertainty: float


class FitSearch(Section):
    """Search for values of keys, within bounds."""

    keys: Annotated[dict[str, FitKey], MAPPING, Field(min_length=1)]
    """Bounds of each key, as after ``--set``; its value is a number."""
    targets: Annotated[dict[str, Target], MAPPING] = Field(default_factory=dict)
    """Measured values of numbers of ``summary.json``, named as in a study: the keys are fitted to
    them."""
    minimise: Text | None = None
    """A number of ``summary.json`` or one of the keys, in place of targets."""
    maximise: Text | None = None
    """The same, to be as large as possible."""
    constraints: Annotated[dict[str, Limit], MAPPING] = Field(default_factory=dict)
    """Bounds of numbers of ``summary.json``, with `minimise` or `maximise`."""
    step: Annotated[PositiveNumber, Field(le=LARGEST_STEP)] = 0.05
    """Difference step of derivatives, as a fraction of the range of a key. It must change the
    numbers by more than a new mesh does."""
    runs: Annotated[int, Field(ge=2, le=1000)] = 40
    """Largest number of runs."""

    @model_validator(mode="after")
    def _check_one_aim(self) -> FitSearch:
        aims = [bool(self.targets), self.minimise is not None, self.maximise is not None]
        if sum(aims) != 1:
            fail("expected one of targets, minimise and maximise")
        if self.targets and self.constraints:
            message = "need minimise or maximise; to reach a value, make it one of the targets"
            fail(message, at=("constraints",))
        if self.runs < len(self.keys) + 1:
            message = f"{self.runs} runs are too few for the start and one change of each key"
            fail(f"{message}; expected at least {len(self.keys) + 1}", at=("runs",))
        if self.objective and self.objective not in self.keys:
            path = ("minimise",) if self.minimise else ("maximise",)
            _check_name(self.objective, path)
        for name in self.targets:
            _check_name(name, ("targets", name))
        for name in self.constraints:
            _check_name(name, ("constraints", name))
        for name, target in self.number_targets.items():
            if target.uncertainty <= 0:
                message = f"{show(self.targets[name].uncertainty)} is not positive"
                fail(message, at=("targets", name, "uncertainty"))
        for name, (lower_bound, upper_bound) in self.limits.items():
            if lower_bound > upper_bound:
                message = f"{show(self.constraints[name].at_least)} is above at_most"
                fail(message, at=("constraints", name, "at_least"))
        return self

    @property
    def objective(self) -> str:
        """The number or key that is minimised or maximised; empty with targets."""
        return self.minimise or self.maximise or ""

    @property
    def numbers(self) -> list[str]:
        """Numbers of ``summary.json`` that are read from each run."""
        read_numbers = [*self.targets]
        if self.objective and self.objective not in self.keys:
            read_numbers.append(self.objective)
        return list(dict.fromkeys([*read_numbers, *self.constraints]))

    @cached_property
    def number_targets(self) -> dict[str, NumberTarget]:
        """Targets by number."""
        return {
            name: NumberTarget(
                _value(name, target.value, ("targets", name, "value")),
                _value(name, target.uncertainty, ("targets", name, "uncertainty"), True),
            )
            for name, target in self.targets.items()
        }

    @cached_property
    def limits(self) -> dict[str, tuple[float, float]]:
        """Lower and upper bound by number; infinite without one."""
        bounds_of_number = {}
        for name, constraint in self.constraints.items():
            path = ("constraints", name)
            lower_bound, upper_bound = -math.inf, math.inf
            if constraint.at_least is not None:
                lower_bound = _value(name, constraint.at_least, (*path, "at_least"))
            if constraint.at_most is not None:
                upper_bound = _value(name, constraint.at_most, (*path, "at_most"))
            bounds_of_number[name] = (lower_bound, upper_bound)
        return bounds_of_number


def _check_name(name: str, path: tuple[str, ...]) -> None:
    """Check that a number exists and belongs to the model, at a path of the fit."""
    with defects_at(path):
        quantities.quantity_or_fail(name)
    if name in quantities.names_of_run_numbers():
        fail(f"{name} describes the run, not the model; expected a number of the model", at=path)


def _value(name: str, value: object, path: tuple[str, ...], difference: bool = False) -> float:
    """Value of a number at a path of the fit."""
    with defects_at(path):
        number = quantities.known_value(name, value, difference)
    return number


class FitFile(Section):
    """The content of a fit file."""

    title: Text = ""
    """Title for logs and reports."""
    base: Text
    """The case, relative to this file, or a shipped one by its name; its variations are not
    used."""
    set: Changes = Field(default_factory=dict)
    """Overrides of the case for every run, as after ``--set`` (and ``ranks``)."""
    fit: FitSearch
    """The keys that are fitted, and the aim."""


@dataclass(frozen=True)
class FitProblem:
    """A fit and the file that it comes from.

    Attributes:
        content: Content of the file.
        file: The file, for messages.
        path: Its path.
        overrides: Options ``--set`` that hold for every run.
    """

    content: FitFile
    file: CaseFile = field(repr=False)
    path: Path
    overrides: tuple[str, ...]

    @property
    def fit(self) -> FitSearch:
        """Keys and aim."""
        return self.content.fit

    @property
    def title(self) -> str:
        """Title of the file, else its name."""
        return self.content.title or self.path.stem

    @property
    def base(self) -> Path:
        """File of the case."""
        return Path(os.path.normpath(overlay.base_file(self.path.parent, self.content.base)))

    def path_of(self, number: str) -> yaml_file.Path:
        """Path of a number of the aim or of a constraint in the file."""
        if number in self.fit.targets:
            return (*TARGETS, number)
        if number in self.fit.constraints:
            return (*CONSTRAINTS, number)
        return ("fit", "minimise" if self.fit.minimise else "maximise")

    def changes(self, values: Mapping[str, object]) -> dict[str, object]:
        """Overrides of the case for values of the keys."""
        return {**self.content.set, **values}

    def values(self, fractions: Floats) -> dict[str, object]:
        """Values of the keys at fractions of their ranges (keys,)."""
        keys_and_fractions = zip(self.fit.keys.items(), fractions, strict=True)
        return {
            key: bounds.value_at(float(fraction)) for (key, bounds), fraction in keys_and_fractions
        }

    def plan(
        self, name: str, fractions: Floats, end: str = ""
    ) -> tuple[list[PlannedRun], list[Fault]]:
        """Plan the run with the keys at fractions of their ranges; return faults if refused.

        Faults of a key are placed at it, or at an ``end`` of its range: low or high.
        """
        common = points.overriding(self.content.set, ("set",))
        values = self.values(fractions)
        places = {key: (*KEYS, key, end) if end else (*KEYS, key) for key in values}
        point = Point(
            name,
            self.changes(values),
            common.places | places,
            base=self.content.base,
            varied=tuple(values),
        )
        runs, faults = sweep.runs_and_faults(self.file, self.path.parent, [point], self.overrides)
        return [replace(run, share=True) for run in runs], faults


def read(path: Path, overrides: Sequence[str] = ()) -> FitProblem:
    """Read a fit; check its first run, and the runs with each key at an end of its range.

    ``--set`` options hold for every run; those of keys below ``fit`` change the fit.

    Raises:
        InputError: Every error of the file and these runs, at its place.
    """
    of_fit = [o for o in overrides if re.match(r"\s*fit\b", o)]
    other_overrides = tuple(o for o in overrides if o not in of_fit)
    file = yaml_file.read(path)
    overlay.apply(file, of_fit)
    if overlay.file_kind(file.data) != "fit":
        message = "expected a fit file: base: CASE, and fit with keys and targets"
        file.raise_all([Fault(("fit",) if "fit" in file.data else (), message)])
    problem = FitProblem(sweep.checked_content(file, FitFile), file, path, other_overrides)
    fit = problem.fit
    start_fractions = np.array([key.start_fraction for key in fit.keys.values()])
    runs, faults = problem.plan("start", start_fractions)
    if runs:
        paths = {problem.path_of(number): number for number in fit.numbers}
        faults += checks.quantities(runs[0].case, paths)
        for k, key in enumerate(fit.keys):
            for end, fraction in (("low", 0.0), ("high", 1.0)):
                at_end = start_fractions.copy()
                at_end[k] = fraction
                of_key = problem.plan(f"{key} at {end}", at_end, end)[1]
                faults += [fault for fault in of_key if fault.path[-1:] == (end,)]
    file.raise_all(faults)
    return problem
