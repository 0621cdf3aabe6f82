r"""Normals of the smooth surface that straight facets approximate.

The mean normal of the facets around a node is off by some hundredths, also along the axis of a
cylinder or a cone. Bodies that slide along this axis then climb their facets. Here a node has the
normal of a surface through it that is fitted to the nodes near it. With a, b the coordinates of a
near node along two tangents and h that along the mean normal, relative to the node,

.. math:: h = c_1 a + c_2 b + c_3 a^2 + c_4 \sqrt2 a b + c_5 b^2 + c_6 a h + c_7 b h + c_8 h^2

describes any quadric, so normals of planes, spheres, cylinders and cones are exact to rounding.
There are three models: the mean normal, the paraboloid with the first five terms, and the quadric.
The model whose slopes :math:`(c_1, c_2)` have the smallest standard error is used, so that a rough
surface keeps its mean normals. This standard error is that of the normal.

If the facets around a node lie in one plane, their normal is kept. A fit is rejected if it rotates
the normal by more than the normals nearby differ.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints, unit_vectors

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

# Number of rings of facets around a node. A surface is fitted to the nodes of these facets.
RINGS = 2
# Least number of nodes to which a surface is fitted.
NODES_NEAR = 10
# Largest number of rings that are added to reach this number of nodes.
MORE_RINGS = 3
# Number of coefficients of the models: plane, paraboloid, quadric.
MODELS = (2, 5, 8)
# Least number of nodes beyond the number of coefficients.
SPARE_NODES = 2
# A model with more coefficients needs less than this fraction of the standard error of another one.
ERROR_RATIO = 0.25
# Normals that differ by less are equal [rad].
FLAT_ANGLE = 1e-6
# A slope is a likely error up to this multiple of the standard error of normals.
LIKELY_MULTIPLE = 3.0
# A larger slope is no error [rad].
LARGEST_SLOPE = 0.01
# Slopes below this are rounding errors [rad].
ROUNDING_OF_SLOPES = 1e-12
# Largest number of steps until slopes are rounding errors.
MOST_STEPS = 20
# Singular values below this fraction of the largest are zero.
SINGULAR = 1e-10


@dataclass(frozen=True)
class SmoothNormals:
    """Normals of a smooth surface at n nodes.

    Attributes:
        normal: Unit normals (n, 3).
        error: Standard error of their direction (n,) [rad].
    """

    normal: Floats
    error: Floats


def smooth_normals(x: Floats, corners: Ints, normals: Floats, areas: Floats) -> SmoothNormals:
    """Return the normals of smooth surfaces at the nodes of straight facets.

    Args:
        x: Nodes (n, 3) [mm]. A node on an edge is one node for each of its smooth faces.
        corners: Nodes of the facets (f, 3).
        normals: Unit normals of the facets at their corners (f, 3, 3).
        areas: Weights of the corners in the mean (f, 3).
    """
    mean = unit_sums(normals, areas, corners, len(x))
    # Largest angle between the mean at a node and the normals of the facets around it.
    spread = np.zeros(len(x))
    np.maximum.at(spread, corners, _angle(normals, mean[corners]))
    if (spread < FLAT_ANGLE).all():
        return SmoothNormals(mean, np.zeros(len(x)))
    joined_nodes = _joined(corners, len(x))
    # Bound of the same angle for facets around the neighbours.
    spread_nearby = spread.copy()
    node, neighbour = joined_nodes.nonzero()
    np.maximum.at(spread_nearby, node, _angle(mean[node], mean[neighbour]) + spread[neighbour])
    # A node inside the surface has as many neighbours as facets.
    neighbour_count = np.diff(joined_nodes.indptr) - 1
    is_inside = neighbour_count == np.bincount(corners.ravel(), minlength=len(x))
    is_flat = (spread < FLAT_ANGLE) & (is_inside | (spread_nearby < FLAT_ANGLE))
    fitted, error = mean.copy(), np.where(is_flat, 0.0, spread)
    rows = np.flatnonzero(~is_flat)
    if len(rows):
        fitted[rows], error[rows] = _fitted(
            x, mean, spread_nearby, error, rows, _nodes_near(joined_nodes, rows)
        )
    return SmoothNormals(fitted, error)


def unit_sums(vectors: Floats, weights: Floats, corners: Ints, node_count: int) -> Floats:
    """Directions of the weighted sums of vectors at nodes (n, 3).

    Args:
        vectors: Vectors at the corners of facets (f, 3, 3).
        weights: Weights of the corners (f, 3).
        corners: Nodes of the corners (f, 3).
        node_count: Number of nodes.
    """
    sums = np.zeros((node_count, 3))
    np.add.at(sums, corners, weights[:, :, None] * vectors)
    return unit_vectors(sums)


def _angle(a: Floats, b: Floats) -> Floats:
    """Return the angles between unit vectors (..., 3), exact if they are small [rad]."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1)))


