"""Output of ``mantle check``: the parts of a case as the program reads them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from app.case.case import Case
from app.case.run_options import Stage
from app.laws.materials import Rigid
from app.schema.section import Section
from app.soundness.cost import solid
from app.system.layout import plain


@dataclass(frozen=True)
class CheckedCase:
    """Result of the check of a case.

    Attributes:
        description: The case in words and tables.
        size: Cells, unknowns and memory: estimated, or counted if it was meshed.
        notes: Warnings about allowed but doubtful input.
    """

    description: str
    size: str
    notes: tuple[str, ...]

    def __str__(self) -> str:
        """All of it."""
        return "\n".join([self.description, self.size, *(f"note: {n}" for n in self.notes)])


def describe(case: Case, given: Mapping[str, Any]) -> str:
    """The case in words and tables; ``given`` is the data of the file, for its units."""
    lines = [case.title or "(no title)", ""]
    lines += ["geometry", *_entries(case.geometry, given.get("geometry"))]
    lines += ["mesh", *_entries(case.mesh, given.get("mesh")), "regions"]
    for name, region in case.regions.items():
        kind = "rigid" if isinstance(region, Rigid) else region.kind
        lines += [f"  {name}: {kind}", *_entries(region, given["regions"][name], 4)]
    lines += ["interfaces", *([] if case.interfaces else ["  none"])]
    for name, law in case.interfaces.items():
        a, b = (" + ".join(side) for side in case.geometry.interface_sides[name])
        lines += [
            f"  {name} ({a} | {b}): {law.kind}",
            *_entries(law, given.get("interfaces", {}).get(name), 4),
        ]
        if case.conducts and law.conductance is None:
            lines.append("    conductance: perfect, one temperature")
    if solid(case):
        lines += ["supports", *_table(case.supports)]
        lines += ["loads", *_table(case.loads), *_resultant(case)]
    if case.conducts:
        lines += ["heat", *_table(case.heat)]
    lines += ["stages", *map(_stage, case.stages)]
    if case.time is not None:
        lines += ["time", *_entries(case.time, given.get("time"))]
    if case.output.probes:
        lines += ["probes", *_table(case.output.probes)]
    if varied := case.variations:
        lines.append(f"variations: {len(varied)} runs, and none of the case without them")
        lines += [f"  {n}: {plain(keys) or 'the case as it is'}" for n, keys in varied.items()]
    return "\n".join(lines)


def _stage(stage: Stage) -> str:
    time = f"{stage.seconds:g} s, " if stage.seconds else "until nothing changes, " * stage.steady
    steps = f"{stage.increments} increment{'s' if stage.increments > 1 else ''}"
    return f"  {stage.name}: {time}{steps}{', adaptive' if stage.adaptive else ''}"


def _entries(model: Section, given: object, indent: int = 2) -> Iterable[str]:
    """A line per field: internal value, and the given one where that differs."""
    written = model.model_dump(mode="json", exclude_none=True)
    source = given if isinstance(given, dict) else {}
    for key, value in written.items():
        if value in ([], {}) or (indent > 2 and key in ("kind", "rigid")):
            continue  # nothing to say, or said already in the line above
        if isinstance(part := getattr(model, key), Section):
            kind = f" {value['kind']}" if "kind" in value else ""
            yield f"{' ' * indent}{key}:{kind}"
            yield from _entries(part, source.get(key), indent + 2)
            continue
        text = plain(value)
        raw = plain(source[key]) if key in source else None
        note = "" if raw is None or raw == text else f"  ({raw})"
        yield f"{' ' * indent}{key}: {text}{note}" + ("" if key in source else "  [default]")


def _table(entries: Mapping[str, Any]) -> list[str]:
    """A line per support, load, condition or probe."""
    lines = []
    for name, entry in entries.items():
        fields = entry.model_dump(mode="json", exclude_none=True)
        kind, place = fields.pop("kind", ""), fields.pop("boundary", "")
        words = [f"{kind} on {place}" if place else kind] if kind else []
        words += [f"{k} {plain(v)}" for k, v in fields.items()]
        lines.append(f"  {name}: {', '.join(words)}")
    return lines or ["  none"]


def _resultant(case: Case) -> Iterable[str]:
    """Resultant force at the end of the last stage."""
    loads = [load for load in case.loads.values() if load.resultant is not None]
    if not loads:
        return
    factors = [1.0 if load.history is None else load.history[-1] for load in loads]
    forces = zip(*(load.resultant for load in loads), strict=True)
    total = [math.sumprod(factors, along) for along in forces]
    components = ", ".join(f"{c:.6g}" for c in total)
    rest = "" if len(loads) == len(case.loads) else ", without pressures and body forces"
    yield f"  sum at the end: [{components}] N, {math.hypot(*total):.6g} N{rest}"
