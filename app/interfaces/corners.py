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

# Factors of jumps below this are rounding errors.
ROUNDING_OF_JUMP_FACTORS = 1e-12
# Stands for the index of a support if the supports of a rigid region together prescribe a motion.
BY_RIGID_REGION = np.iinfo(np.int64).max


@dataclass(frozen=True)
class Corners:
    """Corners of the facets of interfaces (m of them), on all ranks in the same order.

    A vertex has one corner for each interface and each pair of bodies that meet there.

    Attributes:
        interface: Index of the interface (m,).
        vertex: Vertex number of the mesh file (m,).
        dof: Global blocked dof at the vertex (m,).
        x: Position (m, 3) [mm].
        bodies: Bodies (master, slave) (m, 2).
        faces: Number of faces, 1 to 3, or 0 if supports prescribe every component (m,).
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
    """Matrices from quantities at the points (n of them) to quantities at all corners (m of them).

    Attributes:
        values: For values: the fraction of the area of a corner that each point has (m, n).
        forces: For forces per area (3 m, 3 n).
        pressures: For pressures of faces, which are means over whole corners (3 m, 3 n).
        jumps: From the mean jumps of the points to the jumps at the corners (3 m, 3 n).
    """

    values: csr_array
    forces: csr_array
    pressures: csr_array
    jumps: csr_array


@dataclass(frozen=True)
class ContactSurface(Corners):
    """All corners: first the n points, each without its part of dependent corners, then the rest.

    Attributes:
        triangles: For each interface, the corners of its facets (f_i, 3).
        facets: For each interface, the indices of these facets in `InterfaceFacets` (f_i,).
        dependence: Matrices from points to corners; None if all corners are points.
    """

    triangles: tuple[Ints, ...]
    facets: tuple[Ints, ...]
    dependence: Dependence | None = None

    def spread(self, values: Floats) -> Floats:
        """Values at the corners (m, ...) from those at the points (n, ...), by area."""
        if self.dependence is None:
            return values
        corner_values = self.dependence.values @ values.reshape(len(values), -1)
        return np.asarray(corner_values.reshape(-1, *values.shape[1:]))

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
        # Forces do the same work on mean jumps at points as on jumps at corners.
        weighted_jumps = (self.weight[:, None, None] * jumps).reshape(-1, jumps.shape[2])
        work = self.dependence.forces.T @ weighted_jumps
        point_count = self.dependence.values.shape[1]
        area = self.dependence.values.T @ self.weight
        return np.asarray(work.reshape(point_count, 3, -1) / area[:, None, None])

    def spread_status(self, status: Ints) -> Ints:
        """States of the corners (m,).

        A dependent corner has the state of the point with the largest share in it.
        """
        if self.dependence is None:
            return status
        largest_share = np.asarray(self.dependence.values.toarray().argmax(axis=1)).ravel()
        return status[largest_share]


@dataclass(frozen=True)
class VertexConstraints:
    """Constrained displacement components of vertices, body by body, replicated.

    Attributes:
        vertex: Vertex numbers of the mesh file (h,).
        body: Body (h,).
        support: Index of the support of each component, -1 where it is free (h, 3);
            `BY_RIGID_REGION` where the supports of a rigid region together prescribe the motion.
        rigid: Mask of the rows whose node moves with a rigid region of the body (h,).
    """

    vertex: Ints
    body: Ints
    support: Ints
    rigid: Bools

    def supports_of(self, vertex: Ints, bodies: Ints) -> Ints:
        """Support of each component of both bodies at vertices, or -1 (n, 2, 3).

        Args:
            vertex: Vertices (n,).
            bodies: Master and slave at each vertex (n, 2).
        """
        pairs = vertex_body_pairs(self.vertex, self.body)
        support_of_pair = dict(zip(pairs, self.support, strict=True))
        no_support = np.full(3, -1)
        sides = vertex_body_pairs(np.repeat(vertex, 2), bodies.ravel())
        supports = [support_of_pair.get(pair, no_support) for pair in sides]
        return np.array(supports).reshape(len(vertex), 2, 3)

    def rigid_bodies(self, vertex: Ints, bodies: Ints) -> Bools:
        """Mask of the bodies (n, 2) that move with a rigid region at vertices (n,)."""
        rigid_pairs = {*vertex_body_pairs(self.vertex[self.rigid], self.body[self.rigid])}
        sides = vertex_body_pairs(np.repeat(vertex, 2), bodies.ravel())
        is_rigid = [pair in rigid_pairs for pair in sides]
        return np.array(is_rigid, dtype=bool).reshape(len(vertex), 2)


def vertex_body_pairs(vertex: Ints, body: Ints) -> Iterator[tuple[int, int]]:
    """Pairs of vertex and body, one for each row."""
    return zip(map(int, vertex), map(int, body), strict=True)


@dataclass(frozen=True)
class ContactPoints(Corners):
    """Contact points (n of them): corners with unknown jumps.

    Attributes:
        weight: Area of the point, with its part of dependent corners (n,) [mm2].
        normal_error: Standard error of the direction of its normals (n,) [rad].
        prescribing_support: Supports of master and slave that prescribe each component of the
            jump, -1 where it is free (n, 3, 2).
        axes: Axes of these components, as columns (n, 3, 3).
        prescribed_tangents: Projectors on prescribed directions that are tangential to all faces
            (n, 3, 3). Friction acts along these directions, too.
        surface: All corners of the facets, also the dependent ones.
    """

    normal_error: Floats
    prescribing_support: Ints
    axes: Floats
    prescribed_tangents: Floats
    surface: ContactSurface

    @property
    def triangles(self) -> tuple[Ints, ...]:
        """For each interface, the corners of its facets, as rows of ``surface`` (f_i, 3)."""
        return self.surface.triangles

    @property
    def is_prescribed(self) -> Bools:
        """Mask of the components of the jump that supports prescribe (n, 3)."""
        return self.prescribing_support[:, :, 0] >= 0


@dataclass(frozen=True)
class Entries:
    """Entries of the matrices B_b from jumps to the displacement of bodies, as triplets.

    Body b moves by u + B_b q with the jumps q, three per contact point.

    Attributes:
        body: Body b (m,).
        row: Global unrolled dof (m,).
        column: 3 point + component (m,).
        value: Value (m,): +1 or -1 at vertices, halved at the middles of edges. Local axes, bent
            edges and dependent corners give further values.
    """

    body: Ints
    row: Ints
    column: Ints
    value: Floats