def _joined(corners: Ints, node_count: int) -> csr_matrix:
    """Matrix (n, n) of ones for nodes that share a facet, with the diagonal."""
    from scipy.sparse import csr_matrix  # imported late: plane interfaces need no scipy

    rows = np.repeat(corners, 3, axis=1).ravel()
    columns = np.tile(corners, (1, 3)).ravel()
    shape = node_count, node_count
    pattern = csr_matrix((np.ones(len(rows)), (rows, columns)), shape=shape)
    pattern.data[:] = 1.0
    return pattern


def _nodes_near(joined: csr_matrix, rows: Ints) -> Ints:
    """Nodes near the nodes ``rows`` (m, k). The node itself fills the rest of its row."""
    pattern = joined[rows]
    for ring in range(1, RINGS + MORE_RINGS):
        needs_more = np.ones(len(rows)) if ring < RINGS else np.diff(pattern.indptr) <= NODES_NEAR
        if not needs_more.any():
            break
        pattern = pattern + pattern.multiply(needs_more[:, None]).tocsr() @ joined
        pattern.data[:] = 1.0
    pattern = pattern.tocsr()
    pattern.sort_indices()
    count = np.diff(pattern.indptr)
    row = np.repeat(np.arange(len(rows)), count)
    near_nodes = np.tile(rows[:, None], (1, int(count.max())))
    near_nodes[row, np.arange(pattern.nnz) - pattern.indptr[row]] = pattern.indices
    return near_nodes


def _fitted(
    x: Floats, mean: Floats, spread_nearby: Floats, mean_error: Floats, rows: Ints, near_nodes: Ints
) -> tuple[Floats, Floats]:
    """Normals of the nodes ``rows`` by the best model (m, 3), and their standard errors (m,) [rad].

    Args:
        x: All nodes (n, 3) [mm].
        mean: Mean normals of all nodes (n, 3).
        spread_nearby: Largest angle to normals nearby (n,) [rad].
        mean_error: Error of a normal that no model can give (n,) [rad].
        rows: Nodes (m,).
        near_nodes: Nodes near each of them (m, k).
    """
    n, tangents = mean[rows], np.linalg.svd(mean[rows, None])[2][:, 1:]
    offsets = x[near_nodes] - x[rows, None]
    distance = np.linalg.norm(offsets, axis=2)
    # Coordinates relative to the largest distance, so that all models are of order one.
    size = distance.max(axis=1, keepdims=True)
    offsets = offsets / size[:, :, None]
    distance = distance / size
    is_other: Bools = distance > 0
    # Near nodes have more weight: the error of a model grows with the square of the distance.
    weight = np.where(is_other, 1 / np.where(is_other, distance, 1.0) ** 2, 0.0)
    a, b = np.einsum("nki,nji->jnk", offsets, tangents)
    h = np.einsum("nki,ni->nk", offsets, n)
    terms = a, b, a * a, np.sqrt(2) * a * b, b * b, a * h, b * h, h * h
    columns = np.stack(terms, axis=2) * weight[:, :, None]
    height = h * weight
    normal, error = n.copy(), np.full(len(rows), np.inf)
    for coefficients in MODELS:
        model = columns[:, :, :coefficients]
        inverse = np.linalg.pinv(model, rcond=SINGULAR)
        fit = np.einsum("nck,nk->nc", inverse, height)
        residual = height - np.einsum("nkc,nc->nk", model, fit)
        spare_nodes = is_other.sum(axis=1) - coefficients
        variance = (residual**2).sum(axis=1) / np.maximum(spare_nodes, 1)
        slope_error = np.sqrt(variance * (inverse[:, :2] ** 2).sum(axis=(1, 2)))
        fitted_normal = n
        if coefficients > MODELS[0]:
            fitted_normal = n - np.einsum("nj,nji->ni", fit[:, :2], tangents)
            fitted_normal /= np.linalg.norm(fitted_normal, axis=1, keepdims=True)
        is_better = (spare_nodes >= SPARE_NODES) & (slope_error < ERROR_RATIO * error)
        is_better &= _angle(fitted_normal, n) <= spread_nearby[rows]
        normal[is_better], error[is_better] = fitted_normal[is_better], slope_error[is_better]
    return normal, np.where(np.isfinite(error), error, mean_error[rows])


