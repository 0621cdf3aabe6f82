"""A head and its cup, meshed apart: two bodies that share no node."""

from __future__ import annotations

import math
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np

from app.foundation.arrays import Floats, Ints
from meshes.data import MeshData, exterior_facets, mesh_data_of, number
from meshes.gmsh_session import grade, session, tetrahedra

if TYPE_CHECKING:
    from app.bearing.head_cup import HeadCup
    from app.case.shapes import MeshOptions

# Nodes, cells, and the layer of each cell.
Body = tuple[Floats, Ints, Ints]


def build(geometry: HeadCup, mesh: MeshOptions) -> MeshData:
    """Mesh a head with its bore, and a liner, within a shell if it has a thickness.

    Args:
        geometry: Head and cup.
        mesh: ``size`` on the liner's bearing, ``far`` away from it [mm], ``curved``.

    Raises:
        GeometryError: gmsh fails.
    """
    radii = geometry.cup_radii
    level = radii[0] * math.cos(geometry.cover_angle)
    head_points, head_cells, _ = _head(geometry, mesh)
    cup_points, cup_cells, layer = _cup(radii, level, mesh)
    points = np.concatenate([head_points, cup_points])
    cells = np.concatenate([head_cells, cup_cells + len(head_points)])
    tags = np.concatenate([np.ones(len(head_cells), dtype=np.int64), 2 + layer])
    regions, (facets, owner) = number(geometry.region_names), exterior_facets(cells)
    corners, facet_tags = points[facets[:, :3]], tags[owner]
    tolerance = 1e-6 * radii[0]
    radius_of_corners = np.linalg.norm(corners, axis=2)
    on_head = facet_tags == 1
    sphere = on_head & (np.abs(radius_of_corners - geometry.head_radius) < tolerance).all(axis=1)
    rim = ~on_head & (np.abs(corners[..., 2] - level) < tolerance).all(axis=1)
    inner = ~on_head & ~rim & (radius_of_corners.mean(axis=1) < (radii[0] + radii[1]) / 2)
    masks = {"head_surface": sphere, "head_bore": on_head & ~sphere, "liner_inner": inner}
    masks |= {f"{name}_rim": rim & (facet_tags == t) for name, t in regions.items() if t > 1}
    masks[geometry.boundary_names[-1]] = ~on_head & ~rim & ~inner
    points = points @ _rotation(geometry.inclination, geometry.version).T
    return mesh_data_of(points, cells, tags, regions, geometry.interface_sides, masks, facets)


def _head(geometry: HeadCup, mesh: MeshOptions) -> Body:
    """A ball about the origin with a conical bore that opens towards -z."""
    head_radius, bore_radius = geometry.head_radius, geometry.bore_diameter / 2
    narrowing, depth = math.tan(geometry.bore_taper), geometry.bore_depth
    # The bore begins below the ball, so that the cone meets the ball in one circle.
    extra_depth = head_radius - math.sqrt(head_radius**2 - bore_radius**2) + 0.1 * head_radius
    start_radius = bore_radius + extra_depth * narrowing
    end_radius = bore_radius - depth * narrowing
    with session("head_cup") as gmsh:
        occ = gmsh.model.occ
        start = (0, 0, -1.1 * head_radius, 0, 0, depth + extra_depth)
        hole = (
            occ.addCone(*start, start_radius, end_radius)
            if narrowing
            else occ.addCylinder(*start, bore_radius)
        )
        occ.cut([(3, occ.addSphere(0, 0, 0, head_radius))], [(3, hole)])
        return _meshed(gmsh, head_radius, geometry.head_size * mesh.size, mesh)


def _cup(radii: tuple[float, ...], level: float, mesh: MeshOptions) -> Body:
    """Layers between spheres about the origin, from within, above the plane z = level."""
    with session("head_cup") as gmsh:
        occ = gmsh.model.occ
        hollow, *layers = (
            (3, occ.addSphere(0, 0, 0, radius, angle1=math.asin(level / radius)))
            for radius in radii
        )
        _, pieces = occ.fragment(layers[-1:], [*layers[:-1], hollow])
        occ.remove(pieces[-1])
        points, cells, volume = _meshed(gmsh, radii[0], mesh.size, mesh)
    # Number of spheres that contain each volume of gmsh; the outermost layer is in one.
    sphere_count = [sum((3, v) in part for part in pieces) for v in range(volume.max() + 1)]
    return points, cells, len(layers) - np.array(sphere_count)[volume]


def _meshed(gmsh: ModuleType, radius: float, size: float, mesh: MeshOptions) -> Body:
    gmsh.model.occ.synchronize()
    grade(gmsh, [f"(sqrt(x*x+y*y+z*z)-{radius})"], size, max(size, mesh.far_size_or_default))
    return tetrahedra(gmsh, bool(mesh.curved))


def _rotation(inclination: float, version: float) -> Floats:
    """Rotation (3, 3) that lays z along the cup's pole."""
    cos_i, sin_i = math.cos(inclination), math.sin(inclination)
    cos_v, sin_v = math.cos(version), math.sin(version)
    about_y = np.array([[cos_i, 0, sin_i], [0, 1, 0], [-sin_i, 0, cos_i]])
    about_x = np.array([[1, 0, 0], [0, cos_v, -sin_v], [0, sin_v, cos_v]])
    return about_y @ about_x
