"""Points of a sweep or a study as checked cases; errors have places in the file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from app.case import overlay, points
from app.case.case import Case, load
from app.case.points import Point
from app.errors import InputError
from app.schema.section import show
from app.schema.yaml_file import CaseFile, Fault


@dataclass(frozen=True)
class PlannedRun:
    """A case of a sweep or a study.

    Attributes:
        point: Its place in the file; its overrides include ``--set`` options.
        base: The case file.
        overrides: Changes of the base, as after ``--set``.
        ranks: Number of MPI ranks.
        case: The base with the overrides.
    """

    point: Point
    base: Path
    overrides: tuple[str, ...]
    ranks: int
    case: Case


def plan(
    file: CaseFile, folder: Path, every: Sequence[Point], overrides: Sequence[str]
) -> tuple[list[PlannedRun], list[Fault]]:
    """Check the case of each point; return the cases and the faults.

    Args:
        file: The file of the points.
        folder: The folder of relative bases.
        every: The points.
        overrides: ``--set`` options for every point; they replace values under ``set``.
    """
    problems = points.clashes(overrides, ((p.places[k], k) for p in every for k in p.varied))
    given = {o.partition("=")[0].strip(): _value(o) for o in overrides}
    others = [o for o in overrides if o.partition("=")[0].strip() != "ranks"]
    planned: list[PlannedRun] = []
    failed: dict[tuple[Path, str], list[Point]] = {}
    bases = Counter(overlay.found(folder, p.base) for p in every)
    for point in every:
        base, used = overlay.found(folder, point.base), point.changes | given
        ranks = used.get("ranks", 1)
        if not (type(ranks) is int and ranks > 0):
            text = f"{show(ranks)} is not a number of ranks; allowed: 1, 2, 3, ..."
            if "ranks" in given:
                raise InputError(f"--set ranks: {text}")
            problems.append(Fault(point.places["ranks"], text))
        own = {k: v for k, v in point.changes.items() if k not in ("ranks", *given)}
        changes = (*points.as_overrides(own), "variations={}", *others)
        try:
            case = load(base, changes).config
        except InputError as error:
            for message in error.messages:
                if found := points.at_override(message, {key: point.places[key] for key in own}):
                    problems.append(found)
                else:
                    failed.setdefault((base, message), []).append(point)
            continue
        planned.append(PlannedRun(replace(point, changes=used), base, changes, ranks, case))
    for (base, message), of in failed.items():
        at = (*of[0].path, "base")
        if len(of) < bases[base]:
            problems.append(Fault(of[0].path, f"{of[0].name}: {message}"))
        elif message.startswith(f"{base}: "):  # it cannot be read
            problems.append(Fault(at if at in file.places else ("base",), message))
        else:
            problems.append(Fault((), message, ""))
    return planned, problems


def _value(option: str) -> Any:
    """Value of an option; None if it cannot be read."""
    text = option.partition("=")[2]
    return overlay.changed(CaseFile(""), [f"value={text}"]).data.get("value")
