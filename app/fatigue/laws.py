"""Failure of a material: at its largest flaw (Weibull), or by cycles of load (S-N laws, Miner)."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator

from app.case.case import Case
from app.foundation.arrays import Floats
from app.laws.values import MEMORY, Source
from app.schema.section import MAPPING, Kinds, Name, Pair, Section, fail
from app.schema.units import (
    Dimension,
    Length,
    Number,
    Plain,
    PositiveLength,
    PositiveNumber,
)

SOME = AfterValidator(lambda entries: entries or fail("is empty; expected at least one"))
Strength = Annotated[float, Dimension("MPa", "a stress", "26 MPa", at_least=0.0)]
Endured = Annotated[float, Dimension("MPa", "a stress", "38 MPa", above=0.0)]
Fall = Annotated[float, Dimension("MPa", "a stress", "5 MPa", above=0.0)]
Ultimate = Annotated[float, Dimension("MPa", "a stress", "900 MPa", above=0.0)]
Volume = Annotated[float, Dimension("mm^3", "a volume", "1000 mm^3", above=0.0)]


class Weibull(Section):
    """Strength of specimens: three parameters, and the volume to which they refer."""

    shape: PositiveNumber
    """Exponent m."""
    scale: Endured
    """Stress s_0 above the threshold."""
    threshold: Strength = 0.0
    """Stress s_u below which nothing fails."""
    reference_volume: Volume
    """Volume V_0 under tension in the specimens."""

    def risk(self, tension: Floats) -> Floats:
        """Risk per volume [1/mm3] under principal tensions [MPa]."""
        above = tension - self.threshold
        excess = np.asarray(above * (above > 0), dtype=np.float64)
        return np.asarray((excess / self.scale) ** self.shape / self.reference_volume)


_RISING = AfterValidator(
    lambda ends: ends if ends[0] < ends[1] else fail("its second stress is not above the first")
)
Measured = Annotated[tuple[Strength, Strength], Pair("[7 MPa, 25 MPa]"), _RISING]


class FatigueLaw(Section):
    """Base of the S-N laws: cycles N to failure, by the largest stress s of a cycle."""

    ratio: Annotated[float, Plain(at_least=0.0, below=1.0)] = 0.0
    """Stress ratio of the test: smallest over largest stress of a cycle."""
    measured: Measured | None = None
    """Stresses between which it was measured."""
    deviation: Strength = 0.0
    """Standard deviation of the stress that specimens endure for a given number of cycles
    (`stem_test`)."""
    source: Source = None
    """Source of the law."""

    def damage(self, s: Floats) -> Floats:
        """Damage 1/N of a cycle with a largest stress s, not negative [MPa]."""
        raise NotImplementedError

    def endured(self, cycles: float) -> float:
        """Largest stress s of a number of cycles to failure [MPa]: the inverse of `damage`."""
        raise NotImplementedError


class Power(FatigueLaw):
    """A line over the logarithms of both: log10 N = intercept - slope log10 (s / MPa)."""

    kind: Literal["power"] = "power"
    intercept: Number
    """log10 N at 1 MPa."""
    slope: PositiveNumber
    """Decrease of log10 N when s grows tenfold."""

    def damage(self, s: Floats) -> Floats:
        """Damage 1/N of a cycle with a largest stress s, not negative [MPa]."""
        return np.asarray(s**self.slope / 10.0**self.intercept)

    def endured(self, cycles: float) -> float:
        """Largest stress s of a number of cycles to failure [MPa]."""
        return float(10.0 ** ((self.intercept - np.log10(cycles)) / self.slope))


class Logarithmic(FatigueLaw):
    """A line over the logarithm of N: s = strength - fall log10 N; no tension does no damage."""

    kind: Literal["logarithmic"] = "logarithmic"
    strength: Endured
    """Stress at which one cycle causes failure."""
    fall: Fall
    """Decrease of the stress when N grows tenfold."""

    def damage(self, s: Floats) -> Floats:
        """Damage 1/N of a cycle with a largest stress s, not negative [MPa]."""
        return 10.0 ** ((s - self.strength) / self.fall) * (s > 0)

    def endured(self, cycles: float) -> float:
        """Largest stress s of a number of cycles to failure [MPa]."""
        return float(self.strength - self.fall * np.log10(cycles))


class Verdonschot(Power):
    """Bone cement: Verdonschot and Huiskes 1997, from memory: check."""

    kind: Literal["verdonschot_1997"] = "verdonschot_1997"  # type: ignore[assignment]
    intercept: Number = 8.77
    slope: PositiveNumber = 4.68
    source: Source = f"Verdonschot and Huiskes 1997, {MEMORY}"


class Murphy(Logarithmic):
    """Bone cement mixed by hand: Murphy and Prendergast 2000, from memory: check."""

    kind: Literal["murphy_2000"] = "murphy_2000"  # type: ignore[assignment]
    strength: Endured = 37.8
    fall: Fall = 4.736
    ratio: Annotated[float, Plain(at_least=0.0, below=1.0)] = 0.1
    source: Source = f"Murphy and Prendergast 2000, {MEMORY}"


class Okazaki(Logarithmic):
    """Hot-forged stems of Ti-15Zr-4Nb: Okazaki and others 2021.

    Specimens that were cut from stems have a tensile strength of 983 MPa, and 855 +- 14 MPa after
    10^7 cycles. The line through both, with the first at one cycle, is an assumption; so is the
    ratio of 0.1, which the abstract does not give.
    """

    kind: Literal["okazaki_2021"] = "okazaki_2021"  # type: ignore[assignment]
    strength: Endured = 983.0
    fall: Fall = 18.3
    ratio: Annotated[float, Plain(at_least=0.0, below=1.0)] = 0.1
    deviation: Strength = 14.0
    source: Source = "Okazaki and others 2021, Materials 14:732, abstract"


AnyLaw = Annotated[
    Power | Logarithmic | Verdonschot | Murphy | Okazaki,
    Kinds("power"),
]


class Fatigue(Section):
    """Damage that a spectrum of activities does to a region in a year, by Miner's rule."""

    region: Name = "cement"
    """Region whose damage is summed."""
    spectrum: Annotated[dict[Name, PositiveNumber], MAPPING, SOME]
    """Cycles a year of each stage that is an activity. Its peak is the end of the stage, its valley
    the last valley before, or the start of a stage without `cycles`."""
    laws: Annotated[dict[Name, AnyLaw], MAPPING, SOME]
    """S-N laws side by side, by name; life is reported as the band over all of them."""
    goodman: Ultimate | None = None
    """Strength at which Goodman's line ends; without it the mean stress does not count."""

    def equivalent(
        self, law: FatigueLaw, largest_tension: Floats, smallest_tension: Floats
    ) -> Floats:
        r"""Largest stress s of the law's cycle that causes the same damage as a given cycle [MPa].

        Both cycles have the same amplitude where Goodman's line takes them to no mean stress,

        .. math:: \frac{s (1 - R) / 2}{1 - s (1 + R) / 2 S} = \frac{a}{1 - m / S}

        with R the ratio of the law, a amplitude and m mean of the cycle and S the strength. Without
        Goodman's rule S is infinite, and s (1 - R) is the range. ``largest_tension`` and
        ``smallest_tension`` of the given cycle are not negative [MPa].
        """
        strength = self.goodman or float("inf")
        goodman_factor = 1.0 - (largest_tension + smallest_tension) / 2 / strength
        range_ = largest_tension - smallest_tension
        denominator = (1.0 - law.ratio) * (goodman_factor * (goodman_factor > 0))
        denominator += range_ * (1.0 + law.ratio) / 2 / strength
        return np.asarray(range_ / (denominator + (denominator == 0)))


