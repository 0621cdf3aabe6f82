"""Records: what another package follows in the mechanics of a run and publishes of it.

A record sees every step, is saved and restored with the run, adds its numbers to ``summary.json``,
and adds fields by cell. `add_record` registers it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

from app.case.case import Case
from app.foundation.arrays import Floats

if TYPE_CHECKING:
    from app.mechanics.problem import Problem
    from app.stepping.load_steps import OnStep

# Returns, at points (n, 3) [mm], by part of a hip (`quantities.PARTS`) a level (n,) that is not
# positive in it (`meshes.gruen.Zones.borders`).
Borders = Callable[[Floats], dict[str, Floats]]


class Record(Protocol):
    """A record of one run."""

    @property
    def saved(self) -> tuple[str, ...]:
        """Names of the attributes that are saved."""

    def before(self, on_step: OnStep) -> OnStep:
        """Return a hook of steps that takes a step in, then calls ``on_step``."""

    def numbers(self) -> dict[str, dict[str, Any]]:
        """Published numbers by section of ``summary.json``; collective."""

    def cell_fields(self, cells: int) -> dict[str, Floats]:
        """Fields by name on the cells of this rank (cells,)."""


# Makes the record of a run, or None if its case needs none; collective.
Maker = Callable[[Case, "Problem", Borders | None], Record | None]
# By name, in the order in which they take a step in.
MAKERS: dict[str, Maker] = {}


def add_record(name: str, make: Maker) -> None:
    """Register what makes a record.

    Raises:
        ValueError: The name is taken.
    """
    if name in MAKERS:
        raise ValueError(f"there is a record '{name}' already")
    MAKERS[name] = make


def records(case: Case, problem: Problem, borders: Borders | None) -> dict[str, Record]:
    """The records of a run; collective."""
    made = {name: make(case, problem, borders) for name, make in MAKERS.items()}
    return {name: record for name, record in made.items() if record is not None}
