"""A scene: bodies, interfaces, supports, loads, heat and stages to be solved.

`scene_of` makes a scene from laws by name. It is the only function that chooses the equations.
`build_scene` takes the laws from a case. A scene does not know the mesh or the solver. Parts that a
scene does not have are empty tuples.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from app.case.run_options import Stage as Stage
from app.case.run_options import TimeOptions
from app.foundation.arrays import Bools, Field, Floats
from app.foundation.errors import InputError
from app.laws.creep import Creep
from app.laws.cure import Cure
from app.laws.cycle_tables import CycleTable
from app.laws.densities import ChangingDensity
from app.laws.fibres import Straight
from app.laws.heat_conditions import HeatCondition
from app.laws.interface_laws import InterfaceLaw, insertion_stages
from app.laws.loads import Load
from app.laws.materials import Elastic, Material, Region, Rigid
from app.laws.motions import Motion
from app.laws.supports import Foundation, Support
from app.laws.thermal import Thermal
from app.laws.values import NoStem, StemPlaces, amplitude
from app.numerics.rigid_motions import rotation_vector

if TYPE_CHECKING:  # a scene made in Python needs no cases
    from app.case.case import Case

# Default of arguments with laws by name: none.
NO_LAWS: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True)
class Interface:
    """An interface between two sides, of displacement or of temperature.

    Attributes:
        master: Regions on the stiffer side.
        slave: Regions on the softer side, which carries the jumps.
        modulus: Modulus of the softer side, infinite if it is rigid [MPa].
        gap: Initial gap as function of points (n, 3) -> (n,) [mm], negative where bodies interfere.
        gap_history: Multipliers of the gap at the ends of the stages, or empty
            (`laws.values.gap_at`).
        swapped: True if the master is the second side as declared.
        slave_share: Fraction of the friction heat that enters the slave side.
        constants: Constants of the law by name, as functions of points (n, 3) -> (n,).
        between: Boundaries of master and slave with finite sliding, whose bodies are meshed
            separately; else None.
        press_fit: True if micromotion is reported: the jump since the gap last changed.
        zones: Level functions of the zones, by name: points (n, 3) -> (n,), not positive inside.
        rounded_angle: Angle up to which straight facets at an edge stand for a rounded one [rad].
        off_bone: Function of points (n, 3), True where the sides never touch (n,); None: nowhere.
    """

    name: str
    master: tuple[str, ...]
    slave: tuple[str, ...]
    law: InterfaceLaw
    modulus: float
    gap: Field
    gap_history: tuple[float, ...] = ()
    swapped: bool = False
    slave_share: float = 0.0
    constants: Mapping[str, Field] = dataclasses.field(default_factory=dict)
    between: tuple[str, str] | None = None
    press_fit: bool = False
    zones: Mapping[str, Field] = dataclasses.field(default_factory=dict)
    rounded_angle: float = 0.0
    off_bone: Callable[[Floats], Bools] | None = None

    @property
    def slides_finitely(self) -> bool:
        """Return True with finite sliding: the bodies of the two sides are meshed separately."""
        return self.between is not None


@dataclass(frozen=True)
class Scene:
    """All laws that a run solves, with their regions and boundaries.

    Attributes:
        order: Polynomial order of the displacement.
        parting_interfaces: Interfaces whose sides can move relative to each other: all laws except
            bonded ones (`InterfaceLaw.can_part`). The jumps on them are unknowns.
        bonds: Bonded interfaces with a deformable side.
        conductors: Regions that conduct heat.
        thermal_contacts: Interfaces with a temperature jump.
        friction_heat: Interfaces heated by friction.
        sliding_heat: Interfaces with finite sliding that exchange the mean heat of a cycle.
        expansions: Regions with thermal strain.
        time: Time stepping of heat; None without heat.
        coupled: True if heat depends on contact, so that both are solved together.
        motions: Prescribed motions of regions.
        period: Duration of a cycle of the cycle tables, 0 without cycle tables [s].
        insertion: Number of stages in which press fits grow; cycle tables do not act in them.
        loads_of: From the index of each stage that another package solves to that of the stage
            whose final loads act in it.
    """

    order: int
    elastic: tuple[Elastic, ...]
    rigid: tuple[Rigid, ...]
    foundations: tuple[Foundation, ...]
    supports: tuple[Support, ...]
    loads: tuple[Load, ...]
    parting_interfaces: tuple[Interface, ...]
    stages: tuple[Stage, ...]
    conductors: tuple[Thermal, ...] = ()
    heat: tuple[HeatCondition, ...] = ()
    thermal_contacts: tuple[Interface, ...] = ()
    friction_heat: tuple[Interface, ...] = ()
    sliding_heat: tuple[Interface, ...] = ()
    expansions: tuple[Thermal, ...] = ()
    cures: tuple[Cure, ...] = ()
    creeps: tuple[Creep, ...] = ()
    time: TimeOptions | None = None
    coupled: bool = False
    bonds: tuple[Interface, ...] = ()
    motions: tuple[Motion, ...] = ()
    period: float = 0.0
    insertion: int = 0
    loads_of: Mapping[int, int] = dataclasses.field(default_factory=dict)

    @property
    def moduli(self) -> dict[str, float]:
        """Largest Young's modulus of each region that carries load, infinite if rigid [MPa]."""
        elastic = {e.region: max(e.moduli) for e in self.elastic}
        return elastic | {r.region: math.inf for r in self.rigid}

    @property
    def stiffness_varies(self) -> bool:
        """True if the stiffness varies from solve to solve: by cure or by density."""
        return bool(self.cures) or any(e.changing_density for e in self.elastic)

    def is_active(self, support: Support, stage: int) -> bool:
        """Return True if a support is active in a stage."""
        return support.stages is None or self.stages[stage].name in support.stages

    @property
    def loaded_boundaries(self) -> set[str]:
        """Boundaries on which loads or elastic foundations act."""
        boundaries = {foundation.boundary for foundation in self.foundations}
        return boundaries.union(*(load.boundaries for load in self.loads))

    def load_time(self, time: float) -> float:
        """Time on the load histories that corresponds to a time of the run (cycles removed).

        Loads are constant in a stage that another package solves (`loads_of`).
        """
        stage = max(math.ceil(time) - 1, 0)
        if stage in self.loads_of:
            return float(self.loads_of[stage] + 1)
        return stage + self.stages[stage].reached(time - stage)

    def force_sizes(self, times: Floats) -> dict[str, Floats]:
        """Size of each force at times (n,) [N], by the name of its load.

        A force with a cycle table or a motion is three loads of one name, one along each axis.
        """
        forces: dict[str, Floats] = {}
        load_times = [self.load_time(float(time)) for time in times]
        for load in self.loads:
            if load.resultant is not None:
                factors = [load.amplitude(load_time) for load_time in load_times]
                force = np.outer(factors, load.resultant)
                forces[load.name] = forces.get(load.name, 0.0) + force
        return {name: np.linalg.norm(force, axis=1) for name, force in forces.items()}

    @property
    def driven(self) -> tuple[Motion, ...]:
        """Motions that drive a boundary of an elastic region."""
        return tuple(motion for motion in self.motions if motion.boundary)

    def motion_of(self, regions: Sequence[str]) -> Motion | None:
        """First motion of any of the regions, or None."""
        return next((motion for motion in self.motions if motion.region in regions), None)

    def rotation(self, motion: Motion | None, time: float) -> Floats:
        """Rotation of a motion at a time (3, 3); the identity without a motion."""
        if motion is None:
            return np.eye(3)
        phase, ramp = cycle_phase(self.stages, time, self.insertion)
        return motion.rotation_at(phase, ramp)

    def rotation_substeps(self, stage: int, increment: float) -> int:
        """Sub-steps per increment of a stage that keep every rotation below `largest_step`.

        ``increment`` is the length of an increment, as a fraction of the stage.
        """
        times = [stage + i * increment for i in range(round(1 / increment) + 1)]
        substeps = 1
        for motion in self.motions:
            rotations = [self.rotation(motion, time) for time in times]
            largest_angle = max(
                float(np.linalg.norm(rotation_vector(R_end @ R_start.T)))
                for R_start, R_end in pairwise(rotations)
            )
            substeps = max(substeps, math.ceil(largest_angle / motion.largest_step - 1e-9))
        return substeps

    def last_reversal(self, time: float) -> float:
        """The last time before a time at which loads reverse or a stage begins."""
        stage = max(math.ceil(time) - 1, 0)
        segments = self.stages[stage].load_segments
        return stage + (math.ceil((time - stage) * segments - 1e-9) - 1) / segments


