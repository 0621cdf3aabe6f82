"""Heat doses of bone from its temperature in time, and necrosis by several criteria.

The criteria are reported side by side because they disagree: between 47 and 50 degC
Henriques-Moritz, measured on skin, allows a hundred times longer than the bone rule.

Within a step the temperature is taken as linear in time. The doses of that line are exact, to a
relative 1e-12, for steps of any length.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from app.foundation.arrays import Floats
from app.results.over_time import Measure

CELSIUS = 273.15  # K at 0 degC
# Temperatures above which time and volume are reported [degC].
LEVELS = (47.0, 50.0, 56.0)
# Bone dies after a minute at 47 degC (Eriksson & Albrektsson 1983, J Prosthet Dent 50). The minute
# may be made of parts: exposure is cumulative, bone does not recover in between.
MINUTE = 60.0
# Sapareto & Dewey 1984, doi:10.1016/0360-3016(84)90379-1: equivalent minutes at 43 degC; one degree
# more is half the time above 43 degC, a quarter below, and nothing counts below 39 degC.
CEM43_THRESHOLDS = (16, 60, 240)
COUNTS_FROM = 39.0  # degC
_PIECES = ((COUNTS_FROM, 43.0, np.log(4.0)), (43.0, np.inf, np.log(2.0)))
# Henriques 1947, Moritz & Henriques 1947: rate of the damage integral, which is irreversible at 1.
FREQUENCY = 3.1e98  # 1/s
ACTIVATION = 6.28e5 / 8.314462618  # K
# Below this change [K] the difference of antiderivatives loses digits; three points do not.
_SHORT = 0.1
# Doses below this part of a lethal one count as none.
_LEAST = 1e-4
_GAUSS = np.polynomial.legendre.leggauss(3)


def seconds_over(start: Floats, end: Floats, seconds: float, level: float) -> Floats:
    """Seconds of a step in which temperatures [K], linear in time, reach a level [degC] (n,)."""
    low, high = np.minimum(start, end) - CELSIUS - level, np.maximum(start, end) - CELSIUS - level
    share = np.divide(high, high - low, out=(high >= 0).astype(float), where=high > low)
    return np.asarray(seconds * np.clip(share, 0.0, 1.0))


def cem43(start: Floats, end: Floats, seconds: float) -> Floats:
    r"""Cumulative equivalent minutes at 43 degC, :math:`∫ R^{43 - T} dt`, as `seconds_over`."""
    low = np.minimum(start, end) - CELSIUS
    high = np.maximum(start, end) - CELSIUS
    total = np.zeros_like(low)
    for begin, stop, slope in _PIECES:
        a, b = np.clip(low, begin, stop), np.clip(high, begin, stop)
        # The part of the step spent in the piece, and the mean of exp(slope (T - 43)) over it.
        share = np.divide(b - a, high - low, out=np.zeros_like(a), where=high > low)
        still = (high == low) & (low >= begin) & (low < stop)
        span = slope * (b - a)
        mean = np.divide(-np.expm1(-span), span, out=np.ones_like(span), where=span > 0)
        total += np.where(still, 1.0, share) * np.exp(slope * (b - 43.0)) * mean
    return np.asarray(total * seconds / 60.0)


def henriques_moritz(start: Floats, end: Floats, seconds: float) -> Floats:
    r"""Damage integral :math:`Ω = ∫ A \exp(-E/RT) dt`, arguments as `seconds_over`.

    With :math:`B = E/R`, :math:`∫ \exp(-B/T) dT = T E_2(B/T)`, the exponential integral of order 2.
    """
    change = end - start
    short = np.abs(change) < _SHORT
    width = np.where(short, 1.0, change)
    exact = (_antiderivative(end) - _antiderivative(start)) / width
    middle, half = (start + end) / 2, change / 2
    integral_near = sum(
        w / 2 * _rate(middle + p * np.where(short, half, 0.0)) for p, w in zip(*_GAUSS, strict=True)
    )
    return np.asarray(seconds * np.where(short, integral_near, exact))


def _rate(temperature: Floats) -> Floats:
    # One exponent: A alone is 1e98 and its partner 1e-105.
    return np.asarray(np.exp(np.log(FREQUENCY) - ACTIVATION / temperature))


def _antiderivative(temperature: Floats) -> Floats:
    from scipy.special import expn  # 0.1 s, which most runs do without

    x = ACTIVATION / temperature
    return np.asarray(FREQUENCY * temperature * expn(2, x))


# Integrals over time that are kept of bone and cement: seconds at or above each of `LEVELS`,
# equivalent minutes at 43 degC, the damage integral.
DOSES: dict[str, Measure] = {
    **{f"seconds_over_{level:g}": partial(seconds_over, level=level) for level in LEVELS},
    "cem43": cem43,
    "henriques_moritz": henriques_moritz,
}


def death_levels(doses: Mapping[str, Floats]) -> dict[str, Floats]:
    """Level of each criterion (n,) by its name, from `DOSES`; not negative where nodes are dead.

    It is linear in time for criteria in time, and in temperature where equivalent minutes and
    damage are exponentials of it.
    """
    lethal = {f"cem43_{minutes}": doses["cem43"] / minutes for minutes in CEM43_THRESHOLDS}
    lethal["henriques_moritz"] = doses["henriques_moritz"]
    levels = {"47C_1min": np.asarray(doses["seconds_over_47"] / MINUTE - 1)}
    for name, dose in lethal.items():
        levels[name] = np.log(np.maximum(dose, _LEAST))
    return levels
