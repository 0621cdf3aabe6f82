"""Points of sweeps and studies: grid, lists, table and samples, expanded to overrides of a case."""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from app.foundation.arrays import Floats
from app.schema.section import ITEMS, MAPPING, Kinds, Name, Section, Text, fail, show
from app.schema.units import number_and_unit
from app.schema.yaml_file import Fault, Path, key_parts

# Number of random designs to choose from.
DESIGNS = 20
MOST_CASES = 20_000
# A value that can be part of a name.
LABEL = re.compile(r"[A-Za-z0-9_.+-]{1,24}")


@dataclass(frozen=True)
class Point:
    """Overrides of a case: of a variation, of a case of a sweep or study, or of a value of an axis.

    Attributes:
        name: Unique in its file: ``part/value_value``.
        changes: The overrides as values by key, including ``ranks``.
        places: Path of each override in the file.
        path: Path of its part or line in the file; empty if there is only one.
        base: The case as written.
        varied: Keys on an axis.
    """

    name: str
    changes: dict[str, object] = field(default_factory=dict)
    places: dict[str, Path] = field(default_factory=dict)
    path: Path = ()
    base: str = ""
    varied: tuple[str, ...] = ()

    @property
    def part(self) -> str:
        """Name of its part; empty if there is only one."""
        return str(self.path[-1]) if self.path else ""


def _check_equal_lengths(runs: dict[str, object]) -> dict[str, object]:
    """Check that lists, which vary together, have equal lengths."""
    lengths = {key: len(values) for key, values in _lists(runs).items()}
    first_key = next(iter(lengths), "")
    for key, length in lengths.items():
        if not length:
            fail("is an empty list", at=(key,))
        if length != lengths[first_key]:
            fail(f"has {length} values where {first_key} has {lengths[first_key]}", at=(key,))
    return runs


def _check_varies(runs: dict[str, object]) -> dict[str, object]:
    if not varying(runs):
        fail("varies nothing; expected a list for at least one key, e.g. mesh.size: [3 mm, 2 mm]")
    return runs


def _check_distinct(values: list[object]) -> list[object]:
    labels = _labels(values)
    for i, name in enumerate(labels):
        if name in labels[:i]:
            fail(f"{name} is listed twice", at=(i,))
    return values


Changes = Annotated[dict[str, object], MAPPING]
Runs = Annotated[Changes, AfterValidator(_check_equal_lengths)]
Lists = Annotated[Runs, AfterValidator(_check_varies)]
Values = Annotated[list[object], ITEMS, Field(min_length=1), AfterValidator(_check_distinct)]
Grid = Annotated[dict[str, Values], MAPPING, Field(min_length=1)]
Table = Annotated[dict[Name, Changes], MAPPING, Field(min_length=1)]


def _parsed_number(value: object) -> tuple[float, str]:
    parts = number_and_unit(value)
    if parts is None:
        fail(f"{show(value)} is not a number, with its unit if it has one")
    if not math.isfinite(parts[0]):
        fail(f"{show(value)} is not finite")
    return parts


def _power_of_two(samples: int) -> int:
    if samples & (samples - 1):
        below = 2 ** (samples.bit_length() - 1)
        fail(f"{samples} is not a power of two; the next are {below} and {2 * below}")
    return samples


