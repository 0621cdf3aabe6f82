r"""Points of a strain gauge on the facets of a surface.

A gauge is a circle in the tangent plane at its centre, projected along the normal onto the surface.
Its points are Gauss points of rings, equally spaced around: with radius r and area
:math:`A = π R^2`,

.. math:: \frac1A \int_A f \, dA ≈ \sum_k w_k f(x_k), \qquad \sum_k w_k = 1 .

The normal is the mean of the normals of the facets at these points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints
from app.foundation.layout import two_digits
from meshes.data import tangents
from meshes.facets import foot
from meshes.shape_functions import (
    GMSH_TRIANGLE,
    STRAIGHT,
    Edges,
    coordinates_in_curved,
    shape_functions,
)

# Rings of points, and points on each ring.
RINGS = 8
AROUND = 32
# Largest angle between the normal of the gauge and that of the surface below it [deg].
LARGEST_BEND = 60.0
# Largest angle between the direction of the grid and the tangent plane [deg].
LARGEST_TILT = 60.0
# Rounding of barycentric coordinates.
ROUNDING_OF_BARYCENTRIC = 1e-9
# Points this far outside the flat triangle of a curved facet may lie in the facet.
OUTSIDE_FLAT_TRIANGLE = 0.5
# Improvements of the normal by the facets below the circle.
IMPROVEMENTS = 2


@dataclass(frozen=True)
class GaugePoints:
    """Points of a gauge.

    Attributes:
        centre: Its centre (3,) [mm].
        normal: Unit normal of its tangent plane (3,).
        direction: Unit vector of its grid in the tangent plane (3,).
        distance: Distance of its centre from the point that was given [mm].
        facet: Facet of each point (n,).
        barycentric: Barycentric coordinates in the facet (n, 3).
        weight: Weights, whose sum is 1 (n,).
    """

    centre: Floats
    normal: Floats
    direction: Floats
    distance: float
    facet: Ints
    barycentric: Floats
    weight: Floats


class GaugeFault(ValueError):
    """A gauge that does not fit its surface.

    Attributes:
        key: Key of the gauge that is wrong.
        remedy: Values that are allowed.
    """

    def __init__(self, key: str, message: str, remedy: str) -> None:
        super().__init__(message)
        self.key, self.remedy = key, remedy


@dataclass(frozen=True)
class _Hits:
    """Points of a surface on parallel lines, one for each line; facet -1 where there is none.

    Attributes:
        facet: Facet of each (n,).
        barycentric: Barycentric coordinates in it (n, 3).
        height: Position along the line [mm] (n,).
    """

    facet: Ints
    barycentric: Floats
    height: Floats


def gauge_points(
    x: Floats,
    at: Sequence[float],
    towards: Sequence[float] | None,
    direction: Sequence[float],
    diameter: float,
) -> GaugePoints:
    """Place a gauge on facets.

    Args:
        x: Nodes of the facets in gmsh's order (f, 3 or 6, 3) [mm].
        at: Point near the surface, or on the line of sight (3,) [mm].
        towards: Direction of the line of sight (3,); None for the nearest point of the surface.
        direction: Direction of the grid (3,).
        diameter: Diameter of the circle [mm].

    Raises:
        GaugeFault: The line of sight misses the surface, the direction is along the normal, or the
            circle leaves the surface.
    """
    given_point = np.asarray(at, dtype=float)
    if towards is None:
        facet, barycentric = _nearest(x, given_point)
    else:
        facet, barycentric = _last_hit(x, given_point, np.asarray(towards, dtype=float))
    centre = _places(x[facet], barycentric)
    normal = _normals(x[[facet]], barycentric[None])[0]
    radius, angle, weight = _points_of_circle(diameter / 2)
    for _ in range(IMPROVEMENTS + 1):
        grid = _grid(direction, normal)
        across = np.cross(normal, grid)
        plane = radius * np.cos(angle), radius * np.sin(angle)
        points = centre + np.outer(plane[0], grid) + np.outer(plane[1], across)
        hits = _projected(x, points, normal, diameter)
        is_covered = hits.facet >= 0
        normals = np.zeros((len(points), 3))
        normals[is_covered] = _normals(x[hits.facet[is_covered]], hits.barycentric[is_covered])
        slope = normals @ normal
        normals *= np.sign(slope)[:, None]
        mean = weight @ normals
        is_allowed = is_covered & (np.abs(slope) >= np.cos(np.radians(LARGEST_BEND)))
        if not is_allowed.all():
            raise _circle_fault(radius, is_covered, is_allowed, centre)
        normal = mean / np.linalg.norm(mean)
    distance = float(np.linalg.norm(centre - given_point)) if towards is None else 0.0
    return GaugePoints(centre, normal, grid, distance, hits.facet, hits.barycentric, weight)


def _grid(direction: Sequence[float], normal: Floats) -> Floats:
    """Unit vector of a direction in the plane across a normal.

    Raises:
        GaugeFault: It is about the normal.
    """
    unit = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    in_plane = unit - (unit @ normal) * normal
    size = float(np.linalg.norm(in_plane))
    if size < np.cos(np.radians(LARGEST_TILT)):
        angle = np.degrees(np.arccos(min(size, 1.0)))
        nx, ny, nz = normal + 0.0
        message = f"is {angle:.0f} degrees out of the surface, whose normal is "
        message += f"[{nx:.2f}, {ny:.2f}, {nz:.2f}]"
        raise GaugeFault("direction", message, f"expected at most {LARGEST_TILT:g} degrees")
    return np.asarray(in_plane / size)


def _points_of_circle(largest: float) -> tuple[Floats, Floats, Floats]:
    """Radius [mm], angle [rad] and weight of the points of a circle (n,)."""
    # Rings of equal area have equal steps of the radius squared.
    points, weights = np.polynomial.legendre.leggauss(RINGS)
    radius = largest * np.sqrt((points + 1) / 2)
    angle = 2 * np.pi * (np.arange(AROUND) + 0.5) / AROUND
    return (
        np.repeat(radius, AROUND),
        np.tile(angle, RINGS),
        np.repeat(weights / (2 * AROUND), AROUND),
    )


def _circle_fault(
    radius: Floats, is_covered: Bools, is_allowed: Bools, centre: Floats
) -> GaugeFault:
    """Error on a circle that is not on the surface, with the largest that is."""
    location = ", ".join(f"{c:.4g}" for c in centre + 0.0)
    if is_covered.all():
        message = (
            f"the surface bends by more than {LARGEST_BEND:g} degrees below a circle"
            f" at [{location}] mm"
        )
    else:
        missing_percent = 100 * (1 - is_covered.mean())
        message = (
            f"{missing_percent:.0f} % of the circle at [{location}] mm is beyond the edge"
            " of the surface"
        )
    rings = np.unique(radius)
    inside = rings[rings < radius[~is_allowed].min() * (1 - ROUNDING_OF_BARYCENTRIC)]
    if len(inside):
        remedy = f"expected at most about {two_digits(2 * inside.max())} mm there, or another place"
    else:
        remedy = "expected another place"
    return GaugeFault("diameter", message, remedy)


def _places(x: Floats, barycentric: Floats) -> Floats:
    """Position of a point in a facet (3 or 6, 3) [mm]."""
    return np.asarray(shape_functions(barycentric[None], _edges(x))[0] @ x)


def _edges(x: Floats) -> Edges:
    """Edges with a middle node of facets (..., 3 or 6, 3), in gmsh's order."""
    return GMSH_TRIANGLE if x.shape[-2] == 6 else STRAIGHT


