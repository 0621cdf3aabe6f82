"""Array types, and unit vectors."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]
# A number, or one for each point.
FloatOrFloats = float | Floats
# Values at points (n, 3).
Field = Callable[[Floats], Floats]
# Numbers of any type, such as those of voxels.
Numbers = NDArray[np.number]


def unit_vectors(vectors: Floats) -> Floats:
    """Vectors (..., 3) over their lengths."""
    return np.asarray(vectors / np.sqrt((vectors**2).sum(axis=-1, keepdims=True)))