class Range(Section):
    """Range of an uncertain input."""

    low: str | int | float
    """Least value."""
    high: str | int | float
    """Largest value, in the same unit."""
    scale: Literal["linear", "logarithmic"] = "linear"
    """Scale on which values are spread evenly between them: the value or its logarithm."""

    @model_validator(mode="after")
    def _ordered(self) -> Range:
        (lower_bound, unit), (upper_bound, other_unit) = (
            _parsed_number(self.low),
            _parsed_number(self.high),
        )
        if unit != other_unit:
            fail(f"'{unit}' and '{other_unit}': both ends of the range need the same unit")
        if not lower_bound < upper_bound:
            fail(f"{show(self.low)} is not below {show(self.high)}")
        if self.scale == "logarithmic" and lower_bound <= 0:
            fail(f"{show(self.low)} is not positive, so it has no logarithm", at=("low",))
        return self

    @property
    def unit(self) -> str:
        """Unit of both ends; empty for a plain number."""
        return _parsed_number(self.low)[1]

    def number(self, fraction: float) -> float:
        """Value at a fraction of the range, without its unit; defined beyond the range, too."""
        lower_bound, upper_bound = _parsed_number(self.low)[0], _parsed_number(self.high)[0]
        if self.scale == "logarithmic":
            return lower_bound * (upper_bound / lower_bound) ** fraction
        return lower_bound + fraction * (upper_bound - lower_bound)

    def fraction(self, number: float) -> float:
        """Fraction of the range at a number: the inverse of `number`."""
        lower_bound, upper_bound = self.number(0.0), self.number(1.0)
        if self.scale == "logarithmic":
            return math.log(number / lower_bound) / math.log(upper_bound / lower_bound)
        return (number - lower_bound) / (upper_bound - lower_bound)

    def value_at(self, fraction: float) -> str | float:
        """Value at a fraction of the range, to six digits."""
        number = float(f"{self.number(fraction):.6g}")
        return f"{number:g} {self.unit}" if self.unit else number


class Choice(Section):
    """Values of an uncertain input, each as likely as the others."""

    values: Values
    """The values: numbers, names or sections."""

    def value_at(self, fraction: float) -> object:
        """Value at a fraction of the list."""
        return self.values[int(fraction * len(self.values))]


Inputs = Annotated[dict[str, Annotated[Range | Choice, Kinds(".low")]], Field(min_length=1)]


def _overrides_of_samples(
    inputs: Mapping[str, Range | Choice], fractions: Floats
) -> list[dict[str, object]]:
    """Overrides of samples, from fractions of the ranges of the inputs (samples, inputs)."""
    return [
        {
            key: input.value_at(float(fraction))
            for (key, input), fraction in zip(inputs.items(), row, strict=True)
        }
        for row in fractions
    ]


class SampledInputs(Section):
    """Samples of uncertain inputs."""

    samples: int
    """Number of samples."""
    seed: Annotated[int, Field(ge=0)] = 0
    """The same seed gives the same samples."""
    inputs: Inputs
    """The range of each key, or its values."""


class LatinHypercube(SampledInputs):
    """Samples of uncertain inputs: one value of each input in each of equal intervals."""

    samples: Annotated[int, Field(ge=2, le=10_000)]
    """Number of samples."""

    def draw(self) -> list[dict[str, object]]:
        """The overrides of each sample (McKay, Beckman and Conover, doi:10.2307/1268522).

        The least correlated of `DESIGNS` random designs is taken.
        """
        from scipy.stats import qmc

        sampler = qmc.LatinHypercube(len(self.inputs), seed=self.seed)
        designs = [sampler.random(self.samples) for _ in range(DESIGNS)]

        def correlation(design: Floats) -> float:
            # For a single input `corrcoef` is a number.
            coefficients = np.atleast_2d(np.corrcoef(design, rowvar=False))
            return float(np.abs(np.tril(coefficients, -1)).max())

        return _overrides_of_samples(self.inputs, min(designs, key=correlation))


class Sobol(SampledInputs):
    """Samples from which Sobol' indices are computed: the share of each input in the variance."""

    samples: Annotated[int, Field(ge=8, le=4096), AfterValidator(_power_of_two)]
    """Number of base samples, a power of two. Each makes (inputs + 2) runs."""

    def draw(self) -> dict[str, dict[str, object]]:
        """The overrides of each run by its name, base sample by base sample.

        A base sample has two independent points A and B, and for each input A with this input
        of B (Saltelli et al., doi:10.1016/j.cpc.2009.09.018).
        """
        from scipy.stats import qmc

        number = len(self.inputs)
        fractions = qmc.Sobol(2 * number, seed=self.seed).random(self.samples)
        first_points = _overrides_of_samples(self.inputs, fractions[:, :number])
        second_points = _overrides_of_samples(self.inputs, fractions[:, number:])
        short_names = short_keys(list(self.inputs))
        digits = len(str(self.samples))
        runs = {}
        for k, (a, b) in enumerate(zip(first_points, second_points, strict=True), start=1):
            name = f"sample{k:0{digits}d}"
            runs[f"{name}_A"] = a
            runs[f"{name}_B"] = b
            runs |= {f"{name}_A_{short_names[key]}": a | {key: b[key]} for key in self.inputs}
        return runs


