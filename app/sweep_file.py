"""A sweep file, read and checked: what each of its cases is."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from app import case_file, config, study_options
from app.case_file import CaseFile, Problem
from app.errors import InputError
from app.sweep_options import Point, Sweep, expand


@dataclass(frozen=True)
class Planned:
    """A case of a sweep.

    Attributes:
        point: Its place in the sweep.
        base: The case file.
        overrides: What makes the case out of it, as after ``--set``.
        ranks: Number of MPI ranks.
        case: The whole of it.
    """

    point: Point
    base: Path
    overrides: tuple[str, ...]
    ranks: int
    case: config.Case


def read(path: Path, overrides: Sequence[str] = ()) -> tuple[Sweep, list[Planned]]:
    """Read a sweep and check every case of it.

    Args:
        path: The sweep file.
        overrides: ``--set`` options: they hold for every case, whatever the file says.

    Raises:
        InputError: All that is wrong with the file or any case, each at its place.
    """
    file = case_file.read(path)
    for key, what in (("geometry", "case: use mantle run"), ("study", "study: use mantle study")):
        if key in file.data:
            raise InputError(f"{path}: this is a {what} {path}")
    try:
        sweep = Sweep.model_validate(file.data)
    except ValidationError as error:
        file.raise_all(config.problems(error, Sweep))
        raise  # only if an error could not be told in words
    planned: list[Planned] = []
    problems: list[Problem] = []
    given = {o.partition("=")[0].strip(): o.partition("=")[2].strip() for o in overrides}
    if not re.fullmatch("[1-9][0-9]*", given.get("ranks", "1")):
        raise InputError(
            f"--set ranks: {given['ranks']} is not a number of ranks; allowed: 1, 2, ..."
        )
    others = [o for o in overrides if o.partition("=")[0].strip() != "ranks"]
    for point in expand(sweep):
        base = path.parent / point.base
        own = {k: v for k, v in point.changes.items() if k != "ranks" and k not in given}
        changes = (*study_options.options(own), "variations={}", *others)
        try:
            case = config.load(base, changes)
        except InputError as error:
            problems += [_located(point, base, m, own, file) for m in error.messages]
            continue
        ranks = int(given.get("ranks", point.changes.get("ranks", 1)))
        planned.append(Planned(point, base, changes, ranks, case))
    file.raise_all(problems)
    return sweep, planned


def _located(
    point: Point, base: Path, message: str, own: Mapping[str, Any], file: CaseFile
) -> Problem:
    """A defect of a case, where its cause stands in the sweep."""
    part = ("parts", point.part) if point.part else ()
    if message.startswith(f"{base}: "):  # it cannot be read
        at = (*part, "base")
        return Problem(at if at in file.places else ("base",), message)
    if found := case_file.located(message, own, ()):
        return Problem(point.places[str(found.path[0])], found.text)
    if re.match(r"--set |[^ ]+:\d+:\d+: ", message):
        return Problem(part, message)
    return Problem(part, f"{point.name}: {message}")
