"""Meshes of nested layers: the reference body by gmsh, its image by one map.

gmsh's prisms are split by the ranks of their columns, both sides of a face alike. Along a line
where a layer would be thinner than a floor, its two surfaces are one: the nodes between them are
merged, and cells that have a node twice are removed. The floor bounds the angle of the wedges in
which a layer ends. (gmsh would split prisms into flat cells there.)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints
from meshes import reference_body
from meshes.data import EDGES, cell_volumes, faces_of, match_faces
from meshes.layered_surfaces import LayeredSurfaces
from meshes.layers import DIGITS, Nodes
from meshes.quality import check, relaxed, sicn, untangle
from meshes.reference_body import ReferenceBody

# Least thickness of a layer, over the distance to the next line, and to the next section: where it
# would be thinner it has none.
FLOOR = 0.12
ALONG = 0.05

POOR = 0.12  # SICN: quadrangles of the rings with worse cells get their other diagonal

# The tetrahedra of a prism, whose lower corners 0, 1, 2 are in the order of their ranks.
_PRISM = np.array([(0, 1, 2, 5), (0, 1, 4, 5), (0, 3, 4, 5)])


@dataclass(frozen=True)
class Swept:
    """A mesh of layers.

    Attributes:
        surfaces: Surfaces of the layers, which map nodes to their places.
        nodes: Nodes of the mesh; those of curved cells include middle nodes.
        cells: Nodes of each tetrahedron (m, 4 or 10).
        region: Number of the region of each cell (m,).
        names: Names of the regions, by number.
    """

    surfaces: LayeredSurfaces
    nodes: Nodes
    cells: Ints
    region: Ints
    names: tuple[str, ...]

    @cached_property
    def partner(self) -> Ints:
        """Row of the same face of another cell (`match_faces`), shape (4 m,)."""
        return match_faces(self.cells)

    @property
    def facets(self) -> tuple[Ints, Ints]:
        """Nodes of the exterior facets (k, 3 or 6), and their cells (k,)."""
        cell, face = np.divmod(np.flatnonzero(self.partner < 0), 4)
        return faces_of(self.cells, cell, face), cell

    def on(self, facets: Ints, rho: float | None = None, s: int | None = None) -> Bools:
        """Facets (k, 3 or 6) wholly on a surface, or on a station (k,)."""
        nodes, corners = self.nodes, facets[:, :3]
        on = nodes.rho[corners] == rho if s is None else nodes.s[corners] == 2 * s
        return np.asarray(on.all(axis=1))

    def above(self, facets: Ints, s: int) -> Bools:
        """Facets (k, 3 or 6) at a station or above (k,)."""
        return np.asarray((self.nodes.s[facets[:, :3]] >= 2 * s).all(axis=1))

    def describe(self) -> dict[str, Any]:
        """Notes: the grid, and the deviation of the layers from the exact ones [mm]."""
        nodes, surfaces = self.nodes, self.surfaces
        mantle = (nodes.rho == 2) | nodes.merged
        wrong = np.abs(nodes.error[mantle])
        within = nodes.s[mantle] >= 2 * surfaces.mantle[0]
        moved = np.where(nodes.merged[mantle], np.maximum(-nodes.error[mantle], 0.0), wrong)[within]
        floors = nodes.floor[mantle & ~nodes.merged]
        return {
            "lines_around": surfaces.around,
            "steps_along": sum(segment.steps for segment in surfaces.segments),
            "cells_through": list(surfaces.through),
            "least_thickness_mm": float(floors.min()) if len(floors) else 0.0,
            "moved_nodes": float((moved > 10.0**-DIGITS).mean()),
            "moved_max_mm": float(moved.max(initial=0.0)),
        }


def mesh(surfaces: LayeredSurfaces, curved: bool) -> Swept:
    """Mesh the layers; cells are curved if asked.

    Raises:
        PoorCellsError: Cells are inverted or nearly flat: the surfaces are not nested.
    """
    parts = surfaces.through, surfaces.segments
    body = reference_body.make(surfaces.outline(), *parts, surfaces.coarser, surfaces.first)
    nodes, number = _grid(surfaces, body)
    cells, parent = _mended(surfaces, body, nodes, number)
    region = body.region[parent]
    solid = ~surfaces.is_left_out(body)[parent]
    made = _relaxed(_packed(surfaces, nodes, cells[solid], region[solid], body.names))
    _check(made)
    return _curved(made) if curved else made


def _mended(
    surfaces: LayeredSurfaces, body: ReferenceBody, nodes: Nodes, number: Ints
) -> tuple[Ints, Ints]:
    """As `_split`, with other diagonals across the rings where cells are poor and get better.

    A diagonal is the same in all sections: its worst cell counts.
    """
    n, r = surfaces.around, len(body.rho)
    line, place = np.divmod(body.columns, r)
    least = place.min(axis=1)
    ring = np.flatnonzero((body.columns < n * r).all(axis=1) & (least < place.max(axis=1)))
    # Two corners of a triangle in a ring are on one line; the third ends a diagonal.
    third = ((line == np.roll(line, -1, axis=1)).argmax(axis=1) + 2)[ring] % 3
    first, pair = line[ring, third], line[ring, third - 1]
    quad = np.full(len(line), n * r)
    quad[ring] = np.where(first == (pair + 1) % n, pair, first) * r + least[ring]
    turned = body.columns.copy()
    turned[ring, third] += np.where(place[ring, third] == least[ring], 1, -1)

    def split(columns: Ints) -> tuple[tuple[Ints, Ints], Floats]:
        cells, parent = made = _split(surfaces, replace(body, columns=columns), number)
        worst = np.ones(n * r + 1)
        np.minimum.at(worst, quad[parent], sicn(nodes.x, cells))
        return made, worst

    made, worst = split(body.columns)
    if worst[:-1].min() >= POOR:
        return made
    better = (worst < POOR) & (split(turned)[1] > worst)
    return split(np.where(better[quad, None], turned, body.columns))[0]


def _split(surfaces: LayeredSurfaces, body: ReferenceBody, number: Ints) -> tuple[Ints, Ints]:
    """Tetrahedra (m, 4) of distinct nodes, and their prisms (m,).

    A tetrahedron that is not inverted has a positive volume.

    Columns rank from lateral to medial; the columns of one line rank together, outwards. Sections
    rotate about an antero-posterior axis, so that diagonals from lateral to medial are the short
    ones. Where sections rotate back, the order is reversed. Lines on a flat side rank as if it were
    round.
    """
    c = len(body.at)
    lines = surfaces.around * len(body.rho)
    edge = np.concatenate([np.arange(lines) // len(body.rho) * len(body.rho), np.arange(lines, c)])
    x, y = np.round(body.at[edge].T, DIGITS)
    round_ = -np.sign(x) * np.abs(y)
    ranks = [np.argsort(np.lexsort((np.arange(c), y, way * round_, way * x))) for way in (1, -1)]
    back = np.isin(body.slab, surfaces.mirrored)[:, None]
    order = np.argsort(np.where(back, ranks[1][body.columns], ranks[0][body.columns]), axis=1)
    low = np.take_along_axis(body.columns, order, axis=1) + c * body.slab[:, None]
    corners = np.hstack([low, low + c])[:, _PRISM].reshape(-1, 4)
    levels = int(body.slab.max()) + 2
    height = np.repeat(np.arange(levels, dtype=np.float64), c)
    flat = np.column_stack([np.tile(body.at, (levels, 1)), height])
    flipped = cell_volumes(flat, corners) < 0
    corners[flipped] = corners[flipped][:, [1, 0, 2, 3]]
    tets = number[corners]
    ordered = np.sort(tets, axis=1)
    kept = np.flatnonzero((ordered[:, 1:] != ordered[:, :-1]).all(axis=1))
    return tets[kept], kept // 3


def _grid(surfaces: LayeredSurfaces, body: ReferenceBody) -> tuple[Nodes, Ints]:
    """Nodes of all columns at all stations, and the one that stands for each."""
    n, r, c = surfaces.around, len(body.rho), len(body.at)
    levels = sum(segment.steps for segment in surfaces.segments) + 1
    phi, s = np.meshgrid(np.arange(n) / n, np.arange(levels, dtype=float), indexing="ij")
    lines = surfaces.lines(phi.ravel(), s.ravel())
    bone = lines.start + lines.endosteum[:, None] * (lines.end - lines.start)
    gap = lines.gap.reshape(n, levels)
    floor = _floor(surfaces, bone.reshape(n, levels, 3))
    merged = gap < floor
    # Below and above the mantle its first and its last section go on. Without cement the canal is
    # open below.
    low, high = surfaces.mantle
    if surfaces.first == 1:
        merged[:, :low] = merged[:, low : low + 1]
    merged[:, high + 1 :] = merged[:, high : high + 1]
    used = np.where(merged, 0.0, np.maximum(gap, floor))
    # Fewer cells across where they would be flat, and none where a layer has no thickness.
    length, endosteum = lines.length.reshape(n, levels), lines.endosteum.reshape(n, levels)
    widths = (endosteum * length - used, used, (1 - endosteum) * length)[surfaces.first - 1 :]
    place_of = np.full((r, n, levels), float(surfaces.first))
    same = np.zeros((r, n, levels), dtype=np.int64)
    part = np.clip((np.arange(levels) - low) / (high - low), 0.0, 1.0 - 1e-9)
    most: list[Floats | int] = [*surfaces.through]
    if surfaces.first == 1:
        most[0] = np.floor(surfaces.cement + part)
    first = 0
    steps = surfaces.mesh.least_through[surfaces.first - 1 :]
    layers = zip(surfaces.through, widths, steps, most, strict=True)
    for ring, (cells, width, step, limit) in enumerate(layers, start=surfaces.first):
        across = np.clip(np.round(width / step), 1, limit)
        for k in range(1, cells + 1):
            place_of[first + k] = ring + np.minimum(k / across, 1.0)
            same[first + k] = np.where(k < across, first + k, first + cells)
        first += cells
    endosteal = sum(surfaces.through[:-1])
    inner = (place_of >= 2) & (place_of < 3) & merged
    same[(place_of == 2) & merged | inner] = endosteal

    station = np.repeat(np.arange(levels), c)
    line = np.concatenate([np.repeat(np.arange(n), r), np.full(c - n * r, -1)])
    i, j = np.tile(line, levels), np.tile(np.arange(c) % r, levels)
    inside = i < 0
    rho = np.where(inside, 0.0, place_of[j, i, station])
    nodes = Nodes(
        phi=2 * np.maximum(i, 0),
        rho=rho,
        s=2 * station,
        merged=~inside & merged[i, station] & (rho >= 2) & (rho <= 3),
        error=np.where(inside, 0.0, np.where(merged, -gap, 0.0)[i, station]),
        floor=np.where(inside, 0.0, np.where(merged, 0.0, floor)[i, station]),
        x=np.zeros((len(i), 3)),
    )
    nodes = _place(surfaces, nodes)
    x = nodes.x.reshape(levels, c, 3)
    x[:, n * r :] = np.round(body.weights @ x[:, : n * r : r], DIGITS)
    number = np.arange(levels * c)
    number[~inside] += same[j, i, station][~inside] - j[~inside]
    return surfaces.ended(nodes, number, body)


def _place(surfaces: LayeredSurfaces, nodes: Nodes) -> Nodes:
    """Put all nodes on lines onto the surfaces, or between them by their coordinates."""
    on = np.flatnonzero(nodes.rho > 0)
    turn = 2 * surfaces.around
    keys, line = np.unique(nodes.s[on] * turn + nodes.phi[on], return_inverse=True)
    lines = surfaces.lines((keys % turn) / turn, (keys // turn) / 2)
    start, end = lines.start[line], lines.end[line]
    bone, gap = lines.endosteum[line], lines.gap[line]
    merged, rho = nodes.merged[on], nodes.rho[on]
    used = np.where(merged, 0.0, np.maximum(gap + nodes.error[on], nodes.floor[on]))
    mantle = bone - used / lines.length[line]
    if surfaces.first > 1:  # the stem is exact: where they are one, the endosteum is its surface
        bone, mantle = used / lines.length[line], np.zeros(len(on))
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


def _floor(surfaces: LayeredSurfaces, bone: Floats) -> Floats:
    """Least thickness of the layer within the endosteum, by line and station [mm]."""
    apart = np.sqrt(((np.roll(bone, -1, axis=0) - bone) ** 2).sum(axis=2))
    apart = np.maximum(apart, np.roll(apart, 1, axis=0))
    floor = FLOOR * apart
    # Sections that turn are farther apart on the lateral side: wedges there are longer.
    low, high = surfaces.mantle
    steps = ALONG * np.sqrt((np.diff(bone[:, low : high + 1], axis=1) ** 2).sum(axis=2))
    for at in (np.s_[:, low:high], np.s_[:, low + 1 : high + 1]):
        floor[at] = np.maximum(floor[at], steps)
    return floor


def _packed(
    surfaces: LayeredSurfaces, nodes: Nodes, cells: Ints, region: Ints, names: tuple[str, ...]
) -> Swept:
    used, cells = np.unique(cells, return_inverse=True)
    cells = cells.reshape(-1, 4)
    nodes = Nodes(**{name: values[used] for name, values in vars(nodes).items()})
    return Swept(surfaces, nodes, cells, region, names)


def _relaxed(made: Swept) -> Swept:
    """The mesh with poor cells mended by their nodes inside the innermost surface.

    A node on a facet or between regions stays.
    """
    nodes, cells = made.nodes, made.cells
    least, most = np.full(len(nodes), len(made.names)), np.full(len(nodes), -1)
    np.minimum.at(least, cells, made.region[:, None])
    np.maximum.at(most, cells, made.region[:, None])
    free = (nodes.rho == 0) & (least == most)
    free[made.facets[0]] = False
    return replace(made, nodes=replace(nodes, x=relaxed(nodes.x, cells, free, DIGITS)))


def _check(made: Swept) -> None:
    """Raise PoorCellsError where straight cells are inverted or nearly flat."""
    numbers = {name: k for k, name in enumerate(made.names)}
    x = made.surfaces.to_model(made.nodes.x)
    check(x, made.cells, made.region, numbers, ": layers cut through each other")


def _curved(made: Swept) -> Swept:
    """Give each edge a middle node on the surfaces; cells that bend too far are straightened."""
    a, b = (made.cells[:, k].ravel() for k in np.array(EDGES).T)
    n = len(made.nodes)
    keys, of = np.unique(np.minimum(a, b) * n + np.maximum(a, b), return_inverse=True)
    middles = _middles(made, keys // n, keys % n)
    nodes = Nodes(**{k: np.concatenate([v, vars(middles)[k]]) for k, v in vars(made.nodes).items()})
    cells = np.hstack([made.cells, of.reshape(-1, 6) + n])
    x = untangle(nodes.x, cells, made.surfaces.spared)
    return replace(made, nodes=replace(nodes, x=x), cells=cells)


def _middles(made: Swept, a: Ints, b: Ints) -> Nodes:
    """Nodes in the middle of edges between the nodes a and b (e,)."""
    nodes, turn = made.nodes, 2 * made.surfaces.around
    apart = nodes.phi[b] - nodes.phi[a]
    apart = (apart + turn // 2) % turn - turn // 2  # the short way around
    both = nodes.merged[a] & nodes.merged[b]
    # A merged node is on mantle and endosteum: it takes whichever the other is nearer to.
    ends = [
        np.where(nodes.merged[end] & ~both, np.clip(nodes.rho[other], 2, 3), nodes.rho[end])
        for end, other in ((a, b), (b, a))
    ]
    inner = (nodes.rho[a] <= 0) | (nodes.rho[b] <= 0) | (np.abs(apart) > 2)
    shell = inner & (np.minimum(np.abs(nodes.rho[a]), np.abs(nodes.rho[b])) >= 3)
    middle = Nodes(
        phi=np.where(inner, 0, (nodes.phi[a] + apart // 2) % turn),
        rho=np.where(inner, np.where(shell, -3.0, 0.0), np.where(both, 3.0, 0.5 * sum(ends))),
        s=(nodes.s[a] + nodes.s[b]) // 2,
        merged=both & ~inner,
        error=np.where(inner, 0.0, 0.5 * (nodes.error[a] + nodes.error[b])),
        floor=np.where(inner, 0.0, 0.5 * (nodes.floor[a] + nodes.floor[b])),
        x=0.5 * (nodes.x[a] + nodes.x[b]),
    )
    tip = 2 * made.surfaces.tip
    bowl = inner & ~shell & (nodes.s[a] == tip) & (nodes.s[b] == tip)
    heights = made.surfaces.heights(middle.s[bowl] / 2)
    middle.x[bowl] = made.surfaces.stem.hung(middle.x[bowl], heights)
    middle.x[shell] = made.surfaces.arc(nodes.x[a[shell]], nodes.x[b[shell]])
    return _place(made.surfaces, middle)
