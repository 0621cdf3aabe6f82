"""Corners where interfaces meet whose jumps follow from those of the points there.

A dependent corner gives its area and its jump to points of its interface next to it. The unknown of
such a point is the mean jump, by area, of the point and its part of the corner.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import bsr_array, csc_array, csr_array, diags_array, eye_array, kron, vstack
from scipy.sparse.linalg import inv

from app.foundation.arrays import Bools, Floats, Ints
from app.foundation.errors import InputError
from app.interfaces.corners import ROUNDING, ContactPoints, ContactSurface, Entries
from app.interfaces.faces import projectors
from app.interfaces.interface_facets import InterfaceFacets


def handed_area(
    facets: InterfaceFacets,
    surface: ContactSurface,
    held: Floats,
    names: Sequence[str],
) -> csr_array:
    """Areas that dependent corners give to points of their interface (m - n, n) [mm2].

    These points are the other corners of its facets, otherwise the nearest points of the same
    sides. A point with a prescribed component that the corner does not have is the last choice.

    Raises:
        InputError: There is no such point.
    """
    n, m = len(held), len(surface.weight)
    corners = np.concatenate(surface.triangles)
    numbers = np.concatenate(surface.facets)
    same = np.column_stack([surface.interface, surface.bodies])
    loose = ~held.any(axis=(1, 2))
    at_vertex: dict[int, Floats] = {}
    for p in np.flatnonzero(~loose):
        v = int(surface.vertex[p])
        at_vertex[v] = np.maximum(at_vertex.get(v, 0.0), np.abs(held[p]))
    rows: list[int] = []
    columns: list[int] = []
    areas: list[float] = []
    for f, k in zip(*np.nonzero(corners >= n), strict=True):
        c = int(corners[f, k])
        here = at_vertex.get(int(surface.vertex[c]), np.zeros((3, 3)))

        def takes(p: Ints, here: Floats = here) -> Bools:
            return np.asarray((np.abs(held[p]) <= here + ROUNDING).all(axis=(1, 2)))

        near = corners[f][corners[f] < n]
        to = near[takes(near)]
        if not len(to):
            every = np.flatnonzero((same[:n] == same[c]).all(axis=1))
            free = every[takes(every)]
            some = free if len(free) else every
            if not len(some):
                x, y, z = surface.x[c]
                raise InputError(
                    f"interfaces.{names[int(surface.interface[c])]}: all its nodes lie on lines "
                    f"where interfaces meet, e.g. at ({x:.4g}, {y:.4g}, {z:.4g}) mm, so none can "
                    "carry its force; use a finer mesh"
                )
            away = np.linalg.norm(surface.x[some] - surface.x[c], axis=1)
            to = some[np.isclose(away, away.min(), rtol=1e-6)]
        rows += [c - n] * len(to)
        columns += to.tolist()
        areas += [float(facets.area[numbers[f], k]) / len(to)] * len(to)
    return csr_array((areas, (rows, columns)), shape=(m - n, n))


def in_means(
    points: ContactPoints, entries: Entries, handed: csr_array
) -> tuple[ContactPoints, Entries]:
    """Return points and entries with mean jumps as unknowns.

    The mean jumps D of the points are those of their jumps d and of the jumps A d of the dependent
    corners, by area: D = G d. The entries for D are those for d times G^-1. A component that
    supports prescribe stays the jump of the point.
    """
    n, surface = len(points.vertex), points.surface
    weight = points.weight + handed.sum(axis=0)
    A = _dependent_jumps(surface, n)
    of_point = diags_array(points.weight / weight, format="csr")
    mean = csr_array(of_point + csr_array(handed.multiply(1 / weight[None])).T @ A)
    blocks = np.eye(3) - projectors(points.axes, points.held)
    free = bsr_array((blocks, np.arange(n), np.arange(n + 1)), shape=(3 * n, 3 * n)).tocsr()
    one = eye_array(3 * n, format="csr")
    G = one + free @ (_three(mean) - one)
    affected = np.flatnonzero(np.diff(G.indptr) != 1)
    changed = np.unique(np.concatenate([affected, G[affected].indices]))
    part = csr_array(inv(csc_array(G[changed][:, changed])))
    local = part.tocoo()
    stay = np.setdiff1d(np.arange(3 * n), changed)
    row = np.concatenate([stay, changed[local.row]])
    column = np.concatenate([stay, changed[local.col]])
    value = np.concatenate([np.ones(len(stay)), local.data])
    keep = np.abs(value) > ROUNDING
    inverse = csr_array((value[keep], (row[keep], column[keep])), shape=(3 * n, 3 * n))
    parts = []
    for b in np.unique(entries.body):
        here = entries.body == b
        at, rows = np.unique(entries.row[here], return_inverse=True)
        where = rows.ravel(), entries.column[here]
        B = csr_array((entries.value[here], where), shape=(len(at), 3 * n)) @ inverse
        B = B.tocoo()
        on = np.abs(B.data) > ROUNDING
        parts.append((np.full(on.sum(), b), at[B.row[on]], B.col[on].astype(np.int64), B.data[on]))
    body, row, column, value = (np.concatenate(part) for part in zip(*parts, strict=True))
    total = diags_array(1 / surface.weight[n:], format="csr")
    every = vstack([eye_array(n, format="csr"), total @ handed], format="csr")
    jumps = _three(csr_array(vstack([eye_array(n, format="csr"), A], format="csr"))) @ inverse
    surface = replace(surface, shares=csr_array(every), jumps=csr_array(jumps))
    return replace(points, weight=weight, surface=surface), Entries(body, row, column, value)


def _three(scalar: csr_array) -> csr_array:
    """Return factors (m, n) for each of three components (3 m, 3 n)."""
    return csr_array(kron(scalar, eye_array(3), format="csr"))


def _dependent_jumps(surface: ContactSurface, n: int) -> csr_array:
    """Signs of the jumps of the n points in the jumps of the dependent corners (m - n, n)."""
    rows: list[int] = []
    columns: list[int] = []
    values: list[float] = []
    for c in range(n, len(surface.vertex)):
        at = np.flatnonzero(surface.vertex[:n] == surface.vertex[c])
        master, slave = map(int, surface.bodies[c])
        path: dict[int, dict[int, float]] = {master: {}}
        for _ in at:
            for p in map(int, at):
                a, b = map(int, surface.bodies[p])
                if a in path and b not in path:
                    path[b] = path[a] | {p: 1.0}
                elif b in path and a not in path:
                    path[a] = path[b] | {p: -1.0}
        rows += [c - n] * len(path[slave])
        columns += path[slave].keys()
        values += path[slave].values()
    return csr_array((values, (rows, columns)), shape=(len(surface.vertex) - n, n))
