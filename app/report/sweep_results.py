"""A sweep read back from its folder: its cases, their numbers, and the main ones of these."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any

from app.case import number_text, quantities, summary_numbers
from app.case.number_text import Number
from app.case.summary import Summary
from app.foundation.arrays import Floats
from app.foundation.errors import InputError
from app.plots.curves import ROUNDED
from app.results.reading import PathTable, Results
from app.results.verdicts import UNUSABLE
from app.schema.units import number_and_unit
from app.system.folders import read_json, reading

INTERFACES = ("cement_bone", "stem_cement", "stem_bone")
# Of each contact quantity: the percentile that converges, its unit for people, factor, words.
_CONTACT = {
    key: quantities.TABLE["interfaces"][f"{key}_max"]
    for key in ("gap", "slip", "motion", "micromotion", "pressure", "shear")
}
PERCENTILES = {
    key: next(p for p in ("p95", "p99") if quantities.TABLE["interfaces"][f"{key}_{p}"].headline)
    for key in _CONTACT
}
QUANTITIES = {key: (number_text.printed(q.shown), q.factor) for key, q in _CONTACT.items()}
QUANTITY_LABELS = {key: q.label.removesuffix(", max") for key, q in _CONTACT.items()}
QUANTITY_LABELS |= quantities.PLACES
CONVERGED = "converged"
# Statuses of a case.
STATUSES = (CONVERGED, "not converged", "failed", "stopped", UNUSABLE)


# Content of a JSON file: summary.json, provenance.json, a case as plain data.
Json = dict[str, Any]


@dataclass(frozen=True)
class SweptCase:
    """A case of a sweep.

    Attributes:
        folder: Its run directory, which may be missing.
        status: One of `STATUSES`.
        overrides: Differences from the sweep's case, as after ``--set``.
        seconds: Wall time.
        unknowns: Number of unknowns, 0 if not known.
        numbers: Main numbers by full name, in units of ``summary.json``.
        notes: Warnings of the run.
    """

    name: str
    folder: Path
    status: str
    part: str = ""
    overrides: Json = field(default_factory=dict)
    exit_code: int = 0
    message: str = ""
    seconds: float = 0.0
    unknowns: int = 0
    ranks: int = 1
    numbers: dict[str, float] = field(default_factory=dict)
    errors: dict[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def done(self) -> bool:
        """True if the case has results."""
        return self.status == CONVERGED

    @cached_property
    def data(self) -> Json:
        """The resolved configuration as plain data; empty if it cannot be read."""
        with suppress(InputError):
            return Results(self.folder).case
        return {}

    @property
    def bones(self) -> list[str]:
        """Regions of bone."""
        regions = self.data.get("regions", {})
        return [name for name, region in regions.items() if region.get("tissue") == "bone"]

    @cached_property
    def summary(self) -> Summary:
        """Content of summary.json; empty if the case is not done or it cannot be read."""
        with suppress(OSError, ValueError, TypeError):
            return Results(self.folder).summary if self.done else {}
        return {}

    @cached_property
    def step_record(self) -> dict[str, Floats]:
        """Columns of history.csv by their titles; nan where there is no value; may be empty."""
        with suppress(OSError):
            return Results(self.folder).step_record
        return {}

    @cached_property
    def paths(self) -> dict[str, PathTable]:
        """Fields along the paths by their names; empty if their files cannot be read."""
        with suppress(OSError, ValueError, KeyError):
            return Results(self.folder).paths
        return {}

    def number(self, name: str) -> Number | None:
        """Return a number by ``<interface or region>.<key>`` in its printed unit, or None."""
        value, error = (
            summary_numbers.read(self.summary, name, suffix) for suffix in ("", "_error")
        )
        if value is None:
            value, error = self.numbers.get(name), self.errors.get(name)
        if value is None or not self.done:
            return None
        q = quantities.quantity_of(name)
        factor = q.factor if q else 1.0
        return Number(factor * value, None if error is None else factor * error)


@dataclass(frozen=True)
class SweepResults:
    """A sweep.

    Attributes:
        cases: All its cases, failed ones too.
        program: Version and hash of the program that ran it.
        seconds: Wall time.
        uncertainty: Results of uncertain inputs, by part (`app/campaigns/uncertainty.py`).
    """

    folder: Path
    title: str
    cases: Sequence[SweptCase]
    file: str = ""
    program: str = ""
    cores: int = 1
    seconds: float = 0.0
    uncertainty: Json = field(default_factory=dict)

    @property
    def on_axes(self) -> list[SweptCase]:
        """Cases other than samples. Samples vary in all inputs at once and give no curves."""
        return [case for case in self.cases if case.part not in self.uncertainty]


def read(folder: Path) -> SweepResults:
    """Read ``sweep.json``.

    Raises:
        InputError: The file is missing or cannot be read.
    """
    path = folder / "sweep.json"
    if not path.exists():
        problem = "has no sweep.json" if folder.is_dir() else "no such folder"
        raise InputError(
            f"{folder}: {problem}; expected a folder written by mantle run, sweep or fit"
        )
    with reading(path):
        record = read_json(path)
        cases = [_case(entry, folder) for entry in record["cases"]]
        given_fields: Json = {
            f.name: record[f.name] for f in fields(SweepResults) if record.get(f.name)
        }
    if not cases:
        raise InputError(f"{path}: has no cases")
    given_fields |= {
        "folder": folder,
        "title": given_fields.get("title", folder.name),
        "cases": cases,
    }
    return SweepResults(**given_fields)


def _case(entry: Json, folder: Path) -> SweptCase:
    given_fields = {
        f.name: entry[f.name] for f in fields(SweptCase) if entry.get(f.name) is not None
    }
    for key in ("numbers", "errors"):
        given_fields[key] = {k: v for k, v in given_fields.get(key, {}).items() if v is not None}
    given_fields["notes"] = tuple(given_fields.get("notes", ()))
    return SweptCase(**given_fields | {"folder": folder / given_fields["folder"]})


def by_part(cases: Sequence[SweptCase]) -> dict[str, list[SweptCase]]:
    """Return the cases of each part of the sweep."""
    return {
        part: [c for c in cases if c.part == part] for part in dict.fromkeys(c.part for c in cases)
    }


def named(name: str) -> str:
    """Return a name of an interface, region or quantity in words."""
    return QUANTITY_LABELS.get(name) or quantities.place_in_words(name)


def magnitude(value: object) -> float | None:
    """Number of a value with or without a unit (``4.0 mm``); None if it has none."""
    parts = number_and_unit(value)
    return parts[0] if parts else None


def headlines(cases: Sequence[SweptCase]) -> list[str]:
    """Full names of the numbers to show, most important first."""
    names: dict[str, None] = {}
    for case in cases:
        for section in quantities.ADDED.values():
            leading = [q.key for q in quantities.TABLE[section.name].values() if q.headline]
            if section.leads:
                numbers = summary_numbers.numbers_of(case.summary)
                owners = [owner for name, owner, _ in numbers if name == section.name]
                names |= {f"{owner}.{key}": None for owner in owners for key in leading}
        for name in case.summary.get("interfaces", {}):
            names |= {f"{name}.{q}_{statistic}": None for q, statistic in PERCENTILES.items()}
    for case in cases:
        # Bone comes first: heat damages it, while cement may start hot.
        regions = case.summary.get("thermal", {}).get("regions", {})
        order = sorted(regions, key=lambda name: name not in case.bones)
        names |= {f"{name}.temperature_max": None for name in order}
    for case in cases:
        names |= dict.fromkeys(case.numbers)
    known_names = []
    for name in names:
        if not all(case.number(name) is None for case in cases):
            known_names.append(name)
    return known_names


def is_varying(values: Sequence[float]) -> bool:
    """Return True if numbers vary by more than rounding."""
    return max(values, default=0.0) - min(values, default=0.0) > max(ROUNDED.values())
