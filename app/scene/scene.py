"""A scene: bodies, interfaces, supports, loads, heat and stages to be solved.

`scene_of` makes a scene of laws by name. It is the only place that chooses the equations.
`build_scene` takes the laws from a case. A scene does not know the mesh or the solver. Absent parts
are empty tuples.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from app.case.run_options import Stage as Stage
from app.case.run_options import TimeOptions
from app.foundation.arrays import Field, Floats
from app.foundation.errors import InputError
from app.laws.creep import Creep
from app.laws.cure import Cure
from app.laws.cycle_tables import CycleTable
from app.laws.densities import ChangingDensity
from app.laws.fibres import Straight
from app.laws.heat_conditions import HeatCondition
from app.laws.interface_laws import InterfaceLaw
from app.laws.loads import Load
from app.laws.materials import Elastic, Material, Region, Rigid
from app.laws.motions import Motion
from app.laws.supports import Foundation, Support
from app.laws.thermal import Thermal
from app.laws.values import NoStem, StemPlaces, amplitude
from app.numerics.rigid_motions import rotation_vector

if TYPE_CHECKING:  # a scene made in Python needs no cases
    from app.case.case import Case

# No laws of a kind.
NONE: Mapping[str, Any] = MappingProxyType({})


@dataclass(frozen=True)
class Interface:
    """An interface between two sides, of displacement or of temperature.

    Attributes:
        master: Regions on the stiffer side.
        slave: Regions on the softer side, which carries the jumps.
        modulus: Modulus of the softer side, infinite if it is rigid [MPa].
        gap: Initial gap as function of points (n, 3) -> (n,) [mm], negative where bodies interfere.
        gap_history: Amplitudes of the gap at the ends of the stages, or empty
            (`laws.values.gap_at`).
        swapped: True if the master is the second side as declared.
        slave_share: Fraction of the friction heat that enters the slave side.
        constants: Constants of the law by name, as functions of points (n, 3) -> (n,).
        between: Boundaries of master and slave with finite sliding, meshed apart; else None.
        press_fit: True if micromotion is reported: the jump since the gap last changed.
        zones: Parts of the surface with separate numbers: by name, a function of points (n, 3)
            that is not positive there (n,).
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