class StemTest(Section):
    """Bench test of a stem that is potted in resin (ISO 7206-4 and -6): stress and life."""

    region: Name = "stem"
    """Region of the stem."""
    level: Length | None = None
    """Height z of the surface of the resin; by default that of the neck cut (`resection`)."""
    band: PositiveLength = 5.0
    """Height above the resin within which stress is fitted."""
    head: Name = "stem_trunnion"
    """Boundary that carries the head: it has the load, whose `at` is the centre of the head."""
    cycles: PositiveNumber = 5e6
    """Number of cycles of the test."""
    ratio: Annotated[float, Plain(at_least=0.0, below=1.0)] = 300 / 2300
    """Smallest over largest force of a cycle."""
    law: AnyLaw
    """S-N law of the stem's material and surface."""

    def stress(self, largest: float) -> float:
        """Stress of the law's cycles with the same range as those of the test [MPa]."""
        return largest * (1.0 - self.ratio) / (1.0 - self.law.ratio)

    def life(self, largest: float, deviate: float = 0.0) -> float:
        """Cycles to failure of a stem whose strength is some deviations off the mean.

        Args:
            largest: Largest stress of a cycle [MPa].
            deviate: Strength of the stem less the mean, over the standard deviation.
        """
        s = np.asarray(self.stress(largest) - deviate * self.law.deviation)
        tiny = np.finfo(float).tiny
        return 1.0 / max(float(self.law.damage(np.maximum(s, tiny))), tiny)

    def failing(self, largest: float) -> float:
        """Fraction of the stems that fail within the cycles of the test."""
        margin = self.law.endured(self.cycles) - self.stress(largest)
        if self.law.deviation == 0.0:
            return float(margin < 0.0)
        return 0.5 * math.erfc(margin / self.law.deviation / math.sqrt(2.0))


def stem_test_of(case: Case) -> StemTest | None:
    """The section `stem_test` of a case."""
    return case.added("stem_test", StemTest)


def level_of(case: Case) -> float | None:
    """Height of the surface of the resin [mm]; None if the case does not say it."""
    test = stem_test_of(case)
    assert test
    return case.geometry.medial_cut_height if test.level is None else test.level


def fatigue_of(case: Case) -> Fatigue | None:
    """The section `fatigue` of a case."""
    return case.added("fatigue", Fatigue)


def weibull_of(case: Case) -> dict[str, Weibull]:
    """Strengths by name of the regions that have one."""
    strengths = {name: r.added("weibull", Weibull) for name, r in case.regions.items()}
    return {name: law for name, law in strengths.items() if law is not None}
