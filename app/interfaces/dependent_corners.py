"""Corners where interfaces meet and whose jumps follow from the jumps of the points there.

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
    sides_of_corner = np.column_stack([surface.interface, surface.bodies])
    is_free = ~held.any(axis=(1, 2))
    at_vertex: dict[int, Floats] = {}
    for p in np.flatnonzero(~is_free):
        v = int(surface.vertex[p])
        at_vertex[v] = np.maximum(at_vertex.get(v, 0.0), np.abs(held[p]))
    rows: list[int] = []
    columns: list[int] = []
    areas: list[float] = []
    for f, k in zip(*np.nonzero(corners >= n), strict=True):
        c = int(corners[f, k])
        held_at_corner = at_vertex.get(int(surface.vertex[c]), np.zeros((3, 3)))

        def takes(p: Ints, held_at_corner: Floats = held_at_corner) -> Bools:
            return np.asarray((np.abs(held[p]) <= held_at_corner + ROUNDING).all(axis=(1, 2)))

        neighbours = corners[f][corners[f] < n]
        receivers = neighbours[takes(neighbours)]
        if not len(receivers):
            candidates = np.flatnonzero((sides_of_corner[:n] == sides_of_corner[c]).all(axis=1))
            admissible = candidates[takes(candidates)]
            receivers_of_sides = admissible if len(admissible) else candidates
            if not len(receivers_of_sides):
                x, y, z = surface.x[c]
                raise InputError(
                    f"interfaces.{names[int(surface.interface[c])]}: all its nodes lie on lines "
                    f"where interfaces meet, e.g. at ({x:.4g}, {y:.4g}, {z:.4g}) mm, so none can "
                    "carry its force; use a finer mesh"
                )
            distances = np.linalg.norm(surface.x[receivers_of_sides] - surface.x[c], axis=1)
            receivers = receivers_of_sides[np.isclose(distances, distances.min(), rtol=1e-6)]
        rows += [c - n] * len(receivers)
        columns += receivers.tolist()
        areas += [float(facets.area[numbers[f], k]) / len(receivers)] * len(receivers)
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
    free_directions = bsr_array(
        (blocks, np.arange(n), np.arange(n + 1)), shape=(3 * n, 3 * n)
    ).tocsr()
    identity = eye_array(3 * n, format="csr")
    G = identity + free_directions @ (_three(mean) - identity)
    affected = np.flatnonzero(np.diff(G.indptr) != 1)
    changed = np.unique(np.concatenate([affected, G[affected].indices]))
    part = csr_array(inv(csc_array(G[changed][:, changed])))
    local = part.tocoo()
    unchanged = np.setdiff1d(np.arange(3 * n), changed)
    row = np.concatenate([unchanged, changed[local.row]])
    column = np.concatenate([unchanged, changed[local.col]])
    value = np.concatenate([np.ones(len(unchanged)), local.data])
    keep = np.abs(value) > ROUNDING
    inverse = csr_array((value[keep], (row[keep], column[keep])), shape=(3 * n, 3 * n))
    parts = []
    for b in np.unique(entries.body):
        of_body = entries.body == b
        node_rows, rows = np.unique(entries.row[of_body], return_inverse=True)
        positions = rows.ravel(), entries.column[of_body]
        B = csr_array((entries.value[of_body], positions), shape=(len(node_rows), 3 * n)) @ inverse
        B = B.tocoo()
        is_nonzero = np.abs(B.data) > ROUNDING
        parts.append(
            (
                np.full(is_nonzero.sum(), b),
                node_rows[B.row[is_nonzero]],
                B.col[is_nonzero].astype(np.int64),
                B.data[is_nonzero],
            )
        )
    body, row, column, value = (np.concatenate(part) for part in zip(*parts, strict=True))
    total = diags_array(1 / surface.weight[n:], format="csr")
    shares = vstack([eye_array(n, format="csr"), total @ handed], format="csr")
    jumps = _three(csr_array(vstack([eye_array(n, format="csr"), A], format="csr"))) @ inverse
    surface = replace(surface, shares=csr_array(shares), jumps=csr_array(jumps))
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
        points_at_vertex = np.flatnonzero(surface.vertex[:n] == surface.vertex[c])
        master, slave = map(int, surface.bodies[c])
        path: dict[int, dict[int, float]] = {master: {}}
        for _ in points_at_vertex:
            for p in map(int, points_at_vertex):
                a, b = map(int, surface.bodies[p])
                if a in path and b not in path:
                    path[b] = path[a] | {p: 1.0}
                elif b in path and a not in path:
                    path[a] = path[b] | {p: -1.0}
        rows += [c - n] * len(path[slave])
        columns += path[slave].keys()
        values += path[slave].values()
    return csr_array((values, (rows, columns)), shape=(len(surface.vertex) - n, n))
