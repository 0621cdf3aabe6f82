"""Symmetric dense matrices. LAPACK and BLAS fill only one triangle; this module mirrors it."""

from __future__ import annotations

import numpy as np

from app.foundation.arrays import Floats

# Rows that are mirrored at once: blocks that fit into a cache.
BLOCK_ROWS = 256


def mirror_upper(S: Floats) -> Floats:
    """Copy the upper triangle of S (n, n) into the lower one, in place; returns S."""
    for a in range(0, len(S), BLOCK_ROWS):
        rows = S[a : a + BLOCK_ROWS, a : a + BLOCK_ROWS]
        rows[:] = np.triu(rows) + np.triu(rows, 1).T
        S[a + BLOCK_ROWS :, a : a + BLOCK_ROWS] = S[a : a + BLOCK_ROWS, a + BLOCK_ROWS :].T
    return S
