"""Records: what another package follows in the mechanics of a run and publishes of it.

A record sees every step, is saved and restored with the run, and adds its numbers to
``summary.json`` and ``history.csv``, and fields by cell. `add_record` registers it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Protocol

from app.case.case import Case
from app.foundation.arrays import Floats

if TYPE_CHECKING:
    from app.mechanics.problem import Problem
    from app.results.stresses import Stresses
    from app.stepping.load_steps import OnStep
    from meshes.gruen import Zones

# Returns, at points (n, 3) [mm], by part of a hip (`quantities.PARTS`) a level (n,) that is not
# positive in it (`meshes.gruen.Zones.borders`).
Borders = Callable[[Floats], dict[str, Floats]]


class Followed(Protocol):
    """Mechanics of a run that a record follows.

    Attributes:
        zones: Zones of a hip, if it is one.
    """

    problem: Problem
    stresses: Stresses
    zones: Zones | None


class Record:
    """A record of one run. This base publishes nothing; a record overrides what it needs.

    Attributes:
        saved: Names of the attributes that are saved.
    """

    saved: tuple[str, ...] = ()

    def before(self, on_step: OnStep) -> OnStep:
        """Return a hook of steps that takes a step in, then calls ``on_step``."""
        return on_step

    def numbers(self) -> dict[str, Any]:
        """Published numbers, merged into those of ``summary.json``; collective."""
        return {}

    def step_record(self) -> dict[str, float]:
        """Columns of ``history.csv`` after a step; collective."""
        return {}

    def cell_fields(self, cells: int) -> dict[str, Floats]:
        """Fields by name on the cells of this rank (cells,)."""
        return {}


# Makes the record of a run, or None if its case needs none; collective.
Maker = Callable[[Case, Followed], Record | None]
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


def records(case: Case, mechanics: Followed) -> dict[str, Record]:
    """The records of a run; collective."""
    made = {name: make(case, mechanics) for name, make in MAKERS.items()}
    return {name: record for name, record in made.items() if record is not None}


def merge(numbers: dict[str, Any], added: Mapping[str, Any]) -> None:
    """Add numbers to others, section by section."""
    for key, value in added.items():
        if isinstance(value, Mapping):
            merge(numbers.setdefault(key, {}), value)
        else:
            numbers[key] = value
