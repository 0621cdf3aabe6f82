"""Study files: a base case, lines of runs, measured quantities and their reference."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field, model_validator

from app.case import checks, overlay, points, quantities, sweep
from app.case.case import Case, PlannedRun
from app.case.points import Changes, Lists, Point, Runs
from app.schema import yaml_file
from app.schema.section import ITEMS, MAPPING, Name, Section, Text, defects_at, fail, show
from app.schema.units import PositiveNumber
from app.schema.yaml_file import Fault

CONDITION = "solver.condition"


def _quantity(value: object) -> object:
    if not isinstance(value, str):
        fail(f"{show(value)} is not <interface>.<key>, <region>.<key> or stem.<key>")
    quantities.quantity_or_fail(value)
    return value


def _values(value: object) -> object:
    if not isinstance(value, dict):
        fail(f"{show(value)} is not a mapping of quantities to values")
    for quantity, reference_value in value.items():
        if quantity in quantities.names_of_run_numbers():
            fail("has no reference value, as it describes the run; leave it out", at=(quantity,))
        with defects_at((quantity,)):
            quantities.known_value(quantity, reference_value)
    return value


class Reference(Section):
    """Reference: known values, one finer run as it is, or finer runs that are extrapolated."""

    values: Annotated[dict[str, str | int | float], BeforeValidator(_values)] | None = None
    """The exact value of each quantity."""
    run: Runs | None = None
    """Runs as in a line, finest last: two, or at least three to extrapolate, on other meshes than
    those of the lines. Without a list, one run that is the reference as it is."""

    @model_validator(mode="after")
    def _one(self) -> Reference:
        if (self.values is None) == (self.run is None):
            fail("expected either values or run")
        if any(isinstance(value, list) and len(value) < 2 for value in (self.run or {}).values()):
            message = "is a list with one value, so that the error of the reference is unknown; "
            fail(f"{message}expected at least two values, or one without a list", at=("run",))
        return self


class Study(Section):
    """Error against run time: varied keys and measured numbers."""

    quantities: Annotated[tuple[Annotated[str, BeforeValidator(_quantity)], ...], ITEMS]
    """Numbers of ``summary.json``: ``<interface or region>.<key>``, ``stem.<key>``, and what has a
    value but no error: ``solver.<key>``, ``timing.<key>``, penetrations."""
    target: PositiveNumber = 0.02
    """Relative error for which the fastest run is advised."""
    lines: Annotated[dict[Name, Lists], MAPPING]
    """Curves by name: overrides as after ``--set`` (and ``ranks``); lists vary together."""
    reference: Reference
    """Reference that the runs are compared with."""

    @model_validator(mode="after")
    def _complete(self) -> Study:
        for key in ("quantities", "lines"):
            if not getattr(self, key):
                fail("is empty", at=(key,))
        values = self.reference.values
        if values is not None:
            missing_quantities = [
                q for q in self.quantities if q not in values and self.compares(q)
            ]
            if missing_quantities:
                fail(f"no value for {', '.join(missing_quantities)}", at=("reference", "values"))
        return self

    def compares(self, quantity: str) -> bool:
        """Return True if a quantity is compared with the reference, not only shown."""
        return not quantities.quantity_or_fail(quantity).exact or quantity in (
            self.reference.values or {}
        )


class StudyFile(Section):
    """The content of a study file."""

    base: Text
    """The case, relative to this file, or a shipped one by its name; its variations are not
    used."""
    set: Changes = Field(default_factory=dict)
    """Overrides of the case for every point, as after ``--set``."""
    study: Study
    """Lines of runs and the numbers measured in each."""

    def points(self) -> Iterator[Point]:
        """Every run, in the order of the file; runs of the reference last."""
        lines: dict[tuple[str, ...], dict[str, object]] = {
            ("study", "lines", name): line for name, line in self.study.lines.items()
        }
        if self.study.reference.run is not None:
            lines[REFERENCE] = self.study.reference.run
        common = [points.overriding(self.set, ("set",))]
        for path, line in lines.items():
            axis = points.along(line, path, points.short_keys(list(line)))
            for point in points.combine(path, self.base, common, [axis]):
                if path == REFERENCE:
                    yield replace(point, name="reference" + point.name.removeprefix("run"))
                else:
                    yield point


# Path of the reference runs in a study file.
REFERENCE = ("study", "reference", "run")


def name_of_line(run: PlannedRun) -> str:
    """Name of the line of a run; empty for the reference."""
    return "" if run.point.path == REFERENCE else run.point.part


def _density(case: Case) -> tuple[float, str]:
    """Density of the mesh, and the same in words: lines around the stem, else cells per mm."""
    lines_around = case.geometry.grid(case.mesh).get("lines around")
    if lines_around or not case.mesh.size:
        return (
            lines_around or 0.0,
            f"{lines_around} lines around" if lines_around else "the mesh of the file",
        )
    return 1.0 / case.mesh.size, f"size {case.mesh.size:g} mm"


def _shared_meshes(study: Study, runs: Sequence[PlannedRun]) -> Iterator[Fault]:
    """Faults of a reference of several meshes: one that is judged too, or none that is finer."""
    ladder = [r for r in runs if not name_of_line(r)]
    judged_runs = {_density(r.case): r for r in reversed(runs) if name_of_line(r)}
    if not judged_runs or all(r.case.mesh == ladder[0].case.mesh for r in ladder):
        return
    key = points.varying(study.reference.run or {})[0]
    below_text = f"below {min(r.case.mesh.size for r in judged_runs.values()):g} mm"
    for r in ladder:
        density = _density(r.case)
        if density in judged_runs:
            message = (
                f"has the mesh of {judged_runs[density].name} ({density[1]}) and cannot be its "
            )
            message += f"reference; expected sizes that no line has, the last {below_text}"
            yield Fault(r.point.places[key], message)
    finest = max(judged_runs)
    if finest > _density(ladder[-1].case):
        message = (
            f"is not finer than {judged_runs[finest].name} ({finest[1]}); expected a last size"
        )
        yield Fault(ladder[-1].point.places[key], f"{message} {below_text}")


def read(
    path: Path, overrides: Sequence[str] = ()
) -> tuple[Study, list[PlannedRun], tuple[str, ...]]:
    """Read a study and check every run of it; ``--set`` keys that vary are refused.

    Returns:
        The study; its runs, those of the reference last; the options that hold for all of them.

    Raises:
        InputError: Every error of the file and its runs, at its place.
    """
    of_study = [o for o in overrides if re.match(r"\s*study\b", o)]
    other_overrides = [o for o in overrides if o not in of_study]
    file = yaml_file.read(path)
    overlay.apply(file, of_study)
    if overlay.file_kind(file.data) != "study":
        message = (
            "expected a study file: base: CASE, set, and study with quantities, lines, reference"
        )
        file.raise_all([Fault(("study",) if "study" in file.data else (), message)])
    content = sweep.checked_content(file, StudyFile)
    study = content.study
    runs, problems = sweep.runs_and_faults(
        file, path.parent, list(content.points()), other_overrides
    )
    if runs:
        quantity_of_path: dict[yaml_file.Path, str] = {
            ("study", "quantities", i): name for i, name in enumerate(study.quantities)
        }
        problems += checks.quantities(runs[0].case, quantity_of_path)
    problems += _shared_meshes(study, runs)
    if CONDITION in study.quantities and not all(r.case.output.condition for r in runs):
        key_path = ("study", "quantities", study.quantities.index(CONDITION))
        problems.append(Fault(key_path, "needs output.condition: true"))
    file.raise_all(problems)
    keys = {o.partition("=")[0].strip() for o in other_overrides}
    common = points.as_overrides({k: v for k, v in content.set.items() if k not in keys})
    return (
        study,
        [replace(run, needs_idle_machine=True) for run in runs],
        (*common, *other_overrides),
    )
