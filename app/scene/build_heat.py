"""The part of `app/scene/build.py` that chooses the terms of heat."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from app.arrays import Floats
from app.case.case import Case
from app.case.shapes import Sides
from app.errors import InputError
from app.laws import thermal as sections
from app.laws.fibres import FibreDirection
from app.laws.interface_laws import Interface
from app.laws.materials import Region
from app.laws.thermal import (
    Autocatalytic,
    Convection,
    Cure,
    FixedTemperature,
    HeatFlux,
    HeatSource,
    Perfusion,
    Prescribed,
    PressureConductance,
    Thermal,
)
from app.scene.fibres import Fibre
from app.scene.loads import Field
from app.scene.terms import (
    AutocatalyticCure,
    ConductorTerm,
    ConvectionTerm,
    Course,
    CureTerm,
    Expansion,
    FixedTemperatureTerm,
    FrictionHeat,
    HeatCondition,
    HeatFluxTerm,
    HeatSourceTerm,
    PerfusionTerm,
    PrescribedCure,
    ThermalContact,
    TimeStepping,
)
from app.schema.expressions import evaluate


def heat(case: Case, sides: Mapping[str, Sides]) -> dict[str, Any]:
    """The terms of heat by their names in `Scene`; none where nothing conducts.

    Args:
        case: The configuration.
        sides: Master and slave regions of each interface.
    """
    thermal = {n: r.thermal for n, r in case.regions.items() if r.thermal is not None}
    conductors = tuple(_conductor(n, t, case.regions[n]) for n, t in thermal.items())
    effusivities = {c.region: effusivity(c) for c in conductors}
    laws = case.interfaces.items()
    contacts = tuple(term for name, law in laws for term in _contact(name, law, sides[name]))
    friction = tuple(
        term
        for name, law in laws
        for term in _friction(name, law, case.geometry.interface_sides[name], sides, effusivities)
    )
    return {
        "conductors": conductors,
        "heat": tuple(_condition(name, c) for name, c in case.heat.items()),
        "thermal_contacts": contacts,
        "friction_heat": friction,
        "coupled": bool(friction) or any(c.per_pressure > 0 for c in contacts),
        "expansions": tuple(
            Expansion(name, t.thermal_expansion, t.reference_temperature or t.initial_temperature)
            for name, t in thermal.items()
            if t.thermal_expansion
        ),
        "cures": tuple(_cure(name, t.cure) for name, t in thermal.items() if t.cure is not None),
        "time": tuple(
            TimeStepping(t.method, t.tolerance, t.first_step or 0.0, t.mechanical_step)
            for t in (case.time,)
            if t is not None
        ),
    }


def _conductor(name: str, thermal: Thermal, region: Region) -> ConductorTerm:
    axial, transverse = thermal.axial_conductivity, thermal.transverse_conductivity
    if axial is None or transverse is None:
        conductivity: tuple[float, ...] = (thermal.conductivity or 0.0,)
        fibre = None
    else:
        conductivity = axial, transverse
        fibre = fibre_of(getattr(region, "fibre", None) or thermal.fibre or (0.0, 0.0, 1.0))
    capacity = thermal.density * thermal.specific_heat
    return ConductorTerm(name, conductivity, fibre, capacity, thermal.initial_temperature)


def fibre_of(direction: FibreDirection) -> Fibre:
    """The fibres that a file asks for."""
    if isinstance(direction, tuple):
        return Fibre(direction)
    return Fibre(direction.axis, direction.through, direction.kind)


def effusivity(conductor: ConductorTerm) -> float:
    """sqrt(k c), with the geometric mean of the three conductivities [N/(mm K s^1/2)]."""
    k = conductor.conductivity
    mean = (k[0] * k[1] ** 2) ** (1 / 3) if conductor.fibre else k[0]
    return math.sqrt(mean * conductor.capacity)


def _condition(name: str, condition: sections.HeatCondition) -> HeatCondition:
    key = f"heat.{name}"
    match condition:
        case FixedTemperature(temperature=None):
            # A course of temperatures is that of 1 K with the temperatures as multipliers.
            one, course = field(key, 1.0), _course(condition.course)
            return FixedTemperatureTerm(
                name, condition.boundary or "", condition.regions or (), one, course
            )
        case FixedTemperature():
            given = _temperature(f"{key}.temperature", condition.temperature or 0.0)
            return FixedTemperatureTerm(
                name, condition.boundary or "", condition.regions or (), given, ()
            )
        case HeatFlux():
            flux = field(f"{key}.flux", condition.flux)
            return HeatFluxTerm(name, condition.boundary, flux, _course(condition.course))
        case Convection():
            return ConvectionTerm(
                name, condition.boundary, condition.coefficient, condition.ambient
            )
        case HeatSource():
            density = field(f"{key}.density", condition.density)
            return HeatSourceTerm(name, condition.regions, density, _course(condition.course))
        case Perfusion():
            blood = condition.blood_density * condition.blood_specific_heat
            coefficient = condition.rate * blood
            return PerfusionTerm(name, condition.regions, coefficient, condition.temperature)


def _course(course: Sequence[tuple[float, float]] | None) -> Course:
    return tuple(course or ())


def _contact(name: str, law: Interface, sides: Sides) -> tuple[ThermalContact, ...]:
    """A temperature jump; none where the conductance is perfect."""
    match law.conductance:
        case None:
            return ()
        case PressureConductance(open=least, per_pressure=slope, cap=cap):
            return (ThermalContact(name, *sides, least, slope, math.inf if cap is None else cap),)
        case constant:
            return (ThermalContact(name, *sides, constant, 0.0, math.inf),)


def _friction(
    name: str,
    law: Interface,
    given: Sides,
    sides: Mapping[str, Sides],
    effusivity: Mapping[str, float],
) -> tuple[FrictionHeat, ...]:
    """Heat of friction and the slave's share of it: that of its effusivity, unless given."""
    if law.heated_by_friction is None:
        return ()
    master, slave = sides[name]
    match law.heated_by_friction:
        case float(first):
            return (FrictionHeat(name, first if slave == tuple(given[0]) else 1.0 - first),)
        case _:
            e_m, e_s = (sum(effusivity[r] for r in s) / len(s) for s in (master, slave))
            return (FrictionHeat(name, e_s / (e_s + e_m)),)


def _cure(name: str, cure: Cure) -> CureTerm:
    match cure.kinetics:
        case Autocatalytic() as k:
            kinetics: AutocatalyticCure | PrescribedCure = AutocatalyticCure(
                k.rate_constant, k.activation_energy, k.m, k.n, tuple(k.limit or ())
            )
        case Prescribed() as k:
            kinetics = PrescribedCure(tuple(k.rate))
    return CureTerm(
        name,
        kinetics,
        cure.heat,
        cure.initial,
        cure.gel,
        cure.floor,
        cure.exponent,
        cure.shrinkage,
    )


def field(key: str, value: float | str) -> Field:
    """A value or an expression as a function of points (n, 3): shape (n,)."""

    def at(x: Floats) -> Floats:
        if not isinstance(value, str):
            return np.full(len(x), value)
        try:
            return evaluate(value, x)
        except InputError as error:
            raise InputError(f"{key}: {error}") from error

    return at


def _temperature(key: str, value: float | str) -> Field:
    """A temperature at points [K]."""
    given = field(key, value)

    def at(x: Floats) -> Floats:
        result = given(x)
        if np.any(result <= 0.0):
            raise InputError(f"{key}: {value!r} is not above 0 K everywhere; it has to give K")
        return result

    return at