def slid_along(x: Floats, normals: Floats, error: Floats, weight: Floats) -> Floats:
    """Make normals orthogonal to the rigid motions that slide a surface along itself.

    Normals that are slightly off resist the rotation of a body of revolution: the smaller their
    error, the more ill-conditioned the system. A motion slides the surface along itself if normals
    hardly slope against it: the mean and the random slope are within the error of the normals.

    Args:
        x: Points (n, 3) [mm].
        normals: Unit normals at the points (n, 3).
        error: Standard errors of the normals (n,) [rad].
        weight: Areas of the points (n,) [mm2].

    Returns:
        Unit normals (n, 3). They are unchanged if no motion slides.
    """
    count = len(x)
    weight_fraction = weight / weight.sum()
    mean_error = float(np.sqrt(weight_fraction @ error**2))
    largest_slope = min(LIKELY_MULTIPLE * mean_error, LARGEST_SLOPE)
    if largest_slope < ROUNDING_OF_SLOPES or count < NODES_NEAR:
        return normals
    offsets = (x - weight_fraction @ x) / (float(np.linalg.norm(np.ptp(x, axis=0))) or 1.0)
    rotations = -np.cross(offsets[:, :, None], np.eye(3), axis=1)
    motions = np.concatenate([np.tile(np.eye(3), (count, 1, 1)), rotations], axis=2)
    gram = np.einsum("p,pik,pil->kl", weight_fraction, motions, motions)
    scale = np.linalg.inv(np.linalg.cholesky(gram + ROUNDING_OF_SLOPES * np.eye(6))).T
    adjusted, slide_count = normals, 0
    for step in range(MOST_STEPS):
        slopes = np.einsum("pi,pik->pk", adjusted, motions) @ scale
        mean = np.sqrt(count) * (weight_fraction @ slopes)
        sizes, vectors = np.linalg.svd(
            np.vstack([np.sqrt(weight_fraction)[:, None] * slopes, mean])
        )[1:]
        if not step:
            slide_count = int((sizes <= largest_slope).sum())
        if not slide_count or sizes[-slide_count] <= ROUNDING_OF_SLOPES:
            return adjusted
        sliding_motions = motions @ scale @ vectors[-slide_count:].T
        directions, singular_values, _ = np.linalg.svd(sliding_motions, full_matrices=False)
        # At most two motions are independent at a point of a surface.
        directions, singular_values = directions[:, :, :2], singular_values[:, :2]
        is_motion = singular_values > FLAT_ANGLE * singular_values.max()
        directions = np.where(is_motion[:, None], directions, 0.0)
        adjusted = adjusted - np.einsum("pik,pjk,pj->pi", directions, directions, adjusted)
        adjusted /= np.linalg.norm(adjusted, axis=1, keepdims=True)
    return normals
