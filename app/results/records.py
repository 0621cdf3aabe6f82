"""Records: extension point for packages that follow the steps of a run and publish numbers.

A record is called at every step and is saved and restored with the run. It adds numbers to
``summary.json`` and ``history.csv``, and fields on cells. `add_record` registers it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from app.case.case import Case
from app.foundation.arrays import Floats, Ints

if TYPE_CHECKING:
    from app.case.run_options import Stage
    from app.heat.implicit_step import ImplicitStep
    from app.mechanics.problem import Problem
    from app.results.stresses import Stresses
    from app.stepping.load_steps import OnStep
    from meshes.gruen import Zones

# Function that is called before a stage.
OnStage = Callable[["Stage"], None]
# Function that returns levels at points (n, 3) [mm], by part of a hip (`quantities.PARTS`). A level
# (n,) is not positive in its part (`meshes.gruen.Zones.borders`).
Borders = Callable[[Floats], dict[str, Floats]]


@dataclass(frozen=True)
class RecordedModel:
    """Mechanics and heat of a run that a record follows.

    Attributes:
        problem: Mechanics of the run.
        stresses: Stresses of the regions.
        zones: Zones of a hip; None for other bodies.
        heat: Implicit step of heat; None without heat.
    """

    problem: Problem
    stresses: Stresses
    zones: Zones | None
    heat: ImplicitStep | None


class NodalSurface(Protocol):
    """Triangulated surface of bodies, in numbered parts, with fields at its nodes."""

    @property
    def dof(self) -> Ints:
        """Global blocked dofs of the nodes (m,)."""

    @property
    def bodies(self) -> Ints:
        """Bodies whose field is known at each node (m, b)."""

    @property
    def interface(self) -> Ints:
        """Part of the surface with each node (m,)."""

    @property
    def triangles(self) -> Sequence[Ints]:
        """Facets of each part, as nodes (f, 3)."""


@dataclass(frozen=True)
class SurfaceFields:
    """Fields on an interface between separately meshed bodies.

    Attributes:
        master: Surface of the master.
        values: Fields by name: values at the contact points of the interface (n,), and at the
            nodes of the master (m,).
    """

    master: NodalSurface
    values: Mapping[str, tuple[Floats, Floats]]


class Record:
    """A record of a run. The methods of this base class do nothing; subclasses override some.

    Attributes:
        saved: Names of the attributes that a checkpoint saves.
    """

    saved: tuple[str, ...] = ()

    def before(self, on_step: OnStep) -> OnStep:
        """Return a function that records a step and then calls ``on_step``."""
        return on_step

    def before_stage(self, on_stage: OnStage) -> OnStage:
        """Return a function that prepares a stage and then calls ``on_stage``."""
        return on_stage

    def numbers(self) -> Mapping[str, Any]:
        """Sections of ``summary.json`` by key; collective.

        They are merged with those of the run (`case.summary.merge`): a record adds numbers to a
        section of the core, or a section of its package.
        """
        return {}

    def step_record(self) -> dict[str, float]:
        """Return columns of ``history.csv`` after a step; collective."""
        return {}

    def cell_fields(self, cells: int) -> dict[str, Floats]:
        """Return fields by name on the cells of this rank (cells,)."""
        return {}

    def surface_fields(self) -> dict[str, SurfaceFields]:
        """Return fields on both sides of interfaces, by interface."""
        return {}


# Function that makes the record of a run, or None if the case does not need it; collective.
Maker = Callable[[Case, RecordedModel], Record | None]
# Makers by name, in the order in which records are called.
MAKERS: dict[str, Maker] = {}


def add_record(name: str, make: Maker) -> None:
    """Register a function that makes a record.

    Raises:
        ValueError: Another record has this name.
    """
    if name in MAKERS:
        raise ValueError(f"there is a record '{name}' already")
    MAKERS[name] = make


def records(case: Case, followed: RecordedModel) -> dict[str, Record]:
    """Return the records of a run by name; collective."""
    made_records = {name: make(case, followed) for name, make in MAKERS.items()}
    return {name: record for name, record in made_records.items() if record is not None}
