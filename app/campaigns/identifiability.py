"""Uncertainty of fitted keys, and directions of keys that data do not determine.

J (numbers, keys) are the derivatives of the numbers by the keys, in standard uncertainties of the
targets by ranges of the keys. The covariance of the fitted keys is (J^T J)^-1. By the singular
value decomposition J = U S V^T, keys are known in a direction of V to 1 / s of their ranges.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.foundation.arrays import Floats

# Standard deviation of a value of which only its range is known, as a fraction of the range.
KNOWN_RANGE = 1 / math.sqrt(12)
# Smallest component of a direction by which a key takes part in it.
LEAST_COMPONENT = 0.3
# Singular values relative to the largest, and components of directions, that are rounding.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Identifiability:
    """Knowledge of the keys from the data.

    Attributes:
        singular_values: Of the derivatives, one for each key, largest first [-].
        directions: Right singular vectors, a row for each singular value (keys, keys).
        uncertainties: Standard uncertainty of each key as a fraction of its range (keys,);
            infinite if the data do not determine it.
        covariance: Covariance of the keys as fractions of their ranges (keys, keys), without the
            directions that the data do not determine.
        correlation: Correlation of the keys (keys, keys); nan with keys of infinite uncertainty.
        influence: Change of all numbers over the range of each key, in standard uncertainties
            (keys,).
    """

    singular_values: Floats
    directions: Floats
    uncertainties: Floats
    covariance: Floats
    correlation: Floats
    influence: Floats

    def undetermined(self) -> list[dict[int, float]]:
        """Directions known no better than by the ranges: components by number of the key."""
        weak = []
        for i in np.flatnonzero(self.singular_values * KNOWN_RANGE < 1.0):
            parts = [float(v) for v in self.directions[i]]
            weak.append({k: v for k, v in enumerate(parts) if abs(v) > LEAST_COMPONENT})
        return weak


def identify(derivatives: Floats) -> Identifiability:
    """Knowledge of keys from derivatives (numbers, keys) in uncertainties by ranges."""
    keys = derivatives.shape[1]
    _, sizes, directions = np.linalg.svd(derivatives, full_matrices=True)
    sizes = np.append(sizes, np.zeros(keys - len(sizes)))
    sizes[sizes < ROUNDING * sizes[0]] = 0.0
    covariance = np.zeros((keys, keys))
    for size, direction in zip(sizes, directions, strict=True):
        if size:
            covariance += np.outer(direction, direction) / size**2
    unknown = np.abs(directions[sizes == 0.0]).max(axis=0, initial=0.0) > ROUNDING
    with np.errstate(invalid="ignore", divide="ignore"):
        deviations = np.sqrt(np.diag(covariance))
        correlation = covariance / np.outer(deviations, deviations)
    correlation[unknown] = np.nan
    correlation[:, unknown] = np.nan
    return Identifiability(
        singular_values=sizes,
        directions=directions,
        uncertainties=np.where(unknown, np.inf, deviations),
        covariance=covariance,
        correlation=correlation,
        influence=np.linalg.norm(derivatives, axis=0),
    )


def in_words(direction: dict[int, float], names: Sequence[str]) -> str:
    """Return keys of a direction that change together: ``a and b``, or ``a against b``."""
    first = next(iter(direction.values()))
    with_first = [names[k] for k, v in direction.items() if v * first > 0]
    against = [names[k] for k, v in direction.items() if v * first < 0]
    words = " and ".join(with_first)
    return f"{words} against {' and '.join(against)}" if against else words
