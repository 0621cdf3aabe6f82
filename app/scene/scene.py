"""A scene: all that is solved, as the laws of a case that knows its stages and its sides.

It does not know the mesh or the solver. What a scene does not contain is an empty tuple.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from app.arrays import Field
from app.case.run_options import TimeOptions
from app.laws.cure import Cure
from app.laws.heat_conditions import HeatCondition
from app.laws.interface_laws import InterfaceLaw
from app.laws.loads import Load
from app.laws.materials import Elastic, Rigid
from app.laws.supports import Foundation, Support
from app.laws.thermal import Thermal


@dataclass(frozen=True)
class Interface:
    """An interface between two sides, of displacement or of temperature.

    Attributes:
        name: Name in the case file.
        master: Regions on the stiffer side.
        slave: Regions on the softer side, which carries the jumps.
        law: What the sides do to each other.
        modulus: Modulus of the softer side, infinite if it is rigid [MPa].
        gap: Initial gap (n,) at points [mm], negative where the bodies interfere.
        history: Amplitudes of the gap at the ends of the stages, or empty (`laws.values.gap_at`).
        turned: Whether the master is the second side as declared.
        slave_share: Part of the heat of friction that goes into the slave side.
    """

    name: str
    master: tuple[str, ...]
    slave: tuple[str, ...]
    law: InterfaceLaw
    modulus: float
    gap: Field
    history: tuple[float, ...] = ()
    turned: bool = False
    slave_share: float = 0.0


@dataclass(frozen=True)
class SceneStage:
    """A part of the loading: from time k to k + 1, in a number of increments.

    Attributes:
        name: Name in the results.
        increments: Load steps; in a stage that takes time, equal parts after each of which the
            mechanics are solved and fields are written.
        adaptive: Whether load steps may be cut, and time steps be chosen by their error; if not,
            a stage that takes time is done in ``increments`` equal time steps, divided where the
            course of a condition or of cure has a kink.
        max_cut_backs: How often in a row a step may be halved.
        duration: Time it takes [s]; 0: none, temperatures stay as they are.
        steady: Whether heat flows until nothing changes, however long that takes.
    """

    name: str
    increments: int
    adaptive: bool
    max_cut_backs: int
    duration: float = 0.0
    steady: bool = False


@dataclass(frozen=True)
class Scene:
    """Everything that is solved, and nothing else.

    Attributes:
        order: Of the displacement.
        elastic: Elastic regions.
        rigid: Rigid regions.
        foundations: Springs to the ground.
        supports: What holds displacements.
        loads: What does work.
        contacts: Interfaces whose sides can part.
        bonds: Interfaces whose sides cannot, one of which deforms.
        stages: The loading history.
        conductors: Regions that conduct heat.
        heat: What heats or cools.
        thermal_contacts: Interfaces whose sides have temperatures of their own.
        friction_heat: Interfaces heated by friction.
        expansions: Regions with thermal strain.
        cures: Regions that set.
        time: How stages that take time are divided into steps; None without heat.
        coupled: Whether heat depends on contact: both are one system then.
    """

    order: int
    elastic: tuple[Elastic, ...]
    rigid: tuple[Rigid, ...]
    foundations: tuple[Foundation, ...]
    supports: tuple[Support, ...]
    loads: tuple[Load, ...]
    contacts: tuple[Interface, ...]
    stages: tuple[SceneStage, ...]
    conductors: tuple[Thermal, ...] = ()
    heat: tuple[HeatCondition, ...] = ()
    thermal_contacts: tuple[Interface, ...] = ()
    friction_heat: tuple[Interface, ...] = ()
    expansions: tuple[Thermal, ...] = ()
    cures: tuple[Cure, ...] = ()
    time: TimeOptions | None = None
    coupled: bool = False
    bonds: tuple[Interface, ...] = ()

    @property
    def moduli(self) -> dict[str, float]:
        """Largest Young's modulus of each region that carries load, infinite if rigid [MPa]."""
        elastic = {e.region: e.modulus for e in self.elastic}
        return elastic | {r.region: math.inf for r in self.rigid}

    def holds(self, support: Support, stage: int) -> bool:
        """Whether a support holds in a stage."""
        return support.stages is None or self.stages[stage].name in support.stages
