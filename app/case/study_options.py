"""The ``study`` section of a case: what varies, what is measured, and against what."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from app.case import quantities
from app.errors import InputError
from app.schema.section import ITEMS, MAPPING, Name, Section, Text, fail, show
from app.schema.units import PositiveNumber


def known_value(quantity: str, value: object) -> float:
    """A reference value in the unit of its quantity.

    Raises:
        PydanticCustomError: It has another dimension.
    """
    _, kind = quantities.UNITS[quantities.find(quantity).unit]
    return float(kind.read(value))


def _changes(value: object) -> dict[str, Any]:
    """Override keys with values."""
    if not isinstance(value, dict):
        fail(f"{show(value)} is not a mapping of keys to values, e.g. {{mesh.size: 3 mm}}")
    for key in value:
        if key.partition(".")[0] in ("study", ""):
            fail("is not what a run depends on", at=(key,))
    return value


def _runs(value: object) -> dict[str, Any]:
    """Override keys with values, of which lists vary together."""
    runs = _changes(value)
    lengths = {key: len(entry) for key, entry in runs.items() if isinstance(entry, list)}
    first = next(iter(lengths), "")
    for key, length in lengths.items():
        if not length:
            fail("is an empty list", at=(key,))
        if length != lengths[first]:
            fail(f"has {length} values where {first} has {lengths[first]}", at=(key,))
    check_ranks(runs)
    return runs


def check_ranks(changes: Mapping[str, Any], at: tuple[str, ...] = ()) -> None:
    """Refuse numbers of ranks that are none.

    Args:
        changes: Override keys with values or lists of them.
        at: Where they stand below the value under validation.
    """
    entry = changes.get("ranks", 1)
    for i, ranks in enumerate(entry if isinstance(entry, list) else [entry]):
        if not (type(ranks) is int and ranks > 0):
            item = (i,) if isinstance(entry, list) else ()
            text = f"{show(ranks)} is not a number of ranks; allowed: 1, 2, 3, ..."
            fail(text, at=(*at, "ranks", *item))


def _line(value: object) -> dict[str, Any]:
    """At least one of them a list."""
    runs = _runs(value)
    if not varying(runs):
        fail("varies nothing; expected a list for at least one key, e.g. mesh.size: [3 mm, 2 mm]")
    return runs


Changes = Annotated[dict[str, Any], BeforeValidator(_changes)]
Runs = Annotated[dict[str, Any], BeforeValidator(_runs)]
Line = Annotated[dict[str, Any], BeforeValidator(_line)]


def _quantity(value: object) -> object:
    """The name of a quantity, which has a unit."""
    if not isinstance(value, str):
        fail(f"{show(value)} is not <interface>.<key>, <region>.<key> or stem.<key>")
    quantities.find(value)
    return value


def _values(value: object) -> object:
    """Values of quantities, each with its unit."""
    if not isinstance(value, dict):
        fail(f"{show(value)} is not a mapping of quantities to values")
    for quantity, entry in value.items():
        if quantity in quantities.of_run():
            fail("is not compared with anything", at=(quantity,))
        try:
            known_value(quantity, entry)
        except PydanticCustomError as error:
            fail((error.context or {})["text"], at=(quantity,))
    return value


class Reference(Section):
    """Reference: known values, or a finer ladder that is extrapolated."""

    values: Annotated[dict[str, str | int | float], BeforeValidator(_values)] | None = None
    """The exact value of each quantity."""
    run: Runs | None = None
    """Runs as in a line, finest last: two, or at least three to extrapolate. Without a list, one
    run that is the reference as it is."""

    @model_validator(mode="after")
    def _one(self) -> Reference:
        if (self.values is None) == (self.run is None):
            fail("expected either values or run")
        if self.run is not None and varying(self.run) and len(steps(self.run)) < 2:
            fail(
                "has a single run; expected at least two, or its error is unknown; "
                "without a list the run is the reference as it is",
                at=("run",),
            )
        return self


class Study(Section):
    """Error against run time: what varies and what is measured."""

    quantities: Annotated[tuple[Annotated[str, BeforeValidator(_quantity)], ...], ITEMS]
    """Numbers of ``summary.json``: ``<interface or region>.<key>``, ``stem.<key>``, and what has a
    value but no error: ``solver.<key>``, ``timing.<key>``, penetrations."""
    target: PositiveNumber = 0.02
    """Relative error for which the fastest run is advised."""
    lines: Annotated[dict[Name, Line], MAPPING]
    """Curves by name: overrides as after ``--set`` (and ``ranks``); lists vary together."""
    reference: Reference
    """Reference that the runs are compared with."""

    @model_validator(mode="after")
    def _complete(self) -> Study:
        for key in ("quantities", "lines"):
            if not getattr(self, key):
                fail("is empty", at=(key,))
        if (values := self.reference.values) is not None:
            missing = [q for q in self.quantities if q not in values and self.compares(q)]
            if missing:
                fail(f"no value for {', '.join(missing)}", at=("reference", "values"))
        return self

    def compares(self, quantity: str) -> bool:
        """Whether a quantity is compared with the reference, or only shown."""
        return not quantities.find(quantity).exact or quantity in (self.reference.values or {})


class StudyFile(Section):
    """A study that stands apart from its case."""

    base: Text
    """The case, relative to this file, or a shipped one by its name; a study of its own is not
    used."""
    set: Changes = Field(default_factory=dict)
    """Overrides of the case for every point, as after ``--set``."""
    study: Study
    """Lines of runs and the numbers measured in each."""


def split_ranks(overrides: Sequence[str]) -> tuple[int | None, list[str]]:
    """The number of ranks among options, and the others, which are those of a case.

    Raises:
        InputError: It is no such number.
    """
    ranks, others = None, []
    for option in overrides:
        key, _, value = option.partition("=")
        if key.strip() != "ranks":
            others.append(option)
        elif re.fullmatch("[1-9][0-9]*", value.strip()):
            ranks = int(value)
        else:
            text = "is not a number of ranks; allowed: 1, 2, ..."
            raise InputError(f"--set ranks: {value.strip()} {text}")
    return ranks, others


def options(changes: Mapping[str, Any]) -> list[str]:
    """Overrides as options ``key=value``; JSON is YAML."""
    return [f"{key}={json.dumps(value, ensure_ascii=False)}" for key, value in changes.items()]


def steps(line: dict[str, Any]) -> list[dict[str, Any]]:
    """The overrides of each point of a line."""
    number = max((len(value) for value in line.values() if isinstance(value, list)), default=1)
    return [
        {key: value[i] if isinstance(value, list) else value for key, value in line.items()}
        for i in range(number)
    ]


def varying(line: dict[str, Any]) -> list[str]:
    """The keys that vary along a line, mesh.size first."""
    keys = [key for key, value in line.items() if isinstance(value, list)]
    return sorted(keys, key=lambda key: key != "mesh.size")
