"""A sweep file, read and checked: what each of its cases is."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from app.case import overlay, study_options
from app.case.case import Case, load
from app.case.sweep_options import Sweep, SweepPoint, expand
from app.errors import InputError
from app.schema import section, yaml_file
from app.schema.yaml_file import CaseFile, Fault


@dataclass(frozen=True)
class SweptRun:
    """A case of a sweep.

    Attributes:
        point: Its place in the sweep, ``--set`` options among its overrides.
        base: The case file.
        overrides: What makes the case out of it, as after ``--set``.
        ranks: Number of MPI ranks.
        case: The whole of it.
    """

    point: SweepPoint
    base: Path
    overrides: tuple[str, ...]
    ranks: int
    case: Case


def read(path: Path, overrides: Sequence[str] = ()) -> tuple[Sweep, list[SweptRun]]:
    """Read a sweep and check every case of it.

    Args:
        path: The sweep file.
        overrides: ``--set`` options: they hold for every case, in place of what is under ``set``.

    Raises:
        InputError: All that is wrong with the file or any case, each at its place.
    """
    file = yaml_file.read(path)
    for key, what in (("geometry", "case: use mantle run"), ("study", "study: use mantle study")):
        if key in file.data:
            raise InputError(f"{path}: this is a {what} {path}")
    try:
        sweep = Sweep.model_validate(file.data)
    except ValidationError as error:
        file.raise_all(section.faults(error))
        raise  # only if an error could not be told in words
    planned: list[SweptRun] = []
    points = expand(sweep)
    varied = ((p.places[key], key) for p in points for key in p.varied)
    problems = yaml_file.clashes(overrides, varied)
    ranks, others = study_options.split_ranks(overrides)
    given = {o.partition("=")[0].strip(): _value(o) for o in overrides}
    for point in points:
        base = overlay.found(path.parent, point.base)
        own = {k: v for k, v in point.changes.items() if k != "ranks" and k not in given}
        changes = (*study_options.options(own), "variations={}", *others)
        try:
            case = load(base, changes).config
        except InputError as error:
            problems += [_located(point, base, m, own, file) for m in error.messages]
            continue
        number = ranks or point.changes.get("ranks", 1)
        used = replace(point, changes=point.changes | given)
        planned.append(SweptRun(used, base, changes, number, case))
    file.raise_all(problems)
    return sweep, planned


def _value(option: str) -> Any:
    """The value of an option; None if it has none that can be read."""
    text = option.partition("=")[2]
    return yaml_file.changed(CaseFile(""), [f"value={text}"]).data.get("value")


def _located(
    point: SweepPoint, base: Path, message: str, own: Mapping[str, Any], file: CaseFile
) -> Fault:
    """A defect of a case, where its cause stands in the sweep."""
    part = ("parts", point.part) if point.part else ()
    if message.startswith(f"{base}: "):  # it cannot be read
        at = (*part, "base")
        return Fault(at if at in file.places else ("base",), message)
    if found := yaml_file.at_override(message, {key: point.places[key] for key in own}):
        return found
    if re.match(r"--set |[^ ]+:\d+:\d+: ", message):
        return Fault(part, message)
    return Fault(part, f"{point.name}: {message}")
