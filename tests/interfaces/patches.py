"""Facets made by hand, and cylinders with their contact points."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from app.foundation.arrays import Floats
from app.interfaces.corners import ContactPoints, VertexConstraints
from app.interfaces.interface_facets import InterfaceFacets, sorted_facets
from tests import support

NONE = np.zeros(0, np.int64)
NOTHING_HELD = VertexConstraints(NONE, NONE, np.zeros((0, 3), np.int64), np.zeros(0, bool))


def facets_of(
    triangles: Sequence[Floats],
    interface: Sequence[int],
    master: Sequence[int],
    slave: Sequence[int],
    inside: Sequence[Floats],
    stiffness: Floats | None = None,
    rounded_angle: float = 0.0,
) -> tuple[InterfaceFacets, Floats]:
    """Facets from triangles by coordinates, and the coordinates of the shared vertices."""
    corners = np.array(triangles)
    x, number = np.unique(corners.reshape(-1, 3).round(9), axis=0, return_inverse=True)
    vertices = number.reshape(-1, 3).astype(np.int64)
    n = len(corners)
    return (
        sorted_facets(
            np.array(interface, np.int64),
            vertices,
            np.array([master, slave], np.int64).T,
            vertices.copy(),
            corners,
            np.array(inside, dtype=float),
            np.zeros((n, 2)) if stiffness is None else stiffness,
            np.full(n, rounded_angle),
        ),
        x,
    )


def between(triangles: Sequence[Floats], inside: Sequence[float]) -> tuple[InterfaceFacets, Floats]:
    """Facets of one interface between body 0 and body 1, the slave, which contains a point."""
    m = len(triangles)
    return facets_of(triangles, [0] * m, [0] * m, [1] * m, [np.array(inside)] * m)


def patch(origin: Sequence[float], a: Sequence[float], b: Sequence[float], n: int) -> list[Floats]:
    """A parallelogram as 2 n² triangles."""
    o, a, b = (np.array(v, dtype=float) for v in (origin, a, b))
    out = []
    for i in range(n):
        for j in range(n):
            p = [o + a * (i + k) / n + b * (j + m) / n for k, m in ((0, 0), (1, 0), (1, 1), (0, 1))]
            out += [np.array([p[0], p[1], p[2]]), np.array([p[0], p[2], p[3]])]
    return out


# On real meshes

CYLINDERS = """
geometry:
  kind: cylinders
  stem_radius: 7 mm
  cement_thickness: 3 mm
  bone_thickness: 4 mm
  length: 8 mm
  taper: {taper} deg
  sector: {sector}
mesh: {{size: {size} mm, far_size: 4 mm}}
regions:
  stem: {{youngs_modulus: 110 GPa, poisson_ratio: 0.3}}
  cement: {{youngs_modulus: 2200 MPa, poisson_ratio: 0.3}}
  bone: {{youngs_modulus: 17 GPa, poisson_ratio: 0.3}}
interfaces:
  stem_cement: {{kind: contact, friction_coefficient: 0}}
  cement_bone: {{kind: contact, friction_coefficient: 0}}
supports:
  outer: {{kind: fixed, boundary: bone_surface}}
"""


def cylinder_points(**values: object) -> ContactPoints:
    case = support.case(CYLINDERS.format(**values))
    return support.assemble(case)[0].contact.points
