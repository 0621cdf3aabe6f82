"""Surfaces of rigid bodies that are known by formula: planes, spheres, cylinders.

Gap and normal of a point come from the formula, never from facets: the sagitta of a facet is as
large as the deformations that contact is about.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.foundation.arrays import Floats

# Largest distance of nodes from the surface they are on, over their extent.
FIT = 1e-6
STEPS = 20


@dataclass(frozen=True)
class RigidSurface:
    """A plane, a sphere or a cylinder.

    Attributes:
        kind: plane, sphere or cylinder.
        centre: A point of the plane, of the axis, or the centre (3,) [mm].
        across: Projector on what counts of the way from the centre (3, 3).
        radius: Radius, 0 of a plane [mm].
        outward: Unit normal of a plane out of the body (3,), else zero.
        sign: 1 if the body is inside a sphere or cylinder, -1 if it is outside.
    """

    kind: str
    centre: Floats
    across: Floats
    radius: float
    outward: Floats
    sign: float = 1.0

    def gap(self, x: Floats) -> tuple[Floats, Floats]:
        """Gap (n,) [mm] and outward unit normals (n, 3) at points (n, 3) [mm]."""
        way = (x - self.centre) @ self.across
        if self.kind == "plane":
            return way @ self.outward, np.broadcast_to(self.outward, way.shape)
        size = np.linalg.norm(way, axis=1)
        normal = self.sign * way / np.where(size > 0, size, 1.0)[:, None]
        return self.sign * (size - self.radius), normal


def fitted(x: Floats, outward: Floats) -> RigidSurface | None:
    """The surface that nodes (n, 3) [mm] are on, with normals there (n, 3); None if there is none.

    A sphere and a cylinder by least squares (Gauss-Newton).
    """
    middle, size = x.mean(axis=0), float(np.linalg.norm(np.ptp(x, axis=0)))
    thin = np.linalg.svd(x - middle, full_matrices=False)[2][-1]
    thin = thin * np.sign(outward.sum(axis=0) @ thin)
    if np.abs((x - middle) @ thin).max() <= FIT * size:
        return RigidSurface("plane", middle, np.outer(thin, thin), 0.0, thin)
    # The axis of a cylinder is across the normals of its facets.
    axis = np.linalg.eigh(outward.T @ outward)[1][:, 0]
    for kind, along in (("sphere", np.zeros(3)), ("cylinder", axis)):
        found = _round(kind, x, outward, along)
        way = (x - found.centre) @ found.across
        off = np.abs(np.linalg.norm(way, axis=1) - found.radius).max()
        if off <= FIT * size:
            return found
    return None


def _round(kind: str, x: Floats, outward: Floats, axis: Floats) -> RigidSurface:
    """The sphere, with axis zero, or the cylinder nearest to nodes."""
    across = np.eye(3) - np.outer(axis, axis)
    flat = x @ across
    # |x|^2 = 2 c.x + r^2 - |c|^2 is linear in the unknowns.
    linear = np.column_stack([2 * flat, np.ones(len(x))])
    centre = np.linalg.lstsq(linear, (flat**2).sum(axis=1), rcond=1e-12)[0][:3]
    radius = float(np.linalg.norm(flat - centre, axis=1).mean())
    for _ in range(STEPS if axis.any() else 0):
        way = (x - centre) @ across
        size = np.linalg.norm(way, axis=1)
        e, along = way / size[:, None], (x - centre) @ axis
        # Residual |way| - radius, by centre, by a turn of the axis, by the radius.
        turn = np.cross(np.broadcast_to(axis, e.shape), -along[:, None] * e)
        columns = np.column_stack([-e, turn, -np.ones(len(x))])
        step = np.linalg.lstsq(columns, radius - size, rcond=1e-10)[0]
        centre, radius = centre + step[:3], radius + float(step[6])
        axis = axis + np.cross(step[3:6], axis)
        axis /= np.linalg.norm(axis)
        across = np.eye(3) - np.outer(axis, axis)
    sign = np.sign(((x - centre) @ across * outward).sum())
    return RigidSurface(kind, centre, across, radius, np.zeros(3), float(sign))
