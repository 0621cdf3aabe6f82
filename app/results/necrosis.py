"""Heat doses of bone from its temperature over time, and necrosis by several criteria.

All criteria are reported, because they disagree. Between 47 and 50 degC Henriques-Moritz, which was
measured on skin, allows a hundred times longer exposure than the rule for bone.

Within a step the temperature is linear in time. The doses of this linear temperature are exact,
with a relative error of 1e-12, for steps of any length.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from app.case.summary import TEMPERATURE_LEVELS
from app.foundation.arrays import Floats
from app.results.over_time import Measure

# Temperature at 0 degC [K].
CELSIUS = 273.15
# Bone dies after a minute at 47 degC (Eriksson & Albrektsson 1983, J Prosthet Dent 50). The minute
# may be the sum of several exposures: bone does not recover between them.
MINUTE = 60.0
# Sapareto & Dewey 1984, doi:10.1016/0360-3016(84)90379-1: equivalent minutes at 43 degC. One degree
# more halves the time above 43 degC and divides it by four below. Below 39 degC there is no dose.
CEM43_THRESHOLDS = (16, 60, 240)
# Lowest temperature with a dose [degC].
COUNTS_FROM = 39.0
_PIECES = ((COUNTS_FROM, 43.0, np.log(4.0)), (43.0, np.inf, np.log(2.0)))
# Henriques 1947, Moritz & Henriques 1947: rate of the damage integral, which is irreversible at 1.
# Frequency factor [1/s].
FREQUENCY = 3.1e98
# Activation energy over the gas constant [K].
ACTIVATION = 6.28e5 / 8.314462618
# Change of temperature [K] below which three points replace the difference of antiderivatives,
# which would lose digits.
_SHORT = 0.1
# Fraction of a lethal dose below which a dose counts as zero.
_LEAST = 1e-4
_GAUSS = np.polynomial.legendre.leggauss(3)


def seconds_over(start: Floats, end: Floats, seconds: float, level: float) -> Floats:
    """Return the time (n,) [s] of a step at or above a level.

    Args:
        start: Temperatures at the start (n,) [K]. Within the step they are linear in time.
        end: Temperatures at the end (n,) [K].
        seconds: Duration of the step [s].
        level: The level [degC].
    """
    low_excess = np.minimum(start, end) - CELSIUS - level
    high_excess = np.maximum(start, end) - CELSIUS - level
    fraction = np.divide(
        high_excess,
        high_excess - low_excess,
        out=(high_excess >= 0).astype(float),
        where=high_excess > low_excess,
    )
    return np.asarray(seconds * np.clip(fraction, 0.0, 1.0))


def cem43(start: Floats, end: Floats, seconds: float) -> Floats:
    r"""Equivalent minutes at 43 degC, :math:`∫ R^{43 - T} dt`; arguments as `seconds_over`."""
    lowest = np.minimum(start, end) - CELSIUS
    highest = np.maximum(start, end) - CELSIUS
    total = np.zeros_like(lowest)
    for piece_start, piece_end, slope in _PIECES:
        a, b = np.clip(lowest, piece_start, piece_end), np.clip(highest, piece_start, piece_end)
        # Fraction of the step in this piece, and the mean of exp(slope (T - 43)) over it.
        fraction = np.divide(b - a, highest - lowest, out=np.zeros_like(a), where=highest > lowest)
        is_constant = (highest == lowest) & (lowest >= piece_start) & (lowest < piece_end)
        span = slope * (b - a)
        mean = np.divide(-np.expm1(-span), span, out=np.ones_like(span), where=span > 0)
        total += np.where(is_constant, 1.0, fraction) * np.exp(slope * (b - 43.0)) * mean
    return np.asarray(total * seconds / 60.0)


def henriques_moritz(start: Floats, end: Floats, seconds: float) -> Floats:
    r"""Return the damage integral :math:`Ω = ∫ A \exp(-E/RT) dt`; arguments as `seconds_over`.

    With :math:`B = E/R` and the exponential integral :math:`E_2` of order 2,
    :math:`∫ \exp(-B/T) dT = T E_2(B/T)`.
    """
    change = end - start
    is_short = np.abs(change) < _SHORT
    width = np.where(is_short, 1.0, change)
    exact = (_antiderivative(end) - _antiderivative(start)) / width
    middle, half = (start + end) / 2, change / 2
    integral_near = sum(
        w / 2 * _rate(middle + p * np.where(is_short, half, 0.0))
        for p, w in zip(*_GAUSS, strict=True)
    )
    return np.asarray(seconds * np.where(is_short, integral_near, exact))


def _rate(temperature: Floats) -> Floats:
    # Both factors in one exponent, because they are about 1e98 and 1e-105.
    return np.asarray(np.exp(np.log(FREQUENCY) - ACTIVATION / temperature))


def _antiderivative(temperature: Floats) -> Floats:
    from scipy.special import expn  # takes 0.1 s; most runs do not need it

    x = ACTIVATION / temperature
    return np.asarray(FREQUENCY * temperature * expn(2, x))


# Integrals over time in bone and cement: seconds at or above each of `TEMPERATURE_LEVELS`,
# equivalent minutes at 43 degC, and the damage integral.
DOSES: dict[str, Measure] = {
    **{f"seconds_over_{level}": partial(seconds_over, level=level) for level in TEMPERATURE_LEVELS},
    "cem43": cem43,
    "henriques_moritz": henriques_moritz,
}


def death_levels(doses: Mapping[str, Floats]) -> dict[str, Floats]:
    """Return the level of each criterion (n,) from the doses `DOSES`; at least 0 at dead nodes.

    The level of a criterion on time is linear in time. The level of equivalent minutes and of the
    damage integral, which grow exponentially with temperature, is linear in their logarithm.
    """
    lethal = {f"cem43_{minutes}": doses["cem43"] / minutes for minutes in CEM43_THRESHOLDS}
    lethal["henriques_moritz"] = doses["henriques_moritz"]
    levels = {"47C_1min": np.asarray(doses["seconds_over_47"] / MINUTE - 1)}
    for name, dose in lethal.items():
        levels[name] = np.log(np.maximum(dose, _LEAST))
    return levels
