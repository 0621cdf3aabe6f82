"""Terms of a scene: small frozen records, each calling one function of `forms`.

A term knows the regions or boundaries it acts on, its constants and how it changes over the stages
(``history``); it does not know the mesh, the other terms or the solver. What a scene does not
contain is an empty tuple of terms.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from ufl.core.expr import Expr

from app.arrays import Floats
from app.scene.fibres import Fibre
from app.scene.laws import BondTerm, InterfaceLaw
from app.scene.loads import Field, LoadTerm
from forms import elasticity, loads


def amplitude(history: Sequence[float], time: float) -> float:
    """Multiplier at a time: stage k runs from k to k + 1, its end value is ``history[k]``."""
    return float(np.interp(time, np.arange(len(history) + 1), [0.0, *history]))


def gap_at(gap: Floats, history: Sequence[float], time: float) -> Floats:
    """Gap of points at a time (n,) [mm].

    Args:
        gap: At full amplitude (n,) [mm].
        history: Its amplitudes at the ends of the stages. Empty: a clearance is there at once, an
            interference grows through the first stage.
        time: Stage k runs from k to k + 1.
    """
    if history:
        return amplitude(history, time) * gap
    return np.maximum(gap, 0.0) + amplitude((1.0,), time) * np.minimum(gap, 0.0)


@dataclass(frozen=True)
class EigenstrainTerm:
    """A stress-free strain of a region: components xx, yy, zz, yz, xz, xy at full amplitude."""

    components: tuple[float, float, float, float, float, float]
    history: tuple[float, ...]


@dataclass(frozen=True)
class Elastic:
    """An elastic region.

    Attributes:
        region: Its name.
        coefficients: Elastic coefficients of eq. 48 [MPa]: two if isotropic, else five.
        fibre: Fibre directions; None if isotropic.
        modulus: Largest Young's modulus [MPa]: what "softer" and "stiffer" compare.
        eigenstrains: Stress-free strains.
    """

    region: str
    coefficients: tuple[float, ...]
    fibre: Fibre | None
    modulus: float
    eigenstrains: tuple[EigenstrainTerm, ...]

    def energy(self, ε: Expr, coefficients: Sequence[Any], fibre: Any) -> Expr:
        """Strain energy density ψ(ε) [MPa], its constants handed in as UFL constants."""
        if self.fibre:
            return elasticity.transversely_isotropic_energy(ε, fibre, *coefficients)
        return elasticity.isotropic_energy(ε, *coefficients)


@dataclass(frozen=True)
class RigidBody:
    """A region that moves without deforming."""

    region: str


@dataclass(frozen=True)
class FoundationTerm:
    """A bed of springs on a boundary, stiffness (3,) [MPa/mm]."""

    boundary: str
    stiffness: tuple[float, float, float]

    def energy(self, v: Expr, k: Any) -> Expr:
        """Energy per area [N/mm]."""
        return loads.foundation_energy(k, v)


@dataclass(frozen=True)
class Support:
    """Given displacement components on a boundary.

    Attributes:
        name: Name in the case file.
        boundary: Boundary name.
        components: Which of x, y, z are given.
        values: Their values (n, 3) at points at full amplitude [mm].
        history: Amplitudes at the ends of the stages.
        active: Whether it holds in each stage; empty: in all.
        normal: Of a support that holds this direction alone, a unit vector or "face".
    """

    name: str
    boundary: str
    components: tuple[bool, bool, bool]
    values: Field
    history: tuple[float, ...]
    active: tuple[bool, ...] = ()
    normal: tuple[float, ...] | str = ()

    def holds(self, stage: int) -> bool:
        """Whether it holds in a stage."""
        return self.active[stage] if self.active else True


@dataclass(frozen=True)
class ContactTerm:
    """An interface whose sides can move apart.

    Attributes:
        name: Name in the case file.
        master: Regions on the stiffer side.
        slave: Regions on the softer side, which carries the jump.
        law: What the sides do to each other.
        modulus: Modulus of the softer side [MPa].
        gap: Initial gap (n,) at points [mm], negative where the bodies interfere.
        history: Amplitudes of the gap at the ends of the stages, or empty (see `gap_at`).
        turned: Whether the master is the second side as declared.
    """

    name: str
    master: tuple[str, ...]
    slave: tuple[str, ...]
    law: InterfaceLaw
    modulus: float
    gap: Field
    history: tuple[float, ...]
    turned: bool = False


# Pairs of seconds since the start of the run and multiplier, linear in between; empty: always one.
Course = tuple[tuple[float, float], ...]


def multiplier(course: Course, seconds: float) -> float:
    """Multiplier of a heat condition at a time [s]."""
    if not course:
        return 1.0
    return float(np.interp(seconds, [t for t, _ in course], [m for _, m in course]))


@dataclass(frozen=True)
class ConductorTerm:
    """A region that conducts heat.

    Attributes:
        region: Its name.
        conductivity: Along and across the fibre [N/(s K)], or one value if isotropic.
        fibre: Fibre directions; None if isotropic.
        capacity: Density times specific heat [N/(mm2 K)].
        initial: Initial temperature [K].
    """

    region: str
    conductivity: tuple[float, ...]
    fibre: Fibre | None
    capacity: float
    initial: float


@dataclass(frozen=True)
class FixedTemperatureTerm:
    """A given temperature [K] on a boundary, or in whole regions (the boundary is then empty)."""

    name: str
    boundary: str
    regions: tuple[str, ...]
    temperature: Field
    course: Course


@dataclass(frozen=True)
class HeatFluxTerm:
    """Heat that enters through a boundary [N/(mm s)]."""

    name: str
    boundary: str
    flux: Field
    course: Course


@dataclass(frozen=True)
class ConvectionTerm:
    """Heat exchange of a boundary: film coefficient [N/(mm s K)], temperature around it [K]."""

    name: str
    boundary: str
    coefficient: float
    ambient: float


@dataclass(frozen=True)
class HeatSourceTerm:
    """Heat released per volume and time in regions [N/(mm2 s)]."""

    name: str
    regions: tuple[str, ...]
    density: Field
    course: Course


@dataclass(frozen=True)
class PerfusionTerm:
    """Blood that brings a region to its own temperature (Pennes).

    Attributes:
        name: Name in the case file.
        regions: Regions perfused.
        coefficient: Rate times density and specific heat of blood [N/(mm2 s K)].
        temperature: Temperature of the blood [K].
    """

    name: str
    regions: tuple[str, ...]
    coefficient: float
    temperature: float


HeatCondition = (
    FixedTemperatureTerm | HeatFluxTerm | ConvectionTerm | HeatSourceTerm | PerfusionTerm
)


@dataclass(frozen=True)
class ThermalContact:
    """An interface whose sides have temperatures of their own.

    Attributes:
        name: Name in the case file.
        master: Regions on the stiffer side, the same as in mechanical contact.
        slave: Regions on the other side, which carries the temperature jump.
        open: Conductance without pressure [N/(mm s K)].
        per_pressure: Increase with pressure [N/(mm s K) per MPa]; 0 if it does not depend on it.
        cap: Largest conductance [N/(mm s K)]; infinite if none is given.
    """

    name: str
    master: tuple[str, ...]
    slave: tuple[str, ...]
    open: float
    per_pressure: float
    cap: float


@dataclass(frozen=True)
class FrictionHeat:
    """Heat of friction on a contact interface: the part that goes into the slave side."""

    interface: str
    slave_share: float


@dataclass(frozen=True)
class Expansion:
    """Thermal strain of a region: coefficient [1/K], temperature [K] without strain."""

    region: str
    coefficient: float
    reference: float


@dataclass(frozen=True)
class AutocatalyticCure:
    """Rate of cure k0 exp(-Ea/RT) a^m (a_max - a)^n.

    Attributes:
        rate_constant: k0 [1/s].
        activation_energy: Ea [J/mol].
        m: Exponent of the conversion.
        n: Exponent of what is left.
        limit: Pairs of temperature [K] and largest conversion, linear in between; empty: one.
    """

    rate_constant: float
    activation_energy: float
    m: float
    n: float
    limit: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class PrescribedCure:
    """Cure that follows a clock: rate [1/s] by time [s], normalised to reach one at the end."""

    rate: Course


@dataclass(frozen=True)
class CureTerm:
    """A region that sets.

    Attributes:
        region: Its name.
        kinetics: How fast.
        heat: Heat released from degree 0 to 1 per volume [MPa].
        initial: Degree of cure at the start.
        gel: Degree at which it starts to be a solid: from there it strains and stiffens.
        floor: Modulus before that, over the final one.
        exponent: Modulus = floor + (1 - floor) ((a - gel)/(1 - gel))^exponent.
        shrinkage: Volumetric shrinkage from gel to full cure.
    """

    region: str
    kinetics: AutocatalyticCure | PrescribedCure
    heat: float
    initial: float
    gel: float
    floor: float
    exponent: float
    shrinkage: float


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
class TimeStepping:
    """How stages that take time are integrated; none in scenes without heat.

    Attributes:
        method: sdirk4 or backward_euler.
        tolerance: Error of temperature per step [K] (and of cure, as the temperature it releases).
        first_step: First step of a stage [s]; 0: chosen.
        mechanical_step: Change [K], measured likewise, after which the mechanics are solved again,
            where heat does not need them sooner.
    """

    method: str
    tolerance: float
    first_step: float
    mechanical_step: float


@dataclass(frozen=True)
class Scene:
    """Everything that is solved, and nothing else."""

    order: int
    elastic: tuple[Elastic, ...]
    rigid: tuple[RigidBody, ...]
    foundations: tuple[FoundationTerm, ...]
    supports: tuple[Support, ...]
    loads: tuple[LoadTerm, ...]
    contacts: tuple[ContactTerm, ...]
    stages: tuple[SceneStage, ...]
    conductors: tuple[ConductorTerm, ...] = ()
    heat: tuple[HeatCondition, ...] = ()
    thermal_contacts: tuple[ThermalContact, ...] = ()
    friction_heat: tuple[FrictionHeat, ...] = ()
    expansions: tuple[Expansion, ...] = ()
    cures: tuple[CureTerm, ...] = ()
    time: tuple[TimeStepping, ...] = ()
    # Whether heat depends on contact: both are one system then.
    coupled: bool = False
    bonds: tuple[BondTerm, ...] = ()

    @property
    def moduli(self) -> dict[str, float]:
        """Largest Young's modulus of each region that carries load, infinite if rigid [MPa]."""
        elastic = {e.region: e.modulus for e in self.elastic}
        return elastic | {r.region: math.inf for r in self.rigid}