Exchanging = Callable[["Case"], Iterable[str]]
# Functions of other packages. They return the interfaces whose heat exchange the package sets.
_EXCHANGING: list[Exchanging] = []


def mean_exchange(function: Exchanging) -> Exchanging:
    """Register a function that returns the interfaces of a case whose heat exchange is set.

    These interfaces have finite sliding: their sides share no nodes. The package of the function
    sets the exchange by `heat.implicit_step.ImplicitStep.set_exchange`.
    """
    _EXCHANGING.append(function)
    return function


Densities = Callable[["Case"], Mapping[str, ChangingDensity]]
# Functions of other packages. They return the regions whose density changes.
_DENSITIES: list[Densities] = []


def by_density(function: Densities) -> Densities:
    """Register a function that returns the regions of a case whose stiffness follows a density.

    `mechanics.body_forms.BodyForms.density` is the density. After it changes,
    `Problem.follow_density` updates the stiffness.
    """
    _DENSITIES.append(function)
    return function


def scene_of(
    regions: Mapping[str, Region],
    stages: Sequence[Stage],
    *,
    order: int = 2,
    interfaces: Mapping[str, InterfaceLaw] = NO_LAWS,
    sides: Mapping[str, tuple[Sequence[str], Sequence[str]]] = NO_LAWS,
    sliding_boundaries: Mapping[str, tuple[str, str]] = NO_LAWS,
    supports: Mapping[str, Support | Foundation] = NO_LAWS,
    loads: Mapping[str, Load] = NO_LAWS,
    motions: Mapping[str, Motion] = NO_LAWS,
    heat: Mapping[str, HeatCondition] = NO_LAWS,
    time: TimeOptions | None = None,
    stem: StemPlaces | None = None,
    press_fits: Collection[str] = (),
) -> Scene:
    """Build a scene from laws.

    The names of regions, boundaries and interfaces are those of the mesh.

    Args:
        regions: Material of each region.
        stages: The stages in their order.
        order: Polynomial order of the displacement, 1 or 2.
        interfaces: Law of each interface. Regions that touch without an interface are bonded.
        sides: Regions on the two sides of each interface.
        sliding_boundaries: Boundaries of both sides of interfaces with finite sliding, unless the
            law has them.
        supports: Supports by name.
        loads: Loads by name.
        motions: Motions by name.
        heat: Heat conditions by name.
        time: Time stepping of heat; `TimeOptions()` by default.
        stem: Heights on a stem, for interferences and zones along the stem; z by default.
        press_fits: Interfaces whose micromotion is reported, also without an interference.

    Raises:
        InputError: The sides of an interface are unknown.
    """
    unknown = [name for name in interfaces if name not in sides]
    if unknown:
        raise InputError(f"interfaces.{unknown[0]}: expected the regions on its two sides")
    tables = _cycle_tables(motions, loads)
    stages = _with_cycle_tables(stages, tables)
    elastic = tuple(region.named(name) for name, region in regions.items() if region.deforms)
    rigid = tuple(region.named(name) for name, region in regions.items() if region.moves_rigidly)
    moduli = {e.region: max(e.moduli) for e in elastic}
    thermal = {
        name: _thermal(region, name)
        for name, region in regions.items()
        if region.thermal is not None
    }
    all_interfaces = [
        _interface(
            name, law, sides[name], sliding_boundaries.get(name), moduli, thermal, stem or NoStem()
        )
        for name, law in interfaces.items()
    ]
    all_interfaces = [
        dataclasses.replace(i, press_fit=i.press_fit or i.name in press_fits)
        for i in all_interfaces
    ]
    insertion = insertion_stages(interfaces, press_fits)
    conducting = [i for i in all_interfaces if i.law.conductance is not None]
    thermal_contacts = tuple(i for i in conducting if not i.slides_finitely)
    friction_heat = tuple(i for i in all_interfaces if i.law.heated_by_friction is not None)
    depends_on_friction = any(not i.slides_finitely for i in friction_heat)
    depends_on_pressure = any(i.law.conductances[1] > 0 for i in thermal_contacts)
    has_creep = any(stage.creep for stage in stages)
    split_loads: list[Load] = []
    for name, load in loads.items():
        split_loads += _loads(name, load, motions, stages, insertion)
    cycle_times = tables[0].times if tables else (0.0,)
    return Scene(
        order=order,
        elastic=elastic,
        rigid=rigid,
        foundations=tuple(s for s in supports.values() if s.is_spring is True),
        supports=tuple(
            _support(name, s, stages) for name, s in supports.items() if s.is_spring is False
        ),
        loads=tuple(split_loads),
        motions=tuple(motion.named(name) for name, motion in motions.items()),
        parting_interfaces=tuple(i for i in all_interfaces if i.law.can_part),
        bonds=tuple(i for i in all_interfaces if not i.law.can_part and math.isfinite(i.modulus)),
        stages=stages,
        period=cycle_times[-1] - cycle_times[0],
        insertion=insertion,
        conductors=tuple(thermal.values()),
        heat=tuple(condition.named(name) for name, condition in heat.items()),
        thermal_contacts=thermal_contacts,
        friction_heat=friction_heat,
        sliding_heat=tuple(i for i in conducting if i.slides_finitely),
        coupled=depends_on_friction or depends_on_pressure,
        expansions=tuple(t for t in thermal.values() if t.thermal_expansion),
        cures=tuple(t.cure.named(t.region) for t in thermal.values() if t.cure is not None),
        creeps=tuple(e.creep.named(e.region) for e in elastic if has_creep and e.creep is not None),
        time=(time or TimeOptions()) if thermal else None,
    )


