"""Results of a study, as plain data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from app.campaigns.runs import Result
from app.campaigns.work_precision import Effectivity, Point, ReferenceValue
from app.case.quantities import Quantity
from app.schema.yaml_file import Path

# Exponents nearer to 0 say that the error does not depend on the key.
FLAT = 0.05


@dataclass(frozen=True)
class PlannedRun:
    """A point of a line or of the reference's ladder.

    Attributes:
        path: Where the line stands in the case file.
        line: Its name; empty in the reference.
        index: The point's number along it.
        changes: Its overrides.
        key: The key that stands for all that vary; empty if none does.
    """

    path: Path
    line: str
    index: int
    changes: dict[str, Any]
    key: str

    @property
    def label(self) -> str:
        """The value of its key, as written."""
        value = self.changes.get(self.key, "")
        return f"#{self.index + 1}" if isinstance(value, dict | list) else str(value)


@dataclass(frozen=True)
class StudyRun(PlannedRun):
    """A point of a line, or of the reference's ladder, and what became of it.

    Attributes:
        x: The value of its key as a number, if it is one.
        unit: Internal unit of the number; empty if it has none.
        time: Run time without meshing and compiling, which are done once, and without companions
            that tell the error [s]; None if it failed.
        tolerance: Relative tolerance of the solver.
        result: Its result.
    """

    x: float | None
    unit: str
    time: float | None
    tolerance: float
    result: Result

    @property
    def status(self) -> str:
        """Done, or how it failed."""
        code = self.result.exit_code
        return f"failed (exit code {code})" if code else "done"


@dataclass(frozen=True)
class Measured:
    """One quantity over the runs of all lines.

    Attributes:
        name: Its name.
        quantity: What it is.
        compared: Whether it has an error; else only its values are shown.
        reference: What it is compared with; None if there is nothing.
        points: A point for each run.
        exponents: The p of error ~ key^p along each line.
        front: Points that no other beats in time and error, fastest first.
        errors: Error of each point, not less than the reference's own; None if unknown.
        advice: What to use; empty if it is not compared.
    """

    name: str
    quantity: Quantity
    compared: bool
    reference: ReferenceValue | None
    points: Sequence[Point]
    exponents: dict[str, float | None]
    front: list[int]
    errors: list[float | None]
    advice: str


@dataclass(frozen=True)
class Report:
    """Everything that a study found.

    Attributes:
        target: Relative error wanted.
        runs: The runs of all lines.
        ladder: Those of the reference.
        quantities: What was measured, over `runs`.
        advice: What to use for all of it; empty for a single quantity.
        effectivity: How good the estimated errors are.
    """

    target: float
    runs: Sequence[StudyRun]
    ladder: Sequence[StudyRun]
    quantities: Sequence[Measured]
    advice: str
    effectivity: Effectivity


def percent(value: float) -> str:
    """A relative number for people: 0.41 %, 12 %."""
    return f"{100 * value:.0f} %" if value >= 1 else f"{100 * value:.2g} %"
