"""Recovered stress: smoother than that of the displacement, and closer to the truth.

Around every vertex of a region a polynomial of the order of the displacement is fitted to the
stress at the points of the cells there (superconvergent patch recovery, Zienkiewicz and Zhu 1992);
in a cell those of its corners are blended by the barycentric coordinates. Regions are apart: stress
jumps between them.
"""

from __future__ import annotations

import numpy as np
from dolfinx import la
from numpy.typing import NDArray
from scipy.sparse import csr_array

from app.arrays import Floats, Ints
from app.mechanics.problem import Problem

# Weight of what hardly any point tells of, over the number of points.
RIDGE = 1e-4
AT_ONCE = 1 << 14  # cells


def recovered(
    problem: Problem, cells: NDArray[np.integer], X: Floats, x: Floats, values: Floats
) -> Floats:
    """Values at points of cells, from polynomials fitted around the vertices; collective.

    Args:
        problem: Whose displacement the values are of.
        cells: Own cells of a region (c,).
        X: Points in the reference cell (q, 3).
        x: The same in the cells (c, q, 3) [mm].
        values: Of the cells there (c, q, k).

    Returns:
        Shape (c, q, k).
    """
    space, order = problem.mechanics.scalars, problem.scene.order
    vertices: Ints = space.dofmap.list[cells].astype(np.int64)
    at = space.tabulate_dof_coordinates()
    size = _size(problem, vertices, x)
    terms, k = len(_powers(np.zeros((1, 3)), order)[0]), values.shape[2]
    sums = la.vector(space.dofmap.index_map, terms * (terms + k))
    table = sums.array.reshape(len(at), terms, terms + k)
    for begin in range(0, len(cells), AT_ONCE):
        some = slice(begin, begin + AT_ONCE)
        for corner in vertices[some].T:
            p = _powers((x[some] - at[corner, None]) / size[corner, None, None], order)
            both = np.concatenate([p, values[some]], axis=2)
            found = np.einsum("cqa,cqb->cab", p, both).reshape(len(corner), -1)
            rows = csr_array(
                (np.ones(len(corner)), (corner, np.arange(len(corner)))), (len(at), len(corner))
            )
            table += (rows @ found).reshape(table.shape)
    sums.scatter_reverse(la.InsertMode.add)
    sums.scatter_forward()
    used = np.unique(vertices)
    matrix, right = table[used, :, :terms], table[used, :, terms:]
    matrix = matrix + RIDGE * matrix[:, :1, :1] * np.diag([0.0, *np.ones(terms - 1)])
    fits = np.zeros((len(at), terms, k))
    fits[used] = np.linalg.solve(matrix, right)
    result = np.zeros(values.shape)
    share = np.column_stack([1 - X.sum(axis=1), X])
    for begin in range(0, len(cells), AT_ONCE):
        some = slice(begin, begin + AT_ONCE)
        for corner, weight in zip(vertices[some].T, share.T, strict=True):
            p = _powers((x[some] - at[corner, None]) / size[corner, None, None], order)
            result[some] += weight[None, :, None] * (p @ fits[corner])
    return result


def _size(problem: Problem, vertices: Ints, x: Floats) -> Floats:
    """Length of the cells about each vertex (n,) [mm]; collective."""
    space = problem.mechanics.scalars
    at = space.tabulate_dof_coordinates()
    sums = la.vector(space.dofmap.index_map, 2)
    table = sums.array.reshape(-1, 2)
    away = np.linalg.norm(x.mean(axis=1)[:, None] - at[vertices], axis=2)
    np.add.at(table[:, 0], vertices, away)
    np.add.at(table[:, 1], vertices, 1.0)
    sums.scatter_reverse(la.InsertMode.add)
    sums.scatter_forward()
    return np.asarray(np.where(table[:, 1] > 0, table[:, 0] / np.maximum(table[:, 1], 1.0), 1.0))


def _powers(x: Floats, order: int) -> Floats:
    """Monomials up to an order (..., terms) of points (..., 3)."""
    one = np.ones((*x.shape[:-1], 1))
    if order == 1:
        return np.concatenate([one, x], axis=-1)
    a, b, c = (x[..., k : k + 1] for k in range(3))
    return np.concatenate([one, x, a * a, b * b, c * c, b * c, a * c, a * b], axis=-1)