@dataclass(frozen=True)
class UncertainInputs:
    """Keys of the uncertain inputs of a part, and True if its samples are those of `Sobol`."""

    inputs: tuple[str, ...]
    sobol: bool = False


class SweepPart(Section):
    """A base case and axes; every combination of one value of each is a case."""

    base: Text | None = None
    """The case, relative to this file, or a shipped one by its name; its variations are not
    used."""
    set: Changes = Field(default_factory=dict)
    """Overrides for every case, as after ``--set`` (and ``ranks``)."""
    grid: Grid | None = None
    """Lists of values by key; each is an axis."""
    lists: Lists | None = None
    """Lists of values by key that vary together: one axis."""
    table: Table | None = None
    """Overrides by name: one axis."""
    latin_hypercube: LatinHypercube | None = None
    """Samples of uncertain inputs: one axis."""
    sobol: Sobol | None = None
    """Samples for Sobol' indices of uncertain inputs; without other axes."""

    @model_validator(mode="after")
    def _sobol_alone(self) -> SweepPart:
        other_axes = (self.table, self.grid, self.lists, self.latin_hypercube)
        if self.sobol is not None and any(axis is not None for axis in other_axes):
            fail("cannot be combined with other axes; put it into a separate part", at=("sobol",))
        return self

    @property
    def uncertain(self) -> UncertainInputs | None:
        """The uncertain inputs of the part; None if it has none."""
        if self.sobol is not None:
            return UncertainInputs(tuple(self.sobol.inputs), sobol=True)
        if self.latin_hypercube is not None:
            return UncertainInputs(tuple(self.latin_hypercube.inputs))
        return None

    def axes(self, path: Path) -> Iterator[list[Point]]:
        """Axes of the part at a path of the file: table, grid, lists, samples."""
        short_names = short_keys([*(self.grid or {}), *(self.lists or {})])
        if self.table is not None:
            key_path = (*path, "table")
            yield [
                overriding(changes, (*key_path, name), name) for name, changes in self.table.items()
            ]
        for key, values in (self.grid or {}).items():
            yield along({key: values}, (*path, "grid"), short_names)
        if self.lists is not None:
            yield along(self.lists, (*path, "lists"), short_names)
        hypercube = self.latin_hypercube
        if hypercube is not None:
            digits, key_path = len(str(hypercube.samples)), (*path, "latin_hypercube", "inputs")
            yield [
                overriding(changes, key_path, f"sample{i:0{digits}d}")
                for i, changes in enumerate(hypercube.draw(), start=1)
            ]
        if self.sobol is not None:
            key_path = (*path, "sobol", "inputs")
            yield [
                overriding(changes, key_path, name) for name, changes in self.sobol.draw().items()
            ]


def along(runs: Mapping[str, object], path: Path, short: Mapping[str, str]) -> list[Point]:
    """One axis: lists that vary together, and single values, by override key with short names."""
    values_of_key = _lists(runs)
    labels = {key: _labels(values) for key, values in values_of_key.items()}
    return [
        Point(
            "_".join(f"{short[key]}={labels_of_key[i]}" for key, labels_of_key in labels.items()),
            {
                key: values_of_key[key][i] if key in values_of_key else value
                for key, value in runs.items()
            },
            {key: (*path, key, i) if key in values_of_key else (*path, key) for key in runs},
        )
        for i in range(len(next(iter(labels.values()), [""])))
    ]