@dataclass(frozen=True)
class Scene:
    """Everything that is solved, and nothing else.

    Attributes:
        order: Polynomial order of the displacement.
        contacts: Interfaces whose sides can part.
        bonds: Bonded interfaces with a deformable side.
        conductors: Regions that conduct heat.
        thermal_contacts: Interfaces with a temperature jump.
        friction_heat: Interfaces heated by friction.
        sliding_heat: Interfaces with finite sliding that exchange the mean heat of a cycle.
        expansions: Regions with thermal strain.
        time: Time stepping of heat; None without heat.
        coupled: True if heat depends on contact, so that both are solved together.
        motions: Prescribed motions of regions.
        period: Time that a cycle of the cycle tables takes, 0 without [s].
        loads_of: Number of the stage whose final loads act, by the number of a stage that another
            package solves.
    """

    order: int
    elastic: tuple[Elastic, ...]
    rigid: tuple[Rigid, ...]
    foundations: tuple[Foundation, ...]
    supports: tuple[Support, ...]
    loads: tuple[Load, ...]
    contacts: tuple[Interface, ...]
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
    loads_of: Mapping[int, int] = dataclasses.field(default_factory=dict)

    @property
    def moduli(self) -> dict[str, float]:
        """Largest Young's modulus of each region that carries load, infinite if rigid [MPa]."""
        elastic = {e.region: max(e.moduli) for e in self.elastic}
        return elastic | {r.region: math.inf for r in self.rigid}

    @property
    def stiffens(self) -> bool:
        """True if the stiffness changes from solve to solve."""
        return bool(self.cures) or any(e._density for e in self.elastic)

    def holds(self, support: Support, stage: int) -> bool:
        """Return True if a support is active in a stage."""
        return support.stages is None or self.stages[stage].name in support.stages

    @property
    def loaded_boundaries(self) -> set[str]:
        """Boundaries on which loads or elastic foundations act."""
        of_loads = {name for load in self.loads for name in load.boundaries}
        return of_loads | {f.boundary for f in self.foundations}

    def load_time(self, time: float) -> float:
        """Time on the load histories that corresponds to a time of the run (cycles removed).

        Loads of a stage that another package steps through stay as they were (`loads_of`).
        """
        k = max(math.ceil(time) - 1, 0)
        if k in self.loads_of:
            return float(self.loads_of[k] + 1)
        return k + self.stages[k].reached(time - k)

    def force_sizes(self, times: Floats) -> dict[str, Floats]:
        """Size of each force at times (n,) [N], by the name of its load.

        A load with a cycle table or a motion has three parts, one along each axis.
        """
        forces: dict[str, Floats] = {}
        at = [self.load_time(float(time)) for time in times]
        for load in self.loads:
            if load.resultant is not None:
                factors = [load.amplitude(time) for time in at]
                part = np.outer(factors, load.resultant)
                forces[load.name] = forces.get(load.name, 0.0) + part
        return {name: np.linalg.norm(force, axis=1) for name, force in forces.items()}

    @property
    def driven(self) -> tuple[Motion, ...]:
        """Motions that drive a boundary of an elastic region."""
        return tuple(m for m in self.motions if m.boundary)

    def motion_of(self, regions: Sequence[str]) -> Motion | None:
        """The motion of some of the regions, if there is one."""
        return next((m for m in self.motions if m.region in regions), None)

    def rotation(self, motion: Motion | None, time: float) -> Floats:
        """Rotation of a motion at a time (3, 3); without a motion none."""
        return np.eye(3) if motion is None else motion.rotation_at(*cycle_phase(self.stages, time))

    def rotation_substeps(self, k: int, part: float) -> int:
        """Sub-steps per increment of stage k that keep every rotation below `largest_step`."""
        times = [k + i * part for i in range(round(1 / part) + 1)]
        most = 1
        for m in self.motions:
            R = [self.rotation(m, t) for t in times]
            angles = (float(np.linalg.norm(rotation_vector(b @ a.T))) for a, b in pairwise(R))
            most = max(most, math.ceil(max(angles) / m.largest_step - 1e-9))
        return most

    def last_reversal(self, time: float) -> float:
        """The last time before a time at which loads reverse or a stage begins."""
        k = max(math.ceil(time) - 1, 0)
        segments = self.stages[k].load_segments
        return k + (math.ceil((time - k) * segments - 1e-9) - 1) / segments


Exchanging = Callable[["Case"], Iterable[str]]
# Functions of other packages that give interfaces whose heat exchange they set.
_EXCHANGING: list[Exchanging] = []


def mean_exchange(function: Exchanging) -> Exchanging:
    """Register a function of a case: its interfaces with finite sliding whose exchange is set.

    Their sides share no nodes. `heat.implicit_step.ImplicitStep.set_exchange` sets their exchange.
    """
    _EXCHANGING.append(function)
    return function


Densities = Callable[["Case"], Mapping[str, ChangingDensity]]
# Functions of other packages that give regions whose density changes.
_DENSITIES: list[Densities] = []


def by_density(function: Densities) -> Densities:
    """Register a function of a case: its regions whose stiffness follows a density that changes.

    `mechanics.body_forms.BodyForms.density` is that density, `Problem.follow_density` follows it.
    """
    _DENSITIES.append(function)
    return function


