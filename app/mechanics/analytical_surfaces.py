"""Analytical surfaces: planes, spheres and cylinders, fitted to the nodes of a boundary.

Gap and normal of a point come from the formula. Flat facets would be off by their sagitta, which
is as large as the deformations in contact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.foundation.arrays import Floats

# Largest distance of nodes from the fitted surface, over their extent.
FIT_TOLERANCE = 1e-6
# Steps of Gauss and Newton for the axis of a cylinder.
FIT_STEPS = 20


@dataclass(frozen=True)
class AnalyticalSurface:
    """A plane, a sphere or a cylinder.

    Attributes:
        kind: plane, sphere or cylinder.
        centre: A point of the plane, of the axis, or the centre (3,) [mm].
        projector: Projector on the directions in which distance from the centre counts (3, 3).
        radius: Radius, 0 of a plane [mm].
        outward: Unit normal of a plane out of the body (3,), else zero.
        sign: 1 if the body is inside a sphere or cylinder, -1 if it is outside.
    """

    kind: str
    centre: Floats
    projector: Floats
    radius: float
    outward: Floats
    sign: float = 1.0

    def gap(self, x: Floats) -> tuple[Floats, Floats]:
        """Gap (n,) [mm] and outward unit normals (n, 3) at points (n, 3) [mm]."""
        offset = (x - self.centre) @ self.projector
        if self.kind == "plane":
            return offset @ self.outward, np.broadcast_to(self.outward, offset.shape)
        size = np.linalg.norm(offset, axis=1)
        normal = self.sign * offset / np.where(size > 0, size, 1.0)[:, None]
        return self.sign * (size - self.radius), normal


def fit_surface(x: Floats, outward: Floats) -> AnalyticalSurface | None:
    """Fit a surface to nodes (n, 3) [mm] with outward normals (n, 3); None if none fits.

    Spheres and cylinders are fitted by least squares (Gauss-Newton).
    """
    middle, size = x.mean(axis=0), float(np.linalg.norm(np.ptp(x, axis=0)))
    thinnest = np.linalg.svd(x - middle, full_matrices=False)[2][-1]
    thinnest = thinnest * np.sign(outward.sum(axis=0) @ thinnest)
    if np.abs((x - middle) @ thinnest).max() <= FIT_TOLERANCE * size:
        return AnalyticalSurface("plane", middle, np.outer(thinnest, thinnest), 0.0, thinnest)
    # The axis of a cylinder is across the normals of its facets.
    axis = np.linalg.eigh(outward.T @ outward)[1][:, 0]
    for kind, axis_of_kind in (("sphere", np.zeros(3)), ("cylinder", axis)):
        surface = _fit_round_surface(kind, x, outward, axis_of_kind)
        offset = (x - surface.centre) @ surface.projector
        deviation = np.abs(np.linalg.norm(offset, axis=1) - surface.radius).max()
        if deviation <= FIT_TOLERANCE * size:
            return surface
    return None


def _fit_round_surface(kind: str, x: Floats, outward: Floats, axis: Floats) -> AnalyticalSurface:
    """The sphere, with axis zero, or the cylinder nearest to nodes."""
    projector = np.eye(3) - np.outer(axis, axis)
    projected = x @ projector
    # |x|^2 = 2 c.x + r^2 - |c|^2 is linear in the unknowns.
    linear = np.column_stack([2 * projected, np.ones(len(x))])
    centre = np.linalg.lstsq(linear, (projected**2).sum(axis=1), rcond=1e-12)[0][:3]
    radius = float(np.linalg.norm(projected - centre, axis=1).mean())
    for _ in range(FIT_STEPS if axis.any() else 0):
        offset = (x - centre) @ projector
        size = np.linalg.norm(offset, axis=1)
        radial, axial = offset / size[:, None], (x - centre) @ axis
        # Derivatives of |way| - radius by the centre, a rotation of the axis, and the radius.
        rotation = np.cross(np.broadcast_to(axis, radial.shape), -axial[:, None] * radial)
        columns = np.column_stack([-radial, rotation, -np.ones(len(x))])
        step = np.linalg.lstsq(columns, radius - size, rcond=1e-10)[0]
        centre, radius = centre + step[:3], radius + float(step[6])
        axis = axis + np.cross(step[3:6], axis)
        axis /= np.linalg.norm(axis)
        projector = np.eye(3) - np.outer(axis, axis)
    sign = np.sign(((x - centre) @ projector * outward).sum())
    return AnalyticalSurface(kind, centre, projector, radius, np.zeros(3), float(sign))
