"""Sections of a femur, lines across its layers in them, and nodes along the lines.

Sections are planes z = zeta - slope(zeta) (x + lean y) of the stem's axes. They are level along the
stem and turn over the last `TURN_LENGTH` millimetres to the neck cut.

A node has three coordinates: `phi` around and `s` along the line, in half steps, and `rho` across.
Whole values of `rho` are surfaces: 1 the innermost one (the stem, if there is one), 2 the outer
side of the cement mantle, 3 the endosteum, 4 the periosteum. Nodes inside the innermost surface
have 0. Without cement the stem is surface 2, and there is no surface 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize.elementwise import find_root

from app.foundation.arrays import Bools, Floats, Ints
from meshes.placement import Placement

DIGITS_OF_NODES = 6  # decimals [mm] that nodes are rounded to: processors differ far behind these

TURN_LENGTH = 60.0  # mm below the neck cut, or the shoulder, over which sections turn to it
CORE_OVER = 30.0  # mm below the plug over which lines go over to the shape of the bone
ROOT_TOLERANCE = 1e-11  # of roots, absolute and relative


def root(function: Callable[[Floats, Ints], Floats], high: Floats) -> Floats:
    """Zeros between 0 and `high` (n,) of functions that fall through zero; shape (n,).

    Args:
        function: Takes positions and numbers of the functions, both (k,); returns (k,).
        high: Upper ends (n,); the result where a function is positive there.
    """
    index = np.arange(len(high))
    zeros = high.copy()
    has_zero = function(high, index) < 0
    if has_zero.any():
        zeros[has_zero] = find_root(
            lambda x, k: function(x, k.astype(np.int64)),
            (np.zeros(int(has_zero.sum())), high[has_zero]),
            args=(index[has_zero].astype(float),),
            tolerances={"xatol": ROOT_TOLERANCE, "xrtol": ROOT_TOLERANCE},
        ).x
    return zeros


@dataclass(frozen=True)
class Sections:
    """The sections of a mesh, in the stem's axes.

    Attributes:
        placement: Neck cut and stem in the axes of the model.
        shoulder: Height at the axis of the section at the stem's shoulder, or of the cut [mm].
        plug: Height of the end of the cement plug [mm].
        zeta: Heights at the axis of the sections up to the cut (n,) [mm].
    """

    placement: Placement
    shoulder: float
    plug: float
    zeta: Floats

    def slope(self, zeta: Floats) -> Floats:
        """Slope of the sections at heights on the axis."""
        t = np.clip((zeta - self.shoulder + TURN_LENGTH) / TURN_LENGTH, 0.0, 1.0)
        return np.asarray(self.placement.slopes[0] * t * t * (2 - t))

    def rise(self, x: Floats) -> Floats:
        """Distance by which a slope of 1 lowers points (..., 2 or 3) [mm]."""
        return np.asarray(x[..., 0] + self.placement.slopes[1] * x[..., 1])

    def in_plane(self, xy: Floats, zeta: Floats) -> Floats:
        """Points of sections over places (..., 2) of the plane z = 0 (..., 3) [mm]."""
        z = zeta - self.slope(zeta) * self.rise(xy)
        return np.concatenate([xy, z[..., None]], axis=-1)

    def below_plug(self, zeta: Floats) -> Floats:
        """Part from 0 at the plug to 1 at `CORE_OVER` below it, smooth at both ends."""
        fraction = np.clip((self.plug - zeta) / CORE_OVER, 0.0, 1.0)
        return np.asarray(fraction * fraction * (3 - 2 * fraction))


@dataclass(frozen=True)
class Lines:
    """Straight lines across the layers, one for each pair (phi, s).

    Attributes:
        start: Points on the innermost surface (n, 3) [mm].
        end: Points on the periosteum (n, 3) [mm].
        mantle: Outer side of the mantle, as a fraction of the length from start (n,); may lie
            beyond the endosteum.
        endosteum: Endosteum, as a fraction of the length (n,).
    """

    start: Floats
    end: Floats
    mantle: Floats
    endosteum: Floats

    @property
    def exact_thickness(self) -> Floats:
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
        merged: True where mantle and endosteum coincide.
        error: Used thickness of the layer between them less the exact one [mm].
        floor: Least thickness of that layer [mm].
        thickness: Used thickness of that layer [mm]; 0 for nodes on no line.
        x: Positions (n, 3) [mm].
    """

    phi: Ints
    rho: Floats
    s: Ints
    merged: Bools
    error: Floats
    floor: Floats
    thickness: Floats
    x: Floats

    def __len__(self) -> int:
        """Number of nodes."""
        return len(self.phi)
