"""A case of ``mantle stress``: its runs and their judge."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from mantle import configs
from mantle.errors import Reason
from mantle.results.reading import Run

CONFIGS = configs.FOLDER
# The cases that are varied, below `CONFIGS`.
STEM, TAPER, STACK = "stress/stem.yaml", "stress/taper.yaml", "blocks.yaml"
BAR, RINGS, WALL = (
    f"verification/{n}.yaml" for n in ("foundation_bar", "lame_plane_strain", "wall")
)
INCLINE, COOK = "verification/incline.yaml", "verification/cook.yaml"
# What an answer may be off where a closed form is compared with a mesh.
MESH = 0.02


@dataclass(frozen=True)
class Judged:
    """Verdict of a judge.

    Attributes:
        deviation: How far off the answer is, in the judge's own measure.
        note: What else is worth telling.
    """

    deviation: float
    note: str = ""


Judge = Callable[[Sequence[Run]], Judged]


@dataclass(frozen=True)
class Wanted:
    """A run that a case needs.

    Attributes:
        case: The case file, below `CONFIGS`.
        overrides: As after ``--set``.
        mesh: How its mesh is changed first, a name in `changed_meshes`; empty if it is not.
    """

    case: str
    overrides: tuple[str, ...] = ()
    mesh: str = ""


@dataclass(frozen=True)
class ExtremeCase:
    """A case: runs and what they must satisfy.

    Attributes:
        row: What is varied.
        line: What else is set, shared by the cases of a line; may be empty.
        at: The value that is varied.
        parameters: The same for machines.
        runs: The run in question first, then those that it is compared with.
        judge: How far off the answer is; None if there is no answer, and mantle has to say so.
        tolerance: Largest deviation.
        refused: Why mantle may, or has to, refuse it; None where it may not.
    """

    row: str
    line: str
    at: str
    parameters: dict[str, Any]
    runs: tuple[Wanted, ...]
    judge: Judge | None
    tolerance: float = 0.0
    refused: Reason | None = None
    name: str = field(init=False)

    def __post_init__(self) -> None:
        """Its name is made of row, line and value."""
        words = " ".join(filter(None, (self.row, self.line, self.at)))
        object.__setattr__(self, "name", words.replace(" ", "_").replace("/", "_"))


def trial(
    row: str,
    line: str,
    at: str,
    parameters: dict[str, Any],
    runs: Wanted | Sequence[Wanted],
    judge: Judge | None,
    tolerance: float = 0.0,
    refused: Reason | None = None,
) -> ExtremeCase:
    """A case, of one run or of several."""
    runs = (runs,) if isinstance(runs, Wanted) else tuple(runs)
    return ExtremeCase(row, line, at, parameters, runs, judge, tolerance, refused)
