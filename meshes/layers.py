"""Lines across the layers of a femur, and nodes along them.

A node has three coordinates: `phi` around and `s` along the line, in half steps, and `rho` across.
Whole values of `rho` are surfaces: 1 the stem or whatever is innermost, 2 the outer side of the
mantle, 3 the endosteum, 4 the periosteum; 0 stands for the nodes inside the innermost surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints

DIGITS = 6  # decimals [mm] that nodes are rounded to: processors differ far behind these


@dataclass(frozen=True)
class Lines:
    """Straight lines across the layers, one for each pair (phi, s).

    Attributes:
        start: Points on the innermost surface (n, 3) [mm].
        end: Points on the periosteum (n, 3) [mm].
        mantle: Outer side of the mantle, as a fraction of the way from start to end (n,); may lie
            beyond the endosteum.
        endosteum: Endosteum, as a fraction of the way (n,).
    """

    start: Floats
    end: Floats
    mantle: Floats
    endosteum: Floats

    @property
    def gap(self) -> Floats:
        """Thickness left between mantle and endosteum [mm], negative if there is none; (n,)."""
        return (self.endosteum - self.mantle) * self.length

    @property
    def length(self) -> Floats:
        """Length of the lines [mm]; (n,)."""
        return np.sqrt(((self.end - self.start) ** 2).sum(axis=1))


@dataclass(frozen=True)
class Nodes:
    """Nodes by their coordinates; all arrays have shape (n,) unless stated.

    Attributes:
        phi: Around, in half steps.
        rho: Across; 0 for nodes on no line: inside the innermost surface, or in a ball. Negative in
            the shell of a ball.
        s: Along, in half steps.
        merged: Whether mantle and endosteum are one there.
        error: Used thickness of the layer between them less the exact one [mm].
        floor: Least thickness of that layer [mm].
        x: Positions (n, 3) [mm].
    """

    phi: Ints
    rho: Floats
    s: Ints
    merged: Bools
    error: Floats
    floor: Floats
    x: Floats

    def __len__(self) -> int:
        """Number of nodes."""
        return len(self.phi)
