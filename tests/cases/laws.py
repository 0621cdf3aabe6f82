"""Laws of heat by their values, without units and checks, for scenes."""

from __future__ import annotations

import math
from typing import Any, TypeVar

import numpy as np

from app.foundation.arrays import Floats
from app.laws.cure import Autocatalytic, Cure, Prescribed
from app.laws.fibres import Fibre
from app.laws.heat_conditions import (
    Convection,
    FixedTemperature,
    HeatFlux,
    HeatSource,
    Perfusion,
)
from app.laws.interface_laws import InterfaceLaw
from app.laws.thermal import PressureConductance, Thermal
from app.scene.scene import Interface
from app.schema.section import Section

Law = TypeVar("Law", bound=Section)
# Of given temperatures, fluxes and sources: a number or a function of points (n, 3).
Values = Any


def conductor(
    region: str, conductivities: tuple[float, ...], fibre: Fibre | None, capacity: float, T: float
) -> Thermal:
    keys = ("conductivity",) if len(conductivities) == 1 else ("axial", "transverse")
    keys = tuple(k if k == "conductivity" else f"{k}_conductivity" for k in keys)
    thermal = Thermal.model_construct(density=1.0, specific_heat=capacity, initial_temperature=T)
    return thermal.named(region, fibre=fibre, **dict(zip(keys, conductivities, strict=True)))


def expansion(region: str, coefficient: float, reference: float) -> Thermal:
    keys = {"thermal_expansion": coefficient, "reference_temperature": reference}
    return Thermal.model_construct(**keys).named(region)


def temperature(
    name: str, values: Values, time_course: Any = None, **where: Any
) -> FixedTemperature:
    """A given temperature on a `boundary` or in `regions`."""
    return FixedTemperature.model_construct(
        **where, temperature=values, time_course=time_course
    ).named(name)


def flux(name: str, boundary: str, values: Values, time_course: Any = None) -> HeatFlux:
    return HeatFlux.model_construct(boundary=boundary, flux=values, time_course=time_course).named(
        name
    )


def source(name: str, regions: tuple[str, ...], values: Values) -> HeatSource:
    return HeatSource.model_construct(regions=regions, density=values).named(name)


def convection(name: str, boundary: str, coefficient: float, ambient: float) -> Convection:
    keys = {"coefficient": coefficient, "ambient": ambient}
    return Convection.model_construct(boundary=boundary, **keys).named(name)


def perfusion(name: str, regions: tuple[str, ...], coefficient: float, T: float) -> Perfusion:
    keys = {"rate": coefficient, "blood_density": 1.0, "blood_specific_heat": 1.0}
    return Perfusion.model_construct(regions=regions, temperature=T, **keys).named(name)


def interface(
    name: str,
    master: tuple[str, ...] = (),
    slave: tuple[str, ...] = (),
    conductances: tuple[float, float, float] = (0.0, 0.0, math.inf),
    slave_share: float = 0.0,
) -> Interface:
    least, slope, cap = conductances
    conductance = PressureConductance.model_construct(open=least, per_pressure=slope, cap=cap)
    law = InterfaceLaw.model_construct(conductance=conductance)
    nowhere = np.zeros_like
    return Interface(name, master, slave, law, 1.0, nowhere, slave_share=slave_share)


def cure(region: str, kinetics: Autocatalytic | Prescribed, initial: float, **more: Any) -> Cure:
    values = {"heat": 155.0, "initial": initial, "kinetics": kinetics, **more}
    return Cure.model_construct(**values).named(region)


def altered(law: Law, **values: Any) -> Law:
    return law.model_copy(update=values)


BALIGA = Autocatalytic.model_construct(
    rate_constant=2.6397e8, activation_energy=62866.0, m=0.98, n=1.064
)


def compliance(E_l: float, E_t: float, ν_l: float, ν_t: float, μ_l: float) -> Floats:
    """Compliance in Mandel's notation by the definition of the constants; the fibre is along z."""
    S = np.zeros((6, 6))
    S[:3, :3] = [
        [1 / E_t, -ν_t / E_t, -ν_l / E_l],
        [-ν_t / E_t, 1 / E_t, -ν_l / E_l],
        [-ν_l / E_l, -ν_l / E_l, 1 / E_l],
    ]
    S[3, 3] = S[4, 4] = 1 / (2 * μ_l)
    S[5, 5] = (1 + ν_t) / E_t
    return S
