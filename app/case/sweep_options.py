"""Options of a sweep: a base case, and axes whose values multiply."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from app.case.study_options import Changes, Line, check_ranks, steps
from app.case.variation_options import Variation, axes, labels, short_keys
from app.schema.section import MAPPING, Name, Section, Text, Word, fail, show
from app.schema.yaml_file import Path

# Random designs of samples to choose from.
DESIGNS = 20
MOST_CASES = 20_000
# A number, and its unit if it has one.
QUANTITY = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*")


def _grid(value: object) -> dict[str, Any]:
    """A list of values for each key."""
    if not isinstance(value, dict):
        fail(f"{show(value)} is not a mapping of keys to lists, e.g. {{mesh.size: [3 mm, 2 mm]}}")
    if not value:
        fail("varies nothing")
    for key, entry in value.items():
        if not (isinstance(entry, list) and entry):
            fail(f"{show(entry)} is not a list of values; expected e.g. [0.2, 0.4]", at=(key,))
    check_ranks(value)
    for key, names in labels(value).items():
        for i, name in enumerate(names):
            if name in names[:i]:
                fail(f"{name} stands here twice", at=(key, i))
    return value


def _table(value: object) -> dict[str, Any]:
    """Overrides by name."""
    if not (isinstance(value, dict) and value):
        fail(f"{show(value)} is not a mapping of names to overrides")
    for name, changes in value.items():
        if not isinstance(changes, dict):
            fail(f"{show(changes)} is not a mapping of keys to values", at=(name,))
        check_ranks(changes, (name,))
    return value


def _number(value: object) -> tuple[float, str]:
    """A number and its unit."""
    found = QUANTITY.fullmatch(str(value)) if isinstance(value, str | int | float) else None
    if found is None or isinstance(value, bool):
        fail(f"{show(value)} is not a number, with its unit if it has one")
    number = float(found[1])
    if not math.isfinite(number):
        fail(f"{show(value)} is not finite")
    return number, found[2]


class Range(Section):
    """Where an uncertain input lies."""

    low: str | int | float
    """Least value."""
    high: str | int | float
    """Largest value, in the same unit."""
    scale: Literal["linear", "logarithmic"] = "linear"
    """Scale on which values are spread evenly between them: the value or its logarithm."""

    @model_validator(mode="after")
    def _ordered(self) -> Range:
        (low, unit), (high, other) = _number(self.low), _number(self.high)
        if unit != other:
            fail(f"'{unit}' and '{other}': both ends need the same unit")
        if not low < high:
            fail(f"{show(self.low)} is not below {show(self.high)}")
        if self.scale == "logarithmic" and low <= 0:
            fail(f"{show(self.low)} has no logarithm", at=("low",))
        return self

    def at(self, share: float) -> str | float:
        """The value at a share of the way from one end to the other."""
        (low, unit), (high, _) = _number(self.low), _number(self.high)
        if self.scale == "logarithmic":
            value = math.exp(math.log(low) + share * math.log(high / low))
        else:
            value = low + share * (high - low)
        number = float(f"{value:.6g}")
        return f"{number:g} {unit}" if unit else number


class LatinHypercube(Section):
    """Samples of uncertain inputs: each input has one value in each of as many equal parts."""

    samples: Annotated[int, Field(ge=2, le=10_000)]
    """Number of samples."""
    seed: Annotated[int, Field(ge=0)] = 0
    """The same seed gives the same samples."""
    inputs: Annotated[dict[str, Range], Field(min_length=1)]
    """The range of each key."""

    def draw(self) -> list[dict[str, Any]]:
        """The overrides of each sample (McKay, Beckman and Conover, doi:10.2307/1268522).

        Of some designs the one whose inputs are least correlated by chance.
        """
        import numpy as np
        from scipy.stats import qmc

        sampler = qmc.LatinHypercube(len(self.inputs), seed=self.seed)
        designs = [sampler.random(self.samples) for _ in range(DESIGNS)]

        def correlation(design: Any) -> float:
            # That of a single input is a number, not a matrix.
            found = np.atleast_2d(np.corrcoef(design, rowvar=False))
            return float(np.abs(np.tril(found, -1)).max())

        shares = min(designs, key=correlation)
        return [
            {key: r.at(float(s)) for (key, r), s in zip(self.inputs.items(), row, strict=True)}
            for row in shares
        ]


class SweepPart(Section):
    """A base case and axes; every combination of one value of each is a case."""

    base: Text | None = None
    """The case, relative to this file, or a shipped one by its name; its variations and study are
    not used."""
    set: Changes = Field(default_factory=dict)
    """Overrides for every case, as after ``--set`` (and ``ranks``)."""
    grid: Annotated[dict[str, Any], BeforeValidator(_grid)] | None = None
    """Lists of values by key; each is an axis."""
    lists: Line | None = None
    """Lists of values by key that vary together: one axis."""
    table: Annotated[dict[Name, dict[str, Any]], BeforeValidator(_table)] | None = None
    """Overrides by name: one axis."""
    latin_hypercube: LatinHypercube | None = None
    """Samples of uncertain inputs: one axis."""

    @property
    def lengths(self) -> tuple[int, ...]:
        """How many values each axis has."""
        return (
            *(len(values) for values in (self.grid or {}).values()),
            len(steps(self.lists or {})),
            1 if self.table is None else len(self.table),
            self.latin_hypercube.samples if self.latin_hypercube else 1,
        )


class Sweep(SweepPart):
    """The content of a sweep file: one part, or several by name that share base and ``set``."""

    title: Text = ""
    """A line for people."""
    parts: Annotated[dict[Name, SweepPart], MAPPING] = Field(default_factory=dict)
    """Parts with axes of their own, and with a base of their own where it differs."""
    compare_with: Annotated[Literal["paper"], Word()] | None = None
    """A publication whose numbers, figures and trends get a page beside the report."""

    @model_validator(mode="after")
    def _one_or_several(self) -> Sweep:
        for key in ("grid", "lists", "table", "latin_hypercube"):
            if self.parts and getattr(self, key) is not None:
                fail("stands beside parts; put it into each of them that has it", at=(key,))
        for name, part in {"": self, **self.parts}.items():
            if (name or not self.parts) and (part.base or self.base) is None:
                path = ("parts", name, "base") if name else ("base",)
                fail("missing; expected the case that is varied, relative to this file", at=path)
            if (number := math.prod(part.lengths)) > MOST_CASES:
                text = f"{number} combinations; at most {MOST_CASES} are allowed"
                fail(text, at=("parts", name) if name else ())
        return self


@dataclass(frozen=True)
class SweepPoint:
    """One case of a sweep.

    Attributes:
        name: Unique in the sweep: ``part/value_value``.
        part: Its part; empty if the sweep has none.
        base: Its case as written.
        changes: All its overrides, ``ranks`` among them.
        varied: The keys of them that are on an axis.
        places: Where each override stands in the file.
    """

    name: str
    part: str
    base: str
    changes: dict[str, Any]
    varied: tuple[str, ...]
    places: dict[str, Path]


def expand(sweep: Sweep) -> list[SweepPoint]:
    """Every case, in the order of the file; the last axis changes fastest."""
    parts: list[tuple[Path, SweepPart]] = [(("parts", name), p) for name, p in sweep.parts.items()]
    return [p for path, part in parts or [((), sweep)] for p in _points(sweep, part, path)]


def _points(sweep: Sweep, part: SweepPart, path: Path) -> Iterator[SweepPoint]:
    name = str(path[-1]) if path else ""
    for values in itertools.product(*_axes(part, path)):
        changes = {**sweep.set, **part.set}
        places: dict[str, Path] = {key: ("set", key) for key in sweep.set}
        places |= {key: (*path, "set", key) for key in part.set}
        for value in values:
            changes |= value.changes
            places |= value.places
        label = "_".join(value.name for value in values)
        yield SweepPoint(
            "/".join(filter(None, (name, label))) or "base",
            name,
            str(part.base or sweep.base),
            changes,
            tuple(key for value in values for key in value.changes),
            places,
        )


def _axes(part: SweepPart, path: Path) -> Iterator[list[Variation]]:
    """The axes of a part: the table, the grid's keys, the lists, the samples."""
    if part.table is not None:
        yield [
            Variation(name, changes, {key: (*path, "table", name, key) for key in changes})
            for name, changes in part.table.items()
        ]
    short = short_keys([*(part.grid or {}), *(part.lists or {})])
    yield from axes(part.grid or {}, short, (*path, "grid"))
    if part.lists is not None:
        varying = {key: value for key, value in part.lists.items() if isinstance(value, list)}
        called = labels(varying)
        yield [
            Variation(
                "_".join(f"{short[key]}={called[key][i]}" for key in varying),
                changes,
                {k: (*path, "lists", k, *((i,) if k in varying else ())) for k in changes},
            )
            for i, changes in enumerate(steps(part.lists))
        ]
    if (samples := part.latin_hypercube) is not None:
        digits = len(str(samples.samples))
        yield [
            Variation(
                f"sample{i + 1:0{digits}d}",
                changes,
                {key: (*path, "latin_hypercube", "inputs", key) for key in changes},
            )
            for i, changes in enumerate(samples.draw())
        ]


def samples(sweep: Sweep) -> dict[str, list[str]]:
    """The uncertain inputs of each part that has some."""
    parts = sweep.parts or {"": sweep}
    return {name: list(p.latin_hypercube.inputs) for name, p in parts.items() if p.latin_hypercube}