def build_scene(case: Case) -> Scene:
    """Build the scene of a case.

    Raises:
        InputError: Heat flows between sides with finite sliding, and no package sets its exchange.
    """
    scene = scene_of(
        case.regions,
        case.stages,
        order=case.mesh.order,
        interfaces=case.interfaces,
        sides=case.geometry.interface_sides,
        sliding_boundaries=case.sliding_boundaries,
        supports=case.supports,
        loads=case.loads,
        motions=case.motions,
        heat=case.heat,
        time=case.time,
        stem=case.geometry,
        press_fits=case.geometry.press_fits,
    )
    exchanging: set[str] = set().union(*(function(case) for function in _EXCHANGING))
    for interface in scene.sliding_heat:
        if interface.name not in exchanging:
            raise InputError(
                f"interfaces.{interface.name}.conductance: no package computes the heat between "
                "sides with finite sliding; expected none"
            )
    changing_densities: dict[str, ChangingDensity] = {}
    for densities in _DENSITIES:
        changing_densities.update(densities(case))
    for e in scene.elastic:
        e.complete(case.geometry, changing_densities.get(e.region))
    stage_names = [stage.name for stage in case.stages]
    loads_of = {
        index: stage_names.index(stage.extension_kind.loads(case))
        for index, stage in enumerate(case.stages)
        if stage.extension_kind
    }
    return dataclasses.replace(scene, loads_of=loads_of)