def _tangents(x: Floats, barycentric: Floats) -> tuple[Floats, Floats]:
    """Derivatives of the position with respect to the second and third coordinate (n, 3)."""
    if x.shape[1] == 3:
        return x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
    # Each facet has a separate point.
    pairs = [tangents(x[[k]], barycentric[[k]], GMSH_TRIANGLE)[:, :, 0, 0] for k in range(len(x))]
    pair_tangents = np.array(pairs).reshape(-1, 2, 3)
    return pair_tangents[:, 0], pair_tangents[:, 1]


def _normals(x: Floats, barycentric: Floats) -> Floats:
    """Unit normals (n, 3) of facets (n, 3 or 6, 3) at points."""
    normal = np.cross(*_tangents(x, barycentric))
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def _projected(x: Floats, points: Floats, normal: Floats, diameter: float) -> _Hits:
    """Nearest points of the surface on the lines through points (n, 3) along a normal."""
    middle = x[:, :3].mean(axis=1)
    size = np.linalg.norm(x[:, :3] - middle[:, None], axis=2).max(axis=1)
    distances = np.linalg.norm(middle - points.mean(axis=0), axis=1)
    rows = np.flatnonzero(distances <= size + 1.5 * diameter)
    hits = _on_lines(x[rows], points, normal)
    facet = np.full(len(points), -1, dtype=np.int64)
    barycentric = np.zeros((len(points), 3))
    height = np.full(len(points), np.inf)
    for line, row, coordinates, line_height in hits:
        # A point on the edge of two facets belongs to the first of them.
        if (
            abs(line_height) <= diameter
            and abs(line_height) < abs(height[line]) - ROUNDING_OF_BARYCENTRIC * diameter
        ):
            facet[line], barycentric[line], height[line] = rows[row], coordinates, line_height
    return _Hits(facet, barycentric, height)


