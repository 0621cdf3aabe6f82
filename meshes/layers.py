"""Nodes of nested layers, on surfaces that are formulas.

A node has three integer coordinates: `phi` around, `rho` across and `s` along the line, in parts of
the steps of the coarsest mesh. Whole values of ``rho / unit`` are surfaces: 1 the stem or whatever
is innermost, 2 the outer side of the mantle, 3 the endosteum, 4 the periosteum; 0 stands for
the nodes inside the innermost surface. The surfaces are formulas (`Surfaces`), and every node that
refinement or curving adds is put on them by its own coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from app.arrays import Floats, Ints
from meshes.data import distinct, faces_of

Bools = npt.NDArray[np.bool_]

FLOOR = 0.12  # of the mesh size: layers thinner than this have no thickness
ALONG = 0.10  # of the distance to the next section, where that is far: the same
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
        way = np.sqrt(((self.end - self.start) ** 2).sum(axis=1))
        return (self.endosteum - self.mantle) * way


class Surfaces(Protocol):
    """Nested surfaces as functions on the grid.

    Attributes:
        spokes: Number of lines around, a multiple of four.
        stations: Number of sections.
        mantle: The first and the last section with a mantle, whose lines with mantle and endosteum
            in one continue below and above.
        size: Mesh size [mm].
        mirrored: Steps whose prisms are split the other way around: there sections turn back.
    """

    spokes: int
    stations: int
    mantle: tuple[int, int]
    size: float
    mirrored: range

    def outermost(self, slab: int) -> int:
        """The outermost surface of a step along the line, 1, 3 or 4: a neck has no layers.

        Above a step of 3, a lid, the third surface begins where the fourth ends below it.
        """

    def lines(self, phi: Floats, s: Floats) -> Lines:
        """The lines at angles `phi`, in turns, and stations `s`, both of shape (n,)."""

    def ended(self, nodes: Nodes, unit: int) -> Nodes:
        """Nodes of the coarsest mesh, with those of a ball at its end taken off their lines."""

    def arc(self, a: Floats, b: Floats) -> Floats:
        """Middles of edges from a to b (n, 3) in the shell of the ball (n, 3)."""


@dataclass(frozen=True)
class Nodes:
    """Nodes by their coordinates; all arrays have shape (n,) unless stated.

    Attributes:
        phi: Around, in units.
        rho: Across, in units; 0 for nodes on no line: inside the innermost surface, or in a ball.
            Negative in the shell of a ball.
        s: Along, in units.
        merged: Whether mantle and endosteum are one there.
        error: Used thickness of the layer between them less the exact one [mm].
        floor: Least thickness of that layer [mm].
        x: Positions (n, 3) [mm].
    """

    phi: Ints
    rho: Ints
    s: Ints
    merged: Bools
    error: Floats
    floor: Floats
    x: Floats

    def __len__(self) -> int:
        """Number of nodes."""
        return len(self.phi)


@dataclass(frozen=True)
class Swept:
    """A swept mesh.

    Attributes:
        nodes: Its nodes; those of curved cells include middle nodes.
        cells: Tetrahedra (m, 4 or 10).
        layer: Layer of each cell: 0 inside, then 1 to 3 outwards.
        slab: Number of the step along the line of each cell.
        partner: Row of the same face of another cell, as of `match_faces` (4 m,).
        unit: Units in a step of the coarsest mesh.
    """

    surfaces: Surfaces
    nodes: Nodes
    cells: Ints
    layer: Ints
    slab: Ints
    partner: Ints
    unit: int

    @property
    def facets(self) -> tuple[Ints, Ints]:
        """Nodes of the exterior facets (k, 3 or 6), and their cells (k,)."""
        cell, face = np.divmod(np.flatnonzero(self.partner < 0), 4)
        return faces_of(self.cells, cell, face), cell


def lines_of(surfaces: Surfaces, phi: Ints, s: Ints, unit: int) -> tuple[Lines, Ints]:
    """Distinct lines of nodes at phi and s (n,), and the number of the line of each node (n,)."""
    turn = surfaces.spokes * unit
    keys, line = distinct(s * turn + phi)
    return surfaces.lines((keys % turn) / turn, (keys // turn) / unit), line


def place(surfaces: Surfaces, nodes: Nodes, unit: int) -> Nodes:
    """Put all nodes on lines onto the surfaces, or between them by their coordinates."""
    on = np.flatnonzero(nodes.rho > 0)
    lines, line = lines_of(surfaces, nodes.phi[on], nodes.s[on], unit)
    start, end = lines.start[line], lines.end[line]
    bone, gap = lines.endosteum[line], lines.gap[line]
    merged = nodes.merged[on]
    used = np.where(merged, 0.0, np.maximum(gap + nodes.error[on], nodes.floor[on]))
    way = np.sqrt(((end - start) ** 2).sum(axis=1))
    mantle = bone - used / way
    rho = nodes.rho[on] / unit
    part = np.where(
        rho <= 2,
        (rho - 1) * mantle,
        np.where(rho <= 3, mantle + (rho - 2) * (bone - mantle), bone + (rho - 3) * (1 - bone)),
    )
    part = np.where(merged, bone, part)
    x = nodes.x.copy()
    x[on] = start + part[:, None] * (end - start)
    error = nodes.error.copy()
    error[on] = np.where(merged, -gap, used - gap)
    return replace(nodes, x=np.round(x, DIGITS), error=error)


@dataclass(frozen=True)
class On:
    """Facets that lie wholly on a surface or a section.

    Attributes:
        corners: Coordinates rho and s of the corners of facets (2, k, 3), in steps.
    """

    corners: Floats

    def rho(self, surface: int) -> Bools:
        """Facets on a surface (k,)."""
        return np.asarray((self.corners[0] == surface).all(axis=1))

    def s(self, station: int) -> Bools:
        """Facets on a section (k,)."""
        return np.asarray((self.corners[1] == station).all(axis=1))

    def above(self, station: int) -> Bools:
        """Facets at a section or above (k,)."""
        return np.asarray((self.corners[1] >= station).all(axis=1))


def on(made: Swept, facets: Ints) -> On:
    """Positions on the grid of facets (k, 3 or 6) of a swept mesh."""
    corners = facets[:, :3]
    return On(np.stack([made.nodes.rho[corners], made.nodes.s[corners]]) / made.unit)


def describe(made: Swept) -> dict[str, float]:
    """Notes on a swept mesh: its grid, and the deviation of its layers from the exact ones [mm]."""
    nodes = made.nodes
    mantle = (nodes.rho == 2 * made.unit) | nodes.merged
    wrong = np.abs(nodes.error[mantle])
    within = nodes.s[mantle] >= made.surfaces.mantle[0] * made.unit
    moved = np.where(nodes.merged[mantle], np.maximum(-nodes.error[mantle], 0.0), wrong)[within]
    return {
        "spokes": made.surfaces.spokes * made.unit // 2,
        "stations": (made.surfaces.stations - 1) * made.unit // 2 + 1,
        "least_thickness_mm": FLOOR * made.surfaces.size,
        "moved_nodes": float((moved > 10.0**-DIGITS).mean()),
        "moved_max_mm": float(moved.max(initial=0.0)),
    }
