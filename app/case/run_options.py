"""Options of a run: stages, solver, time steps, output."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, PrivateAttr, model_validator

from app.case.paths import AnyPath
from app.case.probes import AnyProbe
from app.laws.interface_laws import DEFAULT_AUGMENTATION
from app.schema import units
from app.schema.section import MAPPING, Name, Section, Truth, add_key, fail, show


class Stage(Section):
    """A stage of the loading history; multipliers are linear in it."""

    name: Name
    """Name in the results."""
    increments: units.PositiveInteger = 1
    """Number of load steps, before any is halved. In a stage that takes time: number of equal
    parts; after each of them the mechanics are solved and fields are written."""
    adaptive: Truth = True
    """Halve a step that does not converge, let it grow again when it is easy, and choose time steps
    by their error. Without it all steps are equal."""
    max_cut_backs: units.NonNegativeInteger = 6
    """Largest number of halvings of a step in a row."""
    duration: units.PositiveTime | None = None
    """Time that the stage takes. By default it takes none, and temperatures stay as they are."""
    steady: Truth = False
    """Compute the steady state of the temperature."""
    fracture_step: units.FractureEnergy | None = None
    """Energy that the damage of interfaces may dissipate in a load step. If a step would dissipate
    more, the load is sought at which it dissipates this energy; the load may fall. By default steps
    follow the load."""
    cycles: units.PositiveInteger = 1
    """Number of load cycles: loads, gaps and supports go to their values at the end of the stage
    and back to `valley`; `increments` counts the steps of one way. With cycle tables (last stage
    without `duration`): repetitions of the tables; `valley` is not used and `increments` counts the
    steps of a repetition."""
    valley: units.Share = 0.1
    """Part of the change of the stage that remains between two cycles."""
    creep_cycles: units.PositiveNumber | None = None
    """Number of cycles for which regions creep, at the loads of the end of the stage, their peak.
    Loads are applied first, in `increments` and without creep. Temperatures stay."""
    creep_time: units.PositiveTime | None = None
    """Time for which regions creep, for creep laws with a unit of time (`per`)."""
    creep_tolerance: units.PositiveNumber = 1e-2
    """Largest error of the creep strain in a step, over the largest elastic strain."""

    _repeats: bool = PrivateAttr(False)

    @property
    def repeats(self) -> bool:
        """Return True if cycle tables run through the stage."""
        return self._repeats

    def repeating(self) -> Stage:
        """The stage with cycles of cycle tables."""
        stage = self.model_copy()
        stage._repeats = True
        return stage

    @model_validator(mode="after")
    def _one_end(self) -> Stage:
        if self.steady and self.duration is not None:
            fail("a steady stage has no duration; leave one of the two out", at=("duration",))
        if self.cycles > 1 and (self.takes_time or self.extension_kind):
            fail(
                "a stage with a duration cannot have cycles; use a stage without duration",
                at=("cycles",),
            )
        if self.fracture_step and self.takes_time:
            fail(
                "a stage with a duration cannot control the fracture energy; leave one out",
                at=("fracture_step",),
            )
        if self.takes_time and self.extension_kind:
            message = "is the time of the stage; leave `duration` and `steady` out"
            fail(message, at=(self.extension_kind.key,))
        if self.creep_cycles and self.creep_time:
            fail("a stage has `creep_cycles` or `creep_time`; leave one out", at=("creep_time",))
        if self.creep and (self.takes_time or self.cycles > 1):
            message = (
                "loads are constant in a stage with creep; leave duration, steady and cycles out"
            )
            fail(message, at=(self.creep_key,))
        return self

    @property
    def extension_kind(self) -> StageKind | None:
        """Kind of the stage if another package solves it, else None."""
        return next((kind for kind in STAGE_KINDS if self.added(kind.key, float)), None)

    @property
    def creep_key(self) -> str:
        """The key that gives the length of creep."""
        return "creep_cycles" if self.creep_cycles else "creep_time"

    @property
    def creep(self) -> float:
        """Cycles or seconds of creep; 0 without."""
        return self.creep_cycles or self.creep_time or 0.0

    @property
    def loaded(self) -> float:
        """Fraction of the stage in which its loads are applied: creep is in the rest."""
        return 0.5 if self.creep else 1.0

    @property
    def load_segments(self) -> int:
        """Number of monotonic load segments in the stage; with cycle tables, number of cycles."""
        return self.cycles if self._repeats else 2 * self.cycles - 1

    def reversal(self, time: float) -> int:
        """Number of the load reversal at a time: 1 at the first peak, 0 if there is none."""
        segments_done = self.load_segments * (time - math.ceil(time) + 1)
        return round(segments_done) if abs(segments_done - round(segments_done)) < 1e-6 else 0

    @property
    def has_valleys(self) -> bool:
        """Return True if the loads go back to a valley. Loads of cycle tables have no valley."""
        return self.load_segments > self.cycles

    def is_valley(self, time: float) -> bool:
        """Return True at an even reversal: a valley, if the stage has valleys."""
        reversal = self.reversal(time)
        return reversal > 0 and reversal % 2 == 0

    def is_peak(self, time: float) -> bool:
        """Return True at a peak of the loads; with cycle tables, at the end of each cycle."""
        return self.reversal(time) > 0 and not (self.has_valleys and self.is_valley(time))

    def reached(self, fraction: float) -> float:
        """Applied fraction of the change at a fraction of the stage: 1 at the end and at peaks."""
        if self._repeats:
            return fraction
        full_segments = min(int(self.load_segments * fraction), self.load_segments - 1)
        low = self.valley if full_segments else 0.0
        up = min(self.load_segments * fraction / self.loaded, self.load_segments) - full_segments
        return low + (1.0 - low) * (1.0 - up if full_segments % 2 else up)

    @property
    def seconds(self) -> float:
        """Duration [s]; 0 without."""
        return self.duration or 0.0

    @property
    def takes_time(self) -> bool:
        """Return True if heat flows in the stage."""
        return self.steady or self.duration is not None


@dataclass(frozen=True)
class StageKind:
    """Kind of stage that another package solves at constant loads; stages with its key are of it.

    `simulation.steppers.add_stepper` registers what steps through them.

    Attributes:
        key: Key of a stage, whose value is the time that it takes [s].
        doc: Text of the key in the manual.
        no_cycle_table: Reason why cycle tables cannot run through such a stage.
        loads: Returns the name of the stage of a case at whose end its loads are.
        solves: Returns about how many solves such a stage of a case needs.
    """

    key: str
    doc: str
    no_cycle_table: str
    loads: Callable[..., str]
    solves: Callable[..., int]

    def seconds(self, stage: Stage) -> float:
        """Time that a stage of this kind takes [s]."""
        return stage.added(self.key, float) or 0.0


STAGE_KINDS: list[StageKind] = []


def add_stage_kind(kind: StageKind) -> None:
    """Let another package step through stages that have an additional key.

    Raises:
        ValueError: A stage has the key.
    """
    add_key(Stage, kind.key, units.PositiveTime, kind.doc)
    STAGE_KINDS.append(kind)


def _petsc(value: dict[str, object]) -> object:
    for name, option in value.items():
        if name.startswith("-"):
            fail(f"write the option without the dash: {name.lstrip('-')}", at=(name,))
        if name.split() != [name]:
            fail(f"{show(name)} is not the name of an option", at=(name,))
        if not isinstance(option, str | int | float | bool):
            fail(f"{show(option)} is not a single value", at=(name,))
    return value


class SolverOptions(Section):
    """Options of the solver."""

    tolerance: units.PositiveNumber = 1e-10
    """Residual relative to the scale of the forces at which a step has converged."""
    max_iterations: units.PositiveInteger = 40
    """Largest number of Newton iterations in a step."""
    linear: Literal["auto", "direct", "multigrid", "condensed"] = "auto"
    """Linear solver: factors, multigrid, or the bodies condensed onto the jumps of contact. `auto`
    takes the one that is expected to be fastest."""
    petsc: Annotated[dict[str, str | int | float | bool], BeforeValidator(_petsc), MAPPING] = Field(
        default_factory=dict
    )
    """Raw PETSc options, without the leading dash."""
    augmentation_factor: units.PositiveNumber = DEFAULT_AUGMENTATION
    """Ratio of the augmentation r to the local stiffness per area, where r is not given."""


class TimeOptions(Section):
    """Division of stages that take time into steps."""

    method: Literal["sdirk4", "backward_euler"] = "sdirk4"
    """Time integrator; both are L-stable, of order 4 and 1."""
    tolerance: units.PositiveDifference = 1e-3
    """Largest error of the temperature in a time step."""
    first_step: units.PositiveTime | None = None
    """First time step of a stage; chosen by mantle by default."""
    mechanical_step: units.PositiveDifference = 5.0
    """Change of temperature after which the mechanics are solved again. Cure counts as the
    temperature that it releases."""


class CheckpointOptions(Section):
    """Times at which the state of a run is saved; at a signal and at `--walltime` it always is."""

    steps: units.PositiveInteger | None = None
    """Number of steps between two checkpoints."""
    minutes: units.PositiveNumber | None = 1.0
    """Minutes between two checkpoints. The state is saved after the step that passes them.
    Checkpoints of a run that ends well are removed, unless this section asks for some."""


class OutputOptions(Section):
    """Results that are written."""

    fields: Truth = True
    """Write field files."""
    every: units.PositiveInteger = 1
    """Steps between two field outputs; the last step is always written."""
    condition: Truth = False
    """Estimate the condition number of the last Jacobian, which is factorized for it."""
    error: Truth = False
    """Estimate the error of each number by coarser companions of the run."""
    accuracy: units.PositivePart | None = None
    """Largest error, such as 5 %, of p99 of gap, slip and motion and of p95 of pressure and shear.
    Cheap runs choose mesh size and order for it, within the limits of memory and `--walltime`."""
    report: Truth = True
    """Write `report.html` at the end: the results as a page. `mantle report` also writes its
    curves and maps as PNG, SVG and PDF."""
    checkpoint: CheckpointOptions = CheckpointOptions()
    """Times at which the state is saved for `--restart`."""
    probes: Annotated[dict[Name, AnyProbe], MAPPING] = Field(default_factory=dict)
    """Points whose displacement and temperature are recorded over time, and strain gauges."""
    paths: Annotated[dict[Name, AnyPath], MAPPING] = Field(default_factory=dict)
    """Paths along which fields are written, at the steps of the fields (`every`)."""