def _on_lines(x: Floats, points: Floats, axis: Floats) -> list[tuple[int, int, Floats, float]]:
    """All points of facets on lines through points (n, 3) along an axis.

    Returns:
        Line, facet, barycentric coordinates (3,) and height along the axis [mm] of each.
    """
    plane = np.linalg.svd(axis[None])[2][1:]
    plane_nodes = x @ plane.T
    plane_points = points @ plane.T
    a, b, c = plane_nodes[:, 0], plane_nodes[:, 1], plane_nodes[:, 2]
    edge = np.stack([b - a, c - a], axis=2)
    # Facets seen from the edge have no points on a line.
    area = np.abs(np.linalg.det(edge))
    longest = np.linalg.norm(x[:, 1:3] - x[:, :1], axis=2).max(axis=1)
    visible = np.flatnonzero(area > ROUNDING_OF_BARYCENTRIC * longest**2)
    inverse = np.linalg.inv(edge[visible])
    inner_coordinates = np.einsum("fij,nfj->nfi", inverse, plane_points[:, None] - a[visible])
    coordinates = np.concatenate(
        [1 - inner_coordinates.sum(axis=2, keepdims=True), inner_coordinates], axis=2
    )
    margin = ROUNDING_OF_BARYCENTRIC if x.shape[1] == 3 else OUTSIDE_FLAT_TRIANGLE
    line, facet = np.nonzero(coordinates.min(axis=2) >= -margin)
    barycentric = coordinates[line, facet]
    facet = visible[facet]
    if x.shape[1] == 6:
        barycentric = _in_curved(plane_nodes[facet], plane_points[line], barycentric)
        inside = np.flatnonzero(barycentric.min(axis=1) >= -ROUNDING_OF_BARYCENTRIC)
        line, facet, barycentric = line[inside], facet[inside], barycentric[inside]
    barycentric = np.maximum(barycentric, 0.0)
    barycentric /= barycentric.sum(axis=1, keepdims=True)
    position = np.einsum("nk,nkc->nc", shape_functions(barycentric, _edges(x)), x[facet])
    height = (position - points[line]) @ axis
    return [
        (int(line_number), int(facet_number), point_coordinates, float(point_height))
        for line_number, facet_number, point_coordinates, point_height in zip(
            line, facet, barycentric, height, strict=True
        )
    ]


def _in_curved(plane_nodes: Floats, plane_points: Floats, barycentric: Floats) -> Floats:
    """Coordinates (n, 3) in curved facets, seen in a plane (n, 6, 2), of points there (n, 2)."""
    barycentric = coordinates_in_curved(plane_points, plane_nodes, barycentric, GMSH_TRIANGLE)
    residual = plane_points - np.einsum(
        "nk,nkc->nc", shape_functions(barycentric, GMSH_TRIANGLE), plane_nodes
    )
    size = np.abs(plane_nodes - plane_nodes[:, :1]).max(axis=(1, 2))
    missed = np.abs(residual).max(axis=1, initial=0.0) > 1e-8 * size
    barycentric[missed] = -1.0
    return barycentric


def _nearest(x: Floats, point: Floats) -> tuple[int, Floats]:
    """Facet with the nearest point of its flat triangle to a point, and its coordinates (3,)."""
    corners = x[:, :3]
    barycentric = foot(np.broadcast_to(point, (len(x), 3)), corners)
    feet = np.einsum("fk,fkc->fc", barycentric, corners)
    facet = int(np.argmin(np.round(np.linalg.norm(feet - point, axis=1), 9)))
    return facet, barycentric[facet]


def _last_hit(x: Floats, point: Floats, towards: Floats) -> tuple[int, Floats]:
    """Facet and coordinates (3,) at which a line of sight leaves a surface for the last time.

    Raises:
        GaugeFault: It does not meet the surface.
    """
    axis = towards / np.linalg.norm(towards)
    ahead = [hit for hit in _on_lines(x, point[None], axis) if hit[3] >= 0]
    if not ahead:
        lowest_corner, highest_corner = (
            ", ".join(f"{c:.4g}" for c in extreme(x.reshape(-1, 3), axis=0) + 0.0)
            for extreme in (np.min, np.max)
        )
        message = "the line of sight from `at` does not meet the surface"
        raise GaugeFault(
            "towards", message, f"the surface fills [{lowest_corner}] to [{highest_corner}] mm"
        )
    last_height = max(hit[3] for hit in ahead)
    _, facet, barycentric, _ = next(
        hit for hit in ahead if hit[3] >= last_height - ROUNDING_OF_BARYCENTRIC * (1 + last_height)
    )
    return facet, barycentric
