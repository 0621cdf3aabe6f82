"""Error against run time: references, orders of convergence, Pareto fronts, from plain numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

# Lowest order of convergence accepted in an extrapolation.
LOWEST_ORDER = 0.5
# Highest order of convergence accepted, unless the caller gives another.
HIGHEST_ORDER = 4.0
# Excess over the highest order that rounding in print hides.
ROUNDED = 0.05
# Text for values whose differences decrease faster than the order of the elements allows.
NOT_CONVERGING = "not yet converging"
# Factor by which the true error must exceed the algebraic one for an effectivity index.
ALGEBRAIC_FACTOR = 10.0
# Factor by which the true error must exceed the uncertainty of the reference.
REFERENCE_FACTOR = 3.0


@dataclass(frozen=True)
class ReferenceValue:
    """Reference value of a quantity.

    Attributes:
        value: The value in the unit of the quantity.
        uncertainty: Its uncertainty in this unit; 0 if it is exact.
        order: Observed order of convergence; None if the value is not extrapolated.
        method: Method by which the value was determined, in words.
    """

    value: float
    uncertainty: float
    order: float | None
    method: str


@dataclass(frozen=True)
class ErrorPoint:
    """Value and error of a quantity in a run.

    Attributes:
        value: The value; None if the run failed or has no such quantity.
        estimate: Error estimated by the run itself, in the unit of the quantity.
        algebraic: Relative error of the linear and nonlinear solution.
        deviation: Distance from the reference, in the unit of the quantity.
        error: Deviation relative to the reference.
        uncertainty: Relative uncertainty of the reference.
    """

    value: float | None
    estimate: float | None = None
    algebraic: float = 0.0
    deviation: float | None = None
    error: float | None = None
    uncertainty: float = 0.0

    @property
    def trusted(self) -> bool:
        """Return True if the error exceeds the uncertainty of the reference."""
        return self.error is not None and self.error > self.uncertainty

    @property
    def bound(self) -> float | None:
        """Error, but at least the uncertainty of the reference; None if unknown."""
        return None if self.error is None else max(self.error, self.uncertainty)

    @property
    def effectivity(self) -> float | None:
        """Effectivity index: estimated over true error; None if one is not known well enough."""
        is_known = self.error is not None and self.error > max(
            ALGEBRAIC_FACTOR * self.algebraic, REFERENCE_FACTOR * self.uncertainty
        )
        if self.estimate is None or not self.deviation or not is_known:
            return None
        return self.estimate / self.deviation


def extrapolate(
    sizes: Sequence[float],
    values: Sequence[float],
    highest: float = HIGHEST_ORDER,
    tolerance: float = 0.0,
) -> ReferenceValue:
    """Return the Richardson extrapolation of the last three values of a refinement.

    The error is assumed as c h^p with the observed order p. The uncertainty is the difference
    between the extrapolated and the finest value. If p is outside the accepted range, the reference
    is the finest value, and its uncertainty is the larger one of the last two differences.

    Args:
        sizes: Mesh sizes, or another number that goes to 0, coarsest first; empty without one.
        values: Quantity at each size; at least two.
        highest: Highest accepted order; above it the values do not converge yet.
        tolerance: Relative error of the values that does not come from the size.
    """
    f, h = list(values[-3:]), list(sizes[-3:])
    last_change, largest_change = abs(f[-1] - f[-2]), float(np.abs(np.diff(f)).max())
    if len(f) < 3 or len(h) < 3:
        return ReferenceValue(f[-1], last_change, None, "finest of two" if len(f) < 3 else "finest")
    order = _observed_order(h, f, highest)
    if order is None or largest_change <= ALGEBRAIC_FACTOR * tolerance * abs(f[-1]):
        return ReferenceValue(f[-1], largest_change, None, "finest, no clear order")
    if math.isinf(order):
        return ReferenceValue(f[-1], largest_change, None, NOT_CONVERGING)
    correction = (f[2] - f[1]) * h[2] ** order / (h[1] ** order - h[2] ** order)
    return ReferenceValue(f[2] + correction, abs(correction), order, "extrapolated")


def _observed_order(h: Sequence[float], f: Sequence[float], highest: float) -> float | None:
    """Return the order p with (f0 - f1) / (f1 - f2) = (h0^p - h1^p) / (h1^p - h2^p).

    Infinite if it is above the highest order, None if it is below the lowest.
    """
    if f[0] == f[1] or not h[0] > h[1] > h[2] > 0:
        return None
    ratio = (f[0] - f[1]) / (f[1] - f[2]) if f[1] != f[2] else math.inf

    def excess(p: float) -> float:
        return (h[0] ** p - h[1] ** p) / (h[1] ** p - h[2] ** p) - ratio

    if excess(LOWEST_ORDER) > 0:  # the excess grows with p
        return None
    if excess(highest + ROUNDED) < 0:
        return math.inf
    return float(brentq(excess, LOWEST_ORDER, highest + ROUNDED))


def compare(point: ErrorPoint, reference: ReferenceValue | None) -> ErrorPoint:
    """Return a point with its deviation from the reference and its error."""
    if reference is None or point.value is None or reference.value == 0.0:
        return point
    deviation = abs(point.value - reference.value)
    return replace(
        point,
        deviation=deviation,
        error=deviation / abs(reference.value),
        uncertainty=reference.uncertainty / abs(reference.value),
    )


def exponent(numbers: Sequence[float | None], points: Sequence[ErrorPoint]) -> float | None:
    """Return the exponent p of error ~ x^p, by least squares in logarithms; None if undetermined.

    Points that are not trusted, and errors within the tolerance of the solution, are left out.
    """
    pairs = [
        (x, p.error)
        for x, p in zip(numbers, points, strict=True)
        if p.trusted and x and x > 0 and p.error and p.error > ALGEBRAIC_FACTOR * p.algebraic
    ]
    if len({x for x, _ in pairs}) < 2:
        return None
    return fitted_order(*zip(*pairs, strict=True))


def fitted_order(sizes: Sequence[float], errors: Sequence[float]) -> float:
    """Return the slope of log |error| over log size by least squares."""
    return float(np.polyfit(np.log(sizes), np.log(np.abs(errors)), 1)[0])


def pareto(costs: Sequence[float | None], errors: Sequence[float | None]) -> list[int]:
    """Return indices of the points that no other point beats in time and error, fastest first."""
    front: list[tuple[float, int]] = []
    for _, error, i in sorted(
        (cost, error, i)
        for i, (cost, error) in enumerate(zip(costs, errors, strict=True))
        if cost is not None and error is not None
    ):
        if not front or error < front[-1][0]:
            front.append((error, i))
    return [i for _, i in front]


def index_of_best(
    costs: Sequence[float | None], errors: Sequence[float | None], target: float
) -> int | None:
    """Return the index of the fastest point within the target, else of the point nearest to it.

    None if no point has a known error.
    """
    front = pareto(costs, errors)
    within_target = [i for i in front if (errors[i] or 0.0) <= target]
    return next(iter(within_target + front[-1:]), None)