def cycle_phase(stages: Sequence[Stage], time: float, insertion: int) -> tuple[float, float]:
    """Phase in the cycle (0 to 1) and ramp factor (0 to 1) at a time.

    The ramp is 0 in the stages of the insertion of a press fit. It is over the next stage, to the
    values at the beginning of the cycle. After the stage of the cycles, the values stay constant.

    Args:
        stages: The stages; cycle tables repeat in one of them.
        time: Stage k runs from k to k + 1.
        insertion: Number of stages of the insertion.
    """
    cycle_stage = next((k for k, stage in enumerate(stages) if stage.repeats), len(stages) - 1)
    if time <= cycle_stage:
        return 0.0, min(max(time - insertion, 0.0), 1.0)
    cycles = min(time - cycle_stage, 1.0) * stages[cycle_stage].cycles
    # The end of a cycle has phase 1.
    return cycles - math.ceil(cycles - 1e-9) + 1, 1.0


def _cycle_tables(motions: Mapping[str, Motion], loads: Mapping[str, Load]) -> list[CycleTable]:
    """Cycle tables of motions and loads."""
    motions_and_loads: list[Motion | Load] = [*motions.values(), *loads.values()]
    return [law.cycle for law in motions_and_loads if law.cycle is not None]


def _with_cycle_tables(stages: Sequence[Stage], tables: Sequence[CycleTable]) -> tuple[Stage, ...]:
    """The stages. Cycle tables repeat in the last stage without a duration."""
    if not tables:
        return tuple(stages)
    repeating = max(k for k, stage in enumerate(stages) if not stage.takes_time)
    return (*stages[:repeating], stages[repeating].repeating(), *stages[repeating + 1 :])


