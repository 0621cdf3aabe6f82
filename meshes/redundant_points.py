r"""Interfaces that meet: points whose jump those of others give, and what stands in for them.

At a vertex with k bodies, k - 1 jumps are independent; more interfaces than that go round in a
circle there. The jump of a redundant point c is that of a way round, :math:`d_c = \sum ± d_k`. It
hands its area and its law to the neighbours on its surface, the corners j of its facets: their law
is one of the mean jump,

.. math:: D_j = (W_j d_j + \sum_c W_{jc} d_c) / (W_j + W_{jc}), \qquad D = G d,

with :math:`W_j` the area of a point and :math:`W_{jc}` what c hands to it. Conjugate to it is a
force :math:`F_c = \sum_j W_{jc} F_j / W_c`, so a uniform pressure is exact. With D as unknowns in
place of d the equations of the points stay apart: displacements follow from :math:`d = G^{-1} D`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from app.arrays import Bools, Floats, Ints
from app.errors import InputError
from meshes.contact_facets import FACE_ANGLE, InterfaceFacets, shared

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Parts of a jump below this are rounding.
ROUNDING = 1e-12
# Mean jumps do not determine jumps if the inverse is larger.
SINGULAR = 1e8
# Distances are equal if they are to this part.
NEAR = 1e-6
# Areas are equal if they are to these digits.
DIGITS = 9


@dataclass(frozen=True)
class Meeting:
    """Which corners of facets are points (n of m), and what stands in for the others (l of m).

    Attributes:
        ways: For each redundant corner, points at its vertex and signs, which add up to its jump.
        share: Area that redundant corners hand to points (l, n) [mm2].
    """

    ways: tuple[tuple[tuple[int, int], ...], ...]
    share: csr_array

    @property
    def near(self) -> csr_array:
        """Parts of its area that each redundant corner hands to points (l, n); rows sum to 1."""
        from scipy.sparse import csr_array  # imported late, as all of it: few runs need it

        return csr_array(self.share.multiply(1 / self.share.sum(axis=1)[:, None]))

    @property
    def way(self) -> csr_array:
        """Jump of redundant corners by that of points (l, n): +1 and -1."""
        from scipy.sparse import csr_array

        entries = [(c, p, sign) for c, way in enumerate(self.ways) for p, sign in way]
        row, column, sign = np.array(entries, dtype=np.int64).reshape(-1, 3).T
        return csr_array((sign.astype(float), (row, column)), shape=self.share.shape)

    def ways_round(self, jumps: csr_array) -> csr_array:
        """Jumps of redundant corners (3 l, 3 n), from those of points (3 n, 3 n)."""
        from scipy.sparse import csr_array, eye_array, kron

        return csr_array(kron(self.way, eye_array(3)) @ jumps)

    def jumps(self, weight: Floats, free: Floats, x: Floats, names: Sequence[str]) -> csr_array:
        """Jumps of points by the mean jumps (3 n, 3 n).

        Args:
            weight: Area of the points with all that they are handed (n,) [mm2].
            free: Projectors on what no support prescribes of their jumps (n, 3, 3): the rest of a
                jump is no mean.
            x: Their positions (n, 3) [mm].
            names: Name of the interface of each (n,).

        Raises:
            InputError: Mean jumps do not determine the jumps.
        """
        from scipy.sparse import csc_array, csr_array, eye_array
        from scipy.sparse.linalg import splu

        n = len(weight)
        part = csr_array(self.share.multiply(1 / weight[None, :])).T
        handed = csr_array((part.sum(axis=1), (np.arange(n), np.arange(n))), shape=(n, n))
        change = (part @ self.way - handed).tocoo()
        blocks = change.data[:, None, None] * free[change.row]
        k, row, column = np.nonzero(blocks)
        at = 3 * change.row[k] + row, 3 * change.col[k] + column
        change = csr_array((blocks[k, row, column], at), shape=(3 * n, 3 * n))
        # With M the change, in the rows of points that are handed something, (1 + M)^-1 is
        # 1 - (1 + M)^-1 M: it is solved in these rows alone.
        rows = np.flatnonzero(np.diff(change.indptr))
        if not len(rows):
            return csr_array(eye_array(3 * n))
        change = change[rows]
        used = np.unique(change.indices)
        try:
            own = splu(csc_array(eye_array(len(rows)) + change[:, rows]))
            solved = own.solve(change[:, used].toarray())
        except RuntimeError:  # exactly singular
            solved = np.full((len(rows), 1), np.inf)
        if (size := np.abs(solved).max(axis=1)).max() > SINGULAR:
            p = int(rows[np.argmax(size)]) // 3
            raise InputError(_refusal(names[p], x[p]))
        solved[np.abs(solved) < ROUNDING] = 0.0
        row, column = np.nonzero(solved)
        found = csr_array((solved[row, column], (rows[row], used[column])), shape=(3 * n, 3 * n))
        return csr_array(eye_array(3 * n) - found)


def meeting(
    facets: InterfaceFacets,
    corners: Ints,
    of: Ints,
    given: Bools,
    normals: Floats,
    area: Floats,
    names: Sequence[str],
) -> tuple[Bools, Meeting | None]:
    """Choose the points among the corners of facets.

    A rule chooses, whatever the order in the case file. At a vertex goes first the stem of a T, an
    interface with a normal unlike those of all others; then the one of the smaller surface, by the
    name in the end. Last go one that has no corner of its facets at other vertices, and one whose
    jump supports prescribe: without it they would hold other bodies at the vertex too.

    Args:
        facets: All facets.
        corners: Interface, vertex, master and slave of each corner, rising (m, 4).
        of: The corner at each vertex of the facets (3 f,).
        given: Whether supports hold both of its sides along an axis (m,).
        normals: Unit normals of its faces (m, 3, 3), zero beyond their number.
        area: Area around it (m,) [mm2].
        names: Names of the interfaces.

    Returns:
        Whether each corner is a point (m,); what stands in for the others, if there are any.

    Raises:
        InputError: No point is left of a surface between two bodies.
    """
    alone = without_circles(corners)
    if alone.all():
        return alone, None
    _, surface = np.unique(corners[:, [0, 2, 3]], axis=0, return_inverse=True)
    size = np.bincount(surface, area).round(DIGITS)
    # Of each corner, whether a facet of it has a corner where nothing is redundant.
    triangles = of.reshape(-1, 3)
    held = np.zeros(len(corners), dtype=bool)
    held[triangles[alone[triangles].any(axis=1)]] = True
    stem = _stems(corners, alone, normals)
    needed = np.zeros(len(size), dtype=bool)
    order = sorted(range(len(names)), key=names.__getitem__)
    by_name = np.argsort(np.array(order, dtype=np.int64))[corners[:, 0]]
    while True:
        first = ~needed[surface], ~given, held, stem
        then = -size[surface], by_name, corners[:, 2], corners[:, 3]
        kept = _forest(corners, alone, np.lexsort((*then[::-1], *first[::-1])))
        bare = np.bincount(surface, kept) == 0
        if not bare.any():
            break
        if (needed & bare).any():
            c = int(np.argmax((needed & bare)[surface]))
            x = facets.x.reshape(-1, 3)[np.argmax(of == c)]
            raise InputError(_refusal(names[corners[c, 0]], x))
        needed |= bare
    return kept, _stand_ins(facets, corners, of, surface, kept)


def _refusal(name: str, x: Floats) -> str:
    place = ", ".join(f"{v:.4g}" for v in x)
    return (
        f"interfaces.{name}: other interfaces meet at so many of its points, e.g. at ({place}) mm, "
        "that its law can hold nowhere; expected smaller cells there, or one interface with "
        "several regions on a side"
    )


def without_circles(corners: Ints) -> Bools:
    """Corners at vertices where all jumps are independent (m,).

    ``corners`` are their interface, vertex, master and slave (m, 4).
    """
    alone = np.ones(len(corners), dtype=bool)
    for rows in shared(corners[:, 1]):
        group = {int(body): int(body) for body in corners[rows, 2:].ravel()}
        for p in rows:
            one, two = (group[int(body)] for body in corners[p, 2:])
            alone[rows] &= one != two
            group = {body: one if g == two else g for body, g in group.items()}
    return alone


def _stems(corners: Ints, alone: Bools, normals: Floats) -> Bools:
    """Corners whose normals are unlike those of all other interfaces at the vertex (m,)."""
    stem = np.zeros(len(corners), dtype=bool)
    for rows in shared(corners[:, 1]):
        if not alone[rows[0]]:
            alike = np.abs(np.einsum("aki,bli->abkl", normals[rows], normals[rows]))
            close = alike.max(axis=(2, 3)) > np.cos(FACE_ANGLE)
            stem[rows] = close.sum(axis=1) == 1
    return stem


def _forest(corners: Ints, alone: Bools, order: Ints) -> Bools:
    """Corners kept: at each vertex a forest of bodies, those that come first in an order."""
    kept, rank = np.ones(len(corners), dtype=bool), np.argsort(order)
    for rows in shared(corners[:, 1]):
        if alone[rows[0]]:
            continue
        group = {int(body): int(body) for body in corners[rows, 2:].ravel()}
        for p in rows[np.argsort(rank[rows])]:
            a, b = (group[int(body)] for body in corners[p, 2:])
            kept[p] = a != b
            group = {body: a if g == b else g for body, g in group.items()}
    return kept


def _stand_ins(
    facets: InterfaceFacets, corners: Ints, of: Ints, surface: Ints, kept: Bools
) -> Meeting:
    """Ways round, and shares of the nearest points of the same surface."""
    from scipy.sparse import csr_array

    lost = np.flatnonzero(~kept)
    number = np.where(kept, np.cumsum(kept), np.cumsum(~kept)) - 1
    ways: dict[int, tuple[tuple[int, int], ...]] = {}
    for rows in shared(corners[:, 1]):
        for c in rows[~kept[rows]]:
            way = _way(corners, rows[kept[rows]], *map(int, corners[c, 2:]))
            ways[int(c)] = tuple((int(number[p]), sign) for p, sign in way)
    triangles = of.reshape(-1, 3)
    x = np.zeros((len(corners), 3))
    x[of] = facets.x.reshape(-1, 3)
    parts: list[tuple[int, int, float]] = []
    for f, k in zip(*np.nonzero(~kept[triangles]), strict=True):
        c = int(triangles[f, k])
        to = triangles[f][kept[triangles[f]]]
        if not len(to):
            # All corners of the facet are redundant: the nearest points stand in, all of them.
            same = np.flatnonzero(kept & (surface == surface[c]))
            away = np.linalg.norm(x[same] - x[c], axis=1)
            to = same[away < away.min() * (1 + NEAR)]
        parts += [(int(number[c]), int(number[j]), float(facets.area[f, k]) / len(to)) for j in to]
    row, column, share = zip(*parts, strict=True)
    shape = len(lost), int(kept.sum())
    shares = csr_array((share, (row, column)), shape=shape)
    return Meeting(tuple(ways[int(c)] for c in lost), shares)


def _way(corners: Ints, points: Ints, master: int, slave: int) -> tuple[tuple[int, int], ...]:
    """Points and signs on the way from a master to a slave body through a forest."""
    ways: dict[int, tuple[tuple[int, int], ...]] = {master: ()}
    while slave not in ways:
        for p in map(int, points):
            a, b = map(int, corners[p, 2:])
            if a in ways and b not in ways:
                ways[b] = (*ways[a], (p, 1))
            elif b in ways and a not in ways:
                ways[a] = (*ways[b], (p, -1))
    return ways[slave]
