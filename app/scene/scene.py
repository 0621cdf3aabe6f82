"""A scene: bodies, interfaces, supports, loads, heat and stages to be solved.

It does not know the mesh or the solver. Absent parts are empty tuples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from app.arrays import Field
from app.case.run_options import Stage as Stage
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
        master: Regions on the stiffer side.
        slave: Regions on the softer side, which carries the jumps.
        modulus: Modulus of the softer side, infinite if it is rigid [MPa].
        gap: Initial gap (n,) at points [mm], negative where the bodies interfere.
        history: Amplitudes of the gap at the ends of the stages, or empty (`laws.values.gap_at`).
        turned: Whether the master is the second side as declared.
        slave_share: Fraction of the friction heat that enters the slave side.
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
class Scene:
    """Everything that is solved, and nothing else.

    Attributes:
        order: Polynomial order of the displacement.
        contacts: Interfaces whose sides can part.
        bonds: Bonded interfaces with a deformable side.
        conductors: Regions that conduct heat.
        thermal_contacts: Interfaces with a temperature jump.
        friction_heat: Interfaces heated by friction.
        expansions: Regions with thermal strain.
        time: Time stepping of heat; None without heat.
        coupled: Whether heat depends on contact, so that both are solved together.
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
    expansions: tuple[Thermal, ...] = ()
    cures: tuple[Cure, ...] = ()
    time: TimeOptions | None = None
    coupled: bool = False
    bonds: tuple[Interface, ...] = ()

    @property
    def moduli(self) -> dict[str, float]:
        """Largest Young's modulus of each region that carries load, infinite if rigid [MPa]."""
        elastic = {e.region: max(e.moduli) for e in self.elastic}
        return elastic | {r.region: math.inf for r in self.rigid}

    def holds(self, support: Support, stage: int) -> bool:
        """Whether a support is active in a stage."""
        return support.stages is None or self.stages[stage].name in support.stages
