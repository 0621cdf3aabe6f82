"""Records: what another package follows in the mechanics of a run and publishes of it.

A record sees every step, is saved and restored with the run, and adds its numbers to
``summary.json`` and ``history.csv``, and fields by cell. `add_record` registers it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from app.case.case import Case
from app.case.summary import Summary
from app.foundation.arrays import Floats, Ints

if TYPE_CHECKING:
    from app.case.run_options import Stage
    from app.heat.implicit_step import ImplicitStep
    from app.mechanics.problem import Problem
    from app.results.stresses import Stresses
    from app.stepping.load_steps import OnStep
    from meshes.gruen import Zones

# Called before a stage.
OnStage = Callable[["Stage"], None]
# Returns, at points (n, 3) [mm], by part of a hip (`quantities.PARTS`) a level (n,) that is not
# positive in it (`meshes.gruen.Zones.borders`).
Borders = Callable[[Floats], dict[str, Floats]]


@dataclass(frozen=True)
class Followed:
    """Mechanics and heat of a run that a record follows.

    Attributes:
        zones: Zones of a hip, if it is one.
        heat: The implicit step of its heat, if heat flows in it.
    """

    problem: Problem
    stresses: Stresses
    zones: Zones | None
    heat: ImplicitStep | None


class NodalSurface(Protocol):
    """Triangulated surfaces of bodies, in parts, with fields at their nodes."""

    @property
    def dof(self) -> Ints:
        """Global blocked dofs of the nodes (m,)."""

    @property
    def bodies(self) -> Ints:
        """Bodies that have the fields at each node (m, b)."""

    @property
    def interface(self) -> Ints:
        """Part of the surfaces that each node is in (m,)."""

    @property
    def triangles(self) -> Sequence[Ints]:
        """Facets of each part, as nodes (f, 3)."""


@dataclass(frozen=True)
class SurfaceFields:
    """Fields on an interface whose sides share no nodes.

    Attributes:
        master: Surface of the master.
        values: By name: at the contact points of the interface (n,), and at the nodes of the
            master (m,).
    """

    master: NodalSurface
    values: Mapping[str, tuple[Floats, Floats]]


class Record:
    """A record of one run. This base publishes nothing; a record overrides what it needs.

    Attributes:
        saved: Names of the attributes that are saved.
    """

    saved: tuple[str, ...] = ()

    def before(self, on_step: OnStep) -> OnStep:
        """Return a hook of steps that takes a step in, then calls ``on_step``."""
        return on_step

    def before_stage(self, on_stage: OnStage) -> OnStage:
        """Return a hook of stages that prepares a stage, then calls ``on_stage``."""
        return on_stage

    def numbers(self) -> Summary:
        """Sections of ``summary.json``, merged into those of the run; collective."""
        return {}

    def step_record(self) -> dict[str, float]:
        """Columns of ``history.csv`` after a step; collective."""
        return {}

    def cell_fields(self, cells: int) -> dict[str, Floats]:
        """Fields by name on the cells of this rank (cells,)."""
        return {}

    def surface_fields(self) -> dict[str, SurfaceFields]:
        """Fields on both sides of interfaces, by interface."""
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


def records(case: Case, followed: Followed) -> dict[str, Record]:
    """The records of a run; collective."""
    made_records = {name: make(case, followed) for name, make in MAKERS.items()}
    return {name: record for name, record in made_records.items() if record is not None}
