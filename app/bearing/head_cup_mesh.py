"""A head and its cup, meshed apart: two bodies that share no node."""

from __future__ import annotations

import math
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from app.foundation.arrays import Floats, Ints
from meshes.data import MeshData, MeshKeys, assemble, exterior_facets, number
from meshes.gmsh_child import grade, session, tetrahedra

if TYPE_CHECKING:
    from app.bearing.head_cup import HeadCup

# Nodes, cells, and the layer of each cell.
Body = tuple[Floats, Ints, Ints]


def build(geometry: HeadCup, mesh: MeshKeys) -> MeshData:
    """Mesh a head with its bore, and a liner, within a shell if it has a thickness.

    Args:
        geometry: Head and cup.
        mesh: ``size`` on the liner's bearing, ``far`` away from it [mm], ``curved``.

    Raises:
        GeometryError: gmsh fails.
    """
    radii = geometry.cup_radii
    level = radii[0] * math.cos(geometry.cover_angle)
    (x, ball, _), (y, cup, layer) = _head(geometry, mesh), _cup(radii, level, mesh)
    points, cells = np.concatenate([x, y]), np.concatenate([ball, cup + len(x)])
    tags = np.concatenate([np.ones(len(ball), dtype=np.int64), 2 + layer])
    regions, (facets, owner) = number(geometry.region_names), exterior_facets(cells)
    at, of = points[facets[:, :3]], tags[owner]
    near, far, on_head = 1e-6 * radii[0], np.linalg.norm(at, axis=2), of == 1
    sphere = on_head & (np.abs(far - geometry.head_radius) < near).all(axis=1)
    rim = ~on_head & (np.abs(at[..., 2] - level) < near).all(axis=1)
    inner = ~on_head & ~rim & (far.mean(axis=1) < (radii[0] + radii[1]) / 2)
    masks = {"head_surface": sphere, "head_bore": on_head & ~sphere, "liner_inner": inner}
    masks |= {f"{name}_rim": rim & (of == t) for name, t in regions.items() if t > 1}
    masks[geometry.boundary_names[-1]] = ~on_head & ~rim & ~inner
    points = points @ _rotation(geometry.inclination, geometry.version).T
    return assemble(points, cells, tags, regions, geometry.interface_sides, masks, facets)


def _head(geometry: HeadCup, mesh: MeshKeys) -> Body:
    """A ball about the origin with a conical bore that opens towards -z."""
    ball, bore = geometry.head_radius, geometry.bore_diameter / 2
    narrowing, depth = math.tan(geometry.bore_taper), geometry.bore_depth
    # From below the ball, so that the cone meets it in one circle.
    more = ball - math.sqrt(ball**2 - bore**2) + 0.1 * ball
    wide, end = bore + more * narrowing, bore - depth * narrowing
    with session("head_cup") as gmsh:
        occ = gmsh.model.occ
        start = (0, 0, -1.1 * ball, 0, 0, depth + more)
        hole = occ.addCone(*start, wide, end) if narrowing else occ.addCylinder(*start, bore)
        occ.cut([(3, occ.addSphere(0, 0, 0, ball))], [(3, hole)])
        return _meshed(gmsh, ball, geometry.head_size * mesh.size, mesh)


def _cup(radii: tuple[float, ...], level: float, mesh: MeshKeys) -> Body:
    """Layers between spheres about the origin, from within, above the plane z = level."""
    with session("head_cup") as gmsh:
        occ = gmsh.model.occ
        hollow, *layers = (
            (3, occ.addSphere(0, 0, 0, radius, angle1=math.asin(level / radius)))
            for radius in radii
        )
        _, parts = occ.fragment(layers[-1:], [*layers[:-1], hollow])
        occ.remove(parts[-1])
        points, cells, volume = _meshed(gmsh, radii[0], mesh.size, mesh)
    within = [sum((3, v) in part for part in parts) for v in range(volume.max() + 1)]
    return points, cells, len(layers) - np.array(within)[volume]


def _meshed(gmsh: ModuleType, radius: float, size: float, mesh: MeshKeys) -> Body:
    gmsh.model.occ.synchronize()
    grade(gmsh, [f"(sqrt(x*x+y*y+z*z)-{radius})"], size, max(size, mesh.far))
    return tetrahedra(gmsh, bool(mesh.curved))


def _rotation(inclination: float, version: float) -> Floats:
    """Rotation (3, 3) that lays z along the cup's pole."""
    c, s, d, t = (f(a) for a in (inclination, version) for f in (math.cos, math.sin))
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ [[1, 0, 0], [0, d, -t], [0, t, d]]
