"""Sweep files: a base case, and axes whose values are combined; points as checked cases."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import Field, ValidationError, model_validator

from app.case import overlay, points
from app.case.case import PlannedRun, load_case
from app.case.former_keys import KEY, check_version
from app.case.points import MOST_CASES, Point, SweepPart, UncertainInputs
from app.foundation.errors import InputError
from app.schema import section, yaml_file
from app.schema.section import MAPPING, Name, Section, Text, fail, show
from app.schema.yaml_file import CaseFile, Fault

Content = TypeVar("Content", bound=Section)


class Sweep(SweepPart):
    """The content of a sweep file: one part, or several by name that share base and ``set``."""

    title: Text = ""
    """Title for logs and reports."""
    parts: Annotated[dict[Name, SweepPart], MAPPING] = Field(default_factory=dict)
    """Parts with their axes, and their base where it differs."""

    @model_validator(mode="after")
    def _one_or_several(self) -> Sweep:
        for key in ("grid", "lists", "table", "latin_hypercube", "sobol"):
            if self.parts and getattr(self, key) is not None:
                fail("cannot be combined with parts; put it into each part", at=(key,))
        for _, path, part in self._parts():
            if (part.base or self.base) is None:
                message = "missing; expected the case that is varied, relative to this file"
                fail(message, at=(*path, "base"))
            number = math.prod(map(len, part.axes(path)))
            if number > MOST_CASES:
                fail(f"{number} combinations; at most {MOST_CASES} are allowed", at=path)
        return self

    def _parts(self) -> list[tuple[str, yaml_file.Path, SweepPart]]:
        """The name and the path of each part, and the part."""
        return [(n, ("parts", n), p) for n, p in self.parts.items()] or [("", (), self)]

    def points(self) -> list[Point]:
        """Every case, in the order of the file."""
        all_points: list[Point] = []
        for _, path, part in self._parts():
            common = [points.overriding(self.set, ("set",))]
            common.append(points.overriding(part.set, (*path, "set")))
            all_points += points.combine(path, str(part.base or self.base), common, part.axes(path))
        return all_points

    def uncertain_inputs(self) -> dict[str, UncertainInputs]:
        """Uncertain inputs by part, of parts that have any."""
        samples_of_parts = {name: part.uncertain for name, _, part in self._parts()}
        return {name: samples for name, samples in samples_of_parts.items() if samples}


def read(path: Path, overrides: Sequence[str] = ()) -> tuple[Sweep, list[PlannedRun]]:
    """Read a sweep, with ``--set`` options that replace values under ``set``; check every case.

    Raises:
        InputError: Every error of the file and its cases, at its place.
    """
    file = yaml_file.read(path)
    kind = overlay.file_kind(file.data)
    if kind not in ("", "sweep"):
        command = "run" if kind == "case" else kind
        raise InputError(f"{path}: this is a {kind}: use mantle {command} {path}")
    sweep = checked_content(file, Sweep)
    planned, problems = runs_and_faults(file, path.parent, sweep.points(), overrides)
    file.raise_all(problems)
    return sweep, [replace(run, share=True) for run in planned]


def checked_content(file: CaseFile, model: type[Content]) -> Content:
    """The checked content of a sweep or study file.

    Raises:
        InputError: Every error of the file itself.
    """
    check_version(file)
    file.data.pop(KEY, None)
    try:
        return model.model_validate(file.data)
    except ValidationError as error:
        file.raise_all(section.faults(error))
        raise  # unreachable: the faults were raised


def runs_and_faults(
    file: CaseFile, folder: Path, all_points: Sequence[Point], overrides: Sequence[str]
) -> tuple[list[PlannedRun], list[Fault]]:
    """Check the case of each point; return the runs and the faults.

    Bases are relative to a folder. ``--set`` options replace values under ``set``, and are among
    the changes of each run.
    """
    problems = points.clashes(overrides, ((p.places[k], k) for p in all_points for k in p.varied))
    keys = [o.partition("=")[0].strip() for o in overrides]
    # An option that cannot be read counts as None here. Its error is reported when the case of the
    # point is read.
    given_values = dict.fromkeys(keys) | overlay.changed(CaseFile(""), overrides).given
    other_overrides = [o for key, o in zip(keys, overrides, strict=True) if key != "ranks"]
    planned: list[PlannedRun] = []
    points_of_failure: dict[tuple[Path, str], list[Point]] = {}
    bases = Counter(overlay.base_file(folder, p.base) for p in all_points)
    for point in all_points:
        base, all_changes = overlay.base_file(folder, point.base), point.changes | given_values
        ranks = all_changes.get("ranks", 1)
        if not isinstance(ranks, int) or isinstance(ranks, bool) or ranks < 1:
            problem = f"{show(ranks)} is not a number of ranks; allowed: 1, 2, 3, ..."
            if "ranks" in given_values:
                raise InputError(f"--set ranks: {problem}")
            problems.append(Fault(point.places["ranks"], problem))
            ranks = 1
        of_case = {k: v for k, v in point.changes.items() if k not in ("ranks", *given_values)}
        overrides_of_run = (*points.as_overrides(of_case), "variations={}", *other_overrides)
        try:
            case = load_case(base, overrides_of_run).config
        except InputError as error:
            for message in error.messages:
                fault = points.at_override(message, {key: point.places[key] for key in of_case})
                if fault:
                    problems.append(fault)
                else:
                    points_of_failure.setdefault((base, message), []).append(point)
            continue
        planned.append(
            PlannedRun(base, overrides_of_run, case, replace(point, changes=all_changes), ranks)
        )
    for (base, message), failed_points in points_of_failure.items():
        base_path = (*failed_points[0].path, "base")
        if len(failed_points) < bases[base]:
            problems.append(Fault(failed_points[0].path, f"{failed_points[0].name}: {message}"))
        elif message.startswith(f"{base}: "):  # it cannot be read
            problems.append(Fault(base_path if base_path in file.places else ("base",), message))
        else:
            problems.append(Fault((), message, ""))
    return planned, problems