def _loads(
    name: str,
    load: Load,
    motions: Mapping[str, Motion],
    stages: Sequence[Stage],
    insertion: int,
) -> tuple[Load, ...]:
    """A load; for a force with a cycle table or a motion, its three components."""
    force = load.as_moving_force([motion.boundary for motion in motions.values()])
    if force is None:
        return (load.named(name),)
    followed_motion = motions[force.follows] if force.follows else None
    # Nodes of an elastic region that rotates have axes that rotate with the region.
    axes_motion = next((m for m in motions.values() if m.boundary == force.boundary), None)

    def component(axis: int, time: float) -> float:
        """Component of the force along an axis of the nodes at a time [N]."""
        phase, ramp = cycle_phase(stages, time, insertion)
        vector = np.array(force.force_at(phase))
        if followed_motion:
            vector = followed_motion.rotation_at(phase, ramp) @ vector
        vector = (ramp if force.cycle_table else amplitude(force.history, time)) * vector
        if axes_motion:
            vector = axes_motion.rotation_at(phase, ramp).T @ vector
        return float(vector[axis])

    components = []
    for axis, direction in enumerate(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))):
        unit_force = force.named(
            name, force=direction, cycle_table=None, follows=None, history=None
        )
        unit_force.set_amplitude(partial(component, axis))
        components.append(unit_force)
    return tuple(components)


def _thermal(region: Material, name: str) -> Thermal:
    """Thermal law of a region, with a fibre if there is no single conductivity."""
    thermal = region.thermal
    assert thermal is not None
    fibre = None
    if thermal.conductivity is None:
        fibre = region.fibre or thermal.fibre or Straight()
    return thermal.named(name, fibre=fibre)


def _support(name: str, support: Support, stages: Sequence[Stage]) -> Support:
    """Support with its name and load history; `stages` is None if it is active in all stages."""
    stage_names = {stage.name for stage in stages}
    is_always_active = support.stages is None or stage_names <= set(support.stages)
    changes: dict[str, Any] = {"stages": None} if is_always_active else {}
    if "history" in type(support).model_fields:
        changes["history"] = support.history or (1.0,) * len(stages)
    return support.named(name, **changes)


def _interface(
    name: str,
    law: InterfaceLaw,
    sides: tuple[Sequence[str], Sequence[str]],
    boundaries: tuple[str, str] | None,
    moduli: Mapping[str, float],
    thermal: Mapping[str, Thermal],
    stem: StemPlaces,
) -> Interface:
    """Interface with the stiffer side as master: the softer side carries the jumps."""
    first, second = (tuple(side) for side in sides)
    swapped = _stiffness(first, moduli) < _stiffness(second, moduli)
    master, slave = (second, first) if swapped else (first, second)
    boundaries = boundaries or law.sliding_boundaries
    # Fraction of the friction heat that enters the first side; a string means: by effusivity.
    first_share = law.heated_by_friction
    if first_share is None:
        slave_share = 0.0
    elif isinstance(first_share, str):
        master_effusivity = sum(thermal[region].effusivity for region in master) / len(master)
        slave_effusivity = sum(thermal[region].effusivity for region in slave) / len(slave)
        slave_share = slave_effusivity / (slave_effusivity + master_effusivity)
    else:
        slave_share = first_share if swapped else 1.0 - first_share
    return Interface(
        name,
        master,
        slave,
        law,
        modulus=_stiffness(slave, moduli),
        gap=law.gap_field(name, stem),
        gap_history=tuple(law.gap_multipliers or ()),
        swapped=swapped,
        slave_share=slave_share,
        constants=law.constants_at_points(name, stem),
        between=(boundaries[::-1] if swapped else boundaries) if boundaries else None,
        press_fit=law.is_press_fit,
        zones={
            zone: partial(_height_outside, ends, stem) for zone, ends in law.zone_heights.items()
        },
        rounded_angle=stem.rounded_angle,
        off_bone=partial(stem.off_bone, name),
    )


def _height_outside(ends: tuple[float, float], stem: StemPlaces, x: Floats) -> Floats:
    """Height of points (n, 3) beyond the nearer end of a zone of a stem, negative inside (n,) [mm].

    ``ends`` are the lower and the upper height of the zone.
    """
    low, high = ends
    height = stem.height_on_stem(x)
    return np.maximum(low - height, height - high)


def _stiffness(side: Sequence[str], moduli: Mapping[str, float]) -> float:
    """Largest modulus on a side of an interface [MPa]; infinite if rigid."""
    return max(moduli.get(region, math.inf) for region in side)
