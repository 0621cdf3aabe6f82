"""Meshes of nested layers swept along a line.

One triangulation of the cross-section is swept through all sections; prisms are split by the ranks
of their columns. Nodes are on surfaces that are formulas (`layers`), and so are those that
refinement and curving add (`refine`): meshes of sizes 2 h and h are nested, with the same regions,
surfaces and names, eight cells for each.

Along a line where two layers would be thinner than a floor, the two surfaces are one: the nodes
between them are merged, and cells that have a node twice are left out. The floor bounds the angle
of the wedges in which a layer ends, so that refinement does not make them flat.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from app.arrays import Bools, Floats, Ints
from app.errors import GeometryError
from meshes import refine
from meshes.data import cell_volumes, match_faces
from meshes.layers import ALONG, DIGITS, FLOOR, Nodes, Surfaces, Swept, place

COARSEST = 5.0  # mm: meshes of this size and below are refinements of one that is coarser
SPOKES = 8  # least number around: two in each quarter


def least_spokes(size: float) -> int:
    """Least number of lines around for a size of the coarsest mesh [mm].

    The lines decide the error of a mesh: from 6 to 16 mm a stance with eight of them changes by a
    quarter of its error. A mesh of more than 10 mm is a coarser companion of one with eight lines
    and has four: cells are twice as large all around.
    """
    return SPOKES if size <= 2 * COARSEST else SPOKES // 2


def steps(size: float) -> tuple[float, int]:
    """Size of the coarsest mesh of a family [mm], and number of refinements for `size`."""
    times = 0
    while size * 2**times <= COARSEST:
        times += 1
    return size * 2**times, times


def mesh(surfaces: Surfaces, times: int, curved: bool) -> Swept:
    """Sweep the cross-section, divide every cell into eight some times, and curve cells if asked.

    Raises:
        GeometryError: Cells overlap: the surfaces are not nested.
    """
    made = _coarsest(surfaces, 2 ** (times + 1))
    for _ in range(times):
        made = refine.refined(made)
    _check_volume(made)
    return refine.curved(made) if curved else made


def _section(spokes: int) -> tuple[Ints, Ints, Ints, list[Ints]]:
    """One triangulation of the cross-section for all stations.

    Returns:
        Columns as rows of spoke and surface (c, 2), inner nodes being numbered by the spoke beside
        them and surface 0; triangles of columns (t, 3); the layer of each; and the rank of each
        column: from lateral to medial, all of one spoke together, outwards. Sections turn about an
        antero-posterior axis, and diagonals from lateral to medial are the short ones; where
        sections turn back, those by the second ranks, from medial to lateral.
    """
    half = spokes // 2
    first = -(-half // 3)  # the ends of the spine, from which outlines fan out
    spine = list(range(first, half - first + 1))
    columns = [(i, j) for i in range(spokes) for j in range(1, 5)] + [(i, 0) for i in spine]
    number = {column: k for k, column in enumerate(columns)}

    def key(column: tuple[int, int]) -> tuple[int, int, int]:
        i, j = column
        return abs(i - half), 0 if j == 0 else 1 + (i > half), j

    def rank(way: int) -> Ints:
        keys = [(way * key(column)[0], *key(column)[1:]) for column in columns]
        return np.argsort(sorted(range(len(columns)), key=lambda k: keys[k]))

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
    return np.array(columns), np.array(triangles), np.array(layers), [rank(1), rank(-1)]


# The tetrahedra of a prism, whose lower corners 0, 1, 2 are in the order of their ranks.
_PRISM = np.array([(0, 1, 2, 5), (0, 1, 4, 5), (0, 3, 4, 5)])


def _coarsest(surfaces: Surfaces, unit: int) -> Swept:
    columns, triangles, layers, ranks = _section(surfaces.spokes)
    c, levels = len(columns), surfaces.stations
    nodes = _grid(surfaces, columns, unit)
    # Prisms, split by the ranks of their columns: both sides of a face are split alike.
    orders = [np.take_along_axis(triangles, np.argsort(r[triangles]), axis=1) for r in ranks]
    outer = columns[triangles][:, :, 1].max(axis=1)
    cells, layer, slab = [], [], []
    for k in range(levels - 1):
        use = outer <= surfaces.outermost(k)
        order = orders[k in surfaces.mirrored][use]
        prism = np.hstack([order + k * c, order + (k + 1) * c])
        cells.append(prism[:, _PRISM].reshape(-1, 4))
        layer.append(np.repeat(layers[use], 3))
        slab.append(np.full(3 * int(use.sum()), k))
    # Nodes of a layer without thickness are one: that on the endosteum, the next in its column.
    number: Ints = np.arange(len(nodes))
    number += nodes.merged & (nodes.rho == 2 * unit)
    if surfaces.outermost(levels - 2) == 3:
        number = _lid(number, levels, c, surfaces.spokes)
    tets = number[np.concatenate(cells)]
    ordered = np.sort(tets, axis=1)
    keep = (ordered[:, 1:] != ordered[:, :-1]).all(axis=1)
    made = Swept(
        surfaces,
        nodes,
        cells=tets[keep],
        layer=np.concatenate(layer)[keep],
        slab=np.concatenate(slab)[keep],
        partner=np.zeros(0, dtype=np.int64),
        unit=unit,
    )
    return _packed(made)


def _grid(surfaces: Surfaces, columns: Ints, unit: int) -> Nodes:
    """Nodes of all columns at all stations, station by station."""
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
    nodes = place(surfaces, nodes, unit)
    # The spine is half-way between the outlines in front of it and behind it.
    x = nodes.x.reshape(levels, c, 3)
    spine = np.flatnonzero(columns[:, 1] == 0)
    front, back = 4 * columns[spine, 0], 4 * (-columns[spine, 0] % surfaces.spokes)
    x[:, spine] = np.round(0.5 * (x[:, front] + x[:, back]), DIGITS)
    return surfaces.ended(nodes, unit)


def _lid(number: Ints, levels: int, c: int, spokes: int) -> Ints:
    """Node numbers where the last step is a lid: its rim is that of the section below it."""
    same = np.arange(len(number)).reshape(levels, c)
    same[-1, 2 : 4 * spokes : 4] = same[-2, 3 : 4 * spokes : 4]
    return same.ravel()[number]


def _merged(surfaces: Surfaces) -> tuple[Bools, Floats, Floats]:
    """Mask where mantle and endosteum merge, by spoke and station; error and floor there [mm]."""
    spokes, levels = surfaces.spokes, surfaces.stations
    phi, s = np.meshgrid(np.arange(spokes) / spokes, np.arange(levels, dtype=float), indexing="ij")
    lines = surfaces.lines(phi.ravel(), s.ravel())
    bone = lines.start + lines.endosteum[:, None] * (lines.end - lines.start)
    bone = bone.reshape(spokes, levels, 3)
    apart = np.sqrt(((np.roll(bone, -1, axis=0) - bone) ** 2).sum(axis=2))
    apart = np.maximum(apart, np.roll(apart, 1, axis=0))
    floor = FLOOR * np.maximum(surfaces.size, apart)
    # Sections that turn are farther apart on the lateral side: wedges there are longer.
    low, high = surfaces.mantle
    steps = ALONG * np.sqrt((np.diff(bone[:, low : high + 1], axis=1) ** 2).sum(axis=2))
    for at in (np.s_[:, low:high], np.s_[:, low + 1 : high + 1]):
        floor[at] = np.maximum(floor[at], steps)
    gap = lines.gap.reshape(spokes, levels)
    merged = gap < floor
    # Below and above the mantle its first and its last section go on.
    merged[:, :low], merged[:, high + 1 :] = merged[:, low : low + 1], merged[:, high : high + 1]
    return merged, np.where(merged, -gap, 0.0), np.where(merged, 0.0, floor)


def _packed(made: Swept) -> Swept:
    used, cells = np.unique(made.cells, return_inverse=True)
    cells = cells.reshape(made.cells.shape)
    nodes = Nodes(**{name: values[used] for name, values in vars(made.nodes).items()})
    flipped = cell_volumes(nodes.x, cells) < 0
    cells[flipped] = cells[flipped][:, [1, 0, 2, 3]]
    return replace(made, nodes=nodes, cells=cells, partner=match_faces(cells))


def _check_volume(made: Swept) -> None:
    """Raise GeometryError unless the cells fill what their exterior facets enclose, once."""
    x = made.nodes.x
    volume = float(np.abs(cell_volumes(x, made.cells)).sum())
    corners = x[made.facets[0]]
    flux = np.cross(corners[:, 0], corners[:, 1]) * corners[:, 2]
    enclosed = float(flux.sum()) / 6
    if abs(volume - enclosed) > 1e-9 * volume:
        raise GeometryError(
            f"geometry: layers cut through each other ({volume - enclosed:.3g} mm3 of"
            f" {volume:.0f} mm3 would be there twice); change what was set last"
        )
