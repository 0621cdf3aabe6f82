"""Cure of a region: kinetics, stiffness and shrinkage."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, model_validator

from app.laws.values import OfRegion, OverTime, rising
from app.schema import units
from app.schema.section import ITEMS, Kinds, Pair, Section, fail

RateOverTime = OverTime[
    Annotated[tuple[units.NonNegativeTime, units.NonNegativeNumber], Pair("[300 s, 1]")]
]
DegreeAboveZero = Annotated[float, units.Plain(above=0.0, at_most=1.0)]
LargestDegreeByTemperature = Annotated[
    tuple[Annotated[tuple[units.Temperature, DegreeAboveZero], Pair("[20 degC, 0.8]")], ...],
    ITEMS,
    AfterValidator(rising("temperature")),
]
DegreeBelowOne = Annotated[float, units.Plain(at_least=0.0, below=1.0)]


class Autocatalytic(Section):
    """Rate of cure k0 exp(-Ea/RT) a^m (a_max - a)^n, with temperature T in K."""

    kind: Literal["autocatalytic"] = "autocatalytic"
    rate_constant: units.PositiveRate
    """k0, the rate constant of the reaction."""
    activation_energy: units.ActivationEnergy
    """Ea, the activation energy of the reaction."""
    m: units.NonNegativeNumber
    """Exponent of the degree of cure a."""
    n: units.NonNegativeNumber
    """Exponent of the remaining cure a_max - a."""
    limit: LargestDegreeByTemperature | None = None
    """Pairs of temperature and largest degree of cure a_max, linear in between; 1 by default."""


class Prescribed(Section):
    """Cure at a prescribed rate, independent of temperature."""

    kind: Literal["prescribed"] = "prescribed"
    rate: RateOverTime
    """Pairs of time and rate, linear in between, zero before and after. The rate may have any unit,
    as it is scaled so that cure is complete at the end."""

    @model_validator(mode="after")
    def _check_rate(self) -> Prescribed:
        if len(self.rate) < 2 or not any(rate for _, rate in self.rate):
            fail("has no cure; expected at least two pairs, one with a rate above 0", at=("rate",))
        return self


class Cure(OfRegion):
    """Cure of a region: kinetics, heat, stiffness and shrinkage."""

    kinetics: Annotated[Autocatalytic | Prescribed, Kinds()]
    """Rate of cure."""
    heat: units.HeatDensity
    """Heat released per volume from degree of cure 0 to 1."""
    initial: DegreeBelowOne = 1e-3
    """Degree of cure at the start; autocatalysis needs a value above 0."""
    gel: DegreeBelowOne = 0.85
    """Degree of cure at gelation. From there stiffness grows and strains are kept."""
    floor: Annotated[float, units.Plain(above=0.0, at_most=1.0)] = 0.01
    """Stiffness before gelation over the final stiffness."""
    exponent: units.PositiveNumber = 1.0
    """Exponent p of the relative stiffness floor + (1 - floor) ((a - gel) / (1 - gel))^p."""
    shrinkage: DegreeBelowOne = 0.0
    """Relative loss of volume from gelation to full cure."""

    @model_validator(mode="after")
    def _check_initial_and_gel_degrees(self) -> Cure:
        kinetics = self.kinetics
        if isinstance(kinetics, Autocatalytic):
            if self.initial == 0.0 and kinetics.m > 0.0:
                fail(
                    "with m > 0 a cure cannot start at 0; expected a small degree, e.g. 1e-3",
                    at=("initial",),
                )
            largest = 1.0
            if kinetics.limit is not None:
                largest = max((a for _, a in kinetics.limit), default=1.0)
            for key in ("initial", "gel"):
                if getattr(self, key) > largest:
                    fail(f"is above the largest limit of the kinetics, {largest:g}", at=(key,))
        return self
