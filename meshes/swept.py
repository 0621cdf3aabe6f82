"""Meshes of nested layers swept along a line: topology, refinement and middle nodes.

A node has three integer coordinates: `phi` around, `rho` across and `s` along the line, in parts of
the steps of the coarsest mesh. Whole values of ``rho / unit`` are surfaces: 1 the stem or whatever
is innermost, 2 the outer side of the mantle, 3 the endosteum, 4 the periosteum; 0 stands for
the nodes inside the innermost surface. The surfaces are formulas (`Surfaces`), and every node that
refinement or curving adds is put on them by its own coordinates. So meshes of sizes 2 h and h
are nested: the same regions, surfaces and names, eight cells for each.

Along a line where two layers would be thinner than a floor, the two surfaces are one: the nodes
between them are merged, and cells that have a node twice are left out. The floor bounds the angle
of the wedges in which a layer ends, so that refinement does not make them flat.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from app.errors import GeometryError

from .curving import untangle
from .data import EDGES, Floats, Ints, cell_volumes, exterior_facets
from .quality import sicn

Bools = npt.NDArray[np.bool_]

COARSEST = 5.0  # mm: meshes of this size and below are refinements of one that is coarser
FLOOR = 0.12  # of the mesh size: layers thinner than this have no thickness
SPOKES = 8  # least number around: two in each quarter
DIGITS = 6  # decimals [mm] that nodes are rounded to: processors differ far behind these
SURER = 1e-6  # a diagonal is taken instead of the usual one if it is better by this much
# How much of the larger thickness a mid-edge node keeps beside a layer's end: else cells invert.
KEPT = 0.8


@dataclass(frozen=True)
class Lines:
    """Straight lines across the layers, one for each pair (phi, s).

    Attributes:
        start: Points on the innermost surface (n, 3) [mm].
        end: Points on the periosteum (n, 3) [mm].
        mantle: Where the outer side of the mantle is, of the way from start to end (n,); it may
            lie beyond the endosteum.
        endosteum: Where the endosteum is, of the way (n,).
    """

    start: Floats
    end: Floats
    mantle: Floats
    endosteum: Floats

    @property
    def gap(self) -> Floats:
        """Thickness that is left between mantle and endosteum [mm], negative if none is; (n,)."""
        way = np.sqrt(((self.end - self.start) ** 2).sum(axis=1))
        return (self.endosteum - self.mantle) * way


class Surfaces(Protocol):
    """Nested surfaces as functions on the grid.

    Attributes:
        spokes: Number of lines around, a multiple of four.
        stations: Number of sections.
        mantle: The first and the last section with a mantle; below and above, lines along which
            mantle and endosteum are one are those of these.
        size: Mesh size [mm].
    """

    spokes: int
    stations: int
    mantle: tuple[int, int]
    size: float

    def lines(self, phi: Floats, s: Floats) -> Lines:
        """The lines at angles `phi`, in turns, and stations `s`, both of shape (n,)."""

    def bend(self, x: Floats, way: Floats, s: Floats) -> Floats:
        """Move points at parts `way` of lines off them, where sections are not plane; (n, 3)."""

    def inside(self, x: Floats, s: Floats) -> Floats:
        """Move points inside the innermost surface, at its ends; (n, 3)."""


@dataclass(frozen=True)
class Nodes:
    """Nodes by their coordinates.

    Attributes:
        phi: Around, in units; of shape (n,) as all.
        rho: Across, in units; 0 for what is inside the innermost surface.
        s: Along, in units.
        merged: Whether mantle and endosteum are one there.
        error: Used thickness of the layer between them less the exact one [mm].
        floor: Least thickness of that layer [mm].
        x: Places (n, 3) [mm].
    """

    phi: Ints
    rho: Ints
    s: Ints
    merged: Bools
    error: Floats
    floor: Floats
    x: Floats

    def __len__(self) -> int:
        """How many."""
        return len(self.phi)


@dataclass(frozen=True)
class Swept:
    """A swept mesh.

    Attributes:
        surfaces: What its nodes are on.
        nodes: Its nodes; those of curved cells include middle nodes.
        cells: Tetrahedra (m, 4 or 10).
        layer: For each cell the layer it is in: 0 inside, then 1 to 3 outwards.
        slab: For each cell the number of the step along the line that it is in.
        unit: Units in a step of the coarsest mesh.
    """

    surfaces: Surfaces
    nodes: Nodes
    cells: Ints
    layer: Ints
    slab: Ints
    unit: int


def steps(size: float) -> tuple[float, int]:
    """Size of the coarsest mesh of a family [mm], and how often it is refined for `size`."""
    times = 0
    while size * 2**times <= COARSEST:
        times += 1
    return size * 2**times, times


def mesh(surfaces: Surfaces, outermost: Callable[[int], int], times: int, curved: bool) -> Swept:
    """Sweep the cross-section, refine it, and curve its cells if asked.

    Args:
        surfaces: The surfaces, with the size of the coarsest mesh.
        outermost: The outermost surface of each slab, 1 or 4: a neck has no layers.
        times: How often every cell is divided into eight.
        curved: Whether cells get nodes in the middle of their edges, on the surfaces.

    Raises:
        GeometryError: Cells overlap: the surfaces are not nested.
    """
    made = _coarsest(surfaces, outermost, 2 ** (times + 1))
    for _ in range(times):
        made = _refined(made)
    _check_volume(made)
    return _curved(made) if curved else made


@dataclass(frozen=True)
class On:
    """Which facets are wholly on a surface or on a section.

    Attributes:
        corners: Coordinates rho and s of the corners of facets (2, k, 3), in steps.
    """

    corners: Floats

    def rho(self, surface: int) -> Bools:
        """Those on a surface (k,)."""
        return np.asarray((self.corners[0] == surface).all(axis=1))

    def s(self, station: int) -> Bools:
        """Those on a section (k,)."""
        return np.asarray((self.corners[1] == station).all(axis=1))

    def above(self, station: int) -> Bools:
        """Those at a section or above (k,)."""
        return np.asarray((self.corners[1] >= station).all(axis=1))


def on(made: Swept, facets: Ints) -> On:
    """Where facets (k, 3 or 6) of a swept mesh are."""
    corners = facets[:, :3]
    return On(np.stack([made.nodes.rho[corners], made.nodes.s[corners]]) / made.unit)


def describe(made: Swept) -> dict[str, float]:
    """Notes on a swept mesh: its grid, and how far its layers are from the exact ones [mm]."""
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


def _section(spokes: int) -> tuple[Ints, Ints, Ints, Ints]:
    """One triangulation of the cross-section for all stations.

    Returns:
        Columns as rows of spoke and surface (c, 2), nodes inside being numbered by the spoke they
        are beside and surface 0; triangles of columns (t, 3); the layer of each; and the rank of
        each column: from lateral to medial, all of one spoke together, outwards. Sections turn
        about an antero-posterior axis, and diagonals from lateral to medial are the short ones.
    """
    half = spokes // 2
    first = -(-half // 3)  # the ends of the spine, from which outlines fan out
    spine = list(range(first, half - first + 1))
    columns = [(i, j) for i in range(spokes) for j in range(1, 5)] + [(i, 0) for i in spine]
    number = {column: k for k, column in enumerate(columns)}

    def key(column: tuple[int, int]) -> tuple[int, int, int]:
        i, j = column
        return abs(i - half), 0 if j == 0 else 1 + (i > half), j

    rank = np.empty(len(columns), dtype=np.int64)
    rank[sorted(range(len(columns)), key=lambda k: key(columns[k]))] = np.arange(len(columns))
    triangles, layers = [], []

    def add(layer: int, *corners: tuple[int, int]) -> None:
        triangles.append([number[i % spokes, j] for i, j in corners])
        layers.append(layer)

    for i in range(spokes):
        low, high = sorted((i, (i + 1) % spokes), key=lambda k: key((k, 1)))
        for j in range(1, 4):
            add(j, (low, j), (low, j + 1), (high, j + 1))
            add(j, (low, j), (high, j), (high, j + 1))
    for i in spine[:-1]:
        for sign in (1, -1):
            add(0, (sign * i, 1), (sign * (i + 1), 1), (i + 1, 0))
            add(0, (sign * i, 1), (i, 0), (i + 1, 0))
    for i in range(-first, first):
        add(0, (i, 1), (i + 1, 1), (first, 0))
    for i in range(half - first, half + first):
        add(0, (i, 1), (i + 1, 1), (half - first, 0))
    return np.array(columns), np.array(triangles), np.array(layers), rank


def _coarsest(surfaces: Surfaces, outermost: Callable[[int], int], unit: int) -> Swept:
    """Sweep the cross-section along all stations."""
    columns, triangles, layers, rank = _section(surfaces.spokes)
    c, levels = len(columns), surfaces.stations
    nodes = _grid(surfaces, columns, unit)
    # Prisms, split by the ranks of their columns: both sides of a face are split alike.
    order = np.take_along_axis(triangles, np.argsort(rank[triangles], axis=1), axis=1)
    outer = columns[triangles][:, :, 1].max(axis=1)
    cells, layer, slab = [], [], []
    for k in range(levels - 1):
        use = outer <= outermost(k)
        prism = np.hstack([order[use] + k * c, order[use] + (k + 1) * c])
        cells.append(prism[:, _PRISM].reshape(-1, 4))
        layer.append(np.repeat(layers[use], 3))
        slab.append(np.full(3 * int(use.sum()), k))
    # Nodes of a layer without thickness are one: that on the endosteum, the next in its column.
    number = np.arange(len(nodes))
    number += nodes.merged & (nodes.rho == 2 * unit)
    tets = number[np.concatenate(cells)]
    ordered = np.sort(tets, axis=1)
    keep = (ordered[:, 1:] != ordered[:, :-1]).all(axis=1)
    made = Swept(
        surfaces, nodes, tets[keep], np.concatenate(layer)[keep], np.concatenate(slab)[keep], unit
    )
    return _packed(made)


# The tetrahedra of a prism, whose lower corners 0, 1, 2 are in the order of their ranks.
_PRISM = np.array([(0, 1, 2, 5), (0, 1, 4, 5), (0, 3, 4, 5)])


def _grid(surfaces: Surfaces, columns: Ints, unit: int) -> Nodes:
    """Nodes of all columns at all stations, those of one station after the other."""
    c, levels = len(columns), surfaces.stations
    merged, error, floor = _merged(surfaces)
    i, j = np.tile(columns, (levels, 1)).T
    k = np.repeat(np.arange(levels), c)
    nodes = Nodes(
        phi=i * unit,
        rho=j * unit,
        s=k * unit,
        merged=merged[i, k] & ((j == 2) | (j == 3)),
        error=np.where(j == 0, 0.0, error[i, k]),
        floor=np.where(j == 0, 0.0, floor[i, k]),
        x=np.zeros((len(i), 3)),
    )
    nodes = _place(surfaces, nodes, unit)
    # The spine is half-way between the outlines in front of it and behind it.
    x = nodes.x.reshape(levels, c, 3)
    spine = np.flatnonzero(columns[:, 1] == 0)
    front, back = 4 * columns[spine, 0], 4 * (-columns[spine, 0] % surfaces.spokes)
    inner = nodes.rho == 0
    middle = (0.5 * (x[:, front] + x[:, back])).reshape(-1, 3)
    nodes.x[inner] = np.round(surfaces.inside(middle, nodes.s[inner] / unit), DIGITS)
    return nodes


def _merged(surfaces: Surfaces) -> tuple[Bools, Floats, Floats]:
    """Where mantle and endosteum are one, by spoke and station; error and floor there [mm]."""
    spokes, levels = surfaces.spokes, surfaces.stations
    phi, s = np.meshgrid(np.arange(spokes) / spokes, np.arange(levels, dtype=float), indexing="ij")
    lines = surfaces.lines(phi.ravel(), s.ravel())
    bone = lines.start + lines.endosteum[:, None] * (lines.end - lines.start)
    bone = bone.reshape(spokes, levels, 3)
    apart = np.sqrt(((np.roll(bone, -1, axis=0) - bone) ** 2).sum(axis=2))
    apart = np.maximum(apart, np.roll(apart, 1, axis=0))
    floor = FLOOR * np.maximum(surfaces.size, apart)
    gap = lines.gap.reshape(spokes, levels)
    merged = gap < floor
    # Below and above the mantle its first and its last section go on.
    low, high = surfaces.mantle
    merged[:, :low], merged[:, high + 1 :] = merged[:, low : low + 1], merged[:, high : high + 1]
    return merged, np.where(merged, -gap, 0.0), np.where(merged, 0.0, floor)


def _packed(made: Swept) -> Swept:
    """The mesh without unused nodes, its cells positive."""
    used, cells = np.unique(made.cells, return_inverse=True)
    cells = cells.reshape(made.cells.shape)
    nodes = Nodes(**{name: values[used] for name, values in vars(made.nodes).items()})
    flipped = cell_volumes(nodes.x, cells) < 0
    cells[flipped] = cells[flipped][:, [1, 0, 2, 3]]
    return replace(made, nodes=nodes, cells=cells)


def _place(surfaces: Surfaces, nodes: Nodes, unit: int) -> Nodes:
    """Put all nodes but those inside on the surfaces, and between them by their coordinates."""
    on = np.flatnonzero(nodes.rho > 0)
    turn = surfaces.spokes * unit
    keys, line = np.unique(nodes.s[on] * turn + nodes.phi[on], return_inverse=True)
    lines = surfaces.lines((keys % turn) / turn, (keys // turn) / unit)
    line = line.ravel()
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
    s = nodes.s[on] / unit
    x = nodes.x.copy()
    x[on] = surfaces.bend(start + part[:, None] * (end - start), part, s)
    error = nodes.error.copy()
    error[on] = np.where(merged, -gap, used - gap)
    return replace(nodes, x=np.round(x, DIGITS), error=error)


def _middles(made: Swept, ends: Ints, curved: bool = False) -> Nodes:
    """Nodes in the middle of edges.

    Args:
        made: The mesh.
        ends: Both ends of each edge (e, 2).
        curved: Whether they curve cells, beside which a layer's end must not be too steep.
    """
    nodes, turn = made.nodes, made.surfaces.spokes * made.unit
    a, b = ends.T
    apart = nodes.phi[b] - nodes.phi[a]
    apart = (apart + turn // 2) % turn - turn // 2  # the short way around
    both = nodes.merged[a] & nodes.merged[b]
    rho = [nodes.rho[k].copy() for k in (a, b)]
    for own, other in ((0, 1), (1, 0)):
        # A merged node is on mantle and endosteum: it takes whichever the other is nearer to.
        alone = nodes.merged[(a, b)[own]] & ~both
        rho[own][alone] = np.clip(rho[other][alone], 2 * made.unit, 3 * made.unit)
    inner = (nodes.rho[a] == 0) | (nodes.rho[b] == 0)
    middle = Nodes(
        phi=np.where(inner, 0, (nodes.phi[a] + apart // 2) % turn),
        rho=np.where(inner, 0, np.where(both, 3 * made.unit, (rho[0] + rho[1]) // 2)),
        s=(nodes.s[a] + nodes.s[b]) // 2,
        merged=both & ~inner,
        error=np.where(inner, 0.0, 0.5 * (nodes.error[a] + nodes.error[b])),
        floor=np.where(inner, 0.0, 0.5 * (nodes.floor[a] + nodes.floor[b])),
        x=0.5 * (nodes.x[a] + nodes.x[b]),
    )
    if curved:
        middle = replace(middle, floor=np.maximum(middle.floor, _steep(made, a, b)))
    x = middle.x
    x[inner] = made.surfaces.inside(x[inner], middle.s[inner] / made.unit)
    return _place(made.surfaces, replace(middle, x=x), made.unit)


def _steep(made: Swept, a: Ints, b: Ints) -> Floats:
    """Least thickness in the middle of edges between a thin and a thick end of a layer [mm]."""
    gap = _thickness(made)
    thin, thick = np.minimum(gap[a], gap[b]), np.maximum(gap[a], gap[b])
    return np.where(2 * thin < thick, KEPT * 0.5 * (thin + thick), 0.0)


def _thickness(made: Swept) -> Floats:
    """Used thickness of the layer between mantle and endosteum at each node [mm]."""
    nodes, turn = made.nodes, made.surfaces.spokes * made.unit
    keys, line = np.unique(nodes.s * turn + nodes.phi, return_inverse=True)
    gap = made.surfaces.lines((keys % turn) / turn, (keys // turn) / made.unit).gap[line.ravel()]
    return np.where(nodes.rho == 0, 0.0, np.maximum(gap + nodes.error, 0.0))


def _edges(cells: Ints) -> tuple[Ints, Ints]:
    """Edges of the cells (e, 2), and the six of each cell as rows of them (m, 6)."""
    ends = np.sort(cells[:, :4][:, np.array(EDGES)].reshape(-1, 2), axis=1)
    n = int(cells.max()) + 1
    keys, of = np.unique(ends[:, 0] * n + ends[:, 1], return_inverse=True)
    return np.stack([keys // n, keys % n], axis=1), of.reshape(-1, 6)


def _joined(a: Nodes, b: Nodes) -> Nodes:
    return Nodes(**{name: np.concatenate([v, vars(b)[name]]) for name, v in vars(a).items()})


# The octahedron that is left when the four corners of a cell are cut off, divided around each of
# its diagonals; nodes 4 to 9 are the middles of `EDGES`. All are as positive as the cell.
_CORNERS = ((0, 4, 6, 7), (4, 1, 5, 9), (6, 5, 2, 8), (7, 9, 8, 3))
_AROUND = {
    (4, 8): (6, 7, 9, 5),
    (5, 7): (9, 8, 6, 4),
    (6, 9): (4, 5, 8, 7),
}


def _refined(made: Swept) -> Swept:
    """Divide each cell into eight: four corners, and four around the octahedron's best diagonal."""
    ends, of = _edges(made.cells)
    nodes = _joined(made.nodes, _middles(made, ends))
    local = np.hstack([made.cells, of + len(made.nodes)])
    choices = []
    for (p, q), ring in _AROUND.items():
        ways = [(p, q, ring[k], ring[(k + 1) % 4]) for k in range(4)]
        choices.append(local[:, ways])
    best = choices[0]
    worth = sicn(nodes.x, best.reshape(-1, 4)).reshape(-1, 4).min(axis=1)
    for cells in choices[1:]:
        other = sicn(nodes.x, cells.reshape(-1, 4)).reshape(-1, 4).min(axis=1)
        better = other > worth + SURER
        best = np.where(better[:, None, None], cells, best)
        worth = np.where(better, other, worth)
    corners = local[:, np.array(_CORNERS)]
    cells = np.concatenate([corners, best], axis=1).reshape(-1, 4)
    return replace(
        made,
        nodes=nodes,
        cells=cells,
        layer=np.repeat(made.layer, 8),
        slab=np.repeat(made.slab, 8),
    )


def _curved(made: Swept) -> Swept:
    """Give each edge a middle node on the surfaces; cells that bend too far are straightened."""
    ends, of = _edges(made.cells)
    nodes = _joined(made.nodes, _middles(made, ends, curved=True))
    cells = np.hstack([made.cells, of + len(made.nodes)])
    return replace(made, nodes=replace(nodes, x=untangle(nodes.x, cells)), cells=cells)


def _check_volume(made: Swept) -> None:
    """Raise GeometryError unless the cells fill what their exterior facets enclose, once."""
    cells, x = made.cells, made.nodes.x
    volume = float(np.abs(cell_volumes(x, cells)).sum())
    facets, _ = exterior_facets(cells)
    corners = x[facets]
    flux = np.cross(corners[:, 0], corners[:, 1]) * corners[:, 2]
    enclosed = float(flux.sum()) / 6
    if abs(volume - enclosed) > 1e-9 * volume:
        raise GeometryError(
            f"geometry: layers cut through each other ({volume - enclosed:.3g} mm3 of"
            f" {volume:.0f} mm3 would be there twice); change what was set last"
        )