def scene_of(
    regions: Mapping[str, Region],
    stages: Sequence[Stage],
    *,
    order: int = 2,
    interfaces: Mapping[str, InterfaceLaw] = NONE,
    sides: Mapping[str, tuple[Sequence[str], Sequence[str]]] = NONE,
    faces: Mapping[str, tuple[str, str]] = NONE,
    supports: Mapping[str, Support | Foundation] = NONE,
    loads: Mapping[str, Load] = NONE,
    motions: Mapping[str, Motion] = NONE,
    heat: Mapping[str, HeatCondition] = NONE,
    time: TimeOptions | None = None,
    stem: StemPlaces | None = None,
) -> Scene:
    """Build a scene from laws; regions, boundaries and interfaces go by the names of the mesh.

    Args:
        regions: Material of each region.
        stages: The loading history.
        order: Polynomial order of the displacement, 1 or 2.
        interfaces: Law of each interface. Regions that touch without an interface are bonded.
        sides: Regions on the two sides of each interface.
        faces: Boundaries of both sides of finite sliding, if the law names none.
        supports: Supports by name.
        loads: Loads by name.
        motions: Motions by name.
        heat: Heat conditions by name.
        time: Time stepping of heat; that of `TimeOptions` by default.
        stem: Heights on a stem, for interferences and zones along it; by default z.

    Raises:
        InputError: The sides of an interface are unknown.
    """
    unknown = [name for name in interfaces if name not in sides]
    if unknown:
        raise InputError(f"interfaces.{unknown[0]}: expected the regions on its two sides")
    tables = _cycle_tables(motions, loads)
    stages = _with_cycle_tables(stages, tables)
    elastic = tuple(r.named(n) for n, r in regions.items() if r.deforms)
    moduli = {e.region: max(e.moduli) for e in elastic}
    thermal = {n: _thermal(r, n) for n, r in regions.items() if r.thermal is not None}
    places = [
        _interface(name, law, sides[name], faces.get(name), moduli, thermal, stem or NoStem())
        for name, law in interfaces.items()
    ]
    conducting = tuple(i for i in places if i.law.conductance is not None)
    rubbing = tuple(i for i in places if i.law.heated_by_friction is not None)
    jumps = tuple(i for i in conducting if not i.between)
    times = tables[0].times if tables else (0.0,)
    return Scene(
        order=order,
        elastic=elastic,
        rigid=tuple(r.named(n) for n, r in regions.items() if r.moves_rigidly),
        foundations=tuple(s for s in supports.values() if s.is_spring is True),
        supports=tuple(
            _support(name, s, stages) for name, s in supports.items() if s.is_spring is False
        ),
        loads=tuple(
            part for name, load in loads.items() for part in _loads(name, load, motions, stages)
        ),
        motions=tuple(motion.named(name) for name, motion in motions.items()),
        contacts=tuple(i for i in places if i.law.can_part),
        bonds=tuple(i for i in places if not i.law.can_part and math.isfinite(i.modulus)),
        stages=stages,
        period=times[-1] - times[0],
        conductors=tuple(thermal.values()),
        heat=tuple(condition.named(name) for name, condition in heat.items()),
        thermal_contacts=jumps,
        friction_heat=rubbing,
        sliding_heat=tuple(i for i in conducting if i.between),
        coupled=any(not i.between for i in rubbing)
        or any(i.law.conductances[1] > 0 for i in jumps),
        expansions=tuple(t for t in thermal.values() if t.thermal_expansion),
        cures=tuple(t.cure.named(t.region) for t in thermal.values() if t.cure is not None),
        creeps=tuple(
            e.creep.named(e.region)
            for e in elastic
            if e.creep is not None and any(stage.creep for stage in stages)
        ),
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
        faces=case.faces,
        supports=case.supports,
        loads=case.loads,
        motions=case.motions,
        heat=case.heat,
        time=case.time,
        stem=case.geometry,
    )
    exchanging = {name for find in _EXCHANGING for name in find(case)}
    for interface in scene.sliding_heat:
        if interface.name not in exchanging:
            raise InputError(
                f"interfaces.{interface.name}.conductance: no package computes the heat between "
                "sides with finite sliding; expected none"
            )
    changing = {region: d for find in _DENSITIES for region, d in find(case).items()}
    for e in scene.elastic:
        e._geometry = case.geometry
        e._density = changing.get(e.region)
    names = [stage.name for stage in case.stages]
    loads_of = {
        k: names.index(stage.other.loads(case))
        for k, stage in enumerate(case.stages)
        if stage.other
    }
    pressed = case.geometry.press_fits
    contacts = tuple(
        dataclasses.replace(c, press_fit=True) if c.name in pressed else c for c in scene.contacts
    )
    return dataclasses.replace(scene, loads_of=loads_of, contacts=contacts)


def cycle_phase(stages: Sequence[Stage], time: float) -> tuple[float, float]:
    """Phase in the cycle (0 to 1) and ramp factor (0 to 1) at a time.

    The ramp is over the first stage, to the values at the beginning of the cycle. After the stage
    of the cycles, the values stay constant.
    """
    last = next((k for k, s in enumerate(stages) if s.repeats), len(stages) - 1)
    if time <= last:
        return 0.0, min(time, 1.0)
    passed = min(time - last, 1.0) * stages[last].cycles
    return passed - math.ceil(passed - 1e-9) + 1, 1.0