def varying(runs: Mapping[str, object]) -> list[str]:
    """The keys with lists of values, mesh.size first."""
    return list(_lists(runs))


def _lists(runs: Mapping[str, object]) -> dict[str, list[object]]:
    """The lists of values by key, mesh.size first."""
    values_of_key = {key: value for key, value in runs.items() if isinstance(value, list)}
    return dict(sorted(values_of_key.items(), key=lambda item: item[0] != "mesh.size"))


def overriding(changes: dict[str, object], path: Path, name: str = "") -> Point:
    """Overrides at a path of the file as a value of an axis; unnamed if they hold throughout."""
    return Point(name, changes, {key: (*path, key) for key in changes})


def combine(
    path: Path, base: str, common: Sequence[Point], axes: Iterable[Sequence[Point]]
) -> Iterator[Point]:
    """Every combination of one value of each axis; the last axis changes fastest.

    The last word of ``path`` is the name of the part; ``common`` holds for every point.
    """
    part = str(path[-1]) if path else ""
    for values in itertools.product(*axes):
        changed_values, path_of_key = dict[str, object](), dict[str, Path]()
        for value in (*common, *values):
            changed_values |= value.changes
            path_of_key |= value.places
        label = "_".join(value.name for value in values if value.name)
        name = "/".join(filter(None, (part, label))) or "base"
        varied = tuple(key for value in values for key in value.changes)
        yield Point(name, changed_values, path_of_key, path, base, varied)


def _labels(values: Sequence[object]) -> list[str]:
    """Names of values: text, number, kind or index in the list."""
    singles = [v[0] if isinstance(v, list) and len(v) == 1 else v for v in values]
    singles = [v.get("kind") if isinstance(v, dict) else v for v in singles]
    value_texts = [str(v) if isinstance(v, str | int | float) else "" for v in singles]
    plain_texts = [text.replace(" ", "") for text in value_texts]
    numbers = [text.partition(" ")[0] for text in value_texts]
    if all(map(LABEL.fullmatch, plain_texts)) and (
        len(set(plain_texts)) == len(plain_texts) or not any(isinstance(v, dict) for v in values)
    ):
        return plain_texts
    if all(map(LABEL.fullmatch, numbers)) and len(set(numbers)) == len(numbers):
        return numbers
    return [f"#{i + 1}" for i in range(len(values))]


def short_keys(keys: Sequence[str]) -> dict[str, str]:
    """Shorten keys to their last words as far as they stay unique."""
    key_words = {key: key_parts(key) for key in keys}
    short_names = {}
    for key, words in key_words.items():
        endings = (words[-n:] for n in range(1, len(words)) if not words[-n].isdigit())
        unique_endings = (
            e for e in endings if sum(w[-len(e) :] == e for w in key_words.values()) == 1
        )
        short_names[key] = ".".join(next(unique_endings, words))
    return short_names


def as_overrides(changes: Mapping[str, object]) -> list[str]:
    """Overrides as options ``key=value``; JSON is YAML."""
    return [f"{key}={json.dumps(value, ensure_ascii=False)}" for key, value in changes.items()]


def at_override(message: str, places: Mapping[str, Path]) -> Fault | None:
    """Locate a message about an override in the file; None if it is about something else."""
    for key, place in places.items():
        located_message = message.removeprefix("--set ")
        if located_message.startswith(f"{key}: "):
            return Fault(place, located_message.removeprefix(f"{key}: "))
    return None


def clashes(overrides: Iterable[str], varied: Iterable[tuple[Path, str]]) -> list[Fault]:
    """Errors for ``--set`` keys that the file varies too, each at the path of its list or value."""
    lists_and_keys = {(p[:-1] if isinstance(p[-1], int) else p, key): None for p, key in varied}
    return [
        Fault(place, f"varies, but --set {given_key} fixes it for every case; leave one out")
        for given_key in dict.fromkeys(o.partition("=")[0].strip() for o in overrides)
        for place, key in lists_and_keys
        if all(a == b for a, b in zip(key_parts(given_key), key_parts(key), strict=False))
    ]
