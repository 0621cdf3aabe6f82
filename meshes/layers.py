"""The map from the reference body to the anatomy: nested layers on surfaces that are formulas.

A node has three coordinates: `phi` around and `s` along the line, in half steps, and `rho` across.
Whole values of `rho` are surfaces: 1 the stem or whatever is innermost, 2 the outer side of the
mantle, 3 the endosteum, 4 the periosteum; 0 stands for the nodes inside the innermost surface. The
surfaces are formulas (`Surfaces`), and the middle nodes of curved cells are put on them by their
own coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from app.arrays import Floats, Ints
from meshes.data import distinct
from meshes.reference_body import Block, Body

Bools = npt.NDArray[np.bool_]

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


class Surfaces(Protocol):
    """Nested surfaces as functions on the grid.

    Attributes:
        around: Number of lines around.
        through: Cells through each layer, at most.
        cement: Cells through the first layer; a fraction is the part, from the end of the mantle
            down, with one more.
        blocks: Blocks of the reference body, from below.
        mantle: The first and the last section with a mantle, whose lines with mantle and endosteum
            in one continue below and above.
        size: Mesh size [mm].
        mirrored: Steps whose prisms are split the other way around: there sections turn back.
    """

    around: int
    through: tuple[int, int, int]
    cement: float
    blocks: tuple[Block, ...]
    mantle: tuple[int, int]
    size: float
    mirrored: range

    def outline(self) -> Floats:
        """Section of the innermost surface in the reference body (around, 2)."""

    def lines(self, phi: Floats, s: Floats) -> Lines:
        """The lines at angles `phi`, in turns, and stations `s`, both of shape (n,)."""

    def ended(self, nodes: Nodes, number: Ints, body: Body) -> tuple[Nodes, Ints]:
        """Nodes with those of a ball at the end, and the node that stands for each."""

    def arc(self, a: Floats, b: Floats) -> Floats:
        """Middles of edges from a to b (n, 3) in the shell of the ball (n, 3)."""


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


def lines_of(surfaces: Surfaces, phi: Ints, s: Ints) -> tuple[Lines, Ints]:
    """Distinct lines of nodes at phi and s (n,), and the number of the line of each node (n,)."""
    turn = 2 * surfaces.around
    keys, line = distinct(s * turn + phi)
    return surfaces.lines((keys % turn) / turn, (keys // turn) / 2), line


def place(surfaces: Surfaces, nodes: Nodes) -> Nodes:
    """Put all nodes on lines onto the surfaces, or between them by their coordinates."""
    on = np.flatnonzero(nodes.rho > 0)
    lines, line = lines_of(surfaces, nodes.phi[on], nodes.s[on])
    start, end = lines.start[line], lines.end[line]
    bone, gap = lines.endosteum[line], lines.gap[line]
    merged, rho = nodes.merged[on], nodes.rho[on]
    used = np.where(merged, 0.0, np.maximum(gap + nodes.error[on], nodes.floor[on]))
    mantle = bone - used / lines.length[line]
    part = np.where(
        rho <= 2,
        (rho - 1) * mantle,
        np.where(rho <= 3, mantle + (rho - 2) * (bone - mantle), bone + (rho - 3) * (1 - bone)),
    )
    part = np.where(merged, bone, part)
    x, error = nodes.x.copy(), nodes.error.copy()
    x[on] = start + part[:, None] * (end - start)
    error[on] = np.where(merged, -gap, used - gap)
    return replace(nodes, x=np.round(x, DIGITS), error=error)