def _cycle_tables(motions: Mapping[str, Motion], loads: Mapping[str, Load]) -> list[CycleTable]:
    parts: list[Motion | Load] = [*motions.values(), *loads.values()]
    return [part.cycle for part in parts if part.cycle is not None]


def _with_cycle_tables(stages: Sequence[Stage], tables: Sequence[CycleTable]) -> tuple[Stage, ...]:
    """The stages; cycle tables run through the last one that takes no time."""
    if not tables:
        return tuple(stages)
    k = max(i for i, stage in enumerate(stages) if not stage.takes_time)
    return (*stages[:k], stages[k].repeating(), *stages[k + 1 :])


def _loads(
    name: str, load: Load, motions: Mapping[str, Motion], stages: Sequence[Stage]
) -> tuple[Load, ...]:
    """A load; of a force with a cycle table or a motion its three components."""
    force = load.moving_force([m.boundary for m in motions.values()])
    if force is None:
        return (load.named(name),)
    motion = motions[force.follows] if force.follows else None
    # Nodes of an elastic region that rotates have axes that rotate with it.
    local = next((m for m in motions.values() if m.boundary == force.boundary), None)

    def component(k: int, time: float) -> float:
        s, part = cycle_phase(stages, time)
        F = force.force_at(s)
        factor = part if force.cycle_table else amplitude(force.history, time)
        in_space = factor * (motion.rotation_at(s, part) @ F if motion else np.array(F))
        return float((local.rotation_at(s, part).T @ in_space if local else in_space)[k])

    parts = []
    for k, axis in enumerate(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))):
        part = force.named(name, force=axis, cycle_table=None, follows=None, history=None)
        part._value = partial(component, k)
        parts.append(part)
    return tuple(parts)


def _thermal(region: Material, name: str) -> Thermal:
    thermal = region.thermal
    assert thermal is not None
    fibre = None
    if thermal.conductivity is None:
        fibre = region.fibre or thermal.fibre or Straight()
    return thermal.named(name, fibre=fibre)


def _support(name: str, support: Support, stages: Sequence[Stage]) -> Support:
    names = {stage.name for stage in stages}
    always = support.stages is None or names <= set(support.stages)
    changes: dict[str, Any] = {"stages": None} if always else {}
    if "history" in type(support).model_fields:
        changes["history"] = support.history or (1.0,) * len(stages)
    return support.named(name, **changes)


def _interface(
    name: str,
    law: InterfaceLaw,
    sides: tuple[Sequence[str], Sequence[str]],
    faces: tuple[str, str] | None,
    moduli: Mapping[str, float],
    thermal: Mapping[str, Thermal],
    stem: StemPlaces,
) -> Interface:
    """Interface with the stiffer side as master: the softer side carries the jumps."""
    first, second = (tuple(side) for side in sides)
    swapped = _stiffness(first, moduli) < _stiffness(second, moduli)
    master, slave = (second, first) if swapped else (first, second)
    faces = faces or law.sliding_boundaries
    share = law.heated_by_friction
    if isinstance(share, str):
        e_m, e_s = (sum(thermal[r].effusivity for r in s) / len(s) for s in (master, slave))
        slave_share = e_s / (e_s + e_m)
    else:
        slave_share = 0.0 if share is None else share if swapped else 1.0 - share
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
        between=(faces[::-1] if swapped else faces) if faces else None,
        press_fit=law.is_press_fit,
        zones={zone: partial(_beyond, ends, stem) for zone, ends in law.zone_heights.items()},
    )


def _beyond(ends: tuple[float, float], stem: StemPlaces, x: Floats) -> Floats:
    """Distance of points (n, 3) along a stem beyond the nearer end of a zone (n,) [mm]."""
    height, (low, high) = stem.height_on_stem(x), ends
    return np.maximum(low - height, height - high)


def _stiffness(side: Sequence[str], moduli: Mapping[str, float]) -> float:
    """Largest modulus on a side of an interface [MPa]; infinite if rigid."""
    return max(moduli.get(region, math.inf) for region in side)
