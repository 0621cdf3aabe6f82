"""Heat at one state: the nodal values that residual, Jacobian and reports share."""

from __future__ import annotations

from dataclasses import dataclass, field

from app.arrays import Floats


@dataclass(frozen=True)
class HeatEvaluation:
    """Nodal values of one state, shared by its residual, Jacobian and reports.

    Attributes:
        given: The state, and pressures and heat of friction, which are set from outside.
        T: Temperature of own nodes of each body [K].
        lacking: Heat that they lack, interfaces left out [N mm/s].
        parts: What that is made of, conduction left out.
        flux: Heat through own points by area, and its derivatives (`TemperatureJumps.flux`).
        sizes: Norm of the parts and what rounding leaves of them, once they were asked for.
    """

    given: list[Floats]
    T: list[Floats]
    lacking: list[Floats]
    parts: list[Floats]
    flux: list[tuple[Floats, Floats, Floats]]
    sizes: list[tuple[float, float]] = field(default_factory=list)
