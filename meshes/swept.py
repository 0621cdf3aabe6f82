"""Meshes of nested layers: the reference body by gmsh, its image by one map.

gmsh's prisms are split by the ranks of their columns, both sides of a face alike. Along a line
where a layer would be thinner than a floor, its two surfaces are one: the nodes between them are
merged, and cells that have a node twice are removed. The floor bounds the angle of the wedges in
which a layer ends. (gmsh would split prisms into flat cells there.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints
from meshes import reference_body
from meshes.data import cell_volumes, faces_of, match_faces
from meshes.layered_surfaces import LayeredSurfaces
from meshes.layers import DIGITS_OF_NODES, Nodes
from meshes.quality import BAD, check, relaxed_nodes, sicn, untangle
from meshes.reference_body import ReferenceBody
from meshes.shape_functions import GMSH_TETRAHEDRON

# Least thickness of a layer over the distance to the next line [-]. A layer that would be thinner
# has no thickness.
FLOOR_RATIO = 0.12
# The same over the distance to the next section [-].
FLOOR_RATIO_ALONG = 0.05

POOR = 0.12  # SICN: quadrangles with worse cells get their other diagonal if it is better

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
        is_on = nodes.rho[corners] == rho if s is None else nodes.s[corners] == 2 * s
        return np.asarray(is_on.all(axis=1))

    def above(self, facets: Ints, s: int) -> Bools:
        """Facets (k, 3 or 6) at a station or above (k,)."""
        return np.asarray((self.nodes.s[facets[:, :3]] >= 2 * s).all(axis=1))

    def describe(self) -> dict[str, Any]:
        """Notes: the grid, and the deviation of the layers from the exact ones [mm]."""
        nodes, surfaces = self.nodes, self.surfaces
        on_outer_side = (nodes.rho == 2) | nodes.merged
        deviation = np.abs(nodes.error[on_outer_side])
        at_mantle = nodes.s[on_outer_side] >= 2 * surfaces.mantle_stations[0]
        reached_by = np.maximum(-nodes.error[on_outer_side], 0.0)
        moved_by = np.where(nodes.merged[on_outer_side], reached_by, deviation)[at_mantle]
        thickness = nodes.thickness[on_outer_side & ~nodes.merged]
        return {
            "lines_around": surfaces.around,
            "steps_along": sum(segment.steps for segment in surfaces.segments),
            "cells_through": list(surfaces.through),
            "least_thickness_mm": float(thickness.min()) if len(thickness) else 0.0,
            "moved_nodes": float((moved_by > 10.0**-DIGITS_OF_NODES).mean()),
            "moved_max_mm": float(moved_by.max(initial=0.0)),
        }


def meshed_layers(surfaces: LayeredSurfaces, curved: bool) -> Swept:
    """Mesh the layers; cells are curved if asked.

    Raises:
        PoorCellsError: Cells are inverted or nearly flat: the surfaces are not nested.
    """
    parts = surfaces.through, surfaces.segments
    body = reference_body.make(surfaces.outline(), *parts, surfaces.coarser, surfaces.innermost)
    nodes, number = _grid(surfaces, body)
    cells, parent = _with_better_diagonals(surfaces, body, nodes, number)
    region = body.region[parent]
    solid = ~surfaces.is_left_out(body)[parent]
    swept_mesh = _with_moved_core_nodes(
        _packed(surfaces, nodes, cells[solid], region[solid], body.names)
    )
    _check(swept_mesh)
    return _curved(swept_mesh) if curved else swept_mesh


def _with_better_diagonals(
    surfaces: LayeredSurfaces, body: ReferenceBody, nodes: Nodes, number: Ints
) -> tuple[Ints, Ints]:
    """Split the prisms as `_split`, with the better diagonals of quadrangles.

    Diagonals of rings change where cells are poor and get better. Those at the edge of the core
    change where the cells outside of them are flat or inverted: all their nodes are on the stem's
    surface, so they cannot be improved. A diagonal is the same in all sections: its worst cell
    counts.
    """
    around, per_line = surfaces.around, len(body.rho)
    first_at_edge, no_quadrangle = around * per_line, around * (per_line + 1)
    quad = np.full(len(body.columns), no_quadrangle)
    turned_columns = body.columns.copy()
    _turn_ring_diagonals(body.columns, around, per_line, quad, turned_columns)
    inside = _turn_edge_diagonals(body, around, per_line, quad, turned_columns)
    judged = quad.copy()
    judged[inside] = no_quadrangle

    def split(columns: Ints) -> tuple[tuple[Ints, Ints], Floats]:
        cells, parent = tetrahedra = _split(surfaces, replace(body, columns=columns), number)
        worst = np.ones(no_quadrangle + 1)
        np.minimum.at(worst, judged[parent], sicn(nodes.x, cells))
        return tetrahedra, worst

    tetrahedra, worst = split(body.columns)
    in_ring, at_edge = np.s_[:first_at_edge], np.s_[first_at_edge:no_quadrangle]
    is_turned = np.zeros(no_quadrangle + 1, dtype=bool)
    is_turned[at_edge] = worst[at_edge] < BAD
    if worst[in_ring].min() < POOR:
        is_better = split(turned_columns)[1] > worst
        is_turned[in_ring] = (worst[in_ring] < POOR) & is_better[in_ring]
    if not is_turned.any():
        return tetrahedra
    return split(np.where(is_turned[quad, None], turned_columns, body.columns))[0]


def _turn_ring_diagonals(
    columns: Ints, around: int, per_line: int, quad: Ints, turned_columns: Ints
) -> None:
    """Number the quadrangles of the rings, and turn their diagonals, in place.

    Args:
        columns: Columns of the prisms (p, 3).
        around: Number of lines around.
        per_line: Columns on each line.
        quad: Number of the quadrangle of each prism (p,): that of its first column.
        turned_columns: Columns of the prisms with other diagonals (p, 3).
    """
    line, ring_place = np.divmod(columns, per_line)
    inner_place = ring_place.min(axis=1)
    ring = np.flatnonzero(
        (columns < around * per_line).all(axis=1) & (inner_place < ring_place.max(axis=1))
    )
    # Two corners of a triangle in a ring are on one line; the third ends a diagonal.
    third = ((line == np.roll(line, -1, axis=1)).argmax(axis=1) + 2)[ring] % 3
    first_node, pair = line[ring, third], line[ring, third - 1]
    quad[ring] = (
        np.where(first_node == (pair + 1) % around, pair, first_node) * per_line + inner_place[ring]
    )
    turned_columns[ring, third] += np.where(ring_place[ring, third] == inner_place[ring], 1, -1)


def _turn_edge_diagonals(
    body: ReferenceBody, around: int, per_line: int, quad: Ints, turned_columns: Ints
) -> Ints:
    """Number the quadrangles at the edge of the core, and turn their diagonals, in place.

    The cells of a triangle between three neighbouring lines are flat where its corners are on a
    plane face of the stem. With the triangle inside it, it is a quadrangle, whose other diagonal
    ends on the middle line. That line gives the number. Arguments: see `_turn_ring_diagonals`.

    Returns:
        The prisms inside the diagonals (k,).
    """
    columns = body.columns
    on_edge = (columns < around * per_line) & (columns % per_line == 0)
    corners_on_edge = on_edge.sum(axis=1)
    outer, inner = (np.flatnonzero(corners_on_edge == count) for count in (3, 2))
    # The middle one of three lines is one step from both others.
    line = columns[outer] // per_line
    steps = (line[:, :, None] - line[:, None, :]) % around
    is_middle = ((steps == 1).any(axis=2)) & ((steps == around - 1).any(axis=2))
    outer, is_middle = outer[is_middle.any(axis=1)], is_middle[is_middle.any(axis=1)]
    middle_column = columns[outer][is_middle]
    ends = np.sort(columns[outer][~is_middle].reshape(-1, 2), axis=1)
    shared_ends = np.sort(columns[inner][on_edge[inner]].reshape(-1, 2), axis=1)
    apex_column = columns[inner][~on_edge[inner]]
    _, of_outer, of_inner = np.intersect1d(
        _edge_keys(body.slab[outer], ends, columns.max() + 1),
        _edge_keys(body.slab[inner], shared_ends, columns.max() + 1),
        return_indices=True,
    )
    first_end, second_end = ends[of_outer].T
    middle, apex = middle_column[of_outer], apex_column[of_inner]
    turned_columns[outer[of_outer]] = np.stack([first_end, middle, apex], axis=1)
    turned_columns[inner[of_inner]] = np.stack([middle, second_end, apex], axis=1)
    quad[outer[of_outer]] = quad[inner[of_inner]] = around * per_line + middle // per_line
    return inner[of_inner]


def _edge_keys(slab: Ints, ends: Ints, column_count: int) -> Ints:
    """Distinct number of each edge between two columns (n, 2) in a layer (n,)."""
    return (slab * column_count + ends[:, 0]) * column_count + ends[:, 1]


def _split(surfaces: LayeredSurfaces, body: ReferenceBody, number: Ints) -> tuple[Ints, Ints]:
    """Tetrahedra (m, 4) of distinct nodes, and their prisms (m,).

    Their nodes are in an order in which volumes are positive unless cells are inverted.

    Columns rank from lateral to medial; the columns of one line rank together, outwards. Sections
    rotate about an antero-posterior axis, so that diagonals from lateral to medial are the short
    ones. Where sections rotate back, the order is reversed. Lines on a flat side rank as if it were
    round.
    """
    column_count = len(body.section)
    lines = surfaces.around * len(body.rho)
    edge = np.concatenate(
        [np.arange(lines) // len(body.rho) * len(body.rho), np.arange(lines, column_count)]
    )
    x, y = np.round(body.section[edge].T, DIGITS_OF_NODES)
    round_ = -np.sign(x) * np.abs(y)
    ranks = [
        np.argsort(np.lexsort((np.arange(column_count), y, side * round_, side * x)))
        for side in (1, -1)
    ]
    is_mirrored = np.isin(body.slab, surfaces.mirrored)[:, None]
    order = np.argsort(
        np.where(is_mirrored, ranks[1][body.columns], ranks[0][body.columns]), axis=1
    )
    lower_corners = (
        np.take_along_axis(body.columns, order, axis=1) + column_count * body.slab[:, None]
    )
    corners = np.hstack([lower_corners, lower_corners + column_count])[:, _PRISM].reshape(-1, 4)
    levels = int(body.slab.max()) + 2
    height = np.repeat(np.arange(levels, dtype=np.float64), column_count)
    reference_points = np.column_stack([np.tile(body.section, (levels, 1)), height])
    flipped = cell_volumes(reference_points, corners) < 0
    corners[flipped] = corners[flipped][:, [1, 0, 2, 3]]
    tetrahedra = number[corners]
    ordered = np.sort(tetrahedra, axis=1)
    kept_rows = np.flatnonzero((ordered[:, 1:] != ordered[:, :-1]).all(axis=1))
    return tetrahedra[kept_rows], kept_rows // 3


@dataclass(frozen=True)
class _Layers:
    """Division of the lines from stem to bone surface, at each line and station.

    Attributes:
        exact_thickness: Distance of the endosteum from the mantle, or without cement from the stem
            (lines, stations) [mm].
        floor: Least thickness of the layer within the endosteum [mm].
        merged: True where this layer has no thickness.
        rho: Layer coordinate of each column of a line (columns, lines, stations).
        representative: Column whose node is that of each column; another one where cells across
            are left out, or where a layer has no thickness.
    """

    exact_thickness: Floats
    floor: Floats
    merged: Bools
    rho: Floats
    representative: Ints

    @classmethod
    def of(cls, surfaces: LayeredSurfaces, per_line: int) -> _Layers:
        """The layers with a number of columns on each line."""
        levels = sum(segment.steps for segment in surfaces.segments) + 1
        shape = surfaces.around, levels
        turns, stations = np.arange(surfaces.around) / surfaces.around, np.arange(levels)
        phi, s = np.meshgrid(turns, stations.astype(float), indexing="ij")
        lines = surfaces.lines(phi.ravel(), s.ravel())
        endosteal_points = lines.start + lines.endosteum[:, None] * (lines.end - lines.start)
        exact_thickness = lines.exact_thickness.reshape(shape)
        floor = _floor(surfaces, endosteal_points.reshape(*shape, 3))
        merged = exact_thickness < floor
        # Below and above the mantle its first and its last section go on. Without cement the canal
        # is open below.
        first_section, last_section = surfaces.mantle_stations
        if surfaces.innermost == 1:
            merged[:, :first_section] = merged[:, first_section : first_section + 1]
        merged[:, last_section + 1 :] = merged[:, last_section : last_section + 1]
        thickness = np.where(merged, 0.0, np.maximum(exact_thickness, floor))
        length, endosteum = lines.length.reshape(shape), lines.endosteum.reshape(shape)
        widths = endosteum * length - thickness, thickness, (1 - endosteum) * length
        rho, representative = cls._divided(surfaces, widths[surfaces.innermost - 1 :], per_line)
        within_endosteum = (rho >= 2) & (rho < 3)
        representative[within_endosteum & merged] = sum(surfaces.through[:-1])
        return cls(exact_thickness, floor, merged, rho, representative)

    @staticmethod
    def _divided(
        surfaces: LayeredSurfaces, widths: Sequence[Floats], per_line: int
    ) -> tuple[Floats, Ints]:
        """Layer coordinates and representatives; fewer cells across where they would be flat.

        ``widths`` are those of the layers [mm], inside first.
        """
        shape = widths[0].shape
        first_section, last_section = surfaces.mantle_stations
        height_fraction = np.clip(
            (np.arange(shape[1]) - first_section) / (last_section - first_section), 0.0, 1.0 - 1e-9
        )
        most_cells: list[Floats | int] = [*surfaces.through]
        if surfaces.innermost == 1:
            most_cells[0] = np.floor(surfaces.cement + height_fraction)
        rho = np.full((per_line, *shape), float(surfaces.innermost))
        representative = np.zeros((per_line, *shape), dtype=np.int64)
        first_column = 0
        least_cells = surfaces.mesh.least_through[surfaces.innermost - 1 :]
        layers = zip(surfaces.through, widths, least_cells, most_cells, strict=True)
        for ring, (cells, width, least_cell, limit) in enumerate(layers, start=surfaces.innermost):
            across = np.clip(np.round(width / least_cell), 1, limit)
            for k in range(1, cells + 1):
                rho[first_column + k] = ring + np.minimum(k / across, 1.0)
                representative[first_column + k] = np.where(
                    k < across, first_column + k, first_column + cells
                )
            first_column += cells
        return rho, representative


def _grid(surfaces: LayeredSurfaces, body: ReferenceBody) -> tuple[Nodes, Ints]:
    """Nodes of all columns at all stations, and the number of the representative of each."""
    around, per_line, column_count = surfaces.around, len(body.rho), len(body.section)
    layers = _Layers.of(surfaces, per_line)
    levels = layers.exact_thickness.shape[1]
    station = np.repeat(np.arange(levels), column_count)
    line = np.concatenate(
        [np.repeat(np.arange(around), per_line), np.full(column_count - around * per_line, -1)]
    )
    line_of_node = np.tile(line, levels)
    column_of_node = np.tile(np.arange(column_count) % per_line, levels)
    in_core = line_of_node < 0
    rho = np.where(in_core, 0.0, layers.rho[column_of_node, line_of_node, station])
    merged, at = layers.merged, (line_of_node, station)
    nodes = Nodes(
        phi=2 * np.maximum(line_of_node, 0),
        rho=rho,
        s=2 * station,
        merged=~in_core & merged[at] & (rho >= 2) & (rho <= 3),
        error=np.where(in_core, 0.0, np.where(merged, -layers.exact_thickness, 0.0)[at]),
        floor=np.where(in_core, 0.0, np.where(merged, 0.0, layers.floor)[at]),
        thickness=np.zeros(len(line_of_node)),
        x=np.zeros((len(line_of_node), 3)),
    )
    nodes = _place(surfaces, nodes)
    x = nodes.x.reshape(levels, column_count, 3)
    x[:, around * per_line :] = np.round(
        body.weights @ x[:, : around * per_line : per_line], DIGITS_OF_NODES
    )
    number = np.arange(levels * column_count)
    number[~in_core] += (
        layers.representative[column_of_node, line_of_node, station] - column_of_node
    )[~in_core]
    return surfaces.place_end_nodes(nodes, number, body)


def _place(surfaces: LayeredSurfaces, nodes: Nodes) -> Nodes:
    """Put all nodes on lines onto the surfaces, or between them by their coordinates."""
    on_line = np.flatnonzero(nodes.rho > 0)
    half_steps = 2 * surfaces.around
    keys, line = np.unique(nodes.s[on_line] * half_steps + nodes.phi[on_line], return_inverse=True)
    lines = surfaces.lines((keys % half_steps) / half_steps, (keys // half_steps) / 2)
    start, end = lines.start[line], lines.end[line]
    bone, exact = lines.endosteum[line], lines.exact_thickness[line]
    merged, rho = nodes.merged[on_line], nodes.rho[on_line]
    thickness = np.maximum(exact + nodes.error[on_line], nodes.floor[on_line])
    thickness = np.where(merged, 0.0, thickness)
    mantle = bone - thickness / lines.length[line]
    if surfaces.innermost > 1:
        # The stem is exact: where they are one, the endosteum is its surface.
        bone, mantle = thickness / lines.length[line], np.zeros(len(on_line))
    fraction = np.where(
        rho <= 2,
        (rho - 1) * mantle,
        np.where(rho <= 3, mantle + (rho - 2) * (bone - mantle), bone + (rho - 3) * (1 - bone)),
    )
    fraction = np.where(merged, bone, fraction)
    x, error, used_thickness = nodes.x.copy(), nodes.error.copy(), nodes.thickness.copy()
    x[on_line] = start + fraction[:, None] * (end - start)
    error[on_line], used_thickness[on_line] = thickness - exact, thickness
    return replace(nodes, x=np.round(x, DIGITS_OF_NODES), error=error, thickness=used_thickness)


def _floor(surfaces: LayeredSurfaces, bone: Floats) -> Floats:
    """Least thickness of the layer within the endosteum, by line and station [mm]."""
    spacing = np.sqrt(((np.roll(bone, -1, axis=0) - bone) ** 2).sum(axis=2))
    spacing = np.maximum(spacing, np.roll(spacing, 1, axis=0))
    floor = FLOOR_RATIO * spacing
    # Sections that turn are farther apart on the lateral side: wedges there are longer.
    low, high = surfaces.mantle_stations
    steps = FLOOR_RATIO_ALONG * np.sqrt((np.diff(bone[:, low : high + 1], axis=1) ** 2).sum(axis=2))
    for stations in (np.s_[:, low:high], np.s_[:, low + 1 : high + 1]):
        floor[stations] = np.maximum(floor[stations], steps)
    return floor


def _packed(
    surfaces: LayeredSurfaces, nodes: Nodes, cells: Ints, region: Ints, names: tuple[str, ...]
) -> Swept:
    used_nodes, cells = np.unique(cells, return_inverse=True)
    cells = cells.reshape(-1, 4)
    nodes = Nodes(**{name: values[used_nodes] for name, values in vars(nodes).items()})
    return Swept(surfaces, nodes, cells, region, names)


def _with_moved_core_nodes(swept_mesh: Swept) -> Swept:
    """Return the mesh with poor cells improved by their nodes inside the innermost surface.

    A node on a facet or between regions stays.
    """
    nodes, cells = swept_mesh.nodes, swept_mesh.cells
    lowest_region = np.full(len(nodes), len(swept_mesh.names))
    highest_region = np.full(len(nodes), -1)
    np.minimum.at(lowest_region, cells, swept_mesh.region[:, None])
    np.maximum.at(highest_region, cells, swept_mesh.region[:, None])
    is_free = (nodes.rho == 0) & (lowest_region == highest_region)
    is_free[swept_mesh.facets[0]] = False
    return replace(
        swept_mesh, nodes=replace(nodes, x=relaxed_nodes(nodes.x, cells, is_free, DIGITS_OF_NODES))
    )


def _check(swept_mesh: Swept) -> None:
    """Raise PoorCellsError where straight cells are inverted or nearly flat."""
    numbers = {name: k for k, name in enumerate(swept_mesh.names)}
    x = swept_mesh.surfaces.to_model(swept_mesh.nodes.x)
    check(x, swept_mesh.cells, swept_mesh.region, numbers, ": layers cut through each other")


def _curved(swept_mesh: Swept) -> Swept:
    """Give each edge a middle node on the surfaces; cells that bend too far are straightened."""
    a, b = (swept_mesh.cells[:, k].ravel() for k in np.array(GMSH_TETRAHEDRON).T)
    n = len(swept_mesh.nodes)
    keys, middle_of_edge = np.unique(np.minimum(a, b) * n + np.maximum(a, b), return_inverse=True)
    middles = _middles(swept_mesh, keys // n, keys % n)
    nodes = Nodes(
        **{k: np.concatenate([v, vars(middles)[k]]) for k, v in vars(swept_mesh.nodes).items()}
    )
    cells = np.hstack([swept_mesh.cells, middle_of_edge.reshape(-1, 6) + n])
    x = untangle(nodes.x, cells, swept_mesh.surfaces.spared)
    return replace(swept_mesh, nodes=replace(nodes, x=x), cells=cells)


def _middles(swept_mesh: Swept, a: Ints, b: Ints) -> Nodes:
    """Nodes in the middle of edges between the nodes a and b (e,)."""
    nodes, half_steps = swept_mesh.nodes, 2 * swept_mesh.surfaces.around
    half_steps_apart = nodes.phi[b] - nodes.phi[a]
    half_steps_apart = (
        half_steps_apart + half_steps // 2
    ) % half_steps - half_steps // 2  # the short way around
    both_merged = nodes.merged[a] & nodes.merged[b]
    # A merged node is on mantle and endosteum. Its coordinate is that of the one, 2 or 3, that is
    # nearer to the other end of the edge.
    ends = [
        np.where(
            nodes.merged[this_end] & ~both_merged,
            np.clip(nodes.rho[other_end], 2, 3),
            nodes.rho[this_end],
        )
        for this_end, other_end in ((a, b), (b, a))
    ]
    is_inner = (nodes.rho[a] <= 0) | (nodes.rho[b] <= 0) | (np.abs(half_steps_apart) > 2)
    in_shell = is_inner & (np.minimum(np.abs(nodes.rho[a]), np.abs(nodes.rho[b])) >= 3)
    middle = Nodes(
        phi=np.where(is_inner, 0, (nodes.phi[a] + half_steps_apart // 2) % half_steps),
        rho=np.where(
            is_inner, np.where(in_shell, -3.0, 0.0), np.where(both_merged, 3.0, 0.5 * sum(ends))
        ),
        s=(nodes.s[a] + nodes.s[b]) // 2,
        merged=both_merged & ~is_inner,
        error=np.where(is_inner, 0.0, 0.5 * (nodes.error[a] + nodes.error[b])),
        floor=np.where(is_inner, 0.0, 0.5 * (nodes.floor[a] + nodes.floor[b])),
        thickness=np.zeros(len(a)),
        x=0.5 * (nodes.x[a] + nodes.x[b]),
    )
    tip = 2 * swept_mesh.surfaces.tip
    in_bowl = is_inner & ~in_shell & (nodes.s[a] == tip) & (nodes.s[b] == tip)
    heights = swept_mesh.surfaces.heights(middle.s[in_bowl] / 2)
    middle.x[in_bowl] = swept_mesh.surfaces.stem.draped(middle.x[in_bowl], heights)
    middle.x[in_shell] = swept_mesh.surfaces.arc(nodes.x[a[in_shell]], nodes.x[b[in_shell]])
    return _place(swept_mesh.surfaces, middle)
