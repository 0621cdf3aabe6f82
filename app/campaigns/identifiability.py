"""Uncertainty of fitted keys, and combinations of keys that the data do not determine.

J (numbers, keys) are the derivatives of the numbers by the keys, in standard uncertainties of the
targets per range of the key. The covariance of the fitted keys is (J^T J)^-1. With the singular
value decomposition J = U S V^T, the standard uncertainty of the keys along a direction of V is
1 / s of their ranges.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.foundation.arrays import Floats

# Standard deviation of a uniform distribution over a range, as a fraction of the range.
KNOWN_RANGE = 1 / math.sqrt(12)
# Component of a direction above which the key belongs to the direction.
LEAST_COMPONENT = 0.3
# Rounding of singular values relative to the largest, and of components of directions.
ROUNDING_OF_SENSITIVITIES = 1e-9


@dataclass(frozen=True)
class Identifiability:
    """Uncertainty of the keys from the data.

    Attributes:
        singular_values: Singular values of the derivatives, largest first (keys,) [-].
        directions: Right singular vectors, a row for each singular value (keys, keys).
        uncertainties: Standard uncertainty of each key as a fraction of its range (keys,);
            infinite if the data do not determine it.
        covariance: Covariance of the keys as fractions of their ranges (keys, keys), without the
            directions that the data do not determine.
        correlation: Correlation of the keys (keys, keys); nan if an uncertainty is infinite.
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
        """Return the directions that the data determine no better than the ranges of the keys.

        Each has its components by number of the key.
        """
        weak = []
        for i in np.flatnonzero(self.singular_values * KNOWN_RANGE < 1.0):
            components = [float(v) for v in self.directions[i]]
            weak.append({k: v for k, v in enumerate(components) if abs(v) > LEAST_COMPONENT})
        return weak


def identify(derivatives: Floats) -> Identifiability:
    """Return the uncertainty of keys from J (numbers, keys), as in the docstring of the module."""
    keys = derivatives.shape[1]
    _, sizes, directions = np.linalg.svd(derivatives, full_matrices=True)
    sizes = np.append(sizes, np.zeros(keys - len(sizes)))
    sizes[sizes < ROUNDING_OF_SENSITIVITIES * sizes[0]] = 0.0
    covariance = np.zeros((keys, keys))
    for size, direction in zip(sizes, directions, strict=True):
        if size:
            covariance += np.outer(direction, direction) / size**2
    is_unknown = (
        np.abs(directions[sizes == 0.0]).max(axis=0, initial=0.0) > ROUNDING_OF_SENSITIVITIES
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        deviations = np.sqrt(np.diag(covariance))
        correlation = covariance / np.outer(deviations, deviations)
    correlation[is_unknown] = np.nan
    correlation[:, is_unknown] = np.nan
    return Identifiability(
        singular_values=sizes,
        directions=directions,
        uncertainties=np.where(is_unknown, np.inf, deviations),
        covariance=covariance,
        correlation=correlation,
        influence=np.linalg.norm(derivatives, axis=0),
    )


def direction_in_words(direction: dict[int, float], names: Sequence[str]) -> str:
    """Name the keys of a direction: ``a and b`` if they increase together, else ``a against b``."""
    first_component = next(iter(direction.values()))
    with_first = [names[k] for k, v in direction.items() if v * first_component > 0]
    against = [names[k] for k, v in direction.items() if v * first_component < 0]
    combination = " and ".join(with_first)
    return f"{combination} against {' and '.join(against)}" if against else combination
