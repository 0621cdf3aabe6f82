"""Points of a path in a mesh: on a line, on a circle, or where a plane cuts a surface.

Each point has its cell and the coordinates in it, so that every rank evaluates the same points by
the same shape functions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints
from meshes.data import (
    MeshData,
    faces_of,
    interface_facets,
)
from meshes.location import cells_of_points, positions_in_cells
from meshes.shape_functions import GMSH_TRIANGLE, node_coordinates

# Parts of a facet with six nodes, by these.
QUARTERS = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
# Barycentric coordinates of the nodes of a facet with six nodes.
NODES = node_coordinates(3, GMSH_TRIANGLE)
# Shift of a plane through nodes, as a fraction of the surface's extent: it cuts edges, not nodes.
SHIFT = 1e-7
# Segments shorter than this fraction of their curve are left out.
SHORTEST_SEGMENT = 1e-9


@dataclass(frozen=True)
class PathPoints:
    """Points of a path in the cells of a mesh.

    Attributes:
        arc: Distance along the path from its first point (n,) [mm].
        x: Positions (n, 3) [mm].
        cell: Row of the cell in `MeshData`, -1 for a point outside (n,).
        barycentric: Barycentric coordinates in the reference cell (n, 4).
        region: Tag of the region of the cell, 0 outside (n,).
    """

    arc: Floats
    x: Floats
    cell: Ints
    barycentric: Floats
    region: Ints

    @property
    def outside(self) -> float:
        """Part of the points outside."""
        return float((self.cell < 0).mean())


@dataclass(frozen=True)
class Facets:
    """Facets of a surface, as faces of cells on one side of it.

    Attributes:
        nodes: Nodes (k, 3 or 6).
        cells: Rows of the cells (k,).
    """

    nodes: Ints
    cells: Ints


def on_line(
    data: MeshData, region: str, start: Sequence[float], end: Sequence[float], n: int
) -> PathPoints:
    """N points at equal distances on a straight line, from start to end [mm].

    The cells that hold them are those of a region, or of every region if it is empty.
    """
    fraction = np.linspace(0.0, 1.0, n)
    start_point, end_point = np.array(start), np.array(end)
    arc = fraction * np.linalg.norm(end_point - start_point)
    return _inside(data, region, arc, start_point + fraction[:, None] * (end_point - start_point))


def on_circle(
    data: MeshData,
    region: str,
    centre: Sequence[float],
    axis: Sequence[float],
    radius: float,
    n: int,
) -> PathPoints:
    """N points on a circle, counterclockwise about its axis; the last is the first.

    The first point lies towards x from the centre, or towards y if the axis is x.
    """
    unit_axis = np.array(axis) / np.linalg.norm(axis)
    start_axis = np.eye(3)[0 if np.abs(unit_axis[0]) < 1 - 1e-9 else 1]
    first_direction = start_axis - (start_axis @ unit_axis) * unit_axis
    first_direction /= np.linalg.norm(first_direction)
    angle = np.linspace(0.0, 2 * np.pi, n)
    x = np.outer(np.cos(angle), first_direction) + np.outer(
        np.sin(angle), np.cross(unit_axis, first_direction)
    )
    return _inside(data, region, radius * angle, np.array(centre) + radius * x)


def _inside(data: MeshData, region: str, arc: Floats, x: Floats) -> PathPoints:
    """Points with the cells that hold them."""
    in_region = data.cell_tags == data.regions[region] if region else data.cell_tags > 0
    allowed = np.flatnonzero(in_region)
    places = cells_of_points(data.points, data.cells[allowed], x)
    is_inside = places.cell >= 0
    cell = np.where(is_inside, allowed[places.cell], -1)
    tags = np.where(is_inside, data.cell_tags[cell], 0).astype(np.int64)
    return PathPoints(arc, x, cell, places.barycentric, tags)


# Surfaces


def facets_of_interface(
    data: MeshData, name: str, region: str, boundaries: tuple[str, str] | None
) -> Facets:
    """Facets of an interface, in the cells of a region, or of its first side if region is empty.

    Of an interface that is meshed apart, with two boundaries, they are those of the second one.
    """
    if boundaries:
        on_boundary = np.isin(data.facet_tags, data.boundaries.get(boundaries[1], ()))
        facets = Facets(data.facets[on_boundary], data.faces_of_facets[on_boundary] // 4)
    else:
        nodes, first, second = interface_facets(data, name)
        sides = data.interfaces[name]
        facets = Facets(nodes, second if region in sides[1] else first)
    if not region:
        return facets
    in_region = data.cell_tags[facets.cells] == data.regions[region]
    return Facets(facets.nodes[in_region], facets.cells[in_region])


def facets_of_region(data: MeshData, region: str) -> Facets:
    """Facets of the whole surface of a region."""
    tag = data.regions[region]
    behind = data.neighbours
    is_border = (behind < 0) | (data.cell_tags[behind] != tag)
    cell, face = np.nonzero(is_border & (data.cell_tags == tag)[:, None])
    return Facets(faces_of(data.cells, cell, face), cell)


# Curves in which a plane cuts a surface


def on_section(data: MeshData, facets: Facets, z: float, n: int) -> PathPoints:
    """N points at equal distances on the curve in which a plane at a height cuts a surface.

    Of several curves it is the longest. A closed one begins towards x of its centroid (medial in a
    hip), turns towards y (anterior), and its last point is its first.
    """
    curve = _cut(data, facets, data.points[:, 2] - z, None)
    if curve is None:
        return _no_points()
    x = curve.ends(data)[:, :2]
    twice_area = np.sum(x[:-1, 0] * x[1:, 1] - x[:-1, 1] * x[1:, 0])
    if twice_area < 0:
        curve, x = curve.reversed(), x[::-1]
    start_arc = _towards_x(x) if curve.closed else 0.0
    return curve.sampled(data, n, start_arc)


def _towards_x(x: Floats) -> float:
    """Distance along a closed polygon (n, 2) at which it passes the ray from its centroid to x."""
    length = np.linalg.norm(np.diff(x, axis=0), axis=1)
    x = x - length @ (x[1:] + x[:-1]) / 2 / length.sum()
    a, b = x[:-1], x[1:]
    crossing = np.flatnonzero((a[:, 1] < 0) & (b[:, 1] >= 0))
    fraction = a[crossing, 1] / (a[crossing, 1] - b[crossing, 1])
    crossing_x = a[crossing, 0] + fraction * (b[crossing, 0] - a[crossing, 0])
    if not len(crossing) or crossing_x.max() <= 0:
        return 0.0
    k = int(np.argmax(crossing_x))
    return float(length[: crossing[k]].sum() + fraction[k] * length[crossing[k]])


def on_side(data: MeshData, facets: Facets, local: Floats, angle: float, n: int) -> PathPoints:
    """N points at equal distances on a surface around an axis, from its lower to its upper end.

    They lie in the half-plane from the axis at an angle from x to y [rad]. Of several curves it is
    the longest. The axis is z of the local positions of the nodes (k, 3) [mm].
    """
    direction = np.array([np.cos(angle), np.sin(angle)])
    across = local[:, :2] @ np.array([-direction[1], direction[0]])
    curve = _cut(data, facets, across, local[:, :2] @ direction)
    if curve is None:
        return _no_points()
    ends = curve.height(local)
    return (curve.reversed() if ends[0] > ends[-1] else curve).sampled(data, n)


def _no_points() -> PathPoints:
    """A path that meets no surface."""
    no_rows: Ints = np.zeros(0, dtype=np.int64)
    return PathPoints(np.zeros(0), np.zeros((0, 3)), no_rows, np.zeros((0, 4)), no_rows)


@dataclass(frozen=True)
class _Curve:
    """A chain of segments on facets.

    Attributes:
        facets: Nodes of the facet of each segment (s, 3 or 6).
        cells: Its cell (s,).
        start: Barycentric coordinates in the facet of the start of each segment (s, 3).
        end: Those of its end (s, 3).
        closed: True if the last segment ends where the first begins.
    """

    facets: Ints
    cells: Ints
    start: Floats
    end: Floats
    closed: bool

    def barycentric_in_cells(
        self, data: MeshData, segment: Ints, facet_coordinates: Floats
    ) -> Floats:
        """Coordinates (n, 4) in the cells of segments (n,) from those in their facets (n, 3)."""
        corners = data.cells[self.cells[segment], :4]
        is_same_node = corners[:, :, None] == self.facets[segment, None, :3]
        return np.asarray(np.einsum("nij,nj->ni", is_same_node, facet_coordinates))

    def places(self, data: MeshData, segment: Ints, facet_coordinates: Floats) -> Floats:
        """Positions (n, 3) [mm] of points in facets."""
        cells = data.cells[self.cells[segment]]
        return positions_in_cells(
            data.points, cells, self.barycentric_in_cells(data, segment, facet_coordinates)
        )

    def ends(self, data: MeshData) -> Floats:
        """Positions of the starts of all segments and of the last end (s + 1, 3) [mm]."""
        segments = np.arange(len(self.cells))
        starts = self.places(data, segments, self.start)
        return np.vstack([starts, self.places(data, segments[-1:], self.end[-1:])])

    def height(self, local: Floats) -> Floats:
        """Height of start and end of the curve (2,), from nodes in other axes (k, 3) [mm]."""
        start_height = self.start[0] @ local[self.facets[0, :3], 2]
        return np.array([start_height, self.end[-1] @ local[self.facets[-1, :3], 2]])

    def reversed(self) -> _Curve:
        """The same curve from its end to its start."""
        backwards = slice(None, None, -1)
        return _Curve(
            self.facets[backwards],
            self.cells[backwards],
            self.end[backwards],
            self.start[backwards],
            self.closed,
        )

    def sampled(self, data: MeshData, n: int, start_arc: float = 0.0) -> PathPoints:
        """N points at equal distances along the curve; a closed one begins at a distance [mm]."""
        corners = self.ends(data)
        length = np.linalg.norm(np.diff(corners, axis=0), axis=1)
        corner_arc = np.concatenate([[0.0], np.cumsum(length)])
        arc = np.linspace(0.0, corner_arc[-1], n)
        curve_arc = np.mod(start_arc + arc, corner_arc[-1]) if start_arc else arc
        segment = np.clip(
            np.searchsorted(corner_arc, curve_arc, side="right") - 1, 0, len(length) - 1
        )
        fraction = ((curve_arc - corner_arc[segment]) / length[segment])[:, None]
        facet_coordinates = self.start[segment] + fraction * (
            self.end[segment] - self.start[segment]
        )
        cell = self.cells[segment]
        return PathPoints(
            arc,
            self.places(data, segment, facet_coordinates),
            cell,
            self.barycentric_in_cells(data, segment, facet_coordinates),
            data.cell_tags[cell].astype(np.int64),
        )


def _cut(
    data: MeshData, facets: Facets, level: Floats, side_values: Floats | None
) -> _Curve | None:
    """Longest curve on facets at which a level is zero; None without any.

    The level has values at the nodes of the mesh (k,), and is linear on facets or on a quarter of
    each. The curve is cut off where the values `side_values` (k,) are negative.
    """
    if not len(facets.nodes):
        return None
    extent = float(np.ptp(level[facets.nodes])) or 1.0
    for shift in (SHIFT, -SHIFT):
        curve = _chain(data, facets, level, level + shift * extent >= 0, side_values)
        if curve is not None:
            return curve
    return None


def _chain(
    data: MeshData, facets: Facets, level: Floats, above: Bools, side_values: Floats | None
) -> _Curve | None:
    """Longest chain of the segments in which a surface passes from above to below."""
    quarters = QUARTERS if facets.nodes.shape[1] == 6 else np.array([[0, 1, 2]])
    facet = np.repeat(np.arange(len(facets.nodes)), len(quarters))
    local_nodes = np.tile(quarters, (len(facets.nodes), 1))
    corners = facets.nodes[facet[:, None], local_nodes]
    count = above[corners].sum(axis=1)
    is_crossed = (count == 1) | (count == 2)
    facet, local_nodes, corners, count = (
        facet[is_crossed],
        local_nodes[is_crossed],
        corners[is_crossed],
        count[is_crossed],
    )
    # The corner that is alone on its side: both edges at it are cut.
    lone_corner = np.argmax(above[corners] == (count == 1)[:, None], axis=1)
    rows = np.arange(len(facet))
    keys: list[Ints] = []
    edge_points: list[Floats] = []
    values: list[Floats] = []
    for other_corner in ((lone_corner + 1) % 3, (lone_corner + 2) % 3):
        a, b = corners[rows, lone_corner], corners[rows, other_corner]
        # From the lesser node, so that both facets of an edge compute the same point.
        lower_node, higher_node = np.minimum(a, b), np.maximum(a, b)
        node_fraction = np.clip(
            level[lower_node] / (level[lower_node] - level[higher_node]), 0.0, 1.0
        )
        lone_point = NODES[local_nodes[rows, lone_corner]]
        other_point = NODES[local_nodes[rows, other_corner]]
        fraction = np.where(a == lower_node, node_fraction, 1.0 - node_fraction)[:, None]
        edge_points.append(lone_point + fraction * (other_point - lone_point))
        keys.append(lower_node * len(level) + higher_node)
        if side_values is not None:
            values.append(
                side_values[lower_node]
                + node_fraction * (side_values[higher_node] - side_values[lower_node])
            )
    start, end = edge_points
    if side_values is not None:
        start, end = _cut_off(start, end, *values)
        is_kept = np.maximum(*values) > 0
        start, end, facet = start[is_kept], end[is_kept], facet[is_kept]
        keys = [k[is_kept] for k in keys]
    x = data.points[facets.nodes[facet, :3]]
    length = np.linalg.norm(np.einsum("sc,sci->si", end - start, x), axis=1)
    order, flipped, closed = _longest(np.column_stack(keys), length)
    if not len(order):
        return None
    flip = np.array(flipped)[:, None]
    first_ends, last_ends = start[order], end[order]
    return _Curve(
        facets.nodes[facet[order]],
        facets.cells[facet[order]],
        np.where(flip, last_ends, first_ends),
        np.where(flip, first_ends, last_ends),
        closed,
    )


def _cut_off(
    start: Floats, end: Floats, start_value: Floats, end_value: Floats
) -> tuple[Floats, Floats]:
    """Ends of segments (s, 3), moved to where a linear value is zero if it is negative there.

    Segments with negative values at both ends have no meaning afterwards.
    """
    step = np.where(start_value == end_value, 1.0, end_value - start_value)
    zero = start + (-start_value / step)[:, None] * (end - start)
    return (
        np.where((start_value < 0)[:, None], zero, start),
        np.where((end_value < 0)[:, None], zero, end),
    )


def _longest(ends: Ints, length: Floats) -> tuple[list[int], list[bool], bool]:
    """Longest chain of segments.

    Args:
        ends: Keys of both ends of each segment (s, 2).
        length: Length of each segment (s,).

    Returns:
        Segments in order without those of no length, True for each that runs from its second end
        to its first, and True if the chain is closed.
    """
    pairs = [(int(a), int(b)) for a, b in ends]
    segments_at: dict[int, list[int]] = {}
    for k, pair in enumerate(pairs):
        for key in pair:
            segments_at.setdefault(key, []).append(k)
    unused = set(range(len(pairs)))
    # Open chains begin at a key of one segment.
    open_ends = [
        k for k, pair in enumerate(pairs) if any(len(segments_at[key]) == 1 for key in pair)
    ]
    best_chain: tuple[list[int], list[bool], bool] = ([], [], False)
    longest = 0.0
    for first_segment in [*open_ends, *range(len(pairs))]:
        if first_segment not in unused:
            continue
        flip = (
            len(segments_at[pairs[first_segment][0]]) > 1
            and len(segments_at[pairs[first_segment][1]]) == 1
        )
        origin, order, flipped = pairs[first_segment][int(flip)], [first_segment], [flip]
        unused.remove(first_segment)
        key = pairs[first_segment][1 - int(flip)]
        while True:
            following = next((k for k in segments_at[key] if k in unused), None)
            if following is None:
                break
            unused.remove(following)
            flip = pairs[following][0] != key
            order.append(following)
            flipped.append(flip)
            key = pairs[following][1 - int(flip)]
        total = float(length[order].sum())
        if total > longest:
            longest = total
            long_rows = [
                k for k in range(len(order)) if length[order[k]] > SHORTEST_SEGMENT * total
            ]
            best_chain = (
                [order[k] for k in long_rows],
                [flipped[k] for k in long_rows],
                key == origin,
            )
    return best_chain
