"""Sweep files: a base case, and axes whose values are combined."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError, model_validator

from app.case import planned_run, points
from app.case.planned_run import PlannedRun
from app.case.points import MOST_CASES, Point, SweepPart
from app.errors import InputError
from app.schema import section, yaml_file
from app.schema.section import MAPPING, Name, Text, fail


class Sweep(SweepPart):
    """The content of a sweep file: one part, or several by name that share base and ``set``."""

    title: Text = ""
    """A line for people."""
    parts: Annotated[dict[Name, SweepPart], MAPPING] = Field(default_factory=dict)
    """Parts with axes of their own, and with a base of their own where it differs."""
    compare_with: Literal["paper"] | None = None
    """A publication whose numbers, figures and trends get a page beside the report."""

    @model_validator(mode="after")
    def _one_or_several(self) -> Sweep:
        for key in ("grid", "lists", "table", "latin_hypercube"):
            if self.parts and getattr(self, key) is not None:
                fail("stands beside parts; put it into each of them that has it", at=(key,))
        for name, part in {"": self, **self.parts}.items():
            path = ("parts", name) if name else ()
            if (name or not self.parts) and (part.base or self.base) is None:
                text = "missing; expected the case that is varied, relative to this file"
                fail(text, at=(*path, "base"))
            if part.number > MOST_CASES:
                fail(f"{part.number} combinations; at most {MOST_CASES} are allowed", at=path)
        return self

    def points(self) -> list[Point]:
        """Every case, in the order of the file."""
        common = points.fixed(self.set, ())
        if not self.parts:
            return list(points.combine((), str(self.base), [common], self.axes(())))
        found: list[Point] = []
        for name, part in self.parts.items():
            path = ("parts", name)
            both = [common, points.fixed(part.set, path)]
            found += points.combine(path, str(part.base or self.base), both, part.axes(path))
        return found

    def uncertain(self) -> dict[str, list[str]]:
        """Uncertain inputs by part, of parts that have any."""
        parts = self.parts or {"": self}
        return {k: list(p.latin_hypercube.inputs) for k, p in parts.items() if p.latin_hypercube}


def read(path: Path, overrides: Sequence[str] = ()) -> tuple[Sweep, list[PlannedRun]]:
    """Read a sweep and check every case of it.

    Args:
        path: The sweep file.
        overrides: ``--set`` options for every case; they replace values under ``set``.

    Raises:
        InputError: Every error of the file and its cases, at its place.
    """
    file = yaml_file.read(path)
    for key, what in (("geometry", "case: use mantle run"), ("study", "study: use mantle study")):
        if key in file.data:
            raise InputError(f"{path}: this is a {what} {path}")
    try:
        sweep = Sweep.model_validate(file.data)
    except ValidationError as error:
        file.raise_all(section.faults(error))
        raise  # unreachable: the faults were raised
    planned, problems = planned_run.plan(file, path.parent, sweep.points(), overrides)
    file.raise_all(problems)
    return sweep, planned
