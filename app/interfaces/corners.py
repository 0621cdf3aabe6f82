"""Corners of the facets of interfaces: contact points and dependent corners, with their supports.

`contact_points` chooses the points among the corners, and explains the rules.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from app.foundation.arrays import Bools, Floats, Ints

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Parts of a jump below this are rounding.
ROUNDING = 1e-12
# Number in place of a support where the supports of a rigid region together prescribe the motion.
RIGIDLY = np.iinfo(np.int64).max


@dataclass(frozen=True)
class Corners:
    """Corners of the facets of interfaces, replicated on all ranks in canonical order (m of them).

    A vertex has a corner for each interface and each pair of bodies that meet there.

    Attributes:
        interface: Index of the interface (m,).
        vertex: Vertex number of the mesh file (m,).
        dof: Global blocked dof at the vertex (m,).
        x: Position (m, 3) [mm].
        bodies: Bodies (master, slave) (m, 2).
        faces: Number of faces, 1 to 3, or 0 where supports hold every component (m,).
        normals: Unit normals of the faces, zero beyond ``faces`` (m, 3, 3).
        weight: Area (m,) [mm2].
    """

    interface: Ints
    vertex: Ints
    dof: Ints
    x: Floats
    bodies: Ints
    faces: Ints
    normals: Floats
    weight: Floats


@dataclass(frozen=True)
class Dependence:
    """Quantities at all corners (m of them) by those at the points (n of them).

    Attributes:
        values: Factors of values, the fractions of the areas of the corners (m, n).
        forces: Factors of forces per area (3 m, 3 n).
        pressures: Factors of the pressures of faces, as means over whole corners (3 m, 3 n).
        jumps: Factors of the mean jumps of the points (3 m, 3 n).
    """

    values: csr_array
    forces: csr_array
    pressures: csr_array
    jumps: csr_array


@dataclass(frozen=True)
class ContactSurface(Corners):
    """All corners: the n points, each with its area alone, then the dependent corners.

    Attributes:
        triangles: For each interface, its facets as rows of corners (f_i, 3).
        facets: For each interface, the numbers of these facets (f_i,).
        dependence: Quantities at the corners by those at the points; None if all are points.
    """

    triangles: tuple[Ints, ...]
    facets: tuple[Ints, ...]
    dependence: Dependence | None = None

    def spread(self, values: Floats) -> Floats:
        """Values at the corners (m, ...) from those at the points (n, ...), by area."""
        if self.dependence is None:
            return values
        flat = self.dependence.values @ values.reshape(len(values), -1)
        return np.asarray(flat.reshape(-1, *values.shape[1:]))

    def spread_forces(self, forces: Floats) -> Floats:
        """Forces per area of the corners (m, 3) from those per area of the points (n, 3) [MPa]."""
        if self.dependence is None:
            return forces
        return np.asarray((self.dependence.forces @ forces.ravel()).reshape(-1, 3))

    def spread_pressures(self, pressures: Floats) -> Floats:
        """Pressures of the faces of corners (m, 3) from those of the points (n, 3) [MPa].

        All are means over the whole areas of corners and points.
        """
        if self.dependence is None:
            return pressures
        return np.asarray((self.dependence.pressures @ pressures.ravel()).reshape(-1, 3))

    def true_jumps(self, jumps: Floats) -> Floats:
        """Jumps at the corners (m, 3) from the mean jumps of the points (n, 3) [mm]."""
        if self.dependence is None:
            return jumps
        return np.asarray((self.dependence.jumps @ jumps.ravel()).reshape(-1, 3))

    def mean_jumps(self, jumps: Floats) -> Floats:
        """Mean jumps of the points (n, 3, k) from jumps at the corners (m, 3, k) [mm]."""
        if self.dependence is None:
            return jumps
        # Forces do the same work in both.
        work = self.dependence.forces.T @ (self.weight[:, None, None] * jumps).reshape(
            -1, jumps.shape[2]
        )
        points = self.dependence.values.shape[1]
        area = self.dependence.values.T @ self.weight
        return np.asarray(work.reshape(points, 3, -1) / area[:, None, None])

    def spread_status(self, status: Ints) -> Ints:
        """States of the corners (m,).

        A dependent corner has the state of the point with the largest share in it.
        """
        if self.dependence is None:
            return status
        return status[np.asarray(self.dependence.values.toarray().argmax(axis=1)).ravel()]


@dataclass(frozen=True)
class VertexConstraints:
    """Constrained displacement components of vertices, body by body, replicated.

    Attributes:
        vertex: Vertex numbers of the mesh file (h,).
        body: Body (h,).
        support: Index of the support of each component, -1 where it is free (h, 3); `RIGIDLY`
            where the supports of a rigid region together prescribe the motion.
        rigid: Mask of nodes that move with a rigid region of the body (h,).
    """

    vertex: Ints
    body: Ints
    support: Ints
    rigid: Bools

    def supports_of(self, vertex: Ints, bodies: Ints) -> Ints:
        """Return the support of each component of both bodies at vertices, or -1 (n, 2, 3)."""
        support = dict(zip(vertices_of_bodies(self.vertex, self.body), self.support, strict=True))
        no_support = np.full(3, -1)
        rows = [support.get(pair, no_support) for pair in _of_both(vertex, bodies)]
        return np.array(rows).reshape(len(vertex), 2, 3)

    def rigid_bodies(self, vertex: Ints, bodies: Ints) -> Bools:
        """Return True for each body that moves with a rigid region at vertices (n, 2)."""
        rigid = {*vertices_of_bodies(self.vertex[self.rigid], self.body[self.rigid])}
        rows = [pair in rigid for pair in _of_both(vertex, bodies)]
        return np.array(rows, dtype=bool).reshape(len(vertex), 2)


def vertices_of_bodies(vertex: Ints, body: Ints) -> Iterator[tuple[int, int]]:
    """Vertices with bodies, one pair for each row."""
    return zip(map(int, vertex), map(int, body), strict=True)


def _of_both(vertex: Ints, bodies: Ints) -> Iterator[tuple[int, int]]:
    """Vertices (n,), each with its master, then with its slave (n, 2)."""
    return vertices_of_bodies(np.repeat(vertex, 2), bodies.ravel())


@dataclass(frozen=True)
class ContactPoints(Corners):
    """Contact points (n of them): corners with unknown jumps.

    Attributes:
        weight: Area of the point, with its part of dependent corners (n,) [mm2].
        doubt: Standard error of the direction of its normals (n,) [rad].
        prescribing_support: Supports (master, slave) that fix each component of the jump, -1 where
            it is free (n, 3, 2).
        axes: Axes of these components, as columns (n, 3, 3).
        held_tangents: Projectors on prescribed directions that are tangential to all faces:
            friction acts along them, too (n, 3, 3).
        surface: All corners of the facets, also the dependent ones.
    """

    doubt: Floats
    prescribing_support: Ints
    axes: Floats
    held_tangents: Floats
    surface: ContactSurface

    @property
    def triangles(self) -> tuple[Ints, ...]:
        """For each interface, its facets as rows of corners of ``surface`` (f_i, 3)."""
        return self.surface.triangles

    @property
    def held(self) -> Bools:
        """Components of the jump prescribed by supports (n, 3)."""
        return self.prescribing_support[:, :, 0] >= 0


@dataclass(frozen=True)
class Entries:
    """Displacement of bodies due to jumps, as triplets.

    Body b moves by u + B_b q with q the jumps, three per contact point.

    Attributes:
        body: Body (m,).
        row: Global unrolled dof (m,).
        column: 3 point + component (m,).
        value: +1 or -1, halved at the edge nodes of second-order elements (m,).
    """

    body: Ints
    row: Ints
    column: Ints
    value: Floats
