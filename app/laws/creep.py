"""Creep of a region, by strain hardening."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import model_validator

from app.laws.values import OfRegion
from app.schema import units
from app.schema.section import Pair, fail

Range = Annotated[tuple[units.PositiveStress, units.PositiveStress], Pair("[3 MPa, 11 MPa]")]


class Creep(OfRegion):
    """Norton-Bailey's law: strain A s^p N^m after N cycles or units of time at a stress s.

    s is the von Mises stress in MPa; for cyclic loads, its peak. The volume is constant. If the
    stress changes, the rate follows from stress and strain (strain hardening), not from time.
    """

    A: units.PositiveNumber
    """Creep strain at 1 MPa after one cycle or one unit of time."""
    p: Annotated[float, units.Plain(at_least=1.0)]
    """Exponent of the stress."""
    m0: Annotated[float, units.Plain(above=0.0, at_most=1.0)]
    """Exponent m of cycles or time, at 1 MPa."""
    m1: units.Number = 0.0
    """Increase of m with the stress: m = m0 + m1 log10(s / MPa)."""
    per: units.PositiveTime | None = None
    """Unit of time of N, such as `1 hour`; N counts cycles by default."""
    stresses: Range | None = None
    """Smallest and largest stress of the measurements, required with `m1`. Stresses outside of this
    range are reported."""

    @model_validator(mode="after")
    def _hardens(self) -> Creep:
        if self.m1 and self.stresses is None:
            fail(
                "'stresses' is missing, required with m1; expected the range of stresses "
                "in which m was measured"
            )
        for s in self.stresses or ():
            m = self.m0 + self.m1 * math.log10(s)
            if not 0.0 < m <= 1.0:
                fail(f"the exponent m is {m:.3g} at {s:g} MPa; expected 0 < m <= 1", at=("m1",))
        if self.stresses and self.stresses[0] >= self.stresses[1]:
            fail("its first stress is not below the second", at=("stresses",))
        return self
